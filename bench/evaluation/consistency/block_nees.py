"""NEES of single blocks of a solution with its bounds in one run: which block is inconsistent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import NavSolution
from bench.core.records.run_records import ErrorSeries
from bench.evaluation.consistency.chi_square import count_independent
from bench.evaluation.errors.error_series import (
    BLOCKS,
    claimed_blocks,
    find_covered_epochs,
    normalized_squares,
    select_epochs,
)
from bench.evaluation.metrics.claims import find_nees_band


@dataclass(frozen=True, slots=True)
class BlockNees:
    """Mean NEES of some states in one run, with its band in this run."""

    states: int  # its expected value
    mean: float  # infinite where a covariance is not positive definite or an error not finite
    low: float  # the 99.9 % band of the mean in this run
    high: float
    samples: float  # number of independent values

    @property
    def excess(self) -> float:
        """Mean NEES minus its expected value."""
        return self.mean - self.states

    @property
    def inside(self) -> bool:
        """Return whether the mean lies in its band."""
        return self.low <= self.mean <= self.high


def measure_nees(error: FloatArray, cov: FloatArray) -> BlockNees:
    """Return the mean NEES of errors (M, n) with covariances (M, n, n)."""
    states, nees = error.shape[1], normalized_squares(error, cov)
    if not len(nees) or not np.isfinite(nees).all():
        return BlockNees(states, np.inf, 0.0, np.inf, 0.0)
    samples = count_independent(nees - states)
    low, high = find_nees_band(states, samples)
    return BlockNees(states, float(nees.mean()), low, high, samples)


def judge_blocks(errors: ErrorSeries, solution: NavSolution, begin: float) -> dict[str, BlockNees]:
    """Return the NEES of each block that a solution reports, from a time on [s]; "all" is the joint NEES."""
    rows = find_covered_epochs(solution) & (solution.t >= begin - SAME_INSTANT)
    claimed = claimed_blocks(solution)
    at, claims = select_epochs(errors, rows), select_epochs(solution, rows).cov
    error = np.hstack([at.pos_n, at.vel_n, at.phi_n])
    columns = {name: np.arange(9)[BLOCKS[name]] for name in claimed}
    if claimed:
        columns["all"] = np.hstack(list(columns.values()))
    return {name: measure_nees(error[:, kept], claims[:, kept][:, :, kept]) for name, kept in columns.items()}


def find_broken_block(found: Mapping[str, BlockNees]) -> str | None:
    """Return the block with the largest NEES per state, if the covariance of any block is broken."""
    blocks = {name: one for name, one in found.items() if name != "all"}
    broken = {name: one for name, one in blocks.items() if one.mean > one.high or one.mean == np.inf}
    if not broken and "all" in found and found["all"].mean > found["all"].high:
        broken = blocks
    return max(broken, key=lambda name: broken[name].mean / broken[name].states, default=None)
