"""An unscented Kalman filter on the error state and the mechanization of the loose filter: slow, no Jacobian.

States, datasheets, gates and rows are those of `loose_tight.Loose`, but each measurement is
compared with the state at its arrival, however late. Sigma points and their weights are filterpy's (R. van
der Merwe, PhD thesis, Oregon, 2004; S. Julier, J. Uhlmann, Proc. IEEE 92 (3), 2004). An error state x
(estimate minus truth) stands for the truth "estimate less x". Each step draws sigma points of the error about
zero, carries the truth each one stands for through the strapdown with the same increments less its own
biases, and takes the spread of what they became about the carried estimate; the mean is fed back at once. A
measurement is predicted from each of the truths the points stand for.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench import earth, rotation
from bench.arrays import FloatArray
from bench.compiled import kernel
from bench.data import EventRow, Events, InitialState, Innovations, NavSolution, SensorData
from bench.navigation.engine.integrity import OUTAGE, nis, nis_limit, tells_of_drift
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.error_state_filter.aiding_sensors import (
    BARO,
    FIXES,
    AidingSensor,
    records_needed,
    unmodelled,
)
from bench.navigation.error_state_filter.error_state import (
    GYRO,
    PHI,
    POS,
    VEL,
    less_errors,
    reset_kernel,
    state_errors,
)
from bench.navigation.error_state_filter.filter_run import solution
from bench.navigation.error_state_filter.measurement_rows import FIX_ROWS
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.state_blocks import BARO_BIAS, StateModel, state_model
from bench.navigation.mechanization import body_step_kernel, step_kernel
from bench.navigation.models.stepped_filters import Measured, SteppedPassage
from bench.navigation.options import UnscentedOptions, read_options
from bench.navigation.start import alignment, headings
from bench.navigation.start.restart import between_gaps
from bench.specs import AssumedSpecs

SENSORS = ("gnss_position", "gnss_velocity", "baro")
_STEP = ("dt", "dtheta", "dvel", "unknown")  # what a step is made of


@kernel
def _carry_kernel(
    points: FloatArray,
    before: FloatArray,
    dt: FloatArray,
    dtheta_b: FloatArray,
    dvel_b: FloatArray,
    work: FloatArray,
    C: FloatArray,
) -> None:
    """Carry filter states ``points`` (S, n + 1), each with its own biases, over the same increments.

    ``before`` (S, 7) is the interval before, for coning and sculling, as each of them knows it.
    """
    dth, dv, rotvec, dv_start, dv_n = work[0], work[1], work[2], work[3], work[4]
    for s in range(points.shape[0]):
        for k in range(dt.shape[0]):
            for i in range(3):
                dth[i] = dtheta_b[k, i] - points[s, 10 + i] * dt[k]
                dv[i] = dvel_b[k, i] - points[s, 13 + i] * dt[k]
            body_step_kernel(dt[k], dth, dv, before[s], rotvec, dv_start)
            step_kernel(points[s], dt[k], rotvec, dv_start, C, dv_n)


class Unscented:
    """Loosely coupled INS/GNSS/baro by sigma points.

    Options: `bench.navigation.options.UnscentedOptions`.
    """

    def __init__(self, **options: Any) -> None:
        self.options = read_options(UnscentedOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, biases and their covariance."""
        initial, events = alignment.complete(sensors, initial)
        return self.in_pieces(sensors, initial, events).feed(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        return between_gaps(self._from_start, first, initial, events, self.options.accuracy)

    def _from_start(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return what :meth:`in_pieces` does, for a record without long gaps of the IMU."""
        if headings.heading_is_unknown(initial):
            return headings.ManyHeadings(self._passage, first, initial, events)
        return self._passage(first, initial, events)

    def _passage(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> SteppedPassage:
        used = [sensor for sensor in self._aiding() if getattr(first, sensor.record) is not None]
        model = state_model(initial, first.specs, [BARO_BIAS] if BARO in used else [])
        schedule = Schedule(
            initial.t, first.specs.imu, compensate=False, accuracy=self.options.fix_accuracy, cut=True
        )
        schedule.events += events
        flight = _Flight(self.options, model, initial)
        return SteppedPassage(flight, schedule, used, first, initial, model.layout)

    @property
    def needs(self) -> tuple[str, ...]:
        """The records it cannot work without; a barometer beside GNSS is used if there is one."""
        return records_needed(self._aiding())

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the estimator has no state for, in words."""
        return unmodelled(specs, self._aiding(), ())

    def _aiding(self) -> list[AidingSensor]:
        return [FIXES] * self.options.gnss + [BARO] * self.options.baro


@dataclass
class _Points:
    """Sigma points of an error about zero, and their weights."""

    x: FloatArray  # (S, n)
    mean: FloatArray  # (S,)
    cov: FloatArray  # (S,)


class _Flight:
    """The estimate and its covariance over one record (`stepped_filters.Flight`)."""

    one_antenna = False

    def __init__(self, options: UnscentedOptions, model: StateModel, initial: InitialState) -> None:
        self.options, self.model = options, model
        n = model.layout.size
        self.shapes: tuple[tuple[int, ...], ...] = ((n + 1,), (n, n))
        self.interval = (1.0 - 1e-6) / options.covariance_hz
        rest = np.zeros(model.layout.size - 9)
        self.estimate = np.concatenate([initial.lla, initial.vel_n, initial.q_nb, rest])
        self.P = model.P.copy()
        self.before = np.zeros(7)
        self.gates = {m: nis_limit(m, options.gate_probability) for m in (1, 3)}
        self.misses = [0, 0, 0]
        self.used = initial.t  # instant of the last fix of which a part was used [s]
        self.innovations: list[tuple[float, int, int, float, float, float, bool]] = []
        self.families: dict[int, Any] = {}  # of sigma points, by the number of states that vary
        self.covered = initial.t  # until when P is carried [s]
        self.since: list[tuple[float, FloatArray, FloatArray, FloatArray]] = []  # steps since
        self.w_ib_b = np.zeros(3)  # of the last step [rad/s]

    def increments(self, increments_b: FloatArray) -> FloatArray:
        """Return increments as they are."""
        return increments_b

    def begin(self, dt: float, dtheta: FloatArray) -> None:
        """Take the rate of the first step."""
        self.w_ib_b = dtheta / dt

    def step(
        self, now: float, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray, due: bool
    ) -> None:
        """Go a step on: estimate and covariance are carried over all that were not when it is time."""
        self.since.append((dt, dtheta, dvel, unknown))
        if due or now - self.covered >= self.interval:
            spans, turns, gains, lost = (np.array(column) for column in zip(*self.since, strict=True))
            self.predict(spans, turns, gains, lost.sum(axis=0))
            self.covered, self.since, self.w_ib_b = now, [], dtheta / dt

    def measure(self, now: float, arrived: list[Measured]) -> None:
        """Use what has arrived."""
        for kind, values, variance in arrived:
            if kind == FIX_ROWS:
                self.use_fix(now, values[:6], variance, values[6:], self.w_ib_b)
            else:
                self.use_baro(now, float(values[0]), float(variance[0]))

    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return the state (n + 1,) and its covariance (n, n)."""
        return self.estimate.copy(), self.P.copy()

    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return answers at instants (M,) [s], with the innovations since this was called last."""
        table, self.innovations = Innovations.from_rows(SENSORS, self.innovations), []
        estimates, P = answers
        return solution(t, self.model.layout, estimates, P, table, Events.from_rows(events))

    def copy(self) -> _Flight:
        """Return a filter that goes on from here by itself."""
        other = copy(self)
        other.estimate, other.P, other.misses = self.estimate.copy(), self.P.copy(), list(self.misses)
        other.since, other.innovations = list(self.since), list(self.innovations)
        return other

    def state(self) -> dict[str, Any]:
        """Return what is carried from one step to the next, as arrays and numbers by name."""
        return {
            "estimate": self.estimate,
            "P": self.P,
            "before": self.before,
            "misses": self.misses,
            "used": self.used,
            "covered": self.covered,
            "since": {str(k): dict(zip(_STEP, step, strict=True)) for k, step in enumerate(self.since)},
            "w_ib_b": self.w_ib_b,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Take over what :meth:`state` returned."""
        self.estimate, self.P, self.before = state["estimate"], state["P"], state["before"]
        self.misses, self.covered, self.w_ib_b = list(state["misses"]), state["covered"], state["w_ib_b"]
        self.used = state["used"]
        self.since = [(one["dt"], *(one[name] for name in _STEP[1:])) for one in state["since"].values()]

    def points(self) -> _Points:
        """Draw the sigma points; a state without variance does not move."""
        live = np.flatnonzero(np.diag(self.P) > 0)
        family = self.families.get(len(live))
        if family is None:
            from filterpy.kalman import MerweScaledSigmaPoints

            a = self.options.spread
            beta = max(2.0, (1.0 / a - a) ** 2)  # the least with which no covariance can turn indefinite
            family = MerweScaledSigmaPoints(len(live), alpha=a, beta=beta, kappa=0.0, sqrt_method=_root)
            self.families[len(live)] = family
        x = np.zeros((2 * len(live) + 1, len(self.P)))
        x[:, live] = family.sigma_points(np.zeros(len(live)), self.P[np.ix_(live, live)])
        return _Points(x, family.Wm, family.Wc)

    @property
    def lost(self) -> bool:
        """Whether there is no estimate any more: a diverged filter gives NaN from here on."""
        return not np.isfinite(self.P).all()

    def predict(self, dt: FloatArray, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray) -> None:
        """Carry estimate and covariance over some steps; ``unknown`` (2,) is what a gap adds to P."""
        if self.lost:
            self.estimate[:] = np.nan
            return
        process, T = self.model.process, float(dt.sum())
        ground_speed = np.hypot(self.estimate[3], self.estimate[4])
        decay = np.exp(-(process.decay_time + process.decay_distance * ground_speed) * T)
        points = self.points()
        x = points.x
        states = np.vstack([less_errors(self.estimate, x), self.estimate])  # truths, and the estimate
        before = np.tile(self.before, (len(states), 1))
        if self.before[6] > 0:  # what each of them takes off the interval before
            before[:-1, :6] += x[:, GYRO : GYRO + 6] * self.before[6]
        _carry_kernel(states, before, dt, dtheta, dvel, np.empty((5, 3)), np.empty((3, 3)))
        self.estimate, self.before = states[-1], before[-1]
        after = x * decay
        after[:, :GYRO] = state_errors(self.estimate, states[:-1])[:, :GYRO]
        mean = points.mean @ after
        spread = after - mean
        self.P = (spread.T * points.cov) @ spread + np.diag(
            np.where(process.stationary > 0, process.stationary * (1 - decay**2), process.q * T)
        )
        self.P[VEL : VEL + 3, VEL : VEL + 3] += unknown[0] * np.eye(3)
        self.P[PHI : PHI + 3, PHI : PHI + 3] += unknown[1] * np.eye(3)
        self.estimate[10:] *= decay[9:]
        self._feed_back(mean)

    def use_fix(
        self,
        t: float,
        fix: FloatArray,
        r: FloatArray,
        antenna_b: FloatArray,
        w_ib_b: FloatArray,
    ) -> None:
        """Use position and velocity of a fix, each gated by itself; there may be no velocity."""
        if self.lost:
            return

        def place(x: FloatArray) -> FloatArray:
            truth = less_errors(self.estimate, x)
            return rotation.rotate(truth[:, 6:10], antenna_b) + earth.difference_n(truth[:, :3], fix[:3])

        def motion(x: FloatArray) -> FloatArray:
            truth = less_errors(self.estimate, x)
            lat, q_nb = self.estimate[0], truth[:, 6:10]
            earth_n = earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
            w_b = w_ib_b - truth[:, 10:13] - rotation.rotate(rotation.conjugate(q_nb), earth_n)
            return truth[:, 3:6] + rotation.rotate(q_nb, np.cross(w_b, antenna_b)) - fix[3:]

        moving, drifted = bool(np.isfinite(fix[3:]).all()), False
        if moving and t - self.used >= OUTAGE and self.misses[:2] == [0, 0]:
            y, S, _ = self._expect(lambda x: np.hstack([place(x), motion(x)]), r)
            drifted = tells_of_drift(y, S, r[:3], self.gates[3])
        self._update(t, 0, place, r[:3], slice(POS, POS + 3), drifted)
        if moving:
            self._update(t, 1, motion, r[3:], slice(VEL, VEL + 3), drifted)

    def use_baro(self, t: float, alt_baro: float, r: float) -> None:
        """Use a barometric altitude."""
        if self.lost:
            return

        at = self.model.index.baro_bias

        def height(x: FloatArray) -> FloatArray:
            y = self.estimate[2] + x[:, POS + 2] - alt_baro + self.estimate[at + 1] - x[:, at]
            return np.asarray(y[:, None])

        self._update(t, 2, height, np.array([r]), slice(at, at + 1))

    def _update(
        self,
        t: float,
        code: int,
        measure: Callable[[FloatArray], FloatArray],
        r: FloatArray,
        own: slice,
        drifted: bool = False,
    ) -> None:
        """Gate and use a sub-vector of the states ``own``.

        ``measure`` says of errors (S, n) what the truth is predicted to show less what was measured (S, m).
        """
        y, S, K = self._expect(measure, r)
        value = nis(y, S)
        sound = value <= self.gates[len(r)]
        use = sound or drifted or self.misses[code] >= self.options.readmit_after
        self.misses[code] = 0 if use else self.misses[code] + 1
        for i in range(len(r)):
            self.innovations.append((t, code, i, -y[i], S[i, i], value, use))
        if not use:
            return
        if code < 2:
            self.used = t
        if not sound:
            x = K @ y  # as `kalman.open_kernel`, or `stretch_kernel`
            self.P += np.outer(x, x)
            if not drifted:
                self.P[own, own] += np.diag(y**2)
            y, S, K = self._expect(measure, r)
        P = self.P - K @ S @ K.T
        self.P = 0.5 * (P + P.T)
        self._feed_back(K @ -y)

    def _expect(self, measure: Callable[[FloatArray], FloatArray], r: FloatArray) -> tuple[FloatArray, ...]:
        """Return the mean (m,) and covariance (m, m) of a sub-vector, and its gain (n, m)."""
        points = self.points()
        y = measure(points.x)
        mean = points.mean @ y
        spread = y - mean
        S = (spread.T * points.cov) @ spread + np.diag(r)
        cross = (points.x.T * points.cov) @ spread
        return mean, S, np.asarray(np.linalg.solve(S, cross.T).T, np.float64)

    def _feed_back(self, x: FloatArray) -> None:
        """Take an expected error off the estimate; the tilts turn with the axes of the unit."""
        self.estimate = less_errors(self.estimate, x)
        reset_kernel(self.P, float(x[PHI + 2]))


def _root(P: FloatArray) -> FloatArray:
    """Return U with U' U = P, each state scaled by its deviation; P may be singular (a course is a velocity).

    Raises
    ------
    numpy.linalg.LinAlgError
        When P has a negative eigenvalue beyond rounding.
    """
    sd = np.sqrt(np.diag(P))
    w, V = np.linalg.eigh(P / sd[:, None] / sd)
    if w[0] < -1e-9:
        raise np.linalg.LinAlgError(f"the covariance of the sigma points has an eigenvalue of {w[0]:.2g}")
    return np.asarray(np.sqrt(np.maximum(w, 0.0))[:, None] * V.T * sd, np.float64)
