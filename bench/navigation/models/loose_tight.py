"""The compiled filters, loose and tight: state layouts, aiding and options as data for one kernel.

An error-state extended Kalman filter in closed loop: the strapdown navigator runs on increments less the
estimated errors, the covariance follows its linear dynamics (`propagation`), and every accepted
measurement (`measurement_rows`, `ranging`) is fed back at once. Loose coupling takes
position and velocity of the GNSS antenna, tight coupling every satellite by itself.

A measurement that arrives late is compared with the state of the time it is valid at, and its H is carried
to the time of arrival by the transition in between: the process noise of the latency is left out, 2e-4 of
the variance of a 0.05 m/s fix for 0.2 s and 0.1 m/s/sqrt(h). The change of P by the turn of the frame at
feedback (half the tilt correction) is neglected: below 1e-4 for corrections below 0.01 rad (equations 10).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray, same_array
from bench.core.records.data import EventRow, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs, ImuSpec
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.gate import new_trust
from bench.navigation.engine.imu_sampler import ImuSampler
from bench.navigation.engine.integrity import nis_limit
from bench.navigation.engine.piecewise import InPieces, JoinedSolution, KnowsImuErrors, answer_now
from bench.navigation.engine.record_cuts import cut_blocks, is_long, longest_wait
from bench.navigation.engine.session import Kept, Replaced, SessionState, require, require_range
from bench.navigation.engine.timeline import empty_epochs
from bench.navigation.engine.velocity_consistency import MovedFixes
from bench.navigation.error_state_filter import measurement_rows
from bench.navigation.error_state_filter.aiding_sensors import (
    AIDING,
    FIXES,
    LATENCY,
    MAGNETOMETER,
    SATELLITES,
    AidingSensor,
    magnetic_map,
    records_needed,
    unmodeled,
)
from bench.navigation.error_state_filter.error_state import CORE, GYRO
from bench.navigation.error_state_filter.filter_run import LONGEST, ForwardRun, Nodes
from bench.navigation.error_state_filter.measurement_rows import SENSORS, opened_states
from bench.navigation.error_state_filter.measurement_update import Gate
from bench.navigation.error_state_filter.ranges.range_states import RANGE_ERRORS, RANGES
from bench.navigation.error_state_filter.ranges.satellite_states import Channels
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.standstill import StandstillDetector
from bench.navigation.error_state_filter.state_blocks import (
    StateModel,
    chosen_blocks,
    moving_states,
    state_model,
    steady_rows,
    used_blocks,
)
from bench.navigation.error_state_filter.state_processes import Block, assumed
from bench.navigation.error_state_filter.vehicle_motion import VehicleSampler
from bench.navigation.options import FusionOptions, TightOptions, read_options
from bench.navigation.start import alignment, headings, turn_on
from bench.navigation.start.headings import ManyHeadings
from bench.navigation.start.restart import Begin, between_gaps
from bench.navigation.start.steady_course import (
    AS_SPECIFIED,
    Gyros,
    SteadyCourse,
    has_large_bias,
)
from bench.navigation.start.turn_on import FromTurnOn

_STRIDE = 1.0  # so far a filter goes at once: planning costs as much as taking some hundred samples [s]
_LINEAR_DRIFT = float(np.deg2rad(2.0)) / 3600.0  # gyro bias whose free drift is linear for 10 minutes [rad/s]


class Fusion:
    """Common parts of loose and tight coupling: options, records, the run.

    The bias states are random walks with ``P0 = turn_on_sd^2 + instability_sd^2`` and
    ``q = 2 instability_sd^2 / correlation``; for an IMU without turn-on bias they are Gauss-Markov processes
    with a mean that decays too. Q, R and P0 come from the assumed specs (`state_blocks`): R is the white
    variance of the GNSS datasheet with Markov states, and the white and Markov variance together, taken as
    white, without.

    Options: `bench.navigation.options.FusionOptions`; ``bench list estimators`` shows them.
    """

    _model: type[FusionOptions] = FusionOptions

    def __init__(self, **options: Any) -> None:
        self.options = read_options(self._model, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, biases and their covariance."""
        initial, events = alignment.complete(sensors, initial)
        return self._run_whole(self.in_pieces(sensors, initial, events), sensors)

    def _run_whole(self, filter_: InPieces, sensors: SensorData) -> NavSolution:
        """Return the solution of a filter for a whole record, in blocks if the record is long."""
        if not is_long(sensors):
            return filter_.update(sensors, 0.0, last=True)
        joined, wait, start = JoinedSolution(len(sensors.output_t)), longest_wait(sensors), filter_.end
        for piece, last in cut_blocks(sensors):
            joined.add(filter_.update(piece, wait, last=last))
        seen = sensors.observations
        if seen is None or SATELLITES not in self.aiding():
            return joined.solution()
        return joined.solution(empty_epochs(seen.t, seen.epoch_start, start, filter_.end))

    def forward(
        self, sensors: SensorData, initial: InitialState, gyros: Gyros = AS_SPECIFIED
    ) -> tuple[NavSolution, list[Nodes], KnowsImuErrors]:
        """Return a solution, the nodes for the backward pass of a smoother, and the filter at the end.

        The nodes come in segments, in their order; a record that is not long is one. There are none where
        the heading was unknown and stayed so.
        """
        initial, events = alignment.complete(sensors, initial)
        if not headings.heading_is_unknown(initial):
            passage = Passage(self, sensors, initial, events, keep=True, gyros=gyros)
            return self._run_whole(passage, sensors), passage.stretches, passage
        search = ManyHeadings(partial(Passage, self, gyros=gyros), sensors, initial, events)
        solution, stretches = search.update(sensors, 0.0, last=True), list[Nodes]()
        if search.complete:
            _, stretches, _ = self.forward(sensors, search.starts[search.best], gyros)
        return solution, stretches, search

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        options = self.options
        whole = options.every_error or options.mems
        large = options.every_error and has_large_bias(first)
        begin: Begin = self._from_large_bias if large else self._from_start
        return between_gaps(
            begin, first, initial, events, options.accuracy,
            whole=whole, readmit_after_s=None if options.tight else options.readmit_after_s, any_heading=True,
        )  # fmt: skip

    def _from_start(
        self,
        first: SensorData,
        initial: InitialState,
        events: list[EventRow],
        gyro_sd: float | None = None,
        *,
        steady: bool = False,
    ) -> InPieces:
        """Return the filter of :meth:`in_pieces` for a record without long IMU gaps.

        ``gyro_sd`` [rad/s] is how well a filter before has learnt the error of the gyros as a whole.
        """
        begin = partial(Passage, self, gyros=Gyros(gyro_sd, steady))
        if headings.heading_is_unknown(initial):
            return ManyHeadings(begin, first, initial, events)
        return begin(first, initial, events)

    def _from_large_bias(
        self, first: SensorData, initial: InitialState, events: list[EventRow], gyro_sd: float | None = None
    ) -> InPieces:
        """Return the filter for an IMU with a large turn-on bias."""
        begin = partial(self._from_start, steady=True)
        if gyro_sd is None and turn_on.may_be_learnt(first, initial):
            return FromTurnOn(begin, first, initial, events)
        return begin(first, initial, events, gyro_sd)

    def blocks_for(self, sensors: SensorData) -> list[Block]:
        """Return the blocks with a record that is present."""
        return used_blocks(self.blocks(), sensors, [sensor.record for sensor in self.aiding()])

    def identity(self, sensors: SensorData) -> tuple[object, ...]:
        """Return the identity of a filter: filters of equal identity give the same solution on this record.

        Options that only choose states count by the states that the datasheets give a size.
        """
        options = self.options.model_dump(exclude={"gnss_markov", "mems", "every_error"})
        states = moving_states(sensors.specs, self.blocks_for(sensors))
        more = [self.more(sensor, sensors.specs) for sensor in self.aiding()]
        return type(self), tuple(options.items()), states, tuple(float(np.sum(one)) for one in more)

    def more(self, sensor: AidingSensor, specs: AssumedSpecs) -> FloatArray:
        """Return the variance of the sensor errors without a state, if the option ``every_error`` is set."""
        spec = getattr(specs, sensor.spec)
        if not self.options.every_error or sensor.short is None or spec is None:
            return np.zeros(1)
        return sensor.short(spec)

    def gate(self, channels: int, start: float, model: StateModel) -> Gate:
        """Return the requested tests, with empty memories."""
        options, bounds = self.options, np.full(4, np.inf)
        if "nis" in options.integrity:
            bounds[1:] = [nis_limit(m, options.gate_probability) for m in (1, 2, 3)]
        return Gate(
            nis=bounds,
            trace=options.trace_ratio if "trace" in options.integrity else np.inf,
            max_acceleration=options.max_acceleration if "tolerance" in options.integrity else np.inf,
            sigmas=options.tolerance_sigmas,
            memory=0.0 if options.adaptive_noise is None else 1.0 / options.adaptive_noise,
            readmit_after_s=options.readmit_after_s,
            opens=np.array([opened_states(code, model.layout) for code in range(len(SENSORS))]),
            trust=new_trust(channels, start),
            level=np.ones(len(SENSORS)),
        )

    def samplers(self, start: float, imu: ImuSpec) -> dict[int, ImuSampler]:
        """Return the samplers that make measurements from IMU samples, by kind."""
        options, found = self.options, dict[int, ImuSampler]()
        if options.standstill:
            found[measurement_rows.STANDSTILL_ROWS] = StandstillDetector(start, imu)
        if options.nonholonomic or options.coordinated:
            found[measurement_rows.VEHICLE_ROWS] = VehicleSampler(start, flying=options.coordinated)
        return found

    def aiding(self) -> list[AidingSensor]:
        """Return the aiding sensors that the options select."""
        other = FIXES if self.options.tight else SATELLITES
        return [sensor for sensor in AIDING if sensor is not other and getattr(self.options, sensor.option)]

    def blocks(self) -> list[Block]:
        """Return the states beyond position, velocity, attitude and biases that the options select.

        A block whose record is not there is left out of a run.
        """
        return chosen_blocks(self.options)

    @property
    def needs(self) -> tuple[str, ...]:
        """The required records; with GNSS, a barometer is optional."""
        return records_needed(self.aiding())

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        taken = {words for block in self.blocks() for words in block.takes}
        if self.options.compensate_latency:
            taken.add(LATENCY)
        found = unmodeled(specs, self.aiding(), taken)
        if not self.options.gnss and specs.imu.gyro.turn_on_bias_sd > _LINEAR_DRIFT:
            found += ("nonlinear drift from a tilt of degrees",)
        return found


class Passage(SessionState):
    """A filter for a record in pieces, from a complete initial state.

    ``first``, ``initial`` and ``events`` are those of `piecewise.RunsInPieces.in_pieces`, ``gyros`` is what
    else is known of them. With ``keep`` it stores the nodes of a smoother in ``stretches``.
    """

    schedule: Kept[Schedule]
    run: Kept[ForwardRun]
    channels: Kept[Channels]
    samplers: Kept[dict[int, ImuSampler]]
    course: Kept[SteadyCourse]
    antenna_b: Replaced[FloatArray]

    def __init__(
        self,
        filter_: Fusion,
        first: SensorData,
        initial: InitialState,
        events: list[EventRow],
        *,
        keep: bool = False,
        gyros: Gyros = AS_SPECIFIED,
    ) -> None:
        self.filter, self.initial, self.antenna_b = filter_, initial, first.antenna_b
        self.stretches = list[Nodes]()
        options, specs = filter_.options, first.specs
        self.used = [sensor for sensor in filter_.aiding() if getattr(first, sensor.record) is not None]
        if SATELLITES in self.used and specs.gnss is not None and specs.gnss.sky is None:
            raise ValueError(
                f"the record holds satellites, but the gnss unit assumed, {specs.gnss.name!r}, has no [sky]"
            )
        self.course = SteadyCourse(initial, specs.imu, steady=gyros.steady)
        blocks = filter_.blocks_for(first) + self.course.blocks()
        blocks.sort(key=lambda block: block is RANGE_ERRORS)
        model = state_model(initial, specs, blocks, gyros.sd)
        watch = None
        if "velocity" in options.integrity and specs.gnss is not None:
            watch = MovedFixes(specs.gnss, options.gate_probability)
        self.schedule = Schedule(
            initial.t, specs.imu, compensate=options.compensate_latency, accuracy=options.fix_accuracy,
            watch=watch, cut=keep,
        )  # fmt: skip
        self.schedule.events += events
        self.samplers = filter_.samplers(initial.t, specs.imu)
        self.channels = Channels()
        field = np.zeros((4, 3))
        if MAGNETOMETER in self.used:
            field = magnetic_map(initial.lla, first.date)
        self.run = ForwardRun(
            initial, model, first.antenna_b, field, filter_.gate(len(SENSORS), initial.t, model),
            0.0 if options.covariance_hz is None else (1.0 - 1e-6) / options.covariance_hz, keep,
        )  # fmt: skip

    @property
    def end(self) -> float:
        """Time of the last processed IMU sample, or of the start [s]."""
        return self.schedule.end

    def update(self, piece: SensorData, look_back: float, *, last: bool) -> NavSolution:
        """Take the next piece; return the answers that are final (`piecewise.InPieces`)."""
        if not same_array(self.antenna_b, piece.antenna_b):
            self._go_over(piece.antenna_b)
        self._take(piece, last=last)
        if not last and self.schedule.end - self.schedule.t < look_back + _STRIDE:
            return self.run.nothing
        solution, nodes = self.run.go(self.schedule, self.channels, look_back)
        if self.run.keep:
            self.stretches.append(nodes)
        return solution

    def current(self, head: SensorData) -> NavSolution:
        """Return the solution at the end as if the record ended there; an output does not end a step."""
        self.schedule.output_t = np.empty(0)
        return answer_now(self, head)

    @property
    def heading_lost_at(self) -> float | None:
        """Time of the first motion without a heading [s], or None (`piecewise.MayLoseHeading`)."""
        return self.run.heading_lost_at

    @property
    def heading_vague(self) -> bool:
        """Whether the sigma of the heading is above `headings.LINEAR`."""
        return bool(self.run.now.P[8, 8] > headings.LINEAR**2)

    def steady_errors(self) -> tuple[FloatArray, FloatArray]:
        """Return the errors (6,) of gyros and accelerometers at the end in level flight, and their sd."""
        run, process = self.run, self.run.model.process
        n = run.model.layout.size
        level = -earth.gravity_n(run.now.state[0], run.now.state[2])
        L = steady_rows(process.drives, level, run.warmth, n)
        L[:, GYRO:CORE] = np.eye(6)
        variance = np.einsum("ij,jk,ik->i", L, run.now.P[:, :n], L)
        return L[:, GYRO:] @ run.now.state[GYRO + 1 :], np.sqrt(variance)

    def _take(self, piece: SensorData, *, last: bool) -> None:
        specs, schedule = piece.specs, self.schedule
        samples = schedule.take(piece, last=last)
        if SATELLITES in self.used and piece.observations is not None:
            seen, lat = piece.observations, float(self.initial.lla[0])
            schedule.add_satellites(seen, assumed(specs, "gnss"), lat, self.channels)
        for sensor in self.used:
            if sensor is not SATELLITES:
                more = self.filter.more(sensor, specs)
                schedule.add(sensor, piece, self.initial, self.run.model.layout, more)
        for kind, sampler in self.samplers.items():
            schedule.add_samples(kind, *sampler.take(samples))
        schedule.add_samples(measurement_rows.COURSE_ROWS, *self.course.take(piece, samples))
        if last:
            schedule.events += self._absent(piece)

    def _go_over(self, antenna_b: FloatArray) -> None:
        """Use another antenna position (3,) [m], b, from now on."""
        options = self.filter.options
        if options.gnss and options.tight:
            raise EstimatorError("'tight' cannot change to another antenna: loosely coupled filters can")
        if options.lever_arm_sd > 0:
            raise EstimatorError(
                f"lever_arm_sd = {options.lever_arm_sd:g} estimates the position of one antenna "
                "and cannot change to another; leave the option out"
            )
        self.antenna_b = self.run.antenna_b = antenna_b

    def check(self) -> None:
        """Check that schedule and filter belong together."""
        schedule, run = self.schedule, self.run
        sky, live = schedule.sky, run.pending.live
        kinds = {sensor.kind for sensor in self.used} | self.samplers.keys() | {measurement_rows.COURSE_ROWS}
        waiting = schedule.waiting
        known = kinds.issuperset(waiting.kind.tolist())
        require(known, "waiting/kind", "must be the sensors of the filter")
        require_range("waiting/slot", waiting.slot, len(live))
        held, of_satellites = np.full(len(waiting.t), 2 * LONGEST), waiting.kind == SATELLITES.kind
        held[of_satellites] = 2 * np.diff(sky.epoch_start)[waiting.number[of_satellites]]
        most = np.zeros(len(live), np.int64)
        np.maximum.at(most, waiting.slot, held)
        most[0] = 2 * LONGEST
        require(bool((live <= most).all()), "pending/live", "must be of the measurements that wait")
        require_range("sky/which (channel)", sky.which[:, 1:3], len(run.gate.trust.misses))
        for system, states in enumerate(RANGES):
            own = sky.which[sky.which[:, 0] == system, 3]
            require_range("sky/which (state)", own + 1, states + 1)  # one that has none has -1

    def _absent(self, piece: SensorData) -> list[EventRow]:
        """Return an event for each sensor that is requested but has no data."""
        asked, start = self.filter.aiding(), self.initial.t
        absent = [sensor.option for sensor in asked if sensor.on_request and sensor not in self.used]
        if SATELLITES in asked and piece.observations is None and piece.fixes is not None:
            absent.append("tight coupling")
        text = "asked for, but the record holds nothing for it"
        return [(start, self.schedule.end, "aiding", f"{what}: {text}") for what in absent]


class Loose(Fusion):
    """Loosely coupled INS/GNSS/baro filter: position and, if any, velocity of a receiver's fixes."""


class Tight(Fusion):
    """Tightly coupled INS/GNSS/baro filter: range and range rate of each satellite, the receiver's clock.

    With the clock, its drift and its offset for each system beside GPS as states it goes on with any number
    of satellites, and rejects one without the others.
    """

    _model = TightOptions
