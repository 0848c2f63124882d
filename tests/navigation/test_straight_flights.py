"""loose-full is honest where a consumer IMU flies straight out, and its heading is hardly told for minutes.

The errors of such a unit are larger than what it measures, and what tells them apart are turns alone: a
filter that takes a correction for a turn, or a state for another, believes itself and is lost.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import bench
from bench import pipeline
from bench.evaluation.error_series import error_series
from bench.navigation.estimator import load
from bench.specs import Fault
from tests.navigation import honesty

TOUR = str(Path(__file__).parent / "tour.toml")
DRAWS, SEED = 8, 4711
FASTER = {"covariance_hz": 20.0}


def assert_honest(averages, draws=DRAWS):
    """The NEES of each draw, averaged over time, and their mean, are in the 99.9 % bands of one instant.

    An average over time scatters less than one instant does, so the bands are wide.
    """
    assert len(averages) == draws
    assert max(averages) < chi2.ppf(1.0 - 1e-3 / draws, 9)
    low, high = chi2.ppf([5e-4, 1.0 - 5e-4], 9 * draws) / draws
    assert low < np.mean(averages) < high


@pytest.mark.slow
@pytest.mark.parametrize(
    ("profile", "changes", "use", "seed"),
    [
        (TOUR, {}, "loose-full", SEED),
        (TOUR, {}, "smoother", SEED),
        (TOUR, {"wind.turbulence": "light"}, "loose-full", SEED),
        ("climb-cruise-descend", {"sensors.imu": "mpu-9250"}, "loose-full", SEED),
        ("date-line", {"sensors.imu": "bmi088"}, "loose-full", 5077),  # one has a bias of three sd
    ],
    ids=["calm", "calm-smoothed", "light", "transport", "three-sigma"],
)
def test_honest_straight_out_with_a_consumer_imu(profile, changes, use, seed):
    flown = bench.load_profile(profile, {**changes, "evaluation.output_hz": 1.0})
    truth = bench.fly(flown)
    found = honesty.judge_draws(replace(flown, seed=seed), truth, "consumer", [(use, FASTER)], range(DRAWS))[
        0
    ]
    assert found.failed == 0
    assert_honest(found.averages)


@pytest.mark.slow
@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_honest_after_a_step_of_the_radar_altimeter(use, figure_eight_truth):
    """60 m for a minute: refused, believed with an open bias, and found again; judged while it lasts, too."""
    flown = bench.load_profile(
        "figure-eight-matched", {"sensors.radar": "matched-radar", "evaluation.output_hz": 1.0}
    )
    step = Fault("radar-step", "radar", 200.0, 260.0, "60 m for a minute", step=(60.0,), ramp=(0.0,))
    flown = replace(flown, sensors=replace(flown.sensors, faults=(step,)))
    estimator, averages = load(use, {"radar": True}), []
    for run in range(DRAWS):
        sensed = pipeline.sense(replace(flown, seed=SEED), figure_eight_truth, run)
        solution = estimator.run(sensed.data, sensed.initial)
        radar = solution.innovations.code == solution.innovations.sensor.index("radar")
        assert not solution.innovations.accepted[radar].all()
        errors = error_series(figure_eight_truth, solution)
        averages.append(errors.nees[errors.t > 60.0].mean())
    assert_honest(averages)
