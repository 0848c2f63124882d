"""Rauch-Tung-Striebel smoother over a stored forward run.

The forward run is an error-state filter in closed loop. Between two nodes its state moves from x_j (after the
updates of node j) to x_{j+1}^- (before those of node j+1), with the error transition Phi. Going back,

    C_j   = P_j Phi' (P_{j+1}^-)^-1
    x_j^s = x_j - C_j (x_{j+1}^- - x_{j+1}^s)
    P_j^s = P_j + C_j (P_{j+1}^s - P_{j+1}^-) C_j'

where the difference of two states is an error state: meters in n, the turns from one attitude to the other,
and plain differences of the rest (H. E. Rauch, F. Tung, C. T. Striebel, AIAA Journal 3 (8), 1965). Tilts are
those of the axes of each state (`error_state`): P_{j+1}^s is turned to those of x_{j+1}^-,
and P_j^s to those of x_j^s.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from bench.core.compilation.compiled import inner, kernel
from bench.core.compilation.wide_rows import LANES, add_row, set_row, wide
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import Events, InitialState, NavSolution, SensorData, no_innovations
from bench.core.records.sensor_specs import AssumedSpecs
from bench.navigation.engine.piecewise import JoinedSolution, KnowsImuErrors
from bench.navigation.error_state_filter.answers import answers, offset_rows, spread
from bench.navigation.error_state_filter.corrections import reset_kernel
from bench.navigation.error_state_filter.error_state import (
    PHI,
    difference_kernel,
    feedback_kernel,
)
from bench.navigation.error_state_filter.filter_run import Nodes
from bench.navigation.error_state_filter.rough_heading import add_arm
from bench.navigation.error_state_filter.state_blocks import first_of_satellites, index_of
from bench.navigation.models.loose_tight import Loose, Tight
from bench.navigation.options import SmootherOptions, read_options
from bench.navigation.start.steady_course import Gyros, has_large_bias
from bench.navigation.start.turn_on import smooth_from_turn_on
from bench.navigation.start.whole_records import run_between_gaps

_ROUNDING = 1e-14  # of a scaled variance: what is left of it is rounding


class Smoother:
    """Loose or tight filter with a backward pass over its record.

    Innovations and events are those of the forward run.

    Options: `bench.navigation.options.SmootherOptions`, those of the forward filter among them.
    """

    def __init__(self, **options: Any) -> None:
        self.options = read_options(SmootherOptions, options)
        forward = Tight if self.options.tight else Loose
        self.filter = forward(**self.options.model_dump(exclude={"over"}))

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Estimate each time from all measurements of the record, earlier and later."""
        options = self.options
        steady, whole = options.every_error and has_large_bias(sensors), options.every_error or options.mems
        errors, sd = np.zeros((2, 6))  # of the IMU at the end of the last run (`KnowsImuErrors`)

        def run(piece: SensorData, start: InitialState, gyro_sd: float | None) -> NavSolution:
            solution, end = self._smooth(piece, start, Gyros(gyro_sd, steady))
            if whole:
                errors[:], sd[:] = end.steady_errors()
            return solution

        def between(piece: SensorData, start: InitialState, gyro_sd: float | None) -> NavSolution:
            if not steady or gyro_sd is not None:
                return run(piece, start, gyro_sd)
            solution, unseen = smooth_from_turn_on(run, piece, start)
            errors[:3] += unseen
            return solution

        learnt = (lambda: (errors.copy(), sd.copy())) if whole else None
        return run_between_gaps(between, sensors, initial, options.accuracy, learnt)

    def _smooth(
        self, sensors: SensorData, initial: InitialState, gyros: Gyros
    ) -> tuple[NavSolution, KnowsImuErrors]:
        """Return the solution of a record without long gaps, and the forward filter at its end."""
        forward, stretches, end = self.filter.forward(sensors, initial, gyros)
        if not any(len(nodes.t) for nodes in stretches) or len(forward.events.select("ended")):
            return forward, end
        smooth(stretches)
        found, begin = JoinedSolution(len(forward.t)), 0
        for nodes in stretches:
            t = forward.t[begin : begin + len(nodes.output)]
            found.add(_answer(t, nodes, sensors.antenna_b))
            begin += len(t)
            if len(stretches) > 1:
                disk_arrays.release()
        return replace(found.solution(), innovations=forward.innovations, events=forward.events), end

    @property
    def needs(self) -> tuple[str, ...]:
        """Return the records that the forward run needs."""
        return self.filter.needs

    def unmodeled_errors(self, specs: AssumedSpecs) -> tuple[str, ...]:
        """Return the errors of these sensors that the filter has no state for, in words."""
        return self.filter.unmodeled_errors(specs)


def _answer(t: FloatArray, nodes: Nodes, antenna_b: FloatArray) -> NavSolution:
    """Return smoothed nodes as the solution at their epochs t (M,)."""
    rows = np.flatnonzero(nodes.output >= 0)
    at = nodes.output[rows]
    shown = first_of_satellites(index_of(nodes.layout), nodes.layout.size)
    state, cov = nodes.state[at, 1, : shown + 1], nodes.P[at, 1, :9, :9]
    variance = np.einsum("kii->ki", nodes.P[:, 1])[at, 9:shown]
    offset = offset_rows(nodes.layout, nodes.P[:, 1])
    offset = None if offset is None else spread(offset[at], rows, len(t))
    if len(rows) != len(t):
        state, cov, variance = (spread(one, rows, len(t)) for one in (state, cov, variance))
    add_arm(cov, antenna_b)
    return answers(t, nodes.layout, state, cov, variance, no_innovations(), Events.from_rows([]), offset)


class SmootherWork(NamedTuple):
    """Memory of the kernels; matrices are wide."""

    scale: FloatArray  # (n,) one over the standard deviations of P^-, 0 for a state without variance
    inverse: FloatArray  # (n,) one over the diagonal of R, 0 where no variance is left
    R: FloatArray  # (n, n) upper Cholesky factor of P^-, scaled: R'R
    P: FloatArray  # (n, n)
    D: FloatArray  # (n, n) P^s - P^-
    gain: FloatArray  # (n, n) C'
    product: FloatArray  # (n, n) D C'
    d: FloatArray  # (n,) error of x^- if x^s is true
    e: FloatArray  # (n,) C d
    turn: FloatArray  # (5, 3) of the axes by a correction
    drives: IntArray  # (0, 3) none: the biases do not turn
    factor: FloatArray  # (0,)


def smooth(stretches: list[Nodes]) -> None:
    """Smooth the states and covariances after the measurements at the nodes of a forward run, in place."""
    stretches = [nodes for nodes in stretches if len(nodes.t)]
    n = stretches[0].layout.size
    square = (n, n)
    work = SmootherWork(
        np.zeros(n), np.zeros(n), wide(square), wide(square), wide(square), wide(square), wide(square),
        np.zeros(n), np.zeros(n), np.zeros((5, 3)), np.empty((0, 3), np.int64), np.empty(0),
    )  # fmt: skip
    later: Nodes | None = None
    for nodes in reversed(stretches):
        if later is not None:  # the last node from the one that follows on it
            state, P, Phi = (
                np.concatenate([a[-1:], b[:1]])
                for a, b in ((nodes.state, later.state), (nodes.P, later.P), (nodes.Phi, later.Phi))
            )
            _smooth_kernel(state, P, Phi, work)
            nodes.state[-1], nodes.P[-1] = state[0], P[0]
            disk_arrays.release()
        _smooth_kernel(nodes.state, nodes.P, nodes.Phi, work)
        later = nodes


@inner
def _turn_heading(heading: float, turn: FloatArray) -> None:
    """Fill turn (5, 3) as `corrections.axes_kernel` does for a heading alone.

    The biases stay: a smoother corrects each time once, so that nothing adds up.
    """
    for i in range(3):
        for k in range(3):
            turn[i, k] = 1.0 if i == k else 0.0
    turn[3, 0], turn[3, 1] = np.sin(heading), np.cos(heading)


@kernel
def _smooth_kernel(state: FloatArray, P: FloatArray, Phi: FloatArray, work: SmootherWork) -> None:
    """Smooth states (N, 2, n + 1) and P (N, 2, n, n) after the measurements, backward from row N - 2."""
    n, d, e, D = work.d.shape[0], work.d, work.e, work.D
    for j in range(state.shape[0] - 2, -1, -1):
        later, before = P[j + 1, 1], P[j + 1, 0]
        difference_kernel(state[j + 1, 0], state[j + 1, 1], d)
        _gain_kernel(before, Phi[j + 1], P[j, 1], work)
        for i in range(n):
            e[i] = 0.0
        for k in range(n):
            for i in range(n):
                e[i] += work.gain[k, i] * d[k]
        for i in range(n):
            for k in range(n):
                D[i, k] = later[i, k]
        _turn_heading(-d[PHI + 2], work.turn)
        reset_kernel(D, work.turn, work.drives, work.factor, work.product)
        for i in range(n):
            for k in range(n):
                D[i, k] -= before[i, k]
        _correct_kernel(P[j, 1], work)
        _turn_heading(e[PHI + 2], work.turn)
        reset_kernel(P[j, 1], work.turn, work.drives, work.factor, work.product)
        feedback_kernel(state[j, 1], e)


@inner
def _gain_kernel(before: FloatArray, Phi: FloatArray, P: FloatArray, work: SmootherWork) -> None:
    """Fill the gain C' = (P^-)^-1 Phi P, solved with each state scaled by its standard deviation.

    A state without variance (a process that is switched off) has no gain; nor has one that is, but for
    rounding, the sum of others. The factor R comes row by row, and with it what it solves.
    """
    scale, inverse, R, gain = work.scale, work.inverse, work.R, work.gain
    n, width = P.shape[0], gain.shape[1]
    for i in range(n):
        scale[i] = 1.0 / np.sqrt(before[i, i]) if before[i, i] > 0.0 else 0.0
    for i in range(n):
        for k in range(n):
            gain[i, k] = 0.0
            work.P[i, k] = P[i, k]
            R[i, k] = before[i, k] * scale[i] * scale[k]
        R[i, i] = 1.0
    for k in range(n):
        for i in range(n):
            if Phi[i, k] != 0.0:
                add_row(gain, i, Phi[i, k] * scale[i], work.P, k, 0, width)
    for k in range(n):
        inverse[k] = 1.0 / np.sqrt(R[k, k]) if R[k, k] > _ROUNDING else 0.0
        set_row(R, k, inverse[k], R, k, k - k % LANES, width)
        set_row(gain, k, inverse[k], gain, k, 0, width)
        for i in range(k + 1, n):
            add_row(R, i, -R[k, i], R, k, i - i % LANES, width)
            add_row(gain, i, -R[k, i], gain, k, 0, width)
    for k in range(n - 1, -1, -1):
        set_row(gain, k, inverse[k], gain, k, 0, width)
        for i in range(k):
            add_row(gain, i, -R[i, k], gain, k, 0, width)
    for i in range(n):
        set_row(gain, i, scale[i], gain, i, 0, width)


@inner
def _correct_kernel(P: FloatArray, work: SmootherWork) -> None:
    """Add C D C' to P (n, n); ``work`` contains a wide copy of P, of which the upper part is computed."""
    gain, product, copy = work.gain, work.product, work.P
    n, width = P.shape[0], gain.shape[1]
    for i in range(n):
        set_row(product, i, work.D[i, 0], gain, 0, 0, width)
    for k in range(1, n):
        for i in range(n):
            add_row(product, i, work.D[i, k], gain, k, 0, width)
    for k in range(n):
        for i in range(n):
            add_row(copy, i, gain[k, i], product, k, i - i % LANES, width)
    for i in range(n):
        for k in range(i, n):
            P[i, k], P[k, i] = copy[i, k], copy[i, k]
