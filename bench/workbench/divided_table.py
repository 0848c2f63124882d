"""Print a table; one that is too wide for the console as several, and nothing is cut."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import NamedTuple

from rich import box
from rich.console import Console, JustifyMethod
from rich.table import Table
from rich.text import Text

from bench.findings.looks import LOOKS

_WIDEST_TEXT = 24  # a column of text in a table too wide for the console
_GAP = 2  # between columns


class TableColumn(NamedTuple):
    """A column of texts, of one line or several."""

    cells: Sequence[str]
    words: bool = False  # text, not numbers


class _Shown(NamedTuple):
    """A column as it is printed."""

    head: str
    cells: Sequence[str]
    words: bool
    width: int


def print_table(
    console: Console, columns: Mapping[str, TableColumn], keys: Sequence[str], title: str = ""
) -> None:
    """Print a table, in parts if it is too wide, each as wide as there is room for; verdicts have their look.

    Parameters
    ----------
    console : Console
        Where to print.
    columns : mapping
        Head -> column, of equal length.
    keys : sequence of str
        Columns that name a row; each part has them.
    title : str
        Above the first part, as wide as the console.
    """
    plain = {name: _Shown(name, *one, _measure([name, *one.cells])) for name, one in columns.items()}
    if title:
        console.print(title, style="table.title")
    whole = _make_table(plain.values())
    if console.measure(whole, options=console.options.update(max_width=10_000)).maximum <= console.width:
        console.print(whole)
        return
    narrow = {name: _narrow(one) for name, one in plain.items()}
    for part in _divide(narrow, keys, console.width):
        shown = {name: narrow[name] for name in part}
        longest = max(part, key=lambda name: plain[name].width)  # gets what room there is left
        spare = max(0, console.width - 1 - sum(one.width + _GAP for one in shown.values()))
        shown[longest] = shown[longest]._replace(width=shown[longest].width + spare)
        console.print(_make_table(shown.values()))


def _measure(texts: Sequence[str]) -> int:
    return max((len(line) for text in texts for line in text.split("\n")), default=0)


def _narrow(column: _Shown) -> _Shown:
    """Return a column whose head is broken after underscores and spaces; text is wrapped at spaces."""
    pieces = re.findall(r"[^_ ]*[_ ]*", column.head)
    widest = _measure(column.cells)
    if column.words:
        word = _measure([word for cell in column.cells for word in cell.split()])
        widest = min(widest, max(word, _WIDEST_TEXT))
    width = max(widest, _measure([piece.rstrip() for piece in pieces]))
    lines = [""]
    for piece in pieces:
        if len((lines[-1] + piece).rstrip()) > width:
            lines.append("")
        lines[-1] += piece
    return column._replace(head="\n".join(line.rstrip() for line in lines), width=width)


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


def _make_table(columns: Collection[_Shown]) -> Table:
    shown = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    for one in columns:
        kind: JustifyMethod = "left" if one.words else "right"
        shown.add_column(one.head, justify=kind, overflow="fold", max_width=one.width)
    for row in zip(*(one.cells for one in columns), strict=True):
        shown.add_row(*(Text(cell, LOOKS[cell].style) if cell in LOOKS else cell for cell in row))
    return shown
