"""What the aiding instruments share: epochs, drawn errors, noise, resolution, times of arrival."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.data import Trajectory
from bench.instruments import INSTRUMENTS
from bench.sensors.timing import find_epoch_rows
from bench.specs import stream


class Sampler:
    """Epochs of an instrument at t = 1/rate, 2/rate, ..., and its errors in one run.

    Parameters
    ----------
    name : str
        Name of the instrument.
    truth : Trajectory
        The motion.
    spec : object
        Its spec, with ``rate`` and ``latency``.
    seed, run : int
        Select the draw. Each error has its own stream, ``<name>.<error>``; one that is off draws nothing.

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """

    def __init__(self, name: str, truth: Trajectory, spec: Any, seed: int, run: int) -> None:
        self._name, self._spec, self._seed, self._run = name, spec, seed, run
        self.rows = find_epoch_rows(name, truth.t, spec.rate)
        self.t = truth.t[self.rows]
        self._steps = np.diff(self.t, prepend=truth.t[0])

    def draw(self, error: str, sd: float, *shape: int) -> FloatArray:
        """Draw normal numbers with a standard deviation; 0 if it is 0."""
        if sd <= 0:
            return np.zeros(shape)
        noise: FloatArray = sd * stream(self._seed, self._run, f"{self._name}.{error}").standard_normal(shape)
        return noise

    def draw_walk(self, error: str, density: float) -> FloatArray:
        """Draw a random walk (M,) with sd ``density sqrt(time since the start of the truth)``."""
        if density <= 0:
            return np.zeros(len(self.t))
        steps = np.sqrt(self._steps) * self.draw(error, 1.0, len(self.t))
        walk: FloatArray = density * np.cumsum(steps)
        return walk

    def report(self, values: FloatArray, valid: BoolArray | None = None) -> Any:
        """Return the record of values (M, ...): white noise is added, then they are rounded."""
        spec, row = self._spec, INSTRUMENTS[self._name]
        if spec.white_sd > 0:
            values = values + self.draw("white", spec.white_sd, *values.shape)
        return row.record(
            t=self.t,
            t_arrival=self.t + spec.latency,
            valid=np.ones(len(self.t), bool) if valid is None else valid,
            **{row.value: round_to(values, spec.quantization), "sd": np.full(len(self.t), spec.white_sd)},
        )


def round_to(values: FloatArray, resolution: float) -> FloatArray:
    """Round values to multiples of a resolution; 0 leaves them."""
    rounded: FloatArray = resolution * np.rint(values / resolution) if resolution > 0 else values
    return rounded
