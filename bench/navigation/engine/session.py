"""The state of a filter, declared once: copy, save and restore follow from the declaration.

A class names what it carries from one piece of a record to the next as ``Kept[...]``, with its type. Memory
that says nothing between two pieces is ``Scratch[...]``. All else stays as the constructor made it. A saved
state is data of somebody: names, types and shapes are held against those of the same filter before its first
piece, and :meth:`SessionState.check` says what else has to be true before compiled code takes it.
"""

from __future__ import annotations

import types
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from datetime import date
from functools import cache
from typing import Annotated, Any, Literal, Self, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import IntArray
from bench.core.records.data import SensorData
from bench.core.records.sensor_specs import AssumedSpecs

_T = TypeVar("_T")
Kept = Annotated[_T, "kept"]
"""An attribute that is carried from one piece to the next."""
Replaced = Annotated[_T, "kept", "replaced"]
"""The same, of a value that nothing changes in place: a copy shares it."""
Scratch = Annotated[_T, "scratch"]
"""An attribute that holds nothing between two pieces."""
Growing = Annotated[_T, "growing"]
"""An array that has rows before the first piece, and may get more or fewer."""


class SessionState:
    """Something with a state that is declared: its attributes of type ``Kept[...]``."""

    def copy(self) -> Self:
        """Return an independent copy in the same state."""
        other = object.__new__(type(self))  # `copy.copy` takes three times as long
        other.__dict__.update(self.__dict__)
        other.make_scratch()
        for name in _forked(type(self)):
            setattr(other, name, fork(getattr(self, name)))
        return other

    def state(self) -> dict[str, Any]:
        """Return the state between two pieces, as arrays, numbers and words by name."""
        return {name.lstrip("_"): _plain(getattr(self, name)) for name in marked(type(self), "kept")}

    def restore(self, state: Mapping[str, Any], place: str = "", specs: AssumedSpecs | None = None) -> None:
        """Take over what :meth:`state` returned; it is checked first.

        ``place`` is where the state stands, for messages, and ``specs`` are the datasheets of the records
        in it; without, those of ``self.head``.

        Raises
        ------
        ValueError
            With the name of what is wrong.
        """
        hints = marked(type(self), "kept")
        _require_names(state, [name.lstrip("_") for name in hints], place)
        specs = specs or getattr(getattr(self, "head", None), "specs", None)
        for parts in (False, True):
            if parts:
                self.make_parts()
            for name, hint in hints.items():
                if _holds_parts(hint) == parts:
                    key = name.lstrip("_")
                    like = getattr(self, name, None)
                    setattr(self, name, rebuild(hint, state[key], like, f"{place}/{key}", specs))
        self.check()

    @classmethod
    def blank(cls) -> Self:
        """Return an object into which a state can be restored, if none exists before the first piece."""
        return cls.__new__(cls)

    def make_scratch(self) -> None:
        """Make the memory that a copy does not share."""

    def make_parts(self) -> None:
        """Create the parts with their own state that differ from those before the first piece.

        All else has been restored.
        """

    def check(self) -> None:
        """Check what has been restored, beyond names, types and shapes.

        Raises
        ------
        ValueError
            With the name of what is wrong.
        """


def _find_marked(cls: type, mark: str) -> dict[str, Any]:
    """Return the attributes of a class that are declared "kept" or "scratch", with their types."""
    hints = get_type_hints(cls, include_extras=True)
    for name, one in (pair for base in reversed(cls.__mro__) for pair in vars(base).items()):
        if isinstance(one, property):
            hints[name] = get_type_hints(one.fget, include_extras=True).get("return")
    return {name: hint for name, hint in hints.items() if mark in getattr(hint, "__metadata__", ())}


def _find_fields(cls: Any) -> dict[str, Any]:
    """Return the fields of a named tuple or a dataclass, with their types, without datasheets."""
    hints = get_type_hints(cls, include_extras=True)
    names = [f.name for f in fields(cls)] if is_dataclass(cls) else cls._fields
    return {name: hints[name] for name in names if hints[name] is not AssumedSpecs}


def _find_forked(cls: type) -> tuple[str, ...]:
    """Return the attributes that a copy must not share."""
    return tuple(name for name, hint in marked(cls, "kept").items() if "replaced" not in hint.__metadata__)


marked: Callable[[type, str], dict[str, Any]] = cache(_find_marked)
_forked: Callable[[type], tuple[str, ...]] = cache(_find_forked)
_fields: Callable[[type], dict[str, Any]] = cache(_find_fields)


_UNCHANGING = frozenset({int, float, bool, str, bytes, type(None), np.float64, np.int64, np.bool_})


def fork(value: Any) -> Any:
    """Return an independent copy of a value; parts that cannot change are shared."""
    kind = type(value)
    if kind in _UNCHANGING:
        return value
    if isinstance(value, np.ndarray):
        return _copy_array(value) if value.flags.writeable else value
    if isinstance(value, tuple):
        return kind(*map(fork, value)) if hasattr(kind, "_fields") else kind(map(fork, value))
    if hasattr(value, "restore"):
        return value.copy()
    if isinstance(value, dict):
        return {key: fork(one) for key, one in value.items()}
    if isinstance(value, list | deque):
        return kind(map(fork, value))
    return value


def _copy_array(array: NDArray[Any]) -> NDArray[Any]:
    """Return a copy, C-ordered and writeable; rows of whole cache lines begin at one (`wide_rows`)."""
    if array.ndim == 2 and array.dtype == np.float64:
        from bench.core.compilation.wide_rows import (  # numba, which who lists what there is does without
            LANES,
            widened,
        )

        if array.shape[1] % LANES == 0:
            return widened(array)
    return np.array(array, order="C")


def _plain(value: Any) -> Any:
    """Return a value as arrays, numbers and words, in tables by name and lists."""
    if hasattr(value, "restore"):
        return value.state()
    if isinstance(value, dict):
        return {str(key): _plain(one) for key, one in value.items()}
    if is_dataclass(value) or hasattr(value, "_fields"):
        return {name: _plain(getattr(value, name)) for name in _fields(type(value))}
    if isinstance(value, list | tuple | deque):
        return [_plain(one) for one in value]
    return value


def rebuild(
    hint: Any, found: Any, like: Any = None, place: str = "", specs: AssumedSpecs | None = None
) -> Any:
    """Return the value of a declared type that a plain value represents, checked.

    ``like``: value of the same filter before its first piece; None if the value came with the pieces. For the
    other parameters see :meth:`SessionState.restore`.

    Raises
    ------
    ValueError
        With the name of what is wrong.
    """
    origin, args = get_origin(hint), get_args(hint)
    if origin is Annotated:
        if "growing" in hint.__metadata__:
            return _array(args[0], found, like, place, grows=True)
        return rebuild(args[0], found, like, place, specs)
    if origin in (Union, types.UnionType):
        return _rebuild_one_of(args, found, like, place, specs)
    require(found is not None, place, "must not be empty")
    if origin is np.ndarray:
        return _array(hint, found, like, place)
    if origin is dict:
        return _rebuild_table(args, found, like, place, specs)
    if origin in (list, tuple, deque):
        return _rebuild_list(origin, args, found, like, place, specs)
    if origin is Literal:
        require(found in args, place, f"must be one of {', '.join(args)}")
        return found
    if hasattr(hint, "restore"):
        part = hint.blank() if like is None else like
        if isinstance(part, SessionState):
            part.restore(found, place, specs)
        else:
            part.restore(found)
        return part
    if is_dataclass(hint) or hasattr(hint, "_fields"):
        inner = _fields(hint)
        _require_names(found, list(inner), place)
        values = {
            name: rebuild(one, found[name], getattr(like, name, None), f"{place}/{name}", specs)
            for name, one in inner.items()
        }
        return hint(**values, **({"specs": specs} if hint is SensorData else {}))
    return _number(hint, found, like, place)


def _rebuild_one_of(
    hints: tuple[Any, ...], found: Any, like: Any, place: str, specs: AssumedSpecs | None
) -> Any:
    """Return the value of the first of several types that fits; None if None is one of them."""
    rest = [hint for hint in hints if hint is not types.NoneType]
    if found is None and len(rest) < len(hints):
        return None
    for hint in rest[:-1]:
        try:
            return rebuild(hint, found, like, place, specs)
        except ValueError:
            continue
    return rebuild(rest[-1], found, like, place, specs)


def _rebuild_table(
    args: tuple[Any, ...], found: Any, like: Any, place: str, specs: AssumedSpecs | None
) -> dict[Any, Any]:
    require(isinstance(found, Mapping), place, "must be a table")
    if like and _holds_parts(args[1]):
        _require_names(found, [str(key) for key in like], place)
    table = {}
    for name, one in found.items():
        key = args[0](name)
        table[key] = rebuild(args[1], one, (like or {}).get(key), f"{place}/{name}", specs)
    return table


def _rebuild_list(
    kind: Any, args: tuple[Any, ...], found: Any, like: Any, place: str, specs: AssumedSpecs | None
) -> Any:
    """Return a list, a tuple or a queue; a tuple of several types and a list of parts have a fixed length."""
    require(isinstance(found, list | tuple), place, "must be a list")
    if kind is tuple and args[-1] is not Ellipsis:
        require(len(found) == len(args), place, f"must have {len(args)} entries; got {len(found)}")
    else:
        if like and _holds_parts(args[0]):
            require(len(found) == len(like), place, f"must have {len(like)} entries; got {len(found)}")
        args = (args[0],) * len(found)
    before = list(like or ()) + [None] * len(found)
    made = [
        rebuild(hint, one, before[k], f"{place}/{k}", specs)
        for k, (hint, one) in enumerate(zip(args, found, strict=True))
    ]
    return kind(made)


def _array(hint: Any, found: Any, like: Any, place: str, *, grows: bool = False) -> Any:
    """Return a checked array: type and shape as before the first piece, and finite if that array is.

    An array without rows there gets them with the pieces.
    """
    ((wanted,),) = (get_args(get_args(hint)[1]),)
    dtype = np.dtype(wanted) if like is None else like.dtype
    require(isinstance(found, np.ndarray) and found.dtype == dtype, place, f"must be {dtype}")
    found = _copy_array(found)
    if like is None:
        return found
    grows = grows or not len(like)
    same = found.ndim == like.ndim and found.shape[grows:] == like.shape[grows:]
    wide = ("N", *like.shape[1:]) if grows else like.shape
    require(same, place, f"must have shape {wide}; got {found.shape}")
    finite = grows or not np.isfinite(like).all() or np.isfinite(found).all()
    require(bool(finite), place, "must be finite")
    return found


def _number(hint: Any, found: Any, like: Any, place: str) -> Any:
    """Return a checked number, truth value or word; finite if the number before the first piece is."""
    if hint is date and isinstance(found, str):
        with suppress(ValueError):
            found = date.fromisoformat(found)
    kinds: Any = (int, float) if hint is float else hint
    same = isinstance(found, kinds) and isinstance(found, bool) == (hint is bool)
    require(same, place, f"must be a {hint.__name__}; got {found!r:.40}")
    finite = hint is not float or like is None or not np.isfinite(like) or np.isfinite(found)
    require(bool(finite), place, "must be finite")
    return found


def _holds_parts(hint: Any) -> bool:
    """Return whether a type has a declared state, or is a container of such types."""
    if hasattr(hint, "restore"):
        return True
    return any(_holds_parts(one) for one in get_args(hint) if not isinstance(one, str))


def _require_names(found: Any, names: list[str], place: str) -> None:
    same = isinstance(found, Mapping) and found.keys() == set(names)
    require(same, place, f"must hold {', '.join(names)}")


def require(good: bool, place: str, wanted: str) -> None:
    """Raise ValueError with the place and the requirement, unless a condition holds."""
    if not good:
        raise ValueError(f"{place.strip('/')} {wanted}")


def require_rows(place: str, table: Any, names: Iterable[str], count: int) -> None:
    """Check that columns of a table have a number of rows."""
    for name in names:
        shape = getattr(table, name).shape
        wanted = (count, *shape[1:])
        require(shape == wanted, f"{place}/{name}", f"must have shape {wanted}; got {shape}")


def require_range(name: str, numbers: IntArray, end: int) -> None:
    """Check that all numbers are valid indices for a length."""
    inside = numbers.dtype == np.int64 and bool(((numbers >= 0) & (numbers < end)).all())
    require(inside, name, f"must be whole numbers from 0 to {end - 1}")
