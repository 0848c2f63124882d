"""The noise of an IMU at rest, found from a log by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.core.records.data import ImuData
from bench.evaluation.motion.recorded_motion import RecordedMotion
from bench.evaluation.motion.rest_noise import LEAST, measure_rest_noise, measure_vibration
from tests.exchange import drives


@pytest.fixture
def quiet(tmp_path):
    """A log whose datasheet has a twentieth of the noise."""
    path = drives.write_log(tmp_path)
    sheet = drives.IMU_SHEET.replace("0.011459", "0.00057").replace("204.0", "10.2")
    (tmp_path / "imu.toml").write_text(sheet)
    return path


def test_the_noise_is_that_of_the_drive_whatever_the_datasheet_says(quiet):
    """Of 17 s at rest and six axes the deviation is known to 12 %; 40 % is beyond three times that."""
    log = bench.read_log(quiet, tune_noise=True)
    imu = log.spec.assumed.imu
    assert imu.gyro.random_walk == pytest.approx(drives.GYRO_N, rel=0.4)
    assert imu.accel.random_walk == pytest.approx(drives.ACCEL_N, rel=0.4)
    (line,) = [check.text for check in log.checks if check.name == "rest_noise_ratio"]
    assert "times imu: assumed" in line
    assert bench.read_log(quiet).spec.assumed.imu.gyro.random_walk < 0.1 * drives.GYRO_N


def test_a_filter_told_so_is_no_longer_overconfident(quiet):
    plain, tuned = (bench.navigate(bench.read_log(quiet, tune_noise=on)) for on in (False, True))
    nees = [one.metrics["loose-15"]["nees_mean"] for one in (plain, tuned)]
    assert nees[0] > 2.0 * nees[1]
    assert tuned.metrics["loose-15"]["verdict"] == "consistent"


def test_a_larger_datasheet_stays_and_steps_do_not_count(tmp_path):
    path = drives.write_log(tmp_path)
    (tmp_path / "imu.toml").write_text(drives.IMU_SHEET.replace("0.011459", "1.0"))
    log = bench.read_log(path, tune_noise=True)
    assert log.spec.assumed.imu.gyro.random_walk == pytest.approx(np.deg2rad(1.0))
    assert any("which is assumed" in check.text for check in log.checks)
    spans = RecordedMotion.from_records(log.records.imu, log.records.fixes).find_standstills()
    imu = log.records.imu
    kicked = imu.dtheta_b.copy()
    kicked[(imu.t > 5.0) & (imu.t < 5.5)] += 1e-3  # a door
    usual, disturbed = (measure_rest_noise(one, spans)[0] for one in (imu, replace(imu, dtheta_b=kicked)))
    assert disturbed < 1.5 * usual


def test_without_a_standstill_the_datasheet_counts(quiet):
    log = bench.read_log(quiet)
    assert measure_rest_noise(log.records.imu, []) is None
    assert measure_rest_noise(log.records.imu, [(0.0, 0.9 * LEAST)]) is None


@pytest.mark.parametrize(("end", "enough"), [(20.9, False), (21.2, True)])
def test_half_a_second_at_each_end_of_a_standstill_does_not_count(end, enough):
    """Ten seconds are left of 11.2 and not of 10.9; white noise is then told to a third."""
    rng, rate = np.random.default_rng(3), 100.0
    t = np.arange(1, 4001) / rate
    steps = [size * rng.standard_normal((len(t), 3)) / np.sqrt(rate) for size in (1e-4, 1e-2)]
    steps[0][(t < 10.5) | (t > end - 0.5)] = 1.0
    imu = ImuData(t, np.full(len(t), 1.0 / rate), np.ones(len(t), np.bool_), *steps)
    found = measure_rest_noise(imu, [(10.0, end)])
    assert (found is not None) == enough
    if found is not None:
        assert found == pytest.approx((1e-4, 1e-2), rel=0.4)


def test_noise_from_sample_to_sample_is_that_of_the_seconds_with_the_engine_on():
    """White noise, five times as strong in the last 30 of 100 s, on a slow motion."""
    rng, rate, n = np.random.default_rng(7), 200.0, 20_000
    t = np.arange(1, n + 1) / rate
    engine = np.where(t > 70.0, 5.0, 1.0)[:, None]
    density = np.array([1e-4, 2e-4, 3e-4]), np.array([1e-2, 2e-2, 3e-2])
    slow = 0.5 * np.sin(0.3 * t)[:, None] / rate
    steps = [slow + engine * one * rng.standard_normal((n, 3)) / np.sqrt(rate) for one in density]
    imu = ImuData(t, np.full(n, 1.0 / rate), np.ones(n, np.bool_), *steps)
    for found, one in zip(measure_vibration(imu), density, strict=True):
        np.testing.assert_allclose(found, 5.0 * one, rtol=0.15)


def test_the_speed_over_ground_has_north_and_east():
    still = np.zeros((2, 3))
    vel_n = np.array([[3.0, 4.0, 7.0], [0.0, -2.0, 1.0]])
    motion = RecordedMotion(np.arange(2.0), still, still, np.arange(2.0), still, vel_n, 0.0)
    np.testing.assert_allclose(motion.speed, [5.0, 2.0])
