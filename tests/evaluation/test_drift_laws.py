"""Drift laws against the Schuler pendulum integrated step by step, and the verdict on a measured drift."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from bench.evaluation.drift_laws import RADIUS, drift_sd
from bench.evaluation.outages import OutageDrift, make_drift_row, place_outages
from bench.units import DEG, STANDARD_GRAVITY
from tests.weaving import IMU

QUIET = replace(
    IMU,
    gyro=replace(IMU.gyro, random_walk=0.0, bias_instability=0.0, turn_on_bias_sd=0.0),
    accel=replace(IMU.accel, random_walk=0.0, bias_instability=0.0, turn_on_bias_sd=0.0),
)


def unit(triad, **figures):
    return replace(QUIET, **{triad: replace(getattr(QUIET, triad), **figures)})


def pendulum(T, *, accel=0.0, gyro=0.0, velocity=0.0, tilt=0.0, turn=0.0):
    """Horizontal channels of an INS: p' = v, v' = a + g phi, phi' = b - v / R, the biases turning with it."""

    def rates(t, x):
        _, v, phi = np.split(x, 3)
        b = np.array([np.cos(turn * t), np.sin(turn * t)])
        return np.concatenate([v, accel * b + STANDARD_GRAVITY * phi, gyro * b - v / RADIUS])

    start = np.array([0.0, 0.0, velocity, 0.0, tilt, 0.0])
    found = solve_ivp(rates, (0.0, T), start, rtol=1e-10, atol=1e-12)
    return float(np.hypot(*found.y[:2, -1]))


@pytest.mark.parametrize("T", [30.0, 600.0, 5064.0])
def test_each_law_is_the_answer_of_the_pendulum(T):
    b_a, b_g = 1e-3 * STANDARD_GRAVITY, 10.0 * DEG / 3600
    assert drift_sd(T, unit("accel", bias_instability=b_a)) == pytest.approx(pendulum(T, accel=b_a), abs=1e-3)
    assert drift_sd(T, unit("gyro", bias_instability=b_g)) == pytest.approx(pendulum(T, gyro=b_g), rel=1e-5)
    assert drift_sd(T, QUIET, velocity=0.2) == pytest.approx(pendulum(T, velocity=0.2), abs=1e-3)
    assert drift_sd(T, QUIET, tilt=1e-3) == pytest.approx(pendulum(T, tilt=1e-3), abs=1e-3)


def test_short_drifts_grow_with_the_second_and_third_power_of_time():
    accel, gyro = unit("accel", bias_instability=1e-2), unit("gyro", bias_instability=1e-4)
    assert drift_sd(10.0, accel) == pytest.approx(0.5 * 1e-2 * 10.0**2, rel=1e-4)
    assert drift_sd(10.0, gyro) == pytest.approx(STANDARD_GRAVITY * 1e-4 * 10.0**3 / 6.0, rel=1e-4)
    assert drift_sd(20.0, accel) / drift_sd(10.0, accel) == pytest.approx(4.0, rel=1e-3)
    assert drift_sd(20.0, gyro) / drift_sd(10.0, gyro) == pytest.approx(8.0, rel=1e-3)
    assert drift_sd(10.0, unit("accel", random_walk=1e-2)) == pytest.approx(1e-2 * np.sqrt(1e3 / 3), rel=1e-3)
    expected = STANDARD_GRAVITY * 1e-4 * np.sqrt(1e5 / 20)
    assert drift_sd(10.0, unit("gyro", random_walk=1e-4)) == pytest.approx(expected, rel=1e-3)


def test_the_pendulum_bounds_an_accelerometer_bias_but_not_a_gyro_bias():
    """A-2.4.4: at most 2 b R / g; A-2.4.7: R b T on average."""
    b = 1e-3 * STANDARD_GRAVITY
    times = np.arange(60.0, 20_000.0, 60.0)
    drifts = [drift_sd(float(T), unit("accel", bias_instability=b)) for T in times]
    assert max(drifts) == pytest.approx(2e-3 * RADIUS, rel=1e-3)
    period = 2 * np.pi * np.sqrt(RADIUS / STANDARD_GRAVITY)
    slow = drift_sd(period, unit("gyro", bias_instability=1e-6))
    assert slow == pytest.approx(RADIUS * 1e-6 * period, rel=1e-6)


def test_a_bias_that_turns_with_the_vehicle_is_integrated_along_its_headings():
    T, turn, b_g = 300.0, 2 * np.pi / 60.0, 1e-4
    heading = turn * np.linspace(0.0, T, 3001)
    circling = drift_sd(T, unit("gyro", turn_on_bias_sd=b_g), heading=heading, calibrated=False)
    assert circling == pytest.approx(pendulum(T, gyro=b_g, turn=turn), rel=1e-3)
    straight = drift_sd(T, unit("gyro", turn_on_bias_sd=b_g), calibrated=False)
    assert circling < 0.2 * straight
    assert drift_sd(T, unit("gyro", turn_on_bias_sd=b_g)) == 0.0  # calibrated: no turn-on bias is left


def test_outages_are_spread_from_the_first_place_to_the_last():
    assert_allclose(place_outages(100.0, 400.0, 60.0, 4), [100.0, 180.0, 260.0, 340.0])
    assert_allclose(place_outages(100.0, 160.0, 60.0, 2), [100.0, 100.0])
    with pytest.raises(ValueError, match="an outage of 60 s does not fit between 100 and 159 s"):
        place_outages(100.0, 159.0, 60.0, 2)


def test_a_row_of_drifts_has_the_quantiles_of_a_vector_of_two_axes():
    """Of s on each axis, half of the lengths are below s sqrt(2 ln 2), and 95 % below s sqrt(2 ln 20)."""
    drifts = [OutageDrift(0.0, 60.0, drift, 1.0, 2.0) for drift in (3.0, 4.0, 5.0)]
    row = make_drift_row("x", 60.0, drifts, IMU)
    expected = drift_sd(60.0, IMU)
    assert row["closed_form_median_h_m"] == pytest.approx(expected * np.sqrt(2.0 * np.log(2.0)), rel=1e-4)
    assert row["closed_form_p95_h_m"] == pytest.approx(expected * np.sqrt(2.0 * np.log(20.0)), rel=1e-4)
    assert row["claimed_median_h_m"] == pytest.approx(2.0 * np.sqrt(2.0 * np.log(2.0)), rel=1e-4)
    assert (row["places"], row["median_h_m"]) == (3, 4.0)
    assert row["rms_h_m"] == pytest.approx(np.sqrt(50.0 / 3.0))
