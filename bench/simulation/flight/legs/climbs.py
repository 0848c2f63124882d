"""Legs to another altitude."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar

from bench.core.records.flight_specs import ALTITUDES, CLIMBS, FIXED_WING, ROTORCRAFT, LegStart
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import Cockpit
from bench.simulation.flight.guidance.shaping import Steps, smooth, ticks
from bench.simulation.flight.legs.keys import AtSpeed, ClimbRate, Key, write_key
from bench.simulation.flight.rotor_cockpit import RotorCockpit

_CLIMB_CHANGE = 1.0  # fastest change of a climb set-point [m/s^2]
_NEAR_ALT = 2.0  # an altitude is reached within [m]
_PATIENCE = 120.0  # how much longer than planned a leg may take [s]


@dataclass(frozen=True)
class _AltitudeChange(AtSpeed):
    flown_by = (FIXED_WING, *ROTORCRAFT)
    sign: ClassVar[int]  # 1 up, -1 down
    to_alt: Annotated[float, Key("to_alt_m", "ellipsoidal altitude", *ALTITUDES)]
    rate: ClimbRate

    def describe(self) -> str:
        return f"to {self.to_alt:g} m at {self.rate:g} m/s"

    def check(self, start: LegStart) -> list[str]:
        if not self.sign * (self.to_alt - start.alt) <= 0:  # NaN where the leg before follows the ground
            return []
        side = "above" if self.sign > 0 else "below"
        return [f"{write_key(self, 'to_alt')} is not {side} the {start.alt:g} m before it"]

    def alt_after(self, start: LegStart) -> float:
        return self.to_alt

    def fly(self, cockpit: Cockpit | RotorCockpit) -> Steps:
        if isinstance(cockpit, RotorCockpit):
            return cockpit.go_to_height(self.to_alt, self.rate)
        return self._fly_on_wings(cockpit)

    def _fly_on_wings(self, cockpit: Cockpit) -> Steps:
        # a short way is climbed slower, so that the ramps fit into it; 0.1 m/s when there is no way at all
        fits = max(0.1, math.sqrt(abs(self.to_alt - cockpit.alt()) * _CLIMB_CHANGE / 2))
        rate = self.sign * min(self.rate, fits)
        cockpit.set_climb(0.0)
        cockpit.lon_mode(2)
        for share in smooth(climb_ramp(rate)):
            cockpit.set_climb(share * rate)
            yield
        yield from level_off(cockpit, self.to_alt, rate)


@dataclass(frozen=True)
class Climb(_AltitudeChange):
    """Climb on the present heading to an altitude."""

    kind = "climb"
    sign = 1


@dataclass(frozen=True)
class Descend(_AltitudeChange):
    """Descend on the present heading to an altitude."""

    kind = "descend"
    sign = -1
    rate: Annotated[
        float, Key("rate_mps", "descent rate, limited by the aircraft", *CLIMBS, most="max_descent")
    ]


def climb_ramp(rate: float) -> float:
    """Return the time to build up a vertical speed [m/s] [s]."""
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
    yield from cockpit.wait_until(
        lambda: abs(alt - cockpit.alt()) < _NEAR_ALT, _PATIENCE, f"{alt:g} m not held"
    )
