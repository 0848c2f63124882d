"""The sensor errors that keep the position error within a limit during a time without GNSS.

Closed form: the Schuler pendulum on a sphere that does not rotate (A-2.4.4 to A-2.4.7, the curves of figures
2.4.1 and 2.4.2). Errors: a constant accelerometer or gyro error, an initial tilt or velocity error, white
noise. The position must be within the limit at every time up to the given one, not only at its end: the
effect of an accelerometer error is back at zero after 84.4 minutes. Each error alone may use the whole limit;
with --split several share the variance equally. Simulation: the strapdown of bench on the rotating ellipsoid,
at rest and level with one bias, its height held as with a barometer. Each value is per axis.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.core.records.findings import Findings, FindingTable, make_table, series
from bench.core.records.findings.series import Plot
from bench.core.records.sensor_specs import ImuSpec
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number, suggest
from bench.evaluation.linear import drift_laws
from bench.evaluation.linear.drift_laws import SCHULER
from bench.experiments.studies.study import Durations, Positive, StudyOptions, StudyWorkers, Words
from bench.experiments.studies.unit_study.catalog_units import find_units
from bench.io.config.datasheets import read_imu
from bench.io.config.library import find_datasheet
from bench.navigation import mechanization

STUDY = 1, "requirements"
QUESTION = "Which gyro and accelerometer errors are allowed for a position error after an outage?"

_UG, _DEG_H = 1e-6 * STANDARD_GRAVITY, DEG / HOUR
_STEP = 0.1  # of the simulation [s]
_HELD = 10  # steps after which the height is set right
_CLOSE = (60.0, 600.0)  # where the two agree: Earth rate and the ellipsoid do not count yet [s]
_LONGEST = 36_000.0  # for which a unit is asked [s]
_QUARTER, _HALF = 0.5 * math.pi / SCHULER, math.pi / SCHULER  # of the Schuler period [s]


class _Error(NamedTuple):
    """A sensor error that causes a position drift of an unaided INS."""

    words: str
    column: str  # ends in its unit
    unit: float  # SI over the unit
    drift: Callable[[float], float]  # after a time [s], per SI
    peak: float = math.inf  # time after which the drift has been largest [s]


ERRORS: Mapping[str, _Error] = {
    "accel": _Error("accelerometer bias", "accel_ug", _UG, drift_laws.accel_bias_drift, _HALF),
    "gyro": _Error("gyro bias", "gyro_deg_h", _DEG_H, drift_laws.gyro_bias_drift),
    "tilt": _Error("tilt at the start", "tilt_mrad", 1e-3, drift_laws.tilt_drift, _HALF),
    "velocity": _Error("velocity at the start", "velocity_mps", 1.0, drift_laws.velocity_drift, _QUARTER),
    "accel-noise": _Error(
        "velocity random walk", "accel_noise_m_s_sqrt_h", 1.0 / 60.0, drift_laws.accel_noise_drift
    ),
    "gyro-noise": _Error(
        "angular random walk", "gyro_noise_deg_sqrt_h", DEG / 60.0, drift_laws.gyro_noise_drift
    ),
}
"""Name of an error -> what it is and how it drifts."""


class Options(StudyOptions):
    """Options of the study."""

    error_m: Positive = 5.0
    """allowed position error, 1 sigma per axis [m]"""
    outages_s: Durations = (10, 30, 60, 100, 120, 180, 300, 600, 900, 1800, 2532, 3600)
    """times without GNSS [s]"""
    lat_deg: Annotated[float, Field(ge=-80, le=80)] = 45.0
    """latitude of the simulation [deg]"""
    split: Words = tuple(ERRORS)
    """errors that share the variance: accel, gyro, tilt, velocity, accel-noise, gyro-noise"""
    units: Words = ("grade-1", "stim300", "adis16475", "icm-42688-p")
    """IMUs of the catalog, or .toml files of your own: how long each stays within the error"""


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the errors that are allowed, by closed form and by simulation."""
    if wrong := [
        f"study requirements: split: {name!r} is unknown{suggest(name, ERRORS, 'errors')}"
        for name in options.split
        if name not in ERRORS
    ]:
        raise ConfigError(*wrong)
    find_units("requirements", options.units)
    t = np.array(sorted(set(options.outages_s)), float)
    work.progress("simulating", 0, 1)
    simulated = simulate(options.error_m, t, options.lat_deg * DEG)
    allowed = {name: allow(options.error_m, t, name) for name in ERRORS}
    share = 1.0 / math.sqrt(len(options.split))
    held = [(name, *find_times(name, options.error_m)) for name in options.units]
    off = np.abs(simulated / np.column_stack([allowed["accel"], allowed["gyro"]]) - 1.0)
    return Findings(
        verdicts=tuple(_tell(options, t, allowed, off, held)),
        tables=(
            _fill_alone(options, t, allowed, simulated),
            _fill_split(options, t, {name: share * allowed[name] for name in options.split}),
            make_table(
                "units",
                f"Time within {options.error_m:g} m by the datasheet, from a perfect start",
                ("unit", "calibrated_s", "as_turned_on_s"),
                held,
            ),
        ),
        figures=tuple(_plot(options, t, simulated)),
    )


def largest_drift(name: str, T: float) -> float:
    """Return the largest drift of an error of :data:`ERRORS` within a time T [s], per SI."""
    one = ERRORS[name]
    return one.drift(min(T, one.peak))


def allow(error: float, t: FloatArray, name: str) -> FloatArray:
    """Return the size (N,) of an error that keeps the position within ``error`` [m] up to t [s]."""
    return np.array([error / largest_drift(name, T) / ERRORS[name].unit for T in t.tolist()])


def find_times(unit: str, error: float) -> tuple[float | None, float | None]:
    """Return the times [s] for which an IMU stays within an error [m] per axis: calibrated, and as turned on.

    From a perfect start, by its datasheet; None if for ten hours.
    """
    imu = read_imu(*find_datasheet("imu", unit, Path()))
    return _find_time(imu, error, calibrated=True), _find_time(imu, error, calibrated=False)


def _find_time(imu: ImuSpec, error: float, *, calibrated: bool) -> float | None:
    for t in np.arange(1.0, _LONGEST + 1.0):
        if drift_laws.drift_sd(float(t), imu, calibrated=calibrated) > error:
            before, after = (drift_laws.drift_sd(float(t) - k, imu, calibrated=calibrated) for k in (1, 0))
            return float(t - 1.0 + (error - before) / (after - before))
    return None


def simulate(error: float, t: FloatArray, lat: float) -> FloatArray:
    """Return the results of :func:`allow` for accelerometer and gyro (N, 2), by a strapdown at lat [rad].

    A bias that moves the position by d at most up to a time may be error / d times as large: it is linear.
    """
    steps = np.maximum(np.rint(t / _STEP).astype(int), 1)
    found = []
    for gyro, accel in (([0.0, 0.0, 0.0], [_UG, 0.0, 0.0]), ([0.0, _DEG_H, 0.0], [0.0, 0.0, 0.0])):
        moved, still = (
            _navigate_at_rest(lat, int(steps.max()), sign * np.array(gyro), sign * np.array(accel))
            for sign in (1.0, 0.0)
        )
        apart = earth.difference_n(moved, still)[:, :2]
        found.append(error / np.maximum.accumulate(np.hypot(*apart.T))[steps])
    return np.column_stack(found)


def _navigate_at_rest(lat: float, n: int, gyro: FloatArray, accel: FloatArray) -> FloatArray:
    """Return latitude, longitude [rad], height [m] (n + 1, 3) of a strapdown with biases; height is fixed."""
    w = np.array([earth.EARTH_RATE * np.cos(lat), 0.0, -earth.EARTH_RATE * np.sin(lat)]) + gyro
    f = -earth.gravity_n(lat, 0.0) + accel
    nav = np.array([[lat, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    parts = [nav[:, :3]]
    for begin in range(0, n, _HELD):
        count = min(_HELD, n - begin)
        last = nav[-1]
        nav = mechanization.propagate(
            [last[0], last[1], 0.0], [last[3], last[4], 0.0], last[6:], np.full(count, _STEP),
            np.tile(w * _STEP, (count, 1)), np.tile(f * _STEP, (count, 1)),
        )  # fmt: skip
        parts.append(nav[1:, :3])
    return np.concatenate(parts)


# --- tables, words and figures ----------------------------------------------------------------------------


def _fill_split(options: Options, t: FloatArray, sizes: Mapping[str, FloatArray]) -> FindingTable:
    columns = {"outage_s": t, **{ERRORS[key].column: values for key, values in sizes.items()}}
    title = f"Errors that together make {options.error_m:g} m, each with an equal part of the variance"
    rows = list(zip(*(values.tolist() for values in columns.values()), strict=True))
    return make_table("split", title, list(columns), rows)


def _fill_alone(
    options: Options, t: FloatArray, allowed: Mapping[str, FloatArray], simulated: FloatArray
) -> FindingTable:
    columns = {
        "outage_s": t,
        **{ERRORS[name].column: values for name, values in allowed.items()},
        "accel_simulated_ug": simulated[:, 0],
        "gyro_simulated_deg_h": simulated[:, 1],
    }
    title = f"Error that alone makes {options.error_m:g} m within the time"
    rows = list(zip(*(values.tolist() for values in columns.values()), strict=True))
    return make_table("requirements", title, list(columns), rows)


def _tell(
    options: Options,
    t: FloatArray,
    allowed: Mapping[str, FloatArray],
    off: FloatArray,
    held: list[tuple[str, float | None, float | None]],
) -> Iterator[str]:
    error = options.error_m
    at = [T for T in (60.0, 300.0, 600.0) if T in t] or t[:1].tolist()
    texts = []
    for T in at:
        k = int(np.flatnonzero(t == T)[0])
        accel, gyro = (format_number(allowed[name][k]) for name in ("accel", "gyro"))
        texts.append(f"{T:g} s without GNSS allow {accel} ug or {gyro} deg/h")
    yield f"For {error:g} m, {'; '.join(texts)}: each if it is the only error."
    share = 100.0 / math.sqrt(len(options.split))
    words = ", ".join(ERRORS[name].words for name in options.split)
    yield f"If {words} share the variance equally, each may be {share:.0f} % of that (table split)."
    least = error / largest_drift("accel", _HALF) / _UG
    yield (
        f"The accelerometer has moved the position most after half the Schuler period, {_HALF:.0f} s: "
        f"{format_number(least, 2)} ug however long it lasts. The gyro is asked for more the longer it lasts."
    )
    near = (t >= _CLOSE[0]) & (t <= _CLOSE[1])
    if near.any():
        yield (
            f"The strapdown of the bench agrees within {100.0 * off[near].max():.2g} % from {_CLOSE[0]:g} to "
            f"{_CLOSE[1]:g} s, and within {100.0 * off.max():.2g} % everywhere: the closed form leaves out "
            "the rate of the Earth."
        )
    parts = [f"{unit} {_say(known)} calibrated, {_say(raw)} as turned on" for unit, known, raw in held]
    yield f"By their datasheets, from a perfect start, these stay within {error:g} m for: {'; '.join(parts)}."


def _say(seconds: float | None) -> str:
    return "ten hours and more" if seconds is None else f"{format_number(seconds, 3)} s"


def _plot(options: Options, t: FloatArray, simulated: FloatArray) -> Iterator[Plot]:
    fine = np.geomspace(t.min(), t.max(), 200)
    for k, (name, what) in enumerate((("accel", "accelerometer bias [ug]"), ("gyro", "gyro drift [deg/h]"))):
        lines = (
            series.draw_line(
                "closed", fine, allow(options.error_m, fine, name), "closed form", series.ESTIMATORS[0]
            ),
            series.draw_dots("simulated", t, simulated[:, k], "strapdown", series.ESTIMATORS[1], 3.0),
        )
        title = f"{what} that makes {options.error_m:g} m within the time"
        key = what.split()[0]
        yield Plot(("requirements", key), title, lines, over="outage", log="xy")
