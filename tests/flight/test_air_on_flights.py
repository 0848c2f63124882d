"""What JSBSim says of the air against what the sensors that feel it make of it: two atmospheres."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose

from bench.core.records.instruments import AirspeedSpec, BaroSpec, StaticPressureSpec
from bench.simulation.sensors import airspeed, static_pressure
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals import air


def test_a_barometer_without_errors_reads_the_geopotential_height_of_the_flight(short_truth):
    """Climb and turn included; the constants of the two atmospheres differ by 4e-6 of the pressure, 4 cm."""
    spec = BaroSpec("none", 10.0, 0.1, 5.0, 0.03, physical=StaticPressureSpec())
    record, bias = static_pressure.measure(short_truth, spec, 101325.0, (0.0, 0.0, 0.0), SensorDraws(1, 0))
    rows = np.searchsorted(short_truth.t, record.t - 1e-6)
    assert_allclose(record.alt_baro, air.to_geopotential(short_truth.lla[rows, 2]), rtol=0, atol=0.06)
    assert_allclose(bias, record.alt_baro - short_truth.lla[rows, 2], rtol=0, atol=1e-9)
    assert np.ptp(record.alt_baro) > 10.0


def test_a_port_that_minds_incidence_errs_more_in_the_turn(short_truth):
    """The angle of attack of a banked turn is larger, and the pressure at the port with it."""
    felt = {}
    for slope in (0.0, 0.1):
        unit = StaticPressureSpec(position_error_alpha=slope)
        felt[slope] = static_pressure.compute_port_pressure(short_truth, unit, 0.0, (0.0, 0.0, 0.0))
    around = short_truth.air
    dynamic = 0.5 * air.standard_atmosphere(1200.0)[2] * around.airspeed_true**2
    assert_allclose(felt[0.1] - felt[0.0], 0.1 * around.alpha * dynamic, rtol=0.01, atol=0.02)
    turning = (around.t > 12.0) & (around.t < 15.0)
    assert around.alpha[turning].mean() > 1.1 * around.alpha[around.t < 9.0].mean()


def test_an_airspeed_unit_without_errors_reads_ground_velocity_less_wind(short_truth):
    truth = short_truth
    record = airspeed.measure(truth, AirspeedSpec("none", 10.0), SensorDraws(1, 0))[0]
    rows = np.searchsorted(truth.t, record.t - 1e-6)
    wind_n = np.column_stack([np.interp(record.t, truth.air.t, column) for column in truth.air.wind_n.T])
    assert np.linalg.norm(wind_n, axis=1).min() > 4.0
    through_air = np.linalg.norm(truth.vel_n[rows] - wind_n, axis=1)
    assert_allclose(record.airspeed_true, through_air, rtol=0, atol=0.05)
    assert np.abs(np.linalg.norm(truth.vel_n[rows], axis=1) - through_air).max() > 3.0


def test_the_impact_pressure_of_the_flight_gives_its_calibrated_airspeed(short_truth):
    """By definition: the airspeed that has the same impact pressure in standard air at sea level."""
    around = short_truth.air
    impact = air.impact_pressure(around.airspeed_true, around.pressure, around.temperature)
    calibrated = air.true_airspeed(impact, 101325.0, 288.15)
    assert_allclose(calibrated, around.airspeed_calibrated, rtol=0, atol=2e-3)
    assert np.abs(calibrated - around.airspeed_true).min() > 0.5
