"""The types of the ``[[leg]]`` tables of a profile, built from the keys that each leg class declares."""

from __future__ import annotations

import functools
import operator
from collections.abc import Iterable
from dataclasses import MISSING
from types import GenericAlias
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, create_model, model_validator
from pydantic_core import PydanticCustomError

from bench.core.mathematics.units import to_si
from bench.core.records.flight_specs import Leg
from bench.io.config.tables import ROWS, Table, between
from bench.simulation.flight.legs.keys import KeyedField, keys_of


class DeclaredTable(Table):
    """A leg, or a row of an array in a leg."""

    made: ClassVar[type[Any]]

    def build(self) -> Any:
        """Return the leg or row in SI."""
        keys = {entry.field: entry.key.name for entry in keys_of(self.made)}
        return self.made(**{field: _to_si(key, getattr(self, key)) for field, key in keys.items()})

    @model_validator(mode="after")
    def _check_whole(self) -> Self:
        try:
            self.build()
        except ValueError as error:
            raise PydanticCustomError("whole", "{why}", {"why": str(error)}) from None
        return self


def build_leg_type(legs: Iterable[type[Leg]]) -> Any:
    """Return the type of the array ``[[leg]]``; the kind of a row selects its type."""
    tables = [_make_table_type(leg, kind=(Literal[leg.kind], ...)) for leg in legs]
    return _make_array_type(_annotate(functools.reduce(operator.or_, tables), Field(discriminator="kind")))


def _make_table_type(made: type[Any], **others: Any) -> type[DeclaredTable]:
    for entry in keys_of(made):
        default = ... if entry.default is MISSING else entry.default
        others[entry.key.name] = (
            _make_key_type(entry) | None if entry.optional else _make_key_type(entry),
            default,
        )
    table = create_model(f"{made.__name__}Table", __base__=DeclaredTable, __doc__=made.__doc__, **others)
    table.made = made
    return table


def _make_key_type(entry: KeyedField) -> Any:
    if entry.row:
        return _make_array_type(_make_table_type(entry.row))
    if entry.choices:
        return entry.type
    return _annotate(entry.type, between(entry.key.low, entry.key.high))


def _make_array_type(row: Any) -> Any:
    return _annotate(GenericAlias(tuple, (row, ...)), ROWS, Field(min_length=1))


def _annotate(kind: Any, *checks: Any) -> Any:
    return Annotated[kind, *checks]


def _to_si(key: str, value: Any) -> Any:
    return tuple(row.build() for row in value) if isinstance(value, tuple) else to_si(key, value)
