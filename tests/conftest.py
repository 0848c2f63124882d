"""Truths from JSBSim that several test files look at; each is flown once."""

from math import radians

import pytest

from bench.data import Trajectory
from bench.flight import fly
from bench.specs import Climb, Straight, Turn
from tests.plans import FIGURE_EIGHT, plan


@pytest.fixture(scope="session")
def short_truth() -> Trajectory:
    """A minute at 100 Hz in a west wind of 5 m/s: straight, a 120 deg right turn, a climb, straight."""
    legs = (Straight(10.0), Turn(radians(120.0), radians(30.0)), Climb(1220.0, 2.0), Straight(5.0))
    return fly(plan(*legs, wind_from=radians(270.0), wind_speed=5.0, duration=60.0))


@pytest.fixture(scope="session")
def figure_eight_truth() -> Trajectory:
    """The shipped flight figure-eight, 600 s at 200 Hz."""
    return fly(FIGURE_EIGHT)
