"""What a verb computes is on the disk before anything is printed about it, and printing never costs it."""

from __future__ import annotations

import contextlib
import io
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.cli.command_line import main
from bench.cli.verbs import campaign_verb, tune_verb
from bench.core.words import plain_output
from bench.core.words.exceptions import DONE, MACHINE, NEGATIVE
from bench.evaluation.ensembles.ensemble import Estimate
from bench.experiments.baselines import checking
from bench.experiments.campaigns import running
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.card import card_making
from bench.experiments.card.card_suite import Suite, SuiteFlight
from bench.experiments.studies import sensor_requirements
from bench.experiments.tuning.noise_factors import Tuning
from bench.experiments.tuning.trials import HeldOutScore
from bench.pipeline import log_pipeline
from bench.plugins.hil import serving
from bench.plugins.receiver import fixes_verb
from bench.views.report import allan_picture
from tests.cli.test_cli import HEAD, PROFILE

TESTS = Path(__file__).parents[1]
_FILES = [TESTS / "data" / "gnss" / f"SEPT_2021078_1200_15M_{name}.rnx.gz" for name in ("30S_MO", "MN")]
RECEIVER = " ".join(map(str, _FILES))
REQUIRED = '\n[[requirement]]\nmetric = "pos_rmse_h_m"\nmost = 50.0\nshare = 0.1\n'
FIRST = HEAD.format("aerosonde", 2)
LOGGED = "copter, .* files\n"

VERBS = {
    "run": (
        "run short.toml --no-report --no-rrd --junit new/j.xml -o new/run",
        "new/j.xml",
        FIRST,
    ),
    "serve": (
        "serve short.toml --no-report --no-rrd -o new/serve",
        "new/serve/result.json",
        FIRST,
    ),
    "navigate": (
        "navigate copter.toml --no-report --no-rrd -o new/log",
        "new/log/result.json",
        LOGGED,
    ),
    "campaign": ("campaign short.toml --runs 2 --no-report --junit new/j.xml -o new/c", "new/j.xml", ""),
    "card": (
        "card -e loose-15 --against free-inertial --quick --require need.toml -o c.json --junit new/j.xml",
        "new/j.xml",
        "",
    ),
    "study": ("study requirements --no-report -o new/study", "new/study/study.json", ""),
    "record": ("check short.toml --record --baselines new/b", "new/b/short.json", ""),
    "check": ("check --baselines made/b --junit new/j.xml", "new/j.xml", ""),
    "tune": ("tune short.toml -e loose-15 -o new/t", "new/t/imu-tuned.toml", ""),
    "allan": ("allan --log rest.csv -o new/a.svg", "new/a.svg", ""),
    "fixes": (f"fixes {RECEIVER} -o new/f.csv --report new/f.html", "new/f.html", ""),
    "score": ("score made/run/solution-loose-15.parquet made/run -o new/s", "new/s/result.json", ""),
    "export": ("export made/run --to csv -o new/e", "new/e/imu.csv", ""),
    "compare": ("compare made/c made/c -o new/c", "new/c/report.html", ""),
    "report": ("report made/run -o new/p.html", "new/p.html", ""),
    "estimator": ("new estimator mine", "mine.py", ""),
}
"""Verb -> its command, the last file that it writes, and what it may print before."""


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Iterator[Path]:
    """A folder with finished results, where what is computed is computed once."""
    place = tmp_path_factory.mktemp("first")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        patch.setattr(sys, "path", list(sys.path))
        short = PROFILE.replace("by_deg = 90.0", "by_deg = 20.0").replace("from_s = 10", "from_s = 2")
        short = short.replace("duration_s = 30.0", "duration_s = 6.0")
        Path("short.toml").write_text(short + REQUIRED)
        Path("need.toml").write_text(REQUIRED)
        for name in ("copter.toml", "copter.bin"):
            shutil.copy(TESTS / "logs" / "flights" / name, name)
        t, noise = 0.01 * np.arange(400), np.random.default_rng(1).normal(scale=1e-3, size=400)
        rows = np.column_stack([t, noise, noise, noise])
        np.savetxt(
            "rest.csv", rows, "%.9f", ",", header="t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s", comments=""
        )
        flights = (SuiteFlight("plain", "short.toml"),)
        patch.setattr(card_making, "QUICK", Suite("card-quick", (), draws=2, members=flights))
        patch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
        for owner, name in (
            (log_pipeline, "read_log"),
            (log_pipeline, "navigate"),
            (campaign_verb, "make_card"),
            (sensor_requirements, "run"),
            (checking.MeasuredRuns, "measure"),
            (checking.MeasuredRuns, "find_unjudged"),
            (checking, "check"),
            (fixes_verb, "solve_rinex"),
        ):
            patch.setattr(owner, name, once(getattr(owner, name)))
        score = HeldOutScore(Estimate(2.0, 1.0, 3.0), Estimate(4.0, 3.0, 5.0), {})
        found = {"imu.gyro.noise": 2.0}, {"imu.gyro.noise": (1.5, 2.5)}
        tuned = Tuning("loose-15", "consistency", *found, True, 1, 1, score, score, 9, {"imu": "tuned"})
        patch.setattr(tune_verb, "tune", lambda *_, **__: tuned)
        patch.setattr(allan_picture, "draw_curve", lambda *_: None)  # what takes long
        served = serving.ServedRun(bench.run("short.toml"), 12.0, "", 0.0)
        patch.setattr(serving, "serve", lambda *_, **__: served)
        for made in (
            "run short.toml --no-rrd --no-report -o made/run",
            "campaign short.toml --runs 2 --no-report -o made/c",
            "check short.toml --record --baselines made/b",
        ):
            assert main(made.split()) == DONE
        yield place


def once(function):
    """Return a function that computes at its first call, and returns the same ever after."""
    made = []

    def get(*arguments, **options):
        if not made:
            made.append(function(*arguments, **options))
        return made[0]

    return get


class Watched(io.StringIO):
    """A stream that keeps what is printed before a file is there."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.path, self.early = path, ""

    def write(self, text: str) -> int:
        if not self.path.exists():
            self.early += text
        return super().write(text)


@contextlib.contextmanager
def printing_to(file: io.IOBase, encoding: str = "utf-8", errors: str = "strict") -> Iterator[None]:
    """Print to a file as a process of ``bench`` does."""
    with pytest.MonkeyPatch.context() as patch, io.TextIOWrapper(file, encoding, errors) as stream:
        patch.setattr(sys, "stdout", stream)
        patch.setattr(sys, "stderr", io.StringIO())
        plain_output.let_streams_write_all()
        yield
        sys.stdout.flush()


def run(verb: str, place: Path) -> None:
    """Run a verb; it ends well and has written its last file."""
    command, last, _ = VERBS[verb]
    shutil.rmtree("new", ignore_errors=True)
    Path("new").mkdir()
    for name in ("mine.py", "test_mine.py", "c.json"):
        Path(name).unlink(missing_ok=True)
    assert main(command.split()) in (DONE, NEGATIVE)
    assert Path(last).is_file()


@pytest.mark.parametrize("verb", VERBS)
def test_a_verb_saves_first_and_prints_wherever_it_can(place, verb, monkeypatch):
    _, last, before = VERBS[verb]
    for width in ("0", "1", "80"):
        monkeypatch.setenv("COLUMNS", width)
        watched = Watched(place / last)
        with contextlib.redirect_stdout(watched):
            run(verb, place)
        if width == "80":
            assert re.fullmatch(before, watched.early)
            assert len(watched.getvalue()) > len(watched.early)
    with open("/dev/full", "wb") as full, printing_to(full):
        run(verb, place)
        assert plain_output.find_lost() is not None
    reader, writer = os.pipe()
    os.close(reader)
    with open(writer, "wb") as closed, printing_to(closed):
        run(verb, place)
        assert plain_output.find_lost() is None
    with open("ascii.txt", "wb") as file, printing_to(file, "ascii", "surrogateescape"):
        run(verb, place)
    assert Path("ascii.txt").read_bytes().isascii()


@pytest.mark.parametrize(
    ("where", "status", "said"),
    [
        (
            "> /dev/full",
            MACHINE,
            "error: standard output: No space left on device; ",
        ),
        ("2> /dev/full | true", DONE, ""),
        (">&- <&-", DONE, ""),
    ],
)
def test_a_process_says_that_its_output_is_not_complete(where, status, said):
    command = f"set -o pipefail; '{sys.executable}' -m bench cache {where}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr.startswith(said)
    assert bool(done.stderr) == bool(said)
