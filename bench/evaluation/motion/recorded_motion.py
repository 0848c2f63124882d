"""A recording as its checks see it: the sound rows of IMU and receiver in order of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray, find_later
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.records.data import GnssFixes, ImuData

STILL = 0.2
"""Ground speed below which a vehicle counts as standing still [m/s]."""
STILL_AT_LEAST = 2.0
"""Shortest standstill that is used [s]."""
_LEVEL = 1.0  # range of heights within which nothing moves up or down [m]
_WILD = 1e5  # a number beyond it in SI is damage, not motion in another unit
_MOVES = 0.4  # ground speed that a vehicle reaches at least once if it moves at all [m/s]
_NEAR = 5  # fixes whose median velocity counts, so that the noise of single ones is no motion
_STEP = 0.02  # samples closer than this are averaged [s]: no vehicle turns much within it


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check."""

    name: str  # ends in the unit of the value
    value: float | None  # None if it could not be measured
    text: str
    good: bool
    advice: Mapping[str, Any] = field(default_factory=dict)
    """What to change: key of the log, or a gain or ``gnss.velocity``, which are no keys -> value to add or to
    multiply by."""


@dataclass(frozen=True, slots=True)
class RecordedMotion:
    """Rates and specific forces of an IMU, means over 20 ms at least, and the fixes of a receiver."""

    t: FloatArray  # (N,) ends of the intervals [s]
    gyro: FloatArray  # (N, 3) [rad/s], b
    accel: FloatArray  # (N, 3) [m/s^2], b
    fix_t: FloatArray  # (M,) [s]
    lla: FloatArray  # (M, 3)
    vel_n: FloatArray  # (M, 3) [m/s]; NaN without
    most_rate: float  # largest angular rate of any sample [rad/s]
    velocity_shift: float = 0.0  # to add to the times of the velocities [s]
    velocity_shift_left: float = 0.0  # what seems to be left of it, and its sd; 0 without velocities [s]
    velocity_shift_sd: float = 0.0
    assumed_sd: float = np.nan  # of the velocities along an axis, as filters take it: their median [m/s]

    @classmethod
    def from_records(cls, imu: ImuData, fixes: GnssFixes) -> RecordedMotion:
        """Make the motion from valid rows with plausible rates and increasing times.

        A vertical velocity that is 0 in all fixes is unknown where their heights change.
        """

        def measure(increments: FloatArray, rows: slice | IntArray) -> FloatArray:
            return np.asarray(increments[rows] / imu.dt[rows, None])

        def find_sane(block: slice) -> BoolArray:
            both = np.hstack([measure(imu.dtheta_b, block), measure(imu.dvel_b, block)])
            return np.asarray((np.abs(both) < _WILD).all(axis=1))

        most = 0.0
        for block in disk_arrays.blocks(len(imu)):
            rates = np.abs(measure(imu.dtheta_b, block)[imu.valid[block]])
            most = float(np.maximum(most, rates.max(initial=0.0)))
        sane = disk_arrays.fill(len(imu), find_sane, np.bool_)
        keep = find_ordered(imu.t, imu.valid & sane)
        good = find_ordered(fixes.t, fixes.valid & ~(np.abs(fixes.vel_n) > _WILD).any(axis=1))
        many = max(1, round(_STEP / float(np.median(np.diff(imu.t[keep]))))) if len(keep) > 1 else 1
        many = many if len(keep) >= many else 1
        keep = keep[: len(keep) // many * many]

        def average(increments: FloatArray, block: slice) -> FloatArray:
            rows = keep[block.start * many : block.stop * many]
            return np.asarray(measure(increments, rows).reshape(-1, many, 3).mean(axis=1))

        gyro, accel = (
            disk_arrays.fill((len(keep) // many, 3), partial(average, increments))
            for increments in (imu.dtheta_b, imu.dvel_b)
        )
        t = disk_arrays.take(imu.t, keep[many - 1 :: many])
        moving = good[np.isfinite(fixes.vel_n[good]).all(axis=1)]
        variance = np.einsum("mii->m", fixes.cov_vel_n[moving]) / 3.0
        assumed = float(np.sqrt(np.median(variance))) if len(moving) else np.nan
        fix_t, lla, vel_n = fixes.t[good], fixes.lla[good], fixes.vel_n[good].copy()
        if len(good) and not vel_n[:, 2].any() and np.ptp(lla[:, 2]) > _LEVEL:
            vel_n[:, 2] = np.nan
        return cls(t, gyro, accel, fix_t, lla, vel_n, most, assumed_sd=assumed)

    @property
    def speed(self) -> FloatArray:
        """Speed (M,) over ground [m/s]."""
        return np.asarray(np.hypot(self.vel_n[:, 0], self.vel_n[:, 1]))

    @property
    def moves(self) -> bool:
        """Return whether the vehicle moves, by its velocities or, without them, by its positions."""
        vel_n = self.take_velocities()[2]
        if len(vel_n) < _NEAR:
            return False
        near = np.median(np.lib.stride_tricks.sliding_window_view(vel_n, _NEAR, axis=0), axis=-1)
        return bool(np.linalg.norm(near, axis=1).max() > _MOVES)

    def find_standstills(self) -> list[tuple[float, float]]:
        """Return start and end [s] of every standstill, by velocities or, without them, positions."""
        t, speed = self.fix_t, self.speed
        if not np.isfinite(speed).any() and len(t) > _NEAR:
            t, _, vel_n = self.take_velocities()
            many = round(STILL_AT_LEAST / float(np.median(np.diff(t)))) if len(t) > 1 else 1
            window = np.ones(int(np.clip(many, 1, max(len(t), 1))))
            count = np.convolve(np.ones(len(t)), window, "same") if len(t) else np.ones(0)
            mean = [np.convolve(v, window, "same") / count if len(t) else v for v in vel_n[:, :2].T]
            speed = np.hypot(*mean)
        still = np.concatenate([[False], speed < STILL, [False]])
        edges = np.flatnonzero(still[1:] != still[:-1])
        spans = [(float(t[a]), float(t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
        return [(a, b) for a, b in spans if b - a >= STILL_AT_LEAST]

    def take_velocities(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return times, positions and velocities of the fixes with a velocity.

        If less than half of them have one, the velocities are those between neighboring positions.
        """
        good = np.asarray(np.isfinite(self.vel_n).all(axis=1))
        if 2 * good.sum() >= len(good):
            return self.fix_t[good] + self.velocity_shift, self.lla[good], self.vel_n[good]
        usual = float(np.median(np.diff(self.fix_t))) if len(self.fix_t) > 1 else 0.0
        near = np.flatnonzero(np.diff(self.fix_t) < 2.5 * usual)
        step = np.diff(to_ecef(self.lla), axis=0)[near] / np.diff(self.fix_t)[near, None]
        lla = self.lla[near]
        vel_n = np.einsum("kji,kj->ki", matrix_en(lla[:, 0], lla[:, 1]), step)
        return 0.5 * (self.fix_t[near] + self.fix_t[near + 1]), lla, vel_n


def find_ordered(t: FloatArray, valid: BoolArray) -> IntArray:
    """Return the valid rows with a time after the times of all valid rows before."""
    rows = np.flatnonzero(valid)
    return rows[find_later(t[rows])]
