"""Where each state of the compiled filters begins and how it moves, by the datasheets: worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench import earth, rotation
from bench.data import InitialState
from bench.instruments import BaroSpec, HeadingSpec, MagSpec, OdometerSpec, RadarSpec
from bench.navigation.error_state_filter.state_blocks import (
    StateModel,
    chosen_blocks,
    state_model,
    steady_rows,
)
from bench.navigation.options import FusionOptions
from bench.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec, ThermalSpec, TriadSpec
from bench.signals.allan import gauss_markov_deviation

DEG = np.pi / 180.0
GYRO = TriadSpec(
    random_walk=3e-4, quantization=6e-4, bias_instability=2e-6, bias_correlation=100.0, turn_on_bias_sd=3e-5,
    scale_factor_sd=2e-3, misalignment_sd=3e-3, nonorthogonality_sd=8e-3, alignment_sd=12e-3,
    scale_asymmetry_sd=4e-4, nonlinearity_sd=5e-4, temperature_sd=2e-6, rate_random_walk=1.5e-8,
    g_sensitivity_sd=7e-5, g2_sensitivity_sd=6e-6, range=8.7,
)  # fmt: skip
ACCEL = TriadSpec(
    random_walk=4e-3, quantization=6e-3, bias_instability=1e-4, bias_correlation=200.0, turn_on_bias_sd=0.03,
    scale_factor_sd=1e-3, nonlinearity_sd=3e-4, quadratic_sd=2e-5, range=80.0,
)  # fmt: skip
IMU = ImuSpec("all", GYRO, ACCEL, ThermalSpec(reference=298.15, self_heating=10.0, time_constant=300.0))
GNSS = GnssSpec(
    "all", 2.0, 1.5, 2.5, 0.05, pos_h_markov_sd=3.0, pos_v_markov_sd=4.0, vel_markov_sd=0.2,
    pos_decay_distance=1e-4, pos_decay_time=0.01, vel_decay_time=0.02, pos_h_jump_markov_sd=0.6,
    pos_v_jump_markov_sd=0.8, vel_jump_markov_sd=0.02,
)  # fmt: skip
SPECS = AssumedSpecs(
    IMU,
    GNSS,
    baro=BaroSpec("baro", 5.0, 0.5, 3.0, 0.05),
    mag=MagSpec("mag", 10.0, 2e-7, 5e-7, soft_iron_sd=0.03, scale_factor_sd=0.04, misalignment_sd=0.02),
    radar=RadarSpec("radar", 10.0, white_sd=0.3, range=2000.0, bias_sd=0.5),
    odometer=OdometerSpec("wheel", 10.0, 0.05, scale_factor_sd=0.02),
    heading=HeadingSpec("two", 10.0, 0.003, wander_sd=0.002, wander_time=50.0, bias_sd=0.01),
)
START = InitialState(
    60.0,
    np.array([0.8, 0.2, 1000.0]),
    np.array([30.0, -20.0, 2.0]),
    rotation.from_euler(0.3, -0.2, 1.1),
    np.diag(np.arange(1.0, 10.0)),
    "given",
    bias_cov=np.arange(54.0).reshape(9, 6) * 1e-6,
    fix_cov=np.array([1.0, 2.0, 3.0]),
)


def model_of(specs: AssumedSpecs = SPECS, **options: object) -> StateModel:
    return state_model(START, specs, chosen_blocks(FusionOptions(**options)))


def figures(model: StateModel, name: str) -> list[float]:
    """Value, variance, density, decay by time and distance, stationary variance of the last of a block."""
    at, own = model.layout.slice(name).stop - 1, model.process
    columns = (own.q, own.decay_time, own.decay_distance, own.stationary)
    return [float(model.values[at]), float(model.P[at, at]), *(float(one[at]) for one in columns)]


EVERY = {"every_error": True, "radar": True, "odometer": True, "magnetometer": True, "heading": True}
JUMPS = {"gnss_markov": True, "every_error": True}
WHEELS = {
    "nonholonomic": True, "axle_b": [1.0, 2.0, 3.0], "axle_sd": 0.5, "mounting_sd_deg": 2.0,
    "slip_sd_deg": 0.5, "slip_s": 4.0,
}  # fmt: skip
WINGS = {"coordinated": True, "alpha_deg": 5.0, "alpha_sd_deg": 2.0, "gust_sd": 3.0}
PART = 100 / 86400 / 0.02
"""A change of the satellites a day times 100, over twice the rate at which a position decays."""
BY_HAND = [
    # value, variance, density, decay in 1/s and 1/m, variance that it tends to
    ({}, "vel", [0, 6, 1.6e-5, 0, 0, 0]),
    ({}, "phi", [0, 9, 9e-8, 0, 0, 0]),
    (EVERY, "vel", [0, 6, 1.6e-5 + 6e-6, 0, 0, 0]),  # of a second; rounding has a twelfth, and a sum two
    (EVERY, "phi", [0, 9, 9e-8 + 6e-8, 0, 0, 0]),
    ({}, "baro_bias", [0, 9, 2.5e-3, 0, 0, 0]),
    ({"gnss_markov": True}, "gnss_pos", [0, 16, 0, 0.01, 1e-4, 16]),
    ({"gnss_markov": True}, "gnss_vel", [0, 0.04, 0, 0.02, 0, 0.04]),
    (JUMPS, "gnss_pos", [0, 16 + 0.64 * PART, 0, 0.01, 1e-4, 16 + 0.64 * PART]),
    (JUMPS, "gnss_vel", [0, 0.04 + 2e-4 * PART, 0, 0.02, 0, 0.04 + 2e-4 * PART]),
    ({"mems": True}, "gyro_scale", [0, 4e-6, 0, 0, 0, 0]),
    ({"mems": True}, "accel_scale", [0, 1e-6, 0, 0, 0, 0]),
    ({"mems": True}, "g_sensitivity_y", [0, 4.9e-9, 0, 0, 0, 0]),
    (EVERY, "gyro_matrix_x", [0, 1.69e-4, 0, 0, 0, 0]),  # 3, 4 (half of 8) and 12 mrad
    (EVERY, "gyro_matrix_z", [0, 4e-6, 0, 0, 0, 0]),
    (EVERY, "accel_scale", [0, 1e-6, 0, 0, 0, 0]),
    (EVERY, "gyro_asymmetry", [0, 1.6e-7, 0, 0, 0, 0]),
    (EVERY, "gyro_nonlinearity", [0, 2.5e-7, 0, 0, 0, 0]),
    (EVERY, "accel_quadratic", [0, 4e-10, 0, 0, 0, 0]),
    (EVERY, "gyro_temperature", [0, 4e-12, 0, 0, 0, 0]),
    (EVERY, "g2_sensitivity_z", [0, 3.6e-11, 0, 0, 0, 0]),
    (EVERY, "radar_bias", [0, 0.25, 0, 0, 0, 0]),
    (EVERY, "odometer_scale", [0, 4e-4, 0, 0, 0, 0]),
    (EVERY, "mag_iron_b", [0, 2.5e-13, 0, 0, 0, 0]),
    (EVERY, "mag_scale", [0, 2.5e-3, 0, 0, 0, 0]),
    (EVERY, "mag_soft_iron", [0, 1.1e-3, 0, 0, 0, 0]),
    (EVERY, "mag_turn", [0, 2e-4, 0, 0, 0, 0]),
    (EVERY, "heading_bias", [0, 1e-4, 0, 0, 0, 0]),
    (EVERY, "heading_wander", [0, 4e-6, 0, 0.02, 0, 4e-6]),
    ({"lever_arm_sd": 0.3}, "antenna_b", [0, 0.09, 0, 0, 0, 0]),
    ({"time_offset_sd": 0.2}, "time_offset", [0, 0.04, 1e-6, 0, 0, 0]),
    ({"airspeed": True}, "wind_east", [0, 100, 0.01, 0, 0, 0]),
    (WHEELS, "axis_yaw", [0, (2 * DEG) ** 2, 0, 0, 0, 0]),
    (WHEELS, "axis_pitch", [0, (2 * DEG) ** 2, 0, 0, 0, 0]),
    (WHEELS, "slip_yaw", [0, (0.5 * DEG) ** 2, 0, 0.25, 0, (0.5 * DEG) ** 2]),
    (WHEELS, "slip_pitch", [0, (0.5 * DEG) ** 2, 0, 0.25, 0, (0.5 * DEG) ** 2]),
    (WHEELS, "pitch_by_force", [0, 3.6e-5, 0, 0, 0, 0]),
    (WHEELS, "axle_b", [3, 0.25, 0, 0, 0, 0]),
    (WINGS, "axis_yaw", [0, (2 * DEG) ** 2, 0, 0, 0, 0]),
    (WINGS, "axis_pitch", [-5 * DEG, (2 * DEG) ** 2, 0, 0, 0, 0]),
    (WINGS, "slip_pitch", [0, (1.5 * DEG) ** 2, 0, 1, 0, (1.5 * DEG) ** 2]),
    (WINGS, "pitch_by_force", [0, 1e-4, 0, 0, 0, 0]),
    (WINGS, "gust_n", [0, 9, 0, 0.2, 0, 9]),
    (WINGS, "wind_north", [0, 100, 0.01, 0, 0, 0]),
]  # fmt: skip


@pytest.mark.parametrize(("options", "name", "wanted"), BY_HAND, ids=[name for _, name, _ in BY_HAND])
def test_a_state_begins_and_moves_as_its_datasheet_says(options, name, wanted):
    assert_allclose(figures(model_of(**options), name), wanted, rtol=1e-9)


def test_without_a_decay_by_time_jumps_gather_for_a_day():
    """A hundred changes of the satellites a day, each of the variance of a jump: half of them on average."""
    slow = replace(GNSS, pos_decay_time=0.0, vel_decay_time=0.0)
    model = model_of(replace(SPECS, gnss=slow), gnss_markov=True, every_error=True)
    assert_allclose(figures(model, "gnss_pos")[1::4], 16 + 50 * 0.64)
    assert_allclose(figures(model, "gnss_vel")[1::4], 0.04 + 50 * 4e-4)


def bias_of(triad: TriadSpec, **options: object) -> list[float]:
    imu = replace(IMU, gyro=triad)
    return figures(model_of(replace(SPECS, imu=imu), **options), "gyro_bias")


def test_a_bias_walks_or_fades_and_holds_temperature_and_rate_random_walk():
    """A Gauss-Markov process of sd 3e-6 / 0.617; the air, 10 K off, wanders by 0.01 K/sqrt(s)."""
    markov = replace(GYRO, bias_model="gauss-markov", bias_instability=3e-6 * 0.617)
    assert_allclose(bias_of(markov), [0, 9e-10 + 9e-12, 1.8e-13, 0, 0, 0], rtol=1e-9)
    fading = replace(markov, turn_on_bias_sd=0.0)
    assert_allclose(bias_of(fading), [0, 9e-12, 1.8e-13, 0.01, 0, 0], rtol=1e-9)
    changed = [0, 9e-12 + 4e-10, 1.8e-13 + 4e-16 + 2.25e-16, 0, 0, 0]
    assert_allclose(bias_of(fading, every_error=True), changed, rtol=1e-9)
    steady = replace(fading, temperature_sd=0.0, rate_random_walk=0.0)
    assert_allclose(bias_of(steady, every_error=True), bias_of(fading), rtol=1e-12)
    constant = replace(markov, bias_instability=0.0)
    assert_allclose(bias_of(constant), [0, 9e-10, 0, 0, 0, 0], rtol=1e-9)


@pytest.mark.parametrize("turned_on", [3e-5, 0.0])
def test_flicker_is_a_sum_of_processes_with_a_flat_allan_deviation(turned_on):
    """Within 2 % from a tenth to ten times the correlation time; the slowest process is part of the bias."""
    triad = replace(GYRO, turn_on_bias_sd=turned_on, temperature_sd=0.0, rate_random_walk=0.0)
    model = model_of(replace(SPECS, imu=replace(IMU, gyro=triad)), every_error=True)
    _, variance, density, decay, _, _ = figures(model, "gyro_bias")
    slow = variance - turned_on**2
    time = 2.0 * slow / density
    assert_allclose(decay, 0.0 if turned_on else 1.0 / time)
    parts = [(slow, time)]
    for name in ("gyro_flicker_1", "gyro_flicker_2"):
        value, variance, density, decay, _, stationary = figures(model, name)
        assert (value, density) == (0.0, 0.0)
        assert variance == stationary
        parts.append((variance, 1.0 / decay))
    tau = np.geomspace(10.0, 1000.0, 50)
    found = np.sqrt(sum(gauss_markov_deviation(tau, np.sqrt(one), time) ** 2 for one, time in parts))
    assert np.abs(found / GYRO.bias_instability - 1.0).max() < 0.02
    still = replace(triad, bias_instability=0.0)
    assert not model_of(replace(SPECS, imu=replace(IMU, gyro=still)), every_error=True).layout.has(
        "gyro_flicker_1"
    )


def test_an_imu_warms_from_the_air_to_its_own_heat():
    """At 1000 m the air has 281.65 K: 6.5 K below the reference with 10 K of its own, e^-0.2 to come."""
    thermal = model_of().process.thermal
    assert_allclose(thermal, [-6.5 - 10.0 * np.exp(-0.2), 0.0, -0.0065, 300.0])
    at_once = replace(SPECS, imu=replace(IMU, thermal=replace(IMU.thermal, time_constant=0.0)))
    assert_allclose(model_of(at_once).process.thermal, [-6.5, 0.0, -0.0065, 0.0])
    assert_allclose(model_of().process.range, [8.7, 80.0])
    before = state_model(replace(START, t=-5.0), SPECS, []).process.thermal
    assert_allclose(before[0], -16.5)


def test_the_start_is_that_of_the_initial_state_and_what_it_has_in_common():
    model = model_of(gnss_markov=True, time_offset_sd=0.2)
    at, P = model.layout.slice("gnss_pos"), model.P
    other = 0.04 * np.outer(START.vel_n, START.vel_n)
    assert_allclose(P[:3, :3], START.cov[:3, :3] + other)
    assert_allclose(P[3:6, 3:6], START.cov[3:6, 3:6] + 0.04 * 4.0 * np.eye(3))
    assert_allclose(P[6:9, 6:9], START.cov[6:9, 6:9])
    assert_allclose(P[:9, 9:15], START.bias_cov)
    assert_allclose(P[:3, at], -np.diag(START.fix_cov))
    assert_allclose(P, P.T)


def test_a_heading_that_knows_the_gyros_knows_them_with_all_that_adds_to_them():
    """Biases, warmth, flicker and what gravity does, in the steady motion of the start: as sure as asked for,
    and what is left unknown is the difference of the others; against a dense product."""
    sd, blocks = 1e-6, chosen_blocks(FusionOptions(every_error=True))
    free, known = state_model(START, SPECS, blocks), state_model(START, SPECS, blocks, sd)
    f_b = rotation.matrix(START.q_nb).T @ -earth.gravity_n(START.lla[0], START.lla[2])
    L = np.zeros((3, free.layout.size))
    L[:, 9:12] = np.eye(3)
    warmth = -6.5 - 10.0 * np.exp(-0.2)
    for state, factor in (("gyro_temperature", warmth), ("gyro_flicker_1", 1.0), ("gyro_flicker_2", 1.0)):
        L[:, free.layout.slice(state)] = factor * np.eye(3)
    for axis, name in enumerate("xyz"):
        L[axis, free.layout.slice(f"g_sensitivity_{name}")] = f_b
        L[axis, free.layout.slice(f"g2_sensitivity_{name}")] = f_b**2
    assert_allclose(L @ known.P @ L.T, sd**2 * np.eye(3), atol=1e-22)
    others = np.delete(np.arange(len(free.P)), [9, 10, 11])
    assert_allclose((L @ known.P)[:, others], 0.0, atol=1e-18)
    assert_allclose(known.P[np.ix_(others, others)], free.P[np.ix_(others, others)])
    assert_allclose(known.P, known.P.T)
    drives = free.process.drives
    acceleration = steady_rows(drives, f_b, warmth, len(free.P))[3:]
    for name, factor in (("accel_scale", f_b), ("accel_quadratic", f_b**2)):
        assert_allclose(acceleration[:, free.layout.slice(name)], np.diag(factor))
