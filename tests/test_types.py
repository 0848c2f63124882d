"""A checker of types sees the public functions as they are: a user's mistakes of name, argument and type."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import bench

ROOT = Path(bench.__file__).parents[1]

SOUND = """
from pathlib import Path

import numpy as np

import bench


class Hold:
    def run(self, sensors: bench.SensorData, initial: bench.InitialState) -> bench.NavSolution:
        return bench.run_filter("free-inertial", sensors, initial)


profile: bench.Profile = bench.read_profile(Path("mine.toml"), {"sensors.imu": "stim300"}, seed=7)
truth: bench.Trajectory = bench.fly("figure-eight", overrides={"duration_s": 60.0})
sensed = bench.sense(profile, truth, run=3)
estimator: bench.Estimator = Hold()
solution = estimator.run(sensed.data, sensed.initial)
errors, metrics = bench.evaluate(profile, truth, solution, sensed)
north: np.floating = errors.pos_n[:, 0].max()
result: bench.RunResult = bench.run("figure-eight", estimators=["loose-15"], sensors={"imu": "stim300"})
print(result.metrics["loose-15"]["pos_rmse_h_m"], metrics["nees_mean"], truth.lla.shape)
try:
    bench.run("nowhere")
except bench.ConfigError as error:
    print(error.messages)
"""

MISTAKES = """
import bench

bench.rnu("figure-eight")
bench.run(42)
bench.run("figure-eight", nonsense=1)
bench.run("figure-eight", seed="7")
bench.run("figure-eight", 7)
bench.fly()
bench.read_profile("figure-eight").titel
bench.run("figure-eight").metric
bench.run_filter("loose-15", bench.fly("figure-eight"), None)
bench.sense("figure-eight", bench.read_profile("figure-eight"))
bench.campaign("figure-eight", runs="many")
number: int = bench.fly("figure-eight")
"""


def check_types(folder: Path, text: str) -> list[int]:
    """Return the lines in which mypy in strict mode finds an error."""
    script = folder / "script.py"
    script.write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", "--hide-error-context"]
    command += ["--config-file", "pyproject.toml", "--cache-dir", str(ROOT / ".mypy_cache"), str(script)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode in (0, 1), done.stdout + done.stderr
    found = [line for line in done.stdout.splitlines() if ": error: " in line]
    assert all(line.startswith(str(script)) for line in found), done.stdout
    return sorted({int(line.split(":")[1]) for line in found})


@pytest.mark.slow
def test_a_sound_script_is_free_of_errors_and_each_mistake_is_found(tmp_path):
    assert check_types(tmp_path, SOUND) == []
    wrong = [number for number, line in enumerate(MISTAKES.splitlines(), 1) if line and number > 2]
    assert check_types(tmp_path, MISTAKES) == wrong


def test_what_a_checker_sees_is_what_there_is():
    tree = ast.parse(Path(bench.__file__).read_text(encoding="utf-8"))
    branches = [
        node for node in tree.body if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)
    ]
    seen = {
        alias.name: node.module
        for node in branches[0].body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    assert seen == bench._PUBLIC | {name: getattr(bench, name).__module__ for name in bench._OF_PLUGINS}
    for name in seen:
        assert getattr(bench, name) is not None
