"""Signal propagation from the satellite: rotation of the Earth (Sagnac), troposphere, ionosphere."""

from __future__ import annotations

from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import ArrayLike

from bench.core.compilation.compiled import kernel, on_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.simulation.signals.orbits import L1, C

ZENITH_TROPOSPHERE = 2.638  # at sea level [m], B-10: 8.8 ns
TROPOSPHERE_SCALE = 7500.0  # scale height [m], B-10
_TOP = 11000.0  # end of the temperature gradient; greater heights count as this [m]

_NTCM_RADIUS, _NTCM_SHELL = 6371.0, 6371.0 + 450.0  # of the Earth and of the shell of NTCM-G [km]
_TECU = 40.3e16 / L1**2  # delay on L1 of 1e16 electrons per m^2 [m]
_GAS = 8314.34 / 28.9644  # of UNB3m [J/(kg K)]
_UNB_LATITUDES = (15.0, 30.0, 45.0, 60.0, 75.0)  # [deg]
_UNB_MEAN = (
    (1013.25, 1017.25, 1015.75, 1011.75, 1013.00),  # pressure [hPa]
    (299.65, 294.15, 283.15, 272.15, 263.65),  # temperature [K]
    (75.0, 80.0, 76.0, 77.5, 82.5),  # relative humidity [%]
    (6.30, 6.05, 5.58, 5.39, 4.53),  # fall of the temperature [K/km]
    (2.77, 3.15, 2.57, 1.81, 1.55),  # how the vapour falls with the pressure [1]
)
_UNB_SWING = (
    (0.00, -3.75, -2.25, -1.75, -0.50),
    (0.00, 7.00, 11.00, 15.00, 14.50),
    (0.0, 0.0, -1.0, -2.5, 2.5),
    (0.00, 0.25, 0.32, 0.81, 0.62),
    (0.00, 0.33, 0.46, 0.74, 0.30),
)
"""The same, amplitude over the year."""

Troposphere = Literal["saastamoinen", "unb3m", "b-10"]
Mapping = Literal["do-229", "cosecant"]


class SurfaceAir(NamedTuple):
    """Air at sea level; the standard atmosphere extends it to other heights with the same humidity."""

    pressure: float = 101325.0  # [Pa]
    temperature: float = 288.15  # [K]
    humidity: float = 0.5  # relative [1]; assumed


STANDARD = SurfaceAir()


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


find_range = on_arrays(range_kernel)
"""The same of arrays."""


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
    phi = np.minimum(np.maximum(semi_lat + psi * cos_az, -0.416), 0.416)
    lam = semi_lon + psi * sin_az / np.cos(phi * np.pi)
    m = phi + 0.064 * np.cos((lam - 1.617) * np.pi)
    local = 43200.0 * lam + t
    local = local - 86400.0 * np.floor(local / 86400.0)
    amplitude = np.maximum(model[0] + m * (model[1] + m * (model[2] + m * model[3])), 0.0)
    period = np.maximum(model[4] + m * (model[5] + m * (model[6] + m * model[7])), 72000.0)
    x2 = (2.0 * np.pi * (local - 50400.0) / period) ** 2
    day = (x2 < 1.57 * 1.57) * amplitude * (1.0 - x2 / 2.0 + x2 * x2 / 24.0)
    away = 0.53 - semi_el
    delay: float = C * (1.0 + 16.0 * away * away * away) * (5e-9 + day)
    return delay


def compute_ntcm(
    lat: FloatArray, lon: FloatArray, el: FloatArray, azimuth: FloatArray, hour: FloatArray, day: float,
    level: ArrayLike,
) -> FloatArray:  # fmt: skip
    """Return the delay of the ionosphere on GPS L1 (K,) [m] by NTCM-G, the model of Galileo without tables.

    European GNSS (Galileo) Open Service, NTCM-G Ionospheric Model Description, issue 1.0 (2022).

    Parameters
    ----------
    lat, lon, el, azimuth : (K,) arrays
        Receiver, and direction to the satellite [rad].
    hour : (K,) array
        Universal time of day [h].
    day : float
        Day of the year.
    level : (3,) array
        Broadcast effective ionisation level a_i0, a_i1, a_i2 [sfu, sfu/deg, sfu/deg^2].
    """
    away = np.pi / 2 - el - np.arcsin(np.clip(_NTCM_RADIUS * np.cos(el) / _NTCM_SHELL, -1.0, 1.0))
    phi = np.arcsin(np.sin(lat) * np.cos(away) + np.cos(lat) * np.sin(away) * np.cos(azimuth))
    lam = lon + np.arcsin(np.clip(np.sin(away) * np.sin(azimuth) / np.cos(phi), -1.0, 1.0))
    turn = 2 * np.pi / 24 * (hour + np.rad2deg(lam) / 15)  # local time as an angle
    sun = np.deg2rad(23.44 * np.sin(np.deg2rad(0.9856 * (day - 80.7))))
    height = np.cos(phi - sun)
    wave = (
        0.92519 * np.cos(turn - 2 * np.pi * 14 / 24)
        + 0.16951 * np.cos(2 * turn) + 0.00443 * np.sin(2 * turn)
        + 0.06626 * np.cos(3 * turn) + 0.00899 * np.sin(3 * turn)
    )  # fmt: skip
    of_day = height + 0.4 + (height - 2 / np.pi * phi * np.sin(sun)) * wave
    year = 2 * np.pi / 365.25
    of_year = 1 + 0.21289 * np.cos(year * (day - 18)) - 0.15414 * np.cos(2 * year * (day - 6))
    north, east = np.deg2rad(79.74), np.deg2rad(-71.78)  # geomagnetic pole
    magnetic = np.arcsin(np.sin(phi) * np.sin(north) + np.cos(phi) * np.cos(north) * np.cos(lam - east))
    crests = (
        1
        + 1.14023 * np.exp(-((np.rad2deg(magnetic) - 16) ** 2) / (2 * 12**2))
        + 1.20556 * np.exp(-((np.rad2deg(magnetic) + 10) ** 2) / (2 * 13**2))
    )
    a, b, c = np.asarray(level, float)
    azpar = np.sqrt(a * a + 1633.33 * b * b + 4802000 * c * c + 3266.67 * a * c)
    vertical = of_day * of_year * (1 - 0.38439 * np.cos(magnetic)) * crests * (1.41808 + 0.13985 * azpar)
    slant = 1 / np.sqrt(1 - (_NTCM_RADIUS / _NTCM_SHELL * np.sin(0.9782 * (np.pi / 2 - el))) ** 2)
    delay: FloatArray = _TECU * vertical * slant
    return delay


def zenith_troposphere(
    lat: ArrayLike,
    alt: ArrayLike,
    model: Troposphere = "saastamoinen",
    weather: SurfaceAir = STANDARD,
    day: float = 28.0,
) -> FloatArray:
    """Return the vertical delay of the troposphere [m].

    Parameters
    ----------
    lat, alt : float or (M,) array
        Receiver [rad, m]; below the ellipsoid the height counts as 0.
    model : str
        "saastamoinen": Saastamoinen (1972) in the standard atmosphere at 50 % humidity or in another
        ``weather``, hydrostatic part as in Davis et al., Radio Science 20 (1985). "unb3m": pressure,
        temperature and humidity from a table by latitude and day; Leandro, Santos, Langley, UNB Neutral
        Atmosphere Models: Development and Performance, ION NTM 2006. "b-10": 2.638 m at sea level, falling by
        1/e over 7500 m (B-10); 0.25 m more than Saastamoinen at sea level.
    weather : SurfaceAir
        At sea level, of "saastamoinen".
    day : float
        Of the year, for "unb3m".

    Examples
    --------
    >>> for model in ("saastamoinen", "unb3m", "b-10"):
    ...     print(f"{zenith_troposphere(0.8, 0.0, model):.3f} {zenith_troposphere(0.8, 3000.0, model):.3f}")
    2.393 1.621
    2.376 1.591
    2.638 1.768
    """
    lat, h = np.asarray(lat, float), np.maximum(np.asarray(alt, float), 0.0)
    if model == "b-10":
        return np.asarray(ZENITH_TROPOSPHERE * np.exp(-h / TROPOSPHERE_SCALE) + 0.0 * lat)
    if model == "unb3m":
        return _compute_unb3m(lat, h, day)
    if model != "saastamoinen":
        raise ValueError(f"model must be one of {', '.join(get_args(Troposphere))}; got {model!r}")
    h = np.minimum(h, _TOP)
    pressure = weather.pressure / 100.0 * (1 - 2.2557e-5 * h) ** 5.2568  # [hPa], ICAO standard atmosphere
    kelvin = weather.temperature - 6.5e-3 * h
    # [hPa], saturation by Magnus
    vapour = 6.108 * weather.humidity * np.exp((17.15 * kelvin - 4684.0) / (kelvin - 38.45))
    dry = 0.0022768 * pressure / (1 - 0.00266 * np.cos(2 * lat) - 0.28e-6 * h)
    wet = 0.002277 * (1255.0 / kelvin + 0.05) * vapour
    return np.asarray(dry + wet)


def _compute_unb3m(lat: FloatArray, h: FloatArray, day: float) -> FloatArray:
    """Return the vertical delay [m] at lat [rad] and h [m] on a day of the year."""
    degrees = np.abs(np.rad2deg(lat))
    season = np.cos((day - 28.0 + 182.625 * (lat < 0)) * 2 * np.pi / 365.25)
    pressure, kelvin, humidity, lapse, shape = (
        np.interp(degrees, _UNB_LATITUDES, mean) - np.interp(degrees, _UNB_LATITUDES, swing) * season
        for mean, swing in zip(_UNB_MEAN, _UNB_SWING, strict=True)
    )
    lapse = lapse / 1000.0
    saturated = 0.01 * np.exp(
        1.2378847e-5 * kelvin**2 - 1.9121316e-2 * kelvin + 3.393711047e1 - 6.3431645e3 / kelvin
    )
    vapour = humidity / 100 * saturated * (1.00062 + 3.14e-6 * pressure + 5.6e-7 * (kelvin - 273.15) ** 2)
    power = STANDARD_GRAVITY / _GAS / lapse
    there = kelvin - lapse * np.minimum(h, _TOP)
    pressure, vapour = (
        pressure * (there / kelvin) ** power,
        vapour * (there / kelvin) ** (power * (shape + 1)),
    )
    flat = np.arctan((1 - 6.6943799901413e-3) * np.tan(lat))
    pull = 1 - 2.66e-3 * np.cos(2 * flat) - 2.8e-7 * h
    mean = (shape + 1) * 9.784 * pull
    inside = there * (1 - lapse * _GAS / mean)  # mean temperature of the water vapour
    wet = 1e-6 * (64.79 - 77.604 * 18.0152 / 28.9644 + 3.776e5 / inside) * _GAS * vapour / mean
    return np.asarray(2.2768e-3 / pull * pressure + wet)


def ionosphere_free(range_1: ArrayLike, range_2: ArrayLike, f_1: ArrayLike, f_2: ArrayLike) -> FloatArray:
    """Combine ranges or range rates (K,) on two carriers [Hz], without first-order ionosphere (B-11)."""
    gamma = (np.asarray(f_2, float) / np.asarray(f_1, float)) ** 2
    combined: FloatArray = (np.asarray(range_1, float) - gamma * np.asarray(range_2, float)) / (1 - gamma)
    return combined
