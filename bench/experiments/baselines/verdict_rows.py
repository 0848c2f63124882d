"""The verdict on each metric: same, better, worse or undecided."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.evaluation.ensembles import regression
from bench.evaluation.ensembles.ensemble import qualify
from bench.evaluation.ensembles.regression import Change
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.baselines.baseline_file import CPU, UNKNOWN, Baseline, EstimatorValues, Value

SAME = 1e-6
"""Relative difference of two values that are the same, on another processor [1]."""

ERROR = 0.01
"""Probability of any false `worse` or `better` in a whole check [1]."""

LOOKS = (20, 40, 80)
"""Numbers of runs after which a check looks at the metrics; `ERROR` is split over the looks."""

CONVERGED = "converged"
"""Name of the row that counts the runs that converged."""

CPU_TOLERANCE = 0.25
"""Change of CPU time that a busy or another machine may make [1]."""

FRACTIONS = {"nees_inside_95": 0.95, "coverage_3sigma": 0.9973, "output_coverage": 1.0}
"""Beginning of the name of a fraction of epochs -> its value for a consistent filter."""

OTHER_TRUTH = "the flight is another one: not paired"
"""Note of a verdict on runs of another truth, or of a log on other sensor data."""

UNPAIRED = "other sensor data of another seed: not paired"
"""Note of a verdict on runs of one truth that are no pairs."""

BY_SEED = "other sensor data, paired by seed"
"""Note of a verdict on other sensors or figures of them: runs of one seed and number share their noise."""

MATCHES = (OTHER_TRUTH, UNPAIRED, BY_SEED)
"""Notes on how the runs of a whole profile are matched; others are on a metric."""

Word = Literal["same", "better", "worse", "undecided"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """One metric of one filter, compared with its baseline."""

    profile: str
    estimator: str
    metric: str
    unit: str
    word: Word
    old: float | None  # pooled over the compared runs
    new: float | None
    change: float | None  # above 0: worse; relative [1], or in the unit if not `relative`
    low: float | None  # Holm-corrected interval of the change
    high: float | None
    relative: bool
    draws: int  # that were compared
    paired: bool  # run by run
    note: str  # what the figures do not say

    @property
    def told(self) -> str:
        """The word; "same" only of equal runs, because no test of equivalence is made."""
        return "within tolerance" if self.word == "same" and self.low is not None else self.word

    @property
    def rare(self) -> str:
        """The words that the interval of an RMSE needs; "" if it needs none."""
        return qualify(self.draws) if _is_rms(self.metric) and self.low is not None else ""

    @property
    def sentence(self) -> str:
        """The row in words."""
        values = " -> ".join("-" if x is None else f"{x:.4g}" for x in (self.old, self.new))
        unit = f" {self.unit}" if self.unit not in ("", "1") else ""
        parts = [f"{self.told}: {self.estimator} on {self.profile}, {self.metric} {values}{unit}"]
        if self.change is not None:
            parts.append(f"{self.format_change()} in {self.draws} runs{self.rare}")
        return ", ".join([*parts, *([self.note] if self.note else [])])

    def format_change(self) -> str:
        """Return the change with its interval as text; above 0 is worse."""
        if self.change is None:
            return ""
        parts = [self.change] if self.low is None or self.high is None else [self.change, self.low, self.high]
        change, *ends = (_format_percent(part) if self.relative else f"{part:+.3g}" for part in parts)
        return f"{change} ({' to '.join(ends)})" if ends else change


def _format_percent(part: float) -> str:
    """Format a fraction in percent, also very large ends of an interval of few runs."""
    return f"{part:+.1%}" if part < 1e3 else f"{100.0 * part:+.2g}%"


@dataclass(frozen=True, slots=True)
class UncorrectedVerdict:
    """A verdict before the error is shared among all rows of the check."""

    row: Verdict
    side: int = 0  # beyond the tolerance: 1 to the worse, -1 to the better side, else 0
    p_value: float = 1.0
    change: Change | None = None
    certain: bool = False  # the word needs no statistics


def decide(candidates: Sequence[UncorrectedVerdict], error: float = ERROR / len(LOOKS)) -> list[Verdict]:
    """Return the verdicts of a whole check at one look, with the family-wise error probability ``error``.

    A metric is worse (or better) if its change is beyond the tolerance and its Holm-corrected interval
    excludes zero. If the change is beyond the tolerance and the interval contains zero, it is undecided.
    """
    open_rows = [k for k, one in enumerate(candidates) if not one.certain]
    rejected, levels = regression.reject_by_holm([candidates[k].p_value for k in open_rows], error)
    verdicts = [one.row for one in candidates]
    for k, proven, level in zip(open_rows, rejected, levels, strict=True):
        one = candidates[k]
        word: Word = "same"
        if one.side:
            word = "undecided" if not proven else "worse" if one.side > 0 else "better"
        verdicts[k] = replace(one.row, word=word)
        if one.change is not None and math.isfinite(one.change.standard_error):
            ends = one.change.interval(float(level))
            low, high = (math.expm1(min(x, 700.0)) if one.row.relative else x for x in ends)
            verdicts[k] = replace(verdicts[k], low=low, high=high)
    return verdicts


def compare(
    baseline: Baseline, measured: Baseline, name: str, *, numbered: bool = False, changed: bool = False
) -> list[UncorrectedVerdict]:
    """Compare the first runs of a baseline with the measured runs, metric by metric.

    Draws whose digests of truth and sensors agree are compared in pairs, if they are at least half of the
    runs measured. Others are pairs, too, if both are ``numbered`` from 0 with one seed on one truth: each
    source of noise has a stream of its own, which other figures scale and other sources leave alone. A pair
    whose noise is not the same costs power, but no error: runs are independent of each other. Otherwise all
    runs before are compared with all runs after. A run without a result is a pair: it failed. ``changed``
    says that draws of equal digests have other sensor data all the same: the digests name seed and number.
    """
    n = min(baseline.draws, measured.draws)
    pairs = zip(baseline.sensors[:n], measured.sensors[:n], strict=True)
    alike = np.array([a == b or UNKNOWN in (a, b) for a, b in pairs])
    if baseline.truth != measured.truth:
        alike[:] = False
    same = bool(alike.sum() >= max(2, 0.5 * n))
    which = np.flatnonzero(alike) if same else np.arange(n)
    seeded = numbered and bool(baseline.truth) and baseline.truth == measured.truth
    match = BY_SEED if changed else ""
    if not same:
        match = BY_SEED if seeded and baseline.seed == measured.seed else UNPAIRED
        if baseline.truth != measured.truth:
            match = OTHER_TRUTH
    rows = []
    for label, old in baseline.estimators.items():
        new = measured.estimators.get(label)
        if new is None:
            row = _make_row(name, label, CONVERGED, match, len(which), "the profile has no such filter")
            rows.append(UncorrectedVerdict(replace(row, word="worse"), certain=True))
            continue
        rows.append(_compare_convergence(name, label, old, new, which, match))
        for metric in old.metrics:
            candidate = _compare_metric(name, label, metric, old, new, which, match, baseline.tolerance)
            if candidate is not None:
                rows.append(candidate)
    return rows


def _are_pairs(match: str) -> bool:
    return match not in (OTHER_TRUTH, UNPAIRED)


def _make_row(name: str, label: str, metric: str, match: str, draws: int, note: str = "") -> Verdict:
    known = find_metric(metric)
    unit = known.unit if known else "1"
    note, paired = ", ".join(filter(None, [note, match])), _are_pairs(match)
    return Verdict(
        name, label, metric, unit, "same", None, None, None, None, None, False, draws, paired, note
    )


def _compare_convergence(
    name: str, label: str, old: EstimatorValues, new: EstimatorValues, which: np.ndarray, match: str
) -> UncorrectedVerdict:
    """Compare how many runs converged; on identical draws a new divergence is worse without statistics."""
    before, after = np.array(old.converged)[which], np.array(new.converged)[which]
    candidate = _compare_events(name, label, CONVERGED, before, after, which, match, new.reasons)
    if not match and (before & ~after).any():
        return replace(candidate, row=replace(candidate.row, word="worse"), certain=True)
    return candidate


def _compare_events(
    name: str,
    label: str,
    metric: str,
    before: BoolArray,
    after: BoolArray,
    which: np.ndarray,
    match: str,
    reasons: Sequence[str] = (),
) -> UncorrectedVerdict:
    """Compare the rates of a success before and after; ``reasons`` by run explain why it did not happen."""
    notes = []
    paired = _are_pairs(match)
    lost = which[before & ~after if paired else ~after]
    if paired:
        for text, draws in (("lost", lost), ("gained", which[~before & after])):
            if len(draws):
                notes.append(f"{text} in run {_list_draws(draws)}")
    if reasons and len(lost) and after.mean() < before.mean():
        notes.append(f"run {lost[0]}: {reasons[lost[0]]}")
    row = _make_row(name, label, metric, match, len(before), ", ".join(notes))
    row = replace(row, old=float(before.mean()), new=float(after.mean()))
    if np.array_equal(before, after):
        return UncorrectedVerdict(row, certain=True)
    difference = float(before.mean() - after.mean())
    p_value = regression.compare_counts(before, after, paired=paired)
    row = replace(row, change=difference)
    return UncorrectedVerdict(row, int(np.sign(difference)), p_value)


def _list_draws(draws: np.ndarray) -> str:
    return ", ".join(str(k) for k in draws[:8]) + (" ..." if len(draws) > 8 else "")


def _compare_metric(
    name: str,
    label: str,
    metric: str,
    old: EstimatorValues,
    new: EstimatorValues,
    which: np.ndarray,
    match: str,
    tolerance: float,
) -> UncorrectedVerdict | None:
    """Compare one metric over the runs that converged and have it before and after; None if none had it."""
    before, after = _get_values(old, metric, which), _get_values(new, metric, which)
    if _is_event(metric):
        known = np.isfinite(before) & np.isfinite(after)
        if not known.any():
            return None
        return _compare_events(
            name, label, metric, before[known] > 0.5, after[known] > 0.5, which[known], match
        )
    has_old, has_new = np.isfinite(before), np.isfinite(after)
    if not has_old.any():
        return None
    if metric.startswith("fault_"):  # only where the fault was detected, before and after
        noticed = f"fault_{metric.split('_')[1]}_detected"
        has_old &= _get_values(old, noticed, which) > 0.5
        has_new &= _get_values(new, noticed, which) > 0.5
    elif not match and metric != CPU and (lost := has_old & ~has_new & np.array(new.converged)[which]).any():
        row = _make_row(name, label, metric, match, len(which), f"no value in run {_list_draws(which[lost])}")
        return UncorrectedVerdict(
            replace(row, word="worse", old=_pool(metric, before[has_old])), certain=True
        )
    paired = _are_pairs(match)
    if paired:
        has_old = has_new = has_old & has_new
    before, after = before[has_old], after[has_new]
    if min(len(before), len(after)) < 2:
        return None
    row = _make_row(name, label, metric, match, len(after))
    row = replace(row, old=_pool(metric, before), new=_pool(metric, after))
    if paired and _is_same(metric, before, after, min(old.epochs, new.epochs)):
        return UncorrectedVerdict(row, certain=True)
    if metric == CPU:
        tolerance = max(tolerance, CPU_TOLERANCE)
    return _measure_change(row, before, after, new.expected.get(metric), tolerance)


def _get_values(of: EstimatorValues, metric: str, which: np.ndarray) -> FloatArray:
    """Return the values of a metric in some runs; NaN without a value or if the run did not converge."""
    stored: Sequence[Value] = of.metrics.get(metric, (None,) * len(of.converged))
    known = find_metric(metric)
    absent = 0.0 if known is not None and known.direction == "zero" else np.nan
    values = np.array([absent if x is None else x for x in stored], float)[which]
    return np.where(np.array(of.converged)[which], values, np.nan)


def _is_event(metric: str) -> bool:
    return metric.startswith("fault_") and metric.endswith("_detected")


def _find_fraction(metric: str) -> float | None:
    """Return the expected value of a fraction of epochs; None for other metrics."""
    return next((value for head, value in FRACTIONS.items() if metric.startswith(head)), None)


def _is_rms(metric: str) -> bool:
    return "_rmse" in metric


def _pool(metric: str, values: FloatArray) -> float:
    """Return a metric pooled over all runs; the squares of an RMSE are averaged."""
    return float(np.sqrt(np.mean(values**2)) if _is_rms(metric) else values.mean())


def _is_same(metric: str, before: FloatArray, after: FloatArray, epochs: int) -> bool:
    """Return whether every run has the same value, apart from rounding on another processor."""
    size = np.maximum(np.abs(before), np.sqrt(np.mean(before**2)))
    allowed = SAME * size
    if _find_fraction(metric) is not None:
        allowed += 1.0 / max(epochs, 1)
    return bool((np.abs(after - before) <= allowed).all())


def _measure_change(
    row: Verdict, before: FloatArray, after: FloatArray, expected: float | None, tolerance: float
) -> UncorrectedVerdict:
    """Choose the scale on which a metric is compared, and measure the change on this scale."""
    known = find_metric(row.metric)
    fraction = _find_fraction(row.metric)
    positive = bool((before > 0).all() and (after > 0).all())
    oriented = None
    if row.paired:
        oriented = np.log(after / before) if positive and fraction is None else after - before
    limit = tolerance * float(np.sqrt(np.mean(before**2)))
    if _is_rms(row.metric):
        before, after = before**2, after**2
    scale, relative, target = regression.distance_from(0.0), False, 0.0
    if fraction is not None:
        scale, limit, target = regression.distance_from(fraction), tolerance, fraction
    elif expected and positive:
        scale, relative, target = regression.log_distance_from(expected), True, expected
    elif positive and (row.metric == CPU or (known is not None and known.direction == "lower")):
        scale = regression.half_log_of_mean if _is_rms(row.metric) else regression.log_of_mean
        relative = True
    if relative:
        limit = math.log1p(tolerance)
    if oriented is not None and (before.mean() - target) * (after.mean() - target) > 0:
        oriented *= np.sign(after.mean() - target)
    elif oriented is not None:  # the values cross their expectation: only the size of the second test counts
        moved = scale(after.mean()) - scale(before.mean())
        oriented *= np.sign(oriented.mean()) * np.sign(moved)
    change = regression.estimate_change(before, after, scale, paired=row.paired, by_draw=oriented)
    size = change.estimate
    row = replace(row, change=math.expm1(min(size, 700.0)) if relative else size, relative=relative)
    side = int(np.sign(size)) if abs(size) > limit else 0
    return UncorrectedVerdict(row, side, change.p_value, change)
