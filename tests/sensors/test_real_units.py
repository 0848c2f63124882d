"""Sensors as they really are: shaped noise, rounded rates, clocks, transients, hysteresis, motor currents.

Each error is held against a law or a tool that does not share its code: spectra by SciPy against sums of
aliases of the transfer function, Allan deviations by allantools. Bounds are 99.9 % bands with fixed seeds.
"""

from __future__ import annotations

from dataclasses import replace

import allantools
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.signal import welch

from bench.core.mathematics import earth
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import no_controls
from bench.core.records.instruments import MagSpec
from bench.core.records.sensor_specs import (
    Fault,
    GnssSpec,
    ImuSpec,
    SampleClockSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion.noise_curves import make_resting_truth
from bench.io.config import read_profile
from bench.io.config.datasheets import read_gnss, read_imu
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.aiding_sensors import fix_errors, imu_errors
from bench.navigation.estimator import list_unmodeled
from bench.simulation.sensors import faults, gnss, imu, imu_terms, magnetometer
from bench.simulation.sensors.draws import SensorDraws
from tests.builders import Z, band
from tests.synthetic import still, turning

OFF = TriadSpec()
N = 2e-3


def measure(truth, gyro=OFF, accel=OFF, seed=1, **more):
    return imu.measure(truth, ImuSpec("test", gyro, accel, **more), SensorDraws(seed, 0))


# --- bits ---------------------------------------------------------------------------------------------------


def test_without_the_errors_of_this_file_the_bits_are_those_of_white_noise_and_a_turn_on_bias():
    """By hand from the streams: the record does not depend on what is off."""
    truth = turning(5.0, 200.0)
    spec = TriadSpec(random_walk=N, turn_on_bias_sd=1e-3, range=50.0, bandwidth=0.0)
    record, _ = measure(truth, accel=spec)
    white = stream(1, 0, "imu.accel.white").standard_normal((len(truth.t) - 1, 3))
    bias = 1e-3 * stream(1, 0, "imu.accel.turn_on").standard_normal(3)
    dt = np.diff(truth.t)[:, None]
    zero = np.zeros(3)[None] * truth.dvel_b
    expected = truth.dvel_b + (zero + bias * dt + N * np.sqrt(dt) * white)
    assert_array_equal(record.dvel_b, expected)
    assert_array_equal(record.dtheta_b, truth.dtheta_b)


# --- noise through the filter -------------------------------------------------------------------------------


def fold(f, rate, bandwidth, averaged):
    """Density of filtered white noise at frequencies f with all aliases, 1 at low frequencies."""

    def density(f):
        around = f[:, None] + rate * np.arange(-4000, 4001)
        power = 1.0 / (1.0 + (around / bandwidth) ** 4)
        return np.sum(power * np.sinc(around / rate) ** 2 if averaged else power, axis=1)

    return density(f) if averaged else density(f) / density(np.zeros(1))


@pytest.mark.parametrize(("rate", "bandwidth"), [(200.0, 20.0), (200.0, 90.0), (100.0, 300.0)])
@pytest.mark.parametrize("shape", ["averaged", "sampled"])
def test_the_spectrum_of_the_noise_is_that_of_the_filter_with_its_aliases(rate, bandwidth, shape):
    """Within 5 % from low frequencies to half the rate, of axes that are independent; N stays as it is."""
    truth = make_resting_truth(rate, 80_000 / rate)
    record, _ = measure(truth, TriadSpec(random_walk=N, noise_shape=shape, bandwidth=bandwidth))
    rates = record.dtheta_b * rate
    f, found = welch(rates, rate, nperseg=400, noverlap=0, axis=0, detrend=False)
    f, found = f[1:199].reshape(11, 18), 0.5 * found[1:199].mean(axis=1).reshape(11, 18)
    expected = np.array([fold(one, rate, bandwidth, shape == "averaged") for one in f])
    low, high = band(2 * 3 * 200 * 18 / 1.94)  # neighbors are correlated by Hann's window
    ratio = np.mean(found / (N**2 * expected), axis=1)
    assert low > 0.95
    assert high < 1.05
    assert ((ratio > low) & (ratio < high)).all()


@pytest.mark.parametrize("shape", ["averaged", "sampled"])
def test_the_allan_deviation_of_shaped_noise_is_the_datasheets(shape):
    truth = make_resting_truth(100.0, 1000.0)
    record, _ = measure(truth, TriadSpec(random_walk=N, noise_shape=shape, bandwidth=30.0))
    for tau in (1.0, 4.0):
        found = [
            allantools.oadev(axis * 100.0, rate=100.0, data_type="freq", taus=[tau])[1][0]
            for axis in record.dtheta_b.T
        ]
        low, high = band(3 * 1000 / tau)
        ratio = np.mean(np.square(found)) / (N**2 / tau)
        assert low < ratio < high
    white, _ = measure(truth, TriadSpec(random_walk=N))
    assert record.dtheta_b.std() < 0.95 * white.dtheta_b.std()


# --- rounding -----------------------------------------------------------------------------------------------


def test_a_rounded_rate_loses_what_a_rounded_increment_carries():
    truth = still(20.0, 100.0)
    rate = truth.dtheta_b[0] * 100.0
    lsb = 3.0 * np.abs(rate).max()  # the Earth rate is a third of it
    lost, _ = measure(truth, TriadSpec(resolution=lsb))
    assert not lost.dtheta_b.any()
    kept, _ = measure(truth, TriadSpec(quantization=lsb / 100.0))
    assert_allclose(kept.dtheta_b.sum(axis=0), truth.dtheta_b.sum(axis=0), atol=0.51 * lsb / 100.0)
    noisy, _ = measure(make_resting_truth(100.0, 400.0), TriadSpec(resolution=lsb, random_walk=0.1 * lsb))
    steps = noisy.dtheta_b * 100.0 / lsb
    assert_allclose(steps, np.rint(steps), atol=1e-9)
    low, high = band(steps.size)
    assert low < steps.var() / (1.0 + 1.0 / 12.0) < high  # Widrow: the rounding adds a twelfth


def test_a_step_of_a_fault_is_rounded_as_the_unit_rounds():
    truth = make_resting_truth(100.0, 4.0)
    unit = ImuSpec("test", TriadSpec(resolution=1e-3, random_walk=1e-4), OFF)
    draws = SensorDraws(1, 0)
    record, _ = imu.measure(truth, unit, draws)
    step = Fault("gyro-step", "gyro", 1.0, 3.0, "step", step=(2.3e-3, 0.0, 0.0), ramp=(0.0, 0.0, 0.0))
    faulty = faults.apply_to_imu(record, unit, [step], draws)
    rates = faulty.dtheta_b[:, 0] * 100.0 / 1e-3
    assert_allclose(rates, np.rint(rates), atol=1e-9)
    added = (faulty.dtheta_b - record.dtheta_b)[:, 0] * 100.0
    acts = (record.t >= 1.0 - 1e-9) & (record.t < 3.0 - 1e-9)
    assert not added[~acts].any()
    assert_allclose(added[acts], 2e-3, atol=1e-12)  # 2.3 rounds to 2: what it holds is rounded already


# --- clock of the IMU ---------------------------------------------------------------------------------------


def ramp(duration, rate, slope):
    """A body at rest with gyros that see a rate growing by ``slope`` [rad/s^2]: exact increments."""
    truth = still(duration, rate)
    turned = 0.5 * slope * truth.t[:, None] ** 2 * np.array([1.0, -2.0, 0.5])
    return replace(truth, dtheta_b=np.diff(turned, axis=0))


def test_a_clock_that_is_fast_tags_the_past():
    truth = ramp(60.0, 200.0, 0.1)
    drift = 500e-6
    record, _ = measure(truth, clock=SampleClockSpec(drift=drift))
    t = truth.t
    middle = 0.5 * (t[1:] + t[:-1]) * (1.0 - drift)
    expected = 0.1 * middle[:, None] * np.array([1.0, -2.0, 0.5]) * np.diff(t)[:, None]
    assert_allclose(record.dtheta_b[3:], expected[3:], rtol=1e-9, atol=1e-12)
    assert_array_equal(record.t, t[1:])
    assert np.abs(record.dtheta_b - truth.dtheta_b).max() > 1e-5  # 30 ms late at the end
    assert_allclose(record.dvel_b, truth.dvel_b, rtol=1e-11)  # constant: the clock is of no effect


def test_jitter_is_noise_in_proportion_to_the_angular_acceleration():
    slope, jitter, rate = 2.0, 2e-3, 200.0
    record, _ = measure(ramp(100.0, rate, slope), clock=SampleClockSpec(jitter=jitter))
    error = (record.dtheta_b - ramp(100.0, rate, slope).dtheta_b)[10:, 0]
    late = 0.5 * jitter * slope / rate
    sd = slope / rate * jitter / np.sqrt(24.0)  # the mean of two delays, uniform from 0 to the jitter
    n = len(error) / 1.5  # neighbors have a delay in common
    assert abs(error.mean() + late) < Z * sd * np.sqrt(2.0 / len(error))
    low, high = band(n)
    assert low < error.var() / sd**2 < high


def test_a_clock_rejects_what_it_cannot_do():
    with pytest.raises(ValueError, match=r"jitter_us = 4600 us must be at most 0.9 of the sampling interval"):
        measure(still(1.0, 200.0), clock=SampleClockSpec(jitter=4.6e-3))
    truth = still(1.0, 200.0)
    uneven = truth.t + np.where(np.arange(len(truth.t)) == 100, 1e-3, 0.0)
    with pytest.raises(ValueError, match="needs samples of equal length"):
        measure(replace(truth, t=uneven), clock=SampleClockSpec(drift=1e-5))


# --- slow biases --------------------------------------------------------------------------------------------


def test_the_transient_decays_and_is_part_of_the_reported_bias():
    truth = still(60.0, 100.0)
    spec = TriadSpec(transient_sd=1e-3, transient_time=10.0)
    record, bias = measure(truth, spec)
    size = 1e-3 * stream(1, 0, "imu.gyro.transient").standard_normal(3)
    assert_allclose(bias.gyro_b, np.exp(-bias.t / 10.0)[:, None] * size, rtol=1e-12)
    added = (record.dtheta_b - truth.dtheta_b).sum(axis=0)
    assert_allclose(added, size * 10.0 * (1.0 - np.exp(-6.0)), rtol=1e-4)


def test_hysteresis_has_a_closed_loop_of_twice_its_size_at_any_speed():
    spec = ThermalSpec(reference=300.0, hysteresis=5.0)

    def sweep(steps):
        up = np.linspace(270.0, 330.0, steps)
        temperature = np.concatenate([up, up[::-1], up, up[::-1]])
        return imu_terms.list_warmth(temperature, spec, SensorDraws(1, 0)).reshape(4, steps, 3)

    slow, fast = sweep(6001), sweep(61)
    assert_allclose(slow[:, ::100], fast, atol=1e-9)
    assert_allclose(fast[0, 5, 2], 1.0 - np.exp(-1.0))  # after 5 K
    warming, cooling = fast[2], fast[3][::-1]
    assert_allclose(warming[30, 2] - cooling[30, 2], 2.0, atol=0.01)
    assert_allclose(fast[2, -1, 2], fast[0, -1, 2], atol=1e-4)  # closed
    assert_allclose(fast[0, :, 1], (np.linspace(270.0, 330.0, 61) - 300.0) ** 2)
    steady = imu_terms.list_warmth(np.full(9, 310.0), spec, SensorDraws(1, 0))
    assert_allclose(steady, np.tile([10.0, 100.0, 0.0], (9, 1)))


def test_temperature_of_second_order_and_hysteresis_act_on_the_bias():
    truth = still(40.0, 100.0)
    spec = TriadSpec(temperature2_sd=1e-6, hysteresis_sd=1e-3)
    thermal = ThermalSpec(reference=280.0, self_heating=20.0, time_constant=10.0)
    _, bias = measure(truth, accel=spec, thermal=thermal)
    above = 20.0 * (1.0 - np.exp(-bias.t / 10.0))  # the air is at 280 K
    square = 1e-6 * stream(1, 0, "imu.accel.temperature2").standard_normal(3)
    turned = 1e-3 * stream(1, 0, "imu.accel.hysteresis").standard_normal(3)
    expected = above[:, None] ** 2 * square + (1.0 - np.exp(-above / 10.0))[:, None] * turned
    assert_allclose(bias.accel_b, expected, rtol=1e-9, atol=1e-15)


# --- vibration inside of a sample ---------------------------------------------------------------------------


def test_an_engine_rectifies_what_it_shakes_inside_of_a_sample():
    """Mean error of a quadratic accelerometer: its coefficient times the mean square, 3 m/s^2 rms at 103 Hz.

    Sampled at 5 kHz, by hand; without an inner rate a sample of 10 ms holds a period and averages it.
    """
    truth = still(60.0, 100.0)
    shaken = VibrationSpec(engine_accel=3.0, engine_reference=2 * np.pi * 103.0)
    turning_engine = replace(truth.air, engine_speed=np.full(len(truth.air.t), 2 * np.pi * 103.0))
    truth = replace(truth, air=turning_engine)
    unit = TriadSpec(quadratic_sd=1e-4)
    coefficient = 1e-4 * stream(1, 0, "imu.accel.quadratic").standard_normal(3)
    smooth, _ = measure(truth, accel=unit)
    inside, _ = measure(truth, accel=unit, vibration=replace(shaken, inner_rate=5000.0))
    outside, _ = measure(truth, accel=unit, vibration=shaken)
    rectified = (inside.dvel_b - smooth.dvel_b).sum(axis=0) / 60.0
    assert_allclose(rectified, coefficient * 9.0, rtol=0.02)
    assert_allclose((outside.dvel_b - smooth.dvel_b).sum(axis=0) / 60.0, 0.0, atol=2e-5)
    sensitive = TriadSpec(g2_sensitivity_sd=1e-5)
    turned, _ = measure(truth, sensitive, vibration=replace(shaken, inner_rate=5000.0))
    H = 1e-5 * stream(1, 0, "imu.gyro.g2_sensitivity").standard_normal((3, 3))
    at_rest, _ = measure(truth, sensitive)
    drift = (turned.dtheta_b - at_rest.dtheta_b).sum(axis=0) / 60.0
    assert_allclose(drift, H.sum(axis=1) * 9.0, rtol=0.02, atol=1e-6)


# --- receivers ----------------------------------------------------------------------------------------------

RECEIVER = GnssSpec("test", rate=10.0, pos_h_white_sd=0.02, pos_v_white_sd=0.03, vel_white_sd=0.05)


def fix(truth, spec, seed=1):
    return gnss.measure(truth, spec, (0.0, 0.0, 0.0), (), SensorDraws(seed, 0))


def test_time_tags_and_latency_of_fixes():
    truth = turning(100.0, 100.0)
    plain = fix(truth, replace(RECEIVER, latency=0.1))
    late = fix(truth, replace(RECEIVER, latency=0.1, time_tag_error=0.02))
    assert_array_equal(late.lla, plain.lla)
    assert_allclose(late.t - plain.t, 0.02, rtol=1e-12)
    assert_array_equal(late.t_arrival, plain.t_arrival)
    ahead = fix(truth, replace(RECEIVER, time_tag_error=0.02))
    assert_array_equal(ahead.t_arrival, ahead.t)  # without latency: not before its tag
    shaken = fix(truth, replace(RECEIVER, latency=0.1, latency_jitter=0.08))
    delay = shaken.t_arrival - shaken.t
    assert_array_equal(shaken.t, plain.t)
    assert 0.1 <= delay.min() < 0.101
    assert 0.179 < delay.max() <= 0.18
    assert abs(delay.mean() - 0.14) < Z * 0.08 / np.sqrt(12 * len(delay))
    crowded = fix(truth, replace(RECEIVER, latency_jitter=2.0))
    assert (np.diff(crowded.t_arrival) >= 0).all()


def test_carrier_smoothed_fixes_are_centimeters_white_and_meters_correlated():
    truth = still(3000.0, 20.0)
    spec = replace(RECEIVER, pos_h_smooth_sd=1.5, pos_v_smooth_sd=2.5, smooth_time=10.0, optimism=2.0)
    fixes = fix(truth, spec)
    error = earth.difference_n(fixes.lla, truth.lla[:1])
    steps, lag = np.diff(error, axis=0), np.exp(-0.1 / 10.0)
    expected = 2.0 * np.array([0.02, 0.02, 0.03]) ** 2 + 2.0 * (1.0 - lag) * np.array([1.5, 1.5, 2.5]) ** 2
    low, high = band(len(steps) / 1.5)
    assert ((steps.var(axis=0) / expected > low) & (steps.var(axis=0) / expected < high)).all()
    low, high = band(300)  # as many correlation times
    spread = error.var(axis=0) / np.array([1.5, 1.5, 2.5]) ** 2
    assert ((spread > low) & (spread < high)).all()
    reported = np.sqrt(np.diag(fixes.cov_pos_n[0]))
    assert_allclose(reported, np.hypot([1.5, 1.5, 2.5], [0.02, 0.02, 0.03]) / 2.0)


# --- magnetometer -------------------------------------------------------------------------------------------


def test_the_field_of_the_motors_is_in_proportion_to_the_throttle():
    truth = still(20.0, 100.0)
    throttle = np.clip(truth.controls.t / 20.0, 0.0, 1.0)
    truth = replace(truth, controls=replace(truth.controls, throttle=throttle))
    spec = MagSpec("test", rate=10.0, white_sd=1e-9)
    still_field, _ = magnetometer.measure(truth, spec, 2026.0, SensorDraws(1, 0))
    found, _ = magnetometer.measure(truth, replace(spec, motor_field_sd=3e-6), 2026.0, SensorDraws(1, 0))
    full = 3e-6 * stream(1, 0, "mag.motor_field").standard_normal(3)
    assert_allclose(found.field_b - still_field.field_b, found.t[:, None] / 20.0 * full, atol=1e-18)
    with pytest.raises(ConfigError, match="motor_field_sd_nt needs the throttle"):
        magnetometer.measure(
            replace(truth, controls=no_controls()),
            replace(spec, motor_field_sd=1e-6),
            2026.0,
            SensorDraws(1, 0),
        )


# --- what filters are told, and files -----------------------------------------------------------------------


def test_every_error_is_named_to_the_filters_and_none_without_it():
    quiet = {words for words, size in imu_errors(ImuSpec("quiet", OFF, OFF)) if size}
    assert not quiet
    for change, words in (
        ({"resolution": 1.0}, "rounding of the rates"),
        ({"transient_sd": 1.0}, "turn-on transient"),
        ({"temperature2_sd": 1.0}, "temperature bias of second order"),
        ({"hysteresis_sd": 1.0}, "temperature hysteresis"),
        ({"noise_shape": "sampled"}, "noise through the filter of the bandwidth"),
    ):
        spec = ImuSpec("odd", replace(OFF, **change), OFF)
        assert {words for words, size in imu_errors(spec) if size} == {f"gyro {words}"}
    spec = ImuSpec("odd", OFF, OFF, clock=SampleClockSpec(jitter=1e-4))
    assert [words for words, size in imu_errors(spec) if size] == ["time tags of the IMU"]
    assert not [words for words, size in fix_errors(RECEIVER) if size]
    odd = replace(RECEIVER, time_tag_error=-0.01, latency_jitter=0.1, pos_h_smooth_sd=1.0)
    assert {words for words, size in fix_errors(odd) if size} == {
        "time tags of the fixes", "GNSS latency", "error of carrier-smoothed code",
    }  # fmt: skip


def test_the_best_filter_names_what_it_has_no_state_for():
    """Each alone; what it models or corrects is not named."""
    profile = read_profile("all-sensors", {"sensors.gnss": "zed-f9p-smoothed", "sensors.imu": "matched-mems"})
    known = list_unmodeled(load("loose-full", {}), "loose-full", profile.sensors.assumed)
    assert "error of carrier-smoothed code" in known
    for table, change, words in (
        ("imu.gyro", {"resolution_deg_s": 0.01}, {"gyro rounding of the rates"}),
        ("imu.accel", {"transient_sd_mg": 1.0, "transient_time_s": 9.0}, {"accelerometer turn-on transient"}),
        ("imu.accel", {"hysteresis_sd_mg": 1.0}, {"accelerometer temperature hysteresis"}),
        ("imu.gyro", {"temperature2_sd_deg_h_k2": 1.0}, {"gyro temperature bias of second order"}),
        ("imu.gyro", {"temperature_sd_deg_h_k": 1.0}, set()),
        ("imu.clock", {"drift_ppm": 10.0}, {"time tags of the IMU"}),
        ("gnss", {"time_tag_error_s": 0.01}, {"time tags of the fixes"}),
        ("gnss", {"latency_jitter_s": 0.01}, set()),
    ):
        changes = {f"sensors.{table}.{key}": value for key, value in change.items()}
        more = {"sensors.gnss": "zed-f9p-smoothed", "sensors.imu": "matched-mems", **changes}
        assumed = read_profile("all-sensors", more).sensors.assumed
        found = list_unmodeled(load("loose-full", {}), "loose-full", assumed)
        assert set(found) - set(known) == words, change


IMU_FILE = """
source = "by hand"
[gyro]
noise_deg_sqrt_h = 0.3
noise_shape = "sampled"
bandwidth_hz = 50.0
resolution_deg_s = 0.0625
transient_sd_deg_h = 36.0
transient_time_s = 60.0
temperature2_sd_deg_h_k2 = 3.6
hysteresis_sd_deg_h = 7.2
[accel]
resolution_mg = 0.5
temperature2_sd_ug_k2 = 2.0
[thermal]
hysteresis_k = 4.0
[clock]
drift_ppm = 20.0
jitter_us = 150.0
"""


def test_the_keys_become_si(tmp_path):
    path = tmp_path / "unit.toml"
    path.write_text(IMU_FILE)
    unit = read_imu(path, "unit.toml")
    deg = np.pi / 180.0
    assert unit.gyro.noise_shape == "sampled"
    found = [unit.gyro.resolution, unit.gyro.transient_sd, unit.gyro.temperature2_sd, unit.gyro.hysteresis_sd]
    assert_allclose(found, [0.0625 * deg, 0.01 * deg, 1e-3 * deg, 2e-3 * deg])
    assert_allclose([unit.accel.resolution, unit.accel.temperature2_sd], [4.903325e-3, 1.96133e-5])
    assert_allclose([unit.thermal.hysteresis, unit.clock.drift, unit.clock.jitter], [4.0, 20e-6, 150e-6])


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("bandwidth_hz = 50.0\n", "", "noise_shape = 'sampled' needs bandwidth_hz above 0 Hz"),
        ("transient_time_s = 60.0\n", "", "transient_sd needs transient_time_s above 0 s"),
        ('"sampled"', '"pink"', "must be 'white', 'averaged' or 'sampled'"),
    ],
)
def test_a_file_that_lacks_a_figure_says_which(tmp_path, old, new, message):
    path = tmp_path / "unit.toml"
    path.write_text(IMU_FILE.replace(old, new))
    with pytest.raises(ConfigError, match=message):
        read_imu(path, "unit.toml")


def test_smoothed_fixes_need_a_time(tmp_path):
    path = tmp_path / "unit.toml"
    text = 'source = "x"\n[gnss]\nrate_hz = 5.0\npos_h_white_sd_m = 1.0\npos_v_white_sd_m = 1.0\n'
    path.write_text(text + "vel_white_sd_mps = 0.1\npos_h_smooth_sd_m = 1.0\n")
    with pytest.raises(ConfigError, match="need smooth_time_s above 0 s"):
        read_gnss(path, "unit.toml")


def test_a_receiver_of_ranges_has_no_key_of_a_receiver_of_fixes():
    changes = {"sensors.gnss": "sky-l1", "sensors.gnss.latency_jitter_s": 0.1}
    with pytest.raises(ConfigError, match="latency_jitter_s and time_tag_error_s are for receivers without"):
        read_profile("figure-eight", changes)
