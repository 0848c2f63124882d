"""Two compared on the same runs: the ratio, the word, and how many runs would tell."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from bench.evaluation.ensembles.paired_draws import SAME, compare_draws_of

NAMES = ("a", "b")


def test_twice_the_error_of_the_same_draws_is_a_ratio_of_a_half():
    values = np.array([3.0, 1.0, 7.0, 2.0])
    pair = compare_draws_of(NAMES, values, 2.0 * values)
    assert (pair.word, pair.draws, pair.deciding) == ("better", 4, None)
    assert pair.ratio.value == pytest.approx(0.5)
    assert pair.ratio.high - pair.ratio.low < 1e-9
    assert pair.sentence == "a over b 0.5 (0.5 to 0.5, if no rare large run exists): better"
    assert compare_draws_of(NAMES, 2.0 * values, values).word == "worse"


def test_equal_draws_are_the_same_and_so_are_draws_within_5_percent():
    values = np.array([3.0, 1.0, 7.0, 2.0])
    assert compare_draws_of(NAMES, values, values).word == "same"
    assert compare_draws_of(NAMES, np.zeros(3), np.zeros(3)).word == "same"
    assert [compare_draws_of(NAMES, one * values, values).word for one in (0.94, 0.96, 1.04, 1.06)] == [
        "better", "same", "same", "worse",
    ]  # fmt: skip
    rng = np.random.default_rng(2)
    base = np.abs(rng.standard_normal(400))
    pair = compare_draws_of(NAMES, base, base * np.exp(0.02 * rng.standard_normal(400)))
    assert pair.word == "same"
    assert 1.0 / (1.0 + SAME) < pair.ratio.low < 1.0 < pair.ratio.high < 1.0 + SAME


def test_the_ratio_is_that_of_root_mean_squares_and_not_of_means():
    first, second = np.array([1.0, 1.0, 7.0]), np.array([5.0, 5.0, 1.0])
    assert compare_draws_of(NAMES, first, second).ratio.value == pytest.approx(1.0)


def draw(rng, n, size, correlation=0.9):
    """Return the horizontal errors (n,) of two, the second of a size, whose runs are correlated."""
    x, y = rng.standard_normal((2, n, 2))
    other = correlation * x + np.sqrt(1.0 - correlation**2) * y
    return np.hypot(*x.T), size * np.hypot(*other.T)


def test_of_two_that_are_the_same_a_wrong_word_is_as_rare_as_asked_for():
    """Never above the 99.9 % edge of 5 % in 600 pairs of 12 runs."""
    rng = np.random.default_rng(5)
    words = [compare_draws_of(NAMES, *draw(rng, 12, 1.0)).word for _ in range(600)]
    wrong = sum(word in ("better", "worse") for word in words)
    assert wrong <= stats.binom.ppf(0.999, 600, 0.05)


def find_deciding(half, clear):
    """Return of how many draws the half width of 30 is ``clear``: it goes with t over the root of N."""

    def width(n):
        return half * stats.t.ppf(0.975, n - 1) / stats.t.ppf(0.975, 29) * np.sqrt(30 / n)

    return optimize.brentq(lambda n: width(n) - clear, 30.0, 1e6)


def test_the_draws_that_would_decide_decide_in_about_half_of_the_cases():
    """The interval then just reaches the nearer edge; a quarter of the runs decides seldom."""
    rng = np.random.default_rng(11)
    first, second = draw(rng, 30, 1.15)
    pair = compare_draws_of(NAMES, first, second)
    while pair.word != "undecided":
        first, second = draw(rng, 30, 1.15)
        pair = compare_draws_of(NAMES, first, second)
    assert pair.deciding is not None
    assert f"undecided in 30 runs, about {pair.deciding - 30} more would decide" in pair.sentence
    half = np.log(pair.ratio.high / pair.ratio.value)
    off = abs(np.log(pair.ratio.value))
    assert pair.deciding == pytest.approx(find_deciding(half, max(off, np.log1p(SAME) - off)), abs=2)
    many = [compare_draws_of(NAMES, *draw(rng, 4 * pair.deciding, pair.ratio.value)).word for _ in range(40)]
    few = [compare_draws_of(NAMES, *draw(rng, max(pair.deciding // 4, 3), 1.0)).word for _ in range(40)]
    assert sum(word != "undecided" for word in many) > 2 * sum(word != "undecided" for word in few)


def test_two_that_are_nearly_the_same_need_draws_until_the_interval_is_within_5_percent():
    rng = np.random.default_rng(3)
    while True:
        pair = compare_draws_of(NAMES, *draw(rng, 30, 1.0, correlation=0.99))
        off = abs(np.log(pair.ratio.value))
        if pair.deciding is not None and 0.01 < off < 0.02:
            break
    half = np.log(pair.ratio.high / pair.ratio.value)
    assert pair.deciding == pytest.approx(find_deciding(half, np.log1p(SAME) - off), abs=2)


def test_pairs_that_hardly_differ_are_not_promised_to_be_told():
    values = np.array([1.0, 2.0])
    pair = compare_draws_of(NAMES, values, np.array([2.0, 1.0]) * (1.0 + 0.5 * SAME))
    assert pair.word == "undecided"
    assert pair.deciding is None or pair.deciding > 1000
