"""Print results, flights and catalogs as tables in the terminal."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from bench import api, config
from bench.config.datasheets import SENSORS
from bench.config.library import CatalogEntry, KeyEntry
from bench.data import NavSolution
from bench.evaluation.error_series import FAILED
from bench.evaluation.metrics import find_metric
from bench.navigation.estimator import BUILT_IN
from bench.navigation.options import Options, described
from bench.run_result import RunResult
from bench.specs import Profile
from bench.wording import one_line

_DEG = 180 / math.pi
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
    "fault_",
    "false_alarms_",
    "nees_mean",
    "nees_states",
    "nees_inside_95",
    "coverage_3sigma_",
    "nis_mean_",
)
"""Names, or beginnings of names, of the metrics in the table; all others are in result.json."""
_COVERAGE = "output_coverage"  # shown if it is not 1 for every estimator


def print_result(console: Console, profile: Profile, run: RunResult) -> None:
    """Print the main metrics of one run, one column per estimator, and the errors they do not model."""
    console.print(
        f"{one_line(profile.title)}: seed {run.seed}, run {run.run}, from {profile.evaluation_from:g} s on"
    )
    print_metrics(console, run.metrics, run.solutions)


def print_metrics(
    console: Console, measured: Mapping[str, Mapping[str, Any]], solutions: Mapping[str, NavSolution]
) -> None:
    """Print the main metrics, one column per estimator, its alignment and the errors it does not model."""
    names = list(dict.fromkeys(name for values in measured.values() for name in values))
    table = _make_metrics_table(measured, names, narrow=False)
    if console.measure(table, options=console.options.update(max_width=10_000)).maximum > console.width:
        table = _make_metrics_table(measured, names, narrow=True)
    console.print(table)
    if any(name.startswith("nis_low_") for name in names):
        console.print("nis_mean: the range is the 99.9 % band of a matched filter.")
    remarks: dict[str, list[str]] = {}
    for label, values in measured.items():
        for begun, end, text in solutions[label].events.select("alignment"):
            remarks.setdefault(f"aligned from {begun:g} to {end:g} s: {text}", []).append(label)
        for begun, end, text in solutions[label].events.select("restart"):
            remarks.setdefault(f"{begun:g} to {end:g} s: {text}", []).append(label)
        if not values["converged"]:
            failed = solutions[label].events.select(FAILED)
            text = values["reason"] if failed else f"diverged: {values['reason']}"
            console.print(f"{label} {text}", style="bold red")
        elif values.get("program"):
            stderr = values["program"]["stderr"]
            last = f"; stderr ends: {stderr.splitlines()[-1][:200]}" if stderr else ""
            console.print(f"{label}: {values['program']['program']}{last}", soft_wrap=True)
        if values.get("unmodelled"):
            remarks.setdefault(f"not modelled: {', '.join(values['unmodelled'])}", []).append(label)
    for text, labels in remarks.items():
        console.print(f"{', '.join(labels)}: {text}")


def _make_metrics_table(
    results: Mapping[str, Mapping[str, Any]], names: Sequence[str], *, narrow: bool
) -> Table:
    """Return the table of the main metrics; if narrow, without lines and with bands below their values."""
    table = _make_table("metric", *results)
    if narrow:
        table = Table(box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False)
        table.add_column("metric", no_wrap=True)
        for label in results:
            table.add_column(label.replace("-", "-\n", 1), justify="right", overflow="fold")
    for start in _SUMMARY:
        for name in names:
            if name.startswith(start) and not name.endswith("_all") and find_metric(name) is not None:
                cells = [
                    _format_number(values.get(name)) + _format_band(name, values, narrow=narrow)
                    for values in results.values()
                ]
                table.add_row(name, *cells)
    if any(values.get(_COVERAGE) not in (None, 1.0) for values in results.values()):
        table.add_row(_COVERAGE, *(_format_number(values.get(_COVERAGE)) for values in results.values()))
    return table


def _format_band(name: str, metrics: Mapping[str, Any], *, narrow: bool) -> str:
    """Return the 99.9 % band of a mean NIS for a matched filter, as text."""
    sensor = name.removeprefix("nis_mean_")
    low, high = metrics.get(f"nis_low_{sensor}"), metrics.get(f"nis_high_{sensor}")
    if sensor == name or low is None:
        return ""
    return f"\n{low:.2f}-{high:.2f}" if narrow else f" ({low:.3g} to {high:.3g})"


def print_flight(console: Console, profile: Profile, summary: Mapping[str, Any]) -> None:
    """Print the legs of a flight and its extremes, as `bench.pipeline.fly_over` returns them."""
    console.print(f"{one_line(profile.title)}: {profile.flight.label}")
    table = Table()
    for column in ("from", "to"):
        table.add_column(column, justify="right", no_wrap=True)
    table.add_column("leg", overflow="fold")
    for start, end, text in summary["legs"]:
        table.add_row(f"{start:.1f} s", f"{end:.1f} s", text)
    console.print(table)
    figures = Table.grid(padding=(0, 2))
    for name, text in _describe_flight(summary).items():
        figures.add_row(name, text)
    console.print(figures)
    print_sanity(console, summary["sanity"])


def print_sanity(console: Console, remarks: Sequence[tuple[float, float, str]]) -> None:
    """Print motions that are implausible for the aircraft class, or inconsistent rows of a table."""
    for start, end, text in remarks:
        when = f"{start:.1f} s" if end == start else f"{start:.1f} to {end:.1f} s"
        console.print(f"sanity, {when}: {text}", style="yellow")


def _describe_flight(summary: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of a flight as text, by name."""

    def format_range(name: str, unit: str, digits: int, scale: float = 1.0) -> str:
        ends = [summary.get(f"{name}_{end}{unit}") for end in ("min", "max")]
        return " to ".join("-" if end is None else f"{scale * end:.{digits}f}" for end in ends)

    def format_degrees(name: str) -> str:
        return f"{_DEG * summary[name]:.1f}"

    rates = ", ".join(format_degrees(f"{axis}_rate_max_rad_s") for axis in ("roll", "pitch", "yaw"))
    return {
        "duration": f"{summary['duration_s']:g} s, {summary['samples']} samples at {summary['rate_hz']:g} Hz",
        "distance over ground": f"{summary['path_over_ground_m'] / 1000:.2f} km",
        "altitude": f"{format_range('alt', '_m', 1)} m",
        "true airspeed": f"{format_range('airspeed', '_mps', 1)} m/s",
        "ground speed": f"{format_range('ground_speed', '_mps', 1)} m/s",
        "climb": f"{format_range('climb', '_mps', 1)} m/s",
        "bank": f"up to {format_degrees('bank_max_rad')} deg",
        "pitch": f"{format_range('pitch', '_rad', 1, _DEG)} deg",
        "load factor": format_range("load_factor", "", 2),
        "roll, pitch, yaw rate": f"up to {rates} deg/s",
        "replay": f"{1e3 * summary['replay_position_m']:.2g} mm, "
        f"{1e6 * summary['replay_attitude_rad']:.2g} microradian: largest error of an error-free two-sample "
        "strapdown within 10 minutes",
    }


_SHELVES: Mapping[str, tuple[str, Callable[[], list[CatalogEntry]]]] = {
    "profiles": ("bench run NAME", config.list_profiles),
    "aircraft": ("aircraft = NAME", config.list_aircraft),
    "legs": ("[[leg]] kind = NAME", config.list_legs),
    "sensors": (f"[sensors] {', '.join(SENSORS)} = NAME", config.list_sensors),
    "estimators": (
        "use = NAME, 'module:Class', 'file:SOLUTION' or 'command:PROGRAM ...'",
        config.list_estimators,
    ),
    "exports": ("bench export RUN --to NAME", api.list_exports),
}
"""Kind that `bench list` shows -> how it is selected, and the function that lists its entries."""


def list_catalog(kind: str | None = None) -> dict[str, list[CatalogEntry]]:
    """Return what there is on each shelf by its name, or on one of them."""
    return {name: entries() for name, (_, entries) in _SHELVES.items() if kind in (None, name)}


def print_catalog(console: Console, kind: str | None = None) -> None:
    """Print the entries of `list_catalog`.

    With a kind, aircraft and sensors also show their figures and sources and what is assumed, legs their
    keys, estimators their options.
    """
    for name, entries in list_catalog(kind).items():
        if kind == "legs":
            for entry in entries:
                _print_grid(
                    console, f"{entry.name}: {entry.title}", [_describe_key(key) for key in entry.keys]
                )
            continue
        rows = []
        for entry in entries:
            what = f"{entry.title}: {entry.note}" if kind and entry.note else entry.title
            rows.append((entry.kind, entry.name, what) if name == "sensors" else (entry.name, what))
        _print_grid(console, f"{name.capitalize()} ({_SHELVES[name][0]})", rows)
    if kind == "estimators":
        _print_options(console)


def _print_grid(console: Console, title: str, rows: Sequence[Sequence[str]]) -> None:
    console.print(title, style="italic", soft_wrap=True)
    grid = Table(show_header=False, box=None, padding=(0, 2))
    for _ in rows[0] if rows else ():
        grid.add_column(overflow="fold")
    for row in rows:
        grid.add_row(*row)
    if rows:
        console.print(grid)
    console.print()


def _describe_key(key: KeyEntry) -> tuple[str, ...]:
    """Return the cells for a key of a leg: name, limits, default, description."""
    holds = ", ".join(key.choices) or "tables"
    if key.low is not None:
        holds = f"{key.low:g} to {key.high:g} {key.unit}"
    default = "required" if key.required else "optional"
    if key.default is not None:
        default = key.default if isinstance(key.default, str) else f"{key.default:g} {key.unit}"
    return f"{key.name:14}", f"{holds:26}", f"{default:8}", key.words


def _print_options(console: Console) -> None:
    """Print the options of the built-in estimators; those that share options are shown together."""
    owners: dict[type[Options], list[str]] = {}
    for name, row in BUILT_IN.items():
        owners.setdefault(row.options, []).append(name)
    for model, names in owners.items():
        base = next((one for one in model.__bases__ if one in owners), None)
        known = described(base) if base else []
        rows = [option for option in described(model) if option not in known]
        shared = f": those of {owners[base][0]}{', and' if rows else ''}" if base else ""
        _print_grid(console, f"Options of {', '.join(names)}{shared}", rows)


def _make_table(first: str, *others: str) -> Table:
    table = Table()
    table.add_column(first, no_wrap=True)
    for name in others:
        table.add_column(name, justify="right" if name else "left", no_wrap=bool(name))
    return table


def _format_number(value: Any) -> str:
    return "-" if value is None else f"{value:.4g}"
