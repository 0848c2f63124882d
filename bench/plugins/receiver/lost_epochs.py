"""Why an epoch has no fix: the first condition that leaves too few satellites, or a fix that cannot be true.

Also which systems have orbits of other times only, or none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import LETTERS, SYSTEM_NAMES, parse_systems
from bench.plugins.receiver import implausible_fixes
from bench.plugins.receiver.rinex.ephemerides import NavigationFile
from bench.plugins.receiver.rinex.observations import ObservationFile
from bench.simulation.signals import orbit_tables, orbits, receiver_solution
from bench.simulation.signals.processing import Processing
from bench.simulation.signals.receiver_solution import ReceiverSolution

_EPOCH = datetime(1980, 1, 6)


def explain(
    seen: GnssObservations, solution: ReceiverSolution, processing: Processing
) -> tuple[list[str], IntArray]:
    """Return reasons, and which of them (M,) each epoch without a fix has; -1: it has a fix."""
    reasons: list[str] = []
    found = np.full(len(seen.epoch_start) - 1, -1)
    open_ = ~solution.fixes.valid
    for words, rows in _list_conditions(seen, solution, processing):
        few = open_ & (found < 0) & _are_few(seen, rows)
        if few.any():
            found[few] = len(reasons)
            reasons.append(f"too few satellites with {words}")
    rest = open_ & (found < 0)
    if rest.any():
        found[rest] = len(reasons)
        reasons.append(
            "the ranges do not agree with one position, and too few of them agree to show which are wrong"
        )
    return reasons, found


def reject_implausible(
    solution: ReceiverSolution, reasons: list[str], reason: IntArray
) -> tuple[ReceiverSolution, list[str], IntArray]:
    """Return the solution with fixes that cannot be true as not valid, and the reasons with theirs."""
    words, which = implausible_fixes.find_implausible(solution)
    reasons, reason = [*reasons], reason.copy()
    for k, one in enumerate(words):
        if (which == k).any():
            reason[which == k] = len(reasons)
            reasons.append(one)
    fixes = replace(solution.fixes, valid=solution.fixes.valid & (which < 0))
    return solution._replace(fixes=fixes), reasons, reason


def _are_few(seen: GnssObservations, rows: BoolArray) -> BoolArray:
    """Return which epochs (M,) have fewer rows than unknowns: a position, and a clock for each system."""
    M = len(seen.epoch_start) - 1
    epoch = seen.epoch[rows]
    system = seen.system[rows]
    clocks = sum((np.bincount(epoch[system == k], minlength=M) > 0).astype(int) for k in range(len(LETTERS)))
    few: BoolArray = np.bincount(epoch, minlength=M) < 3 + np.maximum(clocks, 1)
    return few


def _list_conditions(
    seen: GnssObservations, solution: ReceiverSolution, processing: Processing
) -> Iterator[tuple[str, BoolArray]]:
    """Yield what a satellite must have to be used, and the rows (K,) that have it and all before."""
    rows: BoolArray = np.asarray(np.isfinite(seen.pseudorange).any(axis=1))
    yield "a pseudorange", rows
    rows = rows & np.isin(seen.system, list(parse_systems(processing.systems)))
    yield f"a pseudorange of --systems {processing.systems}", rows
    rows = rows & np.isfinite(seen.sat_clock)
    yield "an ephemeris or orbit of that time", rows
    free = processing.ionosphere == "free"
    carriers = "two carriers (--ionosphere klobuchar needs one)" if free else "the first carrier"
    rows = rows & np.isfinite(receiver_solution.correct_pseudoranges(seen, processing))
    yield f"a pseudorange on {carriers}", rows
    every = replace(processing, mask=-np.pi / 2, false_alarm=0.0, robust=False)
    low = solution if (solution.wanted == rows).all() else receiver_solution.solve_fixes(seen, every)
    above = -low.los_n[:, 2] > np.sin(processing.mask)
    solved = np.isfinite(low.los_n[:, 0])
    yield f"an elevation above the mask, {np.rad2deg(processing.mask):g} deg", rows & (above | ~solved)


def describe_lacking(
    raw: ObservationFile, nav: NavigationFile, processing: Processing, clock: FloatArray
) -> list[str]:
    """Return a line on the wanted systems that have ranges, but no ephemeris at their times.

    ``clock`` (K,) is that of the satellites, NaN where one is not served.
    """
    lacking = [
        SYSTEM_NAMES[system]
        for system in sorted(parse_systems(processing.systems) - {table.system for table in nav.precise})
        if (rows := (raw.system == system) & np.isfinite(raw.pseudorange).any(axis=1)).any()
        and not np.isfinite(clock[rows]).any()
    ]
    return [f"{nav.shown}: no ephemeris of {', '.join(lacking)} at the times observed"] if lacking else []


def describe_unserved(raw: ObservationFile, nav: NavigationFile, processing: Processing) -> list[str]:
    """Return a line for each wanted system that has precise orbits, but none at the times of its ranges."""
    lines, tag = [], np.repeat(raw.t, np.diff(raw.epoch_start)) + raw.origin
    code = np.fmin(*raw.pseudorange.T)
    for system in sorted(parse_systems(processing.systems)):
        rows = np.flatnonzero((raw.system == system) & np.isfinite(code))
        sat, t = raw.sat[rows], tag[rows] - code[rows] / orbits.C
        tables = [table for table in nav.precise if table.system == system]
        served = any((orbit_tables.find_rows(one, sat, t) >= 0).any() for one in tables)
        if served or not tables or not len(rows):
            continue
        lacks, most = f"no orbit for {SYSTEM_NAMES[system]}", max(len(one.t) for one in tables)
        why = f"{format_span(np.concatenate([one.t for one in tables]))}, {lacks} at the times observed"
        if most < orbit_tables.NODES:
            why = f"{lacks}: has {most} epochs in a row; {orbit_tables.NODES} are needed"
        lines.append(f"{', '.join(dict.fromkeys(one.shown for one in tables))}: {why}")
    return lines


def format_span(seconds: FloatArray) -> str:
    """Return the first and the last day of times (K,) [s] since 1980-01-06, of one day the hours."""
    first, last = (_EPOCH + timedelta(seconds=float(t)) for t in (seconds.min(), seconds.max()))
    if first.date() == last.date():
        return f"{first:%Y-%m-%d %H:%M} to {last:%H:%M}"
    return f"{first.date()} to {last.date()}"
