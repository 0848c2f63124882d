"""Wind by altitude and discrete gusts in JSBSim; turbulence is in `turbulence.dryden`."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.flight_specs import FlightSpec, Gust
from bench.simulation.flight.jsbsim_units import FT

_LOCAL_FRAME = 3  # of a cosine gust: north, east, down
_LEAST_NORTH = 0.01 * FT  # [m/s]


def air_velocity(wind_from: float, wind_speed: float) -> FloatArray:
    """Return the velocity of the air mass (3,) [m/s], n; wind_from is the direction it comes from [rad].

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
    """Set a steady wind: velocity of the air mass (3,) [m/s], n."""
    for axis, speed in zip(("north", "east", "down"), wind_n, strict=True):
        fdm[f"atmosphere/wind-{axis}-fps"] = float(speed) / FT


class Weather:
    """Wind and gusts over the flight, without turbulence."""

    def __init__(self, fdm: Any, spec: FlightSpec) -> None:
        self._fdm = fdm
        layers = sorted(spec.wind_layers, key=lambda layer: layer.alt)
        self._alts = np.array([layer.alt for layer in layers])
        self._winds = np.array([air_velocity(layer.wind_from, layer.speed) for layer in layers])
        self._steady = air_velocity(spec.wind_from, spec.wind_speed)
        self._gusts = list(spec.gusts)

    def wind_at(self, alt: float) -> FloatArray:
        """Return the wind at an ellipsoidal height [m], (3,) velocity of the air mass [m/s], frame n."""
        if not len(self._alts):
            return self._steady
        wind_n = np.array([np.interp(alt, self._alts, column) for column in self._winds.T])
        if wind_n.any() and abs(wind_n[0]) < _LEAST_NORTH:
            wind_n[0] = _LEAST_NORTH
        return wind_n

    def blow(self, t: float, alt: float) -> None:
        """Set the wind at this time [s] and height [m], and begin the next gust if it is due."""
        if len(self._alts):
            set_wind(self._fdm, self.wind_at(alt))
        if self._gusts and t >= self._gusts[0].start - SAME_INSTANT:
            _start_gust(self._fdm, self._gusts.pop(0))


def _start_gust(fdm: Any, gust: Gust) -> None:
    strength = float(np.linalg.norm(gust.air_n))
    values = {
        "startup-duration-sec": gust.rise,
        "steady-duration-sec": gust.hold,
        "end-duration-sec": gust.fall,
        "magnitude-ft_sec": strength / FT,
        "frame": _LOCAL_FRAME,
        "X-velocity-ft_sec": gust.air_n[0] / strength,  # a direction
        "Y-velocity-ft_sec": gust.air_n[1] / strength,
        "Z-velocity-ft_sec": gust.air_n[2] / strength,
        "start": 1,
    }
    for name, value in values.items():
        fdm[f"atmosphere/cosine-gust/{name}"] = value
