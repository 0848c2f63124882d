"""The verdict by blocks and axes: a trade is named, matched filters are not accused, and its level holds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from bench.evaluation.ensembles.ensemble_consistency import (
    ERROR_RATE,
    WHOLE,
    judge_ratios,
    read_inside,
    read_ratios,
)
from tests.evaluation.interval_coverage import LEVEL, SKEWED, count_false
from tests.evaluation.power import STEP, TIME_CONSTANTS

AXES = [f"{block}_{axis}" for block in ("pos", "vel", "phi") for axis in "ned"]


def draw_ratios(rng, cases, runs, factors=(1.0, 1.0, 1.0), epochs=11):
    """Yield ratios of NEES of all states, blocks and axes; errors of five of nine states last the run.

    ``factors`` are on the squares of the blocks; the states are in another order in each case.
    """
    a = np.exp(-STEP / np.array([rng.permutation(TIME_CONSTANTS) for _ in range(cases)]))[:, None]
    x, squares = rng.standard_normal((cases, runs, 9)), np.zeros((cases, runs, 9))
    for _ in range(epochs):
        squares += np.square(x) / epochs
        x = a * x + np.sqrt(1.0 - a * a) * rng.standard_normal(x.shape)
    for one in squares * np.repeat(factors, 3):
        blocks = one.reshape(runs, 3, 3).mean(axis=2)
        named = dict(zip(("pos", "vel", "phi"), blocks.T, strict=True)) | dict(zip(AXES, one.T, strict=True))
        yield {**named, WHOLE: one.mean(axis=1)}


def set_ratios(**ratios):
    """Eight runs that scatter by 5 % about these ratios; those that are not given are 1."""
    waves = 1.0 + 0.05 * np.array([-1.0, 1.0] * 4)
    keys = (WHOLE, "pos", "vel", "phi", *AXES)
    return {key: ratios.get(key, 1.0) * waves for key in keys}


@pytest.mark.parametrize(
    ("ratios", "word", "text"),
    [
        ({}, "consistent", "consistent"),
        ({"pos": 1.12}, "consistent", "consistent"),  # not 1, and within 25 %
        (
            {WHOLE: 0.9, "pos": 0.92, "phi": 1.47, "vel": 0.23},
            "overconfident",
            "overconfident in attitude (NEES/3 is 1.47), underconfident in velocity (0.23)",
        ),
        ({"phi_d": 3.0}, "overconfident", "overconfident in heading (NEES is 3)"),
        ({"phi": 2.0, "phi_d": 3.0, "pos_d": 0.5}, "overconfident",
         "overconfident in attitude (NEES/3 is 2), underconfident in height (NEES is 0.5)"),
        ({"pos": 2.0, "vel": 2.0, "phi": 2.0, "vel_e": 3.0}, "overconfident", "overconfident"),
        ({WHOLE: 2.0}, "overconfident", "overconfident"),  # the blocks alone are right
        ({"vel": 0.5}, "underconfident", "underconfident in velocity (NEES/3 is 0.5)"),
        ({"vel": 1.27}, "undecided", "undecided in velocity (NEES/3 is 1.27)"),
        ({WHOLE: 1.2}, "undecided", "undecided"),
        ({WHOLE: np.nan}, "overconfident", "overconfident"),
    ],
)  # fmt: skip
def test_blocks_and_axes_that_are_wrong_are_named(ratios, word, text):
    found = judge_ratios(set_ratios(**ratios))
    assert (found.word, found.text) == (word, text)
    assert (found.runs_to_decide is None) == (word != "undecided")


def test_runs_that_are_all_alike_decide():
    for value, word in (
        (2.0, "overconfident"),
        (1.0, "consistent"),
        (0.5, "underconfident"),
        (0.0, "underconfident"),
    ):
        found = judge_ratios({WHOLE: np.full(3, value)})
        assert (found.word, found.ratios[WHOLE].low, found.ratios[WHOLE].high) == (word, value, value)


def test_a_covariance_that_is_right_in_the_mean_only_is_uneven():
    assert judge_ratios(set_ratios(), np.full(8, 0.5)).text == (
        "uneven, in the central 95 % of its distribution for 50 % of the time"
    )
    assert judge_ratios(set_ratios(), np.full(8, 0.9)).word == "consistent"
    assert judge_ratios(set_ratios(vel=3.0), np.full(8, 0.5)).word == "overconfident"


def test_metrics_of_runs_are_read_where_all_have_them():
    rows = [{"nees_ratio_pos": 1.0, "nees_ratio_vel": 2.0, "nees_inside_95": 0.9}, {"nees_ratio_pos": 3.0}]
    assert {key: values.tolist() for key, values in read_ratios(rows).items()} == {"pos": [1.0, 3.0]}
    assert read_inside(rows) is None
    assert read_inside(rows[:1]).tolist() == [0.9]
    assert (read_ratios([]), read_inside([])) == ({}, None)


def test_400_cards_of_a_matched_filter_hold_the_level():
    """Of 12 flights of 8 runs: false words at most at the error rate, by its 99.9 % bound."""
    flights = 400 * 12
    judged = [judge_ratios(one).word for one in draw_ratios(np.random.default_rng(5), flights, 8)]
    false = sum(word in ("overconfident", "underconfident") for word in judged)
    assert false <= binom.ppf(0.999, flights, ERROR_RATE)


def test_a_trade_between_velocity_and_attitude_is_found_and_named():
    """Attitude sigma x 2 and velocity sigma x 0.86, of which NEES of all states shows little."""
    found = list(map(judge_ratios, draw_ratios(np.random.default_rng(6), 100, 100, (0.95, 0.86**-2, 0.25))))
    assert sum("underconfident in attitude" in one.text for one in found) >= binom.ppf(0.001, 100, 0.99)
    assert "consistent" not in {one.word for one in found}
    told = [
        judge_ratios(one).text for one in draw_ratios(np.random.default_rng(7), 100, 100, (0.92, 2.0, 0.23))
    ]
    named = sum("overconfident in velocity" in one and "underconfident in attitude" in one for one in told)
    assert named >= binom.ppf(0.001, 100, 0.9)


@pytest.mark.parametrize("runs", [8, 40])
@pytest.mark.parametrize("scatter", ["normal, 0.3", "chi-square, 1 degree of freedom", "chi-square, 9"])
def test_the_cube_root_holds_its_level_where_students_t_does_not(scatter, runs):
    small, large, t_small, t_large = count_false(np.random.default_rng(7), 20_000, runs, scatter)
    assert max(small, large) <= binom.ppf(0.999, 20_000, 2.0 * LEVEL)
    if scatter in list(SKEWED)[1:]:
        assert t_small > small
        assert t_large < large
