"""Plausibility checks of a recording: order of times, gaps, units, axes, clocks of IMU and receiver.

Each check reports what it measured and whether that is plausible. Nothing is repaired. The checks use the
motion itself: gravity at standstill (here), and what both IMU and receiver measured on the move, in a car or
in the air (`bench.evaluation.motion.motion_checks`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import gravity_n, matrix_en, to_ecef
from bench.core.records.data import GnssFixes, ImuData
from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.wording import format_number
from bench.evaluation.motion.motion_checks import (
    GRAVITY_OFF,
    SHIFT_OFF,
    SIGMAS,
    check_motion,
    guess_force_unit,
)
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion

TILT_OFF = np.deg2rad(20.0)
"""Allowed angle from the up axis to the specific force at rest [rad]: steeper than any parking place."""
RATE_LIMIT = np.deg2rad(4000.0)
"""Angular rate beyond the range of usual gyros [rad/s]."""
GAIN_OFF = 0.2  # allowed relative difference of heights and velocities by two instruments
_SPEEDS = {3.6: "km/h", 1.944: "knots", 3.281: "ft/s"}
_MOVED, _SLOWEST = 8.0, 0.5  # a velocity is compared if its rms exceeds its noise this much, and [m/s]
_LEAST_CLIMB = 20.0  # standard deviation of the heights from which a barometer is compared [m]
_WANDER = 60.0  # errors of heights further apart than this count as independent [s]
_SEARCH = 1.0  # largest time shift that is tried, either way [s]
_STEP = 0.01  # step of the search [s]
_GAP = 3.0  # a longer interval is a gap, in usual intervals
_LAGS = 4  # fixes over which the residuals of central differences are correlated
_FEWEST = 20  # smallest number of fixes for a correlation


def check_recording(
    imu: ImuData, fixes: GnssFixes, instruments: Mapping[str, Any], antenna_b: FloatArray
) -> list[Check]:
    """Check a recording; return the results in reading order.

    Parameters
    ----------
    imu : ImuData
        In frame b, in the order of the file.
    fixes : GnssFixes
        With times of the same clock.
    instruments : mapping
        Records by name of the instrument, with times of the same clock.
    antenna_b : (3,) array
        GNSS antenna relative to the IMU [m], b.
    """
    checks = [*check_times("imu", imu.t, imu.valid), *check_times("gnss", fixes.t, fixes.valid)]
    for name, record in instruments.items():
        checks += check_times(name, record.t, record.valid)
    with np.errstate(all="ignore"):  # figures may overflow; what is not finite is reported as it is
        motion = RecordedMotion.from_records(imu, fixes)
        velocity = check_velocity(motion)
        checks += [check_rates(motion), *check_rest(motion), *velocity]
        if not any(check.name.startswith("velocity_ratio") for check in velocity):
            checks += check_motion(motion, np.asarray(antenna_b))
        if "baro" in instruments:
            checks += check_heights("baro", motion, instruments["baro"])
        return checks


def check_times(name: str, t: FloatArray, valid: BoolArray) -> list[Check]:
    """Check the times of a record; messages count rows from 1."""
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.nan
    back = np.flatnonzero(t[1:] <= np.maximum.accumulate(t)[:-1])
    long = np.flatnonzero(steps > _GAP * usual)
    bad = np.flatnonzero(~valid)
    rate = 1.0 / usual
    text = f"{name}: {len(t)} rows, {t[0]:.2f} to {t[-1]:.2f} s, {rate:.4g} Hz"
    found = [Check(f"{name}_rate_hz", rate, text, True)]
    if len(back):
        many = f"{len(back)} of {len(t)} rows"
        text = f"{name}: {many} repeat a time or go back and are left out, first row {back[0] + 2}"
        found.append(Check(f"{name}_unordered_rows", float(len(back)), text, False))
    if len(long):
        k = int(long[np.argmax(steps[long])])
        gaps = "1 gap, of" if len(long) == 1 else f"{len(long)} gaps, the longest"
        text = f"{name}: {gaps} {format_number(steps[k], 3)} s before row {k + 2}, at {t[k]:.2f} s"
        found.append(Check(f"{name}_gaps", float(len(long)), text, False))
    if len(bad):
        what = "are flagged, lie at latitude 0, longitude 0" if name == "gnss" else "are flagged"
        text = f"{name}: {len(bad)} rows {what} or hold no finite number, the first is row {bad[0] + 1}"
        found.append(Check(f"{name}_invalid_rows", float(len(bad)), text, False))
    return found


def check_rates(motion: RecordedMotion) -> Check:
    """Check the largest angular rate."""
    most = float(np.rad2deg(motion.most_rate))
    text = f"imu: largest angular rate {most:.4g} deg/s"
    good = motion.most_rate <= RATE_LIMIT
    if not good:
        text += ": are these deg/s in a column of rad/s?"
    return Check("gyro_max_deg_s", most, text, good)


def check_rest(motion: RecordedMotion) -> list[Check]:
    """Check gravity and angular rate at standstill."""
    spans = motion.find_standstills()
    rows = np.zeros(len(motion.t), np.bool_)
    for a, b in spans:
        rows |= (motion.t > a + 0.5) & (motion.t < b - 0.5)
    if not rows.any():
        shown = "shows no standstill" if np.isfinite(motion.speed).any() else "gives no velocity"
        text = f"imu: the receiver {shown}; gravity and gyro bias are not checked"
        return [Check("gravity_ratio", None, text, True)]
    force = motion.accel[rows].mean(axis=0)
    size = float(np.linalg.norm(force))
    lat, _, alt = np.nanmean(motion.lla, axis=0)
    ratio = size / float(np.linalg.norm(gravity_n(lat, alt)))
    tilt = float(np.arccos(np.clip(-force[2] / size, -1.0, 1.0))) if size > 0 else np.nan
    seconds = sum(b - a for a, b in spans)
    text = f"imu: specific force at rest ({seconds:.0f} s) is {size:.4g} m/s^2, {ratio:.4f} of gravity"
    if abs(ratio - 1.0) > GRAVITY_OFF:
        text += guess_force_unit(ratio)
    found = [Check("gravity_ratio", ratio, text, abs(ratio - 1.0) <= GRAVITY_OFF)]
    words = f"imu: at rest the up axis is {np.rad2deg(tilt):.1f} deg off the specific force"
    if tilt > TILT_OFF:
        words += ": mounting_deg does not make z point down"
    found.append(Check("rest_tilt_deg", float(np.rad2deg(tilt)), words, bool(tilt <= TILT_OFF)))
    bias = np.rad2deg(motion.gyro[rows].mean(axis=0))
    text = f"imu: angular rate at rest {', '.join(f'{b:.3f}' for b in bias)} deg/s"
    return [*found, Check("rest_rate_deg_s", float(np.linalg.norm(bias)), text, True)]


def check_velocity(motion: RecordedMotion) -> list[Check]:
    """Compare the velocity of the receiver with its positions: late, in another unit, or with other axes."""
    good = np.asarray(np.isfinite(motion.vel_n).all(axis=1))
    if 2 * good.sum() < len(good) or good.sum() < _FEWEST + 2:
        text = "gnss: no velocity; its positions alone are compared with the IMU"
        return [Check("velocity_shift_s", None, text, True)]
    t, lla, vel_n = motion.fix_t[good], motion.lla[good], motion.vel_n[good]
    C_en = matrix_en(lla[:, 0], lla[:, 1])
    path, velocity = to_ecef(lla), np.einsum("kij,kj->ki", C_en, vel_n)
    between = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
    traveled = np.concatenate([np.zeros((1, 3)), np.cumsum(between, axis=0)])
    middle = np.flatnonzero(t[2:] - t[:-2] < 2.5 * float(np.median(np.diff(t))))
    if len(middle) < _FEWEST:
        text = "gnss: too few velocities in a row to compare them with its positions"
        return [Check("velocity_shift_s", None, text, True)]
    early, late = t[middle], t[middle + 2]
    span = (late - early)[:, None]
    seen, own = (path[middle + 2] - path[middle]) / span, (traveled[middle + 2] - traveled[middle]) / span
    shift, sd = fit_shift(t, traveled, early, late, seen)
    text = f"gnss: its velocity fits its positions with {shift:+.3f} s added to its time (sd {sd:.3f} s)"
    if not np.isfinite(shift) or sd > SHIFT_OFF:
        text = "gnss: the motion does not show whether its velocities are on time"
        found = [Check("velocity_shift_s", None, text, True)]
    else:
        bad = abs(shift) > max(SHIFT_OFF, SIGMAS * sd)
        text += f": add {shift:+.3f} to [gnss] velocity_offset_s" if bad else ""
        found = [Check("velocity_shift_s", shift, text, not bad)]
    turned = np.swapaxes(C_en[middle + 1], 1, 2)
    by_position, by_velocity = (np.einsum("kij,kj->ki", turned, x) for x in (seen, own))
    for axis, reference, value in zip(("north", "east", "down"), by_position.T, by_velocity.T, strict=True):
        ratio, sd = fit_ratio(value, reference)
        jitter = float(np.std(np.diff(value, 2))) / np.sqrt(6.0)  # its noise, if it is white
        still = float(np.sqrt(np.mean(value**2))) < max(_MOVED * jitter, _SLOWEST)
        if still or abs(ratio - 1.0) <= max(GAIN_OFF, SIGMAS * sd):
            continue
        off, unit = min((abs(ratio * factor - 1.0), unit) for factor, unit in _SPEEDS.items())
        guess = f"are these {unit}?" if off < 0.1 else "the unit, a sign or the order of the axes looks wrong"
        text = f"gnss: {axis}, its positions move {ratio:.3f} of its velocity: {guess}"
        found.append(Check(f"velocity_ratio_{axis}", ratio, text, False))
    return found


def fit_ratio(x: FloatArray, y: FloatArray) -> tuple[float, float]:
    """Return the ratio of y to x (N,) and its standard deviation, with residuals that are correlated."""
    power = float(x @ x)
    if power == 0.0:
        return 1.0, np.inf
    ratio = float(x @ y) / power
    return ratio, float(np.sqrt(variance_of_sum(x * (y - ratio * x)))) / power


def check_heights(name: str, motion: RecordedMotion, record: Any) -> list[Check]:
    """Compare the heights of a barometer with the heights of the receiver."""
    height_b = INSTRUMENTS[name].values(record)[:, 0]
    good = record.valid & np.isfinite(height_b)
    rows = np.flatnonzero(good)[np.unique(record.t[good], return_index=True)[1]]
    inside = (motion.fix_t >= record.t[rows].min(initial=np.inf)) & (
        motion.fix_t <= record.t[rows].max(initial=-np.inf)
    )
    height = motion.lla[inside, 2]
    if len(height) < _FEWEST or height.std() < _LEAST_CLIMB:
        return []
    own = np.interp(motion.fix_t[inside], record.t[rows], height_b[rows])
    x, y = height - height.mean(), own - own.mean()
    ratio = float(x @ y / (x @ x))
    seconds = float(motion.fix_t[inside][-1] - motion.fix_t[inside][0])
    sd = float(np.std(y - ratio * x) / np.std(x)) / np.sqrt(max(seconds / _WANDER, 1.0))
    text = f"{name}: heights change by {ratio:.3f} times the receiver (sd {sd:.3f})"
    bad = abs(ratio - 1.0) > max(GAIN_OFF, SIGMAS * sd)
    if bad:
        text += (
            ": are these feet?" if abs(ratio / 3.281 - 1.0) < 0.1 else ": the unit or the sign looks wrong"
        )
    return [Check(f"{name}_ratio", ratio, text, not bad)]


def mean_rate(t: FloatArray, integral: FloatArray, early: FloatArray, late: FloatArray) -> FloatArray:
    """Return the mean rates (M, k) between epochs (M,) of integrals (N, k), less their average."""
    columns = [(np.interp(late, t, one) - np.interp(early, t, one)) / (late - early) for one in integral.T]
    rates = np.stack(columns, axis=-1)
    return np.asarray(rates - rates.mean(axis=0))


def fit_shift(
    t: FloatArray, integral: FloatArray, early: FloatArray, late: FloatArray, seen: FloatArray
) -> tuple[float, float]:
    """Return the time to add to t that fits the reference rates [s], and its standard deviation.

    The shift maximizes the correlation between the mean rates of the integral from ``early`` to ``late`` and
    the reference ``seen``. Its standard deviation is that of a linear least squares fit with correlated
    residuals: neighboring central differences share half their time.
    """
    shifts = np.arange(-_SEARCH, _SEARCH + 0.5 * _STEP, _STEP)
    inside = (early > t[0] + _SEARCH) & (late < t[-1] - _SEARCH)
    early, late, seen = early[inside], late[inside], seen[inside]
    if len(seen) < _FEWEST:
        return np.nan, np.nan
    seen = seen - seen.mean(axis=0)

    def rate(shift: float) -> FloatArray:
        return mean_rate(t, integral, early - shift, late - shift)

    scores = np.abs([np.vdot(own, seen) / np.linalg.norm(own) for own in map(rate, shifts)])
    k = int(np.clip(np.argmax(scores), 1, len(shifts) - 2))
    a, b, c = scores[k - 1 : k + 2]
    bend = a - 2 * b + c
    best = float(shifts[k] + (0.5 * _STEP * (a - c) / bend if bend < 0 else 0.0))
    own = rate(best)
    gain = float(np.vdot(own, seen) / np.vdot(seen, seen))
    slope = (rate(best - _STEP) - rate(best + _STEP)) / (2 * _STEP)
    pulls = np.sum(slope * (own - gain * seen), axis=1)
    return best, float(np.sqrt(variance_of_sum(pulls)) / np.vdot(slope, slope))


def variance_of_sum(values: FloatArray) -> float:
    """Return the variance (above 0) of the sum of values that are correlated over a few rows."""
    products = [np.dot(values[lag:], values[:-lag]) for lag in range(1, min(_LAGS, len(values) - 1) + 1)]
    alone = float(np.dot(values, values))
    return max(alone + 2.0 * float(np.sum(products)), 0.01 * alone)
