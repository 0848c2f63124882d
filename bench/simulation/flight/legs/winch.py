"""The start of a glider by a winch: aircraft/systems/winch.xml pulls, this leg drives the winch and flies.

On a cable that falls by b, pull P, weight W and drag D leave the airspeed as it is on a path that climbs by
atan2(x, y) - asin(D / hypot(x, y)), x = P cos b, y = P sin b + W: the pull along the path is what weight and
drag take.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from bench.core.records.flight_specs import GLIDER, Leg, LegStart
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, G, Steps, clip, smooth, smoothstep, ticks
from bench.simulation.flight.jsbsim_units import FT, POUND
from bench.simulation.flight.legs.keys import Key, Speed, write_key

_SPEED = 1.4  # airspeed on the cable over the slowest airspeed of the glider, if no other is given
_MOST = 0.75  # height over length of the cable, in a strong headwind
_WINDY = 0.6  # headwind over the airspeed on the cable
_BEHIND = 5.0  # largest tailwind [m/s]
_ROLL = 0.5  # part of the cable that the glider may roll on
_THROTTLE = 2.0  # in which the throttle of the winch is opened [s]
_HANDOVER = 1.0  # in which brakes are released and guidance takes the surfaces [s]
_SLOWER = 0.1  # lack of airspeed at which the nose is not raised further
_ROTATE = math.radians(7.0)  # mean rate at which the nose is raised [rad/s]
_STEEPEST = math.radians(40.0)  # path on the cable [rad]
_INCIDENCE = math.radians(5.0)  # of the nose above the path, until the airspeed shows it [rad]
_DRAG = 0.05  # over weight
_SPEED_GAIN = math.radians(1.5)  # nose up per excess airspeed [rad s/m] ...
_SPEED_INTEGRAL = math.radians(0.3)  # ... and per integral of it [rad/m]
_SPEED_MOST = math.radians(15.0)  # the most of it [rad]
_CENTER = 0.01  # track back to the line to the winch per distance off it [rad/m] ...
_CENTER_MOST = math.radians(15.0)  # ... and the most of it [rad]
_STEEP = math.radians(75.0)  # fall of the cable when the hook opens [rad]
_RISES = 0.7  # mean vertical speed while the nose is lowered, over the one before
_LOWER = math.radians(10.0)  # mean rate at which the nose is lowered [rad/s]
_SLACK = 0.02  # of the pull: the hook opens
_PATIENCE = 300.0  # for a climb on the cable [s]


@dataclass(frozen=True)
class Winch(Leg):
    """A glider rolls, climbs on the cable of a winch, releases it, and glides on at the same airspeed."""

    kind = "winch"
    flown_by = (GLIDER,)
    needs = "ground"
    cable: Annotated[
        float, Key("cable_m", "length of the cable; in calm air the release is at 0.4 of it", 400, 3000)
    ] = 1000.0
    to_height: (
        Annotated[
            float,
            Key(
                "to_height_m",
                "release height above the start; without it, release at a steep cable",
                50,
                1500,
            ),
        ]
        | None
    ) = None
    speed: Speed | None = None

    def describe(self) -> str:
        to = "" if self.to_height is None else f" to {self.to_height:g} m above the start"
        at = "" if self.speed is None else f", {self.speed:g} m/s"
        return f"{self.cable:g} m of cable{to}{at}"

    def check(self, start: LegStart) -> list[str]:
        if self.to_height is None or self.to_height <= _MOST * self.cable:
            return []
        what = f"{write_key(self, 'to_height')} is above {_MOST:g} of {write_key(self, 'cable')}"
        return [f"{what}, the most that a winch gives; lay out more cable"]

    def alt_after(self, start: LegStart) -> float:
        return math.nan if self.to_height is None else start.alt + self.to_height

    def fly(self, cockpit: Cockpit) -> Steps:
        launch = _Launch(cockpit, self.cable, self.speed or _SPEED * cockpit.aircraft.min_speed)
        yield from launch.roll()
        yield from launch.climb(self.to_height)
        yield from launch.release()


class _Launch:
    """One launch along the present heading."""

    def __init__(self, cockpit: Cockpit, length: float, speed: float) -> None:
        reader, switch = cockpit.reader, cockpit.switch
        self._cockpit, self._laid_out, self._speed = cockpit, length, speed
        self._start, self._rest, self._course = cockpit.alt(), cockpit.pitch(), cockpit.heading()
        self._plane = cockpit.plane_here()
        north, east = math.cos(self._course), math.sin(self._course)
        lat, lon = self._plane.locate([(0, 0), (length * north, length * east), (1000, 0), (0, 1000)])
        tailwind = FT * sum(
            share * reader(f"atmosphere/wind-{axis}-fps")()
            for axis, share in (("north", north), ("east", east))
        )
        if -tailwind > _WINDY * speed:
            what = f"a headwind of {-tailwind:.0f} m/s"
            raise FlightError(
                f"{what} is too strong, at most {_WINDY * speed:.0f} m/s at {speed:g} m/s of airspeed"
            )
        if tailwind > _BEHIND:
            raise FlightError(
                f"a tailwind of {tailwind:.0f} m/s is too strong, at most {_BEHIND:g} m/s; launch upwind"
            )
        for name, value in {
            "lat-rad": lat[1],
            "lon-rad": lon[1],
            "alt-m": cockpit.ground_at(lat[1], lon[1]),
            "north-m_rad": 1000 / (lat[2] - lat[0]),
            "east-m_rad": 1000 / math.remainder(lon[3] - lon[0], math.tau),
            "rope-limit-mps": speed + tailwind,
            "hook-norm": 1.0,
        }.items():
            switch(f"winch/{name}")(float(value))
        self._hook, self._throttle = switch("winch/hook-norm"), switch("winch/throttle-norm")
        self._runner = switch("winch/runner-norm")
        self._length, self._angle = reader("winch/cable-m"), reader("winch/angle-rad")
        self._tension, self._pull = reader("winch/tension-n"), reader("winch/pull-n")()
        self._weight = reader("inertia/weight-lbs")() * POUND * G
        self._glide = reader("guidance/pitch-trim-rad")

    def roll(self) -> Steps:
        """Release the brakes, open the throttle, hold wings and attitude until the glider lifts off."""
        cockpit = self._cockpit
        cockpit.set_pitch(self._rest)
        cockpit.lon_mode(1)
        cockpit.set_bank(0.0)
        cockpit.lat_mode(1)
        for share in smooth(_HANDOVER):
            cockpit.brake(1 - share)
            for surface in ("aileron", "elevator"):
                cockpit.direct_share[surface](1 - share)
            yield
        opened = 0.0
        while cockpit.on_wheels():
            opened = min(1.0, opened + 1 / (_THROTTLE * GUIDANCE_RATE))
            self._throttle(smoothstep(opened))
            yield
            if self._length() < (1 - _ROLL) * self._laid_out:
                at = f"at {cockpit.speed():.0f} m/s; a higher speed_mps lifts off"
                raise FlightError(f"not off the ground on {_ROLL * self._laid_out:g} m of the cable, {at}")
        self._throttle(1.0)
        self._runner(0.0)
        cockpit.on_ground(standing=False)

    def climb(self, to_height: float | None) -> Steps:
        """Raise the nose and hold the airspeed by it, until the cable is steep or the height is near."""
        cockpit, speed = self._cockpit, self._speed
        cockpit.lat_mode(2)
        begun, turned, integral, handed = self._rest, 0.0, 0.0, 0.0
        angle = before = self._angle()
        for _ in ticks(_PATIENCE):
            handed = min(1.0, handed + 1 / (_HANDOVER * GUIDANCE_RATE))
            cockpit.direct_share["rudder"](1 - smoothstep(handed))
            self._steer()
            excess = cockpit.speed() - speed
            wanted = self._path() + _INCIDENCE
            if excess > -_SLOWER * speed:
                turned += _ROTATE / GUIDANCE_RATE
            share = smoothstep(min(1.0, turned / (1.5 * (wanted - begun))))
            if share == 1.0:
                integral = clip(integral + _SPEED_INTEGRAL * excess / GUIDANCE_RATE, _SPEED_MOST)
            cockpit.set_pitch(begun + share * (wanted + _SPEED_GAIN * excess + integral - begun))
            height, before, angle = cockpit.alt() - self._start, angle, self._angle()
            taken = self._time_to_lower()
            if to_height is not None and height + _RISES * taken * cockpit.climb() > to_height:
                return
            if angle + taken * GUIDANCE_RATE * (angle - before) > _STEEP:
                break
            yield
        if to_height is not None:
            gave = f"{self._laid_out:g} m of cable gave {height:.0f} m"
            raise FlightError(f"{to_height:g} m not reached: {gave}; lay out more cable")

    def release(self) -> Steps:
        """Lower the nose while the throttle is closed, open the hook, hold heading and airspeed."""
        cockpit = self._cockpit
        begun = cockpit.pitch_wanted()
        for share in smooth(self._time_to_lower()):
            self._steer()
            self._throttle(1 - share)
            cockpit.set_pitch(begun + share * (self._glide() - begun))
            yield
        while self._tension() > _SLACK * self._pull:
            yield
        self._hook(0.0)
        cockpit.speed_wanted = cockpit.speed()
        cockpit.set_speed(cockpit.speed_wanted)
        cockpit.change_speed(self._speed)
        cockpit.hold_heading()
        cockpit.hold_alt(cockpit.alt())

    def _steer(self) -> None:
        """Head along the line to the winch, against the drift."""
        (north, east), heading = self._plane.position(), self._cockpit.heading()
        off = east * math.cos(self._course) - north * math.sin(self._course)
        drift = math.remainder(self._plane.track()[0] - heading, math.tau)
        self._cockpit.set_heading(self._course - clip(_CENTER * off, _CENTER_MOST) - drift)

    def _path(self) -> float:
        """Return the path on which the airspeed stays [rad]."""
        ahead = self._pull * math.cos(self._angle())
        down = self._pull * math.sin(self._angle()) + self._weight
        drag = math.asin(_DRAG * self._weight / math.hypot(ahead, down))
        return min(_STEEPEST, math.atan2(ahead, down) - drag)

    def _time_to_lower(self) -> float:
        """Return the time in which the nose is lowered to the pitch of the glide [s]."""
        return 1.5 * max(0.0, self._cockpit.pitch_wanted() - self._glide()) / _LOWER
