"""Exact increments of a recorded motion, computed only from position, velocity and attitude.

All in the inertial frame i, which is frame e at t = 0. A step turns the body by
th_k = log(q_k^-1 q_{k+1}) and, with bench gravitation g at the middle of the step,
adds the velocity C_k^T (v_{k+1} - v_k - g dt) = M(th_k) be_k, where
M(th) = I + (1 - cos|th|)/|th|^2 [th x] + (|th| - sin|th|)/|th|^3 [th x]^2.
(th, be) is motion at constant rate and specific force within the step. What a gyro and
an accelerometer integrate over a smooth motion through the same states is

    alpha_k = th_k - (th_{k-1} x th_k + th_k x th_{k+1}) / 24
    beta_k  = be_k - (th_{k-1} x be_k + be_{k-1} x th_k + th_k x be_{k+1} + be_k x th_{k+1}) / 24

An IMU at l off the center of gravity is at r + C l. Its velocity is that of the center of
gravity plus the derivative of C l, taken from the recorded attitudes by a central difference
of fourth order: position, velocity and attitude stay one motion, which reported rates would
break. The sum of such differences is the difference of positions, so nothing accumulates.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray, join_last, split_last
from bench.core.mathematics.earth import EARTH_RATE, gravity_n, matrix_en, to_geodetic
from bench.core.mathematics.rotation import (
    conjugate,
    continuous,
    cross,
    from_euler,
    multiply,
    rotate,
    to_rotvec,
)


@dataclass(frozen=True, slots=True)
class Motion:
    """Motion of a point of the body, one row per step of the simulation, at equal intervals."""

    dt: float  # [s]
    epa: FloatArray  # (K,) angle the Earth has turned since t = 0 [rad]
    pos_i: FloatArray  # (K, 3) [m]
    vel_i: FloatArray  # (K, 3) [m/s]
    q_nb: FloatArray  # (K, 4), sign-continuous
    q_ib: FloatArray  # (K, 4), sign-continuous

    def select(self, rows: slice) -> Motion:
        """Return selected rows of the motion."""
        columns = (self.epa, self.pos_i, self.vel_i, self.q_nb, self.q_ib)
        return Motion(self.dt, *(column[rows] for column in columns))


def from_states(
    dt: float, epa: FloatArray, pos_i: FloatArray, vel_i: FloatArray, euler: FloatArray, lat_lon: FloatArray
) -> Motion:
    """Build a motion from attitude as roll, pitch, heading (K, 3) at geodetic lat, lon (K, 2) [rad]."""
    q_nb = from_euler(euler[:, 0], euler[:, 1], euler[:, 2])
    q_ib = multiply(_level(lat_lon[:, 0], lat_lon[:, 1] + epa), q_nb)
    return Motion(dt, epa, pos_i, vel_i, continuous(q_nb), continuous(q_ib))


def at_point(motion: Motion, point_b: tuple[float, float, float]) -> Motion:
    """Return the motion of a body-fixed point, with the offset point_b (body axes) [m] from ``motion``.

    The last two rows are missing, because the velocity of a row needs two neighbors on either side. The first
    two have one-sided differences of the same order. A point with zero offset has the rows of ``motion``, bit
    for bit.
    """
    found = motion.select(slice(None, -2))
    if not any(point_b):
        return found
    arm_i = rotate(motion.q_ib, point_b)
    pos_i, vel_i = found.pos_i + arm_i[:-2], found.vel_i + derivative(arm_i, motion.dt)
    lat, lon, _ = split_last(to_geodetic(pos_i))  # longitude from the axis x of i
    q_nb = continuous(multiply(conjugate(_level(lat, lon)), found.q_ib))
    return replace(found, pos_i=pos_i, vel_i=vel_i, q_nb=q_nb)


def derivative(u: FloatArray, dt: float) -> FloatArray:
    """Return the derivative (K-2, 3) of u (K, 3), K >= 5, at all rows but the last two, to order dt^4."""
    rate = np.empty_like(u[:-2])
    rate[0] = -25 * u[0] + 48 * u[1] - 36 * u[2] + 16 * u[3] - 3 * u[4]
    rate[1] = -3 * u[0] - 10 * u[1] + 18 * u[2] - 6 * u[3] + u[4]
    rate[2:] = 8 * (u[3:-1] - u[1:-3]) - (u[4:] - u[:-4])
    rate /= 12 * dt
    return rate


def _level(lat: FloatArray, lon: FloatArray) -> FloatArray:
    """Return q_in (K, 4) at geodetic latitude and longitude from the axis x of i [rad]."""
    half_lon = 0.5 * lon
    half_lat = -0.5 * (lat + 0.5 * np.pi)
    zero = np.zeros_like(half_lon)
    about_z = join_last([np.cos(half_lon), zero, zero, np.sin(half_lon)])
    about_y = join_last([np.cos(half_lat), zero, np.sin(half_lat), zero])
    return multiply(about_z, about_y)


def gravitation_i(pos_i: FloatArray) -> FloatArray:
    """Return bench gravity without its centrifugal part at positions (K, 3) [m], as (K, 3) [m/s^2], i."""
    lat, lon, alt = split_last(to_geodetic(pos_i))  # longitude from the axis x of i
    north, _, down = split_last(gravity_n(lat, alt))
    outward = -north * np.sin(lat) - down * np.cos(lat)
    return join_last(
        [
            outward * np.cos(lon) - EARTH_RATE**2 * pos_i[:, 0],
            outward * np.sin(lon) - EARTH_RATE**2 * pos_i[:, 1],
            north * np.cos(lat) - down * np.sin(lat),
        ]
    )


def earth_relative(epa: FloatArray, pos_i: FloatArray, vel_i: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return geodetic position (K, 3) [rad, rad, m] and Earth-relative velocity (K, 3) [m/s], n."""
    carried = join_last([-pos_i[:, 1], pos_i[:, 0], np.zeros(len(pos_i))])
    pos_e, vel_e = _about_pole(-epa, pos_i), _about_pole(-epa, vel_i - EARTH_RATE * carried)
    lla = to_geodetic(pos_e)
    vel_n = np.einsum("kji,kj->ki", matrix_en(lla[:, 0], lla[:, 1]), vel_e)
    return lla, vel_n


def _about_pole(angle: FloatArray, v: FloatArray) -> FloatArray:
    c, s = np.cos(angle), np.sin(angle)
    return join_last([c * v[:, 0] - s * v[:, 1], s * v[:, 0] + c * v[:, 1], v[:, 2]])


def step_increments(motion: Motion) -> tuple[FloatArray, FloatArray]:
    """Return (th, be), (K-1, 3) each [rad, m/s], b at the start of each step: constant within the step."""
    dt, q = motion.dt, motion.q_ib[:-1]
    th = to_rotvec(multiply(conjugate(q), motion.q_ib[1:]))
    gravitation = gravitation_i(motion.pos_i[:-1] + 0.5 * dt * motion.vel_i[:-1])
    dv = rotate(conjugate(q), np.diff(motion.vel_i, axis=0) - dt * gravitation)
    return th, _unrotate(th, dv)


def true_integrals(th: FloatArray, be: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the integrals (alpha, beta) of rate and specific force over each step but the last."""
    th_x_th = cross(th[:-1], th[1:])
    mixed = cross(th[:-1], be[1:]) + cross(be[:-1], th[1:])
    alpha, beta = th[:-1].copy(), be[:-1].copy()
    alpha -= th_x_th / 24
    beta -= mixed / 24
    alpha[1:] -= th_x_th[:-1] / 24
    beta[1:] -= mixed[:-1] / 24
    # the step before the first is taken to be like it: its products vanish for alpha, and for beta too
    return alpha, beta


def _unrotate(th: FloatArray, dv: FloatArray) -> FloatArray:
    """Return M(th)^-1 dv: with n = |th|, I - [th x]/2 + (1 - n/2 cot(n/2))/n^2 [th x]^2."""
    n2 = np.sum(th * th, axis=-1, keepdims=True)
    half = 0.5 * np.sqrt(np.where(n2 > 1e-4, n2, 1.0))
    series = (1 + n2 / 60 + n2 * n2 / 2520) / 12  # the next term is below 1e-17
    factor = np.where(n2 > 1e-4, (1 - half / np.tan(half)) / (4 * half * half), series)
    once = cross(th, dv)
    result: FloatArray = dv - 0.5 * once + factor * cross(th, once)
    return result
