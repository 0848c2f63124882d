"""A plain free-inertial navigator in the inertial frame, to replay truth with.

Shares normal gravity (`bench.core.mathematics.earth.gravity_kernel`) and the rate and figure of the Earth
with the bench; the geodetic latitude, the integration and the attitude are its own.
"""

from __future__ import annotations

from typing import Any

import numba
import numpy as np

from bench.core.compilation.compiled import choose_cache
from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray, read_only
from bench.core.mathematics.earth import EARTH_RATE, WGS84, gravity_kernel, matrix_en, to_ecef
from bench.core.records.data import Trajectory

_A, _E2 = WGS84.a, WGS84.e2

choose_cache()


def kernel(function: Any) -> Any:
    """Compile a function that may make arrays, unlike those of `bench.core.compilation.compiled`."""
    return numba.njit(cache=True, error_model="numpy")(function)


@kernel
def _gravitation(x: float, y: float, z: float, out: FloatArray) -> None:
    p = np.sqrt(x * x + y * y)
    lat = np.arctan2(z, p * (1.0 - _E2))
    for _ in range(5):
        s = np.sin(lat)
        lat = np.arctan2(z + _E2 * _A / np.sqrt(1.0 - _E2 * s * s) * s, p)
    s, c = np.sin(lat), np.cos(lat)
    alt = p * c + z * s - _A * np.sqrt(1.0 - _E2 * s * s)
    north, down = gravity_kernel(s, c, alt)
    outward = -north * s - down * c
    out[0] = outward * x / p - EARTH_RATE * EARTH_RATE * x
    out[1] = outward * y / p - EARTH_RATE * EARTH_RATE * y
    out[2] = north * c - down * s


@kernel
def _cross(a: FloatArray, b: FloatArray, out: FloatArray) -> None:
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@kernel
def _navigate_kernel(
    dt: float,
    two_sample: bool,
    dtheta: FloatArray,
    dvel: FloatArray,
    pos: FloatArray,
    vel: FloatArray,
    q: FloatArray,
) -> None:
    g, mid, x, y, dv = np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3), np.zeros(3)
    rotvec, a0, b0 = np.zeros(3), np.zeros(3), np.zeros(3)
    for k in range(dtheta.shape[0]):
        a, b = dtheta[k], dvel[k]
        rotvec[:] = a
        if two_sample:
            _cross(a0, a, x)
            rotvec += x / 12.0
        n2 = rotvec[0] ** 2 + rotvec[1] ** 2 + rotvec[2] ** 2
        n = np.sqrt(n2)
        if n > 1e-3:
            m1, m2, half = (1.0 - np.cos(n)) / n2, (n - np.sin(n)) / (n2 * n), np.sin(0.5 * n) / n
        else:
            m1, m2, half = 0.5 - n2 / 24.0, 1.0 / 6.0 - n2 / 120.0, 0.5 - n2 / 48.0
        _cross(rotvec, b, x)
        _cross(rotvec, x, y)
        dv[:] = b + m1 * x + m2 * y
        if two_sample:
            _cross(a0, b, x)
            _cross(b0, a, y)
            dv += (x + y) / 12.0
        w, u = q[k, 0], q[k, 1:]
        _cross(u, dv, x)
        x *= 2.0
        _cross(u, x, y)
        mid[:] = pos[k] + 0.5 * dt * vel[k]
        _gravitation(mid[0], mid[1], mid[2], g)
        vel[k + 1] = vel[k] + dv + w * x + y + dt * g
        pos[k + 1] = pos[k] + 0.5 * dt * (vel[k] + vel[k + 1])
        c, d = np.cos(0.5 * n), half * rotvec
        _cross(u, d, x)
        q[k + 1, 0] = w * c - u[0] * d[0] - u[1] * d[1] - u[2] * d[2]
        q[k + 1, 1:] = w * d + c * u + x
        q[k + 1] /= np.sqrt(np.sum(q[k + 1] ** 2))
        a0[:] = a
        b0[:] = b


def navigate(
    dt: float,
    dtheta_b: FloatArray,
    dvel_b: FloatArray,
    start: tuple[FloatArray, FloatArray, FloatArray],
    *,
    two_sample: bool,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity (N+1, 3) and q_ib (N+1, 4); start is the first of each.

    With ``two_sample`` the increments are integrals and get coning and sculling corrections; without, rate
    and specific force are constant within each interval.
    """
    n = len(dtheta_b) + 1
    pos, vel, q = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 4))
    pos[0], vel[0], q[0] = start
    dtheta_b, dvel_b = (read_only(np.ascontiguousarray(column)) for column in (dtheta_b, dvel_b))
    _navigate_kernel(dt, two_sample, dtheta_b, dvel_b, pos, vel, q)
    return pos, vel, q


def inertial(truth: Trajectory) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return position, velocity and q_ib of a truth in the inertial frame that is frame e at t = 0."""
    C_en = matrix_en(truth.lla[:, 0], truth.lla[:, 1])
    pos_e = to_ecef(truth.lla)
    vel_e = np.einsum("kij,kj->ki", C_en, truth.vel_n)
    half = 0.5 * EARTH_RATE * truth.t
    q_ie = np.stack([np.cos(half), 0 * half, 0 * half, np.sin(half)], axis=-1)
    vel_i = rotation.rotate(q_ie, vel_e + np.cross([0.0, 0.0, EARTH_RATE], pos_e))
    q_ib = rotation.multiply(q_ie, rotation.multiply(rotation.from_matrix(C_en), truth.q_nb))
    return rotation.rotate(q_ie, pos_e), vel_i, q_ib


def largest_difference(
    a: tuple[FloatArray, FloatArray, FloatArray], b: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[float, float]:
    """Return the largest distance [m] and angle [rad] between two motions."""
    distance = np.linalg.norm(a[0] - b[0], axis=1).max()
    angle = np.linalg.norm(
        rotation.to_rotvec(rotation.multiply(rotation.conjugate(a[2]), b[2])), axis=1
    ).max()
    return float(distance), float(angle)


def replay(truth: Trajectory, rate: float) -> tuple[float, float]:
    """Return the largest errors of position [m] and attitude [rad] of the increments navigated anew."""
    reference = inertial(truth)
    start = tuple(column[0] for column in reference)
    found = navigate(1 / rate, truth.dtheta_b, truth.dvel_b, start, two_sample=True)
    return largest_difference(found, reference)
