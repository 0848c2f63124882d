"""The cosine transform of a record at rest, and the likelihood of variances of random errors in it.

The coefficients of the transform (DCT-II) of a random walk, of white noise and of rounding errors are
uncorrelated, and nearly so are those of a Gauss-Markov process. Each is Gaussian; its variance is the sum of
the variances of the processes (`make_shapes`). A constant bias is only in the coefficient 0, left out here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import nnls

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.sensor_specs import TriadSpec
from bench.simulation.sensors.processes import choose_bias_stages

PARAMETERS = ("quantization", "random_walk", "rate_random_walk", "bias_instability")
"""Fields of `TriadSpec` that are fitted, in the order of the columns of `make_shapes`."""
ALONE = 192
"""Coefficients of the lowest frequencies that are not averaged with their neighbors."""
_RATIO = 1.06  # of the edges of the averages beyond


@dataclass(frozen=True, slots=True)
class NoiseSpectrum:
    """Power of the cosine transform in bins; each of the first `ALONE` coefficients is a bin."""

    interval: float  # of the samples [s]
    samples: int
    index: FloatArray  # (M,) number of the coefficient in the middle of each bin
    count: FloatArray  # (M,) coefficients in each bin
    low: FloatArray  # (L, A) coefficients of the first bins
    power: FloatArray  # (M, A) mean squares of the coefficients
    pooled: FloatArray  # (M,) their means over the axes
    regressors: FloatArray  # (L, r) the first coefficients of what is removed

    def select(self, bins: slice = slice(None), axes: slice = slice(None)) -> NoiseSpectrum:
        """Return some of the bins, the first included, and some of the axes."""
        return NoiseSpectrum(
            self.interval,
            self.samples,
            self.index[bins],
            self.count[bins],
            self.low[:, axes],
            self.power[bins, axes],
            self.power[bins, axes].mean(axis=1),
            self.regressors,
        )


def transform(columns: FloatArray) -> FloatArray:
    """Return the orthonormal cosine transform of columns (N, k) without the mean: (N - 1, k)."""
    from scipy.fft import dct

    found: FloatArray = dct(columns - columns.mean(axis=0), axis=0, norm="ortho")[1:]
    return found


def make_spectrum(rates: FloatArray, interval: float) -> NoiseSpectrum:
    """Return the spectrum of rates (N, A), without regressors."""
    found = transform(rates)
    alone = min(ALONE, len(found))
    more = int(np.log(len(found) / alone) / np.log(_RATIO))
    edges = np.unique(np.r_[np.arange(alone), np.geomspace(alone, len(found), more + 2).astype(np.int64)])
    starts: IntArray = edges[edges < len(found)]
    count = np.diff(np.r_[starts, len(found)]).astype(float)
    power = np.add.reduceat(found**2, starts, axis=0) / count[:, None]
    middle, none = starts + 0.5 * (count + 1.0), np.zeros((alone, 0))
    return NoiseSpectrum(interval, len(rates), middle, count, found[:alone], power, power.mean(axis=1), none)


def add_regressors(spectrum: NoiseSpectrum, courses: Sequence[FloatArray]) -> NoiseSpectrum:
    """Return a spectrum from which courses (N,), such as a temperature, are removed."""
    if not courses:
        return spectrum
    return replace(spectrum, regressors=transform(np.column_stack(courses))[: len(spectrum.low)])


def make_shapes(
    index: FloatArray, samples: int, interval: float, correlation: float, model: str = "flicker"
) -> FloatArray:
    """Return the variances of the cosine coefficients of a record of rates, for parameters of 1.

    Parameters
    ----------
    index : (M,) array
        Numbers of the coefficients, above 0.
    samples : int
        Number of samples of the record.
    interval : float
        Length of a sample [s].
    correlation : float
        Correlation time of the bias instability [s].
    model : str
        Its course, `TriadSpec.bias_model`.

    Returns
    -------
    shapes : (M, 4) array
        Variances of quantization, white noise, rate random walk and bias instability, each a mean over the
        sample, of a transform that preserves the sum of squares.

    Notes
    -----
    With ``w = pi k / N`` and ``a = 2 sin(w / 2) / dt``: rounding ``(a^2 (1 - 1 / N)
    + 4 / (N dt^2)) / 12``, white ``1 / dt``, walk
    ``1 / (dt a^2) - dt / 6``. The integral of ``exp(-b |s - u|) cos(a s) cos(a u)`` over a record of
    length T, a a multiple of pi / T, gives a Gauss-Markov stage of sd 1, b = 1 / its correlation time:
    ``2 b / (dt (a^2 + b^2)) - 4 b^2 (1 - (-1)^k exp(-b T)) / (T dt (a^2 + b^2)^2)``, less ``b dt / 3`` for
    the mean over a sample, as of the walk ``2 b`` that the stage is at short times.
    """
    a2 = (2.0 / interval * np.sin(0.5 * np.pi * index / samples)) ** 2
    length, sign = samples * interval, np.where(np.round(index) % 2, -1.0, 1.0)
    flicker = np.zeros_like(index)
    unit = TriadSpec(bias_instability=1.0, bias_correlation=correlation, bias_model=model)
    for time, sd in zip(*choose_bias_stages(unit), strict=True):
        b = 1.0 / time
        inside = 2.0 * b / (a2 + b**2)
        ends = 4.0 * b**2 * (1.0 - sign * np.exp(-b * length)) / (length * (a2 + b**2) ** 2)
        flicker += sd**2 * ((inside - ends) / interval - b * interval / 3.0)
    walk = 1.0 / (interval * a2) - interval / 6.0
    rounding = (a2 + (4.0 / interval**2 - a2) / samples) / 12.0
    return np.column_stack([rounding, np.full_like(index, 1.0 / interval), walk, flicker])


def solve(
    spectrum: NoiseSpectrum, shapes: FloatArray, offset: FloatArray, start: FloatArray
) -> tuple[FloatArray, float]:
    """Maximize the likelihood over non-negative variances; return them and its logarithm.

    ``offset`` (M,) is the part of the variance that is fixed. Fisher's scoring: weighted least squares with
    the weights of the last step, halved if the likelihood falls.
    """
    axes, weight = spectrum.power.shape[1], spectrum.power.shape[1] * spectrum.count
    scale = np.sqrt(np.sum(shapes**2, axis=0))
    least = 1e-12 * float(np.mean(spectrum.pooled))

    def evaluate(values: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        variance = np.maximum(shapes @ values + offset, least)
        power, target, lost = _remove(spectrum, variance)
        likelihood = -0.5 * float(weight @ (np.log(variance) + power / variance)) - 0.5 * axes * lost
        return likelihood, variance, target

    values = start
    best, variance, target = evaluate(values)
    for _ in range(80):
        root = np.sqrt(weight) / variance
        step = nnls(shapes / scale * root[:, None], (target - offset) * root)[0] / scale
        trial = evaluate(step)
        for _ in range(12):
            if trial[0] >= best - 1e-9:
                break
            step = 0.5 * (step + values)
            trial = evaluate(step)
        gain = trial[0] - best
        if gain > 0:
            values, (best, variance, target) = step, trial
        if gain < 1e-5:
            break
    return values, best


def _remove(spectrum: NoiseSpectrum, variance: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return the power (M,) without regressors, the same plus the power lost with them, and log det of their
    information.
    """
    power, X = spectrum.pooled, spectrum.regressors
    if not X.shape[1]:
        return power, power, 0.0
    alone = len(X)
    information, moment = X.T @ (X / variance[:alone, None]), X.T @ (spectrum.low / variance[:alone, None])
    inverse = np.linalg.inv(information)
    rest = spectrum.low - X @ (inverse @ moment)
    power = np.r_[np.mean(rest**2, axis=1), power[alone:]]
    target = power.copy()
    target[:alone] += np.einsum("ij,jk,ik->i", X, inverse, X)
    return power, target, float(np.linalg.slogdet(information)[1])


def estimate_effects(spectrum: NoiseSpectrum, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the coefficients (r, A) of the regressors and their covariance (r, r) for one axis."""
    X: FloatArray = spectrum.regressors
    if not X.shape[1]:
        return np.zeros((0, spectrum.power.shape[1])), np.zeros((0, 0))
    weighted = X / variance[: len(X), None]
    inverse = np.asarray(np.linalg.inv(X.T @ weighted), dtype=float)
    return np.asarray(inverse @ (weighted.T @ spectrum.low)), inverse
