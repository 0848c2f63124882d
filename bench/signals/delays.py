"""Signal propagation from the satellite: rotation of the Earth (Sagnac), troposphere, ionosphere."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from bench.arrays import FloatArray
from bench.compiled import kernel
from bench.signals.orbits import C

ZENITH_TROPOSPHERE = 2.638  # at sea level [m], B-10: 8.8 ns
TROPOSPHERE_SCALE = 7500.0  # scale height [m], B-10
_HUMIDITY = 0.5  # relative humidity at every height [1]; assumed
_TOP = 11000.0  # end of the temperature gradient; greater heights count as this [m]

Troposphere = Literal["saastamoinen", "b-10"]


@kernel
def range_kernel(
    sx: float, sy: float, sz: float, rx: float, ry: float, rz: float, rate: float
) -> tuple[float, float, float, float]:
    """Return the distance of a signal [m] and the direction from receiver to satellite, e at reception.

    The satellite (sx, sy, sz), Earth-fixed at transmission, is rotated back by ``rate`` [rad/s] times the
    travel time; ``rate = 0`` leaves out the Sagnac effect. The travel time includes the first-order effect,
    so the distance is exact to 1e-9 m.
    """
    dx, dy, dz = sx - rx, sy - ry, sz - rz
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    turn = rate / C * (distance + rate / C * (sx * ry - sy * rx))
    sin_t, cos_t = turn * (1.0 - turn * turn / 6.0), 1.0 - 0.5 * turn * turn
    dx = sx * cos_t + sy * sin_t - rx
    dy = sy * cos_t - sx * sin_t - ry
    distance = np.sqrt(dx * dx + dy * dy + dz * dz)
    return distance, dx / distance, dy / distance, dz / distance


@kernel
def range_rate_kernel(
    sx: float, sy: float, sz: float,
    vx: float, vy: float, vz: float,
    rx: float, ry: float, rz: float,
    ex: float, ey: float, ez: float,
    distance: float,
    rate: float,
) -> tuple[float, float]:  # fmt: skip
    """Return a, b of ``range rate = (a - e . v_receiver) / b``; velocities Earth-fixed [m/s].

    Both ends move in the inertial frame that coincides with e at reception, and the travel time changes:
    ``range rate (1 + e . v_sat / c) = e . (v_sat - v_receiver)`` with ``v + rate x r`` for both.
    """
    turn = rate / C * distance
    sin_t, cos_t = turn * (1.0 - turn * turn / 6.0), 1.0 - 0.5 * turn * turn
    ix, iy = vx - rate * sy, vy + rate * sx
    sat = ex * (ix * cos_t + iy * sin_t) + ey * (iy * cos_t - ix * sin_t) + ez * vz
    frame = rate * (ey * rx - ex * ry)
    return sat - frame, 1.0 + sat / C


@kernel
def mapping_kernel(sin_el: float) -> float:
    """Return the ratio of slant to vertical delay of the troposphere [1] (RTCA DO-229D, A.4.2.4)."""
    slope: float = 1.001 / np.sqrt(0.002001 + sin_el * sin_el)
    return slope


@kernel
def obliquity_kernel(el: float) -> float:
    """Return the ratio of slant to vertical delay of the ionosphere [1]: F of IS-GPS-200, 20.3.3.5.2.5."""
    away = 0.53 - el / np.pi
    return 1.0 + 16.0 * away * away * away


@kernel
def klobuchar_kernel(
    lat: float, lon: float, el: float, sin_az: float, cos_az: float, t: float, model: FloatArray
) -> float:
    """Return the delay of the ionosphere on GPS L1 [m] by the broadcast model (B-10b).

    IS-GPS-200, 20.3.3.5.2.5. Receiver at lat, lon [rad], elevation [rad], sine and cosine of the azimuth, GPS
    time of day [s], broadcast alpha 0-3 and beta 0-3 (8,) in their semicircle units. On another carrier f
    multiply by ``(L1 / f)^2``.
    """
    semi_lat, semi_lon, semi_el = lat / np.pi, lon / np.pi, el / np.pi
    psi = 0.0137 / (semi_el + 0.11) - 0.022
    phi = min(max(semi_lat + psi * cos_az, -0.416), 0.416)
    lam = semi_lon + psi * sin_az / np.cos(phi * np.pi)
    m = phi + 0.064 * np.cos((lam - 1.617) * np.pi)
    local = 43200.0 * lam + t
    local -= 86400.0 * np.floor(local / 86400.0)
    amplitude = max(model[0] + m * (model[1] + m * (model[2] + m * model[3])), 0.0)
    period = max(model[4] + m * (model[5] + m * (model[6] + m * model[7])), 72000.0)
    x = 2.0 * np.pi * (local - 50400.0) / period
    night = 5e-9
    if abs(x) < 1.57:
        x2 = x * x
        night += amplitude * (1.0 - x2 / 2.0 + x2 * x2 / 24.0)
    return C * obliquity_kernel(el) * night


def zenith_troposphere(lat: ArrayLike, alt: ArrayLike, model: Troposphere = "saastamoinen") -> FloatArray:
    """Return the vertical delay of the troposphere [m].

    Parameters
    ----------
    lat, alt : float or (M,) array
        Receiver [rad, m]; below the ellipsoid the height counts as 0.
    model : str
        "saastamoinen": Saastamoinen (1972) in the standard atmosphere at 50 % humidity, hydrostatic part as
        in Davis et al., Radio Science 20 (1985). "b-10": 2.638 m at sea level, falling by 1/e over 7500 m
        (B-10); 0.25 m more than Saastamoinen at sea level.

    Examples
    --------
    >>> for model in ("saastamoinen", "b-10"):
    ...     print(f"{zenith_troposphere(0.8, 0.0, model):.3f} {zenith_troposphere(0.8, 3000.0, model):.3f}")
    2.393 1.621
    2.638 1.768
    """
    lat, h = np.asarray(lat, float), np.maximum(np.asarray(alt, float), 0.0)
    if model == "b-10":
        return np.asarray(ZENITH_TROPOSPHERE * np.exp(-h / TROPOSPHERE_SCALE) + 0.0 * lat)
    if model != "saastamoinen":
        raise ValueError(f"model must be 'saastamoinen' or 'b-10'; got {model!r}")
    h = np.minimum(h, _TOP)
    pressure = 1013.25 * (1 - 2.2557e-5 * h) ** 5.2568  # [hPa], ICAO standard atmosphere
    kelvin = 288.15 - 6.5e-3 * h
    # [hPa], saturation by Magnus
    vapour = 6.108 * _HUMIDITY * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1 - 0.00266 * np.cos(2 * lat) - 0.28e-6 * h)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return np.asarray(dry + wet)


def ionosphere_free(range_1: ArrayLike, range_2: ArrayLike, f_1: ArrayLike, f_2: ArrayLike) -> FloatArray:
    """Combine ranges or range rates (K,) on two carriers [Hz], without first-order ionosphere (B-11)."""
    gamma = (np.asarray(f_2, float) / np.asarray(f_1, float)) ** 2
    combined: FloatArray = (np.asarray(range_1, float) - gamma * np.asarray(range_2, float)) / (1 - gamma)
    return combined
