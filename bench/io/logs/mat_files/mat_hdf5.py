"""Read MATLAB files of version 7.3 by h5py: numeric arrays, and structures of them.

MathWorks publishes only that they are HDF5 ("MAT-File Versions"); attributes and order are those in
``src/MAT_HDF5.jl`` of github.com/JuliaIO/MAT.jl. ``MATLAB_class`` names the class of a variable, a structure
is a group, dimensions are in reverse order, and with ``MATLAB_empty`` the numbers are the dimensions of an
empty array. Only numbers in the file are read: no links, no references, no data of other files.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files.memory_limit import limit_memory
from bench.core.words.exceptions import ConfigError

_NUMERIC = {f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)}
_NUMERIC |= {"double", "single", "logical"}
_FILTERS = {1, 2, 3}  # deflate, shuffle, Fletcher's check sum: those of MATLAB; others could load libraries
_MOST_VARIABLES = 100_000  # with the fields of structures
_REFERENCES = object()
"""A field without a class: a reference, as in an array of structures."""
_BESIDE = 256_000_000  # memory of the library beside the numbers [byte]


class TooLargeError(Exception):
    """The numbers of the file exceed their size limit."""


def read_hdf5(path: Path, most: int, deepest: int) -> dict[str, Any]:
    """Return the variables of a file by name: arrays as MATLAB shows them, structures by field, else None.

    Parameters
    ----------
    path : Path
        The file.
    most : int
        Largest size of the numbers, 8 bytes each [byte].
    deepest : int
        Levels of structures within structures.

    Raises
    ------
    ConfigError
        If h5py is missing, or the file is HDF5 of another program.
    TooLargeError
        If the numbers are larger than ``most``.
    ValueError
        If the file is broken.
    """
    try:
        import h5py
    except ModuleNotFoundError:
        text = "a MATLAB file of version 7.3 needs the package h5py: pip install h5py, or save it with -v7"
        raise ConfigError(f"{path.name}: {text}") from None
    try:
        with limit_memory(most + _BESIDE), h5py.File(path, "r", locking=False) as file:
            reader = _Reader(h5py, most, deepest)
            variables = reader.read_group(file, 0)
    except (TooLargeError, ConfigError):
        raise
    except MemoryError:
        raise TooLargeError from None
    except Exception as error:  # a broken file can make the library raise anything
        raise ValueError(str(error) or type(error).__name__) from None
    if not reader.classes:
        raise ConfigError(
            f"{path.name}: HDF5 without MATLAB_class, so not of MATLAB; save the columns as CSV or Parquet"
        )
    return variables


class _Reader:
    def __init__(self, h5py: Any, most: int, deepest: int) -> None:
        self._h5py, self._left, self._deepest = h5py, most, deepest
        self._count = self.classes = 0  # variables, and those with a class

    def read_group(self, group: Any, depth: int) -> dict[str, Any]:
        """Return the variables of a group by name."""
        found: dict[str, Any] = {}
        for name in group:
            self._count += 1
            if self._count > _MOST_VARIABLES:
                raise ValueError(f"more than {_MOST_VARIABLES} variables")
            hard = isinstance(group.get(name, getlink=True), self._h5py.HardLink)
            if hard and not name.startswith("#"):  # "#refs#": what cells refer to
                found[name] = self._read_value(group[name], depth)
        return found

    def _read_value(self, item: Any, depth: int) -> Any:
        kind = item.attrs.get("MATLAB_class", b"")
        name = kind.decode("ascii", "replace") if isinstance(kind, bytes) else ""
        self.classes += bool(name)
        if isinstance(item, self._h5py.Group):
            if name != "struct" or depth >= self._deepest:
                return None
            fields = self.read_group(item, depth + 1)
            return None if any(value is _REFERENCES for value in fields.values()) else fields
        if not isinstance(item, self._h5py.Dataset) or name not in _NUMERIC:
            return None if name or not depth else _REFERENCES
        return self._read_numbers(item)

    def _read_numbers(self, item: Any) -> Any:
        made = item.id.get_create_plist()
        filters = {made.get_filter(k)[0] for k in range(made.get_nfilters())}
        if item.is_virtual or item.external or item.shape is None or item.dtype.kind not in "fiu":
            return None  # complex numbers have two parts
        if not filters <= _FILTERS:
            raise ValueError(f"{item.name!r} is packed by a filter that MATLAB does not have")
        self._left -= 8 * math.prod(item.shape)
        if self._left < 0:
            raise TooLargeError
        numbers = np.asarray(item.astype("f8")[()]).T
        if item.attrs.get("MATLAB_empty", 0):
            shape = tuple(int(n) for n in numbers.ravel()[:32])
            if math.prod(shape) or min(shape, default=-1) < 0:
                raise ValueError(f"{item.name!r} is marked as empty and is not")
            numbers = np.empty(shape)
        return numbers.reshape(-1) if numbers.ndim == 2 and 1 in numbers.shape else numbers
