"""Bursts of wrong fixes reset no filter, and where it follows them it keeps its attitude.

`python -m tests.motions.bursts` prints the table of all lengths, rates, outages and shapes.
"""

from __future__ import annotations

import numpy as np
import pytest

from tests.builders import band
from tests.motions import bursts

SEED = 2611
UNITS = ("adis16495", "stim300", "hg4930-ca51", "vn-100")


@pytest.mark.parametrize(
    ("cell", "runs"),
    [
        ((24.0, 1.0, 0.0, "step"), 5),
        ((24.0, 10.0, 0.0, "step"), 5),
        ((24.0, 10.0, 0.0, "ramp"), 5),
        ((24.0, 10.0, 0.0, "jump"), 5),
        ((3.0, 1.0, 211.0, "step"), 3),
    ],
    ids=str,
)
def test_a_burst_neither_resets_a_filter_nor_makes_it_inconsistent(cell, runs):
    """Errors may last the 40 s that are evaluated, so each run counts as one sample.

    After ten seconds a filter follows a burst; so it may be off by more than it reports until the end of it.
    """
    found = bursts.run_cell(runs, SEED, cell, "loose-full", UNITS)
    assert not [one for one in found if one.resets]
    assert np.mean([one.nees for one in found]) < 9.0 * band(9 * runs)[1]
    if cell[0] < 10.0:  # one that follows is off by all of the distance, of at least 50 m
        assert not [one for one in found if one.lost]


@pytest.mark.long
@pytest.mark.parametrize("cell", bursts.list_cells(["step"]), ids=str)
def test_no_burst_of_any_length_rate_and_outage_resets_a_filter_by_rejections(cell):
    """A gyro of a consumer unit may lose the heading of a vehicle that pans; that is a reset of its own."""
    found = bursts.run_cell(40, SEED, cell, "loose-full")
    assert not [text for one in found for text in one.resets if "fixes rejected" in text]
