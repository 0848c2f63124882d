"""A telemetry log of known motion, written by pymavlink as a ground station writes it."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from pymavlink.dialects.v20 import common

BEGIN = 1_700_000_000.0
"""Time since 1970 at which the autopilot started [s]."""
SEA, ELLIPSOID = 600.0, 648.5  # [m]


def write_telemetry(
    path: Path, count: int = 400, rate: float = 50.0, *, unix: bool = False, gimbal: bool = False
) -> Path:
    """Write RAW_IMU at a rate [Hz], GPS_RAW_INT at 5 Hz, the rest at 10 Hz, and messages of a ground station.

    ``unix``: GPS_RAW_INT has times since 1970. ``gimbal``: a component of the vehicle has an IMU, too.
    """
    autopilot, ground = common.MAVLink(None, srcSystem=1, srcComponent=1), common.MAVLink(None, srcSystem=255)
    beside = common.MAVLink(None, srcSystem=1, srcComponent=154)
    with path.open("wb") as file:

        def put(link, t: float, message) -> None:
            packed = message.pack(link)
            link.seq = (link.seq + 1) % 256
            file.write(struct.pack(">Q", round(1e6 * (BEGIN + t + 0.05))) + packed)

        for k in range(count):
            t = 10.0 + k / rate
            ms, us = round(1e3 * t), round(1e6 * t)
            force, turn = motion(t)
            mg, mrad = (round(v / 9.80665e-3) for v in force), (round(1e3 * v) for v in turn)
            put(autopilot, t, common.MAVLink_raw_imu_message(us, *mg, *mrad, 210, 30, -420))
            for _ in range(3 * gimbal):
                put(beside, t, common.MAVLink_raw_imu_message(us, 0, 0, 999, 5, 5, 5, 0, 0, 0))
                put(beside, t, common.MAVLink_attitude_message(ms, 1.0, 1.0, 1.0, 0, 0, 0))
            if k % 5 == 0:
                put(autopilot, t, common.MAVLink_scaled_pressure_message(ms, 950.0, 0.0, 2000))
                put(autopilot, t, common.MAVLink_attitude_message(ms, 0.1, -0.05, 1.2, 0, 0, 0))
                own = (*place(t), round(1e3 * SEA), 0, 300, -400, 50, 12000)
                put(autopilot, t, common.MAVLink_global_position_int_message(ms, *own))
                put(autopilot, t, common.MAVLink_system_time_message(round(1e6 * (BEGIN + t)), ms))
                put(ground, t, common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3))
            if k % 10 == 0:
                at = round(1e6 * (BEGIN + t)) if unix else us
                fix = (3, *place(t), round(1e3 * SEA), 90, 120, 500, 30687, 14)
                more = (round(1e3 * ELLIPSOID), 1500, 2500, 300, 0)
                put(autopilot, t, common.MAVLink_gps_raw_int_message(at, *fix, *more))
    return path


def motion(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Specific force [m/s^2] and angular rate [rad/s] at a time, forward, right, down."""
    return np.array([0.5 * np.sin(t), 0.2, -9.8]), np.array([0.02, -0.03, 0.1 * np.cos(t)])


def place(t: float) -> tuple[int, int]:
    """Latitude and longitude [1e-7 deg] at a time: 3 m/s north, 4 m/s west."""
    return round(472_600_000 + 270 * (t - 10.0)), round(113_500_000 - 530 * (t - 10.0))
