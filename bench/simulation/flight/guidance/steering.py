"""External commands to the controls of a flight: attitude and throttle, or surfaces and throttle.

A command acts from the tick after its turn on, 50 ms after the time that it answers. The loops of guidance
smooth it: bank and pitch by the lags of their set-points, surfaces by 50 ms.
"""

from __future__ import annotations

import math
from dataclasses import astuple, dataclass

from bench.core.records.flight_specs import Leg
from bench.core.words.exceptions import FlightError
from bench.simulation.flight.cockpit import SURFACES, Cockpit
from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE, Steps


@dataclass(frozen=True, slots=True)
class AttitudeCommand:
    """Targets that the inner loops of guidance fly."""

    bank: float  # right wing down [rad]
    pitch: float  # nose up [rad]
    throttle: float  # 0 to 1

    def describe_wrong(self) -> str:
        """Return the error of the command in words that follow "with"; empty if it is valid."""
        if not all(map(math.isfinite, astuple(self))):
            return "NaN in it"
        if abs(self.bank) > math.pi or abs(self.pitch) > math.pi / 2:
            return "a bank beyond pi or a pitch beyond pi / 2"
        return "" if 0 <= self.throttle <= 1 else "a throttle that is not 0 to 1"

    def write(self, cockpit: Cockpit) -> None:
        """Let the control loops move all surfaces to these targets."""
        for surface in SURFACES:
            cockpit.direct_share[surface](0.0)
        cockpit.set_bank(self.bank)
        cockpit.lat_mode(1)
        cockpit.set_pitch(self.pitch)
        cockpit.lon_mode(1)
        cockpit.thr_mode(0)
        cockpit.set_throttle(self.throttle)


@dataclass(frozen=True, slots=True)
class SurfaceCommand:
    """Surfaces as normalized commands of JSBSim, without any control loop."""

    aileron: float  # -1 to 1
    elevator: float
    rudder: float
    throttle: float  # 0 to 1

    def describe_wrong(self) -> str:
        """Return the error of the command in words that follow "with"; empty if it is valid."""
        *surfaces, throttle = astuple(self)
        if not all(map(math.isfinite, astuple(self))):
            return "NaN in it"
        if any(abs(value) > 1 for value in surfaces):
            return "a surface that is not -1 to 1"
        return "" if 0 <= throttle <= 1 else "a throttle that is not 0 to 1"

    def write(self, cockpit: Cockpit) -> None:
        """Set the surfaces."""
        for surface in SURFACES:
            cockpit.direct[surface](getattr(self, surface))
            cockpit.direct_share[surface](1.0)
        cockpit.thr_mode(0)
        cockpit.set_throttle(self.throttle)


class Commands:
    """The present command, and whether more can come."""

    def __init__(self) -> None:
        self.wanted: AttitudeCommand | SurfaceCommand | None = None
        self.ended = ""  # why no more can come

    def __repr__(self) -> str:
        """Return the same text for all commands, because they are no part of a plan."""
        return "Commands"  # where a plan is hashed


@dataclass(frozen=True)
class Commanded(Leg):
    """Fly by commands; until the first one hold heading, altitude and airspeed."""

    kind = "commands"
    any_bank = True
    duration: float
    commands: Commands

    def describe(self) -> str:
        """Return the duration of the leg in words."""
        return f"of a client, {self.duration:g} s"

    def fly(self, cockpit: Cockpit) -> Steps:
        """Write the present command at each time; a client that has disconnected ends the flight."""
        for _ in range(round(self.duration * GUIDANCE_RATE)):
            if self.commands.ended:
                raise FlightError(self.commands.ended)
            if self.commands.wanted is not None:
                self.commands.wanted.write(cockpit)
            yield
