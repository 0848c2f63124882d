"""A turn-on bias of degrees per second is learnt before a linear filter takes it."""

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench import pipeline
from bench.navigation.estimator import load
from bench.navigation.start import turn_on
from tests.builders import Z, at_rest, band, first_rows
from tests.navigation import honesty

MPU = {"sensors.imu": "mpu-6050"}


def with_biases_alone(profile):
    """Return a profile whose unit has no other errors that are steady in straight flight."""
    unit = profile.sensors.imu
    triads = {
        name: replace(getattr(unit, name), temperature_sd=0.0, g_sensitivity_sd=0.0)
        for name in ("gyro", "accel")
    }
    return honesty.with_unit(profile, replace(unit, **triads))


@pytest.mark.parametrize("standing", [False, True])
def test_the_mean_rate_of_a_straight_or_a_standstill_is_the_bias(figure_eight_truth, standing):
    """In flight to a quarter of a degree per second, at rest to hundredths, over 12 draws of 6.7 deg/s."""
    profile = bench.load_profile("figure-eight", MPU)
    truth = first_rows(figure_eight_truth, 5001)
    if standing:  # to hundredths the g-sensitivity shows, too; without air there is no temperature
        profile = with_biases_alone(profile)
        truth = at_rest(25.0, 200.0, truth.lla[0])
    square = []
    for run in range(12):
        sensed = pipeline.sense(profile, truth, run)
        found = turn_on.find_turn_on(sensed.data, sensed.initial)
        assert found is not None
        assert found.until <= 25.0
        assert found.sd < np.deg2rad(0.02 if standing else 0.3)
        now = np.searchsorted(sensed.truth.t, found.until)
        square.append(((found.bias_b - sensed.truth.gyro_bias_b[now]) / found.sd) ** 2)
    assert np.mean(square) < band(36)[1]  # at least as good as it says


def test_nothing_is_learnt_of_a_small_bias_or_in_a_turn(figure_eight_truth):
    small = bench.load_profile("figure-eight")
    sensed = pipeline.sense(small, first_rows(figure_eight_truth, 5001))
    assert turn_on.find_turn_on(sensed.data, sensed.initial) is None
    large = pipeline.sense(bench.load_profile("figure-eight", MPU), first_rows(figure_eight_truth, 5001))
    fixes = large.data.fixes
    course = 0.2 * fixes.t  # a circle in half a minute
    speed = np.hypot(fixes.vel_n[:, 0], fixes.vel_n[:, 1])
    circle = np.column_stack([speed * np.cos(course), speed * np.sin(course), np.zeros(len(speed))])
    data = replace(large.data, fixes=replace(fixes, vel_n=circle))
    assert turn_on.find_turn_on(data, large.initial) is None


@pytest.mark.slow
def test_loose_full_is_honest_with_a_bias_of_degrees_per_second(figure_eight_truth):
    """6 draws of 5 minutes; without such a start the first turn loses the heading."""
    profile = replace(bench.load_profile("figure-eight", {**MPU, "evaluation.output_hz": 1.0}), seed=31)
    truth = first_rows(figure_eight_truth, 60_001)
    uses = [("loose-full", {})]
    (found,) = honesty.judge_draws(profile, truth, "mpu-6050", uses, range(6))
    assert found.failed == 0
    most = 9.0 + Z * max(found.error, 0.6)
    assert found.mean < most
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(turn_on, "LARGE", np.inf)
        (without,) = honesty.judge_draws(profile, truth, "mpu-6050", uses, range(3))
    assert without.failed > 0 or without.mean > most


def test_what_is_left_of_the_bias_is_learnt_again_while_the_course_stays():
    """A stage is three times as long as the one before and tells three times as much."""
    profile = with_biases_alone(bench.load_profile("long-cruise", MPU))
    sensed = pipeline.sense(profile, bench.fly(profile), 0)
    data = bench.take_piece(sensed.data, -1.0, 600.0)
    solution = load("loose-full", {}).run(replace(data, output_t=np.array([30.0, 590.0])), sensed.initial)
    learnt = solution.events.select("alignment")
    assert [round(end) for _, end, _ in learnt] == list(turn_on.STAGES)
    now = np.searchsorted(sensed.truth.t, solution.t)
    error = np.abs(solution.gyro_bias_b - sensed.truth.gyro_bias_b[now]).max(axis=1)
    assert (error < 4.0 * turn_on.TURNED_SD / np.take(turn_on.STAGES, [0, -1])).all()
