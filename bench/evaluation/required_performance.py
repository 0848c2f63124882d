"""Accuracy, integrity, continuity and availability over runs (A-2.1.5; ICAO Doc 9613, DO-236C)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.evaluation.ensemble import Estimate, estimate_fraction, estimate_rate
from bench.units import HOUR

WITHIN, OUTSIDE_PER_HOUR = 0.95, 1e-5
"""Required: share of the flight time within RNP, and probability of an hour with more than twice RNP."""


@dataclass(frozen=True, slots=True)
class Watched:
    """What R runs of M instants, at equal intervals, did and stated."""

    interval: float  # [s]
    error: FloatArray  # (R, M) size of the position error [m]; NaN: no solution
    level: FloatArray  # (R, M) protection level [m]
    alarm: BoolArray  # (R, M)
    limit: float  # alert limit [m]

    @property
    def alert(self) -> BoolArray:
        """Where the pilot is told not to rely on the position: an alarm, or a level beyond the limit."""
        return np.asarray(self.alarm | ~(self.level <= self.limit))

    @property
    def misleading(self) -> BoolArray:
        """Where the error is larger than the level and no alarm tells."""
        return np.asarray(~self.alarm & ~(self.error <= self.level))

    @property
    def hazardous(self) -> BoolArray:
        """Where it is, and beyond the alert limit that the level is within."""
        return np.asarray(self.misleading & ~self.alert & ~(self.error <= self.limit))


def estimate_availability(watched: Watched) -> Estimate:
    """Return the share of the time without an alert."""
    return estimate_fraction(~watched.alert)


def estimate_per_run(happened: BoolArray) -> Estimate:
    """Return in which share of the runs something happened at any of their instants (R, M)."""
    return estimate_rate(int(happened.any(axis=1).sum()), len(happened))


def count_detected(watched: Watched, within: float) -> tuple[int, int]:
    """Return how many times the error went beyond the limit, and how often an alert told in time.

    In time is within so many seconds of the first instant beyond it; an alert before that counts as long as
    it lasts until then.
    """
    late = round(within / watched.interval)
    beyond, alert = ~(watched.error <= watched.limit), watched.alert
    begun = beyond & ~np.column_stack([np.zeros(len(beyond), np.bool_), beyond[:, :-1]])
    rows = np.argwhere(begun)
    told = sum(bool(alert[run, k : k + late + 1].any()) for run, k in rows.tolist())
    return len(rows), told


def estimate_discontinuity(watched: Watched, window: float) -> Estimate | None:
    """Return how often a window of a duration [s] that begins without an alert has one; None: no window."""
    length = round(window / watched.interval)
    windows = watched.alert.shape[1] // length
    if not windows:
        return None
    parts = watched.alert[:, : windows * length].reshape(len(watched.alert), windows, length)
    begun = ~parts[:, :, 0]
    share = float(begun.mean())
    if share == 0.0:
        return None
    lost = estimate_fraction(begun & parts.any(axis=2))
    return Estimate(lost.value / share, lost.low / share, min(lost.high / share, 1.0))


def bound_per_hour(events: int, hours: float, confidence: float = 0.95) -> float:
    """Return the largest rate per hour at which so few events in so many hours are not rarer than chance.

    Examples
    --------
    >>> round(bound_per_hour(0, 3e5) * 1e5, 2)  # 300,000 hours without an event show 1e-5 per hour
    1.0
    """
    from scipy.special import gammaincinv

    return float(gammaincinv(events + 1.0, confidence)) / hours


def hours_flown(error: FloatArray, interval: float) -> float:
    """Return how many hours the values (R, M) that are known stand for."""
    return float(np.isfinite(error).sum()) * interval / HOUR


def describe_estimate(found: Estimate | None) -> dict[str, Any]:
    """Return value and limits of an estimate as the columns of a table."""
    if found is None:
        return {"value": None, "low": None, "high": None}
    return {"value": found.value, "low": found.low, "high": found.high}
