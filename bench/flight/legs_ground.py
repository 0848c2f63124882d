"""Legs with wheels on the ground or close above it: static, take-off, approach, flare, landing roll."""

from __future__ import annotations

import math
from collections.abc import Generator
from itertools import chain, repeat

from bench.errors import FlightError
from bench.flight.cockpit import SURFACES, Cockpit, Plane
from bench.flight.legs_air import climb_ramp, level_off
from bench.flight.paths import Follower, Path
from bench.flight.shaping import Steps, clip, roll_time, smooth, ticks, wait
from bench.legs import Approach, LandingRoll, Static, TakeOff
from bench.specs import Runway, RunwaySpec

_POWER = 2.0  # in which brakes are released and power is set [s]
_HANDOVER = 1.0  # in which guidance takes the surfaces, or gives them back [s]
_ROTATE = math.radians(5.0)  # rate at which the nose is raised [rad/s]
_NEAR = 2.0  # an airspeed has nearly come when it lacks less [m/s]
_SAFE = 10.0  # height above the ground at which the climb begins [m]
_CENTRE = 0.02  # heading back to the centreline per distance off it [rad/m] ...
_CENTRE_MOST = math.radians(10.0)  # ... and the most of it [rad]
_PATIENCE = 180.0  # for a take-off run or a landing roll [s]
_EDGE = 20.0  # the runway ends this far from its centreline [m]
_ALIGNED = math.radians(60.0)  # an approach begins with its track this close to the runway's [rad]
_FINAL_BANK = math.radians(30.0)  # of an approach [rad]
_FLARE_BANK = math.radians(8.0)  # most of it close to the ground [rad]
_FLARE_TIME = 40.0  # until the wheels touch [s]
_STANDS = 0.02  # slower is standing [m/s]
_BRAKE = 0.6  # share of the brakes of a landing


def static(cockpit: Cockpit, leg: Static) -> Steps:
    """Stand with brakes set."""
    cockpit.brake(1.0)
    yield from wait(leg.duration)


def take_off(cockpit: Cockpit, leg: TakeOff) -> Steps:
    """Power, roll along the centreline, raise the nose at its speed, climb out at a rate."""
    runway, figures = _runway(cockpit)
    centre = _Centreline(cockpit, runway)
    cockpit.course = runway.heading
    cockpit.set_heading(cockpit.course)
    for share in smooth(_POWER):
        cockpit.brake(1 - share)
        cockpit.set_steering(share)
        cockpit.set_throttle(share)
        yield
    yield from _roll_to(cockpit, centre, 0.5 * figures.rotate_speed)
    cockpit.set_bank(0.0)
    cockpit.lat_mode(1)
    for share in smooth(_HANDOVER):
        for surface in ("aileron", "rudder"):
            cockpit.direct_share[surface](1 - share)
        centre.steer()
        yield
    yield from _roll_to(cockpit, centre, figures.rotate_speed)
    yield from _with_full_power(cockpit, leg.speed, _climb_out(cockpit, leg, centre))


def _with_full_power(cockpit: Cockpit, speed: float, steps: Steps) -> Steps:
    """Leave the power as it is until the airspeed [m/s] has nearly come, then hold that."""
    cockpit.set_speed(speed)  # what lacks of it is taken off the climb already
    held = False
    for _ in steps:
        if not held and cockpit.speed() > speed - _NEAR:
            cockpit.start_speed(speed)
            held = True
        yield
    if not held:
        cockpit.start_speed(speed)


def _climb_out(cockpit: Cockpit, leg: TakeOff, centre: _Centreline) -> Steps:
    """Raise the nose, leave the ground, climb to the height of the leg."""
    runway, figures = _runway(cockpit)
    begun = cockpit.pitch()
    cockpit.set_pitch(begun)
    cockpit.lon_mode(1)
    raised = list(smooth(1.5 * (figures.take_off_pitch - begun) / _ROTATE))
    handed, airborne = list(smooth(_HANDOVER)), 0
    for k in ticks(_PATIENCE):
        cockpit.set_pitch(begun + raised[min(k, len(raised) - 1)] * (figures.take_off_pitch - begun))
        cockpit.direct_share["elevator"](1 - handed[min(k, len(handed) - 1)])
        centre.steer()
        if airborne or not cockpit.on_wheels():
            airborne += 1
            cockpit.on_ground(standing=False)
            cockpit.set_steering(1 - handed[min(airborne, len(handed)) - 1])
        if airborne >= len(handed) and cockpit.alt_agl() > _SAFE:
            break
        yield
    else:
        raise FlightError(f"not off the ground in {_PATIENCE:g} s: {cockpit.state()}")
    cockpit.set_heading(cockpit.course)
    cockpit.lat_mode(2)
    climb = cockpit.climb()
    cockpit.set_climb(climb)
    cockpit.set_pitch_trim(cockpit.pitch_wanted())  # the climb begins with the pitch there is
    cockpit.lon_mode(2)
    for share in smooth(climb_ramp(leg.rate - climb) + 1.0):
        cockpit.set_climb(climb + share * (leg.rate - climb))
        yield
    yield from level_off(cockpit, runway.alt + leg.to_height, leg.rate)


def approach(cockpit: Cockpit, leg: Approach) -> Steps:
    """Fly level to the glide path, on the extended centreline, then down it to the height of the flare."""
    runway, figures = _runway(cockpit)
    plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
    line = _centreline(runway)
    before = -line.segments[0].relative(plane.position())[0]
    across = math.remainder(plane.track()[0] - runway.heading, math.tau)
    slope = math.tan(leg.glide)
    limit = cockpit.aircraft.max_descent

    def above() -> float:
        """Height of the glide path above the aircraft [m]."""
        to_go = leg.aim - line.segments[0].relative(plane.position())[0]
        return runway.alt + figures.height + slope * to_go - cockpit.alt()

    if before < 0 or abs(across) > _ALIGNED:
        raise FlightError(
            f"an approach begins before the runway, within {math.degrees(_ALIGNED):.0f} deg of its heading; "
            f"the threshold is {before:.0f} m ahead, the track {math.degrees(across):.0f} deg off"
        )
    if above() < 0:
        raise FlightError(f"an approach begins below the glide path; this is {-above():.0f} m above it")
    cockpit.change_speed(figures.approach_speed)
    bank = min(_FINAL_BANK, cockpit.aircraft.max_bank)
    follower = Follower(cockpit, plane, line, bank)
    limits = chain((share * bank for share in smooth(roll_time(bank))), repeat(bank))  # no step to begin with
    rate = 0.0
    while above() > rate * (0.5 * climb_ramp(rate) + cockpit.climb_lag):
        follower.steer(next(limits))
        yield
        rate = slope * plane.track()[1]
        if rate > limit:
            raise FlightError(f"the glide path needs {rate:.1f} m/s; the limit is {limit:g} m/s")
    cockpit.set_climb(0.0)
    cockpit.lon_mode(2)
    captured = list(smooth(climb_ramp(rate)))
    gain, k = cockpit.gain("altitude-gain"), 0
    while cockpit.alt_agl() > figures.flare_height:
        share, k = captured[min(k, len(captured) - 1)], k + 1
        rate = slope * plane.track()[1]
        cockpit.set_climb(share * (gain * above() * share - rate))
        follower.steer(next(limits))
        if above() < -50.0:
            raise FlightError(f"{-above():.0f} m above the glide path: {cockpit.state()}")
        yield
    if abs(follower.off) > _EDGE:
        raise FlightError(f"{abs(follower.off):.0f} m off the centreline at the flare: {cockpit.state()}")


def flare(cockpit: Cockpit) -> Generator[None, None, str]:
    """Let the sink fall with the height until the wheels touch; returns the touch-down in words."""
    runway, figures = _runway(cockpit)
    plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
    line = _centreline(runway)
    follower = Follower(cockpit, plane, line, min(_FINAL_BANK, cockpit.aircraft.max_bank))
    sink, aimed = -cockpit.climb(), figures.touch_down_sink
    span = (cockpit.alt_agl() - figures.height) / max(sink - aimed, 0.2)  # 1/e of the height each [s]
    looked = list(smooth(1.0))
    for k in ticks(_FLARE_TIME):
        if cockpit.on_wheels():
            along, off, _ = line.segments[0].relative(plane.position())
            side = "right" if off > 0 else "left"
            return (
                f"touch-down at {sink:.2f} m/s, {along:.0f} m along the runway, "
                f"{abs(off):.1f} m {side} of its centreline"
            )
        sink = -cockpit.climb()
        # the height when the vertical speed that is asked for now has come
        ahead = looked[min(k, len(looked) - 1)] * cockpit.climb_lag
        height = cockpit.alt_agl() - figures.height - sink * ahead
        cockpit.set_climb(-max(aimed, aimed + height / span))
        follower.steer(_FLARE_BANK)
        yield
    raise FlightError(f"no touch-down in {_FLARE_TIME:g} s: {cockpit.state()}")


def landing_roll(cockpit: Cockpit, leg: LandingRoll) -> Generator[None, None, str]:
    """Lower the nose, throttle back, brake to a standstill; returns where it stands in words."""
    runway, figures = _runway(cockpit)
    centre = _Centreline(cockpit, runway)
    cockpit.on_ground(standing=True)
    pitch, throttle = cockpit.pitch(), cockpit.throttle()
    cockpit.set_pitch(pitch)
    cockpit.lon_mode(1)
    cockpit.thr_mode(0)
    cockpit.set_bank(0.0)
    cockpit.course = runway.heading
    for share in smooth(1.5):
        cockpit.set_steering(share)
        cockpit.set_pitch((1 - share) * pitch)
        cockpit.set_throttle((1 - share) * throttle)
        centre.steer()
        yield
    for share in smooth(_POWER):
        cockpit.brake(share * _BRAKE)
        centre.steer()
        yield
    for _ in ticks(_PATIENCE):  # wings stay level by aileron while gusts can still lift them
        if centre.ground_speed() < 0.5 * figures.rotate_speed:
            break
        centre.steer()
        yield
    held = {surface: cockpit.surface[surface]() for surface in SURFACES}
    for surface in SURFACES:
        cockpit.direct[surface](held[surface])
    for share in smooth(_POWER):
        for surface in SURFACES:
            cockpit.direct_share[surface](share)
            cockpit.direct[surface]((1 - share) * held[surface])
        centre.steer()
        yield
    for _ in ticks(_PATIENCE):
        if centre.ground_speed() < _STANDS:
            break
        centre.steer()
        yield
    else:
        raise FlightError(f"still rolling at {centre.ground_speed():.1f} m/s after {_PATIENCE:g} s")
    for share in smooth(_POWER):
        cockpit.set_steering(1 - share)
        cockpit.brake(_BRAKE + share * (1 - _BRAKE))
        yield
    yield from wait(leg.hold)
    side = "right" if centre.off > 0 else "left"
    return f"stands {centre.along:.0f} m along the runway, {abs(centre.off):.1f} m {side} of its centreline"


def _runway(cockpit: Cockpit) -> tuple[Runway, RunwaySpec]:
    if cockpit.runway is None or cockpit.aircraft.runway is None:
        raise FlightError(f"the {cockpit.aircraft.name} has no runway here")
    return cockpit.runway, cockpit.aircraft.runway


def _centreline(runway: Runway) -> Path:
    """Return the centreline, from the threshold on; along it is negative before the threshold."""
    path = Path((0.0, 0.0), runway.heading)
    path.straight(1e6)
    return path


def _roll_to(cockpit: Cockpit, centre: _Centreline, speed: float) -> Steps:
    for _ in ticks(_PATIENCE):
        if cockpit.speed() >= speed:
            return
        centre.steer()
        yield
    raise FlightError(f"{speed:.0f} m/s not reached in {_PATIENCE:g} s: {cockpit.state()}")


class _Centreline:
    """Steers along the centreline with the nose wheel."""

    def __init__(self, cockpit: Cockpit, runway: Runway) -> None:
        self._cockpit = cockpit
        self._plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
        self._line = _centreline(runway).segments[0]
        self.along, self.off, _ = self._line.relative(self._plane.position())

    def ground_speed(self) -> float:
        return self._plane.track()[1]

    def steer(self) -> None:
        """Point the nose back to the centreline."""
        self.along, self.off, _ = self._line.relative(self._plane.position())
        if abs(self.off) > _EDGE:
            side = "right" if self.off > 0 else "left"
            raise FlightError(f"ran off the runway to the {side}: {self._cockpit.state()}")
        self._cockpit.set_heading(self._line.course - clip(_CENTRE * self.off, _CENTRE_MOST))
