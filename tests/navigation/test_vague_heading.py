"""Fixes of an antenna on an arm, and a heading that is vague: what they may tell, and what not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from bench.core.mathematics import rotation
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


def test_fixes_of_a_hover_are_not_taken_for_a_heading():
    """16 runs of the worst gyros, fixes of a centimeter, a lever arm: 99.9 % of chi-squared."""
    truth = hovering(8.0, 50.0, still_s=8.0)
    spec = read_profile("figure-eight", {"sensors.imu": "mpu-6050", "sensors.gnss": "rtk-fixed"}).sensors
    spec = replace(spec, output_rate=1.0, gnss_outages=(), faults=(), alignment="given")
    squares = []
    for run in range(16):
        drawn = sensors.sense(truth, spec, 31, run)
        solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        squares.append(error_series(truth, solution).heading[-1] ** 2 / solution.cov[-1, 8, 8])
    assert sum(squares) < chi2.isf(1e-3, 16)
