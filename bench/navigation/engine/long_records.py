"""A record of hours goes through a filter in blocks of samples, so that its memory does not grow with it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import fields, replace
from typing import Any

import numpy as np

from bench import disk_arrays
from bench.arrays import BoolArray, FloatArray
from bench.data import (
    EventRow,
    Events,
    GnssObservations,
    Innovations,
    NavSolution,
    SensorData,
)
from bench.navigation.engine.kept_rows import take_observations, take_rows
from bench.navigation.engine.piecewise import join_events, join_tables
from bench.navigation.engine.record_cuts import aiding_records, arrivals
from bench.navigation.engine.timeline import TIME_TOLERANCE


def is_long(sensors: SensorData) -> bool:
    """Return whether a record is long enough to go through a filter in blocks."""
    return len(sensors.imu) > disk_arrays.LONG * disk_arrays.ROWS


def longest_wait(sensors: SensorData) -> float:
    """Return the longest time from the validity of a measurement to its arrival [s]."""
    waits = [one.t_arrival - one.t for one in aiding_records(sensors).values()]
    longest = max((float(wait[np.isfinite(wait)].max(initial=0.0)) for wait in waits), default=0.0)
    return longest + 2.0 * TIME_TOLERANCE


def cut_record(sensors: SensorData) -> Iterator[tuple[SensorData, bool]]:
    """Yield a record in blocks of IMU samples, in their order, and whether a block is the last.

    A measurement is in the block at whose end it has arrived, an answer wanted in that which reaches it; the
    last block has all that is left. What earlier blocks touched on disk is released.
    """
    imu, left, reached = sensors.imu, aiding_records(sensors), -np.inf
    arrived_at = {name: arrivals(one) for name, one in left.items()}
    for rows in disk_arrays.blocks(len(imu)):
        samples = take_rows(imu, rows)
        begin, last = reached, rows.stop == len(imu)
        reached = max(reached, float(samples.t[np.isfinite(samples.t)].max(initial=-np.inf)))

        def inside(t: FloatArray, begin: float = begin, end: float = reached, last: bool = last) -> BoolArray:
            if last:
                return ~(t <= begin)  # what is not finite, too
            found: BoolArray = (t > begin) & (t <= end)
            return found

        cut: dict[str, Any] = {}
        for name, one in left.items():
            arrived = inside(arrived_at[name])
            observed = isinstance(one, GnssObservations)
            cut[name] = take_observations(one, arrived) if observed else take_rows(one, arrived)
        wanted = sensors.output_t[inside(sensors.output_t)]
        yield replace(sensors, imu=samples, output_t=wanted, **cut), last


class JoinedSolution:
    """The answers to a whole record, put together from those to its blocks."""

    def __init__(self, t: FloatArray) -> None:
        self._t, self._filled = t, 0
        self._columns: dict[str, Any] = {}
        self._names: tuple[str, ...] = ()
        self._tables: list[Innovations] = []
        self._events: list[EventRow] = []

    def add(self, solution: NavSolution) -> None:
        """Take the answers that come next; a filter that knows nothing yet has none."""
        if not (len(solution) or solution.extra_names):
            return
        if not self._columns:
            self._names = solution.extra_names
            for f in fields(solution):
                column = getattr(solution, f.name)
                if isinstance(column, np.ndarray):
                    self._columns[f.name] = disk_arrays.empty((len(self._t), *column.shape[1:]))
        end = self._filled + len(solution)
        for name, column in self._columns.items():
            column[self._filled : end] = getattr(solution, name)
        self._filled = end
        if len(solution.innovations.t):
            self._tables.append(solution.innovations)
        self._events += solution.events.rows()

    def solution(self, more: Iterable[EventRow] = ()) -> NavSolution:
        """Return all of it, with more events."""
        return NavSolution(
            **self._columns,
            extra_names=self._names,
            innovations=join_tables(self._tables),
            events=Events.from_rows(join_events([*self._events, *more])),
        )
