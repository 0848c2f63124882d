"""Adapters for filters of other libraries: fixes in order of arrival, and states as a solution."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.navigation.engine import timeline
from bench.navigation.engine.record_cuts import nothing_known


def fix_steps(
    sensors: SensorData, initial: InitialState
) -> Iterator[tuple[float, list[tuple[FloatArray, FloatArray]]]]:
    """Yield the steps of a filter that uses GNSS fixes alone: time step and new fixes for each output time.

    Rows that are invalid, not finite, repeated, out of order or without velocity are left out.

    Parameters
    ----------
    sensors : SensorData
        Sensor record.
    initial : InitialState
        Initial state with ``alignment`` "given".

    Yields
    ------
    dt : float
        Time since the output time before [s].
    fixes : list of (z, R)
        Fixes that arrived since, in the order of arrival: z (6, 1) is the position of the antenna relative to
        ``initial.lla`` [m] and its velocity [m/s], n; R (6, 6) is the reported covariance.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> steps = list(bench.fix_steps(sensed.data, sensed.initial))
    >>> len(steps) == len(sensed.data.output_t)
    True
    """
    now, fixes = initial.t, sensors.fixes
    new: dict[int, list[tuple[FloatArray, FloatArray]]] = {}
    if fixes is not None:
        rows, at, _ = timeline.fix_rows(fixes, sensors.output_t, initial.t)
        sound = np.isfinite(fixes.vel_n[rows]).all(axis=1)
        for cov in (fixes.cov_pos_n, fixes.cov_vel_n):
            sound &= np.isfinite(cov[rows]).all(axis=(1, 2))
        for row, k in zip(rows[sound], np.maximum(at[sound], 0).tolist(), strict=True):
            z, R = np.empty((6, 1)), np.zeros((6, 6))
            z[:3, 0], z[3:, 0] = earth.difference_n(fixes.lla[row], initial.lla), fixes.vel_n[row]
            R[:3, :3], R[3:, 3:] = fixes.cov_pos_n[row], fixes.cov_vel_n[row]
            new.setdefault(k, []).append((z, R))
    for k, instant in enumerate(sensors.output_t.tolist()):
        yield max(instant - now, 0.0), new.get(k, [])
        now = max(instant, now)


def track_solution(
    sensors: SensorData, initial: InitialState, states: Sequence[tuple[FloatArray, FloatArray]]
) -> NavSolution:
    """Make the solution of a filter that estimates position and velocity; attitude and biases are NaN.

    Parameters
    ----------
    sensors : SensorData
        Sensor record that the filter ran on.
    initial : InitialState
        Its initial state.
    states : sequence of (x, P)
        One for each output time: x, of 6 or more rows, begins with the position relative to ``initial.lla``
        [m] and the velocity [m/s], n; P is their covariance.

    Returns
    -------
    NavSolution
        Solution at ``sensors.output_t``.

    Examples
    --------
    >>> import bench, numpy as np
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> states = [(np.zeros(6), np.eye(6)) for _ in sensed.data.output_t]
    >>> bench.track_solution(sensed.data, sensed.initial, states).cov.shape[1:]
    (9, 9)
    """
    m = len(sensors.output_t)
    x, cov = np.full((m, 6), np.nan), np.full((m, 9, 9), np.nan)
    for k, (state, P) in enumerate(states):
        x[k], cov[k, :6, :6] = np.ravel(state)[:6], P[:6, :6]
    lla = earth.displace(initial.lla, x[:, :3])
    return replace(nothing_known(sensors.output_t), lla=lla, vel_n=x[:, 3:], cov=cov)
