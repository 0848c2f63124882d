"""Read MATLAB files of version 5 to 7: numeric arrays, and structures of them.

scipy is not used, because a manipulated file can crash its compiled reader. The format is described in
"MAT-File Format", MathWorks: elements with a tag (type, length) and data, possibly compressed with zlib.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.files import check_file

MOST_BYTES = 1_000_000_000
"""Largest size of a file, and of its compressed variables when unpacked [byte]."""
_DEEPEST = 4  # levels of structures within structures
_MATRIX, _PACKED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
"""Type of an element -> type of its numbers (table 1-1)."""
_STRUCTURE, _NUMERIC, _COMPLEX = 2, range(6, 16), 0x0800  # array classes and a flag (table 1-3, figure 1-4)

Value = FloatArray | dict[str, Any] | None
"""An array of numbers; a structure, by field; None for anything else."""


def read_mat(path: Path) -> dict[str, Value]:
    """Return the variables of a MATLAB file by name; row and column vectors are one-dimensional.

    Raises
    ------
    ConfigError
        If the file is not a MATLAB file, is of version 7.3, is broken, or is too large when unpacked.
    """
    shown = path.name
    variables: dict[str, Value] = {}
    try:
        check_file(path, shown, MOST_BYTES)
        content = memoryview(path.read_bytes())
        head = bytes(content[:128])
        if head[:8] == b"\x89HDF\r\n\x1a\n" or b"MATLAB 7.3" in head:
            raise ConfigError(f"{shown}: a MATLAB file of version 7.3 is not read; save it with -v7")
        if not head.startswith(b"MATLAB 5.0") or head[126:] not in (b"IM", b"MI"):
            raise ConfigError(f"{shown}: not a MATLAB file of version 5 to 7")
        order = "<" if head[126:] == b"IM" else ">"
        left = MOST_BYTES
        for kind, data in _split_elements(content[128:], order):
            elements = iter([(kind, data)])
            if kind == _PACKED:
                unpacked = zlib.decompressobj().decompress(data, left + 1)
                elements = _split_elements(memoryview(unpacked), order)
                left -= len(unpacked)
            if left < 0:
                raise ConfigError(f"{shown}: larger than {MOST_BYTES // 1_000_000} MB when unpacked")
            arrays = (_read_array(array, order, 0) for kind, array in elements if kind == _MATRIX)
            variables.update(arrays)
    except (ValueError, OverflowError, MemoryError, zlib.error) as error:
        raise ConfigError(f"{shown}: cannot be read: {' '.join(str(error).split())[:200]}") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    return variables


def list_structures(variables: Mapping[str, Value], place: str = "") -> dict[str, dict[str, Any]]:
    """Return the structures of a file, those within others too, by name: ``flight.imu1``."""
    found: dict[str, dict[str, Any]] = {}
    for name, value in variables.items():
        if isinstance(value, dict):
            found |= {f"{place}{name}": value, **list_structures(value, f"{place}{name}.")}
    return found


def find_structure(variables: Mapping[str, Value], name: str, shown: str) -> dict[str, Any]:
    """Return the structure with a name; ``imu1`` is also ``flight.imu1`` where only one has it.

    Raises
    ------
    ConfigError
        If no structure has the name, or more than one has and none of them in full.
    """
    structures = list_structures(variables)
    if name in structures:
        return structures[name]
    fitting = [whole for whole in structures if whole.endswith(f".{name}")]
    if len(fitting) == 1:
        return structures[fitting[0]]
    if fitting:
        listed = ", ".join(sorted(fitting))[:300]
        raise ConfigError(f"{shown}: more than one structure {name!r}: {listed}; name one in full")
    holding = sorted(
        whole for whole, fields in structures.items() if any(not isinstance(v, dict) for v in fields.values())
    )
    raise ConfigError(f"{shown}: no structure {name!r}; there are {', '.join(holding)[:300] or 'none'}")


def get_vector(value: Value, name: str, shown: str) -> FloatArray:
    """Return a variable as a vector (N,); raise ConfigError if it is not one."""
    if not isinstance(value, np.ndarray) or value.ndim > 1:
        kind = "not numeric"
        if value is not None:
            kind = f"of shape {value.shape}" if isinstance(value, np.ndarray) else "a structure"
        raise ConfigError(f"{shown}: {name!r} must be a vector of numbers; it is {kind}")
    return np.atleast_1d(value)


def _split_elements(data: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and data of each element."""
    at = 0
    while at + 8 <= len(data):
        kind, size = (int(x) for x in np.frombuffer(data[at : at + 8], f"{order}u4", 2))
        if kind >> 16:  # small element: length, type and four bytes of data
            kind, size, begin, step = kind & 0xFFFF, kind >> 16, at + 4, 8
            if size > 4:
                raise ValueError("a small element is too long")
        else:
            begin, step = at + 8, 8 + size + (-size % 8 if kind != _PACKED else 0)
        if begin + size > len(data):
            raise ValueError("an element is longer than its variable")
        yield kind, data[begin : begin + size]
        at += step


def _read_array(data: memoryview, order: str, depth: int) -> tuple[str, Value]:
    """Return the name and the value of an array."""
    if not len(data):
        return "", None
    parts = _split_elements(data, order)
    flags = _take_numbers(parts, order)
    if len(flags) < 1:
        raise ValueError("an array has no flags")
    kind, marks = int(flags[0]) & 0xFF, int(flags[0])
    if kind > 15:  # a class outside this format, such as a function
        return "", None
    shape = tuple(int(n) for n in _take_numbers(parts, order))
    if not 2 <= len(shape) <= 32 or min(shape) < 0:
        raise ValueError("an array has no size")
    name = bytes(_take_numbers(parts, order).astype(np.uint8)).decode("utf-8", "replace")
    if kind in _NUMERIC:
        numbers = _take_numbers(parts, order)
        if marks & _COMPLEX:
            return name, None
        count = 1
        for n in shape:
            count *= n
        if count != len(numbers):
            raise ValueError(f"{name!r} holds {len(numbers)} numbers, not {count}")
        return name, _squeeze(numbers.astype(np.float64).reshape(shape, order="F"))
    if kind == _STRUCTURE and shape == (1, 1) and depth < _DEEPEST:
        return name, _read_structure(parts, order, depth)
    return name, None


def _read_structure(parts: Iterator[tuple[int, memoryview]], order: str, depth: int) -> dict[str, Any]:
    width = _take_numbers(parts, order)
    if len(width) != 1 or not 1 <= int(width[0]) <= 64:
        raise ValueError("a structure has no field names")
    letters, length = bytes(_take_numbers(parts, order).astype(np.uint8)), int(width[0])
    names = [
        letters[k : k + length].split(b"\0")[0].decode("utf-8", "replace")
        for k in range(0, len(letters), length)
    ]
    values = [_read_array(data, order, depth + 1)[1] for kind, data in parts if kind == _MATRIX]
    if len(names) != len(values):
        raise ValueError("a structure has more names than fields, or fewer")
    return dict(zip(names, values, strict=True))


def _take_numbers(parts: Iterator[tuple[int, memoryview]], order: str) -> np.ndarray[Any, Any]:
    """Return the numbers of the next element."""
    kind, data = next(parts, (0, memoryview(b"")))
    if kind not in _NUMBERS:
        raise ValueError(f"an element of type {kind} does not hold numbers")
    stored = np.dtype(order + _NUMBERS[kind])
    return np.frombuffer(data[: len(data) // stored.itemsize * stored.itemsize], stored)


def _squeeze(array: FloatArray) -> FloatArray:
    return array.reshape(-1) if array.ndim == 2 and 1 in array.shape else array
