"""Drift without GNSS by grade: covariances of the 22-state filter each second of the flight of equations 7.1.

Beside it what the bias of the grade alone would do if nothing had calibrated it (A-2.4.4, A-2.4.7, figures
2.4.1 and 2.4.2).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import get_args

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings import FindingTable, make_table, series
from bench.core.records.findings.series import Plot
from bench.evaluation.linear.drift_laws import accel_bias_drift, gyro_bias_drift
from bench.experiments.studies.linear_flight import GRADES, LOST, LinearFlight, Phase
from bench.experiments.studies.study import StudyWorkers

_LEAST_S = 600  # that are carried, however short the times asked for [s]


@dataclass(frozen=True)
class Grown:
    """A grade on the linear flight of equations 7.1."""

    name: str
    phase: Phase
    seconds: FloatArray  # (N,) since the loss [s]
    east: FloatArray  # (N,) growth of the east standard deviation [m]
    by_accel: FloatArray  # (N,) what its bias alone would do [m]
    by_gyro: FloatArray  # (N,)

    def take(self, elapsed: Sequence[float]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the three sigmas at some times since the start of the outage [s]."""
        east, accel, gyro = (
            np.interp(elapsed, self.seconds, values) for values in (self.east, self.by_accel, self.by_gyro)
        )
        return east, accel, gyro


def predict_grades(longest: float, work: StudyWorkers) -> list[Grown]:
    """Return the growth of each grade in each phase, for a duration [s] and at least ten minutes."""
    seconds = np.arange(max(_LEAST_S, int(np.ceil(longest))) + 1.0)
    found = work.map("covariances by grade", _grow, [(name, len(seconds) - 1) for name in GRADES])
    grades = []
    for phase in get_args(Phase):
        for name, sd in zip(GRADES, found, strict=True):
            sigmas = GRADES[name].sigmas
            by_accel, by_gyro = (
                np.array([size * law(T) for T in seconds.tolist()])
                for size, law in ((sigmas.da, accel_bias_drift), (sigmas.eps, gyro_bias_drift))
            )
            east = np.sqrt(np.maximum(sd[phase] ** 2 - sd[phase][0] ** 2, 0.0))
            grades.append(Grown(name, phase, seconds, east, by_accel, by_gyro))
    return grades


def _grow(asked: tuple[str, int]) -> dict[str, FloatArray]:
    """Return the east standard deviation from the loss of GNSS on, second by second, of each phase [m]."""
    name, seconds = asked
    grade, flight = GRADES[name], LinearFlight()
    for P in flight.carry(grade, flight.start(grade), 0, LOST):
        lost = P
    return {
        phase: flight.take_sd([lost, *LinearFlight(phase).carry(grade, lost, LOST, LOST + seconds)])[:, 0]
        for phase in get_args(Phase)
    }


def find_time(seconds: FloatArray, values: FloatArray, limit: float) -> float | None:
    """Return the time at which values (N,) first exceed a limit, linear between epochs; None if never."""
    beyond = np.flatnonzero(values > limit)
    if not len(beyond):
        return None
    k = int(beyond[0])
    if k == 0:
        return float(seconds[0])
    share = (limit - values[k - 1]) / (values[k] - values[k - 1])
    return float(seconds[k - 1] + share * (seconds[k] - seconds[k - 1]))


def fill_grades(grades: Sequence[Grown], elapsed: Sequence[float], limit: float) -> FindingTable:
    """Return the drift by grade at the requested times [m], and the time at which it exceeds the limit."""
    rows = [
        (one.name, one.phase, T, *values, find_time(one.seconds, one.east, limit))
        for one in grades
        for T, *values in zip(elapsed, *(part.tolist() for part in one.take(elapsed)), strict=True)
    ]
    names = ("grade", "phase", "outage_s", "growth_east_m", "accel_bias_m", "gyro_bias_m", "beyond_after_s")
    title = f"By grade: covariance of the 22-state filter, 1 sigma, each bias alone; time to {limit:g} m"
    return make_table("grades", title, names, rows)


def tell_grades(grades: Sequence[Grown], limit: float) -> Iterator[str]:
    """Yield the time after which each grade has drifted by a distance [m]."""
    parts = []
    for one in grades:
        if one.phase == "s-turns":
            T = find_time(one.seconds, one.east, limit)
            parts.append(f"{one.name} {f'not in {one.seconds[-1]:g}' if T is None else f'{T:.0f}'} s")
    after = ", ".join(parts)
    yield f"By covariance the drift is {limit:g} m east (1 sigma), S-turns flown on, after: {after}."


def plot_grades(grades: Sequence[Grown]) -> Iterator[Plot]:
    """Yield the growth by grade in each phase, and each bias alone."""
    colors = series.estimator_colors(GRADES)
    for phase in get_args(Phase):
        here = [one for one in grades if one.phase == phase]
        lines = tuple(
            series.draw_line(one.name, one.seconds[1:], one.east[1:], one.name, colors[one.name])
            for one in here
        )
        title = f"by grade, {phase}: growth of the east sigma [m]"
        yield Plot(("outages", f"grades-{phase}"), title, lines, over="outage", log="xy")
    for kind in ("accel", "gyro"):
        lines = tuple(
            series.draw_line(
                one.name, one.seconds[1:], getattr(one, f"by_{kind}")[1:], one.name, colors[one.name]
            )
            for one in grades
            if one.phase == "straight"
        )
        word = "accelerometer" if kind == "accel" else "gyro"
        title = f"{word} bias of the grade alone, not calibrated [m]"
        yield Plot(("outages", f"{word}-bias-alone"), title, lines, over="outage", log="xy")
