"""Is rest found, and only rest? Rates over random motions, by the unit's own noise.

A window is true rest if the vehicle moves slower than 1 mm/s and turns by less than 0.0001 deg, and motion
if it moves faster than 0.2 m/s or turns by more than a degree.
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta, chi2

from bench.evaluation.errors.error_series import error_series
from bench.navigation import built_in
from bench.navigation.error_state_filter.standstill import StandstillDetector
from bench.simulation import sensors
from tests.motions import trials
from tests.motions.held import after
from tests.motions.truths import RATE, Motion, clock, make_truth

SAMPLES = int(RATE)  # in a window of a second
KINDS = ("car queue", "aircraft queue", "turntable", "garage", "hover", "panning", "moored boat then sails")


def draw(kind, number, seed=4071):
    """Motion, unit and record of the sensors of one random trial."""
    r = np.random.default_rng([seed, number, sorted(trials.KINDS).index(kind)])
    motion, unit = trials.KINDS[kind](r), str(r.choice(trials.list_units()))
    spec = trials.choose_start(trials.load_sensors(unit, "zed-f9p"), motion, "given")
    return motion, sensors.sense(make_truth(motion.vel_n, motion.euler), spec, seed, number).data


def judge(kind, number):
    """Windows that are found at rest, that are true rest, and that are motion."""
    motion, data = draw(kind, number)
    last = np.arange(SAMPLES - 1, len(data.imu), SAMPLES)
    still, _, _ = StandstillDetector(0.0, data.specs.imu).measure(data.imu, last)
    spans = [slice(k - SAMPLES + 1, k + 2) for k in last]
    speed = np.array([np.linalg.norm(motion.vel_n[one], axis=1).max() for one in spans])
    angle = np.array([np.rad2deg(np.ptp(motion.euler[one], axis=0).max()) for one in spans])
    return still, (speed < 1e-3) & (angle < 1e-4), (speed > 0.2) | (angle > 1.0)


@pytest.mark.parametrize("kind", KINDS)
def test_rest_is_found_and_motion_is_not_taken_for_it(kind):
    """At least 95 % of all rests, at most one window in a thousand of motion, at 99.9 % confidence."""
    still, rest, moves = (
        np.concatenate(one) for one in zip(*(judge(kind, k) for k in range(6)), strict=True)
    )
    found, count = int((still & rest).sum()), int(rest.sum())
    assert count == 0 or beta.isf(1e-3, found + 1, count - found + 1) > 0.95, f"{found} of {count}"
    wrong, count = int((still & moves).sum()), int(moves.sum())
    assert beta.isf(1 - 1e-3, wrong + 1, count - wrong + 1) < 1e-3, f"{wrong} of {count}"


def test_a_steady_yaw_within_the_spread_of_a_bias_leaves_the_heading_open():
    """24 hovers without vibration that turn by 0.2 to 5 deg/s for 40 s: 99.9 % of chi-squared of the heading.

    A unit at rest with such a bias measures the same; to hold the heading would be wrong by up to 200 deg.
    """
    r, squares = np.random.default_rng(8), []
    t = clock(40.0)
    for run in range(24):
        rate = np.deg2rad(np.exp(r.uniform(np.log(0.2), np.log(5.0)))) * r.choice([-1.0, 1.0])
        yaw = np.cumsum(rate * after(t, 1.0, 2.0)) / RATE
        motion = Motion(np.zeros((len(t), 3)), np.column_stack([0.0 * t, 0.0 * t, yaw]))
        unit = str(r.choice(trials.list_units()))
        truth = make_truth(motion.vel_n, motion.euler)
        drawn = sensors.sense(
            truth, trials.choose_start(trials.load_sensors(unit, "zed-f9p"), motion, "given"), 8, run
        )
        solution = built_in.load("loose-full", {}).run(drawn.data, drawn.initial)
        error, variance = error_series(truth, solution).heading[-1], solution.cov[-1, 8, 8]
        if variance < trials.VAGUE**2:
            squares.append(error**2 / variance)
    assert len(squares) >= 12
    assert sum(squares) < chi2.isf(1e-3, len(squares)), np.round(squares, 1)
