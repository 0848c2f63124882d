"""Rauch-Tung-Striebel smoother over a stored forward run.

The forward run is an error-state filter in closed loop. Between two nodes its state moves from x_j (after the
updates of node j) to x_{j+1}^- (before those of node j+1), with the error transition Phi. Going back,

    C_j   = P_j Phi' (P_{j+1}^-)^-1
    x_j^s = x_j + C_j (x_{j+1}^s - x_{j+1}^-)
    P_j^s = P_j + C_j (P_{j+1}^s - P_{j+1}^-) C_j'

where the difference of two states is an error state: metres in n, the rotation from one attitude to the
other, and plain differences of the rest (H. E. Rauch, F. Tung, C. T. Striebel, AIAA Journal 3 (8), 1965).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from bench.arrays import FloatArray
from bench.compiled import inner, kernel
from bench.data import InitialState, NavSolution, SensorData
from bench.navigation.error_state import difference_kernel, feedback_kernel
from bench.navigation.forward import Nodes, solution
from bench.navigation.fusion import Loose, Tight
from bench.navigation.options import SmootherOptions, read_options
from bench.navigation.restart import run_between_gaps
from bench.navigation.rough_heading import add_arm
from bench.specs import AssumedSpecs
from bench.wide_rows import add_row, set_row, wide

_ROUNDING = 1e-14  # of a scaled variance: what is left of it is rounding


class Smoother:
    """A loose or tight filter, then back over its record.

    Innovations and events are those of the forward run.

    Options: `bench.navigation.options.SmootherOptions`, those of the forward filter among them.
    """

    def __init__(self, **options: Any) -> None:
        self.options = read_options(SmootherOptions, options)
        forward = Tight if self.options.tight else Loose
        self.filter = forward(**self.options.model_dump(exclude={"over"}))

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate each instant from all measurements of the record, earlier and later."""
        return run_between_gaps(self._run, sensors, initial, self.options.accuracy)

    def _run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        forward, nodes = self.filter.forward(sensors, initial, keep=True)
        if not len(nodes.t):
            return forward
        state, P = smooth(nodes)
        served = nodes.output >= 0
        x = np.full((len(forward), state.shape[1]), np.nan)
        cov = np.full((len(forward), *P.shape[1:]), np.nan)
        x[served], cov[served] = state[nodes.output[served]], P[nodes.output[served]]
        add_arm(cov, sensors.antenna_b)
        return solution(forward.t, nodes.layout, x, cov, forward.innovations, forward.events)

    @property
    def needs(self) -> tuple[str, ...]:
        """What its forward run needs."""
        return self.filter.needs

    def unmodelled(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the estimator has no state for, in words."""
        return self.filter.unmodelled(specs)


class SmootherWork(NamedTuple):
    """Memory of the kernels; the matrices that are made row by row are wide."""

    scale: FloatArray  # (n,) one over the standard deviations of P^-, 0 for a state without variance
    L: FloatArray  # (n, n) Cholesky factor of P^-, scaled
    P: FloatArray  # (n, n)
    D: FloatArray  # (n, n) P^s - P^-
    gain: FloatArray  # (n, n) C'
    product: FloatArray  # (n, n) D C'
    d: FloatArray  # (n,) x^s - x^-
    e: FloatArray  # (n,) less C d


def smooth(nodes: Nodes) -> tuple[FloatArray, FloatArray]:
    """Return the smoothed states (N, n + 1) and covariances (N, n, n) at the nodes of a forward run."""
    state, P = nodes.state[:, 1].copy(), nodes.P[:, 1].copy()
    n = P.shape[-1]
    square = (n, n)
    work = SmootherWork(
        np.zeros(n), np.zeros(square), wide(square), np.zeros(square), wide(square), wide(square),
        np.zeros(n), np.zeros(n),
    )  # fmt: skip
    _smooth_kernel(nodes.state, nodes.P, nodes.Phi, state, P, work)
    return state, P


@kernel
def _smooth_kernel(
    node_state: FloatArray,
    node_P: FloatArray,
    Phi: FloatArray,
    state: FloatArray,
    P: FloatArray,
    work: SmootherWork,
) -> None:
    """Smooth states (N, n + 1) and P (N, n, n), those after the measurements, from the last node back."""
    n, d, e = work.d.shape[0], work.d, work.e
    for j in range(state.shape[0] - 2, -1, -1):
        difference_kernel(state[j + 1], node_state[j + 1, 0], d)
        _gain_kernel(node_P[j + 1, 0], Phi[j + 1], P[j], work)
        for i in range(n):
            e[i] = 0.0
        for k in range(n):
            for i in range(n):
                e[i] -= work.gain[k, i] * d[k]
        feedback_kernel(state[j], e)
        for i in range(n):
            for k in range(n):
                work.D[i, k] = P[j + 1, i, k] - node_P[j + 1, 0, i, k]
        _correct_kernel(P[j], work)


@inner
def _gain_kernel(before: FloatArray, Phi: FloatArray, P: FloatArray, work: SmootherWork) -> None:
    """Fill the gain C' = (P^-)^-1 Phi P, solved with each state scaled by its standard deviation.

    A state without variance (a process that is switched off) has no gain; nor has one that is, but for
    rounding, the sum of others.
    """
    scale, L, gain = work.scale, work.L, work.gain
    n, width = P.shape[0], gain.shape[1]
    for i in range(n):
        scale[i] = 1.0 / np.sqrt(before[i, i]) if before[i, i] > 0.0 else 0.0
        for k in range(n):
            gain[i, k] = 0.0
            work.P[i, k] = P[i, k]
    for i in range(n):
        for k in range(i + 1):
            s = before[i, k] * scale[i] * scale[k] if i != k else 1.0
            for m in range(k):
                s -= L[i, m] * L[k, m]
            if i != k:
                L[i, k] = s / L[k, k]
            else:
                L[i, i] = np.sqrt(s) if s > _ROUNDING else np.inf
    for k in range(n):
        for i in range(n):
            if Phi[i, k] != 0.0:
                add_row(gain, i, Phi[i, k] * scale[i], work.P, k, 0, width)
    for k in range(n):
        set_row(gain, k, 1.0 / L[k, k], gain, k, 0, width)
        for i in range(k + 1, n):
            add_row(gain, i, -L[i, k], gain, k, 0, width)
    for k in range(n - 1, -1, -1):
        set_row(gain, k, 1.0 / L[k, k], gain, k, 0, width)
        for i in range(k):
            add_row(gain, i, -L[k, i], gain, k, 0, width)
    for i in range(n):
        set_row(gain, i, scale[i], gain, i, 0, width)


@inner
def _correct_kernel(P: FloatArray, work: SmootherWork) -> None:
    """Add C D C' to P (n, n); ``work`` holds a wide copy of it."""
    gain, product, copy = work.gain, work.product, work.P
    n, width = P.shape[0], gain.shape[1]
    for i in range(n):
        set_row(product, i, work.D[i, 0], gain, 0, 0, width)
    for k in range(1, n):
        for i in range(n):
            add_row(product, i, work.D[i, k], gain, k, 0, width)
    for k in range(n):
        for i in range(n):
            add_row(copy, i, gain[k, i], product, k, 0, width)
    for i in range(n):
        for k in range(n):
            P[i, k] = 0.5 * (copy[i, k] + copy[k, i])
