"""The run that exports, streams and scores start from."""

from pathlib import Path

import pytest

from bench.core.records.data import Trajectory
from bench.core.records.run_records import Sensed
from tests.exchange.exported import make_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Trajectory, Sensed]:
    """A results folder of 20 s in a circle, its truth and its sensors."""
    folder = tmp_path_factory.mktemp("runs") / "circle"
    return folder, *make_run(folder)
