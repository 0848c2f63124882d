"""Measurements from IMU samples at the ends of intervals, independent of the division of the record."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import ImuData
from bench.navigation.engine.kept_rows import join_rows, take_rows
from bench.navigation.engine.session import Kept, SessionState


class ImuSampler(SessionState, ABC):
    """Makes measurements from an IMU; carries the samples that the next one may need.

    Parameters
    ----------
    start : float
        From where the intervals count [s].
    interval : float
        Their length [s]. Each ends with the first sample at or behind its end.
    """

    left: Kept[ImuData]

    def __init__(self, start: float, interval: float) -> None:
        self.start, self.interval = start, interval
        nothing = np.empty(0)
        self.left = ImuData(nothing, nothing, nothing > 0, np.empty((0, 3)), np.empty((0, 3)))

    def take(self, samples: ImuData) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Take the samples in use that come next.

        Returns
        -------
        t : (M,) array
            Epochs of the measurements [s].
        values : (M, m) array
        variance : (6,) array
        """
        imu, seen = join_rows(self.left, samples), len(self.left)
        if not len(imu):
            return np.empty(0), np.empty((0, 0)), np.zeros(6)
        before = imu.t[seen - 1] if seen else imu.t[0] - imu.dt[0]
        number = np.floor((np.append(before, imu.t[seen:]) - self.start) / self.interval + 1e-6)
        last = seen + np.flatnonzero(np.diff(number) > 0)
        good, values, variance = self.measure(imu, last)
        self.left = take_rows(imu, slice(self.first_needed(imu, last), None))
        return imu.t[last[good]], values[good], variance

    @abstractmethod
    def measure(self, imu: ImuData, last: IntArray) -> tuple[BoolArray, FloatArray, FloatArray]:
        """Return a mask (W,) of the intervals to use, their values (W, m) and the variances (6,).

        They end with the samples ``last`` (W,).
        """

    @abstractmethod
    def first_needed(self, imu: ImuData, last: IntArray) -> int:
        """Return the first sample that an interval after those that end with ``last`` needs."""


def sum_segments(values: FloatArray, first: IntArray, end: IntArray) -> FloatArray:
    """Return the sums (W, m) of rows ``first`` to before ``end`` of values (N, m).

    A sum follows from its rows alone; that of a running total would follow from all before, too.
    """
    padded = np.vstack([values, np.zeros((1, values.shape[1]))])
    return np.asarray(np.add.reduceat(padded, np.column_stack([first, end]).ravel(), axis=0)[::2])
