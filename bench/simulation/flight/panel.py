"""Values that legs read from the model of an aircraft, of any kind, in SI."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef, to_geodetic
from bench.core.records.flight_specs import FlightSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.executive import find_property
from bench.simulation.flight.ground.taxiway import Taxiway
from bench.simulation.flight.guidance.belief import Belief
from bench.simulation.flight.guidance.shaping import Steps, ticks
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.trimming import INTEGRATORS, ON_WHEELS
from bench.simulation.signals.terrain import ground_at


class Panel:
    """The instruments of one flight.

    Attitude, height, velocity and position are those that are assumed; without a ``belief`` the true ones.
    """

    def __init__(self, fdm: Any, spec: FlightSpec, belief: Belief | None = None) -> None:
        def reader(name: str) -> Callable[[], float]:
            read: Callable[[], float] = find_property(fdm, name).get_double_value
            return read

        def switch(name: str) -> Callable[[float], None]:
            write: Callable[[float], None] = find_property(fdm, name).set_double_value
            return write

        def believed(name: str, what: str, factor: float = 1.0) -> Callable[[], float]:
            return reader(name) if belief is None else belief.believe(what, reader(name), factor)

        self.reader, self.switch, self.belief = reader, switch, belief
        self.aircraft, self.runway, self.terrain = spec.aircraft, spec.runway, spec.terrain
        self._alt_ft, self._agl_ft = reader("position/geod-alt-ft"), reader("position/h-agl-ft")
        self._lat_lon = reader("position/lat-geod-rad"), reader("position/long-gc-rad")
        self._set_ground_ft, self._flat_alt = switch("position/terrain-elevation-asl-ft"), spec.ground_alt
        self._nav_alt_ft = believed("position/geod-alt-ft", "altitude-ft", FT)
        self._down_fps = believed("velocities/v-down-fps", "down-fps", FT)
        self._speed_fps = reader("velocities/vt-fps")
        self._wheels = reader("gear/wow")
        self.true_roll = reader("attitude/phi-rad")
        self.heading = believed("attitude/psi-rad", "heading-rad")
        self.roll = believed("attitude/phi-rad", "roll-rad")
        self.pitch = believed("attitude/theta-rad", "pitch-rad")
        self.roll_rate = believed("velocities/p-rad_sec", "p-rad_sec")
        self._integrators = {name: switch(f"simulation/integrator/{name}") for name in ON_WHEELS}
        self._wind_fps = [reader(f"atmosphere/wind-{axis}-fps") for axis in ("north", "east")]
        self.start_lla = spec.lat, spec.lon, spec.alt  # of the flight [rad, rad, m]
        self.taxiways: list[Taxiway] = []  # that legs have led along

    def alt(self) -> float:
        """Ellipsoidal height [m]."""
        return self._nav_alt_ft() * FT

    def true_alt(self) -> float:
        """True ellipsoidal height [m]."""
        return self._alt_ft() * FT

    def alt_agl(self) -> float:
        """Height above ground [m]; by the radar altimeter, if any, when an estimate guides the flight."""
        if self.belief is None:
            return self.true_alt_agl()
        return self.belief.height(self.true_alt_agl(), self.alt() - self.true_alt())

    def true_alt_agl(self) -> float:
        """True height above ground [m]."""
        return self._agl_ft() * FT

    def ground_at(self, lat: ArrayLike, lon: ArrayLike) -> FloatArray:
        """Return the ellipsoidal heights of the ground at places (...) [rad], (...) [m].

        Raises
        ------
        FlightError
            If the terrain of the profile has no height at one of them.
        """
        if self.terrain is None:
            return np.full(np.shape(lat), self._flat_alt)
        ground = ground_at(self.terrain, lat, lon)
        if np.isnan(ground).any():
            row = int(np.isnan(ground).ravel().argmax())
            where = ", ".join(f"{math.degrees(float(np.ravel(v)[row])):.5f}" for v in (lat, lon))
            raise FlightError(f"{self.terrain.path.name} has no height at {where} deg")
        return ground

    def move_ground(self) -> None:
        """Set the ground of the model to the height of the terrain at the present position."""
        if self.terrain is not None:
            self._set_ground_ft(float(self.ground_at(*(read() for read in self._lat_lon))) / FT)

    def climb(self) -> float:
        """Vertical speed, up [m/s]."""
        return -self._down_fps() * FT

    def speed(self) -> float:
        """True airspeed [m/s]."""
        return self._speed_fps() * FT

    def on_wheels(self) -> bool:
        """Return whether a wheel touches the ground."""
        return self._wheels() > 0

    def wind_speed(self) -> float:
        """Horizontal wind without gusts and turbulence [m/s]."""
        return math.hypot(*(read() * FT for read in self._wind_fps))

    def state(self) -> str:
        """Return the flight in words."""
        return (
            f"at {self.alt():.0f} m, climbing {self.climb():.1f} m/s, "
            f"heading {math.degrees(self.heading()):.0f} deg, airspeed {self.speed():.1f} m/s"
        )

    def on_ground(self, standing: bool) -> None:
        """Choose the integration of the rates for wheels on the ground, or for flight."""
        for name, write in self._integrators.items():
            write((ON_WHEELS if standing else INTEGRATORS)[name])

    def wait_until(self, reached: Callable[[], bool], patience: float, what: str) -> Steps:
        """Continue the flight until a state is reached; raise FlightError after a time limit [s]."""
        for _ in ticks(patience):
            if reached():
                return
            yield
        raise FlightError(f"{what} within {patience:g} s: {self.state()}")

    def plane_here(self) -> Plane:
        """Return the tangent plane at the present position."""
        lat, lon = (self.reader(f"position/{name}-rad")() for name in ("lat-geod", "long-gc"))
        return Plane(self, lat, lon, self.alt())


class Plane:
    """Coordinates north and east of an origin, in the plane tangent to the Earth at the origin."""

    def __init__(self, panel: Panel, lat: float, lon: float, alt: float) -> None:
        C_en, origin = matrix_en(lat, lon), to_ecef([lat, lon, alt])
        self._north, self._east = (tuple(float(v) for v in C_en[:, k]) for k in (0, 1))
        self._origin = tuple(float(v) for v in origin)
        self._true_pos = self._pos = [panel.reader(f"position/ecef-{axis}-ft") for axis in "xyz"]
        self._true_vel = self._vel = [panel.reader(f"velocities/ecef-{axis}-fps") for axis in "xyz"]
        if panel.belief is not None:
            believe, axes = panel.belief.believe, tuple(enumerate("xyz"))
            self._pos = [believe(f"position/ecef-{a}-ft", self._true_pos[k], FT) for k, a in axes]
            self._vel = [believe(f"velocities/ecef-{a}-fps", self._true_vel[k], FT) for k, a in axes]

    def _project(self, x: float, y: float, z: float) -> tuple[float, float]:
        n, e = self._north, self._east
        return n[0] * x + n[1] * y + n[2] * z, e[0] * x + e[1] * y + e[2] * z

    def position(self) -> tuple[float, float]:
        """Return the position of the aircraft: north, east [m]."""
        x, y, z = (read() * FT - o for read, o in zip(self._pos, self._origin, strict=True))
        return self._project(x, y, z)

    def true_position(self) -> tuple[float, float]:
        """Return the true position: north, east [m]."""
        x, y, z = (read() * FT - o for read, o in zip(self._true_pos, self._origin, strict=True))
        return self._project(x, y, z)

    def velocity(self) -> tuple[float, float]:
        """Return the velocity over ground: north, east [m/s]."""
        x, y, z = (read() * FT for read in self._vel)
        return self._project(x, y, z)

    def true_speed(self) -> float:
        """Return the true speed over ground [m/s]."""
        return math.hypot(*self._project(*(read() * FT for read in self._true_vel)))

    def track(self) -> tuple[float, float]:
        """Return course [rad] and speed [m/s] over ground."""
        north, east = self.velocity()
        return math.atan2(east, north), math.hypot(north, east)

    def locate(self, points: list[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
        """Return the latitudes and longitudes (N,) [rad] of points: north, east [m]."""
        away = np.array(points) @ np.array([self._north, self._east])
        lat, lon, _ = to_geodetic(np.array(self._origin) + away).T
        return lat, lon

    def point(self, lat: float, lon: float, alt: float) -> tuple[float, float]:
        """Return a place [rad, rad, m]: north, east [m]."""
        x, y, z = (float(v) - o for v, o in zip(to_ecef([lat, lon, alt]), self._origin, strict=True))
        return self._project(x, y, z)
