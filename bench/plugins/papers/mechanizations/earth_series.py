"""Radii and gravity of the mechanizations: exact, or the series of the source (A-2.2.1, A-2.2.G1 to G3)."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from bench.core.mathematics.earth import EARTH_RATE, GAMMA_E, WGS84, Ellipsoid, gravity_kernel

_exact_gravity = gravity_kernel.py_func  # type: ignore[attr-defined]


class EarthModel(NamedTuple):
    """Model of the Earth in a mechanization."""

    radii: str = "exact"
    """A key of :data:`RADII`."""
    gravity: str = "exact"
    """A key of :data:`GRAVITIES`."""
    ellipsoid: Ellipsoid = WGS84
    """Of the radii and coordinates; gravity is that of WGS 84."""


def exact_radii(s: float, h: float, e: Ellipsoid) -> tuple[float, float]:
    """Return 1/(R_M + h) and 1/(R_P + h) [1/m] at the sine of a latitude and a height [m] (A-2.2.R)."""
    w2 = 1.0 - e.e2 * s * s
    prime = e.a / math.sqrt(w2)
    return 1.0 / (prime * (1.0 - e.e2) / w2 + h), 1.0 / (prime + h)


def long_radii(s: float, h: float, e: Ellipsoid) -> tuple[float, float]:
    """Return the curvatures of `exact_radii` by the long series, within 0.3 ppm up to 12 km (A-2.2.1)."""
    e2, r, s2 = e.e2, h / e.a, s * s
    meridian = 1 + e2 - r - 1.5 * e2 * s2 - 2 * e2 * r + 3 * e2 * r * s2 + r * r
    meridian += e2 * e2 * (1 - 1.5 * s2 + 0.375 * s2 * s2)
    prime = 1 - r - 0.5 * e2 * s2 + r * r + e2 * r * s2 - 0.125 * e2 * e2 * s2 * s2
    return meridian / e.a, prime / e.a


def short_radii(s: float, h: float, e: Ellipsoid) -> tuple[float, float]:
    """Return the curvatures of `exact_radii` by the short series, within 45 ppm at sea level (A-2.2.1)."""
    e2, r = e.e2, h / e.a
    return (1 + e2 - r - 1.5 * e2 * s * s) / e.a, (1 - r - 0.5 * e2 * s * s) / e.a


RADII: dict[str, Callable[[float, float, Ellipsoid], tuple[float, float]]] = {
    "exact": exact_radii,
    "long": long_radii,
    "short": short_radii,
}

_A, _E2 = WGS84.a, WGS84.e2
_Q = EARTH_RATE**2 * _A / GAMMA_E


def fine_gravity(s: float, c: float, h: float) -> tuple[float, float]:
    """Return the north and down components of the 1e-5 set (A-2.2.G1) [m/s^2]."""
    e2, q, r, s2 = _E2, _Q, h / _A, s * s
    sin2 = 2.0 * s * c
    bracket = 1 - 2 * r - (e2 + 2 * q - 3 * r) * r
    bracket += (0.5 * (5 * q - e2) - e2 * e2 / 8 - 3 / 28 * q * e2 + (3 * e2 - 5 * q) * r) * s2
    bracket += -0.5 * q * e2 * s2 * s2 + e2 / 16 * (0.5 * e2 - 7 * q) * sin2 * sin2
    return 0.5 * GAMMA_E * r * (e2 - 5 * q) * sin2, GAMMA_E * bracket


def medium_gravity(s: float, c: float, h: float) -> tuple[float, float]:
    """Return the north and down components of the 1e-4 set (A-2.2.G2) [m/s^2]."""
    e2, q, r, s2 = _E2, _Q, h / _A, s * s
    sin2 = 2.0 * s * c
    bracket = 1 - 0.5 * e2 * s2 + 2.5 * q * s2 + e2 * e2 * (-s2 / 8 + sin2 * sin2 / 32)
    bracket += e2 * q * (-17 / 28 * s2 - 5 / 16 * sin2 * sin2)
    bracket += r * e2 * (3 * s2 - 1) + r * q * (-2 - 5 * s2) - 2 * r + 3 * r * r
    return GAMMA_E * sin2 * r * (0.5 * e2 - 2.5 * q), GAMMA_E * bracket


def simple_gravity(s: float, c: float, h: float) -> tuple[float, float]:
    """Return the north and down components of the simple formula of the slow loop (A-2.2.G3) [m/s^2]."""
    del c
    return 0.0, GAMMA_E * (1 + 5.2884e-3 * s * s) * (1 - 2 * h / _A * (1 - _E2 * s * s))


GRAVITIES: dict[str, Callable[[float, float, float], tuple[float, float]]] = {
    "exact": _exact_gravity,
    "fine": fine_gravity,
    "medium": medium_gravity,
    "simple": simple_gravity,
}
