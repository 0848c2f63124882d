"""The time of a file at the start of a run, found by the clocks that the file may have."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from bench.core.mathematics.arrays import FloatArray
from bench.io.logs.formats.pose_files import GPS, WEEK_CLOCK
from bench.simulation.signals.gps_time import leap_seconds, to_date
from bench.simulation.signals.orbits import WEEK

UNIX_TO_GPS = 315964800.0
"""From 1970 to 1980-01-06 [s]."""
_UNIX, _GPS = 1.5e9, 1e8  # times of a log from which on they count from 1970, from 1980 [s]
_RUN = "the run"
_NAMES = {GPS: "GPS time since 1980", WEEK_CLOCK: "the GPS week"}


@dataclass(frozen=True, slots=True)
class RunClock:
    """Times of a run, and what clocks show at its start."""

    begin: float
    end: float  # [s]
    shown: Mapping[str, float]  # clock -> its time at t = 0 of the run [s]

    @classmethod
    def of_run(cls, begin: float, end: float, gps: float) -> RunClock:
        """Return the clocks of a simulated run with t = 0 at a GPS time since 1980-01-06 [s]."""
        return cls(begin, end, {_RUN: 0.0, **_list_clocks(gps)})

    @classmethod
    def of_log(cls, begin: float, end: float, origin: float) -> RunClock:
        """Return the clocks of a log with t = 0 at ``origin`` on the clock of its IMU [s]."""
        known = {_RUN: 0.0, "the IMU": origin}
        if origin > _UNIX:
            gps = origin - UNIX_TO_GPS
            known |= _list_clocks(gps + leap_seconds(to_date(gps)))
        elif origin > _GPS:
            known |= _list_clocks(origin)
        return cls(begin, end, known)

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

        def overlap(name: str) -> float:
            return min(last - known[name], self.end) - max(first - known[name], self.begin)

        known = dict(self.shown)
        if declared == GPS and "the IMU" in known and _NAMES[GPS] not in known:
            known[_NAMES[GPS]] = known["the IMU"] + WEEK * (first // WEEK)  # seconds of a week
        order = [_NAMES[declared], *known] if _NAMES.get(declared) in known else list(known)
        best = max(order, key=overlap)
        if not declared and overlap(_RUN) >= 0.0:
            best = _RUN
        if overlap(best) < 0.0:
            return 0.0, (
                f"its times, {first:.9g} to {last:.9g} s, do not overlap with the run, {self.begin:g} to "
                f"{self.end:g} s; --t0 {first - self.begin:.9g} puts its first row at the start"
            )
        if best == _RUN:
            return 0.0, ""
        return known[best], f"its clock is {best}; t = 0 of the run is {known[best]:.12g} s"


def _list_clocks(gps: float) -> dict[str, float]:
    """Return what clocks show at a GPS time since 1980-01-06 [s]."""
    utc = gps - leap_seconds(to_date(gps)) + UNIX_TO_GPS
    return {_NAMES[GPS]: gps, _NAMES[WEEK_CLOCK]: gps % WEEK, "UTC since 1970": utc}
