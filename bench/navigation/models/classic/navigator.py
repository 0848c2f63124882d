"""The inertial navigator in east, north, up: A-5.1.2 to A-5.1.4, and its correction A-5.4.8 to A-5.4.9."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import (
    EARTH_RATE,
    WGS84,
    gravity_gradient_kernel,
    gravity_kernel,
    radii_kernel,
)
from bench.core.mathematics.units import STANDARD_GRAVITY

R3 = 6_371_000.0  # sphere of the reduced coordinates [m], equations 1.5

NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # and back; equations 1.3
FRD_OF_FUR = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # equations 1.3

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class Earth:
    """Radii and gravity at one place, and how they change with latitude and height."""

    r1: float  # prime vertical + h, the source's R1 + h [m]
    r2: float  # meridian + h, the source's R2 + h [m]
    r1_lat: float  # [m/rad]
    r2_lat: float  # [m/rad]
    g_n: float  # northward component of gravity [m/s^2]
    g: float  # downward component, gamma(lat, h) [m/s^2]
    g_n_lat: float  # [m/s^2/rad]
    g_n_h: float  # [1/s^2]
    g_lat: float  # [m/s^2/rad]
    g_h: float  # [1/s^2]


def ellipsoid(lat: float, h: float) -> Earth:
    """Return WGS 84 with Somigliana's gravity (A-5.1.4g, A-2.2.G)."""
    s, c = math.sin(lat), math.cos(lat)
    meridian, prime = radii_kernel(s)
    w2 = 1.0 - WGS84.e2 * s * s
    g_n, g = gravity_kernel(s, c, h)
    g_n_h, g_n_lat, g_h, g_lat = gravity_gradient_kernel(s, c, h)
    slope = WGS84.e2 * s * c / w2
    return Earth(
        prime + h, meridian + h, prime * slope, 3 * meridian * slope, g_n, g, g_n_lat, g_n_h, g_lat, g_h
    )


@dataclass(frozen=True, slots=True)
class Nav:
    """State of the inertial navigator."""

    lat: float  # [rad]
    lon: float  # [rad]
    h: float  # ellipsoidal [m]
    V: FloatArray  # (3,) east, north, up [m/s]
    B: FloatArray  # (3, 3) body (forward, up, right) to east, north, up


def mechanize(nav: Nav, dt: float, turn: Vector, dvel: Vector) -> tuple[Nav, FloatArray]:
    """Carry the navigator over one interval; return it and the velocity increment B dvel (3,) [m/s].

    ``turn`` and ``dvel`` come from :func:`body_increments`. Coriolis, gravity and the rate of the triad are
    taken at the middle of the interval; the attitude turns by exact rotations on both sides (A-5.1.3).
    """
    v_e, v_n, v_h = nav.V.tolist()
    dv = nav.B @ np.array(dvel)
    a_e, a_n, a_h = dv.tolist()
    lat = nav.lat + 0.5 * dt * v_n / WGS84.a  # the radius matters here below 1e-10 rad
    h = nav.h + 0.5 * dt * v_h
    s, c = math.sin(lat), math.cos(lat)
    meridian, prime = radii_kernel(s)
    r1, r2 = prime + h, meridian + h
    g_n, g = gravity_kernel(s, c, h)
    lat_rate, lon_rate = v_n / r2, v_e / (r1 * c)  # at the start of the interval
    w_e, w_n, w_h = -lat_rate, (2 * EARTH_RATE + lon_rate) * c, (2 * EARTH_RATE + lon_rate) * s  # of
    m_e = v_e + 0.5 * (a_e - dt * (w_n * v_h - w_h * v_n))
    m_n = v_n + 0.5 * (a_n - dt * (w_h * v_e - w_e * v_h - g_n))
    m_h = v_h + 0.5 * (a_h - dt * (w_e * v_n - w_n * v_e + g))

    lat_rate, lon_rate = m_n / r2, m_e / (r1 * c)  # and at its middle
    w_e, w_n, w_h = -lat_rate, (2 * EARTH_RATE + lon_rate) * c, (2 * EARTH_RATE + lon_rate) * s
    turned = (EARTH_RATE + lon_rate) * dt
    z_e, z_n, z_h = -lat_rate * dt, turned * c, turned * s  # turn of the triad
    u_e = v_e + a_e - 0.5 * (z_n * a_h - z_h * a_n) - dt * (w_n * m_h - w_h * m_n)
    u_n = v_n + a_n - 0.5 * (z_h * a_e - z_e * a_h) - dt * (w_h * m_e - w_e * m_h - g_n)
    u_h = v_h + a_h - 0.5 * (z_e * a_n - z_n * a_e) - dt * (w_e * m_n - w_n * m_e + g)
    moved = Nav(
        nav.lat + 0.5 * dt * (v_n + u_n) / r2,
        nav.lon + 0.5 * dt * (v_e + u_e) / (r1 * c),
        nav.h + 0.5 * dt * (v_h + u_h),
        np.array([u_e, u_n, u_h]),
        turn_matrix(-z_e, -z_n, -z_h) @ nav.B @ turn_matrix(*turn),
    )
    return moved, dv


def body_increments(
    dt: float, dtheta: Vector, dvel: Vector, before: tuple[float, Vector, Vector] | None
) -> tuple[Vector, Vector]:
    """Return the rotation vector of an interval and its velocity increment in the body axes at its start.

    Coning and sculling by the interval before, ``(dt, dtheta, dvel)`` or None: both rates are lines through
    the two means (equations 10; 1/12 for equal intervals).
    """
    a, b, c = dtheta
    u, v, w = dvel
    x, y, z, p, q, r = a, b, c, u, v, w
    if before is not None:
        h, (a0, b0, c0), (u0, v0, w0) = before
        f = dt * dt / (6.0 * h * (h + dt))
        x, y, z = a + f * (b0 * c - c0 * b), b + f * (c0 * a - a0 * c), c + f * (a0 * b - b0 * a)
        p += f * (b0 * w - c0 * v + v0 * c - w0 * b)
        q += f * (c0 * u - a0 * w + w0 * a - u0 * c)
        r += f * (a0 * v - b0 * u + u0 * b - v0 * a)
    angle2 = x * x + y * y + z * z
    angle = math.sqrt(angle2)
    if angle < 1e-3:  # the next terms are below 1e-14
        m1, m2 = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        m1, m2 = (1.0 - math.cos(angle)) / angle2, (angle - math.sin(angle)) / (angle2 * angle)
    k, l, m = y * w - z * v, z * u - x * w, x * v - y * u  # noqa: E741 - turn x dvel
    return (x, y, z), (
        p + m1 * k + m2 * (y * m - z * l),
        q + m1 * l + m2 * (z * k - x * m),
        r + m1 * m + m2 * (x * l - y * k),
    )


def turn_matrix(x: float, y: float, z: float) -> FloatArray:
    """Return exp([v x]) (3, 3) of a rotation vector [rad], Rodrigues."""
    angle2 = x * x + y * y + z * z
    angle = math.sqrt(angle2)
    if angle < 1e-3:  # the next terms are below 1e-14
        s, v = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        s, v = math.sin(angle) / angle, (1.0 - math.cos(angle)) / angle2
    return np.array(
        [
            [1.0 - v * (y * y + z * z), v * x * y - s * z, v * x * z + s * y],
            [v * x * y + s * z, 1.0 - v * (x * x + z * z), v * y * z - s * x],
            [v * x * z - s * y, v * y * z + s * x, 1.0 - v * (x * x + y * y)],
        ]
    )


def reduced(nav: Nav, earth: Earth) -> tuple[float, float]:
    """Return the number of reduced meters in a meter east and in a meter north (equations 1.5).

    On the sphere at sea level these are the source's 1/cos(lat) and 1.
    """
    return R3 / (earth.r1 * math.cos(nav.lat)), R3 / earth.r2


def corrected(nav: Nav, x: FloatArray) -> Nav:
    """Return the navigator less an estimated error x (22,) (A-5.4.8, A-5.4.9).

    The attitude turns by exact rotations, so that it stays orthogonal: the horizontal part of alpha first, as
    the error state has it (`error_state`).
    """
    east, north, up = (float(v) for v in x[6:9])
    return Nav(
        nav.lat - x[1] / R3,
        nav.lon - x[0] / R3,
        nav.h - x[2],
        nav.V - x[3:6],
        turn_matrix(0.0, 0.0, up) @ turn_matrix(east, north, 0.0) @ nav.B,
    )


def axes_turned(nav: Nav, x: FloatArray) -> FloatArray:
    """Return the rotation of P (22, 22) with the IMU axes when :func:`corrected` subtracts x (22,).

    As in `bench.navigation.error_state_filter.corrections.axes_kernel`.
    """
    s, c = math.sin(x[8]), math.cos(x[8])
    turned = np.eye(len(x))
    turned[6:8, 6:8] = [[c, -s], [s, c]]
    tilted = np.cross(x[12:15], nav.B[2]) / STANDARD_GRAVITY
    turned[12:15, 12:15] = rotation.matrix(rotation.from_rotvec(tilted))
    return turned
