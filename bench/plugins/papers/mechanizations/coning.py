"""Rotation vector and velocity increment of a step from one to four samples: coning and sculling.

With rates that are polynomials of degree m - 1 through the increments of m samples, to the second order
(equations section 10; Titterton and Weston, ch. 11)::

    phi    = sum theta_i + sum_{i<j} K_ij theta_i x theta_j
    dv     = sum v_i + 1/2 theta x v + 1/6 theta x (theta x v)
             + sum_{i<j} K_ij (theta_i x v_j + v_i x theta_j)

One sample takes the sample before it into the line through its rate, with 1/12.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.polynomial import Polynomial
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray

MOST_SAMPLES = 4


@cache
def coning_coefficients(samples: int) -> FloatArray:
    """Return K (m, m) of the cross products of m samples, zero on and below the diagonal.

    Examples
    --------
    >>> round(float(coning_coefficients(2)[0, 1]), 6)  # the two-sample algorithm
    0.666667
    """
    m = samples
    edges = np.arange(m + 1.0)[:, None] ** np.arange(1, m + 1) / np.arange(1, m + 1)
    rates = [Polynomial(c) for c in np.linalg.inv(np.diff(edges, axis=0)).T]  # integral 1 over sample j alone
    angles = [rate.integ() for rate in rates]
    K = np.zeros((m, m))
    for i in range(m):
        for j in range(i + 1, m):
            area = (angles[i] * rates[j] - angles[j] * rates[i]).integ()
            K[i, j] = 0.5 * (area(m) - area(0))
    return K


def step_increments(
    dtheta_b: ArrayLike, dvel_b: ArrayLike, samples: int, *, corrected: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Return rotation vector and velocity increment, body axes at the start, of every step (K, 3).

    Parameters
    ----------
    dtheta_b, dvel_b : (K samples, 3) arrays
        Increments of the samples [rad], [m/s].
    samples : int
        Samples in a step, 1 to 4 if ``corrected``.
    corrected : bool
        Correct coning and sculling; if not, increments are summed and the rates taken as constant in a step.

    Raises
    ------
    ValueError
        If the increments do not fill whole steps, or the samples are too many to correct.
    """
    theta, v = np.asarray(dtheta_b, float), np.asarray(dvel_b, float)
    if len(theta) % samples:
        raise ValueError(f"{len(theta)} samples do not fill steps of {samples}; give a multiple")
    if corrected and samples > MOST_SAMPLES:
        raise ValueError(
            f"coning is corrected with 1 to {MOST_SAMPLES} samples in a step; got {samples}, so choose a "
            "faster attitude"
        )
    theta, v = theta.reshape(-1, samples, 3), v.reshape(-1, samples, 3)
    turn, dv = theta.sum(axis=1), v.sum(axis=1)
    by_turn = np.cross(turn, dv)
    phi, start = turn.copy(), dv + 0.5 * by_turn + np.cross(turn, by_turn) / 6.0
    if not corrected:
        return phi, start
    if samples == 1:
        phi[1:] += np.cross(turn[:-1], turn[1:]) / 12.0
        start[1:] += (np.cross(turn[:-1], dv[1:]) + np.cross(dv[:-1], turn[1:])) / 12.0
        return phi, start
    K = coning_coefficients(samples)
    for i in range(samples):
        for j in range(i + 1, samples):
            phi += K[i, j] * np.cross(theta[:, i], theta[:, j])
            start += K[i, j] * (np.cross(theta[:, i], v[:, j]) + np.cross(v[:, i], theta[:, j]))
    return phi, start
