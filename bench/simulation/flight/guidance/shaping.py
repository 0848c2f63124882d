"""Smooth set-points over time, one value per epoch of the sequencer, with zero slope at both ends."""

from __future__ import annotations

import math
from collections.abc import Iterator

GUIDANCE_RATE = 20.0
"""Epochs per second at which set-points are written, and air data and controls recorded [Hz]."""

G = 9.81  # [m/s^2]
ROLL_RATE = math.radians(20.0)  # fastest change of a bank set-point [rad/s]

Steps = Iterator[None]
"""A leg on its way: each step is one time."""


def smooth(duration: float) -> Iterator[float]:
    """Yield 0 to 1 with zero slope at both ends, one value per time, the last one 1."""
    n = max(1, math.ceil(duration * GUIDANCE_RATE))
    for k in range(1, n + 1):
        yield smoothstep(k / n)


def smoothstep(x: float) -> float:
    """Return the cubic from 0 to 1 over [0, 1] with zero slope at both ends.

    Examples
    --------
    >>> smoothstep(0.0), smoothstep(0.5), smoothstep(1.0)
    (0.0, 0.5, 1.0)
    """
    return x * x * (3 - 2 * x)


def clip(value: float, limit: float) -> float:
    """Return the value within plus and minus the limit."""
    return max(-limit, min(limit, value))


def ticks(duration: float) -> range:
    """Return the epochs of a duration [s]."""
    return range(math.ceil(duration * GUIDANCE_RATE))


def wait(duration: float) -> Steps:
    """Let a duration [s] pass."""
    for _ in range(round(duration * GUIDANCE_RATE)):
        yield


def roll_time(bank: float) -> float:
    """Return the time to roll into or out of a bank [s]."""
    return max(1.0, 1.5 * bank / ROLL_RATE)


def turned_in_roll(bank: float, speed: float) -> float:
    """Heading change while a bank is rolled in or out [rad]."""
    n = 40
    mean_tan = sum(math.tan(bank * smoothstep(k / n)) for k in range(n + 1)) / (n + 1)
    return G / speed * mean_tan * roll_time(bank)
