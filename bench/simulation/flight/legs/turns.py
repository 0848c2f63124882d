"""Legs by heading and bank: turns, figure-eights, S-turns."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal

from bench.core.records.flight_specs import WINGS, LegStart
from bench.core.words.exceptions import FlightError
from bench.core.words.wording import format_count
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.shaping import G, Steps, roll_time, smooth, ticks, turned_in_roll
from bench.simulation.flight.legs.keys import (
    SIDES,
    AtSpeed,
    Bank,
    Key,
    format_deg,
    require_one,
    side_of,
    write_key,
)

_NEAR_HEADING = math.radians(2.0)  # a heading is reached within [rad]
_PATIENCE = 120.0  # how much longer than planned a turn may take [s]


@dataclass(frozen=True)
class Turn(AtSpeed):
    """Turn by an angle or to a heading, at a bank or at a rate, altitude held."""

    kind = "turn"
    flown_by = WINGS
    by: Annotated[float, Key("by_deg", "change of heading, positive to the right", -3600, 3600)] | None = None
    bank: Bank | None = None
    heading: Annotated[float, Key("to_heading_deg", "heading to turn to", 0, 360)] | None = None
    side: Annotated[Literal["right", "left", "shorter"], Key("side", "direction of a turn to a heading")] = (
        "shorter"
    )
    rate: Annotated[float, Key("rate_deg_s", "rate of the heading; 3 is standard", 0.1, 90)] | None = None

    def __post_init__(self) -> None:
        require_one({"by_deg": self.by, "to_heading_deg": self.heading})
        require_one({"bank_deg": self.bank, "rate_deg_s": self.rate})
        if self.by is not None and self.side != "shorter":
            raise ValueError("has by_deg and side: the sign of by_deg is the side")

    def describe(self) -> str:
        if self.by is not None:
            where = f"{format_deg(abs(self.by))} {side_of(self.by)}"
        else:
            assert self.heading is not None
            where = f"to {format_deg(self.heading)}" + (f" {self.side}" if self.side != "shorter" else "")
        if self.bank is not None:
            return f"{where}, bank {format_deg(self.bank)}"
        assert self.rate is not None
        return f"{where}, {format_deg(self.rate)}/s"

    def check(self, start: LegStart) -> list[str]:
        return [f"{write_key(self, 'by')} must not be 0; positive turns right"] if self.by == 0 else []

    def fly(self, cockpit: Cockpit) -> Steps:
        bank = self.bank
        if bank is None:
            assert self.rate is not None
            bank = math.atan(self.rate * cockpit.speed_wanted / G)
            if bank > cockpit.aircraft.max_bank:
                raise FlightError(
                    f"{math.degrees(self.rate):g} deg/s at {cockpit.speed_wanted:.0f} m/s needs a bank of "
                    f"{math.degrees(bank):.0f} deg; the {cockpit.aircraft.name} has "
                    f"{math.degrees(cockpit.aircraft.max_bank):.0f} deg"
                )
        by = self.by
        if by is None:
            assert self.heading is not None
            by = angle_to(cockpit.course, self.heading, SIDES[self.side])
            if by == 0:
                return
        yield from turn_by(cockpit, by, bank)


@dataclass(frozen=True)
class FigureEight(AtSpeed):
    """Full circles, right then left, again and again."""

    kind = "figure-eight"
    flown_by = WINGS
    bank: Bank
    laps: Annotated[int, Key("laps", "eights; one is a full right and a full left circle", 1, 1000)]

    def describe(self) -> str:
        return f"{format_count(self.laps, 'lap')}, bank {format_deg(self.bank)}"

    def fly(self, cockpit: Cockpit) -> Steps:
        for _ in range(self.laps):
            yield from roll_through(cockpit, math.tau, self.bank)
            yield from turn_by(cockpit, -math.tau, self.bank)


@dataclass(frozen=True)
class STurns(AtSpeed):
    """Turn to both sides of the course, right first, and end on the course."""

    kind = "s-turns"
    flown_by = WINGS
    by: Annotated[float, Key("by_deg", "largest angle off the course", 1, 180)]
    bank: Bank
    count: Annotated[int, Key("count", "number of pairs, right and left", 1, 1000)]

    def describe(self) -> str:
        return f"{self.count} of {format_deg(self.by)} either side, bank {format_deg(self.bank)}"

    def fly(self, cockpit: Cockpit) -> Steps:
        yield from roll_through(cockpit, self.by, self.bank)
        for number in range(2 * self.count - 1):
            side = 1 if number % 2 else -1
            yield from roll_through(cockpit, side * 2 * self.by, self.bank)
        yield from turn_by(cockpit, self.by, self.bank)


def angle_to(course: float, heading: float, side: int) -> float:
    """Return the turn from a course to a heading [rad]: side 1 right, -1 left, 0 the shorter way.

    Examples
    --------
    >>> round(math.degrees(angle_to(math.radians(350.0), math.radians(20.0), side=-1)))
    -330
    """
    by = math.remainder(heading - course, math.tau)
    if abs(by) < 1e-9:
        return 0.0
    return by if by * side >= 0 else by + side * math.tau


def turn_by(cockpit: Cockpit, by: float, bank: float) -> Steps:
    """Turn by an angle [rad] and wait for the new heading."""
    yield from roll_through(cockpit, by, bank)

    def held() -> bool:
        return abs(math.remainder(cockpit.course - cockpit.heading(), math.tau)) < _NEAR_HEADING

    yield from cockpit.wait_until(held, _PATIENCE, "heading not held")


def roll_through(cockpit: Cockpit, by: float, bank: float) -> Steps:
    """Turn by an angle through a smooth bank; ends with wings level, in heading mode."""
    begun = cockpit.heading()
    to_go = abs(by) + math.copysign(1.0, by) * math.remainder(cockpit.course - begun, math.tau)
    bank = _bank_that_fits(cockpit, to_go, bank)
    side = math.copysign(1.0, by)
    ramp = roll_time(bank)
    cockpit.set_bank(0.0)
    cockpit.lat_mode(1)
    turned, last = 0.0, begun

    def turn_on() -> None:
        nonlocal turned, last
        now = cockpit.heading()
        turned += side * math.remainder(now - last, math.tau)
        last = now

    for share in smooth(ramp):
        cockpit.set_bank(side * share * bank)
        yield
        turn_on()
    # what the roll out turns, times the airspeed it is flown at [m]
    lead = turned_in_roll(bank, 1.0) + G * math.tan(bank) * cockpit.bank_lag
    planned = to_go / (G * math.tan(bank) / cockpit.speed())
    for _ in ticks(1.5 * planned + _PATIENCE):
        if to_go - turned <= lead / cockpit.speed():
            break
        yield
        turn_on()
    else:
        raise FlightError(f"turned {math.degrees(turned):.0f} of {math.degrees(to_go):.0f} deg only")
    for share in smooth(ramp):
        cockpit.set_bank(side * (1 - share) * bank)
        yield
    cockpit.course += by
    cockpit.set_heading(cockpit.course)
    cockpit.lat_mode(2)


def _bank_that_fits(cockpit: Cockpit, to_go: float, bank: float) -> float:
    """Return the largest bank, up to the commanded one, for which roll in and out do not turn too far."""
    while bank > math.radians(1.0) and 2 * turned_in_roll(bank, cockpit.speed()) > to_go:
        bank *= 0.95
    return bank
