"""Records as bytes for another process: nothing in them can run.

A message is a text and a body. The text is JSON: words and numbers as they are, a record as its class and the
number of its rows, an array as its kind and shape. The body is all arrays as they lie in memory, each at a
multiple of :data:`ALIGNED` but for those of truth values. A record was checked when it was made; on arrival
it is put together as it was. A filter in pieces gets and gives some forty arrays at each piece: what is the
same of all records of a class is worked out once.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import fields
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bench.arrays import read_only
from bench.data import (
    Events,
    GnssFixes,
    GnssObservations,
    ImuData,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
)
from bench.fields import Record, columns_of
from bench.instruments import INSTRUMENTS
from bench.specs import AssumedSpecs

ALIGNED = 8
"""Every array begins at a multiple of this in the body [byte]."""

_KIND, _CONTENT = "=", "of"
"""Keys of the dictionary that stands for a record or an array; no other one has the first."""

_PADDING = bytes(ALIGNED)
_PLAIN = frozenset((int, float, str, bool, type(None)))


class _Plan:
    """How the records of a class are taken apart: columns, those of truth values last; then the rest."""

    def __init__(self, kind: type) -> None:
        declared = columns_of(kind) if issubclass(kind, Record) else {}
        numbers = sorted(
            (name for name, one in declared.items() if one.kind is not str),
            key=lambda name: declared[name].kind is bool,
        )
        self.kind = kind
        self.others = [f.name for f in fields(kind) if f.name not in numbers and f.name != _LEFT_OUT]
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
        """Return the columns of records whose widest have a width, and the size of a row [byte]."""
        if width not in self._known:
            found = []
            for name, kind, shape in self._shapes:
                row = tuple(width if n is None else n for n in shape)
                found.append(_RowColumn(name, kind, row, int(np.prod(row)), np.dtype(kind)))
            size = sum(one.numbers * (1 if one.kind is bool else ALIGNED) for one in found)
            self._known[width] = found, size
        return self._known[width]

    def give_empty(self, width: int) -> Any:
        """Return the record without rows and words; it can be the same each time."""
        if width not in self._empty:
            record: Any = object.__new__(self.kind)
            self._empty[width] = record
            for name, kind, shape, *_ in self.columns(width)[0]:
                object.__setattr__(record, name, read_only(np.empty((0, *shape), kind)))
            for name in self.others:
                object.__setattr__(record, name, ())
        return self._empty[width]


class _RowColumn(NamedTuple):
    """What a row of a record has in one column."""

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
    kind.__name__: _Plan(kind)
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


class RecordMessage:
    """A value on its way: its text, and its body in parts; of a record of others ``check`` its arrays."""

    def __init__(self, value: Any, *, check: bool = False) -> None:
        self._check = check
        self.parts: list[Any] = []  # arrays and bytes
        self.size = 0  # of the body [byte]
        self.text = _encode(self._take(value)).encode()

    def _take(self, value: Any) -> Any:
        kind = type(value)
        if kind in _PLAIN:
            return value
        if (plan := _PLANS.get(kind.__name__)) is not None and kind is plan.kind:
            rows, width, arrays, others, size = plan.take(value, self._check)
            if not rows and all(type(one) is tuple and not one for one in others):
                return {_KIND: kind.__name__, _CONTENT: [0, width]}
            self.parts += arrays
            self._pad(size)
            rest = (one if type(one) in _PLAIN else self._take(one) for one in others)
            return {_KIND: kind.__name__, _CONTENT: [rows, width, *rest]}
        if isinstance(value, np.ndarray):
            if value.dtype.hasobject:
                raise TypeError(f"an array of {value.dtype} is no array of numbers or words")
            self.parts.append(np.ascontiguousarray(value))
            self._pad(value.nbytes)
            return {_KIND: value.dtype.str, _CONTENT: value.shape}
        if isinstance(value, Mapping):
            return {str(key): self._take(inner) for key, inner in value.items()}
        if isinstance(value, list | tuple):
            return [self._take(inner) for inner in value]
        return value

    def _pad(self, size: int) -> None:
        self.size += size
        if over := size % ALIGNED:
            self.parts.append(_PADDING[over:])
            self.size += ALIGNED - over

    def write(self, path: Path) -> None:
        """Write the body to a new ``.npy`` file, an array of bytes, which `bench.disk_arrays.map_file` opens.

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
    """Return the value of a text and its body; its arrays are views of the body, as read-only as that is.

    Tuples outside records are lists.

    Parameters
    ----------
    text, body : bytes, array
        Of a :class:`RecordMessage`.
    specs : AssumedSpecs or None
        The datasheets of a record of sensors.

    Raises
    ------
    ValueError, TypeError
        If the text is none, or an array does not lie in the body.
    """
    return _Reader(body, specs).give(json.loads(text))


class _Reader:
    """Gives the arrays of a body in their order."""

    def __init__(self, body: NDArray[np.uint8], specs: AssumedSpecs | None) -> None:
        self._specs, self._place = specs, 0
        self._body, self._truths = body, body.view(np.bool_)
        self._numbers: dict[type, NDArray[Any]] = {float: body.view(np.float64), int: body.view(np.int64)}

    def give(self, value: Any) -> Any:
        if type(value) is dict:
            if (kind := value.get(_KIND)) is None:
                return {key: self.give(inner) for key, inner in value.items()}
            plan = _PLANS.get(kind)
            content = value[_CONTENT]
            return self._give_array(kind, content) if plan is None else self._give_record(plan, content)
        if type(value) is list:
            return [self.give(inner) for inner in value]
        return value

    def _give_record(self, plan: _Plan, content: list[Any]) -> Any:
        rows, width = content[0], content[1]
        if not rows and len(content) == 2:
            return plan.give_empty(width)
        record: Any = object.__new__(plan.kind)
        put = object.__setattr__
        place = self._place
        for name, kind, shape, count, _ in plan.columns(width)[0]:
            size = rows * count
            if kind is bool:
                array, place = self._truths[place : place + size], place + size
            else:
                first = place // ALIGNED
                array, place = self._numbers[kind][first : first + size], place + ALIGNED * size
            put(record, name, array.reshape(rows, *shape) if shape else array)
        self._place = place + -place % ALIGNED
        for name, value in zip(plan.others, content[2:], strict=True):
            if type(value) not in _PLAIN:
                value = tuple(value) if type(value) is list else self.give(value)
            put(record, name, value)
        if plan.kind is SensorData:
            put(record, _LEFT_OUT, self._specs)
        return record

    def _give_array(self, kind: str, shape: list[int]) -> NDArray[Any]:
        dtype = np.dtype(kind)
        if dtype.hasobject:
            raise ValueError(f"an array of {dtype} is no array of numbers or words")
        size = dtype.itemsize * math.prod(shape)
        array = self._body[self._place : self._place + size].view(dtype).reshape(shape)
        self._place += size + -size % ALIGNED
        return array


def _to_plain(value: Any) -> Any:
    if isinstance(value, np.generic):
        return value.item()
    return str(value)


_encode = json.JSONEncoder(default=_to_plain, separators=(",", ":")).encode
