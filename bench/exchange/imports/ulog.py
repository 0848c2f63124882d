"""PX4 ULog, read with pyulog. Fields and units are those of the uORB messages of PX4-Autopilot (msg/).

imu: ``sensor_combined`` (rates) or ``vehicle_imu`` (increments), forward, right, down. gnss:
``vehicle_gps_position`` or ``sensor_gps``. baro: ``vehicle_air_data`` or ``sensor_baro``. Of these the one
with the most rows: firmware logs others once or twice a second, for telemetry. Times are those of the sample
if the message has them.
"""

from __future__ import annotations

import contextlib
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.exchange.imports import describe_damage
from bench.exchange.rows import MOST_ROWS, LogRows
from bench.files import check_file
from bench.signals.air import pressure_altitude

_MOST_BYTES = 1_000_000_000  # pyulog keeps the file and the wanted messages in memory
_LEAST_COVERED = 0.5  # part of the time between two rows of an IMU that the rows measured
_TOPICS = {
    "imu": ("sensor_combined", "vehicle_imu"),
    "gnss": ("vehicle_gps_position", "sensor_gps"),
    "baro": ("vehicle_air_data", "sensor_baro"),
}


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a ULog; ``topic`` is a message, or ``message:instance``."""
    check_file(path, path.name, _MOST_BYTES)
    from pyulog import ULog

    wanted = (topic.partition(":")[0],) if topic else _TOPICS[kind]
    try:
        # pyulog prints messages on a broken file
        with path.open("rb") as file, contextlib.redirect_stdout(io.StringIO()):
            log = ULog(file, list(wanted))
    except Exception as error:  # a broken file can make pyulog raise anything
        raise describe_damage(path, error) from None
    instance = topic.partition(":")[2] if topic else ""
    found = {
        data.name: data.data
        for data in log.data_list
        if str(data.multi_id) == (instance or "0")
        and data.name in wanted
        and len(data.data.get("timestamp", ()))
    }
    if not found:
        there = ", ".join(sorted(log.message_formats))[:300]
        raise ConfigError(f"{path.name}: no rows of {' or '.join(wanted)}; it defines {there or 'none'}")
    name = max(reversed(found), key=lambda one: (len(found[one]["timestamp"]), -wanted.index(one)))
    data = found[name]
    if len(data["timestamp"]) > MOST_ROWS:
        raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
    notes = (f"{path.name}: the log is damaged; the readable part is used",) if log.file_corruption else ()
    try:
        t = _read_time(data)
        values = {"imu": _read_imu, "gnss": _read_gnss, "baro": _read_baro}[kind](data)
        covered = _measure_cover(t, data) if kind == "imu" else 1.0
    except KeyError as error:
        raise ConfigError(f"{path.name}: message {name} has no field {error.args[0]!r}") from None
    if covered < _LEAST_COVERED:
        rate = (len(t) - 1) / float(np.ptp(t))
        raise ConfigError(
            f"{path.name}: {name} has {rate:.3g} rows a second, which measured {100 * covered:.2g} % of the "
            "time between them: too few to navigate; log the IMU at full rate (SDLOG_PROFILE)"
        )
    return LogRows(t, values, notes)


Data = Mapping[str, FloatArray]


def _read_time(data: Data) -> FloatArray:
    sample = data.get("timestamp_sample")
    stamps = data["timestamp"] if sample is None or not np.any(sample) else sample
    return np.asarray(stamps, float) * 1e-6


def _read_vectors(data: Data, name: str) -> FloatArray:
    return np.stack([np.asarray(data[f"{name}[{k}]"], float) for k in range(3)], axis=-1)


def _read_duration(data: Data, name: str) -> FloatArray:
    """Return durations in seconds; old firmware has them so, later one in microseconds."""
    found = np.asarray(data[name], float)
    return np.asarray(found if np.median(found) < 1.0 else 1e-6 * found)


def _measure_cover(t: FloatArray, data: Data) -> float:
    """Return the part of the time between two rows that the rows measured themselves, by the median."""
    name = "delta_angle_dt" if "delta_angle[0]" in data else "gyro_integral_dt"
    if len(t) < 2 or not np.ptp(t) > 0.0:
        return 1.0
    return float(np.median(_read_duration(data, name)) / np.median(np.diff(t)))


def _read_imu(data: Data) -> dict[str, FloatArray]:
    if "delta_angle[0]" in data:  # of an interval of its own
        gyro, accel = (
            _read_vectors(data, f"delta_{what}") / _read_duration(data, f"delta_{what}_dt")[:, None]
            for what in ("angle", "velocity")
        )
        return {"gyro": gyro, "accel": accel}
    return {"gyro": _read_vectors(data, "gyro_rad"), "accel": _read_vectors(data, "accelerometer_m_s2")}


def _read_gnss(data: Data) -> dict[str, FloatArray]:
    if "latitude_deg" in data:
        place = [
            np.deg2rad(data["latitude_deg"]),
            np.deg2rad(data["longitude_deg"]),
            data["altitude_ellipsoid_m"],
        ]
    else:  # before PX4 1.14
        place = [np.deg2rad(1e-7 * data["lat"]), np.deg2rad(1e-7 * data["lon"]), 1e-3 * data["alt_ellipsoid"]]
    lla = np.stack([np.asarray(column, float) for column in place], axis=-1)
    vel_n = np.stack([np.asarray(data[f"vel_{a}_m_s"], float) for a in "ned"], axis=-1)
    if "vel_ned_valid" in data:
        vel_n[np.asarray(data["vel_ned_valid"]) == 0] = np.nan
    fix = np.asarray(data["fix_type"], float)
    lla[fix < 3] = np.nan  # no fix in three dimensions
    eph, epv, speed = (np.asarray(data[name], float) for name in ("eph", "epv", "s_variance_m_s"))
    values = {
        "lla": lla,
        "vel_n": vel_n,
        "sd_pos": np.stack([eph / np.sqrt(2.0), eph / np.sqrt(2.0), epv], axis=-1),
        "sd_vel": np.stack([speed / np.sqrt(3.0)] * 3, axis=-1),
        "quality": fix,
    }
    if "satellites_used" in data:
        values["satellites"] = np.asarray(data["satellites_used"], float)
    return values


def _read_baro(data: Data) -> dict[str, FloatArray]:
    if "baro_alt_meter" in data:
        return {"alt_baro": np.asarray(data["baro_alt_meter"], float)[:, None]}
    return {"alt_baro": pressure_altitude(np.asarray(data["pressure"], float))[:, None]}
