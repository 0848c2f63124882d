"""A smooth motion through the noisy fixes of a track.

A quintic spline whose third derivative is penalized, so that acceleration is continuous and no larger than
the fixes ask for. How much is penalized follows from the noise: that which is told (the unbiased estimate of
risk, C. L. Mallows, Technometrics 15 (4), 1973), else cross-validation (G. Wahba, Spline Models for
Observational Data, SIAM, 1990, chapter 4), which also estimates it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray

_DEGREE, _DERIVATIVE = 5, 3
_KNOT_RATE = 2.0  # most knots per second: a vehicle's acceleration changes no faster than the fixes show
_LOG_RANGE = (-8.0, 10.0)  # of the penalty, decades
_SEARCH = 24  # steps of the search for the penalty
_CAUTION = (
    1.4  # Y.-J. Kim, C. Gu, J. R. Statist. Soc. B 66 (2), 2004: plain cross-validation follows noise at times
)
_PROBES = 16  # random vectors that estimate a trace (Hutchinson)


@dataclass(frozen=True, slots=True)
class TrackFit:
    """A spline of some axes with common noise."""

    spline: Any  # t -> (T, k)
    left: FloatArray  # (N, k) fixes less spline [m]
    noise: float  # sd of a fix, told or estimated [m]
    missed: float  # rms by which a fix is missed when it is left out [m]


def fit_track(t: FloatArray, fixes: FloatArray, weights: FloatArray, noise: float | None) -> TrackFit:
    """Fit one spline to fixes (N, k) at increasing times (N,).

    Parameters
    ----------
    t : array
        Times [s].
    fixes : array
        (N, k) [m].
    weights : array
        (N,) of their squares, 1 for an ordinary fix.
    noise : float or None
        Standard deviation of an ordinary fix [m]; None: estimated.
    """
    from scipy.interpolate import BSpline
    from scipy.linalg import cho_solve_banded, cholesky_banded

    knots = _place_knots(t)
    basis = BSpline.design_matrix(t, knots, _DEGREE)
    normal = _to_banded(basis.T @ basis.multiply(weights[:, None]))
    penalty = _to_banded(_penalize(knots))
    right = basis.T @ (weights[:, None] * fixes)
    n = len(t)
    probes = np.where(np.random.default_rng(0).integers(0, 2, (n, _PROBES)) == 1, 1.0, -1.0)
    probed = basis.T @ (weights[:, None] * probes)
    scale = normal[0].mean() / penalty[0].mean()

    def solve(log_share: float) -> tuple[FloatArray, FloatArray, float]:
        factor = cholesky_banded(normal + scale * 10**log_share * penalty, lower=True)
        coefficients = cho_solve_banded((factor, True), right)
        trace = float((probes * (basis @ cho_solve_banded((factor, True), probed))).sum() / _PROBES)
        return coefficients, fixes - basis @ coefficients, trace

    def risk(log_share: float) -> float:
        _, left, trace = solve(log_share)
        square = float((weights[:, None] * left**2).mean())
        if noise is None:
            free = 1 - _CAUTION * trace / n
            return math.log(square) - 2 * math.log(free) if free > 0 else math.inf
        return square + 2 * _CAUTION * noise**2 * trace / n

    best = find_least(risk, *_LOG_RANGE)
    coefficients, left, trace = solve(best)
    free = max(1 - trace / n, 1e-6)
    square = float((weights[:, None] * left**2).mean())
    estimated = math.sqrt(square / free)
    spline = BSpline(knots, coefficients, _DEGREE)
    return TrackFit(spline, left, estimated if noise is None else noise, math.sqrt(square) / free)


def _place_knots(t: FloatArray) -> FloatArray:
    """Return the knots: one at each fix, at most 2 per second, none in gaps, which the penalty fills."""
    inner, last = [], float(t[0])
    for now in t[1:-1].tolist():
        if now - last >= (1 - 1e-6) / _KNOT_RATE:
            inner.append(now)
            last = now
    ends = np.full(_DEGREE + 1, t[0]), np.full(_DEGREE + 1, t[-1])
    return np.concatenate([ends[0], inner, ends[1]])


def _penalize(knots: FloatArray) -> Any:
    """Return the matrix of the integral of the squared third derivative over the coefficients, sparse."""
    from scipy.interpolate import BSpline
    from scipy.sparse import diags_array, identity

    change = identity(len(knots) - _DEGREE - 1, format="csr")
    degree, these = _DEGREE, knots
    for _ in range(_DERIVATIVE):
        count = len(these) - degree - 1
        width = these[degree + 1 : degree + count] - these[1:count]
        step = diags_array([-degree / width, degree / width], offsets=[0, 1], shape=(count - 1, count))
        change, degree, these = step @ change, degree - 1, these[1:-1]
    edges = np.unique(these)
    half, middle = np.diff(edges) / 2, (edges[1:] + edges[:-1]) / 2
    nodes, node_weights = np.polynomial.legendre.leggauss(3)  # exact: the square is of degree 4
    at = (middle[:, None] + half[:, None] * nodes).ravel()
    share = (half[:, None] * node_weights).ravel()
    derivative = BSpline.design_matrix(at, these, degree) @ change
    return derivative.T @ derivative.multiply(share[:, None])


def _to_banded(matrix: Any) -> FloatArray:
    banded = np.zeros((_DEGREE + 1, matrix.shape[0]))
    for k in range(_DEGREE + 1):
        diagonal = matrix.diagonal(-k)
        banded[k, : len(diagonal)] = diagonal
    return banded


def find_least(f: Any, low: float, high: float) -> float:
    """Return the argument of the minimum of f: the best of a grid, then a golden-section search around it."""
    grid = np.linspace(low, high, 13)
    values = [f(x) for x in grid]
    k = int(np.argmin(values))
    low, high = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])
    golden = (math.sqrt(5) - 1) / 2
    inner = [high - golden * (high - low), low + golden * (high - low)]
    found = [f(x) for x in inner]
    for _ in range(_SEARCH):
        if found[0] < found[1]:
            high, inner[1], found[1] = inner[1], inner[0], found[0]
            inner[0] = high - golden * (high - low)
            found[0] = f(inner[0])
        else:
            low, inner[0], found[0] = inner[0], inner[1], found[1]
            inner[1] = low + golden * (high - low)
            found[1] = f(inner[1])
    return float(low + high) / 2
