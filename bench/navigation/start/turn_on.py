"""A large turn-on bias of the gyros, estimated in the first seconds before the linear filter starts.

In straight flight no measurement shows the heading. A bias of degrees per second turns it by tens of degrees
until the first turn, and a linear filter is then lost. So the mean rate over a segment in which the course
stays is taken for the bias: the attitude of a vehicle that flies or drives straight changes little. At rest
it does not change at all. The filter begins again at the start with what is left of the bias, first after
1.5 s and then with what a longer segment tells; answers that were given are not changed. What is left is
learnt while the course stays (`steady_course`). A start in a turn has no such segment: see `turning_start`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import cast

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.navigation.engine import timeline
from bench.navigation.engine.kept_rows import take_rows
from bench.navigation.engine.piecewise import (
    InPieces,
    KnowsImuErrors,
    MayLoseHeading,
    join_solutions,
    take_after,
)
from bench.navigation.engine.record_cuts import (
    cut_piece,
    join_pieces,
    longest_wait,
    newest_sample,
    take_head,
)
from bench.navigation.engine.session import Kept, Replaced, SessionState
from bench.navigation.error_state_filter import standstill
from bench.navigation.error_state_filter.standstill import StandstillDetector
from bench.navigation.start import turning_start
from bench.navigation.start.course import LEAST_SPEED
from bench.navigation.start.steady_course import (
    FIRST,
    STANDS,
    STILL,
    STRAIGHT,
    TURNED_SD,
    gyro_error_sd,
    warming_sd,
)

LARGE = float(np.deg2rad(0.3))  # sd of a bias that turns the heading by 18 deg in a minute [rad/s]
STEPS = (1.5, 2.5, 3.5, 5.0, 10.0, FIRST)  # after the start, when the segment so far is looked at [s]
SHORTEST, FIRST_LOOK = 5.0, 0.9  # segment that has ended; one that goes on, which a longer one replaces [s]
MOST = 5.0  # sd; no unit errs by more

Run = Callable[[SensorData, InitialState, float | None], NavSolution]
Begin = Callable[[SensorData, InitialState, list[EventRow], float | None], InPieces]


@dataclass(frozen=True, slots=True)
class TurnOn:
    """A bias of the gyros with its uncertainty."""

    bias_b: FloatArray  # (3,) [rad/s], b
    sd: float  # [rad/s]
    until: float  # end of the segment that it comes from [s]
    turning: bool = False  # that is no straight


class FromTurnOn(SessionState):
    """A filter for gyro increments with a large bias removed (`InPieces`).

    While the segment goes on it takes the record so far once more, from the start, whenever the bias is known
    better: in the first seconds a bias of 10 deg/s is beyond what a linear filter can learn. Where the course
    leaves it begins near the bias that :mod:`turning_start` finds.

    ``begin`` returns the filter of `piecewise.RunsInPieces.in_pieces`, from what that takes and the sd of
    what is left of the bias [rad/s]; None: that of the datasheet. The attitude at the start is given.
    """

    record: Replaced[SensorData]  # from the start on, until the segment has ended
    step: Kept[int]  # of `STEPS`, that is to come
    found: Kept[TurnOn | None]
    told: Kept[float]  # until then the filter before has told its innovations [s]
    filter: Kept[InPieces]

    def __init__(
        self, begin: Begin, first: SensorData, initial: InitialState, events: list[EventRow]
    ) -> None:
        self._begin, self.head, self.initial = begin, take_head(first), initial
        self.record, self.step, self.found, self.told = self.head, 0, None, -np.inf
        self.filter = begin(self.head, initial, events, None)

    @property
    def end(self) -> float:
        """Time of the last processed IMU sample, or of the start [s]."""
        return self.filter.end

    @property
    def heading_lost_at(self) -> float | None:
        """Time of the first motion without a heading [s], or None (`piecewise.MayLoseHeading`)."""
        return cast("MayLoseHeading", self.filter).heading_lost_at

    @property
    def heading_vague(self) -> bool:
        """Whether the sigma of the heading is above `headings.LINEAR`."""
        return cast("MayLoseHeading", self.filter).heading_vague

    def steady_errors(self) -> tuple[FloatArray, FloatArray]:
        """Return the steady errors of the filter plus the bias found before (`piecewise.KnowsImuErrors`)."""
        mean, sd = cast("KnowsImuErrors", self.filter).steady_errors()
        return mean + (0.0 if self.found is None else np.append(self.found.bias_b, np.zeros(3))), sd

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Take the next piece; return the answers that are final (`piecewise.InPieces`)."""
        if not np.array_equal(self.head.antenna_b, piece.antenna_b):
            self.step = len(STEPS)  # the record from the start is of another antenna
        parts: list[NavSolution] = []
        if self.step < len(STEPS):
            self.record = join_pieces(self.record, piece)
        while self.step < len(STEPS):
            due = self.initial.t + STEPS[self.step]
            if newest_sample(self.record) < due:
                break
            self.step += 1
            near = np.zeros(3) if self.found is None else self.found.bias_b
            found = find_turn_on(self.record, self.initial, due)
            found = found or find_turning(self.record, self.initial, due, near)
            if self.is_other(found):
                before, piece = _until(piece, due), _after(piece, due)
                solution = self._take(before, 0.0, last=True)
                events = [*solution.events.rows(), _event(self.initial, found, due)]
                parts.append(replace(solution, events=Events.from_rows(events)))
                self.found, self.told = found, due
                self.make_parts()
                again = replace(_until(self.record, due), output_t=np.empty(0))
                self._take(again, max(look_back, longest_wait(piece)), last=False)  # all of it is told
        if self.step == len(STEPS):
            self.record = self.head
        return join_solutions([*parts, self._take(piece, look_back, last=last)])

    def _take(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        return self._own(self.filter.update(self._less(piece), look_back, last=last))

    def is_other(self, found: TurnOn | None) -> bool:
        """Return whether a new estimate of the bias replaces the one in use."""
        if found is None or self.found is None:
            return found is not self.found
        return found.turning != self.found.turning or found.sd < self.found.sd

    def _less(self, piece: SensorData) -> SensorData:
        return piece if self.found is None else _take_off(self.found, piece)

    def _own(self, solution: NavSolution) -> NavSolution:
        return (
            solution
            if self.found is None
            else _give_back(self.found, take_after(-np.inf, self.told, solution))
        )

    def current(self, head: SensorData) -> NavSolution:
        """Return the solution at the end as if the record ended there."""
        return self._own(self.filter.current(self._less(head)))

    def make_parts(self) -> None:
        """Make the filter before or after the segment."""
        self.filter = self._begin(self.head, self.initial, [], self.found.sd if self.found else None)


def _until(record: SensorData, t: float) -> SensorData:
    """Return the part of a record until a time [s]."""
    return cut_piece(record, np.flatnonzero(~(record.imu.t > t)), -np.inf, t)


def _after(record: SensorData, t: float) -> SensorData:
    """Return the part of a record after a time [s]."""
    return cut_piece(record, np.flatnonzero(record.imu.t > t), t, np.inf)


def may_be_learnt(first: SensorData, initial: InitialState) -> bool:
    """Return whether a turn-on bias is large enough and the attitude at the start is given, not aligned."""
    large = first.specs.imu.gyro.turn_on_bias_sd >= LARGE
    given = initial.alignment == "given" and not initial.bias_cov.any()
    return bool(large and given and first.fixes is not None)


def smooth_from_turn_on(
    run: Run, sensors: SensorData, initial: InitialState
) -> tuple[NavSolution, FloatArray]:
    """Apply `FromTurnOn` to a smoother, with a solution that includes the first segment.

    The second is the bias (3,) of the gyros [rad/s] that it did not see.
    """
    found, near = find_turn_on(sensors, initial), np.zeros(3)
    for step in STEPS if found is None else ():
        if turning := find_turning(sensors, initial, initial.t + step, near):
            found, near = turning, turning.bias_b
    if found is None:
        return run(sensors, initial, None), near
    solution = _give_back(found, run(_take_off(found, sensors), initial, found.sd))
    events = Events.from_rows([_event(initial, found), *solution.events.rows()])
    return replace(solution, events=events), found.bias_b


def _event(initial: InitialState, found: TurnOn | None, due: float = math.inf) -> EventRow:
    if found is None:
        return initial.t, due, "alignment", "turn-on bias of the gyros as before: the course has left"
    way = "the first turn" if found.turning else "their mean rate"
    text = f"turn-on bias of the gyros by {way}, left {np.rad2deg(found.sd):.2g} deg/s"
    return initial.t, found.until, "alignment", text


def _take_off(found: TurnOn, piece: SensorData) -> SensorData:
    imu = piece.imu
    return replace(piece, imu=replace(imu, dtheta_b=imu.dtheta_b - found.bias_b * imu.dt[:, None]))


def _give_back(found: TurnOn, solution: NavSolution) -> NavSolution:
    extra = solution.extra.copy()
    extra[:, :3] += found.bias_b
    return replace(solution, gyro_bias_b=solution.gyro_bias_b + found.bias_b, extra=extra)


def find_turn_on(sensors: SensorData, initial: InitialState, until: float = math.inf) -> TurnOn | None:
    """Return the bias of the gyros by the first straight or standstill; None if it is small or there is none.

    The attitude at the start has to be given. What comes after ``until`` [s] is not looked at.
    """
    until = min(until, initial.t + FIRST)
    fixes, spec = sensors.fixes, sensors.specs.imu
    if fixes is None or not may_be_learnt(sensors, initial):
        return None
    used, _, _ = timeline.fix_rows(fixes, sensors.imu.t, initial.t)
    used = used[(fixes.t_arrival[used] <= until) & np.isfinite(fixes.vel_n[used]).all(axis=1)]
    t, vel_n = fixes.t[used], fixes.vel_n[used]
    speed = np.hypot(vel_n[:, 0], vel_n[:, 1])
    rows, _, _ = timeline.imu_rows(sensors.imu, initial.t, spec)
    if not len(t):
        return None
    height, span, moving = fixes.lla[used, 2], 0.0, speed >= STILL
    if not moving[0]:  # an aircraft rocks on its gear and turns little
        if moving.any():
            t = t[: int(np.argmax(moving))]
            until = float(t[-1]) - standstill.WINDOW  # the next fix saw it move
        inside = rows[sensors.imu.t[rows] <= until]
        detector = StandstillDetector(initial.t, spec, gyro_sd=gyro_error_sd(spec, initial))
        ends, motion_b, _ = detector.take(take_rows(sensors.imu, inside))
        count = standstill.count_steady(
            motion_b[:, :3].reshape(len(ends), 3), None, spec.gyro, warming_sd(FIRST, height, spec, initial)
        )
        ended = bool(moving.any()) or count < len(ends)
        ends, motion_b, span = ends[:count], motion_b[:count], count * standstill.WINDOW
        if span < max(FIRST_LOOK, STANDS * (float(t[-1]) - initial.t)):
            return None  # what hovers may turn
        spread = float(motion_b[:, :3].std(axis=0).max())
        sd, bias_b = math.hypot(standstill.STILL_SD, spread * math.sqrt(span)), motion_b[:, :3].mean(axis=0)
        end = float(ends[-1])
    else:
        course = np.unwrap(np.arctan2(vel_n[:, 1], vel_n[:, 0]))
        straight = (np.abs(course - course[0]) < STRAIGHT) & (speed > LEAST_SPEED)
        ended = not straight.all()
        count = int(np.argmin(straight)) if ended else len(t)
        if count < 2:
            return None
        first, end = float(t[0]), float(t[count - 1])
        inside = rows[(sensors.imu.t[rows] > first) & (sensors.imu.t[rows] <= end)]
        span = float(sensors.imu.dt[inside].sum())
        turn_n = np.array([0.0, 0.0, (course[count - 1] - course[0]) / span])
        turn_b = rotation.rotate(rotation.conjugate(initial.q_nb), turn_n)
        sd, bias_b = TURNED_SD, sensors.imu.dtheta_b[inside].sum(axis=0) / span - turn_b
        height, end = height[:count], float(fixes.t_arrival[used[count - 1]])
    sd = math.hypot(sd / span, warming_sd(span, height, spec, initial))
    before = gyro_error_sd(spec, initial)
    if span < (SHORTEST if ended else FIRST_LOOK) or sd > before:
        return None
    if np.abs(bias_b).max() > MOST * math.hypot(before, sd):  # the vehicle turns, not the unit
        return None
    return TurnOn(bias_b, sd, end)


def find_turning(sensors: SensorData, initial: InitialState, until: float, near: FloatArray) -> TurnOn | None:
    """Return the bias by a start in a turn (:func:`turning_start.find_bias`); None if not usable."""
    if sensors.fixes is None or not may_be_learnt(sensors, initial):
        return None
    before = gyro_error_sd(sensors.specs.imu, initial)
    found = turning_start.find_bias(sensors, initial, until, near)
    if found is None or found[1] > before or np.abs(found[0]).max() > MOST * before:
        return None
    return TurnOn(found[0], found[1], until, turning=True)
