"""Consistency of a filter with its covariance: chi-square bounds, and NIS by sensor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import Innovations

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


def mean_band(dof: float, n: float, probability: float) -> tuple[float, float]:
    """Return the central interval of the mean of n independent chi-square variables with dof each.

    Examples
    --------
    >>> np.round(mean_band(9, 50, 0.95), 2)  # chi2(450) / 50
    array([ 7.86, 10.21])
    """
    tail = 0.5 * (1.0 - probability)
    return chi2_quantile(tail, dof * n) / n, chi2_quantile(1.0 - tail, dof * n) / n


def count_independent(deviation: FloatArray) -> float:
    """Return the number of independent values that have the same information about the mean of a series.

    ``deviation`` (M,) is the distance from the mean that is expected, not from the mean of the series: an
    error that lasts the whole run counts as one value. The autocorrelation is summed over pairs of lags as
    long as their sum is positive (Geyer, Practical Markov chain Monte Carlo, Statistical Science 7, 1992).
    0 if a value is not finite.

    Examples
    --------
    >>> count_independent(np.ones(1000))
    1.0
    """
    count = len(deviation)
    largest = np.abs(deviation).max(initial=0.0)
    if not 0.0 < largest < np.inf:
        return 0.0
    unit = deviation / largest
    if unit.min() > 0.0 or unit.max() < 0.0:  # every pair counts: the square of the sum of the series
        last = unit[0] * unit[-1] if count % 2 else 0.0  # without a partner
        total = (unit.sum() ** 2 - 2.0 * last) / np.square(unit).sum()
    else:
        total = 2.0 * _sum_pairs(unit) - 1.0
    return float(np.clip(count / max(total, 1.0), 1.0, count))


def _sum_pairs(series: FloatArray) -> float:
    """Return the sum of the autocorrelation over pairs of lags, up to the first pair with a negative sum."""
    count = len(series)
    for most in (count // 4, count - 1):  # lag; most sums end in the first quarter
        length = fast_length(count + most)  # so that the end of the series does not meet its start
        spectrum = np.fft.rfft(series, length)
        lags = min(length - count + 1, count)
        correlation = np.fft.irfft(spectrum.real**2 + spectrum.imag**2, length)[:lags]
        pairs = (correlation[0 : lags - 1 : 2] + correlation[1:lags:2]) / correlation[0]
        ended = np.flatnonzero(pairs <= 0.0)
        if len(ended):
            pairs = pairs[: ended[0]]
            break
    return float(pairs.sum())


def fast_length(least: int) -> int:
    """Return an even length with a fast Fourier transform: a power of two times 1, 3 or 5."""
    return min(odd << max(-(-least // odd) - 1, 1).bit_length() for odd in (1, 3, 5))


@dataclass(frozen=True, slots=True)
class SensorNis:
    """Normalized innovation squares (NIS) of one sensor, a row per measurement vector."""

    t: FloatArray  # (K,) [s]
    nis: FloatArray  # (K,)
    dof: IntArray  # (K,) components of the measurement vector
    accepted: BoolArray  # (K,) all components were used

    def take(self, rows: BoolArray) -> SensorNis:
        """Return some of the measurement vectors."""
        return SensorNis(self.t[rows], self.nis[rows], self.dof[rows], self.accepted[rows])


def nis_by_sensor(innovations: Innovations, begin: float = -np.inf) -> dict[str, SensorNis]:
    """Return the NIS of each sensor from a time on, one value per update.

    The table of innovations repeats the NIS of a measurement vector on the rows of its components, which are
    next to each other with increasing ``component``. Rejected updates are kept: the NIS of a matched filter
    is chi-square only if its tail is not cut off.

    Parameters
    ----------
    innovations : Innovations
        Innovations of a solution.
    begin : float
        First time to include [s].

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
    counted = innovations.t[first] >= begin
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
        """Return whether the mean lies in its band; False if it is NaN."""
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
