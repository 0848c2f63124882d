"""What the compiled filters take from the datasheets, by hand: states and the noise of measurements."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.records.data import InitialState
from bench.core.records.instruments import (
    AirspeedData,
    AirspeedSpec,
    BaroSpec,
    HeadingSpec,
    MagSpec,
    OdometerSpec,
    RadarData,
    RadarSpec,
)
from bench.core.records.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec, ThermalSpec, TriadSpec
from bench.io.config import read_profile
from bench.navigation.error_state_filter.aiding_sensors import (
    AIRSPEED,
    BARO,
    FIXES,
    HEADING,
    ODOMETER,
    RADAR,
    SATELLITES,
    fix_variance,
    magnetic_map,
)
from bench.navigation.error_state_filter.ranges.range_states import CLOCK, RANGE_ERRORS
from bench.navigation.error_state_filter.state_blocks import (
    StateModel,
    chosen_blocks,
    state_model,
    steady_rows,
)
from bench.navigation.options import FusionOptions
from bench.simulation.signals.allan import gauss_markov_deviation
from bench.simulation.signals.magnetic import field_n

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
    assert_allclose((L @ known.P)[:, others], 0.0, atol=1e-16)
    assert_allclose(known.P[np.ix_(others, others)], free.P[np.ix_(others, others)])
    assert_allclose(known.P, known.P.T)
    drives = free.process.drives
    acceleration = steady_rows(drives, f_b, warmth, len(free.P))[3:]
    for name, factor in (("accel_scale", f_b), ("accel_quadratic", f_b**2)):
        assert_allclose(acceleration[:, free.layout.slice(name)], np.diag(factor))


def test_errors_are_corrected_forces_first_and_small_ones_of_a_motion_before_those_that_need_it():
    """What no motion changes, what goes by the force on a gyro, by the axis itself, by those across."""
    both = replace(IMU, accel=replace(ACCEL, misalignment_sd=1e-3, temperature_sd=1e-4))
    model = model_of(replace(SPECS, imu=both), every_error=True)
    names = [block for block, _, size in model.layout.blocks for _ in range(size)]
    order, found = [], set()
    for state, error, _ in model.process.drives.tolist():
        name, own = names[state], (error - 9) % 3
        triad = int(error < 12)
        assert name.startswith("accel") != triad
        if "matrix" in name:
            kind = 2 if state - model.layout.slice(name).start == own else 3
        else:
            kind = 0 if "flicker" in name or "temperature" in name else 1 if "sensitivity" in name else 2
        order.append((triad, kind))
        found.add((triad, kind))
    assert order == sorted(order)
    assert found == {(0, 0), (0, 2), (0, 3), (1, 0), (1, 1), (1, 2), (1, 3)}


# --- satellites -----------------------------------------------------------------------------------------

SKY = replace(
    read_profile("figure-eight", {"sensors.gnss": "sky-l1"}).sensors.gnss.sky, systems="all", bands=1,
    gps_space_sd=1.0, glonass_space_sd=2.0, galileo_space_sd=0.5, beidou_space_sd=1.5,
    space_correlation=3600.0, ionosphere_sd=3.0, ionosphere_share=1.0, ionosphere_correlation=1800.0,
    troposphere_sd=0.1, troposphere_correlation=600.0, multipath_zenith_sd=0.5, multipath_horizon_sd=1.0,
    multipath_correlation=60.0, clock_offset_sd=100.0, clock_drift_sd=50.0, glonass_offset_sd=7.0,
    galileo_offset_sd=8.0, beidou_offset_sd=9.0, integration=0.02, clock_h_0=1e-20, clock_h_m1=1e-21,
    clock_h_m2=1e-22,
)  # fmt: skip
LIGHT = 299792458.0


def sky_model(rate: float = 2.0, **changes: object) -> StateModel:
    specs = replace(SPECS, gnss=replace(GNSS, rate=rate, sky=replace(SKY, **changes)))
    return state_model(START, specs, [CLOCK, RANGE_ERRORS])


def test_the_clock_walks_and_each_system_has_its_own_offset():
    """White frequency noise and random walk of the frequency in closed form (Brown and Hwang); flicker by the
    integral of what it moves the frequency between two epochs, up to that of the integration."""
    model = sky_model()
    assert_allclose(figures(model, "clock_offset"), [0, 1e4, 0.5e-20 * LIGHT**2, 0, 0, 0])
    value, variance, walk, *rest = figures(model, "clock_drift")
    assert [value, variance, *rest] == [0.0, 2500.0, 0.0, 0.0, 0.0]
    f = np.linspace(0.0, 0.5 / 0.02, 200_001)[1:]
    changed = np.trapezoid(2.0 * (1.0 - np.cos(np.pi * f)) / f, f)
    assert walk / LIGHT**2 == pytest.approx(2.0 * np.pi**2 * 1e-22 + 2.0 * changed * 1e-21, rel=2e-3)
    for name, sd in (("glonass", 7.0), ("galileo", 8.0), ("beidou", 9.0)):
        assert figures(model, f"{name}_offset") == [0.0, sd**2, 0.0, 0.0, 0.0, 0.0]
    assert not model.layout.has("gps_offset")


def test_what_wanders_in_a_range_decays_by_the_mean_of_its_times():
    """Unit states. The ionosphere is 3 m and 4 m under the broadcast 4 m, at 35 deg 1.6 times as much, of
    which 15 % in variance are a satellite's own; with two carriers it is gone, and multipath 2.98 times."""
    own, near = 0.15 * 1.6**2 * 25.0, 0.25
    model = sky_model()
    for name, space, count in (
        ("gps", 1.0, 16),
        ("glonass", 4.0, 12),
        ("galileo", 0.25, 12),
        ("beidou", 2.25, 16),
    ):
        rate = (space + own + near) / (3600.0 * space + 1800.0 * own + 60.0 * near)
        assert_allclose(figures(model, f"{name}_range_{count}"), [0, 1, 0, rate, 0, 1])
        assert not model.layout.has(f"{name}_range_{count + 1}")
    assert_allclose(figures(model, "ionosphere_5"), [0, 1, 0, 1 / 1800, 0, 1])
    assert not model.layout.has("ionosphere_6")
    assert_allclose(figures(model, "troposphere"), [0, 1, 0, 1 / 600, 0, 1])
    both = sky_model(bands=2)
    near *= 2.98**2
    assert_allclose(figures(both, "gps_range_1")[3], (1.0 + near) / (3600.0 + 60.0 * near))
    assert not both.layout.has("ionosphere_1")
    white = sky_model(multipath_correlation=1.0)
    assert_allclose(figures(white, "gps_range_1")[3], (1.0 + own) / (3600.0 + 1800.0 * own))
    brief = sky_model(ionosphere_correlation=0.5, troposphere_correlation=0.5, multipath_correlation=0.5)
    assert [figures(brief, name)[3] for name in ("ionosphere_1", "troposphere")] == [1.0, 1.0]
    none = sky_model(
        **dict.fromkeys(("ionosphere_sd", "ionosphere_share", "troposphere_sd", "multipath_zenith_sd"), 0.0),
        gps_space_sd=0.0,
    )
    names = [name for name, *_ in none.layout.blocks]
    assert "glonass_range_1" in names
    assert not {"gps_range_1", "ionosphere_1", "troposphere"} & set(names)


# --- measurements ---------------------------------------------------------------------------------------


def test_a_fix_is_as_noisy_as_its_datasheet_says_and_what_has_states_is_no_noise():
    white, wandering = [2.25, 2.25, 6.25, 0.0025, 0.0025, 0.0025], [9, 9, 16, 0.04, 0.04, 0.04]
    assert_allclose(fix_variance(GNSS, gnss_markov=True), white)
    assert_allclose(fix_variance(GNSS, gnss_markov=False), np.add(white, wandering))
    jumping = replace(GNSS, rate=2.0, pos_h_jump_sd=3.0, pos_v_jump_sd=4.0, vel_jump_sd=0.5)
    share = 100 / 86400 / 2.0  # of the epochs
    assert_allclose(FIXES.short(jumping), share * np.array([9, 9, 16, 0.25, 0.25, 0.25]))
    assert_allclose(FIXES.short(replace(jumping, rate=1e-3)), [9, 9, 16, 0.25, 0.25, 0.25])


@pytest.mark.parametrize("sensor", [BARO, RADAR, ODOMETER, HEADING], ids=lambda one: one.option)
def test_rounding_adds_a_twelfth_of_the_square_of_a_step(sensor):
    assert_allclose(sensor.short(replace(getattr(SPECS, sensor.spec), quantization=0.6)), [0.03])


def test_an_airspeed_is_as_noisy_as_its_record_bias_zero_and_scale_factor_say():
    """At 25 m/s: 0.3, 0.4 and 2 % of it; and 5 Pa of the zero over rho V, at the height of the start."""
    spec = AirspeedSpec("pitot", 10.0, bias_sd=0.4, scale_factor_sd=0.02)
    one = np.array([1.0])
    record = AirspeedData(one, one, one > 0, 25.0 * one, 0.3 * one)
    values, variance = AIRSPEED.read(record, spec, None, START, None)
    assert_allclose([values, variance], [[[25.0]], [[0.09 + 0.16 + 0.25]]])
    rho = 1.225 * (1 - 2.25577e-5 * 1000.0) ** 4.2559  # ISA troposphere
    _, more = AIRSPEED.read(record, replace(spec, pressure_bias_sd=5.0), None, START, None)
    assert_allclose(more - variance, [[(5.0 / (rho * 25.0)) ** 2]], rtol=0.01)


def test_a_radar_altimeter_gives_the_height_above_the_ellipsoid():
    one = np.array([1.0])
    record = RadarData(one, one, one > 0, 120.0 * one, 0.4 * one)
    values, variance = RADAR.read(record, SPECS.radar, SimpleNamespace(ground_alt=700.0), START, None)
    assert_allclose([values[0, 0], variance[0]], [820.0, 0.09])


def test_the_map_of_the_magnetic_field_is_its_value_and_its_slope():
    """Against the field 2 km away on either side, along each axis."""
    found = magnetic_map(START.lla, 2026.0)
    assert_allclose(found[0], field_n(START.lla[None], 2026.0)[0])
    for axis, row in enumerate(2e3 * np.eye(3)):
        there, back = field_n(earth.displace(START.lla, np.array([row, -row])), 2026.0)
        assert_allclose(found[1 + axis], (there - back) / 4e3, atol=0.02 * np.abs(found[1:]).max())


def test_the_errors_of_satellites_are_those_of_their_carriers():
    def told(**changes):
        return {
            words for words, size in SATELLITES.errors(replace(GNSS, sky=replace(SKY, **changes))) if size
        }

    ionosphere = "ionosphere beyond the broadcast model"
    assert ionosphere in told()
    assert ionosphere not in told(bands=2) | told(ionosphere_sd=0.0, ionosphere_share=0.0)
