"""The initial state for the filters of a recording: what the log gives, and nothing more.

In the air ("hover") the fixes say how the velocity changed over a segment, ``dv``, and with the gyros, which
carry each sample to the end of it, the specific force there is

    f_b T = sum C_bk dvel_k        C_nb f_b T = dv - g T        Groves, Principles of GNSS..., 2nd ed., 5.6.2

Roll and pitch follow from it once the heading is known; without it ``dv`` counts as an error of the tilt.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.rotation import (
    conjugate,
    from_euler,
    from_rotvec,
    matrix,
    multiply,
    rotate,
    to_euler,
)
from bench.core.records.data import GnssFixes, InitialState
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import LogSpec
from bench.io.logs.log_records import LogRecords
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.navigation.start.alignment import UNKNOWN_SPEED_SD
from bench.navigation.start.leveling import bias_sd
from bench.simulation.signals.magnetic import field_n

HOVER = 4.0
"""Length of the segment of a start in the air [s]."""
_PLACE_SD = 1e3  # of the place of a log without a receiver [m]
_ROUGH_TILT = np.deg2rad(1.0)  # of a start in the air: vibration, flexing, gusts between two fixes [rad]
_TURNS = 20  # fixed-point steps for the heading of a magnetometer: each gains a factor of dv / (g T)

_UP = np.array([0.0, 0.0, -1.0])  # a specific force at rest, n

OwnAttitude = Callable[[float], FloatArray]
"""Attitude (4,) of the autopilot at a time [s]; NaN where it has none."""


def find_start(recording: LogRecords, spec: LogSpec, own: OwnAttitude | None = None) -> InitialState:
    """Return the initial state at or after ``[alignment] at_s``; unknowns are NaN with infinite variance.

    "given": position and velocity of the first usable fix, corrected for the lever arm, and the attitude of
    the log; if no fix has a velocity, zero with a large variance. "level": the position of that fix, with the
    length of the lever arm as additional uncertainty, and the heading if the log says whence. "hover":
    position and velocity of the fix that ends a segment of ``duration_s``, and the attitude by both.
    "course": only the time. Without a receiver: the place of the log, at rest or of any velocity. ``own``
    gives the attitude of the autopilot, of which only the heading is used.

    Raises
    ------
    ConfigError
        If there is no usable fix, it reports no standard deviation, or the heading cannot be had.
    """
    given, fixes = spec.start, recording.fixes
    if spec.gnss is None:
        return _start_at_place(spec)
    arm_b = np.asarray(spec.antenna_b)
    if given.alignment == "hover":
        return _start_in_the_air(recording, spec, own)
    t, lla, vel_n, q_nb, variance = (
        given.at,
        np.full(3, np.nan),
        np.full(3, np.nan),
        np.full(4, np.nan),
        np.full(9, np.inf),
    )
    if given.alignment != "course":
        moving = given.alignment == "given"
        usable = fixes.valid & (fixes.t >= given.at)
        full = usable & np.isfinite(fixes.vel_n).all(axis=1)
        if moving and full.any():
            usable = full
        row = _first_fix(spec, usable)
        t, lla = float(fixes.t[row]), fixes.lla[row]
        variance[:3] = np.diag(fixes.cov_pos_n[row])
        if moving:
            q_nb = from_euler(*given.attitude)
            lla, vel_n = earth.displace(lla, -matrix(q_nb) @ arm_b), fixes.vel_n[row]
            variance[3:6] = np.diag(fixes.cov_vel_n[row])
            if not full[row]:
                vel_n, variance[3:6] = np.zeros(3), UNKNOWN_SPEED_SD**2
            variance[6:] = np.square([given.tilt_sd, given.tilt_sd, given.heading_sd])
        else:
            variance[:3] += arm_b @ arm_b
            if given.heading_from:
                imu = recording.imu
                rest = imu.valid & (imu.t > t) & (imu.t <= t + given.align_for)
                force = imu.dvel_b[rest].sum(axis=0)
                if rest.any():
                    heading = _find_heading(recording, spec, own, force, _UP, t, _no_turn)
                    q_nb, variance[8] = from_euler(*_level(force, heading, _UP)), given.heading_sd**2
        reported = variance[: 6 if moving else 3]
        if not (np.isfinite(reported) & (reported > 0)).all():
            raise ConfigError(
                f"{spec.name}.toml: [alignment] the fix at {t:.2f} s reports no standard "
                "deviation above 0; set at_s to another"
            )
    return InitialState(
        t=t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        cov=np.diag(variance),
        alignment=given.alignment,
        align_for=given.align_for,
        drift_sd=given.drift_sd,
    )


def _start_at_place(spec: LogSpec) -> InitialState:
    """Return the initial state of a log without a receiver: at rest or of any velocity, at its place."""
    assert spec.place is not None
    given, lla = spec.start, np.array(spec.place)
    lla[:2] = np.deg2rad(lla[:2])
    variance = np.repeat([_PLACE_SD**2, UNKNOWN_SPEED_SD**2, np.inf], 3)
    vel_n, q_nb = np.full(3, np.nan), np.full(4, np.nan)
    if given.alignment == "given":
        vel_n, q_nb = np.zeros(3), from_euler(*given.attitude)
        variance[6:] = np.square([given.tilt_sd, given.tilt_sd, given.heading_sd])
    else:
        variance[3:6] = np.inf
    return InitialState(
        given.at, lla, vel_n, q_nb, np.diag(variance), given.alignment, align_for=given.align_for
    )


def _first_fix(spec: LogSpec, usable: BoolArray) -> int:
    if not usable.any():
        at = spec.start.at
        raise ConfigError(f"{spec.name}.toml: [alignment] at_s = {at:g} s: no usable fix from there on")
    return int(np.argmax(usable))


# --- in the air ---------------------------------------------------------------------------------------


def _no_turn(t: float) -> FloatArray:
    """Return the attitude of the body at t in that at the end of a segment: it did not turn."""
    return np.array([1.0, 0.0, 0.0, 0.0])


def _start_in_the_air(recording: LogRecords, spec: LogSpec, own: OwnAttitude | None) -> InitialState:
    """Return the state at the fix that ends a segment, from the fixes and IMU data of the segment."""
    given, fixes, imu = spec.start, recording.fixes, recording.imu
    usable = fixes.valid & np.isfinite(fixes.vel_n).all(axis=1) & (fixes.t >= max(given.at, imu.t[0]))
    first = _first_fix(spec, usable)
    ends = usable & (fixes.t >= fixes.t[first] + given.align_for)
    last = _first_fix(spec, ends)
    begin, end = float(fixes.t[first]), float(fixes.t[last])
    rows = np.flatnonzero(imu.valid & (imu.t > begin) & (imu.t <= end))
    T = float(imu.dt[rows].sum())
    if 0.5 * (end - begin) >= T:
        what = f"the IMU is silent for most of {begin:.2f} to {end:.2f} s"
        raise ConfigError(f"{spec.name}.toml: [alignment] {what}; set at_s to another time")
    turned = np.empty((len(rows) + 1, 4))  # the body after each sample in the body before the first
    turned[0] = 1.0, 0.0, 0.0, 0.0
    for k, step in enumerate(imu.dtheta_b[rows]):
        turned[k + 1] = multiply(turned[k], from_rotvec(step))
    to_end = multiply(conjugate(turned[-1]), turned)  # the body after each sample in that at the end
    force = rotate(to_end[:-1], imu.dvel_b[rows]).sum(axis=0) / T
    gain_n = (fixes.vel_n[last] - fixes.vel_n[first]) / (end - begin)
    g_n = earth.gravity_n(fixes.lla[last, 0], fixes.lla[last, 2])
    felt_n = gain_n - g_n

    def turn_to_end(t: float) -> FloatArray:
        return np.asarray(to_end[np.searchsorted(imu.t[rows], t)])

    known = bool(given.heading_from)
    heading = _find_heading(recording, spec, own, force, felt_n, end, turn_to_end) if known else 0.0
    q_nb = from_euler(*_level(force, heading, felt_n if known else _UP))
    g = float(np.linalg.norm(g_n))
    noise = np.sqrt(np.trace(fixes.cov_vel_n[first] + fixes.cov_vel_n[last])) / (end - begin)
    unknown = [bias_sd(spec.assumed.imu.accel, g), noise, 0.0 if known else np.hypot(*gain_n[:2])]
    tilt_sd = np.hypot(_ROUGH_TILT, np.linalg.norm(unknown) / g)
    heading_sd = given.heading_sd if known else UNKNOWN_HEADING_SD
    arm_b = np.asarray(spec.antenna_b)
    variance = np.concatenate(
        [
            np.diag(fixes.cov_pos_n[last]) + (0.0 if known else arm_b @ arm_b),
            np.diag(fixes.cov_vel_n[last]) + 0.1 * arm_b @ arm_b,
            np.square([tilt_sd, tilt_sd, heading_sd]),
        ]
    )
    return InitialState(
        t=end,
        lla=earth.displace(fixes.lla[last], -matrix(q_nb) @ arm_b if known else np.zeros(3)),
        vel_n=fixes.vel_n[last],
        q_nb=q_nb,
        cov=np.diag(variance),
        alignment="given",
    )


def _level(force: FloatArray, heading: float, felt_n: FloatArray) -> tuple[float, float, float]:
    """Return roll, pitch and heading that turn the force (3,) in b along that felt in n; the smaller roll."""
    along = rotate(from_euler(0.0, 0.0, -heading), felt_n)
    u = along / np.linalg.norm(along)
    x, y, z = force / np.linalg.norm(force)
    side = np.hypot(y, z)
    open_angle, phase = np.arccos(np.clip(u[1] / side, -1.0, 1.0)), np.arctan2(z, y)
    rolls = np.array([open_angle - phase, -open_angle - phase])
    rolls = np.pi - np.mod(np.pi - rolls, 2.0 * np.pi)
    roll = float(rolls[np.argmin(np.abs(rolls))])
    z = np.sin(roll) * y + np.cos(roll) * z
    pitch = np.arctan2(u[0], u[2]) - np.arctan2(x, z)
    return roll, float(np.pi - np.mod(np.pi - pitch, 2.0 * np.pi)), heading


def _find_heading(
    recording: LogRecords,
    spec: LogSpec,
    own: OwnAttitude | None,
    force: FloatArray,
    felt_n: FloatArray,
    end: float,
    turn_to_end: Callable[[float], FloatArray],
) -> float:
    """Return the heading at the end of a segment, by the magnetometer or the autopilot [rad]."""
    place = f"{spec.name}.toml: [alignment] heading = {spec.start.heading_from!r}"
    if spec.start.heading_from == "autopilot":
        q_nb = own(end) if own is not None else np.full(4, np.nan)
        if not np.isfinite(q_nb).all():
            raise ConfigError(f"{place}: the log has no attitude of its autopilot at {end:.2f} s")
        return float(to_euler(q_nb)[2])
    mag = recording.instruments.get("mag")
    begin = end - spec.start.align_for if spec.start.alignment == "hover" else end
    until = end if spec.start.alignment == "hover" else end + spec.start.align_for
    rows: IntArray = np.empty(0, np.int64)
    if mag is not None:
        rows = np.flatnonzero(mag.valid & (mag.t > begin) & (mag.t <= until))
    if mag is None or not len(rows):
        raise ConfigError(f"{place}: no [mag] with rows between {begin:.2f} and {until:.2f} s")
    field_b = np.mean([rotate(turn_to_end(float(mag.t[k])), mag.field_b[k]) for k in rows], axis=0)
    near = int(np.argmin(np.where(recording.fixes.valid, np.abs(recording.fixes.t - end), np.inf)))
    north, east, _ = field_n(recording.fixes.lla[[near]], spec.date)[0]
    return find_magnetic_heading(force, felt_n, field_b, float(np.arctan2(east, north)))


def find_magnetic_heading(
    force: FloatArray, felt_n: FloatArray, field_b: FloatArray, declination: float
) -> float:
    """Return the heading at which a force is felt along ``felt_n``, and the field points to magnetic north.

    Parameters
    ----------
    force, field_b : (3,) arrays
        Specific force and magnetic field, b, in any unit.
    felt_n : (3,) array
        Specific force over ground, n.
    declination : float
        Of the field, from north to east [rad].
    """
    heading = 0.0
    for _ in range(_TURNS):
        roll, pitch, _ = _level(force, heading, felt_n)
        level = rotate(from_euler(roll, pitch, 0.0), field_b)
        heading = declination - float(np.arctan2(level[1], level[0]))
    return float(np.pi - np.mod(np.pi - heading, 2.0 * np.pi))


def choose_stretch(fixes: GnssFixes, first: float, last: float) -> float:
    """Return where to start in the air between two epochs: where the velocity changes least [s]."""
    good = fixes.valid & np.isfinite(fixes.vel_n).all(axis=1) & (fixes.t >= first) & (fixes.t <= last)
    t, vel_n = fixes.t[good], fixes.vel_n[good]
    ends = np.searchsorted(t, t + HOVER)
    inside = np.flatnonzero(ends < len(t))
    if not len(inside):
        return first
    change = np.hypot(*(vel_n[ends[inside]] - vel_n[inside])[:, :2].T)
    return float(t[inside[np.argmin(change)]])
