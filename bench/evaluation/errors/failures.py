"""Solution of a failed filter: all values NaN, with the reason as an event."""

from __future__ import annotations

import traceback
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import EventRow, Events, NavSolution, no_innovations
from bench.core.words.exceptions import (
    EstimatorError,
    EstimatorFailedError,
    EstimatorStoppedError,
    FilterTraceback,
)

FAILED, TRACEBACK = "failed", "traceback"
"""Kinds of events: there is no solution, for the reason in the text; where in the code it was raised."""


def make_failed_solution(t: FloatArray, why: str, events: Sequence[EventRow] = ()) -> NavSolution:
    """Return a solution that is NaN at the epochs t (M,) [s], with the reason as an event."""
    m = len(t)
    return NavSolution(
        t=t,
        lla=np.full((m, 3), np.nan),
        vel_n=np.full((m, 3), np.nan),
        q_nb=np.full((m, 4), np.nan),
        gyro_bias_b=np.full((m, 3), np.nan),
        accel_bias_b=np.full((m, 3), np.nan),
        cov=np.full((m, 9, 9), np.nan),
        extra_names=(),
        extra=np.empty((m, 0)),
        extra_sd=np.empty((m, 0)),
        innovations=no_innovations(),
        events=Events.from_rows([(0.0, 0.0, FAILED, why), *events]),
    )


def describe_error(label: str, error: EstimatorError | EstimatorFailedError) -> tuple[str, list[EventRow]]:
    """Return the reason why a filter failed, and an event with the traceback of its exception."""
    why = str(error).removeprefix(f"filter {label!r}: ")
    if isinstance(error, EstimatorError | EstimatorStoppedError):  # it cannot start here, or was ended
        return why, []
    cause = error.__cause__ or error
    said = isinstance(cause, FilterTraceback)
    text = str(cause) if said else "".join(traceback.format_exception(cause))
    return why, [(0.0, 0.0, TRACEBACK, text)]


def check_starts(raised: Mapping[str, EstimatorError | EstimatorFailedError], count: int) -> None:
    """Check the exceptions of the filters that failed, out of ``count`` filters.

    Raises
    ------
    EstimatorError
        If no filter can start: then what is wrong is the record, or the start asked for.
    """
    refused = [error for error in raised.values() if isinstance(error, EstimatorError)]
    if refused and len(refused) == count:
        raise EstimatorError(*(line for error in refused for line in error.messages))


def describe_failure(solution: NavSolution) -> dict[str, Any]:
    """Return the metrics of a failed filter; empty if it did not fail."""
    reasons = solution.events.select(FAILED)
    if not reasons:
        return {}
    found = {"converged": False, "reason": f"failed: {reasons[0][2]}", "failed": True}
    raised = solution.events.select(TRACEBACK)
    return found | ({"traceback": raised[0][2]} if raised else {})
