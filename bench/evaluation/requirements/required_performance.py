"""Accuracy, integrity, continuity and availability over runs (A-2.1.5; ICAO Doc 9613, DO-236C)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import gammaincinv

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import HOUR
from bench.evaluation.ensembles.ensemble import Estimate, estimate_fraction, estimate_rate
from bench.evaluation.requirements.share_test import MET, MISSED, UNDECIDED

WITHIN, OUTSIDE_PER_HOUR = 0.95, 1e-5
"""Required: share of the flight time within RNP, and probability of an hour with more than twice RNP."""


_SURE = 0.95  # probability of each bound


@dataclass(frozen=True, slots=True)
class Watched:
    """Position errors, protection levels and alarms of R runs of M epochs, at equal intervals."""

    interval: float  # [s]
    error: FloatArray  # (R, M) size of the position error [m]; NaN: no solution
    level: FloatArray  # (R, M) protection level [m]
    alarm: BoolArray  # (R, M)
    limit: float  # alert limit [m]

    @property
    def alert(self) -> BoolArray:
        """Return a mask of the epochs with an alert for the pilot: an alarm, or a level beyond the limit."""
        return np.asarray(self.alarm | ~(self.level <= self.limit))

    @property
    def misleading(self) -> BoolArray:
        """Return a mask of the epochs with an error larger than the level and no alarm."""
        return np.asarray(~self.alarm & ~(self.error <= self.level))

    @property
    def hazardous(self) -> BoolArray:
        """Return a mask of the misleading epochs without alert and with an error beyond the alert limit."""
        return np.asarray(self.misleading & ~self.alert & ~(self.error <= self.limit))


def estimate_per_run(happened: BoolArray) -> Estimate:
    """Return the fraction of the runs with an event at any epoch (R, M)."""
    return estimate_rate(int(happened.any(axis=1).sum()), len(happened))


def count_detected(watched: Watched, within: float) -> tuple[int, int]:
    """Return the number of runs with an error beyond the limit, and of these runs with every alert in time.

    The errors of a run have one cause, so a run counts once. An alert is in time if it comes at most
    ``within`` seconds after the first epoch beyond the limit; an earlier alert counts if it lasts until then.
    """
    late = round(within / watched.interval)
    beyond, alert = ~(watched.error <= watched.limit), watched.alert
    begun = beyond & ~np.column_stack([np.zeros(len(beyond), np.bool_), beyond[:, :-1]])
    untold = {run for run, k in np.argwhere(begun).tolist() if not alert[run, k : k + late + 1].any()}
    with_error = int(beyond.any(axis=1).sum())
    return with_error, with_error - len(untold)


def count_windows(watched: Watched, window: float) -> tuple[BoolArray, BoolArray] | None:
    """Return the windows (R, W) of a duration [s] that begin without an alert, and those with a later one.

    None if no window fits into a run.
    """
    length = round(window / watched.interval)
    windows = watched.alert.shape[1] // length
    if not windows:
        return None
    parts = watched.alert[:, : windows * length].reshape(len(watched.alert), windows, length)
    begun = ~parts[:, :, 0]
    return begun, np.asarray(begun & parts.any(axis=2))


@dataclass(frozen=True, slots=True)
class JudgedFigure:
    """A value compared with its requirement: bounds of 95 % to each side, with flights as trials."""

    found: Estimate
    word: str  # MET, MISSED or UNDECIDED
    more_h: float | None = None  # flight hours that would decide if they go on alike; None: decided, or never


def judge_rate(events: int, hours: float, most: float) -> JudgedFigure:
    """Evaluate a rate per hour from the number of independent events in some flight hours (Poisson).

    It is met where the upper bound is at most ``most``, missed where the lower one is above. Undecided it
    would be met after so many more hours without another event; nothing is extrapolated.

    Examples
    --------
    >>> judge_rate(0, 3e5, 1e-5).word, round(judge_rate(0, 100.0, 1e-5).more_h)
    ('met', 299473)
    """
    high = bound_per_hour(events, hours)
    low = float(gammaincinv(float(events), 1.0 - _SURE)) / hours if events else 0.0
    found = Estimate(events / hours, low, high)
    if high <= most:
        return JudgedFigure(found, MET)
    if low > most:
        return JudgedFigure(found, MISSED)
    return JudgedFigure(found, UNDECIDED, bound_per_hour(events, most) - hours)


def judge_share(inside: BoolArray, least: float, hours: float) -> JudgedFigure:
    """Evaluate the fraction of the time in which a condition (R, M) holds, each of R flights a trial.

    If it always holds, ``ln 0.05 / ln least`` flights are needed: a single bad flight might be as rare.
    """
    found = estimate_fraction(inside, 2.0 * _SURE - 1.0)
    if found.low >= least:
        return JudgedFigure(found, MET)
    if found.high < least:
        return JudgedFigure(found, MISSED)
    flights = len(inside)
    if found.value in (0.0, 1.0):
        needed = math.log(1.0 - _SURE) / math.log(least)
    elif found.value == least:
        return JudgedFigure(found, UNDECIDED)
    else:
        end = found.low if found.value > least else found.high
        needed = flights * ((end - found.value) / (least - found.value)) ** 2
    return JudgedFigure(found, UNDECIDED, max(needed - flights, 1.0) * hours / flights)


def bound_per_hour(events: int, hours: float) -> float:
    """Return the upper 95 % bound of a rate per hour from a number of events in some hours.

    Examples
    --------
    >>> round(bound_per_hour(0, 3e5) * 1e5, 2)  # 300,000 hours without an event show 1e-5 per hour
    1.0
    """
    return float(gammaincinv(events + 1.0, _SURE)) / hours


def hours_flown(shape: tuple[int, ...], interval: float) -> float:
    """Return the duration [h] of R runs of M epochs ``(R, M)`` at an interval [s]."""
    return math.prod(shape) * interval / HOUR
