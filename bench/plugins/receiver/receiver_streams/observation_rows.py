"""Gather the observations of a stream, epoch by epoch, in compact arrays."""

from __future__ import annotations

from array import array
from collections import Counter

import numpy as np

from bench.core.words.exceptions import ConfigError
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.simulation.signals.orbits import DAY


class ObservationRows:
    """The epochs and observations read so far; of several signals of a carrier the first one counts."""

    def __init__(self) -> None:
        self.seconds, self._start = array("d"), array("q", [0])
        self._system, self._sat = array("q"), array("q")
        self._values = tuple(array("d") for _ in range(5))  # of two carriers: range, Doppler, C/N0, phase, sd
        self._band, self._slipped = array("q"), array("b")  # of two carriers
        self._rows: dict[tuple[int, int], int] = {}
        self.others: Counter[str] = Counter()

    def put(
        self, system: int, sat: int, carrier: int, band: int, values: tuple[float, ...], slipped: bool
    ) -> bool:
        """Take an observation of this epoch; return whether its carrier had none yet.

        ``values`` are range [m], Doppler [Hz], C/N0 [dB-Hz], phase [cycles] and the sd of the range [m], NaN
        where missing.
        """
        row = self._rows.get((system, sat))
        if row is None:
            row = self._rows[(system, sat)] = len(self._sat)
            self._system.append(system)
            self._sat.append(sat)
            for column in self._values:
                column.extend((np.nan, np.nan))
            self._band.extend((0, 0))
            self._slipped.extend((0, 0))
        at = 2 * row + carrier
        if self._band[at]:
            return False
        for column, value in zip(self._values, values, strict=True):
            column[at] = value
        self._band[at], self._slipped[at] = band, slipped
        return True

    def end_epoch(self, time: float) -> None:
        """End the epoch at a time by the receiver's clock [s since 1980-01-06]."""
        self.seconds.append(time)
        self._start.append(len(self._sat))
        self._rows.clear()

    def make_file(self, shown: str, lost: int, reasons: tuple[str, ...]) -> ObservationFile:
        """Return what was taken.

        Raises
        ------
        ConfigError
            If the times do not increase, or no satellite has a range.
        """
        t = np.frombuffer(self.seconds)
        if (np.diff(t) <= 0).any():
            raise ConfigError(f"{shown}: the times of its measurements do not increase")
        if not self._sat:
            raise ConfigError(f"{shown}: has no range of GPS, GLONASS, Galileo or BeiDou in it")
        origin = float(t[0] // DAY * DAY)
        pseudorange, doppler, cn0, phase, sd = (np.frombuffer(one).reshape(-1, 2) for one in self._values)
        return ObservationFile(
            shown=shown,
            marker="",
            origin=origin,
            t=t - origin,
            epoch_start=np.frombuffer(self._start, np.int64),
            sat=np.frombuffer(self._sat, np.int64),
            system=np.frombuffer(self._system, np.int64),
            pseudorange=pseudorange,
            doppler=doppler,
            cn0=cn0,
            approximate_e=None,
            antenna_hen=np.zeros(3),
            moving=False,
            lost=lost,
            reasons=reasons,
            band=np.frombuffer(self._band, np.int64).reshape(-1, 2),
            phase=phase,
            slipped=np.frombuffer(self._slipped, np.bool_).reshape(-1, 2),
            others=self.others,
            sd=sd,
        )
