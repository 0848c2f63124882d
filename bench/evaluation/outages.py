"""Drift of a filter without GNSS: outages made at several places of a recording, and their statistics.

The fixes inside an outage are the reference for the drift. A few places say little about the 95 % value, so
every quantile has a confidence interval. It is valid for any distribution if the places are independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.evaluation.ensemble import estimate_quantile
from bench.specs import ImuSpec
from bench.units import STANDARD_GRAVITY

RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
"""Median of the length of a normal horizontal error, over its standard deviation by axis [1]."""
RAYLEIGH_95 = float(np.sqrt(-2.0 * np.log(0.05)))
"""95 % quantile of the length of a normal horizontal error, over its standard deviation by axis [1]."""


@dataclass(frozen=True, slots=True)
class OutageDrift:
    """Drift of an estimator in one outage."""

    start: float  # last fix before the outage [s]
    duration: float  # from there to the fix that ends the outage [s]
    drift: float  # horizontal error at the fix that ends the outage [m]
    drift_v: float  # vertical error there [m]
    claimed: float  # standard deviation by axis that the filter gives there [m]


def place_outages(first: float, last: float, duration: float, count: int) -> FloatArray:
    """Return the starts of ``count`` outages, evenly spaced from the first to the last possible instant [s].

    Raises
    ------
    ValueError
        If there is no room for an outage.
    """
    if last - duration < first:
        raise ValueError(f"an outage of {duration:g} s does not fit between {first:g} and {last:g} s")
    return np.linspace(first, last - duration, count)


def closed_form_sd(imu: ImuSpec, duration: float) -> float:
    """Return the standard deviation by axis of the drift of a calibrated IMU without aiding [m].

    Position and velocity are known when the aiding ends; the bias errors are the bias instabilities::

        s^2 = (b_a T^2 / 2)^2 + (g b_g T^3 / 6)^2 + N_a^2 T^3 / 3 + g^2 N_g^2 T^5 / 20

    with the bias instabilities b and the random walks N of the datasheet: double and triple integrals of a
    constant and of white noise. Valid for T far below 84 minutes. Scale factor errors, misalignments, initial
    tilt and heading errors and timing errors are not included.

    Parameters
    ----------
    imu : ImuSpec
        The datasheet.
    duration : float
        Time without aiding, T [s].
    """
    T, g = duration, STANDARD_GRAVITY
    accel, gyro = imu.accel, imu.gyro
    return float(
        np.sqrt(
            (0.5 * accel.bias_instability * T**2) ** 2
            + (g * gyro.bias_instability * T**3 / 6.0) ** 2
            + accel.random_walk**2 * T**3 / 3.0
            + (g * gyro.random_walk) ** 2 * T**5 / 20.0
        )
    )


def make_drift_row(
    label: str, duration: float, drifts: Sequence[OutageDrift], imu: ImuSpec
) -> dict[str, Any]:
    """Return a row of the drift table: quantiles of the horizontal drift, measured and expected [m]."""
    drift = np.array([one.drift for one in drifts])
    median, most = estimate_quantile(drift, 0.5), estimate_quantile(drift, 0.95)
    expected = closed_form_sd(imu, duration)
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
        "claimed_median_h_m": float(RAYLEIGH_MEDIAN * np.median([one.claimed for one in drifts])),
        "closed_form_median_h_m": RAYLEIGH_MEDIAN * expected,
        "closed_form_p95_h_m": RAYLEIGH_95 * expected,
        "starts_s": [one.start for one in drifts],
        "drifts_h_m": drift.tolist(),
    }


DRIFT_COLUMNS = ("outage", "estimator", "places", "median", "95 %", "claimed", "law")
DRIFT_MEANING = (
    "In brackets: the 95 % confidence interval of the quantile. Claimed: the median by the covariance of the "
    "filter. Law: the median expected from bias instability and noise of the assumed datasheet, with a "
    "perfect start."
)


def format_drift_row(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Return a row of the drift table as text; a limit is a dash if there are too few places."""
    return (
        f"{row['duration_s']:g} s",
        row["estimator"],
        str(row["places"]),
        _format_quantile(row, "median_h"),
        _format_quantile(row, "p95_h"),
        _format_number(row["claimed_median_h_m"]),
        f"{row['closed_form_median_h_m']:.3g}",
    )


def _format_quantile(row: Mapping[str, Any], name: str) -> str:
    low, high = row[f"{name}_low_m"], row[f"{name}_high_m"]
    if not np.isfinite(row[f"{name}_m"]):
        return "-"
    ends = " to ".join(map(_format_number, (low, high)))
    return f"{row[f'{name}_m']:.3g} ({ends})"


def _format_number(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"
