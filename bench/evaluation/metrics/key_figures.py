"""Metrics of a run that its table shows, with their bounds in words."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from bench.core.records.findings import FindingTable
from bench.core.words.notebook import ShownFigure, ShownText
from bench.core.words.wording import format_number
from bench.evaluation.consistency.verdict import find_bounds, is_outside
from bench.evaluation.metrics.metric_words import find_words, format_metric, group_metrics, name_metric
from bench.evaluation.metrics.run_metrics import find_metric

Measured = Mapping[str, Mapping[str, Any]]
"""Estimator -> metric -> value."""

_SUMMARY = (
    "pos_rmse_h_m",
    "pos_sigma_h_m",
    "pos_rmse_d_m",
    "cep50_m",
    "cep95_m",
    "vel_rmse_3d_mps",
    "tilt_rmse_deg",
    "heading_rmse_deg",
    "heading_convergence_s",
    "drift_end_percent",
    "tse_",
    "fte_across_",
    "nse_across_",
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
_ATTITUDE = ("total_error_rmse_deg", "inclination_rmse_deg", "heading_drift_rmse_deg")
"""Shown, too, if no filter estimates a position."""
_COVERAGE = "output_coverage"  # shown if it is not 1 for every filter

MEANING = (
    "! outside its bounds, which stand beside or below: the range of a consistent filter in one run (NEES, "
    "NIS 99.9 %, coverage 99.5 %), or the 95 % radius of the predicted drift. Errors of one "
    "run change slowly: it holds few independent values, so its bounds are wide; many runs narrow them."
)
_ROWS = {
    "pos_sigma": "reported: RMS of the standard deviation that the filter reports",
    "heading_convergence": "the heading time is never earlier than the start of the evaluation",
    "outage_": "outage drift: length of the horizontal error vector at the end minus the one at the start",
    "nees": "NEES, normalized estimation error squared: the number of states is ideal",
    "coverage": "99.7 % within 3 sigma is ideal",
    "nis": "NIS, normalized innovation squared: 3 is ideal for a GNSS position or velocity, 1 for a "
    "scalar; it is low if R includes slowly varying errors, which do not show between fixes",
    "fault_": "a fault is detected if the filter rejected two measurements in a row, or reported it",
}
"""Beginning of the name of a row -> what its words do not say."""


def is_key_figure(name: str) -> bool:
    """Return whether the tables show a metric."""
    return name.startswith(_SUMMARY) and not name.endswith(("_all", "_predicted_95_h_m"))


def explain_rows(names: Sequence[str]) -> list[str]:
    """Return the explanations of table rows that need more than a label, one text for each kind."""
    return [text for start, text in _ROWS.items() if any(name.startswith(start) for name in names)]


def list_key_figures(measured: Measured) -> list[str]:
    """Return the names of the metrics to show, in order; bounds are shown beside their metrics."""
    names = dict.fromkeys(name for values in measured.values() for name in values)
    found = [
        name
        for start in _SUMMARY
        for name in names
        if name.startswith(start) and is_key_figure(name) and find_metric(name)
    ]
    if "pos_rmse_h_m" not in names and "tilt_rmse_deg" in found:
        at = found.index("tilt_rmse_deg")
        found[at:at] = [name for name in _ATTITUDE if name in names]
    if any(values.get(_COVERAGE) not in (None, 1.0) for values in measured.values()):
        found.append(_COVERAGE)
    return found


def tabulate_metrics(measured: Measured, names: Iterable[str], title: str = "") -> FindingTable:
    """Return the table of some metrics by heading, with their bounds; a column for each estimator."""
    columns: dict[str, list[str | ShownText | ShownFigure]] = {"": [], **{label: [] for label in measured}}
    for heading, members in group_metrics(names).items():
        columns[""].append(heading)
        for label in measured:
            columns[label].append(ShownFigure(""))
        for name in members:
            known = find_metric(name)
            columns[""].append(ShownText(name_metric(name), tip=f"{name}: {known.words if known else ''}"))
            for label, values in measured.items():
                columns[label].append(_show_metric(name, values))
    return FindingTable("metrics", title, columns, heads={"": "metric"})


def _show_metric(name: str, values: Mapping[str, Any]) -> ShownFigure:
    text, bounds = format_metric(name, values.get(name)), format_bounds(name, values)
    return ShownFigure(text, bounds, is_outside(name, values))


def format_bounds(name: str, values: Mapping[str, Any]) -> str:
    """Return the bounds of a metric in one run, such as ``1.05 to 29`` or ``≥50``; "" if it has none."""
    bounds = find_bounds(name, values)
    if bounds is None:
        return ""
    factor = find_words(name).factor
    low, high = (None if end is None else format_bound(factor * end) for end in bounds)
    return f"{low} to {high}" if low and high else f"≥{low}" if low else f"≤{high}"


def format_bound(value: float) -> str:
    """Return a bound with two decimals below ten, else with three digits."""
    return f"{value:.2f}" if value < 10 else format_number(value, 3)
