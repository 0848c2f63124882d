"""Read the raw measurements of u-blox receivers, UBX-RXM-RAWX, as observations.

The layout of the message is that of the ROS package ublox_ubx_msgs; pyubx2 reads the same values.
One message of a fixed layout needs no package. NMEA, RTCM and other messages are passed over.
"""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.plugins.receiver.rinex.unpacking import BLOCK, UnpackingError, open_binary
from bench.simulation.signals.orbits import DAY, WEEK

_SYNC = b"\xb5\x62\x02\x15"
_HEAD, _ROW = 16, 32
_LONGEST = 6 + _HEAD + _ROW * 255 + 2  # of a message [byte]
_MOST_BYTES = 2_000_000_000
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
    BEIDOU: {0: (0, 2), 1: (0, 2), 2: (1, 7), 3: (1, 7)},
    GLONASS: {0: (0, 1), 2: (1, 2)},
}
_RANGE_VALID, _PHASE_VALID = 1, 2


def _read_messages(file: BinaryIO) -> Iterator[bytes | None]:
    """Yield the payload of each sound message, and None for each that is damaged."""
    content, at, more = b"", 0, True
    while more:
        block = file.read(BLOCK)
        content, at, more = content[at:] + block, 0, bool(block)
        while True:
            found = content.find(_SYNC, at)
            if found < 0:
                at = max(at, len(content) - len(_SYNC) + 1)
                break
            if more and len(content) - found < _LONGEST:
                at = found
                break
            length = int.from_bytes(content[found + 4 : found + 6], "little")
            end = found + 6 + length
            body = content[found + 2 : end]
            rows = content[found + 17] if found + 17 < len(content) else 0
            sound = len(content) >= end + 2 and length == _HEAD + _ROW * rows
            if sound and _sum(body) == content[end : end + 2]:
                yield body[4:]
                at = end + 2
            else:
                yield None
                at = found + 2


def _sum(body: bytes) -> bytes:
    """Return the Fletcher checksum of a message."""
    values = np.frombuffer(body, np.uint8).astype(np.int64)
    n = len(values)
    return bytes((int(values.sum()) & 0xFF, int((values * (n - np.arange(n))).sum()) & 0xFF))


class _UbxRows:
    """The epochs and observations read so far, in compact arrays."""

    def __init__(self) -> None:
        self.seconds, self.start = array("d"), array("q", [0])
        self.system, self.sat = array("q"), array("q")
        self.values = tuple(array("d") for _ in range(4))  # of two carriers: range, Doppler, C/N0, phase
        self.band, self.slipped = array("q"), array("b")  # of two carriers
        self.others: Counter[str] = Counter()
        self.early = 0  # epochs without a time
        self._locks: dict[tuple[int, int, int], int] = {}

    def add(self, message: bytes) -> None:
        """Take the observations of an epoch."""
        tow, week = np.frombuffer(message, "<f8", 1)[0], int.from_bytes(message[8:10], "little")
        if week == 0:  # a receiver that has no time yet
            self.early += 1
            return
        rows: dict[tuple[int, int], int] = {}
        for one in np.frombuffer(message, _FIELDS, offset=_HEAD):
            system = _SYSTEMS.get(int(one["system"]))
            if system is None:
                self.others[_OTHERS.get(int(one["system"]), "other systems")] += 1
                continue
            place = _BANDS[system].get(int(one["signal"]))
            if place is None or not one["status"] & _RANGE_VALID or one["sat"] == 255:
                continue
            key = (system, int(one["sat"]))
            if key not in rows:
                rows[key] = len(self.sat)
                self._begin_row(*key)
            (carrier, band), at = place, 2 * rows[key] + place[0]
            if self.band[at]:
                continue
            phase = one["phase"] if one["status"] & _PHASE_VALID else np.nan
            found = (one["range"], one["doppler"], one["cn0"] or np.nan, phase)
            for column, value in zip(self.values, found, strict=True):
                column[at] = value
            self.band[at] = band
            lock = int(one["lock"])
            self.slipped[at] = lock < self._locks.get((*key, carrier), 0) or lock == 0
            self._locks[(*key, carrier)] = lock
        self.seconds.append(WEEK * week + float(tow))
        self.start.append(len(self.sat))

    def _begin_row(self, system: int, sat: int) -> None:
        self.system.append(system)
        self.sat.append(sat)
        for column in self.values:
            column.extend((np.nan, np.nan))
        self.band.extend((0, 0))
        self.slipped.extend((0, 0))


def read_ubx(path: Path, shown: str | None = None) -> ObservationFile:
    """Read the observations in a UBX stream, packed or not.

    Raises
    ------
    ConfigError
        If it has no raw measurements.
    """
    shown = path.name if shown is None else shown
    rows, damaged = _UbxRows(), 0
    try:
        check_file(path, shown, _MOST_BYTES)
        with open_binary(path, shown) as file:
            for message in _read_messages(file):
                if message is None:
                    damaged += 1
                else:
                    rows.add(message)
    except UnpackingError as error:
        raise ConfigError(f"{shown}: {error}") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    early = f"{shown}: {rows.early} epochs before the receiver had the time"
    if not rows.seconds:
        text = early if rows.early else f"{shown}: has no raw measurements (UBX-RXM-RAWX) in it"
        raise ConfigError(text)
    t = np.frombuffer(rows.seconds)
    if (np.diff(t) <= 0).any():
        raise ConfigError(f"{shown}: the times of its measurements do not increase")
    if not rows.sat:
        raise ConfigError(f"{shown}: has no range of GPS, GLONASS, Galileo or BeiDou in it")
    origin = float(t[0] // DAY * DAY)
    pseudorange, doppler, cn0, phase = (np.frombuffer(one).reshape(-1, 2) for one in rows.values)
    return ObservationFile(
        shown=shown,
        marker="",
        origin=origin,
        t=t - origin,
        epoch_start=np.frombuffer(rows.start, np.int64),
        sat=np.frombuffer(rows.sat, np.int64),
        system=np.frombuffer(rows.system, np.int64),
        pseudorange=pseudorange,
        doppler=doppler,
        cn0=cn0,
        approximate_e=None,
        antenna_hen=np.zeros(3),
        moving=False,
        lost=damaged + rows.early,
        reasons=(
            *([f"{shown}: {damaged} messages with a wrong length or checksum"] if damaged else []),
            *([early] if rows.early else []),
        ),
        band=np.frombuffer(rows.band, np.int64).reshape(-1, 2),
        phase=phase,
        slipped=np.frombuffer(rows.slipped, np.bool_).reshape(-1, 2),
        others=rows.others,
    )
