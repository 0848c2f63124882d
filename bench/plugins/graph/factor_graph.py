"""A factor graph over a whole record: motion and biases at its nodes, joined by preintegrated IMU factors.

A node at the start, at every fix and at every answer. Between two of them one factor of gtsam holds all
samples of the IMU (C. Forster et al., IEEE TRO 33 (1), 2017); the biases are walks or Gauss-Markov processes.
The graph is a chain. The first pass along it is a filter, whose estimate is the first guess; Gauss and Newton
then fit all nodes at once, every factor linearized at the fit before. Each pass eliminates node after node by
QR: no information matrix is formed, whose condition is the square, so that fine units keep their digits. The
covariance comes back along the chain as a sum of squares and cannot lose its sign.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import block_diag, solve_triangular

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Events, InitialState, NavSolution, SensorData
from bench.core.records.sensor_specs import AssumedSpecs, ImuSpec
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.earthbound import Earthbound
from bench.navigation.engine.gate import REFUSED, SOUND, InnovationGate, growth
from bench.navigation.engine.integrity import nis
from bench.navigation.error_state_filter.aiding_sensors import FIXES
from bench.navigation.error_state_filter.answers import answers
from bench.navigation.error_state_filter.error_state import StateLayout
from bench.navigation.error_state_filter.imu_states import core_states
from bench.navigation.error_state_filter.measurement_rows import POSITION, SENSORS, VELOCITY
from bench.navigation.error_state_filter.schedule import Schedule
from bench.navigation.error_state_filter.step_entries import OUTPUT
from bench.navigation.models.flat_frame import FlatFrame, load_gtsam
from bench.navigation.models.loose_tight import Loose
from bench.navigation.options import read_options
from bench.navigation.start import alignment
from bench.navigation.start.whole_records import run_between_gaps
from bench.plugins.graph.graph_options import GraphOptions

ESTIMATORS = {
    "graph-smoother": {
        "title": "loose-15 as a factor graph of gtsam over a whole record with white fixes, slow "
        "(extra 'graph')",
        "model": "bench.plugins.graph.graph_options:GraphOptions",
        "package": "gtsam",
    },
}
"""Name of a filter -> its row in `bench.navigation.built_in`."""

_SMALL = 0.01  # step of the last pass, in standard deviations
_LEAST = np.array([1e-7, 1e-6, 1e-10, 1e-8])  # of noise of gyro and accelerometer, of their biases, SI
_LEAST_SD = 1e-6  # of start and fixes, m, m/s, rad: a course is a velocity, and P may be singular
_LEAST_WALK = 1e-6  # of a bias from node to node, over that at the start


class GraphSmoother:
    """INS/GNSS smoother as a factor graph.

    Innovations are those of the first pass; what its test rejects is left out of the graph.

    Options: `bench.plugins.graph.graph_options.GraphOptions`.
    """

    needs = ("fixes",)

    def __init__(self, **options: Any) -> None:
        self.options = read_options(GraphOptions, options)

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate each time from all fixes of the record, earlier and later.

        Raises
        ------
        bench.EstimatorError
            Where :meth:`check_sensors` says why, and as for an alignment.
        """
        if sensors.fixes is not None and (said := self.check_sensors(sensors.specs)):
            raise EstimatorError(said)
        return run_between_gaps(self._run, sensors, initial, "datasheet")

    def _run(self, sensors: SensorData, initial: InitialState, _: float | None) -> NavSolution:
        gtsam = load_gtsam()
        initial, events = alignment.complete(sensors, initial)
        schedule = Schedule(initial.t, sensors.specs.imu, compensate=False, cut=True)
        schedule.events += events
        schedule.take(sensors, last=True)
        if sensors.fixes is not None:
            schedule.add(FIXES, sensors, initial, StateLayout())
        plan, events = schedule.plan(), schedule.events
        steps = plan.steps
        dtheta, dvel = (one[steps.row] * steps.share[:, None] for one in (steps.dtheta_b, steps.dvel_b))
        dvel = dvel + 0.5 * np.cross(dtheta, dvel)  # along the axes at the start of the step
        chain = Chain(gtsam, self.options, sensors, initial)
        done, outputs, waiting = -1, [], iter(plan.outputs.tolist())
        for k, action, _, row, _ in plan.entries.tolist():
            if k > done:
                part = slice(done + 1, k + 1)
                unknown = steps.unknown[part].sum(axis=0)
                chain.links.append(Link(steps.span[part], dtheta[part], dvel[part], unknown))
                chain.fixes.append([])
                done = k
            if action == OUTPUT:
                outputs.append((next(waiting), len(chain.links)))
            else:
                w_b = dtheta[max(k, 0)] / steps.span[max(k, 0)]
                now = float(steps.t[k]) if k >= 0 else initial.t
                chain.fixes[-1] += chain.read_fix(now, plan.measured[row, :6], plan.variance[row], w_b)
        m = len(sensors.output_t)
        out, cov, variance = np.full((m, 16), np.nan), np.full((m, 9, 9), np.nan), np.full((m, 6), np.nan)
        try:
            passes = chain.solve(self.options.passes) if outputs else 1
        except (RuntimeError, ValueError) as error:  # no solution is a result
            text = f"the graph has no solution: {str(error).strip().splitlines()[0]}"
            events.append((initial.t, float(sensors.output_t[-1]), "graph", text))
        else:
            for at, node in outputs:
                out[at], cov[at], variance[at] = chain.answer(node)
            if not passes:
                text = f"the fit still moves after {self.options.passes} passes"
                events.append((initial.t, float(sensors.output_t[-1]), "graph", text))
        events += Earthbound().end_answers(sensors.output_t, out, cov, variance)
        table, refused = chain.gate.take(last=True)
        told = Events.from_rows(events + refused)
        return answers(sensors.output_t, StateLayout(), out, cov, variance, table, told)

    def check_sensors(self, specs: AssumedSpecs) -> str:
        """Return the reason why the filter rejects the assumed receiver; "" if its errors are white.

        Averaged over a whole record, errors that last for minutes would leave a covariance ten times too
        small.
        """
        gnss = specs.gnss
        if gnss is None or not max(gnss.pos_h_markov_sd, gnss.pos_v_markov_sd, gnss.vel_markov_sd):
            return ""
        return (
            f"it assumes white errors of fixes, but the errors of {gnss.name!r} last for minutes; "
            "'smoother' has states for them"
        )

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        return Loose(gnss_markov=False, baro=False, compensate_latency=False).unmodeled_errors(specs)


class Link(NamedTuple):
    """IMU measurements between two nodes."""

    dt: FloatArray  # (K,)
    dtheta: FloatArray  # (K, 3)
    dvel: FloatArray  # (K, 3)
    unknown: FloatArray  # (2,) variance of velocity and attitude that a gap adds


class _Vector(NamedTuple):
    """Position or velocity of a fix."""

    t: float
    code: int  # POSITION or VELOCITY
    z: FloatArray  # (3,), t
    C_tn: FloatArray  # (3, 3)
    r: FloatArray  # (3,) variance, n
    w_b: FloatArray  # (3,) rate measured


class _Biases:
    """The processes of the biases, accelerometers first, as in gtsam."""

    def __init__(self, specs: AssumedSpecs) -> None:
        gyro, accel = core_states(specs, changing=False)[3:]
        self.variance, self.density, self.decay = (
            np.concatenate([np.broadcast_to(getattr(one, name), 3) for one in (accel, gyro)])
            for name in ("variance", "density", "decay_time")
        )
        self.sd = np.maximum(np.sqrt(self.variance), np.repeat(_LEAST[[3, 2]], 3))

    def over(self, dt: float) -> tuple[FloatArray, FloatArray]:
        """Return the decay factor of each bias over a time, and the sigma of its new noise (6,)."""
        twice = 2.0 * self.decay * dt
        grown = np.where(twice > 0, -np.expm1(-twice) / np.where(twice > 0, twice, 1.0), 1.0)
        new = np.sqrt(self.density * dt * grown)
        return np.exp(-0.5 * twice), np.maximum(new, _LEAST_WALK * self.sd)


class Chain:
    """The nodes, their factors, and the elimination along them.

    The error of a node (15,) is that of gtsam: attitude, position and velocity along the body axes, then the
    biases of the accelerometers and gyros.
    """

    def __init__(self, gtsam: Any, options: GraphOptions, sensors: SensorData, initial: InitialState) -> None:
        self.gtsam, self.frame = gtsam, FlatFrame.at(initial.lla, not options.flat)
        self.imu, self.antenna_b = sensors.specs.imu, sensors.antenna_b
        self.biases = _Biases(sensors.specs)
        C_tb, p_t, v_t, P = self.frame.begin(initial)
        self.prior = gtsam.NavState(gtsam.Rot3(C_tb), p_t, v_t)
        self.R0 = np.zeros((15, 15))
        self.R0[:9, :9] = _triangle(_invert_root(P + _LEAST_SD**2 * np.eye(9)))
        self.R0[9:, 9:] = np.diag(1.0 / self.biases.sd)
        self.states, self.bias = [self.prior], [np.zeros(6)]
        self.links: list[Link] = []
        self.fixes: list[list[_Vector]] = [[]]
        self.gate = InnovationGate(SENSORS, initial.t, options.gate_probability, options.readmit_after_s)

    def read_fix(self, t: float, fix: FloatArray, r: FloatArray, w_b: FloatArray) -> list[_Vector]:
        """Return position and velocity of a fix, which may have no velocity."""
        p_t, C_tn = self.frame.locate(fix[:3])
        r = np.maximum(r, _LEAST_SD**2)
        found = [_Vector(t, 0, p_t, C_tn, r[:3], w_b)]
        if np.isfinite(fix[3:]).all():
            found.append(_Vector(t, 1, C_tn @ fix[3:], C_tn, r[3:], w_b))
        return found

    def solve(self, most: int) -> int:
        """Fit all nodes; return the number of passes, or 0 if the fit did not converge."""
        preintegrated: list[Any] = []
        for k in range(1, most + 1):
            if k <= 2:  # anew with the biases and attitudes of the first pass
                preintegrated = []
            self._eliminate(preintegrated, first=k == 1)
            if self._substitute_back() < _SMALL:
                return k
        return 0

    def _eliminate(self, preintegrated: list[Any], *, first: bool) -> None:
        """Eliminate along the chain; the ``first`` pass is a filter that predicts nodes and tests fixes."""
        self.rows: list[FloatArray] = []
        self.moved = np.zeros((len(self.fixes), 15))  # since the link before was linearized
        r, _, J = self._difference(self.prior, self.states[0])
        before = np.eye(15)
        before[:9, :9] = J
        Rz = np.column_stack([self.R0 @ before, -self.R0 @ np.concatenate([r, self.bias[0]])])
        for k, fixes in enumerate(self.fixes):
            kept = []
            for i, one in enumerate(fixes):
                H, y = self.compare(k, one)
                if first:
                    if one.code == POSITION:
                        self._see(k, fixes[i : i + 2], Rz)
                    grown = self.test(one, H, y, Rz)
                    if grown is None:
                        continue
                    Rz = grown
                kept.append(one)
                white = one.C_tn.T / np.sqrt(one.r)[:, None]
                Rz = _triangle(np.vstack([np.column_stack([white @ H, white @ y]), Rz]))[:15]
                if first:
                    step = solve_triangular(Rz[:, :15], Rz[:, 15])
                    self._move(k, step)
                    self.moved[k] += step
                    Rz[:, 15] = 0.0
            fixes[:] = kept
            if k == len(self.links):
                break
            if len(preintegrated) == k:
                preintegrated.append(self.preintegrate(k))
            A = self.join(k, preintegrated[k], Rz, first=first)
            both = _triangle(A)
            self.rows.append(both[:15])
            Rz = both[15:30, 15:]
        self.rows.append(Rz)

    def _substitute_back(self) -> float:
        """Move all nodes to the fit and find their covariance; return the largest step in deviations."""
        n = len(self.rows)
        self.P = np.empty((n, 15, 15))
        largest, after, S = 0.0, np.zeros(0), np.zeros((0, 0))
        for k in range(n - 1, -1, -1):
            R, T, z = self.rows[k][:, :15], self.rows[k][:, 15:-1], self.rows[k][:, -1]
            wide = solve_triangular(R, np.column_stack([z - T @ after, np.eye(15), T @ S]))
            step, spread = wide[:, 0], wide[:, 1:]
            after = step + self.moved[k]
            self.P[k] = spread @ spread.T
            S = _triangle(spread.T).T
            largest = max(largest, float((np.abs(step) / np.sqrt(np.diag(self.P[k]))).max()))
            self._move(k, step)
        return largest

    def _bias(self, k: int, part: FloatArray | float = 1.0) -> Any:
        accel, gyro = np.split(part * self.bias[k], 2)
        return self.gtsam.imuBias.ConstantBias(accel, gyro)

    def _move(self, k: int, step: FloatArray) -> None:
        self.states[k] = self.states[k].retract(step[:9])
        self.bias[k] = self.bias[k] + step[9:]

    def _difference(self, start: Any, end: Any) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the error (9,) between two states, and its derivatives (9, 9) with respect to both."""
        by_start, by_end = (np.zeros((9, 9), order="F") for _ in range(2))
        return start.localCoordinates(end, by_start, by_end), by_start, by_end

    def preintegrate(self, k: int) -> Any:
        """Return the IMU measurements after a node, preintegrated over a flat, resting Earth."""
        gtsam, link, state = self.gtsam, self.links[k], self.states[k]
        C_tb, v_t, frame = state.attitude().matrix(), state.velocity(), self.frame
        g_t = frame.gravity(state.position())
        params = gtsam.PreintegrationParams(g_t)
        span, step = float(link.dt.sum()), float(link.dt.mean())
        gyro, accel = _noise(self.imu)
        params.setGyroscopeCovariance(np.eye(3) * (gyro + link.unknown[1] / span))
        params.setAccelerometerCovariance(np.eye(3) * (accel + link.unknown[0] / span))
        params.setIntegrationCovariance(np.eye(3) * accel * step**2 / 12.0)  # of white noise within a step
        measured = gtsam.PreintegratedImuMeasurements(params, self._bias(k))
        coriolis, now = 2.0 * rotation.skew(frame.w_t), 0.0
        for dt, turn, push in zip(link.dt.tolist(), link.dtheta, link.dvel, strict=True):
            C_bt = (C_tb @ measured.deltaRij().matrix()).T
            v = v_t + g_t * now + C_tb @ measured.deltaVij()
            measured.integrateMeasurement(push / dt - C_bt @ (coriolis @ v), turn / dt - C_bt @ frame.w_t, dt)
            now += dt
        return measured

    def join(self, k: int, measured: Any, Rz: FloatArray, *, first: bool) -> FloatArray:
        """Return the rows (30, 31) of two nodes: the factor between them, and the prior of the first."""
        F, by_state, by_bias = np.zeros((15, 15)), np.zeros((9, 9), order="F"), np.zeros((9, 6), order="F")
        left, new = self.biases.over(measured.deltaTij())
        mean = 0.5 * (1.0 + left)  # of a bias on the way, over that at the former node
        ahead = measured.predict(self.states[k], self._bias(k, mean), by_state, by_bias)
        if first:
            self.states.append(ahead)
            self.bias.append(left * self.bias[k])
        r, by_ahead, J = self._difference(ahead, self.states[k + 1])
        F[:9, :9], F[:9, 9:], F[9:, 9:] = -by_ahead @ by_state, -by_ahead @ by_bias * mean, np.diag(left)
        C = measured.deltaRij().matrix().T  # from the axes of the former to those of the latter
        turn, Q = np.eye(9), np.zeros((15, 15))
        turn[3:6, 3:6] = turn[6:9, 6:9] = C
        wandered = by_bias * new**2  # a walk has wandered by half on the way, and by a third in square
        Q[:9, :9] = turn @ measured.preintMeasCov() @ turn.T + wandered @ by_bias.T / 3.0
        Q[9:, 9:] = np.diag(new**2)
        Q[:9, 9:], Q[9:, :9] = 0.5 * wandered, 0.5 * wandered.T
        W, A = _invert_root(Q), np.zeros((30, 31))
        A[:15, :15], A[15:, :15] = -W @ F, Rz[:, :15]
        A[:15, 15:24], A[:15, 24:30] = W[:, :9] @ J, W[:, 9:]
        A[:15, 30] = -W @ np.concatenate([r, self.bias[k + 1] - left * self.bias[k]])
        A[15:, 30] = Rz[:, 15]
        return A

    def compare(self, k: int, one: _Vector) -> tuple[FloatArray, FloatArray]:
        """Return H (3, 15) and the innovation (3,) of a vector of a fix, t."""
        state = self.states[k]
        C_tb = state.attitude().matrix()
        if one.code == 0:
            own, arm = state.position(), self.antenna_b
        else:
            own = state.velocity()
            arm = np.cross(one.w_b - self.bias[k][3:] - C_tb.T @ self.frame.w_t, self.antenna_b)
        H, at = np.zeros((3, 15)), 3 + 3 * one.code
        H[:, :3], H[:, at : at + 3] = -C_tb @ rotation.skew(arm), C_tb
        return H, one.z - own - C_tb @ arm

    def _see(self, k: int, fix: list[_Vector], Rz: FloatArray) -> None:
        """Pass a whole fix to the gate: position and, if any, velocity."""
        if [one.code for one in fix] != [POSITION, VELOCITY]:
            self.gate.see_position()
            return
        H, y = (np.concatenate(both) for both in zip(*(self.compare(k, one) for one in fix), strict=True))
        root = solve_triangular(Rz[:, :15], np.eye(15))
        R = block_diag(*(one.C_tn @ np.diag(one.r) @ one.C_tn.T for one in fix))
        self.gate.see_fix(fix[0].t, y, H @ root @ root.T @ H.T + R, np.diag(R)[:3])

    def test(self, one: _Vector, H: FloatArray, y: FloatArray, Rz: FloatArray) -> FloatArray | None:
        """Log the innovation of a vector of a fix; return its rows (15, 16), or None if it is rejected.

        Those of one that is used after rejections have grown for the filter of the first pass, and no other.
        """
        root = solve_triangular(Rz[:, :15], np.eye(15))
        P = root @ root.T
        S = H @ P @ H.T + one.C_tn @ np.diag(one.r) @ one.C_tn.T
        value = nis(y, S)
        along, variance = one.C_tn.T @ y, np.diag(one.C_tn.T @ S @ one.C_tn)
        sound = value <= self.gate.limits[3]
        verdict = self.gate.decide(one.t, one.code, along, variance, value, sound=sound)
        if verdict == REFUSED:
            return None
        if verdict == SOUND:
            return Rz
        opens = np.zeros(15, np.bool_)
        opens[3 + 3 * one.code : 6 + 3 * one.code] = True
        E = growth(verdict, P @ H.T @ np.linalg.solve(S, y), H, y, opens)
        return np.column_stack([_triangle(_invert_root(P + E @ E.T)), Rz[:, 15]])

    def answer(self, node: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the state (16,) of a node, its covariance (9, 9) and the variances of the biases (6,)."""
        state, (accel, gyro), P = self.states[node], np.split(self.bias[node], 2), self.P[node]
        motion, cov = self.frame.answer(
            state.attitude().matrix(), state.position(), state.velocity(), P[:9, :9]
        )
        return np.concatenate([motion, gyro, accel]), cov, np.diag(P)[[12, 13, 14, 9, 10, 11]]


def _noise(imu: ImuSpec) -> tuple[float, float]:
    """Return the white noise densities of gyros and accelerometers, with a lower limit."""
    return tuple(np.maximum([imu.gyro.random_walk, imu.accel.random_walk], _LEAST[:2]) ** 2)


def _triangle(A: FloatArray) -> FloatArray:
    """Return R, upper triangular, with R' R = A' A."""
    return np.asarray(np.linalg.qr(A, mode="r"))


def _invert_root(P: FloatArray) -> FloatArray:
    """Return W with W' W = P^-1 of a covariance, computed at unit variances."""
    scale = 1.0 / np.sqrt(np.diag(P))
    return np.asarray(np.linalg.inv(np.linalg.cholesky(P * np.outer(scale, scale))) * scale)
