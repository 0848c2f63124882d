"""Start with an unknown heading: one filter for each of several headings, until motion selects one.

A filter that is linear in the heading error is good for about 15 deg. With a larger error the products of
heading and tilt error that it neglects look like information: at rest it becomes sure of a wrong heading and
a wrong tilt. Here each heading psi_k is a hypothesis with its own filter. Its weight follows from the
innovations z of covariance S,

    w_k ~ p(psi_k) prod exp(-z' S^-1 z / 2) / sqrt(prod S_ii)

Until one filter stands for all, the estimate is that of one hypothesis, with the mean square of its error
over all of them. With d the rotation from hypothesis k to the estimate and e the error of hypothesis k, the
attitude error is log(exp(d) exp(e)) = d + J(d) e, J the inverse right Jacobian of rotations (J. Sola, J.
Deray, D. Atchuthan, A micro Lie theory for state estimation in robotics, 2018, eq. 144).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import fields, replace
from typing import Any, cast

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.earth import EARTH_RATE, difference_n
from bench.core.records.data import (
    TIME_OFFSET,
    EventRow,
    Events,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
    no_innovations,
)
from bench.navigation.engine.piecewise import (
    InPieces,
    KnowsImuErrors,
    MayLoseHeading,
    answer_now,
    join_solutions,
    join_tables,
    take_answers,
)
from bench.navigation.engine.record_cuts import cut_piece, first_sample, longest_wait, newest_sample
from bench.navigation.engine.session import Kept, SessionState, require
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.error_state_filter.error_state import PHI, POS, VEL, less_errors
from bench.navigation.error_state_filter.measurement_rows import SENSORS
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD, may_stand
from bench.navigation.start.leveling import bias_sd

LINEAR = float(np.deg2rad(15.0))  # sd of a heading up to which one linear filter is good [rad]
COUNT = 16  # hypotheses around the circle
SD = np.pi / COUNT  # of the heading of each: half the distance to the next, so that their sum is flat to 2 %
FIRST = 60.0  # length of the first trial [s]; each further one is twice as long
AHEAD = 2.0  # a hypothesis becomes the estimate when it is this much more likely than the present one
MOST_NIS = 30.0  # that a measurement counts with: an outlier decides nothing
ASSUMED = ("zero_velocity", "zero_rate", "course")  # no measurements; wrong in steady flight, or in wind
_APART = 0.5  # spread of the hypotheses, over the sd of the best, from which on it stands for all

_PASSED = 2.0  # that a filter is at most behind what may still come late [s]

Begin = Callable[[SensorData, InitialState, list[EventRow]], InPieces]


def heading_is_unknown(initial: InitialState) -> bool:
    """Return whether the heading is too uncertain for one linear filter."""
    return bool(initial.cov[8, 8] > LINEAR**2)


class ManyHeadings(SessionState):
    """A filter from headings around the circle, until one hypothesis replaces all (`InPieces`).

    Innovations belong to the hypothesis that is the estimate, events to the last hypothesis left. ``begin``
    is `piecewise.RunsInPieces.in_pieces` of the filter, from a start with a known heading; the other
    parameters are its parameters.
    """

    log: Kept[FloatArray]  # (COUNT,) logarithms of the weights
    span: Kept[float]  # after which the hypotheses are told apart next [s]
    best: Kept[int]  # the estimate at the last answer
    complete: Kept[bool]  # one stands for all
    apart: Kept[tuple[float, float]]  # spread of the hypotheses, and the sd of the best, then [rad]
    events: Kept[list[list[EventRow]]]
    tables: Kept[list[Innovations]]  # since the last answer
    later: Kept[FloatArray]  # answers wanted after the last sample [s]
    members: Kept[list[InPieces]]
    settled: Kept[float]  # when all had lost the heading, else when one was chosen; -inf before it [s]

    def __init__(
        self, begin: Begin, first: SensorData, initial: InitialState, events: list[EventRow]
    ) -> None:
        turns = 2.0 * np.pi / COUNT * (np.arange(COUNT) - COUNT // 2)
        sd = np.sqrt(initial.cov[8, 8])
        self.log = np.zeros(COUNT) if sd >= UNKNOWN_HEADING_SD else -0.5 * (turns / sd) ** 2
        self.starts = [turn_heading(initial, turn) for turn in turns]
        self.members = [begin(first, start, []) for start in self.starts]
        e_rate = EARTH_RATE * np.cos(initial.lla[0])
        can_gyrocompass = bias_sd(first.specs.imu.gyro, 0.0) < UNKNOWN_HEADING_SD * e_rate
        self.by_rest = list(SENSORS) if can_gyrocompass else ["magnetometer"]
        self.start, self.span = initial.t, FIRST
        self.best, self.complete = COUNT // 2, False  # the heading that was given, before the first answer
        self.apart, self.later = (np.inf, SD), np.empty(0)
        self.settled = -np.inf
        self.events, self.tables = [list(events) for _ in turns], [no_innovations() for _ in turns]

    @property
    def end(self) -> float:
        """Time of the last processed IMU sample, or of the start [s]."""
        return self.members[0].end

    @property
    def heading_lost_at(self) -> float | None:
        """Time of the first motion without a heading [s], or None (`piecewise.MayLoseHeading`).

        The time of the hypothesis that loses it last, because later data can change which one is best.
        """
        lost = [cast("MayLoseHeading", one).heading_lost_at or np.inf for one in self.members]
        last = max(self.settled, *lost)
        return last if np.isfinite(last) else None

    @property
    def heading_vague(self) -> bool:
        """Whether the sigma of the heading is above `headings.LINEAR`."""
        return cast("MayLoseHeading", self.members[0 if self.complete else self.best]).heading_vague

    def steady_errors(self) -> tuple[FloatArray, FloatArray]:
        """Return the steady errors of the hypothesis that is the estimate (`piecewise.KnowsImuErrors`)."""
        return cast("KnowsImuErrors", self.members[0 if self.complete else self.best]).steady_errors()

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Take the next piece; return the answers that are final (`piecewise.InPieces`)."""
        if self.complete:
            return self.members[0].update(piece, look_back, last=last)
        wait = max(look_back, longest_wait(piece)) if last else look_back
        wanted, newest = np.append(self.later, piece.output_t), newest_sample(piece)
        reached = np.inf if last else max(self.end, newest)
        self.later = wanted[wanted > reached]
        rest, found = replace(piece, output_t=wanted[wanted <= reached]), list[NavSolution]()
        while not self.complete:  # not much further than to where they may be told apart
            until = max(self.start + self.span + wait + 2.0 * _PASSED, first_sample(rest))
            if newest <= until:
                break
            ahead = np.flatnonzero(rest.imu.t > until)
            part = cut_piece(rest, np.setdiff1d(np.arange(len(rest.imu)), ahead), -np.inf, until)
            rest = cut_piece(rest, ahead, until, np.inf)
            found += self._step(part, wait, last=False)
        if self.complete:
            found.append(self.members[0].update(rest, look_back, last=last))
        else:
            found += self._step(rest, look_back, last=last)
        return join_solutions(found)

    def _step(self, part: SensorData, look_back: float, *, last: bool) -> list[NavSolution]:
        """Feed a part to all hypotheses; return their joint estimate, or the estimate of the last."""
        solutions = [member.update(part, look_back, last=last) for member in self.members]
        for k, solution in enumerate(solutions):
            self.tables[k] = join_tables([one for one in (self.tables[k], solution.innovations) if len(one)])
            self.events[k] += solution.events.rows()
        t, found, done = solutions[0].t, list[NavSolution](), 0
        while True:
            until = self.start + self.span
            due = int(np.searchsorted(t, until, side="right"))
            found.append(self._estimate([take_answers(one, slice(done, due)) for one in solutions]))
            done = due
            passed = self.end - (0.0 if last else look_back + _PASSED)
            if self.end <= until or (done == len(t) and passed <= until):
                break
            spread, own = self.apart
            if spread < _APART * own:
                text = f"settled by {until:.0f} s, sd {np.rad2deg(own):.2g} deg"
                found.append(self._end(take_answers(solutions[self.best], slice(done, None)), until, text))
                self.settled = self.heading_lost_at or until
                self.members = [self.members[self.best]]
                self.complete = True
                return found
            self.span *= 2.0
        if last:
            rest = take_answers(solutions[self.best], slice(done, None))
            found.append(self._end(rest, self.end, "no motion showed it"))
        return found

    def _end(self, solution: NavSolution, until: float, text: str) -> NavSolution:
        """Return the next answers of the best hypothesis, with its innovations and events so far."""
        event = (self.start, until, "alignment", f"heading unknown: {COUNT} hypotheses; {text}")
        events = Events.from_rows([*self.events[self.best], event])
        return replace(solution, innovations=self.tables[self.best], events=events)

    def _estimate(self, parts: list[NavSolution]) -> NavSolution:
        """Return the estimate of all hypotheses at the next answers, with the innovations until the last."""
        t = parts[0].t
        if not len(t):
            return replace(parts[0], innovations=no_innovations(), events=Events.from_rows([]))
        with np.errstate(all="ignore"):  # a hypothesis that is lost may say anything; its weight is 0
            rest = may_stand(parts[0].vel_n, parts[0].cov)
            log, tables, rows = np.empty((COUNT, len(t))), list[Innovations](), list[IntArray]()
            for k, table in enumerate(self.tables):
                count = int(np.searchsorted(table.t, t[-1] + TIME_TOLERANCE, side="right"))
                used, self.tables[k] = (
                    _take_table(table, part) for part in (slice(count), slice(count, None))
                )
                of = np.searchsorted(t, used.t - TIME_TOLERANCE)
                total = np.cumsum(np.append(self.log[k], gains(used, rest[of], self.by_rest)))
                log[k], self.log[k] = total[np.searchsorted(of, np.arange(len(t)), side="right")], total[-1]
                tables.append(used)
                rows.append(of)
            weight = shares(log)
            leader = leading(weight, self.best)
            self.best = int(leader[-1])
            self.apart = heading_spread(parts, weight, self.best)
            led = [_take_table(tables[k], np.flatnonzero(leader[rows[k]] == k)) for k in range(COUNT)]
            order = np.argsort(
                np.concatenate([rows[k][leader[rows[k]] == k] for k in range(COUNT)]), kind="stable"
            )
            table = join_tables([one for one in led if len(one)])
            return replace(_combine(parts, weight, leader), innovations=_take_table(table, order))

    def current(self, head: SensorData) -> NavSolution:
        """Return the solution at the end as if the record ended there."""
        self.later = np.empty(0)
        return self.members[0].current(head) if self.complete else answer_now(self, head)

    def make_parts(self) -> None:
        """Keep one hypothesis alone once it represents all."""
        if self.complete:
            require(0 <= self.best < len(self.members), "best", "must be one of the hypotheses")
            self.members = [self.members[self.best]]

    def check(self) -> None:
        """Check the restored index of the best hypothesis, and the time of the next comparison."""
        require(0 <= self.best < len(self.log), "best", "must be one of the hypotheses")
        require(self.span > 0, "span", "must be positive")


def turn_heading(initial: InitialState, turn: float) -> InitialState:
    """Return an initial state conditioned on another heading with the sigma ``SD``.

    A tilt found by the accelerations over ground depends on the heading: the same force is felt along other
    axes. With m the tilt by a small error of the heading, it is ``m sin(turn) + e_D x m (1 - cos(turn))``
    less, whatever the turn. What else is not known of the tilts turns with the aircraft.
    """
    cov = initial.cov
    by_heading = cov[:, 8] / cov[8, 8]
    error = -turn * by_heading
    m = by_heading[PHI : PHI + 2]
    error[PHI : PHI + 2] = -np.sin(turn) * m + (1.0 - np.cos(turn)) * np.array([-m[1], m[0]])
    state = np.concatenate([initial.lla, initial.vel_n, initial.q_nb])
    state = less_errors(state, error)
    T = np.eye(9)
    T[PHI : PHI + 2, PHI : PHI + 2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    rest = T @ (cov - cov[8, 8] * np.outer(by_heading, by_heading)) @ T.T
    bias_cov = T @ (initial.bias_cov - np.outer(by_heading, initial.bias_cov[8]))
    return replace(
        initial,
        lla=state[:3],
        vel_n=state[3:6],
        q_nb=state[6:],
        cov=rest + SD**2 * np.outer(by_heading, by_heading),
        bias_cov=bias_cov,
    )


def _take_table(table: Innovations, rows: slice | IntArray) -> Innovations:
    """Return some rows of a table."""
    names = [f.name for f in fields(Innovations) if f.name != "sensor"]
    return replace(table, **{name: getattr(table, name)[rows] for name in names})


def gains(table: Innovations, rest: BoolArray, by_rest: list[str]) -> FloatArray:
    """Return the contribution of each innovation (K,) to the log weight of its hypothesis.

    Until a time at which the aircraft may stand, ``rest`` (K,), only the sensors ``by_rest`` count: in
    others noise and the drift of the filter lie along some heading by chance, and the filter would take them
    for motion.
    """
    gain = -0.5 * (np.where(table.component == 0, np.minimum(table.nis, MOST_NIS), 0.0) + np.log(table.S))
    name = np.array(table.sensor, dtype=str)[table.code]
    gain[np.isin(name, ASSUMED) | (rest & ~np.isin(name, by_rest))] = 0.0
    return np.asarray(np.where(np.isfinite(gain), gain, -np.inf))


def shares(log: FloatArray) -> FloatArray:
    """Return the weights (COUNT, M) by their logarithms, the same for an answer alone and among others."""
    weight = np.exp(log - log.max(axis=0))
    return np.asarray(weight / np.cumsum(weight, axis=0)[-1])  # ``sum`` adds a single column in another order


def leading(weight: FloatArray, now: int) -> IntArray:
    """Return which hypothesis is the estimate at each time; it changes only for a much likelier one."""
    leader = np.empty(weight.shape[1], np.int64)
    for j, column in enumerate(weight.T):
        if column.max() > AHEAD * column[now]:
            now = int(column.argmax())
        leader[j] = now
    return leader


def _combine(members: list[NavSolution], weight: FloatArray, leader: IntArray) -> NavSolution:
    """Return the states of the leading hypothesis, with the covariance of all about them, without events."""
    rows = np.arange(weight.shape[1])

    def led(name: str) -> FloatArray:
        return np.stack([getattr(member, name) for member in members])[leader, rows]

    values = {name: led(name) for name in ("lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "extra")}
    cov, variance = np.zeros((len(rows), 9, 9)), np.zeros_like(values["extra"])
    clock = [k for k, name in enumerate(members[0].extra_names) if name == TIME_OFFSET]
    offset = np.zeros((len(rows), 9)) if clock else None
    for member, w in zip(members, weight, strict=True):
        d = np.empty((len(rows), 9))
        d[:, POS:VEL] = difference_n(values["lla"], member.lla)
        d[:, VEL:PHI] = values["vel_n"] - member.vel_n
        turn = rotation.multiply(values["q_nb"], rotation.conjugate(member.q_nb))
        d[:, PHI:] = rotation.to_rotvec(turn)
        J = np.tile(np.eye(9), (len(rows), 1, 1))
        J[:, PHI:, PHI:] = inverse_jacobian(d[:, PHI:])
        square = J @ member.cov @ np.swapaxes(J, 1, 2) + d[:, :, None] * d[:, None, :]
        apart = values["extra"] - member.extra
        cov += np.where(w > 0, w, 0.0)[:, None, None] * np.where(w[:, None, None] > 0, square, 0.0)
        variance += np.where(w[:, None] > 0, w[:, None] * (member.extra_sd**2 + apart**2), 0.0)
        if offset is not None and member.offset_cov is not None:
            own = np.einsum("kij,kj->ki", J, member.offset_cov) + d * apart[:, clock]
            offset += np.where(w[:, None] > 0, w[:, None] * own, 0.0)
    found: dict[str, Any] = {**values, "cov": cov, "extra_sd": np.sqrt(variance), "offset_cov": offset}
    return replace(members[0], **found, events=Events.from_rows([]))


def inverse_jacobian(d: FloatArray) -> FloatArray:
    """Return J (M, 3, 3) of rotation vectors d (M, 3) up to pi: log(exp(d) exp(e)) = d + J e."""
    angle = np.linalg.norm(d, axis=1)
    half = 0.5 * np.maximum(angle, 1e-3)
    second = (1.0 - half / np.tan(half)) / (4.0 * half * half)
    cross = rotation.skew(d)
    J: FloatArray = np.eye(3) + 0.5 * cross + second[:, None, None] * (cross @ cross)
    return J


def heading_spread(members: list[NavSolution], weight: FloatArray, best: int) -> tuple[float, float]:
    """Return the rms distance of hypotheses from the best at the last epoch, and the best's sigma [rad]."""
    last = [member.q_nb[-1] for member in members]
    apart = [rotation.to_rotvec(rotation.multiply(last[best], rotation.conjugate(q)))[2] for q in last]
    spread = np.nansum(weight[:, -1] * np.square(apart))
    return float(np.sqrt(spread)), float(np.sqrt(members[best].cov[-1, 8, 8]))
