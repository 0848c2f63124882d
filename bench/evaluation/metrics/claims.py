"""Metrics of the reported covariance and of availability: NEES, coverage, NIS and their bands, bias states.

The errors of one run last: a run of ten minutes with an error that wanders over two minutes tells as much as
five independent values. A band for one run therefore counts independent values, not epochs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import DEG, HOUR, STANDARD_GRAVITY
from bench.evaluation.consistency.chi_square import chi2_quantile, count_independent, mean_band, mean_nis
from bench.evaluation.consistency.log_score import score_block
from bench.evaluation.errors.error_series import BLOCKS, claimed_blocks, normalized_squares
from bench.evaluation.errors.failures import FAILED
from bench.evaluation.metrics.case import Case

AXES = ("n", "e", "d")
Edge = Literal["low", "high"]
EDGES: tuple[Edge, ...] = ("low", "high")
NEES_PROBABILITY = 0.999
"""Probability of the band of NEES in one run [1]."""
COVERAGE_PROBABILITY = 0.995
"""Probability that the coverage of a consistent filter in one run is not below its bound [1]."""
INSIDE_3_SIGMA = 0.9973
"""Probability that a normal error is within 3 sigma [1]."""
_UNITS = {"gyro_bias": DEG / HOUR, "accel_bias": 1e-3 * STANDARD_GRAVITY}  # deg/h and mg in SI


def nees_mean(case: Case) -> float:
    """Mean NEES, expected to be nees_states; nees_low to nees_high is its band in one run."""
    return float(np.mean(case.nees))


def nees_states(case: Case) -> float:
    """Number of states in NEES, its expected value."""
    return float(case.states)


def nees_inside_95(case: Case) -> float:
    """Fraction of epochs whose NEES lies in the central 95 % of its chi-square distribution."""
    low, high = chi2_quantile(0.025, case.states), chi2_quantile(0.975, case.states)
    return float(np.mean((low <= case.nees) & (case.nees <= high)))


def nees_ratio(case: Case) -> Mapping[str, float | None]:
    """NEES over its expected value by block (pos, vel, phi) and by axis (pos_n ... phi_d); 1 is expected."""
    found = {block: values / 3.0 for block, values in _average_blocks(normalized_squares, case).items()}
    for block in [*found]:
        squares = np.square(getattr(case, f"{block}_n") / case.sd[:, BLOCKS[block]])
        found |= {f"{block}_{axis}": float(np.mean(squares[:, k])) for k, axis in enumerate(AXES)}
    return found


def log_score(case: Case) -> Mapping[str, float | None]:
    """Logarithmic score of the covariance of a block (pos, vel, phi), in SI units; the lower the better."""
    return _average_blocks(score_block, case)


def _average_blocks(measure: Callable[[FloatArray, FloatArray], FloatArray], case: Case) -> dict[str, float]:
    """Return the mean of a measure of errors (M, 3) and covariances (M, 3, 3), by claimed block."""
    found = {}
    for block in claimed_blocks(case.solution):
        error, own = getattr(case, f"{block}_n"), BLOCKS[block]
        parts = [
            measure(error[rows], case.solution.cov[rows, own, own]).sum()
            for rows in disk_arrays.blocks(len(error))
        ]
        found[block] = float(sum(parts) / len(error))
    return found


def coverage(sigmas: float, block: str, case: Case) -> Mapping[str, float | None]:
    """Fraction of epochs with the error of a block within 3 sigma: n, e, d; 0.9973 is expected."""
    inside = np.abs(getattr(case, f"{block}_n")) <= sigmas * case.sd[:, BLOCKS[block]]
    return {axis: float(np.mean(inside[:, k])) for k, axis in enumerate(AXES)}


def coverage_within(sigmas: float, case: Case) -> Mapping[str, float | None]:
    """Fraction of epochs with the error of an axis within 1 or 2 sigma; 0.6827 and 0.9545 are expected."""
    blocks = claimed_blocks(case.solution)
    return {f"{b}_{axis}": value for b in blocks for axis, value in coverage(sigmas, b, case).items()}


def nis(part: Literal["mean", "low", "high"], case: Case) -> Mapping[str, float | None]:
    """Mean NIS of each sensor, rejected updates included; low, high: the 99.9 % band of a matched filter."""
    return {name: getattr(mean_nis(s.nis, s.dof), part) for name, s in case.nis.items()}


def updates(case: Case) -> Mapping[str, float | None]:
    """Number of updates of each sensor, used or rejected."""
    return {name: float(len(s.nis)) for name, s in case.nis.items()}


def rejected(case: Case) -> Mapping[str, float | None]:
    """Number of updates of each sensor with at least one component that the gate rejected."""
    return {name: float(np.sum(~s.accepted)) for name, s in case.nis.items()}


def nees_samples(case: Case) -> float:
    """Number of independent values of NEES in the run."""
    return case.nees_samples


def nees_band(edge: Edge, case: Case) -> float | None:
    """The 99.9 % band of nees_mean in this run.

    It contains the mean of nees_samples chi-square values. In simulations with errors that last from
    one epoch to the whole run, a consistent filter is outside in at most 0.5 % of the runs.
    """
    return _find_edge(edge, case.states, case.nees_samples)


def _find_edge(edge: Edge, states: int, samples: float) -> float | None:
    return find_nees_band(states, samples)[0 if edge == "low" else 1] if samples else None


def find_nees_band(states: int, samples: float) -> tuple[float, float]:
    """Return the 99.9 % band of the mean of ``samples`` independent values of NEES."""
    return mean_band(states, samples, NEES_PROBABILITY)


def coverage_low(block: str, case: Case) -> dict[str, float | None]:
    """Smallest coverage_3sigma that this run allows a consistent filter, with 99.5 %: n, e, d.

    So many of the independent values of the error over its sigma lie outside 3 sigma with 0.5 % at most. Half
    a value more is allowed, because their number is estimated: consistent filters are below in at most 0.4 %
    of simulated runs.
    """
    with np.errstate(all="ignore"):
        ratios = getattr(case, f"{block}_n") / case.sd[:, BLOCKS[block]]
    return {axis: find_least_inside(count_independent(ratios[:, k])) for k, axis in enumerate(AXES)}


def find_least_inside(samples: float) -> float | None:
    """Return the smallest plausible fraction within 3 sigma of some independent values; None if too few."""
    from scipy.special import bdtr

    count = int(samples)
    if not count:
        return None
    outside = np.arange(count + 1)
    allowed = outside[bdtr(outside, count, 1.0 - INSIDE_3_SIGMA) >= COVERAGE_PROBABILITY][0]
    return max(0.0, float(1.0 - (allowed + 0.5) / count))


def claimed_error_h(case: Case) -> float:
    """Horizontal error that the covariance reports, root mean square [m]."""
    return float(np.sqrt(np.mean(case.sd[:, 0] ** 2 + case.sd[:, 1] ** 2)))


def error_over_sigma(case: Case) -> Mapping[str, float | None]:
    """Root mean square of the error over its sigma: pos, vel, phi; 1 is expected."""
    return {
        block: float(np.sqrt(np.mean((getattr(case, f"{block}_n") / case.sd[:, rows]) ** 2)))
        for block, rows in BLOCKS.items()
        if not np.isnan(case.sd[:, rows]).all()
    }


# --- answers ---------------------------------------------------------------------------------------------


def output_coverage(case: Case) -> float:
    """Fraction of the requested epochs that have a solution; at the others the last one is extrapolated."""
    return 0.0 if case.solution.events.select(FAILED) else len(case.t) / case.asked


def answered(case: Case) -> Mapping[str, float | None]:
    """Fraction of the epochs with a solution of a block, after its first one and without gaps of the data."""
    return {} if case.coverage is None else case.coverage.shares


def first_answer(case: Case) -> float | None:
    """Time from the first requested epoch to the first solution [s]."""
    return None if case.coverage is None else case.coverage.waited


# --- biases -----------------------------------------------------------------------------------------------


def bias_rmse(stem: str, case: Case) -> Mapping[str, float | None]:
    """Root mean square of the error of the gyro [deg/h] or accelerometer [mg] biases, by axis of b."""
    return {
        name.removeprefix(f"{stem}_"): float(np.sqrt(np.mean(one.error**2))) / _UNITS[stem]
        for name, one in case.biases.items()
        if name.startswith(f"{stem}_")
    }


def bias_coverage(case: Case) -> Mapping[str, float | None]:
    """Fraction of epochs with the error of a bias within 3 sigma, by bias; 0.9973 is expected."""
    return {name: float(np.mean(np.abs(one.error) <= 3.0 * one.sd)) for name, one in case.biases.items()}


def nees_bias(case: Case) -> Mapping[str, float | None]:
    """Mean of the squared error of a bias over its variance, by bias; 1 is expected.

    Each bias has its own, because a solution holds no covariance between them.
    """
    return {name: float(np.mean((one.error / one.sd) ** 2)) for name, one in case.biases.items()}


def nees_bias_band(edge: Edge, case: Case) -> Mapping[str, float | None]:
    """The 99.9 % band of nees_bias in this run.

    Counted are the independent values of the error; its square has at least as many.
    """
    return {
        name: _find_edge(edge, 1, count_independent(one.error / one.sd)) for name, one in case.biases.items()
    }
