"""Judging a solution by fixes it was not given: what a broken covariance may not hide behind."""

from dataclasses import replace

import numpy as np
import pytest

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
