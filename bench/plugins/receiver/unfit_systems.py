"""Find satellite systems whose orbits or ranges contradict the others over a whole record.

`bench.simulation.signals.least_squares` leaves a few faulty satellites out, epoch by epoch. A system with
more of them, for example because its navigation file is of another time or scale, spoils the position.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import SYSTEM_NAMES, parse_systems
from bench.navigation.engine.kept_rows import take_rows
from bench.simulation.signals import receiver_solution
from bench.simulation.signals.delays import find_range
from bench.simulation.signals.orbits import GPS_EARTH_RATE
from bench.simulation.signals.processing import Processing
from bench.simulation.signals.receiver_solution import ReceiverSolution

_LOOKED_AT = 400  # epochs, evenly over the record
_SPOILED = 0.3  # part of the epochs with a fault above which a system is searched; assumed
_CURED = 0.25  # part of these that may stay without the system; assumed
_WRONG = 3.0  # sd of a residual that is a contradiction [1]
_MANY = 1 / 3  # part of the residuals of a system that contradict: a satellite or two are fewer; assumed


class UnfitSystem(NamedTuple):
    """A system that is left out, and why."""

    system: int
    residual: float  # median size of its residuals relative to the position by the others [m]
    before: float  # part of the epochs that lose satellites or have no fix with it
    after: float  # the same without it

    def describe(self, epochs: int) -> str:
        """Return a line for a record of so many epochs."""
        before, after = round(self.before * epochs), round(self.after * epochs)
        return (
            f"{SYSTEM_NAMES[self.system]} is left out: its ranges differ from the position of the others by "
            f"{self.residual:.3g} m (median). With it {before} of {epochs} epochs lose satellites or have no "
            f"fix, without it {after}. Check its navigation file, or choose by --systems"
        )


def find_unfit(
    seen: GnssObservations, solution: ReceiverSolution, processing: Processing
) -> list[UnfitSystem]:
    """Return the fewest systems without which the rest agrees; none if nothing is wrong or nothing helps."""
    chosen = parse_systems(processing.systems)
    present = [k for k in sorted(chosen) if (solution.wanted & (seen.system == k)).any()]
    before = _count_spoiled(seen, solution)
    if len(present) < 2 or not before >= _SPOILED:
        return []
    step = -(-(len(seen.epoch_start) - 1) // _LOOKED_AT)
    some = take_rows(seen, seen.epoch % step == 0)
    for out, left in _list_choices(present):
        found = receiver_solution.solve_fixes(some, _choose(processing, left))
        after = _count_spoiled(some, found)
        if not after <= _CURED * before:
            continue
        contradicts = {k: _find_residuals(some, found, processing, k) for k in out}
        if all(_is_wrong(some, k, residual) for k, residual in contradicts.items()):
            return [
                UnfitSystem(k, float(np.nanmedian(np.abs(residual))), before, after)
                for k, residual in contradicts.items()
            ]
    return []


def leave_out(
    seen: GnssObservations, processing: Processing, unfit: list[UnfitSystem]
) -> tuple[GnssObservations, Processing]:
    """Return the observations without the satellites of some systems, and the processing of the others."""
    out = [one.system for one in unfit]
    left = [k for k in sorted(parse_systems(processing.systems)) if k not in out]
    gone = np.isin(seen.system, out)
    pos_e, clock = seen.sat_pos_e.copy(), seen.sat_clock.copy()
    pos_e[gone], clock[gone] = np.nan, np.nan
    return replace(seen, sat_pos_e=pos_e, sat_clock=clock), _choose(processing, left)


def _choose(processing: Processing, systems: list[int]) -> Processing:
    return replace(processing, systems=",".join(SYSTEM_NAMES[k].lower() for k in systems))


def _list_choices(present: list[int]) -> Iterator[tuple[list[int], list[int]]]:
    """Yield systems to leave out and to keep: few first, of one number the last systems first."""
    for count in range(1, len(present)):
        for out in combinations(reversed(present), count):
            yield list(out), [k for k in present if k not in out]


def _count_spoiled(seen: GnssObservations, solution: ReceiverSolution) -> float:
    """Return the part of the epochs that lose two satellites or have no fix, of those with one to spare.

    NaN if fewer than half of the epochs have one.
    """
    M = len(seen.epoch_start) - 1
    spare, lost = np.full(M, -3), np.bincount(seen.epoch[solution.wanted & ~solution.used], minlength=M)
    for k in range(len(SYSTEM_NAMES)):
        count = np.bincount(seen.epoch[solution.wanted & (seen.system == k)], minlength=M)
        spare += count - (count > 0)
    enough = spare >= 1
    if enough.sum() < 0.5 * M:
        return np.nan
    return float(((lost > 1) | ~solution.fixes.valid)[enough].mean())


def _find_residuals(
    seen: GnssObservations, solution: ReceiverSolution, processing: Processing, system: int
) -> FloatArray:
    """Return residuals of a system relative to the position by others, less their median [m]."""
    pos_e = earth.to_ecef(solution.fixes.lla)
    near = receiver_solution.look_around(seen, pos_e, processing)
    ranges = receiver_solution.correct_pseudoranges(seen, processing)
    ranges = receiver_solution.subtract_delays(ranges, near, processing)
    rows = np.flatnonzero((seen.system == system) & (near.el > processing.mask) & np.isfinite(ranges))
    rows = rows[solution.fixes.valid[seen.epoch[rows]]]
    where = pos_e[seen.epoch[rows]]
    distance = find_range(*seen.sat_pos_e[rows].T, *where.T, GPS_EARTH_RATE)[0]
    residual = np.full(len(ranges), np.nan)
    residual[rows] = ranges[rows] - distance
    for a, b in zip(seen.epoch_start[:-1], seen.epoch_start[1:], strict=True):
        if np.isfinite(residual[a:b]).any():
            residual[a:b] -= np.nanmedian(residual[a:b])
    return residual


def _is_wrong(seen: GnssObservations, system: int, residual: FloatArray) -> bool:
    known: BoolArray = np.isfinite(residual)
    wrong = np.abs(residual[known]) > _WRONG * seen.sd_pseudorange[known]
    return bool(known.any() and wrong.mean() > _MANY)
