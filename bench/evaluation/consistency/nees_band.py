"""Bounds of the mean normalized squared error of a record with correct covariances."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray

_MEMORY = 10800.0
"""Time after which the errors of fixes have lost all but 1/e of their correlation [s]; assumed. Errors of the
ionosphere and of ephemerides, which are sent anew every two hours, stay as long as that: after one hour the
fixes of ESBC have 0.6 to 0.9 of it."""
_PICKED = 48  # epochs that stand for a record; more tell the same
_DRAWS = 10000  # of such records
_DRAWN = 16  # largest eigenvalues whose squares are drawn; the others add their mean


def find_band(t: FloatArray, constant: float = 0.0) -> tuple[float, float]:
    """Return the interval that contains the mean NEES/3 of 95 % of records.

    The mean of squares of normal variables with a correlation matrix R (M, M) is the sum of its eigenvalues
    over M, each times the square of an independent one; the band is that of draws of these, three for each.

    Parameters
    ----------
    t : (M,) array
        Epochs, rising [s].
    constant : float
        Share of the variance that is one error of all epochs, 0 to 1; the rest loses its correlation.
    """
    t = t[np.linspace(0, len(t) - 1, min(len(t), _PICKED)).astype(int)]
    R = (1 - constant) * np.exp(-np.abs(t[:, None] - t) / _MEMORY) + constant
    parts = np.linalg.eigvalsh(R) / len(t)
    squares = np.random.default_rng(0).chisquare(3, (_DRAWS, min(len(t), _DRAWN)))
    drawn = parts[-squares.shape[1] :]
    low, high = np.percentile(squares @ drawn / 3 + (parts.sum() - drawn.sum()), [2.5, 97.5])
    return float(low), float(high)
