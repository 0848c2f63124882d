"""Print the result of a run: a headline for each estimator, and the table of the main metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from textwrap import wrap
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.cli.verbs.printing import print_table
from bench.core.records.data import NavSolution
from bench.core.records.findings import FindingTable
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import format_number
from bench.evaluation.consistency import headline, verdict
from bench.evaluation.consistency.headline import Headline, list_stops, make_headline
from bench.evaluation.metrics.key_figures import (
    MEANING,
    Measured,
    explain_rows,
    list_key_figures,
    tabulate_metrics,
)

ROOM = 14
"""Lines for the headlines of a run: with what stands before and behind them a screen of 24."""
_FIRST_LEFT_OUT: tuple[dict[str, Any], ...] = (
    {},
    {"drift": ""},
    {"figures": ""},
    {"outside": ""},
    {"required": ""},
    {"why": ""},
    {"fault": ""},
    {"stops": ""},
)
"""What is left out of headlines where there is no room, in this order."""


def print_headlines(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    """Print the verdict, error, claim and main figures of each estimator, as many lines as have room."""
    lines = [make_headline(label, values, solutions[label].events) for label, values in measured.items()]
    for left_out in _FIRST_LEFT_OUT:
        lines = [one._replace(**left_out) for one in lines]
        texts = [list(_wrap_headline(one, console.width)) for one in lines]
        if sum(map(len, texts)) <= ROOM:
            break
    for one, (first, *more) in zip(lines, texts, strict=True):
        console.print(Text(first, one.look.style))
        for text in more:
            console.print(text)
    if any("NEES" in text for own in texts for text in own):
        console.print(headline.NEES, style="dim")


def _wrap_headline(one: Headline, width: int) -> Iterator[str]:
    first = f"{one.look.mark} {one.label}: {one.first}"
    for text in (first, *one.more):
        yield from wrap(text, width, initial_indent="" if text is first else "  ", subsequent_indent="    ")


def print_metrics(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    """Print verdicts and main metrics, one column per estimator, alignments and errors not modelled."""
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
    """Print the errors over those of the best linear estimator, where they were asked for."""
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
    head = "rms over that of the best linear estimator"
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
        if values.get("unmodelled"):
            remarks.setdefault(f"not modelled: {', '.join(values['unmodelled'])}", []).append(label)
    for text, labels in remarks.items():
        console.print(f"{', '.join(labels)}: {text}")
