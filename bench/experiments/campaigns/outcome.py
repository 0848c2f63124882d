"""The result of a campaign: statistics of the runs of each filter, with intervals and sentences."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings import FindingTable
from bench.core.words.notebook import ShownFigure, draw, make_frame, write_sentences, write_table
from bench.core.words.stages import Stage
from bench.core.words.wording import format_number, one_line
from bench.evaluation.consistency.chi_square import NIS_PROBABILITY, MeanNis, mean_band
from bench.evaluation.ensembles import ensemble, regression
from bench.evaluation.ensembles.ensemble import Comparison, Estimate
from bench.evaluation.ensembles.ensemble_consistency import LEAST_RUNS, Consistency, check_consistency
from bench.evaluation.ensembles.rare_runs import measure_scatter
from bench.evaluation.ensembles.statement import state_uncertainty
from bench.evaluation.metrics.metric_words import find_words
from bench.evaluation.requirements.required_metrics import Finding, judge_runs, list_requirements
from bench.experiments.campaigns.groups import Group

POOLED = ("pos_rmse_h_m", "pos_rmse_d_m", "vel_rmse_3d_mps", "tilt_rmse_deg", "heading_rmse_deg")
"""Metrics whose squares are averaged over the runs."""
RATIO = "ANEES / n"
"""Name of the NEES over its expectation in tables."""

_LEAST = 2  # runs that have an interval


@dataclass(frozen=True)
class Outcome:
    """Statistics of one filter over runs; statistics of errors are over the runs that converged."""

    condition: str  # its name
    label: str
    runs: int
    converged: Estimate  # rate [1]
    errors: Mapping[str, Estimate]  # by metric of `POOLED`, and "cep50_m", "cep95_m"
    consistency: Consistency | None  # None with fewer than 8 runs, or if no accuracy is reported
    lost: str = ""  # why the first run that did not converge did not
    scatter: tuple[str, ...] = ()  # what holds even if rare large runs exist, a text for each error

    @property
    def converged_runs(self) -> int:
        """Number of runs that converged."""
        return round(self.runs * self.converged.value)

    def show(self, name: str, digits: int = 4) -> ShownFigure | None:
        """Return an error, or the ratio `RATIO`, with its interval; None without a value."""
        one, found = self.consistency, self.errors.get(name)
        if name == RATIO:
            found = Estimate(one.ratio, one.low, one.high) if one else None
        return found.show(digits) if found else None

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return the results in sentences."""
        rate, bad = self.converged, self.runs - self.converged_runs
        least, most = (format_number(100 * (1 - end), 2) for end in (rate.high, rate.low))
        found = [
            f"{self.label}: all {self.runs} runs converged; 0 to {most} % diverge, with 95 % confidence"
            if bad == 0
            else f"{self.label}: {bad} of {self.runs} runs diverged or failed, {least} to {most} % of all; "
            f"the first: {self.lost}"
        ]
        found += [f"{self.label}, {text}" for text in self.scatter[:1]]
        if self.consistency is not None:
            found.append(f"{self.label} is {self.consistency.sentence}")
            found += [f"{self.label}: {reason}" for reason in self.consistency.reasons]
        return tuple(found)


def tabulate(outcomes: Sequence[Outcome], names: Mapping[str, str], title: str = "") -> FindingTable:
    """Return a row for each condition and filter; ``names`` maps column names to metrics."""
    columns: dict[str, list[Any]] = {
        "condition": [one.condition for one in outcomes],
        "estimator": [one.label for one in outcomes],
        "converged": [ShownFigure(f"{one.converged_runs} of {one.runs}") for one in outcomes],
    }
    shown = {name: [one.show(metric) for one in outcomes] for name, metric in names.items()}
    return FindingTable("conditions", title, columns | shown)


def summarize(group: Group) -> Outcome:
    """Return the statistics of a group of runs."""
    good = [one for one, converged in zip(group.metrics, group.converged, strict=True) if converged]
    errors: dict[str, Estimate] = {}
    scatter: list[str] = []
    consistency = None
    late = group.evaluation.first
    if len(good) >= _LEAST:
        columns = {name: [one.get(name) for one in good] for name in POOLED}
        known = {name: np.array(values, float) for name, values in columns.items() if None not in values}
        errors = {name: ensemble.pool_rmse(np.square(values)) for name, values in known.items()}
        for name, values in known.items():
            words = find_words(name)
            scatter.append(f"{words.words}: {measure_scatter(values).describe(words.unit)}")
        size = np.hypot(*(group.channel(f"pos_err_{axis}_m", late) for axis in "ne"))
        if size.size:
            errors |= {f"cep{100 * p:.0f}_m": ensemble.pool_quantile(size, p) for p in (0.5, 0.95)}
    nees = group.channel("nees", late)
    if len(good) >= LEAST_RUNS and group.states and nees.size:
        consistency = check_consistency(nees, group.states, pool_nis(group), rows=good)
    return Outcome(
        condition=group.condition.name,
        label=group.label,
        runs=len(group.metrics),
        converged=ensemble.estimate_rate(len(good), len(group.metrics)),
        errors=errors,
        consistency=consistency,
        scatter=tuple(scatter),
        lost=next(
            (one_line(str(one.get("reason")))[:200] for one in group.metrics if not one["converged"]), ""
        ),
    )


@dataclass(frozen=True)
class Pair:
    """Two filters of a condition: a metric of each in the runs in which both converged."""

    names: tuple[str, str]
    first: FloatArray
    second: FloatArray


def pair_runs(groups: Sequence[Group], metric: str = "pos_rmse_h_m") -> list[Pair]:
    """Return pairs of the first group of a condition with each other group."""
    found = []
    for other in groups[1:]:
        both = groups[0].converged & other.converged
        pairs = [
            (a.get(metric), b.get(metric))
            for a, b, converged in zip(groups[0].metrics, other.metrics, both, strict=True)
            if converged
        ]
        if len(pairs) >= _LEAST and all(None not in pair for pair in pairs):
            first, second = np.array(pairs, float).T
            found.append(Pair((groups[0].label, other.label), first, second))
    return found


def compare(pairs: Sequence[Pair], unit: str = "m") -> list[Comparison]:
    """Compare the pairs of all conditions of a campaign.

    By Holm's method over them the probability of any false "better" is 5 %, however many there are.
    """
    changes = [regression.estimate_change(one.second**2, one.first**2, np.sqrt, paired=True) for one in pairs]
    _, levels = regression.decide(changes, 1.0 - ensemble.CONFIDENCE)
    return [
        ensemble.compare_rmse(one.names, one.first, one.second, unit, 1.0 - level)
        for one, level in zip(pairs, levels, strict=True)
    ]


def pool_nis(group: Group) -> dict[str, MeanNis]:
    """Return the mean NIS of each sensor over the runs that converged, with its band."""
    pooled = {}
    good = group.converged
    for sensor in dict.fromkeys(name for dof in group.nis_dof for name in dof):
        rows = [
            (one[f"nis_mean_{sensor}"], one[f"updates_{sensor}"], dof[sensor])
            for one, dof, converged in zip(group.metrics, group.nis_dof, good, strict=True)
            if converged and sensor in dof
        ]
        if rows:
            mean, updates, dof = np.array(rows, float).T
            n = int(updates.sum())
            low, high = mean_band(float(dof.sum()) / n, n, NIS_PROBABILITY)
            pooled[sensor] = MeanNis(float(mean @ updates) / n, low, high, n)
    return pooled


@dataclass(frozen=True, slots=True)
class CampaignStage(Stage):
    """Progress of a campaign; ``done`` includes the runs of its journal.

    Attributes
    ----------
    failed : int
        Runs that failed as a whole, because the aircraft could not be flown.
    new : int
        Runs finished since the start.
    elapsed : float
        Time since the start [s].
    flown : float
        Flight time of the new runs [s].

    Examples
    --------
    >>> str(CampaignStage("approach", 50, 200, "runs", failed=1, new=40, elapsed=20.0, flown=24000.0))
    '50 of 200 runs, 1 failed, 2.00 runs/s, 75 s left, 1200 x real time'
    """

    failed: int = 0
    new: int = 0
    elapsed: float = 0.0
    flown: float = 0.0

    def __str__(self) -> str:
        parts = [f"{self.done:.0f} of {self.total or 0:.0f} runs"]
        parts += [f"{self.failed} failed"] if self.failed else []
        if self.new and self.elapsed:
            rate = self.new / self.elapsed
            left = ((self.total or 0) - self.done) / rate
            parts += [f"{rate:.2f} runs/s", f"{_format_time(left)} left"]
            parts.append(f"{self.flown / self.elapsed:.0f} x real time")
        return ", ".join(parts)


def _format_time(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 6000 else f"{seconds / 3600:.1f} h"


@dataclass(frozen=True)
class Campaign:
    """Statistics of a campaign, with the tables of its runs.

    Attributes
    ----------
    outcomes : tuple of Outcome
        Statistics of each condition and filter: RMSE, NEES and others, with intervals.
    comparisons : tuple of Comparison
        Paired differences between filters.
    runs : pyarrow.Table
        One row for each run and filter; names end in the unit.
    epochs : pyarrow.Table
        One row for each filter and epoch: mean error and reported sigma over the runs.
    planned, finished : int
        Number of runs.
    failed : mapping of str to str
        Command that repeats a run -> why the run failed as a whole.
    conditions : tuple of mapping
        ``profile``, the varied ``values``, and the profile ``as_flown``.
    provenance : mapping
        Versions and commit.
    timing : mapping of str to float
        ``wall_s`` of this call, ``run_cpu_s`` of all finished runs [s].
    interrupted : bool
        Whether runs are missing because the campaign was interrupted.
    folder : Path or None
        Folder of the tables.
    estimator_cpu_s : mapping
        Filter -> CPU time of each finished run [s].
    damaged : int
        Damaged lines and parts of the journal that was continued; their runs were repeated.
    """

    outcomes: tuple[Outcome, ...]
    comparisons: tuple[Comparison, ...]
    runs: Any
    epochs: Any
    planned: int
    finished: int
    failed: Mapping[str, str]
    conditions: tuple[Mapping[str, Any], ...]
    provenance: Mapping[str, Any]
    timing: Mapping[str, float]
    interrupted: bool
    folder: Path | None
    estimator_cpu_s: Mapping[str, Sequence[float]] = field(default_factory=dict)
    damaged: int = 0

    @property
    def sentences(self) -> tuple[str, ...]:
        """Return the results in sentences."""
        own = (text for outcome in self.outcomes for text in outcome.sentences)
        required = (one.sentence for one in self.requirements)
        return (*own, *(f"by horizontal RMSE, {one.sentence}" for one in self.comparisons), *required)

    @property
    def fewest(self) -> int:
        """Return the fewest runs behind an interval."""
        return min((one.converged_runs for one in self.outcomes), default=0)

    @property
    def uncertainty(self) -> dict[str, Any]:
        """Return the uncertainty statement of the figures."""
        seeds = dict.fromkeys(str(one["as_flown"].get("seed")) for one in self.conditions)
        several = f" in {len(self.conditions)} conditions" if len(self.conditions) > 1 else ""
        runs = f"{self.finished} of {self.planned} planned{several}"
        return state_uncertainty(runs, ", ".join(seeds), self.provenance)

    @property
    def requirements(self) -> tuple[Finding, ...]:
        """Return the verdicts on the requirements, for each condition and filter."""
        if not any("requirement" in condition["as_flown"] for condition in self.conditions):
            return ()
        every, found = self.runs.to_pylist(), list[Finding]()
        for k, condition in enumerate(self.conditions):
            own = [row for row in every if row["condition"] == k]
            varied = ", ".join(f"{name} = {value}" for name, value in condition["values"].items())
            for label in dict.fromkeys(row["estimator"] for row in own):
                rows = list_requirements(condition["as_flown"], label)
                runs = [row for row in own if row["estimator"] == label]
                shown = f"{varied}: {label}" if varied else label
                found += judge_runs(shown, runs, rows)
        return tuple(found)

    def __repr__(self) -> str:
        """Return the number of runs and the sentences."""
        return "\n".join([f"<Campaign: {self.finished} of {self.planned} runs>", *self.sentences])

    def _repr_html_(self) -> str:
        """Return the sentences, and a table of the values with their intervals."""
        names = dict.fromkeys(name for one in self.outcomes for name in one.errors)
        table = tabulate(self.outcomes, {name: name for name in names})
        caption = f"{self.finished} of {self.planned} runs{ensemble.qualify(self.fewest)}"
        return write_sentences(self.sentences) + write_table(caption, table.columns)

    def plot(self, quantity: str = "pos_err_n_m", **look: Any) -> Any:
        """Draw a quantity along the runs, a plot for each condition; `look` as for `plot_result`."""
        return draw(self, quantity, **look)

    def frame(self) -> Any:
        """Return the table of runs as a pandas.DataFrame, a row for each run and estimator."""
        return make_frame(self.runs.to_pydict())
