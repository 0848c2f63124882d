"""Errors of a solution against fixes it was not given: the judgement where there is no truth.

A fix is a measurement of the antenna. Estimate minus fix is the error of the estimate less that of the
fix, so a root mean square of it is an upper bound, and its covariance is that of both together.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from bench import earth, rotation
from bench.arrays import FloatArray
from bench.data import ErrorSeries, GnssFixes, ImuData, NavSolution, SensorData
from bench.evaluation import metrics
from bench.evaluation.error_series import aligning, converged, from_row, normalized_squares
from bench.units import SAME_INSTANT


def antenna_errors(solution: NavSolution, fixes: GnssFixes, data: SensorData) -> ErrorSeries:
    """Return estimate minus fix at the antenna, at every fix the solution has an instant for.

    Parameters
    ----------
    solution : NavSolution
        Of the IMU.
    fixes : GnssFixes
        What judges it, in order of time; rows without a velocity leave its error NaN.
    data : SensorData
        For the lever arm, and the turn rate that moves the antenna.

    Returns
    -------
    errors : ErrorSeries
        ``phi_n`` and ``heading`` are NaN. ``nees`` is of position and velocity, or of position alone when
        a fix has no velocity, under the covariance of estimate and fix together.
    """
    k, m = _matched(solution.t, fixes.t)
    with np.errstate(all="ignore"):  # a diverged solution is a result, not a warning
        C_nb = rotation.matrix(solution.q_nb[k])
        arm_n = C_nb @ data.antenna_b
        # without attitude the arm points anywhere: such an estimator says where the antenna is, about
        turned = ~np.isnan(solution.q_nb[k]).all(axis=1)
        arm_n = np.where(turned[:, None], arm_n, 0.0)
        w_b = turn_rate(data.imu, solution.t[k]) - solution.gyro_bias_b[k]
        swing_n = np.einsum("kij,kj->ki", C_nb, np.cross(w_b, data.antenna_b))
        swing_n = np.where(turned[:, None], swing_n, 0.0)
        pos_n = earth.difference_n(earth.displace(solution.lla[k], arm_n), fixes.lla[m])
        vel_n = solution.vel_n[k] + swing_n - fixes.vel_n[m]
        # antenna position error: dp - [arm x] phi; the arm's share of the velocity error is left out
        T = np.tile(np.eye(6, 9), (len(k), 1, 1))
        T[:, :3, 6:] = -rotation.skew(arm_n)
        cov = np.where(turned[:, None, None], solution.cov[k], 0.0)
        cov[:, :6, :6] = solution.cov[k, :6, :6]
        P = T @ cov @ T.transpose(0, 2, 1)
        P[:, :3, :3] += fixes.cov_pos_n[m]
        P[:, 3:, 3:] += fixes.cov_vel_n[m]
        states = 6 if np.isfinite(fixes.vel_n[m]).all() else 3
        both = np.hstack([pos_n, vel_n])[:, :states]
        nees = normalized_squares(both, P[:, :states, :states])
    nothing = np.full((len(k), 3), np.nan)
    return ErrorSeries(
        t=solution.t[k],
        pos_n=pos_n,
        vel_n=vel_n,
        phi_n=nothing,
        heading=nothing[:, 0],
        nees=nees,
        states=states,
    )


def judge(
    solution: NavSolution, fixes: GnssFixes, data: SensorData, evaluation_from: float
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors at fixes that were withheld, and the metrics that need no attitude.

    The metrics are those of `bench.evaluation.metrics` over position, velocity and innovations; ``x`` from
    ``evaluation_from`` [s] on, ``x_all`` over all.
    """
    errors = antenna_errors(solution, fixes, data)
    rows, _ = _matched(solution.t, errors.t)
    at = _rows(solution, rows)
    begun = aligning(at, evaluation_from) if len(rows) else 0
    judged, at = from_row(errors, begun), from_row(at, begun)
    sound, reason = converged(judged, at) if len(at) else (True, None)
    if len(at) and aligning(at, np.inf):
        sound, reason = False, f"no solution before the metrics begin at {evaluation_from:g} s"
    values: dict[str, Any] = {"converged": sound, "reason": reason, "withheld_fixes": len(rows)}
    for suffix, start in (("", evaluation_from), ("_all", -np.inf)):
        case = metrics.case_from(judged, at, start, ())
        if not len(case.t):
            continue
        for metric in metrics.METRICS:
            if metric.block == "phi" or metric.name.startswith(("outage", "coverage")):
                continue  # there is no attitude and no error without that of the fix
            if metric.block == "vel" and not np.isfinite(case.vel_n).all():
                continue
            result = metric.function(case)
            named = result.items() if isinstance(result, Mapping) else [("", result)]
            for key, value in named:
                good = sound and value is not None and np.isfinite(value)
                values[f"{metric.name.format(key)}{suffix}"] = value if good else None
    return errors, values


def turn_rate(imu: ImuData, t: FloatArray) -> FloatArray:
    """Return the angular rate (M, 3) measured over the interval that holds or ends at a time [rad/s], b."""
    row = np.clip(np.searchsorted(imu.t, t - SAME_INSTANT), 0, len(imu) - 1)
    return np.asarray(imu.dtheta_b[row] / imu.dt[row, None])


def _matched(t: FloatArray, wanted: FloatArray) -> tuple[Any, Any]:
    """Return the rows of t (N,) and of wanted (M,) that are one instant."""
    row = np.clip(np.searchsorted(t, wanted - SAME_INSTANT), 0, max(len(t) - 1, 0))
    same = np.flatnonzero(np.abs(t[row] - wanted) <= SAME_INSTANT) if len(t) else np.empty(0, np.int64)
    return row[same], same


def _rows(solution: NavSolution, rows: Any) -> NavSolution:
    """Return a solution at some of its instants."""
    return NavSolution(
        t=solution.t[rows],
        lla=solution.lla[rows],
        vel_n=solution.vel_n[rows],
        q_nb=solution.q_nb[rows],
        gyro_bias_b=solution.gyro_bias_b[rows],
        accel_bias_b=solution.accel_bias_b[rows],
        cov=solution.cov[rows],
        extra_names=solution.extra_names,
        extra=solution.extra[rows],
        extra_sd=solution.extra_sd[rows],
        innovations=solution.innovations,
        events=solution.events,
    )
