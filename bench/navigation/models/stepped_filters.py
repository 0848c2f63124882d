"""Filters in Python that advance step by step through a record in pieces.

They compare a measurement with the state at its arrival, however late: all answers are final up to the last
sample, and nothing waits for what may come.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import EventRow, InitialState, NavSolution, SensorData
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.earthbound import Earthbound
from bench.navigation.engine.piecewise import answer_now
from bench.navigation.engine.session import Kept, SessionState, require
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter.aiding_sensors import AidingSensor
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.step_entries import GO_ON, OUTPUT

_STRIDE = 0.1  # so far a filter goes at once: planning costs as much as taking some samples [s]


class Measurement(NamedTuple):
    """One measurement."""

    kind: int  # as `measurement_rows` numbers them
    values: FloatArray  # (9,), of a fix with its antenna
    variance: FloatArray  # (6,)


class SteppedFilter(SessionState, ABC):
    """A filter that is stepped in Python: its state, prediction and update."""

    shapes: tuple[tuple[int, ...], ...]  # of what it answers
    one_antenna: bool  # for all of a record

    @abstractmethod
    def increments(self, increments_b: FloatArray) -> Sequence[Any] | FloatArray:
        """Return increments (K, 3), b, as :meth:`step` takes them, one by one."""

    @abstractmethod
    def begin(self, dt: float, dtheta: Any) -> None:
        """Store the rate of the first step before it is processed, for measurements at the start."""

    @abstractmethod
    def step(self, now: float, dt: float, dtheta: Any, dvel: Any, unknown: FloatArray, due: bool) -> None:
        """Advance by a step.

        ``unknown`` (2,) is the variance of velocity and attitude that a gap adds. After a step that is
        ``due`` something is measured or answered.
        """

    @abstractmethod
    def measure(self, now: float, arrived: list[Measurement]) -> None:
        """Use the measurements that arrived."""

    @abstractmethod
    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return the output as arrays of the :attr:`shapes`, which are stored."""

    @abstractmethod
    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return a solution of outputs (M, ...) at t (M,) [s], with the innovations since the last call."""


class SteppedPassage(SessionState):
    """A filter for a record in pieces (`piecewise.InPieces`).

    The schedule begins where the filter is; it does not compensate latency. ``aiding`` are the sensors in
    use, read for a ``layout`` of the filter.
    """

    flight: Kept[SteppedFilter]
    schedule: Kept[Schedule]
    antenna_b: Kept[FloatArray]
    begun: Kept[bool]  # it has seen the rate of the first step
    bound: Kept[Earthbound]

    def __init__(
        self,
        flight: SteppedFilter,
        schedule: Schedule,
        aiding: Sequence[AidingSensor],
        first: SensorData,
        initial: InitialState,
        layout: StateLayout,
    ) -> None:
        self.flight, self.schedule, self.aiding = flight, schedule, aiding
        self.initial, self.layout, self.antenna_b = initial, layout, first.antenna_b
        self.begun, self.bound = False, Earthbound()

    @property
    def end(self) -> float:
        """Time of the last processed IMU sample, or of the start [s]."""
        return self.schedule.end

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Process the next piece; return its part of the solution."""
        if not np.array_equal(self.antenna_b, piece.antenna_b):
            if self.flight.one_antenna:
                raise EstimatorError("this filter cannot change to another antenna: loose-* and ukf can")
            self.antenna_b = piece.antenna_b
        self.schedule.take(piece, last=last)
        for sensor in self.aiding:
            self.schedule.add(sensor, piece, self.initial, self.layout)
        if not last and self.schedule.end - self.schedule.t < _STRIDE:
            return self._solution(np.empty(0), np.empty(0, np.int64), (), last=False)
        return self._go()

    def current(self, head: SensorData) -> NavSolution:
        """Return the solution at the end as if the record ended there."""
        wanted = self.schedule.output_t
        self.schedule.output_t = wanted[wanted < self.end - TIME_TOLERANCE]
        return answer_now(self, head)

    def check(self) -> None:
        """Check that stored measurements are of the sensors in use."""
        known = {sensor.kind for sensor in self.aiding}.issuperset(self.schedule.waiting.kind.tolist())
        require(known, "waiting/kind", "must be the sensors of the filter")

    def _go(self) -> NavSolution:
        """Process the samples received so far; return the final part of the solution."""
        schedule, flight = self.schedule, self.flight
        last, plan = schedule.last, schedule.plan()
        steps, count = plan.steps, plan.go_to + 1
        arrived: dict[int, list[Measurement]] = {}
        asked: dict[int, int] = {}
        for k, action, kind, row, _ in plan.entries.tolist():
            if action == OUTPUT:
                asked[k] = asked.get(k, 0) + 1
            elif action != GO_ON:
                arrived.setdefault(k, []).append(Measurement(kind, plan.measured[row], plan.variance[row]))
        answers = list[tuple[FloatArray, ...]]()

        def serve(k: int, now: float) -> None:
            if k in arrived:
                flight.measure(now, arrived[k])
            if k in asked:
                answers.extend([flight.answer(now)] * asked[k])
                schedule.events += self.bound.end_answers(np.full(1, now), answers[-1][0][None])

        rows, share = steps.row[:count], steps.share[:count, None]
        turns, gains = (flight.increments(one[rows] * share) for one in (steps.dtheta_b, steps.dvel_b))
        spans = steps.span[:count].tolist()
        if count and not self.begun:
            flight.begin(spans[0], turns[0])
            self.begun = True
        serve(-1, schedule.t)
        unknown = steps.unknown
        for k, now in enumerate(steps.t[:count].tolist()):
            if now > self.bound.left:
                break
            flight.step(now, spans[k], turns[k], gains[k], unknown[k], k in arrived or k in asked)
            serve(k, now)
        wanted, due = schedule.output_t, plan.outputs
        t = schedule.advance(plan)
        at = np.arange(len(t)) if len(due) == len(t) else np.searchsorted(t, wanted[due])
        return self._solution(t, at, answers, last=last)

    def _solution(
        self, t: FloatArray, at: IntArray, answers: Sequence[tuple[FloatArray, ...]], *, last: bool
    ) -> NavSolution:
        """Return answers as the rows ``at`` (A,) of a solution at epochs t (M,) [s], NaN in the others."""
        columns = [np.full((len(t), *shape), np.nan) for shape in self.flight.shapes]
        for column, values in zip(columns, zip(*answers, strict=True), strict=False):
            column[at[: len(values)]] = values
        self.bound.end_answers(t, *columns)
        events, self.schedule.events = self.schedule.events, []
        return self.flight.solution(t, columns, events, last=last)
