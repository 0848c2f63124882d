"""Text files of other tools: increments and fixes of KF-GINS, solutions of RTKLIB.

KF-GINS: columns separated by white space, as in src/fileio/imufileloader.h and gnssfileloader.h of
github.com/i2Nav-WHU/KF-GINS, its results as in src/kf_gins.cpp. IMU: second of week, increments of angle
[rad] and velocity [m/s] forward, right, down. GNSS: second of week, latitude, longitude [deg], height [m],
standard deviations north, east, down [m]; a file with 13 columns has the velocity before these standard
deviations, and its own behind them.

RTKLIB: the ``.pos`` of RTKPOST and RNX2RTKP, whose last comment line names the columns.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from bench.core.files import disk_arrays
from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import describe_unreadable
from bench.io.logs.rows import MOST_ROWS, LogRows, to_lla
from bench.io.logs.table_files import MOST_BYTES, TableColumns
from bench.simulation.signals.gps_time import leap_seconds
from bench.simulation.signals.orbits import DAY, WEEK

_LINE = 4096  # longest line [characters]
_EPOCH = datetime(1980, 1, 6)
_SEPARATORS = re.compile("[,;]")  # that RTKLIB is asked for, if not white space
_AHEAD_OF_UTC = {"UTC": 0, "JST": 32400}  # time systems of RTKLIB other than GPS time [s]
_GEOID = "height=WGS84/geodetic"  # RTKLIB's word for heights above the geoid


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a KF-GINS or RTKLIB file."""
    if form == "rtklib":
        if kind != "gnss":
            use = 'name it in [gnss] or [reference] of a log: file = "FILE"'
            raise ConfigError(f"{path.name}: a solution of RTKLIB has no {kind.upper()}; {use}")
        return _read_rtklib(path)
    if kind == "baro":
        raise ConfigError(f"{path.name}: KF-GINS has no file for a barometer")
    numbers = read_number_rows(path)
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


def read_kf_gins_solution(path: Path) -> TableColumns:
    """Return the columns of a ``.nav`` of KF-GINS, with its standard deviations if ``STD`` is beside it.

    ``..._Navresult.nav``: week, second of week, latitude, longitude [deg], height [m], velocity north, east,
    down [m/s], roll, pitch, yaw [deg]; ``..._STD.txt``: second, standard deviations of position [m], velocity
    [m/s], attitude [deg] along n, and of the states of the IMU, which are not used.

    Raises
    ------
    ConfigError
        If a file is not of these columns, or the two have other rows.
    """
    rows = read_number_rows(path)
    if rows.shape[1] != 11:
        raise ConfigError(f"{path.name}: a solution of KF-GINS has 11 columns; this has {rows.shape[1]}")
    columns = {
        "time": rows[:, 1:2],
        "position": _to_lla(rows[:, 2:5]),
        "velocity": rows[:, 5:8],
        "attitude": np.deg2rad(rows[:, 8:11]),
    }
    beside = path.with_name(path.name.replace("Navresult.nav", "STD.txt"))
    if beside != path and beside.exists():
        spread = read_number_rows(beside)
        if spread.shape[1] < 10 or not np.array_equal(spread[:, 0], rows[:, 1]):
            raise ConfigError(
                f"{beside.name}: must have a time, 9 columns or more, and the times of {path.name}"
            )
        columns |= {
            "sd_pos": spread[:, 1:4],
            "sd_vel": spread[:, 4:7],
            "sd_phi": np.deg2rad(spread[:, 7:10]),
        }
    names = {
        "time": ("second of week",),
        "position": ("lat", "lon", "alt"),
        "velocity": ("vel_n", "vel_e", "vel_d"),
        "attitude": ("roll", "pitch", "yaw"),
    }
    return TableColumns(columns, names, names, ())


def _read_rtklib(path: Path) -> LogRows:
    names: list[str] = []
    notes: list[str] = []

    def rows() -> Iterator[str]:
        nonlocal names
        for line in read_lines(path):
            if not line.startswith("%"):
                yield line
            elif "lat" in line or "x-ecef" in line:
                names = _SEPARATORS.sub(" ", line[1:]).split()
            if _GEOID in line and not notes:
                notes.append(f"{path.name}: its heights are above the geoid, and are used as ellipsoidal")

    numbers = _read_numbers(path, rows(), _parse_solution, "a time and numbers")
    known = [name.partition("(")[0] for name in names[1:]]  # the first is the time system, of two columns
    if not known:
        raise ConfigError(f"{path.name}: no line that names the columns, such as '%  GPST latitude(deg) ...'")
    if numbers.shape[1] != len(known) + 1:
        raise ConfigError(f"{path.name}: row 1 has {numbers.shape[1]} columns, not {len(known) + 1}")
    column = {name: numbers[:, k + 1] for k, name in enumerate(known)}

    def stack(*wanted: str) -> FloatArray | None:
        return np.stack([column[w] for w in wanted], axis=-1) if all(w in column for w in wanted) else None

    geodetic, fixed = stack("latitude", "longitude", "height"), stack("x-ecef", "y-ecef", "z-ecef")
    values: dict[str, FloatArray | None] = {}
    if geodetic is not None:
        given = next(name for name in names if name.startswith("latitude"))
        if "(deg)" not in given:
            raise ConfigError(f"{path.name}: latitude must be in degrees: {given}")
        vel_enu = stack("ve", "vn", "vu")
        values = {
            "lla": _to_lla(geodetic),
            "vel_n": None if vel_enu is None else vel_enu[:, [1, 0, 2]] * [1.0, 1.0, -1.0],
            "sd_pos": stack("sdn", "sde", "sdu"),
            "sd_vel": stack("sdvn", "sdve", "sdvu"),
        }
    elif fixed is not None:
        values = {"lla": to_lla(fixed)}
    else:
        raise ConfigError(f"{path.name}: no columns latitude, longitude, height or x-ecef, y-ecef, z-ecef")
    values |= {"quality": column.get("Q"), "satellites": column.get("ns")}
    t = numbers[:, 0]
    if names[0] in _AHEAD_OF_UTC:
        days = float(np.clip(np.nan_to_num(t[0]) / DAY, 0.0, 36500.0))  # a century; the week may be garbage
        day = _EPOCH.date() + timedelta(days=days)
        ahead = leap_seconds(day) - _AHEAD_OF_UTC[names[0]]
        t = t + ahead
        notes.append(f"{path.name}: {ahead:+d} s from {names[0]}, which its header names, to GPS time")
    found = {name: value for name, value in values.items() if value is not None}
    return LogRows(t, found, tuple(notes))


def read_number_rows(path: Path) -> FloatArray:
    """Return the numbers of a text (N, columns), apart by spaces or commas; comments (#, %) do not count."""
    lines = (line for line in read_lines(path) if not line.lstrip().startswith(("#", "%")))
    return _read_numbers(path, lines, parse_row, "a row of numbers")


def parse_row(line: str) -> list[float]:
    """Return the numbers of a line, separated by spaces or commas; raise ValueError if one is none."""
    return [float(text) for text in line.replace(",", " ").split()]


def _parse_solution(line: str) -> list[float]:
    """Return the GPS seconds since 1980-01-06 of date and time, or of week and second, and the numbers."""
    day, clock, *rest = _SEPARATORS.sub(" ", line).split()
    if "/" in day:
        date = datetime.strptime(day, "%Y/%m/%d")
        hours, minutes, seconds = (float(part) for part in clock.split(":"))
        t = (date - _EPOCH).total_seconds() + 3600.0 * hours + 60.0 * minutes + seconds
    else:
        t = float(day) * WEEK + float(clock)
    return [round(t, 6), *map(float, rest)]


def read_lines(path: Path) -> Iterator[str]:
    """Yield the lines of a file that are not blank."""
    check_file(path, path.name, MOST_BYTES)
    try:
        with path.open(encoding="utf-8-sig") as file:
            number = 0
            while line := file.readline(_LINE):
                number += 1
                if len(line) >= _LINE:
                    raise ConfigError(f"{path.name}: row {number} is longer than {_LINE} characters")
                if line.strip():
                    yield line
    except UnicodeDecodeError:
        raise ConfigError(describe_unreadable(path, "not a text file in UTF-8")) from None
    except OSError as error:
        raise ConfigError(f"{path.name}: {error.strerror or error}") from None


def _read_numbers(
    path: Path, lines: Iterator[str], parse: Callable[[str], list[float]], content: str
) -> FloatArray:
    """Return the numbers of the lines as an array (N, columns)."""
    flat, columns, gathered = array("d"), 0, disk_arrays.Gathered(0)
    for count, line in enumerate(lines, 1):
        try:
            row = parse(line)
        except ValueError:
            raise ConfigError(f"{path.name}: row {count}: {line.strip()[:40]!r} is not {content}") from None
        if not columns:
            columns, gathered = len(row), disk_arrays.Gathered(len(row))
        if len(row) != columns:
            raise ConfigError(f"{path.name}: row {count} has {len(row)} columns, not {columns}")
        if count > MOST_ROWS:
            raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
        flat.extend(row)
        if count % disk_arrays.ROWS == 0:
            gathered.add(np.array(flat).reshape(-1, columns))
            flat = array("d")
    if not columns:
        raise ConfigError(f"{path.name}: no rows")
    gathered.add(np.array(flat).reshape(-1, columns))
    return gathered.join()


def _to_lla(degrees: FloatArray) -> FloatArray:
    return np.column_stack([np.deg2rad(degrees[:, :2]), degrees[:, 2]])
