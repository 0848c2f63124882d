"""The finished runs of a campaign by condition and estimator."""

from __future__ import annotations

import itertools
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.specs import EvaluationWindow
from bench.experiments.campaigns.binned import BinnedRuns
from bench.experiments.campaigns.journal import Journal
from bench.experiments.campaigns.plan import Cell, Condition, Plan, PlannedRun
from bench.experiments.campaigns.worker import CHANNELS, MOST_INSTANTS, decode, shorten_numbers

MOST_EXACT = 2000
"""Largest number of runs of a condition that keep `MOST_INSTANTS` epochs each; with more runs, each keeps
`FEW_INSTANTS`."""

MOST_KEPT = MOST_EXACT * MOST_INSTANTS
"""Epochs of all runs of a group that are kept in memory; beyond, percentiles come from fixed bins."""

PERCENTILES = (5, 50, 95)
"""Percentiles over the runs, at each time."""

_WORDS = "converged", "reason"
_SOME = 8  # runs that show the epochs of a group
_POOLED = (
    "pos_rmse",
    "vel_rmse",
    "tilt_rmse",
    "heading_rmse",
    "nees_ratio",
    "nees_inside",
    "nis_mean",
    "updates_",
)
"""Prefixes of the metrics that enter the statistics of a group."""

Done = Iterable[tuple[PlannedRun, Mapping[str, Any]]]
"""Finished runs with their rows of the journal."""


class PooledMetrics(Mapping[str, Any]):
    """The metrics of a run that enter the statistics, in half a kB, for campaigns of very many runs."""

    __slots__ = ("_names", "_values", "_words")

    def __init__(self, metrics: Mapping[str, Any]) -> None:
        names = tuple(name for name in metrics if name.startswith(_POOLED))
        self._names = _number_names(names)
        self._values = np.array([metrics[name] for name in names], np.float64)
        self._words = metrics["converged"], metrics.get("reason")

    def __getitem__(self, name: str) -> Any:
        if name in _WORDS:
            return self._words[_WORDS.index(name)]
        value = float(self._values[self._names[name]])
        return None if np.isnan(value) else value

    def __len__(self) -> int:
        return len(_WORDS) + len(self._names)

    def __iter__(self) -> Iterator[str]:
        yield from (*_WORDS, *self._names)


@cache
def _number_names(names: tuple[str, ...]) -> dict[str, int]:
    return {name: k for k, name in enumerate(names)}


@dataclass(frozen=True)
class Group:
    """The finished runs of one condition and one estimator."""

    number: int  # of the condition
    condition: Condition
    label: str
    seeds: tuple[int, ...]  # of its flights
    evaluation: EvaluationWindow
    metrics: tuple[Mapping[str, Any], ...]  # of each run
    states: int  # number of states in NEES
    nis_dof: tuple[Mapping[str, int], ...]  # degrees of freedom of the updates of each run, by sensor
    t: FloatArray  # (M,) epochs [s]
    mean: FloatArray  # (M, C) over the runs that converged
    percentiles: FloatArray  # (P, M, C) over them
    kept_t: FloatArray  # (K,) epochs whose values are kept for each run [s]
    kept: FloatArray  # (R, K, C) single precision

    @property
    def converged(self) -> BoolArray:
        """Mask (R,) of the runs that converged."""
        return np.array([one["converged"] for one in self.metrics], np.bool_)

    def channel(self, name: str, begin: float) -> FloatArray:
        """Return a channel (G, K) of the G converged runs from a time on, where all have values."""
        column = self.kept[self.converged][:, :, list(CHANNELS).index(name)]
        column = np.asarray(column[:, self.kept_t >= begin], np.float64)
        late = np.isfinite(column).all(axis=0)
        return column[:, late]


def gather(plan: Plan, journal: Journal) -> Iterator[Group]:
    """Yield the groups in the order of the plan; only the groups of one condition are in memory."""
    for number, runs in itertools.groupby(plan.runs, lambda one: plan.cells[one.cell].condition):
        keys = [key for one in runs if (key := plan.run_key(one)) in journal]
        cells = [cell for cell in plan.cells if cell.condition == number]
        yield from gather_condition(plan, number, cells, keys, journal)


def gather_condition(
    plan: Plan, number: int, cells: Sequence[Cell], keys: Sequence[str], journal: Journal
) -> Iterator[Group]:
    """Yield the runs of each filter under one condition, thinned if they are very many."""
    labels = cells[0].profile.labels
    step, size = _find_grid(keys, journal)
    stride = max(1, -(-len(keys) * size // MOST_KEPT))
    binned = {label: BinnedRuns(MOST_INSTANTS, len(CHANNELS)) for label in labels if stride > 1}
    rows = {label: list[tuple[Mapping[str, Any], int, Mapping[str, int]]]() for label in labels}
    shared: dict[tuple[tuple[str, int], ...], Mapping[str, int]] = {}
    kept = {label: list[FloatArray]() for label in labels}
    for key in keys:
        whole = journal[key]
        for label, row in whole.get("estimators", {}).items():
            instants = _place(decode(row["instants"]), whole["step"], step)
            kept[label].append(instants[stride - 1 :: stride])
            metrics = row["metrics"] if len(keys) <= MOST_EXACT else PooledMetrics(row["metrics"])
            dof = shared.setdefault(tuple(row["nis_dof"].items()), row["nis_dof"])
            rows[label].append((metrics, row["states"], dof))
            if stride > 1 and row["metrics"]["converged"]:
                binned[label].add(instants)
    for label in labels if rows[labels[0]] else ():
        every, states, dofs = zip(*rows[label], strict=True)
        values = _stack(kept[label])
        if stride == 1:
            mean, percentiles = describe(values, np.array([one["converged"] for one in every], np.bool_))
        else:
            mean = binned[label].mean()
            percentiles = np.stack([binned[label].percentile(p) for p in PERCENTILES])
        yield Group(
            number=number,
            condition=plan.conditions[number],
            label=label,
            seeds=tuple(cell.profile.seed for cell in cells),
            evaluation=cells[0].profile.evaluation,
            metrics=every,
            states=max(states),
            nis_dof=dofs,
            t=np.asarray(step * np.arange(1, len(mean) + 1)),
            mean=mean,
            percentiles=percentiles,
            kept_t=step * stride * np.arange(1, values.shape[1] + 1),
            kept=values,
        )


def _find_grid(keys: Sequence[str], journal: Journal) -> tuple[float, int]:
    """Return the interval of the epochs of a group [s], and their number, from a few of its runs."""
    some = [journal[key] for key in keys[:: max(1, len(keys) // _SOME)]]
    steps = [row["step"] for row in some if "estimators" in row]
    sizes = [
        len(_place(decode(one["instants"]), row["step"], max(steps)))
        for row in some
        for one in row.get("estimators", {}).values()
    ]
    return max(steps, default=1.0), max(sizes, default=0)


def _place(instants: FloatArray, own: float, step: float) -> Any:
    """Return the values (M, C) of a run at the epochs of its group: fewer, or NaN between its own."""
    if own < step and (every := round(step / own)) > 1:
        return shorten_numbers(instants[every - 1 :: every])
    if own > step and (every := round(own / step)) > 1:
        spread = np.full((every * len(instants), instants.shape[1]), np.nan, np.float32)
        spread[every - 1 :: every] = instants
        return spread[:MOST_INSTANTS]
    return instants


def _stack(runs: Sequence[FloatArray]) -> Any:
    """Return the runs (M, C) as one array (R, M, C), with NaN after the end of shorter flights."""
    stacked = np.full((len(runs), max(map(len, runs)), len(CHANNELS)), np.nan, np.float32)
    for k, values in enumerate(runs):
        stacked[k, : len(values)] = values
    return stacked


def describe(values: FloatArray, converged: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Return mean (M, C) and `PERCENTILES` (P, M, C) over the runs (R, M, C) that converged."""
    if not converged.any():
        unknown = np.full(values.shape[1:], np.nan)
        return unknown, np.stack([unknown] * len(PERCENTILES))
    good = values[converged].astype(np.float64)
    with warnings.catch_warnings():  # no run has a value there: NaN
        warnings.simplefilter("ignore", RuntimeWarning)
        return np.nanmean(good, axis=0), find_percentiles(good)


def find_percentiles(values: FloatArray) -> FloatArray:
    """Return `PERCENTILES` (P, M, C) over runs (R, M, C); fast if all runs have a value."""
    unknown = np.isnan(values).sum(axis=0)
    found = np.full((len(PERCENTILES), *values.shape[1:]), np.nan)
    for columns, percentile in (
        (unknown == 0, np.percentile),
        ((unknown > 0) & (unknown < len(values)), np.nanpercentile),
    ):
        if columns.any():
            found[:, columns] = percentile(values[:, columns], PERCENTILES, axis=0)
    return found
