"""The figures of a run that stand in its table, with their bounds in words."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from bench.evaluation.metrics import find_metric
from bench.evaluation.verdict import find_bounds

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

MEANING = (
    "! outside its bounds, which stand beside or below: what this one run allows an honest filter (NEES and "
    "NIS 99.9 %, coverage 99.5 %), or the 95 % radius of the drift that the datasheets give. nees_mean: "
    "nees_states is expected. Errors of one run last, so its bounds are wide; many runs tell more."
)
OUTAGES = (
    "Outages: drift is the error at the end, growth how far the error moved since the start, which may be "
    "more or less; law is the growth that the datasheets give, root mean square."
)


def is_key_figure(name: str) -> bool:
    """Return whether a metric stands in the tables."""
    return name.startswith(_SUMMARY) and not name.endswith(("_all", "_law_95_h_m"))


def list_key_figures(measured: Measured) -> list[str]:
    """Return the names of the metrics to show, in order; bounds stand beside what they bound."""
    names = dict.fromkeys(name for values in measured.values() for name in values)
    found = [
        name
        for start in _SUMMARY
        for name in names
        if name.startswith(start) and is_key_figure(name) and find_metric(name)
    ]
    if any(values.get(_COVERAGE) not in (None, 1.0) for values in measured.values()):
        found.append(_COVERAGE)
    return found


def format_bounds(name: str, values: Mapping[str, Any]) -> str:
    """Return the bounds of a metric in one run, such as ``1.05 to 29`` or ``≥0.50``; "" if it has none."""
    bounds = find_bounds(name, values)
    if bounds is None:
        return ""
    low, high = (None if end is None else f"{end:.2f}" if end < 10 else f"{end:.3g}" for end in bounds)
    return f"{low} to {high}" if low and high else f"≥{low}" if low else f"≤{high}"


def format_number(value: Any) -> str:
    """Return a number with four digits; a dash for None."""
    return "-" if value is None else f"{value:.4g}"
