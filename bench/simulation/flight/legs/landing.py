"""Legs from the glide path to a standstill."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from itertools import chain, repeat
from typing import Annotated

from bench.core.records.flight_specs import SECONDS, Leg, LegStart, Runway, RunwaySpec
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import SURFACES, Cockpit
from bench.simulation.flight.guidance.paths import Follower, SegmentPath, run_in, turn_radius
from bench.simulation.flight.guidance.shaping import Steps, roll_time, smooth, ticks, wait
from bench.simulation.flight.legs.climbs import climb_ramp
from bench.simulation.flight.legs.keys import Bank, Key, format_deg, side_of
from bench.simulation.flight.legs.runway import (
    PATIENCE,
    POWER,
    Centerline,
    centerline,
    check_runway,
    find_runway,
    lower_nose,
)
from bench.simulation.flight.panel import Plane

_ALIGNED = math.radians(60.0)  # with its track this close to the runway's an approach meets its line [rad]
_BASE = math.radians(120.0)  # and with less than this it turns from the base leg [rad]
_SPARE_BANK = math.radians(3.0)  # of the base turn, for what disturbs it [rad] ...
_MORE_BANK = math.radians(2.0)  # ... so much beyond it [rad] ...
_RESERVE = math.radians(7.0)  # ... and below the limit of the aircraft [rad]
_FINAL_BANK = math.radians(30.0)  # of an approach without a bank [rad]
_FLARE_BANK = math.radians(8.0)  # most of it close to the ground [rad]
_USUAL_GLIDE = math.radians(3.5)  # that flare heights are for
_GAINS = 2.0  # in which the gains become those of an approach [s]
_FLARE_TIME = 40.0  # until the wheels touch [s]
_STANDS = 0.02  # slower is standing [m/s]
_BRAKE = 0.6  # share of the brakes of a landing


@dataclass(frozen=True)
class Approach(Leg):
    """Meet the extended centerline and the glide path of the runway, down to the flare."""

    kind = "approach"
    leaves = "approach"
    glide: Annotated[float, Key("glide_deg", "angle of the glide path", 1, 10)] = math.radians(3.0)
    aim: Annotated[
        float, Key("aim_m", "distance beyond the threshold at which the path meets the ground", 0, 1000)
    ] = 60.0
    bank: Bank | None = None

    def describe(self) -> str:
        path = f"glide path {format_deg(self.glide)}"
        return path if self.bank is None else f"{path}, bank {format_deg(self.bank)}"

    def check(self, start: LegStart) -> list[str]:
        nowhere = [] if start.runway else ["there is no [runway] to approach"]
        return check_runway(start.aircraft) + nowhere

    def alt_after(self, start: LegStart) -> float:
        return start.runway.alt if start.runway else start.alt

    def fly(self, cockpit: Cockpit) -> Steps:
        """Fly level to the glide path, along the centerline, then down it to the height of the flare.

        From a base leg it flies on to where a turn with the bank begins that ends on the centerline.
        """
        runway, figures = find_runway(cockpit)
        plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
        line = centerline(runway)
        before = -line.segments[0].relative(plane.position())[0]
        across = math.remainder(plane.track()[0] - runway.heading, math.tau)
        slope = math.tan(self.glide)
        limit = cockpit.aircraft.max_descent

        def above() -> float:
            """Height of the glide path above the aircraft [m]."""
            to_go = self.aim - line.segments[0].relative(plane.position())[0]
            return runway.alt + figures.height + slope * to_go - cockpit.alt()

        lowest, height = self._find_lowest(figures, slope), cockpit.alt() - runway.alt
        if lowest > height:
            raise FlightError(
                f"the glide path ends {lowest:.0f} m above the runway, the aircraft is at {height:.0f} m"
            )
        if before < 0 or abs(across) > _BASE:
            raise FlightError(
                f"an approach begins before the runway, within {format_deg(_BASE)} of its heading; the "
                f"threshold is {before:.0f} m ahead, the track {math.degrees(across):.0f} deg off"
            )
        if above() < 0:
            raise FlightError(f"an approach begins below the glide path; this is {-above():.0f} m above it")
        cockpit.change_speed(figures.approach_speed)
        for share in smooth(_GAINS) if cockpit.approach_gains else ():
            cockpit.hold_approach(share)
            yield
        bank = min(self.bank or _FINAL_BANK, cockpit.aircraft.max_bank)
        base = abs(across) > _ALIGNED
        slow = figures.approach_speed
        path = _turn_from_base(cockpit, plane, line, bank, slow) if base else line
        follower = Follower(cockpit, plane, path, bank, bank if base else self.bank)
        most = bank + _MORE_BANK if base else bank
        limits = chain((share * most for share in smooth(roll_time(most))), repeat(most))  # no step
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
        lowest = self._find_lowest(figures, slope)
        while cockpit.alt_agl() > lowest:
            share, k = captured[min(k, len(captured) - 1)], k + 1
            rate = slope * plane.track()[1]
            cockpit.set_climb(share * (gain * above() * share - rate))
            follower.steer(next(limits))
            if above() < -50.0:
                raise FlightError(f"{-above():.0f} m above the glide path: {cockpit.state()}")
            yield
        yield from self._go_on(cockpit, follower, runway, rate)

    def _find_lowest(self, figures: RunwaySpec, slope: float) -> float:
        """Return the height above the ground at which the path ends [m]; higher on a steeper path.

        From there the sink falls as fast as on the usual path.
        """
        return figures.flare_height * max(1.0, slope / math.tan(_USUAL_GLIDE))

    def _go_on(self, cockpit: Cockpit, follower: Follower, runway: Runway, sink: float) -> Steps:
        """Continue from the end of the path, with a sink [m/s]: a flare follows."""
        if abs(follower.off) > 0.5 * runway.width:
            raise FlightError(f"{abs(follower.off):.0f} m off the centerline at the flare: {cockpit.state()}")
        yield from ()


def _turn_from_base(
    cockpit: Cockpit, plane: Plane, line: SegmentPath, bank: float, slowest: float
) -> SegmentPath:
    """Return the way from the present position: straight on, a turn with a bank [rad], the centerline.

    The turn is for the airspeed of the approach [m/s] if the aircraft has slowed down before it.
    """
    track = plane.track()[0]
    _, right, course = line.segments[0].relative(plane.position())
    across = math.remainder(track - course, math.tau)
    there, turn = -right * math.copysign(1.0, across), 1 - math.cos(across)
    bank = max(min(bank - _SPARE_BANK, cockpit.aircraft.max_bank - _RESERVE), 0.5 * bank)
    slow = turn_radius(cockpit, bank, slowest)
    rest = cockpit.change_time() * (cockpit.fastest() + cockpit.wind_speed())
    radius = slow if there > slow * turn + rest else turn_radius(cockpit, bank)
    needed = radius * turn + abs(math.sin(across)) * run_in(cockpit, bank)
    if there < needed:
        raise FlightError(
            f"a turn of {math.degrees(across):.0f} deg from the base leg, at {radius:.0f} m radius, begins "
            f"{needed:.0f} m before the centerline; there are {there:.0f} m: {cockpit.state()}"
        )
    path = SegmentPath(plane.position(), track)
    path.straight((there - radius * turn) / abs(math.sin(across)))
    path.arc(-across, radius)
    path.straight(1e6)
    return path


@dataclass(frozen=True)
class Flare(Leg):
    """Break off the glide and touch down."""

    kind = "flare"
    needs, leaves = "approach", "flare"

    def fly(self, cockpit: Cockpit) -> Generator[None, None, str]:
        """Let the sink fall with the height until the wheels touch; returns the touch-down in words."""
        runway, figures = find_runway(cockpit)
        plane = Plane(cockpit, runway.lat, runway.lon, runway.alt)
        line = centerline(runway)
        follower = Follower(cockpit, plane, line, min(_FINAL_BANK, cockpit.aircraft.max_bank))
        sink, aimed = -cockpit.climb(), figures.touch_down_sink
        span = (cockpit.alt_agl() - figures.height) / max(sink - aimed, 0.2)  # 1/e of the height each [s]
        looked = list(smooth(1.0))
        for k in ticks(_FLARE_TIME):
            if cockpit.on_wheels():
                return f"touch-down at {sink:.2f} m/s, {_place(line, plane)}"
            sink = -cockpit.climb()
            # the height when the vertical speed that is asked for now has come
            ahead = looked[min(k, len(looked) - 1)] * cockpit.climb_lag
            height = cockpit.alt_agl() - figures.height - sink * ahead
            cockpit.set_climb(-max(aimed, aimed + height / span))
            cockpit.hold_firmly(looked[min(k, len(looked) - 1)])
            follower.steer(_FLARE_BANK)
            yield
        raise FlightError(f"no touch-down in {_FLARE_TIME:g} s: {cockpit.state()}")


@dataclass(frozen=True)
class LandingRoll(Leg):
    """Lower the nose, brake to a standstill on the centerline, and stand."""

    kind = "landing-roll"
    needs, leaves = "flare", "ground"
    hold: Annotated[float, Key("hold_s", "duration of the stop at the end", *SECONDS)] = 10.0

    def fly(self, cockpit: Cockpit) -> Generator[None, None, str]:
        """Lower the nose, throttle back, brake to a standstill; return the final position in words."""
        runway, figures = find_runway(cockpit)
        center = Centerline(cockpit, runway)
        cockpit.course = runway.heading
        yield from lower_nose(cockpit, center)
        for share in smooth(POWER):
            cockpit.brake(share * _BRAKE)
            center.steer()
            yield
        for _ in ticks(PATIENCE):  # wings stay level by aileron while gusts can still lift them
            if center.wheel_speed() < 0.5 * figures.rotate_speed:
                break
            center.steer()
            yield
        held = {surface: cockpit.surface[surface]() for surface in SURFACES}
        for surface in SURFACES:
            cockpit.direct[surface](held[surface])
        for share in smooth(POWER):
            for surface in SURFACES:
                cockpit.direct_share[surface](share)
                cockpit.direct[surface]((1 - share) * held[surface])
            center.steer()
            yield
        for _ in ticks(PATIENCE):
            if center.wheel_speed() < _STANDS:
                break
            center.steer()
            yield
        else:
            raise FlightError(f"still rolling at {center.wheel_speed():.1f} m/s after {PATIENCE:g} s")
        for share in smooth(POWER):
            cockpit.set_steering(1 - share)
            cockpit.brake(_BRAKE + share * (1 - _BRAKE))
            yield
        yield from wait(self.hold)
        return f"stands {_place(centerline(runway), Plane(cockpit, runway.lat, runway.lon, runway.alt))}"


def _place(line: SegmentPath, plane: Plane) -> str:
    """Return the position on the runway in words: as estimated, and the true position if it differs."""

    def say(point: tuple[float, float]) -> str:
        along, off, _ = line.segments[0].relative(point)
        return f"{along:.0f} m along the runway, {abs(off):.1f} m {side_of(off)} of its centerline"

    believed, true = plane.position(), plane.true_position()
    return say(true) if believed == true else f"estimated {say(believed)}, in truth {say(true)}"
