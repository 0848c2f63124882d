"""Measured runs of a baseline: the runs of a profile, or the segments of a recording."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from bench import pipeline
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.run_records import ErrorSeries
from bench.core.records.run_result import RunResult
from bench.core.records.specs import DEFAULT_GUARD, EstimatorChoice, Guard
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.chi_square import nis_by_sensor
from bench.evaluation.metrics.run_metrics import find_metric
from bench.experiments.baselines.baseline_file import CPU, UNKNOWN, Baseline, EstimatorValues, Value, get_name
from bench.experiments.baselines.digests import digest_record
from bench.experiments.campaigns.worker import describe_error, get_truth
from bench.io import results
from bench.io.config import read_profile
from bench.io.config.toml_file import read_toml
from bench.pipeline import build_estimator, log_pipeline

STRETCHES = 20
"""A recording has one run of noise; it is cut into this many segments, each of which counts as one."""


@dataclass(frozen=True, slots=True)
class EstimatorDraw:
    """Metrics of a filter in one run."""

    converged: bool
    reason: str  # why it did not converge
    metrics: Mapping[str, Value]
    expected: Mapping[str, float]
    epochs: int


@dataclass(frozen=True, slots=True)
class Draw:
    """One run: the digest of its sensor data, and the metrics of each filter."""

    sensors: str
    estimators: Mapping[str, EstimatorDraw]


class Experiment(Protocol):
    """A profile or a log that can be measured run by run."""

    source: str
    name: str
    seed: int

    @property
    def labels(self) -> Sequence[str]:
        """The estimators."""

    @property
    def draws(self) -> int | None:
        """Number of available runs, all from one computation; None: unlimited."""

    @property
    def truth_digest(self) -> str:
        """Digest of the truth; empty without a truth."""

    def prepare(self) -> None:
        """Prepare the data that all runs share."""

    def measure(self, draw: int) -> Draw:
        """Return the metrics of the filters in a run; an error counts as a failure of all filters."""


def lose_draw(experiment: Experiment, reason: str) -> Draw:
    """Return a run in which no filter has a result."""
    lost = EstimatorDraw(converged=False, reason=reason, metrics={}, expected={}, epochs=0)
    return Draw(UNKNOWN, dict.fromkeys(experiment.labels, lost))


def open_experiment(
    source: str,
    requested: Sequence[str] | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
    overrides: Mapping[str, Any] | None = None,
    cpu: bool = False,
) -> Experiment:
    """Read a profile or a log and check it; nothing is flown yet.

    ``overrides`` are those of `bench.read_profile`; ``cpu`` adds the metric `CPU`.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError
        If it is missing or wrong.
    """
    if source.endswith(".toml") and "imu" in read_toml(Path(source), source):
        if cpu:
            raise ConfigError(
                f"{source}: a log is run once, which does not measure CPU time; leave --cpu out"
            )
        return Recording(source, requested, allow_code, guard, overrides)
    return FlightDraws(source, requested, allow_code, guard, overrides, cpu=cpu)


class FlightDraws:
    """The runs of a simulated profile, on one truth."""

    draws = None

    def __init__(
        self,
        source: str,
        requested: Sequence[str] | None,
        allow_code: bool,
        guard: Guard,
        overrides: Mapping[str, Any] | None = None,
        *,
        cpu: bool = False,
    ) -> None:
        self.source, self.name, self._cpu = source, get_name(source), cpu
        self.profile = read_profile(
            source, overrides, estimators=requested, allow_code=allow_code, guard=guard
        )
        self.seed = self.profile.seed
        self.truth_digest = ""
        pipeline.build_estimators(self.profile)
        self.labels = [choice.label for choice in self.profile.estimators]
        self._truth_key = pipeline.find_truth_key(self.profile)

    def prepare(self) -> None:
        """Fly the truth into the cache, from which the workers read it."""
        if not self.truth_digest:
            truth = pipeline.fly(self.profile)
            if self.profile.guidance is None:
                pipeline.check_times(self.profile, float(truth.t[-1]))
            self.truth_digest = digest_record(truth)

    def measure(self, draw: int) -> Draw:
        """Sense, navigate and evaluate one run."""
        try:
            closed = self.profile.guidance is not None  # then each run flies its own
            truth = None if closed else get_truth(self._truth_key, self.profile)
            result = pipeline.run(self.profile, run=draw, truth=truth)
        except Exception as error:
            return lose_draw(self, describe_error(error))
        sensed = result.records["sensed"]
        digest = digest_record([sensed.data, sensed.initial])
        rows = {label: collect_draw(result, label) for label in result.metrics}
        if self._cpu:
            ratios = measure_cpu(result)
            rows = {k: replace(row, metrics={**row.metrics, CPU: ratios[k]}) for k, row in rows.items()}
        return Draw(digest, rows)


_UNIT = "free-inertial"
_warm = set[str]()  # what filters of this process have run already


def measure_cpu(result: RunResult) -> dict[str, Value]:
    """Return the CPU time of each filter over the CPU time of `free-inertial` on the same record [1].

    The strapdown alone is a unit shared by fast and slow machines, long and short flights; the least of three
    times counts. None for a filter that failed, or that was just loaded and perhaps compiled.
    """
    sensed = result.records["sensed"]
    unit, spent = build_estimator(EstimatorChoice(_UNIT, _UNIT)), list[float]()
    for _ in range(4):  # the first one loads
        begun = time.process_time()
        unit.run(sensed.data, sensed.initial)
        spent.append(time.process_time() - begun)
    found: dict[str, Value] = {}
    for label, used in result.provenance["estimator_cpu_s"].items():
        key = repr((result.profile["estimator"], label))
        good = key in _warm and not result.metrics[label].get("failed")
        found[label] = used / max(min(spent[1:]), 1e-9) if good else None
        _warm.add(key)
    return found


def collect_draw(result: RunResult, label: str) -> EstimatorDraw:
    """Return the metrics that baselines contain, after the alignment window; empty if the filter failed."""
    values, errors, first = result.metrics[label], result.errors[label], result.evaluation.first
    metrics = {name: x for name, x in values.items() if is_watched(name) and not values.get("failed")}
    expected = {"nees_mean": float(errors.states)}
    for sensor, nis in nis_by_sensor(result.solutions[label].innovations, first).items():
        expected[f"nis_mean_{sensor}"] = float(nis.dof.mean())
    expected |= {name: 1.0 for name in metrics if name.startswith("nees_bias_")}
    return EstimatorDraw(
        converged=bool(values["converged"]),
        reason=values["reason"] or "",
        metrics=metrics,
        expected={name: value for name, value in expected.items() if name in metrics},
        epochs=int(np.sum(errors.t >= first)),
    )


def is_watched(name: str) -> bool:
    """Return whether a metric is compared: it can be better or worse."""
    row = None if name.endswith("_all") else find_metric(name)
    return row is not None and row.direction != "not evaluated"


class Recording:
    """The segments of a log, evaluated by its withheld fixes."""

    draws = STRETCHES
    seed = 0
    truth_digest = ""

    def __init__(
        self,
        source: str,
        requested: Sequence[str] | None,
        allow_code: bool,
        guard: Guard,
        overrides: Mapping[str, Any] | None = None,
    ) -> None:
        self.source, self.name = source, get_name(source)
        self.log = log_pipeline.read_log(
            source, overrides=overrides, estimators=requested, allow_code=allow_code, guard=guard
        )
        self.labels = list(self.log.estimators)

    @cached_property
    def result(self) -> RunResult:
        """Return the solutions, made at the first access."""
        return log_pipeline.navigate(self.log)

    def prepare(self) -> None:
        """Do nothing: the first segment makes the solutions."""

    def measure(self, draw: int) -> Draw:
        """Return RMSE and mean NEES over one segment of the evaluated time."""
        result, start = self.result, self.log.spec.evaluation.begin
        end = float(self.log.records.imu.t.max())
        rows = {label: collect_stretch(result, label, draw, start, end) for label in result.errors}
        return Draw(digest_record([result.sensors]), rows)


def collect_stretch(result: RunResult, label: str, draw: int, start: float, end: float) -> EstimatorDraw:
    """Return RMSE and mean NEES in segment ``draw`` of the `STRETCHES` of a log between start and end [s]."""
    errors, values = result.errors[label], result.metrics[label]
    edges = start + (end - start) / STRETCHES * np.arange(draw, draw + 2)
    inside = (errors.t >= edges[0] - SAME_INSTANT) & (errors.t < edges[1] - SAME_INSTANT)
    return EstimatorDraw(
        converged=bool(values["converged"]),
        reason=values["reason"] or "",
        metrics=_judge_stretch(errors, inside),
        expected={"nees_mean": float(errors.states)},
        epochs=int(inside.sum()),
    )


def _judge_stretch(errors: ErrorSeries, inside: Any) -> dict[str, Value]:
    squares = {
        "pos_rmse_h_m": np.square(errors.pos_n[inside, :2]).sum(axis=1),
        "pos_rmse_d_m": np.square(errors.pos_n[inside, 2]),
        "vel_rmse_3d_mps": np.square(errors.vel_n[inside]).sum(axis=1),
    }
    values = {name: float(np.sqrt(x.mean())) if len(x) else None for name, x in squares.items()}
    values["nees_mean"] = float(errors.nees[inside].mean()) if inside.any() else None
    return {name: x if x is not None and np.isfinite(x) else None for name, x in values.items()}


def make_baseline(
    experiment: Experiment,
    draws: Sequence[Draw],
    requested: Sequence[str] | None,
    overrides: Mapping[str, Any] | None = None,
) -> Baseline:
    """Return the baseline of the measured runs."""
    return Baseline(
        profile=experiment.source,
        requested=None if requested is None else tuple(requested),
        seed=experiment.seed,
        overrides=dict(overrides or {}),
        versions=dict(results.list_versions()),
        truth=experiment.truth_digest,
        sensors=tuple(draw.sensors for draw in draws),
        estimators={
            label: join_draws([draw.estimators[label] for draw in draws]) for label in draws[0].estimators
        },
    )


def join_draws(rows: Sequence[EstimatorDraw]) -> EstimatorValues:
    """Return the values of a filter by metric, from the values by run."""
    names = dict.fromkeys(name for row in rows for name in row.metrics)
    expected: dict[str, list[float]] = {}
    for row in rows:
        for name, value in row.expected.items():
            expected.setdefault(name, []).append(value)
    return EstimatorValues(
        epochs=max(row.epochs for row in rows),
        expected={name: float(np.mean(values)) for name, values in expected.items()},
        converged=tuple(row.converged for row in rows),
        metrics={name: tuple(row.metrics.get(name) for row in rows) for name in names},
        reasons=tuple(row.reason for row in rows),
    )
