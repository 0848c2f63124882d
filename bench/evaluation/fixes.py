"""Errors of a solution against withheld GNSS fixes, for recordings without a truth.

A fix is a measurement of the antenna. Estimate minus fix contains the errors of both: its root mean square
is an upper bound for the error of the estimate, and its covariance is the sum of both covariances.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from bench import earth, rotation
from bench.arrays import BoolArray, FloatArray, IntArray
from bench.data import ErrorSeries, GnssFixes, ImuData, NavSolution, SensorData
from bench.evaluation.error_series import normalized_squares, select_epochs
from bench.evaluation.failures import describe_failure
from bench.evaluation.metrics import METRICS, judge_epochs
from bench.units import SAME_INSTANT

_OF_TRUTH = ("outage", "coverage", "error_over", "ape", "rpe", "drift")
"""How the names of metrics begin that the errors of the fixes themselves would spoil."""


def antenna_errors(solution: NavSolution, fixes: GnssFixes, data: SensorData) -> ErrorSeries:
    """Return estimate minus fix at the antenna, for every fix at an instant of the solution.

    Parameters
    ----------
    solution : NavSolution
        The motion of the IMU.
    fixes : GnssFixes
        The reference, in order of time. The velocity error is NaN where a fix has no velocity.
    data : SensorData
        For the lever arm, and the angular rate that moves the antenna.

    Returns
    -------
    errors : ErrorSeries
        ``phi_n`` and ``heading`` are NaN. ``nees`` uses the sum of the covariances of estimate and fix. It
        counts position and velocity, or position alone if any fix has no velocity.
    """
    k, m = _match_instants(solution.t, fixes.t)
    with np.errstate(all="ignore"):  # a diverged solution is a result, not a warning
        C_nb = rotation.matrix(solution.q_nb[k])
        arm_n = C_nb @ data.antenna_b
        # an estimator without attitude gives the position of the antenna: no lever arm
        has_attitude: BoolArray = np.asarray(~np.isnan(solution.q_nb[k]).all(axis=1))
        arm_n = np.where(has_attitude[:, None], arm_n, 0.0)
        w_b = find_angular_rate(data.imu, solution.t[k]) - solution.gyro_bias_b[k]
        swing_n = np.einsum("kij,kj->ki", C_nb, np.cross(w_b, data.antenna_b))
        swing_n = np.where(has_attitude[:, None], swing_n, 0.0)
        pos_n = earth.difference_n(earth.displace(solution.lla[k], arm_n), fixes.lla[m])
        vel_n = solution.vel_n[k] + swing_n - fixes.vel_n[m]
        # antenna position error: dp - [arm x] phi; the effect of phi on the velocity is neglected
        T = np.tile(np.eye(6, 9), (len(k), 1, 1))
        T[:, :3, 6:] = -rotation.skew(arm_n)
        cov = np.where(has_attitude[:, None, None], solution.cov[k], 0.0)
        cov[:, :6, :6] = solution.cov[k, :6, :6]
        P = T @ cov @ T.transpose(0, 2, 1)
        P[:, :3, :3] += fixes.cov_pos_n[m]
        P[:, 3:, 3:] += fixes.cov_vel_n[m]
        states = 6 if np.isfinite(fixes.vel_n[m]).all() else 3
        both = np.hstack([pos_n, vel_n])[:, :states]
        nees = normalized_squares(both, P[:, :states, :states])
    unknown = np.full((len(k), 3), np.nan)
    return ErrorSeries(
        t=solution.t[k],
        pos_n=pos_n,
        vel_n=vel_n,
        phi_n=unknown,
        heading=unknown[:, 0],
        nees=nees,
        states=states,
    )


def judge(
    solution: NavSolution, fixes: GnssFixes, data: SensorData, evaluation_from: float
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors at the withheld fixes, and the metrics that need no attitude.

    The metrics are those of `bench.evaluation.metrics` for position, velocity and innovations: ``x`` from
    ``evaluation_from`` [s] on, ``x_all`` over the whole recording.
    """
    errors = antenna_errors(solution, fixes, data)
    rows, _ = _match_instants(solution.t, errors.t)
    values: dict[str, Any] = {"converged": True, "reason": None, **describe_failure(solution)}
    if len(rows):
        left_out = {"phi"} if errors.states == 6 else {"phi", "vel"}  # 6: every fix has a velocity
        wanted = [
            metric
            for metric in METRICS
            if metric.block not in left_out and not metric.name.startswith(_OF_TRUTH)
        ]
        values = judge_epochs(errors, select_epochs(solution, rows), evaluation_from, metrics=wanted)
    return errors, {**values, "withheld_fixes": len(rows)}


def find_angular_rate(imu: ImuData, t: FloatArray) -> FloatArray:
    """Return the measured angular rate (M, 3) of the sample that contains or ends at t (M,) [rad/s], b."""
    row = np.clip(np.searchsorted(imu.t, t - SAME_INSTANT), 0, len(imu) - 1)
    return np.asarray(imu.dtheta_b[row] / imu.dt[row, None])


def _match_instants(t: FloatArray, wanted: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the rows of t (N,) and the rows of wanted (M,) that are the same instants."""
    row = np.clip(np.searchsorted(t, wanted - SAME_INSTANT), 0, max(len(t) - 1, 0))
    same = np.flatnonzero(np.abs(t[row] - wanted) <= SAME_INSTANT) if len(t) else np.empty(0, np.int64)
    return row[same], same
