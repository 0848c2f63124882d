"""Statistics of a change, against closed forms and by their coverage and power in simulation."""

import numpy as np
import pytest
from scipy.stats import binom, fisher_exact, ttest_1samp, ttest_ind, ttest_rel

from bench.evaluation.ensembles import regression
from tests.evaluation.power import LOOKS, ROWS, draw_rmse, is_proven

DRAWS = 20


def identity(mean):
    return mean


def test_paired_means_are_the_paired_t_test():
    rng = np.random.default_rng(1)
    old = rng.normal(10.0, 3.0, DRAWS)
    new = old + rng.normal(0.5, 1.0, DRAWS)
    change = regression.estimate_change(old, new, identity, paired=True)
    expected = ttest_rel(new, old)
    assert change.p_value == pytest.approx(expected.pvalue, rel=1e-9)
    assert change.interval(0.01) == pytest.approx(tuple(expected.confidence_interval(0.99)))


def test_unpaired_means_are_welchs_t_test():
    rng = np.random.default_rng(2)
    old, new = rng.normal(10.0, 3.0, 20), rng.normal(11.0, 1.0, 35)
    change = regression.estimate_change(old, new, identity, paired=False)
    expected = ttest_ind(new, old, equal_var=False)
    assert change.p_value == pytest.approx(expected.pvalue, rel=1e-9)
    assert change.dof == pytest.approx(expected.df)


def test_a_factor_on_every_draw_has_no_spread():
    old = np.random.default_rng(3).uniform(1, 5, DRAWS)
    change = regression.estimate_change(old**2, (1.1 * old) ** 2, regression.half_log_of_mean, paired=True)
    assert change.estimate == pytest.approx(np.log(1.1))
    assert change.p_value < 1e-12


def test_nees_is_compared_by_its_distance_from_the_expectation():
    scale = regression.log_distance_from(9.0)
    old, new = np.full(DRAWS, 18.0), np.full(DRAWS, 4.5)
    assert regression.estimate_change(old, new, scale, paired=True).estimate == pytest.approx(0.0)
    nearer = regression.estimate_change(old, np.full(DRAWS, 9.0), scale, paired=True)
    assert nearer.estimate == pytest.approx(-np.log(2))


def test_counts_are_mcnemars_and_fishers_exact_tests():
    old = np.array([True] * 15 + [False] * 5)
    new = np.array([True] * 6 + [False] * 9 + [True] * 1 + [False] * 4)  # nine lost, one gained
    assert regression.compare_counts(old, new, paired=True) == pytest.approx(2 * binom.cdf(1, 10, 0.5))
    table = [[15, 5], [7, 13]]
    assert regression.compare_counts(old, new, paired=False) == pytest.approx(fisher_exact(table)[1])
    assert regression.compare_counts(old, old, paired=True) == 1.0


def test_changes_without_spread_or_with_one_sign_by_draw():
    """Means of 2 and 4 without spread; t is no larger than that of the runs, whose sign must be the same."""
    old, new = np.full(5, 2.0), np.full(8, 4.0)
    assert regression.estimate_change(old, new, identity, paired=False).dof == 4.0
    assert regression.estimate_change(old, new, identity, paired=False).p_value == 0.0
    assert regression.estimate_change(old, old, identity, paired=True).p_value == 1.0
    old, new = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1.5, 2.2, 3.9, 4.1])
    own = regression.estimate_change(old, new, identity, paired=True)
    by_draw = np.array([0.5, -0.4, 0.9, 0.1])
    wide = regression.estimate_change(old, new, identity, paired=True, by_draw=by_draw)
    t = by_draw.mean() / (by_draw.std(ddof=1) / 2.0)
    assert wide.standard_error == pytest.approx(own.estimate / t)
    assert wide.standard_error > own.standard_error
    sure = regression.estimate_change(old, new, identity, paired=True, by_draw=0.5 + 0.01 * by_draw)
    assert sure.standard_error == pytest.approx(own.standard_error)
    turned = regression.estimate_change(old, new, identity, paired=True, by_draw=-by_draw)
    assert (turned.standard_error, turned.p_value) == (np.inf, 1.0)
    with pytest.raises(ValueError, match="at least 2 runs; got 4 and 1"):
        regression.estimate_change(old, new[:1], identity, paired=False)


def test_the_mean_of_changes_is_students_t_of_one_sample():
    by_draw = np.array([0.5, -0.4, 0.9, 0.1])
    change, expected = regression.average_changes(by_draw), ttest_1samp(by_draw, 0.0)
    assert (change.estimate, change.dof, change.draws) == (pytest.approx(0.275), 3.0, 4)
    assert change.p_value == pytest.approx(expected.pvalue)


def test_scales_of_comparison_by_hand():
    assert regression.half_log_of_mean(np.array([4.0]))[0] == pytest.approx(np.log(2.0))
    assert regression.log_distance_from(9.0)(np.array([3.0]))[0] == pytest.approx(np.log(3.0))
    assert regression.distance_from(9.0)(np.array([3.0, 11.0])).tolist() == [6.0, 2.0]
    assert np.isneginf(regression.log_of_mean(np.zeros(1))).all()


def test_holm_stops_at_the_first_p_value_that_is_too_large():
    rejected, levels = regression.reject_by_holm([0.0001, 0.0051, 0.0026, 0.5], 0.01)
    assert rejected.tolist() == [True, False, True, False]
    assert levels == pytest.approx([0.01 / 4, 0.01 / 2, 0.01 / 3, 0.01])
    assert regression.reject_by_holm([], 0.01)[0].tolist() == []


@pytest.mark.parametrize("fewer", [0, 1])
def test_too_few_draws_are_an_error(fewer):
    with pytest.raises(ValueError, match="at least 2 runs"):
        regression.estimate_change(np.ones(fewer), np.ones(fewer), identity, paired=True)


# --- the rule as a whole, by simulation -------------------------------------------------------------------


def test_a_loss_of_10_percent_with_5_percent_scatter_is_found():
    """At least 90 % of 300 checks find it after 20, 40 or 80 runs, by the 99.9 % band of 90 %."""
    old, new = draw_rmse(np.random.default_rng(4), 300, 0.10, 0.05, spread=0.4)
    found = sum(any(is_proven(a[:n], b[:n]) for n in LOOKS) for a, b in zip(old, new, strict=True))
    assert found >= binom.ppf(0.001, 300, 0.9)


def test_scatter_without_a_loss_raises_no_alarm():
    """Draws that differ by e^2 and move by 20 %: less than 1 % of 50 checks of 100 rows at their first look.

    Without the test of the single runs about 7 rows raise an alarm: the largest runs decide the pooled
    value, and the jackknife does not know how few they are.
    """
    old, new = draw_rmse(np.random.default_rng(5), 50 * ROWS, 0.0, 0.20, spread=0.6)
    alarms = sum(is_proven(a[:20], b[:20]) for a, b in zip(old, new, strict=True))
    assert alarms <= binom.ppf(0.999, 50, 0.01 / len(LOOKS))


def test_draws_that_move_the_other_way_prove_nothing():
    old = np.ones(DRAWS)
    new = np.full(DRAWS, 0.9)
    new[0] = 3.0  # one bad draw makes the pooled value worse, and all others are better
    change = regression.estimate_change(
        old, new, regression.log_of_mean, paired=True, by_draw=np.log(new / old)
    )
    assert change.estimate > 0
    assert change.p_value == 1.0
