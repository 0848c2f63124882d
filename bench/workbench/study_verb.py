"""The verb study: progress while it works, then its answer, its tables, and where the files are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from rich import box
from rich.console import Console, JustifyMethod
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar
from rich.table import Table

from bench import store
from bench.report.study_page import format_cell
from bench.report.writing import write_report
from bench.studies.conducting import study
from bench.studies.study import Progress, StudyResult, StudyTable
from bench.workbench.console import PlainConsole

_MOST_ROWS = 40  # of a table that are printed
_WIDEST_TEXT = 24  # a column of text in a table too wide for the console
_GAP = 2  # between columns


def run_study(name: str, *, console: Console, out: Path | None, report: bool, **options: Any) -> StudyResult:
    """Run a study, print its answer and its tables, and write its folder if there is one to write."""
    with _show_progress() as progress:
        result = study(name, out=out, progress=progress, **options)
    if out is not None and report:
        write_report(out)
    for table in result.findings.tables:
        _print_table(console, table)
    for sentence in result.verdicts:
        console.print(sentence, soft_wrap=True)
    console.print(f"{result.command}: {result.wall_s:.1f} s", style="dim", soft_wrap=True)
    if out is not None:
        console.print(f"Wrote {out / store.REPORT if report else out}.", soft_wrap=True)
    return result


def _print_table(console: Console, table: StudyTable) -> None:
    """Print a table; one too wide for the console as several, each with the columns that name a row."""
    columns = {name: _make_column(name, list(values)) for name, values in table.columns.items()}
    shown = _make_table(table.title, list(columns.values()))
    if console.measure(shown, options=console.options.update(max_width=10_000)).maximum <= console.width:
        console.print(shown)
    else:
        columns = {name: _narrow(column) for name, column in columns.items()}
        for k, part in enumerate(_divide(columns, _find_keys(table), console.width)):
            console.print(_make_table("" if k else table.title, [columns[name] for name in part]))
    rows = max((len(values) for values in table.columns.values()), default=0)
    if rows > _MOST_ROWS:
        console.print(f"{rows - _MOST_ROWS} more rows: -o DIR writes all.", style="dim")


class _Column(NamedTuple):
    """A column as it is printed."""

    head: str
    cells: list[str]
    words: bool  # text, not numbers
    width: int


def _make_column(name: str, values: Sequence[Any]) -> _Column:
    cells = [format_cell(value) for value in values[:_MOST_ROWS]]
    words = any(isinstance(value, str) for value in values)
    return _Column(name, cells, words, max(map(len, [name, *cells])))


def _narrow(column: _Column) -> _Column:
    """Return a column with its head on several lines, broken after underscores; long text wraps."""
    pieces = column.head.replace("_", "_ ").split()
    widest = max(map(len, column.cells), default=0)
    if column.words:
        widest = min(widest, _WIDEST_TEXT)
    width = max(widest, *map(len, pieces))
    lines = [""]
    for piece in pieces:
        if len(lines[-1]) + len(piece) > width:
            lines.append("")
        lines[-1] += piece
    return column._replace(head="\n".join(lines), width=width)


def _find_keys(table: StudyTable) -> list[str]:
    """Return the fewest of the first columns that tell all rows apart."""

    def differ(names: Sequence[str]) -> bool:
        rows = list(zip(*(table.columns[name] for name in names), strict=True))
        return len(set(rows)) == len(rows)

    names = list(table.columns)
    keys = next((names[:k] for k in range(1, len(names)) if differ(names[:k])), names[:1])
    for name in keys[1:-1]:
        fewer = [key for key in keys if key != name]
        keys = fewer if differ(fewer) else keys
    return keys


def _divide(columns: Mapping[str, _Column], keys: Sequence[str], room: int) -> Iterator[list[str]]:
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


def _make_table(title: str, columns: Sequence[_Column]) -> Table:
    shown = Table(
        title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False
    )
    for one in columns:
        kind: JustifyMethod = "left" if one.words else "right"
        shown.add_column(one.head, justify=kind, overflow="fold", max_width=one.width)
    for row in zip(*(one.cells for one in columns), strict=True):
        shown.add_row(*row)
    return shown


@contextlib.contextmanager
def _show_progress() -> Iterator[Progress]:
    """Provide a function that shows how far a study is, on a terminal."""
    screen = PlainConsole(stderr=True)
    if not screen.is_interactive:
        yield lambda what, done, of: None
        return
    columns = (TextColumn("{task.description}", markup=False), BarColumn())
    with Bar(*columns, TextColumn("{task.completed} of {task.total}"), console=screen, transient=True) as bar:
        task = bar.add_task("", total=None)

        def show(what: str, done: int, of: int) -> None:
            bar.update(task, description=what, total=of, completed=done)

        yield show
