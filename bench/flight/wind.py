"""Steady wind and Milspec turbulence in JSBSim, the turbulence from a seed."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.flight.units import FT
from bench.specs import stream

# Wind 20 ft above ground of MIL-F-8785C for light, moderate and severe turbulence (15, 30, 45 kt), at the
# probability-of-exceedance index JSBSim takes for each; a straight line between and beyond.
_SEVERITY = (0.0, 3.0, 4.0, 6.0, 7.0)
_WIND_20FT_FPS = (0.0, 25.3, 50.6, 76.0, 88.7)
_MILSPEC = 3
_LEAST_NORTH = 0.01 * FT  # [m/s]


def air_velocity(wind_from: float, wind_speed: float) -> FloatArray:
    """Return the velocity of the air mass, (3,) [m/s], frame n; wind_from is where it comes from [rad].

    JSBSim turns its turbulence with the wind only while the north component is not
    zero: a wind from due east or west gets 0.01 ft/s (3 mm/s) of it.

    Examples
    --------
    >>> print(air_velocity(wind_from=np.pi / 6, wind_speed=6.0).round(3))
    [-5.196 -3.     0.   ]
    """
    north, east = -wind_speed * np.cos(wind_from), -wind_speed * np.sin(wind_from)
    if wind_speed > 0 and abs(north) < _LEAST_NORTH:
        north = _LEAST_NORTH
    return np.array([north, east, 0.0])


def set_wind(fdm: Any, wind_n: FloatArray) -> None:
    """Blow a steady wind, (3,) velocity of the air mass [m/s], frame n."""
    for axis, speed in zip(("north", "east", "down"), wind_n, strict=True):
        fdm[f"atmosphere/wind-{axis}-fps"] = float(speed) / FT


def start_turbulence(fdm: Any, severity: int, seed: int) -> None:
    """Start Milspec turbulence of a probability-of-exceedance index (0 none to 7) from a seed.

    JSBSim draws once per step: the same seed at another step gives another history.
    """
    fdm["simulation/randomseed"] = int(stream(seed, 0, "turbulence").integers(1, 2**31 - 1))
    fdm["atmosphere/turb-type"] = _MILSPEC if severity else 0
    fdm["atmosphere/turbulence/milspec/severity"] = severity
    fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = float(
        np.interp(severity, _SEVERITY, _WIND_20FT_FPS)
    )
