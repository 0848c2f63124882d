"""A barometer on the static pressure of the flight: each cause moves the altitude as altimetry says.

Statistical bounds are two-sided 99.9 % bands of the statistic itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import rotation
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import no_air
from bench.core.records.instruments import BaroSpec, StaticPressureSpec
from bench.simulation.sensors import static_pressure
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals import air
from tests.builders import band, first_rows
from tests.sensors.given_numbers import respond
from tests.synthetic import still

STANDARD = 101325.0
NONE = StaticPressureSpec()
FULL = StaticPressureSpec(
    pressure_white_sd=1.2,
    pressure_bias_sd=50.0,
    temperature_sd=0.75,
    isa_deviation_sd=5.0,
    qnh_sd=50.0,
    qnh_walk=0.4,
)


def flown(height, duration=60.0, rate=100.0, **columns):
    """A truth at a height as a function of time [m], in the standard atmosphere, other air data as told."""
    rest = still(duration, rate)
    truth = replace(rest, lla=np.column_stack([rest.lla[:, :2], height(rest.t)]))
    pressure, temperature, _ = air.standard_atmosphere(air.to_geopotential(height(rest.air.t)))
    told = {name: value + 0 * rest.air.t for name, value in columns.items()}
    return replace(truth, air=replace(rest.air, pressure=pressure, temperature=temperature, **told))


def read(truth, unit=NONE, qnh=STANDARD, port=(0.0, 0.0, 0.0), run=0, **fields):
    spec = BaroSpec("physical", 10.0, 0.1, 5.0, 0.03, physical=unit)
    return static_pressure.measure(truth, replace(spec, **fields), qnh, port, SensorDraws(1, run))[0]


def level(height=1000.0, **columns):
    return flown(lambda t: height + 0 * t, **columns)


@pytest.mark.parametrize("height", [-100.0, 1000.0, 9000.0, 14000.0])
def test_in_standard_air_it_reads_the_geopotential_height(height):
    """16 m below the ellipsoidal one at 10 km; that is the bias told."""
    truth = level(height)
    spec = BaroSpec("physical", 10.0, 0.1, 5.0, 0.03, physical=NONE)
    record, bias = static_pressure.measure(truth, spec, STANDARD, (0.0, 0.0, 0.0), SensorDraws(1, 0))
    geopotential = 6356766.0 * height / (6356766.0 + height)
    assert_allclose(record.alt_baro, geopotential, rtol=0, atol=1e-6)
    assert_allclose(bias, geopotential - height, rtol=0, atol=1e-6)


@pytest.mark.parametrize("hpa", [993.0, 1003.0, 1023.0])
def test_the_setting_moves_the_altitude_by_27_feet_per_hpa(hpa):
    """By the height of the standard atmosphere between the two pressures, closed form, at every height."""
    expected = -44330.77 * (1 - (hpa / 1013.25) ** 0.190263)
    assert abs(expected / 0.3048 / (hpa - 1013.25) - 27.3) < 0.4
    for height in (0.0, 3000.0):
        moved = read(level(height), qnh=100 * hpa).alt_baro - read(level(height)).alt_baro
        assert_allclose(moved, expected, atol=0.01)


@pytest.mark.parametrize("warmer", [-20.0, 10.0])
def test_air_off_standard_makes_the_scale_wrong_by_four_percent_per_ten_kelvin(warmer):
    """Hydrostatic, closed form: H_read = H T0 / (T0 + dT), the lapse rate being the same."""
    for height in (0.0, 1000.0, 5000.0):
        H = air.to_geopotential(height)
        found = read(level(height), replace(NONE, isa_deviation=warmer)).alt_baro
        assert_allclose(found, H * 288.15 / (288.15 + warmer), rtol=0, atol=1e-3)
    assert 0.03 < (1 - found[0] / H) / (warmer / 10) < 0.04
    climb = read(flown(lambda t: 1000.0 + 50.0 * t), replace(NONE, isa_deviation=warmer))
    H = air.to_geopotential(1000.0 + 50.0 * climb.t)
    assert_allclose(climb.alt_baro, H * 288.15 / (288.15 + warmer), rtol=0, atol=1e-3)


@pytest.mark.parametrize(
    ("field", "air_column", "value", "factor"),
    [
        ("position_error", "alpha", 0.0, 1.0),
        ("position_error_alpha", "alpha", 0.1, 0.1),
        ("position_error_beta2", "beta", -0.2, 0.04),
    ],
)
def test_the_port_errs_by_a_share_of_the_dynamic_pressure(field, air_column, value, factor):
    """dh = -Cp q / (rho g) to first order; twice the speed, four times the error; none at rest."""
    moved = []
    for speed in (0.0, 20.0, 40.0):
        truth = level(airspeed_true=speed, **{"alpha": 0.0, "beta": 0.0, air_column: value})
        moved.append(float((read(truth, replace(NONE, **{field: 0.05})).alt_baro - read(truth).alt_baro)[0]))
    density = air.standard_atmosphere(air.to_geopotential(1000.0))[2]
    assert moved[0] == 0.0
    assert_allclose(moved[1], -0.05 * factor * 0.5 * density * 20.0**2 / (density * 9.80665), rtol=5e-3)
    assert_allclose(moved[2], 4 * moved[1], rtol=5e-3)


def test_a_port_away_from_the_center_of_gravity_reads_its_own_height():
    """5 m aft in a climb attitude: lower by 5 sin(pitch); the height follows the attitude."""
    for pitch in (0.0, 0.3):
        truth = level()
        turned = np.tile(rotation.from_euler(0.2, pitch, 1.0), (len(truth.t), 1))
        moved = read(replace(truth, q_nb=turned), port=(-5.0, 0.0, 0.0)).alt_baro - read(truth).alt_baro
        assert_allclose(moved, -5.0 * np.sin(pitch), rtol=0, atol=2e-3)
    warm = replace(NONE, isa_deviation=20.0)  # a step in height is one of less pressure
    moved = (
        read(replace(truth, q_nb=turned), warm, port=(-5.0, 0.0, 0.0)).alt_baro - read(truth, warm).alt_baro
    )
    assert_allclose(moved, -5.0 * np.sin(0.3) * 288.15 / 308.15, rtol=0, atol=2e-3)


def test_a_lag_reads_a_climb_behind_by_its_time():
    """Ramp error: lag times climb rate, less 0.02 % for the curvature of the pressure."""
    truth = flown(lambda t: 1000.0 + 5.0 * t)
    for lag in (0.5, 2.0):
        record = read(truth, replace(NONE, lag=lag))
        behind = (read(truth).alt_baro - record.alt_baro)[record.t > 30.0]
        assert_allclose(behind, 5.0 * lag, rtol=1e-3)


def test_pressure_noise_and_its_least_bit_become_altitude():
    """1 Pa is 1 / (rho g) of altitude: 0.092 m at 1000 m."""
    truth = level()
    meter_per_pascal = 1 / (air.standard_atmosphere(air.to_geopotential(1000.0))[2] * 9.80665)
    exact = read(truth).alt_baro
    noise = read(truth, replace(NONE, pressure_white_sd=1.2)).alt_baro - exact
    low, high = band(len(noise))
    assert low < np.mean(noise**2) / (1.2 * meter_per_pascal) ** 2 < high
    climb = flown(lambda t: 1000.0 + 5.0 * t)
    rounded = read(climb, replace(NONE, quantization=20.0)).alt_baro - read(climb).alt_baro
    assert np.abs(rounded).max() <= 10.0 * meter_per_pascal * 1.03
    assert_allclose(rounded.std(), 20.0 * meter_per_pascal / np.sqrt(12), rtol=0.1)


@pytest.mark.parametrize(
    ("figure", "pascals"),
    [("pressure_bias_sd", 50.0), ("qnh_sd", 50.0 * 0.887), ("temperature_sd", -0.75 * 16.5)],
)
def test_constant_errors_of_the_pressure_are_the_figure_times_what_was_drawn(figure, pascals):
    """At 1000 m and 8.5 degC; a pressure at sea level weighs 0.887 of itself there. Higher reads lower."""
    truth = flown(lambda t: 1000.0 + 0 * t, 0.2)
    exact = read(truth).alt_baro[0]
    unit = replace(NONE, **{figure: getattr(FULL, figure)})
    density = air.standard_atmosphere(air.to_geopotential(1000.0))[2]
    for run in range(4):
        drawn = stream(1, run, f"baro.{figure.removesuffix('_sd')}").standard_normal()
        found = read(truth, unit, run=run).alt_baro[0] - exact
        assert found == pytest.approx(-pascals * drawn / (density * 9.80665), rel=0.01)


def test_the_error_of_the_temperature_knows_the_air_of_the_day():
    """Of the sensor, in proportion to its distance from 25 degC: 8.5 degC, or 18.5 degC on a warm day."""
    errors = [
        read(level(), replace(day, temperature_sd=0.75)).alt_baro[0] - read(level(), day).alt_baro[0]
        for day in (NONE, replace(NONE, isa_deviation=10.0))
    ]
    warm, usual = (281.65 + 10.0) - 298.15, 281.65 - 298.15
    assert errors[1] / errors[0] == pytest.approx(warm / usual, rel=0.05)


def test_air_data_may_go_on_after_the_last_instant():
    truth = flown(lambda t: 1000.0 + 5.0 * t)
    cut = read(first_rows(truth, 57), port=(-5.0, 0.0, 0.0)).alt_baro
    assert_array_equal(cut, read(truth, port=(-5.0, 0.0, 0.0)).alt_baro[: len(cut)])


def test_the_deviation_of_the_day_is_drawn_for_each_run():
    """It is that of air so much warmer: H T0 / (T0 + 5 K times the number)."""
    truth, H = flown(lambda t: 1000.0 + 0 * t, 0.2), air.to_geopotential(1000.0)
    for run in range(4):
        warmer = 5.0 * stream(1, run, "baro.isa_deviation").standard_normal()
        found = read(truth, replace(NONE, isa_deviation_sd=5.0), run=run).alt_baro
        assert_allclose(found, H * 288.15 / (288.15 + warmer), rtol=0, atol=1e-3)


def test_the_pressure_at_sea_level_walks_with_the_root_of_time():
    """After an hour its sd is 60 qnh_walk, by each of its numbers alone."""
    rest = still(3600.0, 1 / 60)
    truth = replace(rest, lla=np.column_stack([rest.lla[:, :2], 0 * rest.t]))
    pressure, temperature, _ = air.standard_atmosphere(0 * rest.air.t)
    truth = replace(truth, air=replace(rest.air, pressure=pressure, temperature=temperature))
    spec = BaroSpec("physical", 1 / 60, 0.1, 5.0, 0.03, physical=replace(NONE, qnh_walk=0.4))
    found = respond(
        "baro.qnh_walk", 60, lambda draws: static_pressure.measure(truth, spec, STANDARD, (0, 0, 0), draws)[1]
    )
    assert np.sqrt((found[-1] ** 2).sum()) == pytest.approx(60 * 0.4 / (1.225 * 9.80665), rel=1e-3)
    assert (found <= 1e-9).all()


def test_what_it_claims_of_itself_and_when():
    record = read(level(), NONE, latency=0.05)
    assert (record.sd == 0.1).all()
    assert_allclose(record.t_arrival - record.t, 0.05, atol=1e-12)
    assert record.valid.all()


def test_without_air_or_without_a_physical_part_it_is_refused():
    with pytest.raises(ValueError, match="has no air data"):
        read(replace(level(), air=no_air()))
    with pytest.raises(ValueError, match="has no physical part"):
        read(level(), None)


def test_every_error_has_a_stream_and_none_is_drawn_for_nothing(streams_drawn):
    drawn = streams_drawn()
    read(level())
    assert drawn == []
    read(level(), FULL)
    names = ("isa_deviation", "pressure_bias", "pressure_white", "qnh", "qnh_walk", "temperature")
    assert sorted(drawn) == [f"baro.{name}" for name in names]
