"""Airspeed: a pitot tube in the air of the flight, and the computer behind it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.arrays import FloatArray
from bench.data import Trajectory
from bench.instruments import AirspeedData, AirspeedSpec
from bench.sensors.processes import lagged
from bench.sensors.timing import epoch_rows
from bench.signals import air
from bench.specs import SensorsSpec, stream


def report(truth: Trajectory, on_board: SensorsSpec, seed: int, run: int) -> tuple[AirspeedData, FloatArray]:
    """Return what the unit on board reports, and the error it had without noise, as `measure` does."""
    assert on_board.airspeed is not None  # or nobody asks
    return measure(truth, on_board.airspeed, seed, run)


def measure(truth: Trajectory, spec: AirspeedSpec, seed: int, run: int) -> tuple[AirspeedData, FloatArray]:
    """Return what the unit reports, and its slowly varying error.

    Parameters
    ----------
    truth : Trajectory
        With the air of the flight, at 20 Hz; a faster unit sees it straight between.
    spec : AirspeedSpec
        The unit. Static pressure and temperature are taken to be known: what the computer has wrong of them,
        and a static port that is off in proportion to the dynamic pressure, are scale factors.
    seed, run : int
        Which draw of the errors.

    Returns
    -------
    airspeed : AirspeedData
        At t = 1/rate, 2/rate, ... A pressure below 0 reads 0 m/s; a sample below ``min_speed`` or clipped at
        the range is not valid. ``sd`` is the noise at the measured speed: the slower, the larger.
    bias : (M,) array
        Error at these times without noise, rounding and clipping [m/s].

    Raises
    ------
    ValueError
        When the rate is above that of the truth, or nothing is known of the air.
    """
    if not len(truth.air.t):
        raise ValueError("airspeed: the truth says nothing of the air")
    rows = epoch_rows("airspeed", truth.t, spec.rate)
    t, around = truth.t[rows], truth.air
    pressure, temperature, true = (
        np.interp(t, around.t, column)
        for column in (around.pressure, around.temperature, around.airspeed_true)
    )
    felt = air.impact_pressure(around.airspeed_true, around.pressure, around.temperature)
    exact = np.interp(t, around.t, lagged(around.t, felt, felt[0], spec.lag))

    def drawn(name: str, sd: float, count: int) -> FloatArray:
        if sd <= 0:
            return np.zeros(count)
        noise: FloatArray = sd * stream(seed, run, f"airspeed.{name}").standard_normal(count)
        return noise

    zero = exact + drawn("pressure_bias", spec.pressure_bias_sd, 1)
    scale = 1.0 + drawn("scale_factor", spec.scale_factor_sd, 1)
    offset = drawn("bias", spec.bias_sd, 1)

    def computed(impact: FloatArray) -> FloatArray:
        return scale * air.true_airspeed(np.maximum(impact, 0.0), pressure, temperature) + offset

    impact = zero + drawn("pressure_white", spec.pressure_white_sd, len(t))
    if spec.quantization > 0:
        impact = spec.quantization * np.rint(impact / spec.quantization)
    clipped = np.zeros(len(t), bool)
    if spec.range > 0:
        clipped = np.abs(impact) > spec.range
        impact = np.clip(impact, -spec.range, spec.range)
    measured = computed(impact) + drawn("white", spec.white_sd, len(t))
    record = AirspeedData(
        t=t,
        t_arrival=t + spec.latency,
        valid=~clipped,
        airspeed_true=measured,
        sd=air.airspeed_sd(spec, np.maximum(measured, 0.0), pressure, temperature),
    )
    return read_out(record, spec), computed(zero) - true


def read_out(record: AirspeedData, spec: AirspeedSpec) -> AirspeedData:
    """Return a record as the unit puts it out: 0 m/s instead of less, not valid below ``min_speed``."""
    speed = np.maximum(record.airspeed_true, 0.0)
    return replace(record, airspeed_true=speed, valid=record.valid & (speed >= spec.min_speed))
