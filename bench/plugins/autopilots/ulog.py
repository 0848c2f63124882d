"""PX4 ULog, read with pyulog. Fields and units are as in the uORB messages of PX4-Autopilot (msg/).

Of the messages with data of a sensor, the message that covers the time best is read: firmware logs some
messages once or twice a second, for telemetry. imu: ``sensor_combined``, ``vehicle_imu`` (increments), the
pairs ``sensor_gyro`` and ``sensor_accel``; forward, right, down. Times are sample times if the message has
them. The age of a fix is ``EKF2_GPS_DELAY``; from PX4 1.18 on (``SENS_GPS0_DELAY``) its own time is used.
"""

from __future__ import annotations

import contextlib
import io
from functools import lru_cache
from pathlib import Path

import numpy as np
from pyulog import ULog

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.formats.unreadable import describe_damage
from bench.io.logs.log_contents import Contents, OwnEstimate, OwnMotion, Vector, day_of_unix, split_instance
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.plugins.autopilots import ulog_motion
from bench.plugins.autopilots.ulog_motion import Data, stack, times
from bench.simulation.signals.air import pressure_altitude

FORMAT = {"endings": (".ulg",), "topics": True, "knows": True, "package": "pyulog"}
"""Its row in `bench.io.log_formats`."""

_MOST_BYTES = 1_000_000_000  # pyulog keeps the file and the wanted messages in memory
_LEAST_COVERED = 0.5  # part of the time between two rows of an IMU that the rows measured
_LEAST_RATE = 50.0  # of an IMU whose rows do not say what time they cover [Hz]
_TOPICS = {
    "imu": ("sensor_combined", "vehicle_imu", "sensor_gyro"),
    "gnss": ("vehicle_gps_position", "sensor_gps"),
    "baro": ("vehicle_air_data", "sensor_baro"),
    "mag": ("vehicle_magnetometer",),
    "airspeed": ("airspeed", "airspeed_validated"),
    "radar": ("distance_sensor",),
    "heading": ("vehicle_gps_position", "sensor_gps"),
}
_WITH = {"sensor_gyro": ("sensor_accel",)}
"""Message -> others that it needs."""
_DOWNWARD = 25  # distance_sensor.orientation: ROTATION_DOWNWARD_FACING
_GAUSS = 1e-4  # [T]


@lru_cache(maxsize=1)
def _open(path: Path, changed: int, wanted: tuple[str, ...]) -> ULog:
    try:
        # pyulog prints messages on a broken file
        with path.open("rb") as file, contextlib.redirect_stdout(io.StringIO()):
            return ULog(file, list(wanted))
    except Exception as error:  # a broken file can make pyulog raise anything
        raise describe_damage(path, error) from None


def open_log(path: Path, topic: str | None = None) -> ULog:
    """Return a log with the messages of all sensors; the last one stays open for the next of them."""
    check_file(path, path.name, _MOST_BYTES)
    named = {name for names in _TOPICS.values() for name in names} | {"sensor_accel", *ulog_motion.MESSAGES}
    if topic is not None:
        named.add(topic.partition(":")[0])
    return _open(path, path.stat().st_mtime_ns, tuple(sorted(named)))


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a sensor; ``topic`` is a message, or ``message:instance``."""
    if kind not in _TOPICS:
        raise ConfigError(f"{path.name}: no {kind} is read from a ULog")
    log = open_log(path, topic)
    name, number = split_instance(topic or "")
    instance = number or 0
    wanted = (name,) if topic else _TOPICS[kind]
    found = {one: data for one in wanted if (data := ulog_motion.find(log, one, instance))}
    if kind == "heading":  # one of the messages may pass it on, and the other not
        found = {one: data for one, data in found.items() if np.isfinite(data.get("heading", np.nan)).any()}
    if not found:
        there = ", ".join(sorted(log.message_formats))[:300]
        raise ConfigError(f"{path.name}: no rows of {' or '.join(wanted)}; it defines {there or 'none'}")
    name = _choose(kind, found) if len(found) > 1 else next(iter(found))
    data = found[name]
    if len(data["timestamp"]) > MOST_ROWS:
        raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
    notes = [f"{path.name}: the log is damaged; the readable part is used"] if log.file_corruption else []
    try:
        t = times(data)
        if kind == "imu":
            values = read_imu(log, name, instance, data)
            _check_cover(path, name, t, data)
        elif kind in ("gnss", "heading"):
            t, fix = _read_gnss(log, t, data, instance, notes)
            values = fix if kind == "gnss" else {**_read_heading(data), "arrival": fix["arrival"]}
        else:
            values = _READERS[kind](data)
    except KeyError as error:
        raise ConfigError(f"{path.name}: message {name} has no field {error.args[0]!r}") from None
    return LogRows(
        t, values, tuple(note if note.startswith(path.name) else f"{path.name}: {note}" for note in notes)
    )


_BARO_SD = "EKF2_BARO_NOISE"
"""Parameter that says the noise of the barometer [m]."""


def look(path: Path) -> Contents:
    """Return the contents of a log."""
    log = open_log(path)
    sensors = []
    for kind in _TOPICS:
        with contextlib.suppress(ConfigError):
            rows = read("ulog", path, kind, None)
            measured = rows.values.get("lla", next(iter(rows.values.values())))
            valid = rows.values.get("valid", np.ones(1)) > 0
            if np.isfinite(measured).any() and valid.any():
                sensors.append(kind)
    gps = next((one for name in _TOPICS["gnss"] if (one := ulog_motion.find(log, name))), None)
    date = None
    if gps is not None and "time_utc_usec" in gps:
        date = day_of_unix(1e-6 * float(np.max(np.asarray(gps["time_utc_usec"], float))))
    return Contents(
        tuple(sensors),
        _find_place(log, "EKF2_IMU_POS_"),
        _find_place(log, "SENS_GPS0_OFF") or _find_place(log, "EKF2_GPS_POS_"),
        date,
        ulog_motion.find(log, ulog_motion.TRUTH) is not None,
        ulog_motion.has_estimate(log),
        (sd, _BARO_SD) if 0.0 < (sd := _read_parameter(log, _BARO_SD) or 0.0) < 1e3 else None,
    )


def read_truth(path: Path) -> OwnMotion:
    """Return the truth of a simulator in a log (`ulog_motion`)."""
    log = open_log(path)
    gps = next((one for name in _TOPICS["gnss"] if (one := ulog_motion.find(log, name))), None)
    fixed = np.nan
    if gps is not None:
        _, values = _read_gnss(log, times(gps), gps, 0, [])
        fixed = float(np.nanmedian(values["lla"][:, 2]))
    return ulog_motion.read_truth(log, find_undulation(log), fixed)


def read_estimate(path: Path, instance: int | None) -> OwnEstimate:
    """Return the estimate of an instance of EKF2 in a log; None selects the instance that flew."""
    log = open_log(path)
    return ulog_motion.read_estimate(log, instance, find_undulation(log))


def find_undulation(log: ULog) -> float:
    """Return by how much ellipsoidal heights of a receiver are above those over the sea [m]; 0 if unknown."""
    gps = next((one for name in _TOPICS["gnss"] if (one := ulog_motion.find(log, name))), None)
    if gps is None:
        return 0.0
    sea, ellipsoid = ("alt", "alt_ellipsoid") if "alt" in gps else ("altitude_msl_m", "altitude_ellipsoid_m")
    if not {sea, ellipsoid} <= gps.keys():
        return 0.0
    scale = 1e-3 if "alt" in gps else 1.0
    fixed = (np.asarray(gps["fix_type"]) >= 3) & (np.asarray(gps[ellipsoid]) != 0)
    apart = scale * (np.asarray(gps[ellipsoid], float) - np.asarray(gps[sea], float))[fixed]
    return float(np.median(apart)) if len(apart) else 0.0


def _find_place(log: ULog, stem: str) -> Vector | None:
    x, y, z = (_read_parameter(log, f"{stem}{axis}") for axis in "XYZ")
    return None if x is None or y is None or z is None else (x, y, z)


def _read_parameter(log: ULog, name: str) -> float | None:
    """Return a parameter at the start; None if the log has none, or no number."""
    value = log.initial_parameters.get(name)  # bytes if the log says that it is no number
    return float(value) if isinstance(value, int | float) and np.isfinite(value) else None


def _choose(kind: str, found: dict[str, Data]) -> str:
    """Return the message with the most rows; of an IMU among those that cover the time between them."""

    def rank(name: str) -> tuple[bool, int, int]:
        data = found[name]
        covers = kind != "imu" or measure_cover(times(data), data) >= _LEAST_COVERED
        return covers, len(data["timestamp"]), -_TOPICS[kind].index(name)

    best = max(found, key=rank)
    first = next(iter(found))  # raw samples of a gyro tell no more than what is integrated of them
    return first if best == "sensor_gyro" and rank(first)[0] else best


def _read_duration(data: Data, name: str) -> FloatArray:
    """Return durations in seconds; old firmware has them so, later one in microseconds."""
    found = np.asarray(data[name], float)
    return np.asarray(found if np.median(found) < 1.0 else 1e-6 * found)


def measure_cover(t: FloatArray, data: Data) -> float:
    """Return the part of the time between two rows that the rows measured themselves, by the median."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else 0.0
    if not step > 0.0:  # rows of the same time: reading them says more
        return 1.0
    name = next((one for one in ("delta_angle_dt", "gyro_integral_dt") if one in data), None)
    if name is None:
        return 1.0 if step * _LEAST_RATE <= 1.0 else 0.0
    return float(np.median(_read_duration(data, name))) / step


def _check_cover(path: Path, name: str, t: FloatArray, data: Data) -> None:
    covered = measure_cover(t, data)
    if covered < _LEAST_COVERED:
        rate = (len(t) - 1) / float(np.ptp(t))
        raise ConfigError(
            f"{path.name}: {name} has {rate:.3g} rows a second, which measured {100 * covered:.2g} % of the "
            "time between them: too few to navigate; log the IMU at full rate (SDLOG_PROFILE)"
        )


def read_imu(log: ULog, name: str, instance: int, data: Data) -> dict[str, FloatArray]:
    """Return rates, or those over the interval that the increments are of; clipped rows are not valid."""
    values: dict[str, FloatArray]
    if "delta_angle[0]" in data:
        values = {
            of: stack(data, *(f"delta_{what}[{k}]" for k in range(3)))
            / _read_duration(data, f"delta_{what}_dt")[:, None]
            for of, what in (("gyro", "angle"), ("accel", "velocity"))
        }
    elif name == "sensor_gyro":
        accel = ulog_motion.find(log, "sensor_accel", instance)
        if accel is None:
            raise KeyError("sensor_accel")
        at, force = times(accel), stack(accel, "x", "y", "z")
        moved = [np.interp(times(data), at, column) for column in force.T]
        values = {"gyro": stack(data, "x", "y", "z"), "accel": np.column_stack(moved)}
    else:
        values = {
            "gyro": stack(data, *(f"gyro_rad[{k}]" for k in range(3))),
            "accel": stack(data, *(f"accelerometer_m_s2[{k}]" for k in range(3))),
        }
    clipped: BoolArray = np.zeros(len(data["timestamp"]), np.bool_)
    for flags in (
        "accelerometer_clipping",
        "gyro_clipping",
        "delta_velocity_clipping",
        "delta_angle_clipping",
    ):
        if flags in data:
            clipped |= np.asarray(data[flags]) > 0
    return {**values, "valid": (~clipped).astype(float)} if clipped.any() else values


def _read_gnss(
    log: ULog, t: FloatArray, data: Data, instance: int, notes: list[str]
) -> tuple[FloatArray, dict[str, FloatArray]]:
    if "latitude_deg" in data:
        names = ("latitude_deg", "longitude_deg", "altitude_ellipsoid_m")
        lat, lon, alt = (np.asarray(data[name], float) for name in names)
        sea = np.asarray(data.get("altitude_msl_m", alt), float)
    else:  # before PX4 1.14
        lat, lon = (1e-7 * np.asarray(data[name], float) for name in ("lat", "lon"))
        alt = 1e-3 * np.asarray(data["alt_ellipsoid"], float)
        sea = 1e-3 * np.asarray(data.get("alt", data["alt_ellipsoid"]), float)
    if not alt.any():
        alt = sea
        notes.append("its heights are over the sea; the receiver gave none over the ellipsoid")
    lla = np.column_stack([np.deg2rad(lat), np.deg2rad(lon), alt])
    vel_n = stack(data, *(f"vel_{a}_m_s" for a in "ned"))
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
    arrival = 1e-6 * np.asarray(data["timestamp"], float)
    values["arrival"] = arrival
    own = f"SENS_GPS{instance}_DELAY"
    late = _read_parameter(log, "EKF2_GPS_DELAY")
    if own in log.initial_parameters or late is None:
        return t, values
    delay = 1e-3 * late
    notes.append(f"a fix is {delay:.3g} s old when it is logged, by EKF2_GPS_DELAY")
    return arrival - delay, values


def _read_baro(data: Data) -> dict[str, FloatArray]:
    if "baro_alt_meter" in data:
        return {"alt_baro": np.asarray(data["baro_alt_meter"], float)[:, None]}
    return {"alt_baro": pressure_altitude(np.asarray(data["pressure"], float))[:, None]}


def _read_mag(data: Data) -> dict[str, FloatArray]:
    return {"field_b": _GAUSS * stack(data, *(f"magnetometer_ga[{k}]" for k in range(3)))}


def _read_airspeed(data: Data) -> dict[str, FloatArray]:
    """Return true airspeeds, for which the autopilot takes the density of the air."""
    return {"airspeed_true": np.asarray(data["true_airspeed_m_s"], float)}


def _read_heading(data: Data) -> dict[str, FloatArray]:
    """Return headings of the vehicle: the driver of the receiver has taken off the offset of its antennas."""
    heading = np.asarray(data["heading"], float)
    sd = np.asarray(data.get("heading_accuracy", np.zeros(len(heading))), float)
    told = np.isfinite(heading)
    return {"heading": heading, **({"sd": sd} if (sd[told] > 0).all() else {})}


def read_radar(data: Data) -> dict[str, FloatArray]:
    """Return heights, valid where the sensor looks down and measures within its limits."""
    distance = np.asarray(data["current_distance"], float)
    good = (distance > np.asarray(data["min_distance"])) & (distance < np.asarray(data["max_distance"]))
    if "orientation" in data:
        good &= np.asarray(data["orientation"]) == _DOWNWARD
    if "signal_quality" in data:
        good &= np.asarray(data["signal_quality"]) != 0
    return {"height": distance, "valid": good.astype(float)}


_READERS = {"baro": _read_baro, "mag": _read_mag, "airspeed": _read_airspeed, "radar": read_radar}
