"""The verb study: progress while it works, then its answer, its tables, and where the files are."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.verbs.console import show_bar
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
    with show_bar("") as show:
        yield lambda what, done, of: show(what, done, of, f"{done} of {of}")
