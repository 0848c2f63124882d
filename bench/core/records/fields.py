"""Declarations of the fields of records and specs: columns with unit and frame, figures with unit and limits.

A record is a frozen set of columns, one row per time. Each field declares the shape of a row, its unit
and its frame; checks, files and exports are made from that. A spec holds the figures of a datasheet or a
profile in SI; each figure declares its unit and limits in a file, and the tables of files are made from that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields, is_dataclass
from functools import cache, partial
from types import MappingProxyType
from typing import Any, ClassVar, TypeVar, dataclass_transform

import numpy as np

from bench.core.mathematics.arrays import Shape, as_float, as_kind, is_array, is_short_and_finite, read_only
from bench.core.mathematics.units import unit_of

_T = TypeVar("_T")

NED, XYZ = ("n", "e", "d"), ("x", "y", "z")
_SHOWN = 6  # numbers of an array that a repr shows
_WIDTH = 80  # characters of a value that a repr shows


@dataclass(frozen=True, slots=True)
class Column:
    """The columns of a file that hold one field of a record, in the order of its flattened rows."""

    names: tuple[str, ...]  # each ends in its unit; empty if their number depends on the record
    units: tuple[str, ...] = ()
    frame: str = ""
    shape: tuple[int | None, ...] = ()  # of one row; None: any length, equal in all such fields
    kind: type = float  # or bool, int, str


@dataclass(frozen=True, slots=True)
class Figure:
    """Key, unit, limits and default of one figure of a spec in a file."""

    unit: str  # ending of its key; empty for a number without a unit
    low: float  # in the unit of the file
    high: float
    reciprocal: bool = False  # the file gives a length or a time, the spec holds its inverse
    reported: bool = False  # the instrument reports it and a filter divides by it: it must be above 0
    default: float | None = None  # in SI; None: required
    stem: str = ""  # beginning of its key; empty: the name of the field
    error: str = ""  # that it describes, in words

    def key(self, name: str) -> str:
        """Return the key in the file of the field ``name``."""
        return f"{self.stem or name}_{self.unit}" if self.unit else self.stem or name


@dataclass(frozen=True, slots=True)
class TriadFigure:
    """Keys and units of a figure of three gyros or three accelerometers, and the error that it describes."""

    gyro: tuple[str, ...]  # units its key may end in; empty: gyros do not have this figure
    accel: tuple[str, ...]  # the same for accelerometers
    key: str  # beginning of its key; empty: the name of the field
    sought: str  # name of the figure on a datasheet; several figures may share it
    error: str  # name of the error if a filter does not model it; empty: white noise and biases
    by_axis: bool  # its axes may differ

    def keys(self, name: str, triad: str) -> list[str]:
        """Return the possible keys of the field ``name`` in the table "gyro" or "accel"."""
        endings: tuple[str, ...] = getattr(self, triad)
        return [f"{self.key or name}_{ending}" for ending in endings]


def column(
    *names: str,
    frame: str = "",
    shape: tuple[int | None, ...] = (),
    kind: type = float,
    units: tuple[str, ...] | None = None,
    default: Any = MISSING,
) -> Any:
    """Declare a field of a record by the names of its columns, each ending in its unit.

    Parameters
    ----------
    names : str
        One for each number of a row.
    frame : str
        Frame in which the values are resolved.
    shape : tuple of int or None
        Shape of one row.
    kind : type
        float, bool, int or str.
    units : tuple of str or None
        Units, if no name can end in them; None: from the endings of the names.
    default : object
        Default of the field; without it the field is required.
    """
    if units is None:
        units = tuple(unit_of(name) or "1" for name in names)
    return field(default=default, metadata={"column": Column(names, units, frame, shape, kind)})


def vector(stem: str, unit: str, frame: str, *, units: tuple[str, ...] | None = None) -> Any:
    """Declare a field with three components: north, east, down in frame n, otherwise x, y, z."""
    axes = NED if frame == "n" else XYZ
    return column(*(f"{stem}_{axis}_{unit}" for axis in axes), frame=frame, shape=(3,), units=units)


def matrix(states: tuple[tuple[str, str], ...], frame: str) -> Any:
    """Declare a covariance of states (name, unit); each element is named by its two states."""
    names = tuple(f"cov_{a}_{b}" for a, _ in states for b, _ in states)
    units = tuple(f"{u} {v}" if u != v else f"({u})^2" for _, u in states for _, v in states)
    return column(*names, frame=frame, shape=(len(states), len(states)), units=units)


def figure(
    unit: str = "",
    low: float = 0.0,
    high: float = 1e6,
    *,
    default: Any = MISSING,
    reciprocal: bool = False,
    reported: bool = False,
    stem: str = "",
    error: str = "",
) -> Any:
    """Declare a figure of a spec: the unit at the end of its key, and its limits in that unit.

    ``default`` is in SI. No real instrument has a figure above 1e6 in any of these units.
    """
    fallback = None if default is MISSING else default
    declaration = Figure(unit, low, high, reciprocal, reported, fallback, stem, error)
    return field(default=default, metadata={"figure": declaration})


def triad_figure(
    gyro: tuple[str, ...] = (),
    accel: tuple[str, ...] = (),
    *,
    default: float,
    key: str = "",
    sought: str = "",
    error: str = "",
    by_axis: bool = False,
) -> Any:
    """Declare a figure of a triad, see :class:`TriadFigure`; 0 means that the triad has no such error."""
    return field(default=default, metadata={"triad": TriadFigure(gyro, accel, key, sought, error, by_axis)})


@dataclass_transform(
    frozen_default=True, field_specifiers=(column, vector, matrix, figure, triad_figure, field)
)
def declared(cls: type[_T]) -> type[_T]:
    """Make a frozen dataclass from a class with declared fields; a record of columns has its own repr."""
    return dataclass(frozen=True, slots=True, repr=not issubclass(cls, Record))(cls)


class Rebuilt:
    """Base of records that are pickled by their fields, so that a copy is checked and read-only as well."""

    __slots__: tuple[str, ...] = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __reduce__(self) -> tuple[Callable[[], Any], tuple[()]]:
        return partial(type(self), **{f.name: getattr(self, f.name) for f in fields(self)}), ()

    def __repr__(self) -> str:
        """Return a line for each field: rows and span of a record, the shape of an array, a short value."""
        lines = [f"  {f.name}: {describe_field(getattr(self, f.name))}" for f in fields(self)]
        return "\n".join([f"<{type(self).__name__}", *lines]) + ">"


class Record(Rebuilt):
    """Base of records of columns with equal length: read-only, in C order, checked for shape and type."""

    __slots__: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self._freeze()

    def _freeze(
        self, *, finite: bool = False, width: int | None = None, besides: Mapping[str, Shape] | None = None
    ) -> None:
        """Replace each column by a checked, read-only view.

        Parameters
        ----------
        finite : bool
            Reject NaN and infinity.
        width : int or None
            Length of the rows that are declared with any length.
        besides : mapping or None
            Full shape of the fields with another number of rows.

        Raises
        ------
        ValueError
            If a column has the wrong shape or type, or the columns differ in length.
        """
        besides = besides or {}
        for name, kind, shape in _frozen(type(self), width):
            freeze_field(self, name, kind, besides.get(name, shape), finite=finite)
        names = columns_of(type(self))
        if len({len(getattr(self, name)) for name in names if name not in besides}) > 1:
            rows = {name: len(getattr(self, name)) for name in names if name not in besides}
            raise ValueError(f"{type(self).__name__}: columns differ in length: {rows}")

    def __len__(self) -> int:
        return len(getattr(self, _first_column(type(self))))

    def __repr__(self) -> str:
        """Return the number of rows, their span, and the columns with their units."""
        columns = (
            f"{name} [{', '.join(dict.fromkeys(one.units))}]" if one.units else name
            for name, one in columns_of(type(self)).items()
        )
        return f"<{type(self).__name__}: {self._describe_rows()}; {', '.join(columns)}>"

    def _describe_rows(self) -> str:
        t: Any = getattr(self, "t", ())
        span = f", t = {t[0]:g} to {t[-1]:g} s" if len(t) else ""
        return f"{len(self)} row{'' if len(self) == 1 else 's'}{span}"


def _find_frozen(record: type, width: int | None) -> tuple[tuple[str, type, Shape], ...]:
    """Return name, kind and shape of the columns of a record that are no text."""
    return tuple(
        (name, one.kind, (None, *(width if n is None else n for n in one.shape)))
        for name, one in columns_of(record).items()
        if one.kind is not str
    )


_frozen: Callable[[type, int | None], tuple[tuple[str, type, Shape], ...]] = cache(_find_frozen)


_DTYPES: dict[type, np.dtype[Any]] = {kind: np.dtype(kind) for kind in (float, int, bool)}


def freeze_field(record: object, name: str, kind: type, shape: Shape, *, finite: bool = False) -> None:
    """Replace a field of a frozen record by a checked, read-only view.

    Raises
    ------
    ValueError
        If the shape or type is wrong or, with ``finite``, a value is not finite.
    """
    value = getattr(record, name)
    if is_array(value, _DTYPES[kind], shape) and (not finite or is_short_and_finite(value)):
        if value.flags.writeable:
            object.__setattr__(record, name, read_only(value))
        return
    place = f"{type(record).__name__}.{name}"
    array: np.ndarray[Any, Any] = (
        as_float(place, value, shape, finite=finite)
        if kind is float
        else as_kind(place, value, np.dtype(kind).type, shape)
    )
    object.__setattr__(record, name, read_only(array))


def describe_field(value: object) -> str:
    """Return a value of a record in at most a line: the rows of a record, the shape of a long array."""
    if isinstance(value, Record):
        return f"{type(value).__name__}, {value._describe_rows()}"
    if isinstance(value, Rebuilt):
        present = (f.name for f in fields(value) if getattr(value, f.name) is not None)
        return f"{type(value).__name__} with {', '.join(present)}"
    if isinstance(value, np.ndarray) and value.size > _SHOWN:
        return f"array {value.shape}"
    if is_dataclass(value) and hasattr(value, "name"):
        return f"{type(value).__name__} {value.name!r}"
    text = " ".join(repr(value).split())
    return text if len(text) <= _WIDTH else f"{type(value).__name__} (...)"


def columns_of(record: type) -> Mapping[str, Column]:
    """Return the declared columns of a record, by name of the field."""
    return _columns(record)


def _find_columns(record: Any) -> Mapping[str, Column]:
    found = {f.name: f.metadata["column"] for f in fields(record) if "column" in f.metadata}
    return MappingProxyType(found)


_columns: Callable[[type], Mapping[str, Column]] = cache(_find_columns)
_first_column: Callable[[type], str] = cache(lambda record: next(iter(columns_of(record))))


def figures_of(spec: type) -> dict[str, Figure]:
    """Return the declared figures of a spec, by name of the field."""
    return {f.name: f.metadata["figure"] for f in fields(spec) if "figure" in f.metadata}


def triad_figures_of(spec: type) -> dict[str, TriadFigure]:
    """Return the declared figures of a triad, by name of the field."""
    return {f.name: f.metadata["triad"] for f in fields(spec) if "triad" in f.metadata}
