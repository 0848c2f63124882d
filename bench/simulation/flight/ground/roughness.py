"""Roughness of the ground that an aircraft rolls on.

The elevation along a line has the one-sided density C (W / 1 rad/m)^-w of the spatial frequency W, between
the wavelengths of 2 m and 100 m. C is the unevenness index, w the waviness. Most frequent on seven measured
runways were 0.13e-6 m^3/rad and 2.2, more waviness than ISO 8608 has for roads ("Spectrum parameters for
runway roughness based on statistical and vibration analysis", abstract; it gives no unit, 1e-6 m^3/rad as
for roads is assumed).

The elevation is p(x) + q(y) with x along the runway and y across it, two profiles of this density. Lines
along and across have it, lines between them up to 1.4 times as much. Each wheel is at its own place: the
main wheels follow the nose wheel by the wheelbase.

JSBSim has one height of the ground for all wheels. A wheel is moved down its strut instead, by the elevation
h and by what the damper c adds to the spring k where the ground rises: h + (c / k) dh/dt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.random_streams import stream
from bench.core.records.flight_specs import FlightSpec
from bench.simulation.flight.ground.gear import Wheel, find_wheels
from bench.simulation.flight.guidance.shaping import smoothstep
from bench.simulation.flight.jsbsim_units import INCH
from bench.simulation.flight.panel import Panel, Plane

WAVELENGTHS = (2.0, 100.0)
"""Shortest and longest wavelength of the elevation [m]."""

WAVINESS = 2.2
"""Exponent of the density over spatial frequency."""

_PERIOD, _STEP = 8192.0, 0.25  # after which a profile repeats, and between its points [m]
_LEVEL = 20.0  # over which the ground becomes rough around a start on the ground [m]
_NEAR = 20.0  # wheels that are higher above the ground need no place on it [m]


def elevation_psd(frequency: ArrayLike, index: float) -> FloatArray:
    """Return the one-sided density of the elevation [m^3/rad] at spatial frequencies [rad/m].

    Parameters
    ----------
    frequency : float or (N,) array
        Spatial frequency [rad/m].
    index : float
        Unevenness index: the density at 1 rad/m [m^3/rad].

    Examples
    --------
    >>> float(elevation_psd(1.0, 0.13e-6))
    1.3e-07
    """
    frequency = np.asarray(frequency, float)
    longest, shortest = (2 * math.pi / length for length in reversed(WAVELENGTHS))
    inside = (frequency >= longest) & (frequency <= shortest)
    return np.where(inside, index * np.where(inside, frequency, 1.0) ** -WAVINESS, 0.0)


class ElevationProfile:
    """Elevation along a line, with a period of 8192 m: harmonics of the density with random phases.

    Parameters
    ----------
    rng : numpy.random.Generator
        Source of the phases.
    index : float
        Unevenness index [m^3/rad].
    """

    def __init__(self, rng: np.random.Generator, index: float) -> None:
        count = round(_PERIOD / _STEP)
        frequency = 2 * math.pi / _PERIOD * np.arange(count // 2 + 1)
        amplitude = np.sqrt(2 * elevation_psd(frequency, index) * frequency[1])
        harmonics = 0.5 * count * amplitude * np.exp(2j * math.pi * rng.random(len(frequency)))
        self.heights: list[float] = np.fft.irfft(harmonics).tolist()
        self._slopes: list[float] = np.fft.irfft(1j * frequency * harmonics).tolist()

    def at(self, place: float) -> float:
        """Return the elevation [m] at a place along the line [m], by cubics with the slopes at the points."""
        whole, x = divmod(place / _STEP, 1.0)
        k = int(whole) % len(self.heights)
        n = (k + 1) % len(self.heights)
        share = smoothstep(x)
        bent = x * (1 - x) * ((1 - x) * self._slopes[k] - x * self._slopes[n])
        return (1 - share) * self.heights[k] + share * self.heights[n] + _STEP * bent


def over_rough_ground(
    fdm: Any, panel: Panel, spec: FlightSpec, dt: float, run: Callable[[], Any]
) -> Callable[[], Any]:
    """Return the step function of the model on the ground of the plan; ``run`` itself on smooth ground.

    Around a start on the ground it is level within the wheels and becomes rough over 20 m. The profiles
    follow from the seed of the turbulence.
    """
    if spec.runway is None or not spec.runway.roughness:
        return run
    return _RoughGround(fdm, panel, spec, dt, run).step


class _RoughGround:
    def __init__(self, fdm: Any, panel: Panel, spec: FlightSpec, dt: float, run: Callable[[], Any]) -> None:
        assert spec.runway is not None  # by over_rough_ground
        runway, self._dt, self._run, self._panel = spec.runway, dt, run, panel
        self._along, self._across = (
            ElevationProfile(stream(spec.turbulence_seed, 0, f"runway.{line}"), runway.roughness)
            for line in ("along", "across")
        )
        self._plane = Plane(panel, runway.lat, runway.lon, runway.alt)
        self._read_heading = panel.reader("attitude/psi-rad")
        self._runway = runway.heading, math.cos(runway.heading), math.sin(runway.heading)
        self._near = (spec.aircraft.rest_height or 0.0) + _NEAR
        self._wheels = find_wheels(spec.aircraft, fdm)
        self._moves = [panel.switch(f"{wheel.unit}/z-position") for wheel in self._wheels]
        self._at_rest = [panel.reader(f"{wheel.unit}/z-position")() for wheel in self._wheels]
        arm = max((math.hypot(wheel.forward, wheel.right) for wheel in self._wheels), default=0.0)
        self._stand = (*self._place(), arm) if spec.on_ground else None
        self._before: list[float] | None = None

    def _place(self) -> tuple[float, float]:
        """Return the place of the center of gravity along the runway and to the right of it [m]."""
        north, east = self._plane.true_position()
        _, c, s = self._runway
        return north * c + east * s, east * c - north * s

    def elevation(self, along: float, across: float) -> float:
        """Return the elevation at a place [m]."""
        height = self._along.at(along) + self._across.at(across)
        if self._stand is not None:
            off = math.hypot(along - self._stand[0], across - self._stand[1]) - self._stand[2]
            height *= smoothstep(min(max(off / _LEVEL, 0.0), 1.0))
        return height

    def _under(self, wheel: Wheel) -> float:
        turned = self._read_heading() - self._runway[0]
        c, s = math.cos(turned), math.sin(turned)
        along, across = self._place()
        return self.elevation(
            along + wheel.forward * c - wheel.right * s, across + wheel.forward * s + wheel.right * c
        )

    def step(self) -> Any:
        """Move the wheels by the elevation below each of them and run the next step."""
        if self._panel.true_alt_agl() < self._near:
            heights = [self._under(wheel) for wheel in self._wheels]
            before = heights if self._before is None else self._before
            for k, wheel in enumerate(self._wheels):
                moved = heights[k] + wheel.lead * (heights[k] - before[k]) / self._dt
                self._moves[k](self._at_rest[k] - moved / INCH)
            self._before = heights
        else:
            self._before = None
        return self._run()
