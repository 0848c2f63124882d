"""Contents of the log of an autopilot: sensors, lever arms, day, truth, own estimate."""

from __future__ import annotations

import datetime
import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Innovations, no_innovations
from bench.core.words.exceptions import ConfigError

Vector = tuple[float, float, float]
_GPS_EPOCH = datetime.date(1980, 1, 6)


@dataclass(frozen=True, slots=True)
class Contents:
    """Contents of a log."""

    sensors: tuple[str, ...]  # "imu", "gnss" and instruments that have rows
    imu: Vector | None = None  # by its parameters: forward, right, down from the origin of the vehicle [m]
    antenna: Vector | None = None
    date: datetime.date | None = None
    truth: bool = False  # of a simulator
    estimate: bool = False  # of the autopilot
    baro_sd: tuple[float, str] | None = None  # that it assumes of heights by its barometer [m], and by what


@dataclass(frozen=True, slots=True)
class OwnMotion:
    """Motion recorded in a log: a truth, or the estimate of its autopilot.

    Position and attitude have times of their own [s], on the clock of the file; unknown values are NaN.
    """

    t: FloatArray  # (N,) of position and velocity
    lla: FloatArray  # (N, 3)
    vel_n: FloatArray  # (N, 3)
    attitude_t: FloatArray  # (K,)
    q_nb: FloatArray  # (K, 4)


@dataclass(frozen=True, slots=True)
class OwnEstimate:
    """The estimate of an autopilot, with what it reports and what it measured of itself."""

    motion: OwnMotion
    variances: tuple[
        FloatArray, FloatArray
    ]  # times (V,), diagonal (V, 9) of pos_n, vel_n, phi_n; NaN unknown
    biases: tuple[FloatArray, FloatArray]  # times (B,), gyro [rad/s] and accelerometer [m/s^2] (B, 6), b
    innovations: Innovations = field(default_factory=no_innovations)
    events: tuple[EventRow, ...] = ()  # resets and changes of lane


def split_instance(topic: str) -> tuple[str, int | None]:
    """Return the name in ``name`` or ``name:instance``, and the number of the instance.

    Raises
    ------
    ConfigError
        If it is no number of an instance.
    """
    name, _, text = topic.partition(":")
    if text and not (text.isdecimal() and len(text) < 4):
        raise ConfigError(f"{topic!r}: the instance after the colon must be a number, such as 0")
    return name, int(text) if text else None


def day_of_gps(week: float, second: float) -> datetime.date | None:
    """Return the day of a GPS week and second; None before any receiver counted them, or if one is NaN."""
    if not (math.isfinite(week) and math.isfinite(second)):
        return None
    days = 7 * int(week) + int(second // 86400)
    return _GPS_EPOCH + datetime.timedelta(days=days) if 0 < days < 40_000 else None


def day_of_unix(second: float) -> datetime.date | None:
    """Return the day of a time in seconds since 1970; None if the time is implausible for a recording."""
    if not 3e8 < second < 4e9:
        return None
    return datetime.datetime.fromtimestamp(second, datetime.UTC).date()


def no_values(width: int) -> tuple[FloatArray, FloatArray]:
    """Return times and values without rows."""
    return np.empty(0), np.empty((0, width))


def tell_innovations(found: Mapping[str, tuple[FloatArray, FloatArray, FloatArray]]) -> Innovations:
    """Return a table from times (K,), innovations z and their variances S (K, k), by name of the sensor.

    A row that repeats the one before is no new measurement; one without a variance is none. The NIS of a
    vector is that of its diagonal, which is all that the logs have.
    """
    rows = []
    for code, (t, z, S) in enumerate(found.values()):
        fresh = np.ones(len(t), np.bool_)
        fresh[1:] = (z[1:] != z[:-1]).any(axis=1)
        fresh &= np.isfinite(z).all(axis=1) & (S > 0).all(axis=1) & np.isfinite(S).all(axis=1) & z.any(axis=1)
        for k in np.flatnonzero(fresh):
            nis = float(np.sum(z[k] ** 2 / S[k]))
            rows += [
                (float(t[k]), code, j, float(z[k, j]), float(S[k, j]), nis, True) for j in range(z.shape[1])
            ]
    rows.sort(key=lambda row: (row[0], row[1], row[2]))
    return Innovations.from_rows(tuple(found), rows)


def turn_quaternion(diagonal: FloatArray, q_nb: FloatArray) -> FloatArray:
    """Return the variances (M, 3) of the attitude error in n by those (M, 4) of the elements of q_nb (M, 4).

    ``phi = 2 vec(dq x conj(q))``, J. Sola, Quaternion kinematics for the error-state Kalman filter, 2017,
    eq. 197; the covariances between the elements are not in the logs.
    """
    inverse, variance = rotation.conjugate(q_nb), np.zeros((len(q_nb), 3))
    for k, step in enumerate(np.eye(4)):
        unit = 2.0 * rotation.multiply(np.broadcast_to(step, inverse.shape), inverse)[:, 1:]
        variance += unit**2 * diagonal[:, [k]]
    return variance


def list_steps(
    t: FloatArray, counters: Mapping[str, FloatArray], kind: str, text: str = "{}"
) -> list[EventRow]:
    """Return an event at each step of counters (N,) by name."""
    return [
        (float(t[k + 1]), float(t[k + 1]), kind, text.format(name))
        for name, counter in counters.items()
        for k in np.flatnonzero(np.diff(counter) != 0)
    ]
