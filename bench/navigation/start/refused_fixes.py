"""Fixes that are rejected for long although they agree with each other, so the filter has diverged.

The gate re-admits rejected fixes after a while (`engine.gate`) and opens position and velocity for it.
Where the attitude is lost that is no help: the filter drifts off again, and rejects the next. What tells a
lost filter from a receiver that errs are the fixes alone. Those of a frozen receiver, of one whose position
is pulled away and of one in a burst of noise move otherwise than their velocities (`velocity_consistency`).
Whoever spoofs position and velocity alike passes, as at the gate, if the first of such fixes did not jump: a
filter drifts away from the fixes, it does not jump off (`gate.jumps_kernel`).
"""

from __future__ import annotations

import math

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssFixes, Innovations
from bench.core.records.sensor_specs import GnssSpec
from bench.navigation.engine.gate import jumps_kernel
from bench.navigation.engine.integrity import nis_limit
from bench.navigation.engine.kept_rows import join_rows
from bench.navigation.engine.session import Kept, Replaced, SessionState
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.engine.velocity_consistency import WINDOWS, MovedFixes
from bench.navigation.error_state_filter.aiding_sensors import fix_variance, weigh_fixes
from bench.navigation.error_state_filter.measurement_rows import POSITION, SENSORS, VELOCITY
from bench.navigation.options import FixAccuracy

SHARE = 0.75
"""Part of the time of a window in which positions are rejected."""
_FEWEST = 10  # fixes in a window; none stands for more than a tenth of its time
_AFTER_JUMP = 3.0  # windows after fixes jumped in which no filter counts as lost
_FALSE_ALARM = 1e-5  # chance that a sound fix counts as one that does not agree


class RefusedFixes(SessionState):
    """Detector of a filter that has rejected sound fixes for long, from its innovations and the fixes.

    A window is twice as long as ``readmit_after_s`` of its gate [s], and no shorter than the fixes are
    compared over.
    """

    _fixes: Replaced[GnssFixes | None]  # of the last window
    _t: Replaced[FloatArray]  # (K,) epochs of its verdicts on positions [s]
    _stood: Replaced[FloatArray]  # (K,) time that each of them stands for [s]
    _refused: Replaced[BoolArray]  # (K,)
    _begun: Kept[float]  # first verdict [s]
    _next: Kept[float]  # before it the fixes are not looked at again [s]
    _used: Kept[float]  # last fix that was used; -inf: it was rejected, or there was none [s]

    def __init__(self, gnss: GnssSpec, accuracy: FixAccuracy, readmit_after_s: float) -> None:
        self._gnss, self._accuracy = gnss, accuracy
        self.window = 2.0 * max(readmit_after_s, WINDOWS[0])
        self.forget()

    def forget(self) -> None:
        """Start again, for another filter."""
        self._fixes = None
        self._t, self._stood, self._refused = np.empty(0), np.empty(0), np.empty(0, np.bool_)
        self._begun, self._next, self._used = np.inf, -np.inf, -np.inf

    def take(self, fixes: GnssFixes) -> None:
        """Take the next sound fixes, in the order of their arrival."""
        if self._fixes is None or not len(self._fixes):
            self._fixes = fixes
        elif len(fixes):
            self._fixes = join_rows(self._fixes, fixes)

    @property
    def any_refused(self) -> bool:
        """Return whether a position of the last window was rejected."""
        return bool(self._refused.any())

    def find(self, table: Innovations, heading_lost_at: float | None = None) -> tuple[float, bool] | None:
        """Return the first epoch [s] at which the filter has diverged, by its next innovations.

        Also whether it has rejected positions for long; if not, it has lost its heading alone.
        ``heading_lost_at`` is the time from which the vehicle has moved without a heading [s], or None. From
        then on the filter has diverged as soon as the fixes of a window agree with their velocities, whether
        rejected or not; a quarter of the window passes between two tests.
        """
        if not len(table):
            return None
        code = table.sensor.index(SENSORS[POSITION]) if SENSORS[POSITION] in table.sensor else -1
        rows = np.flatnonzero((table.code == code) & (table.component == 0))
        if not len(rows):
            return None
        jumps, before = self._list_jumps(table, rows), len(self._t)
        t = np.concatenate([self._t, table.t[rows]])
        apart = np.diff(t[before:], prepend=t[max(before - 1, 0)])
        stood = np.concatenate([self._stood, np.clip(apart, 0.0, self.window / _FEWEST)])
        refused = np.concatenate([self._refused, ~table.accepted[rows]])
        self._begun = min(self._begun, float(t[0]))
        rejected = np.zeros(len(t), np.bool_)
        if refused[before:].any():
            first = np.searchsorted(t, t - self.window, side="right")
            sums, k = np.concatenate([[0.0], np.cumsum(stood * refused)]), np.arange(len(t))
            rejected = sums[k + 1] - sums[first] >= SHARE * self.window - TIME_TOLERANCE
            rejected &= refused & (k + 1 - first >= _FEWEST) & (k >= before)
            rejected &= t >= self._begun + self.window
        due = rejected.copy()
        if heading_lost_at is not None:
            steps = np.floor((t - heading_lost_at + TIME_TOLERANCE) / (0.25 * self.window))
            due[before:] |= (np.diff(steps, prepend=-1.0)[before:] > 0) & (steps[before:] >= 0)
        for now, long in zip(t[due].tolist(), rejected[due].tolist(), strict=True):
            while jumps and jumps[0] <= now:
                self._next = jumps.pop(0) + _AFTER_JUMP * self.window
            if now < self._next:
                continue
            if self._agree(now):
                return now, long
            self._next = now + 0.25 * self.window
        if jumps:
            self._next = jumps[-1] + _AFTER_JUMP * self.window
        kept = t > t[-1] - self.window
        self._t, self._stood, self._refused = t[kept], stood[kept], refused[kept]
        if self._fixes is not None:
            self._fixes = self._fixes.take(self._fixes.t_arrival > t[-1] - self.window)
        return None

    def _list_jumps(self, table: Innovations, rows: IntArray) -> list[float]:
        """Return the times of jumps among the positions at ``rows`` of the innovations and their velocities.

        After a jump the next test waits.
        """
        limit, size = nis_limit(3, _FALSE_ALARM), len(table)
        found = []
        for k in rows.tolist():
            now, v = float(table.t[k]), k + 3
            paired = v + 2 < size and table.t[v] == now and table.sensor[table.code[v]] == SENSORS[VELOCITY]
            used = table.accepted[k] and (not paired or table.accepted[v])
            if paired and not used and np.isfinite(self._used):
                off, speed = math.hypot(*table.z[k : k + 3]), math.hypot(*table.z[v : v + 3])
                if jumps_kernel(now - self._used, table.nis[k], table.nis[v], off, speed, limit):
                    found.append(now)
            self._used = now if used else -np.inf
        return found

    def last(self, t: float) -> GnssFixes:
        """Return the last fix that had arrived at a time [s]."""
        assert self._fixes is not None
        (rows,) = np.nonzero(self._fixes.t_arrival <= t + TIME_TOLERANCE)
        return self._fixes.take(rows[-1:])

    def _agree(self, now: float) -> bool:
        """Return whether all fixes of a window until a time [s] moved consistently with their velocities."""
        assert self._fixes is not None
        arrival = self._fixes.t_arrival
        inside = (arrival > now - self.window) & (arrival <= now + TIME_TOLERANCE)
        fixes = self._fixes.take(inside)
        if len(fixes) < _FEWEST or not np.isfinite(fixes.vel_n).all():
            return False
        variance = weigh_fixes(fixes, self._gnss, fix_variance(self._gnss, gnss_markov=True), self._accuracy)
        moved, _ = MovedFixes(self._gnss, _FALSE_ALARM).take(fixes, variance, last=True)
        return not moved.any()
