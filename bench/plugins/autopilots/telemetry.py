"""Telemetry logs of MAVLink (``.tlog``), as ground stations write them; decoded by pymavlink.

Each message follows the time of its arrival [us since 1970, 8 bytes, big-endian]. Fields and units are those
in common.xml of MAVLink; the axes are forward, right, down. Times count from the start of the autopilot. imu:
``HIGHRES_IMU``, ``RAW_IMU`` (in mg and mrad/s, as ArduPilot sends it), ``SCALED_IMU`` and its second and
third; gnss: ``GPS_RAW_INT``, whose velocity has no component down; baro: ``SCALED_PRESSURE``; mag: with the
IMU. The estimate of the autopilot: ``GLOBAL_POSITION_INT`` and ``ATTITUDE``, with no covariance.
"""

from __future__ import annotations

from array import array
from collections.abc import Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import from_euler
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.words.exceptions import ConfigError
from bench.io.logs.log_contents import (
    Contents,
    OwnEstimate,
    OwnMotion,
    day_of_unix,
    no_values,
    split_instance,
)
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.simulation.signals.air import pressure_altitude

FORMAT = {"endings": (".tlog",), "topics": True, "knows": True, "package": "pymavlink"}
"""Its row in `bench.io.log_formats`."""

_MOST_BYTES = 1_000_000_000
_LEAST_RATE = 20.0  # of an IMU that can be navigated [Hz]
_MILLI_G, _MILLI = 1e-3 * STANDARD_GRAVITY, 1e-3
_IMUS = {"HIGHRES_IMU": 105, "RAW_IMU": 27, "SCALED_IMU": 26, "SCALED_IMU2": 116, "SCALED_IMU3": 129}
_IDS = {
    **_IMUS,
    **{"GPS_RAW_INT": 24, "SCALED_PRESSURE": 29, "ATTITUDE": 30, "GLOBAL_POSITION_INT": 33, "SYSTEM_TIME": 2},
}
_TOPICS = {"imu": (*_IMUS,), "gnss": ("GPS_RAW_INT",), "baro": ("SCALED_PRESSURE",), "mag": (*_IMUS,)}
_AUTOPILOT = 1  # component MAV_COMP_ID_AUTOPILOT1
_UNIX = 1e9  # a time above it is since 1970, not since the start of the autopilot [s]

Columns = Mapping[str, FloatArray]


class _Telemetry(NamedTuple):
    messages: Mapping[str, Columns]  # of the autopilot: name -> columns in the units of the message
    day: float  # arrival of the first message [s since 1970]
    skipped: int  # bytes


def _list_frames(raw: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield start, end and message id of each frame, behind its time of arrival."""
    at, end = 0, len(raw)
    while at + 16 <= end:
        magic, length = raw[at + 8], raw[at + 9]
        plausible = 1e15 < int.from_bytes(raw[at : at + 8], "big") < 4e15
        if plausible and magic in (0xFD, 0xFE):
            newer = magic == 0xFD
            stop = at + 8 + length + ((25 if raw[at + 10] & 1 else 12) if newer else 8)
            if stop <= end and (stop + 8 >= end or raw[stop + 8] in (0xFD, 0xFE)):
                yield at, stop, int.from_bytes(raw[at + 15 : at + 18], "little") if newer else raw[at + 13]
                at = stop
                continue
        at += 1


@lru_cache(maxsize=1)
def _open(path: Path, changed: int) -> _Telemetry:
    common: Any = import_module("pymavlink.dialects.v20.common")
    raw, parser = path.read_bytes(), common.MAVLink(None)
    names = {number: name for name, number in _IDS.items()}
    rows: dict[tuple[int, int], dict[str, array[float]]] = {}  # system and component -> name -> rows
    fields: dict[str, tuple[str, ...]] = {}
    read, first = 0, 0.0
    for begin, stop, number in _list_frames(raw):
        if (name := names.get(number)) is not None:
            try:
                message = parser.decode(bytearray(raw[begin + 8 : stop]))
            except common.MAVError:
                continue
            fields[name] = ("arrival", *message.fieldnames)
            came = 1e-6 * int.from_bytes(raw[begin : begin + 8], "big")
            first = first or came
            sender = rows.setdefault((message.get_srcSystem(), message.get_srcComponent()), {})
            of = sender.setdefault(name, array("d"))
            of.extend((came, *(float(getattr(message, field)) for field in message.fieldnames)))
            if len(of) > MOST_ROWS * len(fields[name]):
                raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
        read += stop - begin
    if not rows:
        raise ConfigError(f"{path.name}: no MAVLink messages with motion; expected {', '.join(_IDS)}")
    # a camera or gimbal beside the autopilot measures, too
    own = max(rows, key=lambda sender: (sender[1] == _AUTOPILOT, sum(map(len, rows[sender].values()))))
    messages = {
        name: dict(zip(fields[name], np.frombuffer(of).reshape(-1, len(fields[name])).T, strict=True))
        for name, of in rows[own].items()
    }
    return _Telemetry(messages, first, len(raw) - read)


def _open_log(path: Path) -> _Telemetry:
    check_file(path, path.name, _MOST_BYTES)
    return _open(path, path.stat().st_mtime_ns)


def _read_times(log: _Telemetry, name: str) -> FloatArray:
    """Return times since the start of the autopilot [s]; times since 1970 by SYSTEM_TIME or by arrival."""
    data = log.messages[name]
    t = _MILLI * data["time_boot_ms"] if "time_boot_ms" in data else 1e-6 * data["time_usec"]
    if float(np.median(t)) < _UNIX:
        return np.asarray(t)
    clock = log.messages.get("SYSTEM_TIME")
    if clock is not None and len(known := np.flatnonzero(clock["time_unix_usec"])):
        away = 1e-6 * clock["time_unix_usec"] - _MILLI * clock["time_boot_ms"]
        return np.asarray(t - np.median(away[known]))
    boot = [one for one in log.messages.values() if "time_boot_ms" in one]
    return np.asarray(
        t - min((float(np.min(o["arrival"] - _MILLI * o["time_boot_ms"])) for o in boot), default=0.0)
    )


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a sensor; ``topic`` is the name of a message."""
    log = _open_log(path)
    if kind not in _TOPICS:
        raise ConfigError(f"{path.name}: no {kind} is read from a telemetry log")
    wanted = (split_instance(topic)[0],) if topic else _TOPICS[kind]
    name = max(
        (one for one in wanted if one in log.messages and one in _TOPICS[kind]),
        key=lambda one: len(log.messages[one]["arrival"]),
        default=None,
    )
    if name is None:
        there = ", ".join(sorted(log.messages))
        raise ConfigError(f"{path.name}: no messages {' or '.join(wanted)}; it has {there}")
    t, data = _read_times(log, name), log.messages[name]
    notes = [f"{log.skipped} bytes of it are no messages and are skipped"] if log.skipped else []
    if kind == "imu" and (rate := (len(t) - 1) / max(float(np.ptp(t)), 1e-9)) < _LEAST_RATE:
        raise ConfigError(
            f"{path.name}: {name} has {rate:.3g} rows a second, too few to navigate "
            f"(at least {_LEAST_RATE:g}); use the log on the autopilot itself, .bin or .ulg"
        )
    values = {"imu": _read_imu, "gnss": _read_gnss, "baro": _read_baro, "mag": _read_mag}[kind](name, data)
    if kind == "gnss" and not data["alt_ellipsoid"].any():
        notes.append("its heights are over the sea; the receiver gave none over the ellipsoid")
    return LogRows(t, values, tuple(f"{path.name}: {note}" for note in notes))


def _stack(data: Columns, stem: str, factor: float) -> FloatArray:
    return factor * np.stack([data[f"{axis}{stem}"] for axis in "xyz"], axis=-1)


def _read_imu(name: str, data: Columns) -> dict[str, FloatArray]:
    force, rate = (1.0, 1.0) if name == "HIGHRES_IMU" else (_MILLI_G, _MILLI)
    return {"gyro": _stack(data, "gyro", rate), "accel": _stack(data, "acc", force)}


def _read_mag(name: str, data: Columns) -> dict[str, FloatArray]:
    field = _stack(data, "mag", 1e-4 if name == "HIGHRES_IMU" else 1e-7)
    field[~field.any(axis=1)] = np.nan
    return {"field_b": field}


def _read_baro(name: str, data: Columns) -> dict[str, FloatArray]:
    pressure = 100.0 * data["press_abs"]
    return {"alt_baro": pressure_altitude(np.where(pressure > 0, pressure, np.nan))[:, None]}


def _read_gnss(name: str, data: Columns) -> dict[str, FloatArray]:
    alt = data["alt_ellipsoid"] if data["alt_ellipsoid"].any() else data["alt"]
    lla = np.column_stack([np.deg2rad(1e-7 * data["lat"]), np.deg2rad(1e-7 * data["lon"]), _MILLI * alt])
    lla[data["fix_type"] < 3] = np.nan  # GPS_FIX_TYPE_3D_FIX
    unknown = 65535.0
    known = (data["vel"] != unknown) & (data["cog"] != unknown)
    speed, course = np.where(known, 1e-2 * data["vel"], np.nan), np.deg2rad(1e-2 * data["cog"])
    down = np.full(len(speed), np.nan)
    values = {
        "lla": lla,
        "vel_n": np.column_stack([speed * np.cos(course), speed * np.sin(course), down]),
        "quality": data["fix_type"],
        "satellites": np.where(data["satellites_visible"] == 255.0, np.nan, data["satellites_visible"]),
    }
    if data["h_acc"].any():
        h, v, s = (_MILLI * data[one] for one in ("h_acc", "v_acc", "vel_acc"))
        values["sd_pos"] = np.stack([h / np.sqrt(2.0), h / np.sqrt(2.0), v], axis=-1)
        values["sd_vel"] = np.stack([s / np.sqrt(3.0)] * 3, axis=-1)
    else:
        values["dilution"] = np.where(data["eph"] == unknown, np.nan, 1e-2 * data["eph"])[:, None]
    return values


def look(path: Path) -> Contents:
    """Return the contents of a log."""
    log, sensors = _open_log(path), []
    for kind in _TOPICS:
        with suppress(ConfigError):
            if np.isfinite(next(iter(read("tlog", path, kind, None).values.values()))).any():
                sensors.append(kind)
    own = {"GLOBAL_POSITION_INT", "ATTITUDE"} <= log.messages.keys()
    return Contents(tuple(sensors), date=day_of_unix(log.day), estimate=own)


def read_estimate(path: Path, instance: int | None) -> OwnEstimate:
    """Return the estimate of the autopilot, with heights over the ellipsoid if the receiver gives both."""
    log = _open_log(path)
    if not {"GLOBAL_POSITION_INT", "ATTITUDE"} <= log.messages.keys() or instance is not None:
        raise ConfigError(
            f"{path.name}: its only estimate is in GLOBAL_POSITION_INT and ATTITUDE, without a topic"
        )
    place, turn = log.messages["GLOBAL_POSITION_INT"], log.messages["ATTITUDE"]
    fixes = log.messages.get("GPS_RAW_INT")
    undulation = 0.0
    if fixes is not None:
        known = np.flatnonzero((fixes["fix_type"] >= 3) & (fixes["alt_ellipsoid"] != 0))
        undulation = float(np.median((fixes["alt_ellipsoid"] - fixes["alt"])[known])) if len(known) else 0.0
    alt = _MILLI * (place["alt"] + undulation)
    lla = np.column_stack([np.deg2rad(1e-7 * place["lat"]), np.deg2rad(1e-7 * place["lon"]), alt])
    lla[~lla[:, :2].any(axis=1)] = np.nan
    vel_n = 1e-2 * np.stack([place["vx"], place["vy"], place["vz"]], axis=-1)
    q_nb = from_euler(turn["roll"], turn["pitch"], turn["yaw"])
    motion = OwnMotion(
        _read_times(log, "GLOBAL_POSITION_INT"), lla, vel_n, _read_times(log, "ATTITUDE"), q_nb
    )
    return OwnEstimate(motion, no_values(9), no_values(6))
