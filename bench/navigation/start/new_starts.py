"""The pause of a filter after a gap or a reset, and the alignments that may end it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import InitialState, SensorData
from bench.navigation.engine.session import Kept, SessionState
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.navigation.error_state_filter.state_blocks import WIND_SD
from bench.navigation.start.alignment import StartSearch
from bench.navigation.start.course import LEAST_SPEED
from bench.navigation.start.fixes_only import Coast
from bench.navigation.start.headings import LINEAR

_ALIGN_FOR = 10.0  # length of a segment that gives the course, or of a standstill [s]
_MATCHED_FOR = 2.0  # length of a segment whose velocities level the IMU [s]
_STILL = 0.3  # speed below which an aircraft stood before a gap [m/s]
_SIGMAS = 5.0  # by which it may seem to have moved in it


@dataclass
class Pause(SessionState):
    """The time from the last sample before a gap, or from divergence, to the restart of the filter."""

    coast: Kept[Coast]
    silent: Kept[tuple[float, float]]  # [s]
    kind: Kept[str]  # of the event
    why_stopped: Kept[str]
    wanted: Kept[FloatArray]  # answers [s]
    record: Kept[SensorData | None]  # since the gap, None before its first sample
    ways: Kept[list[StartSearch]]  # that have not failed
    why: Kept[list[str]]  # the others did

    def due(self, until: float) -> FloatArray:
        """Remove and return the output times up to a time [s]."""
        due = self.wanted <= until
        found, self.wanted = self.wanted[due], self.wanted[~due]
        return found


def list_starts(begin: float, coast: Coast, *, any_heading: bool = False) -> list[StartSearch]:
    """Return the searches for an alignment after a gap or reset that ended at a time [s].

    First "level", if the position is known. Then "course", 10 s; or, if the filter can start with any heading
    and wind may turn the nose off the course by more than `LINEAR`, "motion", 2 s.

    Parameters
    ----------
    begin : float
        First time of the search [s].
    coast : Coast
        Position and velocity by the fixes.
    any_heading : bool
        The filter can start with an unknown heading (`headings`).
    """
    lla, vel_n, cov = coast.at(begin)
    before, unknown = coast.end, np.full(4, np.nan)
    speed = float(np.nan_to_num(np.hypot(*vel_n[:2])))  # a filter may have ended without a velocity
    wide = np.diag(np.full(9, np.inf))
    drift_sd = float(np.arctan2(WIND_SD, max(speed, LEAST_SPEED)))
    ways = [
        InitialState(begin, unknown[:3], unknown[:3], unknown, wide, "course", _ALIGN_FOR, drift_sd=drift_sd)
    ]
    if any_heading and drift_sd > LINEAR:  # motion finds the heading better than the course
        ways = [replace(ways[0], alignment="motion", align_for=_MATCHED_FOR, drift_sd=UNKNOWN_HEADING_SD)]
    if np.isfinite(lla).all():
        wide = wide.copy()
        wide[:3, :3] = cov[:3, :3]
        moved = np.linalg.norm(earth.difference_n(lla, before.lla)) > _SIGMAS * np.sqrt(np.trace(cov[:3, :3]))
        if np.linalg.norm(before.vel_n) < _STILL and not moved:  # the nose points where it did
            unknown, wide[8, 8] = before.q_nb, before.cov[8, 8]
        at_rest = InitialState(begin, lla, np.full(3, np.nan), unknown, wide, "level", _ALIGN_FOR)
        ways.insert(0, replace(at_rest, fix_cov=coast.offset[:3]))
    return [StartSearch(way) for way in ways]
