"""Print the result of a run: a row and a reason for each filter, or the table of the main metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from textwrap import wrap
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.cli.verbs.printing import measure_table, print_table
from bench.core.records.data import NavSolution
from bench.core.records.findings import FindingTable
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import format_number
from bench.evaluation.consistency import headline, verdict
from bench.evaluation.consistency.headline import Headline, list_stops, make_headline
from bench.evaluation.consistency.screen_table import tabulate_log, tabulate_run
from bench.evaluation.metrics.key_figures import (
    MEANING,
    Measured,
    explain_rows,
    list_key_figures,
    tabulate_metrics,
)

SCREEN = 24
"""Lines of a screen: heading, table, reasons and the next commands of a run fit on one."""
_OTHER_LINES = 13  # of a screen, besides a row for each filter and the reasons
_FIRST_LEFT_OUT = ("", "outside", "required", "why", "fault", "stops")
"""Parts of the explanations that are left out if there is no room, in this order."""


def print_screen(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    """Print one row for each filter, and the reason for each verdict that is not green."""
    lines = [make_headline(label, values, solutions[label].events) for label, values in measured.items()]
    tabulate = tabulate_log if any("withheld_fixes" in one for one in measured.values()) else tabulate_run
    table = tabulate(measured, lines, wide=console.width >= _WIDE)
    for head in _NARROW:
        if measure_table(console, table) > console.width:
            table = replace(table, columns={name: one for name, one in table.columns.items() if name != head})
    for left_out in _FIRST_LEFT_OUT:
        without: dict[str, Any] = {left_out: ""} if left_out else {}
        lines = [one._replace(**without) for one in lines]
        texts = [text for one in lines for text in _explain(one, console.width)]
        if len(texts) <= SCREEN - _OTHER_LINES - len(lines):
            break
    print_table(console, table, below=True, last=not texts)
    for text, style in texts:
        console.print(Text(text, style))


_NARROW = ("vertical\nRMS", "outage\ndrift")  # columns that go first where a table is too wide
_WIDE = 110  # columns of a terminal with room for velocity and heading


def _explain(one: Headline, width: int) -> Iterator[tuple[str, str]]:
    """Yield the lines that explain a verdict that is not green, and faults, each with its style."""
    reason = f"{one.reason}." if one.reason else ""
    more = [one.stops, one.fault, one.outside, one.why, one.required]
    parts = [one.note] if one.note else [reason, *more]
    first = f"{'' if one.look.kind == 'good' else one.look.mark} {one.label}  ".lstrip()
    for text in filter(None, parts):
        for line in wrap(text, width, initial_indent=first, subsequent_indent=" " * 4):
            yield line, one.look.style if first.strip() and one.look.kind != "good" else ""
            first = ""
        first = " " * 4


def print_metrics(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    """Print verdicts and main metrics, one column per filter, alignments and errors not modeled."""
    for values in measured.values():
        if text := values.get("verdict_text"):
            console.print(text, style=headline.judge_look(str(values["verdict"]), values).style)
    names = list_key_figures(measured)
    print_table(console, tabulate_metrics(measured, names))
    if any(verdict.find_bounds(name, values) for values in measured.values() for name in names):
        console.print(MEANING, style="dim")
    if explained := explain_rows(names):
        console.print(f"{'; '.join(explained)}.", style="dim")
    for values in measured.values():
        for text in verdict.list_sentences(values):
            console.print(text)
    _print_remarks(console, measured, solutions)


def print_bound(console: Console, measured: Measured) -> None:
    """Print the ratio of the errors to the errors of the best linear filter, if ``--bound`` computed it."""
    held = {label: values["bound"] for label, values in measured.items() if values.get("bound")}
    if not held:
        return
    cells: dict[str, dict[str, ShownFigure]] = {}
    for label, rows in held.items():
        for row in rows:
            interval = f"{_format_end(row['low'])} to {_format_end(row['high'])}"
            figure = ShownFigure(format_number(row["ratio"]), interval)
            cells.setdefault(f"{row['quantity']} {row['phase']}", {})[label] = figure
    columns = {label: [found.get(label, ShownFigure("")) for found in cells.values()] for label in held}
    head = "RMS / RMS of the best linear filter"
    print_table(console, FindingTable("bound", "", {head: list(cells), **columns}))
    meaning = "Beside or below each ratio its 99.9 % interval, by the correlation in time of this one run."
    console.print(meaning, style="dim")


def _format_end(value: float) -> str:
    return f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def _print_remarks(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    remarks: dict[str, list[str]] = {}
    for label, values in measured.items():
        for begun, end, text in solutions[label].events.select("alignment"):
            remarks.setdefault(f"aligned from {begun:g} to {end:g} s: {text}", []).append(label)
        for text in list_stops(solutions[label].events):
            remarks.setdefault(text, []).append(label)
        if values["converged"] and values.get("program"):
            stderr = values["program"]["stderr"]
            last = f"; stderr ends: {stderr.splitlines()[-1][:200]}" if stderr else ""
            console.print(f"{label}: {values['program']['program']}{last}", soft_wrap=True)
        if runs := values.get("causes_runs"):
            remarks.setdefault(f"ran {runs} times more to find out why", []).append(label)
        for name, why in (values.get("no_value") or {}).items():
            remarks.setdefault(f"{name} has no value: {why}", []).append(label)
        if values.get("same_as"):
            remarks.setdefault(f"the same as {values['same_as']} with these sensors", []).append(label)
        if values.get("unmodeled_errors"):
            remarks.setdefault(f"not modeled: {', '.join(values['unmodeled_errors'])}", []).append(label)
    for text, labels in remarks.items():
        console.print(f"{', '.join(labels)}: {text}")
