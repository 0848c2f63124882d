"""Frames of RTCM 3, and the broadcast ephemerides in them: messages 1019, 1020, 1042, 1045 and 1046.

The fields are those of RTCM 10403.3 as pyrtcm (github.com/semuconsulting/pyrtcm) and RTKLIB (rtcm3.c) list
them. They are read here because pyrtcm takes 1.3 ms for an MSM7 of 30 signals.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import date, timedelta
from functools import cache
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import IntArray
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.plugins.receiver.receiver_streams.subframes import FDMA, FNAV, BroadcastParts, Fields, decode
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE
from bench.plugins.receiver.rinex.unpacking import read_frames
from bench.simulation.signals.gps_time import EPOCH, gps_seconds
from bench.simulation.signals.orbits import DAY, WEEK

_SYNC = re.compile(rb"\xd3[\x00-\x03]")
_LONGEST = 3 + 1023 + 3  # of a frame [byte]
_CRC_24Q = 0x864CFB


def _list_shape(bits: int) -> Fields:
    """Return the fields of Galileo and BeiDou from c_rs to c_is; their harmonic terms have so many bits."""
    of_radius, of_angle = (2**-6, 2**-31) if bits == 18 else (2**-5, 2**-29)
    t_oe = ("t_oe_high", 17, 8) if bits == 18 else ("t_oe_week", 14, 60)
    return [
        ("c_rs", -bits, of_radius), ("delta_n", -16, 2**-43), ("mean_anomaly", -32, 2**-31),
        ("c_uc", -bits, of_angle), ("e", 32, 2**-33), ("c_us", -bits, of_angle), ("sqrt_a", 32, 2**-19), t_oe,
        ("c_ic", -bits, of_angle), ("node_0", -32, 2**-31), ("c_is", -bits, of_angle), ("i_0", -32, 2**-31),
        ("c_rc", -bits, of_radius), ("perigee", -32, 2**-31), ("node_rate", -24, 2**-43),
    ]  # fmt: skip


_GALILEO: Fields = [
    ("", 12, 1), ("sat", 6, 1), ("week", 12, 1), ("issue", 10, 1), ("sisa", 8, 1), ("i_rate", -14, 2**-43),
    ("t_oc", 14, 60), ("af_2", -6, 2**-59), ("af_1", -21, 2**-46), ("af_0", -31, 2**-34), *_list_shape(16),
    ("group_delay", -10, 2**-32),
]  # fmt: skip
MESSAGES: dict[int, tuple[int, Fields]] = {
    1019: (GPS, [
        ("", 12, 1), ("sat", 6, 1), ("week", 10, 1), ("ura", 4, 1), ("", 2, 1), ("i_rate", -14, 2**-43),
        ("issue", 8, 1), ("t_oc", 16, 16), ("af_2", -8, 2**-55), ("af_1", -16, 2**-43), ("af_0", -22, 2**-31),
        ("", 10, 1), ("c_rs", -16, 2**-5), ("delta_n", -16, 2**-43), ("mean_anomaly", -32, 2**-31),
        ("c_uc", -16, 2**-29), ("e", 32, 2**-33), ("c_us", -16, 2**-29), ("sqrt_a", 32, 2**-19),
        ("t_oe_week", 16, 16), ("c_ic", -16, 2**-29), ("node_0", -32, 2**-31), ("c_is", -16, 2**-29),
        ("i_0", -32, 2**-31), ("c_rc", -16, 2**-5), ("perigee", -32, 2**-31), ("node_rate", -24, 2**-43),
        ("group_delay", -8, 2**-31), ("health", 6, 1), ("", 2, 1),
    ]),
    1020: (GLONASS, [
        ("", 12, 1), ("sat", 6, 1), ("channel", 5, 1), ("", 16, 1), ("sick", 1, 1), ("", 1, 1),
        ("t_b", 7, 900), *(FDMA[k][at] for k in (1, 2, 3) for at in (-3, -1, -2)), ("", 1, 1),
        ("clock_rate", -11, 2**-40), ("", 2, 1), ("unsure", 1, 1), ("clock", -22, -(2**-30)), ("", 15, 1),
        ("day", 11, 1), ("type", 2, 1), ("", 44, 1), ("years", 5, 1), ("", 30, 1),
    ]),
    1042: (BEIDOU, [
        ("", 12, 1), ("sat", 6, 1), ("week", 13, 1), ("ura", 4, 1), ("i_rate", -14, 2**-43), ("", 5, 1),
        ("t_oc", 17, 8), ("af_2", -11, 2**-66), ("af_1", -22, 2**-50), ("af_0", -24, 2**-33), ("", 5, 1),
        *_list_shape(18), ("group_delay", -10, 1e-10), ("group_delay_2", -10, 1e-10), ("sick", 1, 1),
    ]),
    1045: (GALILEO, [*_GALILEO, ("sick", 2, 1), ("unsure", 1, 1), ("", 7, 1)]),
    1046: (GALILEO, [
        *_GALILEO, ("group_delay_2", -10, 2**-32), ("", 3, 1), ("sick", 2, 1), ("unsure", 1, 1), ("", 2, 1)
    ]),
}  # fmt: skip
"""Number of a message -> its system and fields."""
_WEEKS = {GPS: (1024, 0, 0.0), GALILEO: (4096, 1024, 0.0), BEIDOU: (8192, 1356, BEIDOU_LATE)}
"""Weeks after which their number begins anew, GPS week of week 0, GPS time minus time of the system [s]."""


def read_messages(path: Path, shown: str) -> Iterator[tuple[int, bytes | None]]:
    """Yield number and payload of each message of an RTCM 3 stream; None for a damaged part between two."""
    for frame in read_frames(path, shown, _SYNC, _LONGEST, _measure):
        yield (0, None) if frame is None else (int.from_bytes(frame[3:5]) >> 4, frame[3:-3])


@cache
def _tabulate_crc() -> IntArray:
    """Return the CRC-24Q (1029, 256) of each byte with 0 to 1028 zero bytes behind it."""
    first = np.arange(256) << 16
    for _ in range(8):
        first = (first << 1 & 0xFFFFFF) ^ np.where(first >> 23, _CRC_24Q, 0)
    rows = [first]
    while len(rows) < _LONGEST:
        rows.append((rows[-1] << 8 & 0xFFFFFF) ^ first[rows[-1] >> 16])
    return np.array(rows)


def _measure(content: bytes, at: int) -> int:
    """Return where the frame at a place ends; 0 if it has no message number or a wrong CRC."""
    length = 6 + int.from_bytes(content[at + 1 : at + 3])
    frame = np.frombuffer(content[at : at + length], np.uint8)
    if len(frame) < max(length, 8):
        return 0
    crc = np.bitwise_xor.reduce(_tabulate_crc()[np.arange(len(frame) - 1, -1, -1), frame])
    return 0 if crc else at + len(frame)


def decode_ephemeris(number: int, payload: bytes) -> dict[str, float] | None:
    """Return the fields of an ephemeris message; None if it is too short."""
    system, fields = MESSAGES[number]
    if 8 * len(payload) < sum(abs(count) for _, count, _ in fields):
        return None
    found = decode(int.from_bytes(payload, "big"), 8 * len(payload), fields, magnitude=system == GLONASS)
    if system == GLONASS:
        found["channel"] -= 7.0
    return found


def find_time(number: int, found: dict[str, float], near: float | None) -> float | None:
    """Return a time near that of an ephemeris [s since 1980-01-06]; None if it has no date.

    A week of GPS modulo 1024 is the one next to ``near``, else the last one that is not in the future.
    """
    system = MESSAGES[number][0]
    if system == GLONASS:
        if not (found["type"] and 1 <= found["day"] <= 1461 and found["years"]):
            return near
        day = date(1992 + 4 * int(found["years"]), 1, 1) + timedelta(days=found["day"] - 1)
        return gps_seconds(day.year, day.month, day.day, found["t_b"])
    turn, first, late = _WEEKS[system]
    week = found["week"] + first
    if near is not None:
        week += turn * round((near / WEEK - week) / turn)
    elif system == GPS:
        week += turn * (((date.today() - EPOCH).days * DAY / WEEK - week) // turn)
    return float(week * WEEK + found.get("t_oe_week", found.get("t_oe_high", 0.0)) + late)


def find_date(path: Path, shown: str, near: float | None) -> float | None:
    """Return the time of an ephemeris in a stream [s since 1980-01-06], preferably one with a whole week."""
    unsure = None
    for number, payload in read_messages(path, shown):
        if number not in MESSAGES or payload is None or (found := decode_ephemeris(number, payload)) is None:
            continue
        time = find_time(number, found, near)
        if time is not None and (near is not None or number != 1019):
            return time
        unsure = unsure or time
    return unsure


def read_rtcm_navigation(path: Path, shown: str | None = None) -> NavigationFile:
    """Read the ephemerides in an RTCM 3 stream.

    Raises
    ------
    ConfigError
        If it has none, or none with a date.
    """
    shown = path.name if shown is None else shown
    near, parts = find_date(path, shown, None), BroadcastParts()
    for number, payload in read_messages(path, shown) if near is not None else ():
        if number not in MESSAGES or payload is None or (found := decode_ephemeris(number, payload)) is None:
            continue
        system = MESSAGES[number][0]
        if time := find_time(number, found, near):
            parts.add_whole(FNAV if number == 1045 else system, int(found["sat"]), found, time)
    return parts.make_file(shown, "ephemeris with a date (RTCM 1019, 1020, 1042, 1045, 1046)")
