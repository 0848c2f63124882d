"""Legs of a glider."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Annotated, Literal

from bench.core.records.flight_specs import ALTITUDES, GLIDER, SECONDS, LegStart
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.paths import Follower, Point, SegmentPath, run_in, turn_radius
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, roll_time, smooth
from bench.simulation.flight.legs.keys import SIDES, AtSpeed, Bank, Key, format_deg


@dataclass(frozen=True)
class CircleThermal(AtSpeed):
    """A glider flies to a thermal of [wind.thermals] and circles in it up to an altitude or for a time."""

    kind = "thermal"
    flown_by = (GLIDER,)
    number: Annotated[int, Key("number", "number of the thermal; 1 is the nearest to the start", 1, 10000)]
    to_alt: Annotated[float, Key("to_alt_m", "ellipsoidal altitude at which the glider leaves", *ALTITUDES)]
    duration: Annotated[float, Key("duration_s", "longest time in the circle", *SECONDS)]
    bank: Bank
    side: Annotated[Literal["right", "left"], Key("side", "side of the circle")] = "right"

    def describe(self) -> str:
        return f"number {self.number} {self.side} to {self.to_alt:g} m, bank {format_deg(self.bank)}"

    def alt_after(self, start: LegStart) -> float:
        return math.nan

    def fly(self, cockpit: Cockpit) -> Generator[None, None, str]:
        """Fly a tangent to the circle, follow it over ground, roll out."""
        places = cockpit.thermal_places
        if self.number > len(places):
            raise FlightError(f"number = {self.number}: there are {len(places)} thermals")
        while not cockpit.speed_settled():
            yield
        plane = cockpit.plane_here()
        center = plane.point(*places[self.number - 1], cockpit.start_lla[2])
        radius = turn_radius(cockpit, self.bank)
        path = SegmentPath(plane.position(), plane.track()[0])
        path.straight(run_in(cockpit, self.bank))
        join_circle(path, center, radius, SIDES[self.side])
        there = path.length
        path.arc(SIDES[self.side] * (2 * self.duration * cockpit.fastest() / radius), radius)
        follower = Follower(cockpit, plane, path, self.bank)
        begun: float | None = None
        left = math.ceil(self.duration * GUIDANCE_RATE)
        while follower.steer() and left:
            if follower.along > there:
                begun = cockpit.alt() if begun is None else begun
                left -= 1
                if cockpit.alt() >= self.to_alt:
                    break
            yield
        bank = cockpit.bank_wanted()
        for share in smooth(roll_time(abs(bank))):
            cockpit.set_bank((1 - share) * bank)
            yield
        cockpit.hold_heading()
        return f"from {cockpit.alt() if begun is None else begun:.0f} to {cockpit.alt():.0f} m"


def join_circle(path: SegmentPath, center: Point, radius: float, side: int) -> None:
    """Append the way from the end of a path to a circle: a turn of its radius, and a straight on a tangent.

    The turn is to the side that makes the way shorter.

    Parameters
    ----------
    path : SegmentPath
        It ends in front of the circle.
    center : tuple of float
        North and east of the center of the circle [m].
    radius : float
        Of both [m].
    side : int
        1: the circle is flown to the right; -1: to the left.
    """
    ways = []
    for turn in (side, -side):
        to_center = path.course + turn * 0.5 * math.pi
        north = center[0] - path.point[0] - radius * math.cos(to_center)
        east = center[1] - path.point[1] - radius * math.sin(to_center)
        apart = math.hypot(north, east)
        if turn == side:
            course, straight = math.atan2(east, north), apart
        elif apart > 2 * radius:
            course = math.atan2(east, north) + turn * math.asin(2 * radius / apart)
            straight = math.sqrt(apart**2 - 4 * radius**2)
        else:
            continue
        angle = (turn * (course - path.course)) % math.tau
        ways.append((angle * radius + straight, turn * angle, straight))
    _, angle, straight = min(ways)
    path.arc(angle, radius)
    path.straight(straight)
