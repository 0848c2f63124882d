"""Find fixes that the motion of the IMU does not allow, so that they evaluate no filter.

Between two fixes the gyros and accelerometers give the size of the gained velocity without an attitude, and
the receiver gives the same size from its velocities and gravity. A receiver's glitch of tens of meters per
second differs from it by far more than biases, noise and late velocities do.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.earth import difference_n
from bench.core.records.data import GnssFixes, ImuData
from bench.evaluation.motion.motion_fit import NAMES, Stretches, find_stretches, integrate
from bench.evaluation.motion.recorded_motion import RecordedMotion, find_ordered

_SIGMAS = 5.0
_SPEED_OFF, _FORCE_OFF = 1.0, 0.7  # allowed beyond the noise: late velocities [m/s], biases [m/s^2]
_HARDEST = 5.0  # half the acceleration within which positions follow velocities between fixes [m/s^2]
_LONGEST = 10.0  # after which a fix counts again whatever came before [s]
_STARTS = 5  # fixes of a segment that may be the first sound one
_AT_ONCE = 20  # segments, which bounds the memory
_MOST = 0.2  # share of the fixes beyond which units, axes or clocks are wrong, and not the fixes
_NOISE = 0.1, 1.0  # least noise of a receiver's velocity [m/s] and position [m]


def find_reachable(imu: ImuData, fixes: GnssFixes) -> BoolArray:
    """Return whether each fix (M,) agrees with the motion since the sound fix before it.

    Fixes without a velocity, or where the IMU is silent, are not tested: they count as sound. So do all if a
    large share of them disagrees.
    """
    motion = RecordedMotion.from_records(imu, fixes)
    sound = np.ones(len(fixes), np.bool_)
    if not np.isfinite(motion.vel_n).all(axis=1).any():
        return sound
    rows = find_ordered(fixes.t, fixes.valid & np.isfinite(fixes.vel_n).all(axis=1))
    every = find_stretches(
        motion.t, fixes.t[rows], fixes.lla[rows], fixes.vel_n[rows], most=max(len(rows), 1)
    )
    for first in range(0, len(every), _AT_ONCE):
        part = every.take(np.arange(first, min(first + _AT_ONCE, len(every))))
        _test_stretches(part, motion, fixes, rows, sound)
    return sound if (~sound).mean() < _MOST else np.ones_like(sound)


def _test_stretches(
    stretches: Stretches, motion: RecordedMotion, fixes: GnssFixes, rows: IntArray, sound: BoolArray
) -> None:
    """Set ``sound`` (M,) for the fixes of some segments; ``rows`` are the rows of all tested fixes."""
    near = stretches.find_near(motion.t)
    u = integrate(stretches, motion.t[near], motion.gyro[near], motion.accel[near], np.zeros(len(NAMES)))[0]
    at = rows[np.searchsorted(fixes.t[rows], stretches.fix_t)]
    sd_vel, sd_pos = (
        np.maximum(np.sqrt(np.einsum("mii->mi", cov)[at].max(axis=1)), least)
        for cov, least in zip((fixes.cov_vel_n, fixes.cov_pos_n), _NOISE, strict=True)
    )

    def agree(last: int, k: int) -> bool:
        span = float(stretches.fix_t[k] - stretches.fix_t[last])
        gained = np.linalg.norm(stretches.gained[k] - stretches.gained[last])
        off = abs(float(gained - np.linalg.norm(u[k] - u[last])))
        limit = _SPEED_OFF + _FORCE_OFF * span + _SIGMAS * float(np.hypot(sd_vel[k], sd_vel[last]))
        ahead = _find_lead(fixes, int(at[last]), int(at[k]))
        far = _HARDEST * span**2 + _SIGMAS * float(np.hypot(sd_pos[k], sd_pos[last]))
        return (off <= limit and ahead <= far) or span > _LONGEST

    for cluster in stretches.slices:
        best = _chain(range(cluster.start, cluster.stop), 0, agree)
        for start in range(1, _STARTS):  # the first fixes may be the glitch
            if all(best):
                break
            best = max(best, _chain(range(cluster.start, cluster.stop), start, agree), key=sum)
        sound[at[cluster]] = best


def _chain(rows: range, start: int, agree: Callable[[int, int], bool]) -> list[bool]:
    """Return which rows agree with the last sound row before them, if ``start`` is the first sound row."""
    found, last = [False] * start + [True], rows[start]
    for k in rows[start + 1 :]:
        found.append(agree(last, k))
        last = k if found[-1] else last
    return found


def _find_lead(fixes: GnssFixes, early: int, late: int) -> float:
    """Return how far the position of a fix is from that which both velocities lead to, horizontally [m]."""
    span = fixes.t[late] - fixes.t[early]
    moved: FloatArray = difference_n(fixes.lla[late], fixes.lla[early])
    off = moved - 0.5 * span * (fixes.vel_n[early] + fixes.vel_n[late])
    return float(np.hypot(off[0], off[1]))
