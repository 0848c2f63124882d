"""The table of a run or a log on one screen: a row for each filter."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from bench.core.records.findings import FindingTable
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import format_number
from bench.evaluation.consistency.headline import Headline, find_worst_fault
from bench.evaluation.consistency.verdict import find_bounds, format_distance, format_nees

Measured = Mapping[str, Mapping[str, Any]]
_NIS = "nis_mean_"


def _in_metres(name: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda values: "-" if values.get(name) is None else format_distance(values[name])


def _in(name: str, unit: str) -> Callable[[Mapping[str, Any]], str]:
    return lambda values: "-" if values.get(name) is None else f"{format_number(values[name], 2)} {unit}"


_HORIZONTAL = {
    "horizontal\nRMS": _in_metres("pos_rmse_h_m"),
    "reported\n1 sigma": _in_metres("pos_sigma_h_m"),
}
_ATTITUDE = {"tilt\nRMS": _in("tilt_rmse_deg", "deg"), "heading\nRMS": _in("heading_rmse_deg", "deg")}


def tabulate_run(measured: Measured, lines: Sequence[Headline], *, wide: bool = False) -> FindingTable:
    """Return the table of a run: errors, NEES, outage drift and verdict of each filter.

    Parameters
    ----------
    measured : mapping
        Filter -> metric -> value.
    lines : sequence of Headline
        Of the same filters, in the same order.
    wide : bool
        There is room for velocity and attitude.
    """
    without = any(values.get("pos_rmse_h_m") is None for values in measured.values())
    columns = {**_HORIZONTAL, "vertical\nRMS": _in_metres("pos_rmse_d_m")}
    if wide:
        columns["velocity\nRMS"] = _in("vel_rmse_3d_mps", "m/s")
    if wide or without:
        columns.update(_ATTITUDE)
    states = {values["nees_states"] for values in measured.values() if values.get("nees_states")}
    if len(states) == 1:
        columns[f"NEES\nideal {states.pop():g}"] = lambda values: _show_nees(values, "")
    else:
        columns["NEES\n(ideal)"] = lambda values: _show_nees(values, f" ({values.get('nees_states') or 0:g})")
    columns["outage\ndrift"] = _find_drift
    columns["fault\ndetected"] = _find_detection
    return _tabulate(measured, lines, columns)


def tabulate_log(measured: Measured, lines: Sequence[Headline], *, wide: bool = False) -> FindingTable:
    """Return the table of a log: distance to the withheld fixes, mean NIS and verdict of each filter.

    A last row has the range of the mean NIS of a consistent filter; if filters have different ranges, of the
    first one that has any. Parameters as for a run.
    """
    sensors = dict.fromkeys(
        name.removeprefix(_NIS)
        for values in measured.values()
        for name in values
        if name.startswith(_NIS) and not name.endswith("_all")
    )
    columns = dict(_HORIZONTAL)
    ranges = {"filter": "range", "verdict": ""}
    for sensor in sensors:
        head = f"NIS\n{sensor.removeprefix('gnss_')}"
        columns[head] = partial(_show_nis, sensor)
        found = _list_ranges(measured, sensor)
        ranges[head] = next(iter(found), "")
        if len(set(found)) > 1:
            ranges["filter"] = "range (1st)"
    if wide:
        columns["velocity\nRMS"] = _in("vel_rmse_3d_mps", "m/s")
    table = _tabulate(measured, lines, columns)
    last = {head: ranges.get(head, "") for head in table.columns}
    shown = {
        head: text if head in ("filter", "verdict") else ShownFigure(text) for head, text in last.items()
    }
    return replace(table, columns={head: [*cells, shown[head]] for head, cells in table.columns.items()})


def _tabulate(
    measured: Measured, lines: Sequence[Headline], columns: Mapping[str, Callable[[Mapping[str, Any]], str]]
) -> FindingTable:
    cells: dict[str, list[Any]] = {"filter": list(measured)}
    for head, show in columns.items():
        texts = [show(values) for values in measured.values()]
        if set(texts) - {"-"}:
            cells[head] = [ShownFigure(text) for text in texts]
    cells["verdict"] = [f"{one.look.mark} {one.word}" for one in lines]
    return FindingTable("filters", "", cells)


def _show_nees(values: Mapping[str, Any], ideal: str) -> str:
    mean = values.get("nees_mean")
    return "-" if mean is None else f"{format_nees(mean)}{ideal}"


def _show_nis(sensor: str, values: Mapping[str, Any]) -> str:
    mean = values.get(f"{_NIS}{sensor}")
    return "-" if mean is None else f"{mean:.3g}"


def _list_ranges(measured: Measured, sensor: str) -> list[str]:
    """Return the range of the mean NIS of a sensor for each filter that uses the sensor."""
    bounds = [find_bounds(f"{_NIS}{sensor}", values) or (None, None) for values in measured.values()]
    return [
        f"{format_number(low, 2)}-{format_number(high, 2)}"
        for low, high in bounds
        if low is not None and high is not None
    ]


def _find_detection(values: Mapping[str, Any]) -> str:
    """Return the delay until the fault with the largest error was detected."""
    number = find_worst_fault(values)
    if values.get(f"fault_{number}_detected") is None:
        return "-"
    delay = values.get(f"fault_{number}_delay_s")
    return "no" if delay is None else f"{format_number(delay, 2)} s"


def _find_drift(values: Mapping[str, Any]) -> str:
    """Return the largest drift of the outages; "-" without one, or without any horizontal aiding."""
    grown = [
        value
        for name, value in values.items()
        if name.startswith("outage_") and name.endswith("_growth_h_m") and value is not None
    ]
    return format_distance(max(grown)) if grown and values.get("inertial_end_h_m") is None else "-"
