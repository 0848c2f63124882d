"""Barometric altitude: ellipsoidal height, random-walk bias, white noise (A-5.3.1, A-5.3.2)."""

from __future__ import annotations

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.instruments import BaroData, BaroSpec
from bench.core.records.sensor_specs import SensorsSpec
from bench.simulation.sensors import static_pressure
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler


def report(truth: Trajectory, on_board: SensorsSpec, draws: SensorDraws) -> tuple[BaroData, FloatArray]:
    """Simulate the barometer on board; return its record and its slowly varying error."""
    unit = on_board.baro
    assert unit is not None  # otherwise `sense` does not call this
    if unit.physical is None:
        return measure(truth, unit, draws)
    return static_pressure.measure(truth, unit, on_board.qnh, on_board.static_port_b, draws)


def measure(truth: Trajectory, spec: BaroSpec, draws: SensorDraws) -> tuple[BaroData, FloatArray]:
    """Simulate a barometer; return its record and its bias (M,) [m]. Errors as for `Sampler`.

    The bias walks continuously in time, from ``bias_sd`` at the start of the truth: its sd grows by
    ``bias_walk sqrt(dt)``.
    """
    samples = Sampler("baro", truth, spec, draws)
    bias = samples.draw("bias", spec.bias_sd) + samples.draw_walk("walk", spec.bias_walk)
    return samples.report(truth.lla[samples.rows, 2] + bias), bias
