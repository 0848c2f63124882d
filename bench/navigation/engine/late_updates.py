"""Scalar updates with a delayed change of P: a measurement of many rows changes P only once.

An update by z = h' dx + v, var v = r, subtracts g g' from P, g = P h / sqrt(s) and s = h' P h + r: the Joseph
form with the best gain (A-5.4.5). It subtracts the same from both sides of the diagonal, so that P stays
exactly symmetric. A later row accounts for delayed updates: its P h is reduced by the sum of g (g' h).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.compilation.wide_rows import add_row, set_row, wide
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.navigation.engine.kalman import find_columns_kernel

DEPTH = 16
"""Most updates that wait: more of them cost each row more than going over P."""
_SHRINKS = 1e6
"""An update that leaves less than this part of a variance does not wait: a row after it would lose digits."""


class LateUpdates(NamedTuple):
    """Updates not yet applied to P (n, n), and the rows in progress; matrices are `wide_rows.wide`."""

    G: FloatArray  # (DEPTH, n) g of each update
    HP: FloatArray  # (6, n) rows of a sub-vector times P
    at: IntArray  # (6, n + 1) of a sub-vector, `kalman.find_columns_kernel`


def late_updates(n: int) -> LateUpdates:
    """Return the memory for n states."""
    return LateUpdates(wide((DEPTH, n)), wide((6, n)), np.zeros((6, n + 1), np.int64))


@inner
def _lower_kernel(H: FloatArray, a: int, first: int, last: int, late: LateUpdates) -> None:
    """Subtract the updates ``first`` to ``last`` from row a of HP, the row of H (m, n) times P."""
    G, HP, at = late.G, late.HP, late.at
    for k in range(first, last):
        part = 0.0
        for j in at[a, 1 : at[a, 0] + 1]:
            part -= G[k, j] * H[a, j]
        add_row(HP, a, part, G, k, 0, HP.shape[1])


@kernel
def late_rows_kernel(P: FloatArray, H: FloatArray, late: LateUpdates, count: int) -> None:
    """Fill at, and HP with H (m, n) times the P after ``count`` pending updates."""
    HP, at, width = late.HP, late.at, late.HP.shape[1]
    find_columns_kernel(H, at)
    for a in range(H.shape[0]):
        set_row(HP, a, 0.0, HP, a, 0, width)
        for j in at[a, 1 : at[a, 0] + 1]:
            add_row(HP, a, H[a, j], P, j, 0, width)
        _lower_kernel(H, a, 0, count, late)


@kernel
def late_update_kernel(
    P: FloatArray, dx: FloatArray, H: FloatArray, z: FloatArray, r: FloatArray, late: LateUpdates, count: int
) -> int:
    """Update dx (n,) by the rows H (m, n) of z (m,), HP and at filled; return how many updates are
    pending."""
    HP, at, n = late.HP, late.at, dx.shape[0]
    for a in range(H.shape[0]):
        s, e = r[a], z[a]
        for j in at[a, 1 : at[a, 0] + 1]:
            s += H[a, j] * HP[a, j]
            e -= H[a, j] * dx[j]
        e /= s
        for i in range(n):
            dx[i] += HP[a, i] * e
        set_row(late.G, count, 1.0 / np.sqrt(s), HP, a, 0, HP.shape[1])
        for b in range(a + 1, H.shape[0]):
            _lower_kernel(H, b, count, count + 1, late)
        count += 1
        if count == DEPTH or s > _SHRINKS * r[a]:
            count = settle_kernel(P, late, count)
    return count


@kernel
def settle_kernel(P: FloatArray, late: LateUpdates, count: int) -> int:
    """Apply the pending updates to P; return 0, the number that remain pending."""
    G, k, n, width = late.G, 0, P.shape[0], P.shape[1]
    while k + 4 <= count:
        a, b, c, d = G[k], G[k + 1], G[k + 2], G[k + 3]
        for i in range(n):
            row, p, q, r, s = P[i], a[i], b[i], c[i], d[i]
            for j in range(width):
                row[j] -= p * a[j] + q * b[j] + r * c[j] + s * d[j]
        k += 4
    while k < count:
        a = G[k]
        for i in range(n):
            row, p = P[i], a[i]
            for j in range(width):
                row[j] -= p * a[j]
        k += 1
    return 0
