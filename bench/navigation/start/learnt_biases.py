"""Biases of an IMU that a filter has learnt and the next one goes on with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.arrays import FloatArray
from bench.data import NavSolution, SensorData
from bench.navigation.start.fixes_only import End
from bench.specs import AxisFigures, ImuSpec, TriadSpec


@dataclass(frozen=True, slots=True)
class LearntBiases:
    """Biases of the IMU that are taken off its increments, and how well they are known."""

    gyro: FloatArray  # (3,) [rad/s], b
    accel: FloatArray  # (3,) [m/s^2], b
    gyro_sd: FloatArray  # (3,) [rad/s]; inf: what the datasheet says
    accel_sd: FloatArray  # (3,) [m/s^2]

    def taken_off(self, piece: SensorData) -> SensorData:
        """Return a piece less the biases, with the datasheet of what is left of them."""
        imu, spec = piece.imu, piece.specs.imu
        dt = imu.dt[:, None]
        less = replace(imu, dtheta_b=imu.dtheta_b - self.gyro * dt, dvel_b=imu.dvel_b - self.accel * dt)
        gyro, accel = _less_turn_on(spec.gyro, self.gyro_sd), _less_turn_on(spec.accel, self.accel_sd)
        specs = replace(piece.specs, imu=replace(spec, gyro=gyro, accel=accel))
        return replace(piece, imu=less, specs=specs)

    def given_back(self, solution: NavSolution) -> NavSolution:
        """Return a solution of a piece less the biases with them; one without further states as it is."""
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


def learn_biases(end: End, spec: ImuSpec, biases: LearntBiases) -> LearntBiases:
    """Return the biases to take off the increments behind the end of a filter."""
    if not np.isfinite(np.concatenate([end.gyro_bias_b, end.accel_bias_b, end.extra_sd[:6]])).all():
        return biases
    kept = []
    for triad, part in ((spec.gyro, slice(0, 3)), (spec.accel, slice(3, 6))):
        if triad.turn_on_bias_sd > 0:
            kept.append((end.extra[part], end.extra_sd[part]))
        else:  # a process that forgets itself begins as at the first start
            kept.append((np.zeros(3), np.full(3, np.inf)))
    (gyro, gyro_sd), (accel, accel_sd) = kept
    return LearntBiases(gyro, accel, gyro_sd, accel_sd)


def _less_turn_on(triad: TriadSpec, sd: FloatArray) -> TriadSpec:
    """Return a triad whose biases are known to ``sd`` (3,), no better than its instability."""
    left = np.sqrt(np.maximum(sd**2 - triad.instability_by_axis**2, (1e-3 * sd) ** 2))
    left = np.minimum(triad.by_axis("turn_on_bias_sd"), left)
    axes = tuple(one for one in triad.axes or () if one.name != "turn_on_bias_sd")
    own = AxisFigures("turn_on_bias_sd", *left.tolist())
    return replace(triad, turn_on_bias_sd=float(left.max()), axes=(*axes, own))
