"""Probability of an event too rare for plain runs, by subset simulation.

The event is a value above a limit. Thresholds lead to it: each is exceeded by a tenth of the runs above the
threshold before. The runs above a threshold continue as Markov chains: a chain moves the noise of its run
some way towards fresh noise (`MovedRun`), and does not move where the value would fall below the threshold.
The probability is the product of the conditional probabilities. Its interval follows from the logarithms of
independent repetitions by Student's distribution, because formulas for a single one ignore the correlation
of its chains.

Sources: Au, Beck, Probabilistic Engineering Mechanics 16 (2001) 263-277; for the moves and their adaptation,
Papaioannou, Betz, Zwirglmaier, Straub, Probabilistic Engineering Mechanics 41 (2015) 89-103.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.moved_runs import MovedRun
from bench.evaluation.ensembles.ensemble import Estimate, estimate_rate

LEVELS = 12
"""Largest number of thresholds: probabilities down to 1e-12."""

REPETITIONS = 5
"""Number of independent estimates from which the interval is computed."""

_SHARE = 10  # one of so many runs exceeds a level
_ACCEPTED = 0.44  # fraction of the moves that the step is adapted to


@dataclass(frozen=True, slots=True)
class RareEvent:
    """The probability of an event, and the runs from which it is estimated."""

    probability: Estimate
    levels: tuple[int, ...]  # thresholds of each repetition
    runs: int


def simulate_subsets(
    measure: Callable[[Sequence[MovedRun]], FloatArray],
    limit: float,
    size: int,
    *,
    first: int = 0,
    confidence: float = 0.95,
) -> RareEvent:
    """Estimate the probability that a value of a run exceeds a limit.

    Parameters
    ----------
    measure : callable
        Returns the values (N,) of N runs, a function of their noise; NaN counts as infinite.
    limit : float
    size : int
        Runs above each threshold in each repetition, at least 20.
    first : int
        Number of the first run; the same number gives the same bits.

    Returns
    -------
    RareEvent
        The interval does not cover causes of the event that no chain has found.
    """
    from scipy.special import stdtrit

    number, found = first, list[tuple[float, float, int]]()
    for _ in range(REPETITIONS):
        chance, most, levels, number = _simulate(measure, limit, size, number)
        found.append((chance, most, levels))
    chances, highs, counts = zip(*found, strict=True)
    if 0.0 in chances:
        estimate = Estimate(float(np.mean(chances)), 0.0, max(highs))
    else:
        logarithms = np.log(chances)
        spread = float(logarithms.var(ddof=1))
        middle = float(logarithms.mean()) + 0.5 * spread  # of a log-normal distribution
        error = math.sqrt(spread / REPETITIONS + 0.5 * spread**2 / (REPETITIONS - 1))
        reach = float(stdtrit(REPETITIONS - 1, 0.5 + 0.5 * confidence)) * error
        estimate = Estimate(*(min(math.exp(middle + one), 1.0) for one in (0.0, -reach, reach)))
    return RareEvent(estimate, counts, number - first)


def _simulate(
    measure: Callable[[Sequence[MovedRun]], FloatArray], limit: float, size: int, number: int
) -> tuple[float, float, int, int]:
    """Return the probability, its upper bound if no run exceeds the limit, the levels, and the next run."""
    chains = size // _SHARE
    current = [MovedRun(number + k) for k in range(size)]
    values = _know(measure(current))
    number += size
    chance, levels, step = 1.0, 0, 0.6
    while True:
        order = np.argsort(-values, kind="stable")
        level = float(values[order[chains]])  # a tenth is above it
        above = values > level
        if level >= limit or levels == LEVELS or not above.any():
            break
        chance *= float(above.mean())
        levels += 1
        moving, at = [current[k] for k in order[:chains]], values[order[:chains]]
        current, rows = [], []
        for k in range(size // chains):
            tried = [one.move(number + j, step) for j, one in enumerate(moving)]
            number += chains
            found = _know(measure(tried))
            good = found > level
            moving = [new if taken else old for new, old, taken in zip(tried, moving, good, strict=True)]
            at = np.where(good, found, at)
            current += moving
            rows.append(at)
            step = min(1.0, step * math.exp((float(good.mean()) - _ACCEPTED) / math.sqrt(k + 1.0)))
        values = np.concatenate(rows)
    share = float((values > limit).mean())
    return chance * share, chance * estimate_rate(0, size).high, levels, number


def _know(values: FloatArray) -> FloatArray:
    return np.where(np.isnan(values), np.inf, values)
