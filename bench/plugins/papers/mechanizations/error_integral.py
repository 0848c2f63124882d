"""The error of an attitude quaternion as an integral of rate errors along the attitude (B-7)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_simpson

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import conjugate, multiply


def quaternion_error(
    t: ArrayLike, q_ib: ArrayLike, rate_error_b: ArrayLike, dq_start: ArrayLike = (0.0, 0.0, 0.0, 0.0)
) -> FloatArray:
    """Return the error (N, 4) of an integrated quaternion, to the first order.

    ``dq = [dq_0 o conj(q_0) + 1/2 integral of q o dw o conj(q)] o q(t)``; the integral by Simpson's rule.

    Parameters
    ----------
    t : (N,) array
        Epochs [s].
    q_ib : (N, 4) array
        Attitude at them, body to inertial.
    rate_error_b : (N, 3) array
        Measured less true rate [rad/s], body.
    dq_start : (4,) array
        Error of the quaternion at the start.
    """
    q, dw = np.asarray(q_ib, float), np.asarray(rate_error_b, float)
    pure = np.concatenate([np.zeros((len(dw), 1)), dw], axis=1)
    felt = multiply(multiply(q, pure), conjugate(q))
    total = 0.5 * cumulative_simpson(felt, x=np.asarray(t, float), axis=0, initial=0.0)
    error: FloatArray = multiply(multiply(dq_start, conjugate(q[0])) + total, q)
    return error
