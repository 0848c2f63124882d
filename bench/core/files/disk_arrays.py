"""Large arrays on disk, so that a long flight needs no more memory than a short one.

An array above :data:`LARGE` lies in a file without a name in the cache folder, which is gone with the array,
and is mapped into memory. The system writes its pages to disk where memory is short. :func:`release` takes
all of them out of the memory of this process at once: who goes over a long record in pieces calls it after
each, and then needs no more than what a piece touches.
"""

from __future__ import annotations

import math
import mmap
import os
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from bench.core.files.places import cache_folder

FloatArray = NDArray[np.float64]

LARGE = 4 << 20
"""From this size on an array lies on disk [byte]: gyros of an hour at 100 Hz do, of half an hour not."""

ROWS = 1 << 16
"""Rows of a record that are worked on at a time."""

LONG = 4
"""A record of more than so many :data:`ROWS` is long: three quarters of an hour at 100 Hz."""

SPARED = 128 << 20
"""Arrays on disk of less than this together are not released [byte]: to read them in again costs more."""

_mapped: WeakSet[mmap.mmap] = WeakSet()


def empty(shape: int | tuple[int, ...], dtype: type[np.generic] = np.float64) -> NDArray[Any]:
    """Return an array with undefined values, on disk if it is large.

    It is in memory if the disk has no room, or if the system cannot reserve disk space.
    """
    shape = (shape,) if isinstance(shape, int) else shape
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size >= LARGE and hasattr(os, "posix_fallocate"):
        folder = cache_folder("scratch")
        try:
            folder.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder) as file:
                os.posix_fallocate(file.fileno(), 0, size)
                memory = mmap.mmap(file.fileno(), size)
        except OSError:
            return np.empty(shape, dtype)
        _mapped.add(memory)
        return np.frombuffer(memory, dtype).reshape(shape)
    return np.empty(shape, dtype)


def zeros(shape: int | tuple[int, ...]) -> NDArray[Any]:
    """Return an array of zeros as :func:`empty` returns one."""
    array = empty(shape)
    if array.base is None:  # a new file holds zeros
        array[...] = 0.0
    return array


def fill(
    shape: int | tuple[int, ...],
    make: Callable[[slice], NDArray[Any]],
    dtype: type[np.generic] = np.float64,
) -> NDArray[Any]:
    """Return an array as :func:`empty` returns one; ``make`` returns its values for a block of rows."""
    array = empty(shape, dtype)
    for rows in blocks(len(array)):
        array[rows] = make(rows)
    return array


class Gathered:
    """Rows of ``width`` numbers that arrive in blocks; the number of rows is not known in advance."""

    def __init__(self, width: int) -> None:
        self._width, self._size = width, 0
        self._loose: list[FloatArray] = []
        self._settled: list[FloatArray] = []  # on disk

    def add(self, rows: FloatArray) -> None:
        """Take the rows (K, width) that come next."""
        self._loose.append(rows)
        self._size += rows.nbytes
        if self._size >= LARGE:
            self._settled.append(self._join(self._loose))
            self._loose, self._size = [], 0

    def join(self) -> FloatArray:
        """Return all rows (N, width), once."""
        return self._join([*self._settled, *self._loose])

    def _join(self, parts: list[FloatArray]) -> FloatArray:
        joined, filled = empty((sum(map(len, parts)), self._width)), 0
        for part in parts:
            joined[filled : filled + len(part)] = part
            filled += len(part)
            if joined.base is not None:
                release()
        return joined


def map_file(path: Path) -> NDArray[Any]:
    """Return the array of a ``.npy`` file, read-only; rows that are not read take no memory.

    Raises
    ------
    OSError, ValueError
        If it cannot be read or holds no array of numbers.
    """
    array: NDArray[Any] = np.load(path, mmap_mode="r", allow_pickle=False)
    if isinstance(array, np.memmap):
        _mapped.add(array._mmap)  # type: ignore[attr-defined]
    return array


def take(array: NDArray[Any], rows: NDArray[np.int64] | slice) -> NDArray[Any]:
    """Return ``array[rows]``; if the rows rise, little of the array is in memory at once."""
    if len(array) <= ROWS:
        return array[rows]
    if isinstance(rows, slice):
        rows = np.arange(len(array))[rows]
    if (np.diff(rows) < 0).any():
        return array[rows]
    taken = empty((len(rows), *array.shape[1:]), array.dtype.type)
    for block in blocks(len(array)):
        first, stop = np.searchsorted(rows, [block.start, block.stop])
        taken[first:stop] = array.take(rows[first:stop], axis=0)
    return taken


def release() -> None:
    """Take the pages of all arrays on disk out of the memory of this process; their values stay.

    Nothing is done where they are less than :data:`SPARED`.
    """
    mapped = list(_mapped)
    for memory in mapped if sum(map(len, mapped)) >= SPARED else ():
        if sys.platform != "win32" and hasattr(memory, "madvise"):
            memory.madvise(mmap.MADV_DONTNEED)


def blocks(count: int) -> Iterator[slice]:
    """Yield slices over so many rows; what was touched is released after each of a long record."""
    for first in range(0, count, ROWS):
        yield slice(first, min(first + ROWS, count))
        if count > LONG * ROWS:
            release()
