"""An unscented Kalman filter on the error state and the mechanization of the loose filter: slow, no Jacobian.

States, datasheets, gate and predictions are those of `loose_tight.Loose`, but each measurement is
compared with the state at its arrival, however late. A row of H only says along what P grows where a rejected
sensor is re-admitted. Sigma points and their weights are filterpy's (R. van
der Merwe, PhD thesis, Oregon, 2004; S. Julier, J. Uhlmann, Proc. IEEE 92 (3), 2004). An error state x
(estimate minus truth) stands for the truth "estimate less x". Each step draws sigma points of the error about
zero, carries the truth each one stands for through the strapdown with the same increments less its own
biases, and takes the spread of what they became about the carried estimate; the mean is fed back at once. A
measurement is predicted from each of the truths the points stand for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.compilation.compiled import kernel
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Events, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs
from bench.navigation.engine.gate import REFUSED, SOUND, InnovationGate, growth
from bench.navigation.engine.integrity import nis
from bench.navigation.engine.piecewise import InPieces
from bench.navigation.engine.session import Kept, Scratch
from bench.navigation.error_state_filter.aiding_sensors import MAGNETOMETER, magnetic_map, unmodeled
from bench.navigation.error_state_filter.answers import solution
from bench.navigation.error_state_filter.corrections import axes_kernel, reset_kernel
from bench.navigation.error_state_filter.error_state import (
    GYRO,
    PHI,
    VEL,
    less_errors,
    state_errors,
)
from bench.navigation.error_state_filter.measurement_rows import (
    ABSENT,
    POSITION,
    SENSORS,
    call_rows,
    opened_states,
)
from bench.navigation.error_state_filter.propagation import (
    Measurements,
    Pending,
    Site,
    Work,
    pending_for,
    work_for,
)
from bench.navigation.error_state_filter.ranges.ranging import empty_sky, place_fillers
from bench.navigation.error_state_filter.rough_heading import motion_share
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.state_blocks import StateModel, state_model
from bench.navigation.mechanization import body_step_kernel, step_kernel
from bench.navigation.models.loose_tight import Loose
from bench.navigation.models.stepped_filters import Measurement, SteppedFilter, SteppedPassage
from bench.navigation.options import AidingOptions, UnscentedOptions, read_options
from bench.navigation.start import alignment, headings
from bench.navigation.start.restart import between_gaps


@kernel
def carry_kernel(
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


@kernel
def _predict_kernel(
    fill: int,
    truths: FloatArray,
    w_ib_b: FloatArray,
    site: Site,
    z: FloatArray,
) -> int:
    """Fill z (S, 6): predicted minus actual measurement for each of the truths (S, n + 1).

    Return the number of rows, 0 if the measurement tells one of them nothing. The rows that the site ends
    with are those of the first truth. No state of this filter goes by the specific force.
    """
    now, _, _, pending, work = site
    least: int = z.shape[1]
    for s in range(truths.shape[0] - 1, -1, -1):
        for i in range(truths.shape[1]):
            now.state[i] = truths[s, i]
        for i in range(3):
            work.last[0, i] = w_ib_b[i] - truths[s, 10 + i]
        made: int = call_rows(fill, 0, 0, site)
        for i in range(made):
            z[s, i] = pending.z[i]
        least = min(least, made)
    return least


class Unscented:
    """Loosely coupled filter of fixes and every other aiding sensor, by sigma points.

    Options: `bench.navigation.options.UnscentedOptions`.
    """

    def __init__(self, **options: Any) -> None:
        self.options = read_options(UnscentedOptions, options)
        self.loose = Loose(**self.options.model_dump(include=set(AidingOptions.model_fields)))

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate position, velocity, attitude, biases and their covariance."""
        initial, events = alignment.complete(sensors, initial)
        return self.in_pieces(sensors, initial, events).update(sensors, 0.0, last=True)

    def in_pieces(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter before its first piece (`piecewise.RunsInPieces`)."""
        return between_gaps(self._from_start, first, initial, events, self.options.accuracy)

    def _from_start(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> InPieces:
        """Return the filter of :meth:`in_pieces` for a record without long IMU gaps."""
        if headings.heading_is_unknown(initial):
            return headings.ManyHeadings(self._passage, first, initial, events)
        return self._passage(first, initial, events)

    def _passage(self, first: SensorData, initial: InitialState, events: list[EventRow]) -> SteppedPassage:
        used = [sensor for sensor in self.loose.aiding() if getattr(first, sensor.record) is not None]
        model = state_model(initial, first.specs, self.loose.blocks_for(first))
        field = magnetic_map(initial.lla, first.date) if MAGNETOMETER in used else np.zeros((5, 3))
        schedule = Schedule(
            initial.t, first.specs.imu, compensate=False, accuracy=self.options.fix_accuracy, cut=True
        )
        schedule.events += events
        flight = SigmaPointFlight(self.options, model, initial, field)
        return SteppedPassage(flight, schedule, used, first, initial, model.layout)

    @property
    def needs(self) -> tuple[str, ...]:
        """The required records; with GNSS, a barometer is optional."""
        return self.loose.needs

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        taken = {words for block in self.loose.blocks() for words in block.takes}
        return unmodeled(specs, self.loose.aiding(), taken)


@dataclass
class _Points:
    """Sigma points of an error about zero, and their weights."""

    x: FloatArray  # (S, n)
    mean: FloatArray  # (S,)
    cov: FloatArray  # (S,)


class SigmaPointFlight(SteppedFilter):
    """The estimate and its covariance over one record (`stepped_filters.SteppedFilter`)."""

    estimate: Kept[FloatArray]  # (n + 1,) as `propagation.FilterState.state`
    P: Kept[FloatArray]  # (n, n)
    before: Kept[FloatArray]  # (7,) the step before, for coning and sculling
    gate: Kept[InnovationGate]
    covered: Kept[float]  # until when P is carried [s]
    since: Kept[list[tuple[float, FloatArray, FloatArray, FloatArray]]]  # steps since then
    w_ib_b: Kept[FloatArray]  # (3,) of the last step [rad/s]
    data: Scratch[Measurements]
    pending: Scratch[Pending]
    work: Scratch[Work]
    fillers: Scratch[dict[int, int]]  # where the rows of a kind of record are filled
    families: Scratch[dict[int, Any]]  # of sigma points, by the number of states that vary

    one_antenna = False

    def __init__(
        self, options: UnscentedOptions, model: StateModel, initial: InitialState, field: FloatArray
    ) -> None:
        self.options, self.model = options, model
        n = model.layout.size
        self.shapes = ((n + 1,), (n, n))
        self.interval = (1.0 - 1e-6) / options.covariance_hz
        self.estimate = np.concatenate([initial.lla, initial.vel_n, initial.q_nb, model.values[9:]])
        self.P = model.P.copy()
        self.before = np.zeros(7)
        self.gate = InnovationGate(SENSORS, initial.t, options.gate_probability, options.readmit_after_s)
        self.opens = np.array([opened_states(code, model.layout) for code in range(len(SENSORS))])
        self.data = Measurements(np.zeros((1, 9)), np.zeros((1, 6)), np.zeros(3), field, initial.lla.copy())
        self.pending = pending_for(n, 1, 6)
        self.work = work_for(n, model.process.drives)
        self.fillers, self.families = {}, {}
        self.covered, self.since, self.w_ib_b = initial.t, [], np.zeros(3)

    def increments(self, increments_b: FloatArray) -> FloatArray:
        """Return increments as they are."""
        return increments_b

    def begin(self, dt: float, dtheta: FloatArray) -> None:
        """Take the rate of the first step."""
        self.w_ib_b = dtheta / dt

    def step(
        self, now: float, dt: float, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray, due: bool
    ) -> None:
        """Store a step; estimate and covariance are propagated over the stored steps when one is due."""
        self.since.append((dt, dtheta, dvel, unknown))
        if due or now - self.covered >= self.interval:
            spans, turns, gains, lost = (np.array(column) for column in zip(*self.since, strict=True))
            self.predict(spans, turns, gains, lost.sum(axis=0))
            self.covered, self.since, self.w_ib_b = now, [], dtheta / dt

    def measure(self, now: float, arrived: list[Measurement]) -> None:
        """Use the measurements that arrived."""
        for one in arrived:
            self.use(now, one)

    def answer(self, now: float) -> tuple[FloatArray, ...]:
        """Return the state (n + 1,) and its covariance (n, n)."""
        return self.estimate.copy(), self.P.copy()

    def solution(
        self, t: FloatArray, answers: Sequence[FloatArray], events: list[EventRow], *, last: bool
    ) -> NavSolution:
        """Return the solution at epochs (M,) [s], with the innovations since the last call."""
        table, refused = self.gate.take(last=last)
        estimates, P = answers
        return solution(t, self.model.layout, estimates, P, table, Events.from_rows(events + refused))

    def points(self) -> _Points:
        """Draw the sigma points; a state without variance does not move."""
        live = np.flatnonzero(np.diag(self.P) > 0)
        family = self.families.get(len(live))
        if family is None:
            from filterpy.kalman import MerweScaledSigmaPoints

            a = self.options.spread
            beta = max(2.0, (1.0 / a - a) ** 2)  # the least with which no covariance can turn indefinite
            family = MerweScaledSigmaPoints(len(live), alpha=a, beta=beta, kappa=0.0, sqrt_method=root)
            self.families[len(live)] = family
        x = np.zeros((2 * len(live) + 1, len(self.P)))
        x[:, live] = family.sigma_points(np.zeros(len(live)), self.P[np.ix_(live, live)])
        return _Points(x, family.Wm, family.Wc)

    @property
    def lost(self) -> bool:
        """Return whether the filter has diverged; from then on its answers are NaN."""
        return not np.isfinite(self.P).all()

    def predict(self, dt: FloatArray, dtheta: FloatArray, dvel: FloatArray, unknown: FloatArray) -> None:
        """Propagate estimate and covariance over some steps; ``unknown`` (2,) is the variance of a gap."""
        if self.lost:
            self.estimate[:] = np.nan
            return
        process, T, steady = self.model.process, float(dt.sum()), self.estimate[3:5].copy()
        ground_speed = np.hypot(self.estimate[3], self.estimate[4])
        decay = np.exp(-(process.decay_time + process.decay_distance * ground_speed) * T)
        points = self.points()
        x = points.x
        states = np.vstack([less_errors(self.estimate, x), self.estimate])  # truths, and the estimate
        before = np.tile(self.before, (len(states), 1))
        if self.before[6] > 0:  # what each of them takes off the interval before
            before[:-1, :6] += x[:, GYRO : GYRO + 6] * self.before[6]
        carry_kernel(states, before, dt, dtheta, dvel, np.empty((5, 3)), np.empty((3, 3)))
        self.estimate, self.before = states[-1], before[-1]
        after = x * decay
        after[:, :GYRO] = state_errors(self.estimate, states[:-1])[:, :GYRO]
        gained = self.estimate[3:5] - steady
        # Each point turned all of it by its attitude; what noise may be is turned back.
        gained *= 1.0 - motion_share(float(gained @ gained) / T**2, process.q[VEL] / T)
        after[:, VEL] += gained[1] * x[:, PHI + 2]
        after[:, VEL + 1] -= gained[0] * x[:, PHI + 2]
        after[:, VEL + 2] += gained[0] * x[:, PHI + 1] - gained[1] * x[:, PHI]
        mean = points.mean @ after
        spread = after - mean
        self.P = (spread.T * points.cov) @ spread + np.diag(
            np.where(process.stationary > 0, process.stationary * (1 - decay**2), process.q * T)
        )
        self.P[VEL : VEL + 3, VEL : VEL + 3] += unknown[0] * np.eye(3)
        self.P[PHI : PHI + 3, PHI : PHI + 3] += unknown[1] * np.eye(3)
        self.estimate[10:] *= decay[9:]
        self._feed_back(mean)

    def use(self, t: float, one: Measurement) -> None:
        """Use a measurement, with a gate for each of its sub-vectors."""
        self.data.values[0], self.data.variance[0] = one.values, one.variance
        at = 0
        while not self.lost:
            points = self.points()
            z = self._predict(one.kind, points)
            if at >= z.shape[1]:
                return
            code, _, _, m = self.pending.tags[at].tolist()
            if code == POSITION and z.shape[1] == 6:
                y, S, _ = self._expect(points, z)
                self.gate.see_fix(t, -y, S, self.pending.r[:3])
            elif code == POSITION:
                self.gate.see_position()
            if code != ABSENT:
                self._update(t, one.kind, code, slice(at, at + m), points, z)
            at += m

    def _predict(self, kind: int, points: _Points) -> FloatArray:
        """Return predicted minus actual measurements (S, m) for the truths given by the sigma points."""
        site = Site(self.work.ahead, self.data, self.model.index, self.pending, self.work.measure)
        if kind not in self.fillers:
            self.fillers[kind] = int(place_fillers([kind], site, empty_sky())[kind])
        truths, z = less_errors(self.estimate, points.x), np.empty((len(points.x), 6))
        rows = _predict_kernel(self.fillers[kind], truths, self.w_ib_b, site, z)
        return z[:, :rows]

    def _update(self, t: float, kind: int, code: int, part: slice, points: _Points, z: FloatArray) -> None:
        """Gate and use a sub-vector: ``part`` of the rows z (S, m) that the points predict."""
        H, m = self.pending.H[part].copy(), part.stop - part.start
        y, S, K = self._expect(points, z, part)
        value, opens = nis(y, S), self.opens[code]
        verdict = self.gate.decide(
            t, code, -y, np.diag(S), value,
            sound=value <= self.gate.limits[m], opens=bool(opens.any()),
        )  # fmt: skip
        if verdict == REFUSED:
            return
        if verdict != SOUND:
            E = growth(verdict, K @ y, H, y, opens)
            self.P += E @ E.T
            points = self.points()
            y, S, K = self._expect(points, self._predict(kind, points), part)
        P = self.P - K @ S @ K.T
        self.P = 0.5 * (P + P.T)
        self._feed_back(K @ -y)

    def _expect(
        self, points: _Points, z: FloatArray, part: slice = slice(None)
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the mean (m,) and covariance (m, m) of rows z (S, m), and their gain (n, m)."""
        y = z[:, part]
        mean = points.mean @ y
        spread = y - mean
        S = (spread.T * points.cov) @ spread + np.diag(self.pending.r[: z.shape[1]][part])
        cross = (points.x.T * points.cov) @ spread
        return mean, S, np.asarray(np.linalg.solve(S, cross.T).T, np.float64)

    def _feed_back(self, x: FloatArray) -> None:
        """Subtract an expected error from the estimate; P rotates with the axes of the IMU."""
        turn = np.empty((5, 3))
        drives, factor = np.empty((0, 3), np.int64), np.empty(0)
        axes_kernel(self.estimate, x, drives, factor, turn)
        reset_kernel(self.P, turn, drives, factor, np.empty((3, len(self.P))))
        self.estimate = less_errors(self.estimate, x)


def root(P: FloatArray) -> FloatArray:
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
