"""A large turn-on bias of the gyros, learnt over the first seconds before a linear filter takes it.

In straight flight no measurement shows the heading. A bias of degrees per second turns it by tens of degrees
until the first turn, and a linear filter is then lost. So the mean rate over a stretch in which the course
stays is taken for the bias: the attitude of a vehicle that flies or drives straight changes little. At rest
it does not change at all. The filter begins again at the start with what is left of the bias; until the end
of the stretch its answers are those without this knowledge.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from bench import rotation
from bench.arrays import FloatArray
from bench.data import EventRow, Events, InitialState, NavSolution, SensorData, no_innovations
from bench.errors import EstimatorError
from bench.navigation.engine import timeline
from bench.navigation.engine.kept_rows import columns, take_rows
from bench.navigation.engine.piecewise import (
    InPieces,
    KnowsImuErrors,
    answer_now,
    join_solutions,
    take_answers,
)
from bench.navigation.engine.record_cuts import (
    as_plain,
    cut_piece,
    from_plain,
    join_pieces,
    newest_sample,
    nothing_known,
    take_head,
)
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter import standstill
from bench.navigation.error_state_filter.standstill import StandstillDetector
from bench.navigation.start.alignment import SETTLED
from bench.navigation.start.course import LEAST_SPEED

LARGE = float(np.deg2rad(0.3))  # sd of a bias that turns the heading by 18 deg in a minute [rad/s]
LONGEST, SHORTEST = 20.0, 5.0  # stretch [s]
STRAIGHT = float(np.deg2rad(10.0))  # largest change of the course in it [rad]
TURNED_SD = float(np.deg2rad(5.0))  # of the change of each angle that the course does not show [rad]
STILL = 0.5  # largest speed over ground at rest, by fixes [m/s]
STILL_SD = float(np.deg2rad(0.1))  # of the change of an angle at rest, with the Earth's turn [rad]

Run = Callable[[SensorData, InitialState, float | None], NavSolution]
Begin = Callable[[SensorData, InitialState, list[EventRow], float | None], InPieces]


@dataclass(frozen=True, slots=True)
class TurnOn:
    """A bias of the gyros, and how well it is known."""

    bias_b: FloatArray  # (3,) [rad/s], b
    sd: float  # [rad/s]
    until: float  # end of the stretch that it comes from [s]


class FromTurnOn:
    """A filter that gets a large bias of the gyros taken off its increments (`InPieces`).

    It waits until the stretch at the start is over.

    Parameters
    ----------
    begin : callable
        Returns the filter before its first piece, from the first piece, a start, events and the sd of what is
        left of the bias [rad/s]; None: that of the datasheet.
    first : SensorData
        Its records say which sensors there are.
    initial : InitialState
        Start; the attitude is given.
    events : list of (t, t_end, kind, text)
        What went before.
    """

    def __init__(
        self, begin: Begin, first: SensorData, initial: InitialState, events: list[EventRow]
    ) -> None:
        self._begin, self.head, self.initial, self.events = begin, take_head(first), initial, events
        self.record: SensorData | None = self.head  # until the bias is learnt, or not
        self.found: TurnOn | None = None
        self.filter: InPieces | None = None

    @property
    def end(self) -> float:
        """Instant of the last IMU sample taken, or of the start [s]."""
        if self.filter is not None:
            return self.filter.end
        assert self.record is not None
        return max(self.initial.t, newest_sample(self.record))

    def steady_errors(self) -> tuple[FloatArray, FloatArray]:
        """Return those of the filter with the bias that it did not see (`piecewise.KnowsImuErrors`)."""
        mean, sd = cast("KnowsImuErrors", self.filter).steady_errors()
        return mean + (0.0 if self.found is None else np.append(self.found.bias_b, np.zeros(3))), sd

    def feed(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Take the next piece; return the answers that are final (`piecewise.InPieces`)."""
        if self.filter is not None:
            return self._own(self.filter.feed(self._less(piece), look_back, last=last))
        assert self.record is not None
        if not np.array_equal(self.head.antenna_b, piece.antenna_b):
            raise EstimatorError("it cannot go over to another antenna before it has learnt the turn-on bias")
        record = piece if self.record is self.head else join_pieces(self.record, piece)
        if not last and newest_sample(record) < self.initial.t + LONGEST + SETTLED:
            self.record = record
            return nothing_known(np.empty(0))
        self.record, found = None, find_turn_on(record, self.initial)
        self.found, parts = found, list[NavSolution]()
        wanted = record.output_t
        if found is not None:
            early = cut_piece(record, np.flatnonzero(~(record.imu.t > found.until)), -np.inf, np.inf)
            early = replace(early, output_t=wanted[wanted <= found.until])
            without = self._begin(self.head, self.initial, [], None).feed(early, 0.0, last=True)
            parts.append(replace(without, innovations=no_innovations(), events=Events.from_rows([])))
            text = f"turn-on bias of the gyros by their mean rate, left {np.rad2deg(found.sd):.2g} deg/s"
            self.events = [(self.initial.t, found.until, "alignment", text), *self.events]
        self.filter = self._begin(self.head, self.initial, self.events, found.sd if found else None)
        solution = self._own(self.filter.feed(self._less(record), look_back, last=last))
        if found is not None:
            solution = take_answers(solution, slice(int((solution.t <= found.until).sum()), None))
        return join_solutions([*parts, solution])

    def _less(self, piece: SensorData) -> SensorData:
        return piece if self.found is None else _take_off(self.found, piece)

    def _own(self, solution: NavSolution) -> NavSolution:
        return solution if self.found is None else _give_back(self.found, solution)

    def answer(self, head: SensorData) -> NavSolution:
        """Return state and covariance at the end, were that the end of the record."""
        if self.filter is not None:
            return self._own(self.filter.answer(self._less(head)))
        assert self.record is not None
        wanted = self.record.output_t
        self.record = replace(self.record, output_t=wanted[wanted < self.end - TIME_TOLERANCE])
        return answer_now(self, head)

    def copy(self) -> FromTurnOn:
        """Return a filter that goes on from here by itself."""
        other = copy(self)
        other.filter = None if self.filter is None else self.filter.copy()
        return other

    def state(self) -> dict[str, Any]:
        """Return what is carried from one piece to the next, as arrays, numbers and words by name."""
        return {
            "record": None if self.record is None else as_plain(self.record),
            "found": None if self.found is None else columns(self.found),
            "events": [list(row) for row in self.events],
            "filter": None if self.filter is None else self.filter.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what :meth:`state` returned."""
        self.found = None if state["found"] is None else TurnOn(**state["found"])
        self.record = None if state["record"] is None else from_plain(state["record"], self.head.specs)
        self.events = [(t, t_end, *texts) for t, t_end, *texts in state["events"]]
        self.filter = None
        if state["filter"] is not None:
            self.filter = self._begin(self.head, self.initial, [], self.found.sd if self.found else None)
            self.filter.restore(state["filter"])


def may_be_learnt(first: SensorData, initial: InitialState) -> bool:
    """Tell whether a turn-on bias is large enough and the attitude at the start is given, not aligned."""
    large = first.specs.imu.gyro.turn_on_bias_sd >= LARGE
    given = initial.alignment == "given" and not initial.bias_cov.any()
    return bool(large and given and first.fixes is not None)


def smooth_from_turn_on(run: Run, sensors: SensorData, initial: InitialState) -> NavSolution:
    """Return what `run_from_turn_on` does of a smoother: it knows the stretch from its first answer on."""
    found = find_turn_on(sensors, initial)
    return run(sensors, initial, None) if found is None else _run_without(found, run, sensors, initial)


def _run_without(found: TurnOn, run: Run, sensors: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of a filter that gets a bias taken off its increments, the event first."""
    solution = _give_back(found, run(_take_off(found, sensors), initial, found.sd))
    text = f"turn-on bias of the gyros by their mean rate, left {np.rad2deg(found.sd):.2g} deg/s"
    event: EventRow = (initial.t, found.until, "alignment", text)
    return replace(solution, events=Events.from_rows([event, *solution.events.rows()]))


def _take_off(found: TurnOn, piece: SensorData) -> SensorData:
    imu = piece.imu
    return replace(piece, imu=replace(imu, dtheta_b=imu.dtheta_b - found.bias_b * imu.dt[:, None]))


def _give_back(found: TurnOn, solution: NavSolution) -> NavSolution:
    extra = solution.extra.copy()
    extra[:, :3] += found.bias_b
    return replace(solution, gyro_bias_b=solution.gyro_bias_b + found.bias_b, extra=extra)


def find_turn_on(sensors: SensorData, initial: InitialState) -> TurnOn | None:
    """Return the bias of the gyros by a stretch at the start; None if it is small or there is no stretch.

    The attitude at the start has to be given.
    """
    fixes, spec = sensors.fixes, sensors.specs.imu
    if fixes is None or not may_be_learnt(sensors, initial):
        return None
    used, _, _ = timeline.fix_rows(fixes, sensors.imu.t, initial.t)
    used = used[(fixes.t_arrival[used] <= initial.t + LONGEST) & np.isfinite(fixes.vel_n[used]).all(axis=1)]
    t, vel_n = fixes.t[used], fixes.vel_n[used]
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    rows, _, _ = timeline.imu_rows(sensors.imu, initial.t, spec)
    if not len(t):
        return None
    if (speed < STILL).all():
        inside = rows[sensors.imu.t[rows] <= initial.t + LONGEST]
        ends, motion_b, _ = StandstillDetector(initial.t, spec).take(take_rows(sensors.imu, inside))
        span = len(ends) * standstill.WINDOW
        if span < SHORTEST:
            return None
        return TurnOn(motion_b[:, :3].mean(axis=0), STILL_SD / span, float(ends[-1]))
    course = np.unwrap(np.arctan2(vel_n[:, 1], vel_n[:, 0]))
    straight = (np.abs(course - course[0]) < STRAIGHT) & (speed > LEAST_SPEED)
    count = len(t) if straight.all() else int(np.argmin(straight))
    if count < 2 or t[count - 1] - t[0] < SHORTEST:
        return None
    first, end = float(t[0]), float(t[count - 1])
    inside = rows[(sensors.imu.t[rows] > first) & (sensors.imu.t[rows] <= end)]
    span = float(sensors.imu.dt[inside].sum())
    turn_n = np.array([0.0, 0.0, (course[count - 1] - course[0]) / span])
    turn_b = rotation.rotate(rotation.conjugate(initial.q_nb), turn_n)
    mean = sensors.imu.dtheta_b[inside].sum(axis=0) / span
    return TurnOn(mean - turn_b, TURNED_SD / span, float(fixes.t_arrival[used[count - 1]]))
