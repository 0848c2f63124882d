"""Print the result of a run: a headline for each estimator, and the table of the main metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from textwrap import wrap
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.data import NavSolution
from bench.evaluation import headline, verdict
from bench.evaluation.headline import Headline, make_headline
from bench.evaluation.key_figures import MEANING, Measured, explain_rows, format_bounds, list_key_figures
from bench.evaluation.metric_words import find_words, format_metric, group_metrics
from bench.wording import format_number
from bench.workbench.divided_table import TableColumn, print_table

ROOM = 14
"""Lines for the headlines of a run: with what stands before and behind them a screen of 24."""
_FIRST_LEFT_OUT: tuple[dict[str, Any], ...] = (
    {},
    {"drift": ""},
    {"figures": ""},
    {"outside": ""},
    {"required": ""},
    {"why": ""},
)
"""What is left out of headlines where there is no room, in this order."""


def print_headlines(console: Console, measured: Measured) -> None:
    """Print the verdict, error, claim and main figures of each estimator, as many lines as have room."""
    lines = [make_headline(label, values) for label, values in measured.items()]
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
    first = f"{one.look.mark} {one.label}: {one.word}{f'; {one.error}' if one.error else ''}"
    for text in (first, *one.more):
        yield from wrap(text, width, initial_indent="" if text is first else "  ", subsequent_indent="    ")


def print_metrics(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    """Print verdicts and main metrics, one column per estimator, alignments and errors not modelled.

    A table that is too wide for the console is divided into several.
    """
    for values in measured.values():
        if text := values.get("verdict_text"):
            console.print(text, style=headline.judge_look(str(values["verdict"]), values).style)
    names = list_key_figures(measured)
    for table in _divide(console, measured, names):
        console.print(table)
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
    cells: dict[str, dict[str, str]] = {}
    for label, rows in held.items():
        for row in rows:
            low, high = (_format_end(row[end]) for end in ("low", "high"))
            text = f"{format_number(row['ratio'])}\n{low}-{high}"
            cells.setdefault(f"{row['quantity']} {row['phase']}", {})[label] = text
    head = "rms over that of the best linear estimator"
    columns = {label: TableColumn([texts.get(label, "") for texts in cells.values()]) for label in held}
    print_table(console, {head: TableColumn(list(cells), words=True), **columns}, [head])
    meaning = "Below each ratio its 99.9 % interval, by the correlation in time of this one run."
    console.print(meaning, style="dim")


def _format_end(value: float) -> str:
    return f"{value:.2g}" if value < 100.0 else f"{value:.0f}"


def _print_remarks(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    remarks: dict[str, list[str]] = {}
    for label, values in measured.items():
        for begun, end, text in solutions[label].events.select("alignment"):
            remarks.setdefault(f"aligned from {begun:g} to {end:g} s: {text}", []).append(label)
        for kind in ("restart", "reset", "ended"):
            for begun, end, text in solutions[label].events.select(kind):
                remarks.setdefault(f"{begun:g} to {end:g} s: {text}", []).append(label)
        if values["converged"] and values.get("program"):
            stderr = values["program"]["stderr"]
            last = f"; stderr ends: {stderr.splitlines()[-1][:200]}" if stderr else ""
            console.print(f"{label}: {values['program']['program']}{last}", soft_wrap=True)
        if runs := values.get("causes_runs"):
            remarks.setdefault(f"ran {runs} times more to find out why", []).append(label)
        if values.get("same_as"):
            remarks.setdefault(f"the same as {values['same_as']} with these sensors", []).append(label)
        if values.get("unmodelled"):
            remarks.setdefault(f"not modelled: {', '.join(values['unmodelled'])}", []).append(label)
    for text, labels in remarks.items():
        console.print(f"{', '.join(labels)}: {text}")


def _divide(console: Console, measured: Measured, names: Sequence[str]) -> Iterator[Table]:
    """Yield tables that fit into the console, each with as many estimators as there is room for."""
    labels = list(measured)
    table = _make_table({label: measured[label] for label in labels}, names, narrow=False)
    if _width(console, table) <= console.width:
        yield table
        return
    while labels:
        for count in range(len(labels), 0, -1):
            table = _make_table({label: measured[label] for label in labels[:count]}, names, narrow=True)
            if _width(console, table) <= console.width or count == 1:
                break
        yield table
        labels = labels[count:]


def _width(console: Console, table: Table) -> int:
    return console.measure(table, options=console.options.update(max_width=10_000)).maximum


def _make_table(measured: Measured, names: Sequence[str], *, narrow: bool) -> Table:
    """Return the table of some estimators; if narrow, with bounds below the values."""
    table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
    table.add_column("", no_wrap=True)
    for label in measured:
        table.add_column(label.replace("-", "-\n") if narrow else label, justify="right", no_wrap=True)
    table.add_column("")
    for group, members in group_metrics(names).items():
        table.add_row(Text(group, "bold"))
        for name in members:
            cells = (_make_cell(name, values, narrow=narrow) for values in measured.values())
            table.add_row(f" {find_words(name).words}", *cells, find_words(name).unit)
    return table


def _make_cell(name: str, values: Mapping[str, Any], *, narrow: bool) -> Text:
    """Return a value with its bounds, marked if it is outside."""
    outside, bounds = verdict.is_outside(name, values), format_bounds(name, values)
    text = format_metric(name, values.get(name)) + (" !" if outside else "")
    if bounds:
        text += f"\n{bounds.replace(' to ', '-')}" if narrow else f" ({bounds})"
    return Text(text, "bold red" if outside else "")
