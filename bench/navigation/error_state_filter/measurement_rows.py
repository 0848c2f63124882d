"""The rows of H of each aiding sensor.

Every z is predicted minus measured, z = H dx + noise:

    fix        of `antenna_rows`, and dm_p in position, dm_v in velocity
    baro       h + b - h_baro = -dp_D + db
    magnetic   (1 + M) C' m_n + d - m_b = (1 + M) C' [m_n x] phi + dM C' m_n + dd
    heading    atan2(C_E, C_N) + b + m - psi = dphi_D - C_D (C_N dphi_N + C_E dphi_E) / (1 - C_D^2) + db + dm
    airspeed   |v_n - w| - V = u . (dv - dw)
    radar      h + b - h_radar = -dp_D + db
    odometer   (1 + s) c . u - V = (1 + s) du + (c . u) ds, u of `vehicle_motion`
    wheels     c . u - 0 = du, with c to the right and down; in coordinated flight alike
    standstill v_n - 0 = dv;  w_ib_b - C' w_ie_n = -db_g - C' [w_ie_n x] phi
    course     yaw(C) - o - course = dpsi - do, o the offset of a `steady_course`

with m the Markov part of the GNSS error or of a heading if it is estimated, C_N, C_E, C_D the forward axis of
b in n, u the direction of the airspeed and w in its row the wind, M and d the matrix and the offset that
calibration left in a magnetometer (`state_blocks.MAGNETOMETER`). A fix without velocity has the rows of its
position only. What has a column for the gyro bias has one for each state that adds to it
(`corrections`).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bench.core.compilation.compiled import inner, make_caller
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.earth import EARTH_RATE, radii_kernel
from bench.navigation.error_state_filter.antenna_rows import fix_rows_kernel
from bench.navigation.error_state_filter.corrections import (
    correct_kernel,
    drive_rows_kernel,
    motion_factors_kernel,
)
from bench.navigation.error_state_filter.error_state import GYRO, PHI, POS, VEL, StateLayout
from bench.navigation.error_state_filter.propagation import FilterState, MeasureWork, Pending, Site
from bench.navigation.error_state_filter.rough_heading import yaw_kernel
from bench.navigation.error_state_filter.state_blocks import Index
from bench.navigation.error_state_filter.vehicle_motion import along_kernel
from bench.navigation.mechanization import matrix_kernel

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
    "course",
    "heading",
)
POSITION, VELOCITY, BARO, PSEUDORANGE, RANGE_RATE, MAGNETIC, AIRSPEED, ZERO_VELOCITY, ZERO_RATE = range(9)
RADAR, ODOMETER, NONHOLONOMIC, COORDINATED, COURSE, HEADING = range(9, 15)
ABSENT = -1

FIX_ROWS, SATELLITE_ROWS, BARO_ROWS, MAGNETIC_ROWS, AIRSPEED_ROWS, STANDSTILL_ROWS = range(6)
RADAR_ROWS, ODOMETER_ROWS, VEHICLE_ROWS, COURSE_ROWS, HEADING_ROWS = range(6, 11)
"""Kinds of records; at one time they are used in this order."""

_SLOWEST_AIR = 5.0  # slower, a pitot tube measures nothing useful [m/s]
_LEAST_LEVEL = 0.1  # horizontal part of two antennas apart, below which they tell no heading [1]


@inner
def _row_kernel(pending: Pending, row: int, code: int, component: int, length: int, r: float) -> None:
    """Set a row of H to zero and write its variance and tags."""
    for i in range(pending.H.shape[1]):
        pending.H[row, i] = 0.0
    pending.r[row] = r
    pending.tags[row, 0], pending.tags[row, 1] = code, code  # its channel
    pending.tags[row, 2], pending.tags[row, 3] = component, length


@inner
def _sense_kernel(now: FilterState, values: FloatArray, work: MeasureWork) -> None:
    """Fill ``work.motion`` and its factors from a measured mean rate and force (6,)."""
    turn, push = work.motion[0], work.motion[1]
    for i in range(3):
        turn[i], push[i] = values[i], values[3 + i]
    correct_kernel(now.state, 1.0, work.drives, work.known, turn, push, work.constants)
    motion_factors_kernel(work.motion, work.drives, work.known, work.factor)


@inner
def _fix_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, _ = site
    state, values = now.state, data.values[row]
    for i in range(6):
        code = i // 3
        _row_kernel(pending, first + i, code, i - 3 * code, 3, data.variance[row, i])
    H, z = pending.H[first : first + 6], pending.z[first : first + 6]
    fix_rows_kernel(site, values, H, z)
    if index.gnss_pos >= 0:
        for i in range(6):
            H[i, index.gnss_pos + i] = 1.0
            z[i] += state[index.gnss_pos + 1 + i]
    if not np.isfinite(values[0]):  # a position that a test before the filter has rejected
        for i in range(3):
            pending.tags[first + i, 0], z[i] = ABSENT, 0.0
    return 6 if np.isfinite(values[3] + values[4] + values[5]) else 3  # a fix may have no velocity


@inner
def _calibration_kernel(
    state: FloatArray, p: FloatArray, index: Index, H: FloatArray, z: FloatArray, M: FloatArray
) -> None:
    """Add the calibration errors of a magnetometer to z (3,) and H (3, n) of a true field p (3,), b."""
    M[:] = 0.0
    for i in range(3):
        if index.mag_iron_b >= 0:
            z[i] += state[index.mag_iron_b + 1 + i]
            H[i, index.mag_iron_b + i] = 1.0
        j, k = (i + 1) % 3, (i + 2) % 3
        for at, a, b, back in (
            (index.mag_scale, i, i, 0.0),
            (index.mag_soft_iron, j, k, 1.0),
            (index.mag_turn, j, k, -1.0),
        ):
            if at >= 0:
                M[a, b] += state[at + 1 + i]
                M[b, a] += back * state[at + 1 + i]
                H[a, at + i] = p[b]
                H[b, at + i] += back * p[a]
    for i in range(3):
        z[i] += M[i, 0] * p[0] + M[i, 1] * p[1] + M[i, 2] * p[2]
        a, b, c = H[0, PHI + i], H[1, PHI + i], H[2, PHI + i]
        for j in range(3):
            H[j, PHI + i] += M[j, 0] * a + M[j, 1] * b + M[j, 2] * c


@inner
def _magnetic_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, work = site
    state, C, m = now.state, work.C, work.vectors[0]
    matrix_kernel(state, C)
    s = np.sin(state[0])
    meridian, prime = radii_kernel(s)
    north = (state[0] - data.field_lla[0]) * meridian
    east = (state[1] - data.field_lla[1]) * prime * np.cos(state[0])
    down = data.field_lla[2] - state[2]
    for i in range(3):
        m[i] = data.field[0, i] + north * data.field[1, i] + east * data.field[2, i] + down * data.field[3, i]
    p = work.vectors[1]
    for j in range(3):
        p[j] = C[0, j] * m[0] + C[1, j] * m[1] + C[2, j] * m[2]
    H, z = pending.H[first : first + 3], pending.z[first : first + 3]
    for j in range(3):
        _row_kernel(pending, first + j, MAGNETIC, j, 3, data.variance[row, j])
        z[j] = p[j] - data.values[row, j]
        H[j, PHI] = C[1, j] * m[2] - C[2, j] * m[1]  # C' [m x]
        H[j, PHI + 1] = C[2, j] * m[0] - C[0, j] * m[2]
        H[j, PHI + 2] = C[0, j] * m[1] - C[1, j] * m[0]
    _calibration_kernel(state, p, index, H, z, work.vectors[2:5])
    return 3


@inner
def _airspeed_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, _ = site
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
    _row_kernel(pending, first, AIRSPEED, 0, 1, data.variance[row, 0])
    H = pending.H[first]
    H[VEL], H[VEL + 1], H[VEL + 2] = u / speed, v / speed, w / speed
    H[wind], H[wind + 1] = -u / speed, -v / speed
    if gust >= 0:
        H[gust], H[gust + 1], H[gust + 2] = -u / speed, -v / speed, -w / speed
    pending.z[first] = speed - data.values[row, 0]
    return 1


@inner
def _height_kernel(code: int, bias: int, row: int, first: int, site: Site) -> int:
    """Fill the row of a height above the ellipsoid; ``bias`` is the state of its bias, -1 for none."""
    now, data, _, pending, _ = site
    _row_kernel(pending, first, code, 0, 1, data.variance[row, 0])
    pending.H[first, POS + 2] = -1.0
    pending.z[first] = now.state[2] - data.values[row, 0]
    if bias >= 0:
        pending.H[first, bias] = 1.0
        pending.z[first] += now.state[bias + 1]
    return 1


@inner
def _baro_kernel(row: int, first: int, site: Site) -> int:
    return _height_kernel(BARO, site.where.baro_bias, row, first, site)


@inner
def _radar_kernel(row: int, first: int, site: Site) -> int:
    return _height_kernel(RADAR, site.where.radar_bias, row, first, site)


@inner
def _heading_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, work = site
    C = work.C
    matrix_kernel(now.state, C)
    north, east, down = C[0, 0], C[1, 0], C[2, 0]
    level = north * north + east * east
    if not level > _LEAST_LEVEL * _LEAST_LEVEL:
        return 0
    _row_kernel(pending, first, HEADING, 0, 1, data.variance[row, 0])
    H, z = pending.H[first], np.arctan2(east, north) - data.values[row, 0]
    H[PHI], H[PHI + 1], H[PHI + 2] = -down * north / level, -down * east / level, 1.0
    for at in (index.heading_bias, index.heading_wander):
        if at >= 0:
            H[at] = 1.0
            z += now.state[at + 1]
    pending.z[first] = z - 2.0 * np.pi * np.rint(z / (2.0 * np.pi))
    return 1


@inner
def _odometer_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, work = site
    at = index.odometer_scale
    _row_kernel(pending, first, ODOMETER, 0, 1, data.variance[row, 0])
    H = pending.H[first]
    for i in range(3):
        work.motion[0, i], work.motion[1, i] = work.last[0, i], work.last[1, i]
    motion_factors_kernel(work.motion, work.drives, work.known, work.factor)
    forward = along_kernel(0, 0.0, 0.0, site, H)  # the force of one sample is shaking
    scale = 1.0
    if at >= 0:
        scale += now.state[at + 1]
        for i in range(H.shape[0]):
            H[i] *= scale
        H[at] = forward
    pending.z[first] = scale * forward - data.values[row, 0]
    return 1


@inner
def _vehicle_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, work = site
    values = data.values[row]
    code = COORDINATED if index.gust_n >= 0 else NONHOLONOMIC
    _sense_kernel(now, values, work)
    for i in range(2):
        k = first + i
        _row_kernel(pending, k, code, i, 2, data.variance[row, i])
        pending.z[k] = along_kernel(1 + i, values[6], values[7], site, pending.H[k])
    return 2


@inner
def _standstill_kernel(row: int, first: int, site: Site) -> int:
    """Fill the rows of a standstill: zero velocity, and a mean gyro rate equal to the Earth rate."""
    now, data, _, pending, work = site
    state, C = now.state, work.C
    matrix_kernel(state, C)
    _sense_kernel(now, data.values[row], work)
    n, d = EARTH_RATE * np.cos(state[0]), -EARTH_RATE * np.sin(state[0])
    for i in range(3):
        _row_kernel(pending, first + i, ZERO_VELOCITY, i, 3, data.variance[row, i])
        pending.H[first + i, VEL + i] = 1.0
        pending.z[first + i] = state[VEL + i]
    for j in range(3):
        k = first + 3 + j
        _row_kernel(pending, k, ZERO_RATE, j, 3, data.variance[row, 3 + j])
        pending.z[k] = work.motion[0, j] - (C[0, j] * n + C[2, j] * d)
        pending.H[k, GYRO + j] = -1.0
        pending.H[k, PHI] = -C[1, j] * d  # -C' [w_ie x]
        pending.H[k, PHI + 1] = -(C[2, j] * n - C[0, j] * d)
        pending.H[k, PHI + 2] = C[1, j] * n
    drive_rows_kernel(pending.H[first + 3 : first + 6], work.drives, work.factor)
    return 6


@inner
def _course_kernel(row: int, first: int, site: Site) -> int:
    now, data, index, pending, work = site
    matrix_kernel(now.state, work.C)
    _row_kernel(pending, first, COURSE, 0, 1, data.variance[row, 0])
    yaw = yaw_kernel(work.C, pending.H[first])
    apart = yaw - now.state[index.course_offset + 1] - data.values[row, 0]
    pending.H[first, index.course_offset] = -1.0
    pending.z[first] = apart - 2.0 * np.pi * np.rint(apart / (2.0 * np.pi))
    return 1


ROWS: dict[int, Callable[..., int]] = {
    FIX_ROWS: _fix_kernel,
    BARO_ROWS: _baro_kernel,
    MAGNETIC_ROWS: _magnetic_kernel,
    AIRSPEED_ROWS: _airspeed_kernel,
    STANDSTILL_ROWS: _standstill_kernel,
    RADAR_ROWS: _radar_kernel,
    ODOMETER_ROWS: _odometer_kernel,
    VEHICLE_ROWS: _vehicle_kernel,
    COURSE_ROWS: _course_kernel,
    HEADING_ROWS: _heading_kernel,
}
"""What fills the rows of each kind of record from row ``first`` of ``pending`` on and returns their number.

The filter calls them by address, so that only those of the records there are get compiled.
"""
call_rows = make_caller(ROWS.values())
"""Call one of them by its address."""

OPENS = {
    POSITION: ("pos",),
    VELOCITY: ("vel",),
    BARO: ("baro_bias",),
    PSEUDORANGE: ("pos", "clock_offset"),
    RANGE_RATE: ("vel", "clock_drift"),
    MAGNETIC: ("mag_iron_b",),
    AIRSPEED: ("wind_north", "wind_east"),
    RADAR: ("radar_bias",),
    ODOMETER: ("odometer_scale",),
    HEADING: ("heading_bias",),
    NONHOLONOMIC: ("slip_yaw", "slip_pitch"),
}
"""The states that may have made a step where a sensor is re-admitted after rejections.

A sensor whose states a filter does not have stays out until it agrees with the rest.
"""


def opened_states(code: int, layout: StateLayout) -> BoolArray:
    """Return the states (n,) of a layout that are inflated when a sensor is re-admitted (`OPENS`)."""
    opens, names = np.zeros(layout.size, np.bool_), OPENS.get(code, ())
    if all(layout.has(name) for name in names):
        for name in names:
            opens[layout.slice(name)] = True
    return opens


@inner
def tells_heading_kernel(code: int) -> bool:
    """Return whether a sensor observes the heading directly, not through a motion with other causes."""
    return code in (MAGNETIC, HEADING)
