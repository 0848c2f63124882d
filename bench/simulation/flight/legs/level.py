"""Legs that hold heading and altitude."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from bench.core.records.flight_specs import SECONDS, WINGS, Leg, LegStart
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, Steps, smooth, wait
from bench.simulation.flight.legs.keys import AtSpeed, Key, Seconds, Speed

_NEAR_SPEED = 0.5  # an airspeed is reached within [m/s]
_PATIENCE = 120.0  # for an airspeed to settle [s]


@dataclass(frozen=True)
class Straight(AtSpeed):
    """Hold heading, altitude and airspeed."""

    kind = "straight"
    flown_by = WINGS
    duration: Seconds

    def describe(self) -> str:
        return f"{self.duration:g} s"

    def fly(self, cockpit: Cockpit) -> Steps:
        return wait(self.duration)


@dataclass(frozen=True)
class Cruise(AtSpeed):
    """Hold heading, altitude and airspeed over a distance on the ground."""

    kind = "cruise"
    flown_by = WINGS
    distance: Annotated[float, Key("distance_m", "distance over ground", 10, 1e7)]

    def describe(self) -> str:
        return f"{self.distance:g} m"

    def fly(self, cockpit: Cockpit) -> Steps:
        plane = cockpit.plane_here()
        flown = 0.0
        while flown < self.distance - 0.5 * plane.track()[1] / GUIDANCE_RATE:
            yield
            flown += plane.track()[1] / GUIDANCE_RATE
            if not flown > 0:
                raise FlightError(f"no way is made over ground: {cockpit.state()}")


@dataclass(frozen=True)
class SpeedChange(Leg):
    """Change the airspeed, wait for it, and hold it."""

    kind = "speed"
    flown_by = WINGS
    speed: Speed

    def describe(self) -> str:
        return f"to {self.speed:g} m/s"

    def fly(self, cockpit: Cockpit) -> Steps:
        cockpit.change_speed(self.speed)
        while not cockpit.speed_settled():
            yield

        def near() -> bool:
            return abs(cockpit.speed() - self.speed) < _NEAR_SPEED

        yield from cockpit.wait_until(near, _PATIENCE, f"{self.speed:g} m/s not held")


@dataclass(frozen=True)
class Configuration(Leg):
    """Move flaps or gear; heading, altitude and airspeed are held."""

    kind = "configuration"
    flaps: Annotated[float, Key("flaps", "0 up to 1 full", 0, 1)] | None = None
    gear: Annotated[Literal["up", "down"], Key("gear", "new position")] | None = None
    duration: Annotated[float, Key("duration_s", "duration of the movement", *SECONDS)] = 5.0

    def __post_init__(self) -> None:
        if self.flaps is None and self.gear is None:
            raise ValueError("needs flaps or gear")

    def describe(self) -> str:
        moved = [] if self.flaps is None else [f"flaps {self.flaps:g}"]
        moved += [] if self.gear is None else [f"gear {self.gear}"]
        return ", ".join(moved)

    def check(self, start: LegStart) -> list[str]:
        craft, moved = start.aircraft, {"flaps": self.flaps, "gear": self.gear}
        absent = [name for name in moved if moved[name] is not None and name not in craft.configuration]
        return [f"the {craft.name} has no {name} to move" for name in absent]

    def fly(self, cockpit: Cockpit) -> Steps:
        gear = None if self.gear is None else float(self.gear == "down")
        moves = []
        for name, wanted in (("fcs/flap-cmd-norm", self.flaps), ("gear/gear-cmd-norm", gear)):
            if wanted is not None:
                moves.append((cockpit.switch(name), cockpit.reader(name)(), wanted))
        for share in smooth(self.duration):
            for write, begun, wanted in moves:
                write(begun + share * (wanted - begun))
            yield
