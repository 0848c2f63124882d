"""The standard atmosphere, pressure altitude and airspeed.

ISO 2533 with its constants, up to 32 km; airspeed by the isentropic relations of a perfect gas below the
speed of sound.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.instruments import AirspeedSpec

SEA_LEVEL_PRESSURE = 101325.0  # [Pa]
SEA_LEVEL_TEMPERATURE = 288.15  # [K]
GAS_CONSTANT = 287.05287  # of dry air [J/(kg K)]
GAMMA = 1.4  # ratio of specific heats of air [1]
_RADIUS = 6356766.0  # of the Earth, to convert between geometric and geopotential height [m]
_BOTTOM = (0.0, 11000.0, 20000.0)  # bottom of each layer, geopotential height [m]
LAPSE = -0.0065  # temperature gradient of the lowest layer [K/m]
_LAPSE = (LAPSE, 0.0, 0.001)  # temperature gradient in each layer [K/m]
TOP = 32000.0
"""Geopotential height up to which the standard atmosphere is computed [m]."""


def to_geopotential(alt: ArrayLike) -> FloatArray:
    """Return the geopotential height [m] of a geometric height [m]."""
    geometric: FloatArray = np.asarray(alt, float)
    height: FloatArray = geometric * _RADIUS / (geometric + _RADIUS)
    return height


def standard_atmosphere(
    height: ArrayLike, deviation: float = 0.0
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pressure [Pa], temperature [K] and density [kg/m^3] of the atmosphere.

    Parameters
    ----------
    height : (...) array
        Geopotential height [m], up to 32 km; below sea level the lowest layer goes on.
    deviation : float
        Temperature above standard at every height [K]; the pressure at sea level does not change.

    Raises
    ------
    ValueError
        If a height is above 32 km.

    Examples
    --------
    >>> print(*(f"{float(v):.5g}" for v in standard_atmosphere(5000.0)))
    54020 255.65 0.73612
    """
    height = np.asarray(height, np.float64)
    if (height > TOP).any():
        raise ValueError(f"the standard atmosphere here ends at {TOP:g} m; got {height.max():g} m")
    pressure = np.full_like(height, SEA_LEVEL_PRESSURE)
    temperature: FloatArray = np.full_like(height, SEA_LEVEL_TEMPERATURE + deviation)
    for k, (bottom, lapse) in enumerate(zip(_BOTTOM, _LAPSE, strict=True)):
        ceiling = (*_BOTTOM[1:], TOP)[k]
        rise = np.minimum(height, ceiling) - bottom if k == 0 else np.clip(height, bottom, ceiling) - bottom
        pressure *= np.exp(_log_pressure_ratio(temperature, lapse, rise))
        temperature = temperature + lapse * rise
    return pressure, temperature, pressure / (GAS_CONSTANT * temperature)


def _log_pressure_ratio(temperature: FloatArray, lapse: float, rise: FloatArray) -> FloatArray:
    """Return the logarithm of the pressure ratio over a rise [m] in one layer; temperature [K] below."""
    if lapse == 0.0:
        return -STANDARD_GRAVITY * rise / (GAS_CONSTANT * temperature)
    log: FloatArray = -STANDARD_GRAVITY / (GAS_CONSTANT * lapse) * np.log1p(lapse * rise / temperature)
    return log


def pressure_altitude(pressure: ArrayLike, setting: float = SEA_LEVEL_PRESSURE) -> FloatArray:
    """Return the reading of an altimeter at a static pressure: a geopotential height [m].

    Parameters
    ----------
    pressure : (...) array
        Above 0 [Pa].
    setting : float
        Altimeter setting (QNH) [Pa]; the reading is 0 at this pressure.
    """
    altitude: FloatArray = _find_height(np.asarray(pressure, float)) - _find_height(np.array(setting))
    return altitude


def _find_height(pressure: FloatArray) -> FloatArray:
    """Return the geopotential height of a pressure in the standard atmosphere [m]."""
    bottoms = [standard_atmosphere(bottom) for bottom in _BOTTOM]
    height = np.empty_like(pressure)
    for k, (base, temperature, _) in enumerate(bottoms):
        log = np.log(pressure / base)
        if _LAPSE[k] == 0.0:
            above = -GAS_CONSTANT * temperature / STANDARD_GRAVITY * log
        else:
            above = temperature / _LAPSE[k] * np.expm1(-GAS_CONSTANT * _LAPSE[k] / STANDARD_GRAVITY * log)
        height = np.where(pressure <= base, _BOTTOM[k] + above, height) if k else above
    return height


def impact_pressure(airspeed: ArrayLike, pressure: ArrayLike, temperature: ArrayLike) -> FloatArray:
    """Return total minus static pressure [Pa] at a subsonic true airspeed.

    Parameters
    ----------
    airspeed, pressure, temperature : arrays that broadcast
        True airspeed [m/s], static pressure [Pa] and temperature [K]. A negative speed gives a negative
        pressure.
    """
    speed = np.asarray(airspeed, float)
    mach2 = speed * np.abs(speed) / (GAMMA * GAS_CONSTANT * np.asarray(temperature, float))
    rise = np.expm1(3.5 * np.log1p(0.2 * np.abs(mach2)))
    impact: FloatArray = np.asarray(pressure, float) * np.sign(mach2) * rise
    return impact


def true_airspeed(impact: ArrayLike, pressure: ArrayLike, temperature: ArrayLike) -> FloatArray:
    """Return the true airspeed [m/s] of an impact pressure [Pa], the inverse of `impact_pressure`."""
    impact, pressure = np.asarray(impact, float), np.asarray(pressure, float)
    mach2 = 5.0 * np.expm1(np.log1p(np.abs(impact) / pressure) / 3.5)
    speed: FloatArray = np.sign(impact) * np.sqrt(GAMMA * GAS_CONSTANT * np.asarray(temperature) * mach2)
    return speed


def airspeed_sd(
    spec: AirspeedSpec, airspeed: ArrayLike, pressure: ArrayLike, temperature: ArrayLike
) -> FloatArray:
    """Return the white noise of an airspeed sensor as a standard deviation of true airspeed [m/s].

    Parameters
    ----------
    spec : AirspeedSpec
        Pressure noise divided by the slope of the impact pressure, ``rho V (1 + 0.2 M^2)^2.5``, and speed
        noise. The noise grows as the speed falls, down to ``min_speed`` or 1 m/s, and is constant below.
    airspeed, pressure, temperature : arrays that broadcast
        As for `impact_pressure`; a filter uses `standard_atmosphere` at its estimated height.
    """
    speed = np.maximum(np.abs(np.asarray(airspeed, float)), max(spec.min_speed, 1.0))
    pressure, temperature = np.asarray(pressure, float), np.asarray(temperature, float)
    density = pressure / (GAS_CONSTANT * temperature)
    mach2 = speed**2 / (GAMMA * GAS_CONSTANT * temperature)
    slope = density * speed * (1 + 0.2 * mach2) ** 2.5
    sd: FloatArray = np.hypot(spec.white_sd, spec.pressure_white_sd / slope)
    return sd
