"""Factors of variances are found, and their intervals hold the truth as often as they say, by Monte Carlo."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import binom, sem, t, ttest_1samp

from bench.experiments.tuning.factor_search import (
    REACH,
    SpentError,
    Tried,
    find_edge,
    find_ends,
    search_factors,
    step_to_valley,
    t_value,
    walk,
)

TRUE = np.log([0.2, 3.0])  # right factors of the two noises that show
DRAWS, EPOCHS = 8, 400


def draw_costs(seed: int, draws: int = DRAWS) -> Callable[[np.ndarray], np.ndarray]:
    """Log scores of two errors of known variances, correlated over epochs by first-order Markov processes.

    The first error has noise a, the second 0.3 of it and noise b; a third noise is too small to show.
    """
    rng = np.random.default_rng(seed)
    kept, errors = 0.9, np.empty((draws, EPOCHS, 2))
    errors[:, 0] = rng.standard_normal((draws, 2))
    for k in range(1, EPOCHS):
        errors[:, k] = kept * errors[:, k - 1] + np.sqrt(1 - kept**2) * rng.standard_normal((draws, 2))

    def variances(x: np.ndarray) -> np.ndarray:
        a, b, c = np.exp(2 * x)
        return np.array([a + 1e-4 * c, 0.3 * a + b + 1e-4 * c])

    errors *= np.sqrt(variances(np.append(TRUE, 0.0)))

    def costs(x: np.ndarray) -> np.ndarray:
        v = variances(x)
        return 0.5 * (np.square(errors) / v + np.log(v)).mean(axis=1).sum(axis=1)

    return costs


def test_a_case_with_a_solution_by_hand():
    """One factor on the variance of one error: the cost is least where the factor is its RMS."""
    squares = np.array([1.1, 0.7, 1.4, 0.9, 1.2, 0.6, 1.0, 1.3]) * 0.04
    found = search_factors(lambda x: 0.5 * (squares * np.exp(-2 * x[0]) + 2 * x[0]), 1, 200)
    assert found.converged
    assert found.agreed == found.starts == 3
    mean = squares.mean()
    assert np.exp(2 * found.x[0]) == pytest.approx(mean, rel=0.01)
    # the slope of a run is 1 - square / factor^2: its mean is zero within t of its standard error
    reach = 2.3646 * squares.std(ddof=1) / np.sqrt(len(squares))
    assert np.exp(2 * found.low[0]) == pytest.approx(mean - reach, rel=0.02)
    assert np.exp(2 * found.high[0]) == pytest.approx(mean + reach, rel=0.02)


def test_intervals_hold_the_truth_and_what_does_not_show_has_no_end():
    repetitions = 40  # on flights: tests.campaigns.tune_power
    inside, below, above = np.zeros(2), 0, 0
    for seed in range(repetitions):
        found = search_factors(draw_costs(seed), 3, 1000)
        assert found.converged
        inside += (found.low[:2] <= TRUE) & (found.high[:2] >= TRUE)
        below += found.low[2] == -np.inf
        above += found.high[2] <= REACH
    low, high = binom.ppf([0.0005, 0.9995], repetitions, 0.95)
    assert ((low <= inside) & (inside <= high)).all(), inside
    assert below > 0.9 * repetitions  # the third noise may be none
    assert above > 0.9 * repetitions  # but not a hundred times as much


def test_a_search_that_is_cut_short_says_so():
    found = search_factors(draw_costs(1), 3, 20)
    assert not found.converged
    assert np.isnan(found.low).all()


@pytest.mark.parametrize("deep", [-2.0, 2.0])
def test_the_start_does_not_matter(deep):
    """A second valley, beside the first start: another start finds the deeper one, and goes to its bottom."""
    draws = np.linspace(-0.01, 0.01, 6)

    def costs(x: np.ndarray) -> np.ndarray:
        near = 1 - np.exp(-np.square((x[0] - 0.1) / 0.3))
        return near - 3 * np.exp(-np.square((x[0] - deep) / 0.5)) + draws * x[0]

    found = search_factors(costs, 1, 500)
    assert found.x[0] == pytest.approx(deep, abs=0.002)
    assert found.agreed < found.starts


@pytest.mark.parametrize("off", [(0.02, -0.03, 0.01), (-0.02, 0.03, -0.01), (0.3, 0.0, -0.3)])
def test_a_step_goes_to_the_bottom_of_a_quadratic_and_no_further_than_its_reach(off):
    """Second derivatives are those of the cost and of the pull to 1; of three factors that go together."""
    A, bottom = np.array([[3.0, 1.0, -0.5], [1.0, 2.0, 0.7], [-0.5, 0.7, 4.0]]), np.array([0.1, -0.2, 0.3])

    def costs(x: np.ndarray) -> np.ndarray:
        return np.full(2, 0.5 * (x - bottom) @ A @ (x - bottom) - 1e-3 * x @ x)  # less the pull

    start = bottom + off
    found, hessian = step_to_valley(Tried(costs, 100), start)
    assert hessian == pytest.approx(A, abs=1e-9)
    assert found == pytest.approx(start - np.clip(off, -0.05, 0.05), abs=1e-9)


def test_the_ends_of_a_quadratic_are_where_students_t_is_at_its_edge():
    """The slope of a run is linear in the factor, and the others follow: so is t, and the ends are exact."""
    A = np.array([[3.0, 1.0, -0.5], [1.0, 2.0, 0.7], [-0.5, 0.7, 4.0]])
    right = np.random.default_rng(2).normal(scale=[0.1, 0.5, 0.02], size=(8, 3))
    right -= right.mean(axis=0)

    def costs(x: np.ndarray) -> np.ndarray:
        off = x - right
        return 0.5 * np.einsum("di,ij,dj->d", off, A, off)

    edge = t.ppf(0.975, 7)
    assert find_edge(8) == pytest.approx(edge)
    low, high = find_ends(Tried(costs, 0), np.zeros(3), A, edge)
    assert high == pytest.approx(edge * sem(right, axis=0), rel=1e-9)
    assert low == pytest.approx(-high, rel=1e-9)


def test_second_derivatives_are_of_a_tenth():
    """Of x^4 at 0: 2 h^2, and twice the pull."""
    _, hessian = step_to_valley(Tried(lambda x: np.full(2, x[0] ** 4), 9), np.zeros(1))
    assert hessian[0, 0] == pytest.approx(2 * 0.1**2 + 2e-3)
    for curved in (0.0, -1.0):  # never less than the pull: a step leads down
        _, hessian = step_to_valley(Tried(lambda x, c=curved: np.full(2, c * x[0] ** 2), 9), np.zeros(1))
        assert hessian[0, 0] == pytest.approx(2e-3)


def test_the_search_begins_at_1_and_at_5_and_a_fifth_of_each(monkeypatch):
    """Far at first; to 5 % from the first start and at the end, to 20 % where starts are only compared."""
    asked = []

    def minimize(function, start, bounds, options, **_):
        asked.append((start.tolist(), options["initial_tr_radius"], options["final_tr_radius"]))
        assert bounds == [(-REACH, REACH)] * 2
        function(np.array([0.1, 0.2]) + len(asked))
        return SimpleNamespace(x=np.array([0.1, 0.2]) + len(asked))

    monkeypatch.setattr("scipy.optimize.minimize", minimize)
    search_factors(lambda x: np.array([1.0, 1.1]) * np.square(x - 2.1).sum(), 2, 300)
    log2, log5 = np.log(2.0), np.log(5.0)
    starts = [([0.0] * 2, 0.05), ([log5] * 2, 0.2), ([-log5] * 2, 0.2), ([2.1, 2.2], 0.05)]
    assert asked == [(start, pytest.approx(log2), last) for start, last in starts]


def test_the_way_to_an_end_grows_by_half_until_the_largest_factor():
    """From 0.05 on; a factor without effect has no end, one that all runs tell alike ends at once."""
    tried = Tried(lambda x: np.zeros(3), 0)
    for side in (1.0, -1.0):
        assert walk(tried, np.zeros(1), np.array([side]), 0, 4.3) == side * np.inf
    places = 0.05 * np.cumsum(1.5 ** np.arange(9))  # the next is beyond log 100
    assert sorted(abs(x) for (x,) in tried.rows) == pytest.approx([0.0, *np.repeat(places, 2)])
    assert places[-1] < np.log(100.0) < places[-1] + 0.05 * 1.5**9
    further = Tried(lambda x: np.zeros(3), 0)
    assert walk(further, np.array([2.0]), np.array([1.0]), 0, 4.3) == np.inf
    assert max(further.rows) == pytest.approx((2.0 + places[7],))
    steep = Tried(lambda x: np.full(3, x[0] ** 2), 0)
    assert walk(steep, np.array([0.2]), np.array([1.0]), 0, 4.3) == pytest.approx(0.2 + 0.025)


def test_t_is_that_of_student_and_of_equal_draws_infinite():
    values = np.array([0.3, -0.1, 0.4, 0.2])
    assert t_value(values) == pytest.approx(ttest_1samp(values, 0.0).statistic)
    assert [t_value(np.full(3, x)) for x in (0.0, 2.0, -2.0)] == [0.0, np.inf, -np.inf]


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_factor_that_ought_to_be_larger_than_any_is_at_the_bound(side):
    found = search_factors(lambda x: np.array([1.0, 1.1]) * (10.0 - side * x[0]), 1, 300)
    assert found.x == pytest.approx([side * np.log(100.0)])


def test_the_pull_to_1_is_a_thousandth_of_the_square_and_sets_are_counted():
    tried = Tried(lambda x: np.array([1.0, 3.0]), 2)
    assert tried.mean(np.array([3.0, 4.0])) == pytest.approx(2.0 + 1e-3 * 25.0)
    tried.search(np.array([0.5, 0.0]))
    with pytest.raises(SpentError):
        tried.search(np.array([0.0, 0.0]))
    assert tried.best().tolist() == [0.5, 0.0]
