"""Observation model of the 22 states: H, its noise and the lever arm (A-5.4.3), and outputs in n."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE
from bench.navigation.error_state_filter.measurement_rows import BARO_ROWS, FIX_ROWS
from bench.navigation.models.classic.navigator import NED_OF_ENU, Earth, Nav, reduced
from bench.navigation.models.classic.process_model import SIZE, Sigmas, per_axis
from bench.navigation.models.stepped_filters import Measurement


class Fix(NamedTuple):
    """A fix of a receiver."""

    lat: float  # [rad]
    lon: float  # [rad]
    h: float  # ellipsoidal [m]
    vel_n: FloatArray  # (3,) [m/s], n; not finite: none
    satellites: int


def pair_measurements(arrived: Sequence[Measurement]) -> list[tuple[Fix | None, float | None]]:
    """Return fixes, the last paired with the first barometer height that arrived, then the other heights.

    The values of a fix are latitude, longitude, height, velocity (n) and the number of satellites.
    """
    heights = [float(values[0]) for kind, values, _ in arrived if kind == BARO_ROWS]
    fixes = [values for kind, values, _ in arrived if kind == FIX_ROWS]
    pairs = list[tuple[Fix | None, float | None]]()
    for row in fixes:
        lat, lon, h = row[:3].tolist()
        pairs.append((Fix(lat, lon, h, row[3:6], int(row[6])), None))
    if pairs and heights:
        pairs[-1] = (pairs[-1][0], heights.pop(0))
    return pairs + [(None, height) for height in heights]


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
    Q[1:7, 1:7] = -np.diag(per_axis(sig.white) * unit)
    Q[1:7, 7:13] = -float(jump) * np.diag(per_axis(sig.jump_white) * unit)
    Q[7, 1:] = Q[3, 1:]
    return Q


def antenna_matrix(H: FloatArray, nav: Nav, earth: Earth, antenna: FloatArray, w_b: FloatArray) -> None:
    """Add the effect of a lever arm to H (8, 22); the source has no lever arm (equations 10).

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
    earth_rate = EARTH_RATE * np.array([0.0, math.cos(nav.lat), math.sin(nav.lat)])
    sweep: FloatArray = rotation.skew(w_b - nav.B.T @ earth_rate) @ antenna
    return sweep


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
