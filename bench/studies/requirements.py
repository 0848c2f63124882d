"""The accelerometer and the gyro error that alone make a position error in a time without GNSS.

Closed form is the Schuler pendulum with one constant error (A-2.4.5 and A-2.4.7: the curves of figures 2.4.1
and 2.4.2), a sphere that does not turn. The simulation is the strapdown of the bench on the turning
ellipsoid, at rest and level with one bias. Tilt and velocity at the start are not in it: they add to both.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from bench import earth
from bench.arrays import FloatArray
from bench.evaluation.drift_laws import SCHULER, accel_bias_drift, gyro_bias_drift
from bench.navigation import mechanization
from bench.plots import series
from bench.plots.series import Plot
from bench.studies.study import Durations, Findings, Positive, StudyOptions, StudyTable, Work
from bench.units import DEG, HOUR, STANDARD_GRAVITY
from bench.wording import format_number

_UG, _DEG_H = 1e-6 * STANDARD_GRAVITY, DEG / HOUR
_STEP = 0.1  # of the simulation [s]
_CLOSE = (60.0, 600.0)  # where the two agree: Earth rate and the ellipsoid do not count yet [s]


class Options(StudyOptions):
    """What may be asked."""

    error_m: Positive = 5.0
    """position error that is allowed, 1 sigma [m]"""
    outages_s: Durations = (10, 30, 60, 100, 120, 180, 300, 600, 900, 1800, 2532, 3600)
    """times without GNSS [s]"""
    lat_deg: Annotated[float, Field(ge=-80, le=80)] = 45.0
    """latitude of the simulation [deg]"""


def run(options: Options, work: Work) -> Findings:
    """Return the errors that are allowed, by closed form and by simulation."""
    t = np.array(sorted(set(options.outages_s)), float)
    allowed = allow(options.error_m, t)
    work.progress("simulating", 0, 1)
    simulated = simulate(options.error_m, t, options.lat_deg * DEG)
    names = ("accel_ug", "gyro_deg_h")
    columns = {"outage_s": t.tolist()}
    for name, values in zip(names, allowed.T, strict=True):
        columns[name] = values.tolist()
    for name, values in zip(names, simulated.T, strict=True):
        columns[f"{name.replace('_', '_simulated_', 1)}"] = values.tolist()
    units = {name: "ug" if name.endswith("ug") else "deg/h" for name in columns} | {"outage_s": "s"}
    title = f"Error that alone makes {options.error_m:g} m"
    near = (t >= _CLOSE[0]) & (t <= _CLOSE[1])
    off = np.abs(simulated / allowed - 1.0)[near]
    return Findings(
        verdicts=tuple(_tell(options.error_m, t, allowed, off)),
        tables=(StudyTable("requirements", title, columns, units),),
        figures=tuple(_plot(options, t, simulated)),
    )


def allow(error: float, t: FloatArray) -> FloatArray:
    """Return the errors (N, 2) of accelerometer [ug] and gyro [deg/h] that make an error [m] in t [s]."""
    rows = [(error / accel_bias_drift(T) / _UG, error / gyro_bias_drift(T) / _DEG_H) for T in t.tolist()]
    return np.array(rows)


def simulate(error: float, t: FloatArray, lat: float) -> FloatArray:
    """Return what :func:`allow` does, measured on the strapdown at rest at a latitude [rad]."""
    steps = np.maximum(np.rint(t / _STEP).astype(int), 1)
    n = int(steps.max())
    w = np.array([earth.EARTH_RATE * np.cos(lat), 0.0, -earth.EARTH_RATE * np.sin(lat)])
    f = -earth.gravity_n(lat, 0.0)
    found = []
    for gyro, accel in (([0.0, 0.0, 0.0], [_UG, 0.0, 0.0]), ([0.0, _DEG_H, 0.0], [0.0, 0.0, 0.0])):
        ends = [
            mechanization.propagate(
                [lat, 0.0, 0.0],
                np.zeros(3),
                [1.0, 0.0, 0.0, 0.0],
                np.full(n, _STEP),
                np.tile((w + sign * np.array(gyro)) * _STEP, (n, 1)),
                np.tile((f + sign * np.array(accel)) * _STEP, (n, 1)),
            )[steps, :3]
            for sign in (0.0, 1.0)
        ]
        apart = earth.difference_n(ends[1], ends[0])[:, :2]
        found.append(error / np.hypot(*apart.T))
    return np.column_stack(found)


def _tell(error: float, t: FloatArray, allowed: FloatArray, off: FloatArray) -> list[str]:
    at = [T for T in (60.0, 300.0, 600.0) if T in t] or t[:1].tolist()
    texts = []
    for T in at:
        accel, gyro = allowed[int(np.flatnonzero(t == T)[0])]
        texts.append(f"{T:g} s without GNSS leave {format_number(accel)} ug or {format_number(gyro)} deg/h")
    told = [f"For {error:g} m, {'; '.join(texts)}: each alone, so an honest budget gives each a part."]
    half = np.pi / SCHULER
    least = error / accel_bias_drift(half) / _UG
    told.append(
        f"The accelerometer is asked for most at half the Schuler period, {half:.0f} s: "
        f"{format_number(least, 2)} ug. The gyro is asked for more the longer it lasts."
    )
    if len(off):
        told.append(
            f"The strapdown of the bench agrees within {100.0 * off.max():.2g} % from {_CLOSE[0]:g} to "
            f"{_CLOSE[1]:g} s."
        )
    return told


def _plot(options: Options, t: FloatArray, simulated: FloatArray) -> list[Plot]:
    fine = np.geomspace(t.min(), t.max(), 200)
    curves = allow(options.error_m, fine)
    plots = []
    for k, (name, what) in enumerate((("accelerometer", "bias [ug]"), ("gyro", "drift [deg/h]"))):
        lines = (
            series.draw_line("closed", fine, curves[:, k], "closed form", series.ESTIMATORS[0]),
            series.draw_dots("simulated", t, simulated[:, k], "strapdown", series.ESTIMATORS[1], 3.0),
        )
        title = f"{name} {what} that makes {options.error_m:g} m"
        plots.append(Plot(("requirements", name), title, lines, over="outage", log="xy"))
    return plots
