"""Filters under the tones of four rotors: 5 m/s^2 rms at the IMU, sampled at 8 kHz, folded at 200 Hz."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import band

LEGS = {
    "leg": [
        {"kind": "hover", "duration_s": 60.0},
        {"kind": "goto", "north_m": 30.0, "east_m": 5.0, "speed_mps": 6.0},
        {"kind": "goto", "north_m": 0.0, "east_m": 0.0, "speed_mps": 6.0},
        {"kind": "hover", "duration_s": 10.0},
    ],
    "fault": [],
    "sensors.gnss": "l1-code",
    "sensors.imu": "icm-42688-p",
}
TONES = {
    "rotor_accel_1_mg": 255.0,  # of each rotor; the four together 2 times as much
    "rotor_accel_2_mg": 245.0,
    "rotor_accel_4_mg": 70.0,
    "rotor_reference_rpm": 4500.0,
    "inner_rate_hz": 8000.0,
}


def shaken(**figures: float):
    named = {f"sensors.imu.vibration.{key}": value for key, value in (TONES | figures).items()}
    return read_profile("inspection", LEGS | named)


def test_the_aircraft_gives_arms_and_radii_that_the_unit_leaves_open():
    """By hand: 0.17 m at 45 deg; roots of 3.65, 3.68 and 7.03 g m^2 over 0.5 kg."""
    found = shaken(gyration_z_m=0.2, imu_down_m=0.03).sensors.imu.vibration
    assert (found.rotor_forward, found.rotor_right) == pytest.approx((0.120208, 0.120208), rel=1e-5)
    assert (found.gyration_x, found.gyration_y) == pytest.approx((0.0854400, 0.0857904), rel=1e-5)
    assert (found.gyration_z, found.rotor_up, found.imu_down) == (0.2, 0.0, 0.03)


def test_wings_have_no_rotors_to_shake_an_imu():
    named = {f"sensors.imu.vibration.{key}": value for key, value in TONES.items()}
    with pytest.raises(
        ConfigError, match="rotor_accel needs the speeds of four rotors; this is no multirotor"
    ):
        read_profile("approach", named)
    with pytest.raises(ConfigError, match="inner_rate_hz has no effect without another vibration"):
        read_profile("approach", {"sensors.imu.vibration.inner_rate_hz": 4000.0})
    with pytest.raises(ConfigError, match="inner_rate_hz = 300 Hz must be a multiple of rate_hz = 200 Hz"):
        shaken(inner_rate_hz=300.0)


def test_the_verdict_names_vibration_as_an_error_without_a_state():
    full = load("loose-full", {})
    assert "vibration" in full.unmodeled_errors(shaken().sensors.assumed)
    assert "vibration" not in full.unmodeled_errors(read_profile("inspection", LEGS).sensors.assumed)


@pytest.mark.slow
def test_tones_of_5_mps2_leave_the_standard_filter_consistent_and_clipped_ones_do_not():
    """20 runs, 99.9 % of chi-squared at 60 s and at the end. Peaks beyond a range of 2 g shift the mean."""
    profile, clipped = shaken(), shaken(rotor_accel_2_mg=490.0)
    truth = bench.fly(profile)
    narrow = replace(clipped.sensors.imu, accel=replace(clipped.sensors.imu.accel, range=2 * 9.80665))

    def run(unit, number):
        spec = replace(profile.sensors, imu=unit, output_rate=0.1)
        drawn = sensors.sense(truth, spec, 7, number)
        try:
            solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        except EstimatorError:
            return drawn.data.imu, np.full(2, np.inf)
        errors = error_series(truth, solution)
        return drawn.data.imu, errors.nees[[np.searchsorted(errors.t, 59.9), -1]]

    records, nees = zip(*(run(profile.sensors.imu, number) for number in range(20)), strict=True)
    level = np.mean([record.dvel_b[4000:10_000, :2].std(axis=0) * 200.0 for record in records], axis=0)
    assert 4.0 < level.min() < level.max() < 5.0  # folded: 5 m/s^2 at 75 Hz by sinc(0.375) and the maneuvers
    low, high = band(9 * 20)
    mean = np.mean(nees, axis=0)
    assert 9 * low < mean.min(), mean
    assert mean.max() < 9 * high, mean
    found = [run(narrow, number)[1] for number in range(4)]
    assert not max(np.nan_to_num(one, nan=np.inf).max() for one in found) < 9 * band(9)[1]
