"""Consistency of a filter with its covariance: chi-square bounds, NIS by sensor, verdict over many runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray, as_float
from bench.data import Innovations

STANDARD_ERRORS = 3.3
"""Allowed distance of the mean NEES from its expectation, in standard errors of the run averages [1]."""

LARGEST_OFFSET = 0.6
"""Allowed distance of the mean NEES from its expectation, whatever the standard error [1]."""

LEAST_INSIDE = 0.8
"""Fraction of epochs that must have their NEES, averaged over the runs, in its 95 % band [1]."""

NIS_PROBABILITY = 0.999
"""Probability of the band of a mean NIS [1]."""


def chi2_quantile(probability: float, dof: float) -> float:
    """Return the quantile of the chi-square distribution with dof degrees of freedom.

    Examples
    --------
    >>> round(chi2_quantile(0.999, 3), 2)  # the gate of A-5.4.7 with a false-alarm probability of 0.001
    16.27
    """
    from scipy.special import gammaincinv

    return float(2.0 * gammaincinv(0.5 * dof, probability))


def mean_band(dof: float, n: int, probability: float) -> tuple[float, float]:
    """Return the central interval of the mean of n independent chi-square variables with dof each.

    Examples
    --------
    >>> np.round(mean_band(9, 50, 0.95), 2)  # chi2(450) / 50
    array([ 7.86, 10.21])
    """
    tail = 0.5 * (1.0 - probability)
    return chi2_quantile(tail, dof * n) / n, chi2_quantile(1.0 - tail, dof * n) / n


@dataclass(frozen=True, slots=True)
class SensorNis:
    """Normalized innovation squares (NIS) of one sensor, a row per measurement vector."""

    t: FloatArray  # (K,) [s]
    nis: FloatArray  # (K,)
    dof: IntArray  # (K,) components of the measurement vector
    accepted: BoolArray  # (K,) all components were used


def nis_by_sensor(innovations: Innovations, from_s: float = -np.inf) -> dict[str, SensorNis]:
    """Return the NIS of each sensor from an instant on, one value per update.

    The table of innovations repeats the NIS of a measurement vector on the rows of its components, which are
    next to each other with increasing ``component``. Rejected updates are kept: the NIS of a matched filter
    is chi-square only if its tail is not cut off.

    Parameters
    ----------
    innovations : Innovations
        Innovations of a solution.
    from_s : float
        First instant to include [s].

    Returns
    -------
    nis : dict of SensorNis
        By name of the sensor, for the sensors that have rows.
    """
    if len(innovations) == 0:
        return {}
    same = (
        (np.diff(innovations.code) == 0)
        & (np.diff(innovations.t) == 0)  # the rows of one update carry the same time
        & (np.diff(innovations.component) > 0)
    )
    first = np.concatenate([[0], np.flatnonzero(~same) + 1])
    dof = np.diff(np.append(first, len(innovations)))
    accepted = np.logical_and.reduceat(innovations.accepted, first)
    counted = innovations.t[first] >= from_s
    found = {}
    for code, name in enumerate(innovations.sensor):
        rows = (innovations.code[first] == code) & counted
        if rows.any():
            found[name] = SensorNis(
                innovations.t[first][rows], innovations.nis[first][rows], dof[rows], accepted[rows]
            )
    return found


@dataclass(frozen=True, slots=True)
class MeanNis:
    """Mean NIS of one sensor over all updates of all runs, with the band of that mean."""

    mean: float
    low: float
    high: float
    updates: int

    @property
    def inside(self) -> bool:
        """Whether the mean lies in its band; False if it is NaN."""
        return self.low <= self.mean <= self.high


def mean_nis(nis: FloatArray, dof: IntArray, probability: float = NIS_PROBABILITY) -> MeanNis:
    """Return the mean of K NIS values and the interval of that mean for a matched filter.

    Innovations of a matched filter are independent in time, so the sum of their NIS is chi-square with the
    sum of the degrees of freedom. False-alarm rate: 1 - probability.

    Raises
    ------
    ValueError
        If there are no values.
    """
    if len(nis) == 0:
        raise ValueError("mean_nis: nis must hold at least one update; got none")
    low, high = mean_band(float(dof.sum()) / len(nis), len(nis), probability)
    return MeanNis(float(np.mean(nis)), low, high, len(nis))


@dataclass(frozen=True, slots=True)
class Consistency:
    """Consistency of an ensemble of runs: the statistics, and the reasons against it."""

    states: int
    runs: int
    epochs: int
    mean: float  # of the run averages of NEES
    standard_error: float  # spread of the run averages / sqrt(runs)
    inside: float  # fraction of epochs whose mean NEES over the runs lies in [low, high]
    low: float  # 95 % band of the mean of one epoch over the runs
    high: float
    nis: Mapping[str, MeanNis]  # by sensor
    reasons: tuple[str, ...]  # why it is not consistent; empty if it is

    @property
    def verdict(self) -> bool:
        """Whether the filter is consistent: there is no reason against it."""
        return not self.reasons


def check_consistency(nees: FloatArray, states: int, nis: Mapping[str, Sequence[SensorNis]]) -> Consistency:
    """Check whether the covariance of a filter describes its errors, from many runs.

    Parameters
    ----------
    nees : (R, M) array
        NEES of R runs with independent noise, at M common instants after the alignment window.
    states : int
        Number of states in NEES: its expected value.
    nis : mapping of sequences of SensorNis
        By sensor, one entry per run (:func:`nis_by_sensor`).

    Returns
    -------
    result : Consistency
        Statistics and a reason for each condition that is not met:

        (a) the mean of the R time averages differs from ``states`` by less than
        :data:`STANDARD_ERRORS` standard errors and by less than :data:`LARGEST_OFFSET`. The errors
        of one run are correlated in time, so each run is one sample. False-alarm rate 0.2 % for
        50 runs (Student's t with 49 degrees of freedom).
        (b) at least :data:`LEAST_INSIDE` of the epochs have their mean over the runs in the 95 % band
        ``chi2(states R) / R``.
        (c) the mean NIS of every sensor lies in its :data:`NIS_PROBABILITY` band. False-alarm rate
        0.1 % per sensor.

    Raises
    ------
    ValueError
        If there are fewer than two runs, no epochs, or no updates of a sensor.
    """
    nees = as_float("nees", nees, (None, None), finite=False)
    runs, epochs = nees.shape
    if runs < 2 or epochs < 1:
        raise ValueError(f"nees must hold at least 2 runs and 1 epoch; got {runs} and {epochs}")
    averages = nees.mean(axis=1)
    mean = float(averages.mean())
    standard_error = float(averages.std(ddof=1) / np.sqrt(runs))
    low, high = mean_band(states, runs, 0.95)
    over_runs = nees.mean(axis=0)
    inside = float(np.mean((low <= over_runs) & (over_runs <= high)))
    sensors = {
        name: mean_nis(np.concatenate([s.nis for s in series]), np.concatenate([s.dof for s in series]))
        for name, series in nis.items()
    }
    offset = abs(mean - states)
    distance = offset / standard_error if standard_error > 0 else float("inf")
    reasons = []
    if not offset < STANDARD_ERRORS * standard_error:
        reasons.append(
            f"mean NEES {mean:.3f} is {distance:.1f} standard errors ({standard_error:.3f}) "
            f"from {states}; allowed {STANDARD_ERRORS}"
        )
    if not offset < LARGEST_OFFSET:
        reasons.append(f"mean NEES {mean:.3f} is {offset:.3f} from {states}; allowed {LARGEST_OFFSET}")
    if not inside >= LEAST_INSIDE:
        reasons.append(
            f"{inside:.1%} of the epochs have their NEES over {runs} runs in {low:.2f} to {high:.2f}; "
            f"at least {LEAST_INSIDE:.0%} wanted"
        )
    reasons += [
        f"mean NIS of {name} is {s.mean:.4f} over {s.updates} updates; its {NIS_PROBABILITY:.1%} band is "
        f"{s.low:.4f} to {s.high:.4f}"
        for name, s in sensors.items()
        if not s.inside
    ]
    return Consistency(states, runs, epochs, mean, standard_error, inside, low, high, sensors, tuple(reasons))
