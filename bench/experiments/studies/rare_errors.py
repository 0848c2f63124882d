"""Rates of errors beyond an alert limit, 1e-5 an hour and less, by subset simulation."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.moved_runs import MovedRun
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import Estimate
from bench.evaluation.ensembles.rare_events import simulate_subsets
from bench.evaluation.requirements.required_performance import OUTSIDE_PER_HOUR, JudgedFigure
from bench.evaluation.requirements.share_test import MET, UNDECIDED
from bench.experiments.studies.stanford import PLANES

LEAST = 20
"""Fewest runs above a threshold."""

_FIRST = 1_000_000  # number of the first run: no plain run has its noise


@dataclass(frozen=True, slots=True)
class RareErrors:
    """The rate of flights with an error beyond the limit, bounds of 95 % each."""

    title: str
    judged: JudgedFigure
    required: str
    sentence: str


def find_rare_errors(
    measure: Callable[[Sequence[MovedRun]], FloatArray], limits: Sequence[float], size: int, hours: float
) -> Iterator[RareErrors]:
    """Yield the rate of flights with a horizontal or vertical error beyond its alert limit.

    The rate is an upper bound of the integrity risk, because errors with an alert are counted, too. If it is
    too high, the requirement is undecided and not missed.

    Parameters
    ----------
    measure : callable
        Returns the largest horizontal and vertical errors (N, 2) of N runs [m].
    limits : sequence of float
        Alert limits, horizontal and vertical [m].
    size : int
        Runs above each threshold.
    hours : float
        Duration of a flight [h].
    """
    for k, (plane, limit) in enumerate(zip(PLANES, limits, strict=True)):
        found = simulate_subsets(
            lambda runs, k=k: measure(runs)[:, k],  # type: ignore[misc]
            limit,
            size,
            first=_FIRST,
            confidence=0.9,
        )
        chance = found.probability
        rate = Estimate(*(one / hours for one in (chance.value, chance.low, chance.high)))
        value, low, high = (format_number(one, 2) for one in (rate.value, rate.low, rate.high))
        yield RareErrors(
            f"{plane} error beyond the alert limit, per hour",
            JudgedFigure(rate, MET if rate.high <= OUTSIDE_PER_HOUR else UNDECIDED),
            f"<= {OUTSIDE_PER_HOUR:g}",
            f"{plane.capitalize()} error beyond {format_number(limit)} m: {value} per hour (bounds {low}, "
            f"{high}), by subset simulation of {found.runs} runs with the noise of the profile.",
        )


def find_largest(errors: FloatArray) -> FloatArray:
    """Return the largest horizontal and vertical error (2,) of the errors (M, 3) of a run, n [m].

    It is infinite if an epoch has no solution.
    """
    sizes = np.column_stack([np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])])
    known = np.where(np.isnan(sizes), np.inf, sizes)
    return np.asarray(known.max(axis=0) if len(known) else np.full(2, np.inf))
