"""How far a filter drifts without GNSS: cuts at several places of a recording, their statistics, and the law.

The fixes that are cut out judge the drift. Few places say little about a 95 % value; every quantile
therefore comes with an interval that holds for any distribution, as long as the places are independent.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.specs import ImuSpec
from bench.units import STANDARD_GRAVITY

CONFIDENCE = 0.95
"""Of the intervals of the quantiles."""
RAYLEIGH_MEDIAN = float(np.sqrt(2.0 * np.log(2.0)))
"""Median of the length of a horizontal error over its standard deviation by axis, when normal."""
RAYLEIGH_95 = float(np.sqrt(-2.0 * np.log(0.05)))
"""The same of the 95 % quantile."""


@dataclass(frozen=True, slots=True)
class OutageDrift:
    """What one outage at one place did to an estimator."""

    start: float  # the last fix before it [s]
    duration: float  # from there to the fix that ends it [s]
    drift: float  # horizontal error at the fix that ends it [m]
    drift_v: float  # vertical [m]
    claimed: float  # standard deviation by axis that the filter claims there [m]


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile of a sample and its interval; an end that so few values cannot give is None."""

    value: float
    low: float | None
    high: float | None


def quantile(values: FloatArray, fraction: float, confidence: float = CONFIDENCE) -> Quantile:
    """Return a quantile of independent values, and the order statistics that enclose the true one.

    The number of values below the true quantile is binomial, whatever they are distributed like
    (David, Nagaraja, Order Statistics, 3rd ed., 7.1). Each end may fail with half of 1 - confidence.

    Examples
    --------
    >>> quantile(np.arange(1.0, 11.0), 0.5)  # of ten values the second and the ninth
    Quantile(value=5.5, low=2.0, high=9.0)
    """
    from scipy.special import bdtr

    ordered, n = np.sort(values), len(values)
    below = bdtr(np.arange(n), n, fraction)  # P(at most k of n below the true quantile)
    tail = 0.5 * (1.0 - confidence)
    lower = np.flatnonzero(below <= tail)  # the k-th value (from 1) exceeds it with P(at most k - 1)
    upper = np.flatnonzero(below >= 1.0 - tail)
    return Quantile(
        float(np.quantile(ordered, fraction)),
        float(ordered[lower[-1]]) if len(lower) else None,
        float(ordered[upper[0]]) if len(upper) else None,
    )


def places(first: float, last: float, duration: float, count: int) -> FloatArray:
    """Return where cuts of a duration begin, evenly from the first instant to the last possible [s].

    Raises
    ------
    ValueError
        When there is no room for one.
    """
    if last - duration < first:
        raise ValueError(f"an outage of {duration:g} s does not fit between {first:g} and {last:g} s")
    return np.linspace(first, last - duration, count)


def closed_form_sd(imu: ImuSpec, duration: float) -> float:
    """Return the standard deviation by axis [m] of the drift of a well-calibrated IMU without aiding.

    Position and velocity are known when the aiding ends, the biases up to their instability::

        s^2 = (b_a T^2 / 2)^2 + (g b_g T^3 / 6)^2 + N_a^2 T^3 / 3 + g^2 N_g^2 T^5 / 20

    with the bias instabilities b and the random walks N of the datasheet: double and triple integrals of a
    constant and of white noise. Good for T far below 84 minutes. Scale factors, misalignments, the tilt and
    heading at the start and wrong clocks come on top.

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


def drift_row(label: str, duration: float, cuts: Sequence[OutageDrift], imu: ImuSpec) -> dict[str, Any]:
    """Return a row of the drift table: quantiles of the horizontal drift and what was to be expected [m]."""
    drift = np.array([cut.drift for cut in cuts])
    median, most = quantile(drift, 0.5), quantile(drift, 0.95)
    law = closed_form_sd(imu, duration)
    return {
        "estimator": label,
        "duration_s": duration,
        "places": len(cuts),
        "median_h_m": median.value,
        "median_h_low_m": median.low,
        "median_h_high_m": median.high,
        "p95_h_m": most.value,
        "p95_h_low_m": most.low,
        "p95_h_high_m": most.high,
        "rms_h_m": float(np.sqrt(np.mean(drift**2))),
        "median_v_m": float(np.median([cut.drift_v for cut in cuts])),
        "claimed_median_h_m": float(RAYLEIGH_MEDIAN * np.median([cut.claimed for cut in cuts])),
        "closed_form_median_h_m": RAYLEIGH_MEDIAN * law,
        "closed_form_p95_h_m": RAYLEIGH_95 * law,
        "starts_s": [cut.start for cut in cuts],
        "drifts_h_m": drift.tolist(),
    }


DRIFT_COLUMNS = ("outage", "estimator", "places", "median", "95 %", "claimed", "law")
DRIFT_MEANING = (
    "In brackets the 95 % interval of the quantile, from the places alone. Claimed: the median the filter "
    "says of itself. Law: the median by bias instability and noise of the assumed datasheet after a perfect "
    "start."
)


def drift_cells(row: Mapping[str, Any]) -> tuple[str, ...]:
    """Write a row of the drift table; an end of an interval that so few places cannot give is a dash."""
    return (
        f"{row['duration_s']:g} s",
        row["estimator"],
        str(row["places"]),
        _interval(row, "median_h"),
        _interval(row, "p95_h"),
        _number(row["claimed_median_h_m"]),
        f"{row['closed_form_median_h_m']:.3g}",
    )


def _interval(row: Mapping[str, Any], name: str) -> str:
    low, high = row[f"{name}_low_m"], row[f"{name}_high_m"]
    if not np.isfinite(row[f"{name}_m"]):
        return "-"
    ends = " to ".join(map(_number, (low, high)))
    return f"{row[f'{name}_m']:.3g} ({ends})"


def _number(value: float | None) -> str:
    return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"
