"""What every datasheet says, whatever the sensor, and what must hold for its figures."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field

from bench.config.tables import Table, between, quantity

Grade = Literal["consumer", "industrial", "tactical", "navigation", "synthetic"]
Confidence = Literal["datasheet", "front page", "maker", "quoted", "table"]
"""Where the figures were read: on the sheet, its front page, maker's pages, a quote, a table of grades."""

Figure = Annotated[float, between(0, 1e6)]  # no unit has a figure beyond, in any of its units
Rate = Annotated[float, between(0.01, 400)]


class Sheet(Table):
    """What every datasheet says: where its figures come from."""

    title: str | None = None
    grade: Grade | None = Field(default=None, alias="class")
    confidence: Confidence | None = None
    source: str
    sources: dict[str, str] = Field(default_factory=dict)  # of single figures, by "table.key"
    assumed: list[str] = Field(default_factory=list)  # figures that no source states


def reported(table: Table, name: str, *keys: str) -> list[str]:
    """Say which of the noises that the unit itself reports, and a filter divides by, are 0."""
    return [
        f"[{name}] {quantity(key, getattr(table, key))} must be above 0: the unit reports it"
        for key in keys
        if getattr(table, key) == 0
    ]


def unsourced(sheet: Sheet, document: Mapping[str, Any]) -> list[str]:
    """Say which of the figures named in ``sources`` and ``assumed`` the file does not give."""
    tables = [key for key in document if key not in Sheet.model_fields and isinstance(document[key], dict)]
    figures = {f"{table}.{key}" for table in tables for key in document[table]}
    return [
        f"{where}: {name!r} is no figure of this file"
        for where, names in {"[sources]": sheet.sources, "assumed": sheet.assumed}.items()
        for name in names
        if name not in figures
    ]
