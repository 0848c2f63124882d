"""What the adapters of attitude filters share: samples in time order, frames of the filters, the solution."""

from dataclasses import replace
from typing import ClassVar

import numpy as np

from bench.core.mathematics import rotation
from bench.navigation.filter_adapters import nothing_known
from bench.simulation.signals.magnetic import field_n

NWU = np.array([0.0, 1.0, 0.0, 0.0])
"""Attitude of north, west, up in n: half a turn about north."""
ENU = np.array([0.0, np.sqrt(0.5), np.sqrt(0.5), 0.0])
"""Attitude of east, north, up in n: half a turn about northeast."""
NED = np.array([1.0, 0.0, 0.0, 0.0])
GRAVITY = 9.80665  # [m/s^2]


def rates(imu):
    """Return mean rates [rad/s] and specific forces [m/s^2] of the samples, (N, 3) each."""
    return imu.dtheta_b / imu.dt[:, None], imu.dvel_b / imu.dt[:, None]


def fields(sensors):
    """Return the field (N, 3) that arrived with each IMU sample [T]; NaN if none did."""
    imu, mag = sensors.imu, sensors.mag
    found = np.full((len(imu.t), 3), np.nan)
    if mag is not None:
        row = np.searchsorted(imu.t, mag.t_arrival - 1e-9)
        kept = mag.valid.astype(bool) & (row < len(imu.t))
        found[row[kept]] = mag.field_b[kept]
    return found


def reference_field(sensors, initial):
    """Return the field (3,) of the World Magnetic Model at the start, n [T]."""
    return field_n(initial.lla[None], sensors.date)[0]


def declination(sensors, initial):
    """Return q (4,) from magnetic to true north at the start; no turn without a magnetometer."""
    if sensors.mag is None:
        return NED
    north, east, _ = reference_field(sensors, initial)
    return rotation.from_rotvec(np.array([0.0, 0.0, np.arctan2(east, north)]))


def to_filter(q_nb, frame, turn=NED):
    """Return an attitude in the frame of a filter, whose north is magnetic if ``turn`` is a declination."""
    return rotation.multiply(rotation.conjugate(rotation.multiply(turn, frame)), q_nb)


def make_solution(sensors, initial, q_filter, frame, turn=NED):
    """Return the solution of attitudes (N, 4) after each IMU sample: of the last sample at each output."""
    q_nb = rotation.multiply(rotation.multiply(turn, frame), q_filter)
    row = np.searchsorted(sensors.imu.t, sensors.output_t + 1e-9) - 1
    found = np.where((row >= 0)[:, None], q_nb[np.maximum(row, 0)], initial.q_nb)
    return replace(nothing_known(sensors.output_t), q_nb=found)


class AttitudeFilter:
    """A filter that is stepped through the samples: ``begin`` once, then ``step`` for each sample."""

    frame = NWU  # of the filter; its body axes are those of bench
    magnetic = True  # its north is magnetic
    values: ClassVar[dict[str, float]] = {}  # parameters that differ from the defaults of the authors

    def run(self, sensors, initial):
        turn = declination(sensors, initial) if self.magnetic else NED
        q = to_filter(initial.q_nb, self.frame, turn)
        q = self.begin(sensors, initial, q)
        found = np.empty((len(sensors.imu.t), 4))
        gyro, accel = rates(sensors.imu)
        for k, (w, f, m, dt) in enumerate(zip(gyro, accel, fields(sensors), sensors.imu.dt, strict=True)):
            if np.isfinite(w).all() and np.isfinite(f).all():
                q = self.step(q, w, f, m if np.isfinite(m[0]) else None, float(dt))
            found[k] = q
        return make_solution(sensors, initial, found, self.frame, turn)
