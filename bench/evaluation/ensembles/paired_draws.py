"""Comparison of two filters on the same runs: better, relevant, and the number of runs needed to decide.

Run k of both has the same noise, so that noise in common is in no interval. The ratio of root mean squares is
compared. If a pair is evaluated several times while runs are added, or is one of several pairs, it gets a
part of the probability of a false verdict (Bonferroni).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import CONFIDENCE, SAME, Estimate, qualify
from bench.evaluation.ensembles.regression import Change, estimate_change, half_log_of_mean

Word = Literal["better", "worse", "same", "undecided"]

_MOST_DRAWS = 100_000  # that are thought of
_REPEATED = 20  # until a number of runs stays


@dataclass(frozen=True, slots=True)
class PairedRatio:
    """Ratio of the RMS error of the first filter to the second, over their common runs."""

    first: str
    second: str
    ratio: Estimate
    word: Word
    draws: int
    deciding: int | None  # runs that would decide if the spread stays; None: decided, or more than 100,000

    @property
    def sentence(self) -> str:
        """Return which filter is better and by how much, or how many more runs would decide."""
        text = f"{self.first} over {self.second} {format_number(self.ratio.value, 3)} ({self.ratio.interval}"
        text += f"{qualify(self.draws)})"
        if self.word != "undecided":
            return f"{text}: {self.word}"
        if self.deciding is None:
            return f"{text}: undecided in {self.draws} runs, and more would hardly help"
        return f"{text}: undecided in {self.draws} runs, about {self.deciding - self.draws} more would decide"


def compare_draws_of(
    names: tuple[str, str], first: FloatArray, second: FloatArray, error: float = 1.0 - CONFIDENCE
) -> PairedRatio:
    """Compare two filters by their errors on the same runs.

    Parameters
    ----------
    names : (str, str)
        What they are called.
    first, second : (R,) array
        Root mean square error, or an error, of each run; run k of both has the same noise. At least two.
    error : float
        Probability that the interval of the ratio misses it.

    Returns
    -------
    pair : Pair
        "same" where the interval of the ratio lies within `SAME` of 1; else "better" or "worse" where it
        excludes 1.
    """
    if np.array_equal(first, second):
        return PairedRatio(*names, Estimate(1.0, 1.0, 1.0), "same", len(first), None)
    by_draw = np.log(np.abs(first) / np.abs(second))
    change = estimate_change(
        np.square(second), np.square(first), half_log_of_mean, paired=True, by_draw=by_draw
    )
    low, high = change.interval(error)
    edge = math.log1p(SAME)
    word: Word = (
        "same"
        if -edge <= low and high <= edge
        else "better"
        if high < 0.0
        else "worse"
        if low > 0.0
        else "undecided"
    )
    with np.errstate(over="ignore"):
        ratio = Estimate(*(float(np.exp(one)) for one in (change.estimate, low, high)))
    deciding = None
    if word == "undecided":
        clear = max(abs(change.estimate), edge - abs(change.estimate))
        needed = count_deciding(change, clear, error)
        deciding = math.ceil(needed) + 1 if needed < _MOST_DRAWS else None
    return PairedRatio(*names, ratio, word, len(first), deciding)


def count_deciding(change: Change, clear: float, error: float) -> float:
    """Return the number of runs with which the half-width of the interval of a change is ``clear``.

    The spread stays, and Student's t of more runs is less: it is found by repetition.
    """
    needed = float(change.draws)
    for _ in range(_REPEATED):
        more = replace(change, dof=max(needed, 2.0) - 1.0)
        half = more.interval(error)[1] - change.estimate
        needed = min(change.draws * (half / clear) ** 2, 2.0 * _MOST_DRAWS)
    return needed
