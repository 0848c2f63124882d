"""Contents common to all datasheets: sources of their values, and checks of these values."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import date
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field, create_model

from bench.core.mathematics.units import from_si, to_si
from bench.core.records.fields import figures_of
from bench.core.words.wording import quantity
from bench.io.config.tables import Table, between

Grade = Literal["consumer", "industrial", "tactical", "navigation", "synthetic"]
Confidence = Literal["datasheet", "front page", "maker", "quoted", "table"]
"""Source of the figures: datasheet, its front page, other pages of the maker, a quote, a table of grades."""

MOST = 1e6  # no known figure is larger, in any unit
Figure = Annotated[float, between(0, MOST)]


class ProductTable(Table):
    """Size, mass, power and price of a sensor; what the maker does not print is left out."""

    length_mm: Annotated[float, between(0.1, 5000)] | None = None
    """Longest side."""
    width_mm: Annotated[float, between(0.1, 5000)] | None = None
    """Second side."""
    height_mm: Annotated[float, between(0.1, 5000)] | None = None
    """Third side."""
    mass_kg: Annotated[float, between(1e-6, 1000)] | None = None
    """Mass."""
    power_mw: Annotated[float, between(1e-3, 1e6)] | None = None
    """Typical power."""
    price_usd: Annotated[float, between(0.01, 1e7)] | None = None
    """Price of one sensor, as the maker prints it."""
    price_date: date | None = None
    """Date of this price."""

    @property
    def volume(self) -> float | None:
        """Product of the three sides [cm^3]; None if one of them is left out."""
        if self.length_mm is None or self.width_mm is None or self.height_mm is None:
            return None
        return 1e-3 * self.length_mm * self.width_mm * self.height_mm


class Sheet(Table):
    """A datasheet and the sources of its figures."""

    title: str | None = None
    """Title."""
    grade: Grade | None = Field(default=None, alias="class")
    """Class of the sensor."""
    confidence: Confidence | None = None
    """Kind of the source."""
    source: str
    """Source of the values."""
    product: ProductTable = ProductTable()
    """A table: size, mass, power, price."""
    sources: dict[str, str] = Field(default_factory=dict)
    """A table: sources of single figures, by "table.key"."""
    assumed: list[str] = Field(default_factory=list)
    """Figures without a source, by "table.key"."""


class SpecTable(Table):
    """A table with the fields of a spec as keys."""

    spec: ClassVar[type]


def make_table_type(spec: type) -> type[SpecTable]:
    """Return the table type for a spec: the keys of its figures, with their limits and defaults."""
    rows: dict[str, Any] = {}
    for name, figure in figures_of(spec).items():
        limited = Annotated[float, between(figure.low, figure.high)]
        if figure.reciprocal:
            rows[figure.key(name)] = (limited | None, None)
        elif figure.default is None:
            rows[figure.key(name)] = (limited, ...)
        else:
            rows[figure.key(name)] = (limited, from_si(figure.key(name), figure.default))
    table = create_model(f"{spec.__name__}Table", __base__=SpecTable, __doc__=spec.__doc__, **rows)
    table.spec = spec
    return table


def convert_figures(spec: type, table: Table) -> dict[str, Any]:
    """Return the figures of a spec, in SI, from a table of a file."""
    values = {}
    for name, figure in figures_of(spec).items():
        key = figure.key(name)
        value = to_si(key, getattr(table, key))
        values[name] = value if not figure.reciprocal else 1.0 / value if value else 0.0
    return values


def check_figures(spec: type, table: Table, name: str) -> list[str]:
    """Return one line for each value that must not be 0 but is: reported noise, and decay constants."""
    wrong = []
    for field, figure in figures_of(spec).items():
        key = figure.key(field)
        if getattr(table, key) == 0 and figure.reported:
            wrong.append(f"[{name}] {quantity(key, 0.0)} must be above 0: the unit reports it")
        elif getattr(table, key) == 0 and figure.reciprocal:
            wrong.append(f"[{name}] {quantity(key, 0)} must be above 0; leave it out if nothing decays")
    return wrong


def check_sources(sheet: Sheet, document: Mapping[str, Any]) -> list[str]:
    """Return one line for each name in ``sources`` or ``assumed`` that is not a figure of the file.

    And one for a price without its day.
    """
    figures = {
        f"{table}.{key}"
        for table, values in document.items()
        if isinstance(values, dict) and (table == "product" or table not in Sheet.model_fields)
        for key in values
    }
    undated = sheet.product.price_usd is not None and sheet.product.price_date is None
    return ["[product] price_usd needs price_date: prices change"] * undated + [
        f"{where}: {name!r} is not a figure of this file"
        for where, names in {"[sources]": sheet.sources, "assumed": sheet.assumed}.items()
        for name in names
        if name not in figures
    ]
