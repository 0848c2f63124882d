"""Names of metrics for people: in words, with the unit, under a heading.

Its name stays the identifier in files. A metric that has no words here is called by the first line of its
function, so that a new metric needs none.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from functools import cache
from typing import Any, NamedTuple

from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.wording import format_number
from bench.evaluation.errors.error_series import AXIS_TITLES
from bench.evaluation.metrics.run_metrics import METRICS, Metric, find_metric

POSITION, MOTION, HONESTY = "Position", "Velocity and attitude", "Consistency of the covariance"
OUTAGES, FAULTS, FILTER, OTHER = "Without GNSS", "Faults", "What the filter did", "Other"

_WORDS: Mapping[str, tuple[str, str]] = {
    "pos_rmse_{}_m": (POSITION, "{} error, rms"),
    "pos_sigma_h_m": (POSITION, "horizontal error, reported"),
    "pos_max_h_m": (POSITION, "horizontal error, largest"),
    "pos_max_v_m": (POSITION, "height error, largest"),
    "cep50_m": (POSITION, "horizontal error, 50 % below"),
    "cep95_m": (POSITION, "horizontal error, 95 % below"),
    "r95_m": (POSITION, "horizontal error, 95 % below (R95)"),
    "pos_95_v_m": (POSITION, "height error, 95 % below"),
    "drift_{}_percent": (POSITION, "{} over the distance"),
    "ape_aligned_rmse_m": (POSITION, "error of the aligned track, rms"),
    "rpe_{}_m": (POSITION, "relative error over {}"),
    "tse_{}_m": (POSITION, "flown by it: truth off the path (TSE), {}"),
    "fte_{}_m": (POSITION, "flown by it: belief off the path (FTE), {}"),
    "nse_{}_m": (POSITION, "flown by it: belief off the truth (NSE), {}"),
    "vel_rmse_{}_mps": (MOTION, "{} velocity error, rms"),
    "vel_max_mps": (MOTION, "velocity error, largest"),
    "phi_rmse_{}_deg": (MOTION, "{} error, rms"),
    "tilt_rmse_deg": (MOTION, "tilt error (roll and pitch), rms"),
    "heading_rmse_deg": (MOTION, "heading error, rms"),
    "heading_max_deg": (MOTION, "heading error, largest"),
    "total_error_rmse_deg": (MOTION, "total attitude error, rms"),
    "total_error_max_deg": (MOTION, "total attitude error, largest"),
    "inclination_rmse_deg": (MOTION, "inclination error, rms"),
    "vertical_part_rmse_deg": (MOTION, "attitude error about the vertical, rms"),
    "heading_drift_rmse_deg": (MOTION, "heading error since the first epoch, rms"),
    "heading_convergence_s": (MOTION, "heading within 1 deg or 3 sigma from"),
    "heading_right_s": (MOTION, "heading within 3 deg from"),
    "rpe_{}_deg": (MOTION, "relative attitude error over {}"),
    "gyro_bias_rmse_{}_deg_h": (MOTION, "gyro bias error {}, rms"),
    "accel_bias_rmse_{}_mg": (MOTION, "accelerometer bias error {}, rms"),
    "time_offset_ms": (MOTION, "time offset"),
    "inertial_end_h_m": (OUTAGES, "error at the end without any fix"),
    "inertial_predicted_{}_h_m": (OUTAGES, "the same by the datasheet, {}"),
    "outage_{}_growth_h_m": (OUTAGES, "outage {}: the error moved by"),
    "outage_{}_predicted_h_m": (OUTAGES, "outage {}: predicted, rms"),
    "outage_{}_predicted_95_h_m": (OUTAGES, "outage {}: predicted, 95 %"),
    "outage_{}_drift_h_m": (OUTAGES, "outage {}: error at its end"),
    "fault_{}_detected": (FAULTS, "fault {}: detected"),
    "fault_{}_delay_s": (FAULTS, "fault {}: detected after"),
    "fault_{}_alarm_share": (FAULTS, "fault {}: rejected for, of its time"),
    "fault_{}_max_h_m": (FAULTS, "fault {}: largest horizontal error"),
    "false_alarms_{}": (FAULTS, "sound measurements rejected, {}"),
    "false_alarm_rate_per_h": (FAULTS, "false alarms"),
    "false_alarm_share": (FAULTS, "sound measurements rejected"),
    "nees_mean": (HONESTY, "NEES, mean"),
    "nees_states": (HONESTY, "ideal NEES (number of states)"),
    "nees_low": (HONESTY, "NEES, least that fits"),
    "nees_high": (HONESTY, "NEES, most that fits"),
    "nees_samples": (HONESTY, "NEES, independent values"),
    "nees_inside_95": (HONESTY, "time with NEES in its middle 95 %"),
    "coverage_3sigma_pos_{}": (HONESTY, "{} within 3 sigma"),
    "coverage_3sigma_vel_{}": (HONESTY, "{} velocity within 3 sigma"),
    "coverage_3sigma_phi_{}": (HONESTY, "{} within 3 sigma"),
    "coverage_3sigma_bias_{}": (HONESTY, "{} within 3 sigma"),
    "coverage_low_pos_{}": (HONESTY, "{} within 3 sigma, least that fits"),
    "coverage_low_vel_{}": (HONESTY, "{} velocity within 3 sigma, least that fits"),
    "coverage_low_phi_{}": (HONESTY, "{} within 3 sigma, least that fits"),
    "nees_ratio_{}": (HONESTY, "NEES over its ideal value, {}"),
    "log_score_{}": (HONESTY, "logarithmic score, {}"),
    "coverage_1sigma_{}": (HONESTY, "{} within 1 sigma"),
    "coverage_2sigma_{}": (HONESTY, "{} within 2 sigma"),
    "error_over_sigma_{}": (HONESTY, "{} error over its sigma, rms"),
    "nees_bias_{}": (HONESTY, "NEES of {}"),
    "nees_low_bias_{}": (HONESTY, "NEES of {}, least that fits"),
    "nees_high_bias_{}": (HONESTY, "NEES of {}, most that fits"),
    "nis_mean_{}": (HONESTY, "NIS {}, mean"),
    "nis_low_{}": (HONESTY, "NIS {}, least that fits"),
    "nis_high_{}": (HONESTY, "NIS {}, most that fits"),
    "output_coverage": (FILTER, "epochs answered"),
    "availability_{}": (FILTER, "epochs with {}"),
    "first_answer_s": (FILTER, "first answer at"),
    "updates_{}": (FILTER, "updates by {}"),
    "rejected_{}": (FILTER, "rejected, {}"),
    "longest_rejection_{}_s": (FILTER, "longest rejection of {}"),
    "events_{}": (FILTER, "events: {}"),
}
"""Name of a row of `METRICS` -> its heading, and words in which ``{}`` is what the name has there."""

GROUPS = (POSITION, MOTION, OUTAGES, FAULTS, HONESTY, FILTER, OTHER)
"""Headings in the order of the tables."""

_KEYS = {
    **AXIS_TITLES,
    **{"n": "north", "e": "east", "d": "height", "h": "horizontal", "3d": "3D"},
    **{"pos": "position", "vel": "velocity", "phi": "attitude", "rms": "rms", "95": "95 %"},
    **{"end": "error at the end", "segments": "drift of segments"},
    **{"gnss_position": "GNSS position", "gnss_velocity": "GNSS velocity"},
    **{name: row.title for name, row in INSTRUMENTS.items()},
}
_LENGTH = re.compile(r"^(\d+)(s|m|km)$")
_SHARES = (
    *("coverage_", "nees_inside_95", "output_coverage", "availability_"),
    *("false_alarm_share", "fault_{}_alarm_share"),
)
"""Beginnings of names of shares, shown in percent."""


class MetricWords(NamedTuple):
    """Words, unit and heading of a metric."""

    group: str
    words: str
    unit: str  # "" if it has none
    factor: float  # from the value in files to the value that is shown


@cache
def find_words(name: str) -> MetricWords:
    """Return words, unit and heading of a metric.

    Examples
    --------
    >>> find_words("pos_rmse_h_m")
    MetricWords(group='Position', words='horizontal error, rms', unit='m', factor=1.0)
    """
    metric = find_metric(name)
    if metric is None:
        return MetricWords(OTHER, name.replace("_", " "), "", 1.0)
    group, words = _WORDS.get(metric.name, (OTHER, metric.words.partition(" [")[0].rstrip(".")))
    key = _take_key(name.removesuffix("_all"), metric)
    told = _KEYS.get(key, _LENGTH.sub(r"\1 \2", key.replace("_", " ")))
    if metric.name.startswith(("vel_", "coverage_3sigma_vel", "coverage_low_vel")) and key == "d":
        told = "vertical"
    if "phi_" in metric.name and key in ("n", "e", "d"):
        told = "heading" if key == "d" else f"tilt about {told}"
    words = words.format(told) + (", whole run" if name.endswith("_all") else "")
    if metric.name.startswith(_SHARES):
        return MetricWords(group, words, "%", 100.0)
    unit = "" if metric.unit == "1" else metric.unit
    return MetricWords(group, words, unit, 1.0)


def _take_key(name: str, metric: Metric) -> str:
    head, gap, tail = metric.name.partition("{}")
    return name[len(head) : len(name) - len(tail)] if gap else ""


def name_metric(name: str) -> str:
    """Return a metric in words with its unit."""
    found = find_words(name)
    return f"{found.words} [{found.unit}]" if found.unit else found.words


def format_metric(name: str, value: Any) -> str:
    """Format a value without its unit; detections become yes or no."""
    if name.startswith("fault_") and name.removesuffix("_all").endswith("_detected") and value is not None:
        return "yes" if value else "no"
    factor = find_words(name).factor
    return format_number(None if value is None else factor * value, 3 if factor == 100.0 else 4)


def group_metrics(names: Iterable[str]) -> dict[str, list[str]]:
    """Return names by heading, in the order of the tables."""
    found: dict[str, list[str]] = {group: [] for group in GROUPS}
    for name in names:
        found[find_words(name).group].append(name)
    return {group: members for group, members in found.items() if members}


def list_wordless() -> list[str]:
    """Return the rows of `METRICS` without own words, named by the first line of their function."""
    return [metric.name for metric in METRICS if metric.name not in _WORDS]
