"""Ground paths of straights and arcs, and the guidance that keeps an aircraft on a path in any wind.

The bank holds the curvature of the path at the present ground speed, taken a little ahead of the aircraft
because bank follows its set-point late, and brings the distance off the path to zero:

    tan(bank) = (v^2 kappa + k (s_wanted - s)) / (g cos(crab)),  s_wanted = -clip(k e / 3, v sin 45 deg)

with e the distance off the path, to the right, s its rate, v the ground speed, kappa the curvature to the
right, and k a quarter of what the bank loop can follow: a damping of 0.87 at the frequency 0.58 k.

Until a path is met, and in smooth air all along it, the bank stays within 3 deg of the one that is asked for.
The way to the path is then no steeper than this bank can end: k/3 times the speed across is its acceleration.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.shaping import G, Steps, clip, roll_time, smoothstep, ticks
from bench.simulation.flight.panel import Plane

Point = tuple[float, float]
"""North and east [m]."""

_INTERCEPT = math.sin(math.radians(45.0))  # steepest backward pass to the path, across over along
_MET = 0.1  # a path is met this close to it, in turn radii ...
_ALIGNED = math.radians(5.0)  # ... and to its course [rad]
_SPARE = math.radians(1.5)  # of bank for what disturbs a turn [rad]
_ENDED = 0.8  # of the acceleration of the bank, that ends the way to a path
_PATIENCE = 60.0  # how much longer than planned a path may take [s]
_STRAYED = 150.0  # guidance has lost a path that is further off, in the turn radius or, if that is less, [m]


@dataclass(frozen=True, slots=True)
class Segment:
    """A straight or an arc."""

    start: Point
    course: float  # at the start [rad]
    length: float  # [m]
    curvature: float  # to the right [1/m]; 0 straight

    def end(self) -> tuple[Point, float]:
        """Return the point and the course at the end of the segment."""
        return self.at(self.length)

    def at(self, along: float) -> tuple[Point, float]:
        """Return the point and the course at a distance along the segment [m]."""
        turned = self.curvature * along
        half = 0.5 * turned
        chord = along * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        north, east = self.start
        direction = self.course + half
        return (
            (north + chord * math.cos(direction), east + chord * math.sin(direction)),
            self.course + turned,
        )

    def relative(self, point: Point) -> tuple[float, float, float]:
        """Return the position of a point along the segment and to its right [m], and the course [rad]."""
        north, east = point[0] - self.start[0], point[1] - self.start[1]
        c, s = math.cos(self.course), math.sin(self.course)
        ahead, right = north * c + east * s, east * c - north * s
        if self.curvature == 0:
            return ahead, right, self.course
        radius, side = 1 / abs(self.curvature), math.copysign(1.0, self.curvature)
        inward = radius - side * right  # from the center, towards the start
        angle = math.atan2(ahead, inward)
        if angle < 0.5 * (self.length / radius - math.tau):  # nearer to the end than to the start
            angle += math.tau
        off = side * (radius - math.hypot(ahead, inward))
        return angle * radius, off, self.course + side * angle


class SegmentPath:
    """Segments from end to end, built one after the other."""

    def __init__(self, start: Point, course: float) -> None:
        self.segments: list[Segment] = []
        self.point, self.course = start, course

    def straight(self, length: float) -> None:
        """Append a straight of a length [m]."""
        self._add(length, 0.0)

    def arc(self, angle: float, radius: float) -> None:
        """Append an arc by an angle, positive to the right [rad], with a radius [m]."""
        self._add(abs(angle) * radius, math.copysign(1 / radius, angle))

    def _add(self, length: float, curvature: float) -> None:
        if length > 1e-6:
            segment = Segment(self.point, self.course, length, curvature)
            self.segments.append(segment)
            self.point, self.course = segment.end()

    def at(self, along: float) -> Point:
        """Return the point at a distance along the path [m]; beyond the end the path continues straight."""
        for segment in self.segments:
            if along <= segment.length or segment is self.segments[-1]:
                return segment.at(along)[0]
            along -= segment.length
        return self.point

    def sample(self, step: float) -> list[Point]:
        """Return points along the path, not more than a step [m] apart, with both ends."""
        count = max(1, math.ceil(self.length / step))
        return [self.at(k / count * self.length) for k in range(count + 1)]

    def turn_between(self, begin: float, end: float) -> float:
        """Return the mean curvature to the right between two distances along the path [1/m]."""
        turned = along = 0.0
        for segment in self.segments:
            inside = min(end, along + segment.length) - max(begin, along)
            turned += max(inside, 0.0) * segment.curvature
            along += segment.length
        return turned / (end - begin)

    @property
    def length(self) -> float:
        """Length of the whole path [m]."""
        return sum(segment.length for segment in self.segments)

    def towards(self, target: Point, radius: float, what: str) -> None:
        """Append the shorter turn until the course leads to a point ahead."""
        north, east = target[0] - self.point[0], target[1] - self.point[1]
        bearing = math.remainder(math.atan2(east, north) - self.course, math.tau)
        if abs(bearing) < 1e-9:
            return
        side = math.copysign(1.0, bearing)
        to_center = self.course + side * 0.5 * math.pi
        center = self.point[0] + radius * math.cos(to_center), self.point[1] + radius * math.sin(to_center)
        north, east = target[0] - center[0], target[1] - center[1]
        distance = math.hypot(north, east)
        if distance <= radius:
            raise FlightError(f"{what} is inside the turn that leads to it, of {radius:.0f} m radius")
        # the tangent from the circle to the target
        course = math.atan2(east, north) + side * math.asin(radius / distance)
        self.arc(side * ((side * (course - self.course)) % math.tau), radius)


def turn_radius(cockpit: Cockpit, bank: float, speed: float | None = None) -> float:
    """Return the radius a bank [rad] holds at the highest ground speed the steady wind allows [m].

    It is for an airspeed [m/s], else for the highest one commanded.
    """
    fastest = (cockpit.fastest() if speed is None else speed) + cockpit.wind_speed()
    return fastest**2 / (G * math.tan(bank))


def run_in(cockpit: Cockpit, bank: float) -> float:
    """Return the straight length [m] before the first turn that the aircraft needs to roll to its bank."""
    fastest = cockpit.fastest() + cockpit.wind_speed()
    return fastest * (cockpit.bank_lag + 0.5 * roll_time(bank))


class Follower:
    """Keeps the aircraft on a path; one call of :meth:`steer` per time.

    With ``asked`` the bank [rad] stays near it until the path is met, and in smooth air.
    """

    def __init__(
        self, cockpit: Cockpit, plane: Plane, path: SegmentPath, bank: float, asked: float | None = None
    ) -> None:
        self._cockpit, self._plane, self._segments = cockpit, plane, path.segments
        self._bank = bank
        self._window = roll_time(bank)
        self._quickness = 0.25 / (cockpit.bank_lag / 2 + 1 / cockpit.gain("bank-gain"))
        self._asked, self._turning = asked, math.inf if asked is None else G * math.tan(asked)  # [m/s^2]
        self._across = 3 * _ENDED * self._turning / self._quickness  # most speed across it [m/s]
        self.met = False
        self._passed = 0.0  # length of the segments behind [m]
        self._index = 0
        self.off = 0.0  # distance off the path, to the right [m]
        self.along = 0.0  # way along the path [m]
        cockpit.set_bank(cockpit.bank_wanted())
        cockpit.lat_mode(1)

    def steer(self, limit: float | None = None) -> bool:
        """Write the bank command of this epoch, within a limit [rad]; return False at the end of the path."""
        point = self._plane.position()
        track, speed = self._plane.track()
        along, off, course = self._segments[self._index].relative(point)
        while along >= self._segments[self._index].length:
            if self._index + 1 == len(self._segments):
                return False
            self._passed += self._segments[self._index].length
            self._index += 1
            along, off, course = self._segments[self._index].relative(point)
        self.along, self.off = self._passed + along, off
        if not self.met:
            turn = math.remainder(course - track, math.tau)
            self.met = abs(off) < _MET * speed**2 / self._turning and abs(turn) < _ALIGNED
        if limit is None and self._asked is not None and (self._cockpit.smooth_air or not self.met):
            limit = self._asked + _SPARE
        ahead = self._ahead(along, speed)
        turning = speed**2 * ahead
        k = self._quickness
        across = speed * math.sin(track - course)
        wanted = -clip(k * off / 3, min(speed * _INTERCEPT, self._across))
        crab = math.cos(math.remainder(self._cockpit.heading() - track, math.tau))
        tangent = (turning + k * (wanted - across)) / (G * max(crab, 0.3))
        bank = math.atan(tangent)
        self._cockpit.set_bank(bank if limit is None else clip(bank, limit))
        return True

    def _ahead(self, along: float, speed: float) -> float:
        """Curvature ahead by the lag of the bank, blended over the time of a roll [1/m]."""
        width = speed * self._window
        begin = along + speed * self._cockpit.bank_lag - 0.5 * width
        total, edge = 0.0, 0.0
        index, place = self._index, 0.0
        while index > 0 and place > begin:
            index -= 1
            place -= self._segments[index].length
        for segment in self._segments[index:]:
            place += segment.length
            here = smoothstep(min(1.0, max(0.0, (place - begin) / width)))
            total += segment.curvature * (here - edge)
            edge = here
            if here == 1.0:
                break
        return total


def follow(
    cockpit: Cockpit, plane: Plane, path: SegmentPath, bank: float, alt: Heights | None = None
) -> Steps:
    """Fly a path to its end, with heights along the path if given; ends in heading mode."""
    follower = Follower(cockpit, plane, path, bank, bank)
    strayed = max(_STRAYED, turn_radius(cockpit, bank))
    planned = path.length / max(cockpit.speed_wanted - cockpit.wind_speed(), 1.0)
    for _ in ticks(2 * planned + _PATIENCE):
        if not follower.steer():
            break
        if abs(follower.off) > (strayed if follower.met else 3 * strayed):
            side = "right" if follower.off > 0 else "left"
            raise FlightError(f"{abs(follower.off):.0f} m off the track to the {side}: {cockpit.state()}")
        if alt is not None:
            alt.climb(cockpit, follower.along, plane.track()[1])
        yield
    else:
        raise FlightError(f"{follower.along:.0f} of {path.length:.0f} m of track only: {cockpit.state()}")
    if alt is not None:
        cockpit.hold_alt(alt.heights[-1])
    cockpit.hold_heading()


class Heights:
    """Heights along a path, from one to the next without a corner."""

    def __init__(self, cockpit: Cockpit, places: list[float], heights: list[float]) -> None:
        """Store increasing distances along the path [m], and the ellipsoidal heights there [m]."""
        self.places, self.heights = places, heights
        self._gain = cockpit.gain("altitude-gain")
        for k in range(1, len(places)):
            length, rise = places[k] - places[k - 1], heights[k] - heights[k - 1]
            needed = 1.5 * abs(rise) / length * (cockpit.fastest() + cockpit.wind_speed())
            limit = cockpit.aircraft.max_climb if rise > 0 else cockpit.aircraft.max_descent
            if needed > limit:
                raise FlightError(
                    f"{abs(rise):.0f} m of height in {length:.0f} m of track {k} need {needed:.1f} m/s; "
                    f"the {cockpit.aircraft.name} has {limit:g} m/s"
                )
        cockpit.set_climb(0.0)
        cockpit.lon_mode(2)

    def climb(self, cockpit: Cockpit, along: float, speed: float) -> None:
        """Write the vertical speed that follows the heights, at a distance along the path [m]."""
        height, _ = self._at(along)
        _, slope = self._at(along + speed * cockpit.climb_lag)
        cockpit.set_climb(speed * slope + self._gain * (height - cockpit.alt()))

    def _at(self, along: float) -> tuple[float, float]:
        """Return the height [m] and its slope."""
        if along <= self.places[0]:
            return self.heights[0], 0.0
        for k in range(1, len(self.places)):
            begun, end = self.places[k - 1], self.places[k]
            if along < end:
                x, rise = (along - begun) / (end - begun), self.heights[k] - self.heights[k - 1]
                return self.heights[k - 1] + rise * smoothstep(x), rise * 6 * x * (1 - x) / (end - begun)
        return self.heights[-1], 0.0


class SmoothHeights(Heights):
    """Smooth heights at small steps along a path."""

    def __init__(self, cockpit: Cockpit, step: float, heights: FloatArray) -> None:
        """Store the step [m] and the ellipsoidal heights at 0, 1, 2 ... steps [m]."""
        super().__init__(cockpit, [], heights.tolist())
        self._ways = step * np.arange(len(heights))
        self._slopes = np.gradient(heights, step)

    def _at(self, along: float) -> tuple[float, float]:
        height, slope = (float(np.interp(along, self._ways, row)) for row in (self.heights, self._slopes))
        return height, slope
