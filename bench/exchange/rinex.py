"""RINEX 2 and 3: observation and navigation files of GPS and GLONASS; other systems are skipped.

What is wrong with a file is one line with its name and line number. A file is read line by line; what is
kept grows with its number of satellites and epochs only.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TextIO

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.config.tables import ConfigError
from bench.data import GLONASS, GPS
from bench.signals.orbits import DAY, KEPLER, WEEK, GlonassSets, KeplerSets
from bench.signals.orbits import GLONASS as STATE

_LONGEST = 4096  # characters; 255 observables, more than any receiver writes, fit in one line
_MOST_SATELLITES = 200
_EPOCH = date(1980, 1, 6)
_SYSTEMS = {"G": GPS, " ": GPS, "R": GLONASS}
_NO_LETTER = re.compile(r"([+-]?\d*\.\d*)([+-]\d+)")  # 0.499063314480-269

# First days of UTC with one more leap second against GPS time, IERS Bulletin C.
_LEAPS = tuple(
    date(year, month, 1)
    for year, month in (
        (1981, 7), (1982, 7), (1983, 7), (1985, 7), (1988, 1), (1990, 1), (1991, 1), (1992, 7), (1993, 7),
        (1994, 7), (1996, 1), (1997, 7), (1999, 1), (2006, 1), (2009, 1), (2012, 7), (2015, 7), (2017, 1),
    )
)  # fmt: skip

_CODES = {
    GPS: (("C1C", "C1W", "C1P", "C1L", "C1X", "C1S"), ("C2W", "C2P", "C2L", "C2X", "C2S", "C2C")),
    GLONASS: (("C1C", "C1P"), ("C2C", "C2P")),
}
_CODES_2 = (("C1", "P1"), ("P2", "C2"))
"""Pseudoranges of the first and second carrier, the first one found is taken."""


@dataclass(frozen=True, slots=True)
class ObservationFile:
    """Raw observations; times in s of GPS time since the GPS midnight ``origin`` (s since 1980-01-06)."""

    shown: str
    marker: str
    origin: float
    t: FloatArray  # (M,) by the receiver's clock [s]
    epoch_start: IntArray  # (M + 1,)
    sat: IntArray  # (K,)
    system: IntArray  # (K,)
    pseudorange: FloatArray  # (K, 2) [m]; NaN where missing
    doppler: FloatArray  # (K, 2) positive when approaching [Hz]
    cn0: FloatArray  # (K, 2) [dB-Hz]
    approximate_e: FloatArray | None  # (3,) of the marker, as the header says [m]
    antenna_hen: FloatArray  # (3,) antenna above, east, north of the marker [m]
    bytes_read: int


@dataclass(frozen=True, slots=True)
class NavigationFile:
    """Broadcast ephemerides; times in s since 1980-01-06, GPS time."""

    shown: str
    kepler: KeplerSets
    glonass: GlonassSets
    klobuchar: FloatArray | None  # (8,) alpha, beta


class Lines:
    """The lines of a file with their number, and the error that names it."""

    def __init__(self, file: TextIO, shown: str) -> None:
        self._file, self.shown = file, shown
        self._again: str | None = None
        self.number = 0
        self.size = 0

    def next(self) -> str | None:
        """Return the next line without its end, None at the end of the file."""
        if self._again is not None:
            line, self._again = self._again, None
            self.number += 1
            return line
        line = self._file.readline(_LONGEST + 1)
        if not line:
            return None
        self.number += 1
        self.size += len(line)
        if len(line) > _LONGEST:
            raise self.wrong(f"is longer than {_LONGEST} characters: no RINEX file")
        if "\0" in line:
            raise self.wrong("holds a zero byte: no text file (compressed files are unpacked first)")
        return line.rstrip("\r\n")

    def needed(self, what: str) -> str:
        """Return the next line, or say that the file ends before ``what``."""
        line = self.next()
        if line is None:
            raise self.wrong(f"the file ends before {what}")
        return line

    def back(self, line: str) -> None:
        """Give a line back, to be read again."""
        self._again = line
        self.number -= 1

    def wrong(self, message: str) -> ConfigError:
        """Return the error that names this line."""
        return ConfigError(f"{self.shown}: line {self.number}: {message}")

    def number_in(self, line: str, start: int, end: int, what: str) -> float:
        """Return the number in columns start to end (counted from 0, end not included)."""
        value = _number(line[start:end])
        if value is None:
            text = line[start:end].strip()
            raise self.wrong(f"{what} must be a number; got {text[:30]!r} in columns {start + 1}-{end}")
        return value

    def whole_in(self, line: str, start: int, end: int, what: str) -> int:
        """Return the whole number in columns start to end."""
        text = line[start:end].strip()
        if not re.fullmatch(r"[+-]?\d+", text):
            raise self.wrong(f"{what} must be a whole number; got {text[:30]!r} in columns {start + 1}-{end}")
        return int(text)


def _number(text: str) -> float | None:
    """Read a Fortran number: exponents with D, d, E, e or without a letter."""
    text = text.strip().replace("D", "E").replace("d", "e")
    try:
        value = float(text)
    except ValueError:
        split = _NO_LETTER.fullmatch(text)
        if split is None:
            return None
        value = float(f"{split[1]}e{split[2]}")
    return value if np.isfinite(value) and "_" not in text else None


@contextmanager
def opened(path: Path, shown: str) -> Iterator[Lines]:
    """Give the lines of a text file; what keeps it from being opened is a ConfigError."""
    try:
        with path.open(encoding="latin-1", newline="") as file:
            yield Lines(file, shown)
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{shown}: is a folder, not a file") from None
    except PermissionError as error:
        raise ConfigError(f"{shown}: {error.strerror}") from None


def leap_seconds(day: date) -> int:
    """Return GPS time minus UTC at the start of a day [s].

    Examples
    --------
    >>> leap_seconds(date(2012, 10, 31)), leap_seconds(date(2020, 6, 25))
    (16, 18)
    """
    return sum(day >= first for first in _LEAPS)


def gps_seconds(year: int, month: int, day: int, second: float = 0.0) -> float:
    """Return seconds since 1980-01-06 of a calendar day and second of it, no leap seconds."""
    return (date(year, month, day) - _EPOCH).days * DAY + second


def _day(seconds: float) -> date:
    return date.fromordinal(_EPOCH.toordinal() + int(seconds // DAY))


def _version(lines: Lines, wanted: str) -> tuple[int, str]:
    """Check the first line; return the main version and the kind of file with its system."""
    first = lines.next()
    if first is None:
        raise ConfigError(f"{lines.shown}: is empty")
    label = first[60:80].strip()
    if label.startswith("CRINEX"):
        raise lines.wrong("Hatanaka compression; unpack the file with crx2rnx first")
    if label != "RINEX VERSION / TYPE":
        raise lines.wrong("'RINEX VERSION / TYPE' must stand in columns 61-80: no RINEX file")
    version = lines.number_in(first, 0, 9, "the version")
    if int(version) not in (2, 3):
        raise lines.wrong(f"version {version:g} must be 2 or 3")
    kind = first[20:21].upper()
    kinds = {"O": "an observation file", "N": "a navigation file", "G": "a navigation file"}
    if kinds.get(kind) != wanted:
        raise lines.wrong(f"is {kinds.get(kind, f'of type {kind!r}')}, not {wanted}")
    return int(version), kind + first[40:41].upper()


def _calendar(
    lines: Lines, line: str, columns: Sequence[tuple[int, int]], two_digits: bool
) -> tuple[float, float]:
    """Return midnight since 1980-01-06 and the second of the day of the calendar time in a line [s]."""
    names = ("year", "month", "day", "hour", "minute")
    numbers = [
        lines.whole_in(line, *place, f"the {name}") for name, place in zip(names, columns[:5], strict=True)
    ]
    second = lines.number_in(line, *columns[5], "the second")
    year, month, day, hour, minute = numbers
    if two_digits and year < 100:
        year += 1900 if year >= 80 else 2000
    try:
        midnight = gps_seconds(year, month, day)
    except ValueError as error:
        raise lines.wrong(f"{year}-{month}-{day} is no date: {error}") from None
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
        raise lines.wrong(f"{hour}:{minute}:{second:g} is no time of day")
    return midnight, 3600.0 * hour + 60.0 * minute + second


# --- navigation --------------------------------------------------------------------------------------------


def read_navigation(path: Path, shown: str | None = None) -> NavigationFile:
    """Return the GPS and GLONASS ephemerides of a RINEX 2 or 3 navigation file.

    Parameters
    ----------
    path : Path
        The file.
    shown : str or None
        What messages call it; its name when None.

    Raises
    ------
    ConfigError
        One line with file and line number, when the file is malformed, truncated or empty.
    """
    shown = path.name if shown is None else shown
    with opened(path, shown) as lines:
        version, kind = _version(lines, "a navigation file")
        alpha, beta, leap = _navigation_header(lines)
        kepler: list[list[float]] = []
        glonass: list[list[float]] = []
        while (line := lines.next()) is not None:
            if not line.strip():
                continue
            system = line[0] if version == 3 else ("R" if kind[0] == "G" else "G")
            record = _record(lines, line, version, system)
            if system == "G":
                kepler.append(_kepler(lines, record, version))
            elif system == "R":
                glonass.append(_glonass(lines, record, version, leap))
    if not kepler and not glonass:
        raise ConfigError(f"{shown}: holds no GPS and no GLONASS ephemeris")
    k = np.array(kepler, float).reshape(-1, 2 + len(KEPLER))
    g = np.array(glonass, float).reshape(-1, 3 + len(STATE))
    return NavigationFile(
        shown=shown,
        kepler=KeplerSets(k[:, 0].astype(np.int64), k[:, 1] == 0, np.ascontiguousarray(k[:, 2:])),
        glonass=GlonassSets(
            g[:, 0].astype(np.int64), g[:, 1] == 0, g[:, 2].astype(np.int64), np.ascontiguousarray(g[:, 3:])
        ),
        klobuchar=np.array(alpha + beta) if alpha is not None and beta is not None else None,
    )


def _navigation_header(lines: Lines) -> tuple[list[float] | None, list[float] | None, int | None]:
    alpha = beta = None
    leap = None
    while True:
        line = lines.needed("END OF HEADER")
        label = line[60:80].strip()
        if label == "END OF HEADER":
            return alpha, beta, leap
        name = label if label in ("ION ALPHA", "ION BETA") else line[:4] if "IONO" in label else ""
        start = 2 if label.startswith("ION ") else 5
        if name in ("ION ALPHA", "GPSA", "ION BETA", "GPSB"):
            columns = range(start, start + 48, 12)
            values = [lines.number_in(line, c, c + 12, "an ionosphere parameter") for c in columns]
            alpha, beta = (values, beta) if name in ("ION ALPHA", "GPSA") else (alpha, values)
        elif label == "LEAP SECONDS":
            leap = lines.whole_in(line, 0, 6, "the number of leap seconds")


def _record(lines: Lines, first: str, version: int, system: str) -> tuple[int, list[str]]:
    """Return the number of the first line and all lines of one ephemeris."""
    number, found = lines.number, [first]
    indent = 4 if version == 3 else 3
    if first[:1] == " " and version == 3:
        raise lines.wrong("a record must begin with its satellite, for example 'G05'")
    whole = {"G": (8,), "R": (4, 5) if version == 3 else (4,)}.get(system)
    while whole is None or len(found) < whole[-1]:
        line = lines.next()
        if line is None:
            break
        if line[:indent].strip():
            lines.back(line)
            break
        found.append(line)
    if whole is not None and len(found) not in whole:
        name = first[:3].strip() if version == 3 else f"{system}{first[:2].strip()}"
        raise lines.wrong(
            f"the record of {name} from line {number} ends after {len(found)} of {whole[0]} lines"
        )
    return number, found


def _values(lines: Lines, record: tuple[int, list[str]], version: int) -> list[list[float]]:
    """Return the numbers of a record, a row per line; what is blank is NaN."""
    number, texts = record
    last, rows = lines.number, []
    for offset, text in enumerate(texts):
        lines.number = number + offset
        start = (23 if version == 3 else 22) if offset == 0 else (4 if version == 3 else 3)
        count = 3 if offset == 0 else 4
        places = [(start + 19 * k, start + 19 * (k + 1)) for k in range(count)]
        rows.append(
            [lines.number_in(text, a, b, "a value") if text[a:b].strip() else np.nan for a, b in places]
        )
    lines.number = last
    return rows


def _clock_time(lines: Lines, record: tuple[int, list[str]], version: int) -> tuple[int, float]:
    """Return the satellite and the reference time of a record, in the time of its system."""
    number, texts = record
    last, lines.number = lines.number, number
    if version == 3:
        columns = [(4, 8), (9, 11), (12, 14), (15, 17), (18, 20), (21, 23)]
        sat = lines.whole_in(texts[0], 1, 3, "the satellite")
    else:
        columns = [(3, 5), (6, 8), (9, 11), (12, 14), (15, 17), (17, 22)]
        sat = lines.whole_in(texts[0], 0, 2, "the satellite")
    if not 1 <= sat <= 63:
        raise lines.wrong(f"satellite {sat} is outside 1 to 63")
    t = sum(_calendar(lines, texts[0], columns, version == 2))
    lines.number = last
    return sat, t


def _all_there(lines: Lines, first: int, wanted: dict[str, tuple[int, float]]) -> None:
    for name, (offset, value) in wanted.items():
        if np.isnan(value):
            lines.number = first + offset
            raise lines.wrong(f"{name} is missing")


def _kepler(lines: Lines, record: tuple[int, list[str]], version: int) -> list[float]:
    """Return sat, health and the columns of ``KEPLER`` of one GPS record (RINEX 3.05, table A6)."""
    sat, t_oc = _clock_time(lines, record, version)
    v = _values(lines, record, version)
    group_delay = 0.0 if np.isnan(v[6][2]) else v[6][2]
    placed = {
        "af_0": (0, v[0][0]), "af_1": (0, v[0][1]), "af_2": (0, v[0][2]),
        "c_rs": (1, v[1][1]), "delta_n": (1, v[1][2]), "mean_anomaly": (1, v[1][3]),
        "c_uc": (2, v[2][0]), "e": (2, v[2][1]), "c_us": (2, v[2][2]), "sqrt_a": (2, v[2][3]),
        "t_oe_week": (3, v[3][0]), "c_ic": (3, v[3][1]), "node_0": (3, v[3][2]), "c_is": (3, v[3][3]),
        "i_0": (4, v[4][0]), "c_rc": (4, v[4][1]), "perigee": (4, v[4][2]), "node_rate": (4, v[4][3]),
        "i_rate": (5, v[5][0]), "group_delay": (6, group_delay), "health": (6, v[6][1]),
    }  # fmt: skip
    _all_there(lines, record[0], placed)
    values = {name: value for name, (_, value) in placed.items()}
    for name, low, high in (("e", 0.0, 0.2), ("sqrt_a", 4900.0, 5400.0), ("t_oe_week", 0.0, WEEK)):
        if not low <= values[name] <= high:
            lines.number = record[0] + placed[name][0]
            raise lines.wrong(f"{name} = {values[name]:g} is outside {low:g} to {high:g}: no GPS orbit")
    # the week is that of the clock's reference time: the week field is mod 1024 in some files
    week_start = t_oc - t_oc % WEEK
    t_oe = week_start + values["t_oe_week"]
    t_oe += WEEK * np.round((t_oc - t_oe) / WEEK)
    values |= {"t_oe": t_oe, "t_oc": t_oc}
    return [sat, values["health"], *(values[name] for name in KEPLER)]


def _glonass(lines: Lines, record: tuple[int, list[str]], version: int, leap: int | None) -> list[float]:
    """Return slot, health, channel and the columns of ``GLONASS`` of one record (RINEX 3.05, table A10)."""
    sat, utc = _clock_time(lines, record, version)
    v = _values(lines, record, version)
    placed = {
        "clock": (0, v[0][0]), "clock_rate": (0, v[0][1]),
        "x": (1, v[1][0]), "vx": (1, v[1][1]), "ax": (1, v[1][2]), "health": (1, v[1][3]),
        "y": (2, v[2][0]), "vy": (2, v[2][1]), "ay": (2, v[2][2]), "channel": (2, v[2][3]),
        "z": (3, v[3][0]), "vz": (3, v[3][1]), "az": (3, v[3][2]),
    }  # fmt: skip
    _all_there(lines, record[0], placed)
    values = {name: value for name, (_, value) in placed.items()}
    for name in ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az"):
        values[name] *= 1e3  # km
    radius = np.sqrt(values["x"] ** 2 + values["y"] ** 2 + values["z"] ** 2)
    if not 24e6 <= radius <= 27e6:
        lines.number = record[0] + 1
        raise lines.wrong(f"a radius of {radius / 1e3:.0f} km is outside 24000 to 27000 km: no GLONASS orbit")
    if values["channel"] > 127:  # some writers give -7 as 249
        values["channel"] -= 256
    if leap is None:
        leap = leap_seconds(_day(utc))
    values["t_b"] = utc + leap
    return [sat, values["health"], values["channel"], *(values[name] for name in STATE)]


def merged(files: Sequence[NavigationFile]) -> NavigationFile:
    """Return the ephemerides of several files as one; the first ionosphere model found counts."""
    return NavigationFile(
        shown=", ".join(file.shown for file in files),
        kepler=KeplerSets(
            *(np.concatenate([getattr(f.kepler, n) for f in files]) for n in KeplerSets.__slots__)
        ),
        glonass=GlonassSets(
            *(np.concatenate([getattr(f.glonass, n) for f in files]) for n in GlonassSets.__slots__)
        ),
        klobuchar=next((f.klobuchar for f in files if f.klobuchar is not None), None),
    )


# --- observations ------------------------------------------------------------------------------------------


class _Header:
    """What the header of an observation file says, as far as it is used."""

    def __init__(self) -> None:
        self.marker = ""
        self.approximate_e: FloatArray | None = None
        self.antenna_hen = np.zeros(3)
        self.types: dict[str, list[str]] = {}
        self.time_system = ""
        self.leap: int | None = None

    def take(self, lines: Lines, line: str, version: int) -> None:
        """Read one header line."""
        label = line[60:80].strip()
        if label == "MARKER NAME":
            self.marker = line[:60].strip()
        elif label == "APPROX POSITION XYZ":
            places = ((0, 14), (14, 28), (28, 42))
            self.approximate_e = np.array([lines.number_in(line, *p, "a coordinate") for p in places])
        elif label == "ANTENNA: DELTA H/E/N":
            places = ((0, 14), (14, 28), (28, 42))
            self.antenna_hen = np.array([lines.number_in(line, *p, "an offset") for p in places])
        elif label == "TIME OF FIRST OBS":
            self.time_system = line[48:51].strip()
        elif label == "LEAP SECONDS":
            self.leap = lines.whole_in(line, 0, 6, "the number of leap seconds")
        elif label == "SYS / SCALE FACTOR":
            raise lines.wrong("observations with a scale factor are not read")
        elif label == "SYS / # / OBS TYPES" and version == 3:
            self._types(lines, line, line[0], 3, 6, 7, 13)
        elif label == "# / TYPES OF OBSERV" and version == 2:
            self._types(lines, line, " ", 0, 6, 6, 9)

    def _types(
        self, lines: Lines, line: str, system: str, first: int, last: int, start: int, most: int
    ) -> None:
        count = lines.whole_in(line, first, last, "the number of observables")
        if not 1 <= count <= _LONGEST // 16:
            raise lines.wrong(f"{count} observables are outside 1 to {_LONGEST // 16}")
        found = line[start:60].split()
        while len(found) < count:
            more = lines.needed(f"observable {len(found) + 1} of {count}")
            if "OBS" not in more[60:80] or more[:6].strip():
                raise lines.wrong(f"lists {len(found)} of {count} observables")
            found += more[start:60].split()
        if len(found) > count:
            raise lines.wrong(f"lists {len(found)} observables where {count} are announced")
        self.types[system] = found


def read_observations(path: Path, shown: str | None = None) -> ObservationFile:
    """Return the code, Doppler and C/N0 of GPS and GLONASS of a RINEX 2 or 3 observation file.

    Parameters
    ----------
    path : Path
        The file.
    shown : str or None
        What messages call it; its name when None.

    Raises
    ------
    ConfigError
        One line with file and line number, when the file is malformed, truncated or empty.
    """
    shown = path.name if shown is None else shown
    with opened(path, shown) as lines:
        version, _ = _version(lines, "an observation file")
        header = _Header()
        while (line := lines.needed("END OF HEADER"))[60:80].strip() != "END OF HEADER":
            header.take(lines, line, version)
        if not header.types:
            raise lines.wrong("the header lists no observables")
        rows = _Rows()
        (_epochs_3 if version == 3 else _epochs_2)(lines, header, rows)
        size = lines.size
    if not rows.start:
        raise ConfigError(f"{shown}: holds no epoch")
    if not rows.sat:
        raise ConfigError(f"{shown}: holds no observation of GPS or GLONASS")
    origin = rows.midnight[0]
    t = np.array(rows.midnight) - origin + np.array(rows.second)
    if header.time_system == "GLO":  # UTC
        t += leap_seconds(_day(origin)) if header.leap is None else header.leap
    values = np.array(rows.values).reshape(-1, 3, 2)
    return ObservationFile(
        shown=shown,
        marker=header.marker,
        origin=origin,
        t=t,
        epoch_start=np.append(np.array(rows.start, np.int64), len(rows.sat)),
        sat=np.array(rows.sat, np.int64),
        system=np.array(rows.system, np.int64),
        pseudorange=np.ascontiguousarray(values[:, 0]),
        doppler=np.ascontiguousarray(values[:, 1]),
        cn0=np.ascontiguousarray(values[:, 2]),
        approximate_e=header.approximate_e,
        antenna_hen=header.antenna_hen,
        bytes_read=size,
    )


class _Rows:
    """Epochs and observations as they are read, packed."""

    def __init__(self) -> None:
        self.midnight, self.second, self.values = array("d"), array("d"), array("d")
        self.start, self.sat, self.system = array("q"), array("h"), array("b")

    def epoch(self, lines: Lines, midnight: float, second: float) -> None:
        if self.start:
            later = midnight - self.midnight[-1] + second - self.second[-1]
            if not later > 0:
                raise lines.wrong(f"the epoch is {later:g} s after the one above it; times must increase")
        self.midnight.append(midnight)
        self.second.append(second)
        self.start.append(len(self.sat))

    def add(self, sat: int, system: int, values: Sequence[float]) -> None:
        self.sat.append(sat)
        self.system.append(system)
        self.values.extend(values)


def _places(types: Sequence[str], codes: tuple[tuple[str, ...], tuple[str, ...]]) -> list[int | None]:
    """Return where code, Doppler and C/N0 of both carriers stand among the observables, None for nowhere."""
    places: list[int | None] = []
    chosen = [next((code for code in band if code in types), None) for band in codes]
    for letter in "CDS":
        for band, code in enumerate(chosen):
            name = None
            if code is not None:
                rest = code[1:] if len(code) == 3 else str(band + 1)
                name = code if letter == "C" else letter + rest
            places.append(types.index(name) if name in types else None)
    return places


def _field(lines: Lines, line: str, place: int | None, start: int) -> float:
    if place is None:
        return np.nan
    a = start + 16 * place
    text = line[a : a + 14]
    if not text.strip():
        return np.nan
    value = lines.number_in(line, a, a + 14, "an observation")
    return value if value != 0.0 else np.nan  # RINEX writes a missing value as blank or 0.0


def _check_count(lines: Lines, count: int) -> None:
    if not 0 <= count <= _MOST_SATELLITES:
        raise lines.wrong(f"{count} satellites in one epoch are outside 0 to {_MOST_SATELLITES}")


def _epochs_3(lines: Lines, header: _Header, rows: _Rows) -> None:
    codes = {"G": _CODES[GPS], "R": _CODES[GLONASS]}
    places = {s: _places(header.types[s], c) for s, c in codes.items() if s in header.types}
    columns = [(2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29)]
    while (line := lines.next()) is not None:
        if not line.strip():
            continue
        if line[0] != ">":
            raise lines.wrong(f"an epoch must begin with '>'; got {line[:20]!r}")
        flag = lines.whole_in(line, 31, 32, "the epoch flag")
        count = lines.whole_in(line, 32, 35, "the number of satellites")
        if flag > 1:
            for k in range(count):
                header.take(lines, lines.needed(f"line {k + 1} of {count} of the event"), 3)
            places = {s: _places(header.types[s], c) for s, c in codes.items() if s in header.types}
            continue
        _check_count(lines, count)
        rows.epoch(lines, *_calendar(lines, line, columns, False))
        for k in range(count):
            line = lines.needed(f"satellite {k + 1} of {count} of the epoch")
            if line[:1] == ">":
                raise lines.wrong(f"the epoch above has {k} of {count} satellites")
            if line[:1] not in codes:
                continue
            if line[0] not in places:
                raise lines.wrong(f"the header lists no observables of system {line[0]!r}")
            sat = lines.whole_in(line, 1, 3, "the satellite")
            values = [_field(lines, line, place, 3) for place in places[line[0]]]
            rows.add(sat, _SYSTEMS[line[0]], values)


def _epochs_2(lines: Lines, header: _Header, rows: _Rows) -> None:
    columns = [(1, 3), (4, 6), (7, 9), (10, 12), (13, 15), (15, 26)]
    while (line := lines.next()) is not None:
        if not line.strip():
            continue
        flag = lines.whole_in(line, 28, 29, "the epoch flag")
        count = lines.whole_in(line, 29, 32, "the number of satellites")
        if 2 <= flag <= 5:
            for k in range(count):
                header.take(lines, lines.needed(f"line {k + 1} of {count} of the event"), 2)
            continue
        _check_count(lines, count)
        if flag < 2:
            rows.epoch(lines, *_calendar(lines, line, columns, True))
        names = line[32:68].ljust(36)
        for _ in range((count - 1) // 12):
            names += lines.needed("the rest of the satellites")[32:68].ljust(36)
        types = header.types[" "]
        places = _places(types, _CODES_2)
        for k in range(count):
            name = names[3 * k : 3 * k + 3]
            what = f"satellite {k + 1} of {count} of the epoch"
            parts = [lines.needed(what)[:80].ljust(80) for _ in range((len(types) + 4) // 5)]
            if flag == 6 or name[:1] not in _SYSTEMS:
                continue
            if not name[1:].strip().isdigit():
                raise lines.wrong(f"satellite {name!r} of the epoch must be a letter and a number")
            values = [_field(lines, "".join(parts), place, 0) for place in places]
            rows.add(int(name[1:]), _SYSTEMS[name[0]], values)
