"""The verb study: progress while it works, then its answer, its tables, and where the files are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
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
    shown = Table(title=table.title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    columns = [list(values) for values in table.columns.values()]
    for name, values in zip(table.columns, columns, strict=True):
        number = not any(isinstance(value, str) for value in values)
        shown.add_column(name, justify="right" if number else "left")
    rows = list(zip(*columns, strict=True))
    for row in rows[:_MOST_ROWS]:
        shown.add_row(*(format_cell(value) for value in row))
    console.print(shown)
    if len(rows) > _MOST_ROWS:
        console.print(f"{len(rows) - _MOST_ROWS} more rows: -o DIR writes all.", style="dim")


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
