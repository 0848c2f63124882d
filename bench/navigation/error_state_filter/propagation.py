"""Propagation between measurements: strapdown at every step, covariance at its own rate.

The arrays a compiled filter works on, by name, and the kernel that moves them in time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner
from bench.core.compilation.wide_rows import wide, widened
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.navigation.engine.late_updates import LateUpdates, late_updates
from bench.navigation.engine.session import Growing
from bench.navigation.engine.timeline import Steps
from bench.navigation.error_state_filter.corrections import (
    constants_kernel,
    factor_kernel,
    increments_kernel,
)
from bench.navigation.error_state_filter.error_state import (
    PHI,
    VEL,
    CovarianceWork,
    accumulate_kernel,
    backward_kernel,
    covariance_kernel,
    covariance_work,
    dynamics_kernel,
    mirror_kernel,
    transition_kernel,
)
from bench.navigation.error_state_filter.rough_heading import (
    second_order_tilt_kernel,
    second_order_velocity_kernel,
    stand_kernel,
    steady_kernel,
)
from bench.navigation.error_state_filter.state_blocks import Index, Process
from bench.navigation.mechanization import STATE_SIZE, body_step_kernel, step_kernel

LATE = 0.1  # mean age of the force by which late fixes are compared: half of a delay of 0.2 s [s]
_SLOW = 0.05
_RECIPROCAL = tuple(1.0 / max(k, 1) for k in range(10))


class FilterState(NamedTuple):
    """The state of the filter: the n + 1 numbers it estimates, and its n error states."""

    state: FloatArray  # (n + 1,) navigation state (10), then the values of the states from the gyro bias on
    P: FloatArray  # (n, n), `bench.core.compilation.wide_rows.wide`
    dx: FloatArray  # (n,) error estimated and not yet fed back


class Pending(NamedTuple):
    """Measurements made and not yet used, a slot of ``width`` rows each: z = H dx + v, var v = r."""

    H: Growing[FloatArray]  # (S width, n)
    z: Growing[FloatArray]  # (S width,)
    r: Growing[FloatArray]  # (S width,)
    # (S width, 4) sensor, channel, component, length of the sub-vector that begins here
    tags: Growing[IntArray]
    live: Growing[IntArray]  # (S,) rows that wait in each slot
    width: int


class MeasureWork(NamedTuple):
    """Memory for filling the rows of a measurement, shared with the steps before it."""

    last: FloatArray  # (2, 3) rate [rad/s] and specific force [m/s^2] of the last step, b, corrected
    force_n: FloatArray  # (3,) the mean force of the last `LATE`, n, where the clock of fixes is estimated
    vectors: FloatArray  # (8, 3) the last three are sums over a step of the covariance
    C: FloatArray  # (3, 3)
    lever: FloatArray  # (3,)
    motion: FloatArray  # (2, 3) the same of the epochs that the measurement is of
    known: FloatArray  # (4,) `Carried.known`
    drives: IntArray  # (D, 3) `Process.drives`
    factor: FloatArray  # (D,) what a drive multiplies its state by in this motion
    constants: FloatArray  # (2, 6) bias and slope (`corrections.constants_kernel`)


class Measurements(NamedTuple):
    """Measurements of all kinds except satellites."""

    values: FloatArray  # (R, 9); columns 6 to 8 of a fix: its antenna [m], b
    variance: FloatArray  # (R, 6)
    antenna_b: FloatArray  # (3,) of the satellites [m], b
    field: FloatArray  # (4, 3) magnetic field at field_lla [T], n, and its change per meter north, east, down
    field_lla: FloatArray  # (3,)


class Site(NamedTuple):
    """State with which measurements are compared, and the memory of their rows of H."""

    now: FilterState
    data: Measurements
    where: Index
    pending: Pending
    work: MeasureWork


class UpdateWork(NamedTuple):
    """Memory of an update."""

    row: FloatArray  # (n,)
    square: FloatArray  # (6, 7)
    late: LateUpdates
    var: FloatArray  # (6,)
    innovation: FloatArray  # (6,)
    turn: FloatArray  # (5, 3) of the axes by a correction
    axes: FloatArray  # (3, 3, 3) C_nb before and after it, and the angles
    drives: IntArray  # (D, 3) `Process.drives`
    factor: FloatArray  # (D,) `Carried.factor`


class Carried(NamedTuple):
    """Data that the next step needs from earlier steps; also the first three of `MeasureWork`."""

    whole: FloatArray  # (67 + D,) memory of all of it
    kept: FloatArray  # (67 + D,) a copy, while a filter goes ahead for an answer
    before: FloatArray  # (7,) the step before, for coning and sculling
    C_mean: FloatArray  # (3, 3)
    reference: FloatArray  # (10,)
    # of the IMU (4,): temperature above reference [K], range of gyros, of accelerometers, and the variance of
    # the noise of the newest sample of a gyro [rad^2/s^2]
    known: FloatArray
    lost: FloatArray  # (2,) variance of velocity and attitude that a gap adds to a step of the covariance
    elapsed: FloatArray  # (1,) since the last step of the covariance [s]
    # (1,) first GNSS measurement of a moving vehicle with an unknown heading [s]; 0 before it
    heading_lost: FloatArray
    factor: FloatArray  # (D,) mean of what a drive multiplies its state by, over that step


class StepWork(NamedTuple):
    """Memory of a step of the covariance."""

    F: FloatArray  # (9, 15)
    G: FloatArray  # (9, 15)
    back: FloatArray  # (9, 15)
    Phi: FloatArray  # (n, n) since the last node of a smoother
    decay: FloatArray  # (n,)
    noise: FloatArray  # (n,)
    factor: FloatArray  # (D,)


class Work(NamedTuple):
    """Memory of the kernels, in small tuples (`bench.core.compilation.compiled`)."""

    carried: Carried
    step: StepWork
    covariance: CovarianceWork
    measure: MeasureWork
    update: UpdateWork
    ahead: FilterState  # of a filter that goes ahead for an answer


def work_for(n: int, drives: IntArray) -> Work:
    """Return the memory for n states and their drives (D, 3)."""
    D = len(drives)
    shapes = (7,), (2, 3), (3,), (8, 3), (3, 3), (STATE_SIZE,), (4,), (2,), (1,), (1,), (D,)
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    whole = np.zeros(ends[-1])
    before, last, force_n, vectors, *others = (
        part.reshape(shape) for part, shape in zip(np.split(whole, ends[:-1]), shapes, strict=True)
    )
    F, G, back = np.zeros((3, 9, 15))
    carried = Carried(whole, np.zeros(ends[-1]), before, *others)
    return Work(
        carried=carried,
        step=StepWork(F, G, back, widened(np.eye(n)), widened(np.ones(n)), np.zeros(n), carried.factor),
        covariance=covariance_work(n),
        measure=MeasureWork(
            last,
            force_n,
            vectors,
            np.zeros((3, 3)),
            np.zeros(3),
            np.zeros((2, 3)),
            carried.known,
            drives,
            np.zeros(D),
            np.ones((2, 6)),
        ),
        update=UpdateWork(
            np.zeros(n),
            np.zeros((6, 7)),
            late_updates(n),
            np.zeros(6),
            np.zeros(6),
            np.zeros((5, 3)),
            np.zeros((3, 3, 3)),
            drives,
            carried.factor,
        ),
        ahead=FilterState(np.zeros(n + 1), wide((n, n)), np.zeros(n)),
    )


def pending_for(n: int, slots: int, width: int) -> Pending:
    """Return the memory for measurements that are made but not yet used."""
    rows = slots * width
    return Pending(
        np.zeros((rows, n)),
        np.zeros(rows),
        np.zeros(rows),
        np.zeros((rows, 4), np.int64),
        np.zeros(slots, np.int64),
        width,
    )


def grown(pending: Pending, slots: int, width: int) -> Pending:
    """Return memory for at least some slots of some rows, with the pending measurements copied."""
    have = len(pending.live)
    if have >= slots and pending.width >= width:
        return pending
    more = pending_for(pending.H.shape[1], max(slots, have), max(width, pending.width))
    for old, new in zip(pending[:4], more[:4], strict=True):
        shape = (-1, more.width, *new.shape[1:])
        new.reshape(shape)[:have, : pending.width] = old.reshape((have, pending.width, *old.shape[1:]))
    more.live[:have] = pending.live
    return more


@inner
def warmth_kernel(T: float, thermal: FloatArray, height: float, known: FloatArray) -> None:
    """Carry the temperature of the IMU over an interval T at a height [m], in air of constant lapse rate."""
    end = thermal[1] + thermal[2] * height
    lag = np.exp(-T / thermal[3]) if thermal[3] > 0.0 else 0.0
    known[0] = end + lag * (known[0] - end)


@inner
def clock_kernel(P: FloatArray, at: int, T: float) -> None:
    """Carry a clock's offset over T by its drift: P becomes Phi P Phi', Phi = I but for [at, at + 1] = T."""
    n = P.shape[0]
    for j in range(n):
        P[at, j] += T * P[at + 1, j]
    for i in range(n):
        P[i, at] += T * P[i, at + 1]


@inner
def mean_force_kernel(T: float, newest: FloatArray, force_n: FloatArray) -> None:
    """Update the mean force over the last `LATE` with a mean force (3,) over T."""
    share = 1.0 - np.exp(-T / LATE)
    if force_n[0] == 0.0 and force_n[1] == 0.0 and force_n[2] == 0.0:
        share = 1.0
    for i in range(3):
        force_n[i] += share * (newest[i] - force_n[i])


@inner
def fade_kernel(x: float) -> float:
    """Return exp(-x), by its series for the usual x below `_SLOW`: the next term is below 1e-17."""
    value = 1.0
    for k in range(9, 0, -1):
        value = 1.0 - x * _RECIPROCAL[k] * value
    return value


@inner
def noise_kernel(
    T: float,
    process: Process,
    clock: int,
    speed: float,
    unknown: FloatArray,
    decay: FloatArray,
    noise: FloatArray,
) -> int:
    """Fill decay and noise (n,) of an interval T, flown at a speed [m/s]; return the first that decays."""
    q, stationary = process.q, process.stationary
    decay_time, decay_distance = process.decay_time, process.decay_distance
    n = noise.shape[0]
    fading: int = n
    for i in range(n):
        noise[i] = (decay_time[i] + decay_distance[i] * speed) * T
        decay[i] = fade_kernel(noise[i])
    for i in range(n - 1, -1, -1):
        if noise[i] > 0.0:
            fading = i
        if noise[i] > _SLOW:
            decay[i] = np.exp(-noise[i])
        noise[i] = q[i] * T if stationary[i] == 0.0 else stationary[i] * (1.0 - decay[i] * decay[i])
    for i in range(3):
        noise[VEL + i] += unknown[0]
        noise[PHI + i] += unknown[1]
    if clock >= 0:
        noise[clock] += q[clock + 1] * T * T * T / 3.0
    return fading


@inner
def wait_kernel(
    T: float, pending: Pending, drives: IntArray, clock: int, work: StepWork, row: FloatArray
) -> None:
    """Propagate the pending rows over an interval, with F, decay and factors from ``work``."""
    width = pending.width
    transition_kernel(work.F, -T, work.back)
    for slot in range(pending.live.shape[0]):
        for a in range(slot * width, slot * width + pending.live[slot]):
            h = pending.H[a]
            backward_kernel(h, work.back, work.decay, drives, work.factor, row)
            if clock >= 0:
                h[clock + 1] -= T * h[clock]


@inner
def advance_kernel(
    k: int,
    until: int,
    now: FilterState,
    process: Process,
    index: Index,
    steps: Steps,
    interval: float,
    work: Work,
    pending: Pending,
    keep: bool,
    closing: bool,
    part: float,
    ahead: bool,
) -> int:
    """Propagate over the steps k + 1 to ``until``, the last one only by a ``part`` (1: completely).

    A step of the covariance ends after an ``interval`` [s], 0: every sample, and with ``closing`` at the end.
    ``ahead``: rows that wait stay as they are. Called by its address, it returns 0.
    """
    state, P = now.state, now.P
    carried, step, memory, measure, update, _ = work
    drives, clock = process.drives, index.clock_offset
    rows, spans, shares, unknown = steps.row, steps.span, steps.share, steps.unknown
    dtheta_b, dvel_b = steps.dtheta_b, steps.dvel_b
    C, C_mean, reference, F, G = measure.C, carried.C_mean, carried.reference, step.F, step.G
    Phi, decay, noise, factor = step.Phi, step.decay, step.noise, step.factor
    before, vectors, lost = carried.before, measure.vectors, carried.lost
    dth, dv, rotvec, dv_start, dv_n, dv_sum, w_sum, f_sum = (
        vectors[0], vectors[1], vectors[2], vectors[3], vectors[4], vectors[5], vectors[6], vectors[7],
    )  # fmt: skip
    known, last = carried.known, measure.last
    bias, slope = measure.constants[0], measure.constants[1]
    driven = drives.shape[0]
    n = P.shape[0]
    waiting = False
    for slot in range(pending.live.shape[0]):
        waiting = waiting or (pending.live[slot] > 0 and not ahead)
    T = carried.elapsed[0]
    while k < until or (closing and T > 0.0):
        moving = constants_kernel(state, drives, known, bias, slope)  # the same up to the end of this step
        while k < until:
            if T == 0.0:
                lost[0], lost[1] = 0.0, 0.0
                for i in range(3):
                    dv_sum[i], w_sum[i], f_sum[i] = 0.0, 0.0, 0.0
                    for j in range(3):
                        C_mean[i, j] = 0.0
                for i in range(STATE_SIZE):
                    reference[i] = state[i]
            k += 1
            row, dt, share, some = rows[k], spans[k], shares[k], 1.0
            if k == until:
                some = part
            dt *= some
            share *= some
            for i in range(3):
                dth[i] = dtheta_b[row, i] * share
                dv[i] = dvel_b[row, i] * share
            increments_kernel(state, dt, drives, moving, known, dth, dv, bias, slope)
            if k == until:  # what measurements see
                for i in range(3):
                    last[0, i], last[1, i] = dth[i] / dt, dv[i] / dt
                known[3] = process.q[PHI] / dt
            if driven > 0:
                for i in range(3):
                    w_sum[i] += dth[i]
                    f_sum[i] += dv[i]
            body_step_kernel(dt, dth, dv, before, rotvec, dv_start)
            step_kernel(state, dt, rotvec, dv_start, C, dv_n)
            T += dt
            lost[0] += unknown[k, 0] * some
            lost[1] += unknown[k, 1] * some
            for i in range(3):
                dv_sum[i] += dv_n[i]
                for j in range(3):
                    C_mean[i, j] += C[i, j] * dt
            if not interval > T:
                break
        if interval > T and not closing:
            break
        for i in range(3):
            dv_sum[i] /= T
            for j in range(3):
                C_mean[i, j] /= T
        if index.time_offset >= 0:
            mean_force_kernel(T, dv_sum, measure.force_n)
        for d in range(driven):
            factor[d] = factor_kernel(drives[d, 2], T, w_sum, f_sum, known) / T
        if driven > 0:
            warmth_kernel(T, process.thermal, state[2], known)
        speed = np.sqrt(reference[3] * reference[3] + reference[4] * reference[4])
        fading = noise_kernel(T, process, clock, speed, lost, decay, noise)
        for i in range(fading, n):
            state[i + 1] *= decay[i]
        dynamics_kernel(reference, C_mean, dv_sum, F)
        steady_kernel(reference, dv_sum, process.q[VEL] / T, F)
        second_order_velocity_kernel(dv_sum, T, P)
        lost_heading = stand_kernel(state, T, P, F, noise)
        transition_kernel(F, T, G)
        if clock >= 0:
            state[clock + 1] += T * state[clock + 2]
            clock_kernel(P, clock, T)
        known_heading = P[8, 8]
        covariance_kernel(P, G, decay, noise, fading, drives, factor, memory)
        second_order_tilt_kernel(P[8, 8] - known_heading, P)
        if clock >= 0:
            together = 0.5 * process.q[clock + 1] * T * T
            P[clock, clock + 1] += together
            P[clock + 1, clock] += together
        if keep:
            if lost_heading:
                for j in range(n):
                    Phi[PHI + 2, j] = 0.0
            accumulate_kernel(Phi, G, decay, drives, factor, memory)
            if clock >= 0:
                for j in range(n):
                    Phi[clock, j] += T * Phi[clock + 1, j]
        if waiting:
            wait_kernel(T, pending, drives, clock, step, update.row)
        T = 0.0
    carried.elapsed[0] = T
    mirror_kernel(P)
    return 0
