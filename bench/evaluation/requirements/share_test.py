"""Test of a required share of runs, with a fixed number of runs or while runs are added.

A filter *meets* a requirement if the runs refute that the fraction of all runs that keep it is below
``share``, and *misses* it if they refute that it is above. Each word is wrong with a probability of at most
``alpha``; in between the runs are *undecided*. The number of runs is chosen so that a filter that keeps it in
the fraction ``expected`` of all runs gets *met* with a probability of 1 - ``beta``.

Sources: Clopper, Pearson, Biometrika 26, 1934, for a fixed number of runs. Wald, Annals of Mathematical
Statistics 16, 1945, for runs that are added: a likelihood ratio to each side with the bound 1 / alpha holds
its error at any number of runs.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.evaluation.ensembles.ensemble import Estimate, estimate_rate

MET, MISSED, UNDECIDED = "met", "missed", "undecided"
FIXED, SEQUENTIAL = "fixed", "sequential"

_MOST_RUNS = 100_000  # in the search for the number of runs
_BLOCK = 500


@dataclass(frozen=True, slots=True)
class ShareTest:
    """A required share of runs and the errors that its test may make."""

    share: float = 0.95  # of the runs that must keep the requirement
    expected: float = 0.99  # of the runs of a filter that is good enough, above ``share``
    alpha: float = 0.05  # probability of a wrong "met", and of a wrong "missed"
    beta: float = 0.1  # probability that a filter that is good enough does not get "met"
    sequential: bool = False

    @classmethod
    def from_row(cls, row: Mapping[str, Any], sequential: bool = False) -> ShareTest:
        """Return the test of a row ``[[requirement]]``; runs are added one by one if ``sequential``."""
        share = float(row["share"])
        expected = float(row.get("expected_share") or 1.0 - 0.2 * (1.0 - share))
        one_by_one = sequential or row.get("plan") == SEQUENTIAL
        return cls(share, expected, float(row.get("alpha", 0.05)), float(row.get("beta", 0.1)), one_by_one)

    def bound(self, count: int, n: int) -> Estimate:
        """Return the share of n runs of which ``count`` keep it, each bound with a probability 1 - alpha."""
        return estimate_rate(count, n, 1.0 - 2.0 * self.alpha)

    def decide(self, kept: Sequence[bool]) -> tuple[str, int]:
        """Return the verdict on runs in their order, and the number of runs after which it is final.

        Examples
        --------
        >>> ShareTest().decide([True] * 58), ShareTest().decide([True] * 59)
        (('undecided', 58), ('met', 59))
        >>> ShareTest(sequential=True).decide([True] * 90)
        ('met', 73)
        """
        n = len(kept)
        if not self.sequential:
            held = self.bound(sum(kept), n)
            word = MET if held.low >= self.share else MISSED if held.high < self.share else UNDECIDED
            return word, n
        met, missed = (
            np.cumsum(np.where(kept, *self._steps(other))) for other in (self.expected, self._worse())
        )
        enough = -math.log(self.alpha)
        ends = np.flatnonzero((met >= enough) | (missed >= enough))
        if not len(ends):
            return UNDECIDED, n
        return MET if met[ends[0]] >= enough else MISSED, int(ends[0]) + 1

    def count_least(self) -> int:
        """Return the smallest number of runs that gives "met" if all of them keep the requirement.

        Examples
        --------
        >>> ShareTest(0.95).count_least(), ShareTest(0.5).count_least()
        (59, 5)
        """
        gain = self._steps(self.expected)[0] if self.sequential else -math.log(self.share)
        return math.ceil(-math.log(self.alpha) / gain)

    def count_runs(self) -> int | None:
        """Return the number of runs that give "met" with 1 - beta for a filter with the expected share.

        None for more than 100,000. If runs are added one by one, fewer may do.

        Examples
        --------
        >>> ShareTest().count_runs(), ShareTest(sequential=True).count_runs()
        (153, 233)
        """
        from scipy.special import bdtrc
        from scipy.stats import binom

        for first in range(self.count_least(), _MOST_RUNS, _BLOCK):
            n = np.arange(first, first + _BLOCK)
            if self.sequential:
                gain, loss = self._steps(self.expected)
                least = np.ceil((-math.log(self.alpha) - n * loss) / (gain - loss))
            else:
                least = binom.isf(self.alpha, n, self.share) + 1.0
            enough = np.flatnonzero(bdtrc(least - 1.0, n, self.expected) >= 1.0 - self.beta)
            if len(enough):
                return int(n[enough[0]])
        return None

    def _steps(self, other: float) -> tuple[float, float]:
        """Return the change of the log likelihood ratio by a run that keeps it, and by one that does not."""
        return math.log(other / self.share), math.log((1.0 - other) / (1.0 - self.share))

    def _worse(self) -> float:
        """Return the share as far below the required one as the expected one is above, in log odds."""
        odds, good = (one / (1.0 - one) for one in (self.share, self.expected))
        return 1.0 / (1.0 + good / odds**2)
