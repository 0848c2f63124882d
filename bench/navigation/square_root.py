"""Measurement updates on a square root of the covariance, a scalar at a time: Potter's form and Carlson's.

With P = S S', a = S' h, and z = h' x + v of variance r,

    P+ = S (I - a a' / (a'a + r)) S'

Potter takes the root of the bracket, I - gamma a a' with gamma = b / (1 + sqrt(b r)), b = 1 / (a'a + r)
(2 gamma - gamma^2 a'a = b); Carlson builds the one that keeps S upper triangular, a column at a time. Neither
subtracts two nearly equal covariances, so that P = S S' stays positive in half the digits. The functions keep
the type of their arrays. Register #37; G. J. Bierman, Factorization methods for discrete sequential
estimation, 1977.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating[Any]]


def upper_root(P: Floats) -> Floats:
    """Return the upper triangular S with S S' = P; a state without variance has no row and column in it.

    Raises
    ------
    numpy.linalg.LinAlgError
        When P is not positive definite over the states that vary.
    """
    live = np.flatnonzero(np.diag(P) > 0)
    S = np.zeros_like(P)
    S[np.ix_(live, live)] = np.linalg.cholesky(P[np.ix_(live[::-1], live[::-1])])[::-1, ::-1]
    return S


def potter(x: Floats, S: Floats, h: Floats, z: float, r: float) -> tuple[Floats, Floats]:
    """Return x and S after one scalar measurement (Potter).

    Parameters
    ----------
    x, S : (n,), (n, n) arrays
        Estimate, and any square root of its covariance.
    h : (n,) array
        Row of the measurement.
    z, r : float
        The measurement and its variance.

    Examples
    --------
    >>> x, S = potter(np.zeros(1), np.array([[2.0]]), np.ones(1), 1.0, 4.0)
    >>> (x, S @ S.T)
    (array([0.5]), array([[2.]]))
    """
    one = S.dtype.type(1.0)
    a = S.T @ h
    b = one / (a @ a + S.dtype.type(r))
    along = S @ a
    gamma = b / (one + np.sqrt(b * S.dtype.type(r)))
    return x + b * along * (S.dtype.type(z) - h @ x), S - gamma * np.outer(along, a)


def carlson(x: Floats, S: Floats, h: Floats, z: float, r: float) -> tuple[Floats, Floats]:
    """Return x and the upper triangular S after one scalar measurement (Carlson); as :func:`potter`.

    Examples
    --------
    >>> x, S = carlson(np.zeros(1), np.array([[2.0]]), np.ones(1), 1.0, 4.0)
    >>> (x, S @ S.T)
    (array([0.5]), array([[2.]]))
    """
    a = S.T @ h
    d = S.dtype.type(r)
    e = np.zeros_like(x)
    root = np.empty_like(S)
    for k in range(len(x)):
        before, d = d, d + a[k] * a[k]
        root[:, k] = S[:, k] * np.sqrt(before / d) - e * (a[k] / np.sqrt(before * d))
        e = e + S[:, k] * a[k]
    return x + e * ((S.dtype.type(z) - h @ x) / d), root
