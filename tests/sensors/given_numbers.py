"""What a noise process makes of each of its random numbers alone: with that its covariance is exact."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.simulation.sensors.draws import SensorDraws


class GivenNumbers:
    """A generator whose standard normal numbers are given, to be taken one after another."""

    def __init__(self, numbers: FloatArray) -> None:
        self._left = numbers

    def standard_normal(self, shape: Any = ()) -> FloatArray:
        """Return the next numbers; there must be as many."""
        count = int(np.prod(shape))
        taken, self._left = self._left[:count], self._left[count:]
        return taken.reshape(shape)


def respond(name: str, count: int, simulate: Callable[[SensorDraws], FloatArray]) -> FloatArray:
    """Return what a linear process makes of each of the ``count`` numbers of a stream alone (M, count).

    Its covariance is ``response @ response.T``.
    """
    columns = []
    for numbers in np.eye(count):
        draws, given = SensorDraws(1, 0), GivenNumbers(numbers)
        draws.keep(name, lambda given=given: given, "stream")  # type: ignore[misc]
        columns.append(np.ravel(simulate(draws)))
    return np.column_stack(columns)
