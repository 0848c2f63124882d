"""Drift of a filter in simulated outages at several places of a recording, and its statistics.

The fixes inside an outage are the reference for the drift. A few places say little about the 95 % value, so
every quantile has a confidence interval. It is valid for any distribution if the places are independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings import FindingTable, make_table
from bench.core.records.sensor_specs import ImuSpec
from bench.core.words.notebook import ShownFigure
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import estimate_quantile
from bench.evaluation.linear.drift_laws import RAYLEIGH_95, RAYLEIGH_MEDIAN, drift_sd


@dataclass(frozen=True, slots=True)
class OutageDrift:
    """Drift of a filter in one outage."""

    start: float  # last fix before the outage [s]
    duration: float  # from there to the fix that ends the outage [s]
    drift: float  # horizontal error at the fix that ends the outage [m]
    drift_v: float  # vertical error there [m]
    claimed: float  # standard deviation by axis of the drift: of filter and fix, or reference, together [m]
    fix_sd: float = 0.0  # part of it that is the noise of the fix that measures the drift [m]

    @classmethod
    def measure(
        cls, start: float, end: float, error_n: FloatArray, cov: FloatArray, fix_cov: FloatArray
    ) -> OutageDrift:
        """Return the drift by the error (3,) [m, n] at the end, its covariance, and the part of the fix."""
        sd, fix_sd = (float(np.sqrt(0.5 * (one[0, 0] + one[1, 1]))) for one in (cov, fix_cov))
        drift = float(np.hypot(error_n[0], error_n[1]))
        return cls(start, end - start, drift, float(abs(error_n[2])), sd, fix_sd)


def place_outages(first: float, last: float, duration: float, count: int) -> FloatArray:
    """Return the starts of ``count`` outages, evenly spaced from the first to the last possible time [s].

    Raises
    ------
    ValueError
        If there is no room for an outage.
    """
    if last - duration < first:
        raise ValueError(f"an outage of {duration:g} s does not fit between {first:g} and {last:g} s")
    return np.linspace(first, last - duration, count)


def make_drift_row(
    label: str, duration: float, drifts: Sequence[OutageDrift], imu: ImuSpec
) -> dict[str, Any]:
    """Return a row of the drift table: quantiles of the horizontal drift, measured and expected [m]."""
    drift = np.array([one.drift for one in drifts])
    median, most = estimate_quantile(drift, 0.5), estimate_quantile(drift, 0.95)
    fix_sd = float(np.median([one.fix_sd for one in drifts]))
    expected = float(np.hypot(drift_sd(duration, imu), fix_sd))
    return {
        "estimator": label,
        "duration_s": duration,
        "places": len(drifts),
        "median_h_m": median.value,
        "median_h_low_m": median.low,
        "median_h_high_m": median.high,
        "p95_h_m": most.value,
        "p95_h_low_m": most.low,
        "p95_h_high_m": most.high,
        "rms_h_m": float(np.sqrt(np.mean(drift**2))),
        "median_v_m": float(np.median([one.drift_v for one in drifts])),
        "reported_median_h_m": float(RAYLEIGH_MEDIAN * np.median([one.claimed for one in drifts])),
        "predicted_median_h_m": RAYLEIGH_MEDIAN * expected,
        "predicted_p95_h_m": RAYLEIGH_95 * expected,
        "fixes_median_h_m": RAYLEIGH_MEDIAN * fix_sd,
        "starts_s": [one.start for one in drifts],
        "drifts_h_m": drift.tolist(),
    }


DRIFT_MEANING = (
    "With each quantile stands its 95 % confidence interval. Reported: the median by the covariance of the "
    "filter. Predicted: the median expected from bias instability and noise of the assumed datasheet, with a "
    "perfect start. Both include the accuracy of the fixes that measure the drift."
)


def tabulate_drifts(rows: Sequence[Mapping[str, Any]]) -> FindingTable:
    """Return the table of the drift in each outage."""
    names = ("outage", "estimator", "places", "median", "95 %", "reported", "predicted")
    return make_table("drifts", "Horizontal drift without GNSS [m]", names, list(map(_show_drift, rows)))


def describe_drift(row: Mapping[str, Any]) -> str:
    """Return a row of the drift table in a sentence."""
    median, claimed, law = (
        f"{_format_length(row[name])} m"
        for name in ("median_h_m", "reported_median_h_m", "predicted_median_h_m")
    )
    count = f"{row['places']} simulated outage{'' if row['places'] == 1 else 's'}"
    fixes = row.get("fixes_median_h_m", 0.0)
    noise = (
        f"; noise of the fixes alone: {_format_length(fixes)} m" if fixes > 0.5 * row["median_h_m"] else ""
    )
    return (
        f"{count} of {row['duration_s']:g} s: {row['estimator']} drifts {median} (median), reports "
        f"{claimed}; predicted from the datasheet: {law}{noise}"
    )


def _show_drift(row: Mapping[str, Any]) -> tuple[str | ShownFigure, ...]:
    """Return a row of the drift table; a limit is a dash if there are too few places."""
    return (
        f"{row['duration_s']:g} s",
        row["estimator"],
        ShownFigure(str(row["places"])),
        _show_quantile(row, "median_h"),
        _show_quantile(row, "p95_h"),
        ShownFigure(_format_length(row["reported_median_h_m"])),
        ShownFigure(_format_length(row["predicted_median_h_m"])),
    )


def _show_quantile(row: Mapping[str, Any], name: str) -> ShownFigure:
    value, low, high = (_format_length(row[f"{name}_{end}m"]) for end in ("", "low_", "high_"))
    return ShownFigure(value, "" if value == "-" else f"{low} to {high}")


def _format_length(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else format_number(value, 3)
