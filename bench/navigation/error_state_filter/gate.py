"""The tests that a measurement has to pass, and the update with what passes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.compiled import inner
from bench.navigation.engine.integrity import OUTAGE
from bench.navigation.engine.kalman import (
    drifted_kernel,
    nis_kernel,
    open_kernel,
    stretch_kernel,
    update_kernel,
)
from bench.navigation.error_state_filter.error_state import feedback_kernel, reset_kernel, turn_rows_kernel
from bench.navigation.error_state_filter.measurement_rows import (
    ABSENT,
    MAGNETIC,
    POSITION,
    VELOCITY,
    ZERO_RATE,
    ZERO_VELOCITY,
)
from bench.navigation.error_state_filter.propagation import FilterState, Pending, UpdateWork
from bench.navigation.error_state_filter.rough_heading import blind_kernel


class Gate(NamedTuple):
    """The tests of a sub-vector (A-5.4.6, A-5.4.7, A-5.4.T) and their memories."""

    nis: FloatArray  # (4,) largest NIS by length of the sub-vector; inf: no test
    trace: float  # largest trace ratio; inf: no test
    max_acceleration: float  # tolerance test: unnoticed acceleration of the aircraft [m/s^2]; inf: no test
    sigmas: float  # tolerance test: standard deviations granted to the receiver
    memory: float  # weight of a new measurement in the adapted noise; 0: noise of the datasheet
    readmit_after: IntArray  # (sensors,) refusals in a row after which the next measurement is used
    opens: IntArray  # (sensors, 2) first and number of the states whose variance then grows; 0: none
    misses: IntArray  # (channels,) refusals in a row
    used: FloatArray  # (channels,) instant of the last measurement used [s]
    level: FloatArray  # (sensors,) adapted variance over that of the datasheet


class Log(NamedTuple):
    """Rows of the innovation table."""

    numbers: FloatArray  # (N, 4) t, innovation, its variance, NIS
    marks: IntArray  # (N, 4) sensor, component, accepted, channel
    filled: IntArray  # (1,) number of rows written


@inner
def returns_kernel(t: float, gate: Gate) -> bool:
    """Return whether a fix comes after an outage: none was there, used or refused."""
    waited = t - max(gate.used[POSITION], gate.used[VELOCITY])
    return bool(gate.misses[POSITION] + gate.misses[VELOCITY] == 0 and waited >= OUTAGE)


@inner
def use_kernel(
    t: float,
    first: int,
    rows: int,
    now: FilterState,
    before: FloatArray,
    pending: Pending,
    gate: Gate,
    log: Log,
    work: UpdateWork,
) -> None:
    """Test each sub-vector of a measurement, update with those that pass, log all of them, feed back.

    ``before`` is the covariance before the measurement that a smoother uses: it grows where P does.
    """
    P, dx, n = now.P, now.dx, now.P.shape[0]
    if rows > 0 and pending.tags[first, 0] != MAGNETIC:
        blind_kernel(now.state, P, pending.H[first : first + rows])
    a, drifted = first, False
    while a < first + rows:
        code, channel, m = pending.tags[a, 0], pending.tags[a, 1], pending.tags[a, 3]
        if code == ABSENT:
            a += m
            continue
        level = gate.level[code]
        H, z, r = pending.H[a : a + m], pending.z[a : a + m], pending.r[a : a + m]
        for b in range(m):
            r[b] *= level
        nis = nis_kernel(P, dx, H, z, r, work.var, work.square, work.rows)
        sound = nis <= gate.nis[m]
        if not sound and code == POSITION and a + 3 < first + rows and returns_kernel(t, gate):
            H_6, z_6, r_6 = pending.H[a : a + 6], pending.z[a : a + 6], pending.r[a : a + 6]
            drifted = drifted_kernel(P, dx, H_6, z_6, r_6, gate.nis[3], work.var, work.square, work.rows)
        beyond = drifted and not sound
        sound = sound or beyond
        squares, spread, excess = 0.0, 0.0, 0.0
        waited = t - gate.used[channel]
        reach = gate.max_acceleration * waited
        if code == POSITION:
            reach *= 0.5 * waited
        row = log.filled[0]
        for b in range(m):
            innovation = -z[b]  # measured minus predicted
            for i in range(n):
                if H[b, i] != 0.0:
                    innovation += H[b, i] * dx[i]
            squares += innovation * innovation
            spread += work.var[b]
            most = min(innovation * innovation, gate.nis[1] * work.var[b])
            excess += (most - work.var[b] + r[b]) / (r[b] / level) / m
            if code <= VELOCITY and abs(innovation) > reach + gate.sigmas * np.sqrt(r[b]):
                sound = False
            log.numbers[row + b, 0], log.numbers[row + b, 1] = t, innovation
            log.numbers[row + b, 2], log.numbers[row + b, 3] = work.var[b], nis
        if not squares <= gate.trace * spread:
            sound = False
        if code == ZERO_RATE and gate.misses[ZERO_VELOCITY] > 0:
            sound = False  # in flight the mean rate is not that of the Earth alone
        accepted = sound or gate.misses[channel] >= gate.readmit_after[code]
        gate.misses[channel] = 0 if accepted else gate.misses[channel] + 1
        for b in range(m):
            log.marks[row + b, 0], log.marks[row + b, 1] = code, pending.tags[a + b, 2]
            log.marks[row + b, 2], log.marks[row + b, 3] = accepted, channel
        log.filled[0] += m
        if accepted:
            gate.used[channel] = t
            if not sound and gate.opens[code, 1] > 0:
                e, first_own, count = log.numbers[row : row + m, 1], gate.opens[code, 0], gate.opens[code, 1]
                open_kernel(P, before, H, e, first_own, count, work.square, work.row)
            elif beyond:
                stretch_kernel(P, H, work.square, work.row)
            for b in range(m):
                update_kernel(P, dx, H[b], z[b], r[b], work.row, work.other_row)
        if gate.memory > 0.0 and np.isfinite(excess):
            gate.level[code] = max(level + gate.memory * (excess - level), 0.01)
        a += m
    for slot in range(pending.live.shape[0]):  # rows that wait were measured before this correction
        for b in range(slot * pending.width, slot * pending.width + pending.live[slot]):
            for i in range(n):
                pending.z[b] -= pending.H[b, i] * dx[i]
    if dx[8] != 0.0:
        reset_kernel(P, dx[8])
        turn_rows_kernel(pending.H, np.sin(dx[8]), np.cos(dx[8]))
    feedback_kernel(now.state, dx)


def with_channels(gate: Gate, channels: int, start: float) -> Gate:
    """Return a gate with memories of at least so many channels."""
    new = channels - len(gate.misses)
    if new <= 0:
        return gate
    return gate._replace(
        misses=np.append(gate.misses, np.zeros(new, np.int64)), used=np.append(gate.used, np.full(new, start))
    )
