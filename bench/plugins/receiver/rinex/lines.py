"""Read the numbered lines of RINEX files, and the numbers and times in them."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import GNSSLOGGER, HEAD, NMEA, RINEX, RTCM, SBF, UBX, recognize
from bench.plugins.receiver.rinex.compact import LONGEST, CompactText
from bench.plugins.receiver.rinex.unpacking import MOST_BYTES, UnpackingError, open_text
from bench.simulation.signals.gps_time import gps_seconds

_READ = {UBX: "ubx", RINEX: "", RTCM: "rtcm", SBF: "sbf", GNSSLOGGER: "gnsslogger"}  # kinds of `recognize`
_LOOKED_AT = 65536  # characters: UBX may follow the messages of a program that recorded it
_MOST_REASONS = 20
BEIDOU_LATE = 14.0  # GPS time minus BeiDou time [s], RINEX 3.05, 4.1.4
_NO_LETTER = re.compile(r"([+-]?\d*\.\d*)([+-]\d+)")  # 0.499063314480-269


class Lines:
    """The lines of a file; errors name the number of the current line."""

    def __init__(self, file: TextIO | CompactText, shown: str) -> None:
        self._file, self.shown = file, shown
        self._again: str | None = None
        self.number = 0
        self.lost = 0
        """Number of parts of the file that are left out."""
        self.reasons: list[str] = []
        """Why the first of them are left out."""

    def read_packed(self) -> str | None:
        """Return the first line; if it is the header of Compact RINEX, unpack the file from then on."""
        line = self.read_line()
        if line is not None and line[60:72] == "CRINEX VERS " and not isinstance(self._file, CompactText):
            self._file = CompactText(self._file, self.shown, line)
            line = self.read_line()
        return line

    def count_lost(self) -> tuple[int, tuple[str, ...]]:
        """Return how many parts of the file are left out or cannot be restored, and why the first are."""
        if isinstance(self._file, CompactText):
            return self.lost + self._file.lost, (*self.reasons, *self._file.reasons)
        return self.lost, tuple(self.reasons)

    def read_line(self) -> str | None:
        """Return the next line without its end, None at the end of the file."""
        if self._again is not None:
            line, self._again = self._again, None
            self.number += 1
            return line
        line = self._file.readline(LONGEST + 1)
        if not line:
            return None
        self.number += 1
        if len(line) > LONGEST:
            while line and not line.endswith("\n"):
                line = self._file.readline(LONGEST)
            raise self.error(f"is longer than {LONGEST} characters: not a RINEX file")
        if "\0" in line:
            raise self.error("has a zero byte: not a text file")
        return line.rstrip("\r\n")

    def read_line_of(self, content: str) -> str:
        """Return the next line; raise ConfigError if the file ends before ``content``."""
        line = self.read_line()
        if line is None:
            raise self.error(f"the file ends before {content}")
        return line

    def put_back(self, line: str) -> None:
        """Put the last line back, so that it is read again."""
        self._again = line
        self.number -= 1

    def skip_to(self, head: re.Pattern[str]) -> None:
        """Skip the lines before the next matching line, or to the end of the file."""
        while True:
            try:
                line = self.read_line()
            except ConfigError:
                continue
            if line is not None and head.match(line):
                self.put_back(line)
            if line is None or head.match(line):
                return

    def report(self, error: ConfigError) -> None:
        """Count a part of the file that is left out, and keep why."""
        self.lost += 1
        if len(self.reasons) < _MOST_REASONS:
            self.reasons.append(error.messages[0])

    def describe_nothing(self, part: str) -> ConfigError:
        """Return the error for a file without any whole part, such as an epoch."""
        _, reasons = self.count_lost()
        if not reasons:
            return ConfigError(f"{self.shown}: has no {part} in it")
        reason = reasons[0].removeprefix(f"{self.shown}: ")
        return ConfigError(f"{self.shown}: has no {part} that can be read; {reason}")

    def error(self, message: str, number: int | None = None) -> ConfigError:
        """Return a ConfigError that names a line, by default the current one."""
        return ConfigError(f"{self.shown}: line {number or self.number}: {message}")

    def parse_number(self, line: str, start: int, end: int, what: str) -> float:
        """Return the number in columns start to end (from 0, without end)."""
        value = parse_fortran(line[start:end])
        if value is None:
            text = line[start:end].strip()
            raise self.error(f"{what} must be a number; got {text[:30]!r} in columns {start + 1}-{end}")
        return value

    def parse_whole(self, line: str, start: int, end: int, what: str) -> int:
        """Return the whole number in columns start to end (from 0, without end)."""
        text = line[start:end].strip()
        if not re.fullmatch(r"[+-]?\d+", text):
            raise self.error(f"{what} must be a whole number; got {text[:30]!r} in columns {start + 1}-{end}")
        return int(text)


def parse_fortran(text: str) -> float | None:
    """Parse a Fortran number: exponent with D, d, E, e or without a letter; None if it is not one."""
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
def open_lines(path: Path, shown: str) -> Iterator[Lines]:
    """Open a text file and provide its lines; raise ConfigError if it cannot be opened, or is too large."""
    try:
        check_file(path, shown, MOST_BYTES)
        with open_text(path, shown) as file:
            yield Lines(file, shown)
    except UnpackingError as error:
        raise ConfigError(f"{shown}: {error}") from None
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except IsADirectoryError:
        raise ConfigError(f"{shown}: is a folder, not a file") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror}") from None


def find_kind(path: Path, shown: str) -> str:
    """Return the kind of a file: "observations", "navigation", "sp3", "ubx", "rtcm", "sbf" or "gnsslogger".

    Raises
    ------
    ConfigError
        If it is none of these, or cannot be read.
    """
    with open_lines(path, shown) as lines:
        with open_text(path, shown) as file:
            first = file.read(_LOOKED_AT).encode("latin-1")
        foreign = recognize(first[:HEAD])
        if foreign and foreign.name not in _READ and not (foreign.name == NMEA and b"\xb5b" in first):
            raise ConfigError(f"{shown}: is {foreign.name}; {foreign.advice}")
        if foreign and foreign.name in (RTCM, SBF, GNSSLOGGER):
            return _READ[foreign.name]
        if b"\xb5b" in first and not re.search(rb"RINEX VERS|^#", first[:80]):
            return "ubx"
        if first[:1] == b"#" and first[1:2].isalpha():
            return "sp3"
        if (line := lines.read_packed()) is None:
            raise ConfigError(f"{shown}: is empty")
        kinds = {"O": "observations", "N": "navigation", "G": "navigation", "L": "navigation"}
        kind = kinds.get(line[20:21].upper()) if line[60:80].strip() == "RINEX VERSION / TYPE" else None
        if kind is None:
            raise ConfigError(f"{shown}: unknown format. Supported: RINEX, SP3, UBX, RTCM 3, SBF, GnssLogger")
        return kind


def check_version(lines: Lines, wanted: str) -> tuple[float, str]:
    """Check the first line; return the version, and the letters of file type and system."""
    first = lines.read_packed()
    if first is None:
        raise ConfigError(f"{lines.shown}: is empty")
    label = first[60:80].strip()
    if label != "RINEX VERSION / TYPE":
        raise lines.error("'RINEX VERSION / TYPE' is not in columns 61-80: not a RINEX file")
    version = lines.parse_number(first, 0, 9, "the version")
    if int(version) not in (2, 3, 4):
        raise lines.error(f"version {version:g} must be 2, 3 or 4")
    kind = first[20:21].upper()
    kinds = {"O": "an observation file"} | dict.fromkeys("NGL", "a navigation file")
    if kinds.get(kind) != wanted:
        raise lines.error(f"is {kinds.get(kind, f'of type {kind!r}')}, not {wanted}")
    return version, kind + first[40:41].upper()


def read_calendar(
    lines: Lines, line: str, columns: Sequence[tuple[int, int]], two_digits: bool
) -> tuple[float, float]:
    """Return the calendar time in a line: midnight since 1980-01-06 and second of the day [s]."""
    names = ("year", "month", "day", "hour", "minute")
    numbers = [
        lines.parse_whole(line, *place, f"the {name}") for name, place in zip(names, columns[:5], strict=True)
    ]
    second = lines.parse_number(line, *columns[5], "the second")
    year, month, day, hour, minute = numbers
    if two_digits and year < 100:
        year += 1900 if year >= 80 else 2000
    try:
        midnight = gps_seconds(year, month, day)
    except ValueError as error:
        raise lines.error(f"{year}-{month}-{day} is not a date: {error}") from None
    if not (0 <= hour < 24 and 0 <= minute < 60 and 0 <= second < 61):
        raise lines.error(f"{hour}:{minute}:{second:g} is not a time of day")
    return midnight, 3600.0 * hour + 60.0 * minute + second
