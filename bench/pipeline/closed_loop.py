"""Closed loop of navigation and guidance: a flight guided by an estimate, and this estimate.

The flight gives its truth piece by piece. The sensors measure each piece, the filter processes the arrived
data, and guidance uses its answer (`guidance.belief`). Sensors and filter are the same as in a recorded
flight: `replay` gives the same answers from the truth that was flown, bit for bit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from bench.core.records.data import (
    AirData,
    EventRow,
    Events,
    InitialState,
    NavSolution,
    SensorData,
    Trajectory,
    no_events,
    no_innovations,
)
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import ShowFlight
from bench.core.records.sensor_specs import SensorsSpec
from bench.core.records.specs import CLIENT, Guidance, Profile
from bench.core.words.exceptions import ConfigError, EstimatorError, EstimatorFailedError
from bench.core.words.wording import one_line
from bench.evaluation.errors.failures import FAILED, describe_error
from bench.io.foreign.loading import load_estimators
from bench.io.results import cached_truth, join_pieces
from bench.navigation.engine.kept_rows import join_rows, take_rows
from bench.navigation.engine.piecewise import join_events, join_solutions, join_tables
from bench.navigation.engine.record_cuts import aiding_records, arrivals
from bench.navigation.engine.timeline import TIME_TOLERANCE
from bench.navigation.estimator import make_failure
from bench.navigation.open_filters import PieceFilter
from bench.simulation.flight.guidance.belief import Belief, NavEstimate
from bench.simulation.flight.guidance.steering import Commanded, Commands
from bench.simulation.sensors import SensedPiece, sense_piece
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals.terrain import ground_at


@dataclass(frozen=True, slots=True)
class ClosedFlight:
    """Result of a flight guided by an estimate."""

    truth: Trajectory
    answers: NavSolution  # that steered, in real time: by what had arrived


@dataclass(frozen=True, slots=True)
class ServedFlight:
    """Result of a flight with a client."""

    truth: Trajectory
    answers: NavSolution | None  # of the client, if it gave any
    ended: str  # why the client did not fly to the end; empty if it did


class Deliveries:
    """Sensor rows that are measured but have not yet arrived."""

    def __init__(self) -> None:
        self._waiting: dict[str, Any] = {}

    def take(self, measured: SensorData, until: float) -> SensorData:
        """Return the input of a filter: IMU samples, and the measurements that arrived until a time [s]."""
        come: dict[str, Any] = {}
        for name, record in aiding_records(measured).items():
            before = self._waiting.pop(name, None)
            if before is None and not len(record):
                continue
            rows = record if before is None else join_rows(before, record)
            there = ~(arrivals(rows) > until + TIME_TOLERANCE)
            if there.all():
                come[name] = rows
                continue
            come[name], self._waiting[name] = take_rows(rows, there), take_rows(rows, ~there)
        return replace(measured, **come) if come else measured


class Navigator(Protocol):
    """Source of the estimate that guides the aircraft: a filter on board, or a connected client."""

    def answer(self, data: SensorData, initial: InitialState, end: float) -> NavSolution:
        """Process the data that arrived until a time [s], and return the estimate at this time."""
        ...

    def recount(self) -> list[NavSolution]:
        """Return consecutive solutions, with the innovations and events made during the flight."""
        ...


class Client(Navigator, Protocol):
    """A connected client as navigator."""

    estimates: int  # that it gave
    ended: str  # why its session was ended, in words


class _FilterOnBoard:
    def __init__(self, guidance: Guidance) -> None:
        choice, look_back = guidance.navigation, guidance.look_back
        if choice.use == CLIENT:
            raise ConfigError(f"[guidance] navigation = {CLIENT!r}: bench serve flies it, with a client")
        (built,) = load_estimators([choice])
        self._open = partial(PieceFilter, choice.use, dict(choice.options), built)
        self._look_back = look_back
        self._filter: PieceFilter | None = None
        self._settled = list[NavSolution]()
        self._rest = list[NavSolution]()  # of the last answer: what has happened since

    def answer(self, data: SensorData, initial: InitialState, end: float) -> NavSolution:
        if self._filter is None:
            self._filter = self._open(initial, self._look_back)
        self._settled.append(self._filter.advance(data))
        self._rest = []
        found = self._filter.current()
        self._rest = [found]
        return replace(found, innovations=no_innovations(), events=no_events())

    def recount(self) -> list[NavSolution]:
        return self._settled + self._rest


class Pilot:
    """Loop that passes the pieces of a flight to a navigator and asks for its estimate.

    Parameters
    ----------
    use : str
        Its name, for messages.
    navigator : Navigator
        Who is asked.
    """

    def __init__(self, use: str, navigator: Navigator) -> None:
        self._use, self._navigator = use, navigator
        self._deliveries = Deliveries()
        self.answers: list[NavSolution] = []
        self.events: list[EventRow] = []
        self._died: EstimatorError | EstimatorFailedError | None = None
        self.t = 0.0

    def answer(self, measured: SensedPiece, end: float) -> NavSolution | None:
        """Process the next piece and return the estimate at its end [s]; None if the filter has none."""
        self.t = end
        data = self._deliveries.take(measured.data, end)
        if self._died is not None:
            return None
        try:
            found = self._navigator.answer(data, measured.initial, end)
        except Exception as error:  # a filter that dies leaves the aircraft to what it said last
            self._end(error)
            return None
        if not len(found):
            return None
        self.answers.append(found)
        known = np.isfinite(found.lla[0]).all() and np.isfinite(found.vel_n[0]).all()
        return found if known and np.isfinite(found.q_nb[0]).all() else None

    def _end(self, error: Exception) -> None:
        """Store the reason why the filter ended, with the traceback if it is a bug."""
        use, t = self._use, self.t
        if not isinstance(error, EstimatorError | EstimatorFailedError):
            failure = make_failure(use, "the filter that flies", error)
            failure.__cause__ = error
            error = failure
        self._died = error
        why, places = describe_error(use, error)
        said = one_line(f"the filter that flies has failed: {why}")
        self.events += [(t, t, FAILED, said), *((t, t, kind, text) for _, _, kind, text, *_ in places)]

    def collect(self) -> NavSolution:
        """Return all estimates as one solution.

        Raises
        ------
        ConfigError
            If there is none.
        EstimatorFailedError
            If there is none because the filter raised, which is the cause.
        """
        if not self.answers and isinstance(self._died, EstimatorFailedError):
            raise self._died
        if not self.answers:
            why = self.events[0][3] if self.events else "it never answered"
            raise ConfigError(f"[guidance] navigation = {self._use!r}: {why}")
        known = [one for one in self.answers if one.extra_names] or self.answers
        joined = join_solutions([one for one in self.answers if one.extra_names == known[0].extra_names])
        way = self._navigator.recount()
        events = join_events([row for one in way for row in one.events.rows()])
        return replace(
            joined,
            innovations=join_tables([one.innovations for one in way if len(one.innovations)]),
            events=Events.from_rows(events + self.events),
        )


def fly(
    profile: Profile,
    run: int = 0,
    progress: Callable[[float], None] | None = None,
    show: ShowFlight | None = None,
) -> ClosedFlight:
    """Fly run ``run`` of a profile with guidance that uses an estimate.

    ``show`` is given each piece of the truth, and the estimate at its end.

    Raises
    ------
    bench.FlightError
        If the aircraft cannot be loaded or trimmed. What happens later is an event "crash" of the truth.
    bench.EstimatorError, bench.ConfigError
        If the filter cannot be built, or has never answered.
    """
    assert profile.guidance is not None
    check_legs(profile)
    truth, pilot = _fly(profile, run, _FilterOnBoard(profile.guidance), progress, show=show)
    return ClosedFlight(truth, pilot.collect())


def serve(profile: Profile, run: int, session: Client, commands: Commands | None) -> ServedFlight:
    """Fly a profile with guidance by the estimates of a client; errors as for :func:`fly`.

    With ``commands`` the legs are left out: the client flies. Without any estimate there are no answers.
    """
    spec = profile.flight
    assert isinstance(spec, FlightSpec)
    if commands is not None:
        duration = find_length(profile)
        spec = replace(spec, legs=(Commanded(duration, commands),), duration=duration)
    truth, pilot = _fly(replace(profile, flight=spec), run, session, None)
    answers = pilot.collect() if session.estimates and pilot.answers else None
    failed = next((row[3] for row in pilot.events if row[2] == FAILED), "")
    return ServedFlight(truth, answers, session.ended or failed)


def check_legs(profile: Profile) -> None:
    """Fly legs with a fixed duration by the truth; with an estimate they take about as long.

    Raises
    ------
    bench.FlightError
        If they need longer, or cannot be flown.
    """
    from bench.simulation import flight

    spec = profile.flight
    if isinstance(spec, FlightSpec) and spec.duration is not None:
        cached_truth(spec, lambda: flight.fly_pieces(spec))


def check_rate(profile: Profile) -> None:
    """Check that the samples of a flight fit the turns of guidance; ConfigError otherwise."""
    from bench.simulation.flight.guidance.shaping import GUIDANCE_RATE

    rate = profile.flight.rate
    if rate % GUIDANCE_RATE:
        what = f"{profile.name}: rate_hz = {rate:g} is for autopilots"
        raise ConfigError(f"{what}; turns need a multiple of {GUIDANCE_RATE:g}")


def find_length(profile: Profile) -> float:
    """Return the duration for which commands fly a profile [s].

    Raises
    ------
    ConfigError
        If it begins on the ground, or does not say how long it is.
    """
    spec = profile.flight
    assert isinstance(spec, FlightSpec)
    if spec.on_ground:
        raise ConfigError(f"{profile.name}: commands fly in the air; this flight begins on the ground")
    if spec.duration is None:
        raise ConfigError(
            f"{profile.name}: commands fly without legs. Set the duration: --set duration_s=120"
        )
    return spec.duration


def _fly(
    profile: Profile,
    run: int,
    navigator: Navigator,
    progress: Callable[[float], None] | None,
    show: ShowFlight | None = None,
) -> tuple[Trajectory, Pilot]:
    from bench.simulation import flight

    guidance = profile.guidance
    assert guidance is not None
    assert isinstance(profile.flight, FlightSpec)
    belief = Belief(guidance.error, guidance.latency)
    pieces = flight.fly_pieces(profile.flight, progress, guidance.period, belief)
    flown = list[Trajectory]()
    pilot = Pilot(guidance.navigation.use, navigator)
    _follow(profile, run, _keep(pieces, flown), belief, pilot, show)
    return join_pieces(flown), pilot


def replay(profile: Profile, truth: Trajectory, run: int = 0) -> NavSolution:
    """Return the solution that guided a flight, computed again from the truth of this flight."""
    guidance = profile.guidance
    assert guidance is not None
    pilot = Pilot(guidance.navigation.use, _FilterOnBoard(guidance))
    _follow(profile, run, cut_truth(truth, guidance.period), None, pilot)
    return pilot.collect()


def _keep(pieces: Iterable[Trajectory], flown: list[Trajectory]) -> Iterator[Trajectory]:
    for piece in pieces:
        flown.append(piece)
        yield piece


def _follow(
    profile: Profile,
    run: int,
    pieces: Iterable[Trajectory],
    belief: Belief | None,
    pilot: Pilot,
    show: ShowFlight | None = None,
) -> None:
    """Sense the pieces of a flight, let the pilot navigate and pass the resulting estimate to ``belief``."""
    draws, radar = SensorDraws(profile.seed, run), profile.sensors.radar is not None
    last_air: AirData | None = None
    for piece in pieces:
        whole = piece
        if last_air is not None and len(last_air.t):
            whole = replace(piece, air=join_rows(last_air, piece.air))
        last_air = piece.air if len(piece.air.t) == 1 else take_rows(whole.air, slice(-1, None))
        measured = sense_piece(whole, profile.sensors, draws)
        end = float(piece.t[-1])
        found = pilot.answer(measured, end)
        if show is not None:
            show(piece, found)
        if belief is not None and found is not None:
            belief.take(NavEstimate(end, piece, found, measured.truth.gyro_bias_b[-1]))
        if belief is not None and radar:
            _tell_height(belief, measured.data, piece, profile.sensors)


def _tell_height(belief: Belief, data: SensorData, piece: Trajectory, on_board: SensorsSpec) -> None:
    """Pass on the last measurement of the radar altimeter, as an error of the height above ground."""
    radar = data.radar
    if radar is None or not len(radar.t):
        return
    if not radar.valid[-1]:
        belief.take_radar(None)
        return
    row = int(np.searchsorted(piece.t, radar.t[-1] - TIME_TOLERANCE))
    lat, lon, alt = piece.lla[row]
    ground = on_board.ground_alt if on_board.terrain is None else float(ground_at(on_board.terrain, lat, lon))
    belief.take_radar(float(radar.height[-1] - (alt - ground)))


def cut_truth(truth: Trajectory, seconds: float) -> Iterator[Trajectory]:
    """Yield a truth in pieces of a length [s], as during the flight."""
    rate = round(1.0 / (truth.t[1] - truth.t[0]))
    step, begun = round(seconds * rate), 0
    for first in range(0, len(truth.t) - 1, step):
        last = min(first + step, len(truth.t) - 1)
        end = int(np.searchsorted(truth.air.t, truth.t[last] + TIME_TOLERANCE))
        shared = {name: getattr(truth, name)[first : last + 1] for name in ("t", "lla", "vel_n", "q_nb")}
        steps = {name: getattr(truth, name)[first:last] for name in ("dtheta_b", "dvel_b")}
        parts = {part: take_rows(getattr(truth, part), slice(begun, end)) for part in ("air", "controls")}
        begun = end
        rotors = take_rows(truth.rotors, slice(first, last + 1))
        yield Trajectory(**shared, **steps, **parts, events=Events.from_rows([]), rotors=rotors)
