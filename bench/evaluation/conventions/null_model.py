"""Likelihood of errors of a filter whose covariance is wrong by a factor and whose errors wander.

Errors over their reported covariance are, in each axis of a block, a Gauss-Markov process of variance `scale`
plus a random walk that begins with the run. The scale, one for the block, the correlation times and the
intensities of the walks maximize the likelihood.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.evaluation.conventions.known_conventions import TrueMotion

_TIMES = (0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)  # correlation times [s]
_WALKS = (0.0, *np.logspace(-2.5, 1.5, 9).tolist())  # intensities over the root of the scale [1/sqrt(s)]
_TRIED = [(time, walk) for time in _TIMES for walk in _WALKS]
_SCALES = np.logspace(-6.0, 12.0, 37)  # where the search for the scale begins
_REFINED = 5  # steps of the scale
_LEAST = 1e-12  # scale; errors of zero are likelier than any other


@dataclass(frozen=True, slots=True)
class Noise:
    """The parameters that fit the errors of a block best."""

    misfit: float  # -2 log likelihood without the constant term
    scale: float  # factor of the variance [1]
    chosen: list[tuple[float, float]]  # correlation time and walk of each axis


@np.errstate(all="ignore")
def whiten(columns: FloatArray, cov: FloatArray) -> tuple[FloatArray, float]:
    """Return columns (K, n, m) over the Cholesky factors of cov (K, n, n), and the sum of log det cov.

    Raises
    ------
    numpy.linalg.LinAlgError
        If a covariance is not positive definite or a number not finite.
    """
    sd = np.sqrt(np.einsum("kii->ki", cov))
    L = np.linalg.cholesky(cov / (sd[:, :, None] * sd[:, None, :]))
    white = np.linalg.solve(L, columns / sd[:, :, None])
    volume = 2.0 * float(np.log(sd).sum() + np.log(np.einsum("kii->ki", L)).sum())
    if not (np.isfinite(volume) and np.isfinite(white).all()):
        raise np.linalg.LinAlgError
    return white, volume


def fit_noise(white: FloatArray, motion: TrueMotion, low: float, high: float = np.inf) -> Noise:
    """Return the noise that fits whitened errors (K, n) best, with a scale from low to high."""
    axes = white.shape[1]
    squares, logs = np.empty((len(_TRIED), axes)), np.empty((len(_TRIED), 1))
    for row, tried in enumerate(_TRIED):
        v, logs[row] = innovate(white, motion, *tried)
        squares[row] = np.einsum("ki,ki->i", v, v)
    low = max(low, _LEAST)

    def sum_best(scale: float) -> float:
        least = float((squares / scale + logs).min(axis=0).sum())
        return least + white.size * math.log(scale)

    scale: float = min(np.clip(_SCALES, low, high).tolist(), key=sum_best)
    for _ in range(_REFINED):
        chosen = (squares / scale + logs).argmin(axis=0)
        scale = float(np.clip(squares[chosen, np.arange(axes)].sum() / white.size, low, high))
    return Noise(sum_best(scale), scale, [_TRIED[row] for row in (squares / scale + logs).argmin(axis=0)])


def normalize(columns: FloatArray, motion: TrueMotion, noise: Noise) -> FloatArray:
    """Return whitened columns (K, n, m) as rows for least squares, of variance 1 and independent."""
    rows = [innovate(columns[:, axis], motion, *tried)[0] for axis, tried in enumerate(noise.chosen)]
    return np.stack(rows, axis=1) / float(np.sqrt(noise.scale))


def find_misfit(error: FloatArray, cov: FloatArray, motion: TrueMotion, *limits: float) -> float:
    """Return the mean of -2 log likelihood of the errors (K, n) of a block, without the constant term.

    The factor by which cov (K, n, n) is wrong lies within ``limits``: its least, and its largest if that is
    given. The result is infinite if cov is no covariance.
    """
    try:
        white, volume = whiten(error[:, :, None], cov)
    except np.linalg.LinAlgError:
        return np.inf
    return (fit_noise(white[:, :, 0], motion, *limits).misfit + volume) / len(error)


def innovate(z: FloatArray, motion: TrueMotion, time: float, walk: float) -> tuple[FloatArray, float]:
    """Return the innovations of columns z (K, m) over their sigma, and the sum of log variances of one.

    Each column is a Gauss-Markov process of variance 1 and correlation time ``time`` [s], 0 for white noise,
    and a random walk of intensity ``walk`` [1/sqrt(s)] that begins with the truth of the run.
    """
    v, state = np.empty(z.shape), np.empty((2, z.shape[1]))
    return v, _innovate_kernel(np.ascontiguousarray(z), motion.dt, motion.first, time, walk, state, v)


@kernel
def _innovate_kernel(
    z: FloatArray, dt: FloatArray, first: BoolArray, time: float, walk: float,
    state: FloatArray, v: FloatArray,
) -> float:  # fmt: skip
    """Fill v (K, m) as `innovate`; all columns have the same gains, and state (2, m) is memory."""
    total, a, b, c = 0.0, 1.0, 0.0, 0.0
    for k in range(z.shape[0]):
        kept = np.exp(-dt[k] / time) if time > 0.0 else 0.0
        if first[k]:
            kept, c = 0.0, 0.0
            state[:] = 0.0
        a, b, c = kept * kept * a + 1.0 - kept * kept, kept * b, c + walk * walk * dt[k]
        variance = a + 2.0 * b + c
        total += np.log(variance)
        gain, drift = (a + b) / variance, (b + c) / variance
        for i in range(z.shape[1]):
            e = z[k, i] - kept * state[0, i] - state[1, i]
            v[k, i] = e / np.sqrt(variance)
            state[0, i] = kept * state[0, i] + gain * e
            state[1, i] += drift * e
        a, b, c = a - gain * (a + b), b - gain * (b + c), c - drift * (b + c)
    return total
