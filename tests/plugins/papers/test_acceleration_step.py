"""Register #31: a filter through an acceleration step of 2 g, and receivers that are late or behind in it."""

from __future__ import annotations

import numpy as np
import pytest

from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.plugins.papers.register_flights import fly_step, measure_step


def test_31_nis_stays_in_its_band_through_a_step_of_2_g():
    """Fixes at 10 Hz from the rise of the force on; loops of 15 Hz are 2 cm behind, which nobody sees."""
    truth, begin = fly_step()
    force = np.linalg.norm(truth.dvel_b, axis=1) / np.diff(truth.t) / STANDARD_GRAVITY
    assert force.max() > 2.0
    assert truth.t[np.argmax(force > 2.0)] - begin < 2.0
    for values in ({}, {"sensors.gnss.tracking_bandwidth_hz": 15.0}):
        for name, one in measure_step(**values).items():
            assert one.inside, name


@pytest.mark.parametrize("values", [{"latency_s": 0.2}, {"tracking_bandwidth_hz": 1.0}], ids=str)
def test_31_nis_leaves_its_band_where_fixes_are_late_or_their_loops_slow(values):
    found = measure_step(**{f"sensors.gnss.{key}": value for key, value in values.items()})
    for name in ("gnss_position", "gnss_velocity"):
        assert found[name].mean > found[name].high, name
