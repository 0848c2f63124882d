"""Errors of a solution against a reference: the same motion measured by another system.

Solution and reference have different times: the record with more rows is interpolated at the epochs of the
other, never across a gap.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.records.data import NavSolution, SensorData
from bench.core.records.run_records import ErrorSeries, Reference
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors.error_series import select_epochs
from bench.evaluation.errors.failures import describe_failure
from bench.evaluation.errors.fixes import point_errors
from bench.evaluation.errors.resampling import ForeignSolution, resample
from bench.evaluation.metrics.run_metrics import judge_epochs


def measure_by_reference(
    solution: NavSolution, reference: Reference, data: SensorData, evaluation: EvaluationWindow
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution against a reference, and the metrics of the reference quantities.

    Estimate and reference are compared at the point of the reference. The
    covariance is the sum of ``cov`` of the estimate and ``cov`` of the reference.
    """
    errors, moved = compare(solution, reference, data)
    values: dict[str, Any] = {"converged": True, "reason": None, **describe_failure(solution)}
    if len(errors):
        values = judge_epochs(errors, moved, evaluation)
    return errors, {**values, "reference_epochs": len(errors)}


def compare(solution: NavSolution, reference: Reference, data: SensorData) -> tuple[ErrorSeries, NavSolution]:
    """Return errors and estimate at common epochs, the estimate with the sum of both covariances."""
    estimate, track = _meet(solution, reference.track)
    return point_errors(estimate, track, reference.point_b, data.imu)


def _meet(solution: NavSolution, track: NavSolution) -> tuple[NavSolution, NavSolution]:
    """Return estimate and reference at common epochs."""
    known = np.asarray(np.isfinite(solution.lla).all(axis=1))
    if not known.any():  # a filter of attitude alone
        known = np.asarray(np.isfinite(solution.q_nb).all(axis=1))
    if np.median(np.diff(track.t)) < np.median(np.diff(solution.t)) or not known.any():
        own = resample(take_as_read(track, "reference"), solution.t)
        rows = np.asarray(np.isfinite(own.lla).all(axis=1))
        return select_epochs(solution, rows), select_epochs(own, rows)
    inside = (track.t >= solution.t[0]) & (track.t <= solution.t[-1])
    track = select_epochs(track, inside)
    estimate = resample(take_as_read(select_epochs(solution, known), "the solution"), track.t)
    return replace(estimate, innovations=solution.innovations, events=solution.events), track


def take_as_read(solution: NavSolution, shown: str) -> ForeignSolution:
    """Return a solution in the form that can be interpolated."""
    return ForeignSolution(
        shown=shown,
        rows=np.arange(1, len(solution) + 1),
        t=solution.t,
        lla=solution.lla,
        vel_n=solution.vel_n,
        q_nb=solution.q_nb,
        gyro_bias_b=solution.gyro_bias_b,
        accel_bias_b=solution.accel_bias_b,
        cov=solution.cov,
        remarks=(),
    )
