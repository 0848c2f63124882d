"""Protection levels: a bound of the position error that a navigator states for each instant.

Horizontal errors are bounded in the plane, by the major axis of their covariance: the length of a Gaussian
vector exceeds k times the largest standard deviation with a probability of at most exp(-k^2 / 2).

Without a fault (DO-229, the constants of satellite-based augmentation):

    HPL = 6.18 sigma_major      VPL = 5.33 sigma_down

With at most one faulty satellite, by one subfilter for each satellite that is left out (Brenner, Integrated
GPS/Inertial Fault Detection Availability, Navigation 43 (2), 1996; Blanch and others, Baseline Advanced RAIM
User Algorithm, Transactions on Aerospace and Electronic Systems 51 (1), 2015). The subfilter without the
faulty one is sound; a larger separation from it than the threshold T raises an alarm:

    T_s = k_fa sd(x_s - x_0),  cov(x_s - x_0) = C_s - C_0      PL = max(PL_0, max_s(T_s + k_md sd(x_s)))

A filter that takes range errors for white believes that it averages them. Those of orbit, satellite clock
and ionosphere last for an hour. So they are carried beside its covariance P, as errors that stay: S_s is how
far a metre on the ranges of satellite s moves the position, measured by a pass of the filter for each, and
h_s the leverage of that satellite in a fix. Its residual from all others has the variance sd_s^2 / (1 - h_s).

    C_0 = P_0 + sum_s S_s S_s^T sd_s^2      C_s - C_0 = P_s - P_0 + S_s S_s^T sd_s^2 / (1 - h_s)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench import earth
from bench.arrays import BoolArray, FloatArray
from bench.data import GnssObservations, NavSolution
from bench.units import SAME_INSTANT

HORIZONTAL, VERTICAL = 6.18, 5.33
"""Constants of DO-229: a risk of 5e-9 in the plane and of 1e-7 along a line, two-sided."""

FALSE_ALARM = 3.33e-7
"""Probability of an alarm without a fault, of one instant, over all subfilters."""

MISSED = 1e-3
"""Probability that the error exceeds the level while a satellite is faulty and no alarm is raised."""


@dataclass(frozen=True, slots=True)
class Protection:
    """Protection levels of a solution."""

    level: FloatArray  # (M, 2) horizontal, vertical [m]; infinite where none can be stated
    alarm: BoolArray  # (M,) a separation is larger than its threshold


def protect_fault_free(solution: NavSolution) -> Protection:
    """Return the levels that hold while nothing is faulty, by the covariance of the solution."""
    return _protect(solution.cov[:, :3, :3])


def _protect(cov: FloatArray) -> Protection:
    sd = deviations(cov)
    level = np.where(np.isfinite(sd), sd * (HORIZONTAL, VERTICAL), np.inf)
    return Protection(level, np.zeros(len(level), np.bool_))


@dataclass(frozen=True, slots=True)
class Influence:
    """What each of S satellites has to do with a solution of M rows."""

    response: FloatArray  # (M, S, 3) of the position to an error that stays on its ranges [1], n
    sd: FloatArray  # (S,) of its ranges [m]
    leverage: FloatArray  # (M, S) in a fix, 0 to 1

    def spread(self) -> FloatArray:
        """Return the covariance (M, S, 3, 3) that each gives the position [m^2], n."""
        scaled = self.response * self.sd[:, None]
        return np.asarray(scaled[..., :, None] * scaled[..., None, :])


def protect_by_separation(
    full: NavSolution,
    without: Sequence[NavSolution],
    influence: Influence,
    false_alarm: float = FALSE_ALARM,
    missed: float = MISSED,
) -> Protection:
    """Return the levels that hold while at most one satellite is faulty.

    Parameters
    ----------
    full : NavSolution
        With all satellites; M rows.
    without : sequence of NavSolution
        The S subfilters, at the same instants; one that has no solution leaves no level to state.
    influence : Influence
        Of the satellites, in the order of the subfilters.
    false_alarm, missed : float
        Probabilities, see `FALSE_ALARM` and `MISSED`.
    """
    spread = influence.spread()
    whole = full.cov[:, :3, :3] + spread.sum(axis=1)
    found = _protect(whole)
    level, alarm = found.level.copy(), found.alarm.copy()
    k_fa, k_md = multipliers(false_alarm / max(len(without), 1)), multipliers(missed)
    for s, one in enumerate(without):
        apart = earth.difference_n(one.lla, full.lla)
        size = np.column_stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])])
        left = np.maximum(1.0 - influence.leverage[:, s], _LEAST)[:, None, None]
        separation = one.cov[:, :3, :3] - full.cov[:, :3, :3] + spread[:, s] / left
        threshold = k_fa * deviations(separation)
        bound = threshold + k_md * deviations(whole + separation)
        alarm |= (size > threshold + _SAME).any(axis=1)
        level = np.maximum(level, np.where(np.isfinite(bound), bound, np.inf))
    return Protection(level, alarm)


def list_satellites(o: GnssObservations) -> list[tuple[int, int]]:
    """Return system and number of the satellites that are in view at any time."""
    return [(a, b) for a, b in np.unique(np.column_stack([o.system, o.sat]), axis=0).tolist()]


def measure_leverage(o: GnssObservations, full: NavSolution, mask: float) -> FloatArray:
    """Return the leverage (M, S) of the satellites in a fix by those above an elevation [rad].

    That of the last epoch in which the satellite was used; 0 before. The clock of each system is unknown.
    """
    numbers = {one: s for s, one in enumerate(list_satellites(o))}
    t = o.t[o.epoch_start[:-1]]
    near = np.clip(np.searchsorted(full.t, t), 0, len(full.t) - 1)
    found = np.zeros((len(t) + 1, len(numbers)))
    systems = np.unique(o.system)
    for k in range(len(t)):
        found[k + 1] = found[k]
        lla = full.lla[near[k]]
        if np.isnan(lla).any():
            continue
        rows = slice(o.epoch_start[k], o.epoch_start[k + 1])
        sight = (o.sat_pos_e[rows] - earth.to_ecef(lla)) @ earth.matrix_en(lla[0], lla[1])
        sight /= np.linalg.norm(sight, axis=1)[:, None]
        used = np.isfinite(o.pseudorange[rows, 0]) & (-sight[:, 2] > np.sin(mask))
        G = np.hstack([-sight, o.system[rows, None] == systems]) / o.sd_pseudorange[rows, None]
        Q, R = np.linalg.qr(G[used][:, (G[used] != 0.0).any(axis=0)])
        sound = R.shape[0] == R.shape[1] and np.abs(np.diag(R)).min(initial=1.0) > _SINGULAR
        pairs = zip(o.system[rows][used].tolist(), o.sat[rows][used].tolist(), strict=True)
        found[k + 1, [numbers[one] for one in pairs]] = np.square(Q).sum(axis=1) if sound else 1.0
    return found[np.searchsorted(t, full.t + SAME_INSTANT)]


_LEAST = 1e-6  # of what a satellite with all leverage leaves
_SINGULAR = 1e-9  # [1/m]
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
