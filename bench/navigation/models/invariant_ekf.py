"""The invariant EKF: attitude, position and velocity as one element of SE2(3), and the biases of the IMU.

The error is an element of the group, in body axes: true state = state * error. Its transition does not
depend on the estimate but through the biases, and a heading that is wrong by tens of degrees converges where
an EKF of sums does not (A. Barrau, S. Bonnabel, IEEE TAC 62 (4), 2017; with biases: "imperfect"). Attitude
counts by its rotation vector, position and velocity as they stand, so that a fix is linear in them: by the
exponential of all three each noise of a fix would seem to tell the heading. Fifteen states. Fixes only, their
errors taken as white, compared with the state at their arrival.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs, ImuSpec
from bench.navigation.engine.gate import REFUSED, SOUND, InnovationGate, growth
from bench.navigation.engine.integrity import nis
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.engine.session import Kept
from bench.navigation.error_state_filter.aiding_sensors import FIXES, unmodeled
from bench.navigation.error_state_filter.answers import answers as join_answers
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.measurement_rows import POSITION, SENSORS, VELOCITY
from bench.navigation.error_state_filter.rough_heading import motion_share
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.models.classic.process_model import bias_and_walk
from bench.navigation.models.flat_frame import FlatFrame
from bench.navigation.models.stepped_filters import Measurement, SteppedFilter, SteppedPassage
from bench.navigation.options import InvariantOptions, read_options
from bench.navigation.start import alignment
from bench.navigation.start.restart import between_gaps


class InvariantEkf:
    """INS/GNSS on SE2(3).

    Options: `bench.navigation.options.InvariantOptions`.
    """

    needs = ("fixes",)

    def __init__(self, **options: Any) -> None:
        self.options = read_options(InvariantOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude and biases."""
        initial, events = alignment.complete(sensors, initial)
        return self.in_pieces(sensors, initial, events).update(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        return between_gaps(self._passage, first, initial, events, "datasheet")

    def _passage(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> SteppedPassage:
        flight = InvariantFlight(self.options, first.specs.imu, initial)
        schedule = Schedule(initial.t, first.specs.imu, compensate=False, cut=True)
        schedule.events += events
        used = [] if first.fixes is None else [FIXES]
        return SteppedPassage(flight, schedule, used, first, initial, StateLayout())

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        return unmodeled(specs, [FIXES], ())


class InvariantFlight(SteppedFilter):
    """The filter over one record (`stepped_filters.SteppedFilter`), in the frame t of `flat_frame`.

    P (15, 15) is of the errors of attitude, position and velocity, b, and of gyro and accelerometer bias,
    truth less estimate.
    """

    C_tb: Kept[FloatArray]  # (3, 3)
    p_t: Kept[FloatArray]  # (3,) [m]
    v_t: Kept[FloatArray]  # (3,) [m/s]
    bias: Kept[FloatArray]  # (6,) of gyro [rad/s] and accelerometer [m/s^2], b
    P: Kept[FloatArray]
    gravity: Kept[FloatArray]  # (3,) at the last fix [m/s^2]
    gate: Kept[InnovationGate]
    w_ib_b: Kept[FloatArray]  # (3,) measured in the last step after which something is compared [rad/s]

    shapes = (16,), (9, 9), (6,)
    one_antenna = False

    def __init__(self, options: InvariantOptions, imu: ImuSpec, initial: InitialState) -> None:
        self.options = options
        self.frame = FlatFrame.at(initial.lla, not options.flat)
        self.P = np.zeros((15, 15))
        self.C_tb, self.p_t, self.v_t, self.P[:9, :9] = self.frame.begin(initial)
        across = -self.frame.turn_errors(initial) @ initial.bias_cov  # biases here are truth less estimate
        self.P[:9, 9:], self.P[9:, :9] = across, across.T
        self.bias, self.q = np.zeros(6), np.zeros(15)
        for rows, noisy, one in (
            (slice(9, 12), slice(0, 3), imu.gyro),
            (slice(12, 15), slice(6, 9), imu.accel),
        ):
            start, walk = bias_and_walk(one)
            self.P[rows, rows] = np.eye(3) * start**2
            self.q[noisy], self.q[rows] = one.random_walk**2, walk**2
        self.gravity = self.frame.gravity(self.p_t)
        self.coriolis = 2.0 * rotation.skew(self.frame.w_t)
        self.gate = InnovationGate(SENSORS, initial.t, options.gate_probability, options.readmit_after_s)
        self.w_ib_b = np.zeros(3)

    def increments(self, increments_b: FloatArray) -> FloatArray:
        """Return increments as they are."""
        return increments_b

    def begin(self, dt: float, dtheta: FloatArray) -> None:
        """Take the rate of the first step."""
        self.w_ib_b = dtheta / dt

    def step(
        self, now: float, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray, due: bool
    ) -> None:
        """Advance by a step."""
        self.predict(dt, dtheta, dvel, unknown)
        if due:
            self.w_ib_b = dtheta / dt

    def measure(self, now: float, arrived: list[Measurement]) -> None:
        """Use the measurements that arrived."""
        for _, values, variance in arrived:
            self.use_fix(now, values[:6], variance, values[6:])

    def predict(self, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray) -> None:
        """Propagate over a step; ``unknown`` (2,) is the variance of velocity and attitude due to a gap."""
        turn = dtheta - (self.bias[:3] + self.C_tb.T @ self.frame.w_t) * dt
        push = dvel - self.bias[3:] * dt
        C_tb = self.C_tb
        half = C_tb @ rotation.matrix(rotation.from_rotvec(0.5 * turn))
        gained = half @ push + (self.gravity - self.coriolis @ self.v_t) * dt
        self.p_t = self.p_t + (self.v_t + 0.5 * gained) * dt
        self.v_t = self.v_t + gained
        self.C_tb = C_tb @ rotation.matrix(rotation.from_rotvec(turn))
        F = np.zeros((15, 15))
        F[:3, :3] = F[3:6, 3:6] = F[6:9, 6:9] = -rotation.skew(turn)
        F[3:6, 6:9] = np.eye(3) * dt
        F[6:9, :3] = -rotation.skew(push)
        down = self.gravity / np.linalg.norm(self.gravity)
        noise = gained - down * (down @ gained)  # an attitude error turned it all: not what noise may be
        noise *= 1.0 - motion_share(float(noise @ noise) / dt**2, self.q[6] / dt)
        across, down = np.cross(noise, down) @ C_tb, down @ C_tb
        F[6:9, :3] += np.outer(across, down) - np.outer(down, across)
        F[:3, 9:12] = F[6:9, 12:] = -np.eye(3) * dt
        Phi = np.eye(15) + F + 0.5 * (F @ F)
        added = self.q * dt
        added[:3] += unknown[1]
        added[6:9] += unknown[0]
        self.P = Phi @ self.P @ Phi.T + np.diag(added)

    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return state and biases (16,), the covariance (9, 9) and the variances of the biases (6,)."""
        state, cov = self.frame.answer(self.C_tb, self.p_t, self.v_t, self.P[:9, :9])
        return np.concatenate([state, self.bias]), cov, np.diag(self.P)[9:]

    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return the solution at epochs (M,) [s], with the innovations since the last call."""
        table, refused = self.gate.take(last=last)
        state, cov, variance = answers
        told = Events.from_rows(events + refused)
        return join_answers(t, StateLayout(), state, cov, variance, table, told)

    def use_fix(self, t: float, fix: FloatArray, r: FloatArray, antenna_b: FloatArray) -> None:
        """Use position and velocity of a fix, each with its own gate; there may be no velocity."""
        place, C_tn = self.frame.locate(fix[:3])
        self.gravity = self.frame.gravity(self.p_t)
        moving = bool(np.isfinite(fix[3:]).all())
        z, C = np.concatenate([place, C_tn @ fix[3:]]), np.kron(np.eye(2), C_tn)
        R: FloatArray = (C * r) @ C.T
        if moving:
            y, H = self.compare(z, antenna_b)
            self.gate.see_fix(t, y, H @ self.P @ H.T + R, np.diag(R)[:3])
        else:
            self.gate.see_position()
        for code in (POSITION, VELOCITY)[: 1 + moving]:
            self._update(t, code, z, R, C_tn, antenna_b)

    def compare(self, z: FloatArray, antenna_b: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the innovation (6,) of position and velocity z (6,) of the antenna, t, and H (6, 15)."""
        C_tb, arm = self.C_tb, rotation.skew(antenna_b)
        earth_b = C_tb.T @ self.frame.w_t
        swept = np.cross(self.w_ib_b - self.bias[:3] - earth_b, antenna_b)
        H = np.zeros((6, 15))
        H[:3, :3], H[3:, :3] = -C_tb @ arm, C_tb @ (arm @ rotation.skew(earth_b) - rotation.skew(swept))
        H[:3, 3:6], H[3:, 6:9] = C_tb, C_tb
        H[3:, 9:12] = C_tb @ arm
        return z - np.concatenate([self.p_t + C_tb @ antenna_b, self.v_t + C_tb @ swept]), H

    def _update(
        self, t: float, code: int, z: FloatArray, R: FloatArray, C_tn: FloatArray, antenna_b: FloatArray
    ) -> None:
        """Gate and use the position or the velocity of z (6,), t."""
        part = slice(3 * code, 3 * code + 3)
        y, H = (one[part] for one in self.compare(z, antenna_b))
        R = R[part, part]
        S = H @ self.P @ H.T + R
        value = nis(y, S)
        spread, sound = np.diag(C_tn.T @ S @ C_tn), value <= self.gate.limits[3]
        verdict = self.gate.decide(t, code, C_tn.T @ y, spread, value, sound=sound)
        if verdict == REFUSED:
            return
        if verdict != SOUND:
            opens = np.zeros(15, np.bool_)
            opens[3 + 3 * code : 6 + 3 * code] = True
            E = growth(verdict, self.P @ H.T @ np.linalg.solve(S, y), H, y, opens)
            self.P = self.P + E @ E.T
            S = H @ self.P @ H.T + R
        K = np.linalg.solve(S, H @ self.P).T
        J = np.eye(15) - K @ H
        self.P = J @ self.P @ J.T + K @ R @ K.T
        self.feed_back(K @ y)

    def feed_back(self, x: FloatArray) -> None:
        """Move the estimate by an error x (15,), and P to the errors of the moved estimate."""
        turn = rotation.matrix(rotation.from_rotvec(x[:3]))
        self.p_t, self.v_t = self.p_t + self.C_tb @ x[3:6], self.v_t + self.C_tb @ x[6:9]
        self.C_tb = self.C_tb @ turn
        self.bias = self.bias + x[9:]
        turned = np.eye(15)
        turned[:3, :3] -= 0.5 * rotation.skew(x[:3])
        turned[3:6, 3:6] = turned[6:9, 6:9] = turn.T
        self.P = turned @ self.P @ turned.T
