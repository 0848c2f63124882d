"""Common parts of the aiding sensors: epochs, drawn errors, noise, resolution, times of arrival."""

from __future__ import annotations

from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.instruments import INSTRUMENTS
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.processes import apply_lag


class Sampler:
    """Epochs of an instrument at t = 1/rate, 2/rate, ..., and its errors in one run.

    Parameters
    ----------
    name : str
        Name of the instrument.
    truth : Trajectory
        The motion, or a piece of it.
    spec : object
        Its spec, with ``rate`` and ``latency``.
    draws : SensorDraws
        The errors of the run. Each has its own stream, ``<name>.<error>``; one that is off draws nothing.

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """

    def __init__(self, name: str, truth: Trajectory, spec: Any, draws: SensorDraws) -> None:
        self._name, self._spec, self.draws = name, spec, draws.part(name)
        self.rows, self.steps = self.draws.epochs(name, truth.t, spec.rate)
        self.t = truth.t[self.rows]

    def draw(self, error: str, sd: float, *shape: int) -> FloatArray:
        """Draw constant normal numbers of a standard deviation; 0 if it is 0."""
        if sd <= 0:
            return np.zeros(shape)
        constant: FloatArray = sd * np.asarray(self.draws.constant(error, *shape))
        return constant

    def draw_white(self, error: str, sd: float, *width: int) -> FloatArray:
        """Draw white noise (M, *width); 0 if its standard deviation is 0."""
        shape = (len(self.t), *width)
        if sd <= 0:
            return np.zeros(shape)
        noise: FloatArray = sd * self.draws.stream(error).standard_normal(shape)
        return noise

    def draw_walk(self, error: str, density: float) -> FloatArray:
        """Draw a random walk (M,) with sd ``density sqrt(time since the start of the truth)``."""
        if density <= 0:
            return np.zeros(len(self.t))
        walk: FloatArray = density * self.draws.accumulate(
            error, np.sqrt(self.steps) * self.draw_white(error, 1.0)
        )
        return walk

    def lag(self, name: str, t: FloatArray, target: FloatArray, time: float) -> FloatArray:
        """Return the first-order lag (B,) of a quantity (B,) at epochs t (B,), as `apply_lag` does.

        It begins without a lag; the first epoch of a further piece is the last of the piece before.
        """
        state = self.draws.keep(name, lambda: target[:1].copy())
        found = apply_lag(t, target, float(state[0]), time)
        state[:] = found[-1]
        return found

    def report(self, values: FloatArray, valid: BoolArray | None = None) -> Any:
        """Return the record of values (M, ...): white noise is added, then they are rounded."""
        spec, row = self._spec, INSTRUMENTS[self._name]
        if spec.white_sd > 0:
            values = values + self.draw_white("white", spec.white_sd, *values.shape[1:])
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
