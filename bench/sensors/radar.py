"""Radar altimeter: height above flat ground with bias, white noise and limits of height and tilt."""

from __future__ import annotations

import numpy as np

from bench import rotation
from bench.arrays import BoolArray, FloatArray
from bench.data import Trajectory
from bench.instruments import RadarData, RadarSpec
from bench.sensors.timing import find_epoch_rows
from bench.specs import SensorsSpec, stream


def report(truth: Trajectory, on_board: SensorsSpec, seed: int, run: int) -> tuple[RadarData, FloatArray]:
    """Simulate the radar altimeter on board; return its record and its slowly varying error."""
    assert on_board.radar is not None  # otherwise `sense` does not call this
    return measure(truth, on_board.radar, on_board.ground_alt, seed, run)


def measure(
    truth: Trajectory, spec: RadarSpec, ground_alt: float, seed: int, run: int
) -> tuple[RadarData, FloatArray]:
    """Simulate a radar altimeter above flat ground; return its record and its bias.

    Parameters
    ----------
    truth : Trajectory
        The motion; the altimeter is at the IMU. Its beam is wide enough to include the vertical.
    spec : RadarSpec
        The altimeter.
    ground_alt : float
        Ellipsoidal height of the ground [m].
    seed, run : int
        Select the draw of the errors.

    Returns
    -------
    radar : RadarData
        At t = 1/rate, 2/rate, ..., rounded to the resolution. A sample below the smallest or above the
        largest height, or tilted beyond ``max_tilt``, is not valid.
    bias : (M,) array
        Constant error at these times [m].

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """
    rows = find_epoch_rows("radar", truth.t, spec.rate)
    t, height = truth.t[rows], truth.lla[rows, 2] - ground_alt
    bias = np.zeros(len(t))
    if spec.bias_sd > 0:
        bias += spec.bias_sd * stream(seed, run, "radar.bias").standard_normal()
    measured = height + bias
    if spec.white_sd > 0:
        measured = measured + spec.white_sd * stream(seed, run, "radar.white").standard_normal(len(t))
    if spec.quantization > 0:
        measured = spec.quantization * np.rint(measured / spec.quantization)
    down_n = rotation.rotate(truth.q_nb[rows], np.array([0.0, 0.0, 1.0]))
    seen: BoolArray = (height >= spec.min_height) & (height <= spec.range)
    seen &= down_n[:, 2] >= np.cos(spec.max_tilt)
    radar = RadarData(
        t=t, t_arrival=t + spec.latency, valid=seen, height=measured, sd=np.full(len(t), spec.white_sd)
    )
    return radar, bias
