"""Records as bytes for another process, without any executable content.

A message is a text and a body. The text is JSON: words as they are, a record as its class and the number of
its rows, an array as its kind and shape. The body is all numbers and arrays as they lie in memory, each at a
multiple of :data:`ALIGNED` but for columns of truth values. A record was checked when it was made; on arrival
it is put together as it was. A filter in pieces gets and gives some forty arrays at each piece, and one text
serves many pieces: what follows from it is worked out once.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable, Mapping
from dataclasses import fields
from functools import lru_cache
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import read_only
from bench.core.records.data import (
    Events,
    GnssFixes,
    GnssObservations,
    ImuData,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
)
from bench.core.records.fields import Record, columns_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import AssumedSpecs

ALIGNED = 8
"""Every array begins at a multiple of this in the body [byte]."""

_RECORD, _ARRAY, _MAPPING, _LIST, _WORD_LIST = "record", "array", "mapping", "list", "words"
_FLOAT, _INT = ("float",), ("int",)
"""What the lists of the text begin with."""

_PADDING = bytes(ALIGNED)
_WORDS = frozenset((str, bool, type(None)))
_LARGEST = 1 << 63  # an integer beyond it goes as its digits
_REPEATED = 1 << 12  # a smaller text or body may come again [byte]
_pack_float, _pack_int = struct.Struct("<d").pack, struct.Struct("<q").pack


class _RecordLayout:
    """Layout for packing the records of a class: columns, truth values last; then the other fields."""

    def __init__(self, kind: type) -> None:
        declared = columns_of(kind) if issubclass(kind, Record) else {}
        numbers = sorted(
            (name for name, one in declared.items() if one.kind is not str),
            key=lambda name: declared[name].kind is bool,
        )
        self.kind = kind
        self.others = [f.name for f in fields(kind) if f.name not in numbers and f.name != _LEFT_OUT]
        self.put = {f.name: getattr(kind, f.name).__set__ for f in fields(kind)}  # past what is frozen
        self._shapes = [(name, declared[name].kind, declared[name].shape) for name in numbers]
        self._numbers, self._others = _make_getter(numbers), _make_getter(self.others)
        self._first = numbers[0] if numbers else None
        self._widest = next((name for name, _, shape in self._shapes if None in shape), None)
        self._known: dict[int, tuple[list[_RowColumn], int]] = {}
        self._empty: dict[int, Any] = {}

    def take(self, record: Any, check: bool) -> tuple[int, int, tuple[Any, ...], tuple[Any, ...], int]:
        """Return rows and width of a record, its arrays, the rest, and the size of the arrays [byte].

        ``check`` raises TypeError if an array is not what it was when the record was made.
        """
        rows = 0 if self._first is None else len(getattr(record, self._first))
        width = 0 if self._widest is None else getattr(record, self._widest).shape[1]
        (columns, size), arrays = self.columns(width), self._numbers(record)
        if check:
            for (name, kind, _, count, dtype), array in zip(columns, arrays, strict=True):
                if array.dtype != dtype or array.size != rows * count:
                    raise TypeError(
                        f"{self.kind.__name__}.{name} is not {rows} rows of {kind.__name__} any more"
                    )
        return rows, width, arrays, self._others(record), rows * size

    def columns(self, width: int) -> tuple[list[_RowColumn], int]:
        """Return the columns of records of a given greatest width, and the size of a row [byte]."""
        if width not in self._known:
            found = []
            for name, kind, shape in self._shapes:
                row = tuple(width if n is None else n for n in shape)
                found.append(_RowColumn(name, kind, row, int(np.prod(row)), np.dtype(kind)))
            size = sum(one.numbers * (1 if one.kind is bool else ALIGNED) for one in found)
            self._known[width] = found, size
        return self._known[width]

    def give_empty(self, width: int) -> Any:
        """Return the shared record without rows and words."""
        if width not in self._empty:
            record: Any = object.__new__(self.kind)
            self._empty[width] = record
            for name, kind, shape, *_ in self.columns(width)[0]:
                self.put[name](record, read_only(np.empty((0, *shape), kind)))
            for name in self.others:
                self.put[name](record, ())
        return self._empty[width]


class _RowColumn(NamedTuple):
    """Value of one column in a row of a record."""

    name: str
    kind: type
    shape: tuple[int, ...]
    numbers: int
    dtype: np.dtype[Any]


def _make_getter(names: list[str]) -> Any:
    """Return a function that returns the attributes of a record as a tuple."""
    if len(names) > 1:
        return attrgetter(*names)
    return (lambda record: (getattr(record, names[0]),)) if names else (lambda record: ())


_LEFT_OUT = "specs"  # of a record of sensors: it changes less often than the record, and is given apart

_PLANS = {
    kind.__name__: _RecordLayout(kind)
    for kind in (
        Events,
        GnssFixes,
        GnssObservations,
        ImuData,
        InitialState,
        Innovations,
        NavSolution,
        SensorData,
        *(row.record for row in INSTRUMENTS.values()),
    )
}


_COLUMNS = {float: 0, int: 1, bool: 2}  # of `_Views.columns`
_NUMBERS = {_FLOAT[0]: 0, _INT[0]: 1}


class RecordMessage:
    """A value as a message: text, and body in parts; ``check`` the arrays of foreign records."""

    def __init__(self, value: Any, *, check: bool = False) -> None:
        self._check = check
        self.parts: list[Any] = []  # arrays and bytes
        self.size = 0  # of the body [byte]
        tree = self._take(value)
        self.text = _write_text(tree) if self.size < _REPEATED else _write_text.__wrapped__(tree)

    def _take(self, value: Any) -> Any:
        """Return the text of a value; its arrays and numbers go into the body."""
        kind = type(value)
        if kind in _WORDS:
            return value
        if kind is float or (kind is int and -_LARGEST <= value < _LARGEST):
            self.parts.append(_pack_float(value) if kind is float else _pack_int(value))
            self.size += ALIGNED
            return _FLOAT if kind is float else _INT
        if kind is int:
            return value
        if (plan := _PLANS.get(kind.__name__)) is not None and kind is plan.kind:
            rows, width, arrays, others, size = plan.take(value, self._check)
            if not rows and all(type(one) is tuple and not one for one in others):
                return (_RECORD, kind.__name__, 0, width)
            self.parts += arrays
            self._pad(size)
            return (_RECORD, kind.__name__, rows, width, *map(self._take, others))
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise TypeError(f"an array of {value.dtype} is not an array of numbers or words")
            self.parts.append(np.ascontiguousarray(value))
            self._pad(value.nbytes)
            return (_ARRAY, value.dtype.str, *value.shape)
        if isinstance(value, Mapping):
            return (_MAPPING, *map(str, value), *map(self._take, value.values()))
        if isinstance(value, list | tuple):
            words = all(type(one) in _WORDS for one in value)
            return (_WORD_LIST, *value) if words else (_LIST, *map(self._take, value))
        return self._take(value.item() if isinstance(value, np.generic) else str(value))

    def _pad(self, size: int) -> None:
        self.size += size
        if over := size % ALIGNED:
            self.parts.append(_PADDING[over:])
            self.size += ALIGNED - over

    def write(self, path: Path) -> None:
        """Write the body to a new ``.npy`` file, an array of bytes, which
        `bench.core.files.disk_arrays.map_file` opens.

        Raises
        ------
        OSError
            If it cannot be written.
        """
        with path.open("xb") as file:
            head = {"descr": "|u1", "fortran_order": False, "shape": (self.size,)}
            np.lib.format.write_array_header_1_0(file, head)
            for part in self.parts:
                file.write(part)


def read_message(text: bytes, body: NDArray[np.uint8], specs: AssumedSpecs | None = None) -> Any:
    """Return the value of a text and its body; arrays are views of the body, read-only if the body is.

    Tuples outside records are lists.

    Parameters
    ----------
    text, body : bytes, array
        Of a :class:`RecordMessage`.
    specs : AssumedSpecs or None
        The datasheets of a record of sensors.

    Raises
    ------
    ValueError, TypeError, KeyError, IndexError
        If the text is none, or an array does not lie in the body.
    """
    give, size = _read_text(text) if len(text) < _REPEATED else _read_text.__wrapped__(text)
    if body.size != size:
        raise ValueError(f"the body has {body.size} bytes, the text says {size}")
    return give(_Views((body.view(np.float64), body.view(np.int64), body.view(np.bool_)), body, specs))


class _Views(NamedTuple):
    """Views of a body, and the additional data of its records."""

    columns: tuple[NDArray[Any], ...]
    body: NDArray[np.uint8]
    specs: AssumedSpecs | None


_Give = Callable[[_Views], Any]


@lru_cache(maxsize=256)
def _read_text(text: bytes) -> tuple[_Give, int]:
    """Return the function that builds the value of a text from its body, and the size of the body [byte]."""
    reader = _TextReader()
    give = reader.read(json.loads(text))
    return give, reader.place


class _TextReader:
    """Parser of a text that assigns a place in the body to every array."""

    def __init__(self) -> None:
        self.place = 0

    def read(self, tree: Any) -> _Give:
        """Return the function that builds the value of a part of the text."""
        if type(tree) is not list:
            return lambda views: tree
        mark, *content = tree
        if mark == _RECORD:
            return self._read_record(*content)
        if mark == _ARRAY:
            return self._read_array(*content)
        if mark == _WORD_LIST:
            return lambda views: list(content)
        if mark == _MAPPING:
            half = len(content) // 2
            parts = tuple(zip(content[:half], map(self.read, content[half:]), strict=True))
            return lambda views: {key: give(views) for key, give in parts}
        if mark == _LIST:
            gives = tuple(map(self.read, content))
            return lambda views: [give(views) for give in gives]
        return self._read_number(_NUMBERS[mark])

    def _read_number(self, column: int) -> _Give:
        index = self.place // ALIGNED
        self.place += ALIGNED
        return lambda views: views.columns[column].item(index)

    def _read_array(self, kind: str, *shape: int) -> _Give:
        dtype = np.dtype(kind)
        if dtype.hasobject:
            raise ValueError(f"an array of {dtype} is not an array of numbers or words")
        begin, size = self.place, dtype.itemsize * math.prod(shape)
        self._go_on(size)
        return lambda views: views.body[begin : begin + size].view(dtype).reshape(shape)

    def _read_record(self, kind: str, rows: int, width: int, *others: Any) -> _Give:
        plan = _PLANS[kind]
        if not rows and not others:
            return lambda views: plan.give_empty(width)
        begin, columns = self.place, []
        for name, kind_of, shape, count, _ in plan.columns(width)[0]:
            each = 1 if kind_of is bool else ALIGNED
            part = slice(begin // each, begin // each + rows * count)
            begin += rows * count * each
            columns.append((plan.put[name], _COLUMNS[kind_of], part, (rows, *shape) if shape else None))
        self._go_on(begin - self.place)
        rest = [(plan.put[name], self.read(one)) for name, one in zip(plan.others, others, strict=True)]
        put_specs = plan.put.get(_LEFT_OUT)

        def give(views: _Views) -> Any:
            record: Any = object.__new__(plan.kind)
            for put, column, part, shape in columns:
                array = views.columns[column][part]
                put(record, array if shape is None else array.reshape(shape))
            for put, inner in rest:
                value = inner(views)
                put(record, tuple(value) if type(value) is list else value)
            if put_specs is not None:
                put_specs(record, views.specs)
            return record

        return give

    def _go_on(self, size: int) -> None:
        if size < 0:
            raise ValueError("an array of less than no bytes")
        self.place += size + -size % ALIGNED


@lru_cache(maxsize=256)
def _write_text(tree: Any) -> bytes:
    return json.dumps(tree, separators=(",", ":")).encode()
