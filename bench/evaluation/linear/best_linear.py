"""The best linear estimator: a Kalman filter of the whole truth model along the true motion.

Its states are the errors of an INS that takes the sensors as they are, and every constant and process of the
sensors (`terms`). Its covariance is the least of any linear causal filter of this flight; what is not
Gaussian counts by an equal autocovariance, which leaves the linear bound as it is (Tichavsky, Muravchik,
Nehorai, IEEE Trans. Signal Processing 46 (5), 1998). The bound of smoothers uses the measurements after an
time as well, by the adjoint recursion of Bryson and Frazier:

    L- = h h' / s + (I - K h')' L+ (I - K h'),   L(before a step) = Phi' L Phi,   P^s = P - P L P
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import SensorData
from bench.evaluation.linear.error_budget import ProcessSteps, signals
from bench.evaluation.linear.gains import measurement_rows
from bench.evaluation.linear.path import LinearPath
from bench.evaluation.linear.terms import IMU, TruthModel
from bench.navigation.error_state_filter.error_state import CORE, StateLayout
from bench.navigation.error_state_filter.measurement_rows import BARO, POSITION, VELOCITY
from bench.navigation.error_state_filter.state_blocks import index_of
from bench.navigation.error_state_filter.state_processes import STEADY

_INDEX = index_of(StateLayout())  # of a filter of the core states alone


@dataclass(frozen=True, slots=True)
class Epochs:
    """Measurements in the order of time: each of all components of a sensor."""

    step: IntArray  # (E,) time of the path
    code: IntArray  # (E,) sensor of `bench.navigation.error_state_filter.measurement_rows`


def find_epochs(path: LinearPath, data: SensorData) -> Epochs:
    """Return the measurements of a record: fixes with velocity, barometric heights."""
    steps, codes = [], []
    for record, kinds in ((data.fixes, (POSITION, VELOCITY)), (data.baro, (BARO,))):
        if record is not None:
            at = np.searchsorted(path.t, record.t[record.valid] - SAME_INSTANT)
            steps.append(np.repeat(at, len(kinds)))
            codes.append(np.tile(kinds, len(at)))
    if not steps:
        return Epochs(np.empty(0, np.int64), np.empty(0, np.int64))
    step, code = np.concatenate(steps), np.concatenate(codes)
    order = np.argsort(step, kind="stable")
    return Epochs(step[order], code[order])


@dataclass(frozen=True, slots=True)
class Bound:
    """Covariances of the best linear filter, with N states."""

    t: FloatArray  # (M,) [s]
    labels: tuple[str, ...]  # (N,) of the states
    bias: FloatArray  # (6, N) biases of gyros [rad/s] and accelerometers [m/s^2] by the states
    start: FloatArray  # (N, N) at the start
    causal: FloatArray  # (M, N, N)
    smoothed: FloatArray  # (M, 9, 9) of position [m], velocity [m/s] and attitude [rad], n; none if not asked


class _System:
    """The linear system of the truth model: states, steps, rows."""

    def __init__(self, path: LinearPath, truth_model: TruthModel, antenna_b: FloatArray) -> None:
        self.path, self.antenna_b = path, antenna_b
        every = truth_model.constants
        self.constants = tuple(one for one in every if one.factors)
        self.processes = truth_model.processes
        self.steps = ProcessSteps(self.processes)
        self.fade, self.noise = self.steps.steps(path)
        self.span = path.span
        self.D = signals(path, self.constants)
        self.begin = np.cumsum([9 + len(self.constants), *(3 * one.states for one in self.processes)])
        self.n = int(self.begin[-1])
        self.labels = tuple(
            [f"{kind}_{axis}" for kind in ("pos", "vel", "phi") for axis in ("n", "e", "d")]
            + [one.source for one in self.constants]
            + [one.source for one in self.processes if one.states for _ in range(3)]
        )
        self.P = np.zeros((self.n, self.n))
        starts = np.array([one.start for one in every if one.start is not None]).reshape(-1, 9)
        self.P[:9, :9] = starts.T @ starts
        at = np.arange(9, 9 + len(self.constants))
        self.P[at, at] = 1.0
        for r, one in enumerate(self.processes):
            if one.states:
                own = np.arange(self.begin[r], self.begin[r + 1])
                self.P[own, own] = one.variance
        self.bias = np.zeros((6, self.n))
        for c, constant in enumerate(self.constants):
            for error, factor, size in constant.factors:
                self.bias[error, 9 + c] += size if factor == STEADY else 0.0
        for r, one in enumerate(self.processes):
            if one.acts == IMU and one.states:
                self.bias[one.first : one.first + 3, self.begin[r] : self.begin[r + 1]] = np.eye(3)
        self.white_imu = [one for one in self.processes if one.acts == IMU and one.white.any()]

    def step(self, k: int) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the first nine rows W (9, N) of Phi, the decay (N,) of the others, the noise (N,)."""
        path = self.path
        G = path.G[k]
        c = 9 + len(self.constants)
        W = np.zeros((9, self.n))
        W[:, :9] = np.eye(9) + G[:, :9]
        W[:, 9:c] = -(G[:, 9:15] @ self.D[k])
        decay, noise = np.ones(self.n), np.zeros(self.n)
        fade, added = self.fade[k], self.noise[k]
        for r, one in enumerate(self.processes):
            if one.states:
                own = slice(self.begin[r], self.begin[r + 1])
                decay[own], noise[own] = fade[r], added[r]
                if one.acts == IMU:
                    W[:, own] = -G[:, 9 + one.first : 12 + one.first]
        return W, decay, noise

    def white(self, k: int) -> FloatArray:
        """Return Q (9, 9) of the white noise of the IMU over a step."""
        C, T = self.path.C_mean[k], float(self.span[k])
        Q = np.zeros((9, 9))
        for one in self.white_imu:
            own = slice(6 - one.first, 9 - one.first)
            Q[own, own] += C * (one.white * T) @ C.T
        return Q

    def rows(self, k: int, code: int) -> tuple[FloatArray, FloatArray]:
        """Return H (m, N) of a sensor at a time and the variance (m,) of its white noise."""
        own = measurement_rows(self.path, k, code, self.antenna_b, _INDEX, CORE)[:, :9]
        H, r = np.zeros((len(own), self.n)), np.zeros(len(own))
        H[:, :9] = own
        for i in range(len(own)):
            acts, white = self.steps.rows(code, i, float(self.path.t[k]))
            r[i] = white.sum()
            for p in np.flatnonzero(acts):
                if self.processes[p].states:
                    H[i, self.begin[p] + i] = -1.0
        return H, r


def bound_errors(
    path: LinearPath,
    truth_model: TruthModel,
    epochs: Epochs,
    output: IntArray,
    antenna_b: FloatArray,
    *,
    smooth: bool,
) -> Bound:
    """Return the covariances of the best linear filter at the steps ``output`` (M,) of a path."""
    system = _System(path, truth_model, antenna_b)
    P, start = system.P, system.P.copy()
    count = np.bincount(epochs.step, minlength=len(path.t))
    first = np.concatenate([[0], np.cumsum(count)])
    code = epochs.code
    causal = np.zeros((len(output), system.n, system.n))
    place = {int(step): row for row, step in enumerate(output)}
    kept: list[tuple[int, FloatArray, FloatArray, float]] = []  # step, h, K, s
    for k in range(len(path.t)):
        if k > 0:
            W, decay, noise = system.step(k - 1)
            A = W @ P
            P *= decay[:, None]
            P *= decay
            P[:9, 9:] = A[:, 9:] * decay[9:]
            P[9:, :9] = P[:9, 9:].T
            P[:9, :9] = A @ W.T + system.white(k - 1)
            P[np.diag_indices_from(P)] += noise
        for e in range(first[k], first[k + 1]):
            H, r = system.rows(k, int(code[e]))
            for h, variance in zip(H, r, strict=True):
                Ph = P @ h
                s = float(h @ Ph) + float(variance)
                K = Ph / s
                P -= np.outer(Ph, K)
                if smooth:
                    kept.append((k, h, K, s))
        if k in place:
            P[:] = 0.5 * (P + P.T)
            causal[place[k]] = P
    smoothed = _smooth(system, causal, kept, place) if smooth else np.empty((0, 9, 9))
    return Bound(path.t[output], system.labels, system.bias, start, causal, smoothed)


def _smooth(
    system: _System,
    causal: FloatArray,
    kept: list[tuple[int, FloatArray, FloatArray, float]],
    place: dict[int, int],
) -> FloatArray:
    """Return the covariances (M, 9, 9) given all measurements, from the causal ones and their updates."""
    L = np.zeros((system.n, system.n))
    out = np.zeros((len(causal), 9, 9))
    u = len(kept) - 1
    for k in range(len(system.path.t) - 1, -1, -1):
        if k in place:
            P = causal[place[k]]
            out[place[k]] = P[:9, :9] - P[:9] @ L @ P[:, :9]
        while u >= 0 and kept[u][0] == k:
            _, h, K, s = kept[u]
            LK = L @ K
            y = LK - 0.5 * (float(K @ LK) + 1.0 / s) * h
            L -= np.outer(h, y) + np.outer(y, h)
            u -= 1
        if k > 0:
            W, decay, _ = system.step(k - 1)
            decay[:9] = 0.0
            S = 0.5 * L[:9, :9] @ W + L[:9] * decay
            L = W.T @ S + S.T @ W + L * decay[:, None] * decay
    return out
