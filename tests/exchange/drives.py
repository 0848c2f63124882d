"""A drive nobody recorded: at rest, then a winding road, with what an IMU and a receiver on the car report.

The truth passes through an analytic path; the files are written from it by this module alone, in the units,
axes and clocks a test asks for.
"""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from bench.core.mathematics import earth, rotation
from bench.core.records.flight_specs import TableSpec
from bench.io.results import join_pieces
from bench.io.trajectories.trajectory import read_trajectory

ORIGIN = np.array([np.deg2rad(47.0), np.deg2rad(11.0), 600.0])
REST, LENGTH, RATE = 20.0, 150.0, 100.0  # [s], [s], [Hz]
GYRO_N, ACCEL_N = 2e-4, 2e-3  # white noise of the IMU [rad/sqrt(s)], [m/s/sqrt(s)]
GYRO_BIAS, ACCEL_BIAS = np.array([1e-3, -5e-4, 8e-4]), np.array([0.02, -0.03, 0.01])
POS_SD, VEL_SD = np.array([0.02, 0.02, 0.04]), np.array([0.05, 0.05, 0.05])
ARM = np.array([-0.6, 0.3, -1.0])  # antenna from the IMU [m], b

IMU_SHEET = """
source = "the drive of the tests"
[gyro]
noise_deg_s_sqrt_hz = 0.011459
bias_instability_deg_h = 1.0
bias_correlation_s = 300.0
turn_on_bias_sd_deg_s = 0.06
[accel]
noise_ug_sqrt_hz = 204.0
bias_instability_ug = 20.0
bias_correlation_s = 300.0
turn_on_bias_sd_mg = 3.0
"""
GNSS_SHEET = """
source = "the drive of the tests"
[gnss]
rate_hz = 5.0
pos_h_white_sd_m = 0.02
pos_v_white_sd_m = 0.04
vel_white_sd_mps = 0.05
"""
BARO_SHEET = """
source = "the drive of the tests"
[baro]
rate_hz = 5.0
white_sd_m = 0.3
bias_sd_m = 3.0
bias_walk_m_sqrt_s = 0.02
"""
LOG = """
title = "A drive of the tests"
[imu]
file = "imu.csv"
position_m = [1.0, 0.0, -0.5]
[gnss]
file = "gnss.csv"
position_m = [0.4, 0.3, -1.5]
[sensors.assumed]
imu = "imu.toml"
gnss = "gnss.toml"
[alignment]
kind = "course"
[evaluation]
from_s = 40.0
"""


@functools.cache
def truth():
    """The motion of the IMU, truth at 100 Hz."""
    fine = np.linspace(0.0, LENGTH, 150_001)
    since = np.maximum(fine - REST, 0.0)
    smooth = np.tanh(since / 4.0) ** 2
    speed = 10.0 * smooth * (1.0 + 0.2 * np.sin(since / 3.0))
    heading = 0.5 + 0.4 * smooth * np.sin(0.5 * since)
    north, east = (np.cumsum(speed * part(heading)) * (fine[1] - fine[0]) for part in (np.cos, np.sin))
    rows = slice(None, None, 100)
    t = fine[rows]
    lla = earth.displace(ORIGIN, np.column_stack([north[rows], east[rows], 0.0 * t]))
    columns = [t, np.rad2deg(lla[:, 0]), np.rad2deg(lla[:, 1]), lla[:, 2]]
    columns += [0.0 * t + 1.0, 0.3 * speed[rows], np.rad2deg(heading[rows])]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "path.csv"
        header = "t_s,lat_deg,lon_deg,alt_m,roll_deg,pitch_deg,heading_deg"
        np.savetxt(path, np.column_stack(columns), delimiter=",", header=header, comments="", fmt="%.12f")
        return join_pieces(read_trajectory(TableSpec("path", path, RATE, None)))


def sensed(
    seed: int = 1, mounting_deg=(0.0, 0.0, 0.0), velocity_late: float = 0.0
) -> dict[str, dict[str, np.ndarray]]:
    """What the units report, in SI along the axes of the IMU, on the clock of the truth.

    ``mounting_deg``: roll, pitch, yaw of the axes of the IMU in b, by scipy. ``velocity_late``: the receiver
    reports the velocity it had so many seconds (a multiple of 0.01 s) before.
    """
    flown, random = truth(), np.random.default_rng(seed)
    n = len(flown) - 1
    to_sensor = Rotation.from_euler("ZYX", np.deg2rad(mounting_deg[::-1])).inv()
    gyro = RATE * flown.dtheta_b + GYRO_BIAS + GYRO_N * np.sqrt(RATE) * random.standard_normal((n, 3))
    accel = RATE * flown.dvel_b + ACCEL_BIAS + ACCEL_N * np.sqrt(RATE) * random.standard_normal((n, 3))
    at = np.arange(20, len(flown), 20)
    then = at - round(velocity_late * RATE)
    C_nb = rotation.matrix(flown.q_nb)
    swing = np.cross(RATE * flown.dtheta_b[at - 1], ARM)
    swing_then = np.cross(RATE * flown.dtheta_b[np.maximum(then, 1) - 1], ARM)
    assert swing.shape == swing_then.shape
    lla = earth.displace(flown.lla[at], C_nb[at] @ ARM + POS_SD * random.standard_normal((len(at), 3)))
    vel = flown.vel_n[then] + np.einsum("kij,kj->ki", C_nb[then], swing_then)
    return {
        "imu": {"t": flown.t[1:], "gyro": to_sensor.apply(gyro), "accel": to_sensor.apply(accel)},
        "gnss": {
            "t": flown.t[at],
            "lla": lla,
            "vel_n": vel + VEL_SD * random.standard_normal((len(at), 3)),
        },
        "baro": {"t": flown.t[at], "alt": flown.lla[at, 2] + 5.0 + 0.3 * random.standard_normal(len(at))},
    }


def imu_columns(imu) -> dict[str, np.ndarray]:
    """Columns of an IMU table: rates in SI."""
    columns = {"t_s": imu["t"]}
    columns |= {f"gyro_{a}_rad_s": imu["gyro"][:, k] for k, a in enumerate("xyz")}
    return columns | {f"accel_{a}_m_s2": imu["accel"][:, k] for k, a in enumerate("xyz")}


def gnss_columns(gnss) -> dict[str, np.ndarray]:
    """Columns of a GNSS table."""
    columns = {"t_s": gnss["t"]}
    columns |= {"lat_deg": np.rad2deg(gnss["lla"][:, 0]), "lon_deg": np.rad2deg(gnss["lla"][:, 1])}
    columns |= {"alt_m": gnss["lla"][:, 2]}
    columns |= {f"vel_{a}_mps": gnss["vel_n"][:, k] for k, a in enumerate("ned")}
    columns |= {f"sd_{a}_m": np.full(len(gnss["t"]), POS_SD[k]) for k, a in enumerate("ned")}
    columns |= {f"sd_v{a}_mps": np.full(len(gnss["t"]), VEL_SD[k]) for k, a in enumerate("ned")}
    return columns | {"quality": np.ones(len(gnss["t"]))}


def write_csv(path: Path, columns: dict[str, np.ndarray]) -> None:
    """Write a table with a header."""
    rows = np.column_stack(list(columns.values()))
    np.savetxt(path, rows, delimiter=",", header=",".join(columns), comments="", fmt="%.11g")


def write_log(folder: Path, log: str = LOG, **how) -> Path:
    """Write a log with its tables and datasheets; return its .toml."""
    found = sensed(**how)
    write_csv(folder / "imu.csv", imu_columns(found["imu"]))
    write_csv(folder / "gnss.csv", gnss_columns(found["gnss"]))
    write_csv(folder / "baro.csv", {"t_s": found["baro"]["t"], "alt_baro_m": found["baro"]["alt"]})
    for name, sheet in (("imu", IMU_SHEET), ("gnss", GNSS_SHEET), ("baro", BARO_SHEET)):
        (folder / f"{name}.toml").write_text(sheet)
    (folder / "drive.toml").write_text(log)
    return folder / "drive.toml"
