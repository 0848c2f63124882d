"""Test for faulty ranges of an epoch by normalized residuals."""

from __future__ import annotations

from math import erfc

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray

_FAULT = 30.0  # up to about which size faults are equally likely [m]; assumed, 30 to 1000 find the same ones
_SIZES = np.linspace(0.0, 12.0, 1201)  # of a standard normal variable [1]
_LOG_TAILS = np.log([erfc(x / np.sqrt(2.0)) for x in _SIZES])  # chance that it is as large, either sign
_REFINED = 8  # steps to a threshold, of Newton; with 5e-3 three have all digits


def find_alarms(normalized: FloatArray, share: FloatArray, false_alarm: float) -> tuple[BoolArray, IntArray]:
    """Return a mask of the epochs (M,) with a fault, and the row (M,) most likely at fault.

    A fault of b meters in row i shifts its normalized residual w by ``share`` s times b. If all sizes up to
    some ten meters are equally likely, the odds of a fault in row i against none are
    ``exp(w^2 / 2) / sqrt(1 + (30 m s)^2)``: of two rows with the same w the one with the smaller s has it.
    The test of the largest odds finds most of such faults (Neyman and Pearson). By its threshold the chances
    of all rows have the sum ``false_alarm`` (Bonferroni).

    Parameters
    ----------
    normalized, share : (M, S) arrays
        Both 0 where a row tells nothing; [1] and [1/m].
    """
    told = share > 0.0
    margin = np.where(told, np.log1p((_FAULT * share) ** 2), 0.0)
    size = np.where(told, normalized**2 - margin, -np.inf)
    limit = np.full(len(size), 10.0)
    for _ in range(_REFINED):
        x = np.sqrt(np.maximum(limit[:, None] + margin, 1e-2))
        chance = np.where(told, np.exp(np.interp(x, _SIZES, _LOG_TAILS)), 0.0)
        slope = np.where(told, np.exp(-(x**2) / 2.0) / (np.sqrt(2.0 * np.pi) * x), 0.0).sum(axis=1)
        total = np.maximum(chance.sum(axis=1), 1e-300)
        limit += np.log(total / false_alarm) * total / np.maximum(slope, 1e-300)
    return np.asarray(size.max(axis=1) > limit), size.argmax(axis=1)
