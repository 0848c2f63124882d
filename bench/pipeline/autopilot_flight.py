"""A flight by an autopilot, in lock-step with each sample of the IMU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import AirData, ImuData, Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import ImuSpec, SensorsSpec, TriadSpec
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError, EstimatorStoppedError
from bench.io.results import join_pieces
from bench.navigation.engine.kept_rows import join_rows, take_rows
from bench.navigation.engine.record_cuts import aiding_records, arrivals
from bench.pipeline import closed_loop
from bench.simulation.flight.guidance.steering import Commands
from bench.simulation.sampled.imu_samples import ImuSample, SampledImu
from bench.simulation.sampled.sample_flight import SampleFlight
from bench.simulation.sampled.sample_motion import SampleMotion
from bench.simulation.sensors import sense_piece
from bench.simulation.sensors.draws import SensorDraws

_PIECE = 1.0  # longest piece of which truth is made at a time [s]


class Sample(NamedTuple):
    """Data for an autopilot at a sample of the IMU."""

    motion: SampleMotion  # the truth
    air: FloatArray  # `Stretch.air`
    imu: ImuSample | ImuData  # one row
    come: list[tuple[str, Any, int]]  # sensor, record and row of what has arrived since the last sample

    @property
    def rates(self) -> tuple[FloatArray, FloatArray]:
        """Measured rate (3,) [rad/s] and specific force (3,) [m/s^2], means over the sample."""
        dt = self.imu.dt[0]
        return self.imu.dtheta_b[0] / dt, self.imu.dvel_b[0] / dt


class Autopilot(Protocol):
    """A connected autopilot."""

    commands: Commands  # what it wants
    ended: str  # why it flies no more

    @property
    def aided(self) -> bool:
        """Return whether it gets other sensors than the IMU."""
        ...

    def exchange(self, sample: Sample) -> None:
        """Send a sample, and store the command that answers it."""
        ...


class RestartedError(Exception):
    """The autopilot begins anew, and the flight with it."""


class _Aiding:
    """The sensors other than the IMU, measured as soon as one is due."""

    def __init__(self, spec: SensorsSpec, draws: SensorDraws) -> None:
        units = [spec.gnss, *(getattr(spec, name) for name in INSTRUMENTS)]
        self._rates = [unit.rate for unit in units if unit is not None]
        self._spec = replace(spec, imu=ImuSpec("none", TriadSpec(), TriadSpec()))
        self._draws, self._done = draws, 0
        self._air: AirData | None = None
        self._waiting: list[tuple[float, str, Any, int]] = []

    def is_due(self, t: float) -> bool:
        """Return whether a sensor has an epoch since the last question."""
        before, self._done = self._done, sum(int((t + SAME_INSTANT) * rate) for rate in self._rates)
        return self._done > before

    def measure(self, piece: Trajectory) -> None:
        """Measure the next piece of the flight."""
        whole = piece if self._air is None else replace(piece, air=join_rows(self._air, piece.air))
        self._air = take_rows(piece.air, slice(-1, None))
        for name, record in aiding_records(sense_piece(whole, self._spec, self._draws).data).items():
            kept = np.ones(len(record), bool) if name == "fixes" else record.valid
            come = arrivals(record)
            self._waiting += [(float(come[row]), name, record, row) for row in np.flatnonzero(kept).tolist()]
        self._waiting.sort(key=lambda one: one[0])

    def arrive(self, t: float) -> list[tuple[str, Any, int]]:
        """Return what has arrived by a time [s] and was not returned before."""
        count = sum(one[0] <= t + SAME_INSTANT for one in self._waiting)
        come = [one[1:] for one in self._waiting[:count]]
        del self._waiting[:count]
        return come


def check_flight(profile: Profile) -> float:
    """Return the duration of a flight by an autopilot [s].

    Raises
    ------
    ConfigError
        If it begins on the ground, does not say how long it is, or the aircraft was not made for the bench.
    """
    spec = profile.flight
    assert isinstance(spec, FlightSpec)
    if spec.aircraft.foreign is not None:
        raise ConfigError(
            f"{profile.name}: an autopilot flies aircraft of the bench; {spec.aircraft.name} is not"
        )
    return closed_loop.find_length(profile)


def fly(
    profile: Profile, run: int, autopilot: Autopilot, say: Callable[[str], object]
) -> closed_loop.ServedFlight:
    """Fly run ``run`` of a profile by the commands of an autopilot.

    Raises
    ------
    bench.FlightError
        If the aircraft cannot be loaded or trimmed, or nothing has been flown.
    """
    while True:
        try:
            return _fly_once(profile, run, autopilot)
        except RestartedError as restarted:
            say(f"{restarted}; the flight begins anew")


def _fly_once(profile: Profile, run: int, autopilot: Autopilot) -> closed_loop.ServedFlight:
    spec, sensors, rate = profile.flight, profile.sensors, profile.flight.rate
    assert isinstance(spec, FlightSpec)
    flight = SampleFlight(spec, check_flight(profile), autopilot.commands)
    imu = SampledImu(sensors.imu, sensors.faults, SensorDraws(profile.seed, run), rate)
    aiding = _Aiding(sensors, SensorDraws(profile.seed, run)) if autopilot.aided else None
    samples = flight.fly()
    if (first := next(samples, None)) is not None:
        imu.begin(*first)
    for motion, air in samples:
        if aiding is not None and aiding.is_due(motion.t):
            aiding.measure(flight.cut())
        elif flight.uncut >= _PIECE * rate:
            piece = flight.cut()
            if aiding is not None:
                aiding.measure(piece)
        come = [] if aiding is None else aiding.arrive(motion.t)
        try:
            autopilot.exchange(Sample(motion, air, imu.measure(motion, air), come))
        except EstimatorStoppedError:
            break
    ended = autopilot.ended or flight.ended
    return closed_loop.ServedFlight(join_pieces(flight.finish(ended)), None, ended)
