"""Judging a solution by fixes it was not given: what a broken covariance may not hide behind."""

from dataclasses import replace

import numpy as np
import pytest

from bench.core.mathematics import earth, rotation
from bench.core.records.data import GnssFixes, ImuData, NavSolution, SensorData
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors import fixes
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors
from tests.weaving import units, weaving


@pytest.fixture(scope="module")
def case():
    sensed = sensors.sense(weaving(40.0), units(), 1, 0)
    return sensed.data, Loose().run(sensed.data, sensed.initial)


def judged(case, *, variance=None, velocity=True):
    data, solution = case
    cov = solution.cov.copy()
    if variance is not None:
        cov[100:, 0, 0] = variance
    vel_n = data.fixes.vel_n if velocity else np.full_like(data.fixes.vel_n, np.nan)
    given = replace(data.fixes, vel_n=vel_n)
    return fixes.measure_by_fixes(replace(solution, cov=cov), given, data, EvaluationWindow(10.0))[1]


def test_a_negative_variance_is_a_broken_filter_whatever_the_fixes_lack(case):
    assert judged(case)["converged"]
    for velocity in (True, False):
        found = judged(case, variance=-100.0, velocity=velocity)
        assert not found["converged"]
        assert "covariance is not positive definite" in found["reason"]


def test_fixes_without_velocity_judge_the_position_of_a_sound_filter(case):
    found = judged(case, velocity=False)
    assert found["converged"]
    assert found["reason"] is None
    assert found["nees_states"] == 3.0


def test_a_solution_without_attitude_is_that_of_the_point_and_has_no_error_of_attitude(case):
    """The reference knows the attitude and the estimate does not: six states count, and no lever arm."""
    data, solution = case
    unknown = np.full_like(solution.q_nb, np.nan)
    cov = solution.cov.copy()
    cov[:, 6:], cov[:, :, 6:] = np.nan, np.nan
    alone = replace(solution, q_nb=unknown, cov=cov)
    errors, moved = fixes.point_errors(alone, solution, np.array([3.0, 0.0, 0.0]), data.imu)
    assert errors.states == 6
    np.testing.assert_array_equal(errors.pos_n, 0.0)
    np.testing.assert_array_equal(errors.nees, 0.0)
    assert np.isnan(moved.cov[:, 6:]).all()


def test_a_solution_without_biases_has_a_velocity_at_the_antenna(case):
    """The rate that moves the antenna is that of the IMU then."""
    data, solution = case
    arm = np.array([3.0, 0.0, 0.0])
    errors = [
        fixes.point_errors(replace(solution, gyro_bias_b=bias), solution, arm, data.imu)[0]
        for bias in (np.full_like(solution.gyro_bias_b, np.nan), np.zeros_like(solution.gyro_bias_b))
    ]
    assert np.isfinite(errors[0].vel_n).all()
    np.testing.assert_array_equal(errors[0].vel_n, errors[1].vel_n)
    assert np.abs(errors[0].vel_n).max() > 0.0


def test_errors_at_a_point_by_hand(case):
    """Level and north, 3 m ahead: 0.2 rad/s of which 0.05 are bias move it right by 0.45 m/s.

    1 m^2 of position, 0.01 rad^2 of heading and 0.02 m rad between them: 1 + 9 * 0.01 + 2 * 3 * 0.02.
    """
    data, solution = case
    turning = np.tile([0.0, 0.0, 0.2], (len(data.imu), 1)) * data.imu.dt[:, None]
    cov = np.zeros_like(solution.cov)
    cov[:, 1, 1], cov[:, 8, 8], cov[:, 1, 8], cov[:, 8, 1] = 1.0, 0.01, 0.02, 0.02
    north = replace(
        solution,
        q_nb=np.tile([1.0, 0.0, 0.0, 0.0], (len(solution), 1)),
        gyro_bias_b=np.tile([0.0, 0.0, 0.05], (len(solution), 1)),
        cov=cov,
    )
    imu = replace(data.imu, dtheta_b=turning)
    exact = replace(solution, cov=np.zeros_like(cov))
    errors, moved = fixes.point_errors(north, exact, np.array([3.0, 0.0, 0.0]), imu)
    np.testing.assert_allclose(errors.vel_n, np.tile([0.0, 0.45, 0.0], (len(north), 1)), atol=1e-12)
    np.testing.assert_allclose(errors.pos_n[:, 0], 3.0, atol=1e-5)
    np.testing.assert_allclose(moved.cov[:, 1, 1], 1.21)


def test_the_accuracy_of_a_fix_is_that_of_its_position_and_its_velocity(case):
    data, solution = case
    eye = np.tile(np.eye(3), (len(data.fixes), 1, 1))
    given = replace(data.fixes, cov_pos_n=4.0 * eye, cov_vel_n=0.09 * eye)
    exact = replace(solution, cov=np.zeros_like(solution.cov))
    moved = fixes.antenna_errors(exact, given, data)[1]
    np.testing.assert_allclose(np.einsum("kii->ki", moved.cov)[:, :6], [[4.0] * 3 + [0.09] * 3] * len(moved))


LATE = 0.12  # [s]


def late(truth, arm, d):
    """Return the errors at fixes that show the motion `LATE` after their times, and the estimate there.

    The filter is exact, but for d (10,): position [m], velocity [m/s], attitude [rad], offset [s].
    """
    rows = np.arange(200, 6000, 400)
    after = rows + round(LATE * 200)
    C, q_nb = rotation.matrix(truth.q_nb[after]), truth.q_nb[rows]
    w_b = truth.dtheta_b[after - 1] * 200.0
    n, three = len(rows), np.zeros((len(rows), 3))
    fixes_there = GnssFixes(
        t=truth.t[rows],
        t_arrival=truth.t[rows],
        valid=np.ones(n, np.bool_),
        lla=earth.displace(truth.lla[after], C @ arm),
        vel_n=truth.vel_n[after] + np.einsum("kij,kj->ki", C, np.cross(w_b, arm)),
        cov_pos_n=np.zeros((n, 3, 3)),
        cov_vel_n=np.zeros((n, 3, 3)),
        satellites=np.zeros(n, np.int64),
    )
    solution = NavSolution(
        t=truth.t[rows],
        lla=earth.displace(truth.lla[rows], np.tile(d[:3], (n, 1))),
        vel_n=truth.vel_n[rows] + d[3:6],
        q_nb=rotation.multiply(np.tile(rotation.from_rotvec(d[6:9]), (n, 1)), q_nb),
        gyro_bias_b=three,
        accel_bias_b=three,
        cov=np.tile(P[:9, :9], (n, 1, 1)),
        extra_names=("time_offset_s",),
        extra=np.full((n, 1), LATE + d[9]),
        extra_sd=np.full((n, 1), np.sqrt(P[9, 9])),
        offset_cov=np.tile(P[9, :9], (n, 1)),
    )
    dt = np.full(len(truth) - 1, 0.005)
    imu = ImuData(truth.t[1:], dt, np.ones(len(dt), np.bool_), truth.dtheta_b, truth.dvel_b)
    data = SensorData(imu, fixes_there, arm, units().assumed, solution.t)
    return fixes.antenna_errors(solution, fixes_there, data)


_L = np.tril(np.random.default_rng(3).standard_normal((10, 10)))
P = 1e-4 * _L @ _L.T + 1e-5 * np.eye(10)
"""A covariance of position, velocity, attitude and offset with every element."""


def test_a_fix_is_compared_with_the_motion_at_its_time_plus_the_estimated_offset():
    """3 m of travel and 0.7 m/s of change come down to what a mean force over 0.12 s leaves."""
    truth = weaving(40.0)
    errors, _ = late(truth, np.array([0.8, 0.3, -0.4]), np.zeros(10))
    assert np.abs(errors.pos_n).max() < 2e-3
    assert np.abs(errors.vel_n).max() < 0.02
    exact, _ = late(truth, np.zeros(3), np.zeros(10))
    assert np.abs(exact.pos_n).max() < 1e-3
    assert np.abs(exact.vel_n).max() < 2e-3


def test_the_covariance_there_is_that_of_small_errors_of_state_and_offset():
    """Each column of the Jacobian by differences, about an offset that ends in the middle of a sample."""
    truth, arm, h, about = weaving(40.0), np.zeros(3), 1e-4, 0.0025 * np.eye(10)[9]
    base, moved = late(truth, arm, about)
    columns = []
    for k in range(10):
        wrong, _ = late(truth, arm, about + h * np.eye(10)[k])
        columns.append(np.hstack([wrong.pos_n - base.pos_n, wrong.vel_n - base.vel_n]) / h)
    J = np.stack(columns, axis=-1)
    expected = J @ P @ J.transpose(0, 2, 1)
    scale = np.sqrt(np.einsum("kii->ki", expected))
    difference = (moved.cov[:, :6, :6] - expected) / (scale[:, :, None] * scale[:, None, :])
    assert np.abs(difference[:, :3, :3]).max() < 5e-3
    assert np.abs(difference).max() < 0.08  # the force at the end is not the mean: it turns by 0.1 rad/s
