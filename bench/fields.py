"""How records and specs declare their fields: a column with its unit and frame, a figure with its limits.

A record is a frozen set of columns, one row per instant. Each field says the shape of a row, its unit and its
frame; checks, files and exports follow from that. A spec is what a datasheet or a profile asks for, in SI;
each figure says the unit and the limits it has in a file, and the tables of the files follow from that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import MISSING, dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, TypeVar, dataclass_transform

import numpy as np

from bench.arrays import Shape, as_float, as_kind
from bench.units import unit_of

_T = TypeVar("_T")

NED, XYZ = ("n", "e", "d"), ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Column:
    """How one field of a record lies in columns of a file, in the order of its flattened rows."""

    names: tuple[str, ...]  # each ends in its unit; none when the record itself says how many there are
    units: tuple[str, ...] = ()
    frame: str = ""
    shape: tuple[int | None, ...] = ()  # of one row; None: the same length in all such fields of the record
    kind: type = float  # or bool, int, str


@dataclass(frozen=True, slots=True)
class Figure:
    """How one figure of a spec stands in a file."""

    unit: str  # ending of its key; empty for a number without a unit
    low: float
    high: float
    reciprocal: bool = False  # the file gives a length or a time, the spec its inverse
    reported: bool = False  # the unit reports it and a filter divides by it: it must be above 0
    default: float | None = None  # in SI; None: it has to be given

    def key(self, name: str) -> str:
        """Return the key of the file for the field of a spec."""
        return f"{name}_{self.unit}" if self.unit else name


@dataclass(frozen=True, slots=True)
class TriadFigure:
    """How a figure of three gyros or three accelerometers stands in a datasheet, and the error it is."""

    gyro: tuple[str, ...]  # endings its key may have, by the unit of the datasheet; none: gyros have none
    accel: tuple[str, ...]
    key: str  # beginning of its key; empty: the name of the field
    sought: str  # what a reader looks for on a datasheet; several figures may say it
    error: str  # what a filter without room for it leaves out, in words; empty: white noise and biases

    def keys(self, name: str, triad: str) -> list[str]:
        """Return the keys of the field of a spec in the table of "gyro" or "accel"."""
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
        Frame the values are resolved in.
    shape : tuple of int or None
        Of one row.
    kind : type
        float, bool, int or str.
    units : tuple of str or None
        Units that no name can end in; None: by the names.
    default : object
        Of the field; without one it has to be given.
    """
    if units is None:
        units = tuple(unit_of(name) or "1" for name in names)
    told = Column(names, units, frame, shape, kind)
    return field(default=default, metadata={"column": told})


def vector(stem: str, unit: str, frame: str, *, units: tuple[str, ...] | None = None) -> Any:
    """Declare a field of three components: north, east, down in frame n, else x, y, z."""
    axes = NED if frame == "n" else XYZ
    return column(*(f"{stem}_{axis}_{unit}" for axis in axes), frame=frame, shape=(3,), units=units)


def matrix(states: tuple[tuple[str, str], ...], frame: str) -> Any:
    """Declare a covariance; its elements are named by their two states, each (name, unit)."""
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
) -> Any:
    """Declare a figure of a spec: the unit its key ends in, and its limits in that unit.

    ``default`` is in SI. No unit has a figure beyond 1e6 in any of its units.
    """
    told = Figure(unit, low, high, reciprocal, reported, None if default is MISSING else default)
    return field(default=default, metadata={"figure": told})


def triad_figure(
    gyro: tuple[str, ...] = (),
    accel: tuple[str, ...] = (),
    *,
    default: float,
    key: str = "",
    sought: str = "",
    error: str = "",
) -> Any:
    """Declare a figure of a triad; see :class:`TriadFigure`. 0 is a unit without that error."""
    return field(default=default, metadata={"triad": TriadFigure(gyro, accel, key, sought, error)})


@dataclass_transform(
    frozen_default=True, field_specifiers=(column, vector, matrix, figure, triad_figure, field)
)
def declared(cls: type[_T]) -> type[_T]:
    """Make a frozen dataclass of declared fields."""
    return dataclass(frozen=True, slots=True)(cls)


class Rebuilt:
    """Pickled by its fields, so that a copy is checked and read-only, too."""

    __slots__: tuple[str, ...] = ()
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def __reduce__(self) -> tuple[Callable[[], Any], tuple[()]]:
        return partial(type(self), **{f.name: getattr(self, f.name) for f in fields(self)}), ()


class Record(Rebuilt):
    """Columns of equal length, read-only and in C order, checked at birth for shape and type."""

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
            Refuse NaN and infinity.
        width : int or None
            Length of a row whose shape leaves it open.
        besides : mapping or None
            Whole shape of fields that have another number of rows.
        """
        rows: dict[str, int] = {}
        besides = besides or {}
        for name, told in columns_of(type(self)).items():
            if told.kind is not str:
                row = (width if n is None else n for n in told.shape)
                freeze_field(self, name, told.kind, besides.get(name, (None, *row)), finite=finite)
            if name not in besides:
                rows[name] = len(getattr(self, name))
        if len(set(rows.values())) > 1:
            raise ValueError(f"{type(self).__name__}: columns differ in length: {rows}")

    def __len__(self) -> int:
        return len(getattr(self, next(iter(columns_of(type(self))))))


def freeze_field(record: object, name: str, kind: type, shape: Shape, *, finite: bool = False) -> None:
    """Replace a field of a frozen record by a checked, read-only view.

    Raises
    ------
    ValueError
        When the shape or the type is wrong or, with ``finite``, a value is not finite.
    """
    place, value = f"{type(record).__name__}.{name}", getattr(record, name)
    array: np.ndarray[Any, Any] = (
        as_float(place, value, shape, finite=finite)
        if kind is float
        else as_kind(place, value, np.dtype(kind).type, shape)
    )
    view = array.view()
    view.flags.writeable = False
    object.__setattr__(record, name, view)


def columns_of(record: type) -> dict[str, Column]:
    """Return the columns of each declared field of a record, by the field."""
    return {f.name: f.metadata["column"] for f in fields(record) if "column" in f.metadata}


def figures_of(spec: type) -> dict[str, Figure]:
    """Return the declared figures of a spec, by the field."""
    return {f.name: f.metadata["figure"] for f in fields(spec) if "figure" in f.metadata}


def triad_figures_of(spec: type) -> dict[str, TriadFigure]:
    """Return the declared figures of a triad, by the field."""
    return {f.name: f.metadata["triad"] for f in fields(spec) if "triad" in f.metadata}
