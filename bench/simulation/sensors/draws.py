"""Random numbers of one run in order of time, and the state of the sensors between pieces of a flight.

A sensor measures a flight in pieces: the first says where it begins, each further one goes on where the one
before ended. A flight in one piece and the same in many give the same bits, if pieces end on the 20 Hz of
the guidance: noise is drawn row by row, a process goes on from its state, and a constant is drawn once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.moved_runs import MovedRun
from bench.core.mathematics.random_streams import stream
from bench.core.mathematics.units import SAME_INSTANT
from bench.simulation.sensors.processes import simulate_gauss_markov
from bench.simulation.sensors.timing import find_rows

_Kept = TypeVar("_Kept")


class SensorDraws:
    """The streams of one run by name, each begun once, and the memory of the sensors.

    Parameters
    ----------
    seed, run : int
        Select the noise; the same pair gives the same bits. Each error has its own stream, so that one that
        is off leaves the noise of every other as it is.
    """

    def __init__(self, seed: int, run: int) -> None:
        self._seed, self._run, self._prefix = seed, run, ""
        self._memory: dict[tuple[str, str], Any] = {}

    def part(self, name: str) -> SensorDraws:
        """Return the streams and the memory with names that begin with ``name.``."""
        found = SensorDraws(self._seed, self._run)
        found._prefix, found._memory = f"{self._prefix}{name}.", self._memory
        return found

    def keep(self, name: str, make: Callable[[], _Kept], kind: str = "") -> _Kept:
        """Return what ``make`` returned for the first piece: a constant, or a state changed in place."""
        key = kind, self._prefix + name
        if key not in self._memory:
            self._memory[key] = make()
        return self._memory[key]  # type: ignore[no-any-return]

    def put(self, name: str, value: object) -> None:
        """Store another value under a name."""
        self._memory["", self._prefix + name] = value

    def stream(self, name: str) -> np.random.Generator:
        """Return the random stream of an error, continued from the pieces before."""
        seed, whole = self._seed, self._prefix + name

        def make(run: int) -> np.random.Generator:
            return stream(seed, run, whole)

        own = self._run
        return self.keep(name, lambda: own.open(make) if isinstance(own, MovedRun) else make(own), "stream")

    def constant(self, name: str, *shape: int) -> Any:
        """Return standard normal numbers that are drawn only once; without a shape, a single number."""
        return self.keep(name, lambda: self.stream(name).standard_normal(shape), "constant")

    def accumulate(self, name: str, steps: FloatArray) -> FloatArray:
        """Return the cumulative sum (K, ...) of steps (K, ...), continued from the pieces before."""
        total = self.keep(name, lambda: np.zeros((1, *steps.shape[1:])), "sum")
        summed: FloatArray = np.cumsum(np.concatenate([total, steps]), axis=0)[1:]
        if len(summed):
            total[:] = summed[-1]
        return summed

    def markov(self, name: str, steps: FloatArray, correlation: FloatArray, sd: FloatArray) -> FloatArray:
        """Continue the sum (B, 3) of Gauss-Markov stages of `simulate_gauss_markov`.

        ``steps`` (B,) is the time from the epoch before to each; that of the first epoch of all is not
        used: the stages are stationary from there on.
        """
        state = self.keep(name, lambda: np.zeros((len(sd), 3)), "state")
        begun = self.keep(name, list[bool], "begun")
        if not len(steps):
            return np.zeros((0, 3))
        before = state if begun else None
        out = simulate_gauss_markov(
            steps if begun else steps[1:], correlation, sd, self.stream(name), before, state
        )
        begun[:] = [True]
        return out

    def epochs(self, name: str, t: FloatArray, rate: float) -> tuple[IntArray, FloatArray]:
        """Return the rows of t (N,) at the epochs ``origin + k / rate`` of a piece, and the time before each.

        ``name`` is that of the instrument. The origin is the first epoch of the flight, from which the time
        before the first epoch counts. Errors as for `timing.find_rows`.
        """
        clock = self.keep(name, lambda: [float(t[0]), 0, float(t[0])], "epochs")
        origin, done, before = clock
        count = int((t[-1] - origin + SAME_INSTANT) * rate)
        if count <= done:
            return np.empty(0, np.int64), np.empty(0)
        rows = find_rows(name, t, origin + np.arange(done + 1, count + 1) / rate)
        at = np.concatenate([[before], t[rows]])
        clock[1:] = [count, float(at[-1])]
        return rows, at[1:] - at[:-1]
