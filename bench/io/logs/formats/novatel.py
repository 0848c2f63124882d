"""Logs of NovAtel OEM receivers with SPAN; docs.novatel.com/OEM7, pages of the logs named here.

imu: ``RAWIMU``, ``RAWIMUS`` (``topic`` names the IMU), ``RAWIMUX``, ``RAWIMUSX``: counts along x right, y
forward, z up, with the scale factors in oem7_imu.cpp of github.com/novatel/novatel_oem7_driver. gnss:
``BESTGNSSPOS`` or ``BESTPOS``, with ``BESTGNSSVEL`` or ``BESTVEL`` of the same time; as a reference by
``topic``: ``INSPVAX``, ``INSPVA``, ``INSPVAS``, with attitude. Times are in GPS seconds since 1980-01-06.
"""

from __future__ import annotations

import math
import zlib
from array import array
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import from_euler
from bench.core.mathematics.units import ARCSEC, DEG, STANDARD_GRAVITY
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import NOVATEL_BINARY, is_kind
from bench.io.logs.formats.novatel_binary import Log, read_binary_logs
from bench.io.logs.formats.text import read_lines
from bench.io.logs.rows import MOST_ROWS, LogRows
from bench.simulation.signals.orbits import WEEK

_FOOT = 0.3048
_MILLI_G = 1e-3 * STANDARD_GRAVITY
_IMUS: Mapping[str, tuple[tuple[int, ...], float, float]] = {
    "HG1700-AG58": ((1, 5, 11, 20, 27, 28), 2.0**-33, _FOOT * 2.0**-27),
    "HG1700-AG62": ((4, 12), 2.0**-33, _FOOT * 2.0**-26),
    "LN-200": ((8,), 2.0**-19, 2.0**-14),
    "FSAS": ((13,), 0.1 * 2.0**-8 * ARCSEC, 0.05 * 2.0**-15),
    "KVH-1750": ((16, 33), 0.1 / (3600.0 * 256.0), 0.05 * 2.0**-15),
    "ISA-100C": ((26, 52), 1e-9, 2e-8),
    "ADIS16488": ((31,), 720.0 * 2.0**-31 * DEG, 200.0 * 2.0**-31),
    "STIM300": ((32, 56), 2.0**-21 * DEG, 2.0**-22),
    "HG4930": ((58, 68, 69), 2.0**-33, 2.0**-29),
    "EPSON-G320": ((41,), 0.008 * 2.0**-16 * DEG / 125.0, 0.2 * 2.0**-16 * _MILLI_G / 125.0),
    "EPSON-G320-200HZ": ((62,), 0.008 * 2.0**-16 * DEG / 200.0, 0.2 * 2.0**-16 * _MILLI_G / 200.0),
    "EPSON-G370": ((61,), 0.0151515 * 2.0**-16 * DEG / 200.0, 0.4 * 2.0**-16 * _MILLI_G / 200.0),
}
"""IMU -> its types in the logs, the scale factors of angles [rad] and velocities [m/s]."""
_RAW = ("RAWIMUSX", "RAWIMUX", "RAWIMUS", "RAWIMU")
_FIXES = {"BESTGNSSPOS": "BESTGNSSVEL", "BESTPOS": "BESTVEL"}
_SOLUTIONS = ("INSPVAX", "INSPVA", "INSPVAS")
_GOOD = {"SOL_COMPUTED", "INS_SOLUTION_GOOD", "INS_ALIGNMENT_COMPLETE", "INS_SOLUTION_FREE"}
_NEAR_GRAVITY = 0.05  # part of gravity by which an IMU is told from another [1]
_NO_CRC = "00000000"  # of files that a program made


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of the IMU, the fixes or a solution."""
    if kind == "imu":
        return _read_imu(path, topic)
    if kind != "gnss":
        raise ConfigError(f"{path.name}: no {kind} is read from a NovAtel log")
    logs, notes = _read_logs(path, (topic,) if topic else (*_FIXES, *_FIXES.values()))
    name = next((one for one in ((topic,) if topic else _FIXES) if one in logs), None)
    if name is None:
        there = "; topic = 'INSPVAX' reads its solution" if topic is None else ""
        raise ConfigError(f"{path.name}: no logs {topic or ' or '.join(_FIXES)}{there}")
    if name in _SOLUTIONS:
        return _read_solution(logs[name], name, notes)
    if name not in _FIXES:
        raise ConfigError(f"{path.name}: topic must be {', '.join((*_FIXES, *_SOLUTIONS))}; it is {topic!r}")
    rows = logs[name]
    values = {"lla": _place(rows[:, 4:8]), "sd_pos": rows[:, 9:12], "satellites": rows[:, 16]}
    speeds = logs.get(_FIXES[name])
    if speeds is not None:
        at = np.clip(np.searchsorted(speeds[:, 0], rows[:, 0] - 1e-3), 0, len(speeds) - 1)
        speed, course, up = speeds[at, 6], np.deg2rad(speeds[at, 7]), speeds[at, 8]
        vel_n = np.column_stack([speed * np.cos(course), speed * np.sin(course), -up])
        apart = np.abs(speeds[at, 0] - rows[:, 0]) > 1e-3
        vel_n[apart | (speeds[at, 1] == 0)] = np.nan
        values["vel_n"] = vel_n
        if (late := float(np.nanmedian(speeds[:, 4]))) > 0.0:
            text = f"its velocities are {late:.3g} s old: velocity_offset_s = -{late:.3g}"
            notes = (*notes, f"{path.name}: {text}")
    values["lla"][rows[:, 1] == 0] = np.nan
    return LogRows(rows[:, 0], values, notes)


def _read_logs(path: Path, wanted: Collection[str]) -> tuple[dict[str, FloatArray], tuple[str, ...]]:
    """Return the rows of logs: the time, 1 if a status is good, and the fields; texts are NaN.

    Rows with a wrong checksum or another number of fields are left out and counted.
    """
    flat: dict[str, array[float]] = {}
    widths: dict[str, int] = {}
    bad = 0
    for log in read_binary_logs(path) if is_kind(NOVATEL_BINARY, path) else _read_lines(path, wanted):
        if log is None or widths.setdefault(log[0], len(log[3]) + 2) != len(log[3]) + 2:
            bad += 1
            continue
        name, t, good, fields = log
        if name not in wanted:
            continue
        rows = flat.setdefault(name, array("d"))
        rows.extend([t, float(good), *fields])
        if len(rows) > MOST_ROWS * widths[name]:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} logs {name}")
    notes = (f"{path.name}: {bad} logs are damaged and left out",) if bad else ()
    return {name: np.array(rows).reshape(-1, widths[name]) for name, rows in flat.items()}, notes


def _read_lines(path: Path, wanted: Collection[str]) -> Iterator[Log | None]:
    """Yield each ASCII log; None if it is damaged."""
    for line in read_lines(path):
        head, found, body = line.partition(";")
        cells = head.split(",")
        name = cells[0][1:].removesuffix("A")
        if not found or name not in wanted or line[0] not in "#%":
            continue
        text, _, crc = line.strip()[1:].rpartition("*")
        fields = body.rpartition("*")[0].split(",")
        try:
            week, second = (float(cell) for cell in (cells[5:7] if line[0] == "#" else cells[1:3]))
        except ValueError:
            week = second = math.nan
        right = crc == _NO_CRC or f"{zlib.crc32(text.encode(), 0xFFFFFFFF) ^ 0xFFFFFFFF:08x}" == crc.lower()
        if right and not math.isnan(week):
            yield name, week * WEEK + second, not _GOOD.isdisjoint(fields), [*map(_read_number, fields)]
        else:
            yield None


def _read_number(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return math.nan


def _place(columns: FloatArray) -> FloatArray:
    """Return positions (N, 3) of latitude, longitude [deg], height above the geoid and undulation [m]."""
    return np.column_stack([np.deg2rad(columns[:, :2]), columns[:, 2] + columns[:, 3]])


def _read_imu(path: Path, topic: str | None) -> LogRows:
    logs, notes = _read_logs(path, _RAW)
    name = next((one for one in _RAW if one in logs), None)
    if name is None:
        raise ConfigError(f"{path.name}: no logs {', '.join(_RAW)}")
    rows = logs[name]
    extended = name.endswith("X")
    week, second = (rows[:, 4], rows[:, 5]) if extended else (rows[:, 2], rows[:, 3])
    t, counts = week * WEEK + second, rows[:, -6:]
    angles, velocities = (counts[:, k : k + 3][:, [1, 2, 0]] * [-1.0, 1.0, -1.0] for k in (3, 0))
    imu = topic or next((key for key, one in _IMUS.items() if extended and rows[0, 3] in one[0]), None)
    if imu is None:
        imu = _tell_by_gravity(path, t, velocities, name)
        notes = (*notes, f"{path.name}: its IMU is taken as {imu} by gravity; topic = {imu!r} confirms it")
    if imu not in _IMUS:
        raise ConfigError(f"{path.name}: topic of [imu] must be {', '.join(_IMUS)}; it is {imu!r}")
    _, turn, gain = _IMUS[imu]
    return LogRows(t, {"dtheta": turn * angles, "dvel": gain * velocities}, notes)


def _tell_by_gravity(path: Path, t: FloatArray, velocities: FloatArray, name: str) -> str:
    """Return the only IMU with whose scale factor the median of the specific force is gravity."""
    step = float(np.median(np.diff(t))) if len(t) > 1 else math.nan
    count = float(np.median(np.linalg.norm(velocities, axis=1))) / step if step > 0 else math.nan
    fits = [
        key
        for key, (_, _, gain) in _IMUS.items()
        if abs(gain * count / STANDARD_GRAVITY - 1.0) < _NEAR_GRAVITY
    ]
    if len(fits) == 1:
        return fits[0]
    asked = ", ".join(fits or _IMUS)
    raise ConfigError(f"{path.name}: {name} does not name its IMU; set topic of [imu] to one of {asked}")


def _read_solution(rows: FloatArray, name: str, notes: Sequence[str]) -> LogRows:
    """Return position, velocity and attitude of an INSPVA, INSPVAS or INSPVAX."""
    if name == "INSPVAX":
        lla, motion = _place(rows[:, 4:8]), rows[:, 8:14]
    else:  # heights are above the ellipsoid
        lla, motion = np.column_stack([np.deg2rad(rows[:, 4:6]), rows[:, 6]]), rows[:, 7:13]
    lla[rows[:, 1] == 0] = np.nan
    values = {
        "lla": lla,
        "vel_n": motion[:, :3] * [1.0, 1.0, -1.0],
        "q_nb": from_euler(*np.deg2rad(motion[:, 3:]).T),
    }
    if name == "INSPVAX":
        values |= {"sd_pos": rows[:, 14:17], "sd_vel": rows[:, 17:20]}
    return LogRows(rows[:, 0], values, tuple(notes))
