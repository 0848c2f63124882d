"""Legs that begin on a runway, and the steering along its centerline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from bench.core.records.flight_specs import (
    FIXED_WING,
    ROTORCRAFT,
    WINGS,
    AircraftSpec,
    Leg,
    LegStart,
    Runway,
    RunwaySpec,
)
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.paths import SegmentPath
from bench.simulation.flight.guidance.shaping import Steps, clip, smooth, ticks, wait
from bench.simulation.flight.legs.climbs import climb_ramp, level_off
from bench.simulation.flight.legs.keys import ClimbRate, Key, Seconds, Speed, side_of, write_key
from bench.simulation.flight.panel import Plane
from bench.simulation.flight.rotor_cockpit import RotorCockpit

POWER = 2.0  # in which brakes are released and power is set [s]
PATIENCE = 180.0  # for a take-off run or a landing roll [s]
_HANDOVER = 1.0  # in which guidance takes the surfaces, or gives them back [s]
_ROTATE = math.radians(5.0)  # rate at which the nose is raised [rad/s]
_NEAR = 2.0  # an airspeed has nearly come when it lacks less [m/s]
_LOWEST = 20.0  # height above the runway that a take-off run climbs to [m]
_SAFE = 10.0  # height above the ground at which the climb begins [m]
_CENTER = 0.02  # heading back to the centerline per distance off it [rad/m] ...
_CENTER_MOST = math.radians(10.0)  # ... and the most of it [rad]
_ALONG = math.radians(45.0)  # most from the heading of the runway where its centerline is followed [rad]


@dataclass(frozen=True)
class Static(Leg):
    """Stand on the ground with brakes set."""

    kind = "static"
    flown_by = (*WINGS, *ROTORCRAFT)
    needs = leaves = "ground"
    duration: Seconds

    def describe(self) -> str:
        return f"{self.duration:g} s"

    def fly(self, cockpit: Cockpit | RotorCockpit) -> Steps:
        if isinstance(cockpit, Cockpit):
            cockpit.brake(1.0)
        yield from wait(self.duration)


@dataclass(frozen=True)
class TakeOff(Leg):
    """Roll, rotate and climb straight ahead to a height above the runway; a multirotor rises on the spot."""

    kind = "take-off"
    flown_by: ClassVar[tuple[str, ...]] = (FIXED_WING, *ROTORCRAFT)
    needs = "ground"
    to_height: Annotated[
        float, Key("to_height_m", "height above the runway; 1 m or more for a multirotor", 1, 5000)
    ]
    rate: ClimbRate
    speed: Speed | None = None

    def describe(self) -> str:
        at = f"to {self.to_height:g} m above the runway at {self.rate:g} m/s"
        return at if self.speed is None else f"{at}, {self.speed:g} m/s"

    def check(self, start: LegStart) -> list[str]:
        if start.aircraft.hovers:
            return [] if self.speed is None else [f"{write_key(self, 'speed')} is not used by a multirotor"]
        wrong = check_runway(start.aircraft)
        if self.speed is None:
            wrong.append("speed_mps is missing")
        if self.to_height < _LOWEST:
            wrong.append(
                f"{write_key(self, 'to_height')} is below the {_LOWEST:g} m of an aircraft with wings"
            )
        return wrong

    def alt_after(self, start: LegStart) -> float:
        return (start.runway.alt if start.runway else start.alt) + self.to_height

    def fly(self, cockpit: Cockpit | RotorCockpit) -> Steps:
        if isinstance(cockpit, RotorCockpit):
            return cockpit.lift_off(self.to_height, self.rate)
        return self._roll_and_climb(cockpit)

    def _roll_and_climb(self, cockpit: Cockpit) -> Steps:
        """Power, roll along the centerline, raise the nose at its speed, climb out at a rate."""
        runway, figures = find_runway(cockpit)
        center = Centerline(cockpit, runway)
        cockpit.course = runway.heading
        cockpit.set_heading(cockpit.course)
        for share in smooth(POWER):
            cockpit.brake(1 - share)
            cockpit.set_steering(share)
            cockpit.set_throttle(share)
            yield
        yield from _roll_to(cockpit, center, 0.5 * figures.rotate_speed)
        cockpit.set_bank(0.0)
        cockpit.lat_mode(1)
        for share in smooth(_HANDOVER):
            for surface in ("aileron", "rudder"):
                cockpit.direct_share[surface](1 - share)
            center.steer()
            yield
        yield from _roll_to(cockpit, center, figures.rotate_speed)
        assert self.speed is not None  # by its check
        yield from _with_full_power(cockpit, self.speed, self._climb_out(cockpit, center, direct=True))

    def _climb_out(self, cockpit: Cockpit, center: Centerline, *, direct: bool) -> Steps:
        """Raise the nose, leave the ground, climb to the height; guidance takes a direct elevator."""
        runway, figures = find_runway(cockpit)
        begun = cockpit.pitch()
        cockpit.set_pitch(begun)
        cockpit.lon_mode(1)
        raised = list(smooth(1.5 * (figures.take_off_pitch - begun) / _ROTATE))
        handed, airborne = list(smooth(_HANDOVER)), 0
        for k in ticks(PATIENCE):
            cockpit.set_pitch(begun + raised[min(k, len(raised) - 1)] * (figures.take_off_pitch - begun))
            if direct:
                cockpit.direct_share["elevator"](1 - handed[min(k, len(handed) - 1)])
            center.steer()
            if airborne or not cockpit.on_wheels():
                airborne += 1
                cockpit.on_ground(standing=False)
                cockpit.set_steering(1 - handed[min(airborne, len(handed)) - 1])
            if airborne >= len(handed) and cockpit.alt_agl() > _SAFE:
                break
            yield
        else:
            raise FlightError(f"not off the ground in {PATIENCE:g} s: {cockpit.state()}")
        cockpit.set_heading(cockpit.course)
        cockpit.lat_mode(2)
        climb = cockpit.climb()
        cockpit.set_climb(climb)
        cockpit.set_pitch_trim(cockpit.pitch_wanted())  # the climb begins with the pitch there is
        cockpit.lon_mode(2)
        for share in smooth(climb_ramp(self.rate - climb) + 1.0):
            cockpit.set_climb(climb + share * (self.rate - climb))
            yield
        yield from level_off(cockpit, runway.alt + self.to_height, self.rate)


@dataclass(frozen=True)
class TouchAndGo(TakeOff):
    """Lower the nose after a flare, roll, and take off again."""

    kind = "touch-and-go"
    flown_by = (FIXED_WING,)
    needs = "flare"
    roll: Annotated[float, Key("roll_s", "time on the runway without power", 1, 30)] = 3.0

    def _roll_and_climb(self, cockpit: Cockpit) -> Steps:
        """Nose down and throttle back, roll along the centerline, then as a take-off."""
        runway, figures = find_runway(cockpit)
        center = Centerline(cockpit, runway)
        cockpit.course = runway.heading
        yield from lower_nose(cockpit, center)
        for _ in ticks(self.roll):
            center.steer()
            yield
        for share in smooth(POWER):
            cockpit.set_throttle(share)
            center.steer()
            yield
        yield from _roll_to(cockpit, center, figures.rotate_speed)
        assert self.speed is not None  # by its check
        yield from _with_full_power(cockpit, self.speed, self._climb_out(cockpit, center, direct=False))


def lower_nose(cockpit: Cockpit, center: Centerline) -> Steps:
    """Bring the nose wheel down after a touch-down, wings level and throttle back."""
    cockpit.on_ground(standing=True)
    pitch, throttle = cockpit.pitch(), cockpit.throttle()
    cockpit.set_pitch(pitch)
    cockpit.lon_mode(1)
    cockpit.thr_mode(0)
    cockpit.set_bank(0.0)
    for share in smooth(1.5):
        cockpit.hold_firmly(1 - share)
        cockpit.hold_approach(1 - share)
        cockpit.set_steering(share)
        cockpit.set_pitch((1 - share) * pitch)
        cockpit.set_throttle((1 - share) * throttle)
        center.steer()
        yield


def _with_full_power(cockpit: Cockpit, speed: float, steps: Steps) -> Steps:
    """Keep the power until the airspeed [m/s] is nearly reached, then hold that airspeed."""
    cockpit.set_speed(speed)  # what lacks of it is taken off the climb already
    held = False
    for _ in steps:
        if not held and cockpit.speed() > speed - _NEAR:
            cockpit.start_speed(speed)
            held = True
        yield
    if not held:
        cockpit.start_speed(speed)


def _roll_to(cockpit: Cockpit, center: Centerline, speed: float) -> Steps:
    for _ in ticks(PATIENCE):
        if cockpit.speed() >= speed:
            return
        center.steer()
        yield
    raise FlightError(f"{speed:.0f} m/s not reached in {PATIENCE:g} s: {cockpit.state()}")


def check_runway(aircraft: AircraftSpec) -> list[str]:
    """Return an error line if an aircraft cannot take off and land."""
    return [] if aircraft.runway else [f"the {aircraft.name} has no [runway] in its aircraft.toml"]


def find_runway(cockpit: Cockpit) -> tuple[Runway, RunwaySpec]:
    """Return the runway and the runway data of the aircraft; raise FlightError if either is missing."""
    if cockpit.runway is None or cockpit.aircraft.runway is None:
        raise FlightError(f"the {cockpit.aircraft.name} has no runway here")
    return cockpit.runway, cockpit.aircraft.runway


def centerline(runway: Runway) -> SegmentPath:
    """Return the centerline from the threshold on; distances before the threshold are negative."""
    path = SegmentPath((0.0, 0.0), runway.heading)
    path.straight(1e6)
    return path


class Centerline:
    """Steers along the centerline with the nose wheel."""

    def __init__(self, cockpit: Cockpit, runway: Runway) -> None:
        self._cockpit, self._edge = cockpit, 0.5 * runway.width
        self._plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
        self._line = centerline(runway).segments[0]
        self.along, self.off, _ = self._line.relative(self._plane.position())
        away = math.remainder(cockpit.heading() - self._line.course, math.tau)
        if abs(away) > _ALONG:
            raise FlightError(
                f"not along the runway, heading {math.degrees(away):.0f} deg off: line-up comes before it"
            )

    def wheel_speed(self) -> float:
        """Return the true speed over ground [m/s], as measured by the wheels."""
        return self._plane.true_speed()

    def steer(self) -> None:
        """Steer the nose back to the centerline."""
        self.along, self.off, _ = self._line.relative(self._plane.position())
        if abs(self.off) > self._edge:
            raise FlightError(f"ran off the runway to the {side_of(self.off)}: {self._cockpit.state()}")
        self._cockpit.set_heading(self._line.course - clip(_CENTER * self.off, _CENTER_MOST))
