"""What a run stored at the instants that were asked for, as a solution."""

from __future__ import annotations

import numpy as np

from bench.arrays import FloatArray, IntArray
from bench.data import Events, Innovations, NavSolution
from bench.navigation.error_state_filter.error_state import StateLayout


def spread(values: FloatArray, rows: IntArray, count: int) -> FloatArray:
    """Return an array of ``count`` rows, NaN but for the given ``rows`` (M,), those of values (M, ...)."""
    whole = np.full((count, *values.shape[1:]), np.nan)
    whole[rows] = values
    return whole


def solution(
    t: FloatArray, layout: StateLayout, state: FloatArray, P: FloatArray, table: Innovations, events: Events
) -> NavSolution:
    """Return states (M, n + 1) and covariances (M, n, n) at instants t (M,) as a solution."""
    variance = np.einsum("kii->ki", P)[:, 9:]
    return answers(t, layout, split(state), P[:, :9, :9], variance, table, events)


def split(state: FloatArray) -> list[FloatArray]:
    """Return position, velocity, attitude and the values of the further states from states (M, n + 1)."""
    return [state[:, :3], state[:, 3:6], state[:, 6:10], state[:, 10:]]


def answers(
    t: FloatArray,
    layout: StateLayout,
    state: list[FloatArray],
    cov: FloatArray,
    variance: FloatArray,
    table: Innovations,
    events: Events,
) -> NavSolution:
    """Return the same from states as :func:`split`, covariances (M, 9, 9) and variances (M, shown - 9).

    Values that follow on those of the first ``shown`` states are no part of an answer.
    """
    lla, vel_n, q_nb, values = state
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(variance)
    return NavSolution(
        t=t,
        lla=lla,
        vel_n=vel_n,
        q_nb=q_nb,
        gyro_bias_b=values[:, :3],
        accel_bias_b=values[:, 3:6],
        cov=cov,
        extra_names=layout.labels()[: variance.shape[1]],
        extra=values[:, : variance.shape[1]],
        extra_sd=sd,
        innovations=table,
        events=events,
    )
