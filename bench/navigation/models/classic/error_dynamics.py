"""The error equations of the inertial navigator: A-5.1.9 to A-5.1.11."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.navigation.models.classic.navigator import R3, Earth, Nav


def dynamics_matrix(nav: Nav, a: ArrayLike, earth: Earth) -> FloatArray:
    """Return F (15, 15) of the inertial states (A-5.1.10), ``a`` the specific force east, north, up [m/s^2].

    The elements of the register with R1 + h in the east rows and R2 + h in the north rows, and what the
    change of the radii with latitude adds; on a sphere these are the register's own.
    """
    s, c = math.sin(nav.lat), math.cos(nav.lat)
    tan = s / c
    v_e, v_n, v_h = (float(v) for v in nav.V)
    a_e, a_n, a_h = (float(v) for v in np.asarray(a, float))
    r1, r2, r1_lat, r2_lat = earth.r1, earth.r2, earth.r1_lat, earth.r2_lat
    lat_rate, lon_rate = v_n / r2, v_e / (r1 * c)
    U = 2 * EARTH_RATE + lon_rate
    w_e, w_n, w_h = -lat_rate, (EARTH_RATE + lon_rate) * c, (EARTH_RATE + lon_rate) * s

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
    F[4, 3], F[4, 4], F[4, 5] = -2 * (EARTH_RATE + lon_rate) * s, -v_h / r2, -lat_rate
    F[5, 1] = (
        -2 * EARTH_RATE * v_e * s - v_e**2 * r1_lat / r1**2 - v_n**2 * r2_lat / r2**2 - earth.g_lat
    ) / R3
    F[5, 2] = -earth.g_h - v_e**2 / r1**2 - v_n**2 / r2**2
    F[5, 3], F[5, 4] = 2 * (EARTH_RATE + lon_rate) * c, 2 * lat_rate
    F[3, 7], F[3, 8] = -a_h, a_n
    F[4, 6], F[4, 8] = a_h, -a_e
    F[5, 6], F[5, 7] = -a_n, a_e
    F[3:6, 12:15] = nav.B

    F[6, 1], F[6, 2], F[6, 4] = lat_rate * r2_lat / r2 / R3, v_n / r2**2, -1 / r2
    F[7, 1] = (-EARTH_RATE * s - v_e * r1_lat / r1**2) / R3
    F[7, 2], F[7, 3] = -v_e / r1**2, 1 / r1
    F[8, 1] = (EARTH_RATE * c + lon_rate / c - v_e * tan * r1_lat / r1**2) / R3
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
