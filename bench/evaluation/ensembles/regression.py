"""Statistics of metrics of the same runs before and after a change of the code.

Draw k has the same truth and the same noise before and after, so the change is estimated from pairs. A small
change then shows beside a large spread of the runs.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray

Scale = Callable[[FloatArray], FloatArray]
"""Maps means over runs (...,) to what is compared (...,): the larger, the worse."""


def log_of_mean(mean: FloatArray) -> FloatArray:
    """Scale that compares positive values by their ratio; half of it, for mean squares, is ln of the RMSE."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.log(mean))


def half_log_of_mean(mean_square: FloatArray) -> FloatArray:
    """Compare the roots of mean squares by ratio."""
    return 0.5 * log_of_mean(mean_square)


def log_distance_from(expected: float) -> Scale:
    """Compare by the factor between the mean and its expectation, up or down: for NEES and NIS."""
    return lambda mean: np.abs(log_of_mean(mean / expected))


def distance_from(expected: float) -> Scale:
    """Compare by the distance of the mean from its expectation: for fractions, and signed values."""
    return lambda mean: np.abs(mean - expected)


@dataclass(frozen=True, slots=True)
class Change:
    """Amount by which a metric is worse after a change than before, on the scale of its comparison."""

    estimate: float  # above 0: worse
    standard_error: float
    dof: float  # degrees of freedom of Student's t
    draws: int  # used, of the values after the change

    @property
    def p_value(self) -> float:
        """Probability of an estimate at least this far from 0, either side, without a change."""
        from scipy.special import stdtr

        if self.standard_error == 0.0 or math.isinf(self.standard_error):
            return 0.0 if self.estimate != 0.0 == self.standard_error else 1.0
        return float(2.0 * stdtr(self.dof, -abs(self.estimate) / self.standard_error))

    def interval(self, error: float) -> tuple[float, float]:
        """Return the confidence interval of the change, with an error probability of ``error``."""
        from scipy.special import stdtrit

        half = float(stdtrit(self.dof, 1.0 - 0.5 * error)) * self.standard_error
        return self.estimate - half, self.estimate + half


def estimate_change(
    old: FloatArray, new: FloatArray, scale: Scale, *, paired: bool, by_draw: FloatArray | None = None
) -> Change:
    """Estimate the change of a pooled metric from its values by draw.

    Parameters
    ----------
    old, new : (N,) array
        Values to be averaged over the runs, before and after; squares if the metric is an RMSE. Unpaired
        they may differ in length.
    scale : callable
        What is compared of the means.
    paired : bool
        Whether ``old[k]`` and ``new[k]`` are of the same run.
    by_draw : (N,) array or None
        Change of each run, above 0 if worse, for a second test. A few large runs decide a pooled value; the
        jackknife then reports too small an error. The standard error is widened until t is at most that of
        the mean of ``by_draw``; it is infinite if the two have different signs.

    Returns
    -------
    change : Change
        ``scale(mean(new)) - scale(mean(old))`` with its jackknife standard error (Efron, Tibshirani, An
        Introduction to the Bootstrap, 11.2) and N - 1 degrees of freedom; unpaired by Welch-Satterthwaite.

    Raises
    ------
    ValueError
        If there are fewer than two runs.
    """
    if min(len(old), len(new)) < 2:
        raise ValueError(f"a change needs at least 2 runs; got {len(old)} and {len(new)}")
    estimate = float(scale(new.mean()) - scale(old.mean()))
    before, after = (scale((values.sum() - values) / (len(values) - 1)) for values in (old, new))
    if paired:
        variances = [_jackknife_variance(after - before)]
        counts = [len(new)]
    else:
        variances = [_jackknife_variance(before), _jackknife_variance(after)]
        counts = [len(old), len(new)]
    total = sum(variances)
    spread = sum(v * v / (n - 1) for v, n in zip(variances, counts, strict=True))
    dof = total * total / spread if spread > 0 else float(min(counts) - 1)
    standard_error = total**0.5
    if by_draw is not None and estimate != 0.0:
        mean, error = float(by_draw.mean()), float(by_draw.std(ddof=1)) / len(by_draw) ** 0.5
        if mean * estimate <= 0.0:
            standard_error = float("inf")
        elif error > 0.0:
            standard_error = max(standard_error, error * estimate / mean)
    return Change(estimate, standard_error, dof, len(new))


def average_changes(by_draw: FloatArray) -> Change:
    """Return the mean of the changes (N,) of N runs, by Student's t."""
    n = len(by_draw)
    return Change(float(by_draw.mean()), float(by_draw.std(ddof=1)) / n**0.5, n - 1.0, n)


def decide(changes: Sequence[Change], error: float) -> tuple[list[bool], list[float]]:
    """Return which changes Holm's method proves, and the error probabilities of matching intervals."""
    rejected, levels = reject_by_holm([change.p_value for change in changes], error)
    if not rejected.all():
        levels[~rejected] = levels[~rejected].min()  # where Holm's method stopped
    return rejected.tolist(), levels.tolist()


def _jackknife_variance(left_out: FloatArray) -> float:
    """Return the jackknife variance of an estimate from its values with each run left out in turn."""
    n = len(left_out)
    return float((n - 1) / n * np.square(left_out - left_out.mean()).sum())


def compare_counts(old: BoolArray, new: BoolArray, *, paired: bool) -> float:
    """Return the two-sided p-value of the hypothesis that an event is equally frequent before and after.

    Paired it is McNemar's exact test: of the runs that flipped, each way is equally likely. Unpaired it is
    Fisher's exact test.
    """
    if paired:
        from scipy.special import bdtr

        lost, gained = int(np.sum(old & ~new)), int(np.sum(~old & new))
        flipped = lost + gained
        return min(1.0, float(2.0 * bdtr(min(lost, gained), flipped, 0.5))) if flipped else 1.0
    from scipy.stats import fisher_exact

    table = [[int(np.sum(of)), int(np.sum(~of))] for of in (old, new)]
    return float(fisher_exact(table)[1])


def reject_by_holm(p_values: Sequence[float], error: float) -> tuple[BoolArray, FloatArray]:
    """Decide which of several hypotheses to reject, with a probability of any false rejection of ``error``.

    Holm's step-down method (Scandinavian Journal of Statistics 6, 1979): the k-th smallest of m p-values, k
    from 0, is compared with ``error / (m - k)``, up to the first that is larger.

    Returns
    -------
    rejected : (m,) array of bool
    levels : (m,) array
        What each p-value was compared with.

    Examples
    --------
    >>> reject_by_holm([0.002, 0.04, 0.004], 0.01)
    (array([ True, False,  True]), array([0.00333333, 0.01      , 0.005     ]))
    """
    p = np.asarray(p_values, np.float64)
    order = np.argsort(p, kind="stable")
    levels = np.empty(len(p))
    levels[order] = error / np.arange(len(p), 0, -1)
    rejected = np.zeros(len(p), np.bool_)
    below = p[order] <= levels[order]
    rejected[order[: len(p) if below.all() else int(np.argmin(below))]] = True
    return rejected, levels
