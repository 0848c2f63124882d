"""The drive of the tests as a log of ArduPilot, with an estimate that is wrong by a known amount."""

from __future__ import annotations

import functools
import tempfile
from pathlib import Path

import numpy as np

from bench.core.mathematics import earth, rotation
from bench.simulation.signals.magnetic import field_n
from tests.exchange import drives
from tests.plugins.autopilots.flash import write_flash

OFF_N = np.array([2.0, 1.0, 0.5])
"""Position of the estimate minus truth [m], n."""
SD = np.array([1.5, 1.5, 1.0])
"""What it reports [m]."""
HOME = np.array([47.0, 11.0, 600.0])  # deg, deg, m over the ellipsoid
UNDULATION = -48.0  # GPA.Und [m]
WEEK, DAY = 2300, 3  # of GPS: 4 February 2024 and three days
KINDS = {
    "PARM": ("QNf", "TimeUS,Name,Value"),
    "ORGN": ("QBLLe", "TimeUS,Type,Lat,Lng,Alt"),
    "MSG": ("QZ", "TimeUS,Message"),
    "IMU": ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    "GPS": ("QBBIHBcLLefff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ"),
    "GPA": ("QBCCCCBIHf", "TimeUS,I,VDop,HAcc,VAcc,SAcc,VV,SMS,Delta,Und"),
    "BARO": ("QBfff", "TimeUS,I,Alt,Press,GndTemp"),
    "MAG": ("QBhhhB", "TimeUS,I,MagX,MagY,MagZ,Health"),
    "XKF1": ("QBccCfffffffccce", "TimeUS,C,Roll,Pitch,Yaw,VN,VE,VD,dPD,PN,PE,PD,GX,GY,GZ,OH"),
    "XKQ": ("QBffff", "TimeUS,C,Q1,Q2,Q3,Q4"),
    "XKF3": ("QBffffff", "TimeUS,C,IVN,IVE,IVD,IPN,IPE,IPD"),
    "XKF4": ("QBfffb", "TimeUS,C,SV,SP,SH,PI"),
    "XKV1": ("QB" + "f" * 12, "TimeUS,C," + ",".join(f"V{k:02d}" for k in range(12))),
    "SIM": ("QccCfLLffff", "TimeUS,Roll,Pitch,Yaw,Alt,Lat,Lng,Q1,Q2,Q3,Q4"),
    "SIM2": ("Qffffff", "TimeUS,PN,PE,PD,VN,VE,VD"),
}


def write_flight(path: Path, *, truth: bool = True, silent: tuple[float, float] = (-1.0, -1.0)) -> Path:
    """Write a log of the drive (:func:`_make`)."""
    path.write_bytes(_make(truth, silent))
    return path


@functools.cache
def _make(truth: bool, silent: tuple[float, float]) -> bytes:
    """Return a log: core 0 flies until 80 s, core 1, which is a meter further north, from then on.

    No fix is logged from ``silent[0]`` to ``silent[1]`` [s].
    """
    flown, made = drives.truth(), drives.sensed()
    rows: list[tuple[float, str, tuple[object, ...]]] = [
        (0.0, "PARM", (0, "GPS1_DELAY_MS", 1.0)),
        (0.0, "PARM", (0, "AHRS_EKF_TYPE", 3.0)),
        (0.0, "ORGN", (0, 0, HOME[0], HOME[1], HOME[2] + UNDULATION)),
        (80.0, "MSG", (int(80e6), "EKF3 lane switch 1")),
    ]

    def add(name: str, t: float, *values: object) -> None:
        rows.append((t, name, (round(1e6 * t), *values)))

    imu, gnss = made["imu"], made["gnss"]
    for t, gyro, accel in zip(imu["t"], imu["gyro"], imu["accel"], strict=True):
        add("IMU", t, 0, *gyro, *accel)
    for t, lla, vel in zip(gnss["t"], gnss["lla"], gnss["vel_n"], strict=True):
        if silent[0] <= t <= silent[1]:
            continue
        place = np.rad2deg(lla[:2])
        logged = t + 0.001
        ms = round(1e3 * t) + 86_400_000 * DAY
        course = np.rad2deg(np.arctan2(vel[1], vel[0])) % 360.0
        add(
            "GPS",
            logged,
            0,
            3,
            ms,
            WEEK,
            12,
            0.8,
            *place,
            lla[2] + UNDULATION,
            np.hypot(*vel[:2]),
            course,
            vel[2],
        )
        add("GPA", logged, 0, 0.8, 0.02 * 2**0.5, 0.04, 0.05 * 3**0.5, 1, ms, 200, UNDULATION)
    at = np.arange(10, len(flown), 10)
    home = np.array([*np.deg2rad(HOME[:2]), HOME[2]])
    ned = earth.difference_n(flown.lla[at], np.broadcast_to(home, (len(at), 3)))
    fields = np.einsum("kji,kj->ki", rotation.matrix(flown.q_nb[at]), field_n(flown.lla[at], 2024.1))
    for k, row in enumerate(at):
        t, vel, q = float(flown.t[row]), flown.vel_n[row], flown.q_nb[row]
        angles = np.rad2deg(rotation.to_euler(q))
        add("MAG", t, 0, *np.round(1e7 * fields[k]), 1)
        for core in (0, 1):
            n, e, d = ned[k] + OFF_N + [core, 0.0, 0.0]
            add(
                "XKF1",
                t,
                core,
                angles[0],
                angles[1],
                angles[2] % 360.0,
                *vel,
                0.0,
                n,
                e,
                d,
                0.1,
                0.0,
                0.0,
                0.0,
            )
            add("XKQ", t, core, *q)
            add("XKF3", t, core, 0.3, 0.0, 0.4, 1.0 + 1e-3 * (k % 7), 0.0, 2.0)
            add("XKF4", t, core, 0.1, 0.2, 0.1, 0 if t < 80.0 else 1)
            variances = [1e-5] * 4 + [0.01] * 3 + (SD**2).tolist() + [0.0] * 2
            add("XKV1", t, core, *variances)
        if truth:
            place = np.rad2deg(flown.lla[row, :2])
            add("SIM", t, *angles[:2], angles[2] % 360.0, flown.lla[row, 2] + UNDULATION, *place, *q)
            add("SIM2", t, *ned[k], *vel)
    rows.sort(key=lambda row: row[0])
    kinds = {name: kind for name, kind in KINDS.items() if any(row[1] == name for row in rows)}
    with tempfile.TemporaryDirectory() as folder:
        written = [(name, values) for _, name, values in rows]
        return write_flash(Path(folder) / "x.bin", kinds, written).read_bytes()
