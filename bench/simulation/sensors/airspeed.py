"""Airspeed: a pitot tube in the air of the flight, and its air data computer."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.instruments import AirspeedData, AirspeedSpec
from bench.core.records.sensor_specs import SensorsSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler, round_to
from bench.simulation.signals import air


def report(truth: Trajectory, on_board: SensorsSpec, draws: SensorDraws) -> tuple[AirspeedData, FloatArray]:
    """Simulate the airspeed sensor on board; return its record and its slowly varying error."""
    assert on_board.airspeed is not None  # otherwise `sense` does not call this
    return measure(truth, on_board.airspeed, draws)


def measure(truth: Trajectory, spec: AirspeedSpec, draws: SensorDraws) -> tuple[AirspeedData, FloatArray]:
    """Simulate an airspeed sensor; return its record and its slowly varying error.

    The parameters are those of `Sampler`, with the air of the flight at 20 Hz, interpolated linearly. Static
    pressure and temperature are assumed to be known exactly; the scale factor covers their errors and a
    static port error in proportion to the dynamic pressure.

    Returns
    -------
    airspeed : AirspeedData
        A pressure below 0 reads 0 m/s. A sample below ``min_speed`` or clipped at
        the range is not valid. ``sd`` is the noise at the measured speed; it grows as the speed falls.
    bias : (M,) array
        Error at these times without noise, rounding and clipping [m/s].

    Raises
    ------
    ValueError
        If the rate is above that of the truth, or the truth has no air data.
    """
    if not len(truth.air.t):
        raise ValueError("airspeed: the truth has no air data")
    samples = Sampler("airspeed", truth, spec, draws)
    t, around = samples.t, truth.air
    pressure, temperature, true = (
        np.interp(t, around.t, column)
        for column in (around.pressure, around.temperature, around.airspeed_true)
    )
    true_impact = air.impact_pressure(around.airspeed_true, around.pressure, around.temperature)
    exact = np.interp(t, around.t, samples.lag("impact", around.t, true_impact, spec.lag))

    zero = exact + samples.draw("pressure_bias", spec.pressure_bias_sd)
    scale = 1.0 + samples.draw("scale_factor", spec.scale_factor_sd)
    offset = samples.draw("bias", spec.bias_sd)

    def compute_speed(impact: FloatArray) -> FloatArray:
        return scale * air.true_airspeed(np.maximum(impact, 0.0), pressure, temperature) + offset

    impact = zero + samples.draw_white("pressure_white", spec.pressure_white_sd)
    impact = round_to(impact, spec.quantization)
    clipped = np.zeros(len(t), bool)
    if spec.range > 0:
        clipped = np.abs(impact) > spec.range
        impact = np.clip(impact, -spec.range, spec.range)
    measured = compute_speed(impact) + samples.draw_white("white", spec.white_sd)
    record = AirspeedData(
        t=t,
        t_arrival=t + spec.latency,
        valid=~clipped,
        airspeed_true=measured,
        sd=air.airspeed_sd(spec, np.maximum(measured, 0.0), pressure, temperature),
    )
    return limit_output(record, spec), compute_speed(zero) - true


def limit_output(record: AirspeedData, spec: AirspeedSpec) -> AirspeedData:
    """Set negative speeds to 0 m/s and clear ``valid`` below ``min_speed``."""
    speed = np.maximum(record.airspeed_true, 0.0)
    return replace(record, airspeed_true=speed, valid=record.valid & (speed >= spec.min_speed))
