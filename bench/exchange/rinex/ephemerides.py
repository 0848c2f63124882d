"""Read RINEX navigation files: the broadcast ephemerides of GPS and GLONASS.

A damaged record is left out and reported with its line number.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.exchange.rinex.lines import Lines, check_version, leap_seconds, open_lines, read_calendar, to_date
from bench.orbit_sets import GLONASS as STATE
from bench.orbit_sets import KEPLER, GlonassSets, KeplerSets
from bench.signals.orbits import WEEK

_HEADS = {2: re.compile(r" ?\d"), 3: re.compile(r"[A-Z][ \d]\d")}
"""Version -> how the first line of a record begins."""


@dataclass(frozen=True, slots=True)
class NavigationFile:
    """Broadcast ephemerides; times in s since 1980-01-06, GPS time."""

    shown: str
    kepler: KeplerSets
    glonass: GlonassSets
    klobuchar: FloatArray | None  # (8,) alpha, beta
    lost: int = 0  # number of records that are left out because they are damaged
    reasons: tuple[str, ...] = ()  # why the first of them are, with line numbers


def read_navigation(path: Path, shown: str | None = None) -> NavigationFile:
    """Read the GPS and GLONASS ephemerides of a RINEX 2 or 3 navigation file.

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
    with open_lines(path, shown) as lines:
        version, kind = check_version(lines, "a navigation file")
        alpha, beta, leap = _read_header(lines)
        kepler: list[list[float]] = []
        glonass: list[list[float]] = []
        while True:
            try:
                if (line := lines.read_line()) is None:
                    break
                if not line.strip():
                    continue
                system = line[0] if version == 3 else ("R" if kind[0] == "G" else "G")
                record = _read_record(lines, line, version, system)
                if record is not None and system == "G":
                    kepler.append(_convert_kepler(lines, record))
                elif record is not None:
                    glonass.append(_convert_glonass(lines, record, leap))
            except ConfigError as error:
                lines.report(error)
                lines.skip_to(_HEADS[version])
    if not kepler and not glonass:
        raise lines.describe_nothing("GPS or GLONASS ephemeris")
    k = np.array(kepler, float).reshape(-1, 2 + len(KEPLER))
    g = np.array(glonass, float).reshape(-1, 3 + len(STATE))
    return NavigationFile(
        shown=shown,
        kepler=KeplerSets(k[:, 0].astype(np.int64), k[:, 1] == 0, np.ascontiguousarray(k[:, 2:])),
        glonass=GlonassSets(
            g[:, 0].astype(np.int64), g[:, 1] == 0, g[:, 2].astype(np.int64), np.ascontiguousarray(g[:, 3:])
        ),
        klobuchar=np.array(alpha + beta) if alpha is not None and beta is not None else None,
        lost=lines.lost,
        reasons=tuple(lines.reasons),
    )


def _read_header(lines: Lines) -> tuple[list[float] | None, list[float] | None, int | None]:
    alpha = beta = None
    leap = None
    while True:
        line = lines.read_line_of("END OF HEADER")
        label = line[60:80].strip()
        if label == "END OF HEADER":
            return alpha, beta, leap
        name = label if label in ("ION ALPHA", "ION BETA") else line[:4] if "IONO" in label else ""
        start = 2 if label.startswith("ION ") else 5
        if name in ("ION ALPHA", "GPSA", "ION BETA", "GPSB"):
            columns = range(start, start + 48, 12)
            values = [lines.parse_number(line, c, c + 12, "an ionosphere parameter") for c in columns]
            alpha, beta = (values, beta) if name in ("ION ALPHA", "GPSA") else (alpha, values)
        elif label == "LEAP SECONDS":
            leap = lines.parse_whole(line, 0, 6, "the number of leap seconds")


@dataclass(frozen=True, slots=True)
class _EphemerisRecord:
    """The values of an ephemeris, line by line; blank fields are NaN."""

    first: int  # number of its first line
    sat: int
    t: float  # reference time, in the time scale of its system [s]
    values: list[list[float]]


def _read_record(lines: Lines, first: str, version: int, system: str) -> _EphemerisRecord | None:
    """Read the lines of one ephemeris; None if its system is skipped."""
    begun, indent = lines.number, 4 if version == 3 else 3
    whole = {"G": (8,), "R": (4, 5) if version == 3 else (4,)}.get(system)
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
    if version == 3:
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
    """Return the values by name, from the index of the line and the value; refuse a missing one."""
    for name, (offset, value) in placed.items():
        if np.isnan(value):
            raise lines.error(f"{name} is missing", record.first + offset)
    return {name: value for name, (_, value) in placed.items()}


def _convert_kepler(lines: Lines, record: _EphemerisRecord) -> list[float]:
    """Return sat, health and the columns of ``KEPLER`` of one GPS record (RINEX 3.05, table A6)."""
    v, t_oc = record.values, record.t
    group_delay = 0.0 if np.isnan(v[6][2]) else v[6][2]
    placed = {
        "af_0": (0, v[0][0]), "af_1": (0, v[0][1]), "af_2": (0, v[0][2]),
        "c_rs": (1, v[1][1]), "delta_n": (1, v[1][2]), "mean_anomaly": (1, v[1][3]),
        "c_uc": (2, v[2][0]), "e": (2, v[2][1]), "c_us": (2, v[2][2]), "sqrt_a": (2, v[2][3]),
        "t_oe_week": (3, v[3][0]), "c_ic": (3, v[3][1]), "node_0": (3, v[3][2]), "c_is": (3, v[3][3]),
        "i_0": (4, v[4][0]), "c_rc": (4, v[4][1]), "perigee": (4, v[4][2]), "node_rate": (4, v[4][3]),
        "i_rate": (5, v[5][0]), "group_delay": (6, group_delay), "health": (6, v[6][1]),
    }  # fmt: skip
    values = _name_values(lines, record, placed)
    for name, low, high in (("e", 0.0, 0.2), ("sqrt_a", 4900.0, 5400.0), ("t_oe_week", 0.0, WEEK)):
        if not low <= values[name] <= high:
            text = f"{name} = {values[name]:g} is outside {low:g} to {high:g}: not a GPS orbit"
            raise lines.error(text, record.first + placed[name][0])
    # take the week of the clock reference time, because the week field is modulo 1024 in some files
    week_start = t_oc - t_oc % WEEK
    t_oe = week_start + values["t_oe_week"]
    t_oe += WEEK * np.round((t_oc - t_oe) / WEEK)
    values |= {"t_oe": t_oe, "t_oc": t_oc}
    return [record.sat, values["health"], *(values[name] for name in KEPLER)]


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
    """Merge the ephemerides of several files; the first ionosphere model is used."""
    return NavigationFile(
        shown=", ".join(file.shown for file in files),
        kepler=KeplerSets(
            *(np.concatenate([getattr(f.kepler, n) for f in files]) for n in KeplerSets.__slots__)
        ),
        glonass=GlonassSets(
            *(np.concatenate([getattr(f.glonass, n) for f in files]) for n in GlonassSets.__slots__)
        ),
        klobuchar=next((f.klobuchar for f in files if f.klobuchar is not None), None),
        lost=sum(file.lost for file in files),
        reasons=tuple(reason for file in files for reason in file.reasons),
    )
