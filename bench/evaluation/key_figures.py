"""The figures of a run that stand in its table, with their bounds in words."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from bench.evaluation.metrics import find_metric
from bench.evaluation.verdict import find_bounds
from bench.wording import format_number

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
    "NIS 99.9 %, coverage 99.5 %), or the 95 % radius of the drift that the datasheets give. Errors of one "
    "run change slowly: it holds few independent values, so its bounds are wide; many runs tell more."
)
_ROWS = {
    "pos_claimed": "claimed: root mean square of the sigma that the filter gives",
    "cep": "cep50, cep95: radius around the truth that holds 50, 95 % of the horizontal positions",
    "heading_convergence": "heading_convergence: from then on the heading is right within 1 deg or 3 sigma; "
    "no sooner than the figures begin",
    "drift_end": "drift_end: error at the end over the distance flown",
    "inertial_end": "inertial_end: error at the end without any fix",
    "nees": "nees_mean: squared error over covariance, nees_states is expected",
    "nees_inside_95": "nees_inside_95: share of the time with NEES in the central 95 % of its distribution",
    "coverage": "coverage: share of the time with an error within 3 sigma, 0.997 is expected",
    "nis": "nis: squared innovation over its covariance; it is low where R is larger than the scatter of the "
    "fixes, and their slow wander does not show in it",
    "fault_": "fault_N: the N-th fault of the profile; detected: 1 if the filter refused or reported it; "
    "delay from its start; max_h: largest horizontal error while it lasts",
    "false_alarms": "false_alarms: sound measurements that were refused",
}
"""Beginning of the name of a row -> what it is."""
OUTAGES = (
    "Outages: drift is the error at the end, growth how far the error moved since the start, which may be "
    "more or less; law is the growth that the datasheets give, root mean square."
)


def is_key_figure(name: str) -> bool:
    """Return whether a metric stands in the tables."""
    return name.startswith(_SUMMARY) and not name.endswith(("_all", "_law_95_h_m"))


def explain_rows(names: Sequence[str]) -> list[str]:
    """Return what rows of the table are that their names do not tell, a text for each kind."""
    found = [text for start, text in _ROWS.items() if any(name.startswith(start) for name in names)]
    axes = "h: horizontal; n, e, d: north, east, down"
    attitude = ["phi: attitude error about n, e, d"] if any("_phi_" in name for name in names) else []
    return [axes, *attitude, *found]


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
    low, high = (
        None if end is None else f"{end:.2f}" if end < 10 else format_number(end, 3) for end in bounds
    )
    return f"{low} to {high}" if low and high else f"≥{low}" if low else f"≤{high}"
