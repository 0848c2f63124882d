"""Checks of the shape and dtype of arrays; error messages contain the expected shape or dtype."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bench.core.files import disk_arrays

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_FEW = 1000  # rows that are looked at in one go
Shape = tuple[int | None, ...]


def as_float(name: str, value: ArrayLike, shape: Shape, *, finite: bool = True) -> FloatArray:
    """Convert a value to a C-ordered float64 array and check its shape.

    Parameters
    ----------
    name : str
        Name of the array in messages.
    value : array_like
        The data.
    shape : tuple of int or None
        Expected shape; ``None`` stands for any length.
    finite : bool
        Reject NaN and infinity.

    Raises
    ------
    ValueError
        If the shape differs or, with ``finite``, a value is not finite.

    Examples
    --------
    >>> as_float("vel_n", [[1, 2, 3]], (None, 3))
    array([[1., 2., 3.]])
    >>> as_float("vel_n", [1, 2], (3,))
    Traceback (most recent call last):
    ValueError: vel_n must have shape (3); got (2,)
    """
    if type(value) is np.ndarray and value.dtype == np.float64 and value.ndim and value.flags.c_contiguous:
        array = value  # nothing to convert
    else:
        array = np.ascontiguousarray(value, dtype=np.float64)
        if np.ndim(value) == 0:
            array = array.reshape(())  # ascontiguousarray makes a row of a scalar
    _check_shape(name, array.shape, shape)
    if finite:
        _check_finite(name, np.atleast_1d(array))
    return array


def is_array(value: object, dtype: np.dtype[Any], shape: Shape) -> bool:
    """Return whether a value is a C-ordered array of a dtype and shape: there is nothing to convert."""
    if type(value) is not np.ndarray or value.dtype is not dtype or not value.flags.c_contiguous:
        return False
    return _fits(value.shape, shape)


def is_short_and_finite(array: FloatArray) -> bool:
    """Return whether an array is short and one quick test shows that it is finite."""
    # of finite values alone is the sum of squares finite; `isfinite` takes twice as long
    return len(array) <= _FEW and math.isfinite(np.vdot(array, array))


def as_kind(name: str, value: ArrayLike, dtype: type, shape: Shape) -> NDArray[np.generic]:
    """Convert a value to a C-ordered array of an integer or boolean dtype and check its shape.

    Raises
    ------
    ValueError
        If the shape differs or the conversion would change a value.
    """
    given = np.asarray(value)
    array: NDArray[np.generic] = np.ascontiguousarray(given, dtype=dtype)
    _check_shape(name, array.shape, shape)
    if given.dtype != dtype and given.size and not (array == given).all():
        raise ValueError(f"{name} must contain values of type {dtype.__name__}")
    return array


def split_last(array: FloatArray) -> FloatArray:
    """Return a view (n, ...) of an array (..., n): its components."""
    return array.T if array.ndim < 3 else np.moveaxis(array, -1, 0)


def join_last(parts: Sequence[ArrayLike]) -> FloatArray:
    """Return components of one shape as an array (..., n); `np.stack` takes four times as long for a few."""
    joined = np.empty((*np.shape(parts[0]), len(parts)))
    for k, part in enumerate(parts):
        joined[..., k] = part
    return joined


def take_increasing(column: FloatArray, rows: IntArray) -> FloatArray:
    """Return increasing rows (K,) of a column, as a view if the rows are consecutive."""
    if len(rows) and rows[-1] - rows[0] == len(rows) - 1:
        return column[rows[0] : rows[-1] + 1]
    return column[rows]


def find_later(t: FloatArray) -> BoolArray:
    """Return whether each time (N,) is after all before it."""
    later = np.ones(len(t), np.bool_)
    later[1:] = t[1:] > np.maximum.accumulate(t)[:-1]
    return later


def same_array(one: FloatArray, other: FloatArray) -> bool:
    """Return whether two arrays are equal: at once if they are one."""
    return one is other or np.array_equal(one, other)


def read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view, as columns of records are, for which kernels are compiled."""
    view = array.view()
    view.setflags(write=False)
    return view


def _check_finite(name: str, array: FloatArray) -> None:
    if is_short_and_finite(array):
        return
    for rows in disk_arrays.blocks(len(array)):
        sound = np.isfinite(array[rows])
        if not sound.all():
            row = rows.start + int(np.argwhere(~sound)[0][0])
            raise ValueError(f"{name} must be finite; the first bad value is in row {row}")


def _fits(got: tuple[int, ...], shape: Shape) -> bool:
    if len(got) != len(shape):
        return False
    if got[1:] == shape[1:] and shape and shape[0] is None:  # nearly all: a column of any length
        return True
    for want, have in zip(shape, got, strict=True):  # noqa: SIM110 - a generator takes twice as long
        if want is not None and want != have:
            return False
    return True


def _check_shape(name: str, got: tuple[int, ...], shape: Shape) -> None:
    if not _fits(got, shape):
        wanted = ", ".join("N" if n is None else str(n) for n in shape)
        raise ValueError(f"{name} must have shape ({wanted}); got {got}")
