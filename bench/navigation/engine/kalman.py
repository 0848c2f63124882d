"""Kalman updates: a gated sub-vector at a time, its components as sequential scalars in Joseph form.

A component measures ``z = h' dx + v``, ``v`` of variance ``r``, independent of the others. The normalized
innovation squared of the sub-vector is taken before any of its components is used (A-5.4.7).
"""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray
from bench.compiled import kernel


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
) -> float:
    """Return the normalized innovation squared of z (m,) = H dx + v; NaN if its covariance is not positive.

    Fill var (m,) with the diagonal of the covariance S = H P H' + diag(r). ``work`` (m, m + 1) ends as the
    Cholesky factor of S and the innovation divided by it, ``HP`` (m, n) as H P.
    """
    m, n = H.shape
    nis = 0.0
    for a in range(m):
        e = z[a]
        for i in range(n):
            HP[a, i] = 0.0
        for j in range(n):
            if H[a, j] != 0.0:
                e -= H[a, j] * dx[j]
                for i in range(n):
                    HP[a, i] += P[j, i] * H[a, j]
        for b in range(a + 1):
            s = r[a] if a == b else 0.0
            for i in range(n):
                if H[a, i] != 0.0:
                    s += H[a, i] * HP[b, i]
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
def drifted_kernel(
    P: FloatArray,
    dx: FloatArray,
    H: FloatArray,
    z: FloatArray,
    r: FloatArray,
    limit: float,
    var: FloatArray,
    work: FloatArray,
    HP: FloatArray,
) -> bool:
    """Return `integrity.tells_of_drift` of a fix (6,) whose position is beyond the gate.

    ``work`` (6, 7) and ``HP`` (6, n) end as :func:`nis_kernel` of the position leaves them.
    """
    both = nis_kernel(P, dx, H, z, r, var, work, HP)
    velocity = nis_kernel(P, dx, H[3:], z[3:], r[3:], var, work, HP)
    position = nis_kernel(P, dx, H[:3], z[:3], r[:3], var, work, HP)
    apart = 0.0
    for a in range(3):
        apart += var[a] - 2.0 * r[a]
    return velocity > limit or (apart > 0.0 and both - position <= limit)


@kernel
def stretch_kernel(P: FloatArray, H: FloatArray, work: FloatArray, row: FloatArray) -> None:
    """Let P (n, n) grow by x x', x = P H' S^-1 e the correction that the filter refused; ``row`` ends as x.

    An error along the covariance explains the innovation then. A smoother's P stays as it is: the gain of
    its way back is that of an error which has been too large all along. ``work`` (m, m + 1) is as
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
    own: int,
    count: int,
    work: FloatArray,
    row: FloatArray,
) -> None:
    """Let P (n, n) grow until the innovation e (m,) the filter refused is to be expected (A-5.4.7).

    It has two explanations, and P grows by both: an error along the covariance (:func:`stretch_kernel`), and
    a step of the ``count`` states from ``own`` on alone, the least that explains it. The next measurements
    tell them apart. ``before`` (n, n), the P that a smoother uses, grows alike.
    """
    m, n = H.shape
    stretch_kernel(P, H, work, row)
    for i in range(n):
        for j in range(n):
            before[i, j] += row[i] * row[j]
    for a in range(m):
        size2 = 0.0
        for i in range(own, own + count):
            size2 += H[a, i] * H[a, i]
        if size2 == 0.0:
            continue
        for i in range(own, own + count):
            for j in range(own, own + count):
                grown = H[a, i] * H[a, j] * (e[a] / size2) ** 2
                P[i, j] += grown
                before[i, j] += grown


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
