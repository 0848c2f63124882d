"""What several test files look at: truths from JSBSim, each flown once, and the random streams drawn."""

import signal
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pytest

from bench import pipeline, sensors
from bench.config import load_profile
from bench.data import Sensed, Trajectory
from bench.flight import fly
from bench.specs import stream
from tests.flight.plans import short_plan
from tests.weaving import weaving

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # a shell's background: children would be deaf to it
    signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def short_truth() -> Trajectory:
    """A minute at 100 Hz in a west wind of 5 m/s: straight, a 120 deg right turn, a climb, straight."""
    return fly(short_plan())


@pytest.fixture(scope="session")
def figure_eight_truth() -> Trajectory:
    """The shipped flight figure-eight, 600 s at 200 Hz, from the cache of truths."""
    return pipeline.fly(load_profile("figure-eight"))


@pytest.fixture(scope="module")
def truth(request: pytest.FixtureRequest) -> Trajectory:
    """The flight of tests.weaving; ``FLIGHT`` of the test file says how many seconds, and at which rate."""
    return weaving(*request.module.FLIGHT)


@pytest.fixture(scope="module")
def sensed(request: pytest.FixtureRequest, truth: Trajectory) -> Sensed:
    """What the sensors ``UNITS`` of the test file say of that flight, seed 1, run 0."""
    return sensors.sense(truth, request.module.UNITS, 1, 0)


@pytest.fixture
def streams_drawn(monkeypatch: pytest.MonkeyPatch) -> Callable[..., list[str]]:
    """Watch modules of sensors: the list it gives holds the name of every random stream they ask for."""

    def watch(*modules: ModuleType) -> list[str]:
        names: list[str] = []

        def recorded(seed: int, run: int, name: str) -> np.random.Generator:
            names.append(name)
            return stream(seed, run, name)

        for module in modules:
            monkeypatch.setattr(module, "stream", recorded)
        return names

    return watch
