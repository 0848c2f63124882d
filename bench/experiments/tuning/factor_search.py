"""Find the factors that minimize a mean cost over runs, as logarithms, and their confidence intervals.

The cost of a run is any score with its mean least at the right factors. The search is COBYQA, a trust region
with quadratic models (Ragonneau, Model-based derivative-free optimization methods and software, thesis, Hong
Kong Polytechnic University, 2022), from several starts. Intervals need no model of the costs. Along the path
on which one factor moves and the others follow, each run has a slope; its mean over runs is zero at the
truth. The interval contains the points at which Student's t does not separate the mean slope from zero: a
score test with its variance from the runs (White, Maximum likelihood estimation of misspecified models,
Econometrica 50, 1982; Boos, On generalized score tests, American Statistician 46, 1992). The interval of a
factor without effect has no end.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray

Costs = Callable[[FloatArray], FloatArray]
"""Logarithms of factors (n,) -> cost of each run (D,)."""

REACH = float(np.log(100.0))
"""Largest logarithm of a factor."""

_STARTS = (0.0, float(np.log(5.0)), float(-np.log(5.0)))  # of every logarithm
_BEGIN, _END, _ROUGH = float(np.log(2.0)), 0.05, 0.2  # radius of trust: first, last, last to compare
_PULL = 1e-3  # cost of the square of a logarithm: a factor without effect stays 1
_STEP = 0.1  # of a logarithm, for second derivatives
_FIRST, _GROWTH = 0.05, 1.5  # steps of a logarithm on the way to an end of an interval
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class FoundFactor:
    """Minimum of a mean cost, with intervals of the factors."""

    x: FloatArray  # (n,) logarithms of the factors
    low: FloatArray  # (n,) ends of the 95 % intervals; infinite: none is told; NaN: not searched
    high: FloatArray
    converged: bool
    starts: int  # that were searched from
    agreed: int  # of them that came to the same cost


class SpentError(Exception):
    """Raised when the largest number of sets has been tried."""


class Tried:
    """Costs of the tried sets, and the mean cost that the search minimizes."""

    def __init__(self, costs: Costs, most: int) -> None:
        self._costs, self._most = costs, most
        self.rows: dict[tuple[float, ...], FloatArray] = {}

    def draws(self, x: FloatArray) -> FloatArray:
        """Return the cost of each run (D,), without a limit on the number of sets."""
        key = tuple(x.tolist())
        if key not in self.rows:
            self.rows[key] = self._costs(x)
        return self.rows[key]

    def mean(self, x: FloatArray) -> float:
        """Return the mean cost, with a weak pull of each factor to 1."""
        return float(self.draws(x).mean()) + _PULL * float(x @ x)

    def search(self, x: FloatArray) -> float:
        """Return the mean cost; raise SpentError if no more sets may be tried."""
        if len(self.rows) >= self._most:
            raise SpentError
        return self.mean(x)

    def best(self) -> FloatArray:
        """Return the set with the least mean."""
        return np.array(min(self.rows, key=lambda key: self.mean(np.array(key))))


def search_factors(costs: Costs, n: int, most: int) -> FoundFactor:
    """Return the logarithms that minimize the mean cost, with their intervals.

    Parameters
    ----------
    costs : callable
        Logarithms (n,), each at most `REACH` from zero -> finite costs of the runs (D,), at least two.
    n : int
        Number of factors.
    most : int
        Sets to try in the search; the intervals take some ten more for each factor, if it converged.
    """
    tried, ends = Tried(costs, most), list[FloatArray]()
    try:
        for number, start in enumerate(_STARTS):
            ends.append(_descend(tried, np.full(n, start), _ROUGH if number else _END))
        x = tried.best()
        if not np.array_equal(x, ends[0]):
            x = _descend(tried, x, _END)
    except SpentError:
        open_ends = np.full(n, np.nan)
        return FoundFactor(tried.best(), open_ends, open_ends, converged=False, starts=len(ends), agreed=0)
    x, hessian = step_to_valley(tried, x)
    edge = find_edge(len(tried.draws(x)))
    agreed = sum(abs(t_value(tried.draws(end) - tried.draws(x))) <= edge for end in ends)
    low, high = find_ends(tried, x, hessian, edge)
    return FoundFactor(x, low, high, converged=True, starts=len(ends), agreed=int(agreed))


def _descend(tried: Tried, start: FloatArray, last: float) -> FloatArray:
    """Return the best set of a descent from a start until the trust region is small."""
    from scipy.optimize import minimize

    found = minimize(
        tried.search,
        start,
        method="COBYQA",
        bounds=[(-REACH, REACH)] * len(start),
        options={"initial_tr_radius": _BEGIN, "final_tr_radius": last, "maxfev": 10_000},
    )
    return np.asarray(found.x, float)


def find_edge(draws: int) -> float:
    """Return the bound of Student's t for the number of runs."""
    from scipy.special import stdtrit

    return float(stdtrit(draws - 1, 0.5 + 0.5 * _CONFIDENCE))


def t_value(values: FloatArray) -> float:
    """Return the mean divided by its standard error; 0 if all values are zero."""
    mean, error = float(values.mean()), float(values.std(ddof=1)) / np.sqrt(len(values))
    if error == 0.0:
        return 0.0 if mean == 0.0 else float(np.copysign(np.inf, mean))
    return float(mean / error)


def find_ends(tried: Tried, x: FloatArray, hessian: FloatArray, edge: float) -> tuple[FloatArray, FloatArray]:
    """Return the ends (n,), (n,) of the intervals of the logarithms."""
    n = len(x)
    low, high = np.empty(n), np.empty(n)
    for k in range(n):
        path, others = np.eye(n)[k], np.delete(np.arange(n), k)
        path[others] = -np.linalg.solve(hessian[np.ix_(others, others)], hessian[others, k])
        low[k] = walk(tried, x, -path, k, edge)
        high[k] = walk(tried, x, path, k, edge)
    return low, high


def step_to_valley(tried: Tried, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Take a Newton step if it lowers the mean; return the end point, and the second derivatives (n, n)."""
    n, unit, mean = len(x), _STEP * np.eye(len(x)), tried.mean
    here = mean(x)
    ahead, back = [mean(x + one) for one in unit], [mean(x - one) for one in unit]
    H = np.diag([(a - 2.0 * here + b) / _STEP**2 for a, b in zip(ahead, back, strict=True)])
    for i, j in itertools.combinations(range(n), 2):
        both = mean(x + unit[i] + unit[j])
        H[i, j] = H[j, i] = (both - ahead[i] - ahead[j] + here) / _STEP**2
    values, vectors = np.linalg.eigh(H)
    H = vectors * np.maximum(values, 2.0 * _PULL) @ vectors.T  # positive definite
    slope = (np.array(ahead) - np.array(back)) / (2.0 * _STEP)
    new = np.clip(x - np.linalg.solve(H, slope), x - _END, x + _END)
    new = np.clip(new, -REACH, REACH)
    return (new if mean(new) < here else x), H


def walk(tried: Tried, x: FloatArray, path: FloatArray, k: int, edge: float) -> float:
    """Return the logarithm of factor k at which the t value of the slope passes ``edge``, or infinity.

    Slopes are differences between points on the path and apply at their middles; between two middles
    Student's t is interpolated linearly.
    """
    side, step, reached = path[k], _FIRST, 0.0
    costs, before = tried.draws(x), (0.0, 0.0)  # middle and its t
    while abs(x[k] + side * (reached + step)) <= REACH:
        reached += step
        ahead = tried.draws(np.clip(x + reached * path, -REACH, REACH))
        middle, t = reached - 0.5 * step, t_value(ahead - costs)
        if t > edge:
            share = (edge - before[1]) / (t - before[1]) if np.isfinite(t) else 1.0
            return float(x[k] + side * (before[0] + share * (middle - before[0])))
        costs, before, step = ahead, (middle, t), _GROWTH * step
    return float(side * np.inf)
