"""Read RINEX navigation files: the broadcast ephemerides of GPS, GLONASS, Galileo and BeiDou.

A damaged record is left out and reported with its line number.
"""

from __future__ import annotations

import re
from array import array
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.orbit_sets import (
    BEIDOU,
    GALILEO,
    GLONASS,
    GPS,
    KEPLER,
    STATE,
    GlonassSets,
    KeplerSets,
    OrbitTable,
)
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE, Lines, check_version, open_lines, read_calendar
from bench.simulation.signals.gps_time import leap_seconds, to_date
from bench.simulation.signals.orbits import WEEK

_HEADS = {
    2: re.compile(r" ?\d"),
    3: re.compile(r"[A-Z][ \d]\d"),
    4: re.compile(r">"),
}
"""Version -> how the first line of a record begins."""
_FRAME_4 = re.compile(r"> (EPH|STO|EOP|ION) ([A-Z])(\d\d)? +(\w+)")
_MESSAGES_4 = {"LNAV": "G", "FDMA": "R", "INAV": "E", "FNAV": "E", "D1": "C", "D2": "C", "D1D2": "C"}
"""Messages of RINEX 4 with the records that RINEX 3 has, too, and their systems; the others are skipped."""


class _Kind(NamedTuple):
    """Properties of the Keplerian records of a system."""

    system: int
    name: str
    least: float  # square root of the semi-axis [sqrt(m)]
    most: float
    late: float  # GPS time minus the time of the system [s]
    sick: str = ""


_KINDS = {
    "G": _Kind(GPS, "GPS", 4900.0, 5400.0, 0.0),
    "E": _Kind(GALILEO, "Galileo", 5050.0, 5600.0, 0.0),
    "C": _Kind(BEIDOU, "BeiDou", 5000.0, 6700.0, BEIDOU_LATE),
}
_LEAST_INCLINATION = 0.6  # of satellites that are not geostationary [rad]; in semicircles all are below it
_SEMICIRCLES = "; its angles may be in semicircles"
_INAV, _FNAV = 0b101, 0b010  # bits of the data source of Galileo, RINEX 3.05, table A8
_CLOCKS = {0b01: "F/NAV", 0b10: "I/NAV"}  # bits 8 and 9 of the same: whose pair of carriers the clock is of
_SICK = {"I/NAV": 0b000000111, "F/NAV": 0b000111000}  # bits of its health of E1 and of E5a, the same


@dataclass(frozen=True, slots=True)
class NavigationFile:
    """Broadcast ephemerides; times in s since 1980-01-06, GPS time."""

    shown: str
    gps: KeplerSets
    glonass: GlonassSets
    klobuchar: FloatArray | None  # (8,) alpha, beta of GPS
    lost: int = 0  # number of records that are left out because they are damaged
    reasons: tuple[str, ...] = ()  # why the first of them are, with line numbers
    galileo: tuple[KeplerSets, ...] = ()  # I/NAV and F/NAV
    beidou: KeplerSets | None = None
    level: FloatArray | None = None  # (3,) a_i0, a_i1, a_i2 of Galileo
    precise: tuple[OrbitTable, ...] = ()  # of SP3 files beside it
    notes: tuple[str, ...] = ()  # what is not given, or read with a doubt

    def list_sets(self) -> dict[int, list[KeplerSets | GlonassSets]]:
        """Return the broadcast orbits of each system."""
        beidou = [] if self.beidou is None else [self.beidou]
        return {GPS: [self.gps], GLONASS: [self.glonass], GALILEO: [*self.galileo], BEIDOU: [*beidou]}

    def list_orbits(self) -> dict[int, list[KeplerSets | GlonassSets | OrbitTable]]:
        """Return all orbits of each system, for `receiver_solution.make_observations`."""
        found: dict[int, list[KeplerSets | GlonassSets | OrbitTable]] = {}
        for system, sets in self.list_sets().items():
            found[system] = [*sets, *(table for table in self.precise if table.system == system)]
        return found


@dataclass(slots=True)
class _Found:
    """Data read so far."""

    kepler: dict[str, array[float]] = field(default_factory=dict)
    glonass: array[float] = field(default_factory=lambda: array("d"))
    alpha: list[float] | None = None
    beta: list[float] | None = None
    level: list[float] | None = None
    leap: int | None = None
    semicircles: int = 0  # records of BeiDou with angles in semicircles
    both: Counter[str] = field(default_factory=Counter)  # Galileo's that name two messages, by the one taken

    def make_kepler(self, letter: str, message: str = "") -> KeplerSets:
        rows = np.array(self.kepler.get(letter + message, ()), float).reshape(-1, 2 + len(KEPLER))
        sat, healthy = rows[:, 0].astype(np.int64), rows[:, 1] == 0
        return KeplerSets(sat, healthy, rows[:, 2:], _KINDS[letter].system, message)


def read_navigation(path: Path, shown: str | None = None) -> NavigationFile:
    """Read the ephemerides of a RINEX 2, 3 or 4 navigation file, packed or not.

    Parameters
    ----------
    path : Path
        The file.
    shown : str or None
        Name of the file in messages; default its file name.

    Raises
    ------
    ConfigError
        If the header is malformed or no record can be read: one line with file and line number.
    """
    shown = path.name if shown is None else shown
    found = _Found()
    with open_lines(path, shown) as lines:
        version, kind = check_version(lines, "a navigation file")
        _read_header(lines, found)
        main = int(version)
        while True:
            try:
                if (line := lines.read_line()) is None:
                    break
                if not line.strip():
                    continue
                if main == 4:
                    _read_frame(lines, line, found)
                    continue
                system = line[0] if main == 3 else {"G": "R", "L": "E"}.get(kind[0], "G")
                _take_record(lines, line, main, system, found)
            except ConfigError as error:
                lines.report(error)
                lines.skip_to(_HEADS[main])
    if found.semicircles and found.kepler.pop("C", array("d")):  # geostationary, where the angles do not tell
        text = f"{shown}: all other orbits of BeiDou: they stand beside those with angles in semicircles"
        lines.report(ConfigError(text))
    if not found.kepler and not found.glonass:
        raise lines.describe_nothing("ephemeris of GPS, GLONASS, Galileo or BeiDou")
    notes = tuple(
        f"{shown}: {count} records of Galileo name I/NAV and F/NAV at once: taken as {message}"
        for message, count in found.both.items()
    )
    return replace(_make_file(found), shown=shown, lost=lines.lost, reasons=tuple(lines.reasons), notes=notes)


def _make_file(found: _Found) -> NavigationFile:
    g = np.array(found.glonass, float).reshape(-1, 3 + len(STATE))
    klobuchar = np.array([*found.alpha, *found.beta]) if found.alpha and found.beta else None
    return NavigationFile(
        shown="",
        gps=found.make_kepler("G"),
        glonass=GlonassSets(
            g[:, 0].astype(np.int64), g[:, 1] == 0, g[:, 2].astype(np.int64), np.ascontiguousarray(g[:, 3:])
        ),
        klobuchar=klobuchar,
        galileo=tuple(found.make_kepler("E", message) for message in _SICK),
        beidou=found.make_kepler("C"),
        level=None if found.level is None else np.array(found.level),
    )


def _read_header(lines: Lines, found: _Found) -> None:
    while True:
        line = lines.read_line_of("END OF HEADER")
        label = line[60:80].strip()
        if label == "END OF HEADER":
            return
        name = label if label in ("ION ALPHA", "ION BETA") else line[:4].strip() if "IONO" in label else ""
        start = 2 if label.startswith("ION ") else 5
        if name in ("ION ALPHA", "GPSA", "ION BETA", "GPSB", "GAL"):
            columns = range(start, start + (36 if name == "GAL" else 48), 12)
            values = [lines.parse_number(line, c, c + 12, "an ionosphere parameter") for c in columns]
            if name == "GAL":
                found.level = values
            elif name in ("ION ALPHA", "GPSA"):
                found.alpha = values
            else:
                found.beta = values
        elif label == "LEAP SECONDS":
            found.leap = lines.parse_whole(line, 0, 6, "the number of leap seconds")


def _read_frame(lines: Lines, line: str, found: _Found) -> None:
    """Read the record after a line with > of RINEX 4: an ephemeris, or the ionosphere."""
    frame = _FRAME_4.match(line)
    if frame is None:
        raise lines.error(f"a record must begin here; got {line[:32].strip()!r}")
    kind, letter, _, message = frame.groups()
    if kind == "EPH" and _MESSAGES_4.get(message) == letter:
        first = lines.read_line_of("the ephemeris")
        _take_record(lines, first, 4, letter, found)
    elif kind == "ION" and (letter, message) in (("G", "LNAV"), ("E", "IFNV")):
        first, second = lines.read_line_of("the ionosphere"), lines.read_line_of("the ionosphere")
        values = _read_values(lines, first, 23, 3) + _read_values(lines, second, 4, 4)
        if letter == "E":
            found.level = found.level or values[:3]
        elif found.alpha is None and (third := lines.read_line_of("the ionosphere")):
            values += _read_values(lines, third, 4, 4)
            found.alpha, found.beta = values[:4], values[4:8]
    while (line_of := lines.read_line()) is not None and not _HEADS[4].match(line_of):
        pass
    if line_of is not None:
        lines.put_back(line_of)


def _take_record(lines: Lines, line: str, version: int, letter: str, found: _Found) -> None:
    record = _read_record(lines, line, version, letter)
    if record is None:
        return
    if letter == "R":
        found.glonass.extend(_convert_glonass(lines, record, found.leap))
        return
    message = ""
    if letter == "E":
        message = _find_message(lines, record, found)
    try:
        row = _convert_kepler(lines, record, _KINDS[letter], message)
    except ConfigError as error:
        found.semicircles += _SEMICIRCLES in error.messages[0]
        raise
    found.kepler.setdefault(letter + message, array("d")).extend(row)


def _find_message(lines: Lines, record: _EphemerisRecord, found: _Found) -> str:
    """Return the message of a record of Galileo; of both, the one of its clock or of its only group delay."""
    source = record.values[5][1]
    bits = 0 if np.isnan(source) else int(source)
    if not bits & (_INAV | _FNAV):
        raise lines.error(f"the data source {bits} is neither of I/NAV nor of F/NAV", record.first + 5)
    if not (bits & _INAV and bits & _FNAV):
        return "I/NAV" if bits & _INAV else "F/NAV"
    of_e5a, of_e5b = (abs(np.nan_to_num(value)) > 0 for value in record.values[6][2:])
    message = _CLOCKS.get(bits >> 8 & 3, "F/NAV" if of_e5a and not of_e5b else "I/NAV")
    found.both[message] += 1
    return message


@dataclass(frozen=True, slots=True)
class _EphemerisRecord:
    """The values of an ephemeris, line by line; blank fields are NaN."""

    first: int  # number of its first line
    sat: int
    t: float  # reference time, in the time scale of its system [s]
    values: list[list[float]]


def _read_record(lines: Lines, first: str, version: int, system: str) -> _EphemerisRecord | None:
    """Read the lines of one ephemeris; None if its system is skipped."""
    begun, indent = lines.number, 4 if version >= 3 else 3
    whole = {"R": (4, 5) if version >= 3 else (4,)}.get(system, (8,) if system in _KINDS else None)
    if version == 3 and first[:1] == " ":
        raise lines.error("a record must begin with its satellite, for example 'G05'")
    if whole is None:
        while (line := lines.read_line()) is not None and not line[:indent].strip():
            pass
        if line is not None:
            lines.put_back(line)
        return None
    sat, t = _read_clock_time(lines, first, version)
    rows = [_read_values(lines, first, indent + 19, 3)]
    while len(rows) < whole[-1] and (line := lines.read_line()) is not None:
        if line[:indent].strip():
            lines.put_back(line)
            break
        rows.append(_read_values(lines, line, indent, 4))
    if len(rows) not in whole:
        raise lines.error(
            f"the record of {system}{sat} from line {begun} ends after {len(rows)} of {whole[0]} lines"
        )
    return _EphemerisRecord(begun, sat, t, rows)


def _read_values(lines: Lines, line: str, start: int, count: int) -> list[float]:
    places = [(start + 19 * k, start + 19 * (k + 1)) for k in range(count)]
    return [lines.parse_number(line, a, b, "a value") if line[a:b].strip() else np.nan for a, b in places]


def _read_clock_time(lines: Lines, line: str, version: int) -> tuple[int, float]:
    """Return the satellite and the reference time of a record."""
    if version >= 3:
        columns = [(4, 8), (9, 11), (12, 14), (15, 17), (18, 20), (21, 23)]
        sat = lines.parse_whole(line, 1, 3, "the satellite")
    else:
        columns = [(3, 5), (6, 8), (9, 11), (12, 14), (15, 17), (17, 22)]
        sat = lines.parse_whole(line, 0, 2, "the satellite")
    if not 1 <= sat <= 63:
        raise lines.error(f"satellite {sat} is outside 1 to 63")
    return sat, sum(read_calendar(lines, line, columns, version == 2))


def _name_values(
    lines: Lines, record: _EphemerisRecord, placed: Mapping[str, tuple[int, float]]
) -> dict[str, float]:
    """Return the values by name, from the index of the line and the value; reject a missing one."""
    for name, (offset, value) in placed.items():
        if np.isnan(value):
            raise lines.error(f"{name} is missing", record.first + offset)
    return {name: value for name, (_, value) in placed.items()}


def _convert_kepler(lines: Lines, record: _EphemerisRecord, kind: _Kind, message: str) -> list[float]:
    """Return sat, health and the columns of ``KEPLER`` of one record (RINEX 3.05, tables A6, A8, A14)."""
    v, t_oc = record.values, record.t + kind.late
    health = v[6][1]
    delays = [0.0 if np.isnan(value) else value for value in v[6][2:]]
    if kind.system == GPS:
        delays[1] = 0.0  # IODC
    placed = {
        "af_0": (0, v[0][0]), "af_1": (0, v[0][1]), "af_2": (0, v[0][2]),
        "c_rs": (1, v[1][1]), "delta_n": (1, v[1][2]), "mean_anomaly": (1, v[1][3]),
        "c_uc": (2, v[2][0]), "e": (2, v[2][1]), "c_us": (2, v[2][2]), "sqrt_a": (2, v[2][3]),
        "t_oe_week": (3, v[3][0]), "c_ic": (3, v[3][1]), "node_0": (3, v[3][2]), "c_is": (3, v[3][3]),
        "i_0": (4, v[4][0]), "c_rc": (4, v[4][1]), "perigee": (4, v[4][2]), "node_rate": (4, v[4][3]),
        "i_rate": (5, v[5][0]), "group_delay": (6, delays[0]), "group_delay_2": (6, delays[1]),
        "health": (6, health),
    }  # fmt: skip
    values = _name_values(lines, record, placed)
    for name, low, high in (
        ("e", 0.0, 0.2), ("sqrt_a", kind.least, kind.most), ("t_oe_week", 0.0, WEEK)
    ):  # fmt: skip
        if not low <= values[name] <= high:
            text = f"{name} = {values[name]:g} is outside {low:g} to {high:g}: not a {kind.name} orbit"
            raise lines.error(text, record.first + placed[name][0])
    _check_angles(lines, record, kind, values)
    # take the week of the clock reference time, because the week field is modulo 1024 in some files
    week_start = record.t - record.t % WEEK
    t_oe = week_start + values["t_oe_week"]
    t_oe += WEEK * np.round((record.t - t_oe) / WEEK) + kind.late
    stated = v[6][0]
    values |= {"t_oe": t_oe, "t_oc": t_oc, "accuracy": 0.0 if np.isnan(stated) else stated}
    sick = int(health) & _SICK[message] if message else health
    if kind.system == GALILEO and stated < 0:  # no accuracy prediction available
        sick = 1
    return [record.sat, sick, *(values[name] for name in KEPLER)]


def _check_angles(lines: Lines, record: _EphemerisRecord, kind: _Kind, values: Mapping[str, float]) -> None:
    """Reject an orbit with angles in another unit: all but geostationary satellites fly at 0.9 to 1.1 rad."""
    level = kind.system == BEIDOU and (record.sat <= 5 or record.sat >= 59)
    low = 0.0 if level else _LEAST_INCLINATION
    if not low <= values["i_0"] <= 1.3:
        text = f"i_0 = {values['i_0']:.3g} is outside {low:g} to 1.3 rad: not a {kind.name} orbit"
        raise lines.error(text + (_SEMICIRCLES if values["i_0"] < low else ""), record.first + 4)


def _convert_glonass(lines: Lines, record: _EphemerisRecord, leap: int | None) -> list[float]:
    """Return slot, health, channel and the columns of ``GLONASS`` of one record (RINEX 3.05, table A10)."""
    v = record.values
    placed = {
        "clock": (0, v[0][0]), "clock_rate": (0, v[0][1]),
        "x": (1, v[1][0]), "vx": (1, v[1][1]), "ax": (1, v[1][2]), "health": (1, v[1][3]),
        "y": (2, v[2][0]), "vy": (2, v[2][1]), "ay": (2, v[2][2]), "channel": (2, v[2][3]),
        "z": (3, v[3][0]), "vz": (3, v[3][1]), "az": (3, v[3][2]),
    }  # fmt: skip
    values = _name_values(lines, record, placed)
    for name in ("x", "y", "z", "vx", "vy", "vz", "ax", "ay", "az"):
        values[name] *= 1e3  # km
    radius = np.sqrt(values["x"] ** 2 + values["y"] ** 2 + values["z"] ** 2)
    if not 24e6 <= radius <= 27e6:
        text = f"a radius of {radius / 1e3:.0f} km is outside 24000 to 27000 km: not a GLONASS orbit"
        raise lines.error(text, record.first + 1)
    if values["channel"] > 127:  # some programs write -7 as 249
        values["channel"] -= 256
    values["t_b"] = record.t + (leap_seconds(to_date(record.t)) if leap is None else leap)
    return [record.sat, values["health"], values["channel"], *(values[name] for name in STATE)]


def merge_navigation(files: Sequence[NavigationFile]) -> NavigationFile:
    """Merge the ephemerides of several files, or of none; the first ionosphere model of each kind is used."""
    files = files or [_make_file(_Found())]

    def join(sets: Sequence[KeplerSets]) -> KeplerSets:
        return KeplerSets(
            np.concatenate([one.sat for one in sets]),
            np.concatenate([one.healthy for one in sets]),
            np.concatenate([one.elements for one in sets]),
            sets[0].system,
            sets[0].message,
        )

    return NavigationFile(
        shown=", ".join(file.shown for file in files),
        gps=join([file.gps for file in files]),
        glonass=GlonassSets(
            *(np.concatenate([getattr(f.glonass, n) for f in files]) for n in GlonassSets.__slots__)
        ),
        klobuchar=next((f.klobuchar for f in files if f.klobuchar is not None), None),
        lost=sum(file.lost for file in files),
        reasons=tuple(reason for file in files for reason in file.reasons),
        galileo=tuple(join(sets) for sets in zip(*(file.galileo for file in files), strict=True)),
        beidou=join([file.beidou for file in files if file.beidou is not None]),
        level=next((f.level for f in files if f.level is not None), None),
        notes=tuple(note for file in files for note in file.notes),
    )
