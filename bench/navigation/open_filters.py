"""Filter for a record in pieces of any length, with the same result as for the whole record.

A measurement arrives later than its time of validity, and a filter that has passed that time can no longer
compare it with its state. So the filter processes a piece only up to ``look_back`` before its last sample;
the rest of the samples wait. An answer between pieces processes these on a copy.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import same_array
from bench.core.records.data import EventRow, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.words.exceptions import EstimatorError
from bench.core.words.wording import one_line
from bench.navigation.engine.piecewise import InPieces, RunsInPieces
from bench.navigation.engine.record_cuts import (
    aiding_records,
    join_pieces,
    newest_sample,
    nothing_known,
    take_head,
    without_orbits,
)
from bench.navigation.engine.session import Kept, Replaced, SessionState, rebuild
from bench.navigation.estimator import accept
from bench.navigation.start import alignment

_LONGEST = 200  # characters of an error in a message


class PieceFilter(SessionState):
    """Filter that processes a record in pieces; `bench.open_filter` returns it.

    Parameters
    ----------
    use : str
        Its name, for messages.
    options : mapping
        Its options, as they were given.
    estimator : object
        The filter, one that has `piecewise.RunsInPieces`.
    initial : InitialState
        Start. Where its alignment is not "given", the filter waits until the pieces allow it.
    look_back : float
        Longest time from the validity of a measurement to its arrival [s].

    Raises
    ------
    EstimatorError
        If the filter cannot run in pieces with these options.
    """

    look_back: Kept[float]
    finished: Kept[bool]
    initial: Replaced[InitialState]
    head: Replaced[SensorData | None]
    waiting: Replaced[SensorData | None]  # until the start is known
    search: Kept[alignment.StartSearch]
    start: Replaced[InitialState | None]  # that was found
    passage: Kept[InPieces | None]

    def __init__(
        self,
        use: str,
        options: Mapping[str, Any],
        estimator: object,
        initial: InitialState,
        look_back: float,
    ) -> None:
        if not (np.isfinite(look_back) and look_back >= 0):
            raise EstimatorError(f"look_back = {look_back!r} must be 0 or more, in seconds")
        if not isinstance(estimator, RunsInPieces):
            raise EstimatorError(
                f"{use!r} cannot run in pieces: it has no method in_pieces; all built-in filters have one, "
                "smoothers do not"
            )
        self.use, self.options, self.estimator = use, options, estimator
        self.initial, self.look_back = initial, look_back
        self.head, self.waiting, self.start, self.passage = None, None, None, None
        self.search, self.finished = alignment.StartSearch(initial), False
        self.resumed_from = ""  # the file, if it goes on from a saved state

    @property
    def t(self) -> float:
        """Time of the last processed IMU sample [s]."""
        if self.passage is not None:
            return self.passage.end
        return self.initial.t if self.waiting is None else newest_sample(self.waiting)

    def update(self, piece: SensorData) -> NavSolution:
        """Take the next piece of the record.

        Parameters
        ----------
        piece : SensorData
            The IMU samples of the next segment, all measurements that arrived during it, and in ``output_t``
            the epochs of it at which an answer is wanted. A boundary may fall anywhere. The first piece
            says which sensors there are: one that has said nothing yet is a record without rows. A receiver
            that has gone over to another antenna gives its fixes from then on in a piece with another
            ``antenna_b``; those of earlier pieces that still wait keep theirs.

        Returns
        -------
        NavSolution
            The answers wanted that nothing can change any more, of this piece and earlier ones, with the
            innovations and events since the last piece. Of all pieces together, and of :meth:`finish`, they
            are the solution that ``run`` gives of the whole record, bit for bit.

        Raises
        ------
        EstimatorError
            If the piece does not follow on those before, or something comes later than ``look_back`` allows.
            The filter is then as before the piece.
        """
        after = self.copy()
        solution = after.advance(piece)
        self.__dict__.update(after.__dict__)
        return solution

    def advance(self, piece: SensorData) -> NavSolution:
        """Take the next piece as :meth:`update` does; after an error the filter is of no further use."""
        if self.finished:
            raise EstimatorError(f"{self.use!r} is finished: open another filter, or resume a saved one")
        with self._doubt_the_file():
            self._check(piece)
            return self._take(piece, last=False)

    def current(self) -> NavSolution:
        """Return state and covariance at the last IMU sample from all data so far; the filter is unchanged.

        One row; NaN while the start is not known. It is the answer of the whole record, were this its end.
        """
        if self.passage is None:
            return nothing_known(np.array([self.t]))
        assert self.head is not None
        with self._doubt_the_file():
            return self._accept(self.passage.copy().current(self.head))

    def finish(self) -> NavSolution:
        """Return the rest of the solution at the end of the data.

        Raises
        ------
        EstimatorError
            If the record ends before the alignment that was asked for.
        """
        if self.head is None:
            raise EstimatorError(f"{self.use!r} has no data yet: call update() first")
        with self._doubt_the_file():
            solution = self._take(self.head, last=True)
        self.finished = True
        return solution

    def state(self) -> dict[str, Any]:
        """Return the state of the filter as arrays, numbers and words by name, without options or datasheets.

        Raises
        ------
        EstimatorError
            If it has been given no piece.
        """
        if self.head is None:
            raise EstimatorError(f"{self.use!r} no data to save yet: call update() first")
        return super().state()

    @classmethod
    def resume(
        cls,
        use: str,
        options: Mapping[str, Any],
        estimator: object,
        specs: AssumedSpecs,
        state: Mapping[str, Any],
        path: str,
    ) -> PieceFilter:
        """Return the filter of :meth:`state`, with its estimator and the datasheets it assumes.

        Whatever it raises: the state in the file ``path`` is none of this filter.
        """
        initial = rebuild(InitialState, state["initial"], place="initial")
        found = cls(use, options, estimator, initial, rebuild(float, state["look_back"], place="look_back"))
        found.resumed_from = path
        found.restore(state, specs=specs)
        return found

    def make_parts(self) -> None:
        """Make the filter before its first piece, if it has begun."""
        self.passage = None
        if self.start is not None:
            assert self.head is not None
            self.passage = self.estimator.in_pieces(self.head, self.start, [])

    @contextmanager
    def _doubt_the_file(self) -> Iterator[None]:
        """Add the name of the saved state to errors that it may have caused."""
        try:
            yield
        except EstimatorError:
            raise
        except Exception as error:
            if not self.resumed_from:
                raise
            why = one_line(repr(error))[:_LONGEST]
            raise EstimatorError(
                f"{self.resumed_from}: {self.use!r} cannot go on from this state: {why}"
            ) from error

    def _check(self, piece: SensorData) -> None:
        """Check that a piece has the sensors of the first."""
        if self.head is None:
            self.head = take_head(piece)
            return
        head = self.head
        have, has = aiding_records(head), aiding_records(piece)
        if have.keys() != has.keys():
            raise EstimatorError(
                f"the piece holds {', '.join(has) or 'no aiding'}, the first {', '.join(have) or 'none'}; "
                "a sensor that is silent is a record without rows"
            )
        if not (head.date == piece.date and head.ground_alt == piece.ground_alt):
            raise EstimatorError("ground height and date must equal those in the first piece")
        if head.specs != without_orbits(piece.specs):
            raise EstimatorError("the assumed datasheets must equal those in the first piece")
        if not same_array(head.antenna_b, piece.antenna_b):
            if self.passage is None:
                raise EstimatorError(
                    f"{self.use!r} cannot change to another antenna before its alignment has ended"
                )
            self.head = replace(head, antenna_b=piece.antenna_b)

    def _take(self, piece: SensorData, *, last: bool) -> NavSolution:
        """Process a piece; after the ``last`` piece the whole solution is final."""
        if self.passage is None:
            self.waiting = piece if self.waiting is None else join_pieces(self.waiting, piece)
            begun = self._begin(self.waiting, last)
            if begun is None:
                return nothing_known(np.empty(0))
            self.passage, piece, self.waiting = begun, self.waiting, None
        return self._accept(self.passage.update(piece, self.look_back, last=last))

    def _accept(self, found: NavSolution) -> NavSolution:
        """Return a solution, checked if the filter is user code."""
        return accept(self.use, found) if ":" in self.use else found

    def _begin(self, record: SensorData, last: bool) -> InPieces | None:
        """Return the filter at its start; None while more data may change the start."""
        initial, events = self.initial, list[EventRow]()
        if initial.alignment != "given" and not getattr(self.estimator, "finds_start", False):
            found = self.search.find(record, self.look_back, last=last)
            if found is None:
                return None
            initial, events = found
        self.start = initial
        return self.estimator.in_pieces(record, initial, events)
