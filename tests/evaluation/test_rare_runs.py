"""Figures that hold whether or not rare large runs exist, by hand; and what they are for."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, binomtest

from bench.evaluation.ensembles.ensemble import ENOUGH, qualify
from bench.evaluation.ensembles.rare_runs import measure_scatter
from tests.evaluation.interval_coverage import count_held, count_same

RARE = ", if no rare large run exists"


def test_fewer_than_59_runs_need_the_words():
    assert (qualify(8), qualify(58), qualify(59), qualify(400)) == (RARE, RARE, "", "")
    assert 0.95**ENOUGH <= 0.05 < 0.95 ** (ENOUGH - 1)


def test_one_large_run_of_eight_is_counted_and_has_its_share():
    errors = np.array([1.0, 2.0, 2.0, 2.0, 2.0, 2.0, 3.0, 6.5])
    found = measure_scatter(errors)
    assert (found.runs, found.median, found.low, found.high, found.large) == (8, 2.0, 1.0, 6.5, 1)
    assert found.share == pytest.approx(6.5**2 / np.square(errors).sum())
    assert found.most == pytest.approx(binomtest(1, 8).proportion_ci(0.9, "exact").high)
    assert found.describe("m") == (
        "median 2 (1 to 6.5) m, 1 of 8 runs above 3 times the median (below 47 % of all), "
        "the largest run 58 % of the sum of squares"
    )
    ratios = measure_scatter(errors, errors / 4.0)
    assert (ratios.median, ratios.large, ratios.share) == (0.5, 1, found.share)


def test_none_of_eight_says_below_31_percent_and_few_runs_have_no_interval():
    even = measure_scatter(np.full(8, 2.0))
    assert even.large_words.startswith(
        "0 of 8 runs above 3 times the median (below 31 % of all), the largest"
    )
    assert even.share == pytest.approx(1 / 8)
    few = measure_scatter(np.array([1.0, 2.0, 3.0]))
    assert few.describe("m").startswith("median 2 m, 0 of 3 runs")
    assert measure_scatter(np.zeros(4)).share == 0.25


def test_a_median_holds_where_the_interval_of_a_pooled_error_does_not():
    """One run in twenty errs ten times more: the median is held in 95 %, the RMSE in less than 80 %."""
    pooled, ratio, median = count_held(np.random.default_rng(1), 300, 8, "normal, one run in twenty 10 times")
    assert median >= binom.ppf(0.001, 300, 0.95)
    assert max(pooled, ratio) <= binom.ppf(0.999, 300, 0.8)
    pooled, ratio, median = count_held(np.random.default_rng(2), 300, 59, "normal")
    assert min(pooled, ratio, median) >= binom.ppf(0.001, 300, 0.93)


def test_filters_5_percent_apart_are_called_the_same_at_most_in_the_stated_share():
    """Two one-sided tests by the interval of 95 %: each at 2.5 %; equal filters are mostly found."""
    for ratio in (1.05, 1.0 / 1.05):
        wrong = count_same(np.random.default_rng(3), 400, 20, ratio, 0.03)
        assert max(wrong) <= binom.ppf(0.999, 400, 0.05)
    assert min(count_same(np.random.default_rng(4), 100, 20, 1.0, 0.01)) > 50
