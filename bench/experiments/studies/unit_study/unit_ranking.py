"""Ranking of IMUs and classes on one flight with one filter, by pairs of the same runs.

From the cheapest class on, the best unit of a class is held against the best of the classes below. A unit
that lost a run is not usable and takes no part; one that no run tells from the best of its class stands
beside it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import SAME, Estimate, estimate_rate, pool_rmse
from bench.evaluation.ensembles.paired_draws import PairedRatio, compare_draws_of
from bench.evaluation.requirements.required_metrics import Finding
from bench.evaluation.requirements.share_test import MET, UNDECIDED
from bench.experiments.studies.unit_study.catalog_units import CLASSES

_LEAST = 2  # runs that have an interval


@dataclass(frozen=True)
class UnitFlown:
    """One unit on one flight by one filter."""

    unit: str
    grade: str  # of `CLASSES`, or another word for a unit that stands outside of them
    values: FloatArray  # (R,) the figure that is compared, of each run in order; NaN: lost
    findings: tuple[Finding, ...] = ()  # of what is required

    @property
    def lost(self) -> int:
        """Return the number of runs that diverged, failed or do not have the metric."""
        return int(np.isnan(self.values).sum())

    @property
    def rms(self) -> Estimate | None:
        """Return the RMS over the converged runs with its interval; None for fewer than two runs."""
        known = self.values[~np.isnan(self.values)]
        return pool_rmse(np.square(known)) if len(known) >= _LEAST else None

    @property
    def verdict(self) -> str:
        """Return the verdict: "not usable", "usable", or whether the requirements are met."""
        if self.lost:
            return "not usable"
        words = {one.word for one in self.findings}
        return "usable" if not words else next(word for word in ("missed", UNDECIDED, MET) if word in words)

    @property
    def loss(self) -> str:
        """Return the number of runs that diverged, and the interval of their percentage, in words."""
        rate = estimate_rate(self.lost, len(self.values))
        ends = (format_number(100.0 * end, 2) for end in (rate.low, rate.high))
        return f"{self.unit} {self.lost} of {len(self.values)} ({' to '.join(ends)} % of all)"


@dataclass(frozen=True)
class ClassStep:
    """A class of IMUs: its best IMU, and the gain over the cheaper classes."""

    grade: str
    best: UnitFlown
    beside: tuple[PairedRatio, ...]  # units of the class over the best that are the same or undecided
    gain: PairedRatio | None  # the best over that of the classes below; None: there is none below

    @property
    def pays(self) -> bool:
        """Return whether the class is shown to be better than cheaper classes, or is the cheapest."""
        return self.gain is None or self.gain.word == "better"


@dataclass(frozen=True)
class Ranking:
    """The classes from cheap to expensive, on one flight with one filter."""

    steps: tuple[ClassStep, ...]
    flown: Mapping[str, UnitFlown] = field(default_factory=dict)  # by unit
    alike: bool = False  # the unit does not matter: all usable ones are shown to err by the same

    @property
    def front(self) -> tuple[ClassStep, ...]:
        """The classes that are shown to be better than those below."""
        return tuple(step for step in self.steps if step.pays)

    @property
    def recommended(self) -> ClassStep | None:
        """The cheapest class with an IMU that is shown to meet the requirements; None without one."""
        return next((step for step in self.steps if step.best.verdict == MET), None)

    @property
    def spread(self) -> float:
        """Ratio of the largest to the smallest error of usable units; infinite for fewer than two."""
        found = [one.rms.value for one in self.flown.values() if not one.lost and one.rms]
        return max(found) / min(found) if len(found) > 1 and min(found) > 0.0 else math.inf

    def list_open(self) -> list[PairedRatio]:
        """Return the pairs that are undecided, of classes that pay or may."""
        gains = [step.gain for step in self.steps if step.gain is not None]
        pairs = [*gains, *(pair for step in self.front for pair in step.beside)]
        return [pair for pair in pairs if pair.word == "undecided"]

    def list_undecided(self) -> list[UnitFlown]:
        """Return the IMUs that may meet the requirements, of classes cheaper than the cheapest that does."""
        found = self.recommended
        top = len(CLASSES) if found is None else CLASSES.index(found.grade)
        return [
            one
            for one in self.flown.values()
            if one.verdict == UNDECIDED and one.grade in CLASSES and CLASSES.index(one.grade) < top
        ]


def rank_units(flown: Sequence[UnitFlown], error: float) -> Ranking:
    """Return the best IMU of each class, and the classes that are better than cheaper ones.

    Parameters
    ----------
    flown : sequence of Flown
        On one flight by one filter; run k of all has the same noise.
    error : float
        Probability of a wrong word about a class: that its best is better than what is cheaper.
    """
    steps: list[ClassStep] = []
    best: UnitFlown | None = None
    for grade in CLASSES:
        usable = [one for one in flown if one.grade == grade and not one.lost and len(one.values) >= _LEAST]
        if not usable:
            continue
        met = [one for one in usable if one.verdict == MET]  # a unit that meets is asked for, if there is one
        top = min(met or usable, key=_measure)
        share = error / len(usable)  # the best of several is held against another (Bonferroni)
        pairs = [_compare(one, top, share) for one in usable if one is not top]
        beside = tuple(pair for pair in pairs if pair.word != "worse")
        gain = None if best is None else _compare(top, best, share)
        steps.append(ClassStep(grade, top, beside, gain))
        best = min((one for one in (best, *usable) if one is not None), key=_measure)
    return Ranking(tuple(steps), {one.unit: one for one in flown}, _are_alike(flown, error))


def _are_alike(flown: Sequence[UnitFlown], error: float) -> bool:
    """Return whether all usable IMUs have errors within `SAME` of the best, by the ends of the ratios."""
    usable = sorted((one for one in flown if not one.lost and len(one.values) >= _LEAST), key=_measure)
    ratios = [_compare(one, usable[0], error / len(usable)).ratio for one in usable[1:]]
    return bool(ratios) and all(one.high <= 1.0 + SAME for one in ratios)


def _measure(one: UnitFlown) -> float:
    return float(np.mean(np.square(one.values)))


def _compare(one: UnitFlown, other: UnitFlown, error: float) -> PairedRatio:
    n = min(len(one.values), len(other.values))
    return compare_draws_of((one.unit, other.unit), one.values[:n], other.values[:n], error)
