"""Paths that the legs of a multirotor or a helicopter write to its guidance system, in SI."""

from __future__ import annotations

import math
from collections.abc import Callable, Generator
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef
from bench.core.records.flight_specs import HELICOPTER, FlightSpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.guidance.rides import Ride
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, Steps, smooth, ticks
from bench.simulation.flight.jsbsim_units import FT
from bench.simulation.flight.panel import Panel

Path = Callable[[float], tuple[FloatArray, float, float]]
"""Time since its start [s] -> position and three derivatives (4, 3), heading [rad], its rate [rad/s]."""

AXES = ("north", "east", "down")
ROTORS = range(4)
VERTICAL = 1.5
"""Acceleration of a climb or descent [m/s^2]."""
_YAW = math.radians(60.0)  # acceleration of a turn on the spot [rad/s^2]
_EARTH = 6.371e6  # radius by which the ground falls away from the plane of the start [m]
_SPIN_UP = 2.0  # until the rotors idle [s]
_LEAVES = 0.15  # height of the path above the aircraft at which the rotors take its weight [m]
_PATIENCE = 5.0  # for a lift-off, after which it counts as stuck [s]
_STAYS = 2  # ticks on the legs after which it has landed
_FAR = 10.0  # farther from its path the aircraft has lost it [m]


class RotorCockpit(Panel):
    """The controls and instruments of one flight on rotors; paths are north, east, down of the start [m]."""

    def __init__(self, fdm: Any, spec: FlightSpec) -> None:
        super().__init__(fdm, spec)
        self._set = [
            [self.switch(f"guidance/{axis}-setpoint-{unit}") for axis in AXES]
            for unit in ("m", "mps", "mps2", "mps3")
        ]
        self._set_heading = self.switch("guidance/heading-setpoint-rad")
        self._set_turning = self.switch("guidance/heading-rate-setpoint-rad_sec")
        self._set_tick, self._now = self.switch("guidance/tick-sec"), self.reader("simulation/sim-time-sec")
        self._air_share = self.switch("guidance/air-share")
        self._direct_share = self.switch("guidance/direct-share")
        self._direct = [self.switch(f"guidance/direct{k}-rad_sec") for k in ROTORS]
        self._idle, self._turns = self.reader("guidance/idle-gain")(), spec.aircraft.kind == HELICOPTER
        self._pos = [self.reader(f"guidance/{axis}-m") for axis in AXES]
        self.true_pitch = self.reader("attitude/theta-rad")
        self._dt = fdm.get_delta_t()
        lat, lon = spec.lat, spec.lon
        C_en, origin = matrix_en(lat, lon), to_ecef([lat, lon, spec.alt])
        for k, axis in enumerate(AXES):
            for i, letter in enumerate("xyz"):
                fdm[f"guidance/{axis}-{letter}"] = float(C_en[i, k])
        for i, letter in enumerate("xyz"):
            fdm[f"guidance/origin-{letter}-m"] = float(origin[i])
        ecef = [self.reader(f"position/ecef-{letter}-ft")() for letter in "xyz"]
        self.place: FloatArray = C_en.T @ (FT * np.array(ecef) - origin)  # where the path is [m]
        self.course = spec.heading  # of the nose along the path, not wrapped [rad]
        self._hold()

    # --- what the sequencer asks

    def tick(self) -> None:
        """Date the set-points: the systems of the next step see this time as their start."""
        self._set_tick(self._now() + self._dt)

    def off_path(self) -> float:
        """Return how far the aircraft is from its path [m]."""
        return float(np.linalg.norm([read() for read in self._pos] - self._wanted))

    def watch(self, *, may_touch: bool) -> None:
        """Raise FlightError if the aircraft has hit the ground, tipped over or lost its path."""
        off, tilt = self.off_path(), self.tilt()
        if not math.isfinite(off + tilt):
            raise FlightError("the motion is no longer finite")
        if self.on_wheels() and not may_touch:
            raise FlightError(f"flew into the ground: {self.state()}")
        if tilt > 0.5 * math.pi:
            raise FlightError(f"outside the envelope: upset to a tilt of {math.degrees(tilt):.0f} deg")
        if off > _FAR:
            limit = math.degrees(self.aircraft.max_bank)
            raise FlightError(
                f"{off:.0f} m off its path: speed and wind ask for more than a tilt of {limit:.0f} deg; "
                f"{self.state()}"
            )

    def tilt(self) -> float:
        """Return the angle between the axis of the rotors and the vertical [rad]."""
        return math.acos(max(-1.0, min(1.0, math.cos(self.true_roll()) * math.cos(self.true_pitch()))))

    def change_speed(self, speed: float) -> None:
        """Refuse a change of airspeed, which a leg for both kinds of aircraft may ask for."""
        raise FlightError(f"speed_mps = {speed:g} m/s is an airspeed; what hovers holds none")

    # --- paths

    def _write(self, path: FloatArray, heading: float, turning: float) -> None:
        self._wanted = path[0]
        for writes, row in zip(self._set, path.tolist(), strict=True):
            for write, value in zip(writes, row, strict=True):
                write(value)
        self._set_heading(heading)
        self._set_turning(turning)

    def _hold(self) -> None:
        self._write(np.vstack([self.place, np.zeros((3, 3))]), self.course, 0.0)

    def follow(self, path: Path, duration: float) -> Steps:
        """Fly a path, stretched to whole ticks, and hold its end."""
        n = len(ticks(duration - 1e-9))
        shrink = duration * GUIDANCE_RATE / n if n else 1.0
        for k in range(n):
            rows, heading, turning = path(k / GUIDANCE_RATE * shrink)
            self._write(rows * shrink ** np.arange(4.0)[:, None], heading, turning * shrink)
            yield
        rows, self.course, _ = path(duration)
        self.place = rows[0]
        self._hold()

    def go_to(self, place: FloatArray, speed: float, acceleration: float) -> Steps:
        """Fly straight to a place (3,) [m], from rest to rest, at most at a speed over ground [m/s].

        On a steep way the limits of climb and descent hold the speed down.
        """
        begun, way = self.place, place - self.place
        length = float(np.linalg.norm(way))
        if length == 0.0:
            return iter(())
        limit = self.aircraft.max_descent if way[2] > 0.0 else self.aircraft.max_climb
        speed = min(speed, limit * length / max(abs(float(way[2])), 1e-9))
        ride, along, heading = Ride.plan(length, speed, acceleration), way / length, self.course

        def path(t: float) -> tuple[FloatArray, float, float]:
            rows = np.outer(ride.at(t), along)
            rows[0] += begun
            return rows, heading, 0.0

        return self.follow(path, ride.duration)

    def go_to_height(self, alt: float, rate: float) -> Steps:
        """Climb or descend on the spot to an ellipsoidal height [m]."""
        return self.go_to(self.locate(self.place[0], self.place[1], alt), rate, VERTICAL)

    def turn_by(self, angle: float, rate: float) -> Steps:
        """Turn the nose on the spot by an angle [rad], positive to the right."""
        ride, rows = Ride.plan(abs(angle), rate, _YAW), np.vstack([self.place, np.zeros((3, 3))])
        begun, side = self.course, math.copysign(1.0, angle)

        def path(t: float) -> tuple[FloatArray, float, float]:
            turned, turning, _, _ = ride.at(t)
            return rows, begun + side * turned, side * turning

        return self.follow(path, ride.duration)

    def circle(self, radius: float, angle: float, speed: float, acceleration: float, nose: bool) -> Steps:
        """Fly an arc [rad], positive to the left, round the place ahead [m]; nose to it or kept."""
        ride, side = Ride.plan(radius * abs(angle), speed, acceleration), math.copysign(1.0, angle)
        begun = self.course
        ahead = np.array([math.cos(begun), math.sin(begun), 0.0])
        right = np.array([-ahead[1], ahead[0], 0.0])
        center = self.place + radius * ahead

        def path(t: float) -> tuple[FloatArray, float, float]:
            arc, v, a, j = (side * value / radius for value in ride.at(t))
            out = -math.cos(arc) * ahead - math.sin(arc) * right
            on = math.sin(arc) * ahead - math.cos(arc) * right
            rows = radius * np.vstack(
                [out, v * on, a * on - v * v * out, (j - v**3) * on - 3.0 * v * a * out]
            )
            rows[0] += center
            return rows, begun + arc if nose else begun, v if nose else 0.0

        return self.follow(path, ride.duration)

    def path_alt(self) -> float:
        """Return the ellipsoidal height of the path [m]."""
        north, east, down = (float(v) for v in self.place)
        return self.start_lla[2] - down + (north**2 + east**2) / (2.0 * _EARTH)

    def locate(self, north: float, east: float, alt: float) -> FloatArray:
        """Return the place (3,) of an ellipsoidal height [m] above a place in the plane of the start."""
        return np.array([north, east, self.start_lla[2] - alt + (north**2 + east**2) / (2.0 * _EARTH)])

    # --- ground

    def begin_hover(self) -> None:
        """Let the law take the rotors of an aircraft trimmed in the air."""
        self._air_share(1.0)
        self._direct_share(0.0)

    def spin(self, share: float) -> None:
        """Turn all rotors at a share of their idle speed as far as the law does not.

        The rotors of a helicopter turn all along; the main one gets its idle pitch, the rest none.
        """
        idle = (self._idle, 0.0, 0.0, 0.0) if self._turns else [share * self._idle] * len(ROTORS)
        for write, value in zip(self._direct, idle, strict=True):
            write(value)

    def ground_alt(self) -> float:
        """Return the ellipsoidal height of the ground below the path [m]."""
        return self.path_alt() - self.true_alt_agl()

    def lift_off(self, height: float, rate: float) -> Steps:
        """Spin up, take the weight at once when the path is a little higher, and climb to a height [m].

        It is above the runway, or without one above the ground below.
        """
        alt = height + (self.runway.alt if self.runway else self.ground_alt())
        for share in smooth(_SPIN_UP):
            self.spin(share)
            yield
        climb = self.go_to_height(alt, rate)
        stuck = len(ticks(_PATIENCE))
        on_legs = True
        for _ in climb:
            if on_legs and self._pos[2]() - self._wanted[2] > _LEAVES:
                self._direct_share(0.0)
                stuck -= 1
            if on_legs and not self.on_wheels():
                on_legs = False
                self.on_ground(standing=False)
                self._air_share(1.0)
            if stuck < 0:
                raise FlightError(f"not off the ground in {_PATIENCE:g} s: {self.state()}")
            yield

    def touch_down(self, sink: float, depth: float) -> Generator[None, None, float]:
        """Sink at a rate [m/s] until the legs carry, then stop the rotors; return the sink rate at touch."""
        touch, climb = 0, 0.0
        for _ in self.go_to(self.place + np.array([0.0, 0.0, depth]), sink, VERTICAL):
            if self.on_wheels():
                touch += 1
                self._air_share(0.0)
            else:
                touch, climb = 0, self.climb()
            if touch >= _STAYS:
                break
            yield
        else:
            raise FlightError(f"no ground within {depth:.1f} m below: {self.state()}")
        self.on_ground(standing=True)
        self.spin(1.0)
        for share in smooth(0.2):
            self._direct_share(share)
            yield
        for share in smooth(_SPIN_UP):
            self.spin(1.0 - share)
            yield
        self.place = np.array([read() for read in self._pos])
        self._hold()
        return -climb
