"""Measurement of the IMU sample by sample, with the numbers that `bench.simulation.sensors.imu` draws.

The errors between two knots of the bias are drawn when the first of their samples is due. They do not depend
on the motion: the sensors of the recorded flight get the same. Only the temperature of the air is held.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.data import AirData, ImuData, Trajectory, no_controls, no_events
from bench.core.records.sensor_specs import Fault, ImuSpec, SampleClockSpec, TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.simulation.sampled.sample_motion import SampleMotion
from bench.simulation.sensors import faults, imu, imu_terms, vibration
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.motion_response import Response, tag_responses
from bench.simulation.sensors.processes import apply_lag

_NONE = np.empty((0, 3))


class ImuSample(NamedTuple):
    """One row of `ImuData`, which is checked as it is made; that takes as long as the sample."""

    t: FloatArray
    dt: FloatArray
    valid: BoolArray
    dtheta_b: FloatArray
    dvel_b: FloatArray


class SampledImu:
    """An IMU that is asked for one sample at a time.

    Parameters
    ----------
    spec : ImuSpec
        The IMU.
    scripted : tuple of Fault
        Scripted faults.
    draws : SensorDraws
        The errors of the run.
    rate : float
        Samples per second [Hz].

    Raises
    ------
    ValueError
        If a figure of the IMU requires another one that is missing.
    ConfigError
        If the engine shakes the IMU at an inner rate.
    """

    def __init__(self, spec: ImuSpec, scripted: tuple[Fault, ...], draws: SensorDraws, rate: float) -> None:
        if wrong := imu_terms.check_imu(spec):
            raise ValueError("; ".join(wrong))
        if spec.vibration.inner_rate and not spec.vibration.by_rotors:
            raise ConfigError("[vibration] inner_rate_hz is not for an IMU that is asked sample by sample")
        self._spec, self._scripted, self._all, self._draws = spec, scripted, draws, draws.part("imu")
        self._rate, self._width, self._row = rate, max(1, round(imu.BIAS_STEP * rate)), 0
        self._triads = [(getattr(spec, name), self._draws.part(name)) for name in ("gyro", "accel")]
        self._M = [self._draw_matrix(*one) for one in self._triads]
        self._walks = [triad.by_axis("random_walk") for triad, _ in self._triads]
        self._t, self._errors = np.empty(0), list[tuple[IntArray, FloatArray, FloatArray]]()
        self._warm: float | None = None  # temperature of the unit [K]
        self._last: tuple[SampleMotion, FloatArray] | None = None
        self._N = imu_terms.cone_axes(spec.accel_cone) if spec.accel_cone > 0 else np.eye(3)
        self._back = np.linalg.inv(self._N).astype(float)

    @staticmethod
    def _draw_matrix(triad: TriadSpec, part: SensorDraws) -> FloatArray:
        return part.keep("M", lambda: imu.draw_matrix(triad, part))

    def begin(self, motion: SampleMotion, air: FloatArray) -> None:
        """Store the motion and the air at t = 0."""
        self._last = motion, air

    def measure(self, motion: SampleMotion, air: FloatArray) -> ImuSample | ImuData:
        """Return the sample (one row) that ends with a motion, in the air (`Stretch.air`) at its end."""
        k = self._row % self._width
        if not k:
            self._draw(air)
        self._row += 1
        t, spec = self._t[k : k + 2], self._spec
        dtheta_b, dvel_b = self._shake(motion, air)
        force, dt = dvel_b, t[1:] - t[:-1]
        if spec.accel_cone > 0 or spec.accel_arms:
            arms = np.array(spec.accel_arms) if spec.accel_arms else None
            force = imu_terms.resolve_along_axes(dtheta_b, dvel_b, dt, arms, self._N, self._draws)
        valid, found, responses = np.ones(1, bool), [], []
        for (triad, part), increment in zip(self._triads, (dtheta_b, force), strict=True):
            increment = imu_terms.apply_response(t, increment, triad, part)
            moving = imu_terms.draw_motion_errors(t, increment, dvel_b, triad, part)
            responses.append(Response(increment, moving))
        if spec.clock != SampleClockSpec():
            responses[:] = tag_responses(t, responses, spec.clock, self._draws.part("clock"))
        for number, (increment, moving) in enumerate(responses):
            triad, part = self._triads[number]
            knots, bias, white = self._errors[number]
            out, rest = np.empty((1, 3)), part.keep("rest", lambda: np.zeros(3))
            imu.measure_kernel(
                self._t, k, increment, self._M[number], knots, bias, white[k : k + 1],
                self._walks[number], triad.quantization, triad.resolution, moving, triad.range, rest,
                out, valid,
            )  # fmt: skip
            found.append(out)
        if spec.accel_cone > 0:
            found[1] = imu_terms.rotate_rows(self._back, found[1])
        sample = ImuSample(t[1:], dt, valid, found[0], found[1])
        if not self._scripted:
            return sample
        return faults.apply_to_imu(ImuData(**sample._asdict()), spec, self._scripted, self._all)

    def _draw(self, air: FloatArray) -> None:
        """Draw the errors until the next knot of the bias."""
        t = np.arange(self._row, self._row + self._width + 1) / self._rate
        rows, spec = imu.select_knots(t, imu.BIAS_STEP), self._spec
        warmth = np.empty((0, 3))
        if spec.warms:
            around, thermal = float(air[1]), spec.thermal
            start = around if self._warm is None else self._warm
            warm = apply_lag(t[rows], np.full(2, around + thermal.self_heating), start, thermal.time_constant)
            self._warm, warmth = float(warm[-1]), imu_terms.list_warmth(warm, thermal, self._draws)
        self._t, self._errors = t, []
        for triad, part in self._triads:
            knots, bias = imu.draw_bias(t, triad, rows, warmth, part)
            white = _NONE
            if triad.random_walk > 0:
                white = np.empty((self._width, 3))
                imu.fill_noise(triad, float(t[1] - t[0]), part, white)
            self._errors.append((knots, bias, white))

    def _shake(self, motion: SampleMotion, air: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the increments (1, 3) with the vibration of the unit."""
        dtheta_b, dvel_b = motion.dtheta_b[None], motion.dvel_b[None]
        if not (self._spec.feels_air or self._spec.vibration.by_rotors):
            return dtheta_b, dvel_b
        assert self._last is not None
        before, air_before = self._last
        self._last = motion, air
        lla, vel_n, q_nb = (np.stack(pair) for pair in zip(before[1:4], motion[1:4], strict=True))
        rows, t = np.stack([air_before, air]), np.array([before.t, motion.t])
        pressure, temperature, true, calibrated, attack, slip = rows[:, :6].T.copy()
        wind_n, engine = rows[:, 6:9], rows[:, 9].copy()
        both = AirData(t, pressure, temperature, true, calibrated, attack, slip, wind_n, engine)
        piece = Trajectory(t, lla, vel_n, q_nb, dtheta_b, dvel_b, both, no_controls(), no_events())
        return vibration.shake(piece, self._spec.vibration, self._draws.part("vibration"))
