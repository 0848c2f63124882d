"""One run of all sensors: what the filters get, when, and from where they start."""

from __future__ import annotations

import pickle
from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.files import disk_arrays
from bench.core.mathematics import earth, rotation
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import AirData
from bench.core.records.instruments import AirspeedSpec, BaroSpec, HeadingSpec, MagSpec, StaticPressureSpec
from bench.core.records.sensor_specs import (
    AssumedSpecs,
    Fault,
    GnssSpec,
    ImuSpec,
    SensorsSpec,
    ThermalSpec,
    TriadSpec,
    VibrationSpec,
)
from bench.simulation.sensors import initial, sense, timing
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.sensors.timing import select_output_times
from tests.builders import band
from tests.synthetic import still, turning
from tests.weaving import weaving

TRIAD = TriadSpec(
    random_walk=4e-5,
    bias_instability=1e-5,
    bias_correlation=100.0,
    turn_on_bias_sd=1e-4,
    scale_factor_sd=5e-4,
    misalignment_sd=1e-3,
    quantization=1e-7,
)
IMU = ImuSpec("imu", TRIAD, TRIAD)
GNSS = GnssSpec("gnss", 1.0, 1.5, 2.5, 0.05)
BARO = BaroSpec("baro", 5.0, 0.5, 3.0, 0.05)
SPEC = SensorsSpec(
    imu=IMU,
    gnss=GNSS,
    baro=BARO,
    assumed=AssumedSpecs(replace(IMU, name="believed"), GNSS, baro=BARO),
    antenna_b=(0.5, 0.1, -0.3),
    gnss_outages=((20.0, 30.0),),
    initial_pos_sd=(3.0, 4.0, 5.0),
    initial_vel_sd=(0.1, 0.2, 0.3),
    initial_tilt_sd=0.01,
    initial_heading_sd=0.05,
    output_rate=10.0,
)


@pytest.fixture(scope="module")
def turn():
    return turning(60.0, 200.0)


def test_the_same_seed_and_run_give_the_same_bits_and_others_do_not(turn):
    first = sense(turn, SPEC, 1, 0)
    assert pickle.dumps(first) == pickle.dumps(sense(turn, SPEC, 1, 0))
    for seed, run in ((2, 0), (1, 1)):
        other = sense(turn, SPEC, seed, run)
        assert not np.array_equal(first.data.imu.dtheta_b, other.data.imu.dtheta_b)
        assert not np.array_equal(first.data.fixes.lla, other.data.fixes.lla)
        assert not np.array_equal(first.data.baro.alt_baro, other.data.baro.alt_baro)
        assert not np.array_equal(first.initial.lla, other.initial.lla)


@pytest.mark.parametrize("rows", [1, 89, 640])
def test_a_record_made_in_blocks_on_disk_has_the_bits_of_the_whole(rows, monkeypatch):
    """Of an IMU with every error at once, some of them faster than a second, and with faults."""
    errors: dict[str, object] = {
        "dead_zone": 1e-4,
        "delay": 0.013,
        "bandwidth": 20.0,
        "range": 4.0,
        "rate_random_walk": 1e-6,
        "scale_asymmetry_sd": 1e-3,
        "nonlinearity_sd": 1e-3,
        "quadratic_sd": 1e-3,
        "nonorthogonality_sd": 1e-3,
        "alignment_sd": 1e-3,
        "temperature_sd": 1e-5,
    }
    gyro = replace(TRIAD, bias_correlation=5.0, g_sensitivity_sd=1e-5, g2_sensitivity_sd=1e-6, **errors)
    shaking = VibrationSpec(0.01, 0.3, 500.0, 1.0, 0.01, 0.3, 12.0, 0.1)
    arms = ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1))
    unit = ImuSpec(
        "all", gyro, replace(TRIAD, **errors | {"range": 30.0}), accel_arms=arms, accel_cone=0.6,
        vibration=shaking, thermal=ThermalSpec(290.0, 20.0, 3.0),
    )  # fmt: skip
    faults = (
        Fault("gyro-step", "gyro", 2.0, 3.0, "", step=(0.1, 0.0, 0.0), ramp=(0.0, 0.1, 0.0)),
        Fault("repeated", "imu", 4.0, 5.0, "", share=0.5),
        Fault("noise-burst", "accel", 5.0, 6.0, "", times=3.0),
    )
    mag, pitot = MagSpec("mag", 20.0, 2e-7), AirspeedSpec("pitot", 20.0, pressure_white_sd=2.0, bias_sd=0.3)
    gnss = replace(GNSS, pos_h_markov_sd=1.0, pos_decay_time=0.01)
    spec = replace(SPEC, imu=unit, gnss=gnss, mag=mag, airspeed=pitot, faults=faults)
    rng = np.random.default_rng(4)
    t, one = np.arange(0.0, 9.01, 0.05), np.ones(181)
    wind_n, engine_speed = rng.normal(size=(181, 3)), 200.0 + rng.normal(size=181)
    flow = (25.0 * one, 24.0 * one, 0.02 * one, 0.01 * one)
    air = AirData(t, 9e4 * one, 280.0 + t, *flow, wind_n, engine_speed)
    truth = replace(weaving(9.0, 100.0), air=air)
    whole = pickle.dumps(sense(truth, spec, 1, 0))
    monkeypatch.setattr(disk_arrays, "ROWS", rows)
    monkeypatch.setattr(disk_arrays, "LARGE", 0)
    assert pickle.dumps(sense(truth, spec, 1, 0)) == whole


def test_leaving_out_one_sensor_leaves_the_others_bit_identical(turn):
    whole = sense(turn, SPEC, 1, 0)
    bare = sense(turn, replace(SPEC, gnss=None, baro=None), 1, 0)
    assert_array_equal(bare.data.imu.dtheta_b, whole.data.imu.dtheta_b)
    assert_array_equal(bare.data.imu.dvel_b, whole.data.imu.dvel_b)
    assert_array_equal(bare.initial.q_nb, whole.initial.q_nb)
    assert bare.data.fixes is None
    assert bare.data.baro is None
    assert "baro" not in bare.truth.bias
    assert len(bare.events) == 0
    without_imu_errors = sense(turn, replace(SPEC, imu=ImuSpec("ideal", TriadSpec(), TriadSpec())), 1, 0)
    assert_array_equal(without_imu_errors.data.fixes.lla, whole.data.fixes.lla)
    assert_array_equal(without_imu_errors.data.baro.alt_baro, whole.data.baro.alt_baro)


def test_a_magnetometer_and_an_airspeed_unit_leave_the_others_bit_identical(turn):
    mag = MagSpec("mag", 20.0, 2e-7, hard_iron_sd=5e-7)
    pitot = AirspeedSpec("pitot", 20.0, pressure_white_sd=2.0, bias_sd=0.3)
    bare, whole = sense(turn, SPEC, 1, 0), sense(turn, replace(SPEC, mag=mag, airspeed=pitot), 1, 0)
    equal = [
        (bare.data.imu.dtheta_b, whole.data.imu.dtheta_b),
        (bare.data.fixes.lla, whole.data.fixes.lla),
        (bare.data.baro.alt_baro, whole.data.baro.alt_baro),
        (bare.initial.lla, whole.initial.lla),
    ]
    for one, other in equal:
        assert_array_equal(one, other)
    assert bare.data.mag is None
    assert bare.data.airspeed is None
    assert bare.truth.bias.keys() == {"baro"}
    other = sense(turn, replace(SPEC, mag=mag), 1, 0)
    assert_array_equal(other.data.mag.field_b, whole.data.mag.field_b)
    offset = whole.truth.bias["mag"]
    assert offset.any()
    assert (offset == offset[0]).all()
    error = whole.truth.bias["airspeed"]
    assert np.ptp(error) < 1e-9  # 25 m/s all along
    assert error[0] != 0


def test_the_date_of_the_flight_reaches_the_magnetometer_and_the_estimators(turn):
    mag = MagSpec("mag", 20.0, 0.0)
    early, late = (sense(turn, replace(SPEC, mag=mag, date=date), 1, 0) for date in (2025.0, 2026.0))
    assert (early.data.date, late.data.date) == (2025.0, 2026.0)
    assert np.abs(late.data.mag.field_b - early.data.mag.field_b).max() > 1e-8


def test_a_physical_barometer_is_the_one_with_a_physical_part(turn):
    """The setting and the port reach it; its bias has no noise."""
    felt = replace(BARO, physical=StaticPressureSpec(pressure_white_sd=5.0))
    plain = sense(turn, replace(SPEC, baro=felt), 1, 0)
    assert_allclose(plain.data.baro.alt_baro.mean(), 1190.0, atol=15.0)  # 87700 Pa
    moved = sense(turn, replace(SPEC, baro=felt, qnh=100325.0), 1, 0).data.baro.alt_baro
    assert_allclose(moved - plain.data.baro.alt_baro, -83.6, atol=0.5)
    below = sense(turn, replace(SPEC, baro=felt, static_port_b=(0.0, 0.0, 2.0)), 1, 0).data.baro.alt_baro
    assert_allclose(below - plain.data.baro.alt_baro, -2.0 * np.cos(0.65), atol=0.05)
    assert np.ptp(plain.truth.bias["baro"]) < 1e-6 < np.ptp(plain.data.baro.alt_baro)


def test_an_estimator_gets_the_believed_specs_the_lever_arm_and_the_outage_only_as_silence(turn):
    sensed = sense(turn, SPEC, 1, 0)
    assert sensed.data.specs is SPEC.assumed
    assert_array_equal(sensed.data.antenna_b, [0.5, 0.1, -0.3])
    assert sensed.events.select("gnss_outage") == [(20.0, 30.0, "GNSS outage")]
    assert_array_equal(np.round(sensed.data.fixes.t[18:21]), [19, 30, 31])


def test_the_reported_baro_bias_is_on_the_times_of_the_imu_biases(turn):
    sensed = sense(turn, replace(SPEC, baro=replace(BARO, white_sd=0.0)), 1, 0)
    rows = np.searchsorted(sensed.truth.t, sensed.data.baro.t - 1e-6)
    assert_allclose(sensed.truth.bias["baro"][rows, 0], sensed.data.baro.alt_baro - 1200.0, rtol=0, atol=1e-6)


def test_outputs_are_wanted_every_tenth_and_at_both_ends_of_an_outage(turn):
    t = select_output_times(turn.t, 10.0, ((20.0, 30.0), (40.05, 40.06), (55.0, 80.0)))
    extra = [29.995, 40.05, 40.055]
    assert_allclose(t, np.sort(np.concatenate([np.arange(601) / 10, extra])), atol=1e-9)
    assert np.isin(t, turn.t).all()
    coarse = select_output_times(turn.t, 0.71, ())
    assert coarse[0] == turn.t[0]
    assert coarse[-1] == turn.t[-1]
    assert_allclose(coarse[1:-1], np.arange(1, 43) / 0.71, atol=0.005 + 1e-9)


def test_a_flight_that_begins_at_another_instant_is_sensed_alike(turn):
    """Later by 128 s, with faults and outages as much later: the same runs at the same epochs."""
    step = Fault("baro-step", "baro", 40.0, 45.0, "", step=(9.0,), ramp=(1.0,))
    gnss = replace(GNSS, pos_h_markov_sd=2.0, pos_decay_time=0.01, tracking_bandwidth=2.0)
    imu = ImuSpec(
        "moved", replace(TRIAD, rate_random_walk=1e-6, bandwidth=20.0, delay=0.012), TRIAD,
        vibration=VibrationSpec(0.01, 0.3, 500.0, 1.0, 0.01, 0.3, 12.0, 0.1),
    )  # fmt: skip
    heading = HeadingSpec("two", 5.0, 0.01, wander_sd=0.02, wander_time=30.0)
    spec = replace(SPEC, imu=imu, gnss=gnss, heading=heading, airspeed=AirspeedSpec("pitot", 20.0, lag=0.5))
    later = replace(turn, t=turn.t + 128.0, air=replace(turn.air, t=turn.air.t + 128.0))
    moved = replace(spec, faults=(replace(step, start=168.0, end=173.0),), gnss_outages=((148.0, 158.0),))
    first, other = sense(turn, replace(spec, faults=(step,)), 1, 0), sense(later, moved, 1, 0)
    assert_allclose(other.data.output_t - 128.0, first.data.output_t, rtol=0, atol=1e-9)
    for name in ("imu", "fixes", "baro", "heading", "airspeed"):
        here, there = getattr(first.data, name), getattr(other.data, name)
        for f in fields(here):
            begin = 128.0 * (f.name in ("t", "t_arrival"))
            found = getattr(there, f.name) - begin if begin else getattr(there, f.name)
            assert_allclose(found, getattr(here, f.name), rtol=0, atol=2e-7, err_msg=f"{name}.{f.name}")
    assert_allclose(other.truth.gyro_bias_b, first.truth.gyro_bias_b, rtol=0, atol=1e-12)


@pytest.mark.parametrize("off", [-1e-9, 0.0, 1e-9])
def test_instants_that_rounding_moves_are_the_same(off):
    """Of epochs, of both ends of an outage, and of the end of a flight."""
    t = 128.0 + np.arange(101) * 0.1 + off * (np.arange(101) > 0)
    assert timing.find_interval_rows(t, 130.0, 133.0) == (20, 50)
    assert_array_equal(timing.find_rows("x", t, np.array([129.0, 130.0])), [10, 20])
    assert_array_equal(timing.find_epoch_rows("x", t, 1.0), np.arange(10, 101, 10))
    rows, steps = SensorDraws(1, 0).epochs("x", t, 1.0)
    assert_array_equal(rows, np.arange(10, 101, 10))
    assert_allclose(steps, 1.0, rtol=0, atol=1e-6)
    with pytest.raises(ValueError, match=r"^x: no epoch at 0\.09 Hz within 10 s of truth$"):
        timing.check_duration("x", t, 0.09)
    with pytest.raises(ValueError, match=r"^x: rate 25 Hz is above the 10 Hz of the truth$"):
        timing.find_epoch_rows("x", t, 25.0)


def test_the_initial_error_follows_the_conventions(turn):
    """estimate = truth + error; C_est = exp([phi x]) C_true; the sds are those of the covariance."""
    sd = np.array([3.0, 4.0, 5.0, 0.1, 0.2, 0.3, 0.01, 0.01, 0.05])
    state = initial.draw_initial_state(turn, SPEC, SensorDraws(7, 3))
    error = sd * stream(7, 3, "initial").standard_normal(9)
    assert state.t == turn.t[0]
    assert state.alignment == "given"
    assert_allclose(state.cov, np.diag(sd**2))
    assert_allclose(earth.difference_n(state.lla, turn.lla[0]), error[:3], rtol=0, atol=1e-5)
    assert_allclose(state.vel_n - turn.vel_n[0], error[3:6], rtol=0, atol=1e-12)
    C_true, C_est = rotation.matrix(turn.q_nb[0]), rotation.matrix(state.q_nb)
    first_order = (np.eye(3) + rotation.skew(error[6:])) @ C_true
    second_order = np.linalg.norm(error[6:]) ** 2
    assert_allclose(C_est, first_order, rtol=0, atol=second_order)
    assert np.abs(C_est - C_true @ (np.eye(3) + rotation.skew(error[6:]))).max() > second_order


@pytest.mark.parametrize(
    ("figure", "columns"),
    [
        ("initial_pos_sd", slice(0, 3)),
        ("initial_vel_sd", slice(3, 6)),
        ("initial_tilt_sd", slice(6, 8)),
        ("initial_heading_sd", slice(8, 9)),
    ],
)
def test_doubling_an_initial_sd_doubles_that_error_alone(turn, figure, columns):
    def error(spec):
        state = initial.draw_initial_state(turn, spec, SensorDraws(1, 0))
        phi_n = rotation.to_rotvec(rotation.multiply(state.q_nb, rotation.conjugate(turn.q_nb[0])))
        pos_n = earth.difference_n(state.lla, turn.lla[0])
        return np.concatenate([pos_n, state.vel_n - turn.vel_n[0], phi_n])

    value = getattr(SPEC, figure)
    twice = tuple(2 * v for v in value) if isinstance(value, tuple) else 2 * value
    expected = error(SPEC)
    expected[columns] *= 2
    assert_allclose(error(replace(SPEC, **{figure: twice})), expected, rtol=0, atol=1e-8)


def test_initial_errors_fill_their_covariance():
    """400 runs of 9 components: mean of e^T P^-1 e over 9 within the 99.9 % band of chi2(3600) / 3600."""
    truth = still(1.0, 10.0)
    ratios = []
    for run in range(400):
        state = initial.draw_initial_state(truth, SPEC, SensorDraws(1, run))
        phi_n = rotation.to_rotvec(rotation.multiply(state.q_nb, rotation.conjugate(truth.q_nb[0])))
        pos_n = earth.difference_n(state.lla, truth.lla[0])
        error = np.concatenate([pos_n, state.vel_n, phi_n])
        ratios.append(error @ np.linalg.solve(state.cov, error) / 9)
    low, high = band(3600)
    assert low < np.mean(ratios) < high
    assert not low < 1.1**2 * np.mean(ratios) < high  # sds 10 % too large would be seen
