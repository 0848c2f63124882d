"""Fixes in NMEA 0183 sentences: GGA, and the velocity of RMC or VTG of the same epoch.

Fields: Gpgga, Gprmc and Gpvtg of docs.ros.org/en/api/nmea_msgs. The date comes from RMC. Times become GPS
seconds since 1980-01-06.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Sequence
from datetime import date
from functools import reduce
from operator import xor
from pathlib import Path

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_count
from bench.io.logs.rows import MOST_ROWS, LogRows, to_horizontal
from bench.io.logs.table_files import MOST_BYTES
from bench.simulation.signals.gps_time import gps_seconds, leap_seconds
from bench.simulation.signals.orbits import DAY

_LONGEST = 1000  # line [characters]
_KNOT = 1852.0 / 3600.0  # [m/s]
_COLUMNS = 11
_CLOCK, _LAT, _LON, _ALT, _QUALITY, _SATELLITES, _HDOP, _SEA, _SPEED, _COURSE, _DAY = range(_COLUMNS)


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the fixes of a file of NMEA sentences.

    Raises
    ------
    ConfigError
        If the file cannot be read, or contains no GGA or no date: one line.
    """
    if kind != "gnss":
        read(form, path, "gnss", topic)  # a file without fixes is of no use anywhere
        use = "name the file in [gnss] or [reference] of a log"
        raise ConfigError(f"{path.name}: no {kind.upper()} in NMEA sentences; {use}")
    rows, day, broken = _read_epochs(path)
    if not len(rows):
        have = "has" if broken == 1 else "have"
        wrong = f"{format_count(broken, 'sentence')} {have} a wrong or no checksum; " if broken else ""
        raise ConfigError(
            f"{path.name}: no GGA sentence with a time; {wrong}let the receiver write GGA and RMC"
        )
    if day is None:
        raise ConfigError(
            f"{path.name}: no RMC sentence with a date and a fix, but GGA has no date: let the receiver "
            "write both"
        )
    values = {
        "lla": np.column_stack([np.deg2rad(rows[:, [_LAT, _LON]]), rows[:, _ALT]]),
        "quality": rows[:, _QUALITY],
        "satellites": rows[:, _SATELLITES],
        "valid": (rows[:, _QUALITY] > 0).astype(float),
    }
    if np.isfinite(rows[:, _HDOP]).any():
        values["dilution"] = rows[:, [_HDOP]]
    if np.isfinite(rows[:, _SPEED]).any():
        values["vel_n"] = to_horizontal(rows[:, _SPEED], np.deg2rad(rows[:, _COURSE]))
    ahead = leap_seconds(day)
    notes = tuple(f"{path.name}: {note}" for note in _list_notes(rows, broken))
    return LogRows(rows[:, _DAY] + rows[:, _CLOCK] + ahead, values, notes)


def read_places(path: Path) -> tuple[FloatArray, list[str]]:
    """Return times [s], latitudes, longitudes [deg], heights [m] (N, 4) of the fixes of a file, and notes."""
    rows, _, broken = _read_epochs(path)
    fixed = rows[:, _QUALITY] > 0
    rows, none = rows[fixed], int((~fixed).sum())
    notes = [f"left out: {format_count(none, 'sentence')} without a fix (quality 0)"] * (none > 0)
    notes += _list_notes(rows, broken)
    t = rows[:, _DAY] - rows[:1, _DAY] + rows[:, _CLOCK]
    return np.column_stack([t, rows[:, _LAT : _ALT + 1]]), notes


def _list_notes(rows: FloatArray, broken: int) -> list[str]:
    left = f"left out: {format_count(broken, 'sentence')} with a wrong checksum"
    above = int(np.nansum(rows[:, _SEA]))
    told = f"{format_count(above, 'height')} above the sea: sentences without a geoid separation"
    return [left] * (broken > 0) + [told] * (above > 0)


def _read_epochs(path: Path) -> tuple[FloatArray, date | None, int]:
    """Return the epochs with a GGA (N, columns), the first date, and the number of damaged sentences.

    The last column is the start of the day in seconds since 1980-01-06, without leap seconds. A clock that
    goes back by more than half a day has passed midnight.
    """
    flat, now, first = array("d"), [math.nan] * _COLUMNS, None
    start, days, last, broken, count = 0.0, 0.0, -1.0, 0, 0
    try:
        check_file(path, path.name, MOST_BYTES)
        with path.open(encoding="latin-1") as file:
            while line := file.readline(_LONGEST):
                kind = line[line.find("$") + 3 :].partition(",")[0]
                if kind not in ("GGA", "RMC", "VTG") or "$" not in line:
                    continue
                words = _split_sentence(line.strip())
                if not words:
                    broken += 1
                    continue
                t = now[_CLOCK] if kind == "VTG" else _parse_clock(words[1])
                if math.isnan(t):
                    continue
                if t != now[_CLOCK]:
                    count += _keep(now, flat)
                    if t < last - DAY / 2:
                        days += DAY
                    last = t
                    now = [t, *[math.nan] * (_COLUMNS - 2), days]
                dated = kind == "RMC" and words[2] == "A" and first is None
                if dated and (first := _parse_date(words[9])) is not None:
                    start = gps_seconds(first.year, first.month, first.day) - days
                _fill(now, kind, words)
                if count > MOST_ROWS:
                    raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")
    except OSError as error:
        raise ConfigError(f"{path.name}: {error.strerror or error}") from None
    _keep(now, flat)
    rows = np.array(flat).reshape(-1, _COLUMNS)
    rows[:, _DAY] += start
    return rows, first, broken


def _keep(now: Sequence[float], flat: array[float]) -> bool:
    """Append an epoch if it has a GGA; return whether it has."""
    known = not math.isnan(now[_QUALITY])
    if known:
        flat.extend(now)
    return known


def _fill(now: list[float], kind: str, words: Sequence[str]) -> None:
    """Enter the words of a sentence into its epoch."""
    if kind == "GGA":
        *now[_LAT : _ALT + 1], now[_SEA] = _parse_place(words)
        quality, now[_SATELLITES], now[_HDOP] = (parse_number(words[k]) for k in (6, 7, 8))
        now[_QUALITY] = 0.0 if math.isnan(quality) else quality
    elif kind == "RMC" and words[2] == "A":
        now[_SPEED : _COURSE + 1] = [parse_number(words[7]) * _KNOT, parse_number(words[8])]
    elif kind == "VTG" and math.isnan(now[_SPEED]):
        now[_SPEED : _COURSE + 1] = [parse_number(words[5]) * _KNOT, parse_number(words[1])]


def _parse_date(text: str) -> date | None:
    """Return the day of ddmmyy; None if it is none."""
    try:
        return date(2000 + int(text[4:6]), int(text[2:4]), int(text[:2]))
    except ValueError:
        return None


def _split_sentence(line: str) -> list[str]:
    """Return the words of an NMEA sentence and 15 empty words; none if its checksum is wrong."""
    body, star, rest = line[line.find("$") + 1 :].partition("*")
    if not star or f"{reduce(xor, body.encode('latin-1'), 0):02X}" != rest[:2].upper():
        return []
    return [*body.split(","), *[""] * 15]


def _parse_place(words: Sequence[str]) -> tuple[float, float, float, bool]:
    """Return latitude, longitude [deg] and height [m] of a GGA, and whether its geoid separation is missing.

    Without a geoid separation the height is above the sea.
    """
    lat, lon = (_parse_degrees(words[k], words[k + 1]) for k in (2, 4))
    separation = parse_number(words[11])
    lacks = math.isnan(separation)
    return lat, lon, parse_number(words[9]) + (0.0 if lacks else separation), lacks


def _parse_clock(text: str) -> float:
    """Return the seconds of the day of hhmmss.sss; NaN if the text is not such a time."""
    clock = parse_number(text)
    return clock // 10_000 * 3600 + clock // 100 % 100 * 60 + clock % 100


def _parse_degrees(text: str, side: str) -> float:
    """Return the degrees of ddmm.mmmm with N, S, E or W."""
    value = parse_number(text)
    if side not in ("N", "S", "E", "W"):
        return math.nan
    return (value // 100 + value % 100 / 60) * (-1.0 if side in "SW" else 1.0)


def parse_number(text: str | None) -> float:
    """Return a number; NaN if the text is not a number."""
    try:
        return float(text or "nan")
    except ValueError:
        return math.nan
