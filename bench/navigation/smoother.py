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

from typing import Any

import numpy as np

from bench.arrays import FloatArray
from bench.data import InitialState, NavSolution, SensorData
from bench.navigation.error_state import moved_state, state_difference
from bench.navigation.forward import Nodes, solution
from bench.navigation.fusion import Loose, Tight
from bench.navigation.options import SmootherOptions, read_options
from bench.navigation.restart import run_between_gaps
from bench.navigation.rough_heading import add_arm
from bench.specs import AssumedSpecs


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


def smooth(nodes: Nodes) -> tuple[FloatArray, FloatArray]:
    """Return the smoothed states (N, n + 1) and covariances (N, n, n) at the nodes of a forward run.

    Raises
    ------
    numpy.linalg.LinAlgError
        When a covariance of the forward run is singular.
    """
    state, P = nodes.state[:, 1].copy(), nodes.P[:, 1].copy()
    gain = _gains(nodes)
    for j in range(len(nodes.t) - 2, -1, -1):
        correction = gain[j] @ state_difference(state[j + 1], nodes.state[j + 1, 0])
        state[j] = moved_state(state[j], correction)
        change = gain[j] @ (P[j + 1] - nodes.P[j + 1, 0]) @ gain[j].T
        P[j] += 0.5 * (change + change.T)
    return state, P


def _gains(nodes: Nodes) -> FloatArray:
    """Return C_j (N - 1, n, n), solved with each state scaled by its standard deviation.

    A state without variance (a process that is switched off) has no gain.
    """
    after, before, Phi = nodes.P[:-1, 1], nodes.P[1:, 0], nodes.Phi[1:]
    sd = np.sqrt(np.einsum("kii->ki", before))
    live = sd > 0
    scale = np.where(live, 1 / np.where(live, sd, 1.0), 0.0)
    scaled = before * scale[:, :, None] * scale[:, None, :]
    dead = np.einsum("kij,kj->kij", np.broadcast_to(np.eye(before.shape[1]), before.shape), ~live * 1.0)
    transposed = np.linalg.solve(scaled + dead, (Phi @ after) * scale[:, :, None]) * scale[:, :, None]
    return np.swapaxes(transposed, 1, 2)
