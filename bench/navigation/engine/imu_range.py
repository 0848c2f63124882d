"""Range of an IMU: of a saturated sample, only a lower bound of the true value is known."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import BoolArray
from bench.core.mathematics.units import DEG, STANDARD_GRAVITY
from bench.core.records.data import ImuData
from bench.core.records.sensor_specs import ImuSpec
from bench.navigation.engine.kept_rows import take_rows

IN_RANGE = 1.0 - 1e-9  # of a range, so that rounding does not hide a sensor that is stuck at it
_ALL = "all"

# What an aircraft can do, for a unit whose datasheet has no range.
_MOST_RATE = 5700.0 * DEG  # [rad/s]
_MOST_FORCE = 100.0 * STANDARD_GRAVITY  # [m/s^2]


def limits(spec: ImuSpec) -> tuple[float, float]:
    """Return the largest rate [rad/s] and specific force [m/s^2] that are used."""
    return spec.gyro.range or _MOST_RATE, spec.accel.range or _MOST_FORCE


def find_beyond(imu: ImuData, spec: ImuSpec) -> list[tuple[str, BoolArray]]:
    """Return masks (N,) of IMU rows at or beyond the range of a triad, each with its text.

    A row counts for one triad only. A row that the IMU flags as invalid counts if the datasheet has a range,
    with a tolerance of a quantization step.
    """
    left = np.isfinite(imu.t) & np.isfinite(imu.dt) & (imu.dt > 0)
    left &= np.isfinite(imu.dtheta_b).all(axis=1) & np.isfinite(imu.dvel_b).all(axis=1)
    most_rate, most_force = limits(spec)
    found = []
    for name, triad, increment, limit, unit, factor in (
        ("gyro", spec.gyro, imu.dtheta_b, most_rate, "deg/s", DEG),
        ("accelerometer", spec.accel, imu.dvel_b, most_force, "g", STANDARD_GRAVITY),
    ):
        end = IN_RANGE * limit * imu.dt - np.where(imu.valid, 0.0, triad.quantization)
        rows = left & (np.abs(increment) >= end[:, None]).any(axis=1)
        if not triad.range:
            rows &= imu.valid
        found.append((f"{name} at or beyond its range of {limit / factor:.4g} {unit}", rows))
        left &= ~rows
    return found


def count_lost(counts: dict[str, int], imu: ImuData, rows: slice, spec: ImuSpec) -> dict[str, int]:
    """Return the counts of unused samples, increased by some rows: in total, and for each text of a range."""
    if not len(imu.t[rows]):
        return counts
    lost = take_rows(imu, rows)
    more = {_ALL: len(lost)} | {why: int(rows.sum()) for why, rows in find_beyond(lost, spec)}
    return {why: counts.get(why, 0) + count for why, count in more.items()}


def name_ranges(lost: dict[str, int]) -> str:
    """Return the number of unused samples at the end of a range in words; "" if there are none."""
    parts = [f"{n} of {lost[_ALL]} samples have the {why}" for why, n in lost.items() if n and why != _ALL]
    return f" ({' and '.join(parts)})" if parts else ""
