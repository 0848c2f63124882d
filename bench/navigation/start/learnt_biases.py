"""Biases of an IMU that one filter has estimated and the next one starts with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import NavSolution, SensorData
from bench.core.records.sensor_specs import AxisFigures, ImuSpec, TriadSpec
from bench.navigation.engine.imu_range import find_beyond
from bench.navigation.start.fixes_only import End


@dataclass(frozen=True, slots=True)
class LearntBiases:
    """Biases that are subtracted from the IMU increments, with their uncertainty."""

    gyro: FloatArray  # (3,) [rad/s], b
    accel: FloatArray  # (3,) [m/s^2], b
    gyro_sd: FloatArray  # (3,) [rad/s]; inf: what the datasheet says
    accel_sd: FloatArray  # (3,) [m/s^2]

    def for_alignment(self, piece: SensorData) -> SensorData:
        """Return a piece without the biases for an alignment, if the sum of all bias errors is known."""
        piece = self.taken_off(piece)
        if not np.isfinite(self.gyro_sd).all():
            return piece
        spec = piece.specs.imu
        gyro = replace(spec.gyro, temperature_sd=0.0, g_sensitivity_sd=0.0, g2_sensitivity_sd=0.0)
        return replace(piece, specs=replace(piece.specs, imu=replace(spec, gyro=gyro)))

    def taken_off(self, piece: SensorData) -> SensorData:
        """Return a piece with the biases subtracted, and a datasheet of their remaining errors.

        Whether a sample is beyond the range is decided before the subtraction.
        """
        imu, spec = piece.imu, piece.specs.imu
        dt = imu.dt[:, None]
        beyond = np.any([rows for _, rows in find_beyond(imu, spec)], axis=0)
        less = replace(
            imu,
            valid=imu.valid & ~beyond,
            dtheta_b=imu.dtheta_b - self.gyro * dt,
            dvel_b=imu.dvel_b - self.accel * dt,
        )
        gyro = _less(spec.gyro, self.gyro, self.gyro_sd)
        accel = _less(spec.accel, self.accel, self.accel_sd)
        specs = replace(piece.specs, imu=replace(spec, gyro=gyro, accel=accel))
        return replace(piece, imu=less, specs=specs)

    def given_back(self, solution: NavSolution) -> NavSolution:
        """Return a solution with the subtracted biases added to its bias states, if it has any."""
        if not solution.extra_names:
            return solution
        extra = solution.extra.copy()
        extra[:, :6] += np.concatenate([self.gyro, self.accel])
        return replace(
            solution,
            gyro_bias_b=solution.gyro_bias_b + self.gyro,
            accel_bias_b=solution.accel_bias_b + self.accel,
            extra=extra,
        )


UNLEARNT = LearntBiases(*np.zeros((2, 3)), *np.full((2, 3), np.inf))
"""Of a filter that has not begun."""


def learn_biases(
    end: End, spec: ImuSpec, biases: LearntBiases, steady: tuple[FloatArray, FloatArray] | None
) -> LearntBiases:
    """Return the biases to subtract from the increments after the end of a filter.

    ``steady`` are the errors (6,) of gyros and accelerometers as a whole and their sd, where the filter knows
    them: biases and all that adds to them. Beyond ``biases``, which it did not see.
    """
    if not np.isfinite(np.concatenate([end.gyro_bias_b, end.accel_bias_b, end.extra_sd[:6]])).all():
        return biases
    kept, found, sd = [], end.extra[:6], end.extra_sd[:6]
    if steady is not None and np.isfinite(steady).all():
        found, sd = steady[0] + np.concatenate([biases.gyro, biases.accel]), steady[1]
    for triad, part in ((spec.gyro, slice(0, 3)), (spec.accel, slice(3, 6))):
        if triad.turn_on_bias_sd > 0:
            kept.append((found[part], sd[part]))
        else:  # a process that forgets itself begins as at the first start
            kept.append((np.zeros(3), np.full(3, np.inf)))
    (gyro, gyro_sd), (accel, accel_sd) = kept
    return LearntBiases(gyro, accel, gyro_sd, accel_sd)


def _less(triad: TriadSpec, bias: FloatArray, sd: FloatArray) -> TriadSpec:
    """Return a triad less biases that are known to ``sd`` (3,), no better than its instability."""
    left = np.sqrt(np.maximum(sd**2 - triad.instability_by_axis**2, (1e-3 * sd) ** 2))
    left = np.minimum(triad.by_axis("turn_on_bias_sd"), left)
    axes = tuple(one for one in triad.axes or () if one.name != "turn_on_bias_sd")
    own = AxisFigures("turn_on_bias_sd", *left.tolist())
    most = triad.range and triad.range + float(np.abs(bias).max())
    return replace(triad, turn_on_bias_sd=float(left.max()), range=most, axes=(*axes, own))
