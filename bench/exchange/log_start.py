"""Where the filters are told to start on a recording: the first fix they may use, and an attitude."""

from __future__ import annotations

import numpy as np

from bench import earth
from bench.arrays import FloatArray
from bench.config.log import LogSpec
from bench.config.tables import ConfigError
from bench.data import InitialState
from bench.exchange.log import Recording
from bench.rotation import from_euler, matrix

_REST = 5.0  # levelling averages the specific force of so long a standstill [s]
_STILL = 0.3  # ground speed below which a vehicle stands [m/s]
_AROUND = 1.0  # fixes so far either side give the acceleration at a course [s]


def start(recording: Recording, spec: LogSpec) -> InitialState:
    """Return the state at the first usable fix at or after ``[initial] at_s``.

    "given": roll, pitch and heading are told. "level": roll and pitch from the specific force of the
    standstill that follows, the heading is told. "course": at the first fix that moves, the heading from the
    course over ground, roll and pitch from the specific force less the acceleration of the receiver.

    Raises
    ------
    ConfigError
        When there is no such fix.
    """
    told, fixes = spec.initial, recording.fixes
    at = max(0.0 if told.at is None else told.at, 0.0)
    shown = f"{spec.name}.toml: [initial]"
    with np.errstate(invalid="ignore"):
        usable = fixes.valid & (fixes.t >= at) & (fixes.t < recording.imu.t[-1] - _AROUND)
        speed = np.hypot(fixes.vel_n[:, 0], fixes.vel_n[:, 1])
        if told.alignment == "course":
            usable &= speed >= told.min_speed
    rows = np.flatnonzero(usable)
    if not len(rows):
        needed = f" moves at {told.min_speed:g} m/s" if told.alignment == "course" else ""
        raise ConfigError(f"{shown} no fix from {at:g} s on{needed or ' is usable'}")
    row = int(rows[0])
    if told.alignment == "level":
        row, roll, pitch = _level(recording, row, speed, shown)
    elif told.alignment == "course":
        roll, pitch = _under_way(recording, row, shown)
    else:
        assert told.roll is not None
        assert told.pitch is not None
        roll, pitch = told.roll, told.pitch
    vel_n = fixes.vel_n[row]
    heading = float(np.arctan2(vel_n[1], vel_n[0])) if told.heading is None else told.heading
    q_nb = from_euler(roll, pitch, heading)
    pos_sd = told.pos_sd or tuple(np.sqrt(np.diag(fixes.cov_pos_n[row])))
    vel_sd = told.vel_sd or tuple(np.sqrt(np.diag(fixes.cov_vel_n[row])))
    if not np.isfinite(vel_n).all():
        vel_n = np.zeros(3)
        if told.vel_sd is None:
            raise ConfigError(f"{shown} vel_sd_mps is missing: the fixes have no velocity, 0 is assumed")
    sd = np.array([*pos_sd, *vel_sd, told.tilt_sd, told.tilt_sd, told.heading_sd])
    if not (np.isfinite(sd) & (sd > 0)).all():
        raise ConfigError(
            f"{shown} the fix at {fixes.t[row]:.2f} s reports no spread; set pos_sd_m and vel_sd_mps"
        )
    arm_n = matrix(q_nb) @ np.asarray(spec.antenna_b)
    return InitialState(
        t=float(fixes.t[row]),
        lla=earth.displace(fixes.lla[row], -arm_n),
        vel_n=vel_n,
        q_nb=q_nb,
        cov=np.diag(sd**2),
        alignment="given",
    )


def _force(recording: Recording, low: float, high: float, shown: str) -> FloatArray:
    """Return the mean specific force (3,) between two times [m/s^2], b."""
    imu = recording.imu
    rows = imu.valid & (imu.t > low) & (imu.t <= high)
    if not rows.any():
        raise ConfigError(f"{shown} the imu has no rows from {low:.2f} to {high:.2f} s")
    return np.asarray(imu.dvel_b[rows].sum(axis=0) / imu.dt[rows].sum())


def _levelled(force: FloatArray) -> tuple[float, float]:
    """Return roll and pitch [rad] that make a specific force (3,) point up."""
    return float(np.arctan2(-force[1], -force[2])), float(np.arctan2(force[0], np.hypot(force[1], force[2])))


def _level(recording: Recording, row: int, speed: FloatArray, shown: str) -> tuple[int, float, float]:
    fixes = recording.fixes
    low = float(fixes.t[row])
    during = np.flatnonzero(fixes.valid & (fixes.t >= low) & (fixes.t <= low + _REST))
    with np.errstate(invalid="ignore"):
        if (speed[during] > _STILL).any():
            k = int(during[np.argmax(speed[during] > _STILL)])
            raise ConfigError(
                f"{shown} alignment = 'level' needs {_REST:g} s at rest from {low:.2f} s on; "
                f"the vehicle moves at {speed[k]:.2f} m/s at {fixes.t[k]:.2f} s"
            )
    last = int(during[-1])
    return last, *_levelled(_force(recording, low, low + _REST, shown))


def _under_way(recording: Recording, row: int, shown: str) -> tuple[float, float]:
    fixes = recording.fixes
    t, vel_n = float(fixes.t[row]), fixes.vel_n[row]
    near = fixes.valid & (np.abs(fixes.t - t) <= _AROUND) & np.isfinite(fixes.vel_n).all(axis=1)
    accel_n = np.zeros(3)
    if near.sum() >= 3:
        accel_n = np.polyfit(fixes.t[near] - t, fixes.vel_n[near], 1)[0]
    c, s = vel_n[:2] / np.hypot(vel_n[0], vel_n[1])
    level = np.array([c * accel_n[0] + s * accel_n[1], c * accel_n[1] - s * accel_n[0], accel_n[2]])
    return _levelled(_force(recording, t - _AROUND, t + _AROUND, shown) - level)
