"""The covariance as a square root or as U D U': scalar measurement updates, and the step between them.

With P = S S', a = S' h, and z = h' x + v of variance r,

    P+ = S (I - a a' / (a'a + r)) S'

Potter takes the root of the bracket, I - gamma a a' with gamma = b / (1 + sqrt(b r)), b = 1 / (a'a + r)
(2 gamma - gamma^2 a'a = b); Carlson builds the one that keeps S upper triangular, a column at a time. Neither
subtracts two nearly equal covariances, so that P = S S' stays positive in half the digits. Bierman carries
the unit upper triangular U and the diagonal D of P = U D U', without a square root. Between measurements
P becomes Phi P Phi' + G G': the triangle of [Phi S, G] by orthogonal rows, for U and D weighted by D
(Thornton). The functions keep the type of their arrays. Register #37; G. J. Bierman, Factorization methods
for discrete sequential estimation, 1977; C. L. Thornton, PhD thesis, UCLA, 1976.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import FloatArray

Floats = NDArray[np.floating[Any]]


def root_columns(P: FloatArray) -> FloatArray:
    """Return A with A A' = P for a covariance that may be singular; NaN throughout if it is not finite."""
    sd = np.sqrt(np.diag(P))
    scale = np.where(sd > 0, sd, 1.0)
    correlation = P / np.outer(scale, scale)
    if not np.isfinite(correlation).all():
        return np.full_like(P, np.nan)
    w, V = np.linalg.eigh(correlation)
    return np.asarray(scale[:, None] * V * np.sqrt(np.maximum(w, 0.0)))


def triangular_root(A: Floats) -> Floats:
    """Return the upper triangular S (n, n) with S S' = A A', A (n, m) with m >= n.

    Examples
    --------
    >>> S = triangular_root(np.array([[1.0, 2.0], [3.0, 4.0]]))
    >>> float(S[1, 0]), np.round(S @ S.T, 12).tolist()
    (0.0, [[5.0, 11.0], [11.0, 25.0]])
    """
    R: Floats = np.linalg.qr(A[::-1].T, mode="r")  # type: ignore[assignment]
    return R.T[::-1, ::-1]


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


def thornton(U: Floats, D: Floats, Phi: Floats, G: Floats) -> tuple[Floats, Floats]:
    """Return U and D of Phi U D U' Phi' + G G' by weighted Gram-Schmidt (Thornton).

    Parameters
    ----------
    U, D : (n, n), (n,) arrays
        Unit upper triangular factor and diagonal.
    Phi, G : (n, n), (n, m) arrays
        Transition, and the noise of unit variance.

    Examples
    --------
    >>> thornton(np.eye(1), np.array([4.0]), np.array([[0.5]]), np.ones((1, 1)))
    (array([[1.]]), array([2.]))
    """
    W = np.hstack([Phi @ U, G])
    weight = np.concatenate([D, np.ones(G.shape[1], D.dtype)])
    U, D = np.eye(len(U), dtype=U.dtype), np.empty_like(D)
    for j in range(len(D) - 1, -1, -1):
        weighed = weight * W[j]
        D[j] = W[j] @ weighed
        if D[j] != 0:  # a state that does not vary
            U[:j, j] = W[:j] @ weighed / D[j]
            W[:j] -= np.outer(U[:j, j], W[j])
    return U, D


def bierman(x: Floats, U: Floats, D: Floats, h: Floats, z: float, r: float) -> tuple[Floats, Floats, Floats]:
    """Return x, U and D after one scalar measurement (Bierman); ``h``, ``z``, ``r`` as in :func:`potter`.

    Examples
    --------
    >>> bierman(np.zeros(1), np.eye(1), np.array([4.0]), np.ones(1), 1.0, 4.0)
    (array([0.5]), array([[1.]]), array([2.]))
    """
    f = U.T @ h
    v = D * f
    d = D.dtype.type(r)
    e = np.zeros_like(x)
    after, diagonal = np.empty_like(U), np.empty_like(D)
    for k in range(len(x)):
        before, d = d, d + f[k] * v[k]
        diagonal[k] = D[k] * (before / d)
        after[:, k] = U[:, k] - e * (f[k] / before)
        e = e + U[:, k] * v[k]
    return x + e * ((D.dtype.type(z) - h @ x) / d), after, diagonal
