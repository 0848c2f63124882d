"""Read the raw measurements of u-blox receivers, UBX-RXM-RAWX, as observations.

The layout of the message is that of the ROS package ublox_ubx_msgs; pyubx2 reads the same values.
One message of a fixed layout needs no package. NMEA, RTCM and other messages are passed over.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.exchange.rinex.observations import ObservationFile
from bench.exchange.rinex.unpacking import open_bytes
from bench.files import check_file
from bench.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.signals.orbits import DAY, WEEK

_SYNC = b"\xb5\x62\x02\x15"
_HEAD, _ROW = 16, 32
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


def _find_messages(content: bytes) -> tuple[list[bytes], int]:
    """Return the payloads of all sound messages, and how many are damaged."""
    found, damaged, at = [], 0, content.find(_SYNC)
    while at >= 0:
        length = int.from_bytes(content[at + 4 : at + 6], "little")
        end = at + 6 + length
        body = content[at + 2 : end]
        rows = content[at + 17] if at + 17 < len(content) else 0
        if len(content) >= end + 2 and length == _HEAD + _ROW * rows and _sum(body) == content[end : end + 2]:
            found.append(content[at + 6 : end])
            at = content.find(_SYNC, end + 2)
        else:
            damaged += 1
            at = content.find(_SYNC, at + 2)
    return found, damaged


def _sum(body: bytes) -> bytes:
    """Return the Fletcher checksum of a message."""
    values = np.frombuffer(body, np.uint8).astype(np.int64)
    n = len(values)
    return bytes((int(values.sum()) & 0xFF, int((values * (n - np.arange(n))).sum()) & 0xFF))


def read_ubx(path: Path, shown: str | None = None) -> ObservationFile:
    """Read the observations in a UBX stream, packed with gzip or not.

    Raises
    ------
    ConfigError
        If it has no raw measurements.
    """
    shown = path.name if shown is None else shown
    try:
        check_file(path, shown, _MOST_BYTES)
        messages, damaged = _find_messages(open_bytes(path, shown))
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    if not messages:
        raise ConfigError(f"{shown}: has no raw measurements (UBX-RXM-RAWX) in it")
    others: Counter[str] = Counter()
    seconds: list[float] = []
    starts, bands, slips = [0], list[list[int]](), list[list[bool]]()
    keys, values = list[tuple[int, int]](), list[FloatArray]()
    locks: dict[tuple[int, int, int], int] = {}
    for message in messages:
        tow, week = np.frombuffer(message, "<f8", 1)[0], int.from_bytes(message[8:10], "little")
        rows: dict[tuple[int, int], int] = {}
        for one in np.frombuffer(message, _FIELDS, offset=_HEAD):
            system = _SYSTEMS.get(int(one["system"]))
            if system is None:
                others[_OTHERS.get(int(one["system"]), "other systems")] += 1
                continue
            place = _BANDS[system].get(int(one["signal"]))
            if place is None or not one["status"] & _RANGE_VALID or one["sat"] == 255:
                continue
            key = (system, int(one["sat"]))
            if key not in rows:
                rows[key] = len(keys)
                keys.append(key)
                values.append(np.full((4, 2), np.nan))
                bands.append([0, 0])
                slips.append([False, False])
            k, (carrier, band) = rows[key], place
            if bands[k][carrier]:
                continue
            phase = one["phase"] if one["status"] & _PHASE_VALID else np.nan
            values[k][:, carrier] = one["range"], one["doppler"], one["cn0"] or np.nan, phase
            bands[k][carrier] = band
            lock = int(one["lock"])
            slips[k][carrier] = lock < locks.get((*key, carrier), 0) or lock == 0
            locks[(*key, carrier)] = lock
        seconds.append(WEEK * week + float(tow))
        starts.append(len(keys))
    t = np.array(seconds)
    if (np.diff(t) <= 0).any():
        raise ConfigError(f"{shown}: the times of its measurements do not increase")
    if not keys:
        raise ConfigError(f"{shown}: has no range of GPS, GLONASS, Galileo or BeiDou in it")
    origin = float(t[0] // DAY * DAY)
    table = np.array(values)
    return ObservationFile(
        shown=shown,
        marker="",
        origin=origin,
        t=t - origin,
        epoch_start=np.array(starts, np.int64),
        sat=np.array([sat for _, sat in keys], np.int64),
        system=np.array([system for system, _ in keys], np.int64),
        pseudorange=np.ascontiguousarray(table[:, 0]),
        doppler=np.ascontiguousarray(table[:, 1]),
        cn0=np.ascontiguousarray(table[:, 2]),
        approximate_e=None,
        antenna_hen=np.zeros(3),
        moving=False,
        lost=damaged,
        reasons=(f"{shown}: {damaged} messages with a wrong length or checksum",) if damaged else (),
        band=np.array(bands, np.int64),
        phase=np.ascontiguousarray(table[:, 3]),
        slipped=np.array(slips, np.bool_),
        others=others,
    )
