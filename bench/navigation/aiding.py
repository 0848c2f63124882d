"""The rows of H of each aiding sensor, and the tests that a measurement has to pass.

Every z is predicted minus measured, z = H dx + noise:

    fix        antenna position = dp - [C l x] phi + C dl + dm_p
               antenna velocity = dv - [C (w x l) x] phi + C [l x] db_g + C [w x] dl + dm_v
    baro       h + b - h_baro = -dp_D + db
    magnetic   C' m_n - m_b = C' [m_n x] phi
    airspeed   |v_n - w| - V = u . (dv - dw)
    radar      h + b - h_radar = -dp_D + db
    odometer   (1 + s) c . u - V = (1 + s) du + (c . u) ds, u of `bench.navigation.constraints`
    wheels     c . u - 0 = du, with c to the right and down; in coordinated flight alike
    standstill v_n - 0 = dv;  w_ib_b - C' w_ie_n = -db_g - C' [w_ie_n x] phi

with l the antenna in b, w the rate of b relative to e, m the Markov part of the GNSS error if it is
estimated, u the direction of the airspeed and w in its row the wind. A fix without velocity has the rows of
its position only.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.compiled import inner, kernel
from bench.earth import EARTH_RATE, gravity_kernel, radii_kernel
from bench.navigation.blocks import Index
from bench.navigation.constraints import along_kernel
from bench.navigation.cycle import FilterState, Pending, Work
from bench.navigation.error_state import GYRO, PHI, POS, VEL, feedback_kernel
from bench.navigation.integrity import OUTAGE
from bench.navigation.kalman import drifted_kernel, nis_kernel, open_kernel, stretch_kernel, update_kernel
from bench.navigation.mechanization import matrix_kernel
from bench.navigation.rough_heading import blind_kernel, turn_tilts_kernel

SENSORS = (
    "gnss_position",
    "gnss_velocity",
    "baro",
    "pseudorange",
    "range_rate",
    "magnetometer",
    "airspeed",
    "zero_velocity",
    "zero_rate",
    "radar",
    "odometer",
    "nonholonomic",
    "coordinated",
)
POSITION, VELOCITY, BARO, PSEUDORANGE, RANGE_RATE, MAGNETIC, AIRSPEED, ZERO_VELOCITY, ZERO_RATE = range(9)
RADAR, ODOMETER, NONHOLONOMIC, COORDINATED = 9, 10, 11, 12
ABSENT = -1

FIX_ROWS, SATELLITE_ROWS, BARO_ROWS, MAGNETIC_ROWS, AIRSPEED_ROWS, STANDSTILL_ROWS = range(6)
RADAR_ROWS, ODOMETER_ROWS, VEHICLE_ROWS = 6, 7, 8
"""Kinds of records; at one instant they are used in this order."""

_SLOWEST_AIR = 5.0  # slower, a pitot tube measures nothing useful [m/s]


class Measurements(NamedTuple):
    """Measurements of all kinds except satellites."""

    values: FloatArray  # (R, 9); columns 6 to 8 of a fix: its antenna [m], b
    variance: FloatArray  # (R, 6)
    antenna_b: FloatArray  # (3,) of the satellites [m], b
    field: FloatArray  # (4, 3) magnetic field at field_lla [T], n, and its change per metre north, east, down
    field_lla: FloatArray  # (3,)


class Gate(NamedTuple):
    """The tests of a sub-vector (A-5.4.6, A-5.4.7, A-5.4.T) and their memories."""

    nis: FloatArray  # (4,) largest NIS by length of the sub-vector; inf: no test
    trace: float  # largest trace ratio; inf: no test
    max_acceleration: float  # tolerance test: unnoticed acceleration of the aircraft [m/s^2]; inf: no test
    sigmas: float  # tolerance test: standard deviations granted to the receiver
    memory: float  # weight of a new measurement in the adapted noise; 0: noise of the datasheet
    readmit_after: IntArray  # (sensors,) refusals in a row after which the next measurement is used
    own: IntArray  # (sensors, 3) states whose variance then grows; -1: none
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
    work: Work,
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
            if not sound and gate.own[code, 0] >= 0:
                e = log.numbers[row : row + m, 1]
                open_kernel(P, before, H, e, gate.own[code], work.square, work.row)
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
    turn_tilts_kernel(now.state, P, pending.H, dx)
    feedback_kernel(now.state, dx)


@inner
def _row_kernel(
    pending: Pending, row: int, code: int, channel: int, component: int, length: int, r: float
) -> None:
    """Set a row of H to zero and write its variance and tags."""
    for i in range(pending.H.shape[1]):
        pending.H[row, i] = 0.0
    pending.r[row] = r
    pending.tags[row, 0], pending.tags[row, 1] = code, channel
    pending.tags[row, 2], pending.tags[row, 3] = component, length


@kernel
def antenna_kernel(
    nav: FloatArray,
    C: FloatArray,
    antenna_b: FloatArray,
    w_ib_b: FloatArray,
    lla: FloatArray,
    vel_n: FloatArray,
    H: FloatArray,
    z: FloatArray,
) -> None:
    """Fill z (6,) and H (6, n) of a fix: predicted minus measured position [m] and velocity [m/s], n.

    Elements of H that are always zero are not written: H must hold zeros there.
    """
    s, c = np.sin(nav[0]), np.cos(nav[0])
    meridian, prime = radii_kernel(s)
    r_m, r_p = meridian + nav[2], prime + nav[2]
    x, y, d = antenna_b[0], antenna_b[1], antenna_b[2]
    # rate of b relative to e: without that of the Earth, in b
    p = w_ib_b[0] - EARTH_RATE * (C[0, 0] * c - C[2, 0] * s)
    q = w_ib_b[1] - EARTH_RATE * (C[0, 1] * c - C[2, 1] * s)
    r = w_ib_b[2] - EARTH_RATE * (C[0, 2] * c - C[2, 2] * s)
    sx, sy, sd = q * d - r * y, r * x - p * d, p * y - q * x  # w x l
    for i in range(3):
        H[POS + i, POS + i] = 1.0
        H[VEL + i, VEL + i] = 1.0
        H[3 + i, GYRO] = C[i, 1] * d - C[i, 2] * y  # C [l x]
        H[3 + i, GYRO + 1] = C[i, 2] * x - C[i, 0] * d
        H[3 + i, GYRO + 2] = C[i, 0] * y - C[i, 1] * x
    for block, u, v, w in ((0, x, y, d), (3, sx, sy, sd)):
        a = C[0, 0] * u + C[0, 1] * v + C[0, 2] * w
        b = C[1, 0] * u + C[1, 1] * v + C[1, 2] * w
        g = C[2, 0] * u + C[2, 1] * v + C[2, 2] * w
        H[block, PHI + 1], H[block, PHI + 2] = g, -b  # -[a x]
        H[block + 1, PHI], H[block + 1, PHI + 2] = -g, a
        H[block + 2, PHI], H[block + 2, PHI + 1] = b, -a
        z[block], z[block + 1], z[block + 2] = a, b, g
    dlon = nav[1] - lla[1]
    dlon -= 2.0 * np.pi * np.round(dlon / (2.0 * np.pi))
    z[0] += (nav[0] - lla[0]) * r_m
    z[1] += dlon * r_p * c
    z[2] += lla[2] - nav[2]
    for i in range(3):
        z[3 + i] += nav[3 + i] - vel_n[i]


@inner
def lever_kernel(C: FloatArray, w_ib_b: FloatArray, at: int, H: FloatArray) -> None:
    """Fill the columns from ``at`` on of H (6, n): the estimated lever arm. The Earth rate is neglected."""
    p, q, r = w_ib_b[0], w_ib_b[1], w_ib_b[2]
    for i in range(3):
        for j in range(3):
            H[i, at + j] = C[i, j]
        H[3 + i, at] = C[i, 1] * r - C[i, 2] * q  # C [w x]
        H[3 + i, at + 1] = C[i, 2] * p - C[i, 0] * r
        H[3 + i, at + 2] = C[i, 0] * q - C[i, 1] * p


@inner
def place_kernel(now: FilterState, antenna_b: FloatArray, index: Index, work: Work) -> None:
    """Fill ``work.lever`` with the lever arm, estimated if the layout has it, and ``work.C`` with C_nb."""
    at = index.antenna_b
    for i in range(3):
        work.lever[i] = now.state[at + 1 + i] if at >= 0 else antenna_b[i]
    matrix_kernel(now.state, work.C)


@inner
def _fix_kernel(
    row: int, first: int, now: FilterState, data: Measurements, index: Index, pending: Pending, work: Work
) -> int:
    state, values = now.state, data.values[row]
    place_kernel(now, values[6:], index, work)
    for i in range(6):
        code = i // 3
        _row_kernel(pending, first + i, code, code, i - 3 * code, 3, data.variance[row, i])
    H, z = pending.H[first : first + 6], pending.z[first : first + 6]
    antenna_kernel(state, work.C, work.lever, work.w_ib_b, values[:3], values[3:6], H, z)
    if index.antenna_b >= 0:
        lever_kernel(work.C, work.w_ib_b, index.antenna_b, H)
    if index.gnss_pos >= 0:
        for i in range(6):
            H[i, index.gnss_pos + i] = 1.0
            z[i] += state[index.gnss_pos + 1 + i]
    if not np.isfinite(values[0]):  # a position that a test before the filter has refused
        for i in range(3):
            pending.tags[first + i, 0], z[i] = ABSENT, 0.0
    return 6 if np.isfinite(values[3] + values[4] + values[5]) else 3  # a fix may have no velocity


@inner
def _magnetic_kernel(
    row: int, first: int, now: FilterState, data: Measurements, pending: Pending, work: Work
) -> int:
    state, C, m = now.state, work.C, work.vectors[0]
    matrix_kernel(state, C)
    s = np.sin(state[0])
    meridian, prime = radii_kernel(s)
    north = (state[0] - data.field_lla[0]) * meridian
    east = (state[1] - data.field_lla[1]) * prime * np.cos(state[0])
    down = data.field_lla[2] - state[2]
    for i in range(3):
        m[i] = data.field[0, i] + north * data.field[1, i] + east * data.field[2, i] + down * data.field[3, i]
    for j in range(3):
        k = first + j
        _row_kernel(pending, k, MAGNETIC, MAGNETIC, j, 3, data.variance[row, j])
        pending.z[k] = C[0, j] * m[0] + C[1, j] * m[1] + C[2, j] * m[2] - data.values[row, j]
        pending.H[k, PHI] = C[1, j] * m[2] - C[2, j] * m[1]  # C' [m x]
        pending.H[k, PHI + 1] = C[2, j] * m[0] - C[0, j] * m[2]
        pending.H[k, PHI + 2] = C[0, j] * m[1] - C[1, j] * m[0]
    return 3


@inner
def _airspeed_kernel(
    row: int, first: int, now: FilterState, data: Measurements, index: Index, pending: Pending
) -> int:
    state, wind, gust = now.state, index.wind_north, index.gust_n
    u = state[3] - state[wind + 1]
    v = state[4] - state[wind + 2]
    w = state[5]
    if gust >= 0:
        u -= state[gust + 1]
        v -= state[gust + 2]
        w -= state[gust + 3]
    speed = np.sqrt(u * u + v * v + w * w)
    if not speed > _SLOWEST_AIR:
        return 0
    _row_kernel(pending, first, AIRSPEED, AIRSPEED, 0, 1, data.variance[row, 0])
    H = pending.H[first]
    H[VEL], H[VEL + 1], H[VEL + 2] = u / speed, v / speed, w / speed
    H[wind], H[wind + 1] = -u / speed, -v / speed
    if gust >= 0:
        H[gust], H[gust + 1], H[gust + 2] = -u / speed, -v / speed, -w / speed
    pending.z[first] = speed - data.values[row, 0]
    return 1


@inner
def _height_kernel(
    code: int, bias: int, row: int, first: int, now: FilterState, data: Measurements, pending: Pending
) -> int:
    """Fill the row of a height above the ellipsoid; ``bias`` is the state of its bias, -1 for none."""
    _row_kernel(pending, first, code, code, 0, 1, data.variance[row, 0])
    pending.H[first, POS + 2] = -1.0
    pending.z[first] = now.state[2] - data.values[row, 0]
    if bias >= 0:
        pending.H[first, bias] = 1.0
        pending.z[first] += now.state[bias + 1]
    return 1


@inner
def _odometer_kernel(
    row: int, first: int, now: FilterState, data: Measurements, index: Index, pending: Pending, work: Work
) -> int:
    at = index.odometer_scale
    _row_kernel(pending, first, ODOMETER, ODOMETER, 0, 1, data.variance[row, 0])
    H = pending.H[first]
    for i in range(3):
        work.lever[i] = work.w_ib_b[i] + now.state[GYRO + 1 + i]
    forward = along_kernel(0, work.lever, 0.0, 0.0, now, index, H, work)  # the force of one sample is shaking
    scale = 1.0
    if at >= 0:
        scale += now.state[at + 1]
        for i in range(H.shape[0]):
            H[i] *= scale
        H[at] = forward
    pending.z[first] = scale * forward - data.values[row, 0]
    return 1


@inner
def _vehicle_kernel(
    row: int, first: int, now: FilterState, data: Measurements, index: Index, pending: Pending, work: Work
) -> int:
    values = data.values[row]
    code = COORDINATED if index.gust_n >= 0 else NONHOLONOMIC
    for i in range(2):
        k = first + i
        _row_kernel(pending, k, code, code, i, 2, data.variance[row, i])
        pending.z[k] = along_kernel(1 + i, values[:3], values[3], values[4], now, index, pending.H[k], work)
    return 2


@inner
def _standstill_kernel(
    row: int, first: int, now: FilterState, data: Measurements, index: Index, pending: Pending, work: Work
) -> int:
    """Fill the rows of a standstill: zero velocity, and the mean rate of the gyros is that of the Earth."""
    state, C, at = now.state, work.C, index.g_sensitivity_x
    matrix_kernel(state, C)
    s, c = np.sin(state[0]), np.cos(state[0])
    _, g_d = gravity_kernel(s, c, state[2])
    n, d = EARTH_RATE * c, -EARTH_RATE * s
    for i in range(3):
        _row_kernel(pending, first + i, ZERO_VELOCITY, ZERO_VELOCITY, i, 3, data.variance[row, i])
        pending.H[first + i, VEL + i] = 1.0
        pending.z[first + i] = state[VEL + i]
    for j in range(3):
        k = first + 3 + j
        _row_kernel(pending, k, ZERO_RATE, ZERO_RATE, j, 3, data.variance[row, 3 + j])
        pending.z[k] = data.values[row, j] - state[GYRO + 1 + j] - (C[0, j] * n + C[2, j] * d)
        pending.H[k, GYRO + j] = -1.0
        pending.H[k, PHI] = -C[1, j] * d  # -C' [w_ie x]
        pending.H[k, PHI + 1] = -(C[2, j] * n - C[0, j] * d)
        pending.H[k, PHI + 2] = C[1, j] * n
        if at >= 0:
            for i in range(3):
                force = -C[2, i] * g_d
                pending.z[k] -= state[at + 1 + 3 * j + i] * force
                pending.H[k, at + 3 * j + i] = -force
    return 6


@inner
def measure_kernel(
    kind: int,
    row: int,
    first: int,
    now: FilterState,
    data: Measurements,
    index: Index,
    pending: Pending,
    work: Work,
) -> int:
    """Fill the rows of one measurement from row ``first`` on; return their number."""
    if kind == FIX_ROWS:
        return _fix_kernel(row, first, now, data, index, pending, work)
    if kind == BARO_ROWS:
        return _height_kernel(BARO, index.baro_bias, row, first, now, data, pending)
    if kind == RADAR_ROWS:
        return _height_kernel(RADAR, index.radar_bias, row, first, now, data, pending)
    if kind == ODOMETER_ROWS:
        return _odometer_kernel(row, first, now, data, index, pending, work)
    if kind == VEHICLE_ROWS:
        return _vehicle_kernel(row, first, now, data, index, pending, work)
    if kind == MAGNETIC_ROWS:
        return _magnetic_kernel(row, first, now, data, pending, work)
    if kind == AIRSPEED_ROWS:
        return _airspeed_kernel(row, first, now, data, index, pending)
    return _standstill_kernel(row, first, now, data, index, pending, work)
