"""Checks of a recording by the motion that both IMU and receiver measured: units, axes, clocks, lever arm.

`motion.motion_fit` compares them with the attitude of the vehicle known from its own gyros, so a
bank, a climb or a roll is no error. A value is reported if the motion shows it at all, and called wrong
beyond a limit and 5 of its own standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.evaluation.motion.axis_names import name_axes
from bench.evaluation.motion.axis_search import (
    AS_GIVEN,
    FIT_WELL,
    Explained,
    Hypothesis,
    explain,
    explain_as_given,
    explain_held,
    search,
)
from bench.evaluation.motion.motion_fit import (
    LENGTH,
    MOTION_NOISE,
    NAMES,
    TURN,
    MotionFit,
    Stretches,
    find_stretches,
)
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion

SIGMAS = 5.0
"""A deviation counts beyond this many of its standard deviations."""
GRAVITY_OFF = 0.03
"""Allowed relative error of the specific force [1]: more than the bias of usual IMUs."""
RATE_OFF = 0.05
"""Allowed relative error of the angular rates [1]: more than the scale factor of any usual gyro."""
SHIFT_OFF = 0.02
"""Allowed time shift between the clocks [s]: 0.2 m at 10 m/s."""
TRIADS_OFF = np.deg2rad(5.0)
"""Allowed angle between the axes of gyros and accelerometers [rad]."""
ARM_OFF = 0.5
"""Allowed error of the lever arm [m]."""
_ARM_KNOWN = 0.25  # sd of a lever arm that the motion shows [m]: half of what is known before
YAW_OFF = np.deg2rad(15.0)
"""Allowed angle between the forward axis and the motion through the air or over ground [rad]."""
NOISE_OFF = 2.0
"""Allowed ratio of the scatter of the velocities of a receiver to what filters assume."""
LEVEL_OFF = np.deg2rad(30.0)
"""Allowed angle from the up axis to the mean specific force on the move [rad]."""
_MOVING = 2.0  # lowest ground speed that gives a course [m/s]
_HEADING_SD = np.deg2rad(2.0)  # segments whose heading is known better are compared with the course [rad]
_ROUGH_SD = np.deg2rad(10.0)  # the same to tell which axis is forward [rad]
_FORWARD = 0.8  # length of the mean direction of the motion in the vehicle if it moves forward [1]
_SIDEWAYS = 0.35  # rms of the sine of the angle from the forward axis to the motion, if it does [1]
_WIND_SD, _WIND_SHARE = 15.0, 0.3  # what the wind may be [m/s], and of the speed over ground [1]
_LIKELIER = 2.0  # logarithm of the likelihood by which rather a velocity is late than a clock wrong
_WORST_RECEIVER = 1.0  # noise of a velocity by Doppler [m/s]: tenths in a city
_LEAP, _LEAP_OFF = (13, 18), 0.3  # seconds between UTC and GPS time since 1999, and how near a shift must be


def check_motion(motion: RecordedMotion, antenna_b: FloatArray) -> tuple[list[Check], Hypothesis]:
    """Compare IMU and receiver; ``antenna_b`` (3,) is the antenna relative to the IMU [m], b.

    Clock, axes, signs, unit, gains, biases, lever arm and the angle between the triads are one fit, so that
    one mistake is not named as another. Returns the checks, and the changes with which the recording fits.
    """
    stretches = find_stretches(motion.t, *motion.take_velocities())
    if not len(stretches):
        text = "gnss: too few fixes in a row; clocks, units and axes of IMU and receiver are not compared"
        return [Check("imu_shift_s", None, text, True)], AS_GIVEN
    if not motion.moves:
        text = "imu: nothing moves: clocks, units and axes of gyros, and the lever arm do not show"
        return [Check("imu_shift_s", None, text, True)], AS_GIVEN
    given = explain_as_given(motion, antenna_b)
    assert given is not None
    best = given if given.fit.rms.max() < FIT_WELL else search(motion, antenna_b, given)
    best, words, forward = _name(motion, antenna_b, best)
    h, fit = best.hypothesis, best.fit
    found = []
    if words:
        found.append(Check("imu_axes", None, words, False, {"imu.axes": (h.gyro, h.accel)}))
    level = motion.accel.mean(axis=0) @ h.accel.T
    tilt = float(np.arccos(np.clip(-level[2] / np.linalg.norm(level), -1.0, 1.0)))
    if not motion.find_standstills():
        text = f"imu: on the move the up axis is {np.rad2deg(tilt):.1f} deg off the mean specific force"
        if tilt > LEVEL_OFF:
            text += ": change mounting_deg so that z points down"
        found.append(Check("level_tilt_deg", float(np.rad2deg(tilt)), text, tilt <= LEVEL_OFF))
    if h.down < 0:
        text = "gnss: the vertical velocity is reversed: it is up where down is expected"
        found.append(
            Check("velocity_ratio_down", -1.0, text, False, {"gnss.velocity": np.diag([1.0, 1.0, -1.0])})
        )
    found += [
        check_shift(fit, h.offset, motion.velocity_shift_left, motion.velocity_shift_sd),
        check_rate_gain(fit, h.unit),
        check_force_gain(fit),
    ]
    found.append(check_triads(fit, lambda: _weigh_turn(motion, antenna_b, best)))
    unknown_arm = bool(words) and not forward
    found.append(_unknown("arm_off_m", "where the antenna is") if unknown_arm else check_arm(fit, antenna_b))
    found.append(check_forward_axis(fit, best.stretches))
    if all(one.good for one in found) and motion.velocity_shift == 0.0:
        found += check_velocity_noise(fit, motion)
    return found, h


def _name(motion: RecordedMotion, antenna_b: FloatArray, best: Explained) -> tuple[Explained, str, bool]:
    """Return the fit in the axes of the vehicle, the line on wrong axes, and whether forward shows."""
    h, fit = best.hypothesis, best.fit
    up = motion.accel.mean(axis=0) @ h.accel.T
    cluster = np.repeat(np.arange(len(best.stretches)), np.diff(best.stretches.begin))
    vel = best.stretches.vel_n
    size = np.linalg.norm(vel, axis=1)
    use = (fit.heading_sd[cluster] < _ROUGH_SD) & (size > max(_MOVING, 0.3 * float(size.max())))
    ahead = None
    if len(np.unique(cluster[use])) > 1:
        mean = np.einsum("kji,kj->i", fit.C_nb[use], vel[use] / size[use, None]) / use.sum()
        ahead = mean if np.linalg.norm(mean) > _FORWARD else None
    named = name_axes(h.gyro, h.accel, up, ahead)
    if named.text and not np.array_equal(named.gyro, h.gyro):
        again = explain(motion, antenna_b, replace(h, gyro=named.gyro, accel=named.accel))
        assert again is not None
        best = again
    return best, named.text, ahead is not None


def _weigh_turn(motion: RecordedMotion, antenna_b: FloatArray, best: Explained) -> float:
    """Return by how much the logarithm of the likelihood rises with the turn between the triads."""
    without = explain_held(motion, antenna_b, best, TURN)
    return float((without.cost - best.cost) * best.free.sum())


def _take(fit: MotionFit, name: str) -> tuple[float, float]:
    """Return a parameter and its standard deviation."""
    k = NAMES.index(name)
    return float(fit.values[k]), float(np.sqrt(fit.cov[k, k]))


def _is_off(value: float, sd: float, limit: float) -> bool:
    return abs(value) > max(limit, SIGMAS * sd)


def _unknown(name: str, what: str) -> Check:
    return Check(name, None, f"imu: the motion does not show {what}", True)


def check_shift(fit: MotionFit, offset: float = 0.0, late: float = 0.0, late_sd: float = 0.0) -> Check:
    """Check the time shift between IMU and fixes against the motion of the fixes, beyond an ``offset`` [s].

    ``late`` [s] with ``late_sd``: by the positions, it is added to the times of the velocities alone.
    """
    shift, sd = _take(fit, "shift")
    shift += offset
    off = _is_off(shift, sd, SHIFT_OFF)
    if not off and sd > SHIFT_OFF:
        return _unknown("imu_shift_s", f"the shift between the clocks of IMU and receiver (sd {sd:.2g} s)")
    text = f"imu: its clock fits the receiver's with {shift:+.3f} s added (sd {sd:.3f} s)"
    advice = {}
    if off:
        advice = {"imu.time_offset_s": shift}
        if _LEAP[0] <= round(abs(shift)) <= _LEAP[1] and abs(abs(shift) - round(abs(shift))) < _LEAP_OFF:
            text += f": one clock is UTC, the other GPS time ({round(abs(shift))} leap seconds)"
        may_be_late, by_velocity = (
            late_sd > abs(shift + late) / SIGMAS,
            f"{-shift:+.3f} to [gnss] velocity_offset_s",
        )
        if may_be_late and late**2 - (shift + late) ** 2 > 2.0 * _LIKELIER * late_sd**2:
            text += f", more likely only the receiver's velocity is late: add {by_velocity}"
            return Check("imu_shift_s", shift, text, False, {"gnss.velocity_offset_s": -shift})
        text += f": add {shift:+.3f} to [imu] time_offset_s"
        text += f", or if only the receiver's velocity is late: {by_velocity}" if may_be_late else ""
    return Check("imu_shift_s", shift, text, not off, advice)


def check_rate_gain(fit: MotionFit, unit: float = 1.0) -> Check:
    """Check the gain of the gyros, multiplied by ``unit`` before, against the motion of the fixes."""
    gain, sd = _take(fit, "gyro_gain")
    gain = float(np.exp(gain)) / unit
    off = _is_off(gain - 1.0, sd, RATE_OFF)
    if not off and sd > RATE_OFF:
        return _unknown("turn_gain", f"the unit of the angular rates (sd {sd:.2g})")
    text = f"imu: angular rates are {gain:.3f} times the motion"
    if off:
        guess = {57.3: "deg/s in a column of rad/s", 1 / 57.3: "rad/s in a column of deg/s"}
        near = [words for value, words in guess.items() if abs(gain / value - 1.0) < 0.2]
        text += f": are these {near[0]}?" if near else ": the unit or the scale looks wrong"
    return Check("turn_gain", gain, text, not off, {"imu.gyro_gain": gain} if off else {})


def check_force_gain(fit: MotionFit) -> Check:
    """Check the gain of the accelerometers against the motion of the fixes."""
    gain, sd = _take(fit, "accel_gain")
    gain = float(np.exp(gain))
    off = _is_off(gain - 1.0, sd, GRAVITY_OFF)
    if not off and sd > GRAVITY_OFF:
        return _unknown("force_gain", f"the unit of the specific force (sd {sd:.2g})")
    text = f"imu: specific force is {gain:.3f} times the motion"
    if off:
        text += guess_force_unit(gain)
    return Check("force_gain", gain, text, not off, {"imu.accel_gain": gain} if off else {})


def check_velocity_noise(fit: MotionFit, motion: RecordedMotion) -> list[Check]:
    """Check for velocities that scatter more, within a segment of some seconds, than filters assume.

    Scatter that the noise of the accelerometers explains does not count: if the noise is white, its
    integral is a random walk, whose variance around a fitted line is its variance at the end by 15. Beyond
    `_WORST_RECEIVER` it is the IMU, saturated or silent in the maneuvers, that does not follow.
    """
    sd = float(np.median(fit.rms))
    white = float(np.std(np.diff(motion.accel, 2, axis=0))) / np.sqrt(6.0)
    walk = white * np.sqrt(float(np.median(np.diff(motion.t))) * LENGTH / 15.0)
    assumed = motion.assumed_sd
    least = NOISE_OFF * max(np.hypot(assumed, walk), MOTION_NOISE)
    if not least < sd < _WORST_RECEIVER or len(fit.rms) < 2:
        return []
    text = (
        f"gnss: its velocities scatter by {sd:.2g} m/s around the motion of the IMU, filters assume "
        f"{assumed:.2g} m/s: set velocity_sd_mps = {sd:.2g} in [gnss]"
    )
    return [Check("velocity_sd_mps", sd, text, False, {"gnss.velocity_sd_mps": float(f"{sd:.2g}")})]


def guess_force_unit(ratio: float) -> str:
    """Return the likely cause of this ratio of specific force to gravity, as the end of a line."""
    if abs(ratio * STANDARD_GRAVITY - 1.0) < 0.1:
        return ": are these g in a column of m/s^2?"
    if abs(ratio / STANDARD_GRAVITY - 1.0) < 0.1:
        return ": are these m/s^2 in a column of g?"
    return ": the unit or the scale looks wrong"


def check_triads(fit: MotionFit, weigh: Callable[[], float] = lambda: np.inf) -> Check:
    """Check that gyros and accelerometers share their axes.

    A large turn is far from linear, so its standard deviation may be too small. It is therefore reported only
    if the rise of the log likelihood with the turn, which ``weigh`` returns, is as large as `SIGMAS`, too.
    """
    each = [_take(fit, f"turn_{axis}") for axis in "xyz"]
    bad = [_is_off(turn, sd, TRIADS_OFF) for turn, sd in each]
    alike = any(bad) and weigh() < 0.5 * SIGMAS**2
    if alike or (not any(bad) and max(sd for _, sd in each) > TRIADS_OFF):
        return _unknown("triads_deg", "whether gyros and accelerometers have the same axes")
    turns = np.rad2deg([turn for turn, _ in each])
    shown = ", ".join(f"{turn:+.1f}" for turn in turns)
    text = f"imu: accelerometers are turned by {shown} deg about x, y, z against the gyros"
    if any(bad):
        text += ": their axes are not the same"
    return Check("triads_deg", float(np.linalg.norm(turns)), text, not any(bad))


def check_arm(fit: MotionFit, antenna_b: FloatArray) -> Check:
    """Check the lever arm of the antenna against the motion of the fixes."""
    each = [_take(fit, f"arm_{axis}") for axis in "xyz"]
    bad = [_is_off(arm, sd, ARM_OFF) for arm, sd in each]
    known = [sd <= _ARM_KNOWN for _, sd in each]
    if not any(bad) and not any(known):
        return _unknown("arm_off_m", "where the antenna is")
    shown = ", ".join(
        f"{at + off:.2f}" if told or wrong else "?"
        for at, (off, _), told, wrong in zip(antenna_b, each, known, bad, strict=True)
    )
    text = f"gnss: by the motion the antenna is at {shown} m (forward, right, down of the IMU)"
    if any(bad):
        given = ", ".join(f"{at:.2f}" for at in antenna_b)
        text += f", not at {given} m: is position_m right?"
    off = float(np.linalg.norm([value for (value, _), told in zip(each, known, strict=True) if told]))
    change = [
        value if told or wrong else 0.0 for (value, _), told, wrong in zip(each, known, bad, strict=True)
    ]
    return Check("arm_off_m", off, text, not any(bad), {"gnss.position_m": change} if any(bad) else {})


def check_forward_axis(fit: MotionFit, stretches: Stretches) -> Check:
    """Compare the forward axis with the motion through the air, with a wind that stays.

    With nose h and the unit vector p to its right, turned by the wanted angle, (v - wind) p = 0: Gauss-Newton
    on the angle and the wind.
    """
    unknown = _unknown("forward_yaw_deg", "where its forward axis points")
    cluster = np.repeat(np.arange(len(stretches)), np.diff(stretches.begin))
    vel = stretches.vel_n[:, :2]
    use = (fit.heading_sd[cluster] < _HEADING_SD) & (np.hypot(*vel.T) > _MOVING)
    if len(np.unique(cluster[use])) < 2:
        return unknown
    vel, cluster, nose = vel[use], cluster[use], fit.C_nb[use][:, :2, 0]
    ahead = np.arctan2(nose[:, 1], nose[:, 0])
    off = np.arctan2(vel[:, 1], vel[:, 0]) - ahead
    values = np.array([np.arctan2(np.sin(off).mean(), np.cos(off).mean()), 0.0, 0.0])
    wind_sd = min(_WIND_SD, _WIND_SHARE * float(np.median(np.hypot(*vel.T))))
    prior = np.diag([0.0, wind_sd**-2, wind_sd**-2])
    for _ in range(6):
        h = np.column_stack([np.cos(ahead + values[0]), np.sin(ahead + values[0])])
        p = np.column_stack([-h[:, 1], h[:, 0]])
        air = vel - values[1:]
        J = np.column_stack([np.sum(air * h, axis=1), p])
        residual = np.sum(air * p, axis=1)
        inverse = np.linalg.inv(J.T @ J + prior + 1e-9 * np.eye(3))
        values = values + inverse @ (J.T @ residual - prior @ values)
    scores = np.stack([J[cluster == k].T @ residual[cluster == k] for k in np.unique(cluster)])
    factor = len(scores) / (len(scores) - 1)
    sd = float(np.sqrt((inverse @ (factor * scores.T @ scores + prior) @ inverse)[0, 0]))
    angle = float(np.arctan2(np.sin(values[0]), np.cos(values[0])))
    air = vel - values[1:]
    sideways = np.sin(np.arctan2(air[:, 1], air[:, 0]) - ahead - values[0])
    bad = _is_off(angle, sd, YAW_OFF)
    if (not bad and sd > YAW_OFF) or np.sqrt(np.mean(sideways**2)) > _SIDEWAYS:
        return unknown
    text = f"imu: it moves {np.rad2deg(angle):+.1f} deg right of its forward axis"
    if bad:
        text += ": if it moves forward, change mounting_deg so that x points there"
    return Check("forward_yaw_deg", float(np.rad2deg(angle)), text, not bad)
