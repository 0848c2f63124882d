"""Read RINEX observation files: code, Doppler and C/N0 of GPS and GLONASS."""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import GLONASS, GPS
from bench.errors import ConfigError
from bench.exchange.rinex.lines import (
    LONGEST,
    Lines,
    check_version,
    leap_seconds,
    open_lines,
    read_calendar,
    to_date,
)

_MOST_SATELLITES = 200
_SYSTEMS = {"G": GPS, " ": GPS, "R": GLONASS}

_CODES = {
    GPS: (("C1C", "C1W", "C1P", "C1L", "C1X", "C1S"), ("C2W", "C2P", "C2L", "C2X", "C2S", "C2C")),
    GLONASS: (("C1C", "C1P"), ("C2C", "C2P")),
}
_CODES_2 = (("C1", "P1"), ("P2", "C2"))
"""Pseudoranges of the first and second carrier; the first one in the file is used."""


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
    approximate_e: FloatArray | None  # (3,) position of the marker in the header [m]
    antenna_hen: FloatArray  # (3,) antenna relative to the marker: up, east, north [m]
    bytes_read: int


class _Header:
    """The values in use from the header of an observation file."""

    def __init__(self) -> None:
        self.marker = ""
        self.approximate_e: FloatArray | None = None
        self.antenna_hen = np.zeros(3)
        self.types: dict[str, list[str]] = {}
        self.time_system = ""
        self.leap: int | None = None

    def read(self, lines: Lines, line: str, version: int) -> None:
        """Read one header line."""
        label = line[60:80].strip()
        if label == "MARKER NAME":
            self.marker = line[:60].strip()
        elif label == "APPROX POSITION XYZ":
            places = ((0, 14), (14, 28), (28, 42))
            self.approximate_e = np.array([lines.parse_number(line, *p, "a coordinate") for p in places])
        elif label == "ANTENNA: DELTA H/E/N":
            places = ((0, 14), (14, 28), (28, 42))
            self.antenna_hen = np.array([lines.parse_number(line, *p, "an offset") for p in places])
        elif label == "TIME OF FIRST OBS":
            self.time_system = line[48:51].strip()
        elif label == "LEAP SECONDS":
            self.leap = lines.parse_whole(line, 0, 6, "the number of leap seconds")
        elif label == "SYS / SCALE FACTOR":
            raise lines.error("observations with a scale factor are not supported")
        elif label == "SYS / # / OBS TYPES" and version == 3:
            self._types(lines, line, line[0], 3, 6, 7, 13)
        elif label == "# / TYPES OF OBSERV" and version == 2:
            self._types(lines, line, " ", 0, 6, 6, 9)

    def _types(
        self, lines: Lines, line: str, system: str, first: int, last: int, start: int, most: int
    ) -> None:
        count = lines.parse_whole(line, first, last, "the number of observables")
        if not 1 <= count <= LONGEST // 16:
            raise lines.error(f"{count} observables are outside 1 to {LONGEST // 16}")
        found = line[start:60].split()
        while len(found) < count:
            more = lines.read_line_of(f"observable {len(found) + 1} of {count}")
            if "OBS" not in more[60:80] or more[:6].strip():
                raise lines.error(f"lists {len(found)} of {count} observables")
            found += more[start:60].split()
        if len(found) > count:
            raise lines.error(f"lists {len(found)} observables where {count} are announced")
        self.types[system] = found


def read_observations(path: Path, shown: str | None = None) -> ObservationFile:
    """Read code, Doppler and C/N0 of GPS and GLONASS from a RINEX 2 or 3 observation file.

    Parameters
    ----------
    path : Path
        The file.
    shown : str or None
        Name of the file in messages; default its file name.

    Raises
    ------
    ConfigError
        If the file is malformed, truncated or empty: one line with file and line number.
    """
    shown = path.name if shown is None else shown
    with open_lines(path, shown) as lines:
        version, _ = check_version(lines, "an observation file")
        header = _Header()
        while (line := lines.read_line_of("END OF HEADER"))[60:80].strip() != "END OF HEADER":
            header.read(lines, line, version)
        if not header.types:
            raise lines.error("the header lists no observables")
        rows = _EpochRows()
        (_read_epochs_3 if version == 3 else _read_epochs_2)(lines, header, rows)
        size = lines.size
    if not rows.start:
        raise ConfigError(f"{shown}: has no epoch in it")
    if not rows.sat:
        raise ConfigError(f"{shown}: has no observation of GPS or GLONASS in it")
    origin = rows.midnight[0]
    t = np.array(rows.midnight) - origin + np.array(rows.second)
    if header.time_system == "GLO":  # UTC
        t += leap_seconds(to_date(origin)) if header.leap is None else header.leap
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


class _EpochRows:
    """The epochs and observations read so far, in compact arrays."""

    def __init__(self) -> None:
        self.midnight, self.second, self.values = array("d"), array("d"), array("d")
        self.start, self.sat, self.system = array("q"), array("h"), array("b")

    def epoch(self, lines: Lines, midnight: float, second: float) -> None:
        if self.start:
            later = midnight - self.midnight[-1] + second - self.second[-1]
            if not later > 0:
                raise lines.error(f"the epoch is {later:g} s after the one above it; times must increase")
        self.midnight.append(midnight)
        self.second.append(second)
        self.start.append(len(self.sat))

    def add(self, sat: int, system: int, values: Sequence[float]) -> None:
        self.sat.append(sat)
        self.system.append(system)
        self.values.extend(values)


def _find_places(types: Sequence[str], codes: tuple[tuple[str, ...], tuple[str, ...]]) -> list[int | None]:
    """Return the index of code, Doppler and C/N0 of both carriers among the observables; None if missing."""
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


def _read_field(lines: Lines, line: str, place: int | None, start: int) -> float:
    if place is None:
        return np.nan
    a = start + 16 * place
    text = line[a : a + 14]
    if not text.strip():
        return np.nan
    value = lines.parse_number(line, a, a + 14, "an observation")
    return value if value != 0.0 else np.nan  # a missing value is blank or 0.0


def _check_count(lines: Lines, count: int) -> None:
    if not 0 <= count <= _MOST_SATELLITES:
        raise lines.error(f"{count} satellites in one epoch are outside 0 to {_MOST_SATELLITES}")


def _read_epochs_3(lines: Lines, header: _Header, rows: _EpochRows) -> None:
    codes = {"G": _CODES[GPS], "R": _CODES[GLONASS]}
    places = {s: _find_places(header.types[s], c) for s, c in codes.items() if s in header.types}
    columns = [(2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29)]
    while (line := lines.read_line()) is not None:
        if not line.strip():
            continue
        if line[0] != ">":
            raise lines.error(f"an epoch must begin with '>'; got {line[:20]!r}")
        flag = lines.parse_whole(line, 31, 32, "the epoch flag")
        count = lines.parse_whole(line, 32, 35, "the number of satellites")
        if flag > 1:
            for k in range(count):
                header.read(lines, lines.read_line_of(f"line {k + 1} of {count} of the event"), 3)
            places = {s: _find_places(header.types[s], c) for s, c in codes.items() if s in header.types}
            continue
        _check_count(lines, count)
        rows.epoch(lines, *read_calendar(lines, line, columns, False))
        for k in range(count):
            line = lines.read_line_of(f"satellite {k + 1} of {count} of the epoch")
            if line[:1] == ">":
                raise lines.error(f"the epoch above has {k} of {count} satellites")
            if line[:1] not in codes:
                continue
            if line[0] not in places:
                raise lines.error(f"the header lists no observables of system {line[0]!r}")
            sat = lines.parse_whole(line, 1, 3, "the satellite")
            values = [_read_field(lines, line, place, 3) for place in places[line[0]]]
            rows.add(sat, _SYSTEMS[line[0]], values)


def _read_epochs_2(lines: Lines, header: _Header, rows: _EpochRows) -> None:
    columns = [(1, 3), (4, 6), (7, 9), (10, 12), (13, 15), (15, 26)]
    while (line := lines.read_line()) is not None:
        if not line.strip():
            continue
        flag = lines.parse_whole(line, 28, 29, "the epoch flag")
        count = lines.parse_whole(line, 29, 32, "the number of satellites")
        if 2 <= flag <= 5:
            for k in range(count):
                header.read(lines, lines.read_line_of(f"line {k + 1} of {count} of the event"), 2)
            continue
        _check_count(lines, count)
        if flag < 2:
            rows.epoch(lines, *read_calendar(lines, line, columns, True))
        names = line[32:68].ljust(36)
        for _ in range((count - 1) // 12):
            names += lines.read_line_of("the rest of the satellites")[32:68].ljust(36)
        types = header.types[" "]
        places = _find_places(types, _CODES_2)
        for k in range(count):
            name = names[3 * k : 3 * k + 3]
            what = f"satellite {k + 1} of {count} of the epoch"
            parts = [lines.read_line_of(what)[:80].ljust(80) for _ in range((len(types) + 4) // 5)]
            if flag == 6 or name[:1] not in _SYSTEMS:
                continue
            if not name[1:].strip().isdigit():
                raise lines.error(f"satellite {name!r} of the epoch must be a letter and a number")
            values = [_read_field(lines, "".join(parts), place, 0) for place in places]
            rows.add(int(name[1:]), _SYSTEMS[name[0]], values)
