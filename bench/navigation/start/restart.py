"""Restart after a long gap of the IMU: the filter follows the fixes alone, then starts again.

Over seconds without IMU the tilt may be anything, and the linear error model of a filter breaks: it would
come back meters off and claim decimeters. So it stops at the last sample before the gap. From there on
position and velocity come from the fixes alone (`fixes_only`); the attitude is held and its
covariance grows. When the samples are back, the alignment at rest or in motion finds the attitude
(`alignment`), and the filter starts again. Its IMU biases are kept, each with its variance; all other
states begin as at the first start. A filter without fixes ends at the gap: nothing tells where it is.

A filter that has rejected sound fixes for long is lost (`refused_fixes`): it is reset in the same way, with
nothing taken over of what it said, biases included: with a heading wrong by 90 deg it has learnt wrong ones.
A filter that has lost only its heading, as in a hover, is reset when GNSS shows that the vehicle moves,
because a linear filter would find a wrong heading. Its biases are kept.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import cast

import numpy as np

from bench.core.mathematics.arrays import FloatArray, same_array
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.engine.imu_range import count_lost, name_ranges
from bench.navigation.engine.kept_rows import take_rows
from bench.navigation.engine.piecewise import (
    InPieces,
    KnowsImuErrors,
    MayLoseHeading,
    answer_now,
    join_solutions,
    take_after,
    take_answers,
)
from bench.navigation.engine.record_cuts import (
    cut_piece,
    goes_beyond,
    join_pieces,
    newest_sample,
    nothing_known,
    take_head,
)
from bench.navigation.engine.session import Kept, Replaced, SessionState, require
from bench.navigation.error_state_filter.measurement_rows import POSITION, SENSORS
from bench.navigation.error_state_filter.state_processes import assumed
from bench.navigation.options import FixAccuracy
from bench.navigation.start import alignment
from bench.navigation.start.fixes_only import Coast, End, fresh_fixes, lost_at, violent
from bench.navigation.start.learnt_biases import UNLEARNT, LearntBiases, learn_biases
from bench.navigation.start.new_starts import Pause, list_starts
from bench.navigation.start.refused_fixes import SHARE, RefusedFixes

_RECENT = 5.0  # time before a reset in which a force above 2 g counts as a hard maneuver [s]
_LONG = 10.0  # piece within which a filter may get lost: a copy of it is kept [s]
LONGEST_KEPT = 120.0  # of a record that is kept beside such a copy [s]

Begin = Callable[[SensorData, InitialState, list[EventRow]], InPieces]


class BetweenGaps(SessionState):
    """A filter that starts again after each long gap of the IMU (`piecewise.InPieces`).

    Parameters
    ----------
    begin : callable
        `piecewise.RunsInPieces.in_pieces` of the filter, which need not go over a gap longer than
        `timeline.LONGEST_BRIDGE`.
    first, start, events
        What that takes; there are fixes.
    accuracy : str or None
        How the filter weighs fixes; None: it has none, and ends at a gap.
    whole : bool
        The filter knows what adds to its biases (``steady_errors``), and ``begin`` takes ``gyro_sd``.
    readmit_after_s : float or None
        Of its gate; None: it is not reset.
    any_heading : bool
        The filter can start with an unknown heading (`headings`), so it restarts after 2 s of motion.
    """

    head: Replaced[SensorData]
    start: Replaced[InitialState]
    biases: Replaced[LearntBiases]
    again: Kept[bool]  # it has started again
    intake: Kept[timeline.ImuIntake]
    lost: Replaced[dict[str, int]]  # samples without use since the last, by what was wrong
    held: Replaced[SensorData | None]  # what came after the last sample
    newest: Kept[float]  # validity of the fixes taken [s]
    stopped: Replaced[End | None]  # before the last gap
    names: Replaced[tuple[str, ...]]  # of the further states
    pause: Kept[Pause | None]
    watch: Kept[RefusedFixes | None]
    filter: Kept[InPieces | None]
    fork: Kept[InPieces | None]  # the filter as it was before the first of some rejections
    since: Replaced[SensorData | None]  # what has come since
    told: Replaced[tuple[float, float]]  # last answer and last innovation given since [s]

    def __init__(
        self,
        begin: Begin,
        first: SensorData,
        start: InitialState,
        events: list[EventRow],
        accuracy: FixAccuracy | None,
        *,
        whole: bool = False,
        readmit_after_s: float | None = None,
        any_heading: bool = False,
    ) -> None:
        self._begin, self.head, self.accuracy, self.whole = begin, take_head(first), accuracy, whole
        self.any_heading = any_heading
        self.filter, self.intake = begin(first, start, events), timeline.ImuIntake(start.t)
        self.start, self.biases = start, UNLEARNT
        self.again, self.lost, self.held, self.newest = False, {}, None, -np.inf
        self.pause, self.stopped, self.names = None, None, ()
        self.watch = None
        if accuracy is not None and readmit_after_s is not None:
            self.watch = RefusedFixes(assumed(first.specs, "gnss"), accuracy, readmit_after_s)
        self.fork, self.since, self.told = None, None, (-np.inf, -np.inf)

    @property
    def end(self) -> float:
        """Time of the last processed IMU sample, or of the start [s]."""
        return self.intake.newest

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Take the next piece; return the answers that are final (`piecewise.InPieces`)."""
        record = self._with_held(piece, look_back)
        imu, before = record.imu, self.intake.newest
        rows, span, events, again = self.intake.take(imu, record.specs.imu, last=last)
        gaps = np.flatnonzero(span - imu.dt[rows] > timeline.LONGEST_BRIDGE).tolist() if events else []
        found: list[NavSolution] = []
        first, after = 0, -np.inf
        for k in gaps:
            behind, ended = int(rows[k]), float(imu.t[rows[k - 1]]) if k else before
            sound = first + np.flatnonzero(~(imu.t[first:behind] > imu.t[behind]))  # none with a wild time
            self._take(cut_piece(record, sound, after, ended), look_back, found, ended=ended)
            first, after = behind, ended
            lost = slice(int(rows[k - 1]) + 1 if k else 0, behind)
            self.lost = count_lost(self.lost if k == 0 else {}, imu, lost, record.specs.imu)
            self._stop((ended, float(imu.t[behind] - imu.dt[behind])), found)
        stop = int(again[0]) if len(again) else len(imu)
        lost = slice(int(rows[-1]) + 1 if len(rows) else 0, stop)
        self.lost = count_lost({} if len(rows) else self.lost, imu, lost, record.specs.imu)
        until = np.inf if last else self.end
        rest = record
        if first or stop < len(imu) or goes_beyond(record, until):
            rest = cut_piece(record, slice(first, stop), after, until)
            self.held = None if last else cut_piece(record, slice(stop, None), until, np.inf)
        else:
            self.held = None
        self._take(rest, look_back, found, last=last)
        return join_solutions(found)

    def _with_held(self, piece: SensorData, look_back: float) -> SensorData:
        """Return a piece with the held-back samples in front."""
        held = self.held
        if not same_array(self.head.antenna_b, piece.antenna_b):
            if self.pause is not None:
                raise EstimatorError(
                    "the filter cannot change to another antenna before it has restarted after a gap"
                )
            if held is not None:  # of the antenna before
                assert self.filter is not None
                self.filter.update(
                    self._less(cut_piece(held, slice(0), -np.inf, np.inf)), look_back, last=False
                )
                held = replace(take_head(held), imu=held.imu)
            self.head = replace(self.head, antenna_b=piece.antenna_b)
        return piece if held is None else replace(join_pieces(held, piece), antenna_b=piece.antenna_b)

    def _take(
        self, part: SensorData, look_back: float, found: list[NavSolution], *,
        last: bool = False, ended: float | None = None,
    ) -> None:  # fmt: skip
        """Process a part without a long gap; it may be the ``last``, or a gap begins at ``ended`` [s]."""
        if self.filter is None and self.pause is None:  # it has ended
            found.append(self._unknown(part.output_t))
            return
        if self.accuracy is not None:
            assert part.fixes is not None
            fresh, self.newest = fresh_fixes(part.fixes, self.newest)
            if self.watch is not None:
                self.watch.take(fresh)
        if self.pause is not None:
            self.pause.coast.take(fresh)
            aligned = self._align(part, look_back, found, last=last, ended=ended)
            if aligned is None:
                return
            part = aligned
        assert self.filter is not None
        self._keep_copy(part)
        before = self.biases
        if ended is None:
            solution = self._own(self.filter.update(self._less(part), look_back, last=last))
        else:
            solution = self._end_at(part, ended)
        if self.watch is not None:
            since = None if self.filter is None else cast("MayLoseHeading", self.filter).heading_lost_at
            lost = self.watch.find(solution.innovations, since)
            if lost is not None and self.since is not None:
                self.biases = before
                self._reset(*lost, look_back, found, last=last, ended=ended)
                return
        found.append(solution)
        self._drop_copy(solution)

    def _end_at(self, part: SensorData, ended: float) -> NavSolution:
        """End the filter after a part at a time [s], and store its learned biases."""
        assert self.filter is not None
        wanted = np.union1d(part.output_t, ended)
        solution = self._own(self.filter.update(self._less(replace(part, output_t=wanted)), 0.0, last=True))
        self.stopped, self.names = _last_answer(solution), solution.extra_names
        steady = cast("KnowsImuErrors", self.filter).steady_errors() if self.whole else None
        self.biases = learn_biases(self.stopped, self.head.specs.imu, self.biases, steady)
        self.filter = None
        return solution if len(wanted) == len(part.output_t) else take_answers(solution, slice(-1))

    @property
    def _heading_vague(self) -> bool:
        """Whether the filter may lose its heading soon (`piecewise.MayLoseHeading`)."""
        return self.filter is not None and cast("MayLoseHeading", self.filter).heading_vague

    def _keep_copy(self, part: SensorData) -> None:
        """Copy the filter if it may diverge in a part; if a copy exists, store the part."""
        if self.watch is None:
            return
        assert self.filter is not None
        if self.since is not None:
            self.since = join_pieces(self.since, part)
        elif self.watch.any_refused or self._heading_vague or newest_sample(part) - self.filter.end > _LONG:
            self.fork, self.since, self.told = self.filter.copy(), part, (-np.inf, -np.inf)

    def _drop_copy(self, solution: NavSolution) -> None:
        """Drop the copy if nothing was rejected recently; else remember the solution since the copy."""
        if self.since is None:
            return
        assert self.watch is not None
        kept = self.filter is not None and (self.watch.any_refused or self._heading_vague)
        if not kept or newest_sample(self.since) - self.since.imu.t.min(initial=np.inf) > LONGEST_KEPT:
            self.fork, self.since = None, None
        answered, told = self.told
        self.told = float(solution.t.max(initial=answered)), float(solution.innovations.t.max(initial=told))

    def _reset(
        self,
        t: float,
        rejected: bool,
        look_back: float,
        found: list[NavSolution],
        *,
        last: bool,
        ended: float | None,
    ) -> None:
        """End the filter at a time [s], continue with fixes alone and process the later record.

        ``rejected``: it has rejected positions for long; else only its heading was lost, and its biases stay.
        """
        assert self.watch is not None
        assert self.since is not None
        record, told, fix = self.since, self.told, self.watch.last(t)
        self.filter, self.fork, self.since = self.fork, None, None
        ahead = record.imu.t > t
        part, before = cut_piece(record, np.flatnonzero(~ahead), -np.inf, t), self.biases
        found.append(take_after(*told, self._end_at(part, t)))
        why = "GNSS shows motion while the heading is unknown"
        if rejected:
            self.biases = before  # what it has learnt is as wrong as its attitude
            why = (
                f"fixes rejected for {SHARE:.0%} of {self.watch.window:g} s that agree with their velocities"
            )
        assert self.stopped is not None
        assert self.accuracy is not None
        coast = Coast(self.head, lost_at(t, self.stopped), self.names, self.accuracy)
        if violent(take_rows(part.imu, part.imu.t > t - _RECENT)):
            coast.go_beyond()
        coast.take(fix)
        self.pause = Pause(coast, (t, t), "reset", why, np.empty(0), None, [], [])
        self.watch.forget()
        self.newest = float(fix.t[-1])
        rest = cut_piece(record, np.flatnonzero(ahead), t, np.inf)
        self._take(rest, look_back, found, last=last, ended=ended)

    def _stop(self, silent: tuple[float, float], found: list[NavSolution]) -> None:
        """Continue with fixes alone in a gap between two times [s], or without end."""
        if self.accuracy is None:
            if self.stopped is not None:
                length, because = f"{silent[1] - silent[0]:.6g} s", name_ranges(self.lost)
                text = f"IMU silent for {length}{because}: it ends; without fixes its position is unknown"
                events: list[EventRow] = [
                    (*silent, "timeline", f"imu: gap of {length}", "imu"),
                    (*silent, "ended", text, "imu"),
                ]
                found.append(replace(self._unknown(np.empty(0)), events=Events.from_rows(events)))
            self.stopped = None
            return
        if self.pause is None:
            assert self.stopped is not None
            coast = Coast(self.head, self.stopped, self.names, self.accuracy)
            self.pause = Pause(coast, silent, "", "", np.empty(0), None, [], [])
        because = name_ranges(self.lost)
        if because:
            self.pause.coast.go_beyond()
        if self.watch is not None:
            self.watch.forget()
        why = f"IMU silent for {silent[1] - silent[0]:.6g} s{because}"
        self.pause = replace(
            self.pause, silent=silent, kind="restart", why_stopped=why, record=None, ways=[], why=[]
        )

    def _unknown(self, t: FloatArray) -> NavSolution:
        """Return a solution of NaN at epochs t (M,), with the further states of the filter."""
        none = np.full((len(t), len(self.names)), np.nan)
        return replace(nothing_known(t), extra_names=self.names, extra=none, extra_sd=none)

    def _align(
        self, part: SensorData, look_back: float, found: list[NavSolution], *, last: bool, ended: float | None
    ) -> SensorData | None:
        """Restart the filter; return the record since the gap, or None while it cannot restart."""
        pause = self.pause
        assert pause is not None
        (stopped, begin), no_more = pause.silent, last or ended is not None
        pause.wanted = np.append(pause.wanted, part.output_t)
        stretch = replace(cut_piece(part, slice(None), begin, np.inf), output_t=np.empty(0))
        if pause.record is None:
            found.append(pause.coast.answers(pause.due(begin)))
            pause.record, pause.ways = stretch, list_starts(begin, pause.coast, any_heading=self.any_heading)
        else:
            pause.record = join_pieces(pause.record, stretch)
        start, text = None, ""
        while pause.ways and start is None:
            try:
                aligned = pause.ways[0].find(self.biases.for_alignment(pause.record), look_back, last=no_more)
            except EstimatorError as error:
                pause.why.append(str(error))
                pause.ways.pop(0)
                continue
            if aligned is None:
                until = pause.ways[0].tried - alignment.SETTLED
                found.append(pause.coast.answers(pause.due(until)))
                return None
            start, ((_, _, _, text, *_),) = aligned
        if start is None:
            until = self.end if ended is None else ended
            text = f"not started again: {'; '.join(pause.why)}"
            coasted = pause.coast.answers(pause.due(until))
        else:
            until, text = start.t, f"until {start.t:.6g} s; {text}"
            coasted = pause.coast.answers(pause.due(until - 2.0 * timeline.TIME_TOLERANCE))
        text = f"{pause.why_stopped}: position and velocity by the fixes alone {text}"
        sensor = "imu" if pause.kind == "restart" else SENSORS[POSITION]
        events: list[EventRow] = [
            (stopped, until, pause.kind, text.replace("alone not", "alone; not"), sensor)
        ]
        if pause.kind == "restart":
            length = f"imu: gap of {begin - stopped:.6g} s"
            events.insert(0, (stopped, begin, "timeline", length, "imu"))
        found.append(replace(coasted, events=Events.from_rows(events)))
        if start is None:
            if last:
                self.names = coasted.extra_names
                found.append(self._unknown(pause.wanted))
            return None
        self.pause, self.again, self.start = None, True, start
        self.filter = self._begin_again()
        return replace(pause.record, output_t=pause.wanted)

    def _begin_again(self) -> InPieces:
        """Return the filter from the present start, with the gyro errors learned before."""
        sd = float(self.biases.gyro_sd.max())
        if not (self.whole and self.again and np.isfinite(sd)):
            return self._begin(self._less(self.head), self.start, [])
        return self._begin(self._less(self.head), self.start, [], gyro_sd=sd)  # type: ignore[call-arg]

    def _less(self, piece: SensorData) -> SensorData:
        """Return a piece without the learned biases, as input of the filter."""
        return self.biases.taken_off(piece) if self.again else piece

    def _own(self, solution: NavSolution) -> NavSolution:
        """Return a solution of the filter with the subtracted biases added again."""
        return self.biases.given_back(solution) if self.again else solution

    def current(self, head: SensorData) -> NavSolution:
        """Return the solution at the end as if the record ended there."""
        if self.filter is not None and self.pause is None:
            return self._own(self.filter.current(self._less(head)))
        if self.pause is None:
            return self._unknown(np.array([self.end]))
        self.pause.wanted = np.empty(0)
        if self.held is not None:
            self.held = replace(self.held, output_t=np.empty(0))
        return answer_now(self, head)

    def make_parts(self) -> None:
        """Make the filter of the present start, and one for its copy."""
        self.filter, self.fork = self._begin_again(), self._begin_again()

    def check(self) -> None:
        """Check that filter and samples go together."""
        same = self.filter is None or self.intake.newest == self.filter.end
        require(same, "intake/newest", "must be the last sample of the filter")


def between_gaps(
    begin: Begin,
    first: SensorData,
    start: InitialState,
    events: list[EventRow],
    accuracy: FixAccuracy | None,
    *,
    whole: bool = False,
    readmit_after_s: float | None = None,
    any_heading: bool = False,
) -> InPieces:
    """Return a filter before its first piece that starts again after long gaps, as `BetweenGaps` does.

    Without fixes, or with an ``accuracy`` of None, it has nothing to start again from and ends at a gap; one
    with satellites bridges it.
    """
    if first.fixes is None:
        if accuracy is not None and first.observations is not None:
            return begin(first, start, events)
        accuracy = None
    return BetweenGaps(
        begin, first, start, events, accuracy,
        whole=whole, readmit_after_s=readmit_after_s, any_heading=any_heading,
    )  # fmt: skip


def _last_answer(solution: NavSolution) -> End:
    return End(*(getattr(solution, name)[-1] for name in End._fields))
