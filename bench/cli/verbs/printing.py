"""Print findings in the same way for every verb: tables, then sentences.

A table that is too wide for the console is printed as several, and nothing is cut.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import takewhile
from textwrap import fill
from typing import NamedTuple

from rich import box
from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from bench.core.records.findings import FindingTable
from bench.core.records.findings.looks import LOOKS
from bench.core.words.notebook import ShownFigure, ShownText, format_cell

MOST_ROWS = 40  # of a table that are printed
_WIDEST_TEXT = 24  # a column of text in a table too wide for the console
_GAP = 2  # between columns


def print_findings(
    console: Console,
    sentences: Iterable[str | Text],
    tables: Iterable[FindingTable] = (),
    most: int | None = None,
) -> None:
    """Print tables, and a paragraph for each sentence."""
    print_tables(console, tables, most)
    for sentence in sentences:
        console.print(sentence, soft_wrap=True)


def print_wrapped(console: Console, text: str, style: str = "") -> None:
    """Print a sentence as wide as the console, with its further lines indented."""
    console.print(Text(fill(text, console.width, subsequent_indent="    "), style=style))


def print_tables(console: Console, tables: Iterable[FindingTable], most: int | None = None) -> None:
    """Print tables below each other, as :func:`print_table` does one, with one blank line between two."""
    below = False
    for table in tables:
        print_table(console, table, most, below=below)
        below = bool(table.columns)


def measure_table(console: Console, table: FindingTable) -> int:
    """Return the width of a table [characters]."""
    drawn = _draw(_show(name, values) for name, values in table.columns.items())
    return console.measure(drawn, options=console.options.update(max_width=10_000)).maximum


def print_table(
    console: Console, table: FindingTable, most: int | None = None, *, below: bool = False, last: bool = False
) -> None:
    """Print a table, or the first ``most`` rows of a table that a folder contains in full.

    Verdicts are styled, and a row with only a name is a heading. If the table is too wide, intervals are
    printed below their values; if it is still too wide, each part has the key columns and as many others as
    fit. ``below``: another table and its blank line are above. ``last``: no blank line follows.
    """
    if table.title:
        console.print(table.title, style="table.title")
    if not table.columns:
        return
    columns = {name: values[:most] for name, values in table.columns.items()}
    if table.title or not below:
        console.print()
    if measure_table(console, replace(table, columns=columns)) <= console.width:
        console.print(_draw(_show(name, values) for name, values in columns.items()))
        if not last:
            console.print()
    else:
        narrow = {name: _show(name, values, narrow=True) for name, values in columns.items()}
        for part in _divide(narrow, _find_keys(columns), console.width):
            shown = {name: narrow[name] for name in part}
            longest = max(part, key=lambda name: _measure([name, *map(format_cell, columns[name])]))
            spare = max(0, console.width - sum(one.width + _GAP for one in shown.values()))
            shown[longest] = shown[longest]._replace(width=shown[longest].width + spare)
            console.print(_draw(shown.values()))
            console.print()
    left = max(map(len, table.columns.values()), default=0) - max(map(len, columns.values()), default=0)
    if left > 0:
        console.print(f"{left} more rows: -o DIR writes all.", style="dim")


def _find_keys(columns: Mapping[str, Sequence[object]]) -> list[str]:
    """Return the fewest of the first columns that distinguish all rows, without columns with intervals."""

    def differ(names: Sequence[str]) -> bool:
        rows = list(zip(*(columns[name] for name in names), strict=True))
        return len(set(rows)) == len(rows)

    def names_rows(name: str) -> bool:
        return not any(isinstance(value, ShownFigure) for value in columns[name])

    names = list(takewhile(names_rows, columns)) or list(columns)[:1]
    most = min(len(names), len(columns) - 1)
    keys = next((names[:k] for k in range(1, most + 1) if differ(names[:k])), names[:1])
    for name in keys[1:-1]:
        fewer = [key for key in keys if key != name]
        keys = fewer if differ(fewer) else keys
    return keys


class _Shown(NamedTuple):
    """A column as it is printed."""

    head: str
    cells: Sequence[str]
    styles: Sequence[str]
    words: bool  # text, not numbers
    width: int


def _show(name: str, values: Sequence[object], *, narrow: bool = False) -> _Shown:
    """Return a column; if narrow, its head is broken after underscores and spaces, and text is wrapped."""
    words = any(isinstance(value, str | ShownText) for value in values)
    outside = any(isinstance(value, ShownFigure) and value.outside for value in values)
    styles = [_find_style(value) for value in values]
    cells = [_format(value, marked=outside, narrow=narrow) for value in values]
    if not narrow:
        return _Shown(name, cells, styles, words, _measure([name, *cells]))
    pieces = re.findall(r"[^_ ]*[_ ]*", name)
    widest = _measure(cells)
    if words:
        word = _measure([word for cell in cells for word in cell.split()])
        widest = min(widest, max(word, _WIDEST_TEXT))
    width = max(widest, _measure([piece.rstrip() for piece in pieces]))
    lines = [""]
    for piece in pieces:
        if len((lines[-1] + piece).rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return _Shown("\n".join(line.rstrip() for line in lines), cells, styles, words, width)


def _format(value: object, *, marked: bool, narrow: bool) -> str:
    """Return the text of a cell; in a ``marked`` column, pad unmarked values so that the digits align."""
    if not isinstance(value, ShownFigure):
        return format_cell(value)
    text = f"{value.text}{' !' if value.outside else '  ' if marked else ''}"
    below, beside = f"{text}\n{value.bounds}", f"{text} ({value.bounds})"
    return text if not value.bounds else below if narrow else beside


def _find_style(value: object) -> str:
    if isinstance(value, ShownFigure):
        return "bold red" if value.outside else ""
    return LOOKS[value].style if isinstance(value, str) and value in LOOKS else ""


def _measure(texts: Iterable[str]) -> int:
    return max((len(line) for text in texts for line in text.split("\n")), default=0)


def _divide(columns: Mapping[str, _Shown], keys: Sequence[str], room: int) -> Iterator[list[str]]:
    """Yield the names of the columns of each part, as many as there is room for beside the keys."""
    part: list[str] = []
    for name in columns:
        together = {*keys, *part, name}
        taken = sum(columns[one].width + _GAP for one in together)
        if taken > room and not set(part) <= {*keys}:
            yield part
            part = list(keys)
        if name not in part:
            part.append(name)
    yield part


def _draw(columns: Iterable[_Shown]) -> Table:
    drawn: Collection[_Shown] = list(columns)
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False, show_edge=False)
    for one in drawn:
        kind: JustifyMethod = "left" if one.words else "right"
        table.add_column(one.head, justify=kind, overflow="fold", max_width=one.width)
    cells = ([Text(*pair) for pair in zip(one.cells, one.styles, strict=True)] for one in drawn)
    for row in zip(*cells, strict=True):
        name, *others = row
        heading = others and not any(cell.plain for cell in others)
        table.add_row(*row, style="bold" if heading and name.plain else None)
    return table
