"""Legs by direct surface commands: guidance hands over smoothly, and recovers the flight afterwards."""

from __future__ import annotations

import math
from collections.abc import Generator
from dataclasses import dataclass
from typing import Annotated, Literal

from bench.core.records.flight_specs import SECONDS, Leg, LegStart
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.shaping import (
    GUIDANCE_RATE,
    Steps,
    clip,
    smooth,
    smoothstep,
    ticks,
    wait,
)
from bench.simulation.flight.legs.keys import AtSpeed, Key, format_deg, side_of, write_key

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

_Pause = Annotated[float, Key("pause_s", "time of guided flight between and after the maneuvers", *SECONDS)]
_NO_DEFLECTION = "a deflection of 0 does nothing"


@dataclass(frozen=True)
class Doublet(Leg):
    """Deflect a surface to one side, then to the other, without guidance of this surface."""

    kind = "doublet"
    surface: Annotated[Literal["aileron", "elevator", "rudder"], Key("surface", "control surface")]
    amplitude: Annotated[
        float,
        Key("amplitude", "fraction of its travel, positive rolls right, pitches down, yaws left", -1, 1),
    ]
    width: Annotated[float, Key("width_s", "duration of each half", 0.2, 10)]
    count: Annotated[int, Key("count", "number of doublets", 1, 1000)] = 1
    pause: _Pause = 8.0

    def describe(self) -> str:
        return f"{self.count} of {self.surface} {self.amplitude:+.3g}, {self.width:g} s each way"

    def check(self, start: LegStart) -> list[str]:
        return [] if self.amplitude else [_NO_DEFLECTION]

    def fly(self, cockpit: Cockpit) -> Steps:
        """Deflect the surface to both sides of its present deflection, then return it to guidance."""
        for _ in range(self.count):
            begun = yield from _take(cockpit, self.surface)
            last = 0.0
            for share in (self.amplitude, -self.amplitude, 0.0):
                for part in smooth(_EDGE):
                    cockpit.direct[self.surface](clip(begun + last + part * (share - last), 1.0))
                    yield
                last = share
                if share:
                    yield from wait(max(0.0, self.width - _EDGE))
            yield from _give_back(cockpit, self.surface)
            yield from wait(self.pause)


@dataclass(frozen=True)
class AileronRoll(AtSpeed):
    """Raise the nose, roll all the way around by aileron alone, recover."""

    kind = "aileron-roll"
    any_bank = True
    aileron: Annotated[float, Key("aileron", "fraction of its travel, positive to the right", -1, 1)]
    count: Annotated[int, Key("count", "number of rolls, one after the other", 1, 1000)] = 1
    pitch: Annotated[float, Key("pitch_deg", "pitch before the roll", 0, 30)] = math.radians(15.0)
    pause: _Pause = 8.0

    def describe(self) -> str:
        return f"{self.count} {side_of(self.aileron)}, aileron {abs(self.aileron):.3g}"

    def check(self, start: LegStart) -> list[str]:
        if not self.aileron:
            return [_NO_DEFLECTION]
        little = abs(self.aileron) < 0.2
        return [f"{write_key(self, 'aileron')} is too little to roll around; 0.2 to 1"] if little else []

    def fly(self, cockpit: Cockpit) -> Steps:
        """Pitch up, roll around with fixed elevator and rudder, level the wings."""
        for _ in range(self.count):
            alt = cockpit.alt_wanted
            yield from _pitch_to(cockpit, self.pitch)
            aileron = yield from _take(cockpit, "aileron")
            elevator = yield from _take(cockpit, "elevator")
            rolled, last = 0.0, cockpit.roll()
            side = math.copysign(1.0, self.aileron)
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
                deflection = self.aileron * k / n
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
            yield from wait(self.pause)


@dataclass(frozen=True)
class WindUpTurn(AtSpeed):
    """Tighten a turn by elevator to a load factor, hold it, roll out."""

    kind = "wind-up-turn"
    bank: Annotated[float, Key("bank_deg", "bank angle, 20 or more in size, positive to the right", -85, 85)]
    load: Annotated[float, Key("load_factor", "load factor to reach", 1.2, 9)]
    rise: Annotated[float, Key("rise_s", "time to reach the load factor", 1, 60)] = 5.0
    hold: Annotated[float, Key("hold_s", "duration at the load factor", 0.1, 60)] = 2.0

    def describe(self) -> str:
        return f"{side_of(self.bank)} to {self.load:g} g at {format_deg(abs(self.bank))} bank"

    def check(self, start: LegStart) -> list[str]:
        flat = abs(self.bank) < math.radians(20.0)
        return [f"{write_key(self, 'bank')} must be 20 deg or more to either side"] if flat else []

    def fly(self, cockpit: Cockpit) -> Steps:
        """Roll to the bank, pull by elevator up to the load factor, hold it, roll out."""
        alt, side, bank = cockpit.alt_wanted, math.copysign(1.0, self.bank), abs(self.bank)
        cockpit.set_bank_limit(bank)
        cockpit.set_bank(cockpit.bank_wanted())
        cockpit.lat_mode(1)
        elevator = yield from _take(cockpit, "elevator")
        begun, reached = cockpit.load_factor(), 0.0
        roll_in = 1.5 * bank / _ROLL_RATE
        per_load, integral = cockpit.gain("elevator-turn-gain"), 0.0
        for k in ticks(roll_in + self.rise + self.hold):
            # rolls in first, at the load factor there is: the nose falls and airspeed comes
            t = (k + 1) / GUIDANCE_RATE
            rolled = smoothstep(min(1.0, t / roll_in))
            pulled = smoothstep(min(1.0, max(0.0, t - roll_in) / self.rise))
            cockpit.set_bank(side * rolled * bank)
            wanted = begun + pulled * (self.load - begun)
            load = cockpit.load_factor()
            reached = max(reached, load)
            integral += _LOAD_QUICKNESS * (wanted - load) / GUIDANCE_RATE
            cockpit.direct["elevator"](clip(elevator - per_load * (wanted - begun + integral), 1.0))
            yield
        if reached < self.load - _NEAR_LOAD:
            raise FlightError(f"a load factor of {reached:.2f} of {self.load:g} only: {cockpit.state()}")
        for share in smooth(roll_in):
            cockpit.set_bank(side * bank * (1 - share))
            yield
        yield from _give_back(cockpit, "elevator")
        cockpit.set_bank_limit(cockpit.aircraft.max_bank)
        cockpit.hold_heading()
        cockpit.hold_alt(alt)
        yield from _recovered(cockpit)


def _take(cockpit: Cockpit, surface: str) -> Generator[None, None, float]:
    """Take over a surface at its present deflection, and return the deflection."""
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
    """Continue until the wings are level and the commanded altitude is reached."""

    def level() -> bool:
        near = abs(cockpit.alt_wanted - cockpit.alt()) < _NEAR_ALT and abs(cockpit.climb()) < _NEAR_CLIMB
        return near and abs(cockpit.roll()) < _LEVEL

    yield from cockpit.wait_until(level, _RECOVER, "not recovered")
