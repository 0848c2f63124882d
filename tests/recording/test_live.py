"""A flight that is shown while it is flown: in the viewer stands where it is, and no bit of it changes."""

from __future__ import annotations

import io
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import rerun as rr
from numpy.testing import assert_allclose, assert_array_equal

from bench import pipeline
from bench.cli.command_line import main
from bench.cli.verbs import viewer
from bench.cli.verbs.console import PlainConsole
from bench.core.mathematics import earth
from bench.io import config
from bench.pipeline import closed_loop
from bench.views.recording import column, live
from tests.test_closed_loop import PROFILE

SCALARS = "Scalars:scalars"


@pytest.fixture
def shown(tmp_path):
    """What shows a flight, in a file instead of a viewer."""
    path = tmp_path / "live.rrd"
    stream = rr.RecordingStream("live")
    stream.save(path)
    return live.LiveFlight(stream), stream, path


def test_truth_and_estimate_are_shown_as_they_fly_and_no_bit_changes(tmp_path, shown):
    (tmp_path / "closed.toml").write_text(PROFILE)
    profile = config.read_profile(tmp_path / "closed.toml")
    flight, stream, path = shown
    seen = []

    def show(piece, estimate):
        seen.append((piece.t[-1], estimate))
        flight(piece, estimate)

    flown = closed_loop.fly(profile, show=show)
    stream.disconnect()
    other = closed_loop.fly(profile)
    assert_array_equal(flown.truth.lla, other.truth.lla)
    assert_array_equal(flown.answers.cov, other.answers.cov)
    assert len(seen) == np.ceil(flown.truth.t[-1] / 0.2)  # piece by piece, not at the end
    truth = flown.truth
    t, alt = column(path, "/altitude/truth", SCALARS)
    assert_allclose(t, np.arange(len(t)), atol=1e-6)
    assert len(t) == int(truth.t[-1]) + 1
    assert_allclose(alt[:, 0], truth.lla[np.searchsorted(truth.t, t - 1e-6), 2])
    t, off = column(path, "/error/horizontal", SCALARS)
    rows = np.searchsorted(flown.answers.t, t - 1e-6)
    true = truth.lla[np.searchsorted(truth.t, t - 1e-6)]
    error = earth.difference_n(flown.answers.lla[rows], true)
    assert_allclose(off[:, 0], np.hypot(error[:, 0], error[:, 1]), atol=1e-9)


def test_a_flight_by_the_truth_is_shown_whether_it_is_flown_or_comes_from_the_cache(tmp_path, shown):
    text = PROFILE.replace('[guidance]\nnavigation = "loose-15"\n', "")
    (tmp_path / "open.toml").write_text(text)
    profile = config.read_profile(tmp_path / "open.toml")
    flight, stream, path = shown
    seen = []

    def show(piece, estimate):
        seen.append(piece)
        flight(piece, estimate)

    for _ in range(2):
        seen.clear()
        result = pipeline.run(profile, show=show)
        assert seen[-1].t[-1] == result.truth.t[-1]
    stream.disconnect()
    assert len(column(path, "/altitude/truth", SCALARS)[0]) == int(result.truth.t[-1]) + 1


class Heard:
    """Takes what would go to a viewer."""

    def __init__(self):
        self.lines = {}

    def send_blueprint(self, blueprint): ...

    def set_time(self, timeline, duration): ...

    def log(self, place, what, static=False):
        if isinstance(what, rr.LineStrips3D):
            self.lines[place] = len(what.strips.as_arrow_array().to_pylist()[0])


def test_a_line_of_a_long_flight_goes_on_in_the_next_one():
    """What is sent again each second does not grow with the flight."""
    heard, t = Heard(), np.arange(130.0)
    lla = np.column_stack([np.full(130, 0.8), np.full(130, 0.2), 1000.0 + t])
    live.LiveFlight(heard)(SimpleNamespace(t=t, lla=lla), None)
    assert heard.lines == {f"/world/truth/path/{k}": points for k, points in enumerate((60, 61, 11))}


def test_without_a_display_a_line_says_so_and_the_run_goes_on(tmp_path, monkeypatch, capsys):
    (tmp_path / "closed.toml").write_text(PROFILE)
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    out = tmp_path / "out"
    given = ["--live", "--no-report", "--no-rrd"]
    assert main(["run", str(tmp_path / "closed.toml"), "-o", str(out), *given]) in (0, 1)
    line = "Nothing is shown live: no display for a window; the run goes on without --live.\n"
    assert line in capsys.readouterr().out
    assert (out / "result.json").is_file()


@pytest.fixture
def show_in(monkeypatch, tmp_path):
    """Shows two pieces of a flight in a program as viewer; its children are ended."""
    children, start = [], subprocess.Popen

    def keep(command, **options):
        children.append(start(command, **options))
        return children[-1]

    def show(script, count=2):
        program = tmp_path / "viewer"
        program.write_text(f"#!{sys.executable}\n{script}\n")
        program.chmod(0o755)
        monkeypatch.setenv("DISPLAY", ":0")
        monkeypatch.setattr(viewer, "find_viewer", lambda: program)
        monkeypatch.setattr(viewer, "PATIENCE", 1.0)
        monkeypatch.setattr(subprocess, "Popen", keep)
        console = PlainConsole(file=io.StringIO())
        with viewer.show_live("a, b", console) as flight:
            for k in range(count):
                t = np.arange(100 * k, 100 * (k + 1)) * 1.0
                lla = np.tile([0.8, 0.2, 1000.0], (100, 1))
                flight(SimpleNamespace(t=t, lla=lla), None)
        return console.file.getvalue()

    yield show
    for child in children:
        child.kill()
        child.wait()


def test_the_real_viewer_reads_the_flight_at_its_standard_input_and_rerun_says_nothing(
    show_in, tmp_path, capfd
):
    """It keeps what it reads, because a window needs a display."""
    part, kept = str(tmp_path / "part.rrd"), tmp_path / "kept.rrd"
    command = f"[{str(viewer.find_viewer())!r}, *sys.argv[1:], '--save', {part!r}]"
    script = "import os, subprocess, sys, time"
    script += f"\nsubprocess.run({command})\nos.rename({part!r}, {str(kept)!r})\ntime.sleep(60)"
    assert show_in(script) == ""
    until = time.monotonic() + 60.0
    while not kept.is_file() and time.monotonic() < until:
        time.sleep(0.1)
    assert len(column(kept, "/altitude/truth", SCALARS)[0]) == 200
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("import time\ntime.sleep(60)", "The viewer takes nothing more"),
        ("import sys\nsys.stdin.close()", "The viewer has gone"),
    ],
)
def test_a_viewer_that_takes_nothing_does_not_hold_the_run(show_in, capfd, script, said):
    begun = time.monotonic()
    assert show_in(script, count=30) == f"{said}: not all of the flight is shown live.\n"
    assert time.monotonic() - begun < 20.0
    assert capfd.readouterr().err == ""


def test_a_viewer_that_cannot_be_started_is_a_line(tmp_path, monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "find_viewer", lambda: tmp_path / "none")
    console = PlainConsole(file=io.StringIO())
    with viewer.show_live("figure-eight", console) as flight:
        assert flight is None
    missing = f"Nothing is shown live: {tmp_path / 'none'}: No such file or directory.\n"
    assert console.file.getvalue() == missing
