"""How much of what was asked for a solution answers, from its first answer on."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.data import NavSolution, SensorData
from bench.evaluation.error_series import find_answered_epochs
from bench.units import SAME_INSTANT

ENOUGH = 0.99
"""Share of the instants that a solution has to answer [1]."""

_LATE = 1.0  # a first answer later than this after the first instant is mentioned [s]
_GAP = 1.5  # so many times its usual interval a sensor was silent [1]


@dataclass(frozen=True, slots=True)
class Coverage:
    """The share of the instants that a solution answers, of those that its data allow."""

    share: float  # from the first answer on [1]
    first: float | None  # its first answer [s], if that came late
    longest: tuple[float, float]  # first and last instant of the longest run without an answer [s]

    @property
    def enough(self) -> bool:
        """Whether it answers all but a few."""
        return self.share >= ENOUGH

    @property
    def text(self) -> str:
        """The share in words, rounded down."""
        begin, end = self.longest
        return (
            f"answers {math.floor(1e3 * self.share) / 10:g} % of the instants asked for"
            f"{' from its first answer on' if self.first is not None else ''}, with the longest silence "
            f"from {begin:g} to {end:g} s"
        )


def measure_coverage(solution: NavSolution, data: SensorData | None) -> Coverage:
    """Return how much of the instants asked for a solution answers.

    An instant at which all of it is NaN, or that a table does not cover, has no answer. Those do not count
    that the ``data`` excuse: while the IMU was silent, and of a solution without attitude, which is made of
    fixes, while these were.
    """
    t, answered = solution.t, find_answered_epochs(solution)
    if not answered.any():
        return Coverage(1.0, None, (0.0, 0.0))  # that is another verdict
    first = int(np.argmax(answered))
    counted = np.arange(len(t)) >= first
    if data is not None:
        counted &= answered | ~_is_silent(t, data.imu.t[data.imu.valid])
        if np.isnan(solution.q_nb).all():
            record = data.fixes if data.fixes is not None else data.observations
            if record is not None:
                counted &= answered | ~_is_silent(t, record.t)
    lost = np.flatnonzero(counted & ~answered)
    share = float(answered[counted].mean())
    begun = float(t[first]) if t[first] > t[0] + _LATE else None
    if not len(lost):
        return Coverage(share, begun, (0.0, 0.0))
    runs = np.split(lost, np.flatnonzero(np.diff(lost) > 1) + 1)
    longest = max(runs, key=lambda run: float(t[run[-1]] - t[run[0]]))
    return Coverage(share, begun, (float(t[longest[0]]), float(t[longest[-1]])))


def _is_silent(t: FloatArray, reports: FloatArray) -> BoolArray:
    """Return a mask of the instants t (M,) at which a sensor that reported at other instants was silent."""
    known = np.unique(reports[np.isfinite(reports)])
    if len(known) < 2:
        return np.ones(len(t), np.bool_)
    most = _GAP * float(np.median(np.diff(known)))
    after = np.searchsorted(known, t - SAME_INSTANT)
    ends = np.concatenate([[-np.inf], known, [np.inf]])
    silent: BoolArray = ends[after + 1] - ends[after] > most
    return silent
