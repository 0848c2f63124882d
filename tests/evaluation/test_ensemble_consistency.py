"""The rule for many runs passes a matched filter whose errors last the whole run, and finds a wrong P.

The ensembles are drawn from the model itself: nine whitened errors, five of them with a time constant
as long as the run, two of a minute, two of seconds. False-alarm rate by construction: 0.5 % (a), 0.5 % (b).
"""

import numpy as np
import pytest
from scipy.stats import binom, chi2, t

from bench.evaluation.consistency.chi_square import SensorNis
from bench.evaluation.ensembles.ensemble_consistency import INSTANTS, check_consistency
from tests.evaluation.power import EPOCHS, STATES, draw_nees

RUNS = 40


def nees_of_ensembles(seed, ensembles, runs):
    """NEES (ensembles, runs, EPOCHS) of a matched filter with run-long errors."""
    return draw_nees(np.random.default_rng(seed), ensembles, runs)


def count_rejected(ensembles):
    return sum(check_consistency(nees, STATES, {}).rejected for nees in ensembles)


def test_false_alarms_are_below_2_percent_with_errors_that_last_the_run():
    """4000 matched ensembles of 40 runs; the count of false alarms stays below the 99.9 % bound of 2 %.

    A rule that rejects 3 % of them fails this test with a probability of 96 %.
    """
    count = 4000
    rejected = count_rejected(nees_of_ensembles(1, count, RUNS))
    assert rejected <= binom.ppf(0.999, count, 0.02)


def test_a_covariance_25_percent_too_small_is_found():
    """P 0.75 of what is right makes NEES 4/3: 40 runs find it in at least 90 %, by the same count."""
    count = 1000
    found = count_rejected(nees_of_ensembles(2, count, RUNS) / 0.75)
    assert found >= binom.ppf(0.001, count, 0.9)


@pytest.mark.parametrize(("factor", "word"), [(1.6, "overconfident"), (0.62, "underconfident")])
def test_the_words_of_a_wrong_covariance(factor, word):
    nees = factor * nees_of_ensembles(3, 1, 80)[0]
    result = check_consistency(nees, STATES, {})
    assert result.rejected
    assert result.word == word


def test_a_matched_filter_is_consistent_with_its_interval_and_bands():
    nees = nees_of_ensembles(4, 1, 200)[0]
    result = check_consistency(nees, STATES, {})
    assert (result.word, result.reasons, result.runs_to_decide) == ("consistent", (), None)
    averages = nees.mean(axis=1) / STATES
    mean, c = averages.mean(), averages.var(ddof=1) / (9 * 200 * averages.mean() ** 2)
    for end, p in ((result.low, 0.99), (result.high, 0.01)):  # the mean of which ours is that quantile
        assert np.cbrt(mean / end) == pytest.approx(1 - c + t.ppf(p, 199) * np.sqrt(c))
    tail = 0.005 / INSTANTS / 2
    assert result.band == pytest.approx(chi2.ppf([tail, 1 - tail], STATES * 200) / 200)
    assert result.instants.tolist() == [0, 2, 4, 6, 8, 10]


def test_a_small_error_of_p_is_rejected_and_yet_called_consistent():
    """P 10 % too small: 1000 runs prove it, and it does not matter."""
    result = check_consistency(1.1 * nees_of_ensembles(5, 1, 1000)[0], STATES, {})
    assert result.rejected
    assert result.word == "consistent"


def test_undecided_says_how_many_runs_would_decide():
    averages = STATES * (1.2 + 0.25 * np.where(np.arange(40) % 2, 1.0, -1.0))
    result = check_consistency(np.tile(averages[:, None], (1, 3)), STATES, {})
    assert result.word == "undecided"
    half = 0.5 * (result.high - result.low)
    assert half == pytest.approx(t.ppf(0.99, 39) * 0.25 / np.sqrt(39), rel=0.02)
    needed = int(np.ceil(40 * (half / 0.05) ** 2))
    assert f"about {needed} runs would decide" in result.sentence
    more = STATES * (1.2 + 0.25 * np.where(np.arange(needed + 2) % 2, 1.0, -1.0))
    assert check_consistency(np.tile(more[:, None], (1, 3)), STATES, {}).word == "consistent"


def test_errors_of_p_that_cancel_over_the_run_are_found_at_the_instants():
    """Half of the epochs too high and half too low: every run average is perfect."""
    swing = np.where(np.arange(EPOCHS) % 2, 3.0, -3.0)
    averages = 9.0 + 0.1 * np.where(np.arange(50) % 2, 1.0, -1.0)
    result = check_consistency(averages[:, None] + swing - swing.mean(), STATES, {})
    (reason,) = result.reasons
    assert reason.startswith("NEES over 50 runs is outside 7.13 to 11.14 at 6 of 6 epochs: 6.27")


def test_one_bad_sensor_among_good_ones_is_named():
    rng = np.random.default_rng(6)

    def series(factor, dof):
        nis = factor * rng.chisquare(dof, (50, 500))
        return [SensorNis(np.arange(500.0), row, np.full(500, dof), np.ones(500, bool)) for row in nis]

    nis = {"gnss_position": series(1.0, 3), "baro": series(1.25, 1)}
    result = check_consistency(nees_of_ensembles(7, 1, 50)[0], STATES, nis)
    (reason,) = result.reasons
    assert reason.startswith("mean NIS of baro is 1.2")
    assert result.nis["gnss_position"].updates == 25_000


def test_nees_that_is_not_finite_is_overconfident():
    nees = nees_of_ensembles(8, 1, 50)[0].copy()
    nees[3, 4] = np.nan
    result = check_consistency(nees, STATES, {})
    assert result.rejected
    assert result.word == "overconfident"


@pytest.mark.parametrize("shape", [(7, 10), (8, 0)])
def test_too_few_runs_or_epochs_are_an_error(shape):
    with pytest.raises(ValueError, match="at least 8 runs and 1 epoch"):
        check_consistency(np.ones(shape), STATES, {})
