"""The radar altimeter: height above the runway, a bias, white noise, and where it sees no ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.records.instruments import RadarSpec
from bench.simulation.sensors import radar
from bench.simulation.sensors.draws import SensorDraws
from tests.synthetic import ORIGIN, still

GROUND = ORIGIN[2] - 50.0
EXACT = RadarSpec("exact", rate=10.0, white_sd=0.0, range=500.0)


@pytest.fixture(scope="module")
def rest():
    return still(200.0, 100.0, attitude=(0.1, -0.1, 2.0))


def climbing(rest):
    return replace(rest, lla=np.column_stack([rest.lla[:, :2], GROUND + 5.0 * rest.t]))


def test_without_errors_it_reads_the_height_above_the_runway(rest):
    record, bias = radar.measure(climbing(rest), EXACT, GROUND, SensorDraws(1, 0))
    assert_allclose(record.t, np.arange(1, 2001) / 10.0, atol=1e-9)
    assert_allclose(record.height, 5.0 * record.t, rtol=0, atol=1e-6)
    assert not bias.any()


def test_a_sample_outside_its_range_or_tilted_beyond_its_beam_is_flagged(rest):
    record, _ = radar.measure(climbing(rest), replace(EXACT, min_height=1.4), GROUND, SensorDraws(1, 0))
    assert_array_equal(record.valid, (record.height >= 1.4 - 1e-9) & (record.height <= 500.0 + 1e-9))
    tilt = np.arccos(np.cos(0.1) * np.cos(0.1))  # of roll 0.1 and pitch -0.1
    for limit, seen in ((tilt + 1e-6, True), (tilt - 1e-6, False)):
        record, _ = radar.measure(rest, replace(EXACT, max_tilt=limit), GROUND, SensorDraws(1, 0))
        assert record.valid.all() == record.valid.any() == seen


def test_bias_and_noise_have_the_sizes_of_the_datasheet(rest):
    """Bands of 99.9 %: 3.29 standard errors of a mean of squares."""
    spec = replace(EXACT, white_sd=0.4, bias_sd=0.5)
    draws = [radar.measure(rest, spec, GROUND, SensorDraws(1, run)) for run in range(400)]
    bias = np.array([b[0] for _, b in draws])
    assert abs(np.mean(bias**2) / 0.25 - 1.0) < 3.29 * np.sqrt(2 / len(bias))
    record, one = draws[0]
    assert (one == one[0]).all()
    white = record.height - 50.0 - one
    assert abs(np.mean(white**2) / 0.16 - 1.0) < 3.29 * np.sqrt(2 / len(white))
    assert (record.sd == 0.4).all()


def test_it_is_rounded_late_and_no_faster_than_the_truth(rest):
    record, _ = radar.measure(
        rest, replace(EXACT, quantization=0.25, latency=0.02), GROUND + 0.1, SensorDraws(1, 0)
    )
    assert (record.height == 50.0).all()
    assert_allclose(record.t_arrival - record.t, 0.02, atol=1e-12)
    with pytest.raises(ValueError, match="radar: rate 200 Hz is above the 100 Hz of the truth"):
        radar.measure(rest, replace(EXACT, rate=200.0), GROUND, SensorDraws(1, 0))
