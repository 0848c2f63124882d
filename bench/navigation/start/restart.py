"""Over a long gap in the IMU record a filter with fixes coasts on them, and then starts again.

Over seconds without IMU the tilt may be anything, and the linear error model of a filter breaks: it would
come back metres off and claim decimetres. So it stops at the last sample before the gap. From there on
position and velocity come from the fixes alone (`fixes_only`); the attitude is held and its
covariance grows. When the samples are back, the alignment at rest or on the move finds the attitude
(`alignment`), and the filter starts again. Its IMU biases are kept, each with its variance;
all other states begin as at the first start. A filter without fixes ends at the gap: nothing tells where
it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from bench import earth
from bench.arrays import FloatArray
from bench.data import EventRow, Events, ImuData, InitialState, NavSolution, SensorData
from bench.errors import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.engine.imu_range import find_beyond
from bench.navigation.engine.kept_rows import take_rows
from bench.navigation.engine.piecewise import (
    InPieces,
    KnowsImuErrors,
    answer_now,
    join_solutions,
    take_answers,
)
from bench.navigation.engine.record_cuts import (
    cut_piece,
    goes_beyond,
    join_pieces,
    nothing_known,
    take_head,
)
from bench.navigation.engine.session import Kept, SessionState, require
from bench.navigation.error_state_filter.state_blocks import WIND_SD
from bench.navigation.options import FixAccuracy
from bench.navigation.start import alignment
from bench.navigation.start.alignment import StartSearch
from bench.navigation.start.course import LEAST_SPEED
from bench.navigation.start.fixes_only import Coast, End, fresh_fixes
from bench.navigation.start.learnt_biases import LearntBiases, learn_biases
from bench.specs import ImuSpec

_ALIGN_FOR = 10.0  # of a stretch that gives the course, or of a standstill [s]
_STILL = 0.3  # speed below which an aircraft stood before a gap [m/s]
_SIGMAS = 5.0  # by which it may seem to have moved in it
_ALL = "all"

Begin = Callable[[SensorData, InitialState, list[EventRow]], InPieces]


@dataclass
class _Pause(SessionState):
    """From the last sample before a gap to where the filter starts again."""

    coast: Kept[Coast]
    silent: Kept[tuple[float, float]]  # [s]
    because: Kept[str]  # what it comes from, where that is known
    wanted: Kept[FloatArray]  # answers [s]
    record: Kept[SensorData | None]  # since the gap, None before its first sample
    ways: Kept[list[StartSearch]]  # that have not failed
    why: Kept[list[str]]  # the others did

    def due(self, until: float) -> FloatArray:
        """Remove and return the output times up to an instant [s]."""
        due = self.wanted <= until
        found, self.wanted = self.wanted[due], self.wanted[~due]
        return found


class BetweenGaps(SessionState):
    """A filter that starts again after each long gap of the IMU (`piecewise.InPieces`).

    Parameters
    ----------
    begin : callable
        Returns the filter before its first piece (`piecewise.RunsInPieces.in_pieces`). It
        need not go over a gap longer than `timeline.LONGEST_BRIDGE`.
    first : SensorData
        Its records say which sensors there are; fixes among them.
    start : InitialState
        Start.
    events : list of (t, t_end, kind, text)
        What went before.
    accuracy : str or None
        How the filter weighs fixes; None: it has none, and ends at a gap.
    whole : bool
        The filter knows what adds to its biases (``steady_errors``), and ``begin`` takes ``gyro_sd``.
    """

    head: Kept[SensorData]
    start: Kept[InitialState]
    biases: Kept[LearntBiases]
    again: Kept[bool]  # it has started again
    intake: Kept[timeline.ImuIntake]
    lost: Kept[dict[str, int]]  # samples without use since the last, by what was wrong
    held: Kept[SensorData | None]  # what came after the last sample
    newest: Kept[float]  # validity of the fixes taken [s]
    stopped: Kept[End | None]  # before the last gap
    names: Kept[tuple[str, ...]]  # of the further states
    pause: Kept[_Pause | None]
    filter: Kept[InPieces | None]

    def __init__(
        self,
        begin: Begin,
        first: SensorData,
        start: InitialState,
        events: list[EventRow],
        accuracy: FixAccuracy | None,
        *,
        whole: bool = False,
    ) -> None:
        self._begin, self.head, self.accuracy, self.whole = begin, take_head(first), accuracy, whole
        self.filter, self.intake = begin(first, start, events), timeline.ImuIntake(start.t)
        self.start, self.biases = start, LearntBiases(*np.zeros((2, 3)), *np.full((2, 3), np.inf))
        self.again, self.lost, self.held, self.newest = False, {}, None, -np.inf
        self.pause, self.stopped, self.names = None, None, ()

    @property
    def end(self) -> float:
        """Instant of the last IMU sample taken, or of the start [s]."""
        return self.intake.newest

    def feed(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
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
            self.lost = _count_lost(self.lost if k == 0 else {}, take_rows(imu, lost), record.specs.imu)
            self._stop((ended, float(imu.t[behind] - imu.dt[behind])), found)
        stop = int(again[0]) if len(again) else len(imu)
        lost = slice(int(rows[-1]) + 1 if len(rows) else 0, stop)
        self.lost = _count_lost({} if len(rows) else self.lost, take_rows(imu, lost), record.specs.imu)
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
        """Return a piece after what was held."""
        held = self.held
        if not np.array_equal(self.head.antenna_b, piece.antenna_b):
            if self.pause is not None:
                raise EstimatorError("it cannot go over to another antenna before it has started again")
            if held is not None:  # of the antenna before
                assert self.filter is not None
                self.filter.feed(
                    self._less(cut_piece(held, slice(0), -np.inf, np.inf)), look_back, last=False
                )
                held = replace(take_head(held), imu=held.imu)
            self.head = replace(self.head, antenna_b=piece.antenna_b)
        return piece if held is None else replace(join_pieces(held, piece), antenna_b=piece.antenna_b)

    def _take(
        self,
        part: SensorData,
        look_back: float,
        found: list[NavSolution],
        *,
        last: bool = False,
        ended: float | None = None,
    ) -> None:
        """Take a part without a long gap; nothing comes after the ``last``, and a gap after ``ended`` [s]."""
        if self.filter is None and self.pause is None:  # it has ended
            found.append(self._unknown(part.output_t))
            return
        if self.accuracy is not None:
            assert part.fixes is not None
            fresh, self.newest = fresh_fixes(part.fixes, self.newest)
        if self.pause is not None:
            self.pause.coast.take(fresh)
            aligned = self._align(part, look_back, found, last=last, ended=ended)
            if aligned is None:
                return
            part = aligned
        assert self.filter is not None
        if ended is None:
            found.append(self._own(self.filter.feed(self._less(part), look_back, last=last)))
        else:
            wanted = np.union1d(part.output_t, ended)
            solution = self._own(self.filter.feed(self._less(replace(part, output_t=wanted)), 0.0, last=True))
            asked = len(wanted) == len(part.output_t)
            found.append(solution if asked else take_answers(solution, slice(-1)))
            self.stopped, self.names = _last_answer(solution), solution.extra_names
            steady = cast("KnowsImuErrors", self.filter).steady_errors() if self.whole else None
            self.biases = learn_biases(self.stopped, self.head.specs.imu, self.biases, steady)
            self.filter = None

    def _stop(self, silent: tuple[float, float], found: list[NavSolution]) -> None:
        """Continue from fixes alone in a gap from one instant until another [s], or without end."""
        if self.accuracy is None:
            if self.stopped is not None:
                length, because = f"{silent[1] - silent[0]:.6g} s", _name_ranges(self.lost)
                text = f"IMU silent for {length}{because}: it ends; without fixes nothing tells where it is"
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
            self.pause = _Pause(coast, silent, "", np.empty(0), None, [], [])
        because = _name_ranges(self.lost)
        if because:
            self.pause.coast.go_beyond()
        self.pause = replace(self.pause, silent=silent, because=because, record=None, ways=[], why=[])

    def _unknown(self, t: FloatArray) -> NavSolution:
        """Return a solution of NaN at instants t (M,), with the further states of the filter."""
        none = np.full((len(t), len(self.names)), np.nan)
        return replace(nothing_known(t), extra_names=self.names, extra=none, extra_sd=none)

    def _align(
        self, part: SensorData, look_back: float, found: list[NavSolution], *, last: bool, ended: float | None
    ) -> SensorData | None:
        """Begin the filter again; return the record since the gap, None while it cannot."""
        pause = self.pause
        assert pause is not None
        (stopped, begin), no_more = pause.silent, last or ended is not None
        pause.wanted = np.append(pause.wanted, part.output_t)
        stretch = replace(cut_piece(part, slice(None), begin, np.inf), output_t=np.empty(0))
        if pause.record is None:
            found.append(pause.coast.answers(pause.due(begin)))
            pause.record, pause.ways = stretch, _ways(begin, pause.coast)
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
        length = f"{begin - stopped:.6g} s"
        if start is None:
            until = self.end if ended is None else ended
            text = f"not started again: {'; '.join(pause.why)}"
            coasted = pause.coast.answers(pause.due(until))
        else:
            until, text = start.t, f"until {start.t:.6g} s; {text}"
            coasted = pause.coast.answers(pause.due(until - 2.0 * timeline.TIME_TOLERANCE))
        text = f"IMU silent for {length}{pause.because}: position and velocity by the fixes alone {text}"
        events: list[EventRow] = [
            (stopped, begin, "timeline", f"imu: gap of {length}", "imu"),
            (stopped, until, "restart", text.replace("alone not", "alone; not"), "imu"),
        ]
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
        """Return the filter from the present start, with what it has learnt of the gyros before."""
        sd = float(self.biases.gyro_sd.max())
        if not (self.whole and self.again and np.isfinite(sd)):
            return self._begin(self._less(self.head), self.start, [])
        return self._begin(self._less(self.head), self.start, [], gyro_sd=sd)  # type: ignore[call-arg]

    def _less(self, piece: SensorData) -> SensorData:
        """Return a piece as the filter takes it."""
        return self.biases.taken_off(piece) if self.again else piece

    def _own(self, solution: NavSolution) -> NavSolution:
        """Return a solution of the filter with the biases added that were taken off its increments."""
        return self.biases.given_back(solution) if self.again else solution

    def answer(self, head: SensorData) -> NavSolution:
        """Return state and covariance at the end, were that the end of the record."""
        if self.filter is not None and self.pause is None:
            return self._own(self.filter.answer(self._less(head)))
        if self.pause is None:
            return self._unknown(np.array([self.end]))
        self.pause.wanted = np.empty(0)
        if self.held is not None:
            self.held = replace(self.held, output_t=np.empty(0))
        return answer_now(self, head)

    def make_parts(self) -> None:
        """Make the filter of the present start."""
        self.filter = self._begin_again()

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
) -> InPieces:
    """Return a filter before its first piece that starts again after long gaps, as `BetweenGaps` does.

    Without fixes, or with an ``accuracy`` of None, it has nothing to start again from and ends at a gap; one
    with satellites bridges it.
    """
    if first.fixes is None:
        if accuracy is not None and first.observations is not None:
            return begin(first, start, events)
        accuracy = None
    return BetweenGaps(begin, first, start, events, accuracy, whole=whole)


def _count_lost(counts: dict[str, int], lost: ImuData, spec: ImuSpec) -> dict[str, int]:
    """Return counts of samples without use with more of them: of all, and by the words of a range."""
    if not len(lost):
        return counts
    more = {_ALL: len(lost)} | {why: int(rows.sum()) for why, rows in find_beyond(lost, spec)}
    return {why: counts.get(why, 0) + count for why, count in more.items()}


def _name_ranges(lost: dict[str, int]) -> str:
    """Return how many of the samples without use are at the end of a range, in words; "" if none is."""
    parts = [f"{n} of {lost[_ALL]} samples have the {why}" for why, n in lost.items() if n and why != _ALL]
    return f" ({' and '.join(parts)})" if parts else ""


def _ways(begin: float, coast: Coast) -> list[StartSearch]:
    """Return the search for an alignment after a gap that ended at an instant [s]: at rest, then moving."""
    lla, vel_n, cov = coast.at(begin)
    before, unknown = coast.end, np.full(4, np.nan)
    speed = float(np.nan_to_num(np.hypot(*vel_n[:2])))  # a filter may have ended without a velocity
    wide = np.diag(np.full(9, np.inf))
    ways = [
        InitialState(
            begin, unknown[:3], unknown[:3], unknown, wide, "course", _ALIGN_FOR,
            drift_sd=float(np.arctan2(WIND_SD, max(speed, LEAST_SPEED))),
        )
    ]  # fmt: skip
    if np.isfinite(lla).all():
        wide = wide.copy()
        wide[:3, :3] = cov[:3, :3]
        moved = np.linalg.norm(earth.difference_n(lla, before.lla)) > _SIGMAS * np.sqrt(np.trace(cov[:3, :3]))
        if np.linalg.norm(before.vel_n) < _STILL and not moved:  # the nose points where it did
            unknown, wide[8, 8] = before.q_nb, before.cov[8, 8]
        at_rest = InitialState(begin, lla, np.full(3, np.nan), unknown, wide, "level", _ALIGN_FOR)
        ways.insert(0, replace(at_rest, fix_cov=coast.offset[:3]))
    return [StartSearch(way) for way in ways]


def _last_answer(solution: NavSolution) -> End:
    return End(*(getattr(solution, name)[-1] for name in End._fields))
