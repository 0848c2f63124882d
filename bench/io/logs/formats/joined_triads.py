"""Gyros and accelerometers with times of their own as the rows of one IMU."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray, find_later
from bench.core.words.exceptions import ConfigError
from bench.io.logs.rows import LogRows

_GAP = 3.0  # a longer interval between accelerometer rows is a gap, in median intervals [1]


def join_triads(
    gyro_t: FloatArray, gyro: FloatArray, accel_t: FloatArray, accel: FloatArray, shown: str
) -> LogRows:
    """Return rows of an IMU at the times of its gyros.

    A specific force is the mean over the interval that ends at the time, from the accelerometer rows that
    it covers. In gaps of the accelerometers it is NaN.

    Parameters
    ----------
    gyro_t, accel_t : (N,), (M,) arrays
        Times [s]; rows without a time or a value, and times that go back or repeat, are left out.
    gyro, accel : (N, 3), (M, 3) arrays
        Angular rates [rad/s] and specific forces [m/s^2].
    shown : str
        Name of the file in messages.
    """
    count = len(gyro_t)
    gyro_t, gyro = _order(gyro_t, gyro)
    accel_t, accel = _order(accel_t, accel)
    if len(gyro_t) < 2 or len(accel_t) < 2:
        raise ConfigError(f"{shown}: an IMU needs at least two rows of gyros and two of accelerometers")
    if gyro_t[0] > accel_t[-1] or accel_t[0] > gyro_t[-1]:
        spans = f"{gyro_t[0]:.9g} to {gyro_t[-1]:.9g} s and {accel_t[0]:.9g} to {accel_t[-1]:.9g} s"
        raise ConfigError(f"{shown}: times of gyros and accelerometers do not overlap: {spans}")
    step = np.diff(accel_t)
    usual = float(np.median(step))
    gains = accel[1:] * step[:, None]
    at = np.concatenate([[accel_t[0] - usual], accel_t])
    speed = np.vstack([np.zeros(3), accel[0] * usual, accel[0] * usual + np.cumsum(gains, axis=0)])
    dt = np.diff(gyro_t)
    median = float(np.median(dt))
    dt = np.concatenate([[median], np.where(dt > _GAP * median, median, dt)])
    force = np.column_stack(
        [(np.interp(gyro_t, at, v) - np.interp(gyro_t - dt, at, v)) / dt for v in speed.T]
    )
    after = np.clip(np.searchsorted(accel_t, gyro_t), 1, len(step))
    lacking = (
        (gyro_t < accel_t[0] - usual) | (gyro_t > accel_t[-1] + usual) | (step[after - 1] > _GAP * usual)
    )
    force[lacking] = np.nan
    inside = np.flatnonzero((gyro_t >= accel_t[0]) & (gyro_t <= accel_t[-1]))
    rows = slice(inside[0], inside[-1] + 1) if len(inside) else slice(None)
    left = count - len(gyro_t[rows])
    notes = (
        (f"{shown}: {left} gyro rows repeat, go back or have no specific force; left out",) if left else ()
    )
    return LogRows(gyro_t[rows], {"gyro": gyro[rows], "accel": force[rows]}, notes)


def _order(t: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the complete rows whose time is after the times of all rows before."""
    whole = np.isfinite(t) & np.isfinite(values).all(axis=1)
    t, values = t[whole], values[whole]
    later = find_later(t)
    return t[later], values[later]
