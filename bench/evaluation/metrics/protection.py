"""Protection levels: a bound of the position error that a navigator states for each time.

Horizontal errors are bounded in the plane, by the major axis of their covariance: the length of a Gaussian
vector exceeds k times the largest standard deviation with a probability of at most exp(-k^2 / 2).

Without a fault (DO-229, the constants of satellite-based augmentation):

    HPL = 6.18 sigma_major      VPL = 5.33 sigma_down

With at most one faulty satellite, by one subfilter for each satellite that is left out (Brenner, Integrated
GPS/Inertial Fault Detection Availability, Navigation 43 (2), 1996; Blanch and others, Baseline Advanced RAIM
User Algorithm, Transactions on Aerospace and Electronic Systems 51 (1), 2015). The subfilter without the
faulty one is sound; a larger separation from it than the threshold T raises an alarm:

    T_s = k_fa sd(x_s - x_0),  cov(x_s - x_0) = P_s - P_0      PL = max(PL_0, max_s(T_s + k_md sd(x_s)))

The covariances are those that the filter states: one that takes errors of orbit, satellite clock and
ionosphere for white, though they last for an hour, states levels that do not hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import GnssObservations, NavSolution

HORIZONTAL, VERTICAL = 6.18, 5.33
"""Constants of DO-229: a risk of 5e-9 in the plane and of 1e-7 along a line, two-sided."""

FALSE_ALARM = 3.33e-7
"""Probability of an alarm without a fault, of one time, over all subfilters."""

MISSED = 1e-3
"""Probability that the error exceeds the level while a satellite is faulty and no alarm is raised."""


@dataclass(frozen=True, slots=True)
class Protection:
    """Protection levels of a solution."""

    level: FloatArray  # (M, 2) horizontal, vertical [m]; infinite where none can be stated
    alarm: BoolArray  # (M,) a separation is larger than its threshold


def protect_fault_free(solution: NavSolution) -> Protection:
    """Return the protection levels for fault-free measurements, by the covariance of the solution."""
    sd = deviations(solution.cov[:, :3, :3])
    level = np.where(np.isfinite(sd), sd * (HORIZONTAL, VERTICAL), np.inf)
    return Protection(level, np.zeros(len(level), np.bool_))


def protect_by_separation(
    full: NavSolution,
    without: Sequence[NavSolution],
    false_alarm: float = FALSE_ALARM,
    missed: float = MISSED,
) -> Protection:
    """Return the protection levels for at most one faulty satellite.

    Parameters
    ----------
    full : NavSolution
        With all satellites; M rows.
    without : sequence of NavSolution
        The S subfilters, at the same epochs; one that has no solution leaves no level to state.
    false_alarm, missed : float
        Probabilities, see `FALSE_ALARM` and `MISSED`.
    """
    found = protect_fault_free(full)
    level, alarm = found.level.copy(), found.alarm.copy()
    k_fa, k_md = multipliers(false_alarm / max(len(without), 1)), multipliers(missed)
    for one in without:
        apart = earth.difference_n(one.lla, full.lla)
        size = np.column_stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])])
        threshold = k_fa * deviations(one.cov[:, :3, :3] - full.cov[:, :3, :3])
        bound = threshold + k_md * deviations(one.cov[:, :3, :3])
        alarm |= (size > threshold + _SAME).any(axis=1)
        level = np.maximum(level, np.where(np.isfinite(bound), bound, np.inf))
    return Protection(level, alarm)


def list_satellites(o: GnssObservations) -> list[tuple[int, int]]:
    """Return system and number of the satellites that are in view at any time."""
    return [(a, b) for a, b in np.unique(np.column_stack([o.system, o.sat]), axis=0).tolist()]


_SAME = 1e-3  # solutions so close are the same: a satellite that was not in view [m]


def deviations(cov: FloatArray) -> FloatArray:
    """Return the largest horizontal and the vertical standard deviation (M, 2) of covariances (M, 3, 3)."""
    mean = 0.5 * (cov[:, 0, 0] + cov[:, 1, 1])
    major = mean + np.hypot(0.5 * (cov[:, 0, 0] - cov[:, 1, 1]), cov[:, 0, 1])
    return np.sqrt(np.maximum(np.column_stack([major, cov[:, 2, 2]]), 0.0))


def multipliers(probability: float) -> FloatArray:
    """Return how many deviations a horizontal and a vertical error exceed with a probability.

    Examples
    --------
    >>> multipliers(5e-9)[0].round(2), multipliers(1e-7)[1].round(2)  # DO-229: 6.18 and 5.33
    (np.float64(6.18), np.float64(5.33))
    """
    from scipy.special import ndtri

    return np.array([np.sqrt(-2.0 * np.log(probability)), -ndtri(0.5 * probability)])
