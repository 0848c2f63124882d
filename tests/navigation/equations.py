"""Equations of the register that no filter runs: what the tests hold the filters against."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.navigation.engine.integrity import SCHULER_RADIUS
from bench.navigation.models.classic.navigator import R3, Earth, Nav
from bench.navigation.models.classic.process_model import Sigmas, per_axis


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
            v_e * v_h / earth.r1 - v_e * v_n * tan / earth.r1 + 2 * EARTH_RATE * (v_h * c - v_n * s),
            v_n * v_h / earth.r2 + v_e**2 * tan / earth.r1 + 2 * EARTH_RATE * v_e * s,
            -(v_e**2) / earth.r1 - v_n**2 / earth.r2 - 2 * EARTH_RATE * v_e * c,
        ]
    )
    V_rate = nav.B @ np.asarray(a_b, float) - dn + [0.0, earth.g_n, -earth.g]
    w_in = np.array([-lat_rate, (EARTH_RATE + lon_rate) * c, (EARTH_RATE + lon_rate) * s])
    B_rate = nav.B @ rotation.skew(w_b) - rotation.skew(w_in) @ nav.B
    return np.array([lat_rate, lon_rate, v_h]), V_rate, B_rate


def gnss_noise_12(sig: Sigmas, decay: FloatArray, east: float, north: float, jump: bool) -> FloatArray:
    """Return G_S (6, 12) with Markov and jump noise apart: the 34 noises of the published blocks."""
    q = np.sqrt(1.0 - decay**2)
    unit = np.array([east, north, 1.0, 1.0, 1.0, 1.0])
    return np.hstack(
        [
            np.diag(q * per_axis(sig.markov) * unit),
            np.diag(float(jump) * per_axis(sig.jump_markov) * unit),
        ]
    )


def attitude_bound(T: float, start: float, gyro: float, accel: float) -> float:
    """Return the largest attitude error of an uncorrected INS after T [s], rad: A-5.4.10 with its start.

    An upper bound for T far below 84.4 min: the Schuler feedback that is left out has the opposite sign.

    Parameters
    ----------
    T : float
        Time since the correction [s].
    start : float
        Attitude error left by the correction, Delta alpha_0 [rad].
    gyro, accel : float
        Gyro drift [rad/s] and accelerometer bias [m/s^2].
    """
    tilted = 0.5 * (start * STANDARD_GRAVITY + accel) * T**2 + STANDARD_GRAVITY * gyro * T**3 / 6.0
    return start + gyro * T + tilted / SCHULER_RADIUS
