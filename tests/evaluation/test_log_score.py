"""The logarithmic score is the negative logarithm of a normal density, less its constant."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal, norm

from bench.core.records.data import Innovations
from bench.evaluation.consistency.log_score import score_block, score_claims, score_innovations
from bench.evaluation.errors.error_series import error_series
from tests.evaluation.solutions import weaving_truth, without, wrong_solution


def test_a_claim_scores_as_its_normal_density():
    """Of all nine states, and of the six that are left without attitude; nothing reported has no score."""
    random = np.random.default_rng(3)
    truth, A = weaving_truth(1.0), random.standard_normal((9, 9))
    e = random.standard_normal((11, 9))
    e[:, 6:] *= 0.01
    scale = np.repeat([1.0, 1.0, 0.01], 3)
    cov = (A @ A.T + np.eye(9)) * np.outer(scale, scale)
    solution = wrong_solution(truth, pos_n=e[:, :3], vel_n=e[:, 3:6], phi_n=e[:, 6:], cov=cov)
    for one, n in ((solution, 9), (without(solution, "phi"), 6)):
        density = multivariate_normal(np.zeros(n), cov[:n, :n]).logpdf(e[:, :n])
        found = score_claims(error_series(truth, one), one)
        assert_allclose(found, -density - 0.5 * n * np.log(2.0 * np.pi), rtol=1e-5)
    for wrong in (-np.eye(9), np.full((9, 9), np.nan)):
        one = wrong_solution(truth, cov=wrong)
        assert np.isnan(score_claims(error_series(truth, one), one)).all()


def test_a_block_scores_as_its_normal_density():
    random = np.random.default_rng(4)
    A, e = random.standard_normal((5, 3, 3)), random.standard_normal((5, 3))
    cov = A @ A.transpose(0, 2, 1) + 0.1 * np.eye(3)
    expected = [-multivariate_normal(np.zeros(3), P).logpdf(x) for P, x in zip(cov, e, strict=True)]
    assert_allclose(score_block(e, cov), np.array(expected) - 1.5 * np.log(2.0 * np.pi), rtol=1e-9)
    assert np.isnan(score_block(e[:1], -cov[:1])).all()


def test_an_innovation_scores_as_its_normal_density():
    z, S, zero = np.array([1.0, -2.0, 0.5]), np.array([4.0, 0.3, -1.0]), np.zeros(3, int)
    table = Innovations(np.arange(3.0), ("baro",), zero, zero, z, S, z, zero == 0)
    found = score_innovations(table)
    assert_allclose(found[:2], -norm(0.0, np.sqrt(S[:2])).logpdf(z[:2]) - 0.5 * np.log(2.0 * np.pi))
    assert np.isnan(found[2])
