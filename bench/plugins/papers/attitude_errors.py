"""Three descriptions of one attitude error, and their conversions (A-5.1.12, A-5.1.13).

alpha   from the true local triad to the computed one, east, north, up: the filter's state
delta   the same at the computed place, in the moving equatorial axes (the psi-angle): no position error in it
delta_u in inertial axes: a pure integral of the gyro errors
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.navigation.models.classic.navigator import R3


def equatorial_matrix(lat: float) -> FloatArray:
    """Return Q (3, 3): east, north, up to the moving equatorial axes xi, eta (pole), zeta (A-5.1.1Q)."""
    s, c = math.sin(lat), math.cos(lat)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def inertial_matrix(angle: float) -> FloatArray:
    """Return the matrix (3, 3) from moving equatorial to inertial axes, ``angle`` = u t + lon (A-5.1.13)."""
    s, c = math.sin(angle), math.cos(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def alpha_of_delta(lat: float, dR_E: float, dR_N: float, delta: ArrayLike) -> FloatArray:
    """Return alpha (3,) of delta (3,) and the reduced position errors [m] (A-5.1.12)."""
    turned = equatorial_matrix(lat).T @ np.asarray(delta, float)
    return np.asarray(turned + _turn_of_place(lat, dR_E, dR_N))


def delta_of_alpha(lat: float, dR_E: float, dR_N: float, alpha: ArrayLike) -> FloatArray:
    """Return delta (3,) of alpha (3,) and the reduced position errors [m].

    Examples
    --------
    >>> delta_of_alpha(0.7, 50.0, -80.0, alpha_of_delta(0.7, 50.0, -80.0, [1e-5, 2e-5, 3e-5]))
    array([1.e-05, 2.e-05, 3.e-05])
    """
    delta: FloatArray = equatorial_matrix(lat) @ (np.asarray(alpha, float) - _turn_of_place(lat, dR_E, dR_N))
    return delta


def inertial_of_delta(angle: float, delta: ArrayLike) -> FloatArray:
    """Return delta_u (3,) of delta (3,), ``angle`` = u t + lon [rad] (A-5.1.13)."""
    return np.asarray(inertial_matrix(angle) @ np.asarray(delta, float))


def delta_of_inertial(angle: float, delta_u: ArrayLike) -> FloatArray:
    """Return delta (3,) of delta_u (3,), ``angle`` = u t + lon [rad] (A-5.1.13)."""
    return np.asarray(inertial_matrix(angle).T @ np.asarray(delta_u, float))


def delta_rate(lon_rate: float, delta: ArrayLike, eps: ArrayLike) -> FloatArray:
    """Return d/dt of delta (3,) for gyro errors ``eps`` in the moving equatorial axes (A-5.1.12b)."""
    d, e = np.asarray(delta, float), np.asarray(eps, float)
    turn = EARTH_RATE + lon_rate
    return np.array([-turn * d[2] - e[0], -e[1], turn * d[0] - e[2]])


def delta_u_rate(angle: float, eps: ArrayLike) -> FloatArray:
    """Return d/dt of delta_u (3,), ``eps`` as in :func:`delta_rate` (A-5.1.13)."""
    return -inertial_of_delta(angle, eps)


def _turn_of_place(lat: float, dR_E: float, dR_N: float) -> FloatArray:
    """Return the turn (3,) [rad] of the local triad from the true to the computed place."""
    return np.array([-dR_N, dR_E * math.cos(lat), dR_E * math.sin(lat)]) / R3
