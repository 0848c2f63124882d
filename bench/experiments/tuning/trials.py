"""Data for tuning a filter: runs of a profile, or a recorded log."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np

from bench import pipeline
from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.run_result import RunResult
from bench.core.records.specs import Guard, Profile
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.log_score import score_claims, score_innovations
from bench.evaluation.ensembles import ensemble
from bench.evaluation.ensembles.ensemble import Estimate
from bench.evaluation.errors.error_series import error_series, find_covered_epochs, select_epochs
from bench.experiments.campaigns.batches import Lost, Pool, compute
from bench.experiments.campaigns.heap import keep_freed_memory
from bench.experiments.campaigns.worker import RunTask, choose_step, describe_error, get_truth, measure
from bench.io.config import read_profile
from bench.io.config.datasheets import MODIFIED, SENSORS
from bench.io.config.library import find_profile
from bench.io.results import truth_key
from bench.pipeline import log_pipeline

Goal = Literal["consistency", "rmse"]
Figures = Mapping[str, float]
"""Key of --set -> value of a figure that the filter assumes."""

_STRETCHES = 10  # of each half of a log: each counts as a run
_LEAST = 2
_LOST = 1e6  # cost of a run without finite errors or covariances


@dataclass(frozen=True)
class HeldOutScore:
    """Errors and NEES of a filter on data that were not used for tuning, with 95 % intervals."""

    rmse_h_m: Estimate
    nees_ratio: Estimate  # mean NEES over its expectation; 1 is right
    repetition: Mapping[str, tuple[float, float]]  # of innovations, as `measure_repetition` returns it
    lost: int = 0  # runs that did not converge, which are in no figure
    runs: int = 0  # behind the intervals


class Trial(Protocol):
    """Data for tuning a filter, and other data for its evaluation."""

    label: str  # of the filter
    assumed: dict[str, str]  # kind of sensor -> name of the datasheet that the filter assumes
    beside: Path  # where a datasheet is searched

    def score(self, figures: Figures, goal: Goal) -> FloatArray:
        """Return the cost of each run (D,) with these figures, on the data for tuning; finite."""

    def judge(self, figures: Figures) -> HeldOutScore:
        """Return the score of the filter with these values on the other data."""


class ProfileTrial:
    """Runs of a profile: 0 to ``runs`` - 1 for tuning, and the same number after them for the evaluation.

    ``options`` are those of `bench.io.config.read_profile` but for the estimators.
    """

    def __init__(
        self, source: str, estimator: str, runs: int, pool: Pool, options: Mapping[str, Any]
    ) -> None:
        self._source, self._estimator, self._runs, self._pool = source, estimator, runs, pool
        self._options = options
        profile = self._load({})
        pipeline.build_estimators(profile)
        self._end = float(pipeline.fly(profile).t[-1])
        pipeline.check_times(profile, self._end)
        self._truth_key = truth_key(profile.flight)
        self.label = profile.estimators[0].label
        self.beside = find_profile(source)[0].parent
        self.assumed = list_assumed(profile.document)

    def _load(self, figures: Figures) -> Profile:
        given = {**(self._options.get("overrides") or {}), **figures}
        return read_profile(
            self._source, **{**self._options, "overrides": given}, estimators=[self._estimator]
        )

    def _compute(
        self, function: Callable[[RunTask], Mapping[str, Any]], figures: Figures, draws: Sequence[int]
    ) -> list[Mapping[str, Any]]:
        """Return the result of a worker function for each run."""
        profile = self._load(figures)
        step = choose_step(self._end, profile.sensors.output_rate)
        tasks = [RunTask(str(run), self._truth_key, profile, run, step) for run in draws]
        rows = dict(compute(function, tasks, self._pool))
        found: list[Mapping[str, Any]] = []
        for k in range(len(tasks)):
            row = rows[k]
            wrong = row.reason if isinstance(row, Lost) else row.get("error")
            if isinstance(row, Lost) or wrong:
                raise ConfigError(f"{self._source}: run {draws[k]} has no result: {wrong}")
            found.append(row)
        return found

    def score(self, figures: Figures, goal: Goal) -> FloatArray:
        """Return the cost of the filter in each of the first runs."""
        rows = self._compute(measure_costs, figures, range(self._runs))
        return np.array([limit_cost(row[goal]) for row in rows])

    def judge(self, figures: Figures) -> HeldOutScore:
        """Return the score of the filter with these values in the other runs."""
        others = self._compute(measure, figures, range(self._runs, 2 * self._runs))
        rows = [row["estimators"][self.label] for row in others]
        good = [row for row in rows if row["metrics"]["converged"]]
        sums = [{name: np.array(one) for name, one in row["repetition"].items()} for row in good]
        return replace(_judge(*_draw_values(good), sums), lost=len(rows) - len(good))


class LogTrial:
    """A log: its first half for tuning, the withheld fixes of its second half for the evaluation."""

    def __init__(
        self, source: str, estimator: str, overrides: Mapping[str, Any], *, allow_code: bool, guard: Guard
    ) -> None:
        self._source, self._overrides = source, overrides
        self._code: dict[str, Any] = {"allow_code": allow_code, "guard": guard}
        self._estimator = estimator
        result = self._navigate({})
        [self.label] = result.metrics
        self.beside = Path(source).parent
        self.assumed = list_assumed(result.profile)

    def _navigate(self, figures: Figures) -> RunResult:
        log = log_pipeline.read_log(
            self._source,
            estimators=[self._estimator],
            overrides={**self._overrides, **figures},
            **self._code,
        )
        self._from = log.spec.evaluation.begin
        return log_pipeline.navigate(log)

    def _split(self, t: FloatArray) -> FloatArray:
        """Return the edges of the segments of the evaluated time."""
        return np.linspace(self._from, float(t.max()) + SAME_INSTANT, 2 * _STRETCHES + 1)

    def score(self, figures: Figures, goal: Goal) -> FloatArray:
        """Return the cost of the filter in each segment of the first half."""
        result = self._navigate(figures)
        errors, innovations = result.errors[self.label], result.solutions[self.label].innovations
        edges = self._split(errors.t)[: _STRETCHES + 1]
        if goal == "rmse":
            t, values = errors.t, np.square(errors.pos_n[:, :2]).sum(axis=1)
        else:
            t, values = innovations.t, score_innovations(innovations)
            if not len(t):
                raise ConfigError(f"{self.label} reports no innovations: --goal rmse tunes without them")
        inside = (t >= edges[0]) & (t < edges[-1])
        sums, _ = np.histogram(t[inside], edges, weights=values[inside])
        return np.array([limit_cost(value * _STRETCHES / max(inside.sum(), 1)) for value in sums])

    def judge(self, figures: Figures) -> HeldOutScore:
        """Return the score of the filter with these values in the second half."""
        result = self._navigate(figures)
        t = result.errors[self.label].t
        edges = self._split(t)[_STRETCHES:]
        inside = [(t >= a) & (t < b) for a, b in pairwise(edges)]
        values = _stretch_values(result, self.label, [rows for rows in inside if rows.any()])
        innovations = result.solutions[self.label].innovations
        return _judge(*values, [ensemble.sum_repetition(innovations, edges[0], edges[-1])])


def measure_costs(task: RunTask) -> dict[str, Any]:
    """Return the cost of the filter in a run by goal, or an ``error``; runs in a worker."""
    keep_freed_memory()
    profile = task.profile
    try:
        truth = get_truth(task.truth_key, profile)
        sensed = pipeline.sense(profile, truth, task.run)
        solution = pipeline.navigate(profile.estimators[0], sensed.data, sensed.initial)
        disk_arrays.release()
        rows = find_covered_epochs(solution) & (solution.t >= profile.evaluation.first)
        solution = select_epochs(solution, rows)
        errors = error_series(truth, solution)
        if not errors.states:
            return {
                "error": f"{profile.estimators[0].label} reports no accuracy, so there is nothing to tune"
            }
        with np.errstate(over="ignore"):
            square = float(np.square(errors.pos_n[:, :2]).sum(axis=1).mean())
        return {"consistency": float(score_claims(errors, solution).mean()), "rmse": square}
    except Exception as error:
        return {"error": describe_error(error)}


def limit_cost(value: float) -> float:
    """Return a finite cost for the search; a diverged run gets the largest."""
    return min(float(value), _LOST) if math.isfinite(value) else _LOST


def list_assumed(document: Mapping[str, Any]) -> dict[str, str]:
    """Return the names of the datasheets that a profile or a log assumes."""
    names = {kind: name for kind, name in document["sensors"]["assumed"].items() if kind in SENSORS}
    for kind, name in names.items():
        if name.endswith(MODIFIED):
            raise ConfigError(
                f"tuning starts from datasheets in files, not from --set of figures of {kind}: write them "
                f"into a file and give it with --set sensors.assumed.{kind}"
            )
    return names


def _draw_values(rows: Sequence[Mapping[str, Any]]) -> tuple[FloatArray, FloatArray]:
    """Return the horizontal mean squares and the ratios of NEES of runs."""
    metrics = [row["metrics"] for row in rows]
    mean_squares = np.array([one["pos_rmse_h_m"] for one in metrics], float) ** 2
    return mean_squares, np.array([one["nees_mean"] / one["nees_states"] for one in metrics], float)


def _stretch_values(
    result: RunResult, label: str, inside: Sequence[BoolArray]
) -> tuple[FloatArray, FloatArray]:
    """Return the horizontal mean squares and the ratios of NEES of segments of a log."""
    errors = result.errors[label]
    squares = np.square(errors.pos_n[:, :2]).sum(axis=1)
    mean_squares = np.array([squares[rows].mean() for rows in inside])
    return mean_squares, np.array([errors.nees[rows].mean() for rows in inside]) / errors.states


def _judge(
    mean_squares: FloatArray, nees: FloatArray, repetition: Sequence[Mapping[str, FloatArray]]
) -> HeldOutScore:
    """Return pooled values with intervals; the mean NEES is positive, so its interval is from its root."""
    if len(nees) < _LEAST:
        raise ConfigError("too few runs converged to evaluate the tuned filter")
    root = ensemble.pool_rmse(nees)
    ratio = Estimate(root.value**2, root.low**2, root.high**2)
    rmse, repeated = ensemble.pool_rmse(mean_squares), ensemble.measure_repetition(repetition)
    return HeldOutScore(rmse, ratio, repeated, runs=len(nees))
