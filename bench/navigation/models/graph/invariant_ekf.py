"""The invariant EKF of gtsam: attitude, position and velocity as one element of SE2(3).

The error is an element of the group, so that its transition does not depend on the estimate, and a heading
that is wrong by tens of degrees converges where an EKF of sums does not (A. Barrau, S. Bonnabel, IEEE TAC 62
(4), 2017). Nine states: the biases of the IMU have none and act as noise, white with the power of errors that
last for ``bias_time``. Fixes only, their errors taken as white, compared with the state at their arrival.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from typing import Any

import numpy as np

from bench import rotation
from bench.arrays import FloatArray
from bench.data import EventRow, Events, InitialState, Innovations, NavSolution, SensorData
from bench.navigation.engine.integrity import nis, nis_limit
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.error_state_filter.aiding_sensors import FIXES
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.models.classic.process_model import bias_and_walk
from bench.navigation.models.graph.flat_frame import FlatFrame, load_gtsam, schedule_fixes
from bench.navigation.models.stepped_filters import Measured, SteppedPassage
from bench.navigation.options import InvariantOptions, read_options
from bench.navigation.start import alignment
from bench.navigation.start.restart import between_gaps
from bench.specs import AssumedSpecs, ImuSpec

SENSORS = ("gnss_position", "gnss_velocity")


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
        flight = _Flight(load_gtsam(), self.options, first.specs.imu, initial)
        schedule = schedule_fixes(first, initial, events)
        used = [] if first.fixes is None else [FIXES]
        return SteppedPassage(flight, schedule, used, first, initial, StateLayout())

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the estimator has no state for, in words."""
        found = [f"{name} bias" for name, one in _triads(specs.imu) if bias_and_walk(one)[0] > 0]
        return tuple(found)


def _triads(imu: ImuSpec) -> tuple[tuple[str, Any], ...]:
    return ("gyro", imu.gyro), ("accelerometer", imu.accel)


class _Flight:
    """The filter over one record (`stepped_filters.Flight`)."""

    shapes: tuple[tuple[int, ...], ...] = (10,), (9, 9)
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
        self.limit = nis_limit(3, options.gate_probability)
        self.misses = [0, 0]
        self.w_ib_b = np.zeros(3)  # of the last step after which something is measured [rad/s]
        self.innovations: list[tuple[float, int, int, float, float, float, bool]] = []

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

    def measure(self, now: float, arrived: list[Measured]) -> None:
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
        table, self.innovations = Innovations.from_rows(SENSORS, self.innovations), []
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
            events=Events.from_rows(events),
        )

    def copy(self) -> _Flight:
        """Return a filter that goes on from here by itself."""
        other = copy(self)
        other._begin(self.ekf.state(), self.ekf.covariance())
        other.misses, other.innovations = list(self.misses), list(self.innovations)
        return other

    def state(self) -> dict[str, Any]:
        """Return what is carried from one step to the next, as arrays and numbers by name."""
        state = self.ekf.state()
        return {
            "C_tb": state.attitude().matrix(),
            "p_t": state.position(),
            "v_t": state.velocity(),
            "P": self.ekf.covariance(),
            "gravity": self.gravity,
            "misses": self.misses,
            "w_ib_b": self.w_ib_b,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what :meth:`state` returned."""
        attitude = self.gtsam.Rot3(state["C_tb"])
        self._begin(self.gtsam.NavState(attitude, state["p_t"], state["v_t"]), state["P"])
        self.gravity, self.misses, self.w_ib_b = state["gravity"], list(state["misses"]), state["w_ib_b"]

    def use_fix(
        self, t: float, fix: FloatArray, r: FloatArray, antenna_b: FloatArray, w_b: FloatArray
    ) -> None:
        """Use position and velocity of a fix, each gated by itself; there may be no velocity."""
        place, C_tn = self.frame.locate(fix[:3])
        self.gravity = self.frame.gravity(self.ekf.state().position())
        C_tb = self.ekf.state().attitude().matrix()
        self._update(t, 0, place, C_tn, r[:3], antenna_b)
        if np.isfinite(fix[3:]).all():
            swept = np.cross(w_b - C_tb.T @ self.frame.w_t, antenna_b)
            self._update(t, 1, C_tn @ fix[3:], C_tn, r[3:], swept)

    def _update(
        self, t: float, code: int, z: FloatArray, C_tn: FloatArray, r: FloatArray, arm: FloatArray
    ) -> None:
        """Gate and use a vector of t that is, beside the state's own, an arm (3,) along b."""
        state, P = self.ekf.state(), self.ekf.covariance()
        C_tb = state.attitude().matrix()
        own = state.position() if code == 0 else state.velocity()
        H, R = np.zeros((3, 9)), C_tn @ np.diag(r) @ C_tn.T
        H[:, 0:3], H[:, 3 + 3 * code : 6 + 3 * code] = -C_tb @ rotation.skew(arm), C_tb
        predicted = own + C_tb @ arm
        y, S = z - predicted, H @ P @ H.T + R
        value = nis(y, S)
        sound = value <= self.limit
        use = sound or self.misses[code] >= self.options.readmit_after
        self.misses[code] = 0 if use else self.misses[code] + 1
        along, spread = C_tn.T @ y, np.diag(C_tn.T @ S @ C_tn)
        for i in range(3):
            self.innovations.append((t, code, i, along[i], spread[i], value, bool(use)))
        if not use:
            return
        if not sound:
            x = P @ H.T @ np.linalg.solve(S, y)  # as `kalman.open_kernel`
            added = np.outer(x, x)
            added[3 + 3 * code : 6 + 3 * code, 3 + 3 * code : 6 + 3 * code] += np.diag((C_tb.T @ y) ** 2)
            self._grow(added)
        self.ekf.updateWithVector(predicted, H, z, R)
