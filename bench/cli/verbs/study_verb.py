"""The verb study: progress while it works, then its answer, its tables, and where the files are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, TextColumn
from rich.progress import Progress as Bar

from bench.cli.verbs.console import PlainConsole
from bench.cli.verbs.printing import MOST_ROWS, print_findings
from bench.core.records.findings import StudyResult
from bench.experiments.studies.conducting import study
from bench.experiments.studies.study import Progress
from bench.io import results
from bench.views.report.writing import write_report


def run_study(name: str, *, console: Console, out: Path | None, report: bool, **options: Any) -> StudyResult:
    """Run a study, print its answer and its tables, and write its folder if there is one to write."""
    with _show_progress() as progress:
        result = study(name, out=out, progress=progress, **options)
    if out is not None and report:
        write_report(out)
    print_study(console, result)
    if out is not None:
        console.print(f"Wrote {out / results.REPORT if report else out}.", soft_wrap=True)
    return result


def print_study(console: Console, result: StudyResult) -> None:
    """Print the answer and the tables of a study."""
    print_findings(console, result.verdicts, result.findings.tables, MOST_ROWS)
    console.print(f"{result.command}: {result.wall_s:.1f} s", style="dim", soft_wrap=True)


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
