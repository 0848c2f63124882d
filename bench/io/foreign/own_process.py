"""Run the filter classes of others in processes of their own: ``use = "module:Class"``.

Sensors, datasheets and the start go in; the solution comes out. A filter keeps its process from one run to
the next, with a new instance of its class for each. It is started again after a limit, a crash, or a change
of its files. That guards against accidents. With a confined guard it may open no files but its own, on Linux.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, Self

import numpy as np

from bench.core.files.spawned import Printed
from bench.core.records.data import EventRow, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.io.foreign.filter_process import FilterProcess, pack_specs, take_process

_LEAST = 60.0  # time to start a process and import a module [s]


class OwnProcessEstimator:
    """A filter with its class in another process.

    Parameters
    ----------
    choice : EstimatorChoice
        ``module:Class``, its options and its guard. It is built in its process meanwhile: ask nothing of it
        before :meth:`wait`.

    Raises
    ------
    EstimatorError
        If an option cannot be sent.
    """

    def __init__(self, choice: EstimatorChoice) -> None:
        self._choice = choice
        try:
            self._options = pickle.dumps(dict(choice.options))
        except Exception as error:
            raise EstimatorError(
                f"filter {choice.label!r}: its options cannot be sent to its process: {error}; "
                "Guard(in_process=True) runs it here"
            ) from None
        self.needs: tuple[str, ...] = ()
        self.finds_start = False
        self._printed = Printed()
        self.cpu_s = 0.0
        """CPU time of the last run [s]."""
        self._process = self._start()

    def __reduce__(self) -> tuple[Callable[..., Any], tuple[Any, ...]]:
        return open_estimator, (self._choice,)

    @property
    def printed(self) -> str:
        """Return the text printed since the filter was built."""
        return self._printed.text

    def wait(self) -> Self:
        """Wait until the filter is built, and return it.

        Raises
        ------
        EstimatorError, EstimatorFailedError
            If there is no such class, or it cannot be built with these options.
        """
        built = self._process.collect()
        self._held, self._process.files = _Held(self._process, built["number"]), built["files"]
        self.needs, self.finds_start = tuple(built["needs"]), built["finds_start"]
        self.confined = built["confined"]
        offered: dict[str, Any] = {
            "in_pieces": self._begin,
            "check_sensors": self._refuse,
            "unmodeled_errors": self._list_unmodeled,
            "identity": self._identify,
        }
        for name in built["offers"]:
            setattr(self, name, offered[name])
        return self

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Run a new instance; return its solution.

        Raises
        ------
        EstimatorError, EstimatorFailedError
            What it raised, or why its process was ended.
        """
        process = self._ready()
        begun = process.cpu_s
        seconds = self._choice.guard.choose_timeout(sensors.duration_from(initial.t))
        try:
            process.assume(self._choice.label, self._limit, sensors.specs)
            found: NavSolution = self._ask("run", seconds, sensors=sensors, initial=initial)
        finally:
            self.cpu_s = process.cpu_s - begun
        return replace(found)  # checked once more, here

    def close(self) -> None:
        """End the process; the next run starts another."""
        self._process.close()

    def _refuse(self, specs: AssumedSpecs) -> str:
        self._ready()
        found: str = self._ask("check_sensors", self._limit, specs=pack_specs(specs))
        return found

    def _list_unmodeled(self, specs: AssumedSpecs) -> list[str]:
        found: list[str] = self._ask("unmodeled_errors", self._limit, specs=pack_specs(specs))
        return found

    def _identify(self, sensors: SensorData) -> str:
        """Return the identity of the filter in words: equal identities of a class give equal solutions."""
        try:
            self._ready().assume(self._choice.label, self._limit, sensors.specs)
            found = self._ask("identity", self._limit, sensors=sensors)
        except EstimatorFailedError:
            return f"{self._choice.label}: not known"  # its results are kept all the same
        return f"{self._choice.use} {found}"

    def _begin(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> RemotePassage:
        process = self._ready()
        process.assume(self._choice.label, self._limit, first.specs)
        found = self._ask("begin", self._limit, first=first, initial=initial, events=events)
        seconds = self._choice.guard.choose_timeout()
        return RemotePassage(_Held(process, found["number"]), self._choice.label, seconds, found["end"])

    @property
    def _limit(self) -> float:
        """Limit on the wall time of requests without a flight [s], generous for a busy machine."""
        return max(_LEAST, self._choice.guard.choose_timeout())

    def _start(self) -> FilterProcess:
        """Return the process of the filter, after requesting it to build the filter."""
        process = take_process(self._choice, self._options)
        process.printed = self._printed
        options = np.frombuffer(self._options, np.uint8)
        given = {"use": self._choice.use, "options": options, "home": str(process.home or "")}
        process.post(self._choice.label, "open", self._limit, label=self._choice.label, **given)
        return process

    def _ready(self) -> FilterProcess:
        """Return the process of the filter; start it again if it has ended."""
        if not self._process.usable:
            self._process = self._start()
            self.wait()
        return self._process

    def _ask(self, do: str, seconds: float, **given: Any) -> Any:
        return self._process.ask(self._choice.label, do, seconds, number=self._held.number, **given)


class _Held:
    """Object that the process of a filter stores under a number until it is released."""

    def __init__(self, process: FilterProcess, number: int) -> None:
        self.process, self.number = process, number

    def __del__(self) -> None:
        self.process.forgotten.append(self.number)


class RemotePassage:
    """A filter for a record in pieces, in its own process.

    It is a `bench.navigation.engine.piecewise.InPieces`. The process keeps what it carries; each piece
    makes another of it, so that a copy costs nothing. It ends with its process.
    """

    def __init__(self, held: _Held, label: str, seconds: float, end: float) -> None:
        self._held, self._label, self._seconds, self.end = held, label, seconds, end

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Process the next piece."""
        self._held.process.assume(self._label, self._seconds, piece.specs)
        found = self._ask("update", piece=piece, look_back=look_back, last=last)
        self._move(found)
        solution: NavSolution = found["solution"]
        return solution

    def current(self, head: SensorData) -> NavSolution:
        """Return state and covariance at :attr:`end`."""
        self._held.process.assume(self._label, self._seconds, head.specs)
        solution: NavSolution = self._ask("ask", head=head)
        return solution

    def copy(self) -> RemotePassage:
        """Return an independent filter in the same state."""
        return RemotePassage(self._held, self._label, self._seconds, self.end)

    def state(self) -> dict[str, Any]:
        """Return the state between two pieces."""
        found: dict[str, Any] = self._ask("state")
        return found

    def restore(self, state: Mapping[str, Any]) -> None:
        """Restore the state that :meth:`state` returned."""
        self._move(self._ask("restore", state=dict(state)))

    def _ask(self, do: str, **given: Any) -> Any:
        return self._held.process.ask(self._label, do, self._seconds, number=self._held.number, **given)

    def _move(self, found: Mapping[str, Any]) -> None:
        self._held, self.end = _Held(self._held.process, found["number"]), found["end"]


def open_estimator(choice: EstimatorChoice) -> OwnProcessEstimator:
    """Return a filter class of others, built in its process; errors as for `OwnProcessEstimator.wait`."""
    return OwnProcessEstimator(choice).wait()
