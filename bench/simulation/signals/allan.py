"""Overlapping Allan deviation, its analytic curves, and the confidence of an estimate.

Each process has one function here, its generalized covariance ``k(h)``: the part of the covariance of the
angle ``x`` (integral of the rate) at lag ``h`` that remains in second differences. It gives the Allan
variance, ``sum c_a c_b k((a - b) tau) / (2 tau^2)``, ``c = (1, -2, 1)``, and the covariance of any two second
differences, from which the effective degrees of freedom of an estimate follow.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray, IntArray

Covariance = Callable[[FloatArray], FloatArray]
"""Generalized covariance of an angle: lag h >= 0 [s] -> k [unit^2]."""

_WEIGHTS = ((0, 6.0), (1, -8.0), (2, 2.0))  # c_a c_b summed by |a - b|


def white(random_walk: float) -> Covariance:
    """Return the covariance of an angle or velocity random walk N [unit/sqrt(s)]: white noise of the rate."""
    return lambda h: -0.5 * random_walk**2 * h


def markov(sd: float, correlation: float, step: float = 0.0) -> Covariance:
    """Return the covariance of a first-order Gauss-Markov rate with sd [unit/s] and correlation time [s].

    With a ``step`` [s], well below the correlation time, the rate is linear between epochs one step apart,
    as in `rate_walk`.
    """
    walk = np.sqrt(2 / correlation) * sd  # equivalent rate random walk at short times

    def covariance(h: FloatArray) -> FloatArray:
        x = h / correlation  # without h^2, which vanishes in second differences, for precision
        series = -(x**3) / 6 * (1 - x / 4 * (1 - x / 5 * (1 - x / 6 * (1 - x / 7))))
        shape = np.where(x < 0.05, series, x + np.expm1(-x) - x**2 / 2)
        return -((sd * correlation) ** 2) * shape + _interpolation_term(walk, step, h)

    return covariance


def rate_walk(rate_random_walk: float, step: float = 0.0) -> Covariance:
    """Return the covariance of a rate random walk K [unit/s/sqrt(s)].

    With a ``step`` [s] the rate is linear between epochs one step apart, which lowers its Allan variance
    K^2 tau / 3 by K^2 step^2 / (12 tau) for tau not below the step.
    """
    return lambda h: rate_random_walk**2 * h**3 / 12 + _interpolation_term(rate_random_walk, step, h)


def _interpolation_term(rate_random_walk: float, step: float, h: FloatArray) -> FloatArray:
    """Return the change of the covariance of a rate random walk by linear interpolation between epochs.

    Interpolation smooths the covariance of the rate, ``-K^2 |h| / 2`` up to a constant, with a cubic
    B-spline. The difference, ``-K^2 step (1 - u)^3 / 6`` with u = |h| / step < 1, is integrated twice.
    """
    if step <= 0:
        return np.zeros_like(h)
    u = h / step
    return 0.5 * rate_random_walk**2 * step**3 * (np.maximum(1 - u, 0.0) ** 5 / 60 + u / 12)


def quantization(lsb: float) -> Covariance:
    """Return the covariance of rounding the angle to a resolution [unit], uniform and independent."""
    return lambda h: np.where(h == 0, lsb**2 / 12, 0.0)


def add_processes(*terms: Covariance) -> Covariance:
    """Return the covariance of a sum of independent processes."""
    return lambda h: np.sum([term(h) for term in terms], axis=0) if terms else np.zeros_like(h)


def expected_deviation(term: Covariance, tau: ArrayLike) -> FloatArray:
    """Return the analytic Allan deviation at averaging times tau [s].

    Examples
    --------
    >>> print(expected_deviation(white(2.0), [1.0, 4.0]), expected_deviation(rate_walk(1.0), [3.0]))
    [2. 1.] [1.]
    """
    h = np.asarray(tau, float)
    variance = sum(weight * term(lag * h) for lag, weight in _WEIGHTS) / (2 * h**2)
    adev: FloatArray = np.sqrt(np.maximum(variance, 0.0))
    return adev


def measure_deviation(increments: FloatArray, interval: float, spans: Sequence[int] | IntArray) -> FloatArray:
    """Compute the overlapping Allan deviation of a record.

    Parameters
    ----------
    increments : (N,) or (N, k) array
        Integral of the rate over each sample [unit].
    interval : float
        Length of a sample [s].
    spans : sequence of int
        Numbers of samples to average, each at most N / 2.

    Returns
    -------
    adev : (len(spans),) or (len(spans), k) array
        Allan deviation of the rate [unit/s], as in IEEE Std 952-1997, annex C, fully overlapping.

    Raises
    ------
    ValueError
        If a span is below 1 or above N / 2.

    Examples
    --------
    >>> print(measure_deviation(np.array([0.0, 1.0, 0.0, 1.0]), 1.0, [1]).round(3))
    [0.707]
    """
    columns = increments.reshape(len(increments), -1)
    # the mean has no second difference; removing it reduces rounding errors
    columns = columns - columns.mean(axis=0)
    x = np.vstack([np.zeros((1, columns.shape[1])), np.cumsum(columns, axis=0)])
    variance = []
    for m in spans:
        if not 1 <= 2 * m <= len(x) - 1:
            raise ValueError(f"spans must be 1 to {(len(x) - 1) // 2} for {len(x) - 1} samples; got {m}")
        second = x[2 * m :] - 2 * x[m:-m] + x[: -2 * m]
        variance.append(np.mean(second**2, axis=0) / (2 * (m * interval) ** 2))
    adev: FloatArray = np.sqrt(np.array(variance)).reshape(len(variance), *increments.shape[1:])
    return adev


def make_octaves(samples: int, fewest: int = 8) -> IntArray:
    """Return the spans 1, 2, 4, ... with at least ``fewest`` independent averages in the record.

    Examples
    --------
    >>> make_octaves(100)
    array([1, 2, 4, 8])
    """
    return 2 ** np.arange(max(1, int(np.log2(max(samples // fewest, 1))) + 1))


def degrees_of_freedom(term: Covariance, samples: int, interval: float, span: int) -> float:
    """Return the effective degrees of freedom of an overlapping Allan variance.

    Parameters
    ----------
    term : Covariance
        Covariance of the measured Gaussian process.
    samples : int
        Number of samples in the record.
    interval : float
        Length of a sample [s].
    span : int
        Number of samples averaged.

    Returns
    -------
    edf : float
        Degrees of freedom of the chi-square variable with the mean and variance of the estimate.

    Notes
    -----
    With ``R(l)`` the covariance of second differences ``l`` samples apart and ``M`` of them, the variance of
    their mean square is ``2 / M sum (1 - |l| / M) R(l)^2`` (Isserlis), l of both signs, so that ``edf = M
    R(0)^2 / sum (1 - |l| / M) R(l)^2``. White noise: the closed form of NIST SP 1065 (2008), table 5.

    Examples
    --------
    >>> print(f"{degrees_of_freedom(white(1.0), 4096, 1.0, 1):.0f}")
    2730
    """
    M = samples + 1 - 2 * span
    near = np.arange(min(M, 4 * span + 2))  # every kink of R lies within two spans
    far = np.unique(np.geomspace(near[-1], max(M, near[-1]), 200).astype(np.int64))  # R is smooth beyond
    tau = span * interval

    def weigh_lags(lags: IntArray) -> FloatArray:
        h = lags * interval
        parts = [w * 0.5 * (term(np.abs(h + a * tau)) + term(np.abs(h - a * tau))) for a, w in _WEIGHTS]
        R = np.sum(parts, axis=0)
        R[np.abs(R) < 1e-14 * np.abs(parts).sum(axis=0)] = 0.0  # rounding errors only
        weighted: FloatArray = (1 - lags / M) * R**2
        return weighted

    first = weigh_lags(near)
    tail = np.trapezoid(weigh_lags(far), far) - 0.5 * first[-1] if len(far) > 1 else 0.0
    return float(M * first[0] / (2 * (first.sum() + tail) - first[0]))


def gauss_markov_deviation(tau: ArrayLike, sd: float, correlation: ArrayLike) -> FloatArray:
    """Return the Allan deviation of a stationary first-order Gauss-Markov rate.

    Parameters
    ----------
    tau : float or array
        Averaging time [s].
    sd : float
        Standard deviation of the process [unit/s].
    correlation : float or array
        Correlation time, broadcast against ``tau`` [s].

    Returns
    -------
    adev : array
        Allan deviation of the process [unit/s]; its peak is 0.617 sd at 1.89 correlation times.

    Notes
    -----
    With ``x = tau / correlation`` the Allan variance is half the variance of the difference of two
    adjacent averages of a process with autocovariance ``sd^2 exp(-|lag| / correlation)``:
    ``2 sd^2 / x (1 - (3 - 4 exp(-x) + exp(-2 x)) / (2 x))``, as in IEEE Std 952-1997, annex C.

    Examples
    --------
    >>> print(f"{gauss_markov_deviation(1.89, sd=1.0, correlation=1.0):.3f}")
    0.617
    """
    x = np.asarray(tau, float) / np.asarray(correlation, float)
    variance = 2 * sd**2 / x * (1 - (3 - 4 * np.exp(-x) + np.exp(-2 * x)) / (2 * x))
    adev: FloatArray = np.sqrt(variance)
    return adev


@lru_cache(maxsize=2)
def fit_flat_deviation(stages: tuple[float, ...], first: float, last: float, count: int) -> FloatArray:
    """Fit the sds of Gauss-Markov stages so that the Allan deviation of their sum is 1 (least squares).

    Parameters
    ----------
    stages : tuple of float
        Correlation times [s].
    first, last, count
        Averaging times of the fit: from first to last [s], at equal ratios.
    """
    tau = np.geomspace(first, last, count)
    curves = np.column_stack([gauss_markov_deviation(tau, 1.0, c) ** 2 for c in stages])
    sd: FloatArray = np.sqrt(np.linalg.lstsq(curves, np.ones(count), rcond=None)[0])
    return sd
