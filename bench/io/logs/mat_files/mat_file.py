"""Read MATLAB files of version 5 to 7.3: numeric arrays, and structures of them.

scipy is not used, because a manipulated file can crash its compiled reader. The format is described in
"MAT-File Format", MathWorks: elements with a tag (type, length) and data, possibly compressed with zlib.
"""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import is_hdf5
from bench.io.logs.mat_files.mat_hdf5 import TooLargeError, read_hdf5

MOST_BYTES = 1_000_000_000
"""Largest size of a file, and of its compressed variables when unpacked [byte]."""
_BLOCK = 1 << 16  # read and unpacked at a time [byte]
_VARIABLE = 256  # that an array takes in memory beside its numbers [byte]
_SHORT, _NAMES = 1024, 1_000_000  # longest name or shape of an array, and names of fields [byte]
_DEEPEST = 4  # levels of structures within structures
_MATRIX, _PACKED = 14, 15
_NOTHING = (0, 0)  # in the place of an element that is not there
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
        If the file is not a MATLAB file, is broken, or is too large when unpacked.
    """
    shown = path.name
    variables: dict[str, Value] = {}
    try:
        check_file(path, shown, MOST_BYTES)
        with path.open("rb") as file:
            if is_hdf5(file.read(1024)):
                return read_hdf5(path, MOST_BYTES, _DEEPEST)
            file.seek(0)
            head = file.read(128)
            if not head.startswith(b"MATLAB 5.0") or head[126:] not in (b"IM", b"MI"):
                raise ConfigError(f"{shown}: not a MATLAB file of version 5 to 7.3")
            whole = _MatBytes(iter(partial(file.read, _BLOCK), b""), "<" if head[126:] == b"IM" else ">")
            left: float = MOST_BYTES
            for kind, size in whole.elements(path.stat().st_size - len(head)):
                if kind == _MATRIX:
                    variables.update([_read_array(whole, size, 0)])
                elif kind == _PACKED:
                    inner = _MatBytes(_unpack(whole, size), whole.order, left)
                    for kind_inside, size_inside in inner.elements(math.inf):
                        if kind_inside == _MATRIX:
                            variables.update([_read_array(inner, size_inside, 0)])
                    left = inner.left
    except TooLargeError:
        raise ConfigError(f"{shown}: larger than {MOST_BYTES // 1_000_000} MB when unpacked") from None
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


class _MatBytes:
    """The bytes of a file or of a packed variable in their order, with the elements among them."""

    def __init__(self, blocks: Iterator[bytes], order: str, left: float = math.inf) -> None:
        self._blocks, self._block, self._at = blocks, memoryview(b""), 0
        self.order = order  # of the bytes of a number
        self.left = left  # that what is read may still take in memory [byte]

    def spend(self, size: int) -> None:
        """Take from what is left [byte]; raise `TooLargeError` at its end."""
        self.left -= size
        if self.left < 0:
            raise TooLargeError

    def read(self, count: int) -> bytes:
        """Return the next bytes; fewer at the end."""
        parts: list[memoryview] = []
        while count > 0:
            if not self._block:
                self._block = memoryview(next(self._blocks, b""))
                self.spend(len(self._block))
                if not self._block:
                    break
            parts.append(self._block[:count])
            self._block = self._block[count:]
            count, self._at = count - len(parts[-1]), self._at + len(parts[-1])
        return b"".join(parts)

    def elements(self, size: float) -> Iterator[tuple[int, int]]:
        """Yield type and length of each element in the next bytes; its data may be read before the next."""
        end = self._at + size
        while self._at + 8 <= end and len(tag := self.read(4)) == 4:
            kind = int.from_bytes(tag, "little" if self.order == "<" else "big")
            if kind >> 16:  # small element: length, type and four bytes of data
                kind, length, step = kind & 0xFFFF, kind >> 16, 4
                if length > 4:
                    raise ValueError("a small element is too long")
            else:
                length = int.from_bytes(self.read(4), "little" if self.order == "<" else "big")
                step = length + (-length % 8 if kind != _PACKED else 0)
            if self._at + length > end:
                raise ValueError("an element is longer than its variable")
            after = min(self._at + step, end)
            yield kind, length
            while self._at < after and self.read(min(_BLOCK, int(after) - self._at)):
                pass

    def read_numbers(self, element: tuple[int, int], most: int) -> np.ndarray[Any, Any]:
        """Return the numbers of an element that is not longer than ``most``."""
        if element[1] > most:
            raise ValueError("an element is too long")
        stored, count = self._look_at(element)
        return self._read_block(stored, count)

    def read_floats(self, element: tuple[int, int], count: int, name: str) -> FloatArray:
        """Return the numbers of an element, of which there must be ``count``, in blocks."""
        stored, there = self._look_at(element)
        if count != there:
            raise ValueError(f"{name!r} holds {there} numbers, not {count}")
        self.spend(max(0, 8 - stored.itemsize) * count)
        numbers = np.empty(count)
        for k in range(0, count, _BLOCK):
            rows = slice(k, min(k + _BLOCK, count))
            numbers[rows] = self._read_block(stored, rows.stop - k)
        return numbers

    def _look_at(self, element: tuple[int, int]) -> tuple[np.dtype[Any], int]:
        kind, length = element
        if kind not in _NUMBERS:
            raise ValueError(f"an element of type {kind} does not contain numbers")
        stored = np.dtype(self.order + _NUMBERS[kind])
        return stored, length // stored.itemsize

    def _read_block(self, stored: np.dtype[Any], count: int) -> np.ndarray[Any, Any]:
        data = self.read(count * stored.itemsize)
        if len(data) < count * stored.itemsize:
            raise ValueError("an element is longer than its variable")
        return np.frombuffer(data, stored)


def _unpack(source: _MatBytes, size: int) -> Iterator[bytes]:
    """Yield the content of a packed element in blocks."""
    unpacker, data = zlib.decompressobj(), b""
    while not unpacker.eof:
        if not data and size:
            data = source.read(min(size, _BLOCK))
            size = size - len(data) if data else 0
        block = unpacker.decompress(data, _BLOCK)
        data = unpacker.unconsumed_tail
        if block:
            yield block
        elif not data and not size:  # it is cut off
            return


def _read_array(source: _MatBytes, size: int, depth: int) -> tuple[str, Value]:
    """Return the name and the value of an array."""
    if not size:
        return "", None
    source.spend(_VARIABLE)
    parts = source.elements(size)
    flags = source.read_numbers(next(parts, _NOTHING), _SHORT)
    if len(flags) < 1:
        raise ValueError("an array has no flags")
    kind, marks = int(flags[0]) & 0xFF, int(flags[0])
    if kind > 15:  # a class outside this format, such as a function
        return "", None
    shape = tuple(int(n) for n in source.read_numbers(next(parts, _NOTHING), _SHORT))
    if not 2 <= len(shape) <= 32 or min(shape) < 0:
        raise ValueError("an array has no size")
    letters = source.read_numbers(next(parts, _NOTHING), _SHORT)
    name = bytes(letters.astype(np.uint8)).decode("utf-8", "replace")
    if kind in _NUMERIC and not marks & _COMPLEX:
        numbers = source.read_floats(next(parts, _NOTHING), math.prod(shape), name)
        return name, _squeeze(numbers.reshape(shape, order="F"))
    if kind == _STRUCTURE and shape == (1, 1) and depth < _DEEPEST:
        return name, _read_structure(source, parts, depth)
    return name, None


def _read_structure(source: _MatBytes, parts: Iterator[tuple[int, int]], depth: int) -> dict[str, Any]:
    width = source.read_numbers(next(parts, _NOTHING), _SHORT)
    if len(width) != 1 or not 1 <= int(width[0]) <= 64:
        raise ValueError("a structure has no field names")
    letters = bytes(source.read_numbers(next(parts, _NOTHING), _NAMES).astype(np.uint8))
    length = int(width[0])
    names = [
        letters[k : k + length].split(b"\0")[0].decode("utf-8", "replace")
        for k in range(0, len(letters), length)
    ]
    values = [_read_array(source, size, depth + 1)[1] for kind, size in parts if kind == _MATRIX]
    if len(names) != len(values):
        raise ValueError("a structure has more names than fields, or fewer")
    return dict(zip(names, values, strict=True))


def _squeeze(array: FloatArray) -> FloatArray:
    return array.reshape(-1) if array.ndim == 2 and 1 in array.shape else array
