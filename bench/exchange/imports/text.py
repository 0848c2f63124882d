"""Text files of other tools: increments and fixes of KF-GINS, solutions of RTKLIB.

KF-GINS: columns separated by white space, as in src/fileio/imufileloader.h and gnssfileloader.h of
github.com/i2Nav-WHU/KF-GINS. IMU: second of week, increments of angle [rad] and velocity [m/s] forward,
right, down. GNSS: second of week, latitude, longitude [deg], height [m], standard deviations north, east,
down [m]; a file with 13 columns has the velocity before these standard deviations, and its own behind them.

RTKLIB: the ``.pos`` of RTKPOST and RNX2RTKP, whose last comment line names the columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.exchange.rows import MOST_ROWS, LogRows, to_lla
from bench.exchange.table_files import MOST_BYTES

_LINE = 4096  # longest line [characters]
_WEEK = 604_800.0  # [s]
_EPOCH = datetime(1980, 1, 6)
_BLOCK = 65_536  # rows converted at a time


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a KF-GINS or RTKLIB file."""
    if form == "rtklib":
        if kind != "gnss":
            raise ConfigError(f"{path.name}: a solution of RTKLIB holds fixes, not the rows of an {kind}")
        return _read_rtklib(path)
    if kind == "baro":
        raise ConfigError(f"{path.name}: KF-GINS has no file for a barometer")
    numbers = _read_numbers(path, (line for _, line in _read_lines(path)), None)
    columns = numbers.shape[1]
    if kind == "imu":
        if columns < 7:
            raise ConfigError(
                f"{path.name}: an IMU file of KF-GINS has 7 columns or more; this has {columns}"
            )
        return LogRows(numbers[:, 0], {"dtheta": numbers[:, 1:4], "dvel": numbers[:, 4:7]})
    if columns not in (7, 13):
        raise ConfigError(f"{path.name}: a GNSS file of KF-GINS has 7 or 13 columns; this has {columns}")
    values = {"lla": _to_lla(numbers[:, 1:4]), "sd_pos": numbers[:, 4:7]}
    if columns == 13:
        values = {"lla": values["lla"], "vel_n": numbers[:, 4:7], "sd_pos": numbers[:, 7:10]}
        values["sd_vel"] = numbers[:, 10:13]
    return LogRows(numbers[:, 0], values)


def _read_rtklib(path: Path) -> LogRows:
    names: list[str] = []
    first = -1

    def rows() -> Iterator[str]:
        nonlocal names, first
        for number, line in _read_lines(path):
            if line.startswith("%"):
                names = line[1:].split() if "lat" in line or "x-ecef" in line else names
            elif first < 0:
                first = number
                yield line
            else:
                yield line

    lines = list(_convert_times(path, rows()))
    known = [name.partition("(")[0] for name in names[1:]]  # the first is the time system, of two columns
    if not known:
        raise ConfigError(f"{path.name}: no line that names the columns, such as '%  GPST latitude(deg) ...'")
    numbers = _read_numbers(path, iter(lines), len(known) + 1)
    column = {name: numbers[:, k + 1] for k, name in enumerate(known)}
    at = {name.partition("(")[0]: name for name in names}

    def stack(*wanted: str) -> FloatArray | None:
        return (
            np.stack([column[name] for name in wanted], axis=-1) if all(w in column for w in wanted) else None
        )

    geodetic, fixed = stack("latitude", "longitude", "height"), stack("x-ecef", "y-ecef", "z-ecef")
    if geodetic is not None and "(deg)" not in at["latitude"]:
        raise ConfigError(f"{path.name}: latitude must be in degrees: {at['latitude']}")
    if geodetic is None and fixed is None:
        raise ConfigError(f"{path.name}: no columns latitude, longitude, height or x-ecef, y-ecef, z-ecef")
    values = {"lla": _to_lla(geodetic) if geodetic is not None else to_lla(np.asarray(fixed))}
    if geodetic is not None:
        optional = {
            "vel_n": stack("vn", "ve", "vu"),
            "sd_pos": stack("sdn", "sde", "sdu"),
            "sd_vel": stack("sdvn", "sdve", "sdvu"),
        }
        values |= {name: value for name, value in optional.items() if value is not None}
        if "vel_n" in values:
            values["vel_n"] = values["vel_n"] * [1.0, 1.0, -1.0]
    values |= {new: column[old] for new, old in (("quality", "Q"), ("satellites", "ns")) if old in column}
    return LogRows(numbers[:, 0], values)


def _convert_times(path: Path, lines: Iterator[str]) -> Iterator[str]:
    """Yield the rows with date and time, or week and second, as GPS seconds since 1980-01-06."""
    for number, line in enumerate(lines, 1):
        day, _, rest = line.strip().partition(" ")
        clock, _, rest = rest.strip().partition(" ")
        try:
            if "/" in day:
                date = datetime.strptime(day, "%Y/%m/%d")
                hours, minutes, seconds = (float(part) for part in clock.split(":"))
                t = (date - _EPOCH).total_seconds() + 3600.0 * hours + 60.0 * minutes + seconds
            else:
                t = float(day) * _WEEK + float(clock)
        except ValueError:
            raise ConfigError(
                f"{path.name}: row {number}: {line.strip()[:40]!r} does not begin with a time"
            ) from None
        if number > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
        yield f"{t:.6f} {rest}"


def _read_lines(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a file that are not blank, with their numbers."""
    if path.stat().st_size > MOST_BYTES:
        raise ConfigError(f"{path.name}: larger than {MOST_BYTES // 1_000_000} MB")
    try:
        with path.open(encoding="utf-8") as file:
            number = 0
            while line := file.readline(_LINE):
                number += 1
                if len(line) >= _LINE:
                    raise ConfigError(f"{path.name}: row {number} is longer than {_LINE} characters")
                if line.strip():
                    yield number, line
    except UnicodeDecodeError:
        raise ConfigError(f"{path.name}: not a text file in UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{path.name}: {error.strerror or error}") from None


def _read_numbers(path: Path, lines: Iterator[str], columns: int | None) -> FloatArray:
    """Return lines of numbers as an array (N, columns)."""
    blocks: list[FloatArray] = []
    block: list[list[float]] = []
    for count, line in enumerate(lines, 1):
        try:
            row = [float(text) for text in line.replace(",", " ").split()]
        except ValueError:
            raise ConfigError(
                f"{path.name}: row {count}: {line.strip()[:40]!r} is not a row of numbers"
            ) from None
        columns = columns or len(row)
        if len(row) != columns:
            raise ConfigError(f"{path.name}: row {count} has {len(row)} columns, not {columns}")
        if count > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
        block.append(row)
        if len(block) == _BLOCK:
            blocks.append(np.array(block))
            block = []
    if block:
        blocks.append(np.array(block))
    if not blocks:
        raise ConfigError(f"{path.name}: no rows")
    return np.concatenate(blocks)


def _to_lla(degrees: FloatArray) -> FloatArray:
    return np.column_stack([np.deg2rad(degrees[:, :2]), degrees[:, 2]])
