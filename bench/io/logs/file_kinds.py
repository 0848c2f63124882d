"""Recognize a file by its first bytes, so that a file that cannot be read is named for what it is.

The signatures come from the specifications of the formats: the preambles of GNSS receivers (UBX, RTCM 3, SBF,
OEM binary of NovAtel and Unicore), MAVLink frames after the time of a telemetry log, and the magic numbers of
archives, documents and pictures.
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

HEAD = 4096
"""Bytes of a file that are looked at."""
SBET_COLUMNS = 17
"""Doubles of a row of an SBET."""
_TO_RINEX = "convert it to RINEX, for example by convbin of RTKLIB, then: bench fixes OBS NAV"
_UNPACK = "unpack it first"
_FLY = 'it has no IMU; fly it: trajectory = "FILE" in a profile'
_TO_GPX = "it has fixes but no IMU; convert it to GPX to fly its track"
_AS_TABLE = "write a table of it: bench guide log-format"
_TITLES = "if they contain fixes, convert these to GPX to fly their track"
_RECEIVER = "put it beside a table of an IMU, or compute fixes from its ranges: bench fixes FILE"


NOVATEL, NOVATEL_BINARY = "a NovAtel ASCII log", "a NovAtel binary log"
GNSSLOGGER = "an Android GnssLogger file"
UBX, RINEX, NMEA = "a u-blox UBX recording", "a RINEX file", "a file of NMEA 0183 sentences"
RTCM, SBF = "a recording of RTCM 3 messages", "a Septentrio SBF recording"
SBET = "an SBET trajectory"
"""Names of the kinds for which bench has a reader."""


class FileKind(NamedTuple):
    """Name of a kind of file, and advice for its owner."""

    name: str
    advice: str


def _is_frame(head: bytes, starts: bytes) -> bool:
    """Return whether a MAVLink frame begins behind the time [us, 8 bytes] of a telemetry log."""
    return len(head) > 12 and head[8] in starts and 1e15 < int.from_bytes(head[:8], "big") < 4e15


def _is_rtcm(head: bytes) -> bool:
    """Return whether two RTCM 3 messages follow each other: preamble, six zero bits, length, 3 bytes CRC."""
    starts = {
        match.start(): int.from_bytes(match[0][1:]) for match in re.finditer(rb"(?s)\xd3[\0-\3].", head)
    }
    return any(at + 6 + length in starts for at, length in starts.items())


def _is_sbf(head: bytes) -> bool:
    """Return whether a file begins with an SBF block, or two follow each other: mark, CRC, number, length."""
    starts = {
        match.start(): int.from_bytes(match[1], "little") for match in re.finditer(rb"(?s)\$@.{4}(..)", head)
    }
    return head.startswith(b"$@") or any(length and at + length in starts for at, length in starts.items())


def _is_sbet(head: bytes) -> bool:
    """Return whether two rows are plausible: time of week [s], latitude, longitude [rad], height [m]."""
    if len(head) < 16 * SBET_COLUMNS:
        return False
    rows = struct.unpack(f"<{2 * SBET_COLUMNS}d", head[: 16 * SBET_COLUMNS])
    if not all(math.isfinite(one) for one in rows):
        return False
    (t, lat, lon, alt), (later, *_) = rows[:4], rows[SBET_COLUMNS : SBET_COLUMNS + 4]
    is_place = abs(lat) <= math.pi / 2 and abs(lon) <= math.pi and abs(alt) < 1e5
    return bool(0.0 <= t < 604800.0 and 1e-4 < later - t < 10.0 and is_place)


def _begins(*marks: bytes) -> Callable[[bytes], bool]:
    return lambda head: head.startswith(marks)


def _matches(pattern: bytes) -> Callable[[bytes], bool]:
    return lambda head: re.search(pattern, head) is not None


def is_hdf5(head: bytes) -> bool:
    """Return whether a file begins as HDF5, at once or behind 512 bytes of MATLAB.

    Examples
    --------
    >>> is_hdf5(b"MATLAB 7.3".ljust(512) + b"\\x89HDF\\r\\n\\x1a\\n")
    True
    """
    return b"\x89HDF\r\n\x1a\n" in (head[:8], head[512:520])


KINDS: Sequence[tuple[FileKind, Callable[[bytes], bool]]] = (
    (FileKind("a gzip archive", _UNPACK), _begins(b"\x1f\x8b")),
    (
        FileKind("an Office document", "save its table as CSV"),
        _matches(rb"(?s)\APK\x03\x04.{26}(?:\[Content_Types\]|_rels/|docProps/|xl/)"),
    ),
    (FileKind("a ZIP archive", _UNPACK), _begins(b"PK\x03\x04")),
    (FileKind("a 7-Zip archive", _UNPACK), _begins(b"7z\xbc\xaf\x27\x1c")),
    (FileKind("a bzip2 archive", _UNPACK), _begins(b"BZh")),
    (FileKind("an xz archive", _UNPACK), _begins(b"\xfd7zXZ\x00")),
    (FileKind("a PDF document", "export the data as CSV"), _begins(b"%PDF")),
    (FileKind("a picture", "export the data as CSV"), _begins(b"\x89PNG", b"\xff\xd8\xff", b"GIF8")),
    (FileKind("a video", "export its telemetry as CSV"), lambda head: head[4:8] == b"ftyp"),
    (
        FileKind("a MATLAB v7.3 (HDF5) file", "name it FILE.mat, then: bench new log FILE.mat"),
        is_hdf5,
    ),
    (
        FileKind("a Garmin FIT file", _TO_GPX),
        lambda head: head[8:12] == b".FIT",
    ),
    (FileKind("a Garmin TCX file", _TO_GPX), _matches(rb"<TrainingCenterDatabase\b")),
    (FileKind("a Racelogic VBO file", _TO_GPX), _matches(rb"(?m)^\[column names\]")),
    (FileKind("a file of subtitles (SRT)", _TITLES), _matches(rb"\A\s*\d+\s+\d\d:\d\d:\d\d,\d{3} --> ")),
    (
        FileKind(
            "an ArduPilot log converted to text", "use the .bin it was made from: bench new log FILE.bin"
        ),
        _matches(rb"\AFMT, *128, "),
    ),
    (
        FileKind("a text of rostopic echo", "use the bag it was made from: bench new log BAG"),
        _matches(rb"\Aheader: *\r?\n +(?:seq|stamp):"),
    ),
    (FileKind("a Gyroflow log", f"it has gyros but no fixes; {_AS_TABLE}"), _begins(b"GYROFLOW IMU LOG")),
    (
        FileKind(
            "a recording of VectorNav messages",
            "they have no times; write a table with times: bench guide log-format",
        ),
        _matches(rb"\A\$VN[A-Z]{3},"),
    ),
    # those of gpsd, {"class":..., may be above what a receiver sent
    (FileKind("a JSON file", _AS_TABLE), _matches(rb"\A\s*(?:\{\s*\"(?!class\")|\[\s*\{)")),
    (
        FileKind("a MAVLink telemetry log", "name it FILE.tlog, then: bench new log FILE.tlog"),
        lambda head: _is_frame(head, b"\xfe\xfd"),
    ),
    (
        FileKind(
            "a Betaflight or iNav blackbox",
            "decode it by blackbox_decode --unit-rotation deg/s --unit-acceleration m/s2 FILE, then: "
            "bench new log FILE.csv",
        ),
        _begins(b"H Product:Blackbox"),
    ),
    (FileKind(RTCM, "compute fixes from its ranges: bench fixes FILE"), _is_rtcm),
    (
        FileKind(UBX, _RECEIVER),
        _matches(rb"\A.{0,200}\xb5\x62[\x01\x02\x0a\x0d\x10\x21\x27]"),
    ),
    (FileKind(SBF, _RECEIVER), _is_sbf),
    (
        FileKind(
            NOVATEL_BINARY, "bench new log FILE; for fixes from its ranges, convert it to RINEX by convbin"
        ),
        _matches(rb"(?s)\A.{0,512}\xaa\x44(?:\x12\x1c|\x13)"),
    ),
    (FileKind("a Unicore binary recording", _TO_RINEX), _begins(b"\xaa\x44\xb5")),
    (
        FileKind(NOVATEL, "bench new log FILE"),
        _matches(rb"(?m)^[#%](?:RAWIMU|IMU|INS|BEST|RANGE|CORRIMU)\w*A,"),
    ),
    (
        FileKind(
            GNSSLOGGER,
            "bench new log FILE; with a navigation file its ranges give fixes: bench fixes FILE NAV",
        ),
        _matches(rb"(?m)^#\s*Raw,(?:ElapsedRealtimeMillis|utcTimeMillis)"),
    ),
    (FileKind(RINEX, "bench fixes OBS NAV computes its fixes"), _matches(rb"\A.{60}RINEX VERSION / TYPE")),
    (
        FileKind(NMEA, 'it has fixes but no IMU; name it in [gnss] or [reference] of a log: file = "FILE"'),
        _matches(rb"\A[^$\n]{0,80}\$(?:G[PNLABQI]|BD)[A-Z]{3}[A-Z0-9]{0,2},"),
    ),
    (
        FileKind("a GPX or KML track", _FLY),
        _matches(rb"<(?:gpx|kml)\b"),
    ),
    (FileKind("a motion definition of gnss-ins-sim", _FLY), _begins(b"ini lat (deg),ini lon (deg)")),
    (
        FileKind(
            "a YUMA almanac",
            'it has no ranges; simulate its satellites: almanac = "FILE" in [sky] of a GNSS datasheet',
        ),
        _matches(rb"\A\*+ Week \d+ almanac"),
    ),
    (
        FileKind(
            SBET, "it is a solution, not an IMU; name it in [reference] of a log, or: bench score FILE RUN"
        ),
        _is_sbet,
    ),
)
"""Kinds in the order in which they are tried, each with what recognizes its first bytes."""


def recognize(head: bytes) -> FileKind | None:
    """Return the kind of a file by its first bytes; None if it is none of `KINDS`."""
    return next((kind for kind, test in KINDS if test(head)), None)


def describe_unreadable(path: Path, otherwise: str = "") -> str:
    """Return the message of a file that cannot be read: what it is and what to do, or ``otherwise``.

    Examples
    --------
    >>> describe_unreadable(Path("none.bin"), "not a text file in UTF-8")
    'none.bin: not a text file in UTF-8'
    """
    try:
        with path.open("rb") as file:
            kind = recognize(file.read(HEAD))
    except OSError:
        kind = None
    if kind is None:
        return f"{path.name}: {otherwise}" if otherwise else ""
    return f"{path.name}: is {kind.name}; {kind.advice}"


def is_kind(name: str, path: Path) -> bool:
    """Return whether a file is of a kind, by its first bytes."""
    try:
        with path.open("rb") as file:
            kind = recognize(file.read(HEAD))
    except OSError:
        return False
    return kind is not None and kind.name == name
