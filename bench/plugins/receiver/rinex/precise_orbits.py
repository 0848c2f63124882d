"""Read SP3 files, versions a to d: precise orbits and clocks of satellites.

Hilla, The Extended Standard Product 3 Orbit Format (SP3-d), NGS, 2016.
"""

from __future__ import annotations

import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.orbit_sets import GLONASS, LETTERS, SYSTEM_NAMES, OrbitTable
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.rtcm_ephemerides import read_rtcm_navigation
from bench.plugins.receiver.receiver_streams.sbf import read_sbf_navigation
from bench.plugins.receiver.receiver_streams.ubx import read_ubx_navigation
from bench.plugins.receiver.rinex.ephemerides import NavigationFile, merge_navigation, read_navigation
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE, Lines, find_kind, open_lines, read_calendar
from bench.simulation.signals.gps_time import leap_seconds, to_date

_EPOCH = re.compile(r"\*|EOF")
_CALENDAR = [(3, 7), (8, 10), (11, 13), (14, 16), (17, 19), (20, 31)]
_AHEAD = {"GPS": 0.0, "GAL": 0.0, "QZS": 0.0, "BDT": -BEIDOU_LATE, "BDS": -BEIDOU_LATE, "TAI": 19.0}
"""Time of a system minus GPS time [s]; UTC and GLO, UTC without the hours of Moscow, have leap seconds."""
_NO_CLOCK = 999999.0  # and above [us]
_LEAST, _MOST = 2e7, 5e7  # distance of a satellite of these systems from the center of the Earth [m]
MOST_POSITIONS = 6_000_000  # epochs times satellites: a year of 15 min
_PREDICTED = 0.45  # sd of a predicted clock [m]: 1.5 ns of ultra-rapid orbits, IGS products, igs.org


@dataclass(frozen=True, slots=True)
class PreciseFile:
    """Precise orbits and clocks; times in s since 1980-01-06, GPS time."""

    shown: str
    names: tuple[str, ...]  # (S,) of satellites
    t: FloatArray  # (N,)
    values: FloatArray  # (S, N, 7) x, y, z [m], clock [s], sd [m], 1 where an orbit, a clock begins anew
    lost: int  # number of records that are left out because they are damaged
    reasons: tuple[str, ...]  # why the first of them are, with line numbers
    gaps: tuple[str, ...]  # which satellites have no orbit or clock at some epochs


@dataclass(slots=True)
class _PreciseRows:
    """Data read so far."""

    t: array[float] = field(default_factory=lambda: array("d"))
    sats: dict[str, int] = field(default_factory=dict)  # name of each satellite that has a position -> number
    places: array[int] = field(default_factory=lambda: array("q"))  # of each position: satellite, epoch
    values: array[float] = field(default_factory=lambda: array("d"))  # the seven of `PreciseFile` of each
    names: list[str] = field(default_factory=list)
    exponents: list[int] = field(default_factory=list)
    scale: str = "GPS"

    def find_sd(self) -> dict[str, float]:
        """Return the accuracy of each satellite [m] by the header, where it has one."""
        pairs = zip(self.names, self.exponents, strict=False)
        return {name: 1e-3 * 2.0**n for name, n in pairs if n > 0}


def read_precise_orbits(path: Path, shown: str | None = None) -> PreciseFile:
    """Read the orbits and clocks of GPS, GLONASS, Galileo and BeiDou of an SP3 file, packed or not.

    Raises
    ------
    ConfigError
        If it is no SP3 file, or has no epoch that can be read: one line with file and line number.
    """
    shown = path.name if shown is None else shown
    found = _PreciseRows()
    with open_lines(path, shown) as lines:
        declared = _read_header(lines, found)
        while len(found.places) <= 2 * MOST_POSITIONS:
            try:
                line = lines.read_line()
                if line is None:
                    raise lines.error(f"the file ends without EOF after {len(found.t)} of {declared} epochs")
                if line.startswith("EOF"):
                    break
                if line.startswith("*"):
                    _read_epoch(lines, line, found)
                elif line.startswith("P") and found.t:
                    _read_position(lines, line, found)
            except ConfigError as error:
                lines.report(error)
                if line is None:
                    break
                if line.startswith("*"):
                    lines.skip_to(_EPOCH)
        if len(found.sats) * len(found.t) > MOST_POSITIONS or len(found.places) > 2 * MOST_POSITIONS:
            raise ConfigError(f"{shown}: more than {MOST_POSITIONS} positions of satellites")
        if not found.sats:
            raise lines.describe_nothing("position of a satellite of GPS, GLONASS, Galileo or BeiDou")
    return _make_file(shown, found, lines)


def _read_header(lines: Lines, found: _PreciseRows) -> int:
    """Read the lines before the first epoch; return the number of epochs that they announce."""
    first = lines.read_line_of("the header")
    if not re.match(r"#[abcd][PV]", first):
        raise lines.error("must begin with '#', a version from a to d, and P or V: not an SP3 file")
    declared = lines.parse_whole(first, 32, 39, "the number of epochs")
    known = False
    while True:
        line = lines.read_line_of("the first epoch")
        if line.startswith("*"):
            lines.put_back(line)
            return declared
        if line.startswith("++"):
            fields = [line[k : k + 3].strip() for k in range(9, 60, 3)]
            found.exponents += [int(text) if text.isdecimal() else 0 for text in fields]
        elif line.startswith("+"):
            found.names += [_name(line[k : k + 3]) for k in range(9, 60, 3)]
        elif line.startswith("%c") and not known:
            known, scale = True, line[9:12].strip()
            found.scale = scale if scale != "ccc" and scale else "GPS"
            if found.scale not in (*_AHEAD, "UTC", "GLO"):
                choices = ", ".join((*_AHEAD, "UTC", "GLO"))
                raise lines.error(f"the time system must be one of {choices}; got {found.scale[:10]!r}")


def _name(text: str) -> str:
    """Return the RINEX name of a satellite; SP3-a has no letter for GPS."""
    return f"{text[:1].strip() or 'G'}{text[1:].replace(' ', '0')}"


def _read_epoch(lines: Lines, line: str, found: _PreciseRows) -> None:
    midnight, second = read_calendar(lines, line, _CALENDAR, two_digits=False)
    t = midnight + second
    t += leap_seconds(to_date(t)) if found.scale in ("UTC", "GLO") else -_AHEAD[found.scale]
    if found.t and t <= found.t[-1]:
        raise lines.error("the times of epochs must increase")
    found.t.append(t)


def _read_position(lines: Lines, line: str, found: _PreciseRows) -> None:
    name = _name(line[1:4])
    if name[0] not in LETTERS:
        return
    if not re.fullmatch(r"[A-Z]\d\d", name):
        raise lines.error(f"a satellite must be a letter and two digits; got {line[1:4]!r}")
    columns = enumerate(("x", "y", "z", "the clock"))
    x, y, z, clock = (lines.parse_number(line, 4 + 14 * k, 18 + 14 * k, what) for k, what in columns)
    place = [1e3 * x, 1e3 * y, 1e3 * z]
    far = float(np.linalg.norm(place))
    if far and not _LEAST < far < _MOST:
        name = SYSTEM_NAMES[LETTERS.index(name[0])]
        text = f"a radius of {far / 1e3:.0f} km is outside {_LEAST / 1e3:.0f} to {_MOST / 1e3:.0f} km"
        raise lines.error(f"{text}: not a {name} orbit")
    if not far:
        place = [np.nan] * 3
    seconds = np.nan if abs(clock) >= _NO_CLOCK else 1e-6 * clock
    flags = line[74:80].ljust(6)
    sd = _PREDICTED if flags[1] == "P" else 0.0
    found.places.extend((found.sats.setdefault(name, len(found.sats)), len(found.t) - 1))
    found.values.extend((*place, seconds, sd, flags[4] == "M", flags[0] == "E"))


def _make_file(shown: str, found: _PreciseRows, lines: Lines) -> PreciseFile:
    names = sorted(found.sats)
    values = np.tile([np.nan] * 4 + [0.0] * 3, (len(names), len(found.t), 1))
    order = np.argsort(np.argsort(list(found.sats)))
    sat, epoch = np.array(found.places).reshape(-1, 2).T
    values[order[sat], epoch] = np.array(found.values).reshape(-1, 7)
    stated = found.find_sd()
    values[..., 4] = np.hypot(values[..., 4], [[stated.get(name, 0.0)] for name in names])
    gaps = []
    for column, words in ((0, "orbit"), (3, "clock")):
        lacks = np.isnan(values[..., column]).sum(axis=1)
        parts = [f"{name} {n}" for name, n in zip(names, lacks, strict=True) if n]
        if parts:
            count = f"{len(found.t)} epochs"
            gaps.append(f"{shown}: has no {words} at this many of its {count}: {', '.join(parts)}")
    t = np.array(found.t)
    return PreciseFile(shown, tuple(names), t, values, lines.lost, tuple(lines.reasons), tuple(gaps))


def make_tables(files: Sequence[PreciseFile]) -> list[OrbitTable]:
    """Return the orbits and clocks of several files: a table of each system, step and segment without a gap.

    Of several values of a satellite at an epoch that of the first file counts; so does the first table.
    """
    alike: dict[tuple[int, float, float], list[PreciseFile]] = {}
    for file in files:
        step = round(float(np.median(np.diff(file.t))), 3) if len(file.t) > 1 else np.inf
        for system in {LETTERS.index(name[0]) for name in file.names}:
            alike.setdefault((system, step, round(file.t[0] % step, 3)), []).append(file)
    return [table for (system, step, _), parts in alike.items() for table in _join(system, step, parts)]


def _join(system: int, step: float, files: Sequence[PreciseFile]) -> Iterator[OrbitTable]:
    """Yield the tables of one system of files with the same step [s]."""
    names = sorted({name for file in files for name in file.names if name[0] == LETTERS[system]})
    t = np.unique(np.concatenate([file.t for file in files]))
    values = np.full((len(names), len(t), 7), np.nan)
    for file in files:
        rows = [k for k, name in enumerate(file.names) if name in names]
        place = np.ix_(np.searchsorted(names, [file.names[k] for k in rows]), np.searchsorted(t, file.t))
        found = values[place]
        for first, columns in ((0, [0, 1, 2, 5]), (3, [3, 4, 6])):  # an orbit, a clock and what is said of it
            lacks = np.isnan(found[..., first, None])
            found[..., columns] = np.where(lacks, file.values[rows][..., columns], found[..., columns])
        values[place] = found
    known = np.isfinite(values[..., [0, 3]])
    joined = known[:, :-1] & known[:, 1:] & (values[:, 1:, 5:] == 0)
    sat, shown = np.array([int(name[1:]) for name in names]), ", ".join(file.shown for file in files)
    for k in np.split(np.arange(len(t)), np.flatnonzero(np.diff(t) > 1.5 * step) + 1):
        own = values[:, k]
        yield OrbitTable(system, sat, t[k], own[..., :3], own[..., 3], own[..., 4], joined[:, k[:-1]], shown)


def read_orbits(paths: Sequence[Path]) -> NavigationFile:
    """Read files of navigation and SP3; a system that has precise orbits is computed from these alone.

    A navigation file in which nothing can be read is left out with a note if another one can be read.

    Raises
    ------
    ConfigError
        If a file is neither of these, or nothing can be read in any of them.
    """
    kinds = {path: find_kind(path, str(path)) for path in paths}
    streams = {"ubx": read_ubx_navigation, "rtcm": read_rtcm_navigation, "sbf": read_sbf_navigation}
    broadcast, wrong = list[NavigationFile](), list[ConfigError]()
    for path in (path for path in paths if kinds[path] != "sp3"):
        try:
            read = streams.get(kinds[path], read_navigation)
            broadcast.append(read(path, str(path)))
        except ConfigError as error:
            wrong.append(error)
    files = [read_precise_orbits(path, str(path)) for path in paths if kinds[path] == "sp3"]
    if wrong and not broadcast and not files:
        raise wrong[0]
    nav = merge_navigation(broadcast)
    notes = [*(f"left out: {error}" for error in wrong), *nav.notes]
    nav = replace(nav, notes=tuple(notes))
    if not files:
        return nav
    tables = make_tables(files)
    notes += [line for file in files for line in file.gaps]
    if len(nav.glonass) == 0 and any(table.system == GLONASS for table in tables):
        notes.append("GLONASS needs a navigation file beside SP3: its channels are in no other")
    return replace(
        nav,
        shown=", ".join(map(str, paths)),
        precise=tuple(tables),
        lost=nav.lost + sum(file.lost for file in files),
        reasons=(*nav.reasons, *(line for file in files for line in file.reasons)),
        notes=tuple(notes),
    )
