"""The invariant EKF of gtsam: attitude, position and velocity as one element of SE2(3).

The error is an element of the group, so that its transition does not depend on the estimate, and a heading
that is wrong by tens of degrees converges where an EKF of sums does not (A. Barrau, S. Bonnabel, IEEE TAC 62
(4), 2017). Nine states: the biases of the IMU have none and act as noise, white with the power of errors that
last for ``bias_time``. Fixes only, their errors taken as white, compared with the state at their arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from bench import rotation
from bench.arrays import FloatArray
from bench.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.navigation.engine.gate import REFUSED, SOUND, InnovationGate, growth
from bench.navigation.engine.integrity import nis
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.engine.session import Kept, Scratch
from bench.navigation.error_state_filter.aiding_sensors import FIXES, unmodelled
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import POSITION, SENSORS, VELOCITY
from bench.navigation.models.classic.process_model import bias_and_walk
from bench.navigation.models.graph.flat_frame import FlatFrame, load_gtsam, schedule_fixes
from bench.navigation.models.stepped_filters import Measurement, SteppedFilter, SteppedPassage
from bench.navigation.options import InvariantOptions, read_options
from bench.navigation.start import alignment
from bench.navigation.start.restart import between_gaps
from bench.specs import AssumedSpecs, ImuSpec


class InvariantEkf:
    """INS/GNSS on SE2(3).

    Options: `bench.navigation.options.InvariantOptions`.
    """

    needs = ("fixes",)

    def __init__(self, **options: Any) -> None:
        self.options = read_options(InvariantOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude and their covariance."""
        initial, events = alignment.complete(sensors, initial)
        return self.in_pieces(sensors, initial, events).feed(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        return between_gaps(self._passage, first, initial, events, "datasheet")

    def _passage(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> SteppedPassage:
        flight = InvariantFlight(load_gtsam(), self.options, first.specs.imu, initial)
        schedule = schedule_fixes(first, initial, events)
        used = [] if first.fixes is None else [FIXES]
        return SteppedPassage(flight, schedule, used, first, initial, StateLayout())

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the estimator has no state for, in words."""
        biases = (f"{name} bias" for name, one in _triads(specs.imu) if bias_and_walk(one)[0] > 0)
        return (*biases, *unmodelled(specs, [FIXES], ()))


def _triads(imu: ImuSpec) -> tuple[tuple[str, Any], ...]:
    return ("gyro", imu.gyro), ("accelerometer", imu.accel)


class _Navigated(NamedTuple):
    """State and covariance of the filter, in the frame t of `flat_frame`."""

    C_tb: FloatArray  # (3, 3)
    p_t: FloatArray  # (3,) [m]
    v_t: FloatArray  # (3,) [m/s]
    P: FloatArray  # (9, 9) attitude, position, velocity


class InvariantFlight(SteppedFilter):
    """The filter over one record (`stepped_filters.SteppedFilter`)."""

    gravity: Kept[FloatArray]  # (3,) at the last fix [m/s^2]
    gate: Kept[InnovationGate]
    w_ib_b: Kept[FloatArray]  # (3,) of the last step after which something is measured [rad/s]
    ekf: Scratch[Any]  # a `gtsam.NavStateImuEKF`; what it holds is :attr:`navigated`

    shapes = (10,), (9, 9)
    one_antenna = False

    def __init__(self, gtsam: Any, options: InvariantOptions, imu: ImuSpec, initial: InitialState) -> None:
        self.gtsam, self.options = gtsam, options
        self.frame = FlatFrame.at(initial.lla, not options.flat)
        C_tb, p_t, v_t, P = self.frame.begin(initial)
        self.params = gtsam.PreintegrationParams(self.frame.g_t)
        for one, put in (
            (imu.gyro, self.params.setGyroscopeCovariance),
            (imu.accel, self.params.setAccelerometerCovariance),
        ):
            bias = bias_and_walk(one)[0]
            put(np.eye(3) * (one.random_walk**2 + bias**2 * options.bias_time))
        self.params.setIntegrationCovariance(np.eye(3) * 1e-12)
        self._begin(gtsam.NavState(gtsam.Rot3(C_tb), p_t, v_t), P)
        self.gravity = self.frame.gravity(p_t)
        self.coriolis = 2.0 * rotation.skew(self.frame.w_t)
        self.gate = InnovationGate(SENSORS, initial.t, options.gate_probability, options.readmit_after_s)
        self.w_ib_b = np.zeros(3)

    def _begin(self, state: Any, P: FloatArray) -> None:
        self.ekf = self.gtsam.NavStateImuEKF(state, P, self.params)

    def increments(self, increments_b: FloatArray) -> FloatArray:
        """Return increments as they are."""
        return increments_b

    def begin(self, dt: float, dtheta: FloatArray) -> None:
        """Take the rate of the first step."""
        self.w_ib_b = dtheta / dt

    def step(
        self, now: float, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray, due: bool
    ) -> None:
        """Go a step on."""
        self.predict(dt, dtheta, dvel, unknown)
        if due:
            self.w_ib_b = dtheta / dt

    def measure(self, now: float, arrived: list[Measurement]) -> None:
        """Use what has arrived."""
        for _, values, variance in arrived:
            self.use_fix(now, values[:6], variance, values[6:], self.w_ib_b)

    def predict(self, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray) -> None:
        """Carry the filter over a step; ``unknown`` (2,) is what a gap adds to velocity and attitude."""
        state = self.ekf.state()
        C_bt = state.attitude().matrix().T
        rest = self.gravity - self.frame.g_t - self.coriolis @ state.velocity()
        self.ekf.predict(dtheta / dt - C_bt @ self.frame.w_t, dvel / dt + C_bt @ rest, dt)
        if unknown.any():
            self._grow(np.diag(np.repeat([unknown[1], 0.0, unknown[0]], 3)))

    def _grow(self, added: FloatArray) -> None:
        self._begin(self.ekf.state(), self.ekf.covariance() + added)

    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return the state (10,) and its covariance (9, 9)."""
        state = self.ekf.state()
        return self.frame.answer(
            state.attitude().matrix(), state.position(), state.velocity(), self.ekf.covariance()
        )

    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return answers at instants (M,) [s], with the innovations since this was called last."""
        table, refused = self.gate.take(last=last)
        state, cov = answers
        blank, none = np.full((len(t), 3), np.nan), np.empty((len(t), 0))
        return NavSolution(
            t=t,
            lla=state[:, :3],
            vel_n=state[:, 3:6],
            q_nb=state[:, 6:],
            gyro_bias_b=blank,
            accel_bias_b=blank,
            cov=cov,
            extra_names=(),
            extra=none,
            extra_sd=none,
            innovations=table,
            events=Events.from_rows(events + refused),
        )

    @property
    def navigated(self) -> Kept[_Navigated]:
        """State and covariance of the filter of gtsam."""
        state = self.ekf.state()
        return _Navigated(
            state.attitude().matrix(), state.position(), state.velocity(), self.ekf.covariance()
        )

    @navigated.setter
    def navigated(self, one: _Navigated) -> None:
        self._begin(self.gtsam.NavState(self.gtsam.Rot3(one.C_tb), one.p_t, one.v_t), one.P)

    def use_fix(
        self, t: float, fix: FloatArray, r: FloatArray, antenna_b: FloatArray, w_b: FloatArray
    ) -> None:
        """Use position and velocity of a fix, each with its own gate; there may be no velocity."""
        place, C_tn = self.frame.locate(fix[:3])
        self.gravity = self.frame.gravity(self.ekf.state().position())
        moving = bool(np.isfinite(fix[3:]).all())
        z, C = np.concatenate([place, C_tn @ fix[3:]]), np.kron(np.eye(2), C_tn)
        R: FloatArray = (C * r) @ C.T
        if moving:
            y, H = self._compare(z, antenna_b, w_b)
            self.gate.see_fix(t, y, H @ self.ekf.covariance() @ H.T + R, np.diag(R)[:3])
        else:
            self.gate.see_position()
        for code in (POSITION, VELOCITY)[: 1 + moving]:
            self._update(t, code, z, R, C_tn, antenna_b, w_b)

    def _compare(
        self, z: FloatArray, antenna_b: FloatArray, w_b: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the innovation (6,) of position and velocity z (6,) of the antenna, t, and H (6, 9)."""
        state = self.ekf.state()
        C_tb = state.attitude().matrix()
        swept = np.cross(w_b - C_tb.T @ self.frame.w_t, antenna_b)
        H = np.zeros((6, 9))
        H[:3, :3], H[3:, :3] = -C_tb @ rotation.skew(antenna_b), -C_tb @ rotation.skew(swept)
        H[:3, 3:6], H[3:, 6:] = C_tb, C_tb
        own = np.concatenate([state.position() + C_tb @ antenna_b, state.velocity() + C_tb @ swept])
        return z - own, H

    def _update(
        self,
        t: float,
        code: int,
        z: FloatArray,
        R: FloatArray,
        C_tn: FloatArray,
        antenna_b: FloatArray,
        w_b: FloatArray,
    ) -> None:
        """Gate and use the position or the velocity of z (6,), t."""
        part = slice(3 * code, 3 * code + 3)
        y, H = (one[part] for one in self._compare(z, antenna_b, w_b))
        P, R = self.ekf.covariance(), R[part, part]
        S = H @ P @ H.T + R
        value = nis(y, S)
        spread, sound = np.diag(C_tn.T @ S @ C_tn), value <= self.gate.limits[3]
        verdict = self.gate.decide(t, code, C_tn.T @ y, spread, value, sound=sound)
        if verdict == REFUSED:
            return
        if verdict != SOUND:
            opens = np.zeros(9, np.bool_)
            opens[3 + 3 * code : 6 + 3 * code] = True
            E = growth(verdict, P @ H.T @ np.linalg.solve(S, y), H, y, opens)
            self._grow(E @ E.T)
        self.ekf.updateWithVector(z[part] - y, H, z[part], R)
