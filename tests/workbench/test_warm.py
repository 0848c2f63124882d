"""bench warm: what it compiled, a run does not compile again."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli.command_line import main
from bench.cli.verbs import warm_verb


def bench(*arguments, kernels):
    paths = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels), "PYTHONPATH": paths}
    command = [sys.executable, "-m", "bench", *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=kernels.parent, env=environment, check=True
    )
    return done.stdout


def test_what_is_compiled_ahead_is_there_in_a_run(tmp_path):
    (kernels := tmp_path / "kernels").mkdir()
    use = ["figure-eight-matched", "-e", "gnss-only"]
    said = bench("warm", *use, kernels=kernels)
    count = int(re.match(r"Compiled (\d+) kernels in [\d.]+ s: ", said)[1])
    trial = len(list(kernels.rglob("compiled._add_number*.nbc")))  # of numba, before the first kernel
    assert len(list(kernels.rglob("*.nbc"))) - trial == count > 2
    legs = 'leg=[{kind = "straight", duration_s = 15.0}]'
    changes = (legs, "duration_s=15", "evaluation.from_s=5", "gnss_outage=[]")
    short = [word for change in changes for word in ("--set", change)]
    bench("run", *use, *short, "--no-rrd", "--no-report", kernels=kernels)
    assert len(list(kernels.rglob("*.nbc"))) - trial == count


def test_where_nothing_is_left_to_compile_it_says_so(monkeypatch, capsys):
    monkeypatch.setattr(warm_verb, "run_shortly", lambda *arguments: None)
    assert main(["warm"]) == 0
    assert capsys.readouterr().out.startswith("All kernels were compiled already: ")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["figure-eigth"], "no shipped profile 'figure-eigth'"),
        (["figure-eight", "-e", "command:./filter"], "no built-in filter"),
    ],
)
def test_what_cannot_be_compiled_is_said(arguments, message, capsys):
    assert main(["warm", *arguments]) == 2
    assert message in capsys.readouterr().err
