"""Truths from JSBSim that several test files look at; each is flown once."""

import pytest

from bench.data import Trajectory
from bench.flight import fly
from tests.plans import FIGURE_EIGHT, short_plan


@pytest.fixture(scope="session")
def short_truth() -> Trajectory:
    """A minute at 100 Hz in a west wind of 5 m/s: straight, a 120 deg right turn, a climb, straight."""
    return fly(short_plan())


@pytest.fixture(scope="session")
def figure_eight_truth() -> Trajectory:
    """The shipped flight figure-eight, 600 s at 200 Hz."""
    return fly(FIGURE_EIGHT)
