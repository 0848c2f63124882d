"""Find fixes that pass every test of their epoch and cannot be true.

Four ranges always agree with some position. While a receiver starts or is jammed, such positions are
kilometers off with a small reported sigma; the rest of the record shows it.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes
from bench.simulation.signals.receiver_solution import ReceiverSolution

_LOWEST, _HIGHEST = -1e3, 1e5  # heights between which a receiver is [m]; assumed
_FASTEST = 2.0  # speed over that of the tested fixes, in 99 of 100, which is too fast; assumed
_LEAST_SPEED = 10.0  # limit of a record at rest [m/s]; assumed
_ANY_SPEED = 515.0  # of a record without a tested fix [m/s]: 1000 knots, limit of exported receivers
_SIGMAS = 5.0  # of its reported sigma by which a fix may be farther away
_NEAR = 60.0  # a tested fix so near in time confirms others; or ten epochs of slow data [s]; assumed
_MOST_LOST = (
    0.5  # part of the epochs without a fix above which fixes without a test are not believed; assumed
)

_HEIGHT = f"an implausible height, below {_LOWEST / 1e3:g} km or above {_HIGHEST / 1e3:g} km"
_SPEED = "an implausible motion: faster than the fixes that a spare satellite tests"
_ALONE = "no satellite to spare that would test the fix, and no tested fix near in time"


def find_implausible(solution: ReceiverSolution) -> tuple[list[str], IntArray]:
    """Return reasons, and which of them (M,) each valid fix that cannot be true has; -1: it can."""
    fixes, spare = solution.fixes, count_spare(solution)
    valid, speed = fixes.valid, np.linalg.norm(fixes.vel_n, axis=1)
    found = np.full(len(valid), -1)
    found[valid & ~((fixes.lla[:, 2] > _LOWEST) & (fixes.lla[:, 2] < _HIGHEST))] = 0
    rest = valid & (found < 0)
    tested = rest & (spare >= (2 if (rest & (spare >= 2)).any() else 1))
    if not tested.any():
        found[rest & (speed > _ANY_SPEED)] = 1
        if valid.mean() < 1 - _MOST_LOST:
            found[valid & (found < 0)] = 2
        return [_HEIGHT, _SPEED, _ALONE], found
    limit = max(_FASTEST * _find_speed(fixes, tested, speed), _LEAST_SPEED)
    far, gap = _reach(fixes, tested, limit)
    typical = float(np.nanmedian(np.diff(fixes.t))) if len(fixes.t) > 1 else 0.0
    other = rest & ~tested
    found[other & ((speed > limit) | far)] = 1
    found[other & (found < 0) & (spare <= 0) & (gap > max(_NEAR, 10 * typical))] = 2
    return [_HEIGHT, _SPEED, _ALONE], found


def count_spare(solution: ReceiverSolution) -> IntArray:
    """Return how many satellites (M,) the fixes have beyond a position and a clock for each system."""
    clocks = np.isfinite(solution.clock).sum(axis=1)
    return np.asarray(solution.fixes.satellites - 3 - np.maximum(clocks, 1))


def _find_speed(fixes: GnssFixes, tested: BoolArray, speed: FloatArray) -> float:
    """Return the speed that 99 of 100 tested fixes do not exceed [m/s], by Doppler or distance."""
    known = speed[tested & np.isfinite(speed)]
    if not len(known) and tested.sum() > 1:
        step = np.linalg.norm(np.diff(earth.to_ecef(fixes.lla[tested]), axis=0), axis=1)
        known = step / np.diff(fixes.t[tested])
    return float(np.percentile(known, 99)) if len(known) else 0.0


def _reach(fixes: GnssFixes, tested: BoolArray, limit: float) -> tuple[BoolArray, FloatArray]:
    """Return which fixes (M,) are beyond reach of the tested ones next to them, and the time to these [s]."""
    at, t, pos_e = np.flatnonzero(tested), fixes.t, earth.to_ecef(fixes.lla)
    sigma = np.sqrt(np.trace(fixes.cov_pos_n, axis1=1, axis2=2))
    after = np.searchsorted(t[at], t).clip(0, len(at) - 1)
    far, gap = np.zeros(len(t), bool), np.full(len(t), np.inf)
    for place in (at[after], at[(after - 1).clip(0)]):
        apart = np.abs(t - t[place])
        distance = np.linalg.norm(pos_e - pos_e[place], axis=1)
        far |= distance > limit * apart + _SIGMAS * (sigma + sigma[place])
        gap = np.fmin(gap, apart)
    return far, gap
