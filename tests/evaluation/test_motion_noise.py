"""The noise of an IMU in motion: found as it is, and what a filter reports that is told of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

import bench
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.motion import motion_noise
from bench.evaluation.motion.motion_noise import BANDS, LEAST, assume_motion_noise, measure_motion_noise
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import take
from tests.exchange import drives
from tests.weaving import IMU, units, weaving

RATE = 100.0
CORNER = 25.0  # of the shaking [Hz]
TIMES = 20.0  # as much noise as the datasheet has, at low frequencies
LENGTH, CUTS = 300.0, (90.0, 170.0, 230.0)


@pytest.fixture(scope="module")
def truth():
    return weaving(LENGTH, rate=RATE)


def shaken(imu, seed, times=TIMES, line=0.0, at=31.0):
    """Return samples with a shaking of a corner frequency, and with a line of an engine [times] at [Hz]."""
    random, n = np.random.default_rng(seed), len(imu)
    keep, t = np.exp(-2 * np.pi * CORNER / RATE), imu.t[:, None]
    white = random.standard_normal((n, 6))
    noise = lfilter([1.0 - keep], [1.0, -keep], white, axis=0)  # at low frequencies as dense as the white
    noise += line * np.cos(2 * np.pi * at * t + np.arange(6))
    size = times / np.sqrt(RATE)
    gyro, accel = size * IMU.gyro.random_walk, size * IMU.accel.random_walk
    return replace(imu, dtheta_b=imu.dtheta_b + gyro * noise[:, :3], dvel_b=imu.dvel_b + accel * noise[:, 3:])


def test_the_density_of_shaking_is_found_beside_the_motion_and_a_line(truth):
    """Within 15 % of the density at 6 Hz; six axes and 75 spectra know it to 2 %."""
    imu = sensors.sense(truth, units(), 3, 0).data.imu
    plain = measure_motion_noise(imu, [])
    assert plain[0] == pytest.approx(IMU.gyro.random_walk, rel=0.1)
    assert plain[1] == pytest.approx(IMU.accel.random_walk, rel=0.1)
    wanted = np.hypot(TIMES / np.sqrt(1.0 + (6.0 / CORNER) ** 2), 1.0)
    for line, at in ((0.0, 31.0), (30.0, 31.0), (30.0, 4.0), (30.0, 8.0)):  # the last two inside of a band
        gyro, accel = measure_motion_noise(shaken(imu, 5, line=line, at=at), [])
        assert gyro / IMU.gyro.random_walk == pytest.approx(wanted, rel=0.15)
        assert accel / IMU.accel.random_walk == pytest.approx(wanted, rel=0.15)


def test_standstills_gaps_and_slow_samples_do_not_count(truth):
    imu = sensors.sense(truth, units(), 3, 0).data.imu
    assert measure_motion_noise(imu, [(0.0, LENGTH - 0.9 * LEAST)]) is None
    kept = imu.t % 3.0 > 0.5  # no whole segment is left
    gappy = take(imu, kept)
    assert measure_motion_noise(gappy, []) is None
    slow = replace(imu, dt=imu.dt * (RATE / (1.9 * BANDS[0][1])))
    assert measure_motion_noise(slow, []) is None
    spec, line = assume_motion_noise(IMU, gappy, [])
    assert spec is IMU
    assert "the assumed noise is from weaving-mems" in line.text


def ratios(truth, duration, told):
    """Return the squared horizontal error over its covariance at the end of cuts, of twelve runs."""
    found = []
    for run in range(12):
        cuts = tuple((start, start + duration) for start in CUTS)
        drawn = sensors.sense(truth, replace(units(), gnss_outages=cuts, output_rate=1.0), 7, run)
        imu = shaken(drawn.data.imu, run)
        specs = drawn.data.specs
        if told:
            specs = replace(specs, imu=assume_motion_noise(specs.imu, imu, [])[0])
        solution = load("loose-15", {}).run(replace(drawn.data, imu=imu, specs=specs), drawn.initial)
        series = error_series(truth, solution)
        for start in CUTS:
            k = int(np.searchsorted(solution.t, start + duration - 1e-6)) - 1
            e = series.pos_n[k, :2]
            found.append(e @ np.linalg.solve(solution.cov[k, :2, :2], e))
    return np.array(found)


@pytest.mark.parametrize("duration", [10.0, 30.0, 60.0])
def test_shaking_that_the_datasheet_leaves_out_is_claimed_in_cuts(truth, duration):
    """36 cuts: 2 is right, 1.3 to 3 is asked for; told the datasheet alone a filter reports far too much."""
    assert 1.3 < ratios(truth, duration, told=True).mean() < 3.0
    assert ratios(truth, duration, told=False).mean() > 5.0


def test_a_log_takes_it_by_option_and_says_so(tmp_path):
    path = drives.write_log(tmp_path)
    sheet = drives.IMU_SHEET.replace("0.011459", "0.00057").replace("204.0", "10.2")
    (tmp_path / "imu.toml").write_text(sheet)
    log = bench.read_log(path, motion_noise=True)
    (line,) = [check.text for check in log.checks if check.name == "motion_noise_ratio"]
    assert line.startswith("imu: noise in motion, 3 to 10 Hz: gyro ")
    assert "times imu: assumed" in line
    assert log.spec.assumed.imu.gyro.random_walk > 0.7 * drives.GYRO_N


def test_a_level_and_a_trend_are_no_noise():
    """Of a sample the power of its scatter alone, whatever it stands on."""
    rng, window = np.random.default_rng(1), np.hanning(201)[:200, None]
    scatter = rng.standard_normal((200, 6))
    leaning = scatter + 50.0 + 30.0 * np.linspace(-1.0, 1.0, 200)[:, None]
    plain, found = (motion_noise.spectrum(one, window, 0.01) for one in (scatter, leaning))
    np.testing.assert_allclose(found, plain, rtol=1e-8, atol=1e-12)
    assert plain[5:].mean() == pytest.approx(0.01, rel=0.2)  # white, two-sided: variance times the step
