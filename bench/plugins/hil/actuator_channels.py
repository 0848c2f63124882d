"""Which output of an autopilot moves which control."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from bench.core.words.exceptions import ConfigError
from bench.simulation.flight.guidance.steering import SurfaceCommand

_SHOWN = 20  # of a wrong text, in a message


@dataclass(frozen=True, slots=True)
class ActuatorChannels:
    """Assignment of the outputs of an autopilot, from 1; a negative number reverses the sign.

    The defaults are those of PX4's airframe 1033_jsbsim_rascal with the signs of px4-jsbsim-bridge.
    """

    aileron: int = -6
    elevator: int = -8
    rudder: int = -3
    throttle: int = 5

    @classmethod
    def parse(cls, text: str, base: ActuatorChannels | None = None, most: int = 16) -> ActuatorChannels:
        """Read a list like ``aileron=-6,throttle=5``; ``base`` has what it leaves out.

        ``most`` is the number of outputs.

        Raises
        ------
        ConfigError
            If the text is not such a list.
        """
        found: dict[str, int] = {}
        names = tuple(cls.__slots__)
        for part in filter(None, text.split(",")):
            name, _, number = part.partition("=")
            sign, digits = number[:1], number.removeprefix("-")
            if name not in names:
                raise ConfigError(f"--channels: {name[:_SHOWN]!r} must be one of {', '.join(names)}")
            if name in found:
                raise ConfigError(f"--channels: {name} is given twice")
            short = digits.isascii() and digits.isdecimal() and len(digits) <= 2
            if not (short and 1 <= int(digits) <= most):
                raise ConfigError(
                    f"--channels: {name}={number[:_SHOWN]!r} must be a channel, 1 to {most} or -1 to -{most}"
                )
            found[name] = -int(digits) if sign == "-" else int(digits)
        return replace(base or cls(), **found)

    def take(self, controls: Sequence[float]) -> SurfaceCommand:
        """Return the command from the outputs, -1 to 1, the throttle 0 to 1."""

        def read(channel: int) -> float:
            return math.copysign(1.0, channel) * controls[abs(channel) - 1]

        return SurfaceCommand(*map(read, (self.aileron, self.elevator, self.rudder, self.throttle)))


ARDUPILOT = ActuatorChannels(aileron=1, elevator=-2, rudder=-4, throttle=3)
"""ArduPlane's outputs; reversed as SERVO2_REVERSED and SERVO4_REVERSED of its plane-jsbsim.parm."""
