"""Read UBX of u-blox receivers: raw measurements (RXM-RAWX) and broadcast messages (RXM-SFRBX).

The layouts are those of the ROS package ublox_ubx_msgs and of the u-blox interface description UBX-18010854;
pyubx2 reads the same values. Messages of a fixed layout need no package. Others are passed over.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np

from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.observation_rows import ObservationRows
from bench.plugins.receiver.receiver_streams.subframes import D1, FDMA, INAV, LNAV, BroadcastParts, decode
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.plugins.receiver.rinex.unpacking import read_frames
from bench.simulation.signals.orbits import WEEK

_HEAD = 16
_LONGEST = 8 + _HEAD + 32 * 255  # of a message [byte]
_FIELDS = np.dtype(
    [("range", "<f8"), ("phase", "<f8"), ("doppler", "<f4"), ("system", "u1"), ("sat", "u1"),
     ("signal", "u1"), ("channel", "u1"), ("lock", "<u2"), ("cn0", "u1"), ("range_sd", "u1"),
     ("phase_sd", "u1"), ("doppler_sd", "u1"), ("status", "u1"), ("spare", "u1")]
)  # fmt: skip
_SYSTEMS = {0: GPS, 2: GALILEO, 3: BEIDOU, 6: GLONASS}
_OTHERS = {1: "SBAS", 5: "QZSS", 7: "NavIC"}
_BANDS = {  # signal identifier -> carrier (0 first, 1 second) and RINEX band digit
    GPS: {0: (0, 1), 3: (1, 2), 4: (1, 2)},
    GALILEO: {0: (0, 1), 1: (0, 1), 3: (1, 5), 4: (1, 5), 5: (1, 7), 6: (1, 7)},
    BEIDOU: {0: (0, 2), 1: (0, 2), 2: (1, 7), 3: (1, 7), 4: (1, 6), 10: (1, 6)},
    GLONASS: {0: (0, 1), 2: (1, 2)},
}
_RANGE_VALID, _PHASE_VALID = 1, 2
_MESSAGE_SIGNALS = {GPS: (0,), GLONASS: (0, 2), GALILEO: (1, 5), BEIDOU: (0, 4)}  # with LNAV, FDMA, I/NAV, D1
_WORDS = {GPS: 10, GLONASS: 4, GALILEO: 8, BEIDOU: 10}  # of them, at least
_PREAMBLE_GPS, _PREAMBLE_BEIDOU = 0x8B, 0b11100010010
_MOST_WAITING = 100_000  # broadcast messages before the receiver has the time


class FrameLayout(NamedTuple):
    """Length of a message: a head, and rows whose number is in a byte of the head."""

    head: int
    row: int = 0
    place: int = 0  # of the byte


RAWX, SFRBX = b"\x02\x15", b"\x02\x13"
LAYOUTS = {RAWX: FrameLayout(16, 32, 11), SFRBX: FrameLayout(8, 4, 4)}


def read_messages(
    path: Path, shown: str, layouts: Mapping[bytes, FrameLayout]
) -> Iterator[tuple[bytes, bytes | None]]:
    """Yield class and number of each message with one of the layouts, and its payload, None if damaged."""
    sync = re.compile(b"\xb5\x62(" + b"|".join(re.escape(kind) for kind in layouts) + b")", re.DOTALL)

    def measure(content: bytes, at: int) -> int:
        layout = layouts[content[at + 2 : at + 4]]
        length = int.from_bytes(content[at + 4 : at + 6], "little")
        end, place = at + 6 + length, at + 6 + layout.place
        rows = content[place] if layout.row and place < len(content) else 0
        sound = len(content) >= end + 2 and length == layout.head + layout.row * rows
        return end + 2 if sound and _sum(content[at + 2 : end]) == content[end : end + 2] else 0

    for frame in read_frames(path, shown, sync, _LONGEST, measure):
        yield (b"", None) if frame is None else (frame[2:4], frame[6:-2])


def _sum(body: bytes) -> bytes:
    """Return the Fletcher checksum of a message."""
    values = np.frombuffer(body, np.uint8).astype(np.int64)
    n = len(values)
    return bytes((int(values.sum()) & 0xFF, int((values * (n - np.arange(n))).sum()) & 0xFF))


def find_time(message: bytes) -> float | None:
    """Return the time of an RXM-RAWX [s since 1980-01-06]; None if the receiver has none yet."""
    tow, week = float(np.frombuffer(message, "<f8", 1)[0]), int.from_bytes(message[8:10], "little")
    return WEEK * week + tow if week and 0.0 <= tow < WEEK else None


class _UbxRows:
    """The observations so far, and since when their phases are counted."""

    def __init__(self) -> None:
        self.table = ObservationRows()
        self.early = 0  # epochs without a time
        self._locks: dict[tuple[int, int, int], int] = {}

    def add(self, message: bytes) -> None:
        """Take the observations of an epoch."""
        time = find_time(message)
        if time is None:
            self.early += 1
            return
        for one in np.frombuffer(message, _FIELDS, offset=_HEAD):
            system = _SYSTEMS.get(int(one["system"]))
            if system is None:
                self.table.others[_OTHERS.get(int(one["system"]), "other systems")] += 1
                continue
            place = _BANDS[system].get(int(one["signal"]))
            if place is None or not one["status"] & _RANGE_VALID or one["sat"] == 255:
                continue
            (carrier, band), lock = place, int(one["lock"])
            key = (system, int(one["sat"]), carrier)
            phase = one["phase"] if one["status"] & _PHASE_VALID else np.nan
            found = (one["range"], one["doppler"], one["cn0"] or np.nan, phase, np.nan)
            slipped = lock < self._locks.get(key, 0) or lock == 0
            if self.table.put(*key, band, found, slipped):
                self._locks[key] = lock
        self.table.end_epoch(time)


def read_ubx(path: Path, shown: str | None = None) -> ObservationFile:
    """Read the observations in a UBX stream, packed or not.

    Raises
    ------
    ConfigError
        If it has no raw measurements.
    """
    shown = path.name if shown is None else shown
    rows, damaged = _UbxRows(), 0
    for _, message in read_messages(path, shown, {RAWX: LAYOUTS[RAWX]}):
        if message is None:
            damaged += 1
        else:
            rows.add(message)
    early = f"{shown}: {rows.early} epochs before the receiver set its clock"
    if not rows.table.seconds:
        text = early if rows.early else f"{shown}: has no raw measurements (UBX-RXM-RAWX) in it"
        raise ConfigError(text)
    wrong = f"{shown}: {damaged} messages with a wrong length or checksum"
    reasons = [text for count, text in ((damaged, wrong), (rows.early, early)) if count]
    return rows.table.make_file(shown, damaged + rows.early, tuple(reasons))


def read_ubx_navigation(path: Path, shown: str | None = None) -> NavigationFile:
    """Read the ephemerides in a UBX stream, except those of geostationary satellites of BeiDou.

    Raises
    ------
    ConfigError
        If it has none, or no time.
    """
    shown = path.name if shown is None else shown
    near, found, waiting, ranges = None, BroadcastParts(), list[bytes](), False
    for kind, message in read_messages(path, shown, LAYOUTS):
        if message is None:
            continue
        ranges = ranges or kind == RAWX
        if kind == SFRBX:
            waiting.append(message)
        elif (time := find_time(message)) is not None:
            near = time
        if near is not None or len(waiting) > _MOST_WAITING:
            for one in waiting if near is not None else ():
                _take_subframe(found, one, near or 0.0)
            waiting.clear()
    both = ", and no raw measurements (UBX-RXM-RAWX); let the receiver write both"
    return found.make_file(shown, "whole ephemeris (UBX-RXM-SFRBX)", "" if ranges else both)


def _take_subframe(found: BroadcastParts, message: bytes, near: float) -> None:
    """Take the words of an RXM-SFRBX, if they are of a message that is read."""
    system, sat, signal, channel = _SYSTEMS.get(message[0]), message[1], message[2], message[3] - 7
    words = [int(word) for word in np.frombuffer(message, "<u4", offset=8)]
    if system is None or sat == 255 or signal not in _MESSAGE_SIGNALS[system] or len(words) < _WORDS[system]:
        return
    source = (system, sat, signal)
    if system == GPS:
        bits = _join_words(words[:10], 24, 6)
        number, preamble = bits >> 194 & 7, bits >> 232
        if preamble == _PREAMBLE_GPS and number in LNAV:
            found.add(source, number, decode(bits, 192, LNAV[number]), near)
    elif system == GALILEO:
        if words[0] >> 30 or words[4] >> 30 != 2:  # even and odd part of a nominal page
            return
        bits = (words[0] & (1 << 30) - 1) << 98 | words[1] << 66 | words[2] << 34
        bits |= (words[3] >> 14) << 16 | words[4] >> 14 & 0xFFFF
        if (number := bits >> 122) in INAV:
            found.add(source, number, decode(bits, 122, INAV[number]), near)
    elif system == BEIDOU:
        bits = (words[0] >> 4 & (1 << 26) - 1) << 198 | _join_words(words[1:10], 22, 8)
        if bits >> 213 == _PREAMBLE_BEIDOU and (number := bits >> 206 & 7) in D1:
            found.add(source, number, decode(bits, 186, D1[number]), near)
    else:
        bits = _join_words(words[:3], 32, 0)
        if not bits >> 95 and (number := bits >> 91) in FDMA:
            fields = decode(bits, 91, FDMA[number], magnitude=True)
            found.add(source, number, fields | {"channel": channel}, near)


def _join_words(words: list[int], width: int, parity: int) -> int:
    """Return the data bits of words, first word first."""
    bits = 0
    for word in words:
        bits = bits << width | word >> parity & (1 << width) - 1
    return bits
