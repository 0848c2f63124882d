"""Motion of the IMU over one sample, compiled, as soon as JSBSim is three steps beyond it.

The equations are those of `bench.simulation.flight.increments`. The recorded truth is made by that, in longer
pieces: it takes a millisecond a call, and an autopilot waits for each sample.
"""

from __future__ import annotations

import math
from array import array
from typing import NamedTuple

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE, WGS84, gravity_kernel
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.state_log import NEIGHBORS

_A, _B, _E2 = WGS84.a, WGS84.b, WGS84.e2
_COLUMNS = 12  # of a state
_SECOND_E2 = _E2 / (1.0 - _E2)


class SampleMotion(NamedTuple):
    """True motion of the IMU at the end of a sample, and its increments over the sample."""

    t: float  # [s]
    lla: FloatArray  # (3,) [rad, rad, m]
    vel_n: FloatArray  # (3,) [m/s]
    q_nb: FloatArray  # (4,) b to n
    dtheta_b: FloatArray  # (3,) [rad]
    dvel_b: FloatArray  # (3,) [m/s]


class SampleWindow:
    """The last states of JSBSim, and the motion over the sample in their middle.

    Parameters
    ----------
    substeps : int
        Steps of JSBSim in a sample.
    dt : float
        The step [s].
    imu_b : tuple
        The IMU relative to the center of gravity [m], b.
    """

    def __init__(self, substeps: int, dt: float, imu_b: tuple[float, float, float]) -> None:
        rows = substeps + 1 + 2 * NEIGHBORS
        self._states = array("d", bytes(8 * _COLUMNS * rows))
        self._dt, self._arm = dt, np.array(imu_b)
        self._work = np.zeros((rows, 16))

    def push(self, state: list[float]) -> None:
        """Append a state of a model of the bench, as `StateLog` keeps it."""
        del self._states[:_COLUMNS]
        self._states.extend(state)

    def compute(self, t: float) -> SampleMotion:
        """Return the motion over the sample that ends at t [s], three steps before the last state."""
        out = np.empty(16)
        states = np.array(self._states).reshape(-1, _COLUMNS)
        sample_kernel(states, self._dt, self._arm, NEIGHBORS, self._work, out)
        return SampleMotion(t, out[0:3], out[3:6], out[6:10], out[10:13], out[13:16])


@kernel
def sample_kernel(
    states: FloatArray, dt: float, arm: FloatArray, beyond: int, work: FloatArray, out: FloatArray
) -> None:
    """Fill out (16,): lla, vel_n, q_nb at the end of the sample, and its increments of angle and velocity.

    ``states`` (K, 12) are those of `StateLog`, ``beyond`` rows before the sample and as many after it.
    ``work`` (K, 16) holds, by row: q_ib 0:4, C arm 4:7, velocity 7:10, turn 10:13 and velocity gained 13:16
    over the step that begins there, both at constant rate and force.
    """
    rows = states.shape[0]
    for k in range(rows):
        _attitude_kernel(states[k], work[k])
        _rotate_kernel(work[k], arm, 1.0, work[k, 4:7])
    for k in range(2, rows - 2):
        for i in range(3):
            near, far = work[k + 1, 4 + i] - work[k - 1, 4 + i], work[k + 2, 4 + i] - work[k - 2, 4 + i]
            work[k, 7 + i] = FT * states[k, 3 + i] + (8.0 * near - far) / (12.0 * dt)
    first, last = beyond, rows - 1 - beyond
    for k in range(first - 1, last + 1):
        _step_kernel(states[k], dt, work[k], work[k + 1])
    for i in range(6):
        out[10 + i] = 0.0
    for k in range(first, last):
        for i in range(3):
            a, b = (i + 1) % 3, (i + 2) % 3
            turned = _cross(work[k - 1], 10, work[k], 10, a, b) + _cross(work[k], 10, work[k + 1], 10, a, b)
            gained = _cross(work[k - 1], 10, work[k], 13, a, b) + _cross(work[k - 1], 13, work[k], 10, a, b)
            gained += _cross(work[k], 10, work[k + 1], 13, a, b) + _cross(work[k], 13, work[k + 1], 10, a, b)
            out[10 + i] += work[k, 10 + i] - turned / 24.0
            out[13 + i] += work[k, 13 + i] - gained / 24.0
    x = FT * states[last, 0] + work[last, 4]
    y = FT * states[last, 1] + work[last, 5]
    z = FT * states[last, 2] + work[last, 6]
    lat, alt, across = _geodetic_kernel(x, y, z)
    east = math.atan2(y, x)  # longitude from the axis x of i
    out[0], out[2] = lat, alt
    out[1] = (east - states[last, 11] + math.pi) % (2.0 * math.pi) - math.pi
    vx = work[last, 7] + EARTH_RATE * y
    vy, vz = work[last, 8] - EARTH_RATE * x, work[last, 9]
    outward, sin_lat, cos_lat = (vx * x + vy * y) / across, math.sin(lat), math.cos(lat)
    out[3] = vz * cos_lat - outward * sin_lat
    out[4] = (vy * x - vx * y) / across
    out[5] = -outward * cos_lat - vz * sin_lat
    _level_kernel(lat, east, out[6:10])
    out[7], out[8], out[9] = -out[7], -out[8], -out[9]
    _multiply_kernel(out[6:10], work[last], out[6:10])


@kernel
def _cross(one: FloatArray, p: int, other: FloatArray, q: int, a: int, b: int) -> float:
    """Return the component beside axes a and b of the product of two vectors that begin at p and q."""
    found: float = one[p + a] * other[q + b] - one[p + b] * other[q + a]
    return found


@kernel
def _multiply_kernel(p: FloatArray, q: FloatArray, out: FloatArray) -> None:
    """Fill out (4,), which may be p, with the product of two quaternions."""
    w, x, y, z = p[0], p[1], p[2], p[3]
    a, b, c, d = q[0], q[1], q[2], q[3]
    out[0] = w * a - x * b - y * c - z * d
    out[1] = w * b + x * a + y * d - z * c
    out[2] = w * c - x * d + y * a + z * b
    out[3] = w * d + x * c - y * b + z * a


@kernel
def _rotate_kernel(q: FloatArray, v: FloatArray, sense: float, out: FloatArray) -> None:
    """Fill out (3,) with v (3,) rotated by q, or back with a sense of -1."""
    w, x, y, z = q[0], sense * q[1], sense * q[2], sense * q[3]
    tx, ty, tz = y * v[2] - z * v[1], z * v[0] - x * v[2], x * v[1] - y * v[0]
    out[0], out[1], out[2] = (
        v[0] + 2.0 * (w * tx + y * tz - z * ty),
        v[1] + 2.0 * (w * ty + z * tx - x * tz),
        v[2] + 2.0 * (w * tz + x * ty - y * tx),
    )


@kernel
def _level_kernel(lat: float, lon: float, out: FloatArray) -> None:
    """Fill out (4,) with q_in at a latitude and a longitude from the axis x of i [rad]."""
    tilt = -0.5 * (lat + 0.5 * math.pi)
    c, s, ch, sh = math.cos(tilt), math.sin(tilt), math.cos(0.5 * lon), math.sin(0.5 * lon)
    out[0], out[1], out[2], out[3] = ch * c, -sh * s, ch * s, sh * c


@kernel
def _attitude_kernel(state: FloatArray, out: FloatArray) -> None:
    """Fill out[0:4] with q_ib from roll, pitch, heading, latitude, longitude and angle of the Earth."""
    r, p, h = 0.5 * state[6], 0.5 * state[7], 0.5 * state[8]
    cr, sr, cp, sp, ch, sh = math.cos(r), math.sin(r), math.cos(p), math.sin(p), math.cos(h), math.sin(h)
    out[4] = ch * cp * cr + sh * sp * sr
    out[5] = ch * cp * sr - sh * sp * cr
    out[6] = ch * sp * cr + sh * cp * sr
    out[7] = sh * cp * cr - ch * sp * sr
    _level_kernel(state[9], state[10] + state[11], out)
    _multiply_kernel(out, out[4:8], out)


@kernel
def _geodetic_kernel(x: float, y: float, z: float) -> tuple[float, float, float]:
    """Return latitude, height and distance from the axis; Bowring (1976), below 1e-9 m near the ground."""
    across = math.sqrt(x * x + y * y)
    beta = math.atan2(_A * z, _B * across)
    lat = math.atan2(z + _SECOND_E2 * _B * math.sin(beta) ** 3, across - _E2 * _A * math.cos(beta) ** 3)
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    alt = across * cos_lat + z * sin_lat - _A * math.sqrt(1.0 - _E2 * sin_lat * sin_lat)
    return lat, alt, across


@kernel
def _step_kernel(state: FloatArray, dt: float, begin: FloatArray, end: FloatArray) -> None:
    """Fill begin[10:16] with turn and gained velocity of a step: `increments.step_increments`."""
    x = FT * state[0] + begin[4] + 0.5 * dt * begin[7]
    y = FT * state[1] + begin[5] + 0.5 * dt * begin[8]
    z = FT * state[2] + begin[6] + 0.5 * dt * begin[9]
    lat, alt, across = _geodetic_kernel(x, y, z)
    sin_lat, cos_lat = math.sin(lat), math.cos(lat)
    north, down = gravity_kernel(sin_lat, cos_lat, alt)
    outward = -(north * sin_lat + down * cos_lat) / across - EARTH_RATE**2
    begin[13] = end[7] - begin[7] - dt * outward * x
    begin[14] = end[8] - begin[8] - dt * outward * y
    begin[15] = end[9] - begin[9] - dt * (north * cos_lat - down * sin_lat)
    _rotate_kernel(begin, begin[13:16], -1.0, begin[13:16])
    w = begin[0] * end[0] + begin[1] * end[1] + begin[2] * end[2] + begin[3] * end[3]
    u = begin[0] * end[1] - begin[1] * end[0] - begin[2] * end[3] + begin[3] * end[2]
    v = begin[0] * end[2] + begin[1] * end[3] - begin[2] * end[0] - begin[3] * end[1]
    s = begin[0] * end[3] - begin[1] * end[2] + begin[2] * end[1] - begin[3] * end[0]
    size = math.sqrt(u * u + v * v + s * s)
    angle = 2.0 * math.atan2(size, abs(w))
    scale = math.copysign(angle / size if size > 1e-12 else 2.0, w)
    tx, ty, tz = scale * u, scale * v, scale * s
    n2 = angle * angle
    factor = (1.0 + n2 / 60.0 + n2 * n2 / 2520.0) / 12.0  # below 0.1 rad to 1e-10 of the once crossed
    a, b, c = begin[13], begin[14], begin[15]
    ox, oy, oz = ty * c - tz * b, tz * a - tx * c, tx * b - ty * a
    begin[10], begin[11], begin[12] = tx, ty, tz
    begin[13] = a - 0.5 * ox + factor * (ty * oz - tz * oy)
    begin[14] = b - 0.5 * oy + factor * (tz * ox - tx * oz)
    begin[15] = c - 0.5 * oz + factor * (tx * oy - ty * ox)
