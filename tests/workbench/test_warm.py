"""bench warm: what it compiled, a run does not compile again."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli.command_line import main
from bench.cli.verbs import warm_verb
from bench.core.compilation.compiled import is_plain

PATHS = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
LEGS = 'leg=[{kind = "straight", duration_s = 15.0}]'
CHANGES = (LEGS, "duration_s=15", "evaluation.from_s=5", "gnss_outage=[]")
SHORT = [word for change in CHANGES for word in ("--set", change)]


def bench(*arguments, kernels):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(kernels), "PYTHONPATH": PATHS}
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
    bench("run", *use, *SHORT, "--no-rrd", "--no-report", kernels=kernels)
    assert len(list(kernels.rglob("*.nbc"))) - trial == count


def test_where_nothing_is_left_to_compile_it_says_so(monkeypatch, capsys):
    monkeypatch.setattr(warm_verb, "run_shortly", lambda *arguments: None)
    assert main(["warm"]) == 0
    assert capsys.readouterr().out.startswith("All kernels were compiled already: ")


@pytest.fixture(scope="module")
def kernels(tmp_path_factory):
    """A cache that the first test of a process fills."""
    return tmp_path_factory.mktemp("kernels")


RUNS = """
import os, sys, time
from bench.cli import compiling
from bench.cli.command_line import main
children, fork = [], os.fork
os.fork = lambda: children.append(fork()) or children[-1]
compiling._can_fork = lambda: True
{change}
for folder in ("first", "second"):
    assert main([*sys.argv[1:], "--json", "-o", folder]) == 0
assert len(children) == 1, children
try:
    os.kill(children[0], 0)
except ProcessLookupError:
    print("gone")
"""


@pytest.mark.skipif(is_plain() or sys.platform != "linux", reason="no second process here")
@pytest.mark.parametrize(
    "change",
    ["", "compiling._compile = lambda *_: os._exit(3)", "compiling.os.dup2 = lambda *_: time.sleep(600)"],
)
def test_a_run_gives_the_same_with_and_without_a_second_process(change, kernels, tmp_path):
    """It compiles, has failed, or hangs; nothing of it is left, and the next run starts none."""
    for mark in kernels.rglob("*.compiled"):
        mark.unlink()
    code = RUNS.format(change=change)
    use = ["run", "figure-eight-matched", "-e", "gnss-only", *SHORT, "--no-rrd", "--no-report"]
    done = subprocess.run(
        [sys.executable, "-c", code, *use],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "NUMBA_CACHE_DIR": str(kernels), "PYTHONPATH": PATHS},
        check=True,
    )
    *metrics, last = done.stdout.splitlines()
    half = len(metrics) // 2
    assert half > 10
    assert metrics[:half] == metrics[half:]
    assert last == "gone"


def test_the_second_process_ends_with_its_parent():
    code = "import os, sys; from bench.cli import compiling; compiling._follow(0)"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE) as child:
        child.stdin.close()
        assert child.wait() == 1


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
