"""Motion along a path from rest to rest, smooth up to the jerk, for what hovers.

The speed goes up as the quintic 10 x^3 - 15 x^4 + 6 x^5, stays, and comes down the same way: acceleration and
jerk are zero at both ends of each part, so that no corner comes into the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

_PEAK = 1.875  # largest slope of the quintic


@dataclass(frozen=True, slots=True)
class Ride:
    """A length [m or rad] covered at most at a speed and an acceleration; a short one reaches neither."""

    length: float
    speed: float  # [1/s of the length]
    gathering: float  # time in which the speed is reached [s]

    @classmethod
    def plan(cls, length: float, speed: float, acceleration: float) -> Ride:
        """Return the ride of a length; lengths may be 0.

        Examples
        --------
        >>> ride = Ride.plan(100.0, 10.0, 3.0)
        >>> ride.duration, [round(v, 3) for v in ride.at(ride.duration / 2)]
        (16.25, [50.0, 10.0, 0.0, 0.0])
        """
        speed = max(min(speed, math.sqrt(length * acceleration / _PEAK)), 1e-9)
        return cls(length, speed, _PEAK * speed / acceleration)

    @property
    def duration(self) -> float:
        """Return how long it takes [s]."""
        return self.length / self.speed + self.gathering

    def at(self, t: float) -> tuple[float, float, float, float]:
        """Return the length covered at a time [s] since its start, and its three derivatives."""
        rest = self.duration - t
        if min(t, rest) <= 0.0:
            return 0.0 if t <= 0.0 else self.length, 0.0, 0.0, 0.0
        if min(t, rest) >= self.gathering:
            return self.speed * (t - 0.5 * self.gathering), self.speed, 0.0, 0.0
        x, side = min(t, rest) / self.gathering, 1.0 if t < rest else -1.0
        covered = self.speed * self.gathering * x**4 * (2.5 - 3.0 * x + x * x)
        return (
            covered if t < rest else self.length - covered,
            self.speed * x**3 * (10.0 - 15.0 * x + 6.0 * x * x),
            side * self.speed / self.gathering * 30.0 * (x * (1.0 - x)) ** 2,
            self.speed / self.gathering**2 * 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
        )
