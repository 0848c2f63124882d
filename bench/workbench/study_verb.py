"""The verb study: progress while it works, then its answer, its tables, and where the files are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from bench import store
from bench.findings import StudyResult, StudyTable
from bench.report.study_page import format_cell
from bench.report.writing import write_report
from bench.studies.conducting import study
from bench.studies.study import Progress
from bench.workbench.console import PlainConsole
from bench.workbench.divided_table import TableColumn, print_table

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
    """Print the first rows of a table; if it has to be divided, each part has the columns that name a row."""
    columns = {
        name: TableColumn(
            [format_cell(value) for value in values[:_MOST_ROWS]],
            words=any(isinstance(value, str) for value in values),
        )
        for name, values in table.columns.items()
    }
    print_table(console, columns, _find_keys(table), table.title)
    rows = max((len(values) for values in table.columns.values()), default=0)
    if rows > _MOST_ROWS:
        console.print(f"{rows - _MOST_ROWS} more rows: -o DIR writes all.", style="dim")


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
