"""What several test files look at: truths from JSBSim, each flown once, and the random streams drawn."""

import fcntl
import gc
import hashlib
import os
import pickle
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bench import pipeline
from bench.core.files.places import cache_folder
from bench.core.mathematics.random_streams import stream
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import Sensed
from bench.io.config import read_profile
from bench.simulation import sensors
from bench.simulation.flight import fly
from bench.simulation.flight.truth import Stretch
from bench.simulation.sensors import draws
from tests.builders import first_rows
from tests.flight.plans import record_whole, short_plan
from tests.weaving import weaving

# what is ignored here children ignore, too; a handler they do not inherit
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:  # in a shell's background
    signal.signal(signal.SIGINT, signal.default_int_handler)
if signal.getsignal(signal.SIGHUP) == signal.SIG_IGN:  # under nohup
    signal.signal(signal.SIGHUP, lambda *_: None)
for _name in ("CLICOLOR_FORCE", "COLUMNS", "FORCE_COLOR", "LINES", "NO_COLOR"):  # they change what is printed
    os.environ.pop(_name, None)
# one place of compiled kernels, whatever BENCH_CACHE a test sets; numba reads it when it is imported
os.environ.setdefault("NUMBA_CACHE_DIR", str(cache_folder("kernels")))

SLOWEST = (
    "test_a_heading_that_is_hardly_known_is_found",
    "test_the_option_cuts_what_is_counted",
    "test_the_smoother_knows_its_errors",
    "test_the_matched_filter_knows_its_errors",
)
"""Tests that begin first, so that no worker is left alone with one of them at the end."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the slowest tests first."""
    items.sort(key=lambda item: item.name not in SLOWEST)


def pytest_collection_finish() -> None:
    """Leave what all tests share out of the collection of garbage, which would go over it again and again."""
    gc.collect()
    gc.freeze()


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip the tests of a filter of gtsam where that is not installed."""
    chosen = getattr(getattr(item, "callspec", None), "params", {}).values()
    if "graph-smoother" in [one for one in chosen if isinstance(one, str)]:
        pytest.importorskip("gtsam", reason="the extra 'graph' is not installed")


@pytest.fixture(scope="session", autouse=True)
def no_waiting_for_the_disk() -> Iterator[None]:
    """Leave out `os.fsync`, which waits for the disk: no test ends with the machine."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def one_processor() -> Iterator[None]:
    """See one processor: pytest has a worker on each. What needs processes of its own says how many."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "sched_getaffinity", lambda _: {0}, raising=False)
        yield


@pytest.fixture(scope="session")
def session_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder that all workers of this session share."""
    own = tmp_path_factory.getbasetemp()
    folder = (own.parent if "PYTEST_XDIST_WORKER" in os.environ else own) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session")
def made_once(session_folder: Path) -> Callable[[str, Callable[[], Any]], Any]:
    """Return a function that makes an object once in a session, whichever worker asks first for its name."""

    def get(name: str, make: Callable[[], Any]) -> Any:
        kept = session_folder / f"{name}.pickle"
        with (session_folder / f"{name}.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)  # released when the file is closed, or its process ends
            if not kept.exists():
                kept.with_suffix(".part").write_bytes(pickle.dumps(make()))
                kept.with_suffix(".part").replace(kept)
        return pickle.loads(kept.read_bytes())

    return get


@pytest.fixture(scope="session")
def recorded(made_once: Callable[[str, Callable[[], Any]], Any]) -> Callable[[FlightSpec], Stretch]:
    """Return a function that records a flight as one segment, each flight once in a session."""
    return lambda spec: made_once(
        hashlib.sha256(repr(spec).encode()).hexdigest()[:16], lambda: record_whole(spec)
    )


@pytest.fixture(scope="session")
def short_truth() -> Trajectory:
    """A minute at 100 Hz in a west wind of 5 m/s: straight, a 120 deg right turn, a climb, straight."""
    return fly(short_plan())


@pytest.fixture(scope="session")
def figure_eight_truth() -> Trajectory:
    """The shipped flight figure-eight, 600 s at 200 Hz, from the cache of truths."""
    return pipeline.fly(read_profile("figure-eight"))


@pytest.fixture(scope="session")
def five_minutes(figure_eight_truth: Trajectory) -> Trajectory:
    """The first 300 s of figure-eight, before its outage."""
    return first_rows(figure_eight_truth, 60_001)


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
    """Watch the sensors: the list it gives holds the name of every random stream they ask for."""

    def watch() -> list[str]:
        names: list[str] = []

        def recorded(seed: int, run: int, name: str) -> np.random.Generator:
            names.append(name)
            return stream(seed, run, name)

        monkeypatch.setattr(draws, "stream", recorded)
        return names

    return watch
