"""Chi-square bounds are those of scipy.stats; the consistency verdict passes a matched filter and only that.

The ensemble is a real Kalman filter on a plant of nine random walks measured in
white noise, so that NEES is correlated in time and NIS is not, as in a navigation
filter. False-alarm rates of the claims: (a) 0.2 %, (c) 0.1 % per sensor. With
50 runs of 540 updates, the smallest error of a constant factor in the NIS that (c)
catches at even odds is 0.95 % for nine components; R 20 % too small makes 23 % here.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from bench.data import Innovations, no_innovations
from bench.evaluation.consistency import (
    SensorNis,
    check_consistency,
    chi2_quantile,
    mean_band,
    mean_nis,
    nis_by_sensor,
)

RUNS, EPOCHS, STATES = 50, 540, 9


def sensor_nis(nis, dof):
    nis = np.asarray(nis, float)
    return SensorNis(np.arange(len(nis)) * 1.0, nis, np.full(len(nis), dof), np.ones(len(nis), bool))


@pytest.mark.parametrize("dof", [1, 3, 9, 450, 40_000])
@pytest.mark.parametrize("probability", [0.0005, 0.025, 0.5, 0.975, 0.9995])
def test_quantiles_are_those_of_scipy_stats(dof, probability):
    assert chi2_quantile(probability, dof) == pytest.approx(chi2.ppf(probability, dof), rel=1e-10)


def test_a_band_holds_its_probability():
    low, high = mean_band(3, 40, 0.999)
    inside = chi2.cdf(40 * high, 120) - chi2.cdf(40 * low, 120)
    assert inside == pytest.approx(0.999, abs=1e-9)
    assert chi2.cdf(40 * low, 120) == pytest.approx(0.0005, rel=1e-6)


# --- NIS of a table of innovations ---------------------------------------------------------------------


def table(rows, sensors):
    t, code, component, nis, accepted = (np.array(column) for column in zip(*rows, strict=True))
    one = np.ones(len(rows))
    return Innovations(t, sensors, code, component, one, one, nis, accepted)


def test_nis_of_a_sub_vector_counts_once():
    rows = [
        (1.0, 0, 0, 5.0, True),
        (1.0, 0, 1, 5.0, False),
        (1.0, 0, 2, 5.0, True),
        (1.0, 1, 0, 7.0, True),  # the same instant, another sensor
        (1.0, 1, 1, 7.0, True),
        (1.5, 2, 2, 0.5, True),
        (2.0, 0, 0, 6.0, True),
        (2.0, 0, 1, 6.0, True),
        (2.0, 0, 2, 6.0, True),
        (2.0, 0, 0, 8.0, True),  # a fix that came twice is two updates
        (2.0, 0, 1, 8.0, True),
        (2.0, 0, 2, 8.0, True),
        (3.0, 0, 0, 1.0, True),  # horizontal only, then another sensor's down at the same instant
        (3.0, 0, 1, 1.0, True),
        (3.0, 2, 2, 2.0, True),
        (4.0, 2, 2, 3.0, True),
        (5.0, 0, 0, 1.5, True),  # one component at a time
        (6.0, 0, 1, 2.5, True),
    ]
    found = nis_by_sensor(table(rows, ("position", "velocity", "baro", "unused")))
    assert list(found) == ["position", "velocity", "baro"]
    assert_array_equal(found["position"].nis, [5.0, 6.0, 8.0, 1.0, 1.5, 2.5])
    assert_array_equal(found["position"].dof, [3, 3, 3, 2, 1, 1])
    assert_array_equal(found["position"].accepted, [False, True, True, True, True, True])
    assert_array_equal(found["velocity"].dof, [2])
    assert_array_equal(found["baro"].t, [1.5, 3.0, 4.0])
    late = nis_by_sensor(table(rows, ("position", "velocity", "baro")), 1.5)
    assert list(late) == ["position", "baro"]
    assert_array_equal(late["position"].nis, [6.0, 8.0, 1.0, 1.5, 2.5])


def test_no_innovations_have_no_sensor():
    assert nis_by_sensor(no_innovations()) == {}


def test_mean_nis_of_updates_of_different_size_has_the_band_of_their_sum():
    found = mean_nis(np.array([2.0, 4.0, 1.0]), np.array([3, 3, 1]))
    assert found.mean == pytest.approx(7 / 3)
    assert found.updates == 3
    assert_allclose([found.low, found.high], chi2.ppf([0.0005, 0.9995], 7) / 3, rtol=1e-9)
    assert found.inside


def test_mean_nis_of_nothing_is_an_error():
    with pytest.raises(ValueError, match="at least one update"):
        mean_nis(np.empty(0), np.empty(0, np.int64))


def test_a_mean_nis_that_is_nan_is_outside():
    assert not mean_nis(np.array([np.nan, 1.0]), np.array([1, 1])).inside


# --- the verdict over an ensemble ----------------------------------------------------------------------


def filtered(seed, *, assumed_R=1.0, assumed_q=1.0, runs=RUNS, epochs=EPOCHS):
    """NEES (runs, epochs) and NIS of a Kalman filter on nine random walks, after it has settled."""
    rng = np.random.default_rng(seed)
    R, q = 1.0, 0.01
    settle = 60
    x = np.zeros((runs, STATES))
    estimate = np.zeros((runs, STATES))
    P = R
    nees, nis = np.empty((2, runs, epochs))
    for k in range(-settle, epochs):
        x += np.sqrt(q) * rng.normal(size=x.shape)
        z = x + np.sqrt(R) * rng.normal(size=x.shape)
        P += q * assumed_q
        S = P + R * assumed_R
        innovation = z - estimate
        estimate += P / S * innovation
        P -= P * P / S
        if k >= 0:
            nees[:, k] = np.sum((estimate - x) ** 2, axis=1) / P
            nis[:, k] = np.sum(innovation**2, axis=1) / S
    return nees, {"gnss_position": [sensor_nis(row, STATES) for row in nis]}


def test_a_matched_filter_is_consistent():
    nees, nis = filtered(seed=1)
    result = check_consistency(nees, STATES, nis)
    assert result.verdict, result.reasons
    assert result.reasons == ()
    assert (result.states, result.runs, result.epochs) == (STATES, RUNS, EPOCHS)
    assert result.mean == pytest.approx(9.0, abs=0.6)
    assert_allclose([result.low, result.high], [7.86, 10.21], atol=0.006)
    assert result.standard_error == pytest.approx(nees.mean(axis=1).std(ddof=1) / np.sqrt(RUNS))
    independent = np.sqrt(2 * STATES / (RUNS * EPOCHS))
    assert result.standard_error > 2 * independent  # pooled epochs would claim far more than they know


def test_a_measurement_variance_20_percent_too_small_breaks_every_claim():
    nees, nis = filtered(seed=1, assumed_R=0.8)
    result = check_consistency(nees, STATES, nis)
    assert not result.verdict
    claims = ("standard errors", "allowed 0.6", "of the epochs", "mean NIS of gnss_position")
    assert len(result.reasons) == len(claims)
    for claim, reason in zip(claims, result.reasons, strict=True):
        assert claim in reason
    assert result.nis["gnss_position"].mean > 1.1 * STATES


def test_a_filter_that_believes_too_little_of_itself_fails_too():
    nees, nis = filtered(seed=1, assumed_R=1.3)
    result = check_consistency(nees, STATES, nis)
    assert not result.verdict
    assert result.mean < STATES
    assert result.nis["gnss_position"].mean < result.nis["gnss_position"].low


def test_process_noise_too_small_is_seen():
    nees, nis = filtered(seed=1, assumed_q=0.5)
    assert not check_consistency(nees, STATES, nis).verdict


def ensemble(averages, spread_in_time=0.0):
    """NEES with given run averages; every run swings by the same amount, so that (b) can be set apart."""
    swing = spread_in_time * np.where(np.arange(100) % 2, 1.0, -1.0)
    return np.asarray(averages)[:, None] + swing


def test_the_mean_fails_by_its_standard_errors_alone():
    averages = 9.3 + 0.1 * np.where(np.arange(50) % 2, 1.0, -1.0)  # standard error 0.0143
    result = check_consistency(ensemble(averages), 9, {})
    assert not result.verdict
    assert len(result.reasons) == 1
    assert result.reasons[0].startswith("mean NEES 9.300 is 21.0 standard errors")
    assert check_consistency(ensemble(averages - 0.27), 9, {}).verdict  # 2.1 standard errors


def test_the_mean_fails_by_its_distance_alone():
    averages = 9.7 + 3.0 * np.where(np.arange(50) % 2, 1.0, -1.0)  # standard error 0.43
    result = check_consistency(ensemble(averages), 9, {})
    assert result.reasons == ("mean NEES 9.700 is 0.700 from 9; allowed 0.6",)
    assert check_consistency(ensemble(averages - 0.2), 9, {}).verdict


def test_the_share_of_epochs_fails_alone():
    """Half of the epochs are too high and half too low: the averages over time are perfect."""
    averages = 9.0 + 0.1 * np.where(np.arange(50) % 2, 1.0, -1.0)
    result = check_consistency(ensemble(averages, spread_in_time=2.0), 9, {})
    assert result.inside == 0.0
    assert len(result.reasons) == 1
    assert result.reasons[0].startswith("0.0% of the epochs have their NEES over 50 runs in 7.86 to 10.21")
    assert check_consistency(ensemble(averages, spread_in_time=1.0), 9, {}).verdict


def test_one_bad_sensor_among_good_ones_is_named():
    rng = np.random.default_rng(4)
    averages = 9.0 + 0.1 * np.where(np.arange(50) % 2, 1.0, -1.0)
    good = [sensor_nis(rng.chisquare(3, 500), 3) for _ in range(50)]
    bad = [sensor_nis(1.25 * rng.chisquare(1, 500), 1) for _ in range(50)]
    result = check_consistency(ensemble(averages), 9, {"gnss_position": good, "baro": bad})
    assert len(result.reasons) == 1
    assert result.reasons[0].startswith("mean NIS of baro is 1.2")
    assert result.nis["gnss_position"].inside
    assert result.nis["gnss_position"].updates == 25_000


def test_nees_that_is_nan_is_not_consistent():
    nees, nis = filtered(seed=1, epochs=20)
    nees[3, 4] = np.nan
    assert not check_consistency(nees, STATES, nis).verdict


@pytest.mark.parametrize("shape", [(1, 10), (5, 0)])
def test_too_few_runs_or_epochs_are_an_error(shape):
    with pytest.raises(ValueError, match="at least 2 runs and 1 epoch"):
        check_consistency(np.ones(shape), 9, {})
