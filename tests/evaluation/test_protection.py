"""Protection levels on fixes by least squares, where every covariance has a closed form."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.stats import binom

from bench.evaluation.metrics.protection import (
    deviations,
    multipliers,
    protect_by_separation,
    protect_fault_free,
)
from bench.evaluation.requirements.required_performance import (
    Watched,
    bound_per_hour,
    count_detected,
    count_windows,
    hours_flown,
    judge_rate,
    judge_share,
)
from tests.evaluation.solutions import weaving_truth, wrong_solution

SIGHT = np.array(
    [
        [0, 0, -1],
        [0.9, 0, -0.44],
        [-0.5, 0.8, -0.33],
        [-0.6, -0.7, -0.39],
        [0.3, -0.9, -0.3],
        [0.1, 0.8, -0.6],
    ]
)
G = np.hstack([-SIGHT / np.linalg.norm(SIGHT, axis=1)[:, None], np.ones((6, 1))])
SD = np.array([2.0, 3.0, 2.5, 4.0, 3.0, 2.0])


def solve(keep):
    """How the ranges move a fix by least squares (3, 6), and its covariance."""
    weight = keep / SD**2
    inverse = np.linalg.inv(G.T @ (weight[:, None] * G))
    return (inverse @ (G.T * weight))[:3], inverse[:3, :3]


def draw(draws, bias, seed, scale=1.0):
    """Fixes with all satellites, and without each, and the errors of the first.

    The ranges have errors of SD, one of them a bias; the fixes state ``scale`` times the sd they have.
    """
    rng = np.random.default_rng(seed)
    errors = rng.normal(size=(draws, 6)) * SD
    errors[:, 1] += bias
    truth = weaving_truth(duration=0.01 * (draws - 1))

    def fixed(keep):
        response, cov = solve(keep)
        return wrong_solution(truth, every=1, pos_n=errors @ response.T, cov=scale**2 * padded(cov))

    everything = np.ones(6)
    subsets = [everything - np.eye(6)[s] for s in range(6)]
    return fixed(everything), [fixed(keep) for keep in subsets], errors @ solve(everything)[0].T


def padded(cov):
    return np.pad(cov, (0, 6))


def test_the_multipliers_are_those_of_do_229():
    assert_allclose([multipliers(5e-9)[0], multipliers(1e-7)[1]], [6.18, 5.33], atol=5e-3)


def test_alarms_without_a_fault_are_no_more_frequent_than_asked():
    """The bound is on the sum of all subfilters, by the major axis; vertical and horizontal share it."""
    draws, asked = 4000, 0.05
    full, subsets, _ = draw(draws, 0.0, 2)
    alarms = int(protect_by_separation(full, subsets, asked).alarm.sum())
    assert 0 < alarms <= binom.ppf(0.999, draws, 2 * asked)
    full, subsets, _ = draw(draws, 0.0, 2, scale=0.5)
    assert protect_by_separation(full, subsets, asked).alarm.sum() > binom.ppf(0.999, draws, 2 * asked)


@pytest.mark.parametrize("bias", [10.0, 20.0, 30.0, 60.0])
def test_a_faulty_satellite_misleads_no_more_often_than_asked(bias):
    draws, missed = 4000, 1e-2
    full, subsets, error = draw(draws, bias, 3)
    found = protect_by_separation(full, subsets, 1e-3, missed)
    size = np.column_stack([np.hypot(error[:, 0], error[:, 1]), np.abs(error[:, 2])])
    misled = (~found.alarm[:, None] & (size > found.level)).sum(axis=0)
    assert (misled <= binom.ppf(0.999, draws, missed)).all()
    if bias == 60.0:
        assert found.alarm.mean() > 0.99
        without_alarm = protect_fault_free(full)
        assert (size[:, 1] > without_alarm.level[0, 1]).mean() > missed  # fault-free levels do not hold


def test_the_major_axis_is_the_larger_eigenvalue():
    cov = np.array([[[4.0, 1.5, 0.0], [1.5, 2.0, 0.0], [0.0, 0.0, 9.0]]])
    largest = np.linalg.eigvalsh(cov[0, :2, :2]).max()
    assert_allclose(deviations(cov), [[np.sqrt(largest), 3.0]])


def watch(error, level, alarm=None, limit=10.0):
    error, level = np.array(error, float), np.array(level, float)
    alarm = np.zeros(error.shape, bool) if alarm is None else np.array(alarm, bool)
    return Watched(1.0, error, level, alarm, limit)


def test_the_parts_of_the_stanford_diagram():
    watched = watch([[1, 6, 12, 12, np.nan, 12]], [[5, 5, 15, 8, 5, 8]], [[0, 0, 0, 0, 0, 1]])
    assert watched.alert.tolist() == [[False, False, True, False, False, True]]
    assert watched.misleading.tolist() == [[False, True, False, True, True, False]]
    assert watched.hazardous.tolist() == [[False, False, False, True, True, False]]


def test_an_error_is_told_in_time_or_not():
    error = [[1, 20, 20, 20, 1, 20, 20, 20]]
    alarm = [[0, 0, 1, 1, 0, 0, 0, 0]]
    watched = watch(error, np.full((1, 8), 5.0), alarm)
    assert count_detected(watched, 1.0) == (1, 0)  # the second time nothing tells
    first = watch(np.array(error)[:, :5], np.full((1, 5), 5.0), np.array(alarm)[:, :5])
    assert count_detected(first, 1.0) == (1, 1)
    assert count_detected(first, 0.0) == (1, 0)


def test_the_errors_of_a_run_are_one_trial():
    """A hundred errors in each of two flights show no rate of one in a thousand."""
    error = np.tile([1.0, 20.0], (3, 100))
    error[2] = 1.0
    watched = watch(error, np.full(error.shape, 5.0), np.tile([False, True], (3, 100)))
    assert count_detected(watched, 0.0) == (2, 2)
    watched.alarm[1, 7] = False
    assert count_detected(watched, 0.0) == (2, 1)


def test_continuity_counts_windows_that_may_be_begun():
    level = np.full((2, 9), 5.0)
    level[0, 4] = level[1, 3:6] = 50.0  # the first run loses its second window, the other never begins it
    begun, lost = count_windows(watch(np.ones((2, 9)), level), 3.0)
    assert begun.tolist() == [[True, True, True], [True, False, True]]
    assert lost.tolist() == [[False, True, False], [False, False, False]]
    assert count_windows(watch(np.ones((2, 9)), level), 20.0) is None


def test_300_000_hours_without_an_event_show_1e_5_per_hour():
    assert bound_per_hour(0, -np.log(0.05) / 1e-5) == pytest.approx(1e-5)
    assert bound_per_hour(1, 1.0) > bound_per_hour(0, 1.0)
    assert hours_flown((60, 900), 2.0) == pytest.approx(30.0)


@pytest.mark.parametrize(("events", "hours"), [(0, 299_574.0), (3, 775_366.0)])
def test_a_rate_is_met_from_the_hours_on_that_show_it(events, hours):
    """By the chi-square quantiles of a Poisson rate; before, it says how many hours are missing."""
    needed = stats.chi2.ppf(0.95, 2 * events + 2) / 2.0 / 1e-5
    assert needed == pytest.approx(hours, rel=1e-4)
    assert judge_rate(events, 1.001 * needed, 1e-5).word == "met"
    before = judge_rate(events, 0.4 * needed, 1e-5)
    assert before.word == "undecided"
    assert before.more_h == pytest.approx(0.6 * needed)
    assert before.found.value == pytest.approx(events / (0.4 * needed))


def test_a_rate_is_missed_where_its_lower_bound_is_above():
    """Two events: the rate is at least 0.355 / T with 95 %, by the chi-square quantile of 4 degrees."""
    lower = stats.chi2.ppf(0.05, 4) / 2.0
    assert judge_rate(2, 10.0, 0.999 * lower / 10.0).word == "missed"
    assert judge_rate(2, 10.0, 1.001 * lower / 10.0).word == "undecided"
    assert judge_rate(2, 10.0, 1.0).found.low == pytest.approx(lower / 10.0)


def test_a_share_of_time_that_always_holds_needs_59_flights():
    """0.95^59 < 0.05: a bad flight in twenty would have been seen; 40 flights of half an hour leave 9.5 h."""
    assert judge_share(np.ones((59, 10), bool), 0.95, 1.0).word == "met"
    few = judge_share(np.ones((40, 10), bool), 0.95, 20.0)
    assert few.word == "undecided"
    assert few.more_h == pytest.approx((np.log(0.05) / np.log(0.95) - 40) * 0.5)
    assert judge_share(np.zeros((8, 10), bool), 0.95, 1.0).word == "missed"


def test_a_share_counts_flights_and_not_instants():
    """Five of ten flights are bad throughout: 500 epochs do not show that it is less than 0.7."""
    half = np.zeros((10, 50), bool)
    half[:5] = True
    found = judge_share(half, 0.7, 5.0)
    assert found.word == "undecided"
    # an interval shrinks with the root of the flights: its end, 0.3 or less away, has to come within 0.2
    far = (found.found.high - 0.5) / 0.2
    assert found.more_h == pytest.approx(10.0 * (far**2 - 1.0) * 0.5)
    mixed = np.random.default_rng(3).random((10, 50)) < 0.5
    assert judge_share(mixed, 0.7, 5.0).word == "missed"


def test_levels_of_two_subfilters_by_hand():
    """Separations of 5 m and 2 m, and of 0; the multipliers are those of a Rayleigh and a normal variable."""
    truth = weaving_truth(1.0)
    P = np.diag([4.0, 1.0, 9.0]), np.diag([9.0, 5.0, 13.0]), np.diag([5.0, 10.0, 25.0])
    off = np.zeros(3), np.array([3.0, -4.0, 2.0]), np.zeros(3)
    full, *without = (wrong_solution(truth, pos_n=e, cov=padded(cov)) for e, cov in zip(off, P, strict=True))
    fa, md = 1e-3, 1e-2
    k_fa = stats.rayleigh.isf(fa / 2), stats.norm.isf(fa / 4)
    k_md = stats.rayleigh.isf(md), stats.norm.isf(md / 2)
    plain = np.array([6.18 * 2.0, 5.33 * 3.0])
    bounds = [
        (k_fa[0] * np.sqrt(5.0) + k_md[0] * 3.0, k_fa[1] * 2.0 + k_md[1] * np.sqrt(13.0)),
        (k_fa[0] * 3.0 + k_md[0] * np.sqrt(10.0), k_fa[1] * 4.0 + k_md[1] * 5.0),
    ]
    found = protect_by_separation(full, without, fa, md)
    assert_allclose(found.level, np.tile(np.max([plain, *bounds], axis=0), (len(full), 1)), rtol=1e-9)
    assert found.alarm.any() == (k_fa[0] * np.sqrt(5.0) < 5.0 or k_fa[1] * 2.0 < 2.0)
    far = [wrong_solution(truth, pos_n=[0.0, 0.0, size], cov=padded(P[1])) for size in (-6.9, 6.9)]
    edge = stats.norm.isf(fa / 2) * 2.0
    for one in far:
        assert protect_by_separation(full, [one], fa, md).alarm.all() == (edge < 6.9)
    lost = wrong_solution(truth, cov=np.full((9, 9), np.nan))
    assert np.isinf(protect_by_separation(full, [lost], fa, md).level).all()
    assert_allclose(protect_fault_free(full).level, np.tile(plain, (len(full), 1)))
    assert np.isinf(protect_fault_free(lost).level).all()
    assert_allclose(protect_by_separation(full, [], fa, md).level, np.tile(plain, (len(full), 1)))


@pytest.mark.parametrize(("events", "hours"), [(0, 100.0), (2, 1000.0), (9, 1000.0), (0, 400.0)])
def test_a_rate_is_judged_by_the_interval_of_poisson(events, hours):
    most = 8e-3
    low = stats.chi2.ppf(0.05, 2 * events) / 2.0 / hours if events else 0.0
    high = stats.chi2.ppf(0.95, 2 * events + 2) / 2.0 / hours
    found = judge_rate(events, hours, most)
    assert (found.found.low, found.found.high) == pytest.approx((low, high))
    assert found.found.value == events / hours
    assert found.word == ("met" if high <= most else "missed" if low > most else "undecided")
    if found.word == "undecided":
        assert found.more_h == pytest.approx(stats.chi2.ppf(0.95, 2 * events + 2) / 2.0 / most - hours)
    assert judge_rate(30, 1000.0, most).word == "missed"


def test_a_share_is_judged_by_flights_and_tells_how_many_hours_more():
    flights = np.ones((20, 100), bool)
    assert judge_share(flights, 0.85, 10.0).word == "met"  # 0.05^(1/20) is 0.861
    more = judge_share(flights, 0.95, 10.0)
    assert more.word == "undecided"
    assert more.more_h == pytest.approx((np.log(0.05) / np.log(0.95) - 20.0) * 0.5)
    flights[:5, :40] = False
    for least in (0.87, 0.93):
        found = judge_share(flights, least, 10.0)
        end = found.found.low if found.found.value > least else found.found.high
        needed = 20.0 * ((end - found.found.value) / (least - found.found.value)) ** 2
        assert found.found.value == pytest.approx(0.9)
        assert found.word == "undecided"
        assert found.more_h == pytest.approx(max(needed - 20.0, 1.0) * 0.5)
    assert judge_share(flights, found.found.value, 10.0).more_h is None
    assert judge_share(flights, 0.999, 10.0).word == "missed"
    assert judge_share(flights, 0.5, 10.0).word == "met"
    assert hours_flown((3, 40), 15.0) == pytest.approx(0.5)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_solutions_that_are_apart_along_any_axis_raise_an_alarm(axis):
    """Covariances of 1 and 2 m^2, so their difference has 1 m^2: 6 m is beyond what is asked, 2 m is not."""
    truth, cov = weaving_truth(duration=0.02), np.diag([1.0, 1.0, 1.0, *np.zeros(6)])
    for size, alarm in ((6.0, True), (2.0, False)):
        full = wrong_solution(truth, every=1, pos_n=np.zeros(3), cov=cov)
        one = wrong_solution(truth, every=1, pos_n=size * np.eye(3)[axis], cov=2.0 * cov)
        found = protect_by_separation(full, [one], 1e-5, 1e-3)
        assert found.alarm.all() == alarm == found.alarm.any()
        bound = multipliers(1e-5) + np.sqrt(2.0) * multipliers(1e-3)
        assert_allclose(found.level, np.tile(bound, (len(found.level), 1)))
