"""Findings of a study: sentences, tables and figures, and the result made of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from bench.core.mathematics.units import unit_of
from bench.core.records.findings.series import Plot
from bench.core.words.exceptions import ConfigError
from bench.core.words.notebook import ShownText as ShownText
from bench.core.words.notebook import draw, make_frame, write_sentences, write_table
from bench.core.words.wording import suggest


@dataclass(frozen=True)
class FindingTable:
    """A table for display in any form; a row with only a name is a heading."""

    name: str  # of its file
    title: str
    columns: Mapping[str, Sequence[Any]]  # name, which ends in its unit -> values (N,); None: no value
    units: Mapping[str, str] = field(default_factory=dict)  # of the columns that have one
    heads: Mapping[str, str] = field(default_factory=dict)  # words on a page for names of columns

    @property
    def rows(self) -> list[tuple[Any, ...]]:
        """The rows, a value of each column."""
        return list(zip(*self.columns.values(), strict=True))

    @property
    def groups(self) -> list[tuple[str, list[tuple[Any, ...]]]]:
        """The headings with the rows below each; "" for rows above the first heading."""
        found: list[tuple[str, list[tuple[Any, ...]]]] = [("", [])]
        for row in self.rows:
            first, *others = map(str, row)
            if others and not any(others):
                found.append((first, []))
            else:
                found[-1][1].append(row)
        return [one for one in found if any(one)]


def make_table(name: str, title: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]) -> FindingTable:
    """Return a table of rows of texts, numbers, shown figures and texts, and None.

    A column gets the unit in which its name ends.
    """
    values = {
        key: [one if isinstance(one, str | int | tuple | None) else float(one) for one in column]
        for key, column in zip(columns, zip(*rows, strict=True) if rows else [()] * len(columns), strict=True)
    }
    return FindingTable(name, title, values, {key: unit for key in columns if (unit := unit_of(key))})


@dataclass(frozen=True)
class Findings:
    """Findings of a study."""

    verdicts: tuple[str, ...]  # sentences
    tables: tuple[FindingTable, ...]
    figures: tuple[Plot, ...]  # the last part of each path names its file
    runs: int = 0  # runs behind each figure with an interval; 0: nothing is drawn
    good: bool = True  # no verdict is negative
    undecided: bool = False  # what was asked cannot be told from so few runs


def join_findings(found: Mapping[str, Findings]) -> Findings:
    """Return findings of several cases as one: sentences, tables and figures with the name of their case."""
    if len(found) == 1:
        return next(iter(found.values()))
    return Findings(
        tuple(f"{name}: {text}" for name, one in found.items() for text in one.verdicts),
        tuple(
            replace(table, name=f"{table.name}-{name}", title=f"{name}: {table.title}")
            for name, one in found.items()
            for table in one.tables
        ),
        tuple(
            replace(plot, path=(*plot.path[:-1], f"{plot.path[-1]}-{name}"), title=f"{name}: {plot.title}")
            for name, one in found.items()
            for plot in one.figures
        ),
        max(one.runs for one in found.values()),
        all(one.good for one in found.values()),
        any(one.undecided for one in found.values()),
    )


@dataclass(frozen=True)
class StudyResult:
    """A finished study."""

    name: str
    question: str
    command: str  # that makes it again
    options: Mapping[str, Any]
    findings: Findings
    provenance: Mapping[str, object]
    wall_s: float

    @property
    def verdicts(self) -> tuple[str, ...]:
        """Return the answer in sentences."""
        return self.findings.verdicts

    @property
    def tables(self) -> Mapping[str, FindingTable]:
        """The tables by name."""
        return {table.name: table for table in self.findings.tables}

    @property
    def figures(self) -> Mapping[str, Plot]:
        """The figures by name."""
        return {plot.path[-1]: plot for plot in self.findings.figures}

    def plot(self, figure: str | None = None, **look: Any) -> Any:
        """Draw a figure, the first if none is named; `look` as for `plot_result`."""
        return draw(self, figure, **look)

    def frame(self, table: str | None = None) -> Any:
        """Return a table, the first if none is named, as a pandas.DataFrame."""
        name = table or next(iter(self.tables), "")
        if name not in self.tables:
            raise ConfigError(f"table = {name!r} is not in this study{suggest(name, self.tables, 'tables')}")
        return make_frame(self.tables[name].columns)

    def __repr__(self) -> str:
        """Return the question and the answer."""
        return "\n".join([f"<StudyResult {self.name}: {self.question}>", *self.verdicts])

    def _repr_html_(self) -> str:
        """Return the answer and the tables."""
        tables = (write_table(table.title, table.columns) for table in self.tables.values())
        return write_sentences(self.verdicts) + "".join(tables)
