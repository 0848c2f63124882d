"""A recording as its checks see it, row by row."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth
from bench.core.records.data import GnssFixes, ImuData
from bench.evaluation.motion.motion_noise import assume_motion_noise, measure_motion_noise
from bench.evaluation.motion.recorded_motion import RecordedMotion
from bench.evaluation.motion.rest_noise import assume_noise, measure_rest_noise, measure_vibration
from tests.weaving import IMU

NONE = np.empty((0, 3))


def make_imu(t, dt, gyro, accel, valid=None):
    rows = np.ones(len(t), np.bool_) if valid is None else valid
    return ImuData(t, np.full(len(t), dt), rows, gyro * dt, accel * dt)


def make_fixes(t, lla, vel_n, valid=None):
    rows = np.ones(len(t), np.bool_) if valid is None else valid
    cov = np.tile(np.eye(3), (len(t), 1, 1))
    return GnssFixes(t, t, rows, lla, vel_n, cov, cov, np.full(len(t), 9))


def test_samples_are_averaged_over_20_ms_without_those_that_are_not_sound():
    """At 200 Hz four by four. One row is flagged, one is damage, two go back in time; six are left over."""
    t = np.arange(1, 31) / 200.0
    t[[9, 10]] = t[[4, 8]]
    gyro = np.outer(np.arange(30.0), [1.0, -2.0, 0.5])
    accel = np.outer(np.arange(30.0), [3.0, 1.0, 9.0])
    accel[20] = 2e5
    valid = np.arange(30) != 2
    fix_t = np.array([1.0, 2.0, 1.5, 3.0, 4.0])
    vel_n = np.outer(np.arange(5.0), [1.0, 0.0, 0.0])
    vel_n[4] = 2e5
    found = RecordedMotion.from_records(
        make_imu(t, 0.005, gyro, accel, valid), make_fixes(fix_t, np.zeros((5, 3)), vel_n)
    )
    kept = [k for k in range(30) if k not in (2, 9, 10, 20)][:24]
    assert_allclose(found.t, t[kept[3::4]])
    assert_allclose(found.gyro, gyro[kept].reshape(6, 4, 3).mean(axis=1))
    assert_allclose(found.accel, accel[kept].reshape(6, 4, 3).mean(axis=1))
    assert found.fix_t.tolist() == [1.0, 2.0, 3.0]
    assert_allclose(found.vel_n[:, 0], [0.0, 1.0, 3.0])
    assert found.most_rate == pytest.approx(58.0)
    slow = RecordedMotion.from_records(make_imu(8.0 * t, 0.04, gyro, accel), make_fixes(fix_t, vel_n, vel_n))
    assert len(slow.t) == 27
    one = RecordedMotion.from_records(
        make_imu(t[:1], 0.005, gyro[:1], accel[:1]), make_fixes(fix_t, vel_n, vel_n)
    )
    assert len(one.t) == 1


def moving(vel_n, t=None, lla=None):
    t = np.arange(float(len(vel_n))) if t is None else t
    lla = np.zeros((len(vel_n), 3)) if lla is None else lla
    return RecordedMotion(np.empty(0), NONE, NONE, t, lla, vel_n, 0.0)


def test_a_vehicle_moves_if_five_fixes_agree():
    speed = np.zeros((12, 3))
    speed[3:5, 0] = 9.0
    assert not moving(speed).moves
    speed[5, 0] = 9.0
    assert moving(speed).moves
    assert moving(np.full((5, 3), 0.24)).moves
    assert not moving(np.full((5, 3), 0.22)).moves
    assert not moving(np.full((4, 3), 9.0)).moves


def test_standstills_last_two_seconds_of_fixes_below_a_fifth_of_a_meter_per_second():
    speed = np.array([0.0, 0.19, 0.19, 0.21, 0.0, 0.1, 0.3, 0.0, 0.0, 0.0, 0.1])
    vel_n = np.column_stack([0.6 * speed, 0.8 * speed, 5.0 + 0.0 * speed])
    assert moving(vel_n).find_standstills() == [(0.0, 2.0), (7.0, 10.0)]


def test_without_velocities_in_half_of_the_fixes_those_between_positions_count():
    """Ten meters north and twenty east a second; a pause of three seconds is no step."""
    t = np.array([0.0, 1.0, 2.0, 3.0, 6.0, 7.0])
    lla = earth.displace(np.tile([0.7, 0.3, 50.0], (6, 1)), np.outer(t, [10.0, 20.0, -1.0]))
    vel_n = np.tile([10.0, 20.0, -1.0], (6, 1))
    vel_n[3:, 1] = np.nan
    at, places, found = moving(vel_n, t, lla).take_velocities()
    assert at.tolist() == [0.0, 1.0, 2.0]
    assert_allclose((places, found), (lla[:3], vel_n[:3]))
    vel_n[2] = np.nan
    at, places, found = moving(vel_n, t, lla).take_velocities()
    assert at.tolist() == [0.5, 1.5, 2.5, 6.5]
    assert_allclose(places, lla[[0, 1, 2, 4]])
    assert_allclose(found, np.tile([10.0, 20.0, -1.0], (4, 1)), atol=2e-3)


def white(seconds, rate, seed=3, density=(2e-4, 3e-2)):
    random, n = np.random.default_rng(seed), round(seconds * rate)
    t = np.arange(1, n + 1) / rate
    rates = [size * np.sqrt(rate) * random.standard_normal((n, 3)) for size in density]
    return make_imu(t, 1.0 / rate, *rates)


def test_noise_at_rest_is_the_median_of_second_differences_over_a_second():
    """Eight begin in a second; half a second at each end is left out, and a rest of less than 3 s."""
    imu = white(40.0, 100.0)
    found = measure_rest_noise(imu, [(2.0, 16.0), (20.0, 23.0), (30.0, 32.9)])
    sums = np.cumsum(np.hstack([imu.dtheta_b, imu.dvel_b]), axis=0)
    apart = []
    for begin, end in ((2.5, 15.5), (20.5, 22.5)):
        for at in np.arange(begin, end - 2.0 - 1e-9, 0.125):
            if end - begin > 2.1:
                a, b, c = (np.array([np.interp(at + k, imu.t, one) for one in sums.T]) for k in range(3))
                apart.append(c - 2.0 * b + a)
    noise = 1.4826 * np.median(np.abs(apart), axis=0) / np.sqrt(2.0)
    expected = [np.sqrt(np.mean(noise[k : k + 3] ** 2)) for k in (0, 3)]
    assert found == pytest.approx(expected, rel=0.02)
    assert measure_rest_noise(imu, [(2.0, 12.9)]) is None


def test_noise_of_neighbors_is_the_90_percent_quantile_of_its_seconds():
    imu = white(12.5, 40.0)
    for found, increments in zip(measure_vibration(imu), (imu.dtheta_b, imu.dvel_b), strict=True):
        rate = increments * 40.0
        bend = np.diff(rate, 2, axis=0)[:480].reshape(12, 40, 3)
        expected = np.sqrt(np.quantile(np.mean(bend**2, axis=1), 0.9, axis=0) / 6.0 / 40.0)
        assert_allclose(found, expected)
    short = replace(
        imu, **{name: getattr(imu, name)[:30] for name in ("t", "dt", "valid", "dtheta_b", "dvel_b")}
    )
    assert_allclose(measure_vibration(short), np.zeros((2, 3)))


def test_noise_in_motion_is_the_median_of_three_bands_of_windowed_spectra():
    """Stretches of 4 s without the standstill from 9 to 10 s, by a plain Fourier sum less a fitted line."""
    imu = white(60.0, 50.0)
    found = measure_motion_noise(imu, [(9.0, 10.0)])
    w, n, total = np.hanning(201)[:200], np.arange(200), []
    for first in range(0, 3000, 200):
        if first == 400:
            continue
        x = np.hstack([imu.dtheta_b, imu.dvel_b])[first : first + 200] * 50.0
        line = np.polynomial.polynomial.polyfit(n, x, 1)
        x = x - line[0] - n[:, None] * line[1]
        power = {}
        for k in range(12, 40):
            power[k] = np.abs(np.exp(-2j * np.pi * k * n / 200) @ (w[:, None] * x)) ** 2 / 50.0 / np.sum(w**2)
        total.append(
            [np.mean([power[k] for k in range(a, b)], axis=0) for a, b in ((12, 20), (20, 28), (28, 40))]
        )
    floor = np.median(np.mean(total, axis=0), axis=0)
    assert found == pytest.approx([np.sqrt(np.mean(floor[k : k + 3])) for k in (0, 3)])
    assert measure_motion_noise(imu, [(9.0, 10.0), (20.5, 41.0)]) is None
    assert measure_motion_noise(white(44.0, 50.0), [(1.0, 2.0)]) is not None


@pytest.mark.parametrize(("times", "said"), [(3.0, "assumed"), (0.5, "which is assumed")])
def test_the_larger_noise_is_assumed_and_told_by_triad(times, said):
    noise = times * IMU.gyro.random_walk, 2.0 * IMU.accel.random_walk
    spec, told = assume_noise(IMU, noise, "x_ratio", "noise so", "; more")
    assert spec.gyro.random_walk == pytest.approx(max(times, 1.0) * IMU.gyro.random_walk)
    assert spec.accel.random_walk == pytest.approx(2.0 * IMU.accel.random_walk)
    assert (told.name, told.value, told.good) == ("x_ratio", pytest.approx(max(times, 2.0)), True)
    assert told.text.startswith("imu: noise so: gyro ")
    assert f"{times:g} times {IMU.name}: " in told.text
    assert said in told.text.partition("accel")[0]
    assert told.text.endswith(f"2 times {IMU.name}: assumed; more")
    quiet = replace(IMU, gyro=replace(IMU.gyro, random_walk=0.0))
    assert assume_noise(quiet, noise, "x_ratio", "noise so")[1].value == np.inf
    kept, line = assume_motion_noise(IMU, white(10.0, 50.0), [])
    assert kept is IMU
    assert "less than 40 s of whole motion" in line.text


def test_one_fix_without_velocity_shows_no_motion():
    one = moving(np.full((1, 3), np.nan), np.zeros(1), np.array([[0.7, 0.3, 50.0]]))
    assert [len(part) for part in one.take_velocities()] == [0, 0, 0]
    assert not one.moves


def test_without_velocities_positions_show_a_standstill():
    """10 s at 1 m/s, then 20 s at rest, positions to 1.5 cm at 10 Hz; code positions to 1 m show none."""
    t, none = np.arange(0.0, 30.0, 0.1), np.empty((0, 3))
    north = np.minimum(t, 10.0)
    for sd, found in ((0.015, 1), (1.0, 0)):
        noise = sd * np.random.default_rng(4).standard_normal((len(t), 3))
        lla = earth.displace(
            np.tile([0.8, 0.2, 100.0], (len(t), 1)), np.outer(north, [1.0, 0.0, 0.0]) + noise
        )
        motion = RecordedMotion(np.empty(0), none, none, t, lla, np.full((len(t), 3), np.nan), 0.0)
        long = [span for span in motion.find_standstills() if span[1] - span[0] > 10.0]
        assert len(long) == found
        for begin, end in long:
            assert begin == pytest.approx(10.5, abs=1.2)
            assert end > 28.5


@pytest.mark.parametrize("count", [6, 7, 12])
def test_a_few_positions_show_no_standstill_of_two_seconds(count):
    t, none = np.arange(count) / 10.0, np.empty((0, 3))
    lla = np.tile([0.8, 0.2, 100.0], (count, 1))
    motion = RecordedMotion(np.empty(0), none, none, t, lla, np.full((count, 3), np.nan), 0.0)
    assert motion.find_standstills() == []
