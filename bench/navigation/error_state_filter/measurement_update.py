"""Measurement update of a compiled filter: tests, gate, and update with the accepted parts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.navigation.engine.gate import (
    DRIFTED,
    LOST,
    REFUSED,
    SOUND,
    InnovationLog,
    Trust,
    decide_kernel,
    fix_kernel,
    note_kernel,
    returns_kernel,
)
from bench.navigation.engine.kalman import (
    nis_of_kernel,
    open_all_kernel,
    open_kernel,
    stretch_kernel,
)
from bench.navigation.engine.late_updates import late_rows_kernel, late_update_kernel, settle_kernel
from bench.navigation.error_state_filter.corrections import (
    axes_kernel,
    refer_kernel,
    refer_rows_kernel,
    reset_kernel,
    turn_rows_kernel,
)
from bench.navigation.error_state_filter.error_state import PHI, feedback_kernel
from bench.navigation.error_state_filter.measurement_rows import (
    ABSENT,
    POSITION,
    PSEUDORANGE,
    RANGE_RATE,
    VELOCITY,
    ZERO_RATE,
    ZERO_VELOCITY,
    tells_heading_kernel,
)
from bench.navigation.error_state_filter.propagation import FilterState, Pending, UpdateWork
from bench.navigation.error_state_filter.rough_heading import (
    WIDE,
    blind_kernel,
    swing_kernel,
    vague_kernel,
)
from bench.navigation.mechanization import matrix_kernel


class Gate(NamedTuple):
    """The tests of a sub-vector (A-5.4.6, A-5.4.7, A-5.4.T), and the memory of each channel."""

    nis: FloatArray  # (4,) largest NIS by length of the sub-vector; inf: no test
    trace: float  # largest trace ratio; inf: no test
    max_acceleration: float  # tolerance test: undetected acceleration of the aircraft [m/s^2]; inf: no test
    sigmas: float  # tolerance test: standard deviations granted to the receiver
    memory: float  # weight of a new measurement in the adapted noise; 0: noise of the datasheet
    readmit_after_s: float  # time of nothing but rejections after which a sensor is re-admitted [s]
    opens: BoolArray  # (sensors, n) states whose variance then grows; none: it stays out until it agrees
    trust: Trust
    level: FloatArray  # (sensors,) adapted variance over that of the datasheet


@inner
def opens_kernel(code: int, opens: BoolArray) -> bool:
    """Return whether a filter has states that can explain a step of a sensor."""
    i: int = 0
    n: int = opens.shape[1]
    while i < n and not opens[code, i]:
        i += 1
    return i < n


@inner
def outvoted_kernel(code: int, first: int, rows: int, pending: Pending, trust: Trust) -> bool:
    """Return whether at least half of the satellites of an epoch agree with the filter in range or rate.

    One that does not is then at fault, not the filter.
    """
    seen, agree = 0, 0
    for a in range(first, first + rows):
        if pending.tags[a, 0] == code:
            seen += 1
            if trust.misses[pending.tags[a, 1]] == 0:
                agree += 1
    return 2 * agree >= seen


@inner
def use_kernel(
    t: float,
    first: int,
    rows: int,
    now: FilterState,
    before: FloatArray,
    pending: Pending,
    gate: Gate,
    log: InnovationLog,
    work: UpdateWork,
) -> int:
    """Test each sub-vector of a measurement, update with the accepted ones, log all, and feed back.

    ``before`` is the covariance before the measurement that a smoother uses: it grows where P does.
    Called by its address, it returns 0.
    """
    P, dx, n, trust = now.P, now.dx, now.P.shape[0], gate.trust
    if not tells_heading_kernel(pending.tags[first, 0]):
        blind_kernel(now.state, P, pending.H[first : first + rows])
    of_gnss = pending.tags[first, 0] in (ABSENT, POSITION, VELOCITY, PSEUDORANGE, RANGE_RATE)
    vague = of_gnss and vague_kernel(P)
    swings = vague and P[8, 8] < WIDE**2 and pending.tags[first, 0] == POSITION and rows > 3
    a, drifted, moves, ranges_agree, rates_agree = first, False, True, False, False
    late, waits = work.late, 0
    satellites: int = gate.opens.shape[0]
    if pending.tags[first, 0] == PSEUDORANGE:
        ranges_agree = outvoted_kernel(PSEUDORANGE, first, rows, pending, trust)
        rates_agree = outvoted_kernel(RANGE_RATE, first, rows, pending, trust)
    while a < first + rows:
        code, channel, m = pending.tags[a, 0], pending.tags[a, 1], pending.tags[a, 3]
        if code == ABSENT:
            a += m
            continue
        level = gate.level[code]
        H, z, r = pending.H[a : a + m], pending.z[a : a + m], pending.r[a : a + m]
        for b in range(m):
            r[b] *= level
        late_rows_kernel(P, H, late, waits)
        nis = nis_of_kernel(late.HP, dx, H, late.at, z, r, work.var, work.square)
        sound = nis <= gate.nis[m]
        if code == POSITION and rows > 3 and (
            not sound or trust.misses[POSITION] + trust.misses[VELOCITY] > 0 or returns_kernel(t, trust)
        ):  # fmt: skip
            H_6, z_6, r_6 = pending.H[a : a + 6], pending.z[a : a + 6], pending.r[a : a + 6]
            waits = settle_kernel(P, late, waits)
            drifted, moves, contradicts = fix_kernel(
                t, P, dx, H_6, z_6, r_6, gate.nis[3], gate.readmit_after_s, trust,
                work.innovation, work.var, work.square, late.HP, late.at,
            )  # fmt: skip
            sound = sound and not contradicts
        passed = sound or drifted
        squares, spread, excess, e = 0.0, 0.0, 0.0, work.innovation
        waited = t - trust.used[channel]
        reach = gate.max_acceleration * waited
        if code == POSITION:
            reach *= 0.5 * waited
        for b in range(m):
            innovation = -z[b]  # measured minus predicted
            for j in late.at[b, 1 : late.at[b, 0] + 1]:
                innovation += H[b, j] * dx[j]
            squares += innovation * innovation
            spread += work.var[b]
            most = min(innovation * innovation, gate.nis[1] * work.var[b])
            excess += (most - work.var[b] + r[b]) / (r[b] / level) / m
            if code <= VELOCITY and abs(innovation) > reach + gate.sigmas * np.sqrt(r[b]):
                passed = False
            e[b] = innovation
        if not squares <= gate.trace * spread:
            passed = False
        if code == ZERO_RATE and trust.misses[ZERO_VELOCITY] > 0:
            passed = False  # in flight the mean rate is not that of the Earth alone
        opens = opens_kernel(code, gate.opens)
        if (code == PSEUDORANGE and ranges_agree) or (code == RANGE_RATE and rates_agree):
            opens = False
        if code <= VELOCITY and not moves:
            opens = False
        verdict = decide_kernel(
            t, channel, passed and sound, passed, opens, gate.readmit_after_s, satellites, trust
        )
        for b in range(m):
            component = pending.tags[a + b, 2]
            note_kernel(t, code, channel, component, e[b], work.var[b], nis, verdict != REFUSED, log)
        if verdict != REFUSED and verdict != SOUND:
            waits = settle_kernel(P, late, waits)
            if verdict == DRIFTED:
                stretch_kernel(P, H, work.square, work.row)
            elif code in (PSEUDORANGE, RANGE_RATE):
                open_all_kernel(P, before, e[0], gate.opens[code])
            else:
                lost = verdict == LOST
                open_kernel(P, before, H, e, gate.opens[code], lost, work.square, work.row)
            late_rows_kernel(P, H, late, waits)
        if verdict != REFUSED:
            waits = late_update_kernel(P, dx, H, z, r, late, waits)
        if gate.memory > 0.0 and np.isfinite(excess):
            gate.level[code] = max(level + gate.memory * (excess - level), 0.01)
        a += m
    settle_kernel(P, late, waits)
    for slot in range(pending.live.shape[0]):  # rows that wait were measured before this correction
        for b in range(slot * pending.width, slot * pending.width + pending.live[slot]):
            for i in range(n):
                pending.z[b] -= pending.H[b, i] * dx[i]
    if dx[8] != 0.0:
        axes_kernel(now.state, dx, work.drives, work.factor, work.turn)
        reset_kernel(P, work.turn, work.drives, work.factor, late.HP)
        refer_kernel(P, dx, work.drives, work.factor, work.row)
        for slot in range(pending.live.shape[0]):
            wait = pending.H[slot * pending.width : slot * pending.width + pending.live[slot]]
            turn_rows_kernel(wait, work.turn, work.drives, work.factor)
            refer_rows_kernel(wait, work.drives, work.row)
    if swings:
        for i in range(3):
            work.axes[2, 0, i] = dx[PHI + i]
        matrix_kernel(now.state, work.axes[0])
        feedback_kernel(now.state, dx)
        matrix_kernel(now.state, work.axes[1])
        swing_kernel(pending.H[first : first + 6], work.axes[0], work.axes[1], work.axes[2], now.state, P)
    else:
        feedback_kernel(now.state, dx)
    return 0
