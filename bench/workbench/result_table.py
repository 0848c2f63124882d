"""Print the result of a run: a verdict for each estimator, then the table of the main metrics."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.data import NavSolution
from bench.evaluation import verdict
from bench.evaluation.metrics import find_metric
from bench.run_result import RunResult
from bench.specs import Profile
from bench.wording import one_line

Measured = Mapping[str, Mapping[str, Any]]
"""Estimator -> metric -> value."""

_SUMMARY = (
    "pos_rmse_h_m",
    "pos_claimed_h_m",
    "pos_rmse_d_m",
    "cep50_m",
    "cep95_m",
    "vel_rmse_3d_mps",
    "tilt_rmse_deg",
    "heading_rmse_deg",
    "heading_convergence_s",
    "drift_end_percent",
    "inertial_end_",
    "outage_",
    "fault_",
    "false_alarms_",
    "nees_mean",
    "nees_states",
    "nees_inside_95",
    "coverage_3sigma_pos",
    "coverage_3sigma_vel",
    "coverage_3sigma_phi",
    "nis_mean_",
)
"""Names, or beginnings of names, of the metrics in the table; all others are in result.json."""
_COVERAGE = "output_coverage"  # shown if it is not 1 for every estimator
_STYLES = {
    verdict.OVERCONFIDENT: "bold red",
    verdict.DIVERGED: "bold red",
    verdict.FAILED: "bold red",
    verdict.UNDERCONFIDENT: "yellow",
    verdict.CONSISTENT: "green",
}
_MEANING = (
    "! outside its bounds, which stand beside or below: what this one run allows an honest filter (NEES and "
    "NIS 99.9 %, coverage 99.5 %), or the 95 % radius of the drift that the datasheets give. nees_mean: "
    "nees_states is expected. Errors of one run last, so its bounds are wide; many runs tell more."
)
_OUTAGES = (
    "Outages: drift is the error at the end, growth how far the error moved since the start, which may be "
    "more or less; law is the growth that the datasheets give, root mean square."
)


def print_result(console: Console, profile: Profile, run: RunResult) -> None:
    """Print verdicts and main metrics of one run, one column per estimator, and the errors not modelled."""
    begun = profile.evaluation_from
    console.print(f"{one_line(profile.title)}: seed {run.seed}, run {run.run}, from {begun:g} s on")
    print_metrics(console, run.metrics, run.solutions)


def print_metrics(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    """Print verdicts and main metrics, one column per estimator, alignments and errors not modelled.

    A table that is too wide for the console is divided into several.
    """
    for values in measured.values():
        if text := values.get("verdict_text"):
            console.print(text, style=_STYLES.get(values["verdict"]))
    names = _list_rows(measured)
    for table in _divide(console, measured, names):
        console.print(table)
    if any(verdict.find_bounds(name, values) for values in measured.values() for name in names):
        console.print(_MEANING, style="dim")
    if any(name.startswith("outage_") for name in names):
        console.print(_OUTAGES, style="dim")
    for values in measured.values():
        for text in values.get("drift_text", ()):
            console.print(text)
    _print_remarks(console, measured, solutions)


def _print_remarks(console: Console, measured: Measured, solutions: Mapping[str, NavSolution]) -> None:
    remarks: dict[str, list[str]] = {}
    for label, values in measured.items():
        for begun, end, text in solutions[label].events.select("alignment"):
            remarks.setdefault(f"aligned from {begun:g} to {end:g} s: {text}", []).append(label)
        for begun, end, text in solutions[label].events.select("restart"):
            remarks.setdefault(f"{begun:g} to {end:g} s: {text}", []).append(label)
        if values["converged"] and values.get("program"):
            stderr = values["program"]["stderr"]
            last = f"; stderr ends: {stderr.splitlines()[-1][:200]}" if stderr else ""
            console.print(f"{label}: {values['program']['program']}{last}", soft_wrap=True)
        if values.get("unmodelled"):
            remarks.setdefault(f"not modelled: {', '.join(values['unmodelled'])}", []).append(label)
    for text, labels in remarks.items():
        console.print(f"{', '.join(labels)}: {text}")


def _list_rows(measured: Measured) -> list[str]:
    """Return the names of the metrics to show, in order; bounds stand beside what they bound."""
    names = dict.fromkeys(name for values in measured.values() for name in values)
    found = [
        name
        for start in _SUMMARY
        for name in names
        if name.startswith(start) and not name.endswith(("_all", "_law_95_h_m")) and find_metric(name)
    ]
    if any(values.get(_COVERAGE) not in (None, 1.0) for values in measured.values()):
        found.append(_COVERAGE)
    return found


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
    table.add_column("metric", no_wrap=True)
    for label in measured:
        table.add_column(label.replace("-", "-\n") if narrow else label, justify="right", no_wrap=True)
    for name in names:
        table.add_row(name, *(_make_cell(name, values, narrow=narrow) for values in measured.values()))
    return table


def _make_cell(name: str, values: Mapping[str, Any], *, narrow: bool) -> Text:
    """Return a value with its bounds, marked if it is outside."""
    bounds, outside = verdict.find_bounds(name, values), verdict.is_outside(name, values)
    text = format_number(values.get(name)) + (" !" if outside else "")
    if bounds is not None:
        low, high = (None if end is None else f"{end:.2f}" if end < 10 else f"{end:.3g}" for end in bounds)
        ends = f"{low}-{high}" if low and high else f"≥{low}" if low else f"≤{high}"
        text += f"\n{ends}" if narrow else f" ({ends.replace('-', ' to ')})"
    return Text(text, "bold red" if outside else "")


def format_number(value: Any) -> str:
    """Return a number with four digits; a dash for None."""
    return "-" if value is None else f"{value:.4g}"
