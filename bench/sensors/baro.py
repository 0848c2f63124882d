"""Barometric altitude: ellipsoidal height, random-walk bias, white noise (A-5.3.1, A-5.3.2)."""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray
from bench.data import Trajectory
from bench.instruments import BaroData, BaroSpec
from bench.sensors import static_pressure
from bench.sensors.timing import find_epoch_rows
from bench.specs import SensorsSpec, stream


def report(truth: Trajectory, on_board: SensorsSpec, seed: int, run: int) -> tuple[BaroData, FloatArray]:
    """Simulate the barometer on board; return its record and its slowly varying error."""
    unit = on_board.baro
    assert unit is not None  # otherwise `sense` does not call this
    if unit.physical is None:
        return measure(truth, unit, seed, run)
    return static_pressure.measure(truth, unit, on_board.qnh, on_board.static_port_b, seed, run)


def measure(truth: Trajectory, spec: BaroSpec, seed: int, run: int) -> tuple[BaroData, FloatArray]:
    """Simulate a barometer; return its record and its bias.

    Parameters
    ----------
    truth : Trajectory
        The motion.
    spec : BaroSpec
        The instrument. The bias walks continuously in time: its sd grows by ``bias_walk sqrt(dt)``.
    seed, run : int
        Select the draw of the errors.

    Returns
    -------
    baro : BaroData
        At t = 1/rate, 2/rate, ..., rounded to the resolution.
    bias : (M,) array
        Bias at these times [m]; ``bias_sd`` applies to the start of the truth.

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """
    rows = find_epoch_rows("baro", truth.t, spec.rate)
    t = truth.t[rows]
    bias = np.zeros(len(t))
    if spec.bias_sd > 0:
        bias += spec.bias_sd * stream(seed, run, "baro.bias").standard_normal()
    if spec.bias_walk > 0:
        steps = stream(seed, run, "baro.walk").standard_normal(len(t))
        bias += spec.bias_walk * np.cumsum(np.sqrt(np.diff(t, prepend=truth.t[0])) * steps)
    alt_baro = truth.lla[rows, 2] + bias
    if spec.white_sd > 0:
        alt_baro += spec.white_sd * stream(seed, run, "baro.white").standard_normal(len(t))
    if spec.quantization > 0:
        alt_baro = spec.quantization * np.rint(alt_baro / spec.quantization)
    baro = BaroData(
        t=t,
        t_arrival=t + spec.latency,
        valid=np.ones(len(t), bool),
        alt_baro=alt_baro,
        sd=np.full(len(t), spec.white_sd),
    )
    return baro, bias
