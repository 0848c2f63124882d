"""Magnetometer: the Earth's field in body axes with hard iron, soft iron and errors of the sensor."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.instruments import MagData, MagSpec
from bench.core.records.sensor_specs import Fault, SensorsSpec
from bench.core.words.exceptions import ConfigError
from bench.simulation.sensors import faults
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler
from bench.simulation.signals.magnetic import field_n


def report(truth: Trajectory, on_board: SensorsSpec, draws: SensorDraws) -> tuple[MagData, FloatArray]:
    """Simulate the magnetometer on board; return its record and its slowly varying error."""
    assert on_board.mag is not None  # otherwise `sense` does not call this
    mag, hard_iron_b = measure(truth, on_board.mag, on_board.date, draws, on_board.faults)
    return mag, np.tile(hard_iron_b, (len(mag), 1))


def measure(
    truth: Trajectory, spec: MagSpec, date: float, draws: SensorDraws, scripted: Sequence[Fault] = ()
) -> tuple[MagData, FloatArray]:
    """Simulate a magnetometer at the IMU, along its axes except for ``misalignment_sd``.

    Parameters
    ----------
    truth, spec, draws
        As for `Sampler`; the magnetometer as mounted.
    date : float
        Decimal year of the flight.
    scripted : sequence of Fault
        Scripted faults, of which magnets that are passed add to the field outside.

    Returns
    -------
    mag : MagData
        ``(1 + M) C_bn field_n + hard iron + motor field + noise``. A sample with an axis beyond the range is
        clipped there and not valid.
    hard_iron_b : (3,) array
        The offset [T], b.

    Raises
    ------
    ValueError
        If the rate is above that of the truth, or there is no field model for the date.
    ConfigError
        If the motors have a field and the flight has no throttle.
    """
    samples = Sampler("mag", truth, spec, draws)
    rows = samples.rows
    outside_n = field_n(truth.lla[rows], date) + faults.compute_passed_magnets(samples.t, scripted)
    true_b = rotation.rotate(rotation.conjugate(truth.q_nb[rows]), outside_n)
    distortion, hard_iron_b = draw_calibration(samples, spec)
    near_b = draw_motor_field(truth, samples, spec) + hard_iron_b
    mag: MagData = samples.report(true_b + true_b @ distortion.T + near_b)
    if spec.range > 0:
        within: BoolArray = np.asarray((np.abs(mag.field_b) <= spec.range).all(axis=1))
        mag = replace(mag, valid=within, field_b=np.clip(mag.field_b, -spec.range, spec.range))
    return mag, hard_iron_b


def draw_motor_field(truth: Trajectory, samples: Sampler, spec: MagSpec) -> FloatArray:
    """Draw the field (M, 3) of the motor currents [T], b; (3,) zeros without it.

    One vector times the throttle, as autopilots compensate it (ArduPilot, ArduCopter/compassmot.cpp).

    Raises
    ------
    ConfigError
        If the flight has no throttle.
    """
    if spec.motor_field_sd <= 0:
        return np.zeros(3)
    if not len(truth.controls):
        raise ConfigError("[mag] motor_field_sd_nt needs the throttle, which this flight does not have")
    throttle = np.interp(samples.t, truth.controls.t, truth.controls.throttle)
    return throttle[:, None] * samples.draw("motor_field", spec.motor_field_sd, 3)


def draw_calibration(samples: Sampler, spec: MagSpec) -> tuple[FloatArray, FloatArray]:
    """Draw the errors that remain after calibration: matrix of errors (3, 3) [1], offset (3,) [T]."""
    soft = samples.draw("soft_iron", spec.soft_iron_sd, 3, 3)
    angles = samples.draw("misalignment", spec.misalignment_sd, 3, 3)
    distortion = np.triu(soft) + np.triu(soft, 1).T  # soft iron is symmetric
    distortion += np.diag(samples.draw("scale_factor", spec.scale_factor_sd, 3))
    distortion += angles - np.diag(np.diag(angles))
    return distortion, samples.draw("hard_iron", spec.hard_iron_sd, 3)
