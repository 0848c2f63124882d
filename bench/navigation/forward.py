"""One forward run of the compiled filter: the kernel, its stores, and the solution made of them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from bench.arrays import FloatArray, IntArray, read_only
from bench.compiled import inner, kernel
from bench.data import EventRow, Events, InitialState, Innovations, NavSolution, SensorData, no_innovations
from bench.navigation.aiding import (
    SATELLITE_ROWS,
    SENSORS,
    Gate,
    Log,
    Measurements,
    measure_kernel,
    use_kernel,
)
from bench.navigation.blocks import Index, Process, StateModel
from bench.navigation.cycle import FilterState, ImuSteps, Pending, Work, advance_kernel, work_for
from bench.navigation.error_state import StateLayout
from bench.navigation.ranging import Sky, satellites_kernel
from bench.navigation.rough_heading import add_arm
from bench.navigation.schedule import MEASURE, OUTPUT, USE, Schedule
from bench.wide_rows import widened


class Stores(NamedTuple):
    """What a run stores."""

    state: FloatArray  # (M, n + 1) at each output
    P: FloatArray  # (M, n, n)
    node_t: FloatArray  # (N,) instants of measurements and outputs, for a smoother; none without one
    node_state: FloatArray  # (N, 2, n + 1) before and after the measurements
    node_cov: FloatArray  # (N, 2, n, n)
    transition: FloatArray  # (N, n, n)


@inner
def _keep_kernel(now: FilterState, state: FloatArray, P: FloatArray) -> None:
    """Copy the state of the filter; loops, because copies of slices take the compiler seconds each."""
    n = now.P.shape[0]
    for i in range(n + 1):
        state[i] = now.state[i]
    for i in range(n):
        for j in range(n):
            P[i, j] = now.P[i, j]


@kernel
def _fusion_kernel(
    schedule: IntArray,
    now: FilterState,
    process: Process,
    index: Index,
    steps: ImuSteps,
    data: Measurements,
    sky: Sky,
    pending: Pending,
    gate: Gate,
    log: Log,
    stores: Stores,
    work: Work,
) -> None:
    """Run the filter over a record.

    A row of the schedule is a step (-1: the start), what is done after it, the kind of measurement, its row
    among its kind, and the slot it waits in. ``now`` is the state at the start and becomes the last one.
    """
    n = now.P.shape[0]
    keep = stores.node_t.shape[0] > 0
    k = steps.span.shape[0] * 0 - 1
    e, node, output = 0, 0, 0
    while e < schedule.shape[0]:
        until = schedule[e, 0]
        advance_kernel(k, until, now, process, index, steps, work, pending, keep)
        k = until
        t = steps.t[k]  # the last one serves the start, index -1
        before = work.Phi  # nobody looks there
        if keep:
            before = stores.node_cov[node, 0]
            stores.node_t[node] = t
            _keep_kernel(now, stores.node_state[node, 0], stores.node_cov[node, 0])
            for i in range(n):
                for j in range(n):
                    stores.transition[node, i, j] = work.Phi[i, j]
                    work.Phi[i, j] = 1.0 if i == j else 0.0
        while e < schedule.shape[0] and schedule[e, 0] == until and schedule[e, 1] != OUTPUT:
            action, kind, row, slot = schedule[e, 1], schedule[e, 2], schedule[e, 3], schedule[e, 4]
            first = slot * pending.width
            if action != USE:
                if kind == SATELLITE_ROWS:
                    made = satellites_kernel(row, first, now, data, index, sky, pending, work)
                else:
                    made = measure_kernel(kind, row, first, now, data, index, pending, work)
                pending.live[slot] = made
            if action != MEASURE:
                made = pending.live[slot]
                pending.live[slot] = 0
                use_kernel(t, first, made, now, before, pending, gate, log, work)
            e += 1
        if keep:
            _keep_kernel(now, stores.node_state[node, 1], stores.node_cov[node, 1])
            node += 1
        while e < schedule.shape[0] and schedule[e, 0] == until:
            _keep_kernel(now, stores.state[output], stores.P[output])
            output += 1
            e += 1


@dataclass(frozen=True, slots=True)
class Nodes:
    """A forward run at the instants of its measurements and outputs, for a smoother."""

    layout: StateLayout
    t: FloatArray  # (N,) [s]
    state: FloatArray  # (N, 2, n + 1) before and after: nav state (10), gyro bias, accelerometer bias, extra
    P: FloatArray  # (N, 2, n, n) before and after
    Phi: FloatArray  # (N, n, n) transition of the errors from the node before
    output: IntArray  # (M,) node of each instant of the solution, -1 outside the record


def forward_run(
    sensors: SensorData,
    initial: InitialState,
    model: StateModel,
    schedule: Schedule,
    sky: Sky,
    field: FloatArray,
    names: list[str],
    gate: Gate,
    interval: float,
    keep: bool,
) -> tuple[NavSolution, Nodes]:
    """Return the solution of one pass over a record and, with ``keep``, the nodes a smoother goes back over.

    Parameters
    ----------
    sensors, initial : SensorData, InitialState
        Record and start.
    model : StateModel
        Layout, covariance at the start, processes.
    schedule : Schedule
        Everything to measure.
    sky : Sky
        Satellites, none without tight coupling.
    field : (4, 3) array
        Magnetic field at the start and its change by metre [T], n.
    names : list of str
        Of the channels of the gate.
    gate : Gate
        Tests and their memories (overwritten).
    interval : float
        Of the covariance step [s]; 0: every sample.
    keep : bool
        Store the nodes.
    """
    layout, n = model.layout, model.layout.size
    steps, entries, slots = schedule.order()
    values, variance = schedule.table()
    state = np.concatenate([initial.lla, initial.vel_n, initial.q_nb, model.values[9:]])
    lever = model.index.antenna_b
    if lever >= 0:
        state[lever + 1 : lever + 4] = sensors.antenna_b
    visible = int(np.diff(sky.epoch_start).max(initial=0))
    width = 2 * visible + 6
    size = 7 * len(values) + 2 * len(sky.t)
    log = Log(np.empty((size, 4)), np.empty((size, 4), np.int64), np.zeros(1, np.int64))
    m = len(schedule.outputs)
    at = np.unique(entries[:, 0]) if keep else np.empty(0, np.int64)
    stores = Stores(
        np.empty((m, n + 1)),
        np.empty((m, n, n)),
        np.empty(len(at)),
        np.empty((len(at), 2, n + 1)),
        np.empty((len(at), 2, n, n)),
        np.empty((len(at), n, n)),
    )
    work = work_for(n, len(model.process.drives))
    work.known[:] = model.process.thermal[0], *model.process.range
    if len(steps.t):  # what is measured at the start sees the rate of the first sample
        work.w_ib_b[:] = steps.dtheta_b[steps.row[0]] * steps.share[0] / steps.span[0]
    _fusion_kernel(
        entries,
        FilterState(state, widened(model.P), np.zeros(n)),
        model.process,
        model.index,
        ImuSteps(
            np.append(steps.t, initial.t),  # the last one serves the start, index -1
            steps.span,
            steps.row,
            steps.share,
            steps.unknown,
            read_only(steps.dtheta_b),  # those of the record, or with bridges: of one type for the kernel
            read_only(steps.dvel_b),
            interval,
        ),
        Measurements(values, variance, sensors.antenna_b.copy(), field, initial.lla.copy()),
        sky,
        Pending(
            np.zeros((slots * width, n)),
            np.zeros(slots * width),
            np.zeros(slots * width),
            np.zeros((slots * width, 4), np.int64),
            np.zeros(slots, np.int64),
            width,
        ),
        gate,
        log,
        stores,
        work,
    )
    count = int(log.filled[0])
    numbers, marks = log.numbers[:count], log.marks[:count]
    out_state, out_P = stores.state, stores.P
    if not np.array_equal(schedule.outputs, np.arange(len(sensors.output_t))):
        out_state = np.full((len(sensors.output_t), n + 1), np.nan)
        out_P = np.full((len(sensors.output_t), n, n), np.nan)
        out_state[schedule.outputs], out_P[schedule.outputs] = stores.state, stores.P
    add_arm(out_P, sensors.antenna_b)
    events = schedule.events + refusals(numbers[:, 0], marks, names)
    node = np.full(len(sensors.output_t), -1)
    if keep:
        answered = entries[entries[:, 1] == OUTPUT, 0]
        node[schedule.outputs] = np.searchsorted(at, answered)
    nodes = Nodes(layout, stores.node_t, stores.node_state, stores.node_cov, stores.transition, node)
    table = Events.from_rows(events)
    return solution(sensors.output_t, layout, out_state, out_P, innovations(numbers, marks), table), nodes


def refusals(t: FloatArray, marks: IntArray, names: list[str]) -> list[EventRow]:
    """Return an event for every row of refusals of one channel, from the first to the last instant."""
    events = []
    first = marks[:, 1] == 0
    for channel in np.unique(marks[first & (marks[:, 2] == 0), 3]):
        rows = np.flatnonzero(first & (marks[:, 3] == channel))
        refused = marks[rows, 2] == 0
        edges = np.flatnonzero(np.diff(np.concatenate([[False], refused, [False]]).astype(np.int64)))
        for begin, end in edges.reshape(-1, 2):
            span = float(t[rows[begin]]), float(t[rows[end - 1]])
            text = f"{names[channel]}: {end - begin} in a row refused"
            events.append((*span, "refused", text, names[channel]))
    return sorted(events)


def innovations(numbers: FloatArray, marks: IntArray) -> Innovations:
    """Return the table of the innovations a kernel has logged."""
    if len(numbers) == 0:
        return no_innovations()
    return Innovations(
        t=numbers[:, 0],
        sensor=SENSORS,
        code=marks[:, 0],
        component=marks[:, 1],
        z=numbers[:, 1],
        S=numbers[:, 2],
        nis=numbers[:, 3],
        accepted=marks[:, 2].astype(np.bool_),
    )


def solution(
    t: FloatArray, layout: StateLayout, state: FloatArray, P: FloatArray, table: Innovations, events: Events
) -> NavSolution:
    """Return states (M, n + 1) and covariances (M, n, n) at instants t (M,) as a solution."""
    variance = np.einsum("kii->ki", P)[:, 9:]
    return NavSolution(
        t=t,
        lla=state[:, :3],
        vel_n=state[:, 3:6],
        q_nb=state[:, 6:10],
        gyro_bias_b=state[:, 10:13],
        accel_bias_b=state[:, 13:16],
        cov=P[:, :9, :9],
        extra_names=layout.labels(),
        extra=state[:, 10:],
        extra_sd=np.sqrt(np.where(variance >= 0, variance, np.nan)),
        innovations=table,
        events=events,
    )
