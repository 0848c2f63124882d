"""The verb study: show progress, then the answer, the tables and the folder of the files."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.verbs.console import show_bar
from bench.cli.verbs.printing import MOST_ROWS, measure_table, print_table, print_tables, print_wrapped
from bench.core.records.findings import FindingTable, StudyResult
from bench.core.words.stages import Progress
from bench.core.words.wording import format_count
from bench.evaluation.ensembles.ensemble import qualify
from bench.experiments.studies.conducting import study
from bench.io import results
from bench.views.report.writing import write_report


def run_study(
    name: str, *, console: Console, out: Path | None, report: bool, table: bool = False, **options: Any
) -> StudyResult:
    """Run a study, write its folder if requested, and print its answer."""
    with _show_progress() as progress:
        result = study(name, out=out, progress=progress, **options)
    if out is not None and report:
        write_report(out)
    print_study(console, result, table=table)
    if out is not None:
        console.print(f"Results  {out / results.REPORT if report else out}", soft_wrap=True)
    return result


def print_study(console: Console, result: StudyResult, *, table: bool) -> None:
    """Print the answer of a study and its first table, or all its tables."""
    tables = result.findings.tables
    shown = result.verdicts if table else result.verdicts[:_MOST_SENTENCES]
    for k, text in enumerate(shown):
        print_wrapped(console, text if k else f"Answer: {text}")
    if table:
        print_tables(console, tables, MOST_ROWS)
    elif tables:
        first, left_out = _shorten(tables[0], console)
        print_table(console, first, _MOST_ROWS)
        more = [format_count(len(left_out), "more column")] if left_out else []
        more += [format_count(len(tables) - 1, "more table")] if len(tables) > 1 else []
        more += (
            [f"{len(result.verdicts) - len(shown)} more sentences"]
            if len(shown) < len(result.verdicts)
            else []
        )
        if more:
            console.print(f"{', '.join(more)}: --table prints all", style="dim")
    if words := result.findings.runs and qualify(result.findings.runs):
        print_wrapped(console, f"Intervals of pooled errors hold{words.removeprefix(',')}.", "dim")
    print_wrapped(console, f"{result.command}  ({result.wall_s:.1f} s)", "dim")


_MOST_SENTENCES, _MOST_ROWS = 5, 12  # of an answer on one screen


def _shorten(table: FindingTable, console: Console) -> tuple[FindingTable, list[str]]:
    """Return a table with the first columns that differ between rows and fit the width, and the others."""
    differing = {
        name: values
        for name, values in table.columns.items()
        if len(values) < 2 or len(set(map(str, values))) > 1
    }
    columns = dict(differing or table.columns)
    left_out = []
    while len(columns) > 2 and measure_table(console, replace(table, columns=columns)) > console.width:
        left_out.append(columns.popitem()[0])
    return replace(table, columns=columns), left_out


@contextlib.contextmanager
def _show_progress() -> Iterator[Progress]:
    """Provide a function that shows the progress of a study on a terminal."""
    with show_bar("") as show:
        yield lambda now: show(now.words, now.done, now.total, f"{now.done:.0f} of {now.total or 0:.0f}")
