"""The airspeed unit: a pitot tube feels pressure, so its noise in speed grows as the flight gets slower.

Statistical bounds are two-sided 99.9 % bands of the statistic itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics.random_streams import stream
from bench.core.records.data import no_air
from bench.core.records.instruments import AirspeedSpec
from bench.simulation.sensors import airspeed
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals import air
from tests.builders import band
from tests.synthetic import still

OFF = AirspeedSpec("off", rate=20.0)
FULL = AirspeedSpec("full", 20.0, 2.0, 0.1, pressure_bias_sd=3.0, bias_sd=0.2, scale_factor_sd=0.01, lag=0.5)


def flown(speed, duration=300.0):
    """A truth whose true airspeed is a function of time [m/s]."""
    rest = still(duration, 100.0)
    return replace(rest, air=replace(rest.air, airspeed_true=speed(rest.air.t)))


@pytest.fixture(scope="module")
def steady():
    return flown(lambda t: 25.0 + 0 * t)


def error(truth, spec, run=0):
    record = airspeed.measure(truth, spec, SensorDraws(1, run))[0]
    return record.airspeed_true - np.interp(record.t, truth.air.t, truth.air.airspeed_true)


def test_without_errors_it_reads_the_true_airspeed():
    """Between the rows of the air data too, where pressure goes straight and speed does not: 1 mm/s."""
    truth = flown(lambda t: 25.0 + 8.0 * np.sin(0.3 * t))
    assert_allclose(error(truth, OFF), 0.0, atol=1e-9)
    assert_allclose(error(truth, replace(OFF, rate=50.0)), 0.0, atol=1e-3)


@pytest.mark.parametrize("speed", [10.0, 20.0, 40.0, 240.0])
def test_pressure_noise_is_speed_noise_over_density_and_speed(speed):
    """sd(V) = sd(p) / (rho V), a fifth less at Mach 0.72; the record reports it. Twice the noise fails."""
    truth = flown(lambda t: speed + 0 * t)
    record = airspeed.measure(truth, replace(OFF, pressure_white_sd=2.0), SensorDraws(1, 0))[0]
    density = 87700.0 / (287.05287 * 280.0)
    expected = 2.0 / (density * speed)
    if speed > 100:

        def impact(v):
            return 87700.0 * ((1 + 0.2 * v**2 / (1.4 * 287.05287 * 280.0)) ** 3.5 - 1)

        assert 0.75 < 2.0 / (impact(speed + 0.5) - impact(speed - 0.5)) / expected < 0.85
        expected = 2.0 / (impact(speed + 0.5) - impact(speed - 0.5))
    low, high = band(len(record.t))
    measured = np.mean((record.airspeed_true - speed) ** 2)
    assert 0.95 * low < measured / expected**2 < 1.05 * high
    assert_allclose(np.median(record.sd), expected, rtol=0.02)
    assert not low < measured / (2.0 * expected) ** 2 < high


@pytest.mark.parametrize(
    ("figure", "factor"), [("bias_sd", 1.0), ("scale_factor_sd", 25.0), ("white_sd", 1.0)]
)
def test_doubling_a_figure_of_speed_doubles_its_own_error(steady, figure, factor):
    value = getattr(FULL, figure)
    alone = error(steady, replace(OFF, **{figure: value}))
    assert 0 < np.abs(alone).max() < 5 * value * factor
    assert_allclose(error(steady, replace(OFF, **{figure: 2 * value})), 2 * alone, atol=1e-9)


@pytest.mark.parametrize(
    ("figure", "expected"),
    [
        ("pressure_bias_sd", 3.0 / (87700.0 / (287.05287 * 280.0) * 25.0)),
        ("bias_sd", 0.2),
        ("scale_factor_sd", 0.25),
    ],
)
def test_constant_errors_are_the_figure_times_what_was_drawn(figure, expected):
    """For the zero of the pressure to first order. The bias told is that applied."""
    truth = flown(lambda t: 25.0 + 0 * t, 1.0)
    spec = replace(OFF, **{figure: getattr(FULL, figure)})
    for run in range(4):
        drawn = stream(1, run, f"airspeed.{figure.removesuffix('_sd')}").standard_normal()
        found = error(truth, spec, run)
        assert_allclose(found, expected * drawn, rtol=0.02)
        assert_allclose(airspeed.measure(truth, spec, SensorDraws(1, run))[1], found, atol=1e-9)


def test_a_lag_follows_a_ramp_of_pressure_behind_by_its_time():
    """The ramp error is lag times rate, exactly, once the start is forgotten."""
    rest = still(60.0, 100.0)
    ramp = 100.0 + 5.0 * rest.air.t
    speed = air.true_airspeed(ramp, 87700.0, 280.0)
    truth = replace(rest, air=replace(rest.air, airspeed_true=speed))
    for lag in (0.5, 1.0):
        record = airspeed.measure(truth, replace(OFF, lag=lag), SensorDraws(1, 0))[0]
        felt = air.impact_pressure(record.airspeed_true, 87700.0, 280.0)
        late = record.t > 20.0
        assert_allclose(felt[late], 100.0 + 5.0 * (record.t[late] - lag), rtol=1e-7)


def test_range_least_bit_and_lowest_speed():
    truth = flown(lambda t: 0.1 * t)
    full_scale = float(air.impact_pressure(20.0, 87700.0, 280.0))
    record = airspeed.measure(truth, replace(OFF, range=full_scale, min_speed=5.0), SensorDraws(1, 0))[0]
    assert_array_equal(record.valid, (record.t * 0.1 >= 5.0 - 1e-9) & (record.t * 0.1 <= 20.0 + 1e-9))
    assert_allclose(record.airspeed_true.max(), 20.0, rtol=1e-9)
    coarse = airspeed.measure(truth, replace(OFF, quantization=10.0), SensorDraws(1, 0))[0]
    steps = air.impact_pressure(coarse.airspeed_true, 87700.0, 280.0) / 10.0
    assert_allclose(steps, np.rint(steps), atol=1e-6)
    assert np.abs(error(truth, replace(OFF, quantization=10.0))).max() > 1.0  # at low speed


def test_a_pressure_below_zero_reads_no_speed():
    truth = flown(lambda t: 0 * t)
    record = airspeed.measure(truth, replace(OFF, pressure_white_sd=2.0), SensorDraws(1, 0))[0]
    assert record.airspeed_true.min() == 0.0
    assert 0.4 < np.mean(record.airspeed_true == 0.0) < 0.6
    assert np.isfinite(record.sd).all()


def test_rate_and_latency_and_a_truth_without_air(steady):
    record = airspeed.measure(steady, replace(FULL, rate=10.0, latency=0.1), SensorDraws(1, 0))[0]
    assert len(record.t) == 3000
    assert_allclose(record.t_arrival - record.t, 0.1, atol=1e-12)
    with pytest.raises(ValueError, match="has no air data"):
        airspeed.measure(replace(steady, air=no_air()), FULL, SensorDraws(1, 0))


def test_every_error_has_a_stream_and_none_is_drawn_for_nothing(steady, streams_drawn):
    drawn = streams_drawn()
    airspeed.measure(steady, OFF, SensorDraws(1, 0))
    assert drawn == []
    airspeed.measure(steady, FULL, SensorDraws(1, 0))
    names = ("bias", "pressure_bias", "pressure_white", "scale_factor", "white")
    assert sorted(drawn) == [f"airspeed.{name}" for name in names]
