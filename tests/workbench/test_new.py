"""`bench new` writes what works at once, and nothing over anything; the guide's filterpy filter runs too."""

from __future__ import annotations

import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.linalg import block_diag

import bench
from bench.cli.command_line import main
from bench.cli.new_files.new_example import new_check
from bench.cli.new_files.starting_point import StartingPoint
from bench.core.files import durable
from bench.core.mathematics.earth import difference_n, displace
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.metrics import run_metrics
from bench.navigation.built_in import load
from bench.navigation.models.loose_tight import Loose
from tests.cli.test_cli import cache, here, left, say  # noqa: F401 (fixtures)
from tests.weaving import units

ROOT = Path(__file__).parents[2]
FLIGHT, UNITS = (120.0, 100.0), units(baro=None)


# --- the starting point ------------------------------------------------------------------------------


def test_it_is_the_loose_filter_but_for_its_longer_steps(sensed):
    """Against the compiled filter without barometer: a hundredth of sigma, two minutes of weaving."""
    mine = StartingPoint().run(sensed.data, sensed.initial)
    theirs = Loose(baro=False).run(sensed.data, sensed.initial)
    sd = np.sqrt(np.einsum("kii->ki", theirs.cov))
    assert_allclose(np.sqrt(np.einsum("kii->ki", mine.cov)), sd, rtol=0.01)
    off = bench.core.mathematics.earth.difference_n(mine.lla, theirs.lla)
    assert np.abs(off / sd[:, :3]).max() < 0.02
    assert np.abs((mine.vel_n - theirs.vel_n) / sd[:, 3:6]).max() < 0.02
    assert np.abs((mine.extra - theirs.extra[:, :6]) / theirs.extra_sd[:, :6]).max() < 0.05
    assert mine.extra_names == theirs.extra_names[:6]
    blind = StartingPoint().run(
        type(sensed.data)(**{**columns(sensed.data), "antenna_b": np.zeros(3)}), sensed.initial
    )
    assert np.abs(bench.core.mathematics.earth.difference_n(blind.lla, theirs.lla) / sd[:, :3]).max() > 0.1


def columns(record):
    return {name: getattr(record, name) for name in record.__slots__}


def test_its_gate_refuses(sensed):
    assert StartingPoint().run(sensed.data, sensed.initial).innovations.accepted.all()
    assert not StartingPoint(gate=0.5).run(sensed.data, sensed.initial).innovations.accepted.all()
    with pytest.raises(ValueError, match=r"gate = 0 must be positive"):
        StartingPoint(gate=0)


# --- bench new ---------------------------------------------------------------------------------------


def test_what_it_writes_runs_and_its_test_can_be_collected(here, capsys):  # noqa: F811
    status, out, _ = say(capsys, "new", "estimator", "mine_too")
    assert status == 0
    assert left(here) == ["mine_too.py", "test_mine_too.py"]
    assert "Next: bench run figure-eight -e mine_too:MineToo" in out
    status, out, _ = say(capsys, "run", "short.toml", "-e", "mine_too:MineToo", "-o", "found", "--no-rrd")
    assert status == 0
    assert "MineToo" in out
    text = (here / "test_mine_too.py").read_text()
    (here / "test_mine_too.py").write_text(text.replace('"figure-eight"', '"short.toml"'))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_mine_too.py"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment())
    assert "1 passed" in done.stdout, done.stdout + done.stderr


def environment():
    import os

    return {**os.environ, "PYTHONPATH": f"{ROOT}{os.pathsep}{os.environ.get('PYTHONPATH', '')}"}


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Mine", "'Mine' cannot name a module: use lower-case letters"),
        ("my-filter", "'my-filter' cannot name a module"),
        ("../mine", "'../mine' cannot name a module"),
        ("", "'' cannot name a module"),
        ("class", "'class' cannot name a module"),
        ("none", "'none' cannot name a module"),
        ("m" * 65, "cannot name a module"),
        ("numpy", "'numpy': the name is used already; choose another one"),
        ("random", "'random': the name is used already"),
        ("events", "'events': the name is used already"),
        ("taken", "taken.py: exists already and is not replaced; choose another name"),
        ("half", "test_half.py: exists already"),
        ("package", "package: exists already"),
        ("link", "link.py: exists already"),
    ],
)
def test_bad_names_and_files_that_exist_are_refused_in_one_line(here, capsys, name, message):  # noqa: F811
    (here / "taken.py").write_text("mine\n")
    (here / "test_half.py").write_text("mine\n")
    (here / "package").mkdir()
    (here / "link.py").symlink_to(here / "nowhere")
    before = left(here)
    status, _, err = say(capsys, "new", "estimator", name)
    assert status == 2
    assert message in err
    assert err.count("\n") == 1
    assert left(here) == before
    assert (here / "taken.py").read_text() == "mine\n"


def test_a_disk_that_is_full_leaves_nothing(here, capsys, monkeypatch):  # noqa: F811
    def full(action, path):
        if path.name == "test_unlucky.py":
            raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(durable, "before", full)
    status, _, err = say(capsys, "new", "estimator", "unlucky")
    assert status == 4
    assert "No space left" in err
    assert left(here) == []


# --- the guide's class -------------------------------------------------------------------------------


def test_the_filterpy_filter_of_the_guide_keeps_the_contract(truth, sensed, tmp_path, monkeypatch):
    """As printed; and it finds its way: position to a receiver's noise, velocity in a turn less well."""
    page = (ROOT / "bench" / "guide" / "own-filter.md").read_text()
    blocks = re.findall(r"```python [^\n]+\n(.*?)```", page, re.DOTALL)
    (text,) = [block for block in blocks if "filterpy" in block]
    (tmp_path / "guide_filter.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    estimator = load("guide_filter:FixFilter", {})
    bench.check_estimator(estimator, sensed.data, sensed.initial)
    solution = estimator.run(sensed.data, sensed.initial)
    _, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(20.0), outages=())
    assert judged["converged"], judged["reason"]
    assert judged["pos_rmse_3d_m"] < 6.0
    assert not [name for name in judged if "heading" in name]
    rough = load("guide_filter:FixFilter", {"acceleration": 30.0}).run(sensed.data, sensed.initial)
    assert rough.cov[-1, 0, 0] > solution.cov[-1, 0, 0]


def test_each_fix_comes_once_at_the_first_answer_after_its_arrival(sensed):
    """Of fixes that are late, one flagged, one without velocity and two that do not say how good they are."""
    fixes = sensed.data.fixes
    valid, vel_n = fixes.valid.copy(), fixes.vel_n.copy()
    cov_pos_n, cov_vel_n = fixes.cov_pos_n.copy(), fixes.cov_vel_n.copy()
    valid[3], vel_n[5, 1], cov_pos_n[7, 2, 2], cov_vel_n[9, 0, 0] = False, np.nan, np.nan, np.nan
    arrival = fixes.t + 0.43
    late = replace(
        fixes, t_arrival=arrival, valid=valid, vel_n=vel_n, cov_pos_n=cov_pos_n, cov_vel_n=cov_vel_n
    )
    data = replace(sensed.data, fixes=late)
    now, rows = sensed.initial.t, []
    for dt, new in bench.fix_steps(data, sensed.initial):
        now += dt
        for z, R in new:
            (row,) = np.flatnonzero((vel_n == z[3:, 0]).all(axis=1))
            assert 0 <= now - late.t_arrival[row] < np.diff(data.output_t).max() + 1e-6
            np.testing.assert_array_equal(R, block_diag(cov_pos_n[row], cov_vel_n[row]))
            place = displace(sensed.initial.lla, z[:3, 0])
            assert np.abs(difference_n(place, fixes.lla[row])).max() < 1e-6
            rows.append(int(row))
    arrived = np.flatnonzero(late.t_arrival <= data.output_t[-1])
    assert rows == [row for row in arrived if row not in (3, 5, 7, 9)]


# --- bench new check -----------------------------------------------------------------------------------


def test_new_check_leaves_a_repository_whose_check_passes(here, capsys, monkeypatch):  # noqa: F811
    monkeypatch.setattr(new_check, "__kwdefaults__", {"draws": 20})
    status, out, _ = say(capsys, "new", "check", "loose-15")
    assert status == 0
    assert out.endswith("Next: bench check\n")
    assert left(here) == [".github", "tests"]
    assert sorted(path.name for path in Path("tests/baselines").iterdir()) == [
        "CHANGES.md",
        "short.json",
        "short.toml",
    ]
    (job,) = re.findall(r"run: (bench check .*)", Path(".github/workflows/accuracy.yml").read_text())
    status, out, _ = say(capsys, *job.split()[1:], "--jobs", "1")
    assert (status, Path("accuracy.xml").is_file()) == (0, True)
    assert re.fullmatch(r"short, loose-15: \d+ same \(20 runs\)\n", out)
    status, _, err = say(capsys, "new", "check")
    assert status == 2
    assert err.startswith(
        "error: tests/baselines/short.toml: exists already and is not replaced; 'bench check"
    )


def test_new_check_of_an_unknown_estimator_leaves_no_file(here, capsys):  # noqa: F811
    assert say(capsys, "new", "check", "loose-99")[0] == 2
    assert [path for path in here.rglob("*") if path.is_file()] == [here / "short.toml"]
    assert say(capsys, "new", "estimator")[0] == 2


def test_schemas_are_written_again_over_schemas_and_over_nothing_else(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["new", "schemas"]) == 0
    assert "#:schema ./schemas/profile.json" in " ".join(capsys.readouterr().out.split())
    names = {path.stem for path in Path("schemas").glob("*.json")}
    assert {"profile", "log", "campaign", "aircraft", "imu", "gnss", "baro"} <= names
    first = Path("schemas/imu.json").read_text()
    assert main(["new", "schemas"]) == 0
    assert Path("schemas/imu.json").read_text() == first
    Path("schemas/log.json").write_text("{}")
    assert main(["new", "schemas"]) == 2
    assert "schemas/log.json: exists and is not a schema" in capsys.readouterr().err
    assert Path("schemas/log.json").read_text() == "{}"
