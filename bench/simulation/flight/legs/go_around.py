"""An approach that is broken off."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Annotated, ClassVar

from bench.core.records.flight_specs import LegStart, Runway, RunwaySpec
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.paths import Follower
from bench.simulation.flight.guidance.shaping import Steps, smooth
from bench.simulation.flight.legs.climbs import climb_ramp, level_off
from bench.simulation.flight.legs.keys import ClimbRate, Key, Speed, write_key
from bench.simulation.flight.legs.landing import Approach
from bench.simulation.flight.legs.level import Configuration

_BRISK = 2.0  # so much faster than in other climbs the sink becomes a climb
_POWER = 2.0  # in which the power is set [s]
_BANK = math.radians(15.0)  # most of it on the way up [rad]
_ROOM = 20.0  # least height from the decision to the end of the climb [m]
_CLEAN = 10.0  # height above the decision height at which flaps and gear are retracted [m]


@dataclass(frozen=True)
class GoAround(Approach):
    """Break off an approach at its decision height and climb along the runway to a height above it."""

    kind = "go-around"
    leaves: ClassVar[str] = "air"
    decision: Annotated[float, Key("decision_m", "decision height above the runway", 5, 1000)] = field(
        kw_only=True
    )
    to_height: Annotated[float, Key("to_height_m", "height above the runway", 20, 5000)] = field(kw_only=True)
    rate: ClimbRate = field(kw_only=True)
    speed: Speed = field(kw_only=True)

    def describe(self) -> str:
        climb = f"to {self.to_height:g} m above the runway at {self.rate:g} m/s, {self.speed:g} m/s"
        return f"{super().describe()}, at {self.decision:g} m {climb}"

    def check(self, start: LegStart) -> list[str]:
        wrong, figures = super().check(start), start.aircraft.runway
        if figures is not None and self.decision < figures.flare_height:
            wrong.append(
                f"{write_key(self, 'decision')} is below the {figures.flare_height:g} m at which the "
                f"{start.aircraft.name} flares"
            )
        if self.to_height < self.decision + _ROOM:
            wrong.append(f"{write_key(self, 'to_height')} is not {_ROOM:g} m above the decision height")
        return wrong

    def alt_after(self, start: LegStart) -> float:
        return (start.runway.alt if start.runway else start.alt) + self.to_height

    def _find_lowest(self, figures: RunwaySpec, slope: float) -> float:
        return self.decision + figures.height

    def _go_on(self, cockpit: Cockpit, follower: Follower, runway: Runway, sink: float) -> Steps:
        """Full power, climb, retract what is out, level off; keep to the centerline meanwhile."""
        sequel = level_off(cockpit, runway.alt + self.to_height, self.rate)
        climb = chain(_pull_up(cockpit, sink, self.rate), sequel)
        moves = chain(_set_power(cockpit, self.speed), _retract(cockpit, runway.alt + self.decision + _CLEAN))
        for _ in climb:
            follower.steer(_BANK)
            next(moves, None)
            yield
        if cockpit.speed_wanted != self.speed:  # not reached yet
            cockpit.start_speed(self.speed)
        cockpit.hold_heading()


def _pull_up(cockpit: Cockpit, sink: float, rate: float) -> Steps:
    """Turn the sink [m/s] into a climb at a rate [m/s], with the gains of flight."""
    for share in smooth(climb_ramp(rate + sink) / _BRISK):
        cockpit.hold_approach(1 - share)
        cockpit.set_climb(share * (rate + sink) - sink)
        yield


def _set_power(cockpit: Cockpit, speed: float) -> Iterator[None]:
    """Full power until an airspeed [m/s] is reached, then hold it."""
    begun = cockpit.throttle()
    cockpit.thr_mode(0)
    for share in smooth(_POWER):
        cockpit.set_throttle(begun + share * (1.0 - begun))
        yield
    while cockpit.speed() < speed:
        yield
    cockpit.start_speed(speed)


def _retract(cockpit: Cockpit, alt: float) -> Iterator[None]:
    """Raise the flaps and the gear of an aircraft that has them, once it climbs above a height [m]."""
    parts = cockpit.aircraft.configuration
    while parts and (cockpit.climb() < 0 or cockpit.alt() < alt):
        yield
    if parts:
        flaps = 0.0 if "flaps" in parts else None
        yield from Configuration(flaps, "up" if "gear" in parts else None).fly(cockpit)
