"""The ionosphere around a receiver as a few states; each satellite combines them by its pierce point.

The ionosphere at a pierce point is that of the `ANCHORS`, as far as its correlation with them goes,
exp(-distance / decay); what is left counts as the satellite's own (FITC: Snelson, Ghahramani, Sparse Gaussian
processes using pseudo-inputs, NIPS 18, 2006). The states are those of the anchors made independent.
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import inner
from bench.core.mathematics.arrays import FloatArray
from bench.simulation.signals.least_squares import EARTH_RADIUS, SHELL

_AROUND = 9e5  # from the receiver to the outer anchors [m]: half way to the pierce point at 5 deg
ANCHORS = _AROUND * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
"""Places (A, 2) north and east of the receiver on the shell of the ionosphere [m]."""


def whiten_anchors(decay: float) -> FloatArray:
    """Return (A, A), which turns correlations with the anchors into those with the independent states."""
    apart = ANCHORS[:, None] - ANCHORS
    correlation = np.exp(-np.hypot(apart[..., 0], apart[..., 1]) / decay)
    return np.asarray(np.linalg.inv(np.linalg.cholesky(correlation)))


@inner
def ionosphere_kernel(
    el: float,
    e_n: float,
    e_e: float,
    flat: float,
    size: float,
    anchors: FloatArray,
    whiten: FloatArray,
    decay: float,
    out: FloatArray,
) -> float:
    """Fill out (A,) with the columns of H of the ionosphere; return the variance left [m^2].

    ``size`` is the sd of its error in the range [m]; e_n, e_e and their length are of the line of sight.
    """
    away = SHELL * (np.pi / 2 - el - np.arcsin(EARTH_RADIUS / SHELL * np.cos(el)))
    north, east = away * e_n / max(flat, 1e-12), away * e_e / max(flat, 1e-12)
    count, left = out.shape[0], 1.0
    for i in range(count):
        n, e = north - anchors[i, 0], east - anchors[i, 1]
        out[i] = np.exp(-np.sqrt(n * n + e * e) / decay)
    for i in range(count - 1, -1, -1):
        part = 0.0
        for j in range(i + 1):
            part += whiten[i, j] * out[j]
        left -= part * part
        out[i] = size * part
    return size * size * max(left, 0.0)
