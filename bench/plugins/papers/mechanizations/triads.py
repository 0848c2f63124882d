"""Navigation frames: rotation of the triad, velocity equation and position equation.

In every frame ``V' = C f + g - w_cor x V``, where w_cor is the rate of the triad and that of the Earth,
w_in + w_ie (A-2.2.2, A-5.1.4); frames differ in their rates and in their position. The slow figures, rates
and gravity, hold for a slow interval: at its start, as in the source, or at its middle, where velocity and
position are carried on by the interval before.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import EARTH_RATE, WGS84, matrix_en, to_ecef
from bench.navigation.models.classic.navigator import FRD_OF_FUR, NED_OF_ENU, turn_matrix
from bench.plugins.papers.mechanizations.earth_series import GRAVITIES, RADII, EarthModel
from bench.plugins.papers.mechanizations.vectors import ZERO, Vector, add, cross, scale, turn

NED_OF_NHE = FRD_OF_FUR
"""North, up, east to north, east, down (equations 1.3)."""


class Triad(ABC):
    """A navigation frame with the motion of the IMU in it.

    Parameters
    ----------
    nav : (10,) array
        Start: lat, lon [rad], height [m], velocity [m/s] north, east, down, q_nb.
    earth : EarthModel
        Radii and gravity.
    lead : bool
        Take the slow figures at the middle of a slow interval.
    """

    to_nhe: FloatArray | None = None
    """(3, 3) to north, up, east where the frame stands still in them."""
    C: FloatArray
    """(3, 3) body to frame at the start."""
    V: Vector
    w_in: Vector
    w_cor: Vector
    g: Vector

    def __init__(self, nav: FloatArray, earth: EarthModel, *, lead: bool) -> None:
        self.ellipsoid, self.lead = earth.ellipsoid, lead
        self._radii, self._gravity = RADII[earth.radii], GRAVITIES[earth.gravity]
        self._moved, self.t = ZERO, 0.0
        self._place(nav, rotation.matrix(nav[6:10]) @ FRD_OF_FUR)
        self._before = self.V
        self._refresh(self.V, 0.0)

    def accelerate(self, dv: Vector, T: float) -> None:
        """Carry velocity over a medium interval T [s] with its velocity increment in the frame [m/s]."""
        v, g = self.V, self.g
        half = add(v, add(dv, add(g, cross(self.w_cor, v), -1.0), T), 0.5)
        self.V = add(v, add(dv, add(g, cross(self.w_cor, half), -1.0), T))
        self._moved = add(self._moved, add(v, self.V), 0.5 * T)

    def move(self, T: float) -> None:
        """Propagate the position over a slow interval T [s], and update the slow values for the next."""
        self.t += T
        self._carry(self._moved)
        ahead = add(self.V, add(self.V, self._before, -1.0), 0.5) if self.lead else self.V
        self._moved, self._before = ZERO, self.V
        self._refresh(ahead, 0.5 * T if self.lead else 0.0)

    def _curvature(self, s: float, h: float) -> tuple[float, float]:
        return self._radii(s, h, self.ellipsoid)

    @abstractmethod
    def _place(self, nav: FloatArray, C_nb: FloatArray) -> None: ...

    @abstractmethod
    def _carry(self, moved: Vector) -> None: ...

    @abstractmethod
    def _refresh(self, V: Vector, ahead: float) -> None: ...

    @abstractmethod
    def read(self) -> tuple[Vector, Vector, FloatArray]:
        """Return lat, lon [rad], height [m], velocity [m/s], n, and the matrix (3, 3) from the frame to n."""


class Geodetic(Triad):
    """Latitude, longitude and height with a triad along the meridian."""

    ned: FloatArray
    """(3, 3), the triad to north, east, down."""

    def _place(self, nav: FloatArray, C_nb: FloatArray) -> None:
        self.lat, self.lon, self.h = nav[:3].tolist()
        self.C, self.V = self.ned.T @ C_nb, turn(self.ned.T, tuple(nav[3:6].tolist()))
        self._at = (*self._curvature(math.sin(self.lat), self.h), math.cos(self.lat))

    def _ahead(self, north: float, up: float, ahead: float) -> tuple[float, float, float, float, float]:
        """Return sine and cosine of latitude, curvatures and height at the time of the slow values."""
        lat, h = self.lat + ahead * north * self._at[0], self.h + ahead * up
        s, c = math.sin(lat), math.cos(lat)
        k_m, k_p = self._curvature(s, h)
        self._at = (k_m, k_p, c)
        return s, c, k_m, k_p, h

    def _shift(self, east: float, north: float, up: float) -> None:
        k_m, k_p, c = self._at
        self.lat += north * k_m  # .K, A-5.1.2
        self.lon += east * k_p / c
        self.h += up

    def read(self) -> tuple[Vector, Vector, FloatArray]:
        """Return position, velocity and axes."""
        return (self.lat, self.lon, self.h), turn(self.ned, self.V), self.ned


class Nhe(Geodetic):
    """North, up, east: chapter 2 of the source."""

    ned, to_nhe = NED_OF_NHE, np.eye(3)

    def _refresh(self, V: Vector, ahead: float) -> None:
        v_n, v_h, v_e = V
        s, c, k_m, k_p, h = self._ahead(v_n, v_h, ahead)
        lat_rate, lon_rate = v_n * k_m, v_e * k_p / c
        w_v = (lon_rate * c, lon_rate * s, -lat_rate)
        earth = (EARTH_RATE * c, EARTH_RATE * s, 0.0)
        self.w_in, self.w_cor = add(w_v, earth), add(w_v, earth, 2.0)  # 1 and 2 Omega
        g_n, g_d = self._gravity(s, c, h)
        self.g = (g_n, -g_d, 0.0)

    def _carry(self, moved: Vector) -> None:
        self._shift(moved[2], moved[0], moved[1])


class Enu(Geodetic):
    """East, north, up: chapter 5 of the source."""

    ned, to_nhe = NED_OF_ENU, NED_OF_NHE.T @ NED_OF_ENU

    def _refresh(self, V: Vector, ahead: float) -> None:
        v_e, v_n, v_h = V
        s, c, k_m, k_p, h = self._ahead(v_n, v_h, ahead)
        u, lat_rate, lon_rate = EARTH_RATE, v_n * k_m, v_e * k_p / c
        self.w_in = (-lat_rate, (u + lon_rate) * c, (u + lon_rate) * s)
        self.w_cor = (-lat_rate, (2 * u + lon_rate) * c, (2 * u + lon_rate) * s)
        g_n, g_d = self._gravity(s, c, h)
        self.g = (0.0, g_n, -g_d)

    def _carry(self, moved: Vector) -> None:
        self._shift(*moved)


class WanderAzimuth(Triad):
    """Level triad that does not rotate about the vertical relative to the Earth, regular at the poles.

    East, north, up at the start. Position is the matrix D from the triad to Earth-fixed axes; p, the axis of
    the Earth in the triad, is (cos lat) times north and sin lat up. With 1/(R + h) a tensor,
    1/(R_P + h) + kappa p p', kappa = (1/(R_M + h) - 1/(R_P + h)) / cos^2 lat, which stays finite (Titterton
    and Weston, ch. 3).
    """

    def _place(self, nav: FloatArray, C_nb: FloatArray) -> None:
        self.D = matrix_en(nav[0], nav[1]) @ NED_OF_ENU
        self.h = float(nav[2])
        self.C, self.V = NED_OF_ENU.T @ C_nb, turn(NED_OF_ENU.T, tuple(nav[3:6].tolist()))
        self._at = self._tensor(self.D[2], self.h)

    def _tensor(self, pole: FloatArray, h: float) -> tuple[float, float, float, float]:
        """Return 1/(R_P + h) + kappa p p' of the level axes: xx, xy, yy; and the cosine of the latitude."""
        x, y, s = pole.tolist()
        c = max(math.hypot(x, y), 1e-9)  # at the pole both curvatures are one
        k_m, k_p = self._curvature(s, h)
        kappa = (k_m - k_p) / (c * c) if c > 1e-6 else 0.0
        return k_p + kappa * x * x, kappa * x * y, k_p + kappa * y * y, c

    def _turned(self, moved: Vector) -> Vector:
        """Return the rotation vector of the triad relative to the Earth for a displacement in it [m]."""
        xx, xy, yy, _ = self._at
        return -(xy * moved[0] + yy * moved[1]), xx * moved[0] + xy * moved[1], 0.0

    def _refresh(self, V: Vector, ahead: float) -> None:
        pole = self.D[2] @ turn_matrix(*self._turned(scale(V, ahead)))
        h = self.h + ahead * V[2]
        self._at = self._tensor(pole, h)
        x, y, s = pole.tolist()
        earth = scale((x, y, s), EARTH_RATE)
        over = self._turned(V)
        self.w_in, self.w_cor = add(over, earth), add(over, earth, 2.0)
        c = self._at[3]
        g_n, g_d = self._gravity(s, c, h)
        self.g = (g_n * x / c, g_n * y / c, -g_d)

    def _carry(self, moved: Vector) -> None:
        self.D = self.D @ turn_matrix(*self._turned(moved))
        self.h += moved[2]

    def read(self) -> tuple[Vector, Vector, FloatArray]:
        """Return position, velocity and axes; exactly at a pole, the longitude is 0."""
        up = self.D[:, 2]
        lat, lon = math.atan2(up[2], math.hypot(up[0], up[1])), math.atan2(up[1], up[0])
        C_nw = level_matrix(lat, lon) @ self.D
        return (lat, lon, self.h), turn(C_nw, self.V), C_nw


class Ecef(Triad):
    """Earth-fixed axes with position [m] in them."""

    rate = EARTH_RATE
    """Of the triad [rad/s]."""

    def _place(self, nav: FloatArray, C_nb: FloatArray) -> None:
        C_en = matrix_en(nav[0], nav[1])
        self.r: Vector = tuple(to_ecef(nav[:3], self.ellipsoid).tolist())
        self.C, self.V = C_en @ C_nb, turn(C_en, tuple(nav[3:6].tolist()))
        self.w_in, self.w_cor = (0.0, 0.0, self.rate), (0.0, 0.0, 2.0 * self.rate)

    def _gravity_at(self, r: Vector) -> Vector:
        """Return gravity at a place, along the axes of the triad."""
        lat, lon, h = geodetic(r, self.ellipsoid.a, self.ellipsoid.f)
        s, c = math.sin(lat), math.cos(lat)
        g_n, g_d = self._gravity(s, c, h)
        outward = -g_n * s - g_d * c
        return outward * math.cos(lon), outward * math.sin(lon), g_n * c - g_d * s

    def _refresh(self, V: Vector, ahead: float) -> None:
        self.g = self._gravity_at(add(self.r, V, ahead))

    def _carry(self, moved: Vector) -> None:
        self.r = add(self.r, moved)

    def read(self) -> tuple[Vector, Vector, FloatArray]:
        """Return position, velocity and axes."""
        lla = geodetic(self.r, self.ellipsoid.a, self.ellipsoid.f)
        C_ne = level_matrix(lla[0], lla[1])
        return lla, turn(C_ne, self.V), C_ne


class Inertial(Ecef):
    """Inertial axes, Earth-fixed at the start, with gravitation and without Coriolis terms (A-2.2 intro)."""

    rate = 0.0

    def _place(self, nav: FloatArray, C_nb: FloatArray) -> None:
        super()._place(nav, C_nb)
        self.V = add(self.V, cross((0.0, 0.0, EARTH_RATE), self.r))

    def _gravity_at(self, r: Vector) -> Vector:
        x, y, z = super()._gravity_at(r)  # normal gravity is the same all around the axis
        return x - EARTH_RATE**2 * r[0], y - EARTH_RATE**2 * r[1], z

    def read(self) -> tuple[Vector, Vector, FloatArray]:
        """Return position, velocity and axes, with the rotation angle of the Earth since the start."""
        lat, lon, h = geodetic(self.r, self.ellipsoid.a, self.ellipsoid.f)
        C_ni = level_matrix(lat, lon)
        V = turn(C_ni, add(self.V, cross((0.0, 0.0, EARTH_RATE), self.r), -1.0))
        return (lat, lon - EARTH_RATE * self.t, h), V, C_ni


def level_matrix(lat: float, lon: float) -> FloatArray:
    """Return C_ne (3, 3), Earth-fixed to north, east, down (`earth.matrix_en` transposed)."""
    s, c, sl, cl = math.sin(lat), math.cos(lat), math.sin(lon), math.cos(lon)
    return np.array([[-s * cl, -s * sl, c], [-sl, cl, 0.0], [-c * cl, -c * sl, -s]])


def geodetic(r: Vector, a: float = WGS84.a, f: float = WGS84.f) -> Vector:
    """Return latitude, longitude [rad] and height [m] of an Earth-fixed position [m] (Bowring 1976)."""
    x, y, z = r
    p = math.hypot(x, y)
    b, e2 = a * (1.0 - f), f * (2.0 - f)
    beta = math.atan2(z, (1.0 - f) * p)
    for _ in range(2):
        lat = math.atan2(z + e2 / (1.0 - e2) * b * math.sin(beta) ** 3, p - e2 * a * math.cos(beta) ** 3)
        beta = math.atan2((1.0 - f) * math.sin(lat), math.cos(lat))
    s = math.sin(lat)
    return lat, math.atan2(y, x), p * math.cos(lat) + z * s - a * math.sqrt(1.0 - e2 * s * s)
