"""What every datasheet says, whatever the sensor, and what must hold for its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, create_model

from bench.config.tables import Table, between
from bench.fields import figures_of
from bench.units import from_si, to_si
from bench.wording import quantity

Grade = Literal["consumer", "industrial", "tactical", "navigation", "synthetic"]
Confidence = Literal["datasheet", "front page", "maker", "quoted", "table"]
"""Where the figures were read: on the sheet, its front page, maker's pages, a quote, a table of grades."""

Figure = Annotated[float, between(0, 1e6)]  # no unit has a figure beyond, in any of its units


class Sheet(Table):
    """What every datasheet says: where its figures come from."""

    title: str | None = None
    grade: Grade | None = Field(default=None, alias="class")
    confidence: Confidence | None = None
    source: str
    sources: dict[str, str] = Field(default_factory=dict)  # of single figures, by "table.key"
    assumed: list[str] = Field(default_factory=list)  # figures that no source states


def make_table_type(spec: type, *names: str) -> type[Table]:
    """Build the table of a file that a spec is made of: its figures under their keys, with their limits.

    ``names`` are the figures that go into it; all when none is given.
    """
    rows: dict[str, Any] = {}
    for name, told in figures_of(spec).items():
        if names and name not in names:
            continue
        limited = Annotated[float, between(told.low, told.high)]
        if told.reciprocal:
            rows[told.key(name)] = (limited | None, None)
        elif told.default is None:
            rows[told.key(name)] = (limited, ...)
        else:
            rows[told.key(name)] = (limited, from_si(told.key(name), told.default))
    return create_model(f"{spec.__name__}Table", __base__=Table, __doc__=spec.__doc__, **rows)


def convert_figures(spec: type, table: Table) -> dict[str, Any]:
    """Return the figures of a spec, in SI, from the table of a file."""
    found = {}
    for name, told in figures_of(spec).items():
        key = told.key(name)
        if key in type(table).model_fields:
            value = to_si(key, getattr(table, key))
            found[name] = value if not told.reciprocal else 1.0 / value if value else 0.0
    return found


def check_figures(spec: type, table: Table, name: str) -> list[str]:
    """Say which figures of a table may not be 0: noise that the unit reports, and decays."""
    wrong = []
    for field, told in figures_of(spec).items():
        key = told.key(field)
        if getattr(table, key) == 0 and told.reported:
            wrong.append(f"[{name}] {quantity(key, 0.0)} must be above 0: the unit reports it")
        elif getattr(table, key) == 0 and told.reciprocal:
            wrong.append(
                f"[{name}] {quantity(key, 0)} must be above 0; leave it out when there is no such decay"
            )
    return wrong


def check_sources(sheet: Sheet, document: Mapping[str, Any]) -> list[str]:
    """Say which of the figures named in ``sources`` and ``assumed`` the file does not give."""
    tables = [key for key in document if key not in Sheet.model_fields and isinstance(document[key], dict)]
    figures = {f"{table}.{key}" for table in tables for key in document[table]}
    return [
        f"{where}: {name!r} is no figure of this file"
        for where, names in {"[sources]": sheet.sources, "assumed": sheet.assumed}.items()
        for name in names
        if name not in figures
    ]
