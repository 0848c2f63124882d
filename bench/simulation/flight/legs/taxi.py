"""Legs that roll on the ground from stop to stop: along the runway, along taxiways, onto the runway."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Protocol

import numpy as np

from bench.core.records.flight_specs import SECONDS, Leg, LegStart, Runway
from bench.core.words.exceptions import FlightError
from bench.core.words.wording import format_count
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.ground.taxiway import Taxiway
from bench.simulation.flight.guidance.paths import SegmentPath
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, Steps, clip, smooth, ticks, wait
from bench.simulation.flight.legs.keys import Key, side_of
from bench.simulation.flight.legs.runway import PATIENCE, POWER, Centerline, check_runway, find_runway
from bench.simulation.flight.legs.tracks import Point, fly_by
from bench.simulation.flight.panel import Plane

_QUICKENS, _SLOWS = 0.5, 0.5  # changes of the speed of taxiing [m/s^2]
_BRAKE, _STANDS = 0.4, 0.15  # most of the brakes; the speed that they end [m/s]
_LAG = 0.5  # so much below the speed that lets it stop in time it still quickens [m/s]
_TURNS = 1.0  # most lateral acceleration of a turn [m/s^2]
_BLEND = 1.0  # over which a turn is steered in and out [s]
_BACK = 0.06  # heading back to the taxiway per distance off it [rad/m] ...
_BACK_MOST = math.radians(20.0)  # ... and the most of it [rad]
_STEP = 0.5  # between the points of a taxiway [m]
_STEEREST = math.radians(150.0)  # most turn onto the runway [rad]

_RollSpeed = Annotated[float, Key("speed_mps", "ground speed between the stops", 1, 15)]
_Stop = Annotated[float, Key("stop_s", "duration of each stop", *SECONDS)]
_Radius = Annotated[float, Key("radius_m", "radius of the turns", 5, 200)]
_Width = Annotated[float, Key("width_m", "width of the taxiway; a leg that leaves it fails", 3, 100)]


class _Steered(Protocol):
    """Steers along a line on the ground."""

    along: float

    def steer(self) -> None:
        """Write the heading of this time."""

    def wheel_speed(self) -> float:
        """Return the true speed over ground [m/s]."""


@dataclass(frozen=True)
class Taxi(Leg):
    """Roll along the centerline with stops at equal distances, the last at the end."""

    kind = "taxi"
    needs = leaves = "ground"
    distance: Annotated[float, Key("distance_m", "length of the whole path", 20, 5000)]
    speed: _RollSpeed = 6.0
    stops: Annotated[int, Key("stops", "number of stops, including the last", 1, 100)] = 1
    stop: _Stop = 10.0

    def describe(self) -> str:
        return f"{self.distance:g} m at {self.speed:g} m/s, {self.stops} stops"

    def check(self, start: LegStart) -> list[str]:
        return check_runway(start.aircraft)

    def fly(self, cockpit: Cockpit) -> Steps:
        """Hold a speed by throttle and brakes that falls to zero at each stop; steer by the nose wheel."""
        runway, _ = find_runway(cockpit)
        center = Centerline(cockpit, runway)
        cockpit.course = runway.heading
        cockpit.set_heading(cockpit.course)
        begun, patience = center.along, PATIENCE + 2 * self.distance / self.speed
        for number in range(1, self.stops + 1):
            end = begun + number * self.distance / self.stops
            yield from _go_and_stop(cockpit, center, end, lambda _: self.speed, patience)
            yield from wait(self.stop)


@dataclass(frozen=True)
class _OnTaxiway(Leg):
    needs = leaves = "ground"
    radius: _Radius
    speed: _RollSpeed = 6.0
    width: _Width = 15.0
    stop: _Stop = 10.0

    def check(self, start: LegStart) -> list[str]:
        nowhere = [] if start.runway else ["there is no [runway] beside it"]
        return check_runway(start.aircraft) + nowhere

    def fly(self, cockpit: Cockpit) -> Steps:
        """Roll along the path, in turns with at most 1 m/s^2 to the side, and stop at its end."""
        runway, _ = find_runway(cockpit)
        plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
        path = SegmentPath(plane.position(), cockpit.heading())
        self._lay(path, cockpit, plane, runway)
        cockpit.taxiways.append(Taxiway(np.array(path.sample(_STEP)), self.width))
        track = _Centered(cockpit, plane, path, self.width)
        cockpit.set_heading(cockpit.heading())
        patience = PATIENCE + 2 * path.length / min(self.speed, math.sqrt(_TURNS * self.radius))
        yield from _go_and_stop(cockpit, track, path.length, self._find_limit(path), patience)
        cockpit.course = path.course
        yield from wait(self.stop)

    @abstractmethod
    def _lay(self, path: SegmentPath, cockpit: Cockpit, plane: Plane, runway: Runway) -> None:
        """Append the way from the place and heading of the aircraft."""

    def _find_limit(self, path: SegmentPath) -> Callable[[float], float]:
        """Return the fastest speed [m/s] at a way along the path [m]: in a turn, and slowing down to it."""
        slow, turns, begin = min(self.speed, math.sqrt(_TURNS * self.radius)), [], 0.0
        for segment in path.segments:
            if segment.curvature:
                turns.append((begin - slow * _BLEND, begin + segment.length + 0.5 * slow * _BLEND))
            begin += segment.length

        def limit(along: float) -> float:
            ahead = (max(first - along, 0.0) for first, last in turns if along < last)
            return min((math.sqrt(slow**2 + 2 * _SLOWS * way) for way in ahead), default=self.speed)

        return lambda along: min(self.speed, limit(along))


@dataclass(frozen=True)
class TaxiRoute(_OnTaxiway):
    """Roll from point to point on a taxiway with rounded turns, and stop at the last."""

    kind = "taxi-route"
    points: Annotated[
        tuple[Point, ...], Key("points", "points of the route; the turns at all but the last are rounded")
    ] = field(kw_only=True)

    def describe(self) -> str:
        return f"{format_count(len(self.points), 'point')} at {self.speed:g} m/s, stop of {self.stop:g} s"

    def _lay(self, path: SegmentPath, cockpit: Cockpit, plane: Plane, runway: Runway) -> None:
        at = [plane.point(*point.place(cockpit.start_lla), runway.alt) for point in self.points]
        path.towards(at[0], self.radius, "point 1")
        fly_by(path, at, self.radius, "point")


@dataclass(frozen=True)
class LineUp(_OnTaxiway):
    """Roll straight on to the runway, turn onto its centerline, and stop."""

    kind = "line-up"
    distance: Annotated[float, Key("distance_m", "distance along the centerline after the turn", 0, 500)] = (
        20.0
    )

    def describe(self) -> str:
        return f"at {self.speed:g} m/s, stop of {self.stop:g} s"

    def _lay(self, path: SegmentPath, cockpit: Cockpit, plane: Plane, runway: Runway) -> None:
        c, s = math.cos(runway.heading), math.sin(runway.heading)
        right = path.point[1] * c - path.point[0] * s
        across = math.remainder(path.course - runway.heading, math.tau)
        tangent = self.radius * math.tan(0.5 * min(abs(across), _STEEREST))
        to_center = -right / math.sin(across) if across else math.inf
        if abs(across) > _STEEREST or not tangent <= to_center < 1e5:
            raise FlightError(
                f"no turn of {self.radius:g} m radius onto the centerline, {abs(right):.0f} m to its "
                f"{side_of(right)}, heading {math.degrees(across):.0f} deg off: {cockpit.state()}"
            )
        path.straight(to_center - tangent)
        path.arc(-across, self.radius)
        path.straight(self.distance)


class _Centered:
    """Steers the center of gravity along a path with the nose wheel.

    The heading that is asked for contains what the nose wheel needs for the turn: the steering law is
    proportional to the heading error, less a lead by the yaw rate.
    """

    def __init__(self, cockpit: Cockpit, plane: Plane, path: SegmentPath, width: float) -> None:
        self._cockpit, self._plane, self._path, self._edge = cockpit, plane, path, 0.5 * width
        wheels = cockpit.find_wheels()
        steered = max(wheels, key=lambda wheel: wheel.steer)
        fixed = [wheel.forward for wheel in wheels if not wheel.steer] or [0.0]
        self._behind = -sum(fixed) / len(fixed)  # of the fixed wheels, behind the center of gravity [m]
        self._base = steered.forward + self._behind
        self._per_angle = 1 / (max(steered.steer, 1e-3) * cockpit.gain("steer-gain"))
        self._lead = cockpit.gain("steer-lead-sec")
        self._index, self._passed = 0, 0.0
        self.along = self.off = 0.0

    def wheel_speed(self) -> float:
        """Return the true speed over ground [m/s]."""
        return self._plane.true_speed()

    def steer(self) -> None:
        """Ask for the course of the path, its turn, and back to the path."""
        segments = self._path.segments
        point, speed = self._plane.position(), self.wheel_speed()
        along, self.off, course = segments[self._index].relative(point)
        while along >= segments[self._index].length and self._index + 1 < len(segments):
            self._passed += segments[self._index].length
            self._index += 1
            along, self.off, course = segments[self._index].relative(point)
        self.along = self._passed + along
        if abs(self.off) > self._edge:
            raise FlightError(
                f"ran off the taxiway, {abs(self.off):.1f} m to the {side_of(self.off)}: "
                f"{self._cockpit.state()}"
            )
        turn = self._path.turn_between(self.along, self.along + max(speed, 1.0) * _BLEND)
        needed = self._lead * speed + math.atan(self._base * abs(turn)) / max(abs(turn), 1e-9) * (
            self._per_angle * max(speed, 3.0) / 10.0
        )
        self._cockpit.set_heading(
            course + turn * (needed - self._behind) - clip(_BACK * self.off, _BACK_MOST)
        )


def _go_and_stop(
    cockpit: Cockpit, track: _Steered, end: float, limit: Callable[[float], float], patience: float
) -> Steps:
    """Release the brakes, roll to a way along the track [m], set the brakes."""
    for share in smooth(POWER):
        cockpit.brake(1 - share)
        cockpit.set_steering(share)
        yield
    yield from _roll(cockpit, track, end, limit, patience)
    for share in smooth(POWER):
        cockpit.brake(_BRAKE + share * (1 - _BRAKE))
        cockpit.set_steering(1 - share)
        yield


def _roll(
    cockpit: Cockpit, track: _Steered, end: float, limit: Callable[[float], float], patience: float
) -> Steps:
    power = brake = begun = 0.0
    for k in ticks(patience):
        track.steer()
        speed, to_go, fastest = track.wheel_speed(), end - track.along, limit(track.along)
        wanted = math.sqrt(2 * _SLOWS * max(to_go, 0.0))
        braking = wanted < min(fastest, speed + _LAG)
        wanted = min(wanted, fastest, (k + 1) / GUIDANCE_RATE * _QUICKENS)
        if braking and speed < _STANDS:
            break
        lacks = wanted - speed
        power = 0.0 if braking else min(max(power + 0.02 * lacks / GUIDANCE_RATE, 0.0), 0.5)
        asked = 0.0 if braking else min(max(power + 0.04 * lacks, 0.0), 0.5)
        begun += 0.1 * (asked - begun)  # no step of the throttle
        cockpit.set_throttle(begun)
        brake += 0.1 * (min(max(-0.5 * lacks, 0.0), _BRAKE) - brake)
        cockpit.brake(_BRAKE if braking and to_go < 0 else brake)
        yield
    else:
        raise FlightError(f"not at {end:.0f} m along the way: {track.along:.0f} m, {cockpit.state()}")
