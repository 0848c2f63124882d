"""Evaluation of a solution: errors, metrics and a verdict from the solution and the known motion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from bench.core.records.data import GnssFixes, NavSolution, SensorData, Trajectory
from bench.core.records.run_records import ErrorSeries, Reference
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.verdict import add_verdict
from bench.evaluation.errors.fixes import measure_by_fixes
from bench.evaluation.errors.reference_errors import measure_by_reference
from bench.evaluation.errors.used_fixes import measure_innovations
from bench.evaluation.metrics.coverage import Coverage, measure_coverage
from bench.evaluation.metrics.run_metrics import measure
from bench.evaluation.motion.rest_tilt import measure_rest_tilt
from bench.evaluation.requirements.required_metrics import list_requirements

Known = Trajectory | Reference | GnssFixes | None
"""What a solution is held against: the truth, another unit, withheld fixes, or its own innovations."""


@dataclass(frozen=True, slots=True)
class Judged:
    """A solution with its errors, its metrics and its verdict."""

    label: str
    errors: ErrorSeries
    metrics: dict[str, Any]  # with the verdict
    values: dict[str, Any]  # without it
    coverage: Coverage | None
    required: Sequence[Mapping[str, Any]]

    @classmethod
    def make(cls, label: str, errors: ErrorSeries, values: dict[str, Any], *rest: Any) -> Judged:
        """Return the verdict of metrics; ``rest`` is coverage and requirements, of `add_verdict`."""
        return cls(label, errors, add_verdict(label, values, *rest), values, *rest)

    def explain(self, found: Mapping[str, Any]) -> Judged:
        """Return the verdict with the causes that were found."""
        return self.make(self.label, self.errors, {**self.values, **found}, self.coverage, self.required)


def measure_solution(
    solution: NavSolution, known: Known, data: SensorData | None, evaluation: EvaluationWindow, **facts: Any
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors and metrics of a solution; ``facts`` are arguments of `run_metrics.measure`.

    Parameters
    ----------
    solution : NavSolution
        Of a filter, in any run, log or file.
    known : Trajectory, Reference, GnssFixes or None
        What it is held against; None: nothing that it has not used but its own innovations.
    data : SensorData or None
        What the filter got; None if that is not known, which only a truth allows.
    evaluation : EvaluationWindow
        What metrics ``x`` count; ``x_all`` are of the whole run.
    """
    if isinstance(known, Trajectory):
        return measure(known, solution, evaluation=evaluation, data=data, **facts)
    assert data is not None
    if known is None:
        alone = data.fixes is None
        errors, values = measure_innovations(solution, evaluation.begin, without_fixes=alone)
        return errors, values | (measure_rest_tilt(solution, data.imu, evaluation.begin) if alone else {})
    if isinstance(known, GnssFixes):
        return measure_by_fixes(solution, known, data, evaluation)
    return measure_by_reference(solution, known, data, evaluation)


def judge_solution(
    label: str,
    solution: NavSolution,
    known: Known,
    data: SensorData | None,
    evaluation: EvaluationWindow,
    document: Mapping[str, Any],
    more: Mapping[str, Any] | None = None,
    *,
    counts: bool = True,
    **facts: Any,
) -> Judged:
    """Evaluate a solution: the one way from a solution to a verdict, for runs, logs and scores.

    Parameters as for :func:`measure_solution`, and the filter's label, the ``document`` of the profile or
    log, which may require something, and ``more`` that stands among the metrics. ``counts`` is False where
    the epochs without an answer are those of a logger.
    """
    errors, values = measure_solution(solution, known, data, evaluation, **facts)
    coverage = measure_coverage(solution, data) if counts else None
    return Judged.make(
        label, errors, {**values, **(more or {})}, coverage, list_requirements(document, label)
    )
