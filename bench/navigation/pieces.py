"""A filter that takes a record in pieces, of a hundredth of a second or an hour, and ends as on the whole.

A measurement arrives after the instant it is valid at. A filter that has gone past that instant cannot
compare it with its state there. So it takes a piece up to ``look_back`` before its last sample and leaves
the rest of the samples waiting. What it is asked between goes over these on a copy and leaves no trace.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from bench.arrays import BoolArray, FloatArray
from bench.data import (
    EventRow,
    GnssFixes,
    GnssObservations,
    ImuData,
    InitialState,
    NavSolution,
    SensorData,
)
from bench.errors import EstimatorError
from bench.instruments import INSTRUMENTS
from bench.navigation import alignment
from bench.navigation.in_pieces import InPieces, RunsInPieces
from bench.navigation.waiting import columns, join_rows, take_observations, take_rows
from bench.specs import AssumedSpecs

_SETTLED = 2.0  # time after an alignment until which the record may still change it [s]


class PieceFilter:
    """A filter on its way through a record; `bench.open_filter` makes one.

    Parameters
    ----------
    use : str
        Its name, for messages.
    options : mapping
        Its options, as they were given.
    estimator : object
        The estimator, one that has `bench.navigation.in_pieces.RunsInPieces`.
    initial : InitialState
        Start. Where its alignment is not "given", the filter waits until the pieces allow it.
    look_back : float
        Longest time from the validity of a measurement to its arrival [s].

    Raises
    ------
    EstimatorError
        If the estimator cannot run in pieces with these options.
    """

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
        self.head: SensorData | None = None
        self.waiting: SensorData | None = None  # until the start is known
        self.tried = -np.inf  # last sample when it was looked for last [s]
        self.start: InitialState | None = None  # that was found
        self.passage: InPieces | None = None
        self.finished = False

    @property
    def t(self) -> float:
        """Instant of the last IMU sample that was taken [s]."""
        if self.passage is not None:
            return self.passage.end
        return self.initial.t if self.waiting is None else _newest(self.waiting)

    def feed(self, piece: SensorData) -> NavSolution:
        """Take the next piece of the record.

        Parameters
        ----------
        piece : SensorData
            The IMU samples of the next stretch, all measurements that arrived during it, and in ``output_t``
            the instants of it at which an answer is wanted. A boundary may fall anywhere. The first piece
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
            If the piece does not follow on those before, something comes later than ``look_back`` allows, or
            the IMU was silent for longer than can be bridged. The filter is then as before the piece.
        """
        if self.finished:
            raise EstimatorError(f"{self.use!r} is finished: open another filter, or resume a saved one")
        after = self._copy()
        after._check(piece)
        solution = after._take(piece, last=False)
        self.__dict__.update(after.__dict__)
        return solution

    def answer(self) -> NavSolution:
        """Return state and covariance at the last IMU sample, by all that has arrived; no bit changes.

        One row; NaN while the start is not known. It is the answer of the whole record, were this its end.
        """
        if self.passage is None:
            return _nothing(np.array([self.t]))
        assert self.head is not None
        return self.passage.copy().answer(self.head)

    def finish(self) -> NavSolution:
        """Return the answers that are left; nothing comes any more.

        Raises
        ------
        EstimatorError
            If the record ends before the alignment that was asked for.
        """
        if self.head is None:
            raise EstimatorError(f"{self.use!r} has been given nothing: feed a piece first")
        solution = self._take(self.head, last=True)
        self.finished = True
        return solution

    def state(self) -> dict[str, Any]:
        """Return all that the filter carries, as arrays, numbers and words by name; no options or datasheets.

        Raises
        ------
        EstimatorError
            If it has been given no piece.
        """
        if self.head is None:
            raise EstimatorError(f"{self.use!r} has been given nothing to save: feed a piece first")
        return {
            "look_back": self.look_back,
            "finished": self.finished,
            "initial": columns(self.initial),
            "head": _plain(self.head),
            "waiting": None if self.waiting is None else _plain(self.waiting),
            "start": None if self.start is None else columns(self.start),
            "passage": None if self.passage is None else self.passage.state(),
        }

    @classmethod
    def restore(
        cls,
        use: str,
        options: Mapping[str, Any],
        estimator: object,
        specs: AssumedSpecs,
        state: Mapping[str, Any],
    ) -> PieceFilter:
        """Return the filter of :meth:`state`, with its estimator and the datasheets it assumes."""
        found = cls(use, options, estimator, InitialState(**state["initial"]), state["look_back"])
        found.head, found.finished = _unplain(state["head"], specs), state["finished"]
        if state["waiting"] is not None:
            found.waiting = _unplain(state["waiting"], specs)
        if state["passage"] is not None:
            found.start = InitialState(**state["start"])
            found.passage = found.estimator.in_pieces(found.head, found.start, [])
            found.passage.restore(state["passage"])
        return found

    def _check(self, piece: SensorData) -> None:
        """Check that a piece has the sensors of the first."""
        if self.head is None:
            self.head = _head(piece)
            return
        head = self.head
        have, has = _records(head), _records(piece)
        if have.keys() != has.keys():
            raise EstimatorError(
                f"the piece holds {', '.join(has) or 'no aiding'}, the first {', '.join(have) or 'none'}; "
                "a sensor that is silent is a record without rows"
            )
        if not (head.date == piece.date and head.ground_alt == piece.ground_alt):
            raise EstimatorError("ground height and date must be those of the first piece")
        if head.specs != without_orbits(piece.specs):
            raise EstimatorError("the datasheets assumed must be those of the first piece")
        if not np.array_equal(head.antenna_b, piece.antenna_b):
            if self.passage is None:
                raise EstimatorError(
                    f"{self.use!r} cannot go over to another antenna before it has found its start"
                )
            self.head = replace(head, antenna_b=piece.antenna_b)

    def _copy(self) -> PieceFilter:
        """Return a filter that goes on from here by itself."""
        copy = PieceFilter(self.use, self.options, self.estimator, self.initial, self.look_back)
        copy.head, copy.waiting, copy.finished = self.head, self.waiting, self.finished
        copy.tried, copy.start = self.tried, self.start
        copy.passage = None if self.passage is None else self.passage.copy()
        return copy

    def _take(self, piece: SensorData, *, last: bool) -> NavSolution:
        """Take a piece; of the ``last`` one all answers are final."""
        if self.passage is None:
            self.waiting = piece if self.waiting is None else join_pieces(self.waiting, piece)
            begun = self._begin(self.waiting, last)
            if begun is None:
                return _nothing(np.empty(0))
            self.passage, piece, self.waiting = begun, self.waiting, None
        return self.passage.feed(piece, self.look_back, last=last)

    def _begin(self, record: SensorData, last: bool) -> InPieces | None:
        """Return the filter at its start, None while the record may still change that."""
        initial, events = self.initial, list[EventRow]()
        if initial.alignment == "given" or getattr(self.estimator, "finds_start", False):
            self.start = initial
            return self.estimator.in_pieces(record, initial, events)
        newest = _newest(record)
        enough = self.tried + _SETTLED
        if initial.alignment == "level":
            enough = initial.t + initial.align_for + _SETTLED + self.look_back
        if not last and newest < enough:
            return None
        self.tried = newest
        try:
            initial, events = alignment.complete(record, initial)
        except EstimatorError:
            if last or initial.alignment == "level":
                raise
            return None
        if not last and newest < initial.t + _SETTLED + self.look_back:
            return None
        self.start = initial
        return self.estimator.in_pieces(record, initial, events)


def _newest(record: SensorData) -> float:
    t = record.imu.t[np.isfinite(record.imu.t)]
    return float(t.max(initial=-np.inf))


def _nothing(t: FloatArray) -> NavSolution:
    """Return a solution that knows nothing at instants t (M,)."""
    none = np.full((len(t), 9, 9), np.nan)
    three, four = none[:, 0, :3], none[:, 0, :4]
    return NavSolution(t, three, three, four, three, three, none, (), none[:, 0, :0], none[:, 0, :0])


def _records(sensors: SensorData) -> dict[str, Any]:
    """Return the aiding records, by name."""
    found = {"fixes": sensors.fixes, "observations": sensors.observations}
    return {name: record for name, record in found.items() if record is not None} | sensors.instruments


def _plain(sensors: SensorData) -> dict[str, Any]:
    """Return a piece of a record by name, without the datasheets."""
    whole = {name: getattr(sensors, name) for name in ("antenna_b", "output_t", "ground_alt", "date")}
    records = {name: columns(record) for name, record in _records(sensors).items()}
    return whole | {"imu": columns(sensors.imu), "records": records}


def _unplain(plain: Mapping[str, Any], specs: AssumedSpecs) -> SensorData:
    """Return the piece that :func:`_plain` was given."""
    kinds = {"fixes": GnssFixes, "observations": GnssObservations}
    kinds |= {name: instrument.record for name, instrument in INSTRUMENTS.items()}
    records: dict[str, Any] = {"fixes": None}
    records |= {name: kinds[name](**one) for name, one in plain["records"].items()}
    whole = {name: plain[name] for name in ("antenna_b", "output_t", "ground_alt", "date")}
    return SensorData(imu=ImuData(**plain["imu"]), specs=specs, **whole, **records)


def without_orbits(specs: Any) -> Any:
    """Return datasheets without the true orbits of a sky, which no filter knows."""
    if specs.gnss is None or specs.gnss.sky is None:
        return specs
    return replace(specs, gnss=replace(specs.gnss, sky=replace(specs.gnss.sky, gps=None, glonass=None)))


def _head(piece: SensorData) -> SensorData:
    """Return a piece without rows."""
    return replace(take_piece(piece, np.inf, np.inf), specs=without_orbits(piece.specs))


def take_piece(record: SensorData, begin: float, end: float) -> SensorData:
    """Return what came after an instant and until another [s]: the piece that a filter is fed next.

    IMU samples and wanted answers by their time, measurements by their arrival.
    """

    def inside(t: FloatArray) -> BoolArray:
        found: BoolArray = (t > begin) & (t <= end)
        return found

    cut: dict[str, Any] = {}
    for name, one in _records(record).items():
        rows = inside(one.t_arrival)
        observed = isinstance(one, GnssObservations)
        cut[name] = take_observations(one, rows) if observed else take_rows(one, rows)
    imu, output_t = record.imu, record.output_t
    return replace(record, imu=take_rows(imu, inside(imu.t)), output_t=output_t[inside(output_t)], **cut)


def join_pieces(first: SensorData, second: SensorData) -> SensorData:
    """Return two pieces of a record as one."""
    joined: dict[str, Any] = {
        name: join_rows(one, getattr(second, name)) for name, one in _records(first).items()
    }
    output_t = np.append(first.output_t, second.output_t)
    return replace(first, imu=join_rows(first.imu, second.imu), output_t=output_t, **joined)
