"""Rows of matrices by loops that numba compiles: what `compilation.vector_rows` does, with the same bits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, cast

import numba
import numpy as np

from bench.core.mathematics.arrays import FloatArray

LANES = 8
"""Numbers of a row are a multiple of it."""
_loops: Any = numba.njit(
    error_model="numpy", fastmath={"contract"}
)  # a b + c is rounded once, where it can be


@_loops
def _add(target: FloatArray, factor: float, source: FloatArray) -> None:
    for c in range(len(target)):
        target[c] = target[c] + factor * source[c]


@_loops
def _copy(target: FloatArray, source: FloatArray) -> None:
    for c in range(len(target)):
        target[c] = source[c]


def row_sums(pattern: Sequence[Sequence[int]], upper_rows: int) -> Callable[..., None]:
    """Return a function that adds multiples of rows to rows, as `vector_rows.row_sums` does."""
    terms, count = np.array([(i, k) for i, row in enumerate(pattern) for k in row]), len(pattern)

    @_loops
    def add_rows(
        start: FloatArray, factors: FloatArray, upper: FloatArray, lower: FloatArray, target: FloatArray,
        first: int, last: int,
    ) -> None:  # fmt: skip
        totals = np.empty((count, last - first))
        for i in range(count):
            _copy(totals[i], start[i, first:last])
        for i, k in terms:
            if k < upper_rows:
                _add(totals[i], factors[i, k], upper[k, first:last])
            else:
                _add(totals[i], factors[i, k], lower[k - upper_rows, first:last])
        for i in range(count):
            _copy(target[i, first:last], totals[i])

    return cast(Callable[..., None], add_rows)


@_loops
def add_row(
    target: FloatArray, i: int, factor: float, source: FloatArray, k: int, first: int, last: int
) -> None:
    """``target[i] += factor source[k]``."""
    _add(target[i, first:last], factor, source[k, first:last])


@_loops
def set_row(
    target: FloatArray, i: int, factor: float, source: FloatArray, k: int, first: int, last: int
) -> None:
    """``target[i] = factor source[k]``."""
    row, of = target[i, first:last], source[k, first:last]
    for c in range(len(row)):
        row[c] = factor * of[c]


@_loops
def scale_row(
    target: FloatArray, i: int, factor: float, scale: FloatArray, source: FloatArray, k: int,
    first: int, last: int,
) -> None:  # fmt: skip
    """``target[i] = factor scale source[k]``, by elements."""
    row, by, of = target[i, first:last], scale[first:last], source[k, first:last]
    for c in range(len(row)):
        row[c] = factor * by[c] * of[c]
