"""bench warm: what it compiled, a run does not compile again."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from bench.cli import compiling
from bench.cli.command_line import main
from bench.cli.verbs import warm_verb
from bench.core.compilation.compiled import is_plain


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


SHORT = [
    word
    for change in ('leg=[{kind = "straight", duration_s = 15.0}]', "duration_s=15", "evaluation.from_s=5")
    for word in ("--set", change)
]


@pytest.fixture
def cold(tmp_path, monkeypatch):
    """A cache without a filter, and a machine with two cores."""
    (folder := tmp_path / "kernels").mkdir()
    monkeypatch.setattr(compiling, "choose_cache", lambda: folder)
    monkeypatch.setattr(compiling, "_count_cores", lambda: 2)
    return folder


@pytest.mark.skipif(is_plain() or sys.platform == "win32", reason="these kernels have no locks")
@pytest.mark.parametrize("start", ["import os; os._exit(3) #{}", "import time; time.sleep(600) #{}"])
def test_a_run_does_without_the_second_process(cold, start, tmp_path, monkeypatch, capsys):
    """It has ended, or does nothing: same numbers, nothing is left of it, and none is started again."""
    started = []

    class Started(subprocess.Popen):
        def __init__(self, command, **options):
            super().__init__(command, **options)
            started.append(self)

    use = ["run", "figure-eight-matched", "-e", "gnss-only", "--no-rrd", "--no-report", *SHORT]
    use += ["--set", "gnss_outage=[]", "--json", "-o"]
    monkeypatch.setattr(compiling, "_count_cores", lambda: 1)
    assert main([*use, str(tmp_path / "alone")]) == 0
    alone = capsys.readouterr().out
    monkeypatch.setattr(compiling, "_count_cores", lambda: 2)
    monkeypatch.setattr(compiling, "_START", start)
    monkeypatch.setattr(compiling.subprocess, "Popen", Started)
    for name in ("first", "second"):
        assert main([*use, str(tmp_path / name)]) == 0
        assert capsys.readouterr().out == alone
    assert [one.returncode in {3, -9} for one in started] == [True]


def test_the_second_process_ends_with_its_parent():
    code = "import time; from bench.cli import compiling as c; c.pickle.load = lambda _: None; " + (
        "c.threading.Thread = type('T', (), {'__init__': lambda s, target, daemon: target(), "
        "'start': lambda s: None}); c.compile_for_parent()"
    )
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
