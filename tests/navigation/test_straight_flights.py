"""loose-full is consistent if a consumer IMU flies straight out, its heading hardly observable.

The errors of such a unit are larger than what it measures, and what tells them apart are turns alone: a
filter that takes a correction for a turn, or a state for another, trusts itself and is lost.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

import bench
from bench import pipeline
from bench.core.records.sensor_specs import Fault
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from tests.flight.plans import truth_of
from tests.navigation import honesty

TOUR, CLIMB = (str(Path(__file__).parent / f"{name}.toml") for name in ("tour", "climb"))
DRAWS, SEED = 8, 4711
FASTER = {"covariance_hz": 20.0}
LEG = {"duration_s": 1500.0, "gnss_outage": [], "leg": [{"kind": "straight", "duration_s": 1500.0}]}
"""25 minutes straight on: accelerometers' noise alone moves anything, and tells no heading."""


def assert_honest(averages, draws=DRAWS):
    """The NEES of each run, averaged over time, and their mean, are in the 99.9 % bands of one time.

    An average over time scatters less than one time does, so the bands are wide.
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
        pytest.param(TOUR, {"wind.turbulence": "light"}, "loose-full", SEED, marks=pytest.mark.long),
        ("climb-cruise-descend", {"sensors.imu": "mpu-9250"}, "loose-full", SEED),
        ("date-line", {"sensors.imu": "bmi088"}, "loose-full", 5077),  # one has a bias of three sd
        pytest.param(
            *("long-cruise", {"sensors.imu": "icm-20948"}, "loose-full", 5077), marks=pytest.mark.long
        ),
        ("long-cruise", {"sensors.imu": "icm-20948", **LEG}, "loose-full", 5077),
        ("long-cruise", {"sensors.imu": "vn-100", **LEG}, "loose-full", 773311),
        ("date-line", {"sensors.imu": "icm-42688-p"}, "loose-full", 773311),  # 0.17 deg/s for two minutes
        (CLIMB, {}, "loose-full", SEED),
        (CLIMB, {"sensors.gnss": "rtk-fixed"}, "loose-full", SEED),
        (CLIMB, {"sensors.gnss": "rtk-fixed", "sensors.imu": "mpu-6050"}, "smoother", SEED),
    ],
    ids=[
        "calm",
        "calm-smoothed",
        "light",
        "transport",
        "three-sigma",
        "cruise",
        "leg-20948",
        "leg",
        "small",
        "climb",
        "fixed",
        "fixed-smoothed",
    ],
)
def test_honest_straight_out_with_a_consumer_imu(recorded, profile, changes, use, seed):
    flown = bench.read_profile(profile, {**changes, "evaluation.output_hz": 1.0})
    if profile == "climb-cruise-descend":  # which others look at, too
        truth = truth_of(recorded(flown.flight), flown.flight.rate)
    else:
        truth = bench.fly(flown)
    found = honesty.judge_draws(replace(flown, seed=seed), truth, "consumer", [(use, FASTER)], range(DRAWS))[
        0
    ]
    assert found.failed == 0
    assert_honest(found.averages)


@pytest.mark.slow
@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_honest_after_a_step_of_the_radar_altimeter(use, figure_eight_truth):
    """60 m for a minute: rejected, re-admitted with an inflated bias, found again; evaluated throughout."""
    flown = bench.read_profile(
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


_NOISY = """
title = "gyros with white noise, a scale factor and little else"
class = "consumer"
confidence = "table"
source = "made for this test"
[gyro]
noise_deg_s_sqrt_hz = 0.015
turn_on_bias_sd_deg_s = 0.01
scale_factor_sd_percent = 0.5
[accel]
noise_ug_sqrt_hz = 230.0
turn_on_bias_sd_mg = 2.0
"""
_CRUISE = """
title = "ten minutes straight on, the antenna meters ahead of the IMU"
aircraft = "jet747"
rate_hz = 200
seed = 5077
start = { lat_deg = 47.0, lon_deg = 11.0, alt_m = 9000.0, heading_deg = 280.0, speed_mps = 230.0 }
sensors = { imu = "noisy.toml", gnss = "l1-code", baro = "bmp388" }
initial_error_sd = { pos_m = [3.0, 3.0, 5.0], vel_mps = [0.2, 0.2, 0.2], tilt_deg = 0.5, heading_deg = 2.0 }
leg = [{ kind = "straight", duration_s = 600.0 }]
estimator = [{ use = "loose-full" }]
evaluation = { output_hz = 1.0 }
"""


def test_noise_of_the_gyros_does_not_tell_their_scale_factor(tmp_path):
    """Nothing turns, and an antenna meters ahead of the IMU shows the noise of a sample at every fix.

    So the scale factors stay what they were: within half of what is not known of them.
    """
    (tmp_path / "noisy.toml").write_text(_NOISY)
    (tmp_path / "cruise.toml").write_text(_CRUISE)
    flown = bench.read_profile(str(tmp_path / "cruise.toml"))
    truth = bench.fly(flown)
    for run in range(4):
        sensed = pipeline.sense(flown, truth, run)
        solution = load("loose-full", {}).run(sensed.data, sensed.initial)
        at = [solution.extra_names.index(f"gyro_scale_{axis}_1") for axis in "xyz"]
        assert (np.abs(solution.extra[-1, at]) < 0.5 * solution.extra_sd[-1, at]).all()
