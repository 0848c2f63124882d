"""Numbers of the register that take seconds to compute: closed forms and short flights, each checked."""

from __future__ import annotations

import math
from functools import cache
from typing import NamedTuple

import numpy as np
from scipy import stats

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import ARCSEC, DEG, HOUR, STANDARD_GRAVITY
from bench.evaluation.errors.route_errors import cross_track_error
from bench.evaluation.linear.drift_laws import accel_bias_drift, gyro_bias_drift
from bench.navigation.engine import integrity
from bench.plugins.papers import alignment_errors, vector_matching
from bench.plugins.papers.mechanization_costs import (
    coning_drift,
    gravity_error,
    radii_error,
    simulate_accelerometers,
)
from bench.plugins.papers.mechanizations import attitude
from bench.plugins.papers.mechanizations.error_integral import quaternion_error
from bench.plugins.papers.mechanizations.solving import IntervalMotion, Rates, navigate
from bench.simulation.flight.closed_form import SwingingFlight
from bench.simulation.signals import delays


class Bounded(NamedTuple):
    """A number that must lie between two others."""

    value: float
    low: float
    high: float

    @property
    def holds(self) -> bool:
        """Return whether the value lies within its bounds; False for NaN."""
        return self.low <= self.value <= self.high


def below(value: float, most: float) -> Bounded:
    """Return bounds for a size up to a limit."""
    return Bounded(value, 0.0, most)


def near(value: float, wanted: float, within: float) -> Bounded:
    """Return bounds around a wanted value, within a tolerance."""
    return Bounded(value, wanted - within, wanted + within)


class RowFinding(NamedTuple):
    """Finding of bench for a row."""

    ours: str
    checks: tuple[Bounded, ...]

    @property
    def holds(self) -> bool:
        """Return whether every value lies within its bounds."""
        return all(one.holds for one in self.checks)


@cache
def _fly(duration: float, rate: float, banked: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    turns = SwingingFlight() if banked else SwingingFlight(bank=0.0, climb=0.0, nod=0.0)
    return turns.fly(duration, rate)


def _apart(motion: IntervalMotion, true: FloatArray) -> tuple[float, float]:
    """Return errors at the end: position [m], attitude [arcsec]."""
    end = motion.nav[-1]
    turn = rotation.to_rotvec(rotation.multiply(end[6:], rotation.conjugate(true[6:])))
    return (
        float(np.linalg.norm(earth.difference_n(end[:3], true[:3]))),
        float(np.linalg.norm(turn)) / ARCSEC,
    )


def rest_for_an_hour() -> RowFinding:
    """#1: error-free sensors at rest, and NHE against ENU in flight."""
    q_nb = rotation.from_euler(0.02, -0.03, 2.0)
    start = np.array([0.9, 0.3, 200.0, 0.0, 0.0, 0.0, *q_nb])
    w_n = earth.EARTH_RATE * np.array([math.cos(0.9), 0.0, -math.sin(0.9)])
    w, f = (rotation.rotate(rotation.conjugate(q_nb), v) for v in (w_n, -earth.gravity_n(0.9, 200.0)))
    n, dt = 28_800, 0.125
    rest = _apart(navigate("nhe", start, dt, np.tile(w * dt, (n, 1)), np.tile(f * dt, (n, 1))), start)[0]
    nav, dtheta, dvel = _fly(60.0, 25.0, banked=True)
    nhe, enu = (navigate(name, nav[0], 0.04, dtheta, dvel).nav for name in ("nhe", "enu"))
    off = float(np.abs(nhe[:, 3:6] - enu[:, 3:6]).max())
    return RowFinding(f"{rest:.2g} m; {off:.1g} m/s", (below(rest, 0.01), below(off, 1e-6)))


def fly_inertial() -> RowFinding:
    """#3: the inertial frame against ENU."""
    nav, dtheta, dvel = _fly(600.0, 25.0, banked=True)
    ends = [navigate(name, nav[0], 0.04, dtheta, dvel) for name in ("inertial", "enu")]
    off = _apart(ends[0], ends[1].nav[-1])[0]
    return RowFinding(f"{off:.1g} m", (below(off, 0.01),))


def fly_three_rates() -> RowFinding:
    """#4: 100/50/10 Hz, with the slow figures half an interval ahead and as in the source."""
    nav, dtheta, dvel = _fly(300.0, 100.0, banked=False)
    ahead, lagging = (
        _apart(navigate("nhe", nav[0], 0.01, dtheta, dvel, rates=Rates(100, 50, 10, lead)), nav[-1])[0]
        for lead in (True, False)
    )
    return RowFinding(f"{ahead:.1g} m; lagging {lagging:.2f} m", (below(ahead, 0.4), near(lagging, 0.6, 0.1)))


def fly_attitude(name: str, most: float) -> RowFinding:
    """#5 to #8: attitude after 300 s of level turns."""
    nav, dtheta, dvel = _fly(300.0, 100.0, banked=False)
    off = _apart(navigate("nhe", nav[0], 0.01, dtheta, dvel, attitude=name), nav[-1])[1]
    return RowFinding(f'{off:.2g}"', (below(off, most),))


def fly_euler() -> RowFinding:
    """#6: after level turns, and past both verticals with and without the guard."""
    level = fly_attitude("euler", 0.02)
    rate, C = np.array([1e-3, 1e-3, 40.0 * DEG]), attitude.nhe_matrix(0.3, 0.0, 0.02)
    true = C @ rotation.matrix(rotation.from_rotvec(9.0 * rate))
    x, y, z = (0.01 * rate).tolist()
    lost = []
    for guard in (math.inf, attitude.EULER_GUARD):
        body = attitude.Euler(C, np.eye(3), guard=guard)
        for _ in range(900):
            body.step((x, y, z), (0.0, 0.0, 0.0))
        lost.append(float(np.linalg.norm(rotation.to_rotvec(rotation.from_matrix(body.C @ true.T)))) / DEG)
    text = f"{level.ours}; past 90 deg {lost[0]:.2g} deg, guarded {lost[1]:.1g}"
    return RowFinding(text, (*level.checks, Bounded(lost[0], 0.05, math.inf), below(lost[1], lost[0] / 30.0)))


def take_picard_step() -> RowFinding:
    """#8: error of a step of 1 deg over its cube by 24."""
    q = attitude.picard_turn((DEG, 0.0, 0.0))
    ratio = (DEG - 2.0 * math.atan2(q[1], q[0])) / (DEG**3 / 24.0)
    total = 60_000 * (24.7 * DEG / 100.0) ** 3 / 24.0 * abs(ratio)
    text = f"cube / 24 times {abs(ratio):.4f}; {total:.2e} rad"
    return RowFinding(text, (near(abs(ratio), 1.0, 0.02), near(total, 1.99e-4, 2e-6)))


def cone() -> RowFinding:
    """#9: one increment against two samples."""
    found = [(coning_drift(rate, 1, "two-quaternions"), coning_drift(rate, 2)) for rate in (100, 200, 400)]
    wanted = ((9.60, 2.72), (2.55, 0.196), (0.65, 0.013))
    text = "; ".join(f"{a:.3g}, {b:.2g}" for a, b in found)
    checks = (
        near(a, b, 0.04 * b)
        for pair, one in zip(found, wanted, strict=True)
        for a, b in zip(pair, one, strict=True)
    )
    return RowFinding(f"{text} deg/h", tuple(checks))


def expand_series() -> RowFinding:
    """#10: errors of the series."""
    long, short = radii_error("long"), radii_error("short", 0.0)
    fine, simple = gravity_error("fine"), gravity_error("simple")
    checks = (near(long, 0.3, 0.01), near(short, 45.0, 0.5), below(fine, 0.33), Bounded(simple, 15.0, 21.0))
    return RowFinding(f"{long:.2g} ppm, {short:.0f} ppm; {fine:.2g} ug, {simple:.0f} ug", checks)


def measure_ellipsoids() -> RowFinding:
    """#11: radii at the equator and the pole of every ellipsoid: a(1 - e^2), a; both a^2/b."""
    worst = 0.0
    for e in (earth.WGS84, earth.PZ90_11, earth.KRASOVSKY_1940, earth.INTERNATIONAL_1924):
        for lat, wanted in ((0.0, (e.b**2 / e.a, e.a)), (0.5 * math.pi, (e.a**2 / e.b, e.a**2 / e.b))):
            worst = max(worst, float(np.abs(np.array(earth.radii(lat, e)) / wanted - 1.0).max()))
    return RowFinding(f"within {worst:.1g}", (below(worst, 1e-14),))


def drift_without_gyros() -> RowFinding:
    """#12: exponents of the growth, at first and with the level's square in the end."""
    early, late = simulate_accelerometers(np.array([30.0, 60.0, 1800.0, 3600.0])).reshape(2, 2)
    first, last = (math.log2(pair[1] / pair[0]) for pair in (early, late))
    text = f"t^{first:.2f} to 60 s, t^{last:.2f} to 1 h"
    return RowFinding(text, (near(first, 4.0, 0.05), Bounded(last, 2.0, 3.5)))


def require() -> RowFinding:
    """#16: accelerometer and gyro for 5 m after 300 s."""
    accel = 5.0 / accel_bias_drift(300.0) / (1e-6 * STANDARD_GRAVITY)
    gyro = 5.0 / gyro_bias_drift(300.0) / (DEG / HOUR)
    text = f"{accel:.4g} ug, {gyro:.4g} deg/h"
    return RowFinding(text, (near(accel, 11.46, 5e-3), near(gyro, 0.02353, 5e-6)))


def shift_datum() -> RowFinding:
    """#29: SK-42 at 50 N 30 E against WGS 84, and back."""
    lla = np.array([50.0 * DEG, 30.0 * DEG, 0.0])
    moved = earth.to_datum(lla, "SK-42")
    back = float(np.linalg.norm(earth.to_ecef(earth.from_datum(moved, "SK-42")) - earth.to_ecef(lla)))
    shift = float(np.linalg.norm(earth.to_ecef(moved, earth.KRASOVSKY_1940) - earth.to_ecef(lla)))
    return RowFinding(f"{shift:.1f} m; back {back:.1g} m", (near(shift, 156.3, 0.1), below(back, 1e-3)))


def detect() -> RowFinding:
    """#41: detection of 8 sigma on the accurate axis, S = diag(100, 1, 1): trace ratio and NIS."""
    limit = integrity.nis_limit(3, 1e-4)
    by_nis = float(stats.ncx2.sf(limit, 3, 64.0))
    rng = np.random.default_rng(1)
    y = rng.standard_normal((200_000, 3)) * [10.0, 1.0, 1.0] + [0.0, 0.0, 8.0]
    by_trace = float(np.mean(np.sum(y**2, axis=1) / 102.0 > 10.0))
    text = f"{100 * by_trace:.1f} % against {100 * by_nis:.2f} %"
    return RowFinding(text, (near(by_nis, 0.9998, 1e-4), near(by_trace, 0.002, 7e-4)))


def correct() -> RowFinding:
    """#43: the period of A-5.4.10 with its start."""
    T = integrity.correction_period(DEG, 0.5 * DEG, 10.0 * DEG / HOUR, 5e-3 * STANDARD_GRAVITY)
    return RowFinding(f"{T:.1f} s", (near(T, 172.2, 0.1),))


def normalize() -> RowFinding:
    """#52: the squared norm under the threshold, growing and shrinking."""
    worst = 0.0
    for factor in (1.0 + 1e-11, 1.0 - 1e-11):
        q = (1.0, 0.0, 0.0, 0.0)
        for _ in range(1000):
            w, x, y, z = (factor * part for part in q)
            q = attitude.normalize((w, x, y, z), 1e-9)
            worst = max(worst, abs(sum(part * part for part in q) - 1.0))
    return RowFinding(f"within {worst:.2g} of 1 at 1e-9", (below(worst, 1e-9),))


def integrate_quaternion_error() -> RowFinding:
    """#53: B-7 against two integrations, constant rates, exact to the second order."""
    t = np.linspace(0.0, 4.0, 401)
    w, dw = np.array([0.3, -0.2, 0.1]), 1e-6 * np.array([1.0, -2.0, 0.5])
    start = rotation.from_euler(0.2, 0.1, 1.0)
    q, more, less = (
        rotation.multiply(start, rotation.from_rotvec(np.outer(t, w + share * dw)))
        for share in (0.0, 1.0, -1.0)
    )
    error = quaternion_error(t, q, np.tile(dw, (len(t), 1)))
    off = float(np.abs(error - 0.5 * (more - less)).max())
    return RowFinding(f"{off:.1g}", (below(off, 1e-11),))


def describe_attitude_error() -> RowFinding:
    """#19: alpha, delta and delta_u along a steady course of 5000 s."""
    _, _, apart = alignment_errors.travel(alignment_errors.Options())
    return RowFinding(f"{apart:.1g} rad", (below(apart, 1e-15),))


def match_directions() -> RowFinding:
    """#59: a misalignment of 3.7 mrad by vectors of position and velocity 57.6 deg apart, 300 runs."""
    position = np.array([0.314, 0.949, 0.03])
    across = np.cross(position, [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    angle = 57.6 * DEG
    second = np.array([206.0 * (math.cos(angle) * position + math.sin(angle) * across), 316e3 * position])
    sd = np.array([0.05 * math.sqrt(2.0), math.hypot(5.0, 10.0)])
    turn = np.array([2.0e-3, -2.5e-3, 1.86e-3])
    ins, rng = rotation.matrix(rotation.from_rotvec(turn)), np.random.default_rng(2)
    found = []
    for noise in rng.standard_normal((300, 2, 3)):
        match = vector_matching.match_vectors(second + sd[:, None] * noise, second, sd)
        found.append(vector_matching.misalignment(ins, match.matrix))
    spread = np.sqrt(np.diag(match.cov))
    off = np.abs(np.mean(found, axis=0) - turn) / (spread / math.sqrt(300.0))
    size = 1e3 * float(np.linalg.norm(np.mean(found, axis=0)))
    sds = (near(a, b, 0.1 * b) for a, b in zip(spread.tolist(), (1.3e-4, 3.8e-4, 3.7e-5), strict=True))
    drawn = zip(np.std(found, axis=0).tolist(), spread.tolist(), strict=True)
    checks = (near(size, 3.7, 0.1), *sds, *(below(one, 4.0) for one in off.tolist()))
    checks += tuple(near(a, b, 3.3 / math.sqrt(600.0) * b) for a, b in drawn)
    return RowFinding(f"{size:.2f} mrad; {', '.join(f'{one:.1e}' for one in spread)} rad", checks)


def cross_track() -> RowFinding:
    """#54: 1000 km with 0.1 deg."""
    found = cross_track_error(1e6, 0.1 * DEG)
    return RowFinding(f"{found:.1f} m", (near(found, 1738.2, 0.05),))


def ionosphere() -> RowFinding:
    """#55: Klobuchar's delay of the register's example."""
    lat, lon, el, az = (v * DEG for v in (40.0, -100.0, 20.0, 210.0))
    model = np.array([3.82e-8, 1.49e-8, -1.79e-7, 0.0, 1.43e5, 0.0, -3.28e5, 1.13e5])
    found = float(delays.klobuchar_kernel(lat, lon, el, math.sin(az), math.cos(az), 20.75 * 3600, model))
    return RowFinding(f"{found:.3f} m", (near(found, 23.784, 5e-4),))
