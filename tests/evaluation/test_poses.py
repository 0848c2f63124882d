"""Poses and normalized squares against scipy and plain loops."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from bench.core.mathematics import earth, rotation
from bench.evaluation.consistency import chi_square
from bench.evaluation.errors import error_series
from bench.evaluation.errors.error_series import error_series as find_errors
from bench.evaluation.errors.poses import Poses, align
from tests.evaluation.solutions import weaving_truth, without, wrong_solution

M = 40


def scipy(q):
    return Rotation.from_quat(q, scalar_first=True)


@pytest.fixture(scope="module")
def poses():
    random = np.random.default_rng(6)
    q_estimate, q_truth = (
        Rotation.random(M, random_state=random).as_quat(scalar_first=True) for _ in range(2)
    )
    points = np.cumsum(random.standard_normal((M, 3)), axis=0)
    far = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    t = 5.0 + 0.3 * np.arange(M)
    return Poses(t, points + random.standard_normal((M, 3)), points, q_estimate, q_truth, far)


def test_relative_errors_are_those_of_two_displacements_and_turns(poses):
    first, last = np.arange(M - 7), np.arange(7, M)
    moved = [
        scipy(q[first]).inv().apply(at[last] - at[first])
        for q, at in ((poses.q_estimate, poses.estimate_e), (poses.q_truth, poses.truth_e))
    ]
    assert_allclose(poses.distance(first, last), np.linalg.norm(moved[0] - moved[1], axis=1))
    turned = [scipy(q[first]).inv() * scipy(q[last]) for q in (poses.q_estimate, poses.q_truth)]
    assert_allclose(poses.angle(first, last), (turned[1].inv() * turned[0]).magnitude())


def test_pieces_begin_once_a_second_and_end_where_they_are_long_enough(poses):
    """Samples every 0.3 s, so the first at or after each second; 3 s of time are ten of them."""
    begins = [int(np.ceil(second / 0.3 - 1e-9)) for second in range(12)]
    for along, step in ((poses.t, 3.0), (poses.traveled, 9.0)):
        ((first, last),) = poses.pairs(along, [step])
        expected = [
            (k, next(j for j in range(M) if along[j] >= along[k] + step - 1e-6))
            for k in begins
            if along[-1] >= along[k] + step - 1e-6
        ]
        assert list(zip(first.tolist(), last.tolist(), strict=True)) == expected


def test_the_best_turn_is_that_of_scipy_and_never_a_mirror(poses):
    target = poses.truth_e * [1.0, 1.0, -1.0]
    for reference in (poses.truth_e, target):
        found = align(poses.estimate_e, reference)
        centered = poses.estimate_e - poses.estimate_e.mean(axis=0)
        turn, _ = Rotation.align_vectors(reference - reference.mean(axis=0), centered)
        assert_allclose(found, turn.apply(centered) + reference.mean(axis=0), atol=1e-9)


def test_poses_are_the_places_and_axes_of_estimate_and_truth():
    truth = weaving_truth(4.0)
    solution = wrong_solution(truth, pos_n=[3.0, -2.0, 1.0], phi_n=[0.01, -0.02, 0.03])
    errors = find_errors(truth, solution)
    found = Poses.from_errors(solution, errors)
    rows = np.arange(0, len(truth), 10)
    assert_allclose(found.estimate_e, earth.to_ecef(solution.lla), atol=1e-6)
    assert_allclose(found.truth_e, earth.to_ecef(truth.lla[rows]), atol=1e-3)
    C_en = earth.matrix_en(truth.lla[rows, 0], truth.lla[rows, 1])
    for q_en_b, q_nb in ((found.q_estimate, solution.q_nb), (found.q_truth, truth.q_nb[rows])):
        assert_allclose(scipy(q_en_b).as_matrix(), C_en @ rotation.matrix(q_nb), atol=1e-6)
    steps = np.linalg.norm(np.diff(earth.to_ecef(truth.lla[rows]), axis=0), axis=1)
    assert_allclose(found.traveled, np.concatenate([[0.0], np.cumsum(steps)]), atol=1e-3)
    bare = without(solution, "phi")
    plain = Poses.from_errors(bare, find_errors(truth, bare))
    assert_allclose(plain.q_truth, np.tile([1.0, 0.0, 0.0, 0.0], (len(rows), 1)))
    assert_allclose(plain.q_estimate, plain.q_truth)
    lost = without(solution, "pos")
    assert Poses.from_errors(lost, find_errors(truth, lost)) is None
    assert len(found.select(slice(0, 3)).t) == 3
    assert found.select(slice(0, 2)) is None


def test_normalized_squares_are_those_of_a_linear_solver():
    random = np.random.default_rng(8)
    A = random.standard_normal((6, 7, 7)) * 10.0 ** np.arange(-3, 4)[:, None]
    P, e = A @ A.swapaxes(1, 2), random.standard_normal((6, 7))
    expected = np.einsum("ki,ki->k", e, np.linalg.solve(P, e[:, :, None])[:, :, 0])
    assert_allclose(error_series.normalized_squares(e, P), expected, rtol=1e-6)
    P[0, 3, 3], P[1, 2, 2], P[2, 1, 4], P[3, 5, 0] = -1.0, 0.0, np.nan, np.inf
    P[4] = np.outer(np.arange(1.0, 8.0), np.arange(1.0, 8.0)) - 0.1 * np.eye(7)
    assert np.isfinite(error_series.normalized_squares(e, P)).tolist() == [False] * 5 + [True]
    assert error_series.positive_definite(P).tolist() == [False] * 5 + [True]


def test_the_deviation_of_the_heading_is_that_of_a_small_turn():
    """By differences of the heading by each component of phi; pitch to 70 deg, all nine terms of P."""
    truth = weaving_truth(2.0)
    A = np.random.default_rng(1).standard_normal((9, 9))
    solution = wrong_solution(truth, cov=A @ A.T)
    q_nb = rotation.from_euler(*np.random.default_rng(2).uniform(-1.2, 1.2, (3, len(solution))))
    solution = replace(solution, q_nb=q_nb)
    step = 1e-6
    J = np.column_stack(
        [
            (
                rotation.to_heading(rotation.multiply(rotation.from_rotvec(step * axis), q_nb))
                - rotation.to_heading(q_nb)
            )
            / step
            for axis in np.tile(np.eye(3)[:, None], (1, len(q_nb), 1))
        ]
    )
    expected = np.sqrt(np.einsum("ki,ij,kj->k", J, (A @ A.T)[6:, 6:], J))
    assert_allclose(error_series.heading_sd(solution), expected, rtol=1e-4)


@pytest.mark.parametrize("count", [5, 8, 300, 301])
def test_independent_values_are_counted_by_the_sum_of_the_autocorrelation(count):
    """Geyer's sum by plain loops: pairs of lags, as long as they are positive; at least one, at most all."""
    random = np.random.default_rng(count)
    for keep in (0.0, 0.9, -0.5, 1.0):
        x = random.standard_normal(count)
        for k in range(1, count):
            x[k] += keep * x[k - 1]
        rho = [x[lag:] @ x[: count - lag] / (x @ x) for lag in range(count)]
        pairs = [rho[k] + rho[k + 1] for k in range(0, count - 1, 2)]
        kept = pairs[: next((k for k, one in enumerate(pairs) if one <= 0.0), len(pairs))]
        total = max(2.0 * sum(kept) - 1.0, 1.0)
        assert chi_square.count_independent(x) == pytest.approx(np.clip(count / total, 1.0, count))
    positive = 1.0 + random.random(count)
    rho = [positive[lag:] @ positive[: count - lag] / (positive @ positive) for lag in range(count)]
    total = 2.0 * sum(rho[: count // 2 * 2]) - 1.0
    for sign in (1.0, -1.0):
        assert chi_square.count_independent(sign * positive) == pytest.approx(max(count / total, 1.0))
    assert chi_square.count_independent(np.append(positive, np.nan)) == 0.0
    assert chi_square.count_independent(np.zeros(3)) == 0.0
    lengths = {1: 2, 2: 2, 3: 4, 7: 8, 9: 10, 11: 12, 13: 16, 17: 20}
    assert {least: chi_square.fast_length(least) for least in lengths} == lengths
