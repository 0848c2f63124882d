"""Read RINEX observation files: code, Doppler and C/N0 of GPS and GLONASS.

An epoch that is damaged, or whose time does not fit between those around it, is left out and reported with
its line number. The code of each carrier is chosen for each satellite and epoch.
"""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray
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
"""Pseudoranges of the first and second carrier; the first one that a satellite has at an epoch is used."""

_HEADS = {
    2: re.compile(r" [ \d]\d( [ \d]\d){4}[ \d]{2}\d\.[ \d]{7}  \d[ \d]{2}\d| {28}[2-5][ \d]{2}\d"),
    3: re.compile(">"),
}
"""Version -> how the first line of an epoch, or of an event, begins."""

Places = tuple[int | None, int | None, int | None]
"""Indices of code, Doppler and C/N0 among the observables; None if missing."""


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
    moving: bool  # an event in the file says that the antenna begins to move
    lost: int  # number of epochs that are left out
    reasons: tuple[str, ...]  # why the first of them are, with line numbers


class _Header:
    """The values in use from the header of an observation file."""

    def __init__(self) -> None:
        self.marker = ""
        self.approximate_e: FloatArray | None = None
        self.antenna_hen = np.zeros(3)
        self.types: dict[str, list[str]] = {}
        self.time_system = ""
        self.leap: int | None = None
        self.moving = False
        self._places: dict[str, list[list[Places]]] | None = None

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

    def find_places(self) -> Mapping[str, Sequence[Sequence[Places]]]:
        """Return, for each system, the signals of both carriers that the file has, in order of preference."""
        if self._places is None:
            codes = {"G": _CODES[GPS], "R": _CODES[GLONASS], " ": _CODES_2}
            self._places = {s: _find_places(types, codes[s]) for s, types in self.types.items() if s in codes}
        return self._places

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
        self.types[system], self._places = found, None


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
        If the header is malformed or no epoch can be read: one line with file and line number.
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
        _read_epochs(lines, header, version, rows)
    if not rows.start:
        raise lines.describe_nothing("epoch")
    if not rows.sat:
        raise ConfigError(f"{shown}: has no observation of GPS or GLONASS in it")
    kept = rows.find_increasing()
    for k in np.flatnonzero(~kept):
        lines.report(
            lines.error("the time of the epoch does not fit between those around it", rows.number[k])
        )
    start = np.append(np.array(rows.start, np.int64), len(rows.sat))
    count = np.diff(start)
    of_kept = np.repeat(kept, count)
    midnight = np.array(rows.midnight)[kept]
    origin = float(midnight[0])
    t = midnight - origin + np.array(rows.second)[kept]
    if header.time_system == "GLO":  # UTC
        t += leap_seconds(to_date(origin)) if header.leap is None else header.leap
    values = np.array(rows.values).reshape(-1, 3, 2)[of_kept]
    return ObservationFile(
        shown=shown,
        marker=header.marker,
        origin=origin,
        t=t,
        epoch_start=np.concatenate([[0], np.cumsum(count[kept])]),
        sat=np.array(rows.sat, np.int64)[of_kept],
        system=np.array(rows.system, np.int64)[of_kept],
        pseudorange=np.ascontiguousarray(values[:, 0]),
        doppler=np.ascontiguousarray(values[:, 1]),
        cn0=np.ascontiguousarray(values[:, 2]),
        approximate_e=header.approximate_e,
        antenna_hen=header.antenna_hen,
        moving=header.moving,
        lost=lines.lost,
        reasons=tuple(lines.reasons),
    )


def _find_places(types: Sequence[str], codes: Sequence[Sequence[str]]) -> list[list[Places]]:
    """Return the signals among the observables, for each carrier."""

    def find(letter: str, code: str, band: int) -> int | None:
        name = letter + (code[1:] if len(code) == 3 else str(band))
        return types.index(name) if name in types else None

    return [
        [(types.index(code), find("D", code, band), find("S", code, band)) for code in each if code in types]
        for band, each in enumerate(codes, 1)
    ]


class _EpochRows:
    """The epochs and observations read so far, in compact arrays."""

    def __init__(self) -> None:
        self.midnight, self.second, self.values = array("d"), array("d"), array("d")
        self.start, self.number = array("q"), array("q")
        self.sat, self.system = array("h"), array("b")

    def begin(self, lines: Lines, time: tuple[float, float]) -> None:
        self.midnight.append(time[0])
        self.second.append(time[1])
        self.start.append(len(self.sat))
        self.number.append(lines.number)

    def add(self, sat: int, system: int, values: Sequence[float]) -> None:
        self.sat.append(sat)
        self.system.append(system)
        self.values.extend(values)

    def keep_first(self, epochs: int) -> None:
        """Remove the epochs after the first ones."""
        if epochs < len(self.start):
            rows = self.start[epochs]
            for column in (self.midnight, self.second, self.start, self.number):
                del column[epochs:]
            del self.sat[rows:], self.system[rows:], self.values[6 * rows :]

    def find_increasing(self) -> BoolArray:
        """Mark a longest sequence of epochs (M,) whose times increase; of equal times, the first."""
        times = (np.array(self.midnight) + np.array(self.second)).tolist()
        kept = np.ones(len(times), np.bool_)
        if len(times) < 2 or (np.diff(times) > 0).all():
            return kept
        ends: list[float] = []  # smallest last time of a sequence of each length, and its epoch
        at: list[int] = []
        before = [-1] * len(times)
        for k, t in enumerate(times):
            length = bisect_left(ends, t)
            before[k] = at[length - 1] if length else -1
            if length == len(ends):
                ends.append(t)
                at.append(k)
            elif t < ends[length]:
                ends[length], at[length] = t, k
        kept[:] = False
        k = at[-1]
        while k >= 0:
            kept[k] = True
            k = before[k]
        return kept


def _read_epochs(lines: Lines, header: _Header, version: int, rows: _EpochRows) -> None:
    """Read every epoch; report a damaged one and go on at the next."""
    head = _HEADS[version]
    read = {2: _read_epoch_2, 3: _read_epoch_3}[version]
    while True:
        epochs = len(rows.start)
        try:
            if (line := lines.read_line()) is None:
                return
            if not line.strip():
                continue
            if not head.match(line):
                raise lines.error(f"an epoch must begin here; got {line[:32].strip()!r}")
            read(lines, line, header, rows)
            if (line := lines.read_line()) is None:
                return
            lines.put_back(line)
            if line.strip() and not head.match(line):
                raise lines.error("the epoch has more lines than its satellites need", lines.number + 1)
        except ConfigError as error:
            rows.keep_first(epochs)
            lines.report(error)
            lines.skip_to(head)


def _read_body(lines: Lines, version: int, k: int, count: int, content: str) -> str:
    """Return the next line of an epoch; raise ConfigError if the next epoch or the end comes first."""
    line = lines.read_line_of(f"{content} {k + 1} of {count} of the epoch")
    if _HEADS[version].match(line):
        lines.put_back(line)
        raise lines.error(f"the epoch above has {k} of {count} {content}s", lines.number + 1)
    return line


def _read_event(lines: Lines, header: _Header, version: int, flag: int, count: int) -> None:
    header.moving |= flag == 2
    for k in range(count):
        header.read(lines, _read_body(lines, version, k, count, "line"), version)


def _read_epoch_3(lines: Lines, line: str, header: _Header, rows: _EpochRows) -> None:
    columns = [(2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29)]
    flag = lines.parse_whole(line, 31, 32, "the epoch flag")
    count = lines.parse_whole(line, 32, 35, "the number of satellites")
    if flag > 1:
        _read_event(lines, header, 3, flag, count)
        return
    _check_count(lines, count)
    rows.begin(lines, read_calendar(lines, line, columns, False))
    places = header.find_places()
    for k in range(count):
        line = _read_body(lines, 3, k, count, "satellite")
        system = _SYSTEMS.get(line[:1].strip() or "-")
        if system is None:
            continue
        if line[0] not in places:
            raise lines.error(f"the header lists no observables of system {line[0]!r}")
        rows.add(_read_number(lines, line[1:3]), system, _read_values(lines, line, places[line[0]], 3))


def _read_epoch_2(lines: Lines, line: str, header: _Header, rows: _EpochRows) -> None:
    columns = [(1, 3), (4, 6), (7, 9), (10, 12), (13, 15), (15, 26)]
    flag = lines.parse_whole(line, 28, 29, "the epoch flag")
    count = lines.parse_whole(line, 29, 32, "the number of satellites")
    if 2 <= flag <= 5:
        _read_event(lines, header, 2, flag, count)
        return
    _check_count(lines, count)
    if flag < 2:
        rows.begin(lines, read_calendar(lines, line, columns, True))
    names, more = line[32:68].ljust(36), (count - 1) // 12
    for k in range(more):
        names += _read_body(lines, 2, k, more, "further line")[32:68].ljust(36)
    places = header.find_places()[" "]
    width = (len(header.types[" "]) + 4) // 5
    for k in range(count):
        name = names[3 * k : 3 * k + 3]
        parts = [_read_body(lines, 2, k, count, "satellite")[:80].ljust(80) for _ in range(width)]
        if flag < 2 and name[:1] in _SYSTEMS:
            values = _read_values(lines, "".join(parts), places, 0)
            rows.add(_read_number(lines, name[1:]), _SYSTEMS[name[0]], values)


def _check_count(lines: Lines, count: int) -> None:
    if not 0 <= count <= _MOST_SATELLITES:
        raise lines.error(f"{count} satellites in one epoch are outside 0 to {_MOST_SATELLITES}")


def _read_number(lines: Lines, text: str) -> int:
    if not re.fullmatch(r" *\d+ *", text):
        raise lines.error(f"the number of a satellite must be a whole number; got {text!r}")
    return int(text)


def _read_values(lines: Lines, line: str, bands: Sequence[Sequence[Places]], start: int) -> list[float]:
    """Return code, Doppler and C/N0, each of both carriers, by the first code that the satellite has."""
    chosen = []
    for signals in bands:
        read = [[_read_field(lines, line, place, start) for place in places] for places in signals]
        read.sort(key=lambda values: np.isnan(values[0]))  # a stable sort: those with a code first
        chosen.append([next((v for v in one if not np.isnan(v)), np.nan) for one in zip(*read, strict=True)])
    first, second = (values or [np.nan] * 3 for values in chosen)
    return [value for both in zip(first, second, strict=True) for value in both]


def _read_field(lines: Lines, line: str, place: int | None, start: int) -> float:
    if place is None:
        return np.nan
    a = start + 16 * place
    text = line[a : a + 14]
    if not text.strip():
        return np.nan
    value = lines.parse_number(line, a, a + 14, "an observation")
    return value if value != 0.0 else np.nan  # a missing value is blank or 0.0
