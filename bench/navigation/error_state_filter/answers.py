"""Results that a run stored at the requested epochs, as a solution."""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray, IntArray
from bench.core.records.data import Events, Innovations, NavSolution
from bench.navigation.error_state_filter.error_state import StateLayout


def spread(values: FloatArray, rows: IntArray, count: int) -> FloatArray:
    """Return an array of ``count`` rows: values (M, ...) in the given ``rows`` (M,), NaN elsewhere."""
    whole = np.full((count, *values.shape[1:]), np.nan)
    whole[rows] = values
    return whole


def solution(
    t: FloatArray, layout: StateLayout, state: FloatArray, P: FloatArray, table: Innovations, events: Events
) -> NavSolution:
    """Return states (M, n + 1) and covariances (M, n, n) at epochs t (M,) as a solution."""
    variance = np.einsum("kii->ki", P)[:, 9:]
    return answers(t, layout, state, P[:, :9, :9], variance, table, events, offset_rows(layout, P))


def find_offset(layout: StateLayout) -> int:
    """Return the index of the clock offset of the fixes, or -1."""
    return layout.slice("time_offset").start if layout.has("time_offset") else -1


def offset_rows(layout: StateLayout, P: FloatArray) -> FloatArray | None:
    """Return the covariances (M, 9) of the clock offset in P (M, n, n) with the first states."""
    at = find_offset(layout)
    return P[:, at, :9] if at >= 0 else None


def answers(
    t: FloatArray,
    layout: StateLayout,
    state: FloatArray,
    cov: FloatArray,
    variance: FloatArray,
    table: Innovations,
    events: Events,
    offset_cov: FloatArray | None = None,
) -> NavSolution:
    """Return a solution from covariances (M, 9, 9) and variances (M, shown - 9) of the other states.

    Values that follow on those of the first ``shown`` states are no part of an answer.
    """
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(variance)
    return NavSolution(
        t=t,
        lla=state[:, :3],
        vel_n=state[:, 3:6],
        q_nb=state[:, 6:10],
        gyro_bias_b=state[:, 10:13],
        accel_bias_b=state[:, 13:16],
        cov=cov,
        extra_names=layout.labels()[: variance.shape[1]],
        extra=state[:, 10 : 10 + variance.shape[1]],
        extra_sd=sd,
        innovations=table,
        events=events,
        offset_cov=offset_cov,
    )
