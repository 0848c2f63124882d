"""The study of the mechanizations on a short flight: its tables, and the law of accelerometers alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.navigation.register.mechanizations.accelerometers import drift_by_angular_acceleration
from bench.studies.mechanization_costs import (
    acceleration_error,
    gravity_error,
    radii_error,
    simulate_accelerometers,
)


@pytest.fixture(scope="module")
def found():
    return bench.study("mechanizations", duration_s=12, coning_rates_hz=(100,), bases_m=(0.5, 1.0))


def test_every_algorithm_has_a_row(found):
    attitudes = found.tables["attitudes"].columns
    assert attitudes["samples"] == [1, 1, 1, 1, 1, 2, 3, 4]
    assert_allclose(attitudes["coning_100_hz_deg_h"][:4], 9.60, rtol=0.01)
    assert attitudes["coning_100_hz_deg_h"][5] == pytest.approx(2.72, rel=0.01)
    assert max(attitudes["level_turns_arcsec"]) < 0.2
    assert min(attitudes["step_us"]) > 0
    frames = found.tables["frames"].columns
    assert len(frames["frame"]) == 1 + 5 * 2 * 3
    lead = np.array(frames["lead"])
    slow = np.array([rates == "100/50/10" for rates in frames["rates_hz"]])
    position = np.array(frames["position_m"])
    assert position[lead & slow].sum() < 0.2 * position[~lead & slow].sum()


def test_series_are_as_good_as_the_register_says():
    assert radii_error("long") < 0.35
    assert 40 < radii_error("short", 0.0) < 46
    assert max(gravity_error("fine"), gravity_error("medium")) < 0.33
    assert 15 < gravity_error("simple") < 21


def test_12_the_strapdown_follows_the_law_of_accelerometers_alone(found):
    """g e t^4 / 24 at first and R e t^2 / 2 with Schuler's term later: within 1 % to half an hour."""
    t = np.array([60.0, 600.0, 1800.0])
    assert_allclose(simulate_accelerometers(t), drift_by_angular_acceleration(t, 1e-11), rtol=0.01)
    assert acceleration_error(0.5, 1e-4) == pytest.approx(2e-4, rel=1e-9)  # bias over base
    lost = found.tables["accelerometers"].columns["level_lost_s"]
    assert lost[1] / lost[0] == pytest.approx(np.sqrt(2.0))
