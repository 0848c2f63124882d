"""Figures beside a pooled error that hold even if rare large runs exist: order statistics and counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import CONFIDENCE, estimate_quantile, estimate_rate

_LARGE = 3.0  # times the median


@dataclass(frozen=True, slots=True)
class RunScatter:
    """The scatter of the RMS errors of runs."""

    runs: int
    median: float
    low: float | None  # 95 % interval of the median; None: too few runs
    high: float | None
    large: int  # runs above three times the median
    most: float  # fraction of such runs, upper bound with 95 % [1]
    share: float  # of the sum of squares in the largest run [1]

    def describe(self, unit: str = "") -> str:
        """Return the figures in words."""
        ends = "" if self.low is None or self.high is None else f" ({self.low:.3g} to {self.high:.3g})"
        return f"median {format_number(self.median, 3)}{ends} {unit}".rstrip() + f", {self.large_words}"

    @property
    def large_words(self) -> str:
        """The number of large runs, its bound for all runs, and the largest share, in words."""
        return (
            f"{self.large} of {self.runs} runs above {_LARGE:g} times the median "
            f"(below {100 * self.most:.0f} % of all), "
            f"the largest run {100 * self.share:.0f} % of the sum of squares"
        )


def measure_scatter(errors: FloatArray, ratios: FloatArray | None = None) -> RunScatter:
    """Return the median, the large runs and the largest share of RMS errors (R,) of independent runs.

    If ``ratios`` (R,) are given, the median is the median of the ratios. Its interval follows from order
    statistics, the bound of the large runs from Clopper and Pearson.

    Examples
    --------
    >>> measure_scatter(np.arange(1.0, 9.0)).large_words
    '0 of 8 runs above 3 times the median (below 31 % of all), the largest run 31 % of the sum of squares'
    """
    middle, squares = estimate_quantile(errors if ratios is None else ratios, 0.5), np.square(errors)
    large = int(np.sum(errors > _LARGE * np.median(errors)))
    most = estimate_rate(large, len(errors), 2.0 * CONFIDENCE - 1.0).high
    share = float(squares.max() / squares.sum()) if squares.any() else 1.0 / len(errors)
    return RunScatter(len(errors), middle.value, middle.low, middle.high, large, most, share)
