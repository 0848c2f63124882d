"""Legs along tracks over ground: waypoints, survey, holding. The wind moves the bank, not the track."""

from __future__ import annotations

import math

from bench.errors import FlightError
from bench.flight.cockpit import Cockpit
from bench.flight.paths import Heights, Path, follow, run_in, turn_radius
from bench.flight.shaping import Steps
from bench.legs import Holding, Survey, Waypoints


def waypoints(cockpit: Cockpit, leg: Waypoints) -> Steps:
    """Turn to the first point, then fly by each on an arc tangent to both its tracks, to the last."""
    plane = cockpit.plane_here()
    radius = turn_radius(cockpit, leg.bank)
    path = Path(plane.position(), plane.track()[0])
    path.straight(run_in(cockpit, leg.bank))
    alts = [cockpit.alt_wanted]
    for point in leg.points:
        alts.append(alts[-1] if point.alt is None else point.alt)
    at = [plane.point(point.lat, point.lon, alt) for point, alt in zip(leg.points, alts[1:], strict=True)]
    path.towards(at[0], radius, "waypoint 1")
    places = [path.length]
    for number, (here, there) in enumerate(zip(at, [*at[1:], None], strict=True), 1):
        to_here = math.dist(path.point, here)
        cut = turned = 0.0
        if there is not None:
            course = math.atan2(there[1] - here[1], there[0] - here[0])
            turned = math.remainder(course - path.course, math.tau)
            cut = radius * math.tan(0.5 * abs(turned))
            room = min(to_here, math.dist(here, there))
            if cut > room:
                raise FlightError(
                    f"waypoint {number}: a turn of {math.degrees(turned):.0f} deg at {radius:.0f} m radius "
                    f"needs {cut:.0f} m of track before and after it; there are {room:.0f} m"
                )
        path.straight(to_here - cut)
        places.append(path.length)
        if there is not None and turned:
            path.arc(turned, radius)
    if len({*alts}) == 1:
        yield from follow(cockpit, plane, path, leg.bank)
    else:
        yield from follow(cockpit, plane, path, leg.bank, Heights(cockpit, places, alts))


def survey(cockpit: Cockpit, leg: Survey) -> Steps:
    """Fly strips to and fro; where they are closer than a turn is wide, the turn bulges out."""
    plane = cockpit.plane_here()
    radius = turn_radius(cockpit, leg.bank)
    path = Path(plane.position(), plane.track()[0] if leg.course is None else leg.course)
    side = leg.side
    for strip in range(leg.strips):
        path.straight(leg.length)
        if strip + 1 < leg.strips:
            _turn_around(path, side, leg.spacing, radius)
            side = -side
    yield from follow(cockpit, plane, path, leg.bank)


def _turn_around(path: Path, side: int, across: float, radius: float) -> None:
    """Turn by 180 deg to a track that is a distance across to one side."""
    if across >= 2 * radius:
        path.arc(side * 0.5 * math.pi, radius)
        path.straight(across - 2 * radius)
        path.arc(side * 0.5 * math.pi, radius)
        return
    # three circles that touch, the middle one between the tracks: cos of the angle turned away first
    away = math.acos((across + 2 * radius) / (4 * radius))
    path.arc(-side * away, radius)
    path.arc(side * (math.pi + 2 * away), radius)
    path.arc(-side * away, radius)


def holding(cockpit: Cockpit, leg: Holding) -> Steps:
    """Fly racetracks: turn at the fix, outbound, turn, inbound to the fix again."""
    plane = cockpit.plane_here()
    radius = turn_radius(cockpit, leg.bank)
    length = leg.leg_time * cockpit.speed_wanted
    path = Path(plane.position(), plane.track()[0] if leg.course is None else leg.course)
    path.straight(run_in(cockpit, leg.bank))
    for _ in range(leg.laps):
        path.arc(leg.side * math.pi, radius)
        path.straight(length)
        path.arc(leg.side * math.pi, radius)
        path.straight(length)
    yield from follow(cockpit, plane, path, leg.bank)
