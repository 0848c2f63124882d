"""Errors of a solution against withheld GNSS fixes, for recordings without a truth.

A fix is a measurement of the antenna. Estimate minus fix contains the errors of both: its root mean square
is an upper bound for the error of the estimate, and its covariance is the sum of both covariances.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import TIME_OFFSET, GnssFixes, ImuData, NavSolution, SensorData
from bench.core.records.run_records import ErrorSeries
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors.error_series import find_covered_epochs, normalized_squares, select_epochs
from bench.evaluation.errors.failures import describe_failure
from bench.evaluation.metrics.coverage import carry_on, find_excused, find_silent_epochs, measure_coverage
from bench.evaluation.metrics.run_metrics import METRICS, CarriedSolution, judge_epochs

_OF_TRUTH = ("outage", "coverage", "error_over", "ape", "rpe", "drift")
"""How the names of metrics begin that the errors of the fixes themselves would spoil."""
_LATEST = 1.0  # longest part of a clock offset over which the motion of the IMU is averaged [s]


def antenna_errors(
    solution: NavSolution, fixes: GnssFixes, data: SensorData
) -> tuple[ErrorSeries, NavSolution]:
    """Return estimate minus fix at the antenna, for every fix at an epoch of the solution.

    If the filter estimates the clock of the fixes, a fix is compared with the motion at its time plus the
    estimated offset.

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
        As :func:`point_errors` returns them; ``phi_n`` and ``heading`` are NaN.
    moved : NavSolution
        The estimate at the antenna, with the sum of its covariance and the covariance of the fixes.
    """
    k, m = _match_instants(solution.t, fixes.t)
    fixes = fixes.take(m)
    cov = np.zeros((len(k), 9, 9))
    cov[:, :3, :3], cov[:, 3:6, 3:6] = fixes.cov_pos_n, fixes.cov_vel_n
    unknown = np.full((len(k), 3), np.nan)
    reference = NavSolution(
        t=fixes.t,
        lla=fixes.lla,
        vel_n=fixes.vel_n,
        q_nb=np.full((len(k), 4), np.nan),
        gyro_bias_b=unknown,
        accel_bias_b=unknown,
        cov=cov,
        extra_names=(),
        extra=np.empty((len(k), 0)),
        extra_sd=np.empty((len(k), 0)),
    )
    estimate = _move_by_offset(select_epochs(solution, k), data.imu)
    return point_errors(estimate, reference, data.antenna_b, data.imu)


def _move_by_offset(solution: NavSolution, imu: ImuData) -> NavSolution:
    """Return a solution at each of its epochs plus the clock offset of the fixes that it estimates.

    The mean force and rate in between move it, ``p + v dt + a dt^2 / 2`` and ``v + a dt``. The error of the
    offset adds v, a and the rate to the errors there. Unknown covariances of the offset with them count as 0.
    """
    if solution.offset_cov is None or not len(solution):
        return solution
    at = solution.extra_names.index(TIME_OFFSET)
    dt, sd = solution.extra[:, at, None], solution.extra_sd[:, at, None]
    dt = np.where(np.isfinite(dt), dt, 0.0)
    w_b, f_b = _find_mean_motion(imu, solution.t, solution.t + np.clip(dt[:, 0], -_LATEST, _LATEST))
    w_b = w_b - np.nan_to_num(solution.gyro_bias_b)
    half = rotation.from_rotvec(0.5 * w_b * dt)
    middle = rotation.multiply(solution.q_nb, half)
    C_nb = rotation.matrix(middle)
    f_n = np.einsum("kij,kj->ki", C_nb, f_b - np.nan_to_num(solution.accel_bias_b))
    a_n = np.nan_to_num(f_n + earth.gravity_n(solution.lla[:, 0], solution.lla[:, 2]))
    u = np.hstack([solution.vel_n + a_n * dt, a_n, np.einsum("kij,kj->ki", C_nb, np.nan_to_num(w_b))])
    F = np.tile(np.eye(9), (len(dt), 1, 1))
    F[:, range(3), range(3, 6)] = dt
    F[:, 3:6, 6:] = rotation.skew(np.nan_to_num(f_n)) * -dt[:, :, None]
    F[:, :3, 6:] = 0.5 * dt[:, :, None] * F[:, 3:6, 6:]
    c = F @ np.nan_to_num(solution.offset_cov)[:, :, None]
    across = c @ u[:, None, :]
    variance = np.nan_to_num(sd)[:, :, None] ** 2
    cov = F @ solution.cov @ F.transpose(0, 2, 1) + across + across.transpose(0, 2, 1)
    return replace(
        solution,
        lla=earth.displace(solution.lla, solution.vel_n * dt + 0.5 * a_n * dt**2),
        vel_n=solution.vel_n + a_n * dt,
        q_nb=rotation.multiply(middle, half),
        cov=cov + variance * u[:, :, None] * u[:, None, :],
    )


def _find_mean_motion(imu: ImuData, begin: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean rate (M, 3) [rad/s] and force (M, 3) [m/s^2] of the samples between times (M,), b."""
    first, last = (
        np.clip(np.searchsorted(imu.t, t - SAME_INSTANT), 0, len(imu) - 1)
        for t in (np.minimum(begin, end), np.maximum(begin, end))
    )
    span = [slice(a, b + 1) for a, b in zip(first, last, strict=True)]
    duration = np.array([imu.dt[one].sum() for one in span])[:, None]
    w_b, f_b = (
        np.array([of[one].sum(axis=0) for one in span]) / duration for of in (imu.dtheta_b, imu.dvel_b)
    )
    return w_b, f_b


def point_errors(
    solution: NavSolution, reference: NavSolution, point_b: FloatArray, imu: ImuData
) -> tuple[ErrorSeries, NavSolution]:
    """Return estimate minus reference at a point of the vehicle.

    Parameters
    ----------
    solution : NavSolution
        The motion of the IMU.
    reference : NavSolution
        The motion of the point at the same epochs (M,); NaN where it has no velocity or attitude. A
        covariance of zero is taken as exact; if all are NaN, no NEES is computed.
    point_b : (3,) array
        The point relative to the IMU [m], b.
    imu : ImuData
        For the angular rate that moves the point.

    Returns
    -------
    errors : ErrorSeries
        ``nees`` counts the blocks that the reference has at every time, with the sum of both covariances.
    moved : NavSolution
        The estimate at the point, with that sum as its covariance; NaN in blocks that are not compared.
    """
    with np.errstate(all="ignore"):  # a diverged solution is a result, not a warning
        C_nb = rotation.matrix(solution.q_nb)
        # a filter without attitude gives the position of the point: no lever arm
        has_attitude: BoolArray = np.asarray(~np.isnan(solution.q_nb).all(axis=1))
        arm_n = np.where(has_attitude[:, None], C_nb @ point_b, 0.0)
        w_b = find_angular_rate(imu, solution.t) - np.nan_to_num(solution.gyro_bias_b)
        swing_n = np.einsum("kij,kj->ki", C_nb, np.cross(w_b, point_b))
        swing_n = np.where(has_attitude[:, None], swing_n, 0.0)
        lla, vel_n = earth.displace(solution.lla, arm_n), solution.vel_n + swing_n
        pos_error_n, vel_error_n = earth.difference_n(lla, reference.lla), vel_n - reference.vel_n
        turned = rotation.multiply(solution.q_nb, rotation.conjugate(reference.q_nb))
        phi_n = rotation.to_rotvec(turned)
        headings = [rotation.to_euler(one.q_nb)[2] for one in (solution, reference)]
        heading = np.pi - np.mod(np.pi - (headings[0] - headings[1]), 2 * np.pi)
        # position error of the point: dp - [arm x] phi; the effect of phi on its velocity is neglected
        T = np.tile(np.eye(9), (len(solution), 1, 1))
        T[:, :3, 6:] = -rotation.skew(arm_n)
        cov = np.where(has_attitude[:, None, None], solution.cov, 0.0)
        cov[:, :6, :6] = solution.cov[:, :6, :6]
        own = [bool(np.isfinite(block).any()) for block in (solution.lla, solution.vel_n)]
        unestimated = np.repeat([not own[0], not own[1], False], 3)
        cov[:, unestimated], cov[:, :, unestimated] = 0.0, 0.0
        unknown = bool(np.isnan(reference.cov).all())
        P = T @ cov @ T.transpose(0, 2, 1) + (np.nan if unknown else np.nan_to_num(reference.cov))
        moves = bool(np.isfinite(reference.vel_n).all())
        turns = bool(np.isfinite(reference.q_nb).all() and has_attitude.any())
        counted = np.repeat([own[0], own[1] and moves, turns], 3)
        P[:, ~counted], P[:, :, ~counted] = np.nan, np.nan
        P[~has_attitude & np.isnan(solution.lla).any(axis=1)] = np.nan
        error = np.hstack([pos_error_n, vel_error_n, phi_n])[:, counted]
        nees = normalized_squares(error, P[:, counted][:, :, counted])
    moved = replace(
        solution,
        lla=lla,
        vel_n=vel_n if moves else np.full_like(vel_n, np.nan),
        q_nb=solution.q_nb if turns else np.full_like(solution.q_nb, np.nan),
        cov=P,
    )
    states = int(counted.sum())
    return ErrorSeries(solution.t, pos_error_n, vel_error_n, phi_n, heading, nees, states), moved


def measure_by_fixes(
    solution: NavSolution, fixes: GnssFixes, data: SensorData, evaluation: EvaluationWindow
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors at the withheld fixes, and the metrics that need no attitude.

    The metrics are those of `metrics.run_metrics` for position, velocity and innovations: ``x`` over
    what ``evaluation`` counts, ``x_all`` over the whole recording.
    """
    errors, _ = antenna_errors(solution, fixes, data)
    rows, _ = _match_instants(solution.t, errors.t)
    values: dict[str, Any] = {"converged": True, "reason": None, **describe_failure(solution)}
    if len(rows):
        left_out = {"phi"} if errors.states == 6 else {"phi", "vel"}  # 6: every fix has a velocity
        wanted = [
            metric
            for metric in METRICS
            if metric.block not in left_out and not metric.name.startswith(_OF_TRUTH)
        ]
        covered, silent = find_covered_epochs(solution)[rows], find_silent_epochs(solution)
        at_fixes = _move_by_offset(select_epochs(solution, rows[covered]), data.imu)
        judged = select_epochs(errors, covered)
        carried = None
        if silent[rows].any():
            moved = carry_on(solution, silent)
            unexcused = (silent & ~find_excused(solution, data))[rows]
            carried = CarriedSolution(
                antenna_errors(moved, fixes, data)[0], select_epochs(moved, rows), unexcused
            )
        if len(judged):
            values = judge_epochs(
                judged,
                at_fixes,
                evaluation,
                metrics=wanted,
                carried=carried,
                coverage=measure_coverage(solution, data),
            )
    return errors, {**values, "withheld_fixes": len(rows)}


def find_angular_rate(imu: ImuData, t: FloatArray) -> FloatArray:
    """Return the measured angular rate (M, 3) of the sample that contains or ends at t (M,) [rad/s], b."""
    row = np.clip(np.searchsorted(imu.t, t - SAME_INSTANT), 0, len(imu) - 1)
    return np.asarray(disk_arrays.take(imu.dtheta_b, row) / disk_arrays.take(imu.dt, row)[:, None])


def _match_instants(t: FloatArray, wanted: FloatArray) -> tuple[IntArray, IntArray]:
    """Return the rows of t (N,) and the rows of wanted (M,) that are the same epochs."""
    row = np.clip(np.searchsorted(t, wanted - SAME_INSTANT), 0, max(len(t) - 1, 0))
    same = np.flatnonzero(np.abs(t[row] - wanted) <= SAME_INSTANT) if len(t) else np.empty(0, np.int64)
    return row[same], same
