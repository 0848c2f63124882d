"""The invariant EKF with biases: matrices against finite differences, covariances against many runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import expm, logm

from bench.core.mathematics import rotation
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.models.invariant_ekf import InvariantFlight
from bench.navigation.options import InvariantOptions
from bench.simulation import sensors
from tests.builders import band, ensemble
from tests.weaving import DEG, IMU, units, weaving

ARM = np.array([0.8, -0.3, 0.5])
STEPS = (1e-5, 1e-5, 1e-5, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, 1e-3, *[1e-5] * 3, *[1e-4] * 3)


@pytest.fixture(scope="module")
def flight():
    """The filter in the middle of a turn."""
    sensed = sensors.sense(weaving(2.0), units(), 1, 0)
    made = InvariantFlight(InvariantOptions(), IMU, sensed.initial)
    made.w_ib_b = np.array([0.2, -0.1, 0.3])
    return made


def as_group(flight) -> np.ndarray:
    X = np.eye(5)
    X[:3, :3], X[:3, 3], X[:3, 4] = flight.C_tb, flight.p_t, flight.v_t
    return X


def moved(flight, x):
    """A copy whose estimate is moved by an error; the exponential is that of scipy."""
    other, error = flight.copy(), np.eye(5)
    error[:3, :3], error[:3, 3], error[:3, 4] = expm(rotation.skew(x[:3])), x[3:6], x[6:9]
    X = as_group(flight) @ error
    other.C_tb, other.p_t, other.v_t = X[:3, :3], X[:3, 3], X[:3, 4]
    other.bias = flight.bias + x[9:]
    return other


def error_of(truth, estimate) -> np.ndarray:
    error = np.linalg.solve(as_group(estimate), as_group(truth))
    A = np.real(logm(error[:3, :3]))
    phi = np.array([A[2, 1], A[0, 2], A[1, 0]])
    return np.concatenate([phi, error[:3, 3], error[:3, 4], truth.bias - estimate.bias])


def difference(flight, of) -> np.ndarray:
    columns = []
    for k, size in enumerate(STEPS):
        x = np.eye(15)[k] * size
        columns.append((of(moved(flight, x)) - of(moved(flight, -x))) / (2.0 * size))
    return np.array(columns).T


def test_the_transition_is_that_of_finite_differences(flight):
    """The carried P of P = I is Phi Phi^T; every state of the fifteen, a hundredth of a second of a turn."""
    dt, turn, push = 0.01, np.array([0.004, -0.003, 0.006]), np.array([0.05, -0.02, -0.1])

    def carried(one):
        other = one.copy()
        other.predict(dt, turn, push, np.zeros(2))
        return other

    ahead = carried(flight)
    Phi = difference(flight, lambda one: error_of(carried(one), ahead))
    start = flight.copy()
    start.P, start.q = np.eye(15), np.zeros(15)
    start.predict(dt, turn, push, np.zeros(2))
    assert_allclose(start.P, Phi @ Phi.T, atol=3e-6)


def test_the_rows_are_those_of_finite_differences(flight):
    H = flight.compare(np.zeros(6), ARM)[1]
    found = difference(flight, lambda one: -one.compare(np.zeros(6), ARM)[0])
    assert_allclose(H, found, atol=2e-6)


def test_the_feedback_moves_the_estimate_and_p_with_it(flight):
    """What is left of an error after half of it is fed back, beside what P is turned by: to second order."""
    x = 1e-2 * np.arange(1.0, 16.0) / 15.0
    fed = flight.copy()
    fed.P = np.diag(np.arange(1.0, 16.0))
    fed.feed_back(x)
    assert_allclose(as_group(fed), as_group(moved(flight, x)), atol=1e-12)
    G = difference_about(flight, x)
    P = G @ np.diag(np.arange(1.0, 16.0)) @ G.T
    assert_allclose(fed.P, P, atol=1e-4)
    assert np.abs(np.diag(np.arange(1.0, 16.0)) - P).max() > 1e-3


def difference_about(flight, x) -> np.ndarray:
    """How the error after a feedback of x follows from errors near x."""
    fed, columns = moved(flight, x), []
    for k, size in enumerate(STEPS):
        e = np.eye(15)[k] * size
        after = (error_of(moved(flight, x + e), fed), error_of(moved(flight, x - e), fed))
        columns.append((after[0] - after[1]) / (2.0 * size))
    return np.array(columns).T


@pytest.mark.parametrize(("sigmas", "part"), [(0.0, 0.0), (2.9, 0.0), (10.0, 0.91)])
def test_an_attitude_error_turns_no_noise(flight, sigmas, part):
    """Level and at rest; a force beyond that by some sigma of the noise is turned as far as it is motion."""
    one, dt, psi = flight.copy(), 0.01, 1e-4
    one.C_tb, one.v_t, one.bias = np.eye(3), np.zeros(3), np.zeros(6)
    one.gravity, one.q = np.array([0.0, 0.0, 9.8]), np.full(15, 1e-6)
    one.P = np.zeros((15, 15))
    one.P[:3, :3] = psi**2 * np.eye(3)
    more = sigmas * np.sqrt(one.q[6] / dt) * np.array([0.6, -0.8, 0.0])
    one.predict(dt, one.frame.w_t * dt, (more - one.gravity) * dt, np.zeros(2))
    assert_allclose(one.P[6:8, 2] / (psi**2 * dt), part * np.array([-more[1], more[0]]), atol=1e-6)
    assert_allclose(one.P[8, :2] / (psi**2 * dt), part * np.array([more[1], -more[0]]), atol=1e-6)


def test_it_knows_its_errors():
    """NEES of nine states late in 60 s: within the 99.9 % band of the mean of 6 runs."""
    truth, spec = weaving(60.0, rate=50.0), replace(units(), output_rate=1.0)
    one = load("invariant-ekf", {})
    found = ensemble(one, truth, lambda k: sensors.sense(truth, spec, 7, k), 6, 50.0)
    low, high = band(6, states=9)
    assert low < np.mean([nees[0] for nees in found.nees]) < high


def test_a_heading_that_is_far_off_comes_in():
    """40 deg off, where it reports 45: in a minute of turns it is right to what it reports, in three runs."""
    truth = weaving(90.0, rate=50.0)
    spec = replace(units(), output_rate=1.0, initial_heading_sd=45.0 * DEG)
    for run in range(3):
        sensed = sensors.sense(truth, spec, 11, run)
        found = error_series(truth, load("invariant-ekf", {}).run(sensed.data, sensed.initial))
        assert np.abs(found.heading[-1]) < 3.0 * DEG
