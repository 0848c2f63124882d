"""Read the raw measurements of Android phones, the lines Raw of GnssLogger, as observations.

European GNSS Agency, Using GNSS Raw Measurements on Android Devices, White Paper (2017), 2.4: the range is
the time of reception less that of transmission. The first bias after each discontinuity of the clock counts,
so that ranges change as the Doppler says. Left out are L5 of GPS, whose message has no group delay for it,
B1C and B2a of BeiDou, and ranges that may be off by milliseconds.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.records.orbit_sets import BEIDOU, GALILEO, GLONASS, GPS
from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.receiver_streams.observation_rows import ObservationRows
from bench.plugins.receiver.rinex.lines import BEIDOU_LATE, open_lines
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.plugins.receiver.rinex.unpacking import MOST_BYTES
from bench.simulation.signals.gps_time import leap_seconds, to_date
from bench.simulation.signals.orbits import DAY, L1, WEEK, C

_SYSTEMS = {"1": GPS, "3": GLONASS, "5": BEIDOU, "6": GALILEO}
_OTHERS = {"2": "SBAS", "4": "QZSS", "7": "NavIC"}
_CARRIERS = {  # carrier [MHz] from and to -> carrier (0 first, 1 second) and RINEX band digit
    GPS: [(1574, 1577, 0, 1)],
    GLONASS: [(1597, 1607, 0, 1)],
    BEIDOU: [(1560, 1562, 0, 2)],
    GALILEO: [(1574, 1577, 0, 1), (1175, 1178, 1, 5)],
}
_LOCKED, _TIMED = 1 | 1 << 10, 1 << 3 | 1 << 14  # states: code lock (of E1 its own bit); time of week known
_DAY_TIMED = 1 << 7 | 1 << 15  # of GLONASS, the time of day
_AMBIGUOUS = 1 << 4  # by milliseconds
_PHASE_VALID, _PHASE_SLIPPED = 1, 2 | 4
_MOST_UNSURE = 500  # of the time of transmission [ns], 150 m; assumed
_LONGEST = 0.5  # travel time of a signal, with the error of the phone's clock [s]
_MOST_ROWS = 20_000_000
_NS = 10**9
_NEEDED = (
    "TimeNanos", "FullBiasNanos", "Svid", "State", "ReceivedSvTimeNanos", "ReceivedSvTimeUncertaintyNanos",
    "Cn0DbHz", "PseudorangeRateMetersPerSecond", "ConstellationType",
)  # fmt: skip


def read_android(path: Path, shown: str | None = None) -> ObservationFile:
    """Read the observations in a log of GnssLogger, packed or not.

    Raises
    ------
    ConfigError
        If it has no lines Raw that can be read.
    """
    shown = path.name if shown is None else shown
    check_file(path, shown, MOST_BYTES)
    rows = _PhoneRows()
    with open_lines(path, shown) as lines:
        while (line := lines.read_line()) is not None:
            if line.startswith("Raw,"):
                rows.take(line.split(","))
            elif line.startswith("#") and "Raw," in line:
                rows.names = [name.strip() for name in line[line.index("Raw,") :].split(",")]
            if len(rows.table.seconds) > _MOST_ROWS:
                raise ConfigError(f"{shown}: more than {_MOST_ROWS} epochs")
    rows.end()
    if missing := [name for name in _NEEDED if name not in rows.names]:
        raise ConfigError(f"{shown}: has no column {missing[0]} in the lines Raw, as GnssLogger names them")
    if not rows.table.seconds:
        raise ConfigError(f"{shown}: has no line Raw with a clock bias and a range that can be read")
    reasons = (f"{shown}: {rows.damaged} lines Raw are damaged",) if rows.damaged else ()
    return rows.table.make_file(shown, rows.damaged, reasons)


class _PhoneRows:
    """The state of the phone's clock, and the observations so far."""

    def __init__(self) -> None:
        self.names: list[str] = []
        self.table = ObservationRows()
        self.damaged = 0
        self._epoch: int | None = None  # TimeNanos
        self._time = 0  # of the epoch [ns since 1980-01-06]
        self._bias: tuple[str, int, float] | None = (
            None  # discontinuity count, full and rest of the first bias
        )

    def end(self) -> None:
        """End the epoch, if there is one."""
        if self._epoch is not None:
            self.table.end_epoch(self._time / _NS)
        self._epoch = None

    def take(self, fields: list[str]) -> None:
        """Take a line."""
        one = dict(zip(self.names, fields, strict=False))
        try:
            self._take(one)
        except (KeyError, ValueError, OverflowError):
            self.damaged += 1

    def _take(self, one: dict[str, str]) -> None:
        epoch, full, system = int(one["TimeNanos"]), one["FullBiasNanos"], one["ConstellationType"].strip()
        if not full or not int(full):  # the phone has no GPS time
            return
        if epoch != self._epoch:
            self.end()
            count = one.get("HardwareClockDiscontinuityCount", "")
            if self._bias is None or self._bias[0] != count:
                self._bias = count, int(full), float(one.get("BiasNanos") or 0.0)
            self._epoch, self._time = epoch, epoch - self._bias[1]
        assert self._bias is not None
        if system not in _SYSTEMS:
            self.table.others[_OTHERS.get(system, "other systems")] += 1
            return
        which, sat, state = _SYSTEMS[system], int(one["Svid"]), int(one["State"])
        frequency = float(one.get("CarrierFrequencyHz") or L1)
        places = [place for place in _CARRIERS[which] if place[0] < 1e-6 * frequency < place[1]]
        timed = _DAY_TIMED if which == GLONASS else _TIMED
        unsure = float(one["ReceivedSvTimeUncertaintyNanos"])
        sound = state & _LOCKED and state & timed and not state & _AMBIGUOUS and 0 <= unsure < _MOST_UNSURE
        if not places or not sound or not 1 <= sat <= (24 if which == GLONASS else 63):
            return
        rest = float(one.get("TimeOffsetNanos") or 0.0) - self._bias[2]
        late = self._time - int(one["ReceivedSvTimeNanos"])
        period = DAY if which == GLONASS else WEEK
        if which == GLONASS:
            late += (10800 - leap_seconds(to_date(self._time / _NS))) * _NS  # Moscow time
        elif which == BEIDOU:
            late -= round(BEIDOU_LATE) * _NS
        half = round(period) * _NS // 2
        travel = ((late + half) % (2 * half) - half + rest) / _NS
        if abs(travel) > _LONGEST:
            return
        doppler = -float(one["PseudorangeRateMetersPerSecond"]) * frequency / C
        tracked = int(one.get("AccumulatedDeltaRangeState") or 0)
        phase = float(one.get("AccumulatedDeltaRangeMeters") or np.nan) * frequency / C
        values = (C * travel, doppler, float(one["Cn0DbHz"]), phase if tracked & _PHASE_VALID else np.nan)
        _, _, carrier, band = places[0]
        self.table.put(
            which, sat, carrier, band, (*values, 1e-9 * unsure * C), bool(tracked & _PHASE_SLIPPED)
        )
