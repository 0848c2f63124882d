"""Rows of matrices, eight columns at a time: `bench.core.compilation.vector_rows`, or plain loops
(`bench.core.compilation.plain_rows`).

The functions are called by kernels only. Their arrays are float64, C-ordered, of rows of a multiple of
:data:`LANES` numbers (:func:`wide`), and columns run from ``first`` to ``last``, multiples of :data:`LANES`.
Nothing is checked.
"""

from __future__ import annotations

import math

import numpy as np

from bench.core.compilation.compiled import is_plain
from bench.core.mathematics.arrays import FloatArray

if is_plain():
    from bench.core.compilation.plain_rows import LANES, add_row, row_sums, scale_row, set_row
else:
    from bench.core.compilation.vector_rows import LANES, add_row, row_sums, scale_row, set_row

__all__ = ["LANES", "add_row", "row_sums", "scale_row", "set_row", "wide", "widened"]


def wide(shape: tuple[int, ...]) -> FloatArray:
    """Return zeros with at least this shape: rows of whole cache lines, the first at the start of one."""
    whole = *shape[:-1], -(-shape[-1] // LANES) * LANES
    size = math.prod(whole)
    memory = np.zeros(size + LANES)
    begin = -memory.__array_interface__["data"][0] // memory.itemsize % LANES
    return memory[begin : begin + size].reshape(whole)


def widened(array: FloatArray) -> FloatArray:
    """Return a copy with wide rows; what is added to a row is zero."""
    copy = wide(array.shape)
    copy[..., : array.shape[-1]] = array
    return copy
