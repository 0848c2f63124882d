"""One forward run of the compiled filter: the kernel, its stores, and the solution from the stores."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner, kernel, make_caller, types_of
from bench.core.compilation.wide_rows import widened
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray, IntArray, read_only
from bench.core.records.data import Events, InitialState, NavSolution, no_events, no_innovations
from bench.navigation.engine.earthbound import Earthbound
from bench.navigation.engine.gate import InnovationLog, Refused, innovations, new_log, refusals
from bench.navigation.engine.session import (
    Kept,
    Replaced,
    Scratch,
    SessionState,
    fork,
    require,
    require_range,
    require_rows,
)
from bench.navigation.engine.timeline import Steps
from bench.navigation.error_state_filter.answers import answers, find_offset, solution, spread
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import (
    SATELLITE_ROWS,
    SENSORS,
    call_rows,
)
from bench.navigation.error_state_filter.measurement_update import Gate, use_kernel
from bench.navigation.error_state_filter.propagation import (
    FilterState,
    Measurements,
    Pending,
    Site,
    Work,
    advance_kernel,
    grown,
    pending_for,
    work_for,
)
from bench.navigation.error_state_filter.ranges.ranging import (
    SkyRows,
    call_satellites,
    place_fillers,
    renew_kernel,
)
from bench.navigation.error_state_filter.ranges.satellite_states import Channels, narrow, widen
from bench.navigation.error_state_filter.rough_heading import add_arm, heading_lost_kernel
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.state_blocks import (
    Process,
    StateModel,
    first_of_satellites,
)
from bench.navigation.error_state_filter.step_entries import GO_ON, MEASURE, OUTPUT, USE

LONGEST = 3
"""Most components of a sub-vector."""


class Stores(NamedTuple):
    """Arrays that a run stores."""

    state: FloatArray  # (M, shown + 1) at each output, but the last states: single satellites
    cov: FloatArray  # (M, 9, 9) of position, velocity, attitude
    variance: FloatArray  # (M, shown - 9) of the states from the gyro bias on
    offset: FloatArray  # (M, 9) covariance of the clock offset of fixes with them, if there is one
    # (N, 2, n + 1) before and after the measurements at the nodes of a smoother; none without one
    node_state: FloatArray
    node_cov: FloatArray  # (N, 2, n, n)
    transition: FloatArray  # (N, n, n)
    clock: int  # index of the clock offset of fixes, or -1


@inner
def _keep_kernel(now: FilterState, state: FloatArray, P: FloatArray) -> None:
    """Copy the state of the filter; loops, because copies of slices take the compiler seconds each."""
    n = now.P.shape[0]
    for i in range(n + 1):
        state[i] = now.state[i]
    for i in range(n):
        for j in range(P.shape[1]):  # what follows a row in memory, too, where there is room for it
            P[i, j] = now.P[i, j]


@inner
def _answer_kernel(now: FilterState, at: int, stores: Stores) -> None:
    """Store the state of the filter as an output."""
    P, cov = now.P, stores.cov[at]
    for i in range(stores.state.shape[1]):
        stores.state[at, i] = now.state[i]
    for i in range(9):
        for j in range(9):
            cov[i, j] = P[i, j]
    for i in range(stores.variance.shape[1]):
        stores.variance[at, i] = P[9 + i, 9 + i]
    if stores.clock >= 0:
        for i in range(9):
            stores.offset[at, i] = P[stores.clock, i]


call_advance = make_caller([advance_kernel])
call_use = make_caller([use_kernel])
_FILLERS: dict[tuple[int, frozenset[int]], IntArray] = {}  # by types, of which equal ones are one object


@kernel
def fusion_kernel(
    schedule: IntArray,
    fillers: IntArray,
    ahead: FloatArray,
    site: Site,
    process: Process,
    steps: Steps,
    interval: float,
    sky: SkyRows,
    gate: Gate,
    log: InnovationLog,
    stores: Stores,
    work: Work,
) -> None:
    """Run the filter over a piece of a record.

    A row of the schedule has the number of a step (-1: the start), what is done after it, the kind of
    measurement, its row among its kind, and the slot in which it waits. The last two ``fillers`` are the
    addresses of `advance_kernel` and `use_kernel`, so that two processes can compile them side by side. An
    answer within a step comes from a copy of the filter, propagated by the part ``ahead`` (M,) of the step.
    With a smoother, the filter itself ends a step of its covariance at each answer, and ``ahead`` is 0.
    ``site`` holds the state at the start, and at the end the last one.
    """
    now, _, index, pending, _ = site
    n = now.P.shape[0]
    carried, step, _, _, update, other = work
    keep = stores.node_state.shape[0] > 0
    k = steps.span.shape[0] * 0 - 1
    e, node, output = 0, 0, 0
    while e < schedule.shape[0]:
        until, action = schedule[e, 0], schedule[e, 1]
        asked = action == OUTPUT and not keep
        peeking = asked and k == until and (ahead[output] > 0.0 or carried.elapsed[0] > 0.0)
        target, part, goes = until, 1.0, now
        if peeking:
            goes = other
            _keep_kernel(now, goes.state, goes.P)
            for i in range(carried.whole.shape[0]):
                carried.kept[i] = carried.whole[i]
            if ahead[output] > 0.0:
                target, part = until + 1, ahead[output]
        closing = peeking or not (asked or action == GO_ON)
        if k < target or closing:
            call_advance(
                fillers[-2], k, target, goes, process, index, steps, interval, work, pending,
                keep, closing, part, peeking,
            )  # fmt: skip
        k = until
        if peeking:
            for i in range(carried.whole.shape[0]):
                carried.whole[i] = carried.kept[i]
            _answer_kernel(goes, output, stores)
            output += 1
            e += 1
        elif asked and ahead[output] == 0.0 and carried.elapsed[0] == 0.0:
            _answer_kernel(now, output, stores)
            output += 1
            e += 1
        elif action == GO_ON:
            e += 1
        if asked or action == GO_ON:
            continue
        t = steps.t[k]  # the last one serves the start, index -1
        before, f = step.Phi, e  # unused without a smoother
        while f < schedule.shape[0] and schedule[f, 0] == until and schedule[f, 1] < OUTPUT:
            if schedule[f, 2] == SATELLITE_ROWS and schedule[f, 1] != USE:
                renew_kernel(schedule[f, 3], now, step.Phi, index, pending, sky)
            f += 1
        if keep:
            before = stores.node_cov[node, 0]
            _keep_kernel(now, stores.node_state[node, 0], stores.node_cov[node, 0])
            for i in range(n):
                for j in range(n):
                    stores.transition[node, i, j] = step.Phi[i, j]
                    step.Phi[i, j] = 1.0 if i == j else 0.0
        while e < schedule.shape[0] and schedule[e, 0] == until and schedule[e, 1] < OUTPUT:
            action, kind, row, slot = schedule[e, 1], schedule[e, 2], schedule[e, 3], schedule[e, 4]
            first = slot * pending.width
            if action != USE:
                fill = fillers[kind]
                if kind == SATELLITE_ROWS:
                    made: int = call_satellites(fill, row, first, site, sky)
                else:
                    made = call_rows(fill, row, first, site)
                pending.live[slot] = made
            if action != MEASURE:
                made = pending.live[slot]
                pending.live[slot] = 0
                if (
                    kind <= SATELLITE_ROWS
                    and carried.heading_lost[0] == 0.0
                    and heading_lost_kernel(now.state, now.P)
                ):
                    carried.heading_lost[0] = t
                call_use(fillers[-1], t, first, made, now, before, pending, gate, log, update)
            e += 1
        if keep:
            _keep_kernel(now, stores.node_state[node, 1], stores.node_cov[node, 1])
            node += 1
            while e < schedule.shape[0] and schedule[e, 0] == until and schedule[e, 1] == OUTPUT:
                _answer_kernel(now, output, stores)
                output += 1
                e += 1


@dataclass(frozen=True, slots=True)
class Nodes:
    """A forward run, or a segment of one, at the epochs of its measurements and outputs, for a smoother."""

    layout: StateLayout
    t: FloatArray  # (N,) [s]
    state: FloatArray  # (N, 2, n + 1) before and after: nav state (10), gyro bias, accelerometer bias, extra
    P: FloatArray  # (N, 2, n, n) before and after
    Phi: FloatArray  # (N, n, n) transition of the errors from the node before
    output: IntArray  # (M,) node of each time of its solution, -1 outside the record


class ForwardRun(SessionState):
    """Filter that processes a record.

    ``antenna_b`` is (3,) [m], ``field`` (4, 3) the magnetic field at the start and its change by meter [T],
    n, ``interval`` that of the covariance step [s], 0: every sample. With ``keep`` it stores the nodes of a
    smoother, on disk if the record comes in pieces.
    """

    now: Replaced[FilterState]
    gate: Replaced[Gate]
    pending: Replaced[Pending]
    antenna_b: Replaced[FloatArray]
    moved: Kept[bool]  # it has seen the rate of the first sample
    refused: Replaced[Refused]
    bound: Kept[Earthbound]
    carried: Replaced[FloatArray]  # what the next step needs of the steps before
    work: Scratch[Work]  # of all copies: one of them goes at a time

    def __init__(
        self,
        initial: InitialState,
        model: StateModel,
        antenna_b: FloatArray,
        field: FloatArray,
        gate: Gate,
        interval: float,
        keep: bool,
    ) -> None:
        n = model.layout.size
        self.initial, self.model, self.antenna_b, self.field = initial, model, antenna_b, field
        self.gate, self.interval, self.keep = gate, interval, keep
        state = np.concatenate([initial.lla, initial.vel_n, initial.q_nb, model.values[9:]])
        lever = model.index.antenna_b
        if lever >= 0:
            state[lever + 1 : lever + 4] = antenna_b
        self.now = FilterState(state, widened(model.P), np.zeros(n))
        self.work = work_for(n, model.process.drives)
        self.work.carried.known[:3] = model.process.thermal[0], *model.process.range
        self.carried = self.work.carried.whole.copy()
        self.pending = pending_for(n, 1, 6)
        shown = first_of_satellites(model.index, n)
        none = np.empty((0, shown + 1)), np.empty((0, shown, shown)), no_innovations(), no_events()
        self.nothing = solution(np.empty(0), model.layout, *none)  # without epochs
        self.moved, self.refused, self.bound = False, {}, Earthbound()

    @property
    def warmth(self) -> float:
        """Temperature of the IMU above its reference [K]."""
        self.work.carried.whole[:] = self.carried
        return float(self.work.carried.known[0])

    @property
    def heading_lost_at(self) -> float | None:
        """Time of the first GNSS measurement in motion with an unknown heading [s]; None before it."""
        self.work.carried.whole[:] = self.carried
        return float(self.work.carried.heading_lost[0]) or None

    def check(self) -> None:
        """Check the data that the filter kernel reads."""
        gate, pending = self.gate, self.pending
        channels, slots, width = len(gate.trust.misses), len(pending.live), pending.width
        require(channels >= len(gate.opens), "misses", f"must have at least {len(gate.opens)} rows")
        for name in ("since", "used"):
            same = getattr(gate.trust, name).shape == (channels,)
            require(same, f"gate/trust/{name}", f"must have {channels} rows")
        require(width >= 2 * LONGEST and slots > 0, "pending/width", "must hold a fix")
        require_rows("pending", pending, Pending._fields[:4], slots * width)
        require_range("pending/live", pending.live, width + 1)
        waiting = np.arange(width)[None, :] < pending.live[:, None]
        code, channel, component, length = pending.tags.reshape(slots, width, 4)[waiting].T
        require_range("pending/tags (sensor)", code + 1, len(gate.opens) + 1)  # one that is absent has -1
        require_range("pending/tags (channel)", channel, channels)
        require_range("pending/tags (component)", component, LONGEST)
        require_range("pending/tags (length)", length - 1, LONGEST)

    def go(self, schedule: Schedule, channels: Channels, look_back: float) -> tuple[NavSolution, Nodes]:
        """Return the final part of the solution, and with ``keep`` the nodes for a smoother.

        The schedule forgets what is done. ``look_back`` is how far before the last sample to stop [s]
        (`Schedule.plan`).
        """
        model, keep, names = self.model, self.keep, channels.names
        process, index, n = model.process, model.index, model.layout.size
        shown = first_of_satellites(index, n)
        plan, sky = schedule.plan(look_back), schedule.sky
        steps, entries, start = plan.steps, plan.entries, schedule.t
        steps = steps._replace(
            t=np.append(steps.t, start),  # the last one serves the start, index -1
            dtheta_b=read_only(steps.dtheta_b),  # those of the record, or with bridges: of one type
            dvel_b=read_only(steps.dvel_b),
        )
        visible = int(np.diff(sky.epoch_start).max(initial=0)) if len(sky.t) else 0
        now, pending = fork(self.now), fork(grown(self.pending, plan.slots, 2 * visible + 6))
        gate = fork(self.gate._replace(trust=self.gate.trust.with_channels(len(names), self.initial.t)))
        refused = dict(self.refused)
        if shown < n and not keep and len(used := channels.used(index, n)) < n:
            n = len(used)
            now, pending, gate = narrow(used, now, pending, gate)
            process, index = process.take(used), index.take(used)
        size = 7 * len(plan.variance) + 2 * len(sky.t)
        log = new_log(size)
        m = len(plan.outputs)
        at = np.unique(entries[entries[:, 1] != GO_ON, 0]) if keep else np.empty(0, np.int64)
        whole = schedule.last and start == self.initial.t
        empty = np.empty if whole else disk_arrays.empty
        stores = Stores(
            np.empty((m, shown + 1)),
            np.empty((m, 9, 9)),
            np.empty((m, shown - 9)),
            np.empty((m, 9)),
            empty((len(at), 2, n + 1)),
            empty((len(at), 2, n, n)),
            empty((len(at), n, n)),
            find_offset(model.layout),
        )
        if len(self.work.update.row) != n:
            self.work = work_for(n, process.drives)
        work = self.work
        work.carried.whole[:] = self.carried
        if len(steps.span) and not self.moved:  # measurements at the start see the rate of the first sample
            first = np.stack([steps.dtheta_b[steps.row[0]], steps.dvel_b[steps.row[0]]])
            work.measure.last[:] = first * steps.share[0] / steps.span[0]
            self.moved = True
        data = Measurements(
            plan.measured, plan.variance, self.antenna_b.copy(), self.field, self.initial.lla.copy()
        )
        site = Site(now, data, index, pending, work.measure)
        kinds = frozenset(entries[entries[:, 1] < USE, 2].tolist())
        types = types_of(site, process, steps, self.interval, work, gate, log, keep, sky)
        if (fillers := _FILLERS.get((id(types), kinds))) is None:
            advance = 0, 0, now, process, index, steps, self.interval, work, pending, keep, False, 1.0, False
            use = 0.0, 0, 0, now, work.step.Phi, pending, gate, log, work.update
            parts = (advance_kernel, types_of(*advance)), (use_kernel, types_of(*use))
            fillers = _FILLERS[id(types), kinds] = place_fillers(kinds, site, sky, parts)
        fusion_kernel(
            entries,
            fillers,
            plan.ahead,
            site,
            process,
            steps,
            self.interval,
            sky,
            gate,
            log,
            stores,
            work,
        )
        if n < model.layout.size:
            now, pending, gate = widen(used, now, pending, gate, self.now, self.gate.opens)
        self.now, self.pending, self.gate, self.refused = now, pending, gate, refused
        self.carried = work.carried.whole.copy()
        count = int(log.filled[0])
        numbers, marks = log.numbers[:, :count], log.marks[:, :count]
        wanted = schedule.output_t
        t = schedule.advance(plan)
        state, cov, variance, offset = stores[:4]
        rows = np.searchsorted(t, wanted[plan.outputs])
        add_arm(cov, self.antenna_b)
        events = schedule.events + refusals(numbers[0], marks, names, refused, last=schedule.last)
        answered = t if len(t) == m else t[rows]
        events += self.bound.end_answers(answered, state, cov, variance, offset, every=True)
        if len(t) != m:
            state, cov, variance, offset = (spread(one, rows, len(t)) for one in stores[:4])
        schedule.events = []
        node = np.full(len(t), -1)
        if keep:
            outputs = entries[entries[:, 1] == OUTPUT, 0]
            node[rows] = np.searchsorted(at, outputs)
        nodes = Nodes(model.layout, steps.t[at], *stores[4:7], node)
        table = innovations(SENSORS, numbers, marks)
        late = offset if stores.clock >= 0 else None
        return answers(t, model.layout, state, cov, variance, table, Events.from_rows(events), late), nodes
