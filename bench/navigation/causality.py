"""Causality tests of a filter: feed it piece by piece, or change what arrives later, and compare the answers.

An answer at t may follow from all that has arrived until t, and from the IMU sample that t lies in. A filter
that runs in pieces gets no more than that before its answer at t is taken. Of another filter, the values of
everything that arrives after a time are replaced. The answers until then must not change by a bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, SensorData
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.record_cuts import cut_piece, nothing_known
from bench.navigation.open_filters import PieceFilter

_COLUMNS = ("lla", "vel_n", "q_nb", "cov", "gyro_bias_b", "accel_bias_b", "extra", "extra_sd", "offset_cov")
_TIMES = ("t", "t_arrival", "dt")
_WHOLE = 0.9  # of the time before a time: a filter that uses so much uses the whole record
_HALVINGS = 8  # of the rest of a record, in search of the last data that an answer uses


def measure_look_ahead(
    run: Callable[[SensorData], NavSolution],
    first: NavSolution,
    sensors: SensorData,
    others: Sequence[SensorData],
    instants: Iterable[float],
) -> tuple[float, str]:
    """Return how far a filter looks ahead [s], 0 if not at all, also in words.

    ``run`` returns the solution of a new instance for a record: ``first`` for ``sensors``. After ``instants``
    [s], each moved to the IMU sample before, data are from ``others``; the first one that shows a look-ahead
    counts. ValueError if the records are not of the same epochs, or if ``first`` is empty.
    """
    if not (np.isfinite(first.lla).any() or np.isfinite(first.q_nb).any()):
        raise ValueError("it gives no answer")
    t = sensors.imu.t
    interval = float(np.median(np.diff(t)))

    def find(after: float, until: float) -> float | None:
        return find_change(first, run(change_later(sensors, others, after)), until)

    for instant in instants:
        end = float(t[max(int(np.searchsorted(t, instant + SAME_INSTANT)) - 1, 0)])
        changed = find(end, end)
        if changed is None:
            continue
        whole = max(end - changed, interval) > _WHOLE * (end - float(first.t[0]))
        low, high = end, float(t[-1])
        for _ in range(0 if whole else _HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if find(middle, changed) is None else (middle, high)
        seconds, same = max(low - changed, interval), run(change_later(sensors, others[-1:], end))
        times = "" if find_change(first, same, end) is not None else ", by the times of later data alone"
        return seconds, ("the whole record" if whole else f"{seconds:.3g} s") + times
    return 0.0, "no"


def change_later(sensors: SensorData, others: Sequence[SensorData], after: float) -> SensorData:
    """Return a record with as many rows, in which all that arrives after a time [s] is of other records.

    The last has the same epochs and gives IMU and satellites. The rest is of the first with enough rows after
    the time: of the same motion without an outage, for example. ValueError if the epochs differ.
    """
    changed = {}
    for one in fields(sensors):
        record = getattr(sensors, one.name)
        if not hasattr(record, "t"):
            continue
        *rest, last = (getattr(other, one.name) for other in others)
        if last is None or not np.array_equal(last.t, record.t, equal_nan=True):
            raise ValueError(f"{one.name}: the two runs have different epochs")
        later = np.flatnonzero(getattr(record, "t_arrival", record.t) > after + SAME_INSTANT)
        source, rows = last, later
        for another in rest if one.name not in ("imu", "observations") else ():
            found = np.flatnonzero(another.t_arrival > after + SAME_INSTANT)[: len(later)]
            source, rows = (another, found) if len(found) == len(later) else (source, rows)
        columns = {f.name: getattr(record, f.name) for f in fields(record)}
        for name, column in columns.items():
            if isinstance(column, np.ndarray) and len(column) == len(record.t):
                columns[name] = column.copy()
                columns[name][later] = getattr(source, name)[rows]
        changed[one.name] = replace(record, **columns)
    return replace(sensors, **changed)


def reverse_values(data: SensorData) -> SensorData:
    """Return a record with the same times, its values in reverse order: another motion; satellites stay."""
    changed = {}
    for one in fields(data):
        record = getattr(data, one.name)
        if hasattr(record, "t") and one.name != "observations":
            columns = {f.name: getattr(record, f.name) for f in fields(record)}
            changed[one.name] = replace(record, **{
                name: column[::-1].copy()
                for name, column in columns.items()
                if name not in _TIMES and isinstance(column, np.ndarray) and len(column) == len(record.t)
            })  # fmt: skip
    return replace(data, **changed)


def find_change(first: NavSolution, other: NavSolution, until: float) -> float | None:
    """Return the first time, until some time [s], at which two solutions differ, events included."""
    rows = np.flatnonzero(first.t <= until + SAME_INSTANT)
    times = first.t[rows][list_differing(first, rows, other, rows)][:1].tolist()
    a, b = _list_due(first), _list_due(other)
    times += [t for key, t in (a | b).items() if t <= until and not (key in a and key in b)]
    return min(times, default=None)


def list_differing(one: NavSolution, its: IntArray, other: NavSolution, theirs: Any) -> BoolArray:
    """Return which of some rows (M,) of two solutions differ by a bit; states that one lacks are NaN."""
    differ = np.zeros(len(its), np.bool_)
    for name in _COLUMNS:
        a, b = (
            np.empty((len(its), 0)) if column is None else column[rows].reshape(len(its), column[:1].size)
            for column, rows in ((getattr(one, name), its), (getattr(other, name), theirs))
        )
        if a.shape == b.shape:
            differ |= ((a != b) & ~(np.isnan(a) & np.isnan(b))).any(axis=1)
        else:
            differ |= ~(np.isnan(a).all(axis=1) & np.isnan(b).all(axis=1))
    return differ


def _list_due(solution: NavSolution) -> dict[tuple[float, str, str], float]:
    """Return when each event is due [s], by start, kind and sensor: alarms at their start, others at end."""
    rows = [(*row, "") for row in solution.events.rows()]
    return {(t, kind, sensor): t if kind == "integrity" else end for t, end, kind, _, sensor, *_ in rows}


def find_late(filter_: PieceFilter, sensors: SensorData, whole: NavSolution, ends: BoolArray) -> list[float]:
    """Feed a filter piece by piece; return the times of answers and events that differ or come late [s].

    A piece ends at each epoch of ``ends`` (M,): the answer there is taken before anything later comes. Epochs
    in a gap of the IMU belong to the piece after it; those before the first answer of ``whole``, the solution
    for the record, are left out. EstimatorError if the filter cannot run in pieces from this start.
    """
    output_t, imu_t = sensors.output_t, sensors.imu.t
    counts = np.searchsorted(imu_t, output_t - SAME_INSTANT)
    ends = ends & (np.append(imu_t - sensors.imu.dt, np.inf)[counts] < output_t - SAME_INSTANT)
    ends[-1] = True
    begun = np.isfinite(np.column_stack([whole.lla, whole.vel_n, whole.q_nb])).any(axis=1).cumsum() > 0
    told, late = dict[tuple[float, str, str], float](), set[float]()
    reached, count, none = -np.inf, 0, nothing_known(np.empty(0))
    for k in np.flatnonzero(ends).tolist():
        t, end = float(output_t[k]), int(counts[k]) + 1
        final, now = filter_.advance(cut_piece(sensors, slice(count, end), reached, t)), none
        reached, count = t, end
        with suppress(EstimatorError):  # while the start is not known
            now = filter_.copy().finish()
        for part in (final, now):
            rows = np.minimum(np.searchsorted(output_t, part.t), len(output_t) - 1)
            late.update(output_t[rows[list_differing(whole, rows, part, slice(None)) & begun[rows]]].tolist())
            for key in _list_due(part):
                told.setdefault(key, t)
        if begun[k] and not (t in final.t or t in now.t):
            late.add(t)
    for key, due in _list_due(whole).items():  # at the last epoch, of what arrives after it
        stops = output_t[ends & (output_t >= due - SAME_INSTANT)]
        if due < output_t[-1] and told.get(key, np.inf) > stops[0]:
            late.add(due)
    return sorted(late)
