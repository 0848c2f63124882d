"""The Earth: ellipsoids, radii, normal gravity, geodetic, Earth-fixed and local coordinates.

Geodetic functions take an :class:`Ellipsoid`; gravity and all kernels are WGS 84.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import FloatArray, join_last, split_last

EARTH_RATE = 7.292115e-5  # rotation rate of the Earth [rad/s], NIMA TR8350.2 (2000)
GM = 3.986004418e14  # geocentric gravitational constant [m^3/s^2], NIMA TR8350.2 (2000)
GAMMA_E = 9.7803253359  # normal gravity at the equator [m/s^2], NIMA TR8350.2 (2000)
_K = 0.00193185265241  # Somigliana's constant [1], NIMA TR8350.2 (2000)
_M = 0.00344978650684  # (rate a)^2 b / GM [1], NIMA TR8350.2 (2000)
_G_NORTH = 8.08e-9  # southward gravity per height and sin(2 lat) [1/s^2], A-2.2.G


@dataclass(frozen=True, slots=True)
class Ellipsoid:
    """An ellipsoid of revolution by its semi-major axis [m] and flattening [1]."""

    name: str
    a: float
    f: float

    @property
    def b(self) -> float:
        """Semi-minor axis [m]."""
        return self.a * (1 - self.f)

    @property
    def e2(self) -> float:
        """First eccentricity squared [1]."""
        return self.f * (2 - self.f)


WGS84 = Ellipsoid("WGS-84", 6378137.0, 1 / 298.257223563)
PZ90_11 = Ellipsoid("PZ-90.11", 6378136.0, 1 / 298.25784)
KRASOVSKY_1940 = Ellipsoid("Krasovsky 1940", 6378245.0, 1 / 298.3)
INTERNATIONAL_1924 = Ellipsoid("International 1924", 6378388.0, 1 / 297.0)

_A, _F, _E2 = WGS84.a, WGS84.f, WGS84.e2


@kernel
def radii_kernel(sin_lat: float) -> tuple[float, float]:
    """Return the meridian and prime-vertical radii of WGS 84 [m] (A-2.2.R)."""
    w2 = 1.0 - _E2 * (sin_lat * sin_lat)
    prime = _A / np.sqrt(w2)
    return prime * (1.0 - _E2) / w2, prime


@kernel
def displace_kernel(lla: FloatArray, d_n: FloatArray, out: FloatArray) -> None:
    """Fill out (3,), which may be lla, with a position (3,) moved by a displacement (3,) [m], n."""
    meridian, prime = radii_kernel(np.sin(lla[0]))
    r_m, r_p = meridian + lla[2], (prime + lla[2]) * np.cos(lla[0])
    out[0] = lla[0] + d_n[0] / r_m
    out[1] = lla[1] + d_n[1] / r_p
    out[2] = lla[2] - d_n[2]


@kernel
def difference_kernel(lla: FloatArray, ref: FloatArray, out: FloatArray) -> None:
    """Fill out (3,) with the small difference lla - ref (3,) of positions [m], n at ref."""
    meridian, prime = radii_kernel(np.sin(ref[0]))
    east = lla[1] - ref[1]
    east -= 2.0 * np.pi * np.round(east / (2.0 * np.pi))
    out[0] = (lla[0] - ref[0]) * (meridian + ref[2])
    out[1] = east * (prime + ref[2]) * np.cos(ref[0])
    out[2] = ref[2] - lla[2]


@kernel
def gravity_kernel(sin_lat: float, cos_lat: float, alt: float) -> tuple[float, float]:
    """Return the north and down components of WGS 84 normal gravity [m/s^2]."""
    s2 = sin_lat * sin_lat
    gamma_0 = GAMMA_E * (1.0 + _K * s2) / np.sqrt(1.0 - _E2 * s2)
    ratio = alt / _A
    down = gamma_0 * (1.0 - 2.0 * (1.0 + _F + _M - 2.0 * _F * s2) * ratio + 3.0 * ratio * ratio)
    return -_G_NORTH * alt * 2.0 * sin_lat * cos_lat, down


@kernel
def gravity_gradient_kernel(sin_lat: float, cos_lat: float, alt: float) -> tuple[float, float, float, float]:
    """Return d g_N/d alt, d g_N/d lat, d g_D/d alt, d g_D/d lat of :func:`gravity_kernel` [SI]."""
    s2 = sin_lat * sin_lat
    w2 = 1.0 - _E2 * s2
    w = np.sqrt(w2)
    gamma_0 = GAMMA_E * (1.0 + _K * s2) / w
    gamma_0_s2 = GAMMA_E * (_K / w + 0.5 * _E2 * (1.0 + _K * s2) / (w * w2))
    ratio = alt / _A
    linear = 2.0 * (1.0 + _F + _M - 2.0 * _F * s2)
    series = 1.0 - linear * ratio + 3.0 * ratio * ratio
    sin_2lat = 2.0 * sin_lat * cos_lat
    return (
        -_G_NORTH * sin_2lat,
        -_G_NORTH * alt * 2.0 * (cos_lat * cos_lat - s2),
        gamma_0 * (6.0 * ratio - linear) / _A,
        (gamma_0_s2 * series + gamma_0 * 4.0 * _F * ratio) * sin_2lat,
    )


def radii(lat: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> tuple[FloatArray, FloatArray]:
    """Return the meridian and prime-vertical radii of curvature R_M, R_P [m] (A-2.2.R).

    Parameters
    ----------
    lat : float or (N,) array
        Geodetic latitude [rad].
    ellipsoid : Ellipsoid
        Figure of the Earth.

    Examples
    --------
    >>> R_M, R_P = radii(0.0)
    >>> print(f"{R_M:.3f} {R_P:.3f}")
    6335439.327 6378137.000
    """
    w2 = 1 - ellipsoid.e2 * np.sin(np.asarray(lat, float)) ** 2
    prime = ellipsoid.a / np.sqrt(w2)
    return prime * (1 - ellipsoid.e2) / w2, prime


def gravity_n(lat: ArrayLike, alt: ArrayLike) -> FloatArray:
    """Return normal gravity resolved in the local level frame.

    Gravity is gravitation plus the centrifugal acceleration of the rotating Earth, the direction of a plumb
    line. An accelerometer at rest reads ``-gravity_n``.

    Parameters
    ----------
    lat : float or (N,) array
        Geodetic latitude [rad].
    alt : float or (N,) array
        Height above the WGS 84 ellipsoid [m].

    Returns
    -------
    g_n : (3,) or (N, 3) array
        Gravity [m/s^2], frame n (north, east, down). East is zero.

    Notes
    -----
    Somigliana's closed form on the ellipsoid and the second-order series in height: NIMA TR8350.2 (3rd ed.,
    2000), section 4; within 0.1 mGal of the exact normal field up to 12 km. The north component is the linear
    term of the same field, due to the curvature of the plumb line.

    Examples
    --------
    >>> gravity_n(lat=0.0, alt=0.0)
    array([0.        , 0.        , 9.78032534])
    """
    lat, alt = np.broadcast_arrays(np.asarray(lat, float), np.asarray(alt, float))
    sin2 = np.sin(lat) ** 2
    gamma_0 = GAMMA_E * (1 + _K * sin2) / np.sqrt(1 - _E2 * sin2)
    series = 1 - 2 / _A * (1 + _F + _M - 2 * _F * sin2) * alt + 3 * (alt / _A) ** 2
    g_n = np.zeros((*lat.shape, 3))
    g_n[..., 0] -= _G_NORTH * alt * np.sin(2 * lat)
    g_n[..., 2] = gamma_0 * series
    return g_n


def to_ecef(lla: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return Earth-fixed positions (..., 3) [m] of geodetic (lat rad, lon rad, height m).

    Examples
    --------
    >>> to_ecef([0.0, 0.0, 100.0])
    array([6378237.,       0.,       0.])
    """
    lat, lon, alt = split_last(np.asarray(lla, float))
    _, prime = radii(lat, ellipsoid)
    p = (prime + alt) * np.cos(lat)
    return join_last([p * np.cos(lon), p * np.sin(lon), (prime * (1 - ellipsoid.e2) + alt) * np.sin(lat)])


def to_geodetic(pos_e: ArrayLike, ellipsoid: Ellipsoid = WGS84) -> FloatArray:
    """Return geodetic (lat rad, lon rad, height m) of Earth-fixed positions (..., 3) [m].

    Notes
    -----
    Bowring's iteration on the reduced latitude (Survey Review 23 (181), 1976). The error after three
    iterations is below 1e-9 m from 10 km under the ellipsoid to satellite heights, poles included.
    """
    x, y, z = split_last(np.asarray(pos_e, float))
    a, b, f, e2 = ellipsoid.a, ellipsoid.b, ellipsoid.f, ellipsoid.e2
    p = np.hypot(x, y)
    beta = np.arctan2(z, (1 - f) * p)
    lat = beta
    for _ in range(3):
        lat = np.arctan2(z + e2 / (1 - e2) * b * np.sin(beta) ** 3, p - e2 * a * np.cos(beta) ** 3)
        beta = np.arctan2((1 - f) * np.sin(lat), np.cos(lat))
    alt = p * np.cos(lat) + z * np.sin(lat) - a * np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return join_last([lat, np.arctan2(y, x), alt])


def matrix_en(lat: ArrayLike, lon: ArrayLike) -> FloatArray:
    """Return C_en (..., 3, 3), from north, east, down to the Earth-fixed frame, at lat, lon [rad]."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, float), np.asarray(lon, float))
    s, c, sl, cl = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    zero = np.zeros_like(s)
    rows = ([-s * cl, -sl, -c * cl], [-s * sl, cl, -c * sl], [c, zero, -s])
    return join_last([element for row in rows for element in row]).reshape(*s.shape, 3, 3)


def difference_n(lla: ArrayLike, lla_ref: ArrayLike) -> FloatArray:
    """Return the small position difference lla - lla_ref (..., 3) [m] in frame n at lla_ref.

    First order: the error at a distance of 1 km is about 0.1 m. Longitude wraps at 180 deg.
    """
    here, ref = np.asarray(lla, float), np.asarray(lla_ref, float)
    R_M, R_P = radii(ref[..., 0])
    alt = ref[..., 2]
    dlon = here[..., 1] - ref[..., 1]
    dlon = dlon - 2 * np.pi * np.round(dlon / (2 * np.pi))
    return join_last(
        [
            (here[..., 0] - ref[..., 0]) * (R_M + alt),
            dlon * (R_P + alt) * np.cos(ref[..., 0]),
            alt - here[..., 2],
        ]
    )


def displace(lla: ArrayLike, d_n: ArrayLike) -> FloatArray:
    """Return positions lla moved by a small displacement d_n (..., 3) [m], the inverse of `difference_n`."""
    ref, d = np.asarray(lla, float), np.asarray(d_n, float)
    R_M, R_P = radii(ref[..., 0])
    alt = ref[..., 2]
    return join_last(
        [
            ref[..., 0] + d[..., 0] / (R_M + alt),
            ref[..., 1] + d[..., 1] / ((R_P + alt) * np.cos(ref[..., 0])),
            alt - d[..., 2],
        ]
    )


def local_ned(lla: ArrayLike, origin_lla: ArrayLike) -> FloatArray:
    """Return positions (..., 3) [m] in the rigid north-east-down frame at an origin (3,)."""
    origin = np.asarray(origin_lla, float)
    C_en = matrix_en(origin[0], origin[1])
    offset: FloatArray = (to_ecef(lla) - to_ecef(origin)) @ C_en
    return offset


# --- datums ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Datum:
    """A geodetic datum: ellipsoid and transformation of its Earth-fixed axes to WGS 84."""

    name: str
    ellipsoid: Ellipsoid
    shift: tuple[float, float, float]  # translation to WGS 84 [m]
    rotation: tuple[float, float, float]  # to WGS 84, coordinate-frame convention [arcsec]
    scale: float  # correction to WGS 84 [1]


DATUMS = {
    datum.name: datum
    for datum in (
        Datum("WGS-84", WGS84, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0),
        # PZ-90.11 and WGS 84 (G1762) both follow ITRF2008 within centimeters: only the ellipsoid differs
        Datum("PZ-90.11", PZ90_11, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0),
        # GOST R 51794-2008; EPSG "Pulkovo 1942 to WGS 84 (20)"
        Datum("SK-42", KRASOVSKY_1940, (23.57, -140.95, -79.80), (0.0, -0.35, -0.79), -0.22e-6),
    )
}
"""Name -> datum for output positions (equations #29)."""


def compute_helmert(datum: Datum) -> tuple[FloatArray, FloatArray]:
    """Return A (3, 3), b (3,) [m] of ``WGS 84 = A @ datum + b``, first order in the rotation angles."""
    x, y, z = np.deg2rad(np.array(datum.rotation) / 3600.0)
    A = (1 + datum.scale) * np.array([[1.0, z, -y], [-z, 1.0, x], [y, -x, 1.0]])
    return A, np.array(datum.shift)


def to_datum(lla: ArrayLike, datum: str) -> FloatArray:
    """Convert WGS 84 geodetic positions (..., 3) [rad, rad, m] to latitude, longitude, height in a datum.

    Examples
    --------
    >>> sk42 = to_datum([np.deg2rad(50.0), np.deg2rad(30.0), 0.0], "SK-42")
    >>> print(np.round(np.rad2deg(sk42[:2]), 6), round(float(sk42[2]), 2))
    [50.000176 30.001705] -14.84
    """
    target = DATUMS[datum]
    A, b = compute_helmert(target)
    pos_e = (to_ecef(lla) - b) @ np.linalg.inv(A).T
    return to_geodetic(pos_e, target.ellipsoid)


def from_datum(lla: ArrayLike, datum: str) -> FloatArray:
    """Convert latitude, longitude, height (..., 3) in a datum to WGS 84 geodetic [rad, rad, m]."""
    target = DATUMS[datum]
    A, b = compute_helmert(target)
    pos_e: FloatArray = to_ecef(lla, target.ellipsoid) @ A.T + b
    return to_geodetic(pos_e)
