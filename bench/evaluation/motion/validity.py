"""Plausibility checks of a recording: order of times, gaps, units, axes, clocks of IMU and receiver.

Each check reports what it measured and whether that is plausible. Nothing is repaired. The checks use the
motion itself: gravity at standstill (here), and what both IMU and receiver measured on the move, in a car or
in the air (`bench.evaluation.motion.motion_checks`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray, find_later
from bench.core.mathematics.earth import gravity_n
from bench.core.mathematics.units import DEG, STANDARD_GRAVITY
from bench.core.records.data import GnssFixes, ImuData
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.core.words.wording import format_number
from bench.evaluation.motion.axis_search import AS_GIVEN
from bench.evaluation.motion.fix_reach import find_reachable
from bench.evaluation.motion.motion_checks import GRAVITY_OFF, SIGMAS, check_motion, guess_force_unit
from bench.evaluation.motion.recorded_motion import Check, RecordedMotion
from bench.evaluation.motion.velocity_checks import GAIN_OFF, check_velocity

TILT_OFF = np.deg2rad(20.0)
"""Allowed angle from the up axis to the specific force at rest [rad]: steeper than any parking place."""
RATE_LIMIT = np.deg2rad(4000.0)
"""Angular rate beyond the range of usual gyros [rad/s]."""
_FORCE_LIMIT = 100.0 * STANDARD_GRAVITY  # the same of accelerometers [m/s^2]
_BEYOND, _FEWEST_BEYOND = 1.01, 5  # part of a range, and samples beyond it, that show another IMU
_LEAST_CLIMB = 20.0  # standard deviation of the heights from which a barometer is compared [m]
_WANDER = 60.0  # errors of heights further apart than this count as independent [s]
_GAP = 3.0  # a longer interval is a gap, in usual intervals
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
    checks = check_times("imu", imu.t, imu.valid)
    checks += check_times("gnss", fixes.t, fixes.valid) if len(fixes) else []
    for name, record in instruments.items():
        checks += check_times(name, record.t, record.valid)
    with np.errstate(all="ignore"):  # figures may overflow; what is not finite is reported as it is
        motion = RecordedMotion.from_records(imu, fixes)
        if not len(fixes):
            return [*checks, check_rates(motion)]
        velocity, motion = check_velocity(motion)
        fitted, axes = list[Check](), AS_GIVEN
        if not any(one.name.startswith("velocity_ratio") for one in velocity):
            fitted, axes = check_motion(motion, np.asarray(antenna_b))
        rest = check_rest(replace(motion, accel=motion.accel @ axes.accel.T))
        checks += keep_causes([check_rates(motion), *rest, *velocity, *fitted])
        checks += check_reach(imu, fixes) if all(one.good for one in (*velocity, *fitted)) else []
        if "baro" in instruments:
            checks += check_heights("baro", motion, instruments["baro"])
        return checks


_SAME_CAUSE = {"turn_gain": "gyro_max_deg_s", "gravity_ratio": "force_gain"}


def keep_causes(checks: list[Check]) -> list[Check]:
    """Return the checks without a second line on a unit that another line names."""
    wrong = {one.name for one in checks if not one.good}
    frames = [one for one in checks if "gnss.velocity" in one.advice]
    if len(frames) == 2 and np.array_equal(
        frames[0].advice["gnss.velocity"], frames[1].advice["gnss.velocity"]
    ):
        return [one for one in checks if one not in frames]  # each takes back the other
    twice = {other for name, other in _SAME_CAUSE.items() if {name, other} <= wrong}
    return [one for one in checks if one.name not in twice]


def check_times(name: str, t: FloatArray, valid: BoolArray) -> list[Check]:
    """Check the times of a record; messages count rows from 1."""
    steps = np.diff(t)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else np.nan
    back = np.flatnonzero(~find_later(t))
    long = np.flatnonzero(steps > _GAP * usual)
    bad = np.flatnonzero(~valid)
    rate = 1.0 / usual
    text = f"{name}: {len(t)} rows, {t[0]:.2f} to {t[-1]:.2f} s, {rate:.4g} Hz"
    found = [Check(f"{name}_rate_hz", rate, text, True)]
    if len(back):
        many = f"{len(back)} of {len(t)} rows"
        text = f"{name}: {many} repeat a time or go back and are left out, first row {back[0] + 1}"
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


def assume_range(spec: ImuSpec, imu: ImuData) -> tuple[ImuSpec, Check | None]:
    """Return a datasheet without a range that the record exceeds, and a check with a message if it does.

    A range ends what an IMU can read, so a record with larger values is of another IMU. A few such values
    may be damaged, and do not count.
    """
    told, triads = [], dict[str, TriadSpec]()
    for name, increments, most, unit, factor in (
        ("gyro", imu.dtheta_b, RATE_LIMIT, "deg/s", DEG),
        ("accel", imu.dvel_b, _FORCE_LIMIT, "g", STANDARD_GRAVITY),
    ):
        triad: TriadSpec = getattr(spec, name)
        count, largest = 0, 0.0
        for rows in disk_arrays.blocks(len(imu.t)) if triad.range else ():
            dt = np.where(imu.valid[rows], imu.dt[rows], np.inf)
            sizes = np.abs(increments[rows]).max(axis=1) / dt
            beyond = sizes[(sizes > _BEYOND * triad.range) & (sizes < most)]
            count, largest = count + len(beyond), max(largest, float(beyond.max(initial=0.0)) / factor)
        if count >= _FEWEST_BEYOND:
            triads[name], end = replace(triad, range=0.0), triad.range / factor
            told.append(f"{name} up to {largest:.4g} {unit}, beyond the {end:.4g} {unit} of the datasheet")
    if not told:
        return spec, None
    unused = "which is not used" if len(told) == 1 else "which are not used"
    text = f"imu: not the assumed {spec.name}: {', '.join(told)}, {unused}; "
    spec = replace(spec, gyro=triads.get("gyro", spec.gyro), accel=triads.get("accel", spec.accel))
    return spec, Check("imu_range", None, f"{text}name your IMU in [sensors.assumed]", False)


def check_rest(motion: RecordedMotion) -> list[Check]:
    """Check gravity and angular rate at standstill."""
    spans = motion.find_standstills()
    rows = np.zeros(len(motion.t), np.bool_)
    for a, b in spans:
        rows |= (motion.t > a + 0.5) & (motion.t < b - 0.5)
    if not rows.any():
        text = "imu: the receiver shows no standstill; gravity and gyro bias are not checked"
        return [Check("gravity_ratio", None, text, True)]
    force = motion.accel[rows].mean(axis=0)
    size = float(np.linalg.norm(force))
    lat, _, alt = np.nanmean(motion.lla, axis=0)
    ratio = size / float(np.linalg.norm(gravity_n(lat, alt)))
    tilt = float(np.arccos(np.clip(-force[2] / size, -1.0, 1.0))) if size > 0 else np.nan
    seconds = sum(b - a for a, b in spans)
    text = f"imu: specific force at rest ({seconds:.0f} s) is {size:.4g} m/s^2, {ratio:.4f} of gravity"
    heaved = sum(_find_heave(motion, a, b) for a, b in spans) / (seconds * STANDARD_GRAVITY)
    bad = abs(ratio - 1.0) > GRAVITY_OFF + heaved
    if bad:
        text += guess_force_unit(ratio)
    found = [Check("gravity_ratio", ratio, text, not bad, {"imu.accel_gain": ratio} if bad else {})]
    words = f"imu: at rest the up axis is {np.rad2deg(tilt):.1f} deg off the specific force"
    if tilt > TILT_OFF:
        words += ": change mounting_deg so that z points down"
    found.append(Check("rest_tilt_deg", float(np.rad2deg(tilt)), words, bool(tilt <= TILT_OFF)))
    bias = np.rad2deg(motion.gyro[rows].mean(axis=0))
    text = f"imu: angular rate at rest {', '.join(f'{b:.3f}' for b in bias)} deg/s"
    return [*found, Check("rest_rate_deg_s", float(np.linalg.norm(bias)), text, True)]


def _find_heave(motion: RecordedMotion, begin: float, end: float) -> float:
    """Return the range of the vertical velocity in a standstill [m/s]: a boat at its mooring heaves."""
    down = motion.vel_n[(motion.fix_t >= begin) & (motion.fix_t <= end), 2]
    return float(np.ptp(down[np.isfinite(down)])) if np.isfinite(down).any() else 0.0


def describe_accuracy(fixes: GnssFixes, reported: str) -> Check:
    """Return a check that always passes, with a message on the weights of the fixes."""
    sd = np.sqrt(np.einsum("mii->mi", fixes.cov_pos_n[fixes.valid])[:, :2].mean(axis=1))
    low, median, high = np.nanquantile(sd, [0.0, 0.5, 1.0])
    spread = f"{low:.3g} to {high:.3g} m horizontally, median {median:.3g} m"
    if high - low < 1e-3 * high:
        spread = f"{median:.3g} m horizontally, the same for all"
    text = (
        f"each fix is weighted by the {reported} it came with: {spread}; "
        "option fix_accuracy = 'datasheet' weights all alike"
    )
    return Check("fix_accuracy_m", float(median), text, True)


def describe_offset(sd: float) -> Check:
    """Return a check that always passes, with a message on the clock of fixes, estimated from ``sd`` [s]."""
    text = (
        f"gnss: filters estimate the clock offset of its fixes, sigma {sd:g} s at the start; "
        "time_offset_s in [imu] or [gnss] fixes the offset"
    )
    return Check("time_offset_sd_s", sd, text, True)


def check_reach(imu: ImuData, fixes: GnssFixes) -> list[Check]:
    """Check for fixes to which the IMU does not lead; they evaluate no filter."""
    wrong = np.flatnonzero(~find_reachable(imu, fixes))
    if not len(wrong):
        return []
    many = f"{len(wrong)} of {len(fixes.t)} fixes do" if len(wrong) > 1 else f"1 of {len(fixes.t)} fixes does"
    text = f"gnss: {many} not agree with the motion of the IMU, the first at {fixes.t[wrong[0]]:.2f} s"
    return [Check("gnss_unreachable_fixes", float(len(wrong)), f"{text}: not used for the evaluation", False)]


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
