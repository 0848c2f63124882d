"""Read RINEX observation files: code, Doppler, C/N0 and phase of GPS, GLONASS, Galileo and BeiDou.

A damaged epoch is left out and reported with its line number.
"""

from __future__ import annotations

import re
from array import array
from bisect import bisect_left
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.codes import OTHERS, SYSTEMS, Signal, Signals, find_signals
from bench.plugins.receiver.rinex.compact import LONGEST
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE, Lines, check_version, open_lines, read_calendar
from bench.simulation.signals.gps_time import leap_seconds, to_date

_MOST_SATELLITES = 200
_MOST_SCALES = 10_000  # of observables of all systems; each has less than 100
_HEADS = {
    2: re.compile(r" [ \d]\d( [ \d]\d){4}[ \d]{2}\d\.[ \d]{7}  \d[ \d]{2}\d| {28}[2-5][ \d]{2}\d"),
    3: re.compile(">"),
}
"""Version -> how the first line of an epoch, or of an event, begins."""
_SATELLITE = re.compile(r"[A-Z ].*\S")
_MORE_SATELLITES = re.compile(r" {32}([A-Z ][ \d]\d)+\s*$")
_NAN, _INF = float("nan"), float("inf")
_NONE = (_NAN,) * 4
_WHOLE = 6  # whole numbers of a row: satellite, system; band of two carriers; whether each lost count


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
    band: IntArray  # (K, 2) RINEX digit of each carrier; 0 where missing
    phase: FloatArray  # (K, 2) [cycles]; NaN where missing or not asked for
    slipped: BoolArray  # (K, 2) the receiver says that it lost count of the cycles
    recounted: int = 0  # number of epochs with another number of satellites than they say
    others: Mapping[str, int] = field(default_factory=dict)  # name of a system that is left out -> its rows
    sd: FloatArray | None = None  # (K, 2) what the receiver says of its ranges [m]; NaN where it says nothing


class _Header:
    """The values in use from the header of an observation file."""

    def __init__(self, version: float) -> None:
        self.version = version
        self.marker = ""
        self.approximate_e: FloatArray | None = None
        self.antenna_hen = np.zeros(3)
        self.types: dict[str, list[str]] = {}
        self.scales: dict[tuple[str, str], float] = {}
        self.time_system = ""
        self.leap: int | None = None
        self.moving = False
        self._signals: dict[str, Signals] | None = None

    def read(self, lines: Lines, line: str) -> None:
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
            self._read_scale(lines, line)
        elif label == "SYS / # / OBS TYPES" and self.version >= 3:
            self._types(lines, line, line[0], 3, 6, 7, 13)
        elif label == "# / TYPES OF OBSERV" and self.version < 3:
            self._types(lines, line, " ", 0, 6, 6, 9)

    def find_signals(self) -> Mapping[str, Signals]:
        """Return, for each system, the signals of both carriers that the file has, in order of preference."""
        if self._signals is None:
            types = dict.fromkeys(SYSTEMS, self.types.get(" ", [])) if self.version < 3 else self.types
            self._signals = {s: find_signals(s, types[s], self.version) for s in SYSTEMS if s in types}
        return self._signals

    def find_scales(self, letter: str) -> list[float] | None:
        """Return the factor of each observable of a system; None if all are 1."""
        if not self.scales:
            return None
        types = self.types.get(letter, [])
        return [self.scales.get((letter, one), self.scales.get((letter, ""), 1.0)) for one in types]

    def _read_scale(self, lines: Lines, line: str) -> None:
        """Take by what the observables of a system are multiplied (RINEX 3.05, table A2)."""
        system, names = line[0], line[10:58].split()
        scale = float(lines.parse_whole(line, 2, 6, "the scale factor"))
        if scale not in (1.0, 10.0, 100.0, 1000.0):
            raise lines.error(f"the scale factor {scale:g} must be 1, 10, 100 or 1000")
        count = lines.parse_whole(line, 8, 10, "the number of observables") if line[8:10].strip() else 0
        while len(names) < count:
            names += lines.read_line_of("the observables with a scale factor")[10:58].split()
        for name in names or [""]:
            self.scales[system, name] = scale
        if len(self.scales) > _MOST_SCALES:
            raise lines.error(f"more than {_MOST_SCALES} scale factors")

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
        self.types[system], self._signals = found, None


def read_observations(path: Path, shown: str | None = None, *, phase: bool = False) -> ObservationFile:
    """Read code, Doppler and C/N0 of four systems from a RINEX 2, 3 or 4 observation file, packed or not.

    Parameters
    ----------
    path : Path
        The file: as it is, Compact RINEX, gzip, or .Z.
    shown : str or None
        Name of the file in messages; default its file name.
    phase : bool
        Read carrier phases, too.

    Raises
    ------
    ConfigError
        If the header is malformed or no epoch can be read: one line with file and line number.
    """
    shown = path.name if shown is None else shown
    with open_lines(path, shown) as lines:
        version, _ = check_version(lines, "an observation file")
        header = _Header(version)
        while (line := lines.read_line_of("END OF HEADER"))[60:80].strip() != "END OF HEADER":
            header.read(lines, line)
        if not header.types:
            raise lines.error("the header lists no observables")
        rows = _EpochRows(header, phase)
        _read_epochs(lines, header, rows)
    if not rows.start:
        raise lines.describe_nothing("epoch")
    if not rows.whole:
        others = f" (only {', '.join(rows.others)})" if rows.others else ""
        raise ConfigError(f"{shown}: has no observation of GPS, GLONASS, Galileo or BeiDou in it{others}")
    kept = rows.find_increasing()
    for k in np.flatnonzero(~kept):
        lines.report(
            lines.error("the time of the epoch does not fit between those around it", rows.number[k])
        )
    start = np.append(np.array(rows.start, np.int64), rows.count())
    count = np.diff(start)
    of_kept = np.repeat(kept, count)
    midnight = np.array(rows.midnight)[kept]
    origin = float(midnight[0])
    t = midnight - origin + np.array(rows.second)[kept]
    if header.time_system == "GLO":  # UTC
        t += leap_seconds(to_date(origin)) if header.leap is None else header.leap
    elif header.time_system == "BDT":
        t += BEIDOU_LATE
    code, doppler, cn0, carrier = (_keep(column, 2, of_kept) for column in rows.values)
    whole = _keep(rows.whole, _WHOLE, of_kept)
    lost, reasons = lines.count_lost()
    return ObservationFile(
        shown=shown,
        marker=header.marker,
        origin=origin,
        t=t,
        epoch_start=np.concatenate([[0], np.cumsum(count[kept])]),
        sat=whole[:, 0].astype(np.int64),
        system=whole[:, 1].astype(np.int64),
        pseudorange=code,
        doppler=doppler,
        cn0=cn0,
        approximate_e=header.approximate_e,
        antenna_hen=header.antenna_hen,
        moving=header.moving,
        lost=lost,
        reasons=reasons,
        band=whole[:, 2:4].astype(np.int64),
        phase=carrier,
        slipped=whole[:, 4:].astype(np.bool_),
        recounted=rows.recounted,
        others=rows.others,
    )


def _keep(numbers: array[Any], width: int, kept: BoolArray) -> NDArray[Any]:
    """Return numbers as rows (K, width), those marked; without a copy if all are."""
    rows = np.frombuffer(numbers, numbers.typecode).reshape(-1, width)
    return rows if kept.all() else rows[kept]


class _EpochRows:
    """The epochs and observations read so far, in compact arrays."""

    def __init__(self, header: _Header, phase: bool) -> None:
        self._header, self._phase = header, phase
        self.midnight, self.second = array("d"), array("d")
        self.values = tuple(array("d") for _ in range(4))  # of two carriers: code, Doppler, C/N0, phase
        self.start, self.number = array("q"), array("q")
        self.whole = array("h")
        self.recounted = 0
        self.others: Counter[str] = Counter()

    def count(self) -> int:
        """Return the number of rows."""
        return len(self.whole) // _WHOLE

    def begin(self, lines: Lines, time: tuple[float, float]) -> None:
        self.midnight.append(time[0])
        self.second.append(time[1])
        self.start.append(self.count())
        self.number.append(lines.number)

    def add(self, lines: Lines, name: str, line: str, start: int) -> None:
        """Take the observables of a satellite, which begin in a column of a line."""
        letter = name[:1].strip() or "G"
        system = SYSTEMS.get(letter)
        if system is None:
            self.others[OTHERS.get(letter, f"system {letter!r}")] += 1
            return
        signals = self._header.find_signals().get(letter)
        if signals is None:
            raise lines.error(f"the header lists no observables of system {letter!r}")
        number = name[1:3]
        if not number.strip().isdecimal():
            raise lines.error(f"the number of a satellite must be a whole number; got {number!r}")
        scales = self._header.find_scales(letter)
        one, band, slipped = self._choose(lines, line, start, signals[0], scales)
        two, band_2, slipped_2 = self._choose(lines, line, start, signals[1], scales)
        for column, of_one, of_two in zip(self.values, one, two, strict=True):
            column.append(of_one)
            column.append(of_two)
        self.whole.extend((int(number), system, band, band_2, slipped, slipped_2))

    def _choose(
        self, lines: Lines, line: str, start: int, signals: Sequence[Signal], scales: list[float] | None
    ) -> tuple[tuple[float, ...], int, bool]:
        """Return code, Doppler, C/N0 and phase of the first signal with a code, its band, and a slip flag.

        A missing Doppler or C/N0 is taken from another signal of the carrier.
        """
        for chosen in signals:
            code = _read_field(lines, line, start + 16 * chosen.code)
            if code == code:
                break
        else:
            return _NONE, 0, False
        doppler = cn0 = phase = _NAN
        of_doppler = of_cn0 = 0
        for of_doppler in chosen.doppler:
            doppler = _read_field(lines, line, start + 16 * of_doppler)
            if doppler == doppler:
                break
        for of_cn0 in chosen.cn0:
            cn0 = _read_field(lines, line, start + 16 * of_cn0)
            if cn0 == cn0:
                break
        slipped = False
        if self._phase and chosen.phase >= 0:
            a = start + 16 * chosen.phase
            phase = _read_field(lines, line, a)
            slipped = line[a + 14 : a + 15] in tuple("1357")  # bit 0 of the indicator
        if scales is not None:
            code, doppler = code / scales[chosen.code], doppler / scales[of_doppler]
            cn0, phase = cn0 / scales[of_cn0], phase / scales[chosen.phase]
        return (code, doppler, cn0, phase), chosen.band, slipped

    def keep_first(self, epochs: int) -> None:
        """Remove the epochs after the first ones."""
        if epochs < len(self.start):
            rows = self.start[epochs]
            for column in (self.midnight, self.second, self.start, self.number):
                del column[epochs:]
            for column in self.values:
                del column[2 * rows :]
            del self.whole[_WHOLE * rows :]

    def find_increasing(self) -> BoolArray:
        """Return a mask (M,) of a longest sequence of increasing times; of equal times, the first."""
        times = np.array(self.midnight) + np.array(self.second)
        kept = np.ones(len(times), np.bool_)
        if len(times) < 2 or (np.diff(times) > 0).all():
            return kept
        ends, at = array("d"), array("q")  # smallest last time of a sequence of each length, and its epoch
        before = np.full(len(times), -1)
        for k, t in enumerate(array("d", times)):
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


def _read_epochs(lines: Lines, header: _Header, rows: _EpochRows) -> None:
    """Read every epoch; report a damaged one and go on at the next."""
    old = header.version < 3
    head, read = _HEADS[2 if old else 3], _read_epoch_2 if old else _read_epoch_3
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


def _read_body(lines: Lines, head: re.Pattern[str], k: int, count: int, content: str) -> str:
    """Return the next line of an epoch; raise ConfigError if the next epoch or the end comes first."""
    line = lines.read_line_of(f"{content} {k + 1} of {count} of the epoch")
    if head.match(line):
        lines.put_back(line)
        raise lines.error(f"the epoch above has {k} of {count} {content}s", lines.number + 1)
    return line


def _read_event(lines: Lines, header: _Header, head: re.Pattern[str], flag: int, count: int) -> None:
    header.moving |= flag == 2
    for k in range(count):
        header.read(lines, _read_body(lines, head, k, count, "line"))


def _read_epoch_3(lines: Lines, line: str, header: _Header, rows: _EpochRows) -> None:
    columns = [(2, 6), (7, 9), (10, 12), (13, 15), (16, 18), (18, 29)]
    flag = lines.parse_whole(line, 31, 32, "the epoch flag")
    count = lines.parse_whole(line, 32, 35, "the number of satellites")
    if flag > 1:
        _read_event(lines, header, _HEADS[3], flag, count)
        return
    _check_count(lines, count)
    rows.begin(lines, read_calendar(lines, line, columns, False))
    found = 0
    while (body := lines.read_line()) is not None:
        if not _SATELLITE.match(body):
            lines.put_back(body)
            break
        found += 1
        rows.add(lines, body[:3], body, 3)
    if body is None and found < count:  # its last line may be cut off, too
        raise lines.error(f"the file ends before satellite {found + 1} of {count} of the epoch")
    rows.recounted += found != count  # its lines are sound: the epoch is kept


def _read_epoch_2(lines: Lines, line: str, header: _Header, rows: _EpochRows) -> None:
    columns = [(1, 3), (4, 6), (7, 9), (10, 12), (13, 15), (15, 26)]
    flag = lines.parse_whole(line, 28, 29, "the epoch flag")
    count = lines.parse_whole(line, 29, 32, "the number of satellites")
    if 2 <= flag <= 5:
        _read_event(lines, header, _HEADS[2], flag, count)
        return
    _check_count(lines, count)
    if flag < 2:
        rows.begin(lines, read_calendar(lines, line, columns, True))
    listed = line[32:68].ljust(36)
    more = lines.read_line()
    while more is not None and _MORE_SATELLITES.match(more):
        listed += more[32:68].ljust(36)
        more = lines.read_line()
    if more is not None:
        lines.put_back(more)
    names = [listed[k : k + 3] for k in range(0, len(listed), 3)]
    names = [name for name in names if name.strip()]
    rows.recounted += len(names) != count
    width = (len(header.types[" "]) + 4) // 5
    for k, name in enumerate(names):
        parts = [_read_body(lines, _HEADS[2], k, len(names), "satellite")[:80] for _ in range(width)]
        if flag < 2:
            rows.add(lines, name, "".join(part.ljust(80) for part in parts), 0)


def _check_count(lines: Lines, count: int) -> None:
    if not 0 <= count <= _MOST_SATELLITES:
        raise lines.error(f"{count} satellites in one epoch are outside 0 to {_MOST_SATELLITES}")


def _read_field(lines: Lines, line: str, a: int) -> float:
    """Return the observation in a column; NaN where it is missing: blank or 0.0."""
    text = line[a : a + 14]
    if not text or text.isspace():
        return _NAN
    try:
        if abs(value := float(text)) < _INF and "_" not in text:
            return value or _NAN
    except ValueError:
        pass
    return lines.parse_number(line, a, a + 14, "an observation") or _NAN
