"""Legs along tracks over ground; wind changes the bank, not the track."""

from __future__ import annotations

import math
from abc import abstractmethod
from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import matrix_en, to_ecef, to_geodetic
from bench.core.records.flight_specs import ALTITUDES, SECONDS, WINGS, LegStart
from bench.core.words.exceptions import FlightError
from bench.core.words.wording import format_count
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.paths import (
    Heights,
    SegmentPath,
    SmoothHeights,
    follow,
    run_in,
    turn_radius,
)
from bench.simulation.flight.guidance.shaping import Steps
from bench.simulation.flight.legs.keys import SIDES, AtSpeed, Bank, Key, format_deg, write_key
from bench.simulation.flight.panel import Plane

_GROUND_STEP = 20.0  # at which the ground below a way is looked at [m]
_CLIMB_SHARE = 0.7  # of the climb of the aircraft that a way along the ground may need
_ROUNDED = 8.0  # time in which its corners are rounded [s]
_NEAR_HEIGHT = 20.0  # so far below its start a way along the ground may be begun [m]

_Course = Annotated[float, Key("course_deg", "over ground, of the first track; else the present one", 0, 360)]


@dataclass(frozen=True)
class Point:
    """A point to fly by: latitude and longitude, or meters from the start of the profile."""

    lat: Annotated[float, Key("lat_deg", "latitude", -90, 90)] | None = None
    lon: Annotated[float, Key("lon_deg", "longitude", -180, 180)] | None = None
    north: Annotated[float, Key("north_m", "north of the start", -100e3, 100e3)] | None = None
    east: Annotated[float, Key("east_m", "east of the start", -100e3, 100e3)] | None = None

    def __post_init__(self) -> None:
        absolute, local = (self.lat, self.lon), (self.north, self.east)
        complete = [pair for pair in (absolute, local) if None not in pair]
        begun = [pair for pair in (absolute, local) if pair != (None, None)]
        if len(complete) != 1 or len(begun) != 1:
            raise ValueError("needs either lat_deg and lon_deg or north_m and east_m")

    def place(self, start_lla: tuple[float, float, float]) -> tuple[float, float]:
        """Return latitude and longitude of the point [rad]; the profile starts at start_lla (rad, rad, m)."""
        if self.lat is not None and self.lon is not None:
            return self.lat, self.lon
        beside = matrix_en(start_lla[0], start_lla[1]) @ np.array([self.north, self.east, 0.0])
        lat, lon, _ = (float(v) for v in to_geodetic(to_ecef(start_lla) + beside))
        return lat, lon


@dataclass(frozen=True)
class Waypoint(Point):
    """A point with an altitude."""

    alt: (
        Annotated[float, Key("alt_m", "ellipsoidal altitude; without it the altitude before", *ALTITUDES)]
        | None
    ) = None


@dataclass(frozen=True)
class PointToPoint(AtSpeed):
    """Follow the tracks from point to point; turns begin early enough to meet the next track."""

    points: Annotated[tuple[Point, ...], Key("points", "flown by, but for the last")]
    bank: Bank

    def describe(self) -> str:
        return f"{format_count(len(self.points), 'point')}, bank {format_deg(self.bank)}"

    def fly(self, cockpit: Cockpit) -> Steps:
        """Turn to the first point, then pass each point on an arc tangent to both tracks, up to the last."""
        plane = cockpit.plane_here()
        radius = turn_radius(cockpit, self.bank)
        path = _begin_path(plane)
        path.straight(run_in(cockpit, self.bank))
        alts = self._list_alts(cockpit.alt_wanted)
        places = [point.place(cockpit.start_lla) for point in self.points]
        at = [plane.point(*place, alt) for place, alt in zip(places, alts[1:], strict=True)]
        path.towards(at[0], radius, "waypoint 1")
        ways = fly_by(path, at, radius, "waypoint")
        yield from follow(
            cockpit, plane, path, self.bank, self._find_heights(cockpit, plane, path, ways, alts)
        )

    def _list_alts(self, first: float) -> list[float]:
        """Return the altitudes [m] at the start, the first, and at each point."""
        return [first] * (len(self.points) + 1)

    @abstractmethod
    def _find_heights(
        self, cockpit: Cockpit, plane: Plane, path: SegmentPath, ways: list[float], alts: list[float]
    ) -> Heights | None:
        """Return the heights along the path, with its points at distances ``ways``; None keeps the height."""


def fly_by(path: SegmentPath, at: list[tuple[float, float]], radius: float, what: str) -> list[float]:
    """Append tracks from point to point, with arcs tangent to both tracks at each but the last.

    Returns the ways along the path at its start and at each point, where its arc begins [m]; the points
    are north and east [m].

    Raises
    ------
    FlightError
        If two points are too close for their arcs.
    """
    ways = [path.length]
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
                    f"{what} {number}: a turn of {math.degrees(turned):.0f} deg at {radius:.0f} m "
                    f"radius needs {cut:.0f} m of track before and after it; there are {room:.0f} m"
                )
        path.straight(to_here - cut)
        ways.append(path.length)
        if there is not None and turned:
            path.arc(turned, radius)
    return ways


@dataclass(frozen=True)
class Waypoints(PointToPoint):
    """Follow the tracks from point to point; turns begin early enough to meet the next track."""

    kind = "waypoints"
    flown_by = WINGS
    points: Annotated[tuple[Waypoint, ...], Key("points", "flown by, but for the last")]

    def check(self, start: LegStart) -> list[str]:
        rows = enumerate(self.points if start.aircraft.glides else ())
        given = [f"points[{k}] {write_key(row, 'alt')}" for k, row in rows if row.alt is not None]
        return [f"{what}: a glider holds no altitude; leave it out" for what in given]

    def alt_after(self, start: LegStart) -> float:
        return self._list_alts(start.alt)[-1]

    def _list_alts(self, first: float) -> list[float]:
        alts = [first]
        for point in self.points:
            alts.append(alts[-1] if point.alt is None else point.alt)
        return alts

    def _find_heights(
        self, cockpit: Cockpit, plane: Plane, path: SegmentPath, ways: list[float], alts: list[float]
    ) -> Heights | None:
        return Heights(cockpit, ways, alts) if len({*alts}) > 1 else None


@dataclass(frozen=True)
class TerrainFollowing(PointToPoint):
    """Follow the tracks from point to point at a height above the ground, or higher over steep terrain."""

    kind = "terrain-following"
    height: Annotated[float, Key("height_m", "least one above the ground, as commanded", 20, 5000)]

    def describe(self) -> str:
        return f"{self.height:g} m above ground, {super().describe()}"

    def alt_after(self, start: LegStart) -> float:
        return math.nan

    def _find_heights(
        self, cockpit: Cockpit, plane: Plane, path: SegmentPath, ways: list[float], alts: list[float]
    ) -> Heights:
        """Return heights that the aircraft can follow with its climb rate."""
        count = math.ceil(path.length / _GROUND_STEP) + 1
        along = np.linspace(0.0, path.length, count)
        at = [path.at(float(way)) for way in along]
        ground = cockpit.ground_at(*plane.locate(at))
        fastest = cockpit.fastest() + cockpit.wind_speed()
        slope = _CLIMB_SHARE * min(cockpit.aircraft.max_climb, cockpit.aircraft.max_descent) / fastest
        width = 2 * math.ceil(0.5 * fastest * _ROUNDED / along[1]) + 1
        least = ground + self.height
        least[0] = max(least[0], cockpit.alt())  # from above it descends as it may
        heights = clear_heights(least, float(along[1]), slope, width)
        if heights[0] > cockpit.alt() + _NEAR_HEIGHT:
            raise FlightError(f"the ground ahead asks for {heights[0]:.0f} m at the start: {cockpit.state()}")
        return SmoothHeights(cockpit, float(along[1]), heights)


def clear_heights(least: FloatArray, step: float, slope: float, width: int) -> FloatArray:
    """Return heights that are never below given heights and nowhere steeper than a slope.

    The others are raised to the cones of that slope that stand on each of them, then to the largest within
    an odd number of samples, ``width``, whose mean rounds the corners.

    Parameters
    ----------
    least : (N,) array
        The others, at equal distances [m].
    step : float
        The distance [m].
    slope : float
        Rise over way.
    width : int
        Samples of the mean.
    """
    way = slope * step * np.arange(len(least))
    up = np.maximum.accumulate(least + way) - way
    down = (np.maximum.accumulate((least - way)[::-1]) + way[::-1])[::-1]
    half = width // 2
    padded = np.pad(np.maximum(up, down), 2 * half, mode="edge")
    highest = np.lib.stride_tricks.sliding_window_view(padded, width).max(axis=1)
    mean: FloatArray = np.lib.stride_tricks.sliding_window_view(highest, width).mean(axis=1)
    return mean


@dataclass(frozen=True)
class Survey(AtSpeed):
    """Parallel strips from the present position, flown to and fro."""

    kind = "survey"
    flown_by = WINGS
    length: Annotated[float, Key("length_m", "length of a strip", 10, 1e6)]
    spacing: Annotated[float, Key("spacing_m", "spacing of the strips", 1, 1e5)]
    strips: Annotated[int, Key("strips", "number of strips", 1, 1000)]
    bank: Bank
    course: _Course | None = None
    side: Annotated[Literal["right", "left"], Key("side", "side of the next strip")] = "right"

    def describe(self) -> str:
        strips = f"{format_count(self.strips, 'strip')} of {self.length:g} m, {self.spacing:g} m apart"
        return f"{strips} to the {self.side}, bank {format_deg(self.bank)}"

    def fly(self, cockpit: Cockpit) -> Steps:
        """Fly the strips; if they are closer than the diameter of a turn, the turn bulges out."""
        plane = cockpit.plane_here()
        radius = turn_radius(cockpit, self.bank)
        path = _begin_path(plane, self.course)
        side = SIDES[self.side]
        for strip in range(self.strips):
            path.straight(self.length)
            if strip + 1 < self.strips:
                _turn_around(path, side, self.spacing, radius)
                side = -side
        yield from follow(cockpit, plane, path, self.bank)


def _begin_path(plane: Plane, course: float | None = None) -> SegmentPath:
    """Return a path from the present position, on a given course [rad] or the present course."""
    return SegmentPath(plane.position(), plane.track()[0] if course is None else course)


def _turn_around(path: SegmentPath, side: int, across: float, radius: float) -> None:
    """Turn by 180 deg to a parallel track at a distance to one side."""
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


@dataclass(frozen=True)
class Holding(AtSpeed):
    """Racetracks over ground, whatever the wind, from a fix at the present position."""

    kind = "holding"
    flown_by = WINGS
    laps: Annotated[int, Key("laps", "number of laps", 1, 1000)]
    bank: Bank
    course: _Course | None = None
    leg_time: Annotated[float, Key("leg_s", "duration of each straight at the airspeed", *SECONDS)] = 60.0
    side: Annotated[Literal["right", "left"], Key("side", "side of the turns")] = "right"

    def describe(self) -> str:
        laps = f"{format_count(self.laps, 'lap')} {self.side}, {self.leg_time:g} s straights"
        return f"{laps}, bank {format_deg(self.bank)}"

    def fly(self, cockpit: Cockpit) -> Steps:
        """Turn at the fix, outbound, turn, inbound to the fix again."""
        plane = cockpit.plane_here()
        radius, half_turn = turn_radius(cockpit, self.bank), SIDES[self.side] * math.pi
        length = self.leg_time * cockpit.speed_wanted
        path = _begin_path(plane, self.course)
        path.straight(run_in(cockpit, self.bank))
        for _ in range(self.laps):
            path.arc(half_turn, radius)
            path.straight(length)
            path.arc(half_turn, radius)
            path.straight(length)
        yield from follow(cockpit, plane, path, self.bank)
