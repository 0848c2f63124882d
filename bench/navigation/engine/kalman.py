"""Kalman updates: a gated sub-vector at a time, its components as sequential scalars in Joseph form.

A component measures ``z = h' dx + v``, ``v`` of variance ``r``, independent of the others. The normalized
innovation squared of the sub-vector is taken before any of its components is used (A-5.4.7).
"""

from __future__ import annotations

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray


@kernel
def nis_kernel(
    P: FloatArray,
    dx: FloatArray,
    H: FloatArray,
    z: FloatArray,
    r: FloatArray,
    var: FloatArray,
    work: FloatArray,
    HP: FloatArray,
    at: IntArray,
) -> float:
    """Return :func:`nis_of_kernel` of z (m,) = H dx + v; ``HP`` (m, n) ends as H P."""
    m, n = H.shape
    find_columns_kernel(H, at)
    for a in range(m):
        for i in range(n):
            HP[a, i] = 0.0
        for j in at[a, 1 : at[a, 0] + 1]:
            for i in range(n):
                HP[a, i] += P[j, i] * H[a, j]
    nis: float = nis_of_kernel(HP, dx, H, at, z, r, var, work)
    return nis


@kernel
def find_columns_kernel(H: FloatArray, at: IntArray) -> None:
    """Fill at (m, n + 1) with the number and the indices of the nonzero columns of each row of H (m, n)."""
    for a in range(H.shape[0]):
        found = 0
        for j in range(H.shape[1]):
            if H[a, j] != 0.0:
                found += 1
                at[a, found] = j
        at[a, 0] = found


@kernel
def nis_of_kernel(
    HP: FloatArray,
    dx: FloatArray,
    H: FloatArray,
    at: IntArray,
    z: FloatArray,
    r: FloatArray,
    var: FloatArray,
    work: FloatArray,
) -> float:
    """Return the normalized innovation squared of z (m,) = H dx + v; NaN if its covariance is not positive.

    Fill var (m,) with the diagonal of the covariance S = H P H' + diag(r). ``work`` (m, m + 1) ends as the
    Cholesky factor of S and the innovation divided by it. ``HP`` (m, n) is H P, ``at`` the columns of H that
    :func:`find_columns_kernel` finds.
    """
    m, nis = H.shape[0], 0.0
    for a in range(m):
        e = z[a]
        for j in at[a, 1 : at[a, 0] + 1]:
            e -= H[a, j] * dx[j]
        for b in range(a + 1):
            s = r[a] if a == b else 0.0
            for j in at[a, 1 : at[a, 0] + 1]:
                s += H[a, j] * HP[b, j]
            if a == b:
                var[a] = s
            for k in range(b):
                s -= work[a, k] * work[b, k]
            work[a, b] = np.sqrt(s) if a == b else s / work[b, b]
        for k in range(a):
            e -= work[a, k] * work[k, m]
        work[a, m] = e / work[a, a]
        nis += work[a, m] * work[a, m]
    return nis


@kernel
def stretch_kernel(P: FloatArray, H: FloatArray, work: FloatArray, row: FloatArray) -> None:
    """Add x x' to P (n, n), with the rejected correction x = P H' S^-1 e; ``row`` ends as x.

    An error along the covariance explains the innovation then. A smoother's P stays as it is: the gain of
    its backward pass is that of an error which has been too large all along. ``work`` (m, m + 1) is as
    :func:`nis_kernel` left it.
    """
    m, n = H.shape
    for a in range(m - 1, -1, -1):  # S^-1 e
        for b in range(a + 1, m):
            work[a, m] -= work[b, a] * work[b, m]
        work[a, m] /= work[a, a]
    for i in range(n):
        row[i] = 0.0
        for a in range(m):
            for j in range(n):
                if H[a, j] != 0.0:
                    row[i] += P[i, j] * H[a, j] * work[a, m]
    for i in range(n):
        for j in range(n):
            P[i, j] += row[i] * row[j]


@kernel
def open_kernel(
    P: FloatArray,
    before: FloatArray,
    H: FloatArray,
    e: FloatArray,
    opens: BoolArray,
    lost: bool,
    work: FloatArray,
    row: FloatArray,
) -> None:
    """Inflate P (n, n) until the rejected innovation e (m,) is consistent with it (A-5.4.7).

    A step of the states ``opens`` (n,) alone explains it, the least that does. If the filter may be ``lost``,
    so does an error along the covariance (:func:`stretch_kernel`): P grows by both, and the next measurements
    tell them apart. ``before`` (n, n), the P that a smoother uses, grows alike.
    """
    m, n = H.shape
    if lost:
        stretch_kernel(P, H, work, row)
        for i in range(n):
            for j in range(n):
                before[i, j] += row[i] * row[j]
    for a in range(m):
        size2 = 0.0
        for i in range(n):
            if opens[i]:
                size2 += H[a, i] * H[a, i]
        if size2 == 0.0:
            continue
        for i in range(n):
            for j in range(n):
                if opens[i] and opens[j]:
                    grown = H[a, i] * H[a, j] * (e[a] / size2) ** 2
                    P[i, j] += grown
                    before[i, j] += grown


@kernel
def open_all_kernel(P: FloatArray, before: FloatArray, size: float, opens: BoolArray) -> None:
    """Inflate P (n, n) and ``before`` by a step of a size of each of the states ``opens``.

    For a row that is one of many rejected together: which of the states made the step, the others tell.
    """
    for i in range(P.shape[0]):
        if opens[i]:
            P[i, i] += size * size
            before[i, i] += size * size


@kernel
def update_kernel(
    P: FloatArray, dx: FloatArray, h: FloatArray, z: float, r: float, Ph: FloatArray, K: FloatArray
) -> None:
    """Update the error estimate dx (n,) and P (n, n) by one scalar z = h' dx + v, var v = r (A-5.4.5).

    P = (I - K h') P (I - K h')' + K r K', row by row; it stays exactly symmetric.
    """
    n = P.shape[0]
    s, e = r, z
    for i in range(n):
        Ph[i] = 0.0
    for j in range(n):
        if h[j] != 0.0:
            for i in range(n):
                Ph[i] += P[j, i] * h[j]
            e -= h[j] * dx[j]
    for i in range(n):
        if h[i] != 0.0:
            s += h[i] * Ph[i]
    hph = s - r
    for i in range(n):
        K[i] = Ph[i] / s
        dx[i] += K[i] * e
    for i in range(n):
        a, b, c = K[i], Ph[i] - K[i] * hph, r * K[i]
        for j in range(i + 1):
            P[i, j] = P[i, j] - a * Ph[j] - b * K[j] + c * K[j]
    for i in range(n):
        for j in range(i):
            P[j, i] = P[i, j]
