"""Causality test of a filter: change the data that arrive later, and compare the solutions.

An answer at t may follow from all that has arrived until t, and from the IMU sample that t lies in. Where the
values of everything that arrives after a time are those of other noise, the answers until
then must not change by a bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution, SensorData

_KEPT = ("t", "t_arrival", "dt", "valid", "sat", "system", "frequency", "epoch_start", "klobuchar", "gps_t0")
"""Columns of records that stay as they are: when something was measured, and of what."""
_ANSWERS = ("lla", "vel_n", "q_nb", "cov")
_WHOLE = 0.9  # of the time before a time: a filter that uses so much uses the whole record


@dataclass(frozen=True, slots=True)
class LookAhead:
    """Time by which a filter looks ahead."""

    seconds: float  # the longest that was found [s]; 0: none
    whole: bool  # as far as to the begin of the record
    repeatable: bool  # whether it gives the same bits of the same record

    @property
    def text(self) -> str:
        """Return the result in words."""
        if not self.repeatable:
            return "not repeatable: two runs of one record differ"
        if self.seconds == 0.0:
            return "uses the future: no"
        return f"uses the future: {'the whole record' if self.whole else f'{self.seconds:.3g} s'}"


def measure_look_ahead(
    run: Callable[[SensorData], NavSolution],
    sensors: SensorData,
    other: SensorData,
    instants: Iterable[float],
    first: NavSolution | None = None,
) -> LookAhead:
    """Return how far a filter looks ahead at some epochs.

    Parameters
    ----------
    run : callable
        Returns the solution of the filter for a record; a new instance each time.
    sensors, other : SensorData
        Two realizations of the noise on the same motion.
    instants : iterable of float
        After which the second draw takes the place of the first [s]; each is moved to the IMU sample before.
    first : NavSolution or None
        Its solution of ``sensors``, if that is known to be the same in each run; None: it is found twice.

    Raises
    ------
    ValueError
        If the runs are not of the same epochs, or it gives no answer.
    """
    first, again = (run(sensors), run(sensors)) if first is None else (first, first)
    if not (np.isfinite(first.lla).any() or np.isfinite(first.q_nb).any()):
        raise ValueError("it gives no answer")
    if _find_change(first, again, np.inf) is not None:
        return LookAhead(0.0, whole=False, repeatable=False)
    longest, whole = 0.0, False
    interval = float(np.median(np.diff(sensors.imu.t)))
    for instant in instants:
        end = float(sensors.imu.t[np.searchsorted(sensors.imu.t, instant + SAME_INSTANT) - 1])
        changed = _find_change(first, run(change_later(sensors, other, end)), end)
        if changed is not None:
            ahead = max(end - changed, interval)
            longest = max(longest, ahead)
            whole |= ahead > _WHOLE * (end - float(first.t[0]))
    return LookAhead(longest, whole, repeatable=True)


def change_later(sensors: SensorData, other: SensorData, after: float) -> SensorData:
    """Return a record in which all data that arrive after a time [s] have other noise."""
    changed = {}
    for one in fields(sensors):
        record, source = getattr(sensors, one.name), getattr(other, one.name)
        if not hasattr(record, "t"):
            continue
        arrival = getattr(record, "t_arrival", record.t)
        if source is None or not np.array_equal(source.t, record.t, equal_nan=True):
            raise ValueError(f"{one.name}: the two runs have different epochs")
        changed[one.name] = _take_later(record, source, arrival > after + SAME_INSTANT)
    return replace(sensors, **changed)


def _take_later(record: Any, source: Any, later: BoolArray) -> Any:
    columns: dict[str, FloatArray] = {}
    for one in fields(record):
        column = getattr(record, one.name)
        if one.name not in _KEPT and isinstance(column, np.ndarray) and len(column) == len(later):
            columns[one.name] = column.copy()
            columns[one.name][later] = getattr(source, one.name)[later]
    return replace(record, **columns)


def _find_change(first: NavSolution, other: NavSolution, until: float) -> float | None:
    """Return the first epoch, until some time [s], at which two solutions differ by a bit."""
    rows = first.t <= until + SAME_INSTANT
    differ = np.zeros(int(rows.sum()), np.bool_)
    for name in _ANSWERS:
        one, two = (getattr(solution, name)[rows].reshape(len(differ), -1) for solution in (first, other))
        differ |= ((one != two) & ~(np.isnan(one) & np.isnan(two))).any(axis=1)
    return float(first.t[rows][np.argmax(differ)]) if differ.any() else None
