"""Broadcast messages fitted to positions and clocks of satellites, as a control segment makes them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.orbit_sets import KEPLER, STATE, GlonassSets, KeplerSets
from bench.simulation.signals import orbits
from bench.simulation.signals.orbits import C

_STEPS = {
    "sqrt_a": 1e-2, "e": 1e-5, "i_0": 1e-5, "node_0": 1e-5, "perigee": 1e-5, "mean_anomaly": 1e-5,
    "delta_n": 1e-8, "i_rate": 1e-8, "node_rate": 1e-8,
    "c_uc": 1e-5, "c_us": 1e-5, "c_rc": 100.0, "c_rs": 100.0, "c_ic": 1e-5, "c_is": 1e-5,
}  # fmt: skip
"""Elements that are fitted, with the steps of their central differences: some 100 m."""
_STATE_STEPS = (
    dict.fromkeys(STATE[1:4], 100.0) | dict.fromkeys(STATE[4:7], 1.0) | dict.fromkeys(STATE[7:10], 1e-2)
)
"""The same of GLONASS."""
_WEIGHT = 10.0  # of velocities against positions [s]
_CLOSE = 2e-4  # rms of both that ends the iteration [m]
_DAMPING = 1e-6  # at the start, of Levenberg-Marquardt with columns of unit length [1]
_STUCK = 10.0  # no step of any use is left
_ROUNDS = 40


def fit_kepler(
    sat: int, system: int, t_oe: float, t_oe_week: float,
    t: FloatArray, pos_e: FloatArray, vel_e: FloatArray, clock: FloatArray,
) -> KeplerSets:  # fmt: skip
    """Fit one set of Keplerian elements (IS-GPS-200, table 20-III) to a satellite.

    Parameters
    ----------
    sat, system : int
        Its number and system.
    t_oe, t_oe_week : float
        Reference time since the origin of ``t``, and since the start of the week of its system [s].
    t : (N,) array
        Epochs [s].
    pos_e, vel_e : (N, 3) arrays
        Its position and velocity there [m, m/s], e.
    clock : (N,) array
        Its clock with relativity there [m].

    Notes
    -----
    Levenberg-Marquardt from the osculating orbit at the time nearest to ``t_oe``. What a short arc does
    not determine stays at that.
    """
    row = np.zeros(len(KEPLER))
    k = int(np.argmin(np.abs(t - t_oe)))
    values = _find_osculating(sat, system, t_oe, t[k], pos_e[k], vel_e[k])
    rate = orbits.EARTH_RATES[system]
    values |= {"t_oe": t_oe, "t_oc": t_oe, "t_oe_week": t_oe_week}
    values["node_0"] += rate * t_oe_week
    for name, value in values.items():
        row[KEPLER.index(name)] = value

    def make(elements: FloatArray) -> KeplerSets:
        return KeplerSets(np.array([sat]), np.ones(1, bool), elements[None], system)

    row = _fit(row, {KEPLER.index(name): step for name, step in _STEPS.items()}, make, t, pos_e, vel_e)
    if row[KEPLER.index("e")] < 0.0:  # the same orbit, counted from the other apsis
        row[KEPLER.index("e")] *= -1.0
        row[[KEPLER.index("perigee"), KEPLER.index("mean_anomaly")]] += np.pi
    relativity = orbits.compute_states(make(row), np.zeros(len(t), np.int64), t).relativity
    row[[KEPLER.index("af_0"), KEPLER.index("af_1")]] = _fit_line(t - t_oe, clock / C - relativity)
    for name in ("node_0", "perigee", "mean_anomaly"):
        at = KEPLER.index(name)
        row[at] = (row[at] + np.pi) % (2 * np.pi) - np.pi
    return make(row)


def fit_glonass(
    sat: int, channel: int, t_b: float,
    t: FloatArray, pos_e: FloatArray, vel_e: FloatArray, clock: FloatArray,
) -> GlonassSets:  # fmt: skip
    """Fit a state with a constant luni-solar acceleration (GLONASS ICD 5.1, table 4.5) to a satellite.

    The parameters are those of `fit_kepler`, ``t_b`` the reference time. An orbit of two bodies differs from
    the motion with J2 and a fitted acceleration by 0.3 mm over 2 minutes, by 0.2 m at the ends of 15.
    """

    def make(state: FloatArray) -> GlonassSets:
        return GlonassSets(np.array([sat]), np.ones(1, bool), np.array([channel]), state[None])

    k, row = int(np.argmin(np.abs(t - t_b))), np.zeros(len(STATE))
    row[0], row[1:4], row[4:7] = t[k], pos_e[k], vel_e[k]
    begun = orbits.compute_states(make(row), np.zeros(1, np.int64), np.array([t_b]))
    row[0], row[1:4], row[4:7] = t_b, begun.pos_e[0], begun.vel_e[0]

    row = _fit(row, {STATE.index(name): step for name, step in _STATE_STEPS.items()}, make, t, pos_e, vel_e)
    row[10:] = _fit_line(t - t_b, clock / C)
    return make(row)


def _find_osculating(
    sat: int, system: int, t_oe: float, t: float, pos_e: FloatArray, vel_e: FloatArray
) -> dict[str, float]:
    """Return the elements of the orbit of two bodies through a state, with the node of ``t_oe``."""
    gm, rate = orbits.GRAVITY[system], orbits.EARTH_RATES[system]
    s, c = np.sin(rate * (t_oe - t)), np.cos(rate * (t_oe - t))
    to_frame = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])  # axes of e at t_oe
    at = KeplerSets(np.array([sat]), np.ones(1, bool), np.zeros((1, len(KEPLER))), system)
    if orbits.is_geostationary(at)[0]:
        to_frame = orbits.INCLINED.T @ to_frame
    r = to_frame @ pos_e
    v = to_frame @ (vel_e + np.cross([0.0, 0.0, rate], pos_e))
    h, distance = np.cross(r, v), float(np.linalg.norm(r))
    p = float(h @ h) / gm
    a = 1.0 / (2.0 / distance - float(v @ v) / gm)
    e_cos, e_sin = p / distance - 1.0, np.sqrt(p / gm) * float(r @ v) / distance
    e, true = float(np.hypot(e_cos, e_sin)), float(np.arctan2(e_sin, e_cos))
    node = np.arctan2(h[0], -h[1])
    ahead = np.array([np.cos(node), np.sin(node), 0.0])
    latitude = np.arctan2(r @ np.cross(h, ahead) / np.linalg.norm(h), r @ ahead)
    anomaly = 2.0 * np.arctan2(np.sqrt(1.0 - e) * np.sin(true / 2), np.sqrt(1.0 + e) * np.cos(true / 2))
    mean = anomaly - e * np.sin(anomaly) + np.sqrt(gm / a) / a * (t_oe - t)
    return {
        "sqrt_a": float(np.sqrt(a)), "e": e, "i_0": float(np.arctan2(np.hypot(h[0], h[1]), h[2])),
        "node_0": float(node), "perigee": float(latitude - true), "mean_anomaly": float(mean),
    }  # fmt: skip


def _fit(
    row: FloatArray,
    steps: dict[int, float],
    make: Callable[[FloatArray], KeplerSets | GlonassSets],
    t: FloatArray,
    pos_e: FloatArray,
    vel_e: FloatArray,
) -> FloatArray:
    """Return the parameters that come nearest to positions and, times `_WEIGHT`, velocities (N, 3)."""
    at, size = list(steps), np.array(list(steps.values()))

    def compute(change: FloatArray) -> FloatArray:
        parameters = row.copy()
        parameters[at] += change * size
        found = orbits.compute_states(make(parameters), np.zeros(len(t), np.int64), t)
        return np.concatenate([found.pos_e, _WEIGHT * found.vel_e]).ravel()

    n = len(at)
    change, wanted, damping = np.zeros(n), np.concatenate([pos_e, _WEIGHT * vel_e]).ravel(), _DAMPING
    left = wanted - compute(change)
    for _ in range(_ROUNDS):
        rms = float(np.sqrt(np.mean(left**2)))
        if rms < _CLOSE or damping > _STUCK:
            break
        J = np.stack([0.5 * (compute(change + one) - compute(change - one)) for one in np.eye(n)], -1)
        scale = np.linalg.norm(J, axis=0)
        damped = np.concatenate([J / scale, np.sqrt(damping) * np.eye(n)])
        tried = change + np.linalg.lstsq(damped, np.append(left, np.zeros(n)), rcond=None)[0] / scale
        remaining = wanted - compute(tried)
        if np.sqrt(np.mean(remaining**2)) < rms:
            change, left, damping = tried, remaining, 0.1 * damping
        else:
            damping *= 30.0
    best = row.copy()
    best[at] += change * size
    return best


def _fit_line(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return value at 0 and slope (2,) of the line through values (N,); a slope of 0 through one."""
    rows = np.column_stack([np.ones(len(t)), t])
    size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
    found: FloatArray = np.linalg.lstsq(rows / size, values, rcond=1e-9)[0] / size
    return found
