"""Position and velocity from GNSS fixes alone, propagated by a maneuver model.

The model, and the filter as a kernel: `singer`. Attitude is not estimated: in wind the
course is not the heading. The filter runs at the times of validity of the fixes, so latency only lengthens
the prediction to the output.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import (
    EventRow,
    Events,
    GnssFixes,
    InitialState,
    NavSolution,
    SensorData,
    no_innovations,
)
from bench.core.records.sensor_specs import AssumedSpecs
from bench.navigation.engine import timeline
from bench.navigation.engine.earthbound import Earthbound
from bench.navigation.engine.kept_rows import join_rows
from bench.navigation.engine.piecewise import answer_now, refuse
from bench.navigation.engine.record_cuts import nothing_known
from bench.navigation.engine.session import Kept, SessionState
from bench.navigation.error_state_filter.aiding_sensors import (
    LATENCY,
    fix_errors,
    fix_variance,
    remaining,
    weigh_fixes,
)
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.options import GnssOnlyOptions, read_options
from bench.navigation.start.fix_track import FixTrack, unknown_arm

STATES = tuple(f"acceleration_{axis}_m_s2" for axis in "ned")


class GnssOnly:
    """A Kalman filter over the fixes of a receiver.

    Options: `bench.navigation.options.GnssOnlyOptions`.
    """

    needs = ("fixes",)
    finds_start = True

    def __init__(self, **options: Any) -> None:
        self.options = read_options(GnssOnlyOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity and their covariance; attitude and sensor errors are NaN.

        Without a given initial state it begins with the first fix.
        """
        if not len(sensors.output_t):  # without an output no fix is used
            sensors = replace(sensors, fixes=None)
        return FixPassage(self.options, initial, []).update(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> FixPassage:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        return FixPassage(self.options, initial, events)

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of the receiver that the filter has no state for, in words."""
        return () if specs.gnss is None else remaining(fix_errors(specs.gnss), {LATENCY})


class FixPassage(SessionState):
    """The filter for a record in pieces (`piecewise.InPieces`).

    Without a given start it begins with the first fix; ``events`` are what went before.
    """

    events: Kept[list[EventRow]]
    track: Kept[FixTrack | None]
    sampled: Kept[float]  # last IMU sample [s]
    passed: Kept[float]  # up to here all is done [s]
    newest: Kept[float]  # validity of the fixes taken [s]
    wanted: Kept[FloatArray]  # answers beyond [s]
    waiting: Kept[GnssFixes | None]  # fixes that no answer has come after
    bound: Kept[Earthbound]

    def __init__(self, options: GnssOnlyOptions, initial: InitialState, events: list[EventRow]) -> None:
        self.options, self.initial, self.events = options, initial, events
        self.track, self.bound = None, Earthbound()
        if initial.alignment == "given":
            self.track = FixTrack(options, initial.t, initial.lla, initial.vel_n, initial.cov[:6, :6])
        self.sampled, self.passed, self.newest = initial.t, -np.inf, -np.inf
        self.wanted, self.waiting = np.empty(0), None

    @property
    def end(self) -> float:
        """Time of the last IMU sample, or of a newer fix in use [s]."""
        return self.sampled if self.track is None else max(self.sampled, self.track.t)

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Process the next piece; return its part of the solution.

        A fix is used for the next answer wanted, and by ``look_back`` after its arrival without one.
        """
        if (passed := piece.output_t[piece.output_t < self.passed]).size:
            refuse("an answer", float(passed[0]), self.passed)
        wanted = np.append(self.wanted, piece.output_t)
        fixes = self._take_fixes(piece)
        self.sampled = _latest(self.sampled, piece.imu.t)
        self.passed = _latest(self.end, wanted, *([] if fixes is None else [fixes.t_arrival]))
        self.passed -= 2.0 * timeline.TIME_TOLERANCE
        final = np.full(len(wanted), last) | (wanted <= self.passed)
        output_t, self.wanted = wanted[final], wanted[~final]
        if fixes is not None:
            x, P = self._use_fixes(fixes, piece, output_t, self.passed - look_back, last)
        elif self.track is not None:
            x, P = self.track.at(output_t)
        else:
            x, P = _unknown(len(output_t))
        arm = unknown_arm(piece.antenna_b)
        P[:, range(6), range(6)] += arm
        accelerations_sd = np.sqrt(np.einsum("kii->ki", P)[:, 6:])
        P[:, 6:], P[:, :, 6:] = np.nan, np.nan
        self.events += self.bound.end_answers(output_t, x, P, accelerations_sd)
        events, self.events = self.events, []
        return replace(
            nothing_known(output_t),
            lla=x[:, :3],
            vel_n=x[:, 3:6],
            cov=P,
            extra_names=STATES,
            extra=x[:, 6:],
            extra_sd=accelerations_sd,
            innovations=self.track.take_innovations() if self.track else no_innovations(),
            events=Events.from_rows(events),
        )

    def _take_fixes(self, piece: SensorData) -> GnssFixes | None:
        """Return the waiting fixes and the new fixes of a piece, in the order of their arrival."""
        fixes = piece.fixes
        if fixes is None:
            return None
        t, arrival = fixes.t, fixes.t_arrival
        sound = fixes.valid & np.isfinite(t) & np.isfinite(arrival) & np.isfinite(fixes.lla).all(axis=1)
        if (late := sound & (arrival <= self.passed)).any():
            refuse("a row of gnss", float(t[late][0]), self.passed)
        rows, events = timeline.fresh_rows(t, arrival, sound, "gnss", self.newest)
        self.events += events
        self.newest = _latest(self.newest, t[sound])
        fresh = fixes.take(rows)
        return fresh if self.waiting is None else join_rows(self.waiting, fresh)

    def _use_fixes(
        self,
        fixes: GnssFixes,
        piece: SensorData,
        output_t: FloatArray,
        due: float,
        last: bool,
    ) -> tuple[FloatArray, FloatArray]:
        """Return states (M, 9) and P (M, 9, 9) at the outputs; fixes until ``due`` need no later output."""
        start, arrival = self.initial.t, fixes.t_arrival
        at = np.searchsorted(output_t, arrival - timeline.TIME_TOLERANCE)
        before = arrival <= start - timeline.TIME_TOLERANCE
        use = ~before & ((at < len(output_t)) | (not last and arrival <= due))
        left = ~use & (before | last)
        at[arrival < start + timeline.TIME_TOLERANCE] = -1
        self.events += timeline.left_out("gnss", fixes.t, left, timeline.OUTSIDE)
        self.waiting = fixes.take(~use & ~left)
        used = np.flatnonzero(use)
        self.events += timeline.without_velocity(fixes, used)
        gnss = assumed(piece.specs, "gnss")
        white = fix_variance(gnss, gnss_markov=False)
        r, begin = weigh_fixes(fixes, gnss, white, self.options.fix_accuracy), 0
        if self.track is None and len(used):
            first, begin = used[0], max(int(at[used[0]]), 0)
            self.track = FixTrack.begin(
                self.options, float(fixes.t[first]), fixes.lla[first], fixes.vel_n[first], r[first]
            )
            moving = np.isfinite(fixes.vel_n[first]).all()
            origin = "position and velocity" if moving else "position"
            text = f"{origin} of the first fix; attitude is not estimated"
            until = output_t[begin] if begin < len(output_t) else arrival[first]
            self.events.append((start, float(until), "alignment", text))
        if self.track is None:
            return _unknown(len(output_t))
        x, P = self.track.run(fixes, used, r, at[used] - begin, output_t[begin:])
        if begin:  # the first fix has not arrived
            nothing = _unknown(begin)
            x, P = np.concatenate([nothing[0], x]), np.concatenate([nothing[1], P])
        return x, P

    def current(self, head: SensorData) -> NavSolution:
        """Return state and covariance at :attr:`end` from all data that arrived."""
        self.wanted = self.wanted[self.wanted < self.end - timeline.TIME_TOLERANCE]
        self.passed = -np.inf
        return answer_now(self, head)


def _unknown(count: int) -> tuple[FloatArray, FloatArray]:
    """Return states (M, 9) and P (M, 9, 9) filled with NaN."""
    return np.full((count, 9), np.nan), np.full((count, 9, 9), np.nan)


def _latest(t: float, *more: FloatArray) -> float:
    """Return the latest finite time of all [s]."""
    return max(t, *(float(one[np.isfinite(one)].max(initial=-np.inf)) for one in more))
