"""Gyro bias from a start in a turn, if no segment is straight.

The attitude at a time is taken for that of coordinated flight: the heading has turned with the course,
the bank is that of the turn, the pitch is that of the start. The bias is what leads there.
"""

from __future__ import annotations

import math

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import InitialState, SensorData
from bench.navigation.engine import timeline
from bench.navigation.mechanization import propagate
from bench.navigation.start.course import LEAST_SPEED
from bench.navigation.start.steady_course import STRAIGHT, TURNED_SD

_PART = 0.5  # sd of the bank over the bank, as a turn may slip and a car has none; assumed
_STEPS = 10  # of Newton's method, at most
_NEAR = 1e-4  # the last of them is shorter, and so are those that give the slopes [rad/s]


def find_bias(
    sensors: SensorData, initial: InitialState, until: float, near: FloatArray
) -> tuple[FloatArray, float] | None:
    """Return the bias (3,) of the gyros that leads to coordinated flight, b, and its sd [rad/s].

    None: the course stays, the vehicle hardly moves, or no bias is found.

    Parameters
    ----------
    sensors : SensorData
        Record with fixes.
    initial : InitialState
        Start; its attitude is known.
    until : float
        What comes later is not looked at [s].
    near : (3,) array
        Where to look for it: over ten seconds, biases 36 deg/s apart lead to the same attitude.
    """
    fixes, imu = sensors.fixes, sensors.imu
    assert fixes is not None
    used, _, _ = timeline.fix_rows(fixes, imu.t, initial.t)
    used = used[(fixes.t_arrival[used] <= until) & np.isfinite(fixes.vel_n[used]).all(axis=1)]
    t, velocity = fixes.t[used], np.vstack([initial.vel_n, fixes.vel_n[used]])
    speed, course = np.hypot(velocity[:, 0], velocity[:, 1]), np.arctan2(velocity[:, 1], velocity[:, 0])
    course = np.unwrap(course)
    if len(t) < 2 or (speed < LEAST_SPEED).any() or (np.abs(course - course[0]) < STRAIGHT).all():
        return None
    end, rate = 0.5 * (t[-2] + t[-1]), (course[-1] - course[-2]) / (t[-1] - t[-2])
    _, pitch, heading = rotation.to_euler(initial.q_nb)
    bank = math.atan(0.5 * (speed[-2] + speed[-1]) * rate / STANDARD_GRAVITY)
    q_end = rotation.from_euler(bank, pitch, heading + 0.5 * (course[-2] + course[-1]) - course[0])
    rows, span, _ = timeline.imu_rows(imu, initial.t, sensors.specs.imu)
    inside = imu.t[rows] <= end
    rows, span = rows[inside], span[inside]

    def turn(bias: FloatArray) -> FloatArray:
        """Return the attitude at the end."""
        share = (span / imu.dt[rows])[:, None]
        dtheta, dvel = share * imu.dtheta_b[rows] - bias * span[:, None], share * imu.dvel_b[rows]
        return propagate(initial.lla, initial.vel_n, initial.q_nb, span, dtheta, dvel)[-1, 6:]

    def between(q: FloatArray, other: FloatArray) -> FloatArray:
        return rotation.to_rotvec(rotation.multiply(rotation.conjugate(q), other))

    bias = near.copy()
    for _ in range(_STEPS):
        q = turn(bias)
        slopes = np.column_stack([between(q, turn(bias + step)) for step in _NEAR * np.eye(3)]) / _NEAR
        change, *_ = np.linalg.lstsq(slopes, between(q, q_end))
        bias = bias + change
        if np.abs(change).max() < _NEAR:
            return bias, math.hypot(TURNED_SD, _PART * bank) / (end - initial.t)
    return None
