"""Covariances by source of error against closed forms, a toy solved by hand, and Monte Carlo."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.core.records.instruments import BaroSpec
from bench.core.records.sensor_specs import AssumedSpecs, GnssSpec, ImuSpec, TriadSpec
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.linear import gains, terms
from bench.evaluation.linear.best_linear import Epochs, bound_errors, find_epochs
from bench.evaluation.linear.error_budget import split_errors
from bench.evaluation.linear.gains import record_gains
from bench.evaluation.linear.path import make_path
from bench.evaluation.linear.switching import keep_source, sense_alone
from bench.evaluation.linear.terms import model_errors
from bench.io.config.datasheets import read_imu
from bench.io.config.library import find_datasheet
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.measurement_rows import BARO as MEASURED_BARO
from bench.navigation.error_state_filter.measurement_rows import POSITION, VELOCITY
from bench.simulation import sensors
from tests.builders import band
from tests.synthetic import still, turning
from tests.weaving import BARO, DEG, IMU, units, weaving

G = 9.80665
NOTHING = ImuSpec("perfect", TriadSpec(), TriadSpec())
EVERY = ImuSpec(
    "every",
    replace(
        IMU.gyro,
        scale_factor_sd=3e-3,
        misalignment_sd=3e-3,
        nonorthogonality_sd=2e-3,
        alignment_sd=1e-3,
        scale_asymmetry_sd=5e-4,
        nonlinearity_sd=1e-3,
        range=5.0,
        g_sensitivity_sd=2e-5,
        rate_random_walk=1e-6,
        bias_model="flicker",
    ),
    replace(
        IMU.accel, scale_factor_sd=3e-3, misalignment_sd=3e-3, quadratic_sd=1e-4, nonorthogonality_sd=1e-3
    ),
)
GNSS = GnssSpec("wandering", 1.0, 1.5, 2.5, 0.03, 3.0, 4.0, 0.05, 4e-6, 5e-4, 0.01)
OUTPUT = np.arange(0.0, 61.0, 5.0)


def wandering():
    """Every error of an IMU, a receiver that wanders, and a start near enough for a linear model."""
    return replace(units(EVERY, GNSS), initial_tilt_sd=0.1 * DEG, initial_heading_sd=0.3 * DEG)


def study(truth, spec, use, output=OUTPUT):
    """Filter without tests of its innovations, gains and budget of one estimator."""
    filter_ = load(use, {"integrity": ()})
    sensed = sensors.sense(truth, spec, 1, 0)
    gains = record_gains(filter_, sensed, truth, output)
    return filter_, gains, split_errors(gains, model_errors(truth, spec, 1, known_jumps=True))


def errors_of(filter_, truth, sensed, output=OUTPUT):
    """Errors (M, 9) of position, velocity, attitude of one run."""
    solution = filter_.run(replace(sensed.data, output_t=output), sensed.initial)
    found = error_series(truth, solution)
    return np.hstack([found.pos_n, found.vel_n, found.phi_n])


def test_free_drift_is_the_closed_form_of_each_source():
    """A minute at rest, each source alone: b T^2 / 2, g b T^3 / 6, N^2 T^3 / 3, g^2 N^2 T^5 / 20, v T."""
    T, gyro, accel = 60.0, IMU.gyro, IMU.accel
    truth = still(T, 50.0, (0.0, 0.0, 0.0))
    _, _, budget = study(truth, units(gnss=None, baro=None), "free-inertial", np.array([0.0, T]))
    expected = {
        "initial position": 3.0,
        "initial velocity": 0.2 * T,
        "initial tilt": 0.5 * DEG * G * T**2 / 2,
        "gyro white noise": gyro.random_walk * G * np.sqrt(T**5 / 20),
        "gyro turn-on bias": gyro.turn_on_bias_sd * G * T**3 / 6,
        "accelerometer white noise": accel.random_walk * np.sqrt(T**3 / 3),
        "accelerometer turn-on bias": accel.turn_on_bias_sd * T**2 / 2,
    }
    for name, sd in expected.items():
        found = np.sqrt(budget.variance[-1, :2, budget.sources.index(name)])
        assert_allclose(found, sd, rtol=4e-3, err_msg=name)


def test_a_filter_of_one_state_is_as_by_hand():
    """Height from M readings of white variance r, by a filter that takes it for r': weights by hand."""
    start, r, assumed = 5.0, 0.25, 1.0
    baro = BaroSpec("white", 5.0, np.sqrt(r))
    spec = replace(
        units(NOTHING, None, baro),
        initial_pos_sd=(1e-3, 1e-3, start),
        initial_vel_sd=(1e-9,) * 3,
        initial_tilt_sd=1e-12,
        initial_heading_sd=1e-12,
    )
    spec = replace(spec, assumed=AssumedSpecs(NOTHING, None, baro=replace(baro, white_sd=np.sqrt(assumed))))
    truth = still(4.0, 50.0)
    output = np.arange(0.0, 4.1, 1.0)
    _, gains, budget = study(truth, spec, "baro-inertial", output)
    M = 5 * output
    down, noise = (
        budget.variance[:, 2, budget.sources.index(name)] for name in ("initial position", "barometer noise")
    )
    assert_allclose(down, start**2 * (assumed / (assumed + M * start**2)) ** 2, rtol=1e-4)
    assert_allclose(noise, M * r * (start**2 / (assumed + M * start**2)) ** 2, rtol=1e-4)
    assert_allclose(budget.claimed[:, 2], 1 / (1 / start**2 + M / assumed), rtol=1e-4)
    model = model_errors(truth, spec, 1, known_jumps=False)
    sensed = sensors.sense(truth, spec, 1, 0)
    epochs = find_epochs(gains.path, sensed.data)
    bound = bound_errors(gains.path, model, epochs, gains.output, np.zeros(3), smooth=True)
    assert_allclose(bound.causal[:, 2, 2], 1 / (1 / start**2 + M / r), rtol=1e-4)
    assert_allclose(bound.smoothed[:, 2, 2], 1 / (1 / start**2 + M[-1] / r), rtol=1e-4)


@pytest.fixture(scope="module")
def flight():
    return weaving(60.0, 50.0)


def test_the_sources_add_up_to_the_covariance_of_a_filter_that_knows_them_all(flight):
    """`loose-full` has a state for each of 29 sources; one left out of the truth would be missed."""
    spec = wandering()
    _, _, budget = study(flight, spec, "loose-full")
    assert len(budget.sources) == 29
    assert_allclose(np.sqrt(budget.total / budget.claimed), 1.0, atol=0.02)
    less = np.delete(budget.variance, budget.sources.index("gyro misalignment"), axis=2).sum(axis=2)
    assert np.sqrt(less / budget.claimed)[-1].min() < 0.9


@pytest.mark.parametrize("grade", ["grade-1", "grade-2", "grade-3"])
def test_single_runs_add_up_to_the_full_run(flight, grade):
    """Register #17: the errors of runs with one source each, summed, are those of the full run within 3 %."""
    imu = read_imu(*find_datasheet("imu", grade, Path()))
    spec = replace(wandering(), imu=imu, assumed=AssumedSpecs(imu, GNSS, baro=BARO))
    filter_ = load("loose-15", {"integrity": ()})
    sources = model_errors(flight, spec, 1, known_jumps=True).sources
    whole = errors_of(filter_, flight, sensors.sense(flight, spec, 1, 0))
    parts = [errors_of(filter_, flight, sense_alone(flight, spec, one, 1, 0)) for one in sources]
    left, less = np.sum(parts, axis=0) - whole, np.sum(parts[1:], axis=0) - whole
    rms, missed, short = (
        np.sqrt(np.mean(np.square(one).reshape(-1, 3, 3), axis=(0, 2))) for one in (whole, left, less)
    )
    assert (missed < 0.03 * rms).all(), missed / rms
    assert not (short < 0.03 * rms).all()  # nor without one of them


@pytest.mark.parametrize("name", [None, "gyro misalignment"])
def test_the_covariance_is_that_of_monte_carlo(flight, name):
    """Mean squares of 24 draws over their variance, in the 99.9 % band of each of nine states at the end."""
    spec, draws = wandering(), 24
    filter_, _, budget = study(flight, spec, "loose-15", OUTPUT[[0, -1]])
    if name is None:
        expected = budget.total[-1]
        drawn = [sensors.sense(flight, spec, 1, run) for run in range(draws)]
    else:
        source = next(
            one for one in model_errors(flight, spec, 1, known_jumps=True).sources if one.name == name
        )
        expected = budget.variance[-1, :, budget.sources.index(name)]
        drawn = [sense_alone(flight, spec, source, 1, run) for run in range(draws)]
    errors = np.array([errors_of(filter_, flight, one, OUTPUT[-1:])[0] for one in drawn])
    low, high = band(draws)
    ratio = np.mean(errors**2, axis=0) / expected
    assert ((ratio > low) & (ratio < high)).all(), ratio
    assert not ((ratio / 4 > low) & (ratio / 4 < high)).all()  # half of an error would be seen


def test_no_filter_is_below_the_bound(flight):
    spec = wandering()
    model = model_errors(flight, spec, 1, known_jumps=False)
    sensed = sensors.sense(flight, spec, 1, 0)
    path = make_path(flight, spec.imu, np.concatenate([sensed.data.fixes.t, sensed.data.baro.t, OUTPUT]))
    output = np.searchsorted(path.t, OUTPUT - 1e-6)
    epochs = find_epochs(path, sensed.data)
    bound = bound_errors(path, model, epochs, output, sensed.data.antenna_b, smooth=True)
    causal = np.einsum("mii->mi", bound.causal)[:, :9]
    smoothed = np.einsum("mii->mi", bound.smoothed)
    assert (smoothed <= causal * (1 + 1e-9)).all()
    assert (smoothed > 0).all()
    assert_allclose(smoothed[-1], causal[-1])
    for use, most in (("loose-15", np.inf), ("loose-22", np.inf), ("loose-full", 1.02)):
        total = study(flight, spec, use)[2].total
        assert (total > causal * 0.999).all(), use
        assert (np.sqrt(total / causal) < most).all(), use
    none = Epochs(epochs.step[:0], epochs.code[:0])
    free = bound_errors(path, model, none, output, sensed.data.antenna_b, smooth=False)
    assert (np.einsum("mii->mi", free.causal)[1:, :9] > causal[1:]).all()


def test_rows_of_an_antenna_are_those_of_its_place_and_swing():
    """Columns of C r and C (w x r) by each component of r and of a turn; of a receiver and a barometer."""
    index = SimpleNamespace(antenna_b=15, gnss_pos=18, baro_bias=24)
    C = rotation.matrix(rotation.from_euler(0.3, -0.2, 1.1))
    w, r = np.array([0.3, -0.5, 0.7]), np.array([1.0, 2.0, 3.0])
    path = SimpleNamespace(C_nb=C[None], lla=np.array([[0.7, 0.2, 100.0]]), rate_b=w[None])
    place, swing = (gains.measurement_rows(path, 0, code, r, index, 25) for code in (POSITION, VELOCITY))
    assert_allclose(place[:, 15:18], C)
    assert_allclose(swing[:, 15:18], C @ np.column_stack([np.cross(w, axis) for axis in np.eye(3)]))
    assert_allclose(place[:, :3], np.eye(3))
    assert_allclose(swing[:, 3:6], np.eye(3))
    assert_allclose(place[:, 6:9], np.column_stack([np.cross(axis, C @ r) for axis in np.eye(3)]))
    turned = np.column_stack([np.cross(axis, C @ np.cross(w, r)) for axis in np.eye(3)])
    assert_allclose(swing[:, 6:9], turned, atol=1e-3)
    assert_allclose(np.vstack([place, swing])[:, 18:24], np.eye(6))
    (baro,) = gains.measurement_rows(path, 0, MEASURED_BARO, r, index, 25)
    assert np.flatnonzero(baro).tolist() == [2, 24]
    assert (baro[2], baro[24]) == (-1.0, 1.0)
    bare = SimpleNamespace(antenna_b=-1, gnss_pos=-1, baro_bias=-1)
    assert not gains.measurement_rows(path, 0, VELOCITY, r, bare, 25)[:, 15:].any()
    assert np.flatnonzero(gains.measurement_rows(path, 0, MEASURED_BARO, r, bare, 25)).tolist() == [2]


def test_a_source_alone_has_its_figures_and_no_other():
    """All errors of all sensors at once, and what is left of them for each source."""
    spec = replace(wandering(), baro=replace(BARO, white_sd=0.5, bias_sd=3.0, bias_walk=0.05))
    parts = {
        "gyro": spec.imu.gyro,
        "accel": spec.imu.accel,
        "gnss": spec.gnss,
        "baro": spec.baro,
        "initial": spec,
    }
    every = list(terms.list_sources())
    for source in every:
        kept = keep_source(spec, source)
        left = {"gyro": kept.imu.gyro, "accel": kept.imu.accel, "gnss": kept.gnss, "baro": kept.baro}
        for part, whole in parts.items():
            one = left.get(part, kept)
            if part == "baro" and source.name == terms.PHYSICAL:
                assert one == whole
                continue
            for name in {figure for other in every if other.part == part for figure in other.figures}:
                value = getattr(one, name)
                if source.part == part and name in source.figures:
                    assert value == getattr(whole, name), (source.name, part, name)
                elif isinstance(value, float | tuple):
                    assert not np.any(value), (source.name, part, name)


def test_the_distance_between_accelerometers_is_what_a_turn_makes_of_it():
    """A steady turn: each axis feels w x (w x r) of its own place, in m/s^2 and not in m/s."""
    truth, arms = turning(4.0, 100.0, turn_rate=0.5), 0.01 * np.array([[9.0, 1, 2], [3, 8, 1], [2, 1, 7]])
    imu = ImuSpec("made", TriadSpec(), TriadSpec(), accel_arms=tuple(map(tuple, arms.tolist())))
    (found,) = terms.sampled_imu(truth, imu, 1)
    w = (truth.dtheta_b / np.diff(truth.t)[:, None]).mean(axis=0)
    felt = [np.cross(w, np.cross(w, arm))[axis] for axis, arm in enumerate(arms)]
    signal = np.asarray(found.signal)[50:-50]
    assert_allclose(signal[:, :3], 0.0, atol=1e-12)
    assert_allclose(signal[:, 3:], np.tile(felt, (len(signal), 1)), rtol=0.02, atol=1e-4)
