"""What counts as a standstill: noise no more than the unit's own, means of gravity and the Earth's rotation.

Noise goes up and down by one size, so that its sd and every limit are numbers that can be worked out.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.records.data import ImuData
from bench.core.records.sensor_specs import ImuSpec, TriadSpec, VibrationSpec
from bench.navigation.error_state_filter.standstill import StandstillDetector
from bench.navigation.error_state_filter.vehicle_motion import VehicleSampler
from tests.builders import take

DT, G = 0.01, 9.7803253359  # gravity at the equator [m/s^2]
IMU = ImuSpec(
    "by-hand",
    # noise of a sample: 3, 4 and 12 mrad/s make 13; bias: 3e-4 and 4e-4 rad/s make 5e-4
    TriadSpec(
        random_walk=3e-4, quantization=4e-5 * np.sqrt(6.0), turn_on_bias_sd=3e-4,
        bias_instability=0.617 * 4e-4, g_sensitivity_sd=1e-5,
    ),
    TriadSpec(
        random_walk=3e-3, quantization=4e-4 * np.sqrt(6.0), turn_on_bias_sd=0.03,
        bias_instability=0.617 * 0.04, scale_factor_sd=2e-3,
    ),
    vibration=VibrationSpec(engine_gyro=0.012, engine_accel=0.12),
)  # fmt: skip
RATE_LIMIT = 7.292115e-5 + 4.0 * (5e-4 + 2e-5 + 1e-5 * G)
FORCE_LIMIT = 0.06 + 4.0 * (0.05 + 2e-3 * G)


def record(rate_noise=0.0, force_noise=0.0, rate=0.0, force=G, count=200, dt=DT, axis=0):
    """Samples of a unit whose rate and force are given on one axis, gravity always along it, too."""
    noise = np.where(np.arange(count) % 2, 1.0, -1.0)
    turn, push = np.zeros((count, 3)), np.zeros((count, 3))
    turn[:, axis], push[:, axis] = rate + rate_noise * noise, force + force_noise * noise
    t = dt * np.arange(1, count + 1)
    return ImuData(t, np.full(count, dt), t > 0, turn * dt, push * dt)


def is_still(imu, **options):
    return len(StandstillDetector(0.0, IMU, **options).take(imu)[0]) == 2


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("rate_noise", 1.5 * 0.013),
        ("force_noise", 1.5 * 0.13),
        ("rate", RATE_LIMIT),
        ("rate", -RATE_LIMIT),
        ("force", G + FORCE_LIMIT),
        ("force", -G - FORCE_LIMIT),
    ],
)
def test_each_limit_is_where_the_datasheet_puts_it(name, limit):
    for axis in range(3):
        assert is_still(record(**{name: limit - np.sign(limit) * 1e-3 * abs(limit)}, axis=axis))
        assert not is_still(record(**{name: limit + np.sign(limit) * 1e-3 * abs(limit)}, axis=axis))
    assert is_still(record(force=G - 0.999 * FORCE_LIMIT))
    assert not is_still(record(force=G - 1.001 * FORCE_LIMIT))


def test_by_its_gyros_a_unit_may_be_shaken_but_neither_turns_nor_swings():
    """A swing may change its mean by 0.3 of its sd from one half of a window to the other."""
    assert is_still(record(force_noise=1.0), gyro_sd=1e-4)
    assert is_still(record(rate_noise=1.0), gyro_sd=1e-4)
    assert not is_still(record(rate_noise=1.0))
    assert not is_still(record(force=G + 1.0), gyro_sd=1e-4)
    limit = 7.292115e-5 + 4.0 * (1e-4 + 2e-5)
    assert is_still(record(rate=0.999 * limit), gyro_sd=1e-4)
    assert not is_still(record(rate=1.001 * limit), gyro_sd=1e-4)
    shaken = record(rate_noise=1.0)
    half = np.where(np.arange(200) % 100 < 50, 1.0, -1.0)[:, None] * DT
    for change, still in ((0.148, True), (0.155, False)):  # 2 x / sqrt(1 + x^2) < 0.3
        swung = replace(shaken, dtheta_b=shaken.dtheta_b + change * half * [1.0, 0.0, 0.0])
        assert is_still(swung, gyro_sd=1e-4) == still


def test_a_window_has_no_gap_and_four_samples():
    """Their epochs may be off by up to half an interval."""
    imu = record()
    assert is_still(imu)
    assert not is_still(take(imu, np.delete(np.arange(200), 150)))
    for late, still in ((0.45, True), (0.55, False)):
        t = imu.t.copy()
        t[99] += late * DT
        assert is_still(replace(imu, t=t)) == still
    assert is_still(record(count=8, dt=0.25))
    assert not is_still(record(count=6, dt=1.0 / 3.0))


def test_it_says_what_was_measured_and_how_well_that_is_zero_and_the_earth_and_goes_on_in_pieces():
    imu = record(rate=2e-4, force=9.8, count=350)
    t, values, variance = StandstillDetector(0.0, IMU).take(imu)
    assert_allclose(t, [1.0, 2.0, 3.0])
    assert_allclose(values, np.tile([2e-4, 0, 0, 9.8, 0, 0], (3, 1)))
    assert_allclose(variance, np.repeat([0.02**2, 3e-4**2 + 2e-5**2], 3))
    pieces = StandstillDetector(0.0, IMU)
    found = [pieces.take(take(imu, rows))[1] for rows in np.split(np.arange(350), [30, 150, 160])]
    assert [len(one) for one in found] == [0, 1, 0, 2]
    assert_allclose(np.vstack([one for one in found if len(one)]), values)


@pytest.mark.parametrize(("flying", "interval", "sd"), [(False, 0.2, 0.05), (True, 1.0, 0.3)])
def test_a_vehicle_is_sampled_with_the_mean_motion_before(flying, interval, sd):
    """Rate and force over 0.1 s, what leans over 0.5 s: forward, and sideways by the 1.5 m/s^2 at which tyres
    slip twice as much; of wings, the load beyond 1 g."""
    count = 300
    turn, push = np.random.default_rng(3).normal(size=(2, count, 3))
    t = DT * np.arange(1, count + 1)
    imu = ImuData(t, np.full(count, DT), t > 0, turn * DT, push * DT)
    ends, values, variance = VehicleSampler(0.0, flying=flying).take(imu)
    assert_allclose(ends, interval * np.arange(1, len(ends) + 1))
    assert ends[-1] == pytest.approx(3.0)
    assert_allclose(variance, np.full(6, sd**2))
    last, lean = slice(-10, None), push[-50:].mean(axis=0)
    leaning = [lean[2] + 9.80665, 0.0] if flying else [lean[0], lean[1] / 1.5]
    assert_allclose(values[-1], [*turn[last].mean(axis=0), *push[last].mean(axis=0), *leaning])
