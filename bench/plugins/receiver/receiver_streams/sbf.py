"""Read SBF of Septentrio receivers: ranges (MeasEpoch), and what the receiver decoded of broadcast messages.

The layouts are those of the PolaRx5TR Reference Guide 5.5.0, chapter 4, as pysbf2
(github.com/semuconsulting/pysbf2) and RTKLIB (septentrio.c) list them, too. Other blocks are passed over.
"""

from __future__ import annotations

import re
import struct
from binascii import crc_hqx
from collections import Counter
from collections.abc import Iterator
from functools import cache
from math import isfinite, pi
from pathlib import Path

import numpy as np

from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.observation_rows import ObservationRows
from bench.plugins.receiver.receiver_streams.subframes import ANGLES, FNAV, MOSCOW, BroadcastParts
from bench.plugins.receiver.rinex.codes import CODES, OTHERS, SYSTEMS
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.plugins.receiver.rinex.unpacking import read_frames
from bench.simulation.signals.gps_time import leap_seconds, to_date
from bench.simulation.signals.orbits import WEEK, C, find_frequency

_SYNC = re.compile(rb"\$@")
_LONGEST = 0xFFFF  # of a block [byte]
_RANGES, _COMPACT_RANGES, _GPS_ION, _GALILEO_ION = 4027, 4109, 5893, 4030
_SATELLITES = {  # identifier -> letter of the system, number
    identifier: (letter, identifier - late)
    for letter, first, last, late in (
        ("G", 1, 37, 0), ("R", 38, 61, 37), ("R", 63, 68, 38), ("E", 71, 106, 70), ("S", 120, 140, 100),
        ("C", 141, 180, 140), ("J", 181, 187, 180), ("I", 191, 197, 190), ("S", 198, 215, 157),
        ("I", 216, 222, 208), ("C", 223, 245, 182),
    )
    for identifier in range(first, last + 1)
}  # fmt: skip
_SIGNALS = {
    0: "G1C", 1: "G1W", 2: "G2W", 3: "G2L", 4: "G5Q", 5: "G1L", 8: "R1C", 9: "R1P", 10: "R2P", 11: "R2C",
    12: "R3Q", 13: "C1P", 14: "C5P", 17: "E1C", 19: "E6C", 20: "E5Q", 21: "E7Q", 22: "E8Q", 28: "C2I",
    29: "C7I", 30: "C6I",
}  # fmt: skip
"""Number of a signal -> letter of the system and RINEX code."""
_PLACES = {
    signal: (carrier, codes.index(name[1:]))
    for signal, name in _SIGNALS.items()
    for carrier, codes in enumerate(CODES[name[0]])
    if name[1:] in codes
}
"""Number of a signal -> carrier and order of preference."""
_FIRST, _NEXT = struct.Struct("<xBBBIiHbBHBB"), struct.Struct("<BBBBbBHHH")
_FDMA, _SEMICODELESS = range(8, 12), (1, 2)  # signals with a channel, and those without 10 dB of their C/N0
_LONG = 254  # the longest time of lock of all signals [s]
_NO_TIME, _NO_WEEK, _NOTHING = 0xFFFFFFFF, 0xFFFF, -2e10
_MOST = 1e7  # of all fields in their units; the largest are those of the ionosphere
_DAMAGED, _EARLY = "damaged blocks", "epochs before the receiver set its clock"
_SCRAMBLED = "epochs with ranges that the receiver scrambled"
_KEPLER = (
    " t_oc af_2 af_1 af_0 c_rs delta_n mean_anomaly c_uc e c_us sqrt_a t_oe_week c_ic node_0 c_is i_0 c_rc"
    " perigee node_rate i_rate"
)
_KEPLER_FORM = "I5fdfdfdIfdfdfdff"
_NAVIGATION = {
    number: (system, struct.Struct(form), names.split())
    for number, system, form, names in (
        (5891, GPS, "<6xB4xBB7xf" + _KEPLER_FORM, "id ura health group_delay" + _KEPLER),
        (4081, BEIDOU, "<6xB3xBB4xff" + _KEPLER_FORM, "id ura sick group_delay group_delay_2" + _KEPLER),
        (4002, GALILEO, "<6xBB6d9fIIffd6xHxBBxff",
         "id source sqrt_a mean_anomaly e i_0 perigee node_0 node_rate i_rate delta_n c_uc c_us c_rc c_rs"
         " c_ic c_is t_oe_week t_oc af_2 af_1 af_0 states sisa_5a sisa_5b group_delay group_delay_2"),
        (4004, GLONASS, "<6xBB3d8f4xI5xB4xB",
         "id channel x y z vx vy vz ax ay az clock_rate clock t_oe sick unsure"),
        (_GPS_ION, GPS, "<6xBx8f", "id alpha_0 alpha_1 alpha_2 alpha_3 beta_0 beta_1 beta_2 beta_3"),
        (_GALILEO_ION, GALILEO, "<6xBx3f", "id a_0 a_1 a_2"),
    )
}  # fmt: skip
"""Number of a block -> its system, layout and fields."""
_FNAV_SOURCE = 16


def read_blocks(path: Path, shown: str) -> Iterator[tuple[int, bytes | None]]:
    """Yield number and body of each block of an SBF stream; None for a damaged part between two."""
    for frame in read_frames(path, shown, _SYNC, _LONGEST, _measure):
        yield (0, None) if frame is None else (int.from_bytes(frame[4:6], "little") & 0x1FFF, frame[8:])


def _measure(content: bytes, at: int) -> int:
    """Return where the block at a place ends; 0 if it has no time stamp, or a wrong length or CRC."""
    crc, length = (int.from_bytes(content[at + k : at + k + 2], "little") for k in (2, 6))
    end = at + length
    sound = length >= 16 and length % 4 == 0 and end <= len(content)
    return end if sound and crc_hqx(content[at + 4 : end], 0) == crc else 0


def find_time(body: bytes) -> float | None:
    """Return the time of a block [s since 1980-01-06]; None if the receiver has none yet."""
    tow, week = struct.unpack_from("<IH", body)
    return None if tow == _NO_TIME or week == _NO_WEEK else WEEK * week + 1e-3 * tow


def has_ranges(path: Path, shown: str) -> bool:
    """Return whether a stream has ranges, readable or not, or neither ranges nor ephemerides."""
    numbers = set[int]()
    for number, _ in read_blocks(path, shown):
        if number in (_RANGES, _COMPACT_RANGES):
            return True
        numbers.add(number)
    return not numbers & _NAVIGATION.keys()


@cache
def _find_frequency(signal: int, channel: int) -> float:
    name = _SIGNALS.get(signal, "G0")
    return float(find_frequency(*np.array([[SYSTEMS[name[0]]], [int(name[1])], [channel]]))[0])


def _join(high: int, low: int, least: int, unit: float) -> float:
    """Return a number of two parts; NaN for the least number, which means that the value is missing."""
    return np.nan if (high, low) == (least, 0) else unit * ((high << 16) + low)


class _SbfRows:
    """The observations so far, and since when their phases are counted."""

    def __init__(self) -> None:
        self.table = ObservationRows()
        self.lost: Counter[str] = Counter()
        self._locks: dict[tuple[int, int, int], tuple[int, int]] = {}

    def take(self, body: bytes) -> None:
        """Take the observations of an epoch."""
        time = find_time(body)
        count, size, size_next, flags = struct.unpack("4B", body[6:10] if len(body) >= 12 else b"\1\0\0\0")
        at, found = 12, list[tuple[tuple[int, ...], list[tuple[int, ...]]]]()
        for _ in range(count):
            first = _FIRST.unpack_from(body, at) if at + _FIRST.size <= len(body) else (0,)
            begin = at + size
            at = begin + size_next * first[-1]
            if size < _FIRST.size or (first[-1] and size_next < _NEXT.size) or at > len(body):
                self.lost[_DAMAGED] += 1
                return
            found.append((first, [_NEXT.unpack_from(body, k) for k in range(begin, at, size_next or 1)]))
        if time is None or flags >> 7:
            self.lost[_EARLY if time is None else _SCRAMBLED] += 1
            return
        for first, others in found:
            self._take_satellite(first, others)
        self.table.end_epoch(time)

    def _take_satellite(self, first: tuple[int, ...], others: list[tuple[int, ...]]) -> None:
        kind, identifier, high, low, rate, phase_low, phase_high, cn0, lock, info, _ = first
        letter, sat = _SATELLITES.get(identifier, ("", 0))
        if letter in OTHERS:
            self.table.others[OTHERS[letter]] += 1
        if letter not in SYSTEMS:
            return
        channel = (info >> 3) - 8 if kind & 31 in _FDMA else 0
        distance = 1e-3 * ((high & 15) << 32 | low) or np.nan
        doppler = np.nan if rate == -(2**31) else 1e-4 * rate
        signals = [(kind, distance, doppler, _join(phase_high, phase_low, -128, 1e-3), cn0, lock, info)]
        master = _find_frequency(kind & 31, channel)
        for kind, lock, cn0, high, phase_high, info, low, phase_low, rate in others:
            ratio = _find_frequency(kind & 31, channel) / master
            range_, phase = (high & 7 ^ 4) - 4, _join(phase_high, phase_low, -128, 1e-3)
            slow = doppler * ratio + _join((high >> 3 ^ 16) - 16, rate, -16, 1e-4)
            signals.append((kind, distance + _join(range_, low, -4, 1e-3), slow, phase, cn0, lock, info))
        for kind, distance, doppler, phase, cn0, lock, info in sorted(
            signals, key=lambda one: _PLACES.get(one[0], (2, 0))
        ):
            if kind not in _PLACES or _SIGNALS[kind][0] != letter or not isfinite(distance):
                continue  # another antenna has higher numbers
            key = (SYSTEMS[letter], sat, _PLACES[kind][0])
            strength = np.nan if cn0 == 255 else 0.25 * cn0 + 10.0 * (kind not in _SEMICODELESS)
            cycles = distance * _find_frequency(kind, channel) / C + phase
            before, lock = self._locks.get(key, (kind, 0)), min(lock, _LONG)
            slipped = bool(info & 4) or lock == 0 or kind != before[0] or lock < before[1]
            values = (distance, doppler, strength, cycles, np.nan)
            if self.table.put(*key, int(_SIGNALS[kind][1]), values, slipped):
                self._locks[key] = (kind, lock)


def read_sbf(path: Path, shown: str | None = None) -> ObservationFile:
    """Read the observations in an SBF stream, packed or not.

    Raises
    ------
    ConfigError
        If it has no ranges.
    """
    shown = path.name if shown is None else shown
    rows = _SbfRows()
    for number, body in read_blocks(path, shown):
        if body is None:
            rows.lost[_DAMAGED] += 1
        elif number == _RANGES:
            rows.take(body)
    reasons = tuple(f"{shown}: {count} {words}" for words, count in rows.lost.items())
    if not rows.table.seconds:
        text = f"{shown}: has no ranges (SBF MeasEpoch) in it; sbf2rin of Septentrio converts Meas3Ranges"
        raise ConfigError("; ".join([text, *reasons]))
    return rows.table.make_file(shown, rows.lost.total(), reasons)


def read_sbf_navigation(path: Path, shown: str | None = None) -> NavigationFile:
    """Read the ephemerides in an SBF stream.

    Raises
    ------
    ConfigError
        If it has none, or none with a time.
    """
    shown = path.name if shown is None else shown
    parts = BroadcastParts()
    for number, body in read_blocks(path, shown):
        if body is not None and number in _NAVIGATION and (time := find_time(body)) is not None:
            _take_navigation(parts, number, body, time)
    return parts.make_file(shown, "ephemeris (SBF GPSNav, GLONav, GALNav, BDSNav)")


def _take_navigation(parts: BroadcastParts, number: int, body: bytes, time: float) -> None:
    """Take the ephemeris or the ionosphere of a block, if it is whole."""
    system, layout, names = _NAVIGATION[number]
    values = layout.unpack_from(body) if len(body) >= layout.size else (np.nan,)
    letter, sat = _SATELLITES.get(int(values[0]) if isfinite(values[0]) else 0, ("", 0))
    if SYSTEMS.get(letter) != system or not all(abs(value) < _MOST or value == _NOTHING for value in values):
        return
    found = {
        name: (0.0 if value == _NOTHING else float(value)) * (pi if name in ANGLES else 1.0)
        for name, value in zip(names, values, strict=True)
    }
    if number in (_GPS_ION, _GALILEO_ION):
        page = {"page": 56.0} if number == _GPS_ION else {}
        parts.add((system, sat, -1), 4 if number == _GPS_ION else 5, found | page, time)
        return
    if system == GALILEO:
        of_5a = found["source"] == _FNAV_SOURCE
        state = int(found["states"]) >> (8 if of_5a else 0)  # a bit that it is known, one of E5a or E1, two
        found |= {"sisa": found["sisa_5a" if of_5a else "sisa_5b"], "sick": (state & 1) * (state >> 1 & 7)}
        parts.add_whole(FNAV if of_5a else GALILEO, sat, found, time)
        return
    if system == BEIDOU:
        found["t_oe_high"] = found["t_oe_week"]
    if system == GLONASS:
        found |= {axis: 1e3 * found[axis] for axis in names[2:11]}
        found |= {"channel": found["channel"] - 8.0, "clock": -found["clock"]}
        found["sick"] = int(found["sick"]) >> 2
        found["t_b"] = found["t_oe"] + MOSCOW - leap_seconds(to_date(time))
    parts.add_whole(system, sat, found, time)
