"""The compiled filters, loose and tight: state layouts, aiding and options as data for one kernel.

An error-state extended Kalman filter in closed loop: the strapdown navigator runs on increments less the
estimated errors, the covariance follows its linear dynamics (`bench.navigation.cycle`), and every accepted
measurement (`bench.navigation.aiding`, `bench.navigation.ranging`) is fed back at once. Loose coupling takes
position and velocity of the GNSS antenna, tight coupling every satellite by itself.

A measurement that arrives late is compared with the state of the instant it is valid at, and its H is carried
to the instant of arrival by the transition in between: the process noise of the latency is left out, 2e-4 of
the variance of a 0.05 m/s fix for 0.2 s and 0.1 m/s/sqrt(h). The change of P by the turn of the frame at
feedback (half the tilt correction) is neglected: below 1e-4 for corrections below 0.01 rad (equations
section 10).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bench.data import InitialState, NavSolution, SensorData
from bench.navigation import aiding, alignment, ranging, standstill
from bench.navigation.agenda import Agenda
from bench.navigation.aiding import POSITION, SENSORS, VELOCITY, ZERO_RATE, ZERO_VELOCITY, Gate
from bench.navigation.blocks import Block, StateModel, assumed, chosen_blocks, state_model
from bench.navigation.error_state import POS, VEL
from bench.navigation.forward import Nodes, forward_run
from bench.navigation.integrity import nis_limit
from bench.navigation.measurements import (
    AIDING,
    FIXES,
    LATENCY,
    MAGNETOMETER,
    SATELLITES,
    AidingSensor,
    magnetic_map,
    records_needed,
    unmodelled,
)
from bench.navigation.options import is_count, is_number
from bench.specs import AssumedSpecs

_NEVER = np.iinfo(np.int64).max


class Fusion:
    """What loose and tight coupling share: options, records, the run.

    The bias states are random walks with ``P0 = turn_on_sd^2 + instability_sd^2`` and
    ``q = 2 instability_sd^2 / correlation``; for a unit without turn-on bias they are Gauss-Markov processes
    whose mean decays too. Q, R and P0 come from the assumed specs (`bench.navigation.blocks`): R is the
    white variance of the GNSS datasheet with Markov states, and the white and Markov variance together,
    taken as white, without.

    Parameters
    ----------
    gnss, baro : bool
        Which aiding to use; without any it navigates by the IMU alone and P is its open-loop covariance.
    gnss_markov : bool
        Estimate the Markov part of the GNSS errors in six states: with all aiding the 22 states of A-5.4.1.
        Loose coupling only.
    mems : bool
        Estimate scale factors (3 + 3) and the g-sensitivity of the gyros (9).
    covariance_hz : float or None
        Rate of the covariance step; None: at every IMU sample.
    gate_probability : float
        Chance of refusing a sound sub-vector of a matched filter, (0, 1).
    readmit_after : int
        Refusals in a row after which the next sub-vector is used all the same (A-5.4.7), P grown for it
        where it is position, velocity or height; every satellite counts for itself.
    integrity : sequence of {"nis", "trace", "tolerance"}
        Tests every sub-vector has to pass: normalized innovation squared, ratio of traces (A-5.4.7), and for
        fixes the distance from the INS since the last one used (A-5.4.T).
    trace_ratio : float
        Limit of "trace", delta of A-5.4.7.
    max_acceleration : float
        What the aircraft can do between fixes [m/s^2], for "tolerance".
    tolerance_sigmas : float
        Multiple of the receiver's standard deviation granted by "tolerance".
    compensate_latency : bool
        Compare a measurement with the state at its ``t``; else with that at its ``t_arrival``.
    adaptive_noise : int or None
        Measurements over which the variance of a sensor is taken from its innovations; None: the datasheet's.
    standstill : bool
        Zero velocity and zero rate whenever the IMU stands still by its own account.
    lever_arm_sd : float
        How well each component of the antenna's place is known [m]; above 0 it is estimated.
    airspeed : bool
        Use true airspeed, with the wind as two states.
    magnetometer : bool
        Use the direction and size of the magnetic field.
    """

    tight = False

    def __init__(
        self,
        *,
        gnss: bool = True,
        baro: bool = True,
        gnss_markov: bool = False,
        covariance_hz: float | None = None,
        gate_probability: float = 1e-5,
        readmit_after: int = 10,
        mems: bool = False,
        integrity: Sequence[str] = ("nis",),
        trace_ratio: float = 10.0,
        max_acceleration: float = 20.0,
        tolerance_sigmas: float = 5.0,
        compensate_latency: bool = True,
        adaptive_noise: int | None = None,
        standstill: bool = False,
        lever_arm_sd: float = 0.0,
        airspeed: bool = False,
        magnetometer: bool = False,
    ) -> None:
        for name, value in (
            ("gnss", gnss),
            ("baro", baro),
            ("gnss_markov", gnss_markov),
            ("mems", mems),
            ("compensate_latency", compensate_latency),
            ("standstill", standstill),
            ("airspeed", airspeed),
            ("magnetometer", magnetometer),
        ):
            if not isinstance(value, bool):
                raise ValueError(f"{name} = {value!r} must be true or false")
        if covariance_hz is not None and not (is_number(covariance_hz) and 0 < covariance_hz < np.inf):
            raise ValueError(
                f"covariance_hz = {covariance_hz!r} must be positive, or left out for every sample"
            )
        if not (is_number(gate_probability) and 0 < gate_probability < 1):
            raise ValueError(f"gate_probability = {gate_probability!r} must lie between 0 and 1")
        if not is_count(readmit_after):
            raise ValueError(f"readmit_after = {readmit_after!r} must be a whole number, at least 1")
        if adaptive_noise is not None and not is_count(adaptive_noise):
            raise ValueError(
                f"adaptive_noise = {adaptive_noise!r} must be a count of measurements, at least 1"
            )
        for name, number in (
            ("trace_ratio", trace_ratio),
            ("max_acceleration", max_acceleration),
            ("tolerance_sigmas", tolerance_sigmas),
        ):
            if not (is_number(number) and 0 < number < np.inf):
                raise ValueError(f"{name} = {number!r} must be positive")
        if not (is_number(lever_arm_sd) and 0 <= lever_arm_sd < np.inf):
            raise ValueError(f"lever_arm_sd = {lever_arm_sd!r} must be a length [m], 0 for a known antenna")
        if isinstance(integrity, str) or not set(integrity) <= {"nis", "trace", "tolerance"}:
            raise ValueError(f"integrity = {integrity!r} must be a list of 'nis', 'trace', 'tolerance'")
        if gnss_markov and not gnss:
            raise ValueError("gnss_markov = True needs gnss = True: the states are errors of its fixes")
        if gnss_markov and self.tight:
            raise ValueError("gnss_markov = True needs fixes: tight coupling uses none")
        if lever_arm_sd > 0 and not gnss:
            raise ValueError(
                f"lever_arm_sd = {lever_arm_sd!r} needs gnss = True: only its antenna has an arm"
            )
        self.gnss, self.baro, self.gnss_markov, self.mems = gnss, baro, gnss_markov, mems
        self.covariance_hz = covariance_hz
        self.gate_probability = gate_probability
        self.readmit_after = readmit_after
        self.integrity = tuple(integrity)
        self.trace_ratio, self.max_acceleration = trace_ratio, max_acceleration
        self.tolerance_sigmas = tolerance_sigmas
        self.compensate_latency = compensate_latency
        self.adaptive_noise = adaptive_noise
        self.standstill = standstill
        self.lever_arm_sd = lever_arm_sd
        self.airspeed, self.magnetometer = airspeed, magnetometer

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, biases and their covariance.

        Raises
        ------
        ValueError
            When a sensor in use has no assumed spec.
        """
        return self.forward(sensors, initial, keep=False)[0]

    def forward(self, sensors: SensorData, initial: InitialState, *, keep: bool) -> tuple[NavSolution, Nodes]:
        """Return the solution of :meth:`run` and, with ``keep``, the nodes a smoother goes back over."""
        initial, aligned = alignment.complete(sensors, initial)
        specs = sensors.specs
        used = [sensor for sensor in self.aiding() if getattr(sensors, sensor.record) is not None]
        records = {sensor.record for sensor in used}
        if SATELLITES in used and specs.gnss is not None and specs.gnss.sky is None:
            raise ValueError(
                f"the record holds satellites, but the gnss unit assumed, {specs.gnss.name!r}, has no [sky]"
            )
        blocks = [b for b in self.blocks() if not b.records or records & set(b.records)]
        model = state_model(initial, specs, blocks)
        agenda = Agenda(sensors, initial.t, compensate=self.compensate_latency)
        agenda.events += aligned
        sky, seen = ranging.no_sky(), sensors.observations if SATELLITES in used else None
        if seen is not None:
            sky = agenda.add_satellites(seen, assumed(specs, "gnss"), float(initial.lla[0]))
        for sensor in used:
            if sensor is not SATELLITES:
                agenda.add(sensor, sensors, initial, model.layout)
        field = np.zeros((4, 3))
        if MAGNETOMETER in used:
            field = magnetic_map(initial.lla, sensors.date)
        if self.standstill:
            last, rate_b = standstill.windows(sensors.imu, agenda.rows, specs.imu)
            variance = np.repeat([standstill.VELOCITY_SD**2, standstill.rate_variance(specs.imu)], 3)
            agenda.add_samples(aiding.STANDSTILL_ROWS, last, rate_b, variance)
        names = list(SENSORS)
        if seen is not None:
            names += [f"{sat} {what}" for sat in ranging.satellite_names(seen) for what in ("range", "rate")]
        absent = [sensor.option for sensor in self.aiding() if sensor.on_request and sensor not in used]
        if SATELLITES in self.aiding() and seen is None and sensors.fixes is not None:
            absent.append("tight coupling")
        end = float(agenda.imu_t[-1]) if len(agenda.imu_t) else initial.t
        agenda.events += [
            (initial.t, end, "aiding", f"{what}: asked for, but the record holds nothing for it")
            for what in absent
        ]
        interval = 0.0 if self.covariance_hz is None else (1.0 - 1e-6) / self.covariance_hz
        gate = self._gate(len(names), initial.t, model)
        return forward_run(
            sensors, initial, model, agenda, sky, field, names, gate=gate, interval=interval, keep=keep
        )

    def _gate(self, channels: int, start: float, model: StateModel) -> Gate:
        """Return the tests asked for, with empty memories."""
        bounds = np.full(4, np.inf)
        if "nis" in self.integrity:
            bounds[1:] = [nis_limit(m, self.gate_probability) for m in (1, 2, 3)]
        readmit = np.full(len(SENSORS), int(self.readmit_after))
        readmit[[ZERO_VELOCITY, ZERO_RATE]] = _NEVER
        own = np.full((len(SENSORS), 3), -1)  # one satellite of many opens nothing: it is outvoted
        own[POSITION], own[VELOCITY] = POS + np.arange(3), VEL + np.arange(3)
        own[aiding.BARO, 0] = model.index.baro_bias
        return Gate(
            nis=bounds,
            trace=self.trace_ratio if "trace" in self.integrity else np.inf,
            max_acceleration=self.max_acceleration if "tolerance" in self.integrity else np.inf,
            sigmas=float(self.tolerance_sigmas),
            memory=0.0 if self.adaptive_noise is None else 1.0 / self.adaptive_noise,
            readmit_after=readmit,
            own=own,
            misses=np.zeros(channels, np.int64),
            used=np.full(channels, start),
            level=np.ones(len(SENSORS)),
        )

    def aiding(self) -> list[AidingSensor]:
        """Return the aiding sensors that the options ask for."""
        other = FIXES if self.tight else SATELLITES
        return [sensor for sensor in AIDING if sensor is not other and getattr(self, sensor.option)]

    def blocks(self) -> list[Block]:
        """Return the states beyond position, velocity, attitude and biases, as the options ask for them.

        A block whose record is not there is left out of a run.
        """
        return chosen_blocks(self)

    @property
    def needs(self) -> tuple[str, ...]:
        """What it has nothing to work on without; a barometer beside GNSS is used where there is one."""
        return records_needed(self.aiding())

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Name the errors of these units that the state has no room for, in words."""
        taken = {words for block in self.blocks() for words in block.takes}
        return unmodelled(specs, self.aiding(), taken | ({LATENCY} if self.compensate_latency else set()))


class Loose(Fusion):
    """Loosely coupled INS/GNSS/baro filter: position and, if any, velocity of a receiver's fixes."""


class Tight(Fusion):
    """Tightly coupled INS/GNSS/baro filter: range and range rate of each satellite, the receiver's clock.

    With the clock, its drift and the offset of its GLONASS as states it goes on with any number of
    satellites, and refuses one without the others.
    """

    tight = True
