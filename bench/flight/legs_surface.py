"""Legs by the surfaces themselves: guidance hands over softly, and takes back what is left of the flight."""

from __future__ import annotations

import math
from collections.abc import Generator

from bench.errors import FlightError
from bench.flight.cockpit import Cockpit
from bench.flight.shaping import GUIDANCE_RATE, Steps, clip, smooth, smoothstep, ticks, wait
from bench.legs import AileronRoll, Doublet, WindUpTurn

_HANDOVER = 0.4  # [s]
_EDGE = 0.15  # a deflection takes to build up [s]
_RECOVER = 60.0  # at most, until heading, altitude and bank are held again [s]
_ROLL_STOPS = 0.1  # time in which a roll rate dies out without aileron [s]
_PITCH_RATE = math.radians(10.0)  # fastest change of a pitch set-point [rad/s]
_ROLL_RATE = math.radians(45.0)  # fastest change of the bank of a wind-up turn [rad/s]
_LOAD_QUICKNESS = 1.0  # at which the elevator closes on a load factor [1/s]
_NEAR_LOAD = 0.2  # a load factor is reached within [1]
_LEVEL = math.radians(5.0)  # wings are level within [rad]
_NEAR_ALT = 3.0  # an altitude is held again within [m] ...
_NEAR_CLIMB = 1.0  # ... and this vertical speed [m/s]


def doublet(cockpit: Cockpit, leg: Doublet) -> Steps:
    """Hand one surface over, deflect it to and fro about where it was, take it back."""
    for _ in range(leg.count):
        begun = yield from _take(cockpit, leg.surface)
        last = 0.0
        for share in (leg.amplitude, -leg.amplitude, 0.0):
            for part in smooth(_EDGE):
                cockpit.direct[leg.surface](clip(begun + last + part * (share - last), 1.0))
                yield
            last = share
            if share:
                yield from wait(max(0.0, leg.width - _EDGE))
        yield from _give_back(cockpit, leg.surface)
        yield from wait(leg.pause)


def aileron_roll(cockpit: Cockpit, leg: AileronRoll) -> Steps:
    """Pitch up, roll around by aileron with elevator and rudder as they are, take the wings level."""
    for _ in range(leg.count):
        alt = cockpit.alt_wanted
        yield from _pitch_to(cockpit, leg.pitch)
        aileron = yield from _take(cockpit, "aileron")
        elevator = yield from _take(cockpit, "elevator")
        rolled, last = 0.0, cockpit.roll()
        side = math.copysign(1.0, leg.aileron)
        n, k, deflection = math.ceil(_EDGE * GUIDANCE_RATE), 0, 0.0
        for _ in ticks(_RECOVER):
            now = cockpit.roll()
            rolled += side * math.remainder(now - last, math.tau)
            last = now
            rate = side * cockpit.roll_rate()
            # what is left is rolled while the deflection is taken out and guidance takes over
            if rolled + rate * (0.5 * _EDGE + _ROLL_STOPS) >= math.tau:
                break
            k = min(n, k + 1)
            deflection = leg.aileron * k / n
            cockpit.direct["aileron"](clip(aileron + deflection, 1.0))
            cockpit.direct["elevator"](elevator)
            yield
        else:
            raise FlightError(f"rolled {math.degrees(rolled):.0f} of 360 deg only: {cockpit.state()}")
        for share in smooth(_EDGE):
            cockpit.direct["aileron"](clip(aileron + (1 - share) * deflection, 1.0))
            yield
        yield from _give_back(cockpit, "aileron", "elevator")
        cockpit.hold_alt(alt)
        yield from _recovered(cockpit)
        yield from wait(leg.pause)


def wind_up_turn(cockpit: Cockpit, leg: WindUpTurn) -> Steps:
    """Roll to the bank, pull by elevator until the load factor is there, hold it, roll out."""
    alt, side, bank = cockpit.alt_wanted, math.copysign(1.0, leg.bank), abs(leg.bank)
    cockpit.set_bank_limit(bank)
    cockpit.set_bank(cockpit.bank_wanted())
    cockpit.lat_mode(1)
    elevator = yield from _take(cockpit, "elevator")
    begun, reached = cockpit.load_factor(), 0.0
    roll_in = 1.5 * bank / _ROLL_RATE
    per_load, integral = cockpit.gain("elevator-turn-gain"), 0.0
    for k in ticks(roll_in + leg.rise + leg.hold):
        t = (
            k + 1
        ) / GUIDANCE_RATE  # rolls in first, at the load factor there is: the nose falls and airspeed comes
        rolled = smoothstep(min(1.0, t / roll_in))
        pulled = smoothstep(min(1.0, max(0.0, t - roll_in) / leg.rise))
        cockpit.set_bank(side * rolled * bank)
        wanted = begun + pulled * (leg.load - begun)
        load = cockpit.load_factor()
        reached = max(reached, load)
        integral += _LOAD_QUICKNESS * (wanted - load) / GUIDANCE_RATE
        cockpit.direct["elevator"](clip(elevator - per_load * (wanted - begun + integral), 1.0))
        yield
    if reached < leg.load - _NEAR_LOAD:
        raise FlightError(f"a load factor of {reached:.2f} of {leg.load:g} only: {cockpit.state()}")
    for share in smooth(roll_in):
        cockpit.set_bank(side * bank * (1 - share))
        yield
    yield from _give_back(cockpit, "elevator")
    cockpit.set_bank_limit(cockpit.aircraft.max_bank)
    cockpit.hold_heading()
    cockpit.hold_alt(alt)
    yield from _recovered(cockpit)


def _take(cockpit: Cockpit, surface: str) -> Generator[None, None, float]:
    """Take a surface over where it is; returns where that was."""
    begun = cockpit.surface[surface]()
    cockpit.direct[surface](begun)
    for share in smooth(_HANDOVER):
        cockpit.direct_share[surface](share)
        yield
    return begun


def _give_back(cockpit: Cockpit, *surfaces: str) -> Steps:
    for share in smooth(_HANDOVER):
        for surface in surfaces:
            cockpit.direct_share[surface](1 - share)
        yield


def _pitch_to(cockpit: Cockpit, pitch: float) -> Steps:
    begun = cockpit.pitch_wanted()
    cockpit.set_pitch(begun)
    cockpit.lon_mode(1)
    duration = 1.5 * abs(pitch - begun) / _PITCH_RATE
    for share in smooth(duration):
        cockpit.set_pitch(begun + share * (pitch - begun))
        yield
    yield from wait(cockpit.pitch_lag)


def _recovered(cockpit: Cockpit) -> Steps:
    """Fly on until the wings are level and the altitude is held."""
    for _ in ticks(_RECOVER):
        near = abs(cockpit.alt_wanted - cockpit.alt()) < _NEAR_ALT and abs(cockpit.climb()) < _NEAR_CLIMB
        if near and abs(cockpit.roll()) < _LEVEL:
            return
        yield
    raise FlightError(f"not recovered within {_RECOVER:g} s: {cockpit.state()}")
