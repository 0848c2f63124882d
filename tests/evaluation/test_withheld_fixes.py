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
