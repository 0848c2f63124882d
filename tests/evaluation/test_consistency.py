"""Chi-square bounds are those of scipy.stats; NIS counts each measurement vector once."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.stats import chi2

from bench.core.records.data import Innovations, no_innovations
from bench.evaluation.consistency.chi_square import chi2_quantile, mean_band, mean_nis, nis_by_sensor


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
        (1.0, 1, 0, 7.0, True),  # the same time, another sensor
        (1.0, 1, 1, 7.0, True),
        (1.5, 2, 2, 0.5, True),
        (2.0, 0, 0, 6.0, True),
        (2.0, 0, 1, 6.0, True),
        (2.0, 0, 2, 6.0, True),
        (2.0, 0, 0, 8.0, True),  # a fix that came twice is two updates
        (2.0, 0, 1, 8.0, True),
        (2.0, 0, 2, 8.0, True),
        (3.0, 0, 0, 1.0, True),  # horizontal only, then another sensor's down at the same time
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
