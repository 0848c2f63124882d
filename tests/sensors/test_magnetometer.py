"""The magnetometer: the field of the Earth in body axes, distorted as calibration leaves it.

Statistical bounds are two-sided 99.9 % bands of the statistic itself.
"""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import rotation
from bench.core.records.instruments import MagSpec
from bench.simulation.sensors import magnetometer, sampling
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals.magnetic import field_n
from tests.builders import band
from tests.synthetic import still, turning

DATE = 2026.0
OFF = MagSpec("off", rate=10.0, white_sd=0.0)
FULL = MagSpec(
    "full",
    10.0,
    2e-7,
    hard_iron_sd=5e-7,
    soft_iron_sd=0.01,
    scale_factor_sd=0.002,
    misalignment_sd=0.003,
    motor_field_sd=4e-7,
)
ERRORS = ("white_sd", "hard_iron_sd", "soft_iron_sd", "scale_factor_sd", "misalignment_sd", "motor_field_sd")


@pytest.fixture(scope="module")
def turn():
    """A turn at a bank: all axes see the field change."""
    return turning(60.0, 100.0)


def reading(truth, spec, run=0):
    return magnetometer.measure(truth, spec, DATE, SensorDraws(1, run))[0].field_b


def test_without_errors_it_reads_the_field_turned_into_the_body(turn):
    """The heading of the level components, corrected for declination, is that of the nose."""
    record, offset = magnetometer.measure(turn, OFF, DATE, SensorDraws(1, 0))
    rows = np.arange(10, len(turn.t), 10)
    assert_allclose(record.t, turn.t[rows], atol=1e-9)
    B_n = field_n(turn.lla[rows], DATE)
    assert_allclose(rotation.rotate(turn.q_nb[rows], record.field_b), B_n, rtol=0, atol=1e-15)
    roll, pitch, heading = rotation.to_euler(turn.q_nb[rows])
    level = rotation.rotate(rotation.from_euler(roll, pitch, 0 * roll), record.field_b)
    compass = -np.arctan2(level[:, 1], level[:, 0]) + np.arctan2(B_n[:, 1], B_n[:, 0])
    assert_allclose(np.angle(np.exp(1j * (compass - heading))), 0.0, atol=1e-12)
    assert record.valid.all()
    assert not offset.any()


@pytest.mark.parametrize("figure", ERRORS)
def test_doubling_a_figure_doubles_its_own_error_and_no_other(turn, figure):
    value, true = getattr(FULL, figure), reading(turn, OFF)
    alone = reading(turn, replace(OFF, **{figure: value})) - true
    doubled = reading(turn, replace(OFF, **{figure: 2 * value})) - true
    assert np.abs(alone).max() > 1e-9
    assert_allclose(doubled, 2 * alone, rtol=0, atol=1e-15)
    after = reading(turn, replace(FULL, **{figure: 2 * value}))
    assert_allclose(after - reading(turn, FULL), alone, rtol=0, atol=1e-15)


@pytest.mark.parametrize("figure", ERRORS[1:-1])
def test_the_matrix_and_the_offset_found_from_the_readings_are_those_of_the_figure(figure):
    """Least squares on 200 attitudes of a tumble, for 400 units: each element has the sd of its figure, and
    what the figure says nothing of stays zero; the matrix applied is the one drawn, not its transpose."""
    rng = np.random.default_rng(2)
    rest = still(0.2, 1000.0)
    q = rotation.from_rotvec(rng.normal(size=(len(rest.t), 3)) * 2)
    tumble = replace(rest, q_nb=rotation.continuous(q))
    spec = replace(OFF, rate=1000.0, **{figure: getattr(FULL, figure)})
    true = reading(tumble, replace(OFF, rate=1000.0))
    A = np.column_stack([true, np.ones(len(true))])
    found = []
    for run in range(400):
        x, *_ = np.linalg.lstsq(A, reading(tumble, spec, run) - true, rcond=None)
        found.append(x.T / getattr(spec, figure))
    drawn = magnetometer.draw_calibration(sampling.Sampler("mag", tumble, spec, SensorDraws(1, 399)), spec)
    assert_allclose(found[-1] * getattr(spec, figure), np.column_stack(drawn), rtol=1e-6, atol=1e-9)
    found = np.array(found)
    M, offset = found[:, :, :3], found[:, :, 3]
    low, high = band(len(found))
    off_diagonal = ~np.eye(3, dtype=bool)
    if figure == "hard_iron_sd":
        assert ((low < np.mean(offset**2, axis=0)) & (np.mean(offset**2, axis=0) < high)).all()
        assert np.abs(M).max() < 1e-3
        return
    assert np.abs(offset).max() < 1e-9
    power = np.mean(M**2, axis=0)
    on, off = np.diag(power), power[off_diagonal]
    if figure == "scale_factor_sd":
        assert ((low < on) & (on < high)).all()
        assert off.max() < 1e-12
    elif figure == "misalignment_sd":
        assert ((low < off) & (off < high)).all()
        assert on.max() < 1e-12
    else:
        assert ((low < power) & (power < high)).all()
        assert_allclose(M, np.swapaxes(M, 1, 2), atol=1e-9)


def test_white_noise_has_its_figure_and_the_unit_claims_it(turn):
    spec = replace(OFF, white_sd=2e-7)
    record = magnetometer.measure(turn, spec, DATE, SensorDraws(1, 0))[0]
    noise = (record.field_b - reading(turn, OFF)) / 2e-7
    low, high = band(noise.size)
    assert low < np.mean(noise**2) < high
    assert_array_equal(record.sd, 2e-7)


def test_the_offset_reported_is_the_offset_applied(turn):
    spec = replace(OFF, hard_iron_sd=5e-7)
    record, offset = magnetometer.measure(turn, spec, DATE, SensorDraws(1, 0))
    assert_allclose(record.field_b - reading(turn, OFF), np.tile(offset, (len(record.t), 1)), atol=1e-15)


def test_least_bit_range_rate_and_latency(turn):
    rounded = reading(turn, replace(OFF, quantization=1e-6))
    assert_allclose(rounded * 1e6, np.rint(rounded * 1e6), atol=1e-6)
    assert 0 < np.abs(rounded - reading(turn, OFF)).max() <= 0.5e-6 * (1 + 1e-9)
    limit = float(np.median(np.abs(reading(turn, OFF)).max(axis=1)))
    clipped = magnetometer.measure(turn, replace(OFF, range=limit), DATE, SensorDraws(1, 0))[0]
    beyond = (np.abs(reading(turn, OFF)) > limit).any(axis=1)
    assert 0 < beyond.sum() < len(beyond)
    assert_array_equal(clipped.valid, ~beyond)
    assert np.abs(clipped.field_b).max() == limit
    late = magnetometer.measure(turn, replace(OFF, rate=5.0, latency=0.03), DATE, SensorDraws(1, 0))[0]
    assert len(late.t) == 300
    assert_allclose(late.t_arrival - late.t, 0.03, atol=1e-12)


def test_the_date_moves_the_field(turn):
    """At 47 deg north it grows by tens of nT in a year; a date without a model is rejected."""
    year = magnetometer.measure(turn, OFF, DATE + 1.0, SensorDraws(1, 0))[0].field_b - reading(turn, OFF)
    assert 10e-9 < np.linalg.norm(year, axis=1).min() < 200e-9
    with pytest.raises(ValueError, match="modeled from 2010 to 2030"):
        magnetometer.measure(turn, OFF, 2031.0, SensorDraws(1, 0))


def test_every_error_has_a_stream_and_none_is_drawn_for_nothing(turn, streams_drawn):
    drawn = streams_drawn()
    magnetometer.measure(turn, OFF, DATE, SensorDraws(1, 0))
    assert drawn == []
    magnetometer.measure(turn, FULL, DATE, SensorDraws(1, 0))
    wanted = [f"mag.{f.name.removesuffix('_sd')}" for f in fields(MagSpec) if f.name.endswith("_sd")]
    assert sorted(drawn) == sorted(wanted)
