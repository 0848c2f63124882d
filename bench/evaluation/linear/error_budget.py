"""The actual covariance of a filter's errors, by source, under its own recorded gains.

The errors of the filter's n states (position, velocity and attitude; its estimates of the others) and the
true errors of the sensors make one linear system, driven by what the truth model has (`terms`) and corrected
by the gains of the filter, whose model may be another (P. S. Maybeck, Stochastic Models, Estimation, and
Control, vol. 1, 1979, ch. 6). It is linear, so that the sources add. Each is carried alone, all in one pass:
a constant as its sensitivity (n,), a process as a covariance (n + 3, n + 3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.evaluation.linear.gains import Gains
from bench.evaluation.linear.path import FACTORS, LinearPath
from bench.evaluation.linear.terms import IMU, Constant, ErrorProcess, TruthModel
from bench.navigation.error_state_filter.measurement_rows import BARO
from bench.navigation.error_state_filter.propagation import warmth_kernel
from bench.navigation.error_state_filter.state_blocks import StateModel
from bench.navigation.error_state_filter.state_processes import WARMTH


@dataclass(frozen=True, slots=True)
class Budget:
    """Variances of the errors of position [m^2], velocity [m^2/s^2] and attitude [rad^2], n, by source."""

    t: FloatArray  # (M,) [s]
    sources: tuple[str, ...]
    variance: FloatArray  # (M, 9, S)
    claimed: FloatArray  # (M, 9) by the filter

    @property
    def total(self) -> FloatArray:
        """Actual variance (M, 9)."""
        return np.asarray(self.variance.sum(axis=2))


def split_errors(gains: Gains, truth_model: TruthModel) -> Budget:
    """Return the variances of the errors of a recorded filter by source."""
    path, updates = gains.path, gains.updates
    walk = SourceWalk(path, truth_model, gains.model)
    count = np.bincount(updates.step, minlength=len(path.t))
    first = np.concatenate([[0], np.cumsum(count)])
    names = [source.name for source in truth_model.sources]
    of_constant = _one_hot([one.source for one in truth_model.constants], names)
    of_process = _one_hot([one.source for one in walk.processes], names)
    out = np.zeros((len(gains.output), 9, len(names)))
    wanted = {int(step): row for row, step in enumerate(gains.output)}
    for k in range(len(path.t)):
        if k > 0:
            walk.move(k - 1)
        for u in range(first[k], first[k + 1]):
            h, K = updates.h[u], updates.K[u]
            walk.correct(h, K, int(updates.code[u]), int(updates.component[u]), int(updates.number[u]), k)
        if k in wanted:
            own = walk.Pxx[np.arange(9), :, np.arange(9)]
            out[wanted[k]] = np.square(walk.X[:9]) @ of_constant + own @ of_process
    return Budget(path.t[gains.output], tuple(names), out, np.einsum("mii->mi", gains.P))


def motion_factors(path: LinearPath, model: StateModel) -> FloatArray:
    """Return the motion factors (K, `FACTORS`) of a filter, with the temperature that it models."""
    if not (model.process.drives[:, 2] == WARMTH).any():
        return path.factors
    factors = path.factors.copy()
    known = np.array([model.process.thermal[0], 0.0, 0.0])
    warm = warmth_kernel.py_func  # type: ignore[attr-defined]  # compiled it may only be called by kernels
    for k, T in enumerate(path.span):
        factors[k, WARMTH] = known[0]
        warm(T, model.process.thermal, path.lla[k, 2], known)
    return factors


def signals(path: LinearPath, constants: tuple[Constant, ...]) -> FloatArray:
    """Return the mean errors (K, 6, C) of gyros [rad/s] and accelerometers [m/s^2] per step and constant."""
    shape = np.zeros((FACTORS, 6, len(constants)))
    sampled = []
    for c, one in enumerate(constants):
        for error, factor, size in one.factors:
            shape[factor, error, c] += size
        if one.signal is not None:
            sampled.append((c, one.signal))
    out = np.tensordot(path.factors, shape, 1)
    for c, signal in sampled:
        whole = np.vstack([np.zeros(6), np.cumsum(signal, axis=0)])
        out[:, :, c] += np.diff(whole[path.rows], axis=0) / np.diff(path.rows)[:, None]
    return out


def _one_hot(sources: list[str], names: list[str]) -> FloatArray:
    table = np.zeros((len(sources), len(names)))
    for row, name in enumerate(sources):
        table[row, names.index(name)] = 1.0
    return table


class SourceWalk:
    """The sensitivities and covariances of all sources, at one time.

    ``X`` (n, C) by constant; ``Pxx`` (n, R, n), ``Pxs`` (n, R, 3) and ``Pss`` (R, 3) by process, the I that
    act on the IMU first.
    """

    def __init__(self, path: LinearPath, truth_model: TruthModel, model: StateModel) -> None:
        constants = truth_model.constants
        processes = sorted(truth_model.processes, key=lambda one: one.acts != IMU)
        self.path, self.processes = path, processes
        n, R, K = model.layout.size, len(processes), len(path.G)
        self.X = np.zeros((n, len(constants)))
        for c, one in enumerate(constants):
            if one.start is not None:
                self.X[:9, c] = one.start
        self.pushed = path.G[:, :, 9:15] @ signals(path, constants)
        self.heights = [(c, one.height) for c, one in enumerate(constants) if one.height is not None]
        self.drift = ProcessSteps(processes)
        self.Pxx, self.Pxs = np.zeros((n, R, n)), np.zeros((n, R, 3))
        self.Pss: FloatArray = self.drift.variance.copy()
        self.fade, self.noise = self.drift.steps(path)
        self.kicks = [(one.at, r, one.kick) for r, one in enumerate(processes) if one.at is not None]
        self.W, factors = np.zeros((K, 9, n)), motion_factors(path, model)
        self.W[:, :, :15] = path.G
        self.W[:, :, :9] += np.eye(9)
        for state, error, by in model.process.drives.tolist():
            self.W[:, :, state] += path.G[:, :, error] * factors[:, None, by]
        rate = model.process.decay_time[9:] + np.outer(path.speed, model.process.decay_distance[9:])
        self.own = np.exp(-rate * path.span[:, None])
        on_imu = [one for one in processes if one.acts == IMU]
        self.I = len(on_imu)
        self.columns = np.array([one.first for one in on_imu], int)[:, None] + 9 + np.arange(3)
        self.white = [  # process, first state it drives, variance that each step adds
            (r, 6 - one.first, (path.C_mean * (one.white * path.span[:, None])[:, None]) @ path.C_mean.mT)
            for r, one in enumerate(on_imu)
            if one.white.any()
        ]

    def move(self, k: int) -> None:
        """Propagate over step k."""
        W, own, decay, count = self.W[k], self.own[k], self.fade[k], self.I
        n, R = len(self.X), len(decay)
        top = W @ self.X
        top -= self.pushed[k]
        self.X[9:] *= own[:, None]
        self.X[:9] = top
        U = self.path.G[k][:, self.columns].transpose(1, 0, 2)  # (I, 9, 3)
        Pxs = (W @ self.Pxs.reshape(n, R * 3)).reshape(9, R, 3)
        B = (W @ self.Pxx.reshape(n, R * n)).reshape(9, R, n)
        Pxs[:, :count] -= (U * self.Pss[:count, None]).transpose(1, 0, 2)
        B[:, :count] -= (U @ self.Pxs[:, :count].transpose(1, 2, 0)).transpose(1, 0, 2)
        P = (B.reshape(9 * R, n) @ W.T).reshape(9, R, 9)
        P[:, :count] -= (Pxs[:, :count].transpose(1, 0, 2) @ U.transpose(0, 2, 1)).transpose(1, 0, 2)
        for r, at, Q in self.white:
            P[at : at + 3, r, at : at + 3] += Q[k]
        low = B[:, :, 9:] * own
        self.Pxx[9:, :, 9:] *= own[:, None, None] * own
        self.Pxx[:9, :, 9:], self.Pxx[9:, :, :9] = low, low.transpose(2, 1, 0)
        self.Pxx[:9, :, :9] = P
        self.Pxs[9:] *= own[:, None, None]
        self.Pxs[:9] = Pxs
        self.Pxs *= decay[:, None]
        self.Pss = self.Pss * decay[:, None] ** 2 + self.noise[k]
        for instants, r, kick in self.kicks:
            if np.any(np.abs(instants - self.path.t[k + 1]) < SAME_INSTANT):
                self.Pss[r] += kick

    def correct(self, h: FloatArray, K: FloatArray, code: int, component: int, number: int, k: int) -> None:
        """Use a scalar measurement h dx of a sensor with the gain K (n,)."""
        z = h @ self.X
        if code == BARO:
            for c, height in self.heights:
                z[c] -= height[number]
        self.X -= K[:, None] * z
        n, R = len(h), self.Pss.shape[0]
        m, white = self.drift.rows(code, component, float(self.path.t[k]))
        zx = (h @ self.Pxx.reshape(n, R * n)).reshape(R, n) - (self.Pxs[:, :, component] * m).T
        zs = (h @ self.Pxs.reshape(n, R * 3)).reshape(R, 3)
        zs[:, component] -= m * self.Pss[:, component]
        zz = zx @ h - m * zs[:, component] + white
        y = zx - 0.5 * zz[:, None] * K
        half = K[:, None, None] * y
        self.Pxx -= half
        self.Pxx -= half.transpose(2, 1, 0)
        self.Pxs -= K[:, None, None] * zs


class ProcessSteps:
    """Propagation of R processes over a step, and their effect on a measurement."""

    def __init__(self, processes: Sequence[ErrorProcess]) -> None:
        def stack(name: str) -> FloatArray:
            return np.array([getattr(one, name) for one in processes], float)

        self.variance = stack("variance").reshape(-1, 3)
        self._density, self._white = stack("density").reshape(-1, 3), stack("white").reshape(-1, 3)
        self._time, self._distance = stack("decay_time"), stack("decay_distance")
        self._acts: IntArray = np.array([one.acts for one in processes], np.int64)
        self._cache: dict[tuple[int, int], tuple[FloatArray, FloatArray]] = {}
        self._at = [(r, one.at) for r, one in enumerate(processes) if one.at is not None]

    def steps(self, path: LinearPath) -> tuple[FloatArray, FloatArray]:
        """Return the decay (K, R) of the states over each step and the variance (K, R, 3) that it adds."""
        T = path.span
        decay = np.exp(-(self._time + np.outer(path.speed, self._distance)) * T[:, None])
        lost = 1.0 - decay**2
        walked = self._density * T[:, None, None]
        return decay, np.where((decay < 1.0)[:, :, None], self.variance * lost[:, :, None], walked)

    def rows(self, code: int, component: int, t: float) -> tuple[FloatArray, FloatArray]:
        """Return for a measurement which processes (R,) act on it, 1 or 0, and their white variance (R,)."""
        if (code, component) not in self._cache:
            acts = (self._acts == code).astype(float)
            self._cache[code, component] = acts, acts * self._white[:, component]
        acts, white = self._cache[code, component]
        if self._at:
            white = white.copy()
            for r, at in self._at:
                if not np.any(np.abs(at - t) < SAME_INSTANT):
                    white[r] = 0.0
        return acts, white
