"""Report a position of a receiver that disagrees with its velocities.

The displacement from an earlier fix, less the integral of the velocities in between, is tested against its
variance, which follows from the white and Markov errors of both positions and of the velocities. The earlier
fix is the median of the last few fixes that passed, and of the first few within each of `WINDOWS`. A fix that
failed is not compared with, so a ramp is reported until it ends. Within the first window the median of all
fixes so far is taken. Only earlier fixes decide about a fix.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.records.data import EventRow, GnssFixes
from bench.core.records.sensor_specs import GnssSpec
from bench.navigation.engine.integrity import nis_limit
from bench.navigation.engine.session import Kept, SessionState

WINDOWS = (10.0, 30.0, 100.0)
"""Times over which positions are compared with velocities [s]; a slow ramp shows over a long one."""
_NEAR = 5  # fixes whose median stands for one, so that a bad one that passed does no harm
_FEWEST = 3  # fixes of which the median is not that of a bad one
_STEPS = 9  # between fixes whose median is the usual one
_GAP = 2.5  # usual steps, from which on the test begins anew
_JERK = 10.0  # [m/s^3]: what the sum of velocities a step apart leaves out

# a fix by what is carried from the begin to it: [s], way left over [m] e, variance of an end [m^2] n, sum of
# velocity variances [m^2] n, path [m]
_T, _REST, _END, _SUMMED, _PATH = 0, slice(1, 4), slice(4, 7), slice(7, 10), 10


class MovedFixes(SessionState):
    """Tests the positions of fixes, one after another, against the velocities of the same receiver.

    ``false_alarm`` is the probability that a sound fix is reported.
    """

    _begin: Kept[FloatArray]  # (3,) of the first fix [m], e; none before it
    _C_en: Kept[FloatArray]  # (3, 3) there
    _before: Kept[FloatArray]  # (11,) the fix before
    _vel_e: Kept[FloatArray]  # (3,) of it [m/s], e
    _change: Kept[FloatArray]  # (3,) of the velocity to it [m/s], e
    _sum_e: Kept[FloatArray]  # (3,) of the velocities from the begin to it [m], e
    _steps: Kept[FloatArray]  # the last of them [s]
    _measures: Kept[FloatArray]  # (F, 11) fixes to compare with
    _passed: Kept[bool]  # the first window; the measures are fixes that passed
    _told: Kept[tuple[float, float, int] | None]  # first, last [s] and number of those in a row

    def __init__(self, gnss: GnssSpec, false_alarm: float) -> None:
        self._limit = nis_limit(3, false_alarm / (len(WINDOWS) + 1))
        self._slow, self._vel_var = gnss.vel_decay_time, gnss.vel_markov_sd**2
        self._decay, self._decay_by_way = gnss.pos_decay_time, gnss.pos_decay_distance
        self._markov = np.square([gnss.pos_h_markov_sd, gnss.pos_h_markov_sd, gnss.pos_v_markov_sd])
        self._jump = np.square([gnss.pos_h_jump_sd, gnss.pos_h_jump_sd, gnss.pos_v_jump_sd])
        self._begin = self._steps = np.empty(0)
        self._C_en = np.empty((0, 3))
        self._before, self._measures = np.zeros(11), np.empty((0, 11))
        self._vel_e = self._change = self._sum_e = np.zeros(3)
        self._passed, self._told = False, None

    def take(self, fixes: GnssFixes, variance: FloatArray, *, last: bool) -> tuple[BoolArray, list[EventRow]]:
        """Return which positions (M,) of the next fixes disagree with the velocities, and the events.

        Fixes without velocity pass; the test begins anew after a gap. The white variances (M, 6) are those of
        position [m^2] and velocity [m^2/s^2], n; nothing comes after the ``last``.
        """
        moved, events = np.zeros(len(fixes), np.bool_), list[EventRow]()
        whole = fixes.valid & np.isfinite(np.hstack([fixes.lla, fixes.vel_n])).all(axis=1)
        for k, t in enumerate(fixes.t.tolist()):
            if whole[k]:
                moved[k] = self._moved(t, fixes.lla[k], fixes.vel_n[k], variance[k])
            if moved[k]:
                first, _, count = self._told or (t, t, 0)
                self._told = first, t, count + 1
            else:
                events += self._end_row()
        return moved, events + (self._end_row() if last else [])

    def _end_row(self) -> list[EventRow]:
        if self._told is None:
            return []
        (first, end, count), self._told = self._told, None
        words = "positions disagree with the velocities of the receiver"
        return [(first, end, "integrity", f"{count} {words}", "gnss_position")]

    def _moved(self, t: float, lla: FloatArray, vel_n: FloatArray, variance: FloatArray) -> bool:
        """Return whether the position of the next fix disagrees with the velocities."""
        C_en, dt = matrix_en(lla[0], lla[1]), t - float(self._before[_T])
        vel_e = C_en @ vel_n
        known = len(self._begin) > 0
        usual = float(np.median(self._steps)) if len(self._steps) else dt
        if known:
            self._steps = np.append(self._steps, dt)[-_STEPS:]
        fix = np.zeros(11)
        fix[_T], fix[_END] = t, variance[:3] + self._jump
        change = np.zeros(3)
        if not known or dt > _GAP * usual:
            self._begin, self._C_en = to_ecef(lla), C_en
            self._measures, self._passed = np.empty((0, 11)), False
            self._sum_e = np.zeros(3)
        else:
            change = vel_e - self._vel_e
            self._sum_e = self._sum_e + 0.5 * (vel_e + self._vel_e) * dt
            # position less the sum of velocities, by Euler and Maclaurin
            rest_e = to_ecef(lla) - self._begin + change * dt / 12.0 - self._sum_e
            fix[_REST] = self._C_en.T @ rest_e
            left = _JERK * dt**3 / 24.0 + np.linalg.norm(change - self._change) * dt / 6.0
            fix[_END] += left**2
            fix[_SUMMED] = self._before[_SUMMED] + variance[3:] * dt**2
            speeds = np.linalg.norm(vel_e) + np.linalg.norm(self._vel_e)
            fix[_PATH] = self._before[_PATH] + 0.5 * speeds * dt
        self._before, self._vel_e, self._change = fix, vel_e, change
        return self._compare(fix)

    def _compare(self, fix: FloatArray) -> bool:
        """Return whether a fix disagrees with earlier fixes; if not, later fixes are compared with it."""
        if not self._passed:
            if not len(self._measures) or fix[_T] < self._measures[0, _T] + WINDOWS[0]:
                self._measures = np.vstack([self._measures, fix])
                return len(self._measures) >= _FEWEST and not self._fits(fix, self._measures)
            good = [one for one in self._measures if self._fits(one, self._measures)]
            self._measures = np.array(good or self._measures[:1])
            self._passed = True
        begins = np.searchsorted(self._measures[:, _T], fix[_T] - np.array(WINDOWS))
        newest = max(len(self._measures) - _NEAR, 0)
        for begin in {min(int(b), newest) for b in (*begins, newest)}:
            if not self._fits(fix, self._measures[begin : begin + _NEAR]):
                return True
        self._measures = np.vstack([self._measures[min(int(begins[-1]), newest) :], fix])
        return False

    def _fits(self, fix: FloatArray, some: FloatArray) -> bool:
        """Return whether the displacement from the median of some fixes agrees with the velocities."""
        one = some[len(some) // 2]
        T = abs(float(fix[_T] - one[_T]))
        slow = self._slow
        wander = T * T if slow * T < 1e-3 else 2.0 * (slow * T - 1.0 + np.exp(-slow * T)) / slow**2
        decay = self._decay * T + self._decay_by_way * abs(float(fix[_PATH] - one[_PATH]))
        var = fix[_END] + one[_END] + 2.0 * self._markov * -np.expm1(-decay)
        var += np.abs(fix[_SUMMED] - one[_SUMMED]) + self._vel_var * wander
        apart = fix[_REST] - np.median(some[:, _REST], axis=0)
        return bool(np.sum(np.square(apart) / var) <= self._limit)
