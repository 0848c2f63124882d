"""What an estimator must offer to run in pieces, as `bench.navigation.pieces.PieceFilter` asks it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, replace
from typing import Any, Protocol, Self, runtime_checkable

import numpy as np

from bench.data import EventRow, InitialState, NavSolution, SensorData
from bench.errors import EstimatorError
from bench.navigation.timeline import LONGEST_BRIDGE


class InPieces(Protocol):
    """A filter on its way through a record that comes in pieces."""

    @property
    def end(self) -> float:
        """Instant of the last IMU sample taken, or of the start [s]."""
        ...

    def feed(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Take the next piece; return the answers that nothing can change any more.

        Parameters
        ----------
        piece : SensorData
            IMU samples and instants wanted by their time, measurements by their arrival.
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

    def answer(self, head: SensorData) -> NavSolution:
        """Return state and covariance at :attr:`end`, were that the end of the record: one row.

        It may use up what it goes over: it is asked of a copy. ``head`` is a piece without rows.
        """
        ...

    def copy(self) -> Self:
        """Return a filter that goes on from here by itself."""
        ...

    def state(self) -> dict[str, Any]:
        """Return what is carried from one piece to the next, as arrays, numbers and words by name."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what :meth:`state` returned."""
        ...


@runtime_checkable
class RunsInPieces(Protocol):
    """An estimator that runs in pieces.

    Its ``run`` on the whole record gives the same bits. An attribute ``finds_start = True`` is optional: the
    estimator takes a start that is not told as it is, and needs no alignment.
    """

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece.

        Parameters
        ----------
        first : SensorData
            Its records say which sensors there are, and its datasheets are those assumed.
        initial : InitialState
            Start; complete, unless the estimator finds it by itself.
        events : list of (t, t_end, kind, text)
            What went before.

        Raises
        ------
        EstimatorError
            If it cannot run in pieces from this start.
        """
        ...


def answer_now(filter_: InPieces, head: SensorData) -> NavSolution:
    """Return the last of the answers to a record that ends with what a filter has taken."""
    solution = filter_.feed(replace(head, output_t=np.array([filter_.end])), 0.0, last=True)
    columns = {f.name: getattr(solution, f.name) for f in fields(solution)}
    columns = {name: one[-1:] for name, one in columns.items() if isinstance(one, np.ndarray)}
    return replace(solution, **columns)


def refuse_gap(longest: float) -> None:
    """Raise the error of a gap in the IMU record [s] after which a filter with fixes starts again.

    Raises
    ------
    EstimatorError
    """
    if longest > LONGEST_BRIDGE:
        raise EstimatorError(
            f"it cannot run in pieces over a gap of {longest:.3g} s in the IMU record, after which it starts "
            f"again; up to {LONGEST_BRIDGE:g} s are bridged: open another behind it"
        )


def refuse(what: str, t: float, reached: float) -> None:
    """Raise the error of what comes after the filter has gone on.

    Raises
    ------
    EstimatorError
    """
    raise EstimatorError(
        f"{what} for {t:.6g} s comes when the filter has gone on to {reached:.6g} s; "
        "open it with a longer look_back"
    )
