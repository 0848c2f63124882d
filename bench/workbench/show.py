"""Tables in the terminal: a result, a flight, a verdict, and what there is to choose from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.baselines import Verdict
from bench.config import list_aircraft, list_profiles, list_sensors
from bench.data import RunResult, Trajectory
from bench.evaluation.metrics import metric_of
from bench.flight import summarise
from bench.navigation.estimator import BUILT_IN
from bench.specs import Profile

_SUMMARY = (
    "pos_rmse_h_m",
    "pos_rmse_d_m",
    "cep50_m",
    "cep95_m",
    "vel_rmse_3d_mps",
    "tilt_rmse_deg",
    "heading_rmse_deg",
    "heading_convergence_s",
    "outage_",
    "nees_mean",
    "nees_states",
    "nees_inside_95",
    "coverage_3sigma_",
    "nis_mean_",
)
"""Metrics of the table, or how their names begin; all the others are in result.json."""


def result(console: Console, profile: Profile, run: RunResult) -> None:
    """Print the main metrics of one run, a column for each estimator, and what they do not model."""
    console.print(f"{profile.title}: seed {run.seed}, run {run.run}, from {profile.evaluation_from:g} s on")
    table = _table("metric", *run.metrics)
    names = dict.fromkeys(name for metrics in run.metrics.values() for name in metrics)
    for start in _SUMMARY:
        for name in names:
            if name.startswith(start) and not name.endswith("_all") and metric_of(name) is not None:
                values = [
                    _number(metrics.get(name)) + _band(name, metrics) for metrics in run.metrics.values()
                ]
                table.add_row(name, *values)
    console.print(table)
    for label, metrics in run.metrics.items():
        if not metrics["converged"]:
            console.print(f"{label} diverged: {metrics['reason']}", style="bold red")
        if metrics.get("unmodelled"):
            console.print(f"{label} does not model: {', '.join(metrics['unmodelled'])}")


def _band(name: str, metrics: Mapping[str, Any]) -> str:
    """Return the 99.9 % band of a mean NIS, where the filter is matched."""
    sensor = name.removeprefix("nis_mean_")
    low, high = metrics.get(f"nis_low_{sensor}"), metrics.get(f"nis_high_{sensor}")
    return f" ({low:.3g} to {high:.3g})" if sensor != name and low is not None else ""


def flight(console: Console, profile: Profile, truth: Trajectory) -> None:
    """Print what was flown, leg by leg, and its extremes."""
    flown = summarise(truth)
    console.print(f"{profile.title}: {profile.flight.aircraft.name}")
    table = _table("flown", "")
    for start, end, text in flown.pop("legs"):
        table.add_row(f"{start:.1f} to {end:.1f} s", text)
    for name, value in flown.items():
        in_deg = "_rad" in name
        shown = np.rad2deg(value) if in_deg else value
        table.add_row(name.replace("_rad", "_deg"), f"{shown:.6g}")
    console.print(table)


def verdicts(console: Console, rows: Sequence[Verdict]) -> None:
    """Print the limits that do not hold, and how many do."""
    columns = ("profile", "estimator", "metric", "expected", "tolerance", "measured", "")
    table = _table(*columns)
    for row in rows:
        if row.regressed or row.improved:
            verdict = Text("worse", "bold red") if row.regressed else Text("better")
            numbers = [_number(value) for value in (row.expected, row.tolerance, row.measured)]
            table.add_row(row.profile, row.estimator, row.metric, *numbers, verdict)
    if table.row_count:
        console.print(table)
    held = sum(not row.regressed for row in rows)
    console.print(f"{held} of {len(rows)} limits hold.")


def choices(console: Console, kind: str | None = None) -> None:
    """Print the profiles, aircraft, sensors and estimators there are, or those of one kind.

    Of the sensors alone also where their figures are from, and which of them are assumed.
    """
    sensors = list_sensors()
    shelves: Mapping[str, Sequence[Sequence[str]]] = {
        "Profiles (bench run NAME)": list_profiles(),
        "Aircraft (aircraft = NAME)": list_aircraft(),
        "Sensors ([sensors] imu, gnss, baro = NAME)": [row[:3] for row in sensors]
        if kind is None
        else [(*row[:2], f"{row[2]}: {row[3]}") for row in sensors],
        "Estimators (use = NAME, or 'module:Class' of your own)": [
            (name, what) for name, (what, _, _) in BUILT_IN.items()
        ],
    }
    for title, rows in shelves.items():
        if kind is not None and not title.lower().startswith(kind):
            continue
        table = Table(title=title, title_justify="left", show_header=False, box=None, padding=(0, 2))
        for _ in rows[0] if rows else ():
            table.add_column(overflow="fold")
        for row in rows:
            table.add_row(*row)
        console.print(table)
        console.print()


def _table(first: str, *others: str) -> Table:
    table = Table()
    table.add_column(first, no_wrap=True)
    for name in others:
        table.add_column(name, justify="right" if name else "left", no_wrap=bool(name))
    return table


def _number(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}"
