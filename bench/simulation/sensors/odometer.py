"""Odometer: the speed of a wheel on the ground along the body, with a scale factor and white noise."""

from __future__ import annotations

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Trajectory
from bench.core.records.instruments import OdometerData, OdometerSpec
from bench.core.records.sensor_specs import SensorsSpec
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.sampling import Sampler

_CLEAR = 0.3  # height of the IMU above its height at rest at which the wheel leaves the ground [m]


def report(truth: Trajectory, on_board: SensorsSpec, draws: SensorDraws) -> tuple[OdometerData, FloatArray]:
    """Simulate the odometer on board; return its record and its slowly varying error."""
    assert on_board.odometer is not None  # otherwise `sense` does not call this
    highest = on_board.ground_alt + on_board.rest_height + _CLEAR
    return measure(truth, on_board.odometer, highest, draws)


def measure(
    truth: Trajectory, spec: OdometerSpec, highest: float, draws: SensorDraws
) -> tuple[OdometerData, FloatArray]:
    """Simulate an odometer; return its record and the error of its scale factor (M,) [m/s].

    The wheel is at the IMU and does not slip. A sample is not valid while the wheel is off the ground. The
    other parameters and errors are those of `Sampler`.

    Parameters
    ----------
    highest : float
        Ellipsoidal height of the IMU up to which the wheel is on the ground [m].
    """
    samples = Sampler("odometer", truth, spec, draws)
    rows = samples.rows
    forward = rotation.rotate(rotation.conjugate(truth.q_nb[rows]), truth.vel_n[rows])[:, 0]
    error = float(samples.draw("scale_factor", spec.scale_factor_sd)) * forward
    return samples.report(forward + error, truth.lla[rows, 2] <= highest), error
