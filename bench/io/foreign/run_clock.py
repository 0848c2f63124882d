"""The time of a file at the start of a run, found by the clocks that the file may have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from bench.core.mathematics.arrays import FloatArray
from bench.io.logs.formats.pose_files import GPS, WEEK_CLOCK
from bench.simulation.signals.gps_time import UNIX_TO_GPS, leap_seconds, may_be_gps, to_date
from bench.simulation.signals.orbits import WEEK

_RUN = "the run"
_NAMES = {GPS: "GPS time since 1980", WEEK_CLOCK: "the GPS week"}


@dataclass(frozen=True, slots=True)
class RunClock:
    """Times of a run, and what clocks show at its start."""

    begin: float
    end: float  # [s]
    shown: Sequence[tuple[str, float]]  # clocks, and their time at t = 0 of the run [s]

    @classmethod
    def of_run(cls, begin: float, end: float, gps: float) -> RunClock:
        """Return the clocks of a simulated run with t = 0 at a GPS time since 1980-01-06 [s]."""
        return cls(begin, end, [(_RUN, 0.0), *_list_clocks(gps)])

    @classmethod
    def of_log(cls, begin: float, end: float, origin: float) -> RunClock:
        """Return the clocks of a log with t = 0 at ``origin`` on the clock of its IMU [s].

        The clock of the IMU may count from 1980 or, in UTC, from 1970: the times of a file show which.
        """
        utc = origin - UNIX_TO_GPS
        readings = [origin] if may_be_gps(origin) else []
        readings += [utc + leap_seconds(to_date(utc))] if may_be_gps(utc) else []
        clocks = [clock for gps in readings for clock in _list_clocks(gps)]
        return cls(begin, end, [(_RUN, 0.0), ("the IMU", origin), *clocks])

    def find_start(self, t: FloatArray, declared: str) -> tuple[float, str]:
        """Return the time in a file at the start of the run [s], and a remark unless it is 0.

        Parameters
        ----------
        t : (N,) array
            Times of the file, in order.
        declared : str
            Clock that the format has: ``"gps"``, ``"week"``, or empty for any.
        """
        first, last = float(t[0]), float(t[-1])

        def overlap(clock: tuple[str, float]) -> float:
            return min(last - clock[1], self.end) - max(first - clock[1], self.begin)

        wanted, origin = _NAMES.get(declared), dict(self.shown).get("the IMU")
        known = sorted(self.shown, key=lambda clock: clock[0] != wanted)
        if declared == GPS and origin is not None and known[0][0] != wanted:
            known.insert(0, (_NAMES[GPS], origin + WEEK * (first // WEEK)))  # seconds of a week
        best = max(known, key=overlap)
        if not declared and overlap((_RUN, 0.0)) >= 0.0:
            best = _RUN, 0.0
        if overlap(best) < 0.0:
            return 0.0, (
                f"its times, {first:.13g} to {last:.13g} s, do not overlap with the run, {self.begin:g} to "
                f"{self.end:g} s; --t0 {first - self.begin:.13g} puts its first row at the start"
            )
        if best[0] == _RUN:
            return 0.0, ""
        return best[1], f"its clock is {best[0]}; t = 0 of the run is {best[1]:.12g} s"


def _list_clocks(gps: float) -> list[tuple[str, float]]:
    """Return what clocks show at a GPS time since 1980-01-06 [s]."""
    utc = gps - leap_seconds(to_date(gps)) + UNIX_TO_GPS
    return [(_NAMES[GPS], gps), (_NAMES[WEEK_CLOCK], gps % WEEK), ("UTC since 1970", utc)]
