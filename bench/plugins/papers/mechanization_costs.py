"""Cost of frame, rates, attitude algorithm, series and gyro-free accelerometers, in meters and time.

All fly the same banked S-turns in closed form with exact increments (`flight.closed_form`), so the error at
the end is due to the algorithm. Coning is a cone of a given half angle, sampled at several rates. The time of
a step is for Python without a compiler, for comparisons within the table; ned is compiled.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from itertools import chain
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import ARCSEC, DEG, HOUR, STANDARD_GRAVITY
from bench.core.records.findings import Findings, FindingTable, series
from bench.core.records.findings.series import Plot, Series
from bench.core.words.palette import Color
from bench.experiments.studies.study import Numbers, Positive, StudyOptions, StudyWorkers
from bench.navigation import mechanization
from bench.plugins.papers.mechanizations import accelerometers, coning, earth_series
from bench.plugins.papers.mechanizations.attitude import ATTITUDES, make_attitude
from bench.plugins.papers.mechanizations.earth_series import EarthModel
from bench.plugins.papers.mechanizations.solving import FRAMES, IntervalMotion, Rates, navigate
from bench.simulation.flight.closed_form import SwingingFlight

QUESTION = "How much error and time do frame, task rates, attitude algorithm and series of a strapdown cost?"

_TINY = 1e-11  # error of the angular acceleration that stays linear for an hour [rad/s^2]
_VECTOR, _PICARD = "rotation-vector", "two-quaternions"
_SHOWN = ("nhe", "ecef", "inertial")  # in the figure; the other level frames do what nhe does
_LOST = 0.1  # tilt at which level is lost [rad]


class Options(StudyOptions):
    """Options of the study."""

    duration_s: Annotated[int, Field(ge=12, le=3600, multiple_of=12)] = 300
    """length of the flight [s], a multiple of 12"""
    rate_hz: Annotated[int, Field(ge=100, le=1000, multiple_of=100)] = 100
    """rate of the increments [Hz]"""
    coning_deg: Positive = 0.1
    """half angle of the cone [deg]"""
    coning_hz: Positive = 20.0
    """frequency of the coning [Hz]"""
    coning_rates_hz: Numbers = (100, 200, 400)
    """rates of the IMU under coning [Hz]"""
    bases_m: Numbers = (0.2, 0.5, 1.0)
    """distances of opposite accelerometers without gyros [m]"""
    accel_bias_ug: Positive = 10.0
    """bias of one accelerometer [ug]"""


class AlgorithmCosts(NamedTuple):
    """Errors and processor time of an algorithm."""

    motion: IntervalMotion
    position_m: float
    attitude_arcsec: float
    step_us: float
    """Processor time of a sample."""


class TrueFlight(NamedTuple):
    """A flight with its increments, to navigate with different algorithms."""

    nav: FloatArray
    dtheta: FloatArray
    dvel: FloatArray
    interval: float

    def fly(self, name: str, **options: Any) -> AlgorithmCosts:
        """Navigate with an algorithm and return its errors at the end and its CPU time."""
        begun = time.process_time()
        motion = navigate(name, self.nav[0], self.interval, self.dtheta, self.dvel, **options)
        spent = time.process_time() - begun
        end, true = motion.nav[-1], self.nav[-1]
        turn = rotation.to_rotvec(rotation.multiply(end[6:], rotation.conjugate(true[6:])))
        return AlgorithmCosts(
            motion,
            float(np.linalg.norm(earth.difference_n(end[:3], true[:3]))),
            float(np.linalg.norm(turn)) / ARCSEC,
            spent / len(self.dtheta) * 1e6,
        )

    def growth(self, motion: IntervalMotion) -> FloatArray:
        """Return the position error (M,) at the epochs of a motion [m]."""
        step = round((len(self.nav) - 1) / (len(motion.t) - 1))
        return np.asarray(np.linalg.norm(earth.difference_n(motion.nav[:, :3], self.nav[::step, :3]), axis=1))


def run(options: Options, work: StudyWorkers) -> Findings:
    """Fly every algorithm and return the tables and figures."""
    found = work.map("flying", _compare, [(options, k) for k in range(4)])
    verdicts, tables, figures = zip(*found, strict=True)
    return Findings(tuple(chain(*verdicts)), tables, tuple(chain(*figures)))


def _compare(asked: tuple[Options, int]) -> tuple[list[str], FindingTable, list[Plot]]:
    """Return sentences, table and figures of a part of the study."""
    options, part = asked
    interval = 1.0 / options.rate_hz
    flight = TrueFlight(*SwingingFlight().fly(options.duration_s, options.rate_hz), interval)
    navigate("ned", flight.nav[0], interval, flight.dtheta[:100], flight.dvel[:100])  # compiles it
    parts = (_compare_attitudes, _compare_frames, _compare_series, _compare_accelerometers)
    return parts[part](options, flight)


def _list_attitudes() -> list[tuple[str, str, int]]:
    """Return label, attitude and samples in a step of each algorithm."""
    sums = [(name, name, 1) for name in ATTITUDES if name != _VECTOR]
    return sums + [(f"{_VECTOR}, {m}", _VECTOR, m) for m in range(1, coning.MOST_SAMPLES + 1)]


def _compare_attitudes(options: Options, flight: TrueFlight) -> tuple[list[str], FindingTable, list[Plot]]:
    flat = TrueFlight(
        *SwingingFlight(bank=0.0, climb=0.0, nod=0.0).fly(options.duration_s, options.rate_hz),
        flight.interval,
    )
    columns: dict[str, list[Any]] = {}
    lines, cones, ends, drifts = [], [], {}, {}
    rates = np.array(sorted(options.coning_rates_hz), float)
    colors = iter(series.ESTIMATORS), iter(series.ESTIMATORS)
    for label, name, samples in _list_attitudes():
        schedule = Rates(fast=options.rate_hz / samples)
        flown = flight.fly("nhe", rates=schedule, attitude=name)
        drift = [coning_drift(r, samples, name, options.coning_deg, options.coning_hz) for r in rates]
        ends[label], drifts[label] = flown.attitude_arcsec, drift
        row = {
            "attitude": name,
            "samples": samples,
            "position_m": flown.position_m,
            "attitude_arcsec": flown.attitude_arcsec,
            "level_turns_arcsec": flat.fly("nhe", rates=schedule, attitude=name).attitude_arcsec,
            "step_us": flown.step_us,
        }
        row |= {f"coning_{rate:g}_hz_deg_h": found for rate, found in zip(rates, drift, strict=True)}
        for key, value in row.items():
            columns.setdefault(key, []).append(value)
        if samples == 1:
            t = flown.motion.t[1:]
            lines.append(_line(name, t, flight.growth(flown.motion)[1:], next(colors[0])))
        if name in (_PICARD, _VECTOR):
            shown = "sum" if name == _PICARD else f"vector, {samples}"
            cones.append(_line(shown, rates, np.array(drift), next(colors[1])))
    worst, best = (choose(ends, key=ends.__getitem__) for choose in (max, min))
    told = [
        f"After {options.duration_s} s of banked turns at {options.rate_hz} Hz the attitude is off by "
        f"{ends[best]:.2g} arcsec with {best} and by {ends[worst]:.2g} with {worst}.",
        f"Under coning of {options.coning_deg:g} deg at {options.coning_hz:g} Hz one increment in a step "
        f"drifts by {drifts[_PICARD][0]:.3g} deg/h at {rates[0]:g} Hz, two samples by "
        f"{drifts[f'{_VECTOR}, 2'][0]:.3g}.",
    ]
    units = {"position_m": "m", "attitude_arcsec": "arcsec", "level_turns_arcsec": "arcsec", "step_us": "us"}
    units |= {key: "deg/h" for key in columns if key.startswith("coning")}
    table = FindingTable("attitudes", "Attitude algorithms, north, up, east", columns, units)
    growth = Plot(("mechanizations", "growth"), "position error by attitude [m]", tuple(lines), log="y")
    title, over = "drift under coning [deg/h]", "rate of the IMU"
    cone = Plot(("mechanizations", "coning"), title, tuple(cones), across="Hz", over=over, log="xy")
    return told, table, [growth, cone]


def coning_drift(
    rate: float, samples: int, name: str = "rotation-vector", half_deg: float = 0.1, cone_hz: float = 20.0
) -> float:
    """Return the drift under coning [deg/h] of an attitude with so many samples in a step, at a rate [Hz].

    The cone, of a half angle [deg] at a frequency [Hz], is that of Goodman and Robinson (1958): its rates are
    closed forms. An attitude that takes one increment in a step gets the sum of the samples.
    """
    angle, w = half_deg * DEG, 2.0 * math.pi * cone_hz
    periods = max(1, math.ceil(cone_hz / 20.0))
    steps = round(max(1.0, 40.0 * periods / cone_hz) * rate / samples)
    t = np.arange(steps * samples + 1) / rate
    s = math.sin(angle)
    whole = np.column_stack([-2.0 * w * math.sin(angle / 2) ** 2 * t, s * np.cos(w * t), s * np.sin(w * t)])
    theta, _ = coning.step_increments(
        np.diff(whole, axis=0), 0.0 * whole[1:], samples, corrected=name == "rotation-vector"
    )
    half = 0.5 * angle

    def truth(T: float) -> FloatArray:
        c, sn = math.cos(w * T), math.sin(w * T)
        return rotation.matrix([math.cos(half), 0.0, math.sin(half) * c, math.sin(half) * sn])

    body = make_attitude(name, truth(0.0), np.eye(3))
    for x, y, z in theta.tolist():
        body.step((x, y, z), (0.0, 0.0, 0.0))
    turn = rotation.to_rotvec(rotation.from_matrix(body.C @ truth(float(t[-1])).T))
    return float(np.linalg.norm(turn)) / float(t[-1]) / (DEG / HOUR)


def _compare_frames(options: Options, flight: TrueFlight) -> tuple[list[str], FindingTable, list[Plot]]:
    columns: dict[str, list[Any]] = {}
    slow = (100.0, 10.0, 1.0)
    medium = {100.0: 100.0, 10.0: 50.0, 1.0: 10.0}  # rates of the table of
    lines = []
    for name in ("ned", *FRAMES):
        for lead in (True, False):
            if name == "ned" and not lead:
                continue
            ends = []
            for rate in slow if name != "ned" else slow[:1]:
                rates = Rates(100.0, medium[rate], rate, lead) if name != "ned" else Rates()
                flown = flight.fly(name, rates=rates)
                ends.append(flown.position_m)
                row = {
                    "frame": name,
                    "rates_hz": "/".join(f"{r or options.rate_hz:g}" for r in rates[:3]),
                    "lead": lead,
                    "position_m": flown.position_m,
                    "attitude_arcsec": flown.attitude_arcsec,
                    "step_us": flown.step_us,
                }
                for key, value in row.items():
                    columns.setdefault(key, []).append(value)
            if name in _SHOWN:
                label = f"{name}{'' if lead else ', lagging'}"
                color = series.ESTIMATORS[_SHOWN.index(name) + (0 if lead else len(_SHOWN))]
                lines.append(_line(label, np.array(slow)[::-1], np.array(ends)[::-1], color))
    chosen = {
        lead: p
        for p, lead, rate, name in zip(
            columns["position_m"], columns["lead"], columns["rates_hz"], columns["frame"], strict=True
        )
        if name == "nhe" and rate == "100/50/10"
    }
    told = [
        f"At 100/50/10 Hz the frame north, up, east ends {chosen[False]:.2g} m off with rates and gravity at "
        f"the start of their interval, as in the source, and {chosen[True]:.1g} m with values at its middle."
    ]
    units = {"rates_hz": "Hz", "position_m": "m", "attitude_arcsec": "arcsec", "step_us": "us"}
    table = FindingTable("frames", "Frames and rates, rotation vector", columns, units)
    title = f"position error after {options.duration_s} s [m]"
    plot = Plot(("mechanizations", "rates"), title, tuple(lines), across="Hz", over="slow rate", log="xy")
    return told, table, [plot]


def _compare_series(options: Options, flight: TrueFlight) -> tuple[list[str], FindingTable, list[Plot]]:
    columns: dict[str, list[Any]] = {"figure": [], "formula": [], "largest_error": [], "position_m": []}
    rates = Rates(100.0, 50.0, 10.0)
    for kind, names, measure in (
        ("radii", tuple(earth_series.RADII), radii_error),
        ("gravity", tuple(earth_series.GRAVITIES), gravity_error),
    ):
        for name in names:
            model = EarthModel(radii=name) if kind == "radii" else EarthModel(gravity=name)
            columns["figure"].append(f"{kind}, {'ppm' if kind == 'radii' else 'ug'}")
            columns["formula"].append(name)
            columns["largest_error"].append(measure(name))
            columns["position_m"].append(flight.fly("enu", rates=rates, earth=model).position_m)
    told = [
        f"Up to 12 km the short series of the radii is wrong by {radii_error('short'):.0f} ppm at most, the "
        f"long one by {radii_error('long'):.1g}; simple gravity by {gravity_error('simple'):.0f} ug, the "
        f"other two sets by {max(map(gravity_error, ('fine', 'medium'))):.1g} ug."
    ]
    title = "Series of radii and gravity, 0 to 12 km, east, north, up"
    return told, FindingTable("series", title, columns, {"position_m": "m"}), []


def radii_error(name: str, height: float = 12_000.0) -> float:
    """Return the largest relative error of the radii of a series up to a height [m], in ppm (A-2.2.1)."""
    worst = 0.0
    for s in np.sin(np.arange(-90.0, 91.0, 5.0) * DEG).tolist():
        for h in (0.0, 0.5 * height, height):
            found = earth_series.RADII[name](s, h, earth.WGS84)
            exact = earth_series.exact_radii(s, h, earth.WGS84)
            worst = max(worst, *(abs(a / b - 1.0) for a, b in zip(found, exact, strict=True)))
    return worst * 1e6


def gravity_error(name: str, height: float = 12_000.0) -> float:
    """Return the largest error of a gravity formula up to a height [m], in ug (A-2.2.G1 to G3)."""
    worst = 0.0
    for lat in (np.arange(-90.0, 91.0, 5.0) * DEG).tolist():
        for h in (0.0, 0.5 * height, height):
            north, down = earth_series.GRAVITIES[name](math.sin(lat), math.cos(lat), h)
            exact = earth.gravity_n(lat, h)
            worst = max(worst, abs(north - exact[0]), abs(down - exact[2]))
    return worst / STANDARD_GRAVITY * 1e6


def _compare_accelerometers(
    options: Options, flight: TrueFlight
) -> tuple[list[str], FindingTable, list[Plot]]:
    del flight
    t = np.unique(np.rint(np.geomspace(30.0, 3600.0, 25)))
    measured = simulate_accelerometers(t) / _TINY
    bias = options.accel_bias_ug * 1e-6 * STANDARD_GRAVITY
    columns: dict[str, list[Any]] = {"base_m": [], "level_lost_s": [], "position_then_m": []}
    columns |= {f"position_{T:g}_s_m": [] for T in (10.0, 60.0)}
    lines: list[Series] = []
    fine = np.geomspace(10.0, 3600.0, 200)
    law: Callable[..., FloatArray] = accelerometers.drift_by_angular_acceleration
    for k, base in enumerate(sorted(options.bases_m)):
        error = acceleration_error(base, bias)
        lost = math.sqrt(2.0 * _LOST / error)
        columns["base_m"].append(base)
        columns["level_lost_s"].append(lost)
        columns["position_then_m"].append(float(law(lost, error)))
        for T in (10.0, 60.0):
            columns[f"position_{T:g}_s_m"].append(float(law(T, error)))
        color = series.ESTIMATORS[k % len(series.ESTIMATORS)]
        lines.append(_line(f"{base:g} m", fine, law(fine, error), color))
    middle = acceleration_error(sorted(options.bases_m)[len(options.bases_m) // 2], bias)
    lines.append(series.draw_dots("strapdown", t, measured * middle, "strapdown", series.TRUTH, 3.0))
    off = np.abs(measured * _TINY / law(t, _TINY) - 1.0)[t <= 1800].max()
    told = [
        f"Without gyros, one accelerometer of a cube off by {options.accel_bias_ug:g} ug tilts the level by "
        f"{_LOST:g} rad in {columns['level_lost_s'][0]:.0f} s at a base of {columns['base_m'][0]:g} m and in "
        f"{columns['level_lost_s'][-1]:.0f} s at {columns['base_m'][-1]:g} m: the rate drifts with bias over "
        "base, the level with the square of time.",
        f"The strapdown agrees with the law within {100.0 * off:.2g} % from 30 to 1800 s.",
    ]
    units = {key: "s" if key.endswith("_s") else "m" for key in columns}
    table = FindingTable("accelerometers", "Accelerometers alone: six on a cube", columns, units)
    title = f"position error without gyros, {options.accel_bias_ug:g} ug [m]"
    return told, table, [Plot(("mechanizations", "accelerometers"), title, tuple(lines), log="xy")]


def acceleration_error(base: float, bias: float) -> float:
    """Return the horizontal angular acceleration [rad/s^2] that a bias [m/s^2] of one accelerometer makes."""
    return float(np.linalg.norm(accelerometers.make_cube(base).solution[:2, 0]) * bias)


def simulate_accelerometers(t: FloatArray, lat: float = 45.0 * DEG) -> FloatArray:
    """Return the position error (N,) [m] at times (N,) [s] of a cube at rest, angular acceleration 1e-11 off.

    Readings with and without a bias of one accelerometer, through the cube and the strapdown of the bench.
    """
    cube = accelerometers.make_cube(1.0)
    n = round(float(t.max()))
    w = earth.EARTH_RATE * np.array([math.cos(lat), 0.0, -math.sin(lat)])
    still = (np.tile(v, (n + 1, 1)) for v in (w, np.zeros(3), -earth.gravity_n(lat, 0.0)))
    readings = cube.read(*still)
    bias = _TINY / acceleration_error(1.0, 1.0) * np.eye(6)[0]
    ends = []
    for error in (0.0, 1.0):
        dtheta, dvel = cube.integrate(readings + error * bias, 1.0, w)
        ends.append(
            mechanization.propagate(
                [lat, 0.0, 0.0], np.zeros(3), [1.0, 0.0, 0.0, 0.0], np.ones(n), dtheta, dvel
            )
        )
    rows = np.rint(t).astype(int)
    apart = earth.difference_n(ends[1][rows, :3], ends[0][rows, :3])
    return np.asarray(np.hypot(apart[:, 0], apart[:, 1]))


def _line(label: str, x: FloatArray, y: FloatArray, color: Color) -> Series:
    return series.draw_line(label, x, y, label, color, most=2.0)
