"""In-flight calibration: INS errors before an outage as a curve, extrapolated through the outage.

While GNSS is there the filter's estimates of the errors are kept; without it a line, a parabola or the basis
of the Schuler loop is fitted to those of a window by least squares and extrapolated (A-2.3, #46).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.navigation.engine.integrity import SCHULER_RADIUS

Curve = Literal["line", "parabola", "schuler"]


def basis(curve: Curve, t: ArrayLike) -> FloatArray:
    """Return the functions of a curve at times t (N,) [s] as columns (N, k).

    Examples
    --------
    >>> basis("parabola", [0.0, 2.0])
    array([[1., 0., 0.],
           [1., 2., 4.]])
    """
    t = np.asarray(t, float)
    if curve == "schuler":
        w = np.sqrt(STANDARD_GRAVITY / SCHULER_RADIUS)
        return np.column_stack([np.ones_like(t), t, np.sin(w * t), np.cos(w * t)])
    return np.vander(t, 2 if curve == "line" else 3, increasing=True)


def extrapolate(curve: Curve, t: ArrayLike, values: ArrayLike, now: float) -> FloatArray:
    """Return values (N, ...) of times t (N,) at a later time, by the curve that fits them best.

    Examples
    --------
    >>> float(extrapolate("line", [0.0, 1.0, 2.0], [0.0, 2.0, 4.0], 5.0).round(9))
    10.0
    """
    t, values = np.asarray(t, float), np.asarray(values, float)
    A, at = basis(curve, t - t[-1]), basis(curve, [now - t[-1]])
    scale = np.abs(A).max(axis=0)
    weights = (at / scale) @ np.linalg.pinv(A / scale, rcond=1e-10)
    return np.asarray(np.tensordot(weights[0], values, 1))
