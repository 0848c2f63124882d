"""Magnetometer: the Earth's field in body axes with hard iron, soft iron and errors of the sensor."""

from __future__ import annotations

import numpy as np

from bench import rotation
from bench.arrays import BoolArray, FloatArray
from bench.data import Trajectory
from bench.instruments import MagData, MagSpec
from bench.sensors.timing import find_epoch_rows
from bench.signals.magnetic import field_n
from bench.specs import SensorsSpec, stream


def report(truth: Trajectory, on_board: SensorsSpec, seed: int, run: int) -> tuple[MagData, FloatArray]:
    """Simulate the magnetometer on board; return its record and its slowly varying error."""
    assert on_board.mag is not None  # otherwise `sense` does not call this
    mag, hard_iron_b = measure(truth, on_board.mag, on_board.date, seed, run)
    return mag, np.tile(hard_iron_b, (len(mag), 1))


def measure(truth: Trajectory, spec: MagSpec, date: float, seed: int, run: int) -> tuple[MagData, FloatArray]:
    """Simulate a magnetometer; return its record and its offset.

    Parameters
    ----------
    truth : Trajectory
        The motion; the magnetometer is at the IMU, along its axes except for ``misalignment_sd``.
    spec : MagSpec
        The magnetometer as mounted.
    date : float
        Decimal year of the flight.
    seed, run : int
        Select the draw of the errors.

    Returns
    -------
    mag : MagData
        ``(1 + M) C_bn field_n + hard iron + noise`` at t = 1/rate, 2/rate, ..., rounded to the resolution. A
        sample with an axis beyond the range is clipped there and not valid.
    hard_iron_b : (3,) array
        The offset [T], b.

    Raises
    ------
    ValueError
        If the rate is above that of the truth, or there is no field model for the date.
    """
    rows = find_epoch_rows("mag", truth.t, spec.rate)
    t = truth.t[rows]
    true_b = rotation.rotate(rotation.conjugate(truth.q_nb[rows]), field_n(truth.lla[rows], date))
    distortion, hard_iron_b = _calibration(spec, seed, run)
    field_b = true_b + true_b @ distortion.T + hard_iron_b
    if spec.white_sd > 0:
        field_b += spec.white_sd * stream(seed, run, "mag.white").standard_normal((len(t), 3))
    if spec.quantization > 0:
        field_b = spec.quantization * np.rint(field_b / spec.quantization)
    valid: BoolArray = np.ones(len(t), bool)
    if spec.range > 0:
        valid = np.asarray((np.abs(field_b) <= spec.range).all(axis=1))
        field_b = np.clip(field_b, -spec.range, spec.range)
    mag = MagData(
        t=t,
        t_arrival=t + spec.latency,
        valid=valid,
        field_b=field_b,
        sd=np.full(len(t), spec.white_sd),
    )
    return mag, hard_iron_b


def _calibration(spec: MagSpec, seed: int, run: int) -> tuple[FloatArray, FloatArray]:
    """Draw the errors that remain after calibration: matrix of errors (3, 3) [1], offset (3,) [T]."""
    distortion, hard_iron_b = np.zeros((3, 3)), np.zeros(3)
    if spec.soft_iron_sd > 0:
        draws = spec.soft_iron_sd * stream(seed, run, "mag.soft_iron").standard_normal((3, 3))
        distortion += np.triu(draws) + np.triu(draws, 1).T  # soft iron is symmetric
    if spec.scale_factor_sd > 0:
        distortion += np.diag(spec.scale_factor_sd * stream(seed, run, "mag.scale_factor").standard_normal(3))
    if spec.misalignment_sd > 0:
        angles = spec.misalignment_sd * stream(seed, run, "mag.misalignment").standard_normal((3, 3))
        distortion += angles - np.diag(np.diag(angles))
    if spec.hard_iron_sd > 0:
        hard_iron_b += spec.hard_iron_sd * stream(seed, run, "mag.hard_iron").standard_normal(3)
    return distortion, hard_iron_b
