"""Logarithmic score of a covariance; its mean is smallest if the covariance describes the errors.

Dawid and Sebastiani, Coherent dispersion criteria for optimal experimental design, Annals of Statistics 27,
1999: ``(e' P^-1 e + ln det P) / 2`` is proper for mean and covariance, whatever the distribution. NEES alone
is least for the widest claim.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import Innovations, NavSolution
from bench.core.records.run_records import ErrorSeries
from bench.evaluation.errors.error_series import BLOCKS, claimed_blocks, normalized_squares


def score_claims(errors: ErrorSeries, solution: NavSolution) -> FloatArray:
    """Return the score of each epoch (M,) [1], computed in SI units from the blocks with a covariance.

    NaN where the covariance is not positive definite; all of them where nothing is reported.
    """
    present = claimed_blocks(solution)
    counted = np.repeat([name in present for name in BLOCKS], 3)
    if not counted.any():
        return np.full(len(solution), np.nan)
    cov = solution.cov[:, counted][:, :, counted]
    with np.errstate(all="ignore"):  # a lost filter reports anything
        sd = np.sqrt(np.einsum("kii->ki", cov))
        sign, scaled = np.linalg.slogdet(cov / (sd[:, :, None] * sd[:, None, :]))
        log_det = np.where(sign > 0.0, scaled, np.nan) + 2.0 * np.log(sd).sum(axis=1)
        return np.asarray(0.5 * (errors.nees + log_det))


def score_block(error: FloatArray, cov: FloatArray) -> FloatArray:
    """Return the score (M,) [1] of errors (M, 3) with covariances (M, 3, 3); NaN where not positive."""
    with np.errstate(all="ignore"):
        sd = np.sqrt(np.einsum("kii->ki", cov))
        a, b, c = (cov[:, i, j] / (sd[:, i] * sd[:, j]) for i, j in ((1, 0), (2, 0), (2, 1)))
        log_det = np.log(1.0 + 2.0 * a * b * c - a * a - b * b - c * c) + 2.0 * np.log(sd).sum(axis=1)
        return np.asarray(0.5 * (normalized_squares(error, cov) + log_det))


def score_innovations(innovations: Innovations) -> FloatArray:
    """Return the score of each scalar innovation (K,) [1]; NaN where its variance is not positive."""
    with np.errstate(all="ignore"):
        return np.asarray(0.5 * (np.square(innovations.z) / innovations.S + np.log(innovations.S)))
