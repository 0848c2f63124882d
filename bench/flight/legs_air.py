"""Legs by heading, bank and altitude: straights, climbs, turns, eights, S-turns, speeds, flaps and gear."""

from __future__ import annotations

import math

from bench.errors import FlightError
from bench.flight.cockpit import Cockpit
from bench.flight.shaping import (
    GUIDANCE_RATE,
    G,
    Steps,
    roll_time,
    smooth,
    ticks,
    turned_in_roll,
)
from bench.legs import Configuration, Cruise, FigureEight, STurns, Turn

_CLIMB_CHANGE = 1.0  # fastest change of a climb set-point [m/s^2]
_NEAR_ALT = 2.0  # an altitude is reached within [m]
_NEAR_HEADING = math.radians(2.0)  # a heading is reached within [rad]
_NEAR_SPEED = 0.5  # an airspeed is reached within [m/s]
_PATIENCE = 120.0  # how much longer than planned a leg may take [s]
_FLAPS, _GEAR = "fcs/flap-cmd-norm", "gear/gear-cmd-norm"


def cruise(cockpit: Cockpit, leg: Cruise) -> Steps:
    """Hold what is held until the distance over ground is flown."""
    plane = cockpit.plane_here()
    flown = 0.0
    while flown < leg.distance - 0.5 * plane.track()[1] / GUIDANCE_RATE:
        yield
        flown += plane.track()[1] / GUIDANCE_RATE
        if not flown > 0:
            raise FlightError(f"no way is made over ground: {cockpit.state()}")


def settle_speed(cockpit: Cockpit, speed: float) -> Steps:
    """Fly on until the airspeed is the one wanted."""
    while not cockpit.speed_settled():
        yield
    for _ in ticks(_PATIENCE):
        if abs(cockpit.speed() - speed) < _NEAR_SPEED:
            return
        yield
    raise FlightError(f"{speed:g} m/s not held within {_PATIENCE:g} s: {cockpit.state()}")


def to_alt(cockpit: Cockpit, alt: float, rate: float) -> Steps:
    """Ramp the vertical speed up, hold it, ramp it down into the altitude."""
    begun = cockpit.alt()
    # a short way is climbed slower, so that the ramps fit into it; 0.1 m/s when there is no way at all
    fits = max(0.1, math.sqrt(abs(alt - begun) * _CLIMB_CHANGE / 2))
    rate = math.copysign(min(abs(rate), fits), rate)
    ramp = climb_ramp(rate)
    cockpit.set_climb(0.0)
    cockpit.lon_mode(2)
    for share in smooth(ramp):
        cockpit.set_climb(share * rate)
        yield
    yield from level_off(cockpit, alt, rate)


def climb_ramp(rate: float) -> float:
    """Return how long a vertical speed [m/s] is built up [s]."""
    return 1.5 * abs(rate) / _CLIMB_CHANGE


def level_off(cockpit: Cockpit, alt: float, rate: float) -> Steps:
    """Keep climbing (negative: descending) at a rate and ramp it down into the altitude."""
    begun = cockpit.alt()
    ramp = climb_ramp(rate)
    lead = abs(rate) * (ramp / 2 + cockpit.climb_lag)
    planned = abs(alt - begun) / abs(rate)
    for _ in ticks(planned + _PATIENCE):
        if (alt - cockpit.alt()) * math.copysign(1.0, rate) <= lead:
            break
        yield
    else:
        raise FlightError(f"{alt:g} m not reached in {planned + _PATIENCE:.0f} s: {cockpit.state()}")
    for share in smooth(ramp):
        cockpit.set_climb((1 - share) * rate)
        yield
    cockpit.hold_alt(alt)
    for _ in ticks(_PATIENCE):
        if abs(alt - cockpit.alt()) < _NEAR_ALT:
            return
        yield
    raise FlightError(f"{alt:g} m not held within {_PATIENCE:g} s: {cockpit.state()}")


def turn(cockpit: Cockpit, leg: Turn) -> Steps:
    """Roll in, hold the bank, roll out on the new heading and catch it."""
    bank = leg.bank
    if bank is None:
        assert leg.rate is not None
        bank = math.atan(leg.rate * cockpit.speed_wanted / G)
        if bank > cockpit.aircraft.max_bank:
            raise FlightError(
                f"{math.degrees(leg.rate):g} deg/s at {cockpit.speed_wanted:.0f} m/s needs a bank of "
                f"{math.degrees(bank):.0f} deg; the {cockpit.aircraft.name} has "
                f"{math.degrees(cockpit.aircraft.max_bank):.0f} deg"
            )
    by = leg.by
    if by is None:
        assert leg.heading is not None
        by = angle_to(cockpit.course, leg.heading, leg.side)
        if by == 0:
            return
    yield from turn_by(cockpit, by, bank)


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
    yield from _roll_through(cockpit, by, bank)
    for _ in ticks(_PATIENCE):
        error = math.remainder(cockpit.course - cockpit.heading(), math.tau)
        if abs(error) < _NEAR_HEADING:
            return
        yield
    raise FlightError(f"heading not held within {_PATIENCE:g} s: {cockpit.state()}")


def figure_eight(cockpit: Cockpit, leg: FigureEight) -> Steps:
    """Full circles, right then left."""
    for _ in range(leg.laps):
        yield from _roll_through(cockpit, math.tau, leg.bank)
        yield from turn_by(cockpit, -math.tau, leg.bank)


def s_turns(cockpit: Cockpit, leg: STurns) -> Steps:
    """Swing about the course, and end on it."""
    yield from _roll_through(cockpit, leg.by, leg.bank)
    for number in range(2 * leg.count - 1):
        side = 1 if number % 2 else -1
        yield from _roll_through(cockpit, side * 2 * leg.by, leg.bank)
    yield from turn_by(cockpit, leg.by, leg.bank)


def configure(cockpit: Cockpit, leg: Configuration) -> Steps:
    """Move flaps and gear from where they are, all in the same time."""
    moves = []
    for name, wanted in ((_FLAPS, leg.flaps), (_GEAR, None if leg.gear is None else float(leg.gear))):
        if wanted is not None:
            moves.append((cockpit.switch(name), cockpit.reader(name)(), wanted))
    for share in smooth(leg.duration):
        for write, begun, wanted in moves:
            write(begun + share * (wanted - begun))
        yield


def _roll_through(cockpit: Cockpit, by: float, bank: float) -> Steps:
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
    """Largest bank up to the wanted one whose roll in and out turn no further than wanted."""
    while bank > math.radians(1.0) and 2 * turned_in_roll(bank, cockpit.speed()) > to_go:
        bank *= 0.95
    return bank
