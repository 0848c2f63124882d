"""Odometer: the speed of a wheel on the ground along the body, with a scale factor and white noise."""

from __future__ import annotations

import numpy as np

from bench import rotation
from bench.arrays import FloatArray
from bench.data import Trajectory
from bench.instruments import OdometerData, OdometerSpec
from bench.sensors.timing import find_epoch_rows
from bench.specs import SensorsSpec, stream

_CLEAR = 0.3  # height of the IMU above its height at rest at which the wheel leaves the ground [m]


def report(truth: Trajectory, on_board: SensorsSpec, seed: int, run: int) -> tuple[OdometerData, FloatArray]:
    """Simulate the odometer on board; return its record and its slowly varying error."""
    assert on_board.odometer is not None  # otherwise `sense` does not call this
    highest = on_board.ground_alt + on_board.rest_height + _CLEAR
    return measure(truth, on_board.odometer, highest, seed, run)


def measure(
    truth: Trajectory, spec: OdometerSpec, highest: float, seed: int, run: int
) -> tuple[OdometerData, FloatArray]:
    """Simulate an odometer; return its record and the error of its scale factor.

    Parameters
    ----------
    truth : Trajectory
        The motion. The wheel is at the IMU and does not slip.
    spec : OdometerSpec
        The odometer.
    highest : float
        Ellipsoidal height of the IMU up to which the wheel is on the ground [m].
    seed, run : int
        Select the draw of the errors.

    Returns
    -------
    odometer : OdometerData
        Forward speed over ground at t = 1/rate, 2/rate, ..., rounded to the resolution. A sample is not valid
        while the wheel is off the ground.
    error : (M,) array
        Error by the scale factor at these times [m/s].

    Raises
    ------
    ValueError
        If the rate is above that of the truth.
    """
    rows = find_epoch_rows("odometer", truth.t, spec.rate)
    t = truth.t[rows]
    forward = rotation.rotate(rotation.conjugate(truth.q_nb[rows]), truth.vel_n[rows])[:, 0]
    scale = 0.0
    if spec.scale_factor_sd > 0:
        scale = spec.scale_factor_sd * float(stream(seed, run, "odometer.scale_factor").standard_normal())
    error = scale * forward
    measured = forward + error
    if spec.white_sd > 0:
        measured = measured + spec.white_sd * stream(seed, run, "odometer.white").standard_normal(len(t))
    if spec.quantization > 0:
        measured = spec.quantization * np.rint(measured / spec.quantization)
    odometer = OdometerData(
        t=t,
        t_arrival=t + spec.latency,
        valid=truth.lla[rows, 2] <= highest,
        speed=measured,
        sd=np.full(len(t), spec.white_sd),
    )
    return odometer, error
