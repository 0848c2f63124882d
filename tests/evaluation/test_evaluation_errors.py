"""Errors are estimate minus truth in n at the solution's times; NEES is e' P^-1 e of the estimated blocks.

The laws: a known error put in comes out, with its sign; NEES of errors drawn from their
own covariance is chi-square; a solution that cannot be evaluated is recognized, with the reason.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.linalg import expm

from bench.core.mathematics import rotation
from bench.evaluation.consistency.chi_square import mean_band
from bench.evaluation.errors import error_series as error_series_file
from bench.evaluation.errors.error_series import (
    check_convergence,
    error_series,
    heading_sd,
    interpolate_truth,
    normalized_squares,
)
from tests.evaluation.solutions import COV, weaving_truth, without, wrong_solution

POS, VEL, PHI = np.array([3.0, -4.0, 2.0]), np.array([0.1, 0.2, -0.3]), np.array([0.01, -0.02, 0.03])


@pytest.fixture(scope="module")
def truth():
    return weaving_truth()


def draws(rng, n):
    """Errors (n, 9) and the full covariance (9, 9) they are drawn from, meters beside microradians."""
    scale = np.array([5.0, 3.0, 8.0, 0.1, 0.2, 0.05, 1e-5, 2e-5, 1e-3])
    factor = scale[:, None] * (np.eye(9) + 0.5 * rng.normal(size=(9, 9)))
    return rng.normal(size=(n, 9)) @ factor.T, factor @ factor.T


def test_the_truth_has_no_error(truth):
    errors = error_series(truth, wrong_solution(truth))
    assert np.abs(errors.pos_n).max() == 0.0
    assert np.abs(errors.vel_n).max() == 0.0
    assert np.abs(errors.phi_n).max() < 1e-14
    assert np.abs(errors.nees).max() < 1e-24


@pytest.mark.parametrize("factor", [1.0, 2.0])
def test_what_is_put_in_comes_out_as_estimate_minus_truth(truth, factor):
    errors = error_series(
        truth, wrong_solution(truth, pos_n=factor * POS, vel_n=factor * VEL, phi_n=factor * PHI)
    )
    assert_allclose(errors.pos_n, np.tile(factor * POS, (len(errors), 1)), atol=2e-8)
    assert_allclose(errors.vel_n, np.tile(factor * VEL, (len(errors), 1)), atol=1e-13)
    assert_allclose(errors.phi_n, np.tile(factor * PHI, (len(errors), 1)), atol=1e-14)


def test_phi_is_the_rotation_that_takes_the_true_matrix_to_the_estimated_one():
    """C_nb_est = exp([phi_n x]) C_nb_true, by matrices and matrix exponential, at a steep banked attitude."""
    truth = weaving_truth(duration=0.1)
    attitude = rotation.from_euler(0.7, -0.4, 2.5)
    truth = replace(truth, q_nb=np.tile(attitude, (len(truth), 1)))
    phi_n = np.array([0.3, -0.5, 0.8])
    C_est = expm(rotation.skew(phi_n)) @ rotation.matrix(attitude)
    solution = wrong_solution(truth)
    solution = replace(solution, q_nb=np.tile(rotation.from_matrix(C_est), (len(solution), 1)))
    assert_allclose(error_series(truth, solution).phi_n, np.tile(phi_n, (len(solution), 1)), atol=1e-14)
    turned_in_b = expm(rotation.skew(rotation.matrix(attitude).T @ phi_n))  # the same error, seen in b
    assert_allclose(rotation.matrix(attitude) @ turned_in_b, C_est, atol=1e-14)


def test_a_quaternion_of_either_sign_is_the_same_attitude(truth):
    solution = wrong_solution(truth, phi_n=PHI)
    flipped = replace(solution, q_nb=-solution.q_nb)
    assert_allclose(error_series(truth, flipped).phi_n, error_series(truth, solution).phi_n, atol=1e-15)


@pytest.mark.parametrize(("true_deg", "est_deg", "error_deg"), [(359.0, 1.0, 2.0), (1.0, 359.0, -2.0)])
def test_heading_error_wraps_at_north(true_deg, est_deg, error_deg):
    truth = weaving_truth(duration=0.1)
    level = np.zeros(len(truth))
    truth = replace(truth, q_nb=rotation.from_euler(level, level, level + np.deg2rad(true_deg)))
    solution = wrong_solution(truth)
    flat = np.zeros(len(solution))
    solution = replace(solution, q_nb=rotation.from_euler(flat, flat, flat + np.deg2rad(est_deg)))
    errors = error_series(truth, solution)
    assert_allclose(np.rad2deg(errors.heading), error_deg, atol=1e-10)
    assert_allclose(errors.phi_n[:, 2], errors.heading, atol=1e-12)  # level: heading turns about down


# --- which time of the truth -----------------------------------------------------------------------


def test_a_sample_instant_takes_its_own_row_even_with_rounding(truth):
    rows = np.array([0, 1, 777, len(truth) - 1])
    for jitter in (-1e-10, 0.0, 1e-10):
        lla, vel_n, q_nb = interpolate_truth(truth, truth.t[rows] + jitter)
        assert_array_equal(lla, truth.lla[rows])
        assert_array_equal(vel_n, truth.vel_n[rows])
        assert_array_equal(q_nb, truth.q_nb[rows])


def test_between_samples_the_error_falls_with_the_order_of_the_interpolation():
    """Cubic Hermite: 4th order in the step; linear velocity and constant rotation rate: 2nd order.

    A linear position would be 2nd order too and is what this catches (ratio 4 instead of 16).
    """
    exact = weaving_truth(rate=400.0)
    worst = []
    for rate in (1.0, 2.0):
        coarse = weaving_truth(rate=rate)
        odd = np.flatnonzero((exact.t * rate * 4) % 4 == 1)  # a quarter into each interval
        lla, vel_n, q_nb = interpolate_truth(coarse, exact.t[odd])
        phi_n = rotation.to_rotvec(rotation.multiply(q_nb, rotation.conjugate(exact.q_nb[odd])))
        offset = (lla - exact.lla[odd]) * [6.4e6, 4.4e6, 1.0]
        worst.append([np.abs(x).max() for x in (offset, vel_n - exact.vel_n[odd], phi_n)])
    order = np.log2(np.array(worst[0]) / worst[1])
    assert 3.7 < order[0] < 4.3
    assert 1.7 < order[1] < 2.3
    assert 1.7 < order[2] < 2.3


def test_interpolation_crosses_the_date_line(truth):
    shifted = replace(truth, lla=truth.lla + np.array([0.0, np.pi - truth.lla[1000, 1], 0.0]))
    lon = shifted.lla[:, 1]
    wrapped = replace(
        shifted, lla=np.column_stack([shifted.lla[:, 0], lon - 2 * np.pi * (lon > np.pi), shifted.lla[:, 2]])
    )
    t = truth.t[[999, 1000, 1001]] + 0.004
    there, _, _ = interpolate_truth(wrapped, t)
    here, _, _ = interpolate_truth(shifted, t)
    assert_allclose(np.mod(there[:, 1], 2 * np.pi), np.mod(here[:, 1], 2 * np.pi), atol=1e-14)


@pytest.mark.parametrize("t", [-0.001, 20.001, np.nan])
def test_a_time_outside_the_truth_is_an_error_that_says_which(truth, t):
    solution = wrong_solution(truth)
    times = solution.t.copy()
    times[3] = t
    with pytest.raises(ValueError, match=r"NavSolution\.t: row 3 has .* s; the truth covers 0 to 20 s"):
        error_series(truth, replace(solution, t=times))


# --- NEES ---------------------------------------------------------------------------------------------


def test_nees_is_the_quadratic_form_of_the_inverse_covariance():
    error, P = draws(np.random.default_rng(1), 20)
    expected = np.einsum("ki,ij,kj->k", error, np.linalg.inv(P), error)
    assert_allclose(normalized_squares(error, np.broadcast_to(P, (20, 9, 9))), expected, rtol=1e-6)
    assert_allclose(
        normalized_squares(2 * error, np.broadcast_to(P, (20, 9, 9))),
        4 * normalized_squares(error, np.broadcast_to(P, (20, 9, 9))),
        rtol=1e-12,
    )


def test_nees_of_matched_errors_is_chi_square_and_a_covariance_20_percent_too_small_is_seen():
    """4000 independent epochs, false-alarm rate 0.1 %; the smallest defect it catches is 2.5 %."""
    error, P = draws(np.random.default_rng(2), 4000)
    low, high = mean_band(9, 4000, 0.999)
    assert high / 9 < 1.026
    matched = normalized_squares(error, np.broadcast_to(P, (4000, 9, 9))).mean()
    assert low < matched < high
    for factor in (0.8, 1.25):
        wrong = normalized_squares(error, np.broadcast_to(factor * P, (4000, 9, 9))).mean()
        assert not low < wrong < high


def test_nees_goes_through_attitude_as_phi_n(truth):
    """Errors drawn from the covariance, put into a solution, give chi-square NEES; 99.9 % band."""
    rng = np.random.default_rng(3)
    error = rng.multivariate_normal(np.zeros(9), COV, size=201)
    solution = wrong_solution(truth, pos_n=error[:, :3], vel_n=error[:, 3:6], phi_n=error[:, 6:])
    errors = error_series(truth, solution)
    low, high = mean_band(9, 201, 0.999)
    assert errors.states == 9
    assert low < errors.nees.mean() < high
    expected = np.sum(error**2 / np.diag(COV), axis=1)
    assert_allclose(errors.nees, expected, rtol=1e-6)


def test_a_block_that_is_not_estimated_is_left_out_of_nees(truth):
    solution = wrong_solution(truth, pos_n=POS, vel_n=VEL, phi_n=PHI)
    part = [np.sum(e**2 / np.diag(COV)[k : k + 3]) for k, e in ((0, POS), (3, VEL), (6, PHI))]
    for blocks, expected in (
        (("phi",), part[0] + part[1]),
        (("pos", "phi"), part[1]),
        (("pos", "vel"), part[2]),
    ):
        errors = error_series(truth, without(solution, *blocks))
        assert errors.states == 9 - 3 * len(blocks)
        assert_allclose(errors.nees, expected, rtol=1e-6)
        assert check_convergence(errors, without(solution, *blocks)) == (True, None)


@pytest.mark.parametrize(
    "spoil",
    [
        lambda P: P * np.where(np.eye(9, dtype=bool), [-1] + [1] * 8, 1),  # a negative variance
        lambda P: (
            P
            + 4.5 * (np.eye(9, k=1) + np.eye(9, k=-1)) * (np.arange(9) == 0)[:, None]
            + 4.5 * (np.eye(9, k=-1)) * (np.arange(9) == 0)[None, :]
        ),  # correlation above 1
        lambda P: P * (np.arange(9) > 0)[:, None] * (np.arange(9) > 0)[None, :],  # a zero variance
    ],
)
def test_nees_is_nan_only_where_the_covariance_is_not_positive_definite(truth, spoil):
    solution = wrong_solution(truth, pos_n=POS)
    cov = solution.cov.copy()
    cov[5] = spoil(cov[5])
    bad = replace(solution, cov=cov)
    errors = error_series(truth, bad)
    assert_array_equal(np.flatnonzero(np.isnan(errors.nees)), [5])
    sound, reason = check_convergence(errors, bad)
    assert not sound
    assert reason == "covariance is not positive definite at t = 0.5 s (1 of 201 epochs)"


def test_heading_sd_is_the_slope_of_heading_along_phi():
    """Against central differences of the Euler angles, at pitches where tilt matters."""
    truth = weaving_truth(duration=0.4)
    P = np.array([[1e-4, 3e-5, -7e-5], [3e-5, 4e-4, 1.1e-4], [-7e-5, 1.1e-4, 9e-4]])
    cov = COV.copy()
    cov[6:, 6:] = P
    pitch = np.array([-1.0, -0.3, 0.0, 0.6, 1.2])
    q_nb = rotation.from_euler(0.4, pitch, [0.1, 1.0, 2.5, 4.0, 6.0])
    solution = replace(wrong_solution(truth, cov=cov), q_nb=q_nb)
    slopes = []
    for axis in np.eye(3):
        ends = [
            rotation.to_euler(rotation.multiply(rotation.from_rotvec(s * 1e-6 * axis), q_nb))[2]
            for s in (1, -1)
        ]
        slopes.append((ends[0] - ends[1]) / 2e-6)
    h = np.array(slopes).T
    assert_allclose(heading_sd(solution), np.sqrt(np.einsum("ki,ij,kj->k", h, P, h)), rtol=1e-6)
    assert np.ptp(heading_sd(solution)) > 0.005  # tilt does matter in this test


# --- what cannot be evaluated ----------------------------------------------------------------------------


def spoiled(solution, field, row, value):
    column = getattr(solution, field).copy()
    column[row] = value
    return replace(solution, **{field: column})


@pytest.mark.parametrize(
    ("field", "value", "reason"),
    [
        ("lla", np.nan, "position is not finite at t = 0.7 s (1 of 201 epochs)"),
        ("vel_n", np.inf, "velocity is not finite at t = 0.7 s (1 of 201 epochs)"),
        ("q_nb", np.nan, "attitude is not finite at t = 0.7 s (1 of 201 epochs)"),
        ("gyro_bias_b", np.nan, "gyro bias is not finite at t = 0.7 s (1 of 201 epochs)"),
        ("accel_bias_b", np.inf, "accelerometer bias is not finite at t = 0.7 s (1 of 201 epochs)"),
        ("cov", np.nan, "covariance is not finite at t = 0.7 s (1 of 201 epochs)"),
    ],
)
def test_a_state_that_is_not_finite_has_not_converged(truth, field, value, reason):
    solution = spoiled(wrong_solution(truth), field, 7, value)
    assert check_convergence(error_series(truth, solution), solution) == (False, reason)


def test_a_state_beyond_the_nine_counts_too(truth):
    solution = wrong_solution(truth)
    ones = np.ones((len(solution), 1))
    solution = replace(solution, extra_names=("baro_bias_m",), extra=ones, extra_sd=ones)
    assert check_convergence(error_series(truth, solution), solution) == (True, None)
    bad = spoiled(solution, "extra_sd", 2, np.nan)
    assert check_convergence(error_series(truth, bad), bad) == (
        False,
        "standard deviation of baro_bias_m is not finite at t = 0.2 s (1 of 201 epochs)",
    )


def test_values_that_are_nan_throughout_under_a_finite_covariance_are_a_failure_not_an_absent_block(truth):
    solution = wrong_solution(truth)
    solution = replace(solution, vel_n=np.full_like(solution.vel_n, np.nan))
    sound, reason = check_convergence(error_series(truth, solution), solution)
    assert not sound
    assert reason == "velocity is not finite at t = 0 s (201 of 201 epochs)"


def test_an_estimator_without_any_block_has_not_converged(truth):
    solution = without(wrong_solution(truth), "pos", "vel", "phi")
    errors = error_series(truth, solution)
    assert errors.states == 0
    assert check_convergence(errors, solution) == (
        False,
        "no finite position, velocity or attitude at any epoch",
    )


@pytest.mark.parametrize(
    ("distance", "sigma", "sound"),
    [(1100.0, 100.0, False), (1100.0, 120.0, True), (900.0, 1.0, True), (1100.0, 1.0, False)],
)
def test_diverged_means_beyond_10_sigma_and_beyond_1_km(truth, distance, sigma, sound):
    """Sigma is the root of the sum of the two horizontal variances; both limits have to be passed."""
    cov = COV.copy()
    cov[0, 0] = cov[1, 1] = sigma**2 / 2
    pos_n = np.zeros((201, 3))
    pos_n[100:, :2] = distance / np.sqrt(2)
    solution = wrong_solution(truth, pos_n=pos_n, cov=cov)
    verdict, reason = check_convergence(error_series(truth, solution), solution)
    assert verdict is sound
    if not sound:
        assert reason == (
            f"horizontal error is {distance:.0f} m at t = 10 s (101 of 201 epochs), "
            f"more than 10 sigma of {sigma:.1f} m"
        )


@pytest.mark.parametrize(
    ("wrong", "reason"),
    [
        ({"pos_n": (0.0, 0.0, -500.0)}, "height error is 500 m at t = 0 s"),
        ({"vel_n": (0.0, 0.0, 20.0)}, "velocity error is 20 m/s at t = 0 s"),
        ({"phi_n": (0.0, np.deg2rad(40.0), 0.0)}, "tilt is 40 deg at t = 0 s"),
        ({"phi_n": (0.0, 0.0, np.deg2rad(-92.0))}, "heading error is "),
    ],
)
def test_every_block_that_is_far_off_has_not_converged(truth, wrong, reason):
    """Held against the covariance, or against the limit alone where nothing is reported."""
    solution = wrong_solution(truth, **wrong)
    for cov, end in (
        (solution.cov, "more than 10 sigma of "),
        (np.full_like(solution.cov, np.nan), "more than "),
    ):
        one = replace(solution, cov=cov)
        good, told = check_convergence(error_series(truth, one), one)
        assert not good
        assert told.startswith(reason)
        assert end in told
    wide = replace(solution, cov=solution.cov * 1e6)  # it says that it does not know
    assert check_convergence(error_series(truth, wide), wide) == (True, None)
    near = wrong_solution(truth, **{name: 0.3 * np.array(value) for name, value in wrong.items()})
    assert check_convergence(error_series(truth, near), near) == (True, None)


def test_sizes_that_tell_a_divergence_are_in_their_units(monkeypatch):
    """Errors of 3, 4, 12 m, of 1, 2, 2 m/s, tilts of 3 and 4 and a heading of 5 deg; sigmas by hand."""
    errors = SimpleNamespace(
        pos_n=np.array([[3.0, 4.0, -12.0]]), vel_n=np.array([[1.0, 2.0, -2.0]]),
        phi_n=np.deg2rad([[3.0, 4.0, 5.0]]), heading=np.deg2rad([-5.0]),
    )  # fmt: skip
    sd = np.array([1.0, 2.0, 3.0, 0.1, 0.2, 0.2, *np.deg2rad([0.3, 0.4, 0.7])])
    monkeypatch.setattr(error_series_file, "variances", lambda solution: np.square(sd)[None])
    monkeypatch.setattr(error_series_file, "heading_sd", lambda solution: sd[8:])
    found = {
        what: (unit, float(size[0]), float(sigma[0]))
        for what, unit, _, size, sigma in error_series_file.list_sizes(errors, None, ("pos", "vel", "phi"))
    }
    assert found == {
        "horizontal error": ("m", 5.0, pytest.approx(np.sqrt(5.0))),
        "height error": ("m", 12.0, 3.0),
        "velocity error": ("m/s", 3.0, pytest.approx(0.3)),
        "tilt": ("deg", pytest.approx(5.0), pytest.approx(0.5)),
        "heading error": ("deg", pytest.approx(5.0), pytest.approx(0.7)),
    }
