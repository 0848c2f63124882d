"""One filter, several layouts: 15 states, the 22 of A-5.4.1, baro-inertial; each consistent in its own model.

Register #34: loosely coupled error-state filter with GNSS Markov states.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench import pipeline
from bench.core.mathematics import earth
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import AxisFigures, ImuSpec, TriadSpec
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.imu_states import EVERY_ERROR, MEMS
from bench.navigation.error_state_filter.state_blocks import state_model
from bench.navigation.estimator import find_same
from bench.navigation.models.loose_tight import Loose
from tests.builders import assert_same_solution, band, ensemble, first_rows, student

RUNS = 40
"""Fewest runs that `bench.evaluation.ensembles.ensemble_consistency` evaluates."""
BY_AXIS = [name for name, one in triad_figures_of(TriadSpec).items() if one.by_axis]


@pytest.fixture(scope="module")
def profile():
    """Matched IMU and barometer, and the receiver of the catalog with its wandering error."""
    matched = read_profile("figure-eight-matched", {"sensors.gnss": "l1-code"})
    return replace(matched, evaluation=EvaluationWindow(120.0))


def without_markov(specs):
    return replace(specs, gnss=replace(specs.gnss, pos_h_markov_sd=0, pos_v_markov_sd=0, vel_markov_sd=0))


def test_states_without_variance_change_nothing(profile, five_minutes):
    """A 22-state layout with zero variance in its extra states equals the 15-state one."""
    sensed = pipeline.sense(profile, five_minutes)
    data = replace(sensed.data, specs=without_markov(sensed.data.specs))
    small, large = (Loose(gnss_markov=markov).run(data, sensed.initial) for markov in (False, True))
    assert_allclose(earth.difference_n(small.lla, large.lla), 0, atol=1e-7)  # [m]; latitude rounds at 1e-9 m
    assert_allclose(small.vel_n, large.vel_n, rtol=0, atol=1e-9)
    assert_allclose(small.cov, large.cov, rtol=1e-9, atol=1e-18)
    assert large.extra.shape[1] == small.extra.shape[1] + 6
    assert not large.extra[:, -6:].any()


def test_scale_factors_without_variance_change_nothing(profile, five_minutes):
    """The 37 states of loose-mems with no scale factor error or g-sensitivity assumed equal the 22."""
    sensed = pipeline.sense(profile, five_minutes)
    small, large = (
        Loose(gnss_markov=True, mems=mems).run(sensed.data, sensed.initial) for mems in (False, True)
    )
    assert_allclose(earth.difference_n(small.lla, large.lla), 0, atol=1e-7)  # [m]; latitude rounds at 1e-9 m
    assert_allclose(small.vel_n, large.vel_n, rtol=0, atol=1e-9)
    assert_allclose(small.cov, large.cov, rtol=1e-9, atol=1e-18)
    assert large.extra.shape[1] == small.extra.shape[1] + 15
    assert not large.extra[:, -15:].any()


def draws(estimator, profile, truth, runs, assumed=None):
    """Return an ensemble over the runs of a profile's sensors."""
    return ensemble(
        estimator,
        truth,
        lambda run: pipeline.sense(profile, truth, run),
        runs,
        profile.evaluation.begin,
        assumed,
    )


def claims(name, profile, truth, runs, **options):
    """Return the verdict on the three tests of consistency."""
    return draws(load(name, options), profile, truth, runs).claims()


def with_mems_errors(profile):
    """Scale factors of 3000 ppm and a g-sensitivity of 36 deg/h/g, on board and assumed."""
    imu = profile.sensors.imu
    imu = replace(
        imu,
        gyro=replace(imu.gyro, scale_factor_sd=3e-3, g_sensitivity_sd=np.deg2rad(36 / 3600) / 9.81),
        accel=replace(imu.accel, scale_factor_sd=3e-3),
    )
    assumed = replace(profile.sensors.assumed, imu=imu)
    return replace(profile, sensors=replace(profile.sensors, imu=imu, assumed=assumed))


@pytest.mark.slow
def test_loose_mems_knows_scale_factors_and_g_sensitivity(profile, five_minutes):
    """40 runs of 300 s on matched sensors: all three tests pass; without the states NEES is far off.

    With the wandering receiver the mean of 20 runs is in its 99.9 % band.
    """
    matched = with_mems_errors(read_profile("figure-eight-matched"))
    result = claims("loose-mems", matched, five_minutes, RUNS)
    assert not result.rejected, result.reasons
    mems = with_mems_errors(profile)
    found = draws(load("loose-mems", {}), mems, five_minutes, 20)
    assert abs(standard_errors_from(found.averages(), 9)) < student(20)
    assert all(nis.inside for nis in found.pooled_nis().values()), found.pooled_nis()
    without = draws(load("loose-22", {}), mems, five_minutes, 5)
    assert np.median(without.averages()) > 30


def test_scale_factors_are_found(profile, five_minutes):
    """Turns and a climb show some of them: the sd of half of the axes falls by a third or more."""
    sensed = pipeline.sense(with_mems_errors(profile), five_minutes)
    solution = load("loose-mems", {}).run(sensed.data, sensed.initial)
    at = [k for k, name in enumerate(solution.extra_names) if "_scale_" in name]
    assert len(at) == 6
    kept = solution.extra_sd[-1, at] / solution.extra_sd[0, at]
    assert np.sum(kept < 2 / 3) >= 2
    assert "gyro scale factor" not in load("loose-mems", {}).unmodeled_errors(sensed.data.specs)
    assert "gyro g-sensitivity" in load("loose-22", {}).unmodeled_errors(sensed.data.specs)


def test_figures_of_one_axis_are_those_of_its_states(profile, five_minutes):
    """States of z begin and move as with its figure for all axes; the white noise is that of z for all."""
    sensed = pipeline.sense(profile, five_minutes)
    small = dict.fromkeys(BY_AXIS, 1e-4) | {"bias_correlation": 50.0, "misalignment_sd": 1e-3}
    large = small | dict.fromkeys(BY_AXIS, 5e-4)
    axes = tuple(AxisFigures(name, 1e-4, 1e-4, 5e-4) for name in BY_AXIS)
    for blocks in ((MEMS,), (EVERY_ERROR,)):
        models = []
        for triad in (TriadSpec(**small), TriadSpec(**large, axes=axes), TriadSpec(**large)):
            specs = replace(sensed.data.specs, imu=ImuSpec("by axis", triad, triad))
            models.append(state_model(sensed.initial, specs, blocks))
        n, axis = models[0].layout.size, np.arange(models[0].layout.size) % 3
        white = np.isin(np.arange(n), np.r_[models[0].layout.slice("vel"), models[0].layout.slice("phi")])
        for usual, ours, whole in (
            [np.diag(model.P) for model in models],
            *([getattr(model.process, name) for model in models] for name in ("q", "stationary")),
        ):
            assert_allclose(ours[(axis < 2) & ~white], usual[(axis < 2) & ~white], rtol=1e-12)
            assert_allclose(ours[(axis == 2) | white], whole[(axis == 2) | white], rtol=1e-12)
            assert np.array_equal(ours, usual) == (not whole.any())  # stationary in one layout alone


def with_matrix_errors(profile):
    """Misalignments of 4 mrad, scale factors of 2000 ppm, g-sensitivity, on board and assumed."""
    imu = profile.sensors.imu
    imu = replace(
        imu,
        gyro=replace(
            imu.gyro,
            misalignment_sd=4e-3,
            scale_factor_sd=2e-3,
            g_sensitivity_sd=np.deg2rad(36 / 3600) / 9.81,
        ),
        accel=replace(imu.accel, misalignment_sd=3e-3, nonorthogonality_sd=2e-3, scale_factor_sd=2e-3),
    )
    assumed = replace(profile.sensors.assumed, imu=imu)
    return replace(profile, sensors=replace(profile.sensors, imu=imu, assumed=assumed))


@pytest.mark.slow
def test_loose_full_knows_misalignments(five_minutes):
    """40 runs of 300 s on matched sensors: all consistent; loose-mems without the states is far off."""
    matched = with_matrix_errors(read_profile("figure-eight-matched"))
    result = claims("loose-full", matched, five_minutes, RUNS)
    assert not result.rejected, result.reasons
    without = draws(load("loose-mems", {}), matched, five_minutes, 5)
    assert np.median(without.averages()) > 30


@pytest.mark.slow
def test_loose_full_is_honest_on_a_consumer_unit(five_minutes):
    """Eight runs of a unit with every error: the band of NEES holds 9; loose-mems has hundreds."""
    profile = read_profile("figure-eight", {"sensors.imu": "icm-42688-p"})
    honest, fooled = (
        draws(load(name, {}), profile, five_minutes, 8).averages() for name in ("loose-full", "loose-mems")
    )
    assert abs(honest.mean() - 9.0) < student(8) * honest.std(ddof=1) / np.sqrt(8)
    assert fooled.mean() - 9.0 > student(8) * fooled.std(ddof=1) / np.sqrt(8)
    assert fooled.min() > 100.0


def test_loose_full_has_states_for_what_the_datasheet_names(profile):
    full = load("loose-full", {})
    counts = {}
    for unit in ("adis16475", "icm-42688-p", "matched-mems"):
        specs = read_profile("figure-eight", {"sensors.imu": unit}).sensors.assumed
        counts[unit] = sum(states.size for block in full.blocks() for states in block.states(specs))
        left = full.unmodeled_errors(specs)
        assert not left
    # barometer and receiver 7; gyro matrix 9 or both matrices 18; flicker stages 12; of the second unit
    # nonlinearity and temperature of both triads 12
    assert counts == {"adis16475": 28, "icm-42688-p": 49, "matched-mems": 7}


@pytest.mark.parametrize("unit", ["bmi088", "mpu-6050", "mti-300"])
def test_loose_full_answers_with_every_kind_of_state(five_minutes, unit):
    """Nonlinearity, temperature, g-sensitivity, a bias of degrees per second: a minute, within 5 sigma."""
    truth = first_rows(five_minutes, 12_001)
    sensed = pipeline.sense(read_profile("figure-eight", {"sensors.imu": unit}), truth)
    solution = load("loose-full", {}).run(sensed.data, sensed.initial)
    errors = error_series(truth, solution)
    assert np.isfinite(errors.nees).all()
    assert errors.nees[errors.t > 30.0].mean() < 9 * 5


def test_filters_of_equal_states_are_the_same_and_say_so(five_minutes):
    """By their states and options, not by their answers; loose-full and loose-22 then agree bit by bit."""
    truth = first_rows(five_minutes, 2001)
    built = {name: load(name, {}) for name in ("loose-15", "loose-22", "loose-mems", "loose-full", "tight")}
    built["slow"] = load("loose-22", {"covariance_hz": 4.0})
    found = {}
    for unit, gnss in (
        ("matched-mems", "l1-code"),
        ("matched-mems", "matched-white"),
        ("adis16475", "l1-code"),
    ):
        sensors = {"sensors.imu": unit, "sensors.gnss": gnss, "sensors.baro": "matched-walk"}
        sensed = pipeline.sense(read_profile("figure-eight", sensors), truth)
        found[unit, gnss] = find_same(built, sensed.data)
    assert found == {
        ("matched-mems", "l1-code"): {"loose-mems": "loose-22", "loose-full": "loose-22"},
        ("matched-mems", "matched-white"): dict.fromkeys(
            ["loose-22", "loose-mems", "loose-full"], "loose-15"
        ),
        ("adis16475", "l1-code"): {"loose-mems": "loose-22"},
    }
    sensors = {"sensors.imu": "matched-mems", "sensors.baro": "matched-walk"}
    sensed = pipeline.sense(read_profile("figure-eight", sensors), truth)
    one, other = (built[name].run(sensed.data, sensed.initial) for name in ("loose-22", "loose-full"))
    assert_same_solution(one, other)


def standard_errors_from(nees, states):
    return (nees.mean() - states) / (nees.std(ddof=1) / np.sqrt(len(nees)))


@pytest.mark.slow
def test_loose_22_keeps_all_three_claims_on_matched_sensors(five_minutes):
    """40 seeds of 300 s, every error modeled, Markov states of a receiver without Markov error in it."""
    result = claims("loose-22", read_profile("figure-eight-matched"), five_minutes, RUNS)
    assert not result.rejected, result.reasons
    assert set(result.nis) == {"gnss_position", "gnss_velocity", "baro"}


@pytest.mark.slow
def test_loose_22_knows_the_error_of_a_wandering_receiver(profile, five_minutes):
    """Mean NEES and mean NIS in their 99.9 % bands; the runs are the samples."""
    found = draws(load("loose-22", {}), profile, five_minutes, RUNS)
    assert abs(standard_errors_from(found.averages(), 9)) < student(RUNS)
    assert all(nis.inside for nis in found.pooled_nis().values()), found.pooled_nis()


@pytest.mark.slow
def test_the_same_check_fails_for_markov_errors_assumed_a_third_too_small(profile, five_minutes):
    gnss = profile.sensors.assumed.gnss
    small = replace(
        profile.sensors.assumed,
        gnss=replace(
            gnss,
            pos_h_markov_sd=gnss.pos_h_markov_sd * 0.67,
            pos_v_markov_sd=gnss.pos_v_markov_sd * 0.67,
            vel_markov_sd=gnss.vel_markov_sd * 0.67,
        ),
    )
    found = draws(load("loose-22", {}), profile, five_minutes, RUNS, small)
    assert standard_errors_from(found.averages(), 9) > student(RUNS)
    assert not found.pooled_nis()["gnss_velocity"].inside


def test_loose_15_believes_what_the_receiver_averages_away(profile, five_minutes):
    """Section 7.1 (a): with the error taken for white, position is no better and far too sure of itself."""
    sensed = pipeline.sense(profile, five_minutes)
    nees = {}
    for name in ("loose-15", "loose-22"):
        solution = load(name, {}).run(sensed.data, sensed.initial)
        errors, _ = pipeline.measure(profile, five_minutes, solution)
        nees[name] = errors.nees[errors.t >= 120.0].mean()
    assert nees["loose-15"] > 50
    assert nees["loose-22"] < 30


def test_loose_22_reports_a_position_no_better_than_the_receiver(profile, five_minutes):
    """Section 7.1 (a): the Markov error is not separable from the INS error in loose coupling."""
    sensed = pipeline.sense(profile, five_minutes)
    solution = load("loose-22", {}).run(sensed.data, sensed.initial)
    sd = np.sqrt(solution.cov[-1, 0, 0])
    assert 0.3 * profile.sensors.gnss.pos_h_markov_sd < sd < profile.sensors.gnss.pos_h_markov_sd


@pytest.mark.slow
def test_open_loop_covariance_against_monte_carlo(profile, five_minutes):
    """free-inertial and baro-inertial: errors over their own sigma at the end are standard normal.

    After 100 s errors are still small enough to be linear. Each component over 60 runs, chi-square with 60
    degrees of freedom, 99.9 % band: 0.47 to 1.77 of its mean.
    """
    runs = 60
    low, high = band(runs)
    truth = first_rows(five_minutes, 20_001)
    for name in ("free-inertial", "baro-inertial"):
        squares = np.zeros(9)
        for run in range(runs):
            sensed = pipeline.sense(profile, truth, run)
            solution = load(name, {}).run(sensed.data, sensed.initial)
            errors = error_series(truth, solution)
            error = np.concatenate([errors.pos_n[-1], errors.vel_n[-1], errors.phi_n[-1]])
            squares += error**2 / np.diag(solution.cov[-1]) / runs
        assert ((low < squares) & (squares < high)).all(), (name, squares)


def test_baro_inertial_holds_the_height(profile, five_minutes):
    sensed = pipeline.sense(profile, five_minutes)
    free, held = (load(n, {}).run(sensed.data, sensed.initial) for n in ("free-inertial", "baro-inertial"))
    true = np.interp(free.t, five_minutes.t, five_minutes.lla[:, 2])
    assert np.abs(held.lla[-1, 2] - true[-1]) < 15 < np.abs(free.lla[-1, 2] - true[-1])
    assert held.extra_names[-1] == "baro_bias_m"


def test_what_a_layout_has_no_room_for(profile):
    specs = profile.sensors.assumed
    named = {
        name: load(name, {}).unmodeled_errors(specs) for name in ("loose-15", "loose-22", "baro-inertial")
    }
    assert "time-correlated GNSS position error" in named["loose-15"]
    assert not [text for text in named["loose-22"] if "GNSS" in text]
    assert not [text for text in named["baro-inertial"] if "GNSS" in text]


def test_markov_states_need_their_receiver():
    with pytest.raises(ValueError, match="gnss_markov = true needs gnss = true"):
        Loose(gnss=False, gnss_markov=True)
