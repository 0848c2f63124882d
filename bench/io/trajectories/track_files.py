"""Read positions over time from GPX, KML, NMEA, IGC files and tables.

What a file does not say is a remark: of which height it speaks, which fixes are left out. GPX and KML are
read with the same care as a model of an aircraft; nothing in a file is followed or executed.
"""

from __future__ import annotations

import math
import re
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray, find_later
from bench.core.words.exceptions import ConfigError, FlightError
from bench.core.words.wording import format_count
from bench.io.logs.formats.nmea_sentences import parse_number, read_places
from bench.simulation.flight.model_files import read_xml

MOST_FIXES, LEAST_FIXES = 500_000, 10
_MOST_BYTES = 200_000_000
_DAY = 86400.0
_LONGEST_LINE = 1000
_B_RECORD = re.compile(
    "B([0-9]{2})([0-9]{2})([0-9]{2})([0-9]{2})([0-9]{5})([NS])([0-9]{3})([0-9]{5})([EW])(.)"
    "(-[0-9]{4}|[0-9]{5})(-[0-9]{4}|[0-9]{5})"
)
"""Of IGC: hour, minute, second; degrees, thousandths of minutes; validity; heights of pressure and GNSS."""


@dataclass(frozen=True, slots=True)
class FixSeries:
    """Fixes in the order of their times."""

    t: FloatArray  # (N,) [s], from the first
    lla: FloatArray  # (N, 3) latitude, longitude [rad], height as the file has it [m]
    notes: tuple[str, ...]  # what was assumed or left out


Fix = tuple[float, float, float, float]
"""Time [s], latitude, longitude [deg], height [m]."""


def read_track(path: Path) -> FixSeries:
    """Read a track by the ending of its file.

    Raises
    ------
    ConfigError
        If it cannot be read or has no times: one line.
    """
    shown = path.name
    try:
        check_file(path, shown, _MOST_BYTES)
        notes: list[str] = []
        numbers = array("d")
        for fix in READERS[path.suffix.lower()](path, notes):
            numbers.extend(fix)
            if len(numbers) > 4 * MOST_FIXES:
                raise ConfigError(f"{shown}: more than {MOST_FIXES} fixes")
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    except FlightError as error:
        raise ConfigError(str(error)) from None
    fixes = np.array(numbers).reshape(-1, 4)
    return order_fixes(fixes[:, 0], np.column_stack([np.radians(fixes[:, 1:3]), fixes[:, 3]]), notes, shown)


def order_fixes(t: FloatArray, lla: FloatArray, notes: list[str], shown: str) -> FixSeries:
    """Return the finite fixes in increasing time as a track; append a note on the fixes left out."""
    if len(t) > MOST_FIXES:
        raise ConfigError(f"{shown}: {len(t)} fixes, more than {MOST_FIXES}")
    whole = np.isfinite(t) & np.isfinite(lla).all(axis=1)
    inside = whole & (np.abs(lla[:, 0]) <= 0.5 * np.pi) & (np.abs(lla[:, 1]) <= 2 * np.pi)
    inside &= (lla[:, 2] > -1e3) & (lla[:, 2] < 1e5)
    t, lla, left = t[inside], lla[inside], len(t) - int(inside.sum())
    later = find_later(t)
    if left:
        notes.append(f"left out: {format_count(left, 'fix')} without a time, a position or a height")
    if not later.all():
        many = format_count(int((~later).sum()), "fix")
        notes.append(f"left out: {many} not after the one before")
    t, lla = t[later], lla[later]
    if len(t) < LEAST_FIXES:
        raise ConfigError(
            f"{shown}: {len(t)} fixes with time, position and height; at least {LEAST_FIXES} are needed"
        )
    return FixSeries(t - t[0], lla, tuple(notes))


def _strip(element: ElementTree.Element) -> str:
    return element.tag.rpartition("}")[2]


def _parse_time(text: str | None) -> float:
    """Return the seconds since 1970 of an ISO time; NaN if the text is no ISO time."""
    try:
        at = datetime.fromisoformat((text or "").strip())
    except ValueError:
        return math.nan
    return (at if at.tzinfo else at.replace(tzinfo=UTC)).timestamp()


def _read_gpx(path: Path, notes: list[str]) -> Iterator[Fix]:
    """Read GPX 1.1: trkpt with lat, lon, ele, time."""
    root, timed = read_xml(path, path.name), False
    notes.append("heights are taken as ellipsoidal; GPX does not define them")
    for point in root.iter():
        if _strip(point) != "trkpt":
            continue
        inner = {_strip(child): child.text for child in point}
        t = _parse_time(inner.get("time"))
        timed |= not math.isnan(t)
        lat, lon = parse_number(point.get("lat")), parse_number(point.get("lon"))
        yield t, lat, lon, parse_number(inner.get("ele"))
    if not timed:
        raise ConfigError(f"{path.name}: no <trkpt> with a <time>: a route without times is not a motion")


def _read_kml(path: Path, notes: list[str]) -> Iterator[Fix]:
    """Read KML with gx:Track: a <when> and a <gx:coord> for each fix; a LineString has no times."""
    root, found = read_xml(path, path.name), False
    notes.append("heights are taken as ellipsoidal; KML has them above the sea")
    for track in root.iter():
        if _strip(track) != "Track":
            continue
        times = [_parse_time(child.text) for child in track if _strip(child) == "when"]
        places = [(child.text or "").split() for child in track if _strip(child) == "coord"]
        if len(times) != len(places):
            raise ConfigError(
                f"{path.name}: a <gx:Track> has {len(times)} <when> and {len(places)} <gx:coord>"
            )
        for t, place in zip(times, places, strict=True):
            found = True
            lon, lat, alt = (parse_number(text) for text in (*place, "", "", "")[:3])
            yield t, lat, lon, alt
    if not found:
        raise ConfigError(f"{path.name}: no <gx:Track>: a <LineString> has no times")


def _read_lines(path: Path) -> Iterator[str]:
    with path.open(encoding="latin-1") as file:
        while line := file.readline(_LONGEST_LINE):
            yield line.strip()


def _read_nmea(path: Path, notes: list[str]) -> Iterator[Fix]:
    """Read NMEA 0183: GGA for time, position and height with geoid separation; quality 0 means no fix."""
    places, told = read_places(path)
    notes += told
    yield from places.tolist()


def _read_igc(path: Path, notes: list[str]) -> Iterator[Fix]:
    """Read IGC: B records with time and position in fixed columns (FAI technical specification, A4.1).

    The height of the GNSS is above the ellipsoid; without it, that of the pressure, above 1013.25 hPa.
    """
    rows: list[tuple[float, float, float, float, float]] = []
    day, last, flat = 0.0, -1.0, 0
    for line in _read_lines(path):
        if (found := _B_RECORD.match(line)) is None:
            continue
        clock = [int(text) for text in found.group(1, 2, 3)]
        t = clock[0] * 3600.0 + clock[1] * 60 + clock[2]
        if t < last - _DAY / 2:
            day += _DAY
        last = t
        lat = (int(found[4]) + int(found[5]) / 60_000) * (-1 if found[6] == "S" else 1)
        lon = (int(found[7]) + int(found[8]) / 60_000) * (-1 if found[9] == "W" else 1)
        flat += found[10] != "A"
        rows.append((day + t, lat, lon, float(found[11]), float(found[12])))
        if len(rows) > MOST_FIXES:
            break
    satellite = any(row[4] for row in rows)
    if flat:
        notes.append(f"{flat} fixes are marked as two-dimensional")
    if not satellite:
        notes.append("heights are pressure heights above 1013.25 hPa: the file has no GNSS heights")
    for t, lat, lon, by_pressure, by_gnss in rows:
        yield t, lat, lon, by_gnss if satellite else by_pressure


READERS: dict[str, Callable[[Path, list[str]], Iterator[Fix]]] = {
    ".gpx": _read_gpx,
    ".kml": _read_kml,
    ".nmea": _read_nmea,
    ".igc": _read_igc,
}
"""Ending of a file -> what reads its fixes, and appends remarks."""
