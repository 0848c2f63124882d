"""Legs of a multirotor: it hovers, and flies from rest to rest."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Annotated, Literal

from bench.core.records.flight_specs import ALTITUDES, ROTORCRAFT, Leg, LegStart
from bench.simulation.flight.guidance.shaping import G, Steps, wait
from bench.simulation.flight.legs.keys import Key, Seconds, format_deg, side_of, write_key
from bench.simulation.flight.rotor_cockpit import RotorCockpit

GroundSpeed = Annotated[
    float, Key("speed_mps", "ground speed, if the distance suffices to reach it", 0.1, 100, most="max_speed")
]
Acceleration = Annotated[float, Key("accel_mps2", "largest acceleration along the path", 0.1, 10)]
_TURN = math.radians(60.0)  # rate at which the nose turns into a course [rad/s]
_NEAR_GROUND = 1.0  # height above it at which the sink before the touch-down begins [m]


@dataclass(frozen=True)
class Hover(Leg):
    """A multirotor holds place, height and heading."""

    kind = "hover"
    flown_by = ROTORCRAFT
    duration: Seconds

    def describe(self) -> str:
        return f"{self.duration:g} s"

    def fly(self, cockpit: RotorCockpit) -> Steps:
        return wait(self.duration)


@dataclass(frozen=True)
class Goto(Leg):
    """A multirotor flies straight to a point north and east of the start, and stops there."""

    kind = "goto"
    flown_by = ROTORCRAFT
    north: Annotated[float, Key("north_m", "distance north of the start", -1e4, 1e4)]
    east: Annotated[float, Key("east_m", "distance east of the start", -1e4, 1e4)]
    speed: GroundSpeed
    alt: (
        Annotated[float, Key("alt_m", "ellipsoidal altitude; without it the present one", *ALTITUDES)] | None
    ) = None
    accel: Acceleration = 3.0
    nose: Annotated[
        Literal["keep", "course"], Key("nose", "keep the heading, or turn it into the course first")
    ] = "keep"

    def describe(self) -> str:
        to = "" if self.alt is None else f", {self.alt:g} m"
        return f"{self.north:g} m north, {self.east:g} m east{to} at {self.speed:g} m/s"

    def alt_after(self, start: LegStart) -> float:
        return start.alt if self.alt is None else self.alt

    def fly(self, cockpit: RotorCockpit) -> Steps:
        alt = cockpit.path_alt() if self.alt is None else self.alt
        place = cockpit.locate(self.north, self.east, alt)
        away = place - cockpit.place
        if self.nose == "course" and math.hypot(away[0], away[1]) > 0.0:
            off = math.remainder(math.atan2(away[1], away[0]) - cockpit.course, math.tau)
            yield from cockpit.turn_by(off, _TURN)
        yield from cockpit.go_to(place, self.speed, self.accel)


@dataclass(frozen=True)
class Sprint(Leg):
    """A multirotor flies straight, level, over a distance, and stops there."""

    kind = "sprint"
    flown_by = ROTORCRAFT
    distance: Annotated[float, Key("distance_m", "distance over ground", 1, 1e4)]
    speed: GroundSpeed
    accel: Acceleration = 5.0
    off_nose: Annotated[
        float, Key("off_nose_deg", "course minus heading, positive to the right", -180, 180)
    ] = 0.0

    def describe(self) -> str:
        return f"{self.distance:g} m at {self.speed:g} m/s, {format_deg(self.off_nose)} off the nose"

    def fly(self, cockpit: RotorCockpit) -> Steps:
        course, (north, east, _) = cockpit.course + self.off_nose, cockpit.place
        north += self.distance * math.cos(course)
        east += self.distance * math.sin(course)
        place = cockpit.locate(north, east, cockpit.path_alt())
        return cockpit.go_to(place, self.speed, self.accel)


@dataclass(frozen=True)
class Orbit(Leg):
    """A multirotor circles a point ahead of it, and stops after some laps."""

    kind = "orbit"
    flown_by = ROTORCRAFT
    radius: Annotated[float, Key("radius_m", "radius; the center is ahead at this distance", 1, 1000)]
    speed: GroundSpeed
    laps: Annotated[float, Key("laps", "number of laps", 0.05, 1000)] = 1.0
    side: Annotated[
        Literal["left", "right"], Key("side", "side to which it moves first, with the center ahead")
    ] = "left"
    nose: Annotated[
        Literal["center", "keep"], Key("nose", "point the nose to the center, or keep the heading")
    ] = "center"
    accel: Acceleration = 2.0

    def describe(self) -> str:
        where = f"{self.radius:g} m to the {self.side}"
        return f"{self.laps:g} laps of {where} at {self.speed:g} m/s, nose: {self.nose}"

    def check(self, start: LegStart) -> list[str]:
        tilt = math.atan(self.speed**2 / self.radius / G)
        if tilt <= start.aircraft.max_bank:
            return []
        return [
            f"{write_key(self, 'speed')} on {write_key(self, 'radius')} needs a tilt of {format_deg(tilt)}, "
            f"above the {format_deg(start.aircraft.max_bank)} of the {start.aircraft.name}"
        ]

    def fly(self, cockpit: RotorCockpit) -> Steps:
        arc = math.tau * self.laps * (1.0 if self.side == "left" else -1.0)
        return cockpit.circle(self.radius, arc, self.speed, self.accel, nose=self.nose == "center")


@dataclass(frozen=True)
class Yaw(Leg):
    """A multirotor turns its nose on the spot."""

    kind = "yaw"
    flown_by = ROTORCRAFT
    by: Annotated[float, Key("by_deg", "change of heading, positive to the right", -36000, 36000)]
    rate: Annotated[float, Key("rate_deg_s", "largest yaw rate", 0.1, 180)] = math.radians(30.0)

    def describe(self) -> str:
        return f"{format_deg(abs(self.by))} {side_of(self.by)}"

    def fly(self, cockpit: RotorCockpit) -> Steps:
        return cockpit.turn_by(self.by, self.rate)


@dataclass(frozen=True)
class Land(Leg):
    """A multirotor descends on the spot, touches down and stops its rotors."""

    kind = "land"
    flown_by = ROTORCRAFT
    leaves = "ground"
    rate: Annotated[
        float, Key("rate_mps", "descent rate until 1 m above the ground", 0.1, 100, most="max_descent")
    ] = 1.5
    sink: Annotated[float, Key("sink_mps", "sink rate at the touch-down", 0.05, 1)] = 0.3

    def describe(self) -> str:
        return f"at {self.rate:g} m/s, touching at {self.sink:g} m/s"

    def alt_after(self, start: LegStart) -> float:
        return math.nan  # of the ground, wherever that is

    def fly(self, cockpit: RotorCockpit) -> Generator[None, None, str]:
        """Descend to a meter above the ground, then sink until the legs carry."""
        low = cockpit.ground_alt() + (cockpit.aircraft.rest_height or 0.0) + _NEAR_GROUND
        if low < cockpit.path_alt():
            yield from cockpit.go_to_height(low, self.rate)
        touched = yield from cockpit.touch_down(self.sink, 2.0 * _NEAR_GROUND)
        return f"touched at {touched:.2g} m/s"
