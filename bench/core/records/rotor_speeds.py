"""The rotors of a multirotor: four in an X, in the order of aircraft/systems/multirotor.xml."""

from __future__ import annotations

from functools import cache

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.fields import Record, column, declared

ROTORS = ("ahead_right", "ahead_left", "behind_left", "behind_right")
"""Places of the rotors, in the order of all columns."""
AHEAD, RIGHT = (1.0, 1.0, -1.0, -1.0), (1.0, -1.0, -1.0, 1.0)
"""Signs of the places of the rotors along x and y."""
SENSES = (-1.0, 1.0, -1.0, 1.0)
"""Senses in which the rotors turn, about z down."""


@declared
class Rotors(Record):
    """Speeds of the rotors at the times of the truth; without rows if there are none."""

    t: FloatArray = column("t_s")  # (N,) [s]
    # (N, 4) [rad/s]
    speed: FloatArray = column(*(f"rotor_speed_{place}_rad_s" for place in ROTORS), shape=(len(ROTORS),))

    def __post_init__(self) -> None:
        self._freeze(finite=True)


@cache
def no_rotors() -> Rotors:
    """Return a record without rows, for what has no rotors."""
    return Rotors(np.empty(0), np.empty((0, len(ROTORS))))
