"""A confined filter opens its own files and no others; honest filters run as without."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from bench import pipeline
from bench.core.records.specs import EstimatorChoice, Guard
from bench.simulation import sensors
from tests.synthetic import turning

OWN = """
import os, subprocess, sys, tempfile
from pathlib import Path
import numpy as np
import helper
from bench.navigation.built_in import load

TABLE = Path(__file__).with_name("table.npy")

class Reads:
    def __init__(self, *, path=""):
        self.path = path
    def run(self, data, initial):
        import late_helper
        if self.path:
            Path(self.path).read_bytes()
        return late_helper.scale(load("loose-15", {}).run(data, initial), helper.ONE * np.load(TABLE)[0])

class Lists(Reads):
    def run(self, data, initial):
        os.listdir(self.path)

class Writes(Reads):
    def run(self, data, initial):
        Path(self.path).write_text("seen")

class Keeps(Reads):
    def run(self, data, initial):
        assert os.listdir(".") == [".kernels"], os.listdir(".")
        Path(tempfile.gettempdir(), "seen").write_text("seen")
        assert subprocess.run(["/bin/sh", "-c", "cat seen; echo"], capture_output=True).stdout == b"seen\\n"
        np.random.default_rng().normal()
        os.remove("seen")
        return super().run(data, initial)
"""


@pytest.fixture
def place(tmp_path, monkeypatch) -> Iterator[Path]:
    """A folder to stand in, with a filter, its helpers and its table, and results of others."""
    (tmp_path / "mine.py").write_text(OWN)
    (tmp_path / "helper.py").write_text("ONE = 1.0\n")
    (tmp_path / "late_helper.py").write_text(
        "def scale(found, one):\n    return found if one == 1.0 else None\n"
    )
    np.save(tmp_path / "table.npy", np.ones(1))
    for name in ("runs", "cards"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "kept.txt").write_text("the truth")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    yield tmp_path


@pytest.fixture(scope="module")
def sensed():
    return sensors.sense(turning(), turning_units(), 1, 0)


def build(name: str, **options):
    guard = Guard(timeout=120.0, confined=True)
    return pipeline.build_estimator(EstimatorChoice(f"mine:{name}", name, options, guard=guard))
