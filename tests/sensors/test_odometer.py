"""The odometer: forward speed over ground, a scale factor, white noise, and a wheel off the ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.records.instruments import OdometerSpec
from bench.simulation.sensors import odometer
from bench.simulation.sensors.draws import SensorDraws
from tests.synthetic import turning

EXACT = OdometerSpec("exact", rate=10.0, white_sd=0.0)


@pytest.fixture(scope="module")
def turn():
    """25 m/s along the nose, banked."""
    return turning(100.0, 100.0)


def test_without_errors_it_reads_the_speed_along_the_nose(turn):
    record, error = odometer.measure(turn, EXACT, np.inf, SensorDraws(1, 0))
    assert_allclose(record.speed, 25.0, rtol=0, atol=1e-9)
    assert record.valid.all()
    assert not error.any()
    backwards = odometer.measure(replace(turn, vel_n=-turn.vel_n), EXACT, np.inf, SensorDraws(1, 0))[0]
    assert_allclose(backwards.speed, -25.0, rtol=0, atol=1e-9)


def test_a_wheel_off_the_ground_is_flagged(turn):
    climbing = replace(turn, lla=turn.lla + np.outer(turn.t, [0.0, 0.0, 1.0]))
    highest = turn.lla[0, 2] + 30.0
    record, _ = odometer.measure(climbing, EXACT, highest, SensorDraws(1, 0))
    rows = np.searchsorted(climbing.t, record.t - 1e-6)
    assert_array_equal(record.valid, climbing.lla[rows, 2] <= highest)
    assert 0.2 < record.valid.mean() < 0.4


def test_scale_factor_and_noise_have_the_sizes_of_the_datasheet(turn):
    """Bands of 99.9 %: 3.29 standard errors of a mean of squares."""
    spec = replace(EXACT, white_sd=0.05, scale_factor_sd=0.02)
    draws = [odometer.measure(turn, spec, np.inf, SensorDraws(1, run)) for run in range(400)]
    scale = np.array([error[0] for _, error in draws]) / 25.0
    assert abs(np.mean(scale**2) / 4e-4 - 1.0) < 3.29 * np.sqrt(2 / len(scale))
    record, error = draws[0]
    white = record.speed - 25.0 - error
    assert abs(np.mean(white**2) / 0.0025 - 1.0) < 3.29 * np.sqrt(2 / len(white))
    assert (record.sd == 0.05).all()


def test_it_is_rounded_and_late(turn):
    record, _ = odometer.measure(
        turn, replace(EXACT, quantization=2.0, latency=0.02), np.inf, SensorDraws(1, 0)
    )
    assert np.isin(record.speed, [24.0, 26.0]).all()
    assert_allclose(record.t_arrival - record.t, 0.02, atol=1e-12)
