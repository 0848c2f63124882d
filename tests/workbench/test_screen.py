"""What a command prints of a run fits on a screen of 24 lines and 80 columns, and begins within a second."""

from __future__ import annotations

import subprocess
import sys
import time
from io import StringIO

import numba
import numpy as np
import pytest

import bench
from bench import pipeline
from bench.cli.command_line import main
from bench.cli.verbs import console, result_table
from bench.cli.verbs.console import PlainConsole
from bench.core.compilation import compiled
from bench.core.records.data import Events, no_events
from bench.core.words.stages import Stage
from bench.evaluation.consistency.headline import make_headline
from bench.evaluation.consistency.verdict import add_verdict
from bench.navigation.engine.record_cuts import nothing_known
from tests.evaluation.test_verdict import SOUND, verdict

WIDTH, HEIGHT = 80, 24
CAUSES = ("time-correlated GNSS position error", "time-correlated GNSS velocity error", "gyro misalignment")


def take_lines(text: str) -> list[str]:
    lines = text.splitlines()
    assert max(map(len, lines)) <= WIDTH
    return lines


@pytest.mark.parametrize(
    ("profile", "words"),
    [
        ("figure-eight", ("6.0 m     6.1 m", "✓ consistent", "✗ loose-15  NEES 1031;", "△ large drift")),
        ("approach", ("✗ overconfident", "✗ loose-15  NEES", "errors beyond 3 sigma: height 100 %")),
        (
            "approach-spoofed",
            ("fault ", " no  ✗ overconfident", "18 s  ✗ overconfident"),
        ),
        ("gnss-faults", ("190 m     605 m", "✓ consistent")),
    ],
)
def test_a_run_is_told_on_one_screen(profile, words, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["run", profile, "--no-causes", "--no-rrd", "--no-report"]) in (0, 1)
    printed = capsys.readouterr().out
    assert len(take_lines(printed)) <= HEIGHT
    for text in (*words, "bench show runs/"):
        assert text in printed
    assert main(["show"]) == 0
    table = capsys.readouterr().out
    take_lines(table)
    assert "horizontal error, rms" in table
    assert "pos_rmse_h_m" not in table


@pytest.mark.parametrize("count", [1, 3, 9])
def test_more_filters_leave_out_what_matters_least(count):
    """A row and the reason stay for each filter; the cause stays if there is room."""
    causes = [{"cause": name, "block": "position", "step": 1} for name in CAUSES]
    values = verdict(causes=causes, advice_text="loose-full has states for all of them.", pos_rmse_d_m=14.65)
    out = StringIO()
    console = PlainConsole(file=out, width=WIDTH)
    labels = [f"filter-{k}" for k in range(count)]
    result_table.print_screen(
        console, dict.fromkeys(labels, values), dict.fromkeys(labels, nothing_known(np.zeros(1)))
    )
    lines = take_lines(out.getvalue())
    assert len(lines) <= max(result_table.SCREEN - 8, 3 * count + 5)
    first = "NEES 1031; one run of a consistent filter stays within 1 to 29."
    assert " ".join(out.getvalue().split()).count(first) == count
    assert ("cause: time-correlated" in out.getvalue()) == (count == 1)
    assert out.getvalue().count("14.7 m") == count


def test_where_a_filter_stopped_stands_below_its_verdict():
    rows = [(3.0, 4.0, "restart", "IMU silent for 1 s", "imu"), (8.0, 8.0, "reset", "fixes rejected", "")]
    found = make_headline("mine", verdict(), Events.from_rows(rows))
    assert found.more[0] == "3 to 4 s: IMU silent for 1 s; 1 more"
    assert make_headline("mine", verdict(), no_events()).stops == ""


def test_a_headline_names_what_is_required_and_missed():
    asked = [{"metric": "pos_rmse_h_m", "most": 5.0}, {"metric": "nees_states", "most": 9.0}]
    found = make_headline("mine", add_verdict("mine", dict(SOUND), None, asked))
    assert found.required == "pos_rmse_h_m is 13.69 m, at most 5 m is required: missed."
    met = make_headline("mine", add_verdict("mine", dict(SOUND), None, asked[1:]))
    assert met.required == "required: 1 met"


def test_the_first_line_comes_before_anything_that_takes_long(tmp_path):
    """What it needs is numpy, pydantic, rich, click and the profile: nothing that loads for half a second."""
    command = [sys.executable, "-u", "-X", "importtime", "-m", "bench", "run", "figure-eight", "--no-rrd"]
    loaded = set()
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=tmp_path, text=True
    ) as started:
        assert started.stdout is not None
        for line in started.stdout:
            if line == "figure-eight: Figure-eights in a steady wind, GNSS lost for a minute\n":
                break
            loaded.add(line.rpartition("|")[2].strip().partition(".")[0])
        else:
            pytest.fail("it has printed no first line")
        started.terminate()
    assert {"numpy", "pydantic", "rich", "click", "bench"} <= loaded
    assert not loaded & {"numba", "jsbsim", "scipy", "rerun", "pandas", "pyarrow", "matplotlib", "filterpy"}


def test_a_run_names_its_stages():
    """Sensing, each filter of how many and evaluation, also where the flight comes from the cache."""

    stages: list[Stage] = []
    result = bench.run(
        "approach", estimators=["loose-15", "free-inertial"], causes=False, progress=stages.append
    )
    told = list(dict.fromkeys(stage.words for stage in stages))
    assert told[-4:] == ["sensing", "filter 1 of 2: loose-15", "filter 2 of 2: free-inertial", "judging"]
    assert str(Stage("flying", 30.0, 60.0)) == "flying, 30 of 60 s"
    assert str(Stage("filter 1 of 2: x", compiling=True)) == "filter 1 of 2: x (compiling, once)"
    assert result.provenance["cpu_s"]["compile"] >= 0.0
    found = [stage.found for stage in stages if stage.found]
    assert [line.partition(",")[0] for line in found] == [
        f"{label}: {make_headline(label, values).word}" for label, values in result.metrics.items()
    ]


def test_a_verdict_stays_on_the_terminal_while_the_run_goes_on(monkeypatch):
    """It is above the bar, which is gone at last."""
    written = StringIO()
    terminal = PlainConsole(file=written, force_terminal=True, width=WIDTH)
    monkeypatch.setattr(console, "PlainConsole", lambda **_: terminal)
    with console.show_bar("starting") as show:
        show("judging", 0.0, None, found="loose-full: consistent, 6.0 m")
        show("why loose-15 is wrong", 0.0, None)
    assert written.getvalue().count("loose-full: consistent, 6.0 m\n") == 1


def test_compiling_is_told_and_is_not_the_work_of_a_filter():
    """The clock that a filter's CPU is read from stands still while its kernels compile."""

    def add(values: np.ndarray) -> float:
        total = 0.0
        for value in values:
            total += value
        return total

    told: list[bool] = []
    compiled.time_compiling()
    one = numba.njit(add)  # never from a cache
    with compiled.watch_compiling(told.append):
        cpu, work, before = (
            time.process_time(),
            pipeline.steps.read_work_clock(),
            compiled.read_compile_time(),
        )
        assert one(np.ones(3)) == 3.0
        compiling = compiled.read_compile_time() - before
        cpu, work = time.process_time() - cpu, pipeline.steps.read_work_clock() - work
        assert one(np.ones(4)) == 4.0
    assert told == [True, False]
    assert compiling > 0.02
    assert work == pytest.approx(cpu - compiling, abs=1e-3)
    assert compiled.read_compile_time() - before == compiling
