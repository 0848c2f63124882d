"""Definition of a block of states: names, parameters, effect of each state; for blocks see `state_blocks`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.sensor_specs import AssumedSpecs

STEADY, WARMTH, ABSOLUTE, SQUARE, CUBE = 6, 7, 8, 14, 20
"""What a state multiplies beside a rate (0 to 2) or specific force (3 to 5): 1, the temperature of the IMU
above its reference [K], and |x|, x^2 and ``x (4 (x / range)^2 - 3)`` of each rate or specific force x."""

_Figure = float | FloatArray  # the same for every state of a block, or one for each


@dataclass(frozen=True, slots=True)
class States:
    """One to three states of one name and the process they follow.

    A drive ``(state, error, rate)`` adds a state (0 to 2) times a measured rate (0 to 2), specific force
    (3 to 5) or another factor (`STEADY` and on) to an error of the gyros (0 to 2) or accelerometers (3 to 5).
    """

    name: str
    unit: str
    size: int
    variance: _Figure = 0.0  # at the start [unit^2]
    density: _Figure = 0.0  # of the white noise that drives it [unit^2/s]
    decay_time: _Figure = 0.0  # rate at which a Gauss-Markov state decays by time [1/s]
    decay_distance: _Figure = 0.0  # and by distance over ground [1/m]
    stationary: _Figure = 0.0  # variance that a Gauss-Markov state tends to, in place of the density [unit^2]
    drives: tuple[tuple[int, int, int], ...] = ()
    value: _Figure = 0.0  # at the start [unit]


@dataclass(frozen=True, slots=True)
class Block:
    """States that are estimated together or not at all."""

    option: str  # of the compiled filters, that asks for it
    states: Callable[[AssumedSpecs], Sequence[States]]
    takes: tuple[str, ...] = ()  # errors that it models, as `aiding_sensors` names them
    records: tuple[str, ...] = ()  # of `SensorData`, one of which has to be in use; none: always there


def assumed(specs: AssumedSpecs, name: str) -> Any:
    """Return the datasheet of a sensor in use.

    Raises
    ------
    ValueError
        If the filter was given none.
    """
    spec = getattr(specs, name)
    if spec is None:
        raise ValueError(f"the record holds {name} data, but sensors.assumed names no {name} unit")
    return spec
