"""Thermals: columns of rising air over flat ground, and the sink between them.

M. J. Allen, Updraft Model for Development of Autonomous Soaring Uninhabited Air Vehicles, AIAA 2006-1510
(NTRS 20060004052). Of the paper its first page was opened; the equations are those of its program as
transcribed in ``AllenThermal.m`` of the public repository lars-ehrlich/Thermal-Modelling, and the number of
thermals is quoted in the public program glideslope. With z the height above ground, z_i the depth of the
convective layer and w* its velocity scale:

    mean updraft  w_m = w* (z/z_i)^(1/3) (1 - 1.1 z/z_i)
    outer radius  r_2 = max(10 m, 0.102 (z/z_i)^(1/3) (1 - 0.25 z/z_i) z_i)
    inner radius  r_1 = q r_2, q = min(0.0011 r_2 + 0.14, 0.8)
    core          w_c = 3 w_m (1 - q) / (1 - q^3)
    profile       w_c / (1 + (k_1 |r/r_2 + k_3|)^k_2) + w_c k_4 r/r_2, at least 0, by a table of q
    edge          w_m (pi/6) sin(pi r/r_2) for r_2 < r < 2 r_2, times 2.5 (z/z_i - 0.5), 0 to 1
    number        0.6 A / (z_i r_2) in an area A

What differs, so that the wind has no step anywhere: the profile is interpolated between the rows of the
table, where the program takes the nearest; neighbors are added, where it takes the nearest thermal; the edge
keeps its full strength above 0.9 z_i; the stretch that joins a profile to the sink begins at its center; the
air is still above z_i / 1.1, where the mean updraft ends. The sink is the one that makes the mean vertical
wind of the area zero at each height: the program's counts every thermal as a mean one, and leaves out 2 % of
the updraft.

Thermals stand upright over their places and last; the aircraft feels them at its center, not across the span.
Strengths and radii of single ones are within 20 % of the mean. These are choices of this project.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import radii
from bench.core.mathematics.random_streams import stream
from bench.core.records.flight_specs import FlightSpec, ThermalsSpec
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, smoothstep
from bench.simulation.flight.jsbsim_units import FT

_RATIOS = np.array([0.14, 0.25, 0.36, 0.47, 0.58, 0.69, 0.80])  # q of the rows of the table
_SHAPES = np.array(  # k_1 to k_4
    [
        [1.5352, 2.5826, -0.0113, -0.1950],
        [1.5265, 3.6054, -0.0176, -0.1265],
        [1.4866, 4.8356, -0.0320, -0.0818],
        [1.2042, 7.7904, 0.0848, -0.0445],
        [0.8816, 13.9720, 0.3404, -0.0216],
        [0.7067, 23.9940, 0.5689, -0.0099],
        [0.6189, 42.7965, 0.7157, -0.0033],
    ]
)
_TOP = 1 / 1.1  # z/z_i at which the mean updraft ends
_USUAL = 0.4  # z/z_i whose radius gives the number of thermals
_TILES = 3.0  # side of the square that repeats, by z_i
_SPREAD = 0.2  # of strengths and radii about the mean
_BEGIN = 10.0  # time in which the vertical wind comes up after the start [s]
_REACH = 2.0  # r/r_2 beyond which a thermal adds nothing
_PARTS = 4000  # of it, for integrals


def _row_profiles(ratio: FloatArray) -> FloatArray:
    """Return the profiles over w_c of all rows of the table at r/r_2 (...), (..., 7)."""
    k1, k2, k3, k4 = _SHAPES.T
    at = ratio[..., None]
    profiles: FloatArray = np.maximum(1.0 / (1.0 + (k1 * np.abs(at + k3)) ** k2) + k4 * at, 0.0)
    return profiles


@cache
def _integrate_rows() -> FloatArray:
    """Return the integrals of the profiles over the area, over r_2^2, (7,)."""
    step = _REACH / _PARTS
    at = step * (np.arange(_PARTS, dtype=np.float64) + 0.5)
    total: FloatArray = 2 * np.pi * step * (at @ _row_profiles(at))
    return total


def mean_updraft(height: float, thermals: ThermalsSpec) -> float:
    """Return the mean updraft of a thermal at a height above ground [m], [m/s]; 0 above the layer.

    Examples
    --------
    >>> round(mean_updraft(280.0, ThermalsSpec(w_star=2.56, depth=1401.0)), 3)
    1.168
    """
    share = min(max(height / thermals.depth, 0.0), _TOP)
    return float(thermals.w_star * np.cbrt(share) * (1 - 1.1 * share))


def outer_radius(height: float, thermals: ThermalsSpec) -> float:
    """Return the mean outer radius of a thermal at a height above ground [m], [m].

    Examples
    --------
    >>> round(outer_radius(280.0, ThermalsSpec(w_star=2.56, depth=1401.0)), 1)
    79.4
    """
    share = min(max(height / thermals.depth, 0.0), _TOP)
    return float(0.102 * np.cbrt(share) * (1 - 0.25 * share) * thermals.depth)


class ThermalField:
    """Thermals at places that repeat north and east, the same for the same seed.

    Parameters
    ----------
    thermals : ThermalsSpec
        The convective layer.
    seed : int
        The places, strengths and radii follow from it.
    """

    def __init__(self, thermals: ThermalsSpec, seed: int) -> None:
        self._layer = thermals
        self.side = _TILES * thermals.depth
        """Side of the square that repeats [m]."""
        usual = outer_radius(_USUAL * thermals.depth, thermals)
        number = max(1, round(0.6 * self.side**2 / (thermals.depth * usual)))
        rng = stream(seed, 0, "thermals")
        places = self.side * (rng.random((number, 2)) - 0.5)
        self.places = places[np.argsort(np.hypot(*places.T))]
        """North and east of the start [m], (N, 2), the nearest first."""
        self.strengths, self.widths = 1 + _SPREAD * (2 * rng.random((2, number)) - 1)
        """Of each over the mean, (N,)."""
        self._rows = _integrate_rows()

    def vertical_wind(self, north: float, east: float, height: float) -> float:
        """Return the vertical wind, up [m/s], north and east of the start at a height above ground [m]."""
        return float(self.vertical_winds(np.array([[north, east]]), height)[0])

    def vertical_winds(self, at: FloatArray, height: float) -> FloatArray:
        """Return the vertical winds, up (K,) [m/s], at places (K, 2) [m] and one height above ground [m]."""
        mean, share = mean_updraft(height, self._layer), height / self._layer.depth
        if mean <= 0:
            return np.zeros(len(at))
        radius = np.maximum(10.0, outer_radius(height, self._layer) * self.widths)
        q = np.minimum(0.0011 * radius + 0.14, 0.8)
        core, edge = 3 * (1 - q) / (1 - q**3), min(max(2.5 * (share - 0.5), 0.0), 1.0)
        row = np.minimum(np.searchsorted(_RATIOS, q, side="right") - 1, len(_RATIOS) - 2)
        part = (q - _RATIOS[row]) / (_RATIOS[row + 1] - _RATIOS[row])
        # over the area: the edge alone is -pi r_2^2
        profile = (1 - part) * self._rows[row] + part * self._rows[row + 1]
        flux = self.strengths * radius**2 * (core * profile - np.pi * edge)
        stretched = radius**2 * (profile - np.pi * edge / core)
        sink = -flux.sum() / (self.side**2 - stretched.sum())  # over the mean updraft
        away = np.abs(at[:, None] - self.places)
        away = np.minimum(away % self.side, -away % self.side)
        ratio = np.hypot(away[..., 0], away[..., 1]) / radius
        total = np.full(len(at), sink)
        near, which = np.nonzero(ratio < _REACH)
        r = ratio[near, which]
        rows = _row_profiles(r)
        here, k = np.arange(len(r)), row[which]
        shape = (1 - part[which]) * rows[here, k] + part[which] * rows[here, k + 1]
        ring = np.where(r > 1, np.pi / 6 * np.sin(np.pi * r), 0.0)
        rises = (core[which] * shape + edge * ring) * (self.strengths[which] - sink / core[which])
        np.add.at(total, near, rises)
        return mean * total


def locate_thermals(spec: FlightSpec) -> list[tuple[float, float]]:
    """Return latitude and longitude of the thermals of a plan [rad], the nearest to the start first."""
    if spec.thermals is None:
        return []
    per_north, per_east = _scale(spec)
    places = ThermalField(spec.thermals, spec.turbulence_seed).places
    return [(spec.lat + north / per_north, spec.lon + east / per_east) for north, east in places.tolist()]


def _scale(spec: FlightSpec) -> tuple[float, float]:
    """Return the lengths of a radian of latitude and of longitude at the start [m]."""
    meridian, prime = (float(v) for v in radii(spec.lat))
    return meridian + spec.alt, (prime + spec.alt) * math.cos(spec.lat)


def through_thermals(fdm: Any, spec: FlightSpec, dt: float) -> Callable[[], Any]:
    """Return the step function of the model with the thermals of the plan, or JSBSim's own ``run``.

    The vertical wind is looked up 20 times a second, at the place of the next time, and goes there in a
    straight line. It comes up from zero, for which the aircraft is trimmed, in the first ten seconds.
    """
    if spec.thermals is None:
        run: Callable[[], Any] = fdm.run
        return run
    return _Thermals(fdm, spec, dt).step


class _Thermals:
    def __init__(self, fdm: Any, spec: FlightSpec, dt: float) -> None:
        assert spec.thermals is not None
        self._run, self._field = fdm.run, ThermalField(spec.thermals, spec.turbulence_seed)
        self._read = [
            find_property(fdm, name).get_double_value
            for name in (
                "position/lat-geod-rad",
                "position/long-gc-rad",
                "position/geod-alt-ft",
                "velocities/v-north-fps",
                "velocities/v-east-fps",
                "velocities/v-down-fps",
            )
        ]
        self._set_down = find_property(fdm, "atmosphere/wind-down-fps").set_double_value
        self._origin = spec.lat, spec.lon, spec.ground_alt
        self._scale = _scale(spec)
        self._per_tick = round(1 / (GUIDANCE_RATE * dt))
        self._done, self._begun, self._end = 0, 0.0, 0.0

    def step(self) -> Any:
        """Write the vertical wind of the next step and fly it."""
        k = self._done % self._per_tick
        if not k:
            self._begun, self._end = self._end, self._look_up()
        self._done += 1
        up = self._begun + (k + 1) / self._per_tick * (self._end - self._begun)
        self._set_down(-up / FT)
        return self._run()

    def _look_up(self) -> float:
        """Return the vertical wind, up [m/s], where the aircraft is at the next time."""
        lat, lon, alt, north, east, down = (read() for read in self._read)
        ahead = 1 / GUIDANCE_RATE
        along = self._scale[0] * (lat - self._origin[0]) + north * FT * ahead
        across = self._scale[1] * math.remainder(lon - self._origin[1], math.tau) + east * FT * ahead
        height = alt * FT - self._origin[2] - down * FT * ahead
        begun = smoothstep(min(1.0, (self._done + self._per_tick) / self._per_tick * ahead / _BEGIN))
        return begun * self._field.vertical_wind(along, across, height)
