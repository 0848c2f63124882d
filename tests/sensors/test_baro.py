"""The barometer: height plus a bias that walks plus white noise, rounded to its least bit.

Statistical bounds are two-sided 99.9 % bands of the statistic itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.records.instruments import BaroSpec
from bench.simulation.sensors import baro
from bench.simulation.sensors.draws import SensorDraws
from tests.builders import band
from tests.sensors.given_numbers import respond
from tests.synthetic import ORIGIN, still

OFF = BaroSpec("off", rate=5.0, white_sd=0.0, bias_sd=0.0, bias_walk=0.0)
FULL = BaroSpec("full", rate=5.0, white_sd=0.5, bias_sd=3.0, bias_walk=0.05)


@pytest.fixture(scope="module")
def rest():
    return still(600.0, 100.0)


def test_without_errors_it_reads_the_ellipsoidal_height(rest):
    climbing = replace(rest, lla=np.column_stack([rest.lla[:, :2], 1200.0 + 2.0 * rest.t]))
    record, bias = baro.measure(climbing, OFF, SensorDraws(1, 0))
    assert_allclose(record.t, np.arange(1, 3001) / 5.0, atol=1e-9)
    assert_allclose(record.alt_baro, 1200.0 + 2.0 * record.t, rtol=0, atol=1e-9)
    assert record.valid.all()
    assert not bias.any()


@pytest.mark.parametrize("figure", ["white_sd", "bias_sd", "bias_walk"])
def test_doubling_a_figure_doubles_its_own_error_and_no_other(rest, figure):
    value = getattr(FULL, figure)
    alone = baro.measure(rest, replace(OFF, **{figure: value}), SensorDraws(1, 0))[0].alt_baro - ORIGIN[2]
    doubled = (
        baro.measure(rest, replace(OFF, **{figure: 2 * value}), SensorDraws(1, 0))[0].alt_baro - ORIGIN[2]
    )
    assert alone.std() > 0 or figure == "bias_sd"
    assert np.abs(alone).max() > 0
    assert_allclose(doubled, 2 * alone, rtol=0, atol=1e-9)
    before = baro.measure(rest, FULL, SensorDraws(1, 0))[0].alt_baro
    after = baro.measure(rest, replace(FULL, **{figure: 2 * value}), SensorDraws(1, 0))[0].alt_baro
    assert_allclose(after - before, alone, rtol=0, atol=1e-9)


def test_the_bias_reported_is_the_bias_applied(rest):
    record, bias = baro.measure(rest, FULL, SensorDraws(1, 0))
    white = baro.measure(rest, replace(OFF, white_sd=0.5), SensorDraws(1, 0))[0].alt_baro - ORIGIN[2]
    assert_allclose(record.alt_baro, ORIGIN[2] + bias + white, rtol=0, atol=1e-9)
    low, high = band(len(white))
    assert low < np.mean(white**2) / 0.5**2 < high
    assert_array_equal(record.sd, 0.5)


@pytest.mark.parametrize("rate", [1 / 60, 1 / 600])
def test_bias_after_an_hour(rate):
    """Equations #24: sd(1 h) = sqrt(sd_0^2 + 3600 walk^2), by each of its numbers alone."""
    truth, walks = still(3600.0, rate), replace(OFF, rate=rate, bias_walk=0.05)
    walked = respond("baro.walk", round(3600 * rate), lambda draws: baro.measure(truth, walks, draws)[1])
    t = truth.t[1:]
    assert_allclose(walked @ walked.T, 0.05**2 * np.minimum.outer(t, t), rtol=1e-12)
    assert (walked >= 0).all()
    stays = replace(OFF, rate=rate, bias_sd=3.0)
    assert_allclose(respond("baro.bias", 1, lambda draws: baro.measure(truth, stays, draws)[1]), 3.0)


def test_the_bias_walks_from_the_start_of_the_truth(rest):
    """The first epoch of a quarter of the rate is four times as far: with the same number, twice the step."""
    first = [
        baro.measure(rest, replace(OFF, rate=rate, bias_walk=0.05), SensorDraws(1, 0))[1][0]
        for rate in (4.0, 1.0)
    ]
    assert_allclose(first[1] / first[0], 2.0, rtol=1e-9)


def test_the_least_bit_rounds_and_doubling_it_rounds_twice_as_coarsely(rest):
    exact = baro.measure(rest, FULL, SensorDraws(1, 0))[0].alt_baro
    spread = []
    for lsb in (0.1, 0.2):
        rounded = baro.measure(rest, replace(FULL, quantization=lsb), SensorDraws(1, 0))[0].alt_baro
        assert_allclose(rounded / lsb, np.rint(rounded / lsb), rtol=0, atol=1e-9)
        assert np.abs(rounded - exact).max() <= 0.5 * lsb * (1 + 1e-9)
        spread.append(np.std(rounded - exact) / (lsb / np.sqrt(12)))
    assert_allclose(spread, 1.0, atol=3.29 * np.sqrt(0.8 / len(exact)) / 2)


def test_rate_and_latency(rest):
    for rate in (5.0, 10.0):
        for latency in (0.1, 0.2):
            record = baro.measure(rest, replace(FULL, rate=rate, latency=latency), SensorDraws(1, 0))[0]
            assert len(record.t) == 600 * rate
            assert_allclose(record.t_arrival - record.t, latency, atol=1e-12)
    with pytest.raises(ValueError, match="baro: rate 200 Hz is above the 100 Hz of the truth"):
        baro.measure(rest, replace(FULL, rate=200.0), SensorDraws(1, 0))


def test_every_noise_has_a_stream_and_none_is_drawn_for_nothing(rest, streams_drawn):
    drawn = streams_drawn()
    baro.measure(rest, OFF, SensorDraws(1, 0))
    assert drawn == []
    baro.measure(rest, FULL, SensorDraws(1, 0))
    assert sorted(drawn) == ["baro.bias", "baro.walk", "baro.white"]
