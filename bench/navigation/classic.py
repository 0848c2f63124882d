"""The source's 22-state filter, step by step in the order and the symbols of the equation register.

East, north, up; heading clockwise; body axes forward, up, right; attitude as the matrix B from body to east,
north, up. Errors are computed minus true, and alpha turns the true triad into the computed one:
``B_computed = (I - [alpha x]) B`` (equations 1.4). Position errors are in reduced coordinates,
``dR_E = R3 dlon`` and ``dR_N = R3 dlat`` on a sphere of fixed radius R3 (equations 1.5), so ``reduced`` says
how many of them make a metre. The state (A-5.4.1):

    0-2   dR_E, dR_N [m, reduced], dh [m]           9-11  gyro errors eps [rad/s], body
    3-5   dV_E, dV_N, dV_h [m/s]                    12-14 accelerometer errors da [m/s^2], body
    6-8   alpha_E, alpha_N, alpha_h [rad]           15    barometer bias [m]
    16-18 Markov part of the GNSS position [m, 16 and 17 reduced], 19-21 of its velocity [m/s]

In one respect each the filter goes beyond the source, as the register decides: the radii of the ellipsoid and
Somigliana's gravity in place of a sphere (A-5.1.10, A-5.1.4g), seven measurements in place of eight
(A-5.4.8R), coning and sculling of the previous interval, and the lever arm of the GNSS antenna (section 10).

It shares with the compiled filters the datasheets, the Earth and the choice of rows of a record; the
covariance is `filterpy`'s, and everything else is its own, so that one can be held against the other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench import rotation
from bench.arrays import FloatArray
from bench.data import Events, InitialState, Innovations, NavSolution, SensorData
from bench.earth import RATE, WGS84, gravity_gradient_kernel, gravity_kernel, radii_kernel
from bench.navigation import alignment, square_root, timeline
from bench.navigation.blocks import GNSS_MARKOV
from bench.navigation.error_state import StateLayout
from bench.navigation.integrity import correction_period, nis, nis_limit, tolerance, trace_ratio
from bench.navigation.measurements import BARO, FIXES, unmodelled
from bench.navigation.options import ClassicOptions, read_options
from bench.specs import AssumedSpecs, TriadSpec

R3 = 6_371_000.0  # sphere of the reduced coordinates [m], equations 1.5
SIZE = 22
NOISES = 28

NED_OF_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # and back; equations 1.3
FRD_OF_FUR = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # equations 1.3

SENSORS = ("gnss_position", "gnss_velocity", "baro")
_ROWS = {"baro": [0], "gnss_position": [1, 2, 3], "gnss_velocity": [4, 5, 6]}
_STATES = {"baro": [15], "gnss_position": [0, 1, 2], "gnss_velocity": [3, 4, 5]}

Vector = tuple[float, float, float]

# --- the mechanization: to A-5.1.4 -----------------------------------------------------------------


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
    """Return WGS 84 with Somigliana's gravity (A-5.1.4g, section 3)."""
    s, c = math.sin(lat), math.cos(lat)
    meridian, prime = radii_kernel(s)
    w2 = 1.0 - WGS84.e2 * s * s
    g_n, g = gravity_kernel(s, c, h)
    g_n_h, g_n_lat, g_h, g_lat = gravity_gradient_kernel(s, c, h)
    slope = WGS84.e2 * s * c / w2
    return Earth(
        prime + h, meridian + h, prime * slope, 3 * meridian * slope, g_n, g, g_n_lat, g_n_h, g_lat, g_h
    )


def sphere(lat: float, h: float) -> Earth:
    """Return the source's sphere of radius R3 with g = g_e (1 + beta sin^2 lat)(1 - 2 h / R3) (A-5.1.6)."""
    s, c = math.sin(lat), math.cos(lat)
    g_e, beta = 9.7803253359, 0.0053024  # equations 1.6 and
    surface, height = g_e * (1.0 + beta * s * s), 1.0 - 2.0 * h / R3
    return Earth(
        r1=R3 + h,
        r2=R3 + h,
        r1_lat=0.0,
        r2_lat=0.0,
        g_n=0.0,
        g=surface * height,
        g_n_lat=0.0,
        g_n_h=0.0,
        g_lat=2.0 * beta * g_e * s * c * height,
        g_h=-2.0 * surface / R3,
    )


@dataclass(frozen=True, slots=True)
class Nav:
    """What the inertial navigator knows."""

    lat: float  # [rad]
    lon: float  # [rad]
    h: float  # ellipsoidal [m]
    V: FloatArray  # (3,) east, north, up [m/s]
    B: FloatArray  # (3, 3) body (forward, up, right) to east, north, up


def body_to_enu(heading: float, pitch: float, roll: float) -> FloatArray:
    """Return B (3, 3) of heading (clockwise from north), pitch and roll [rad] (A-5.1.1)."""
    sp, cp = math.sin(heading), math.cos(heading)
    st, ct = math.sin(pitch), math.cos(pitch)
    sg, cg = math.sin(roll), math.cos(roll)
    return np.array(
        [
            [sp * ct, cp * sg - sp * cg * st, cp * cg + sp * sg * st],
            [cp * ct, -sp * sg - cp * cg * st, -sp * cg + cp * sg * st],
            [st, cg * ct, -sg * ct],
        ]
    )


def rates(
    nav: Nav, w_b: ArrayLike, a_b: ArrayLike, earth: Earth
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return d/dt of (lat, lon, h), of V and of B: the equations the navigator integrates.

    Parameters
    ----------
    nav : Nav
        Where it is.
    w_b, a_b : (3,) arrays
        Inertial rate [rad/s] and specific force [m/s^2], body.
    earth : Earth
        Radii and gravity there.
    """
    s, c, tan = math.sin(nav.lat), math.cos(nav.lat), math.tan(nav.lat)
    v_e, v_n, v_h = nav.V
    lat_rate, lon_rate = v_n / earth.r2, v_e / (earth.r1 * c)
    dn = np.array(
        [
            v_e * v_h / earth.r1 - v_e * v_n * tan / earth.r1 + 2 * RATE * (v_h * c - v_n * s),
            v_n * v_h / earth.r2 + v_e**2 * tan / earth.r1 + 2 * RATE * v_e * s,
            -(v_e**2) / earth.r1 - v_n**2 / earth.r2 - 2 * RATE * v_e * c,
        ]
    )
    V_rate = nav.B @ np.asarray(a_b, float) - dn + [0.0, earth.g_n, -earth.g]
    w_in = np.array([-lat_rate, (RATE + lon_rate) * c, (RATE + lon_rate) * s])
    B_rate = nav.B @ rotation.skew(w_b) - rotation.skew(w_in) @ nav.B
    return np.array([lat_rate, lon_rate, v_h]), V_rate, B_rate


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
    w_e, w_n, w_h = -lat_rate, (2 * RATE + lon_rate) * c, (2 * RATE + lon_rate) * s  # of
    m_e = v_e + 0.5 * (a_e - dt * (w_n * v_h - w_h * v_n))
    m_n = v_n + 0.5 * (a_n - dt * (w_h * v_e - w_e * v_h - g_n))
    m_h = v_h + 0.5 * (a_h - dt * (w_e * v_n - w_n * v_e + g))

    lat_rate, lon_rate = m_n / r2, m_e / (r1 * c)  # and at its middle
    w_e, w_n, w_h = -lat_rate, (2 * RATE + lon_rate) * c, (2 * RATE + lon_rate) * s
    z_e, z_n, z_h = (
        -lat_rate * dt,
        (RATE + lon_rate) * c * dt,
        (RATE + lon_rate) * s * dt,
    )  # turn of the triad
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
    the two means (section 10; 1/12 for equal intervals).
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


# --- the error model: to A-5.1.13 -----------------------------------------------------------------


def dynamics_matrix(nav: Nav, a: ArrayLike, earth: Earth) -> FloatArray:
    """Return F (15, 15) of the inertial states (A-5.1.10), ``a`` the specific force east, north, up [m/s^2].

    The elements of the register with R1 + h in the east rows and R2 + h in the north rows, and what the
    change of the radii with latitude adds; on :func:`sphere` these are the register's own.
    """
    s, c = math.sin(nav.lat), math.cos(nav.lat)
    tan = s / c
    v_e, v_n, v_h = (float(v) for v in nav.V)
    a_e, a_n, a_h = (float(v) for v in np.asarray(a, float))
    r1, r2, r1_lat, r2_lat = earth.r1, earth.r2, earth.r1_lat, earth.r2_lat
    lat_rate, lon_rate = v_n / r2, v_e / (r1 * c)
    U = 2 * RATE + lon_rate
    w_e, w_n, w_h = -lat_rate, (RATE + lon_rate) * c, (RATE + lon_rate) * s

    F = np.zeros((15, 15))
    F[0, 1] = lon_rate * (tan - r1_lat / r1)
    F[0, 2], F[0, 3] = -lon_rate * R3 / r1, R3 / (r1 * c)
    F[1, 1], F[1, 2], F[1, 4] = -lat_rate * r2_lat / r2, -lat_rate * R3 / r2, R3 / r2
    F[2, 5] = 1.0

    F[3, 1] = (
        U * (v_h * s + v_n * c)
        - lon_rate * tan * (v_h * c - v_n * s)
        + v_e * (v_h - v_n * tan) * r1_lat / r1**2
    ) / R3
    F[3, 2] = v_e * (v_h - v_n * tan) / r1**2
    F[3, 3], F[3, 4], F[3, 5] = (v_n * tan - v_h) / r1, U * s, -U * c
    F[4, 1] = (
        -U * v_e * c
        - v_e**2 * tan**2 / r1
        + v_e**2 * tan * r1_lat / r1**2
        + v_n * v_h * r2_lat / r2**2
        + earth.g_n_lat
    ) / R3
    F[4, 2] = v_e**2 * tan / r1**2 + v_h * v_n / r2**2 + earth.g_n_h
    F[4, 3], F[4, 4], F[4, 5] = -2 * (RATE + lon_rate) * s, -v_h / r2, -lat_rate
    F[5, 1] = (-2 * RATE * v_e * s - v_e**2 * r1_lat / r1**2 - v_n**2 * r2_lat / r2**2 - earth.g_lat) / R3
    F[5, 2] = -earth.g_h - v_e**2 / r1**2 - v_n**2 / r2**2
    F[5, 3], F[5, 4] = 2 * (RATE + lon_rate) * c, 2 * lat_rate
    F[3, 7], F[3, 8] = -a_h, a_n
    F[4, 6], F[4, 8] = a_h, -a_e
    F[5, 6], F[5, 7] = -a_n, a_e
    F[3:6, 12:15] = nav.B

    F[6, 1], F[6, 2], F[6, 4] = lat_rate * r2_lat / r2 / R3, v_n / r2**2, -1 / r2
    F[7, 1] = (-RATE * s - v_e * r1_lat / r1**2) / R3
    F[7, 2], F[7, 3] = -v_e / r1**2, 1 / r1
    F[8, 1] = (RATE * c + lon_rate / c - v_e * tan * r1_lat / r1**2) / R3
    F[8, 2], F[8, 3] = -v_e * tan / r1**2, tan / r1
    F[6, 7], F[6, 8] = w_h, -w_n
    F[7, 6], F[7, 8] = -w_h, w_e
    F[8, 6], F[8, 7] = w_n, -w_e
    F[6:9, 9:12] = -nav.B
    return F


def noise_matrix(B: FloatArray, process: ArrayLike, gyro: float, accel: float) -> FloatArray:
    """Return G (15, 21), densities in unit/sqrt(s) (A-5.1.11).

    Parameters
    ----------
    B : (3, 3) array
        Body to east, north, up.
    process : (15,) array
        sigma_1 to sigma_15; the last six drive the sensor errors.
    gyro, accel : float
        Angular [rad/sqrt(s)] and velocity random walk [m/s/sqrt(s)].
    """
    G = np.zeros((15, 21))
    G[:15, :15] = np.diag(np.asarray(process, float))
    G[6:9, 15:18] = -gyro * B
    G[3:6, 18:21] = accel * B
    return G


def equatorial_matrix(lat: float) -> FloatArray:
    """Return Q (3, 3): east, north, up to the moving equatorial axes xi, eta (pole), zeta (A-5.1.1Q)."""
    s, c = math.sin(lat), math.cos(lat)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def alpha_of_delta(lat: float, dR_E: float, dR_N: float, delta: ArrayLike) -> FloatArray:
    """Return alpha (3,) of the equatorial attitude error delta and the reduced position errors (A-5.1.12)."""
    turned = np.array([-dR_N, dR_E * math.cos(lat), dR_E * math.sin(lat)]) / R3
    alpha: FloatArray = equatorial_matrix(lat).T @ np.asarray(delta, float) + turned
    return alpha


def delta_rate(lon_rate: float, delta: ArrayLike, eps: ArrayLike) -> FloatArray:
    """Return d/dt of delta (3,) for gyro errors ``eps`` in the moving equatorial axes (A-5.1.12b)."""
    d, e = np.asarray(delta, float), np.asarray(eps, float)
    turn = RATE + lon_rate
    return np.array([-turn * d[2] - e[0], -e[1], turn * d[0] - e[2]])


def inertial_matrix(angle: float) -> FloatArray:
    """Return the matrix (3, 3) from moving equatorial to inertial axes, ``angle`` = u t + lon (A-5.1.13)."""
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


# --- the filter, A-5.4 ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Sigmas:
    """The figures of the filter's model, standard deviations unless said otherwise; SI."""

    gyro: float  # angular random walk, sigma_omega [rad/sqrt(s)]
    accel: float  # velocity random walk, sigma_a [m/s/sqrt(s)]
    eps_walk: float  # of the gyro errors, sigma_10..12 [rad/s/sqrt(s)]
    da_walk: float  # of the accelerometer errors, sigma_13..15 [m/s^2/sqrt(s)]
    eps: float  # gyro errors at the start [rad/s]
    da: float  # accelerometer errors at the start [m/s^2]
    h: float  # barometer, white [m]
    xi: float  # barometer bias, walk [m/sqrt(s)]
    bb: float  # barometer bias at the start [m]
    white: Vector  # GNSS sigma_Rs, sigma_Hs [m], sigma_Vs [m/s]
    markov: Vector  # GNSS sigma_Rc, sigma_Hc [m], sigma_Vc [m/s]
    lambda_s: float  # decay of the position's Markov part by distance [1/m]
    lambda_st: float  # and by time [1/s]
    lambda_v: float  # decay of the velocity's Markov part [1/s]
    jump_white: Vector = (
        0.0,
        0.0,
        0.0,
    )  # sigma_dRs, sigma_dHs [m], sigma_dVs [m/s] at a new set of satellites
    jump_markov: Vector = (0.0, 0.0, 0.0)  # sigma_dRc, sigma_dHc [m], sigma_dVc [m/s]


def sigmas(specs: AssumedSpecs) -> Sigmas:
    """Return the filter's figures of the assumed datasheets; a sensor without one gets zeros.

    Sensor errors are random walks (A-5.1.8): a bias instability of standard deviation s and correlation tau
    starts with the turn-on bias and s together and walks with s sqrt(2 / tau).
    """
    eps, eps_walk = _walk(specs.imu.gyro)
    da, da_walk = _walk(specs.imu.accel)
    b, g = specs.baro, specs.gnss
    none = (0.0, 0.0, 0.0)
    return Sigmas(
        gyro=specs.imu.gyro.random_walk,
        accel=specs.imu.accel.random_walk,
        eps_walk=eps_walk,
        da_walk=da_walk,
        eps=eps,
        da=da,
        h=b.white_sd if b else 0.0,
        xi=b.bias_walk if b else 0.0,
        bb=b.bias_sd if b else 0.0,
        white=(g.pos_h_white_sd, g.pos_v_white_sd, g.vel_white_sd) if g else none,
        markov=(g.pos_h_markov_sd, g.pos_v_markov_sd, g.vel_markov_sd) if g else none,
        lambda_s=g.pos_decay_distance if g else 0.0,
        lambda_st=g.pos_decay_time if g else 0.0,
        lambda_v=g.vel_decay_time if g else 0.0,
    )


def _walk(triad: TriadSpec) -> tuple[float, float]:
    if triad.instability_sd == 0:
        return triad.turn_on_bias_sd, 0.0
    start = math.hypot(triad.turn_on_bias_sd, triad.instability_sd)
    return start, triad.instability_sd * math.sqrt(2 / triad.bias_correlation)


def reduced(nav: Nav, earth: Earth) -> tuple[float, float]:
    """Return how many reduced metres a metre east and a metre north are (equations 1.5).

    On the sphere at sea level these are the source's 1/cos(lat) and 1.
    """
    return R3 / (earth.r1 * math.cos(nav.lat)), R3 / earth.r2


def gnss_decay(sig: Sigmas, speed: float, T: float) -> FloatArray:
    """Return diag(W_R x 3, W_V x 3) as (6,) over T [s] at a ground speed [m/s] (A-5.2.2)."""
    w_r = math.exp(-(sig.lambda_s * speed + sig.lambda_st) * T)
    w_v = math.exp(-sig.lambda_v * T)
    return np.array([w_r, w_r, w_r, w_v, w_v, w_v])


def gnss_noise(sig: Sigmas, decay: FloatArray, east: float, north: float, jump: bool) -> FloatArray:
    """Return G_S (6, 6), Markov and jump noise of a channel merged (A-5.4.2, 28 noises)."""
    q = np.sqrt(1.0 - decay**2)
    unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
    return np.diag(np.hypot(q * _per_axis(sig.markov), float(jump) * _per_axis(sig.jump_markov)) * unit)


def gnss_noise_12(sig: Sigmas, decay: FloatArray, east: float, north: float, jump: bool) -> FloatArray:
    """Return G_S (6, 12) with Markov and jump noise apart: the 34 noises of the published blocks."""
    q = np.sqrt(1.0 - decay**2)
    unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
    return np.hstack(
        [
            np.diag(q * _per_axis(sig.markov) * unit),
            np.diag(float(jump) * _per_axis(sig.jump_markov) * unit),
        ]
    )


def _per_axis(figures: Vector) -> FloatArray:
    r, h, v = figures
    return np.array([r, r, h, v, v, v])


def model(
    nav: Nav, earth: Earth, a: ArrayLike, sig: Sigmas, T: float, *, jump: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return Phi_p (22, 22) and G_p (22, 28) over T [s], first order (A-5.1.D, A-5.4.2).

    Phi = E + F T and G sqrt(T); the GNSS block is exact and its noise G_S holds T already.
    """
    decay = gnss_decay(sig, math.hypot(nav.V[0], nav.V[1]), T)
    Phi, G = np.eye(SIZE), np.zeros((SIZE, NOISES))
    Phi[:15, :15] += dynamics_matrix(nav, a, earth) * T
    Phi[16:, 16:] = np.diag(decay)
    G[:15, :21] = _noise(nav, sig) * math.sqrt(T)
    G[15, 21] = sig.xi * math.sqrt(T)
    G[16:, 22:] = gnss_noise(sig, decay, *reduced(nav, earth), jump)
    return Phi, G


def model_van_loan(
    nav: Nav, earth: Earth, a: ArrayLike, sig: Sigmas, T: float, *, jump: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return Phi_p (22, 22) and Q_p = G_p G_p' (22, 22), the inertial block by van Loan (A-5.1.D)."""
    Phi, G = model(nav, earth, a, sig, T, jump=jump)
    Q = G @ G.T
    F, noise = dynamics_matrix(nav, a, earth), _noise(nav, sig)
    joint = np.zeros((30, 30))
    joint[:15, :15], joint[:15, 15:], joint[15:, 15:] = -F * T, noise @ noise.T * T, F.T * T
    joint = _exponential(joint)
    Phi[:15, :15] = joint[15:, 15:].T
    Q[:15, :15] = Phi[:15, :15] @ joint[:15, 15:]
    return Phi, Q


def _exponential(A: FloatArray) -> FloatArray:
    """Return exp(A) by its series: over a step F T is all but nilpotent, and a dozen terms are exact."""
    term, total = np.eye(len(A)), np.eye(len(A))
    for k in range(1, 40):
        term = term @ A / k
        total += term
        if (np.abs(term) <= 1e-17 * np.abs(total)).all():
            break
    return total


def _noise(nav: Nav, sig: Sigmas) -> FloatArray:
    process = np.repeat([0.0, 0.0, 0.0, sig.eps_walk, sig.da_walk], 3)
    return noise_matrix(nav.B, process, sig.gyro, sig.accel)


def measurement_matrix() -> FloatArray:
    """Return H (8, 22) as published, without a lever arm (A-5.4.H); its last row is row 4 less row 1."""
    H = np.zeros((8, SIZE))
    for row, plus, minus in (
        (0, 2, 15), (1, 0, 16), (2, 1, 17), (3, 2, 18), (4, 3, 19), (5, 4, 20), (6, 5, 21),
    ):  # fmt: skip
        H[row, plus], H[row, minus] = 1.0, -1.0
    H[7, 15], H[7, 18] = 1.0, -1.0
    return H


def measurement_noise(sig: Sigmas, east: float, north: float, jump: bool) -> FloatArray:
    """Return Q_p (8, 13), the published noise of the measurements; R = Q_p Q_p' has rank 7 (A-5.4.Q)."""
    unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
    Q = np.zeros((8, 13))
    Q[0, 0], Q[7, 0] = -sig.h, sig.h
    Q[1:7, 1:7] = -np.diag(_per_axis(sig.white) * unit)
    Q[1:7, 7:13] = -float(jump) * np.diag(_per_axis(sig.jump_white) * unit)
    Q[7, 1:] = Q[3, 1:]
    return Q


def antenna_matrix(H: FloatArray, nav: Nav, earth: Earth, antenna: FloatArray, w_b: FloatArray) -> None:
    """Write what a lever arm adds to H (8, 22): the source has none (section 10).

    The computed antenna is at r + B l and moves with V + B (w x l), w the rate of the body against the
    Earth; with ``B_computed = B - [alpha x] B`` the errors of these terms are [B l x] alpha, [B (w x l) x]
    alpha and -[B l x] B eps.
    """
    east, north = reduced(nav, earth)
    arm = rotation.skew(nav.B @ antenna)
    H[1:4, 6:9] = arm * np.array([[east], [north], [1.0]])
    H[4:7, 6:9] = rotation.skew(nav.B @ antenna_sweep(nav, antenna, w_b))
    H[4:7, 9:12] = -arm @ nav.B
    H[7, 6:12] = H[3, 6:12] - H[0, 6:12]


def antenna_sweep(nav: Nav, antenna: FloatArray, w_b: FloatArray) -> FloatArray:
    """Return the velocity (3,) [m/s], body, of an antenna relative to the IMU."""
    earth_rate = RATE * np.array([0.0, math.cos(nav.lat), math.sin(nav.lat)])
    sweep: FloatArray = rotation.skew(w_b - nav.B.T @ earth_rate) @ antenna
    return sweep


def corrected(nav: Nav, x: FloatArray) -> Nav:
    """Return the navigator less an estimated error x (22,) (A-5.4.8, A-5.4.9).

    The attitude turns by the exact rotation of alpha, so that it stays orthogonal.
    """
    return Nav(
        nav.lat - x[1] / R3,
        nav.lon - x[0] / R3,
        nav.h - x[2],
        nav.V - x[3:6],
        turn_matrix(*(float(v) for v in x[6:9])) @ nav.B,
    )


def covariance_floor(P: FloatArray, floor: FloatArray) -> None:
    """Raise the diagonal of P to at least floor (22,) (A-5.4.F)."""
    index = np.arange(len(floor))
    P[index, index] = np.maximum(P[index, index], floor)


# --- the estimator ----------------------------------------------------------------------------------------


class Classic22:
    """The 22-state filter of the source, slow and readable: the oracle of `loose-22`.

    It follows the register step by step: 5.1.2 to 5.1.4 at every IMU sample, (5.4.4) at the covariance rate
    and at every measurement and output, then the seven rows of (5.4.3) that have arrived, tested sub-vector
    by sub-vector, (5.4.5) with what passed, and the correction (5.4.8) to (5.4.11) or none. Outputs are
    corrected by what the filter knows and has not fed back. A fix is used with the barometer reading of the
    same IMU sample.

    Options: `bench.navigation.options.ClassicOptions`.
    """

    needs = ("fixes",)

    def __init__(self, **options: Any) -> None:
        self.options = read_options(ClassicOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, sensor errors and their covariance.

        Raises
        ------
        ValueError
            When a sensor with data has no assumed spec.
        """
        for record, name in ((sensors.baro, "baro"), (sensors.fixes, "gnss")):
            if record is not None and getattr(sensors.specs, name) is None:
                raise ValueError(f"the record holds {name} data, but sensors.assumed names no {name} unit")
        initial, aligned = alignment.complete(sensors, initial)
        rows, span, events = timeline.imu_rows(sensors.imu, initial.t)
        events += aligned
        t = sensors.imu.t[rows]
        aids: dict[int, list[tuple[int | None, int | None]]] = {}
        fixes, baro = sensors.fixes, sensors.baro
        if fixes is not None:
            used, at, left = timeline.fix_rows(fixes, t, initial.t)
            events += left
            for row, k in zip(used.tolist(), at.tolist(), strict=True):
                aids.setdefault(k, []).append((row, None))
        if baro is not None:
            used, at, left = timeline.aiding_rows(baro, baro.alt_baro[:, None], "baro", t, initial.t)
            events += left
            for row, k in zip(used.tolist(), at.tolist(), strict=True):
                waiting = aids.setdefault(k, [])
                if waiting and waiting[-1][1] is None:
                    waiting[-1] = (waiting[-1][0], row)
                else:
                    waiting.append((None, row))

        scale = (span / sensors.imu.dt[rows])[:, None]
        dtheta = (sensors.imu.dtheta_b[rows] * scale @ FRD_OF_FUR).tolist()
        dvel = (sensors.imu.dvel_b[rows] * scale @ FRD_OF_FUR).tolist()
        interval = (1.0 - 1e-6) / self.options.covariance_hz
        wanted = sensors.output_t
        served = wanted >= initial.t - timeline.TIME_TOLERANCE
        served &= wanted <= (t[-1] if len(t) else initial.t) + timeline.TIME_TOLERANCE
        output_at = np.searchsorted(t, wanted[served] - timeline.TIME_TOLERANCE)
        output_at[wanted[served] < initial.t + timeline.TIME_TOLERANCE] = -1
        outputs: dict[int, int] = {}
        for k in output_at.tolist():
            outputs[k] = outputs.get(k, 0) + 1

        flight = _Flight(self.options, sensors, initial)
        answers = [flight.answer()] * outputs.get(-1, 0)
        for k, (now, dt) in enumerate(zip(t.tolist(), span.tolist(), strict=True)):
            flight.advance(dt, dtheta[k], dvel[k])
            if k in aids or k in outputs or flight.elapsed >= interval:
                flight.predict()
            for fix_row, baro_row in aids.get(k, ()):
                flight.update(now, fix_row, baro_row)
            if k in outputs:
                answers += [flight.answer()] * outputs[k]
        return _solution(sensors, served, answers, flight, events)

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Name the errors of these units that the state has no room for, in words."""
        found = unmodelled(specs, (FIXES, BARO), GNSS_MARKOV.takes)
        for name, triad in (("gyro", specs.imu.gyro), ("accelerometer", specs.imu.accel)):
            if triad.bias_instability > 0 and triad.turn_on_bias_sd == 0 and triad.bias_model != "flicker":
                found += (f"{name} bias instability that fades (taken as a random walk)",)
        return found


class _Flight:
    """The navigator, its filter and their book-keeping over one record."""

    def __init__(self, options: ClassicOptions, sensors: SensorData, initial: InitialState) -> None:
        from filterpy.kalman import KalmanFilter

        self.options, self.sensors = options, sensors
        self.gates = {name: nis_limit(len(rows), options.gate_probability) for name, rows in _ROWS.items()}
        self.sig = replace(
            sigmas(sensors.specs), jump_white=options.jump_white_sd, jump_markov=options.jump_markov_sd
        )
        self.antenna = FRD_OF_FUR.T @ sensors.antenna_b
        lat, lon, h = initial.lla.tolist()
        B = NED_OF_ENU @ rotation.matrix(initial.q_nb) @ FRD_OF_FUR
        self.nav = Nav(lat, lon, h, NED_OF_ENU @ initial.vel_n, B)
        self.eps, self.da = np.zeros(3), np.zeros(3)  # accumulated calibration, A-5.4.11

        sig, earth = self.sig, ellipsoid(lat, h)
        east, north = reduced(self.nav, earth)
        P = np.zeros((SIZE, SIZE))
        of_ned = np.linalg.inv(ned_matrix(self.nav, earth))
        P[:9, :9] = of_ned @ initial.cov @ of_ned.T
        unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
        rest = [sig.eps] * 3 + [sig.da] * 3 + [sig.bb] + (unit * _per_axis(sig.markov)).tolist()
        P[np.arange(9, SIZE), np.arange(9, SIZE)] = np.square(rest)
        P[:9, 9:15] = -of_ned @ initial.bias_cov @ np.kron(np.eye(2), FRD_OF_FUR)  # true less estimate
        P[9:15, :9] = P[:9, 9:15].T
        self.floor = options.floor**2 * np.diag(P)
        self.kf: Any = KalmanFilter(dim_x=SIZE, dim_z=7)
        self.kf.P = P
        self.scale = (east, north)  # of the reduced Markov states

        self.elapsed = 0.0  # since the last prediction [s]
        self.B_sum, self.dv_sum = np.zeros((3, 3)), np.zeros(3)
        self.start = self.nav
        self.w_b = np.zeros(3)
        self.before: tuple[float, Vector, Vector] | None = None

        self.next_correction = -np.inf
        self.satellites: int | None = None
        self.misses = dict.fromkeys(_ROWS, 0)
        self.refused: dict[str, tuple[float, float, str]] = {}
        self.accepted: dict[str, tuple[float, FloatArray]] = {}  # last fix used: instant, INS less GNSS
        self.innovations: list[tuple[float, int, int, float, float, float, bool]] = []
        self.events: list[tuple[float, float, str, str]] = []

    # -- the navigator

    def advance(self, dt: float, dtheta: list[float], dvel: list[float]) -> None:
        """One IMU sample: increments less the calibration (A-5.4.11), then the mechanization."""
        (e0, e1, e2), (d0, d1, d2) = self.eps.tolist(), self.da.tolist()
        dth = (dtheta[0] - e0 * dt, dtheta[1] - e1 * dt, dtheta[2] - e2 * dt)
        dv = (dvel[0] - d0 * dt, dvel[1] - d1 * dt, dvel[2] - d2 * dt)
        turn, dv_start = body_increments(dt, dth, dv, self.before)
        self.B_sum += self.nav.B * dt
        self.nav, dv_n = mechanize(self.nav, dt, turn, dv_start)
        self.dv_sum += dv_n
        self.elapsed += dt
        self.before = (dt, dth, dv)
        self.w_b = np.array(dth) / dt

    def predict(self) -> None:
        """Carry the filter over the time since the last prediction (A-5.4.4)."""
        T = self.elapsed
        if T == 0.0:
            return
        earth = ellipsoid(self.start.lat, self.start.h)
        mean = replace(self.start, B=self.B_sum / T)
        a = self.dv_sum / T
        if self.options.discretization == "euler":
            Phi, G = model(mean, earth, a, self.sig, T)
            Q = G @ G.T
        else:
            Phi, Q = model_van_loan(mean, earth, a, self.sig, T)
        # the Markov states keep their metres while the reduced ones change (A-5.2.2, caveat)
        scale = reduced(self.nav, ellipsoid(self.nav.lat, self.nav.h))
        Phi[16, 16] *= scale[0] / self.scale[0]
        Phi[17, 17] *= scale[1] / self.scale[1]
        self.kf.predict(F=Phi, Q=Q)
        self.scale = scale
        covariance_floor(self.kf.P, self.floor)
        self.elapsed = 0.0
        self.B_sum, self.dv_sum, self.start = np.zeros((3, 3)), np.zeros(3), self.nav

    # -- the measurements

    def update(self, now: float, fix_row: int | None, baro_row: int | None) -> None:
        """Use what has arrived: the rows of Y, their tests, the update and the correction."""
        earth = ellipsoid(self.nav.lat, self.nav.h)
        east, north = reduced(self.nav, earth)
        jump = fix_row is not None and self._satellites_changed(fix_row)
        if jump:
            self.kf.P[16:, 16:] += np.diag(
                np.square(_per_axis(self.sig.jump_markov) * [east, north, 1, 1, 1, 1])
            )
        H, Q = measurement_matrix(), measurement_noise(self.sig, east, north, jump)
        antenna_matrix(H, self.nav, earth, self.antenna, self.w_b)
        R = Q @ Q.T
        Y = self._measurements(earth, fix_row, baro_row)
        y = Y - H @ self.kf.x[:, 0]
        PH, S = self.kf.P @ H.T, H @ self.kf.P @ H.T + R
        metres = np.array([1.0, 1 / east, 1 / north, 1.0, 1.0, 1.0, 1.0, 1.0])
        error = H[:, :15] @ self.kf.x[:15, 0]  # of the INS, as far as it is known
        apart = (Y - error) * metres  # corrected INS less aid
        use = []
        vel_row = fix_row
        if fix_row is not None and self.sensors.fixes is not None:
            moving = np.isfinite(self.sensors.fixes.vel_n[fix_row]).all()
            vel_row = fix_row if moving else None  # a fix may have no velocity
        for name, given in (("gnss_position", fix_row), ("gnss_velocity", vel_row), ("baro", baro_row)):
            if given is not None and self._is_sound(
                now, name, apart, y * metres, S * np.outer(metres, metres), PH * metres
            ):
                use += _ROWS[name]
        if fix_row is not None and baro_row is not None:
            ratio = abs(y[7]) / math.sqrt(S[7, 7])
            if ratio > self.options.monitor_sigmas:
                text = f"barometer and GNSS height differ by {ratio:.1f} sigma"
                self.events.append((now, now, "integrity", text))
        use.sort()
        if not use:
            return
        if self.options.rows == 8 and len(use) == 7:
            use = list(range(8))
            self.kf.inv = pseudo_inverse
        if self.options.form == "joseph":
            self.kf.update(Y[use, None], R=R[np.ix_(use, use)], H=H[use])
        else:
            step = square_root.potter if self.options.form == "potter" else square_root.carlson
            x, root = self.kf.x[:, 0], square_root.upper_root(self.kf.P)
            for k in use:
                x, root = step(x, root, H[k], float(Y[k]), float(R[k, k]))
            self.kf.x, self.kf.P = x[:, None], root @ root.T
        self.kf.inv = np.linalg.inv
        covariance_floor(self.kf.P, self.floor)
        found = H[:, :15] @ self.kf.x[:15, 0] - error
        for name, (at, offset) in self.accepted.items():  # the correction moves the INS, not the last fix
            self.accepted[name] = (at, offset - (found * metres)[_ROWS[name]])
        for name in ("gnss_position", "gnss_velocity"):
            if set(_ROWS[name]) <= set(use):
                self.accepted[name] = (now, (apart - found * metres)[_ROWS[name]])
        self._correct(now)

    def _satellites_changed(self, row: int) -> bool:
        count = int(self.sensors.fixes.satellites[row]) if self.sensors.fixes is not None else None
        changed = self.satellites is not None and count != self.satellites
        self.satellites = count
        return changed

    def _measurements(self, earth: Earth, fix_row: int | None, baro_row: int | None) -> FloatArray:
        """Return Y (8,), INS less aid (A-5.4.3), NaN in the rows of what has not arrived."""
        Y = np.full(8, np.nan)
        nav = self.nav
        if baro_row is not None and self.sensors.baro is not None:
            Y[0] = nav.h - self.sensors.baro.alt_baro[baro_row]
        if fix_row is not None and self.sensors.fixes is not None:
            east, north = reduced(nav, earth)
            arm = nav.B @ self.antenna
            lat, lon, h = self.sensors.fixes.lla[fix_row].tolist()
            dlon = nav.lon - lon
            dlon -= 2.0 * math.pi * round(dlon / (2.0 * math.pi))
            Y[1] = dlon * R3 + arm[0] * east
            Y[2] = (nav.lat - lat) * R3 + arm[1] * north
            Y[3] = nav.h - h + arm[2]
            swept = nav.B @ antenna_sweep(nav, self.antenna, self.w_b)
            Y[4:7] = nav.V + swept - NED_OF_ENU @ self.sensors.fixes.vel_n[fix_row]
        Y[7] = Y[3] - Y[0]
        return Y

    def _is_sound(
        self, now: float, name: str, apart: FloatArray, y: FloatArray, S: FloatArray, PH: FloatArray
    ) -> bool:
        """Test one sub-vector, all in metres, and note the outcome; readmit after too many refusals.

        S and PH are those before any of an instant is used; the compiled filter uses one after the other.
        """
        rows, options = _ROWS[name], self.options
        y, S = y[rows], S[np.ix_(rows, rows)]
        value = nis(y, S)
        failed = [
            test for test in options.integrity if self._fails(test, now, name, apart[rows], y, S, value)
        ]
        readmitted = bool(failed) and self.misses[name] >= options.readmit_after
        use = not failed or readmitted
        if readmitted:
            earth = ellipsoid(self.nav.lat, self.nav.h)
            unit = [*reduced(self.nav, earth), 1.0] if name == "gnss_position" else np.ones(len(rows))
            states = _STATES[name]
            x = PH[:, rows] @ np.linalg.solve(S, y)  # as `bench.navigation.kalman.open_kernel`
            self.kf.P += np.outer(x, x)
            self.kf.P[states, states] += np.square(y * unit)
        if failed and not readmitted:
            self.misses[name] += 1
            start = self.refused.get(name, (now, now, failed[0]))[0]
            self.refused[name] = (start, now, failed[0])
        else:
            self.misses[name] = 0
            self.close(name)
        code = SENSORS.index(name)
        along_n = -(NED_OF_ENU @ y) if len(rows) == 3 else -y  # measured less predicted
        variance = np.diag(S)[[1, 0, 2]] if len(rows) == 3 else np.diag(S)
        for i, (z, s) in enumerate(zip(along_n.tolist(), variance.tolist(), strict=True)):
            self.innovations.append((now, code, i, z, s, value, use))
        return use

    def _fails(
        self, test: str, now: float, name: str, apart: FloatArray, y: FloatArray, S: FloatArray, value: float
    ) -> bool:
        options = self.options
        if test == "nis":
            return value > self.gates[name]
        if test == "trace":
            return trace_ratio(y, S) > options.trace_limit
        if name not in self.accepted:  # no fix to carry on yet, or the barometer
            return False
        at, offset = self.accepted[name]
        decay = gnss_decay(self.sig, math.hypot(self.nav.V[0], self.nav.V[1]), now - at)
        part = slice(0, 3) if name == "gnss_position" else slice(3, 6)
        wander = (1.0 - decay[part]) * np.square(_per_axis(self.sig.markov)[part])
        sd = np.sqrt(2.0 * (np.square(_per_axis(self.sig.white)[part]) + wander))
        bound = tolerance(
            now - at,
            sd,
            order=2 if name == "gnss_position" else 1,
            max_acceleration=options.max_acceleration,
            sigmas=options.tolerance_sigmas,
        )
        return bool((np.abs(apart - offset) > bound).any())

    def close(self, name: str) -> None:
        """Report a stretch of refusals that has ended."""
        if name in self.refused:
            start, end, test = self.refused.pop(name)
            self.events.append((start, end, "integrity", f"{name} refused by {test}"))

    # -- the correction

    def _correct(self, now: float) -> None:
        """Feed the estimate back when it is due (A-5.4.8, A-5.4.9, A-5.4.11)."""
        options = self.options
        if not options.feedback or now < self.next_correction - timeline.TIME_TOLERANCE:
            return
        x = self.kf.x[:, 0]
        self.nav = corrected(self.nav, x)
        self.start = self.nav
        self.eps = self.eps + x[9:12]
        self.da = self.da + x[12:15]
        self.kf.x[:15] = 0.0  # what is left of these errors is zero in the mean; 15 to 21 and P are kept
        period = options.correction_period
        if isinstance(period, str):
            spread = 3.0 * np.sqrt(np.diag(self.kf.P))
            attitude, gyro, accel = (spread[first : first + 3].max() for first in (6, 9, 12))
            period = correction_period(math.radians(options.admissible_deg), attitude, gyro, accel)
        self.next_correction = now + period

    # -- the answer

    def answer(self) -> tuple[FloatArray, ...]:
        """Return lla, vel_n, q_nb, states, their sd and the covariance of the corrected output."""
        x, P = self.kf.x[:, 0], self.kf.P
        nav = corrected(self.nav, x)
        earth = ellipsoid(nav.lat, nav.h)
        J = ned_matrix(nav, earth)
        east, north = reduced(nav, earth)
        to_ned = np.zeros((13, 13))
        to_ned[0:3, 0:3] = to_ned[3:6, 3:6] = FRD_OF_FUR
        to_ned[6, 6] = 1.0
        to_ned[7:10, 7:10] = NED_OF_ENU @ np.diag([1 / east, 1 / north, 1.0])
        to_ned[10:13, 10:13] = NED_OF_ENU
        states = x[9:].copy()
        states[:3] += self.eps
        states[3:6] += self.da
        return (
            np.array([nav.lat, nav.lon, nav.h]),
            NED_OF_ENU @ nav.V,
            rotation.from_matrix(NED_OF_ENU @ nav.B @ FRD_OF_FUR.T),
            to_ned @ states,
            np.sqrt(np.diag(to_ned @ P[9:, 9:] @ to_ned.T)),
            J @ P[:9, :9] @ J.T,
        )


def ned_matrix(nav: Nav, earth: Earth) -> FloatArray:
    """Return J (9, 9): the first nine states as (pos_n m, vel_n m/s, phi_n rad) errors (equations 1.3)."""
    east, north = reduced(nav, earth)
    J = np.zeros((9, 9))
    J[0:3, 0:3] = NED_OF_ENU @ np.diag([1 / east, 1 / north, 1.0])
    J[3:6, 3:6] = NED_OF_ENU
    J[6:9, 6:9] = -NED_OF_ENU
    return J


def pseudo_inverse(S: FloatArray) -> FloatArray:
    """Return the pseudo-inverse of the singular S of eight rows (A-5.4.8R), taken at unit variances."""
    scale = 1.0 / np.sqrt(np.diag(S))
    inverse = np.asarray(np.linalg.pinv(S * np.outer(scale, scale), rcond=1e-12, hermitian=True), float)
    return inverse * np.outer(scale, scale)


def _solution(
    sensors: SensorData,
    served: Any,
    answers: list[tuple[FloatArray, ...]],
    flight: _Flight,
    events: list[tuple[float, float, str, str]],
) -> NavSolution:
    for name in list(flight.refused):
        flight.close(name)
    m = len(sensors.output_t)
    columns = [np.full((m, *shape), np.nan) for shape in ((3,), (3,), (4,), (13,), (13,), (9, 9))]
    for column, values in zip(columns, zip(*answers, strict=True), strict=False):
        column[served] = np.array(values)
    lla, vel_n, q_nb, states, sd, cov = columns
    layout = StateLayout(("baro_bias", "m", 1), ("gnss_pos", "m", 3), ("gnss_vel", "m_s", 3))
    return NavSolution(
        t=sensors.output_t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        gyro_bias_b=states[:, :3],
        accel_bias_b=states[:, 3:6],
        cov=cov,
        extra_names=layout.labels(),
        extra=states,
        extra_sd=sd,
        innovations=Innovations.from_rows(SENSORS, flight.innovations),
        events=Events.from_rows(events + flight.events),
    )
