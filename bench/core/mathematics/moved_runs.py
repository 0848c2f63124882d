"""Runs with a mixture of the normal noise of other runs, for Markov chains over noise."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np


class MovedRun(int):
    """The number of a run that has a weighted sum of the noises of several runs as its normal noise.

    The squares of the weights sum to 1, so the noise of any such run is distributed as that of a plain one.
    All other random numbers, such as a uniform phase, are from the first run.

    Examples
    --------
    >>> MovedRun(3).move(7, 0.6).parts
    ((3, 0.8), (7, 0.6))
    """

    parts: tuple[tuple[int, float], ...]

    def __new__(cls, run: int, parts: tuple[tuple[int, float], ...] = ()) -> MovedRun:
        """Make a run; without ``parts``, the plain run."""
        made = super().__new__(cls, run)
        made.parts = parts or ((run, 1.0),)
        return made

    def move(self, run: int, step: float) -> MovedRun:
        """Return the run moved towards another; a step of 1 is the other run."""
        kept = math.sqrt(1.0 - step * step)
        return MovedRun(int(self), (*((one, kept * weight) for one, weight in self.parts), (run, step)))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MovedRun) and self.parts == other.parts

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash(self.parts)

    def __getnewargs__(self) -> tuple[int, tuple[tuple[int, float], ...]]:  # type: ignore[override]
        return int(self), self.parts

    def open(self, make: Callable[[int], np.random.Generator]) -> np.random.Generator:
        """Return the random stream of the run, from those that ``make`` returns for its parts."""
        return _MixedGenerator([(make(run), weight) for run, weight in self.parts])


class _MixedGenerator(np.random.Generator):
    """A generator of weighted sums of the normal numbers of other generators."""

    def __init__(self, parts: list[tuple[np.random.Generator, float]]) -> None:
        super().__init__(parts[0][0].bit_generator)
        self._parts = parts

    def standard_normal(self, size: Any = None, dtype: Any = np.float64, out: Any = None) -> Any:
        """Return normal numbers, as `numpy.random.Generator.standard_normal`."""
        size = np.shape(out) if out is not None else size
        total = sum(weight * one.standard_normal(size, dtype) for one, weight in self._parts)
        if out is None:
            return total
        out[...] = total
        return out

    def normal(self, loc: Any = 0.0, scale: Any = 1.0, size: Any = None) -> Any:
        """Return normal numbers, as `numpy.random.Generator.normal`."""
        return loc + scale * self.standard_normal(size)
