"""Fixes of an antenna on an arm, and a heading that is vague: what they may tell, and what not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from bench.core.mathematics import earth, rotation
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.error_state_filter import rough_heading
from bench.navigation.error_state_filter.antenna_rows import antenna_kernel
from bench.navigation.error_state_filter.error_state import feedback_kernel
from bench.simulation import sensors
from tests.hovering import hovering
from tests.navigation.test_error_state import plain

N = 15
LLA, VEL = np.array([0.82, 0.19, 800.0]), np.array([4.0, -3.0, 1.0])
ARM, RATE = np.array([0.6, -0.3, -0.4]), np.array([0.3, -0.2, 0.9])


def covariance(seed):
    root = np.random.default_rng(seed).normal(size=(N, N))
    return 0.01 * root @ root.T


def measure_antenna(state):
    """Position [m from LLA] and velocity of the antenna, n, and the rows of a fix of it."""
    H, z = np.zeros((6, N)), np.zeros(6)
    C = rotation.matrix(state[6:10])
    plain(antenna_kernel)(state, C, ARM, RATE, LLA, np.zeros(3), H, z)
    return z, H


def test_a_gain_that_leaves_out_heading_and_vertical_gyro_bias():
    """The covariance of a gain with both taken out, by Joseph's form; a rotated vertical."""
    P, r = covariance(1), np.random.default_rng(2)
    q = rotation.from_euler(0.4, -0.3, 1.0)
    state = np.concatenate([LLA, VEL, q, np.zeros(6)])
    H, R = r.normal(size=(6, N)), np.diag(r.uniform(0.1, 1.0, 6))
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    best, dx = P - K @ H @ P, K @ r.normal(size=6)
    down = rotation.matrix(q)[2]
    out = np.zeros((N, 2))
    out[8, 0], out[9:12, 1] = 1.0, down
    left = np.eye(N) - out @ out.T
    wanted = (np.eye(N) - left @ K @ H) @ P @ (np.eye(N) - left @ K @ H).T + left @ K @ R @ K.T @ left.T
    kept, found = np.zeros(6), best.copy()
    corrected = dx.copy()
    assert plain(rough_heading.drifting_kernel)(state, P, kept)
    plain(rough_heading.consider_kernel)(found, corrected, kept)
    assert_allclose(found, wanted, atol=1e-12)
    assert_allclose(corrected, left @ dx, atol=1e-12)


@pytest.mark.parametrize(("sd", "drifts"), [(1.01, True), (0.99, False)])
def test_a_gyro_that_knows_the_rate_of_the_earth_may_tell_the_heading(sd, drifts):
    P = np.eye(N)
    P[9:12, 9:12] *= (sd * earth.EARTH_RATE) ** 2
    state = np.concatenate([LLA, VEL, rotation.from_euler(0.5, 0.2, 1.0), np.zeros(6)])
    assert plain(rough_heading.drifting_kernel)(state, P, np.zeros(6)) is drifts


@pytest.mark.parametrize("heading_deg", [-50.0, 3.0, 20.0])
def test_the_antenna_stays_where_the_update_put_it(heading_deg):
    """Its position and velocity by the states, and their covariances by the rows at the new attitude."""
    state = np.concatenate([LLA, VEL, rotation.from_euler(0.2, -0.1, 1.3), np.zeros(6)])
    dx = np.array([0.3, -0.2, 0.1, 0.05, 0.02, -0.03, 0.02, -0.01, np.deg2rad(heading_deg), *np.zeros(6)])
    z, H = measure_antenna(state)
    wanted, P = z - H @ dx, covariance(3)
    spread = H @ P @ H.T
    before, phi = rotation.matrix(state[6:10]), dx[6:9].copy()
    plain(feedback_kernel)(state, dx)
    work = np.vstack([phi, np.zeros((2, 3))])
    plain(rough_heading.swing_kernel)(H, before, rotation.matrix(state[6:10]), work, state, P)
    found, rows = measure_antenna(state)
    assert_allclose(found, wanted, atol=2e-5)  # radii of the Earth over half a meter
    assert_allclose(rows @ P @ rows.T, spread, atol=5e-6)  # the Earth rate turns with the attitude
    assert_allclose(P, P.T, atol=1e-15)


def test_a_hover_tells_no_heading_by_the_arm_of_the_antenna():
    """16 runs of the worst gyros, fixes of a centimeter: 99.9 % of chi-squared, and an unknown bias."""
    truth = hovering(4.0, 50.0, still_s=4.0)
    spec = read_profile("figure-eight", {"sensors.imu": "mpu-6050", "sensors.gnss": "rtk-fixed"}).sensors
    spec = replace(spec, output_rate=1.0, gnss_outages=(), faults=(), alignment="given")
    squares, known = [], []
    for run in range(16):
        drawn = sensors.sense(truth, spec, 31, run)
        solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        squares.append(error_series(truth, solution).heading[-1] ** 2 / solution.cov[-1, 8, 8])
        known.append(solution.extra_sd[-1, solution.extra_names.index("gyro_bias_z_rad_s")])
    assert sum(squares) < chi2.isf(1e-3, 16)
    assert min(known) > 0.9 * spec.imu.gyro.turn_on_bias_sd
