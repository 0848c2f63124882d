"""Read the observations in a stream of RTCM 3: MSM4 to MSM7 of four systems, and 1002, 1004, 1010 and 1012.

The fields are those of RTCM 10403.3 as pyrtcm (github.com/semuconsulting/pyrtcm) and RTKLIB (rtcm3.c) list
them. Messages contain the time of the week or of the day; an ephemeris gives the date. Of several stations
the first one is read. A half-cycle ambiguity counts as a cycle slip.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.observation_rows import ObservationRows
from bench.plugins.receiver.receiver_streams.rtcm_ephemerides import (
    decode_ephemeris,
    find_date,
    read_messages,
)
from bench.plugins.receiver.receiver_streams.subframes import MOSCOW, Fields, decode
from bench.plugins.receiver.rinex.codes import CODES
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.simulation.signals.gps_time import leap_seconds, to_date
from bench.simulation.signals.orbits import DAY, WEEK, C, find_frequency

_SIGNALS = {  # bit of the signal mask -> RINEX code
    GPS: {2: "1C", 3: "1P", 4: "1W", 8: "2C", 9: "2P", 10: "2W", 15: "2S", 16: "2L", 17: "2X", 30: "1S",
          31: "1L", 32: "1X"},
    GLONASS: {2: "1C", 3: "1P", 8: "2C", 9: "2P"},
    GALILEO: {2: "1C", 4: "1B", 5: "1X", 14: "7I", 15: "7Q", 16: "7X", 22: "5I", 23: "5Q", 24: "5X"},
    BEIDOU: {2: "2I", 3: "2Q", 4: "2X", 8: "6I", 9: "6Q", 10: "6X", 14: "7I", 15: "7Q", 16: "7X"},
}  # fmt: skip
_PLACES = {
    system: {
        bit: (carrier, order[carrier].index(code), int(code[0]))
        for bit, code in signals.items()
        for carrier in range(2)
        if code in order[carrier]
    }
    for (system, signals), order in zip(_SIGNALS.items(), (CODES[letter] for letter in "GREC"), strict=True)
}
"""System -> bit of the signal mask -> carrier, order of preference, and RINEX band digit."""
_MSM = {107: GPS, 108: GLONASS, 109: GALILEO, 112: BEIDOU}
_OTHERS = {110: "SBAS", 111: "QZSS", 113: "NavIC"}
_CHANNELS = 1020
_PLACES_OF = (1005, 1006)
_HEAD: Fields = [("", 12, 1), ("station", 12, 1)]
_TIME, _TIME_MSM, _TIME_LEGACY = (
    [*_HEAD, *fields]
    for fields in ([("second", 30, 1e-3)], [("", 3, 1), ("second", 27, 1e-3)], [("second", 27, 1e-3)])
)
_PLACE: Fields = [
    *_HEAD,
    ("", 10, 1),
    ("x", -38, 1e-4),
    ("", 2, 1),
    ("y", -38, 1e-4),
    ("", 2, 1),
    ("z", -38, 1e-4),
]
_MASKS, _CELLS, _MOST_CELLS = 73, 169, 64  # first bits of the masks; by the standard
_MILLISECOND = 1e-3 * C  # [m]
_UNKNOWN = 99  # channel of GLONASS
_COARSE, _FINE = (15, 22, 4, 6), (20, 24, 10, 10)  # bits of range, phase, lock time, C/N0
_STEP = {15: 2.0**-24, 20: 2.0**-29, 22: 2.0**-29, 24: 2.0**-31, 6: 1.0, 10: 2.0**-4}  # [ms], [dB-Hz]
_FIRST: Fields = [("sat", 6, 1), ("", 1, 1), ("range", 24, 0.02), ("phase", -20, 0.0005), ("lock", 7, 1),
                  ("turns", 8, _MILLISECOND), ("cn0", 8, 0.25)]  # fmt: skip
_GLONASS: Fields = [("sat", 6, 1), ("", 1, 1), ("channel", 5, 1), ("range", 25, 0.02), ("phase", -20, 0.0005),
                    ("lock", 7, 1), ("turns", 7, 2.0 * _MILLISECOND), ("cn0", 8, 0.25)]  # fmt: skip
_SECOND: Fields = [("", 2, 1), ("range_2", -14, 0.02), ("phase_2", -20, 0.0005), ("lock_2", 7, 1),
                   ("cn0_2", 8, 0.25)]  # fmt: skip
_LEGACY = {1002: _FIRST, 1004: [*_FIRST, *_SECOND], 1010: _GLONASS, 1012: [*_GLONASS, *_SECOND]}
_NO_PHASE, _NO_RANGE = -(2**19) * 0.0005, -(2**13) * 0.02
_ROLL = 1500.0  # cycles after which the phase relative to the range begins anew
_SAME = 5e-4  # messages so near to each other are of one epoch [s]
_RADIUS, _FAR = 6.37e6, 1e5  # of the Earth, and how far a station may be from it [m]; some send zeros
_MOST_SATELLITE = 37  # of GPS in the legacy messages; SBAS follows


def _is_observation(number: int) -> bool:
    return number in _LEGACY or (number // 10 in _MSM and 4 <= number % 10 <= 7)


def has_observations(path: Path, shown: str) -> bool:
    """Return whether a stream has ranges, not ephemerides alone."""
    return any(_is_observation(number) for number, _ in read_messages(path, shown))


def read_rtcm(path: Path, shown: str | None = None, near: float | None = None) -> ObservationFile:
    """Read the observations in an RTCM 3 stream, packed or not.

    ``near`` is the time of other files, for one without an ephemeris [s since 1980-01-06].

    Raises
    ------
    ConfigError
        If it has no date, or no observation.
    """
    shown = path.name if shown is None else shown
    date = find_date(path, shown, near)
    if (date := near if date is None else date) is None:
        raise ConfigError(
            f"{shown}: RTCM 3 has no date, and this file has no ephemeris, which would give it; "
            f"give the navigation file of the day, too: bench fixes {shown} NAV"
        )
    rows = _RtcmRows(date)
    for number, payload in read_messages(path, shown):
        rows.take(number, payload)
    rows.end()
    if not rows.table.seconds:
        raise ConfigError(f"{shown}: has no ranges (RTCM MSM4 to MSM7, 1002, 1004, 1010, 1012) in it")
    counts = {
        "damaged messages": rows.damaged,
        "messages out of order in time": rows.late,
        f"messages of other stations than {rows.station}": rows.foreign,
    }
    reasons = tuple(f"{shown}: {count} {words}" for words, count in counts.items() if count)
    return replace(rows.table.make_file(shown, sum(counts.values()), reasons), approximate_e=rows.place)


class _RtcmRows:
    """The observations so far, and what later messages need of earlier ones."""

    def __init__(self, near: float) -> None:
        self.table = ObservationRows()
        self.damaged = self.late = self.foreign = 0
        self.station: int | None = None
        self.place: FloatArray | None = None
        self._near, self._time, self._open = near, -np.inf, False
        self._channels: dict[int, int] = {}
        self._locks: dict[tuple[int, int, int], int] = {}
        self._phases: dict[tuple[int, int, int], float] = {}

    def take(self, number: int, payload: bytes | None) -> None:
        """Take a message."""
        system = _MSM.get(number // 10, GLONASS if number in (1010, 1012) else GPS)
        if payload is None:
            self.damaged += 1
        elif number == _CHANNELS:
            if found := decode_ephemeris(number, payload):
                self._channels[int(found["sat"])] = int(found["channel"])
        elif number // 10 in _OTHERS:
            self.table.others[_OTHERS[number // 10]] += 1
        elif _is_observation(number) or number in _PLACES_OF:
            late = [_TIME_LEGACY if number in _LEGACY else _TIME_MSM, _TIME][system != GLONASS]
            head = _decode(payload, 0, _PLACE if number in _PLACES_OF else late)
            if head is None:
                self.damaged += 1
                return
            self.station = int(head["station"]) if self.station is None else self.station
            if head["station"] != self.station:
                self.foreign += 1
            elif number in _PLACES_OF:
                place = np.array([head[axis] for axis in "xyz"])
                if self.place is None and abs(np.linalg.norm(place) - _RADIUS) < _FAR:
                    self.place = place
            elif self._begin(system, head["second"]):
                takes = self._take_legacy if number in _LEGACY else self._take_msm
                self.damaged += not takes(system, number, payload)

    def end(self) -> None:
        """End the epoch, if there is one."""
        if self._open:
            self.table.end_epoch(self._time)
        self._open = False

    def _begin(self, system: int, second: float) -> bool:
        """Begin the epoch of a message if it is new; return False if it is earlier than an epoch before."""
        period = DAY if system == GLONASS else WEEK
        if system == GLONASS:
            second += leap_seconds(to_date(self._near)) - MOSCOW
        second += BEIDOU_LATE if system == BEIDOU else 0.0
        time = second + period * round((self._near - second) / period)
        if self._open and abs(time - self._time) < _SAME:
            return True
        self.end()
        if time < self._time + _SAME:
            self.late += 1
            return False
        self._near, self._time, self._open = time, time, True
        return True

    def _take_legacy(self, system: int, number: int, payload: bytes) -> bool:
        """Take a message of the time before MSM; return whether it is complete."""
        fields, start = _LEGACY[number], 64 if system == GPS else 61
        width = sum(abs(count) for _, count, _ in fields)
        count = int((_decode(payload, start - 9, [("count", 5, 1)]) or {"count": 0})["count"])
        for k in range(count):
            if (one := _decode(payload, start + k * width, fields)) is None:
                return False
            sat, channel = int(one["sat"]), int(one.get("channel", 7.0)) - 7
            if system == GPS and sat > _MOST_SATELLITE:
                self.table.others["SBAS"] += 1
                continue
            first = one["range"] + one["turns"]
            for carrier, name in enumerate(("", "_2") if "range_2" in one else ("",)):
                if carrier and one["range_2"] == _NO_RANGE:
                    continue
                frequency = float(find_frequency(*np.array([[system], [carrier + 1], [channel]]))[0])
                phase, key = one[f"phase{name}"] * frequency / C, (system, sat, carrier)
                phase += _ROLL * round((self._phases.get(key, phase) - phase) / _ROLL)
                self._phases[key] = phase
                phase = np.nan if one[f"phase{name}"] == _NO_PHASE else first * frequency / C + phase
                distance = first + one["range_2"] if carrier else first
                values = (distance, np.nan, one[f"cn0{name}"] or np.nan, phase, np.nan)
                self._put(key, carrier + 1, values, int(one[f"lock{name}"]), False)
        return True

    def _take_msm(self, system: int, number: int, payload: bytes) -> bool:
        """Take a multiple signal message; return whether it is complete."""
        bits = np.unpackbits(np.frombuffer(payload, np.uint8))
        sats = np.flatnonzero(bits[_MASKS : _MASKS + 64]) + 1
        signals = np.flatnonzero(bits[_MASKS + 64 : _CELLS]) + 1
        area, n = len(sats) * len(signals), len(sats)
        cells = bits[_CELLS : _CELLS + area]
        if area > _MOST_CELLS or len(cells) < area:
            return False
        row, column = np.nonzero(cells.reshape(n, len(signals)))
        rates = number % 2
        wide = _FINE if number % 10 >= 6 else _COARSE
        sizes = [(8, n), *([(4, n)] * rates), (10, n), *([(14, n)] * rates)]
        sizes += [(width, len(row)) for width in (wide[0], wide[1], wide[2], 1, wide[3], *([15] * rates))]
        if len(bits) < _CELLS + area + sum(width * count for width, count in sizes):
            return False
        blocks = _split(bits, _CELLS + area, sizes)
        whole = next(blocks)
        channel = np.zeros(n, np.int64)
        extended = next(blocks) if rates else channel + 15
        if system == GLONASS:
            known = np.array([self._channels.get(int(sat), _UNKNOWN) for sat in sats])
            channel = np.where(extended <= 13, extended - 7, known)
        rough = (np.where(whole == 255, np.nan, whole) + next(blocks) / 1024.0)[row]
        slow = _scale(next(blocks), 14, 1.0)[row] if rates else np.full(len(row), np.nan)
        code = (rough + _scale(next(blocks), wide[0], _STEP[wide[0]])) * _MILLISECOND
        phase = (rough + _scale(next(blocks), wide[1], _STEP[wide[1]])) * _MILLISECOND
        lock, half, cn0 = next(blocks), next(blocks), next(blocks) * _STEP[wide[3]]
        rate = slow + (_scale(next(blocks), 15, 1e-4) if rates else 0.0)
        places = [_PLACES[system].get(int(signal), (2, 0, 0)) for signal in signals[column]]
        band = np.array([place[2] for place in places], int)
        frequency = find_frequency(np.full(len(row), system), band, channel[row])
        frequency[channel[row] == _UNKNOWN] = np.nan
        for k in sorted(range(len(row)), key=lambda k: (row[k], places[k])):
            if places[k][0] < 2 and np.isfinite(code[k]):
                per_meter = frequency[k] / C
                values = (code[k], -rate[k] * per_meter, cn0[k] or np.nan, phase[k] * per_meter, np.nan)
                key = (system, int(sats[row[k]]), places[k][0])
                self._put(key, places[k][2], values, int(lock[k]), bool(half[k]))
        return True

    def _put(
        self, key: tuple[int, int, int], band: int, values: tuple[float, ...], lock: int, half: bool
    ) -> None:
        slipped = half or lock < self._locks.get(key, 0) or lock == 0
        if self.table.put(*key, band, values, slipped):
            self._locks[key] = lock


def _decode(payload: bytes, start: int, fields: Fields) -> dict[str, float] | None:
    """Return the fields from a bit on; None if the message ends before."""
    width = 8 * len(payload) - start
    if width < sum(abs(count) for _, count, _ in fields):
        return None
    return decode(int.from_bytes(payload, "big"), width, fields)


def _split(bits: NDArray[np.uint8], at: int, sizes: list[tuple[int, int]]) -> Iterator[IntArray]:
    """Yield a block of numbers for each of ``sizes``: width of a number [bit], and count."""
    for width, count in sizes:
        block = bits[at : at + width * count].reshape(count, width)
        yield block @ (1 << np.arange(width - 1, -1, -1))
        at += width * count


def _scale(block: IntArray, width: int, step: float) -> FloatArray:
    """Return signed numbers in a unit; NaN for the least number, which means that a value is missing."""
    least = 1 << width - 1
    value = np.where(block >= least, block - 2 * least, block)
    return np.where(value == -least, np.nan, value * step)
