"""Axes that are those of a file in another order or reversed, as matrices (3, 3) of 0, 1 and -1."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import permutations, product

import numpy as np

from bench.core.mathematics.arrays import FloatArray


def list_signed() -> list[FloatArray]:
    """Return the 48 orders and signs of three axes; the given one first."""
    orders, signs = permutations(range(3)), list(product((1.0, -1.0), repeat=3))
    return [np.eye(3)[list(order)] * np.array(one)[:, None] for order in orders for one in signs]


def write_axes(matrix: FloatArray, names: Sequence[str] = "xyz") -> str:
    """Return the columns from which axes are taken, with their signs.

    Examples
    --------
    >>> write_axes(np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]))
    '-y, x, z'
    """
    return ", ".join(f"{'-' if row.min() < 0 else ''}{names[int(np.argmax(np.abs(row)))]}" for row in matrix)
