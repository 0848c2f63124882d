"""Protocol of a filter that runs in pieces, as `bench.navigation.open_filters.PieceFilter` requires."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import (
    EventRow,
    Events,
    InitialState,
    Innovations,
    NavSolution,
    SensorData,
    no_innovations,
)
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.kept_rows import columns
from bench.navigation.engine.timeline import TIME_TOLERANCE

_COUNTED = re.compile(r"(\w+): (\d+) (.*)")
"""Text of an event that counts rows of a record."""


class InPieces(Protocol):
    """Filter that processes a record in pieces."""

    @property
    def end(self) -> float:
        """Time of the last processed IMU sample, or of the start [s]."""
        ...

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Process the next piece; return the solution at the epochs that later data cannot change.

        Parameters
        ----------
        piece : SensorData
            IMU samples and epochs wanted by their time, measurements by their arrival.
        look_back : float
            Longest time from the validity of a measurement to its arrival [s].
        last : bool
            Nothing comes after it: all answers that are left are final.

        Returns
        -------
        NavSolution
            With the innovations and events since the piece before.

        Raises
        ------
        EstimatorError
            If it cannot go on with this piece.
        """
        ...

    def current(self, head: SensorData) -> NavSolution:
        """Return the solution at :attr:`end` as if the record ended there, in one row.

        It may change the filter: callers ask a copy. ``head`` is a piece without rows.
        """
        ...

    def copy(self) -> Self:
        """Return an independent filter in the same state."""
        ...

    def state(self) -> dict[str, Any]:
        """Return the state between two pieces, as arrays, numbers and words by name."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what :meth:`state` returned."""
        ...


class KnowsImuErrors(InPieces, Protocol):
    """Filter with states for errors that add to the biases of the IMU."""

    def steady_errors(self) -> tuple[FloatArray, FloatArray]:
        """Return the errors (6,) of gyros and accelerometers at the end in level flight, and their sd."""
        ...


class MayLoseHeading(InPieces, Protocol):
    """Filter with a linear heading error that detects when this error is too large."""

    @property
    def heading_lost_at(self) -> float | None:
        """Time of the first GNSS measurement in motion with an unknown heading [s]; None before it."""
        ...

    @property
    def heading_vague(self) -> bool:
        """Whether the heading is too uncertain for one linear filter, and may be lost soon."""
        ...


@runtime_checkable
class RunsInPieces(Protocol):
    """A filter that runs in pieces.

    Its ``run`` on the whole record gives the same bits. An attribute ``finds_start = True`` is optional: the
    filter takes an incomplete start and does its own alignment.
    """

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece.

        Parameters
        ----------
        first : SensorData
            Its records say which sensors there are, and its datasheets are those assumed.
        initial : InitialState
            Start; complete, unless the filter does its own alignment.
        events : list of (t, t_end, kind, text)
            What went before.

        Raises
        ------
        EstimatorError
            If it cannot run in pieces from this start.
        """
        ...


def answer_now(filter_: InPieces, head: SensorData) -> NavSolution:
    """Return the solution at the end of the data that a filter has processed."""
    solution = filter_.update(replace(head, output_t=np.array([filter_.end])), 0.0, last=True)
    return solution if len(solution) == 1 else take_answers(solution, slice(-1, None))


def take_answers(solution: NavSolution, rows: slice) -> NavSolution:
    """Return selected epochs of a solution, with all innovations and events."""
    found: dict[str, Any] = {f.name: getattr(solution, f.name) for f in fields(solution)}
    found = {name: one[rows] for name, one in found.items() if isinstance(one, np.ndarray)}
    return replace(solution, **found)


def take_after(answered: float, told: float, solution: NavSolution) -> NavSolution:
    """Return a solution after one time, with innovations and events after another time [s]."""
    if np.isfinite(answered):
        solution = take_answers(solution, slice(int(np.searchsorted(solution.t, answered, "right")), None))
    table = solution.innovations
    kept = table.t > told + TIME_TOLERANCE
    if not kept.all():
        rest = {name: one[kept] for name, one in columns(table).items() if name != "sensor"}
        solution = replace(solution, innovations=replace(table, **rest))
    events = [row for row in solution.events.rows() if row[1] > told + TIME_TOLERANCE]
    return replace(solution, events=Events.from_rows(events))


def join_solutions(parts: list[NavSolution]) -> NavSolution:
    """Join successive solutions with the same states and sensors."""
    parts = [one for one in parts if len(one) or one.extra_names] or parts[:1]  # others know nothing yet
    if len(parts) == 1:
        return parts[0]
    joined = JoinedSolution(sum(map(len, parts)))
    for one in parts:
        joined.add(one)
    return joined.solution()


class JoinedSolution:
    """Successive solutions as one with ``count`` epochs, on disk if there are many."""

    def __init__(self, count: int) -> None:
        self._count, self._filled = count, 0
        self._columns: dict[str, Any] = {}
        self._names: tuple[str, ...] = ()
        self._tables: list[Innovations] = []
        self._events: list[EventRow] = []

    def add(self, solution: NavSolution) -> None:
        """Append the next part of the solution; a filter that has not started yet has none."""
        if not (len(solution) or solution.extra_names):
            return
        if not self._columns:
            self._names = solution.extra_names
            for f in fields(solution):
                column = getattr(solution, f.name)
                if isinstance(column, np.ndarray):
                    self._columns[f.name] = disk_arrays.empty((self._count, *column.shape[1:]))
        end = self._filled + len(solution)
        for name, column in self._columns.items():
            column[self._filled : end] = getattr(solution, name)
        self._filled = end
        if len(solution.innovations):
            self._tables.append(solution.innovations)
        self._events += solution.events.rows()

    def solution(self, more: Iterable[EventRow] = ()) -> NavSolution:
        """Return the whole solution, with additional events."""
        return NavSolution(
            **self._columns,
            extra_names=self._names,
            innovations=join_tables(self._tables),
            events=Events.from_rows(join_events([*self._events, *more])),
        )


def join_tables(tables: list[Innovations]) -> Innovations:
    """Join successive innovation tables."""
    if not tables:
        return no_innovations()
    joined: dict[str, Any] = {}
    count = sum(len(table.t) for table in tables)
    for f in fields(Innovations):
        if f.name != "sensor":
            parts = [getattr(table, f.name) for table in tables]
            joined[f.name] = disk_arrays.empty(count, parts[0].dtype.type)
            np.concatenate(parts, out=joined[f.name])
    return Innovations(sensor=tables[0].sensor, **joined)


def join_events(rows: list[EventRow]) -> list[EventRow]:
    """Join the events of parts of a record; counts of the same kind are added."""
    found: list[EventRow] = []
    counts: dict[tuple[str, str, str, str], tuple[float, float, int]] = {}
    for row in rows:
        t, t_end, kind, text, *sensor = row
        match = _COUNTED.fullmatch(text) if kind == "timeline" else None
        if match is None:
            found.append(row)
            continue
        name, number, what = match.groups()
        key = (kind, name, what, "".join(sensor))
        first, last, count = counts.get(key, (np.inf, -np.inf, 0))
        counts[key] = min(t, first), max(t_end, last), count + int(number)
    for (kind, name, what, of), (first, last, count) in counts.items():
        found.append((first, last, kind, f"{name}: {count} {what}", of))
    return found


def refuse(what: str, t: float, reached: float) -> None:
    """Raise the error for data that arrive too late, after the filter has moved on.

    Raises
    ------
    EstimatorError
    """
    raise EstimatorError(
        f"{what} for {t:.6g} s comes when the filter has gone on to {reached:.6g} s; "
        "open it with a longer look_back"
    )
