"""Statistics over runs: each figure against a closed form, each interval by how often it holds the truth.

The simulated errors last the whole run: the epochs of a run share most of their error. Intervals from pooled
epochs would hold the truth in a third of all cases. Counts of misses are held against the 99.9 % band of a
binomial with the stated rate, one-sided where an interval may be wider than it says.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import beta, binom, chi2, norm
from scipy.stats import t as student

from bench.core.records.data import Innovations
from bench.evaluation.ensembles import ensemble

CASES = 1000
RARE = ", if no rare large run exists"


def most_misses(rate=0.05, cases=CASES):
    return binom.ppf(0.999, cases, rate)


def errors_of_runs(rng, runs=40, epochs=12):
    """Errors (runs, epochs) of unit variance, 0.8 of it common to the epochs of a run."""
    common = rng.standard_normal((runs, 1))
    return np.sqrt(0.8) * common + np.sqrt(0.2) * rng.standard_normal((runs, epochs))


def count_misses(estimate, truth, rng, cases=CASES):
    found = [estimate(errors_of_runs(rng)) for _ in range(cases)]
    return sum(not one.low <= truth <= one.high for one in found)


def test_pooled_rmse_is_the_root_of_the_mean_square_and_holds_the_truth():
    rng = np.random.default_rng(1)
    x = errors_of_runs(rng)
    assert ensemble.pool_rmse(np.mean(x**2, axis=1)).value == pytest.approx(np.sqrt(np.mean(x**2)))
    misses = count_misses(lambda x: ensemble.pool_rmse(np.mean(x**2, axis=1)), 1.0, rng)
    assert misses <= most_misses(0.065)  # the jackknife of 40 skewed values misses 6.4 % of 10000


def test_pooled_rmse_of_normal_errors_has_the_interval_of_chi_square():
    """One epoch per run: 500 squares are chi-square, and the jackknife is near its exact interval."""
    x = np.random.default_rng(2).standard_normal(500)
    found = ensemble.pool_rmse(x**2)
    exact = np.sqrt(np.sum(x**2) / chi2.ppf([0.975, 0.025], 500))
    assert (found.low, found.high) == pytest.approx(tuple(exact), rel=0.015)


@pytest.mark.parametrize("fraction", [0.5, 0.95])
def test_radii_hold_the_truth_with_errors_that_last_the_run(fraction):
    rng = np.random.default_rng(3)
    truth = norm.ppf(0.5 + 0.5 * fraction)
    misses = count_misses(lambda x: ensemble.pool_quantile(np.abs(x), fraction), truth, rng)
    assert misses <= most_misses()


def test_a_radius_of_single_epochs_has_the_interval_of_order_statistics():
    x = np.random.default_rng(4).exponential(size=(400, 1))
    found, plain = ensemble.pool_quantile(x, 0.5), ensemble.estimate_quantile(x[:, 0], 0.5)
    assert found.value == pytest.approx(plain.value, rel=0.02)
    assert (found.low, found.high) == pytest.approx((plain.low, plain.high), rel=0.03)


def test_the_interval_of_a_quantile_holds_it_as_often_as_it_says():
    """5000 samples of ten values of a skewed distribution; 99.9 % band of the count of misses."""
    random = np.random.default_rng(5)
    samples = random.exponential(size=(5_000, 10))
    inside = 0
    for sample in samples:
        found = ensemble.estimate_quantile(sample, 0.5)
        inside += found.low <= np.log(2.0) <= found.high
    exact = 1.0 - 2 * (1 + 10) / 2**10  # fewer than two below, or fewer than two above
    assert abs(inside / 5_000 - exact) < 3.3 * np.sqrt(exact * (1 - exact) / 5_000)
    assert ensemble.estimate_quantile(samples[0], 0.95).high is None  # ten values say nothing above


def test_a_quantile_of_times_may_be_never():
    times = np.array([3.0, 4.0, 5.0, np.inf, np.inf, 1.0, 2.0, 2.5, 3.5, 4.5])
    assert ensemble.estimate_quantile(times, 0.5) == ensemble.Quantile(3.5, 2.0, np.inf)


def test_growth_of_a_random_walk_of_velocity_is_its_closed_form():
    """Position errors v T: rms sqrt(2) s T, median s T sqrt(2 ln 2), whatever the error at the start."""
    rng = np.random.default_rng(6)
    t = np.arange(100.0)
    speed, begin = rng.normal(0.0, 0.5, (2000, 1, 3)), rng.normal(0.0, 30.0, (2000, 1, 3))
    rows = ensemble.measure_growth(t, begin + speed * t[:, None], 40.0, [10.0, 30.5])
    for row, T in zip(rows, (10.0, 30.0), strict=True):
        assert row.rms.low <= np.sqrt(2) * 0.5 * T <= row.rms.high
        assert row.median.low <= 0.5 * T * np.sqrt(2 * np.log(2)) <= row.median.high
        assert row.p95.low <= 0.5 * T * np.sqrt(-2 * np.log(0.05)) <= row.p95.high
    with pytest.raises(ValueError, match="no epoch within 10 s of the outage at -20 s"):
        ensemble.measure_growth(t, begin + speed * t[:, None], -20.0, [10.0])


# --- consistency -----------------------------------------------------------------------------------------


def test_coverage_holds_the_truth_with_errors_that_last_the_run():
    rng = np.random.default_rng(8)
    truth = 2 * norm.cdf(1.5) - 1
    misses = count_misses(lambda x: ensemble.estimate_fraction(np.abs(x) < 1.5), truth, rng)
    assert misses <= most_misses()


def test_coverage_of_all_or_none_counts_each_run_once():
    found = ensemble.estimate_fraction(np.ones((40, 1000), bool))
    assert (found.value, found.high) == (1.0, 1.0)
    assert found.low == pytest.approx(0.025 ** (1 / 40))  # closed form of Clopper and Pearson


@pytest.mark.parametrize(("count", "n"), [(1, 40), (20, 40), (39, 40)])
def test_a_rate_has_the_interval_of_clopper_and_pearson(count, n):
    found = ensemble.estimate_rate(count, n)
    assert found.low == pytest.approx(beta.ppf(0.025, count, n - count + 1))
    assert found.high == pytest.approx(beta.ppf(0.975, count + 1, n - count))
    assert binom.sf(count - 1, n, found.low) == pytest.approx(0.025)  # what the ends are defined by
    assert binom.cdf(count, n, found.high) == pytest.approx(0.025)


def test_white_innovations_pass_and_colored_ones_do_not():
    """p-values of white series are uniform: 5 % of 1000 below 0.05. A correlation of 0.1 is found."""
    rng = np.random.default_rng(9)
    low = 0
    for _ in range(CASES):
        low += ensemble.measure_whiteness(list(rng.standard_normal((4, 200)))).p_value < 0.05
    assert binom.ppf(0.0005, CASES, 0.05) <= low <= binom.ppf(0.9995, CASES, 0.05)
    x = rng.standard_normal((4, 1000))
    x[:, 1:] += 0.1 * x[:, :-1]
    found = ensemble.measure_whiteness(list(x))
    assert found.p_value < 0.001
    assert found.correlation[0] == pytest.approx(0.1, abs=found.band)
    assert found.band == pytest.approx(norm.ppf(0.9995) / np.sqrt(4000))
    with pytest.raises(ValueError, match="40 updates in 4 runs are too few for 20 lags"):
        ensemble.measure_whiteness(list(x[:, :10]))


def test_innovations_are_normalized_by_component():
    t = np.repeat(np.arange(3.0), 2)
    table = Innovations(
        t, ("baro", "gnss"), np.ones(6, int), np.tile([0, 1], 3), np.arange(6.0), np.full(6, 4.0),
        np.zeros(6), np.ones(6, bool),
    )  # fmt: skip
    assert ensemble.normalize_innovations(table, "gnss", 1, begin=0.5).tolist() == [1.5, 2.5]
    assert len(ensemble.normalize_innovations(table, "baro", 0)) == 0


def test_innovations_that_repeat_are_found_in_two_runs():
    rng = np.random.default_rng(11)
    runs = []
    for _ in range(2):
        white = rng.standard_normal(3000)
        wandering = white + 0.5 * np.concatenate([[0.0], white[:-1]])
        z = np.column_stack([white, wandering, 1e3 * np.ones(3000)]).ravel()
        code = np.tile([0, 1, 1], 3000)
        t, component = np.repeat(np.arange(3000.0), 3), np.tile([0, 0, 1], 3000)
        table = Innovations(
            t, ("baro", "gnss"), code, component, z, np.full(9000, 4.0), np.zeros(9000), np.ones(9000, bool)
        )
        runs.append(ensemble.sum_repetition(table, 1000.0, 2000.0))
    assert [one["gnss"][2] for one in runs] == [2 * 999] * 2
    found = ensemble.measure_repetition([{"baro": one["baro"]} for one in runs])
    value, edge = found["baro"]
    assert edge == pytest.approx(norm.ppf(0.9995) / np.sqrt(2 * 999))
    assert abs(value) < edge
    only = [ensemble.sum_repetition(replace(table, z=np.where(component, 0.0, z)), 1000.0) for _ in runs]
    value, edge = ensemble.measure_repetition(only)["gnss"]
    assert value == pytest.approx(0.4, abs=edge)  # of a moving average with 0.5: 0.5 / 1.25


def test_the_interval_of_an_rmse_is_the_jackknife_of_its_logarithm():
    squares = np.array([1.0, 4.0, 9.0, 2.0, 30.0])
    roots = [0.5 * np.log(np.delete(squares, k).mean()) for k in range(5)]
    half = student.ppf(0.975, 4) * np.sqrt(4.0 * np.var(roots))
    found, value = ensemble.pool_rmse(squares), np.sqrt(9.2)
    assert (found.value, found.low, found.high) == pytest.approx(
        (value, value * np.exp(-half), value * np.exp(half))
    )
    assert ensemble.pool_rmse(squares, 0.5).high == pytest.approx(
        value * np.exp(half * student.ppf(0.75, 4) / student.ppf(0.975, 4))
    )


@pytest.mark.parametrize("shares", [(0.9, 0.5, 0.8, 0.6), (1.0, 1.0, 1.0, 0.5), (0.7, 0.7, 0.7, 0.7)])
def test_the_interval_of_a_fraction_counts_as_many_values_as_the_runs_scatter_by(shares):
    """Korn and Graubard; degrees of freedom by the squares that the runs bring to the variance."""
    inside = np.arange(20) < 20 * np.array(shares)[:, None] - 0.5
    p, squares = np.mean(shares), np.square(np.array(shares) - np.mean(shares))
    n = 80.0
    if squares.sum() > 1e-9:
        independent = p * (1.0 - p) / (squares.sum() / 3.0 / 4.0)
        dof = max(squares.sum() ** 2 / np.sum(squares**2) - 1.0, 1.0)
        shrink = (student.ppf(0.975, max(independent - 1.0, 1.0)) / student.ppf(0.975, dof)) ** 2
        n = min(80.0, independent * min(shrink, 1.0))
    found = ensemble.estimate_fraction(inside)
    assert found.value == pytest.approx(p)
    assert found.low == pytest.approx(beta.ppf(0.025, p * n, n - p * n + 1.0))
    assert found.high == pytest.approx(beta.ppf(0.975, p * n + 1.0, n - p * n))


def test_a_pooled_quantile_lies_between_the_ends_of_its_fraction():
    values = np.random.default_rng(3).exponential(size=(6, 5)) * np.arange(1.0, 7.0)[:, None]
    found, ordered = ensemble.pool_quantile(values, 0.72), np.sort(values, axis=None)
    assert found.value == ordered[21]  # the 22nd of 30
    below = ensemble.estimate_fraction(values <= found.value)
    low, high = (30 * (end + 0.72 - 22 / 30) for end in (below.low, below.high))
    assert found.low == ordered[int(np.ceil(low)) - 1]
    assert found.high == ordered[min(int(np.ceil(high)), 30) - 1]


def test_whiteness_by_plain_sums():
    """Two runs of 6 and 3 updates at three lags: the second has two pairs, one and none."""
    z = [np.array([1.0, -2.0, 0.5, 3.0, 1.0, 2.0]), np.array([2.0, 1.0, -1.0])]
    found = ensemble.measure_whiteness(z, 2)
    power = sum(np.sum(one**2) for one in z)
    r = [sum(np.sum(one[k:] * one[:-k]) for one in z) / power for k in (1, 2)]
    q = (9 * r[0]) ** 2 / 7 + (9 * r[1]) ** 2 / 5
    assert found.correlation == pytest.approx(np.array(r))
    assert found.p_value == pytest.approx(chi2.sf(q, 2))
    assert (found.updates, found.band) == (9, pytest.approx(norm.ppf(0.9995) / 3.0))
    assert len(ensemble.measure_whiteness(z, 4).correlation) == 4
    with pytest.raises(ValueError, match="9 updates in 2 runs are too few for 5 lags"):
        ensemble.measure_whiteness(z, 5)


def test_repetition_by_plain_sums():
    times = np.array([0.0, 1.0, 1.0, 2.0, 2.0, 3.0, 4.0])
    table = Innovations(
        times, ("baro", "gnss"), np.array([1, 1, 0, 1, 0, 1, 1]), np.array([0, 1, 0, 0, 0, 0, 1]),
        np.array([9.0, 2.0, 4.0, 6.0, -2.0, 4.0, 8.0]), np.full(7, 4.0), np.zeros(7), np.ones(7, bool),
    )  # fmt: skip
    sums = ensemble.sum_repetition(table, 1.0, 4.0)
    assert sums["baro"].tolist() == [-2.0, 5.0, 1.0]
    assert sums["gnss"].tolist() == [6.0, 1.0 + 9.0 + 4.0, 1.0]
    found = ensemble.measure_repetition([sums, {"gnss": np.array([1.0, 2.0, 3.0]), "none": np.zeros(3)}])
    assert found["baro"] == pytest.approx((-0.4, norm.ppf(0.9995)))
    assert found["gnss"] == pytest.approx((7.0 / 16.0, norm.ppf(0.9995) / 2.0))
    assert list(found) == ["baro", "gnss"]


def test_the_better_of_two_is_named_by_the_sign_of_the_difference():
    for low, high, told in (
        (-3.0, -1.0, "a is better than b by 1 to 3 m{}"),
        (1.0, 3.0, "b is better than a by 1 to 3 m{}"),
        (-1.0, 2.0, "a and b: undecided in 7 runs, the first minus the second is -1 to 2 m{}"),
        (0.0, 2.0, "a and b: undecided in 7 runs, the first minus the second is 0 to 2 m{}"),
        (
            -1.1,
            0.1,
            "a and b: undecided in 7 runs, the first minus the second is -1.1 to 0.1 m{}",
        ),
        (-1.0, 0.1, "a and b: the same within 5 % in 7 runs, the first minus the second is -1 to 0.1 m{}"),
    ):
        estimate = ensemble.Estimate(0.5 * (low + high), low, high)
        assert ensemble.Comparison("a", "b", "m", estimate, 7, 20.0).sentence == told.format(RARE)
        assert ensemble.Comparison("a", "b", "m", estimate, 59, 20.0).sentence == told.format("").replace(
            " 7 ", " 59 "
        )


# --- two filters --------------------------------------------------------------------------------------


def test_two_estimators_are_compared_on_the_same_draws():
    """The difference of 2 m is far below the spread of the runs, 5 m, and yet held by a narrow interval."""
    rng = np.random.default_rng(10)
    common = np.exp(rng.normal(0.0, 0.4, 40))
    loose_15, loose_22 = 14.0 * common, 12.0 * common * np.exp(rng.normal(0.0, 0.03, 40))
    found = ensemble.compare_rmse(("loose-15", "loose-22"), loose_15, loose_22, "m")
    truth = 2.0 * np.sqrt(np.mean(common**2))
    assert found.difference.low <= truth <= found.difference.high
    assert found.difference.high - found.difference.low < 0.8
    low, high = found.difference.low, found.difference.high
    assert found.sentence == f"loose-22 is better than loose-15 by {low:.3g} to {high:.3g} m{RARE}"
    turned = ensemble.compare_rmse(("loose-22", "loose-15"), loose_22, loose_15, "m")
    assert turned.sentence == found.sentence


def test_estimators_that_do_not_differ_are_said_not_to_as_often_as_the_interval_says():
    rng = np.random.default_rng(11)
    wrong = 0
    for _ in range(CASES):
        common = np.exp(rng.normal(0.0, 0.3, 40))
        pair = common * np.exp(rng.normal(0.0, 0.1, (2, 40)))
        wrong += "better" in ensemble.compare_rmse(("a", "b"), *pair, "m").sentence
    assert wrong <= most_misses(0.06)
