"""Plausibility checks of a recording: order of times, gaps, units, axes, clocks of IMU and receiver.

Each check reports what it measured and whether that is plausible. Nothing is repaired. The checks use the
motion itself: gravity at standstill, and on the move the turns and accelerations that both the IMU and the
receiver measure.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import GnssFixes, ImuData
from bench.earth import gravity_n, local_ned
from bench.instruments import BaroData
from bench.units import STANDARD_GRAVITY

STILL = 0.2
"""Ground speed below which a vehicle counts as standing still [m/s]."""
STILL_AT_LEAST = 2.0
"""Shortest standstill that is used [s]."""
GRAVITY_OFF = 0.03
"""Allowed relative error of the specific force at rest [1]: more than the bias of any usual IMU."""
TILT_OFF = np.deg2rad(20.0)
"""Allowed angle from the up axis to the specific force at rest [rad]: steeper than any parking place."""
GAIN_OFF = 0.2
"""Allowed relative difference of the turn rates of IMU and receiver [1]."""
YAW_OFF = np.deg2rad(10.0)
"""Allowed angle between the forward axis and the direction of accelerations [rad]."""
SHIFT_OFF = 0.02
"""Allowed time shift between the clocks [s]: 0.2 m at 10 m/s."""
RATE_LIMIT = np.deg2rad(4000.0)
"""Angular rate beyond the range of usual gyros [rad/s]."""
_MOVING = 2.0  # lowest ground speed that gives a course [m/s]
_TURNING = np.deg2rad(1.0)  # lowest rms turn rate for a correlation [rad/s]
_SPEEDING = 0.1  # lowest rms acceleration along the track for a correlation [m/s^2]
_SEARCH = 1.0  # largest time shift that is tried, either way [s]
_STEP = 0.01  # step of the search [s]
_SIGMAS = 5.0  # a shift is reported beyond this many of its standard deviations
_GAP = 3.0  # a longer interval is a gap, in usual intervals
_LAGS = 4  # fixes over which the residuals of central differences are correlated
_FEWEST = 20  # smallest number of fixes for a correlation


@dataclass(frozen=True, slots=True)
class Check:
    """Result of one check."""

    name: str  # ends in the unit of the value
    value: float | None  # None if it could not be measured
    text: str
    good: bool


def check_recording(
    imu: ImuData, fixes: GnssFixes, baro: BaroData | None, antenna_b: FloatArray
) -> list[Check]:
    """Check a recording; return the results in reading order.

    Parameters
    ----------
    imu : ImuData
        In frame b, in the order of the file.
    fixes : GnssFixes
        With times of the same clock.
    baro : BaroData or None
        With times of the same clock.
    antenna_b : (3,) array
        GNSS antenna relative to the IMU [m], b.

    Notes
    -----
    The course over ground at the IMU is compared with the integral of the turn rate. A car turns about its
    rear axle: an IMU at a distance L ahead of it swings out, and its clock seems to be late by L / speed.
    """
    checks = [*_check_times("imu", imu.t, imu.valid), *_check_times("gnss", fixes.t, fixes.valid)]
    if baro is not None:
        checks += _check_times("baro", baro.t, baro.valid)
    motion = _Motion.from_records(imu, fixes)
    return [
        *checks,
        _check_rates(motion),
        *_check_rest(motion),
        *_check_alignment(motion, np.asarray(antenna_b)),
    ]


def _check_times(name: str, t: FloatArray, valid: BoolArray) -> list[Check]:
    """Check the times of a record; messages count rows from 1."""
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.nan
    back = np.flatnonzero(steps <= 0)
    long = np.flatnonzero(steps > _GAP * usual)
    bad = np.flatnonzero(~valid)
    rate = 1.0 / usual
    text = f"{name}: {len(t)} rows, {t[0]:.2f} to {t[-1]:.2f} s, {rate:.4g} Hz"
    found = [Check(f"{name}_rate_hz", rate, text, True)]
    if len(back):
        text = f"{name}: {len(back)} rows repeat a time or go back and are left out, first row {back[0] + 2}"
        found.append(Check(f"{name}_unordered_rows", float(len(back)), text, False))
    if len(long):
        k = int(long[np.argmax(steps[long])])
        text = f"{name}: {len(long)} gaps, the longest {steps[k]:.3g} s before row {k + 2}, at {t[k]:.2f} s"
        found.append(Check(f"{name}_gaps", float(len(long)), text, False))
    if len(bad):
        text = f"{name}: {len(bad)} rows are flagged or hold no finite number, the first is row {bad[0] + 1}"
        found.append(Check(f"{name}_invalid_rows", float(len(bad)), text, False))
    return found


@dataclass(frozen=True, slots=True)
class _Motion:
    """Measurements of IMU and receiver in order of time."""

    t: FloatArray  # (N,) of the IMU [s]
    dt: FloatArray  # (N,) [s]
    gyro: FloatArray  # (N, 3) [rad/s], b
    accel: FloatArray  # (N, 3) [m/s^2], b
    fix_t: FloatArray  # (M,) [s]
    lla: FloatArray  # (M, 3)
    vel: FloatArray  # (M, 2) over ground [m/s], n

    @classmethod
    def from_records(cls, imu: ImuData, fixes: GnssFixes) -> _Motion:
        """Take the valid rows whose time increases."""
        keep, good = (_find_ordered(record.t, record.valid) for record in (imu, fixes))
        dt = imu.dt[keep, None]
        return cls(
            imu.t[keep],
            imu.dt[keep],
            imu.dtheta_b[keep] / dt,
            imu.dvel_b[keep] / dt,
            fixes.t[good],
            fixes.lla[good],
            fixes.vel_n[good, :2],
        )

    @property
    def speed(self) -> FloatArray:
        """Speed (M,) over ground [m/s]."""
        return np.asarray(np.hypot(self.vel[:, 0], self.vel[:, 1]))


def _find_ordered(t: FloatArray, valid: BoolArray) -> IntArray:
    """Return the valid rows with a time after those of all valid rows before."""
    rows = np.flatnonzero(valid)
    before = np.concatenate([[-np.inf], np.maximum.accumulate(t[rows])[:-1]])
    return rows[t[rows] > before]


def _check_rates(motion: _Motion) -> Check:
    """Check the largest angular rate."""
    most = float(np.abs(motion.gyro).max(initial=0.0))
    text = f"imu: largest angular rate {np.rad2deg(most):.4g} deg/s"
    good = most <= RATE_LIMIT
    if not good:
        text += ": are these deg/s in a column of rad/s?"
    return Check("gyro_max_deg_s", float(np.rad2deg(most)), text, good)


def find_standstills(fixes_t: FloatArray, speed: FloatArray) -> list[tuple[float, float]]:
    """Return start and end [s] of every standstill between fixes."""
    still = np.concatenate([[False], speed < STILL, [False]])
    edges = np.flatnonzero(still[1:] != still[:-1])
    spans = [(float(fixes_t[a]), float(fixes_t[b - 1])) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    return [(a, b) for a, b in spans if b - a >= STILL_AT_LEAST]


def _check_rest(motion: _Motion) -> list[Check]:
    """Check gravity and angular rate at standstill."""
    spans = find_standstills(motion.fix_t, motion.speed)
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
        guess = ""
        if abs(ratio * STANDARD_GRAVITY - 1.0) < GRAVITY_OFF:
            guess = ": are these g in a column of m/s^2?"
        elif abs(ratio / STANDARD_GRAVITY - 1.0) < GRAVITY_OFF:
            guess = ": are these m/s^2 in a column of g?"
        text += guess or ": the unit or the scale looks wrong"
    found = [Check("gravity_ratio", ratio, text, abs(ratio - 1.0) <= GRAVITY_OFF)]
    words = f"imu: at rest the up axis is {np.rad2deg(tilt):.1f} deg off the specific force"
    if tilt > TILT_OFF:
        words += ": mounting_deg does not make z point down"
    found.append(Check("rest_tilt_deg", float(np.rad2deg(tilt)), words, bool(tilt <= TILT_OFF)))
    bias = np.rad2deg(motion.gyro[rows].mean(axis=0))
    text = f"imu: angular rate at rest {', '.join(f'{b:.3f}' for b in bias)} deg/s"
    return [*found, Check("rest_rate_deg_s", float(np.linalg.norm(bias)), text, True)]


def _check_alignment(motion: _Motion, antenna_b: FloatArray) -> list[Check]:
    """Check clocks, units and axes with the motion that both IMU and receiver measured."""
    good = np.asarray(np.isfinite(motion.vel).all(axis=1))
    if good.sum() < _FEWEST:
        text = "gnss: no velocity; the clocks, turns and accelerations of IMU and receiver are not compared"
        return [Check("imu_shift_s", None, text, True)]
    t, speed = motion.fix_t[good], motion.speed[good]
    course = np.unwrap(np.arctan2(motion.vel[good, 1], motion.vel[good, 0]))
    level = motion.accel.mean(axis=0)
    down = -level / np.linalg.norm(level)
    usual = float(np.median(np.diff(t)))
    # central differences of neighbouring fixes, and of the integrals of the IMU over the same time
    middle = np.flatnonzero(
        (t[2:] - t[:-2] < 2.5 * usual) & (np.minimum.reduce([speed[2:], speed[1:-1], speed[:-2]]) > _MOVING)
    )
    if len(middle) < _FEWEST:
        text = "gnss: the vehicle hardly moves; clocks, turns and accelerations are not compared"
        return [Check("imu_shift_s", None, text, True)]
    rate = np.where(speed > _MOVING, np.gradient(course, t), 0.0)
    forward = np.array([1.0, 0.0, 0.0]) - down[0] * down
    ahead, right = antenna_b @ forward, antenna_b @ np.cross(down, forward)
    course = course - rate * ahead / np.maximum(speed, _MOVING)  # of the IMU: the antenna swings
    speed = speed + rate * right
    early, late = t[middle], t[middle + 2]
    span = late - early
    turn = (course[middle + 2] - course[middle]) / span
    gain_of_speed = (speed[middle + 2] - speed[middle]) / span
    found = _check_velocity(motion, good, middle)
    if np.sqrt(np.mean(turn**2)) > _TURNING:
        yaw = _integrate(motion.t, (motion.gyro @ down)[:, None])
        shift, sd, gain = _fit_shift(motion.t, yaw, early, late, turn[:, None])
        found.append(_check_clock(shift, sd, "turns"))
        text = f"imu: turn rate is {gain:.3f} of that of the course"
        if abs(gain - 1.0) > GAIN_OFF:
            guess = {57.3: "deg/s in a column of rad/s", 1 / 57.3: "rad/s in a column of deg/s"}
            near = [words for value, words in guess.items() if abs(abs(gain) / value - 1.0) < GAIN_OFF]
            likely = f"are these {near[0]}?" if near else "the unit, or the axes of the mounting, look wrong"
            text += f": {likely}"
        found.append(Check("turn_gain", gain, text, abs(gain - 1.0) <= GAIN_OFF))
    elif np.sqrt(np.mean(gain_of_speed**2)) > _SPEEDING:
        forward = _integrate(motion.t, motion.accel[:, :1] - level[:1])
        shift, sd, _ = _fit_shift(motion.t, forward, early, late, gain_of_speed[:, None])
        found.append(_check_clock(shift, sd, "accelerations"))
    else:
        text = "imu: too few turns and accelerations to compare its clock with the receiver's"
        found.append(Check("imu_shift_s", None, text, True))
    if np.sqrt(np.mean(gain_of_speed**2)) > _SPEEDING:
        seen = np.column_stack([gain_of_speed, 0.5 * (speed[middle + 2] + speed[middle]) * turn])
        found.append(_check_forward_axis(motion, level, early, late, seen))
    return found


def _integrate(t: FloatArray, rate: FloatArray) -> FloatArray:
    """Return the integral (N, k) of rates (N, k) that held over the intervals ending at t (N,)."""
    return np.asarray(np.cumsum(rate * np.diff(t, prepend=t[0])[:, None], axis=0))


def _mean_rate(t: FloatArray, integral: FloatArray, early: FloatArray, late: FloatArray) -> FloatArray:
    """Return the mean rates (M, k) between instants (M,) of integrals (N, k), less their average."""
    columns = [(np.interp(late, t, one) - np.interp(early, t, one)) / (late - early) for one in integral.T]
    rates = np.stack(columns, axis=-1)
    return np.asarray(rates - rates.mean(axis=0))


def _fit_shift(
    t: FloatArray, integral: FloatArray, early: FloatArray, late: FloatArray, seen: FloatArray
) -> tuple[float, float, float]:
    """Return the time to add to t that fits the reference rates [s], its standard deviation, and the gain.

    The shift maximizes the correlation between the mean rates of the integral from ``early`` to ``late`` and
    the reference ``seen``. Its standard deviation is that of a linear least squares fit with correlated
    residuals: neighbouring central differences share half their time.
    """
    shifts = np.arange(-_SEARCH, _SEARCH + 0.5 * _STEP, _STEP)
    inside = (early > t[0] + _SEARCH) & (late < t[-1] - _SEARCH)
    early, late, seen = early[inside], late[inside], seen[inside]
    if len(seen) < _FEWEST:
        return np.nan, np.nan, np.nan
    seen = seen - seen.mean(axis=0)

    def rate(shift: float) -> FloatArray:
        return _mean_rate(t, integral, early - shift, late - shift)

    scores = np.abs([np.vdot(own, seen) / np.linalg.norm(own) for own in map(rate, shifts)])
    k = int(np.clip(np.argmax(scores), 1, len(shifts) - 2))
    a, b, c = scores[k - 1 : k + 2]
    bend = a - 2 * b + c
    best = float(shifts[k] + (0.5 * _STEP * (a - c) / bend if bend < 0 else 0.0))
    own = rate(best)
    gain = float(np.vdot(own, seen) / np.vdot(seen, seen))
    slope = (rate(best - _STEP) - rate(best + _STEP)) / (2 * _STEP)
    pulls = np.sum(slope * (own - gain * seen), axis=1)
    return best, float(np.sqrt(_variance_of_sum(pulls)) / np.vdot(slope, slope)), gain


def _variance_of_sum(values: FloatArray) -> float:
    """Return the variance (above 0) of the sum of values that are correlated over a few rows."""
    products = [np.dot(values[lag:], values[:-lag]) for lag in range(1, min(_LAGS, len(values) - 1) + 1)]
    alone = float(np.dot(values, values))
    return max(alone + 2.0 * float(np.sum(products)), 0.01 * alone)


def _check_velocity(motion: _Motion, good: BoolArray, middle: IntArray) -> list[Check]:
    """Compare the velocity of the receiver with its positions: some receivers report velocity late."""
    t, origin = motion.fix_t[good], motion.lla[good][0]
    path, velocity = local_ned(motion.lla[good], origin)[:, :2], motion.vel[good]
    between = 0.5 * (velocity[1:] + velocity[:-1]) * np.diff(t)[:, None]
    travelled = np.concatenate([np.zeros((1, 2)), np.cumsum(between, axis=0)])
    early, late = t[middle], t[middle + 2]
    seen = (path[middle + 2] - path[middle]) / (late - early)[:, None]
    shift, sd, _ = _fit_shift(t, travelled, early, late, seen)
    text = f"gnss: its velocity fits its positions with {shift:+.3f} s added to its time (sd {sd:.3f} s)"
    bad = abs(shift) > max(SHIFT_OFF, _SIGMAS * sd)
    if bad:
        text += f": add {shift:+.3f} to [gnss] velocity_offset_s"
    return [Check("velocity_shift_s", shift if np.isfinite(shift) else None, text, not bad)]


def _check_clock(shift: float, sd: float, by: str) -> Check:
    """Check the time shift between IMU and receiver."""
    good = not (abs(shift) > max(SHIFT_OFF, _SIGMAS * sd))
    text = f"imu: its clock fits the receiver's by {by} with {shift:+.3f} s added (sd {sd:.3f} s)"
    if not good:
        text += f": add {shift:+.3f} to [imu] time_offset_s"
    return Check("imu_shift_s", shift if np.isfinite(shift) else None, text, good)


def _check_forward_axis(
    motion: _Motion, level: FloatArray, early: FloatArray, late: FloatArray, seen: FloatArray
) -> Check:
    """Compare the direction of the specific force with the accelerations of the receiver.

    ``seen`` (M, 2): acceleration along and across the track [m/s^2].
    """
    speeds = _integrate(motion.t, motion.accel[:, :2] - level[:2])
    own = _mean_rate(motion.t, speeds, early, late)
    gains = np.linalg.lstsq(seen - seen.mean(axis=0), own, rcond=None)[0][0]
    angle = float(np.arctan2(gains[1], gains[0]))
    text = f"imu: accelerations along the track point {np.rad2deg(angle):+.1f} deg right of the forward axis"
    good = abs(angle) <= YAW_OFF
    if not good:
        text += ": mounting_deg does not make x point forward"
    return Check("forward_yaw_deg", float(np.rad2deg(angle)), text, good)
