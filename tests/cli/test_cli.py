"""Every way a command can end has its exit status, one line that says why, and nothing half-written."""

from __future__ import annotations

import errno
import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

import bench
from bench import pipeline
from bench.cli.command_line import commands, main
from bench.cli.group import end_run
from bench.cli.verbs import viewer
from bench.core.words.exceptions import FlightError
from bench.io import results
from bench.io.results import parquet
from bench.views import recording
from bench.views.report import page as report_page
from tests.builders import is_running

PROFILE = """
title = "Half a minute"
aircraft = "aerosonde"
rate_hz = 100
seed = 5
duration_s = 30.0
[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m = 1000.0
heading_deg = 10.0
speed_mps = 25.0
[[leg]]
kind = "turn"
by_deg = 90.0
bank_deg = 25.0
[sensors]
imu = "matched-mems"
gnss = "matched-white"
[evaluation]
from_s = 10.0
[[estimator]]
use = "loose-15"
"""

HEAD = (
    "short: Half a minute\naircraft {}; sensors: IMU matched-mems, GNSS matched-white\n"
    "seed 5, run 0; errors from {} s on\n\n"
)
"""What a run says before it flies."""

LOST = """
import dataclasses
import numpy as np
from bench.navigation.models.loose_tight import Loose

class Lost(Loose):
    def run(self, sensors, initial):
        found = super().run(sensors, initial)
        return dataclasses.replace(found, lla=np.full_like(found.lla, np.nan))
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory) -> str:
    return str(tmp_path_factory.mktemp("cache"))


@pytest.fixture
def here(tmp_path, monkeypatch, cache) -> Path:
    """An empty folder to stand in, with a short profile and a cache of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BENCH_CACHE", cache)
    (tmp_path / "short.toml").write_text(PROFILE)
    return tmp_path


def left(here: Path) -> list[str]:
    """What stands in the folder besides the profile and the bytecode of Python, hidden files too."""
    return sorted(path.name for path in here.iterdir() if path.name not in ("short.toml", "__pycache__"))


def say(capsys, *arguments: str) -> tuple[int, str, str]:
    status = main(arguments)
    return status, *capsys.readouterr()


# --- what goes well -----------------------------------------------------------------------------------


def test_run_writes_its_folder_and_says_what_comes_next(here, capsys):
    status, out, err = say(capsys, "run", "short.toml")
    assert (status, err) == (0, "")
    folder = here / "runs" / "short-5"
    names = {path.name for path in folder.iterdir()}
    assert {"result.json", "truth.parquet", "sensors-imu.parquet", "sensors-gnss.parquet"} <= names
    assert {"solution-loose-15.parquet", "errors-loose-15.parquet", "flight.rrd"} <= names
    assert "✓ consistent" in out
    assert "Next     bench view runs/short-5 " in out
    assert left(here / "runs") == ["short-5"]
    result = results.read_result(folder)
    assert result.profile["sensors"]["assumed"]["imu"] == "matched-mems"
    assert result.metrics["loose-15"]["converged"] is True

    status, out, err = say(capsys, "run", "short.toml")
    assert (status, out) == (2, "")
    assert err == "error: runs/short-5: the results folder exists; --force replaces it, -o names another\n"
    assert say(capsys, "run", "short.toml", "--force", "--no-rrd")[0] == 0
    assert not (folder / "flight.rrd").exists()


def test_five_estimators_stand_in_two_tables_of_80_columns(here, capsys):
    """No word is cut, each mean NIS with its band; what they have in common is said once."""
    names = ("loose-15", "loose-22", "smoother", "baro-inertial", "gnss-only")
    chosen = [part for name in names for part in ("-e", name)]
    given = ("--no-rrd", "--table", "--set", 'sensors.baro="bmp388"')
    status, out, _ = say(capsys, "run", "short.toml", *given, *chosen)
    assert status == 0
    assert max(len(line) for line in out.splitlines()) <= 80
    for words in (
        "heading within 1 deg or",
        "heading within 3 sigma",
        "NIS GNSS velocity, mean",
    ):
        assert [line.strip().startswith(words) for line in out.splitlines()].count(True) == 2
    rows = [k for k, line in enumerate(out.splitlines()) if line.strip().startswith("NIS barometer, mean")]
    below = [out.splitlines()[row + 1] for row in rows]
    assert len(re.findall(r"\d\.\d\d to \d\.\d\d", " ".join(below))) == 4
    assert "loose-15, loose-22: not modeled: " in out.replace("\n", " ")


def test_json_is_all_there_is_on_stdout(here, capsys):
    status, out, err = say(capsys, "run", "short.toml", "--json", "--no-rrd", "-o", "a/b", "--seed", "8")
    assert status == 0
    metrics = json.loads(out)
    assert metrics["loose-15"]["pos_rmse_h_m"] > 0
    assert "Results  a/b" in err
    assert results.read_result("a/b").seed == 8


def test_every_option_has_an_effect(here, capsys):
    def metrics(*options: str):
        status, out, _ = say(capsys, "run", "short.toml", "--json", "--no-rrd", "--force", *options)
        assert status == 0
        return json.loads(out)

    plain = metrics()
    assert metrics() == plain
    for options in (("--seed", "6"), ("--run", "1"), ("--set", "sensors.imu=stim300")):
        assert metrics(*options)["loose-15"] != plain["loose-15"]
    two = "[[estimator]]\nuse = 'free-inertial'\n"
    (here / "short.toml").write_text(PROFILE + two)
    assert list(metrics()) == ["loose-15", "free-inertial"]
    assert list(metrics("-e", "free-inertial")) == ["free-inertial"]
    assert left(here / "runs") == ["short-5", "short-5-run1", "short-6"]


def test_fly_sums_the_flight_up_and_run_finds_it_in_the_cache(here, capsys, monkeypatch):
    status, out, _ = say(capsys, "fly", "short.toml", "--set", "start.alt_m=1010")
    assert status == 0
    assert "1 turn: 90 deg right, bank 25 deg" in out
    assert "30 s, 3001 samples at 100 Hz" in out
    assert re.search(r"replay +0\.0\d+ mm, \S+ microradian", out)
    assert left(here) == []
    monkeypatch.setattr("bench.simulation.flight.fly_pieces", None)
    assert say(capsys, "run", "short.toml", "--set", "start.alt_m=1010", "--no-rrd")[0] == 0


def test_list_names_everything_there_is(capsys):
    assert say(capsys, "list")[0] == 0
    out = "".join(say(capsys, "list", kind)[1] for kind in ("profiles", "aircraft", "sensors", "estimators"))
    for name in ("figure-eight", "aerosonde", "adis16475", "l1-code", "bmp388", "loose-15", "free-inertial"):
        assert name in out


@pytest.mark.parametrize(
    ("values", "usual", "strict"),
    [
        ({"verdict": "consistent"}, 0, 0),
        ({"verdict": "undecided"}, 0, 0),
        ({"verdict": "overconfident"}, 0, 1),
        ({"verdict": "underconfident"}, 0, 1),
        ({"verdict": "consistent", "required": "missed"}, 1, 1),
        ({"verdict": "incomplete", "converged": False}, 1, 1),
        ({"verdict": "failed", "converged": False, "traceback": "boom"}, 70, 70),
    ],
)
def test_a_claim_that_does_not_hold_is_status_1_if_it_is_asked_for(values, usual, strict, capsys):
    metrics = {"good": {"converged": True, "verdict": "consistent"}, "mine": {"converged": True, **values}}
    assert (end_run(metrics), end_run(metrics, strict=True)) == (usual, strict)
    for verb in ("run", "navigate", "serve", "score", "campaign"):
        assert "--strict" in [flag for one in commands.get_command(None, verb).params for flag in one.opts]


def test_every_kind_that_a_message_or_a_page_sends_to_is_listed(capsys):
    status, out, _ = say(capsys, "list", "metrics")
    assert status == 0
    for name in ("pos_rmse_{}_m", "heading_rmse_deg", "outage_{}_drift_h_m"):
        assert name in out
    package = Path(bench.__file__).parent
    told = [*package.rglob("*.py"), *package.rglob("*.md"), package.parent / "README.md"]
    sent = {kind for path in told for kind in re.findall(r"bench list ([a-z]+)", path.read_text("utf-8"))}
    assert "metrics" in sent
    assert sent <= set(json.loads(say(capsys, "list", "--json")[1]))


def test_list_legs_says_what_each_key_may_be(capsys):
    status, out, _ = say(capsys, "list", "legs")
    assert status == 0
    turn = out.split("turn: Turn by an angle or to a heading")[1].split("waypoints:")[0]
    assert re.search(r"by_deg +-3600 to 3600 deg +optional +change of heading", turn)
    assert re.search(r"side +right, left, shorter +shorter +direction of a turn", turn)
    assert "Profiles" not in out
    (legs,) = json.loads(say(capsys, "list", "legs", "--json")[1]).values()
    glide, aim, _ = next(leg for leg in legs if leg["name"] == "approach")["keys"]
    assert (glide["name"], glide["unit"], glide["low"], glide["high"]) == ("glide_deg", "deg", 1.0, 10.0)
    assert (glide["default"], glide["required"], aim["default"]) == (3.0, False, 60.0)


MINE = """
import dataclasses
import numpy as np
from bench.core.mathematics import earth
from bench.navigation.models.loose_tight import Loose

class Mine(Loose):
    def run(self, sensors, initial):
        found = super().run(sensors, initial)
        noise = np.random.default_rng(1).normal(scale=NOISE, size=(len(found), 3))
        return dataclasses.replace(found, lla=earth.displace(found.lla, noise))
"""


RECORD = ("--record", "--runs", "20", "--jobs", "1")


def test_check_finds_a_loss_in_a_filter_of_the_present_folder(here, capsys, monkeypatch):
    """Unchanged it passes; with noise as large as its error added, the check names what got worse."""

    def write_filter(noise):
        monkeypatch.delitem(sys.modules, "mylab", raising=False)
        (here / "mylab.py").write_text(MINE.replace("NOISE", str(noise)))

    write_filter(0.0)
    own = ["-e", "mylab:Mine", "--in-process"]  # but for the check of --allow-code
    status, out, _ = say(capsys, "check", "short.toml", *own, *RECORD, "--baselines", "b")
    assert (status, out.splitlines()[0]) == (0, "Wrote b/short.json.")
    status, out, err = say(capsys, "check", "--baselines", "b")
    assert (status, out) == (2, "")
    assert "its baseline names 'mylab:Mine', which runs code on this machine; --allow-code permits it" in err
    status, out, _ = say(capsys, "check", "--baselines", "b", "--allow-code", "--jobs", "2")
    assert status == 0
    assert re.fullmatch(r"short, Mine: \d+ same \(20 runs\)\n", out)
    baseline = json.loads((here / "b/short.json").read_text())["estimators"]["Mine"]
    rmse = np.sqrt(np.mean(np.square(baseline["metrics"]["pos_rmse_d_m"])))
    write_filter(rmse)
    status, out, _ = say(
        capsys, "check", *own, "--baselines", "b", "--json", "--junit", "b/check.xml", "--jobs", "1"
    )
    assert status == 1
    rows = {row["metric"]: row for row in json.loads(out)}
    assert rows["pos_rmse_d_m"]["word"] == "worse"
    assert rows["pos_rmse_d_m"]["change"] == pytest.approx(np.sqrt(2) - 1, abs=0.05)
    assert rows["heading_rmse_deg"]["word"] == "same"
    assert "<failure" in (here / "b/check.xml").read_text()
    assert left(here) == ["b", "mylab.py"]


# --- what goes wrong ----------------------------------------------------------------------------------

WRONG = [
    (["run"], "error: Missing argument 'PROFILE'. ('bench run --help' says more)"),
    (["rum"], "error: No such command 'rum'"),
    (["run", "short.toml", "--bogus"], "error: No such option"),
    (["run", "short.toml", "--set", "x"], "error: Invalid value for '--set': 'x' must be KEY=VALUE"),
    (["run", "short.toml", "--view", "--no-rrd"], "error: --view needs the recording"),
    (["run", "nowhere.toml"], "error: nowhere.toml: no such file"),
    (["study", "requirements", "--seed", "1"], "error: study requirements: --seed is for studies that fly"),
    (["study", "alignment", "--units", "x"], "error: study alignment: --units is for studies that fly"),
    (["run", "figure-nine"], "error: no shipped profile 'figure-nine'"),
    (["cache", "--limit", "nan"], "error: Invalid value for '--limit': nan is not a finite number."),
    (["cache", "--limit", "inf"], "error: Invalid value for '--limit': inf is not a finite number."),
    (
        ["run", "short.toml", "--set", "start.lat_deg=95"],
        "error: short.toml: [start] lat_deg = 95 deg is outside",
    ),
    (
        ["run", "short.toml", "--set", "leg.1.bank_deg=nan"],
        "error: short.toml: [[leg]] 1 (turn): bank_deg = nan",
    ),
    (["run", "short.toml", "--set", "aircraft=kite"], "error: short.toml: aircraft = 'kite' is not found"),
    (["run", "short.toml", "-e", "x"], "error: short.toml: no filter 'x' in this profile"),
    (
        ["run", "short.toml", "--set", "estimator.1.use=x"],
        "error: short.toml: [[estimator]] 1: use = 'x' is no",
    ),
    (
        ["run", "short.toml", "-o", "short.toml"],
        "error: short.toml: a file is there; a results folder needs",
    ),
    (["run", "short.toml", "-o", "short.toml/a"], "error: short.toml/a: no folder can be made in "),
    (
        ["run", "short.toml", "-o", "a" * 300],
        f"error: {'a' * 300}: no folder can be made there: File name too long",
    ),
    (["run", "short.toml", "-o", ".", "--force"], "error: .: the present folder is not replaced"),
    (["view"], "error: runs: no recording in any folder; 'bench run figure-eight' makes one"),
    (["view", "x"], "error: x: no such file or folder"),
    (["check", "--baselines", "x"], "error: x: no baseline"),
]


@pytest.mark.parametrize(("arguments", "line"), WRONG)
def test_a_wrong_command_or_file_is_status_2(here, capsys, arguments, line, monkeypatch):
    monkeypatch.setattr(pipeline.steps, "fly", None)  # it fails before anything flies
    status, out, err = say(capsys, *arguments)
    assert (status, out) == (2, "")
    assert err.startswith(line)
    assert err.count("error:") == 1
    assert left(here) == []


def test_all_errors_are_said_at_once(here, capsys):
    status, _, err = say(capsys, "run", "short.toml", "--set", "start.lat_deg=95", "--set", "wnd=1")
    assert status == 2
    assert [line[:17] for line in err.splitlines()] == [
        "error: short.toml",
        "error: short.toml",
        "  known keys: air",
    ]


@pytest.mark.parametrize("text", ["<output name='x'/>", "no XML", "<fdm_config/>"])
def test_an_aircraft_that_does_not_load_is_status_3(here, capsys, text):
    from bench.io.config.library import find_aircraft

    own = here / "aircraft" / "kite"
    own.mkdir(parents=True)
    toml = find_aircraft("aerosonde", here) / "aircraft.toml"
    (own / "aircraft.toml").write_text(toml.read_text())
    (own / "kite.xml").write_text(text)
    status, out, err = say(capsys, "run", "short.toml", "--set", "aircraft=kite")
    assert (status, out) == (3, HEAD.format("kite", 10))
    assert re.fullmatch(r"error: .*kite.*\n", err)
    assert left(here) == ["aircraft"]


def test_a_flight_that_does_not_fit_its_duration_is_status_3(here, capsys):
    status, _, err = say(
        capsys, "run", "short.toml", "--set", "leg.1.by_deg=360", "--set", "leg.1.bank_deg=5"
    )
    assert status == 3
    assert re.fullmatch(r"error: the legs need .*; duration is 30 s\n", err)
    assert left(here) == []


def test_an_aircraft_lost_in_the_air_is_status_3(here, capsys, monkeypatch):
    def crash(*args, **keywords):
        raise FlightError("leg 1 turn: at 3.2 s: into the ground")

    monkeypatch.setattr("bench.simulation.flight.fly_pieces", crash)
    status, _, err = say(capsys, "run", "short.toml", "--seed", "77")
    assert (status, err) == (3, "error: leg 1 turn: at 3.2 s: into the ground\n")
    assert left(here) == []


def test_a_filter_that_diverges_is_a_result_and_status_1(here, capsys, monkeypatch):
    (here / "my_lab.py").write_text(LOST)
    monkeypatch.setattr(sys, "path", list(sys.path))
    status, out, _ = say(capsys, "run", "short.toml", "-o", "a", "-e", "loose-15", "-e", "my_lab:Lost")
    assert status == 1
    assert "✗ Lost  " in out
    metrics = results.read_result("a").metrics
    assert (metrics["loose-15"]["converged"], metrics["Lost"]["converged"]) == (True, False)
    assert metrics["Lost"]["pos_rmse_h_m"] is None


@pytest.mark.parametrize("name", ["truth.parquet", "errors-loose-15.parquet"])
def test_a_full_disk_is_status_4(here, capsys, monkeypatch, name):
    def until(path, *args, **keywords):
        if path.name == name:
            path.write_text("half")
            raise OSError(errno.ENOSPC, "No space left on device")
        return genuine(path, *args, **keywords)

    genuine = parquet.write
    monkeypatch.setattr(parquet, "write", until)
    status, _, err = say(capsys, "run", "short.toml", "-o", "a")
    assert status == 4
    assert err == "error: a: No space left on device; nothing was written\n"
    assert left(here) == []


@pytest.mark.parametrize(
    "error", [OSError(errno.ENOSPC, "No space left on device"), AttributeError("no 'time_view'")]
)
@pytest.mark.parametrize("view", ["recording", "report"])
def test_a_recording_or_report_that_fails_is_status_5_and_loses_nothing(
    here, capsys, monkeypatch, view, error
):
    """The results and the other of the two are there; the verb that the line names makes it again."""

    def fail(*args, **keywords):
        raise error

    place = (recording, "write") if view == "recording" else (report_page, "make_page")
    with monkeypatch.context() as patched:
        patched.setattr(*place, fail)
        status, out, err = say(capsys, "run", "short.toml", "-o", "a")
    assert status == 5
    assert "✓ consistent" in out
    reason = f"the {view} failed, {type(error).__name__}: {error}"
    verb = {"recording": "record", "report": "report"}[view]
    assert err == f"error: a: the results are written, but {reason}; bench {verb} a makes it again\n"
    made = {"recording": "flight.rrd", "report": "report.html"}
    assert results.read_result("a").metrics["loose-15"]["converged"]
    assert [name for name in made.values() if (here / "a" / name).is_file()] == [
        name for one, name in made.items() if one != view
    ]
    assert say(capsys, verb, "a")[0] == 0
    assert (here / "a" / made[view]).is_file()
    assert say(capsys, "run", "short.toml", "-o", "a", "--force")[0] == 0  # all files in it are of bench


@pytest.mark.parametrize("step", ["fly", "navigate_all", "answer", "judge_solution"])
def test_an_interrupted_run_is_status_130(here, capsys, monkeypatch, step):
    def interrupt(*args, **keywords):
        raise KeyboardInterrupt

    part = pipeline.estimator if step == "answer" else pipeline if step == "navigate_all" else pipeline.steps
    monkeypatch.setattr(part, step, interrupt)
    status, out, err = say(capsys, "run", "short.toml")
    assert (status, out, err.strip()) == (130, HEAD.format("aerosonde", 10), "error: interrupted")
    assert left(here) == []


def test_interrupted_while_writing_leaves_the_old_results(here, capsys, monkeypatch):
    assert say(capsys, "run", "short.toml", "--no-rrd")[0] == 0
    before = (here / "runs/short-5/result.json").read_text()

    def interrupt(path, *args, **keywords):
        path.write_text("half")
        raise KeyboardInterrupt

    monkeypatch.setattr(parquet, "write", interrupt)
    assert say(capsys, "run", "short.toml", "--force", "--run", "0")[0] == 130
    assert (here / "runs/short-5/result.json").read_text() == before
    assert left(here / "runs") == ["short-5"]


def test_a_bug_is_status_70_and_keeps_its_traceback(here, capsys, monkeypatch):
    for bug in (ZeroDivisionError("a bug"), FileNotFoundError("a bug"), KeyError("a bug")):

        def fail(*args, bug=bug, **keywords):
            raise bug

        monkeypatch.setattr(pipeline, "sense", fail)
        status, _, err = say(capsys, "run", "short.toml")
        assert status == 70
        assert "Traceback" in err
        assert "a bug" in err
        assert left(here) == []


MY_LAB = """
from dataclasses import replace
from bench.navigation.models.loose_tight import Loose

class Raises:
    def run(self, sensors, initial):
        raise PermissionError(13, "no right to it", "model.bin")

class Nothing:
    def run(self, sensors, initial):
        return None

class Short:
    def run(self, sensors, initial):
        short = replace(sensors, output_t=sensors.output_t[:-3])
        return Loose().run(short, initial)

class Eventless(Loose):
    def run(self, sensors, initial):
        return replace(super().run(sensors, initial), events=[])

class Leaves(Loose):
    def run(self, sensors, initial):
        raise SystemExit(0)

class Rude(Exception):
    def __str__(self):
        raise ValueError("a bug in a bug")

class Confused(Loose):
    def unmodeled_errors(self, specs):
        raise Rude
"""


def test_a_failed_estimator_is_a_result_beside_the_others(here, capsys):
    (here / "lab.py").write_text(MY_LAB)
    names = ("Raises", "Nothing", "Short", "Eventless", "Leaves", "Confused")
    uses = [option for name in names for option in ("-e", f"lab:{name}")]
    got, out, err = say(capsys, "run", "short.toml", *uses, "-e", "loose-15", "--no-rrd")
    assert got == 70
    texts = " ".join(out.split())
    for why in (
        "✗ Raises run() raised PermissionError: [Errno 13] no right to it: 'model.bin'",
        "✗ Nothing run() must return a NavSolution; got NoneType",
        "✗ Short its t must be sensors.output_t, 301 epochs; got 298 epochs",
        "✗ Eventless events must be Events; got list",
        "✗ Leaves run() raised SystemExit: 0",
        "✗ Confused unmodeled_errors() raised lab.Rude: <exception str() failed>",
    ):
        assert why in texts
    assert err.count("Traceback") == len(names)
    assert 'lab.py", line 7, in run' in err
    read = bench.read_result(here / "runs/short-5")
    assert read.metrics["Raises"]["traceback"].endswith("no right to it: 'model.bin'\n")
    assert [name for name, values in read.metrics.items() if values.get("failed")] == list(names)
    assert say(capsys, "run", "short.toml", "--no-rrd", "--force")[0] == 0
    alone = bench.read_result(here / "runs/short-5")
    assert "traceback" not in alone.metrics["loose-15"]
    assert alone.metrics["loose-15"] == read.metrics["loose-15"]


def test_an_estimator_that_cannot_start_has_failed_where_another_can(here, capsys):
    """Leveling in flight: gnss-only needs no attitude. If none can start, the profile is wrong."""
    run = ("run", "short.toml", "--no-rrd", "--set=alignment={kind='level',duration_s=5}")
    why = "alignment level needs a standstill of 5 s at the start; at 0 s GNSS reports 25 m/s"
    got, out, err = say(capsys, *run, "-e", "loose-15", "-e", "gnss-only")
    assert (got, err) == (1, "")
    assert f"✗ loose-15 {why}" in " ".join(out.split())
    read = bench.read_result(here / "runs/short-5")
    assert {name: values.get("failed", False) for name, values in read.metrics.items()} == {
        "loose-15": True,
        "gnss-only": False,
    }
    got, out, err = say(capsys, *run, "-e", "loose-15", "-e", "ukf", "--force")
    assert (got, err) == (2, f"error: filter 'loose-15': {why}\nerror: filter 'ukf': {why}\n")


def test_two_estimators_of_one_label_are_refused(here, capsys):
    status, _, err = say(capsys, "run", "short.toml", "-e", "loose-15", "-e", "loose-15")
    assert status == 2
    assert "two of the requested filters have the label 'loose-15'" in err


def test_an_outage_after_a_flight_of_open_length_is_refused(here, capsys):
    outage = "--set=gnss_outage=[{start_s=5000.0,duration_s=5.0}]"
    text = (here / "short.toml").read_text()
    (here / "open.toml").write_text(
        "\n".join(x for x in text.splitlines() if not x.startswith("duration_s ="))
    )
    status, _, err = say(capsys, "run", "open.toml", outage)
    assert status == 2
    assert "[[gnss_outage]] 1: its end at 5005 s is outside the flight" in err
    fault = "--set=fault=[{kind='frozen',sensor='gnss',start_s=5000.0,duration_s=5.0}]"
    status, _, err = say(capsys, "run", "open.toml", fault)
    assert status == 2
    assert "[[fault]] 1 (frozen): its end at 5005 s is outside the flight" in err


def test_a_sensor_that_an_estimator_needs_is_missed_before_the_flight(here, capsys, monkeypatch):
    def flown(*_, **__):
        raise AssertionError("it was flown")

    monkeypatch.setattr("bench.pipeline.steps.fly", flown)
    text = (here / "short.toml").read_text()
    lines = [x for x in text.splitlines() if not x.startswith("gnss")]
    (here / "blind.toml").write_text("\n".join(lines))
    status, _, err = say(capsys, "run", "blind.toml", "-e", "loose-15")
    assert status == 2
    assert err.strip() == "error: filter 'loose-15' needs a gnss; there is none in [sensors]"
    assert not (here / "runs").exists()


# --- the process as a whole ---------------------------------------------------------------------------


def python(code: str, *, cwd: Path) -> subprocess.Popen:
    paths = [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    return subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=cwd,
        env=env,
    )


def modules(arguments: list[str], cwd: Path) -> set[str]:
    """The modules loaded after a command, each with its parents."""
    code = f"import sys; from bench.cli.command_line import main; status = main({arguments})"
    code += "; print(); print(*sys.modules); sys.exit(status)"
    process = python(code, cwd=cwd)
    out, err = process.communicate()
    assert process.returncode == 0, err
    return set(out.splitlines()[-1].split())


def test_help_imports_nothing_heavy(tmp_path):
    for arguments in (["--help"], ["run", "--help"], []):
        loaded = modules(arguments, tmp_path)
        assert "bench.cli" in loaded
        assert not loaded & {"numpy", "pydantic", "rich", "numba", "pyarrow", "bench.core.records.data"}


def test_the_list_imports_only_what_it_uses(tmp_path):
    loaded = modules(["list"], tmp_path)
    assert "bench.cli.verbs.show" in loaded
    assert not loaded & {"pydantic", "numba", "scipy", "pyarrow", "pandas", "bench.navigation.options"}


def test_a_cached_run_imports_only_what_it_uses(here, capsys):
    assert say(capsys, "fly", "short.toml")[0] == 0
    loaded = modules(["run", "short.toml", "--no-rrd"], here)
    assert "bench.navigation.models.loose_tight" in loaded
    assert "pandas" not in modules(["run", "short.toml", "--force"], here)
    heavy = {"jsbsim", "rerun", "matplotlib", "filterpy", "scipy.stats", "scipy.optimize", "pandas"}
    assert not loaded & heavy


def test_a_terminated_run_ends_like_an_interrupted_one(here):
    code = (
        "import sys, time; from bench import pipeline; from bench.cli.command_line import main\n"
        "def fly(*a, **k):\n    print('flying', flush=True); time.sleep(60)\n"
        "pipeline.steps.fly = fly; sys.exit(main(['run', 'short.toml']))"
    )
    process = python(code, cwd=here)
    assert "flying\n" in (process.stdout.readline() for _ in range(5))
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=30)
    assert (process.returncode, err.strip()) == (130, "error: interrupted")
    assert left(here) == []


# --- the viewer ---------------------------------------------------------------------------------------


def write_summary(folder: Path) -> None:
    profile = {"title": "x", "evaluation": {"from_s": 0.0, "output_hz": 10.0}}
    summary = {"format": 2, "profile": profile, "seed": 1, "run": 0, "metrics": {}, "provenance": {}}
    (folder / "result.json").write_text(json.dumps(summary))


def test_cache_shows_its_size_and_is_emptied(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv("BENCH_CACHE", str(tmp_path))
    (tmp_path / "truth" / "a").mkdir(parents=True)
    (tmp_path / "truth" / "a" / "lla.npy").write_bytes(bytes(3_000_000))
    for arguments, line in (
        ((), "1 flights, 0.003 GB"),
        (["--limit", "1"], "1 flights"),
        (["--empty"], "0 flights"),
    ):
        status, out, _ = say(capsys, "cache", *arguments)
        assert status == 0
        assert f"{tmp_path / 'truth'}: {line}" in out
        assert "limit: 2 GB, set by BENCH_CACHE_GB" in out
    assert list((tmp_path / "truth").iterdir()) == []


def test_view_takes_the_newest_recording(here):
    for age, name in enumerate(("b", "c", "a")):
        folder = here / "runs" / name
        folder.mkdir(parents=True)
        write_summary(folder)
        os.utime(folder / "result.json", (1e9 - age, 1e9 - age))
        if name != "b":
            (folder / "flight.rrd").touch()
    assert viewer.find_recording(None) == Path("runs/c/flight.rrd")
    assert viewer.find_recording(Path("runs/a")) == Path("runs/a/flight.rrd")


@pytest.mark.parametrize(
    ("name", "content", "line"),
    [
        ("a.rrd", b"RIFF", "a.rrd: is not a rerun recording. Give a .rrd file or a results folder"),
        ("a.rrd", b"", "a.rrd: is not a rerun recording. Give a .rrd file or a results folder"),
        ("b.rrd", None, "b.rrd: no such file or folder"),
    ],
)
def test_view_takes_a_recording_by_its_file(here, capsys, monkeypatch, name, content, line):
    """A file that is none is rejected in one line; a recording need not be in a results folder."""
    if content is not None:
        (here / name).write_bytes(content)
    status, _, err = say(capsys, "view", name)
    assert (status, err) == (2, f"error: {line}\n")
    with rr.RecordingStream("bench") as stream:
        stream.save(str(here / "fixes.rrd"))
        stream.log("x", rr.Scalars(1.0))
    started = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(viewer, "wait_for", lambda command: started.append(command) or 0)
    assert say(capsys, "view", "fixes.rrd")[0] == 0
    assert started[0][1] == "fixes.rrd"


def test_no_display_and_no_viewer_are_status_4(here, capsys, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    status, _, err = say(capsys, "run", "short.toml", "--view")
    assert (status, err) == (
        4,
        "error: no display for a window; 'bench view --web' serves the recording to a browser\n",
    )
    assert (here / "runs/short-5/flight.rrd").is_file()
    monkeypatch.setattr(viewer, "find_spec", lambda name: None)
    status, _, err = say(capsys, "view")
    assert status == 4
    assert err.startswith("error: no viewer found in the package rerun-sdk")


def test_a_viewer_that_fails_is_status_4(here, capsys, monkeypatch):
    (here / "runs/a").mkdir(parents=True)
    write_summary(here / "runs/a")
    (here / "runs/a/flight.rrd").touch()
    monkeypatch.setattr(viewer, "find_viewer", lambda: Path("/bin/false"))
    status, _, err = say(capsys, "view", "runs/a", "--web")
    assert status == 4
    assert re.match(r"error: the viewer ended with status 1: /bin/false http://127.0.0.1:\d+/", err)
    assert "--bind 127.0.0.1" in err


def test_the_viewer_ends_with_its_children(here):
    """Ctrl-C on bench ends the whole process group of the viewer, a child that ignores it included."""
    child = (
        "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN)\n"
        "print('up', flush=True); time.sleep(60)"
    )
    viewer = (
        f"import subprocess, sys; child = subprocess.Popen([sys.executable, '-c', {child!r}])\n"
        "print(child.pid, flush=True); child.wait()"
    )
    code = (
        "import sys; from bench.cli.verbs import viewer; viewer.PATIENCE = 0.2\n"
        f"viewer.wait_for([sys.executable, '-c', {viewer!r}])"
    )
    process = python(code, cwd=here)
    lines = [process.stdout.readline().strip() for _ in range(2)]
    assert "up" in lines
    (child,) = (int(line) for line in lines if line != "up")
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=60)
    assert _all_end([child])


@pytest.mark.parametrize("killed", ["bench", "its parent"])
def test_the_viewer_ends_when_bench_or_its_parent_is_killed(here, killed):
    child = "import os, time; print(os.getpid(), flush=True); time.sleep(60)"
    bench_view = (
        "import os, sys; from bench.cli.verbs import viewer; print(os.getpid(), flush=True)\n"
        f"viewer.wait_for([sys.executable, '-c', {child!r}])"
    )
    code = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {bench_view!r}])"
    process = python(code, cwd=here)
    pids = [int(process.stdout.readline()) for _ in range(2)]
    os.kill(pids[0] if killed == "bench" else process.pid, signal.SIGKILL)
    process.wait(30)
    assert _all_end(pids)
    process.communicate()


def _all_end(pids: list[int]) -> bool:
    """Wait until none of the processes runs; they would by themselves for a minute."""
    until = time.monotonic() + 40.0  # of a busy machine; it takes a tenth of a second
    while any(map(is_running, pids)):
        if time.monotonic() > until:
            return False
        time.sleep(0.1)
    return True


def test_web_serves_on_this_machine_only_and_ends(here, capsys):
    assert say(capsys, "run", "short.toml")[0] == 0
    process = python(
        "import sys; from bench.cli.command_line import main; sys.exit(main(['view', '--web']))", cwd=here
    )
    line = process.stdout.readline()
    page, port = (int(text) for text in re.findall(r"127\.0\.0\.1(?::|%3A)(\d+)", line))
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    for _ in range(100):
        try:
            with opener.open(f"http://127.0.0.1:{page}/", timeout=5) as answer:
                assert answer.status == 200
            break
        except OSError:
            time.sleep(0.1)
    else:
        pytest.fail("nothing is served")
    assert page == port
    with opener.open(f"http://127.0.0.1:{page}/flight.rrd", timeout=5) as answer:
        assert answer.read() == (here / "runs/short-5/flight.rrd").read_bytes()
    for hosts in (["evil.example"], [f"evil.example:{page}"], [], [f"127.0.0.1:{page}", "evil.example"]):
        for path in ("/flight.rrd", "/", "//flight.rrd"):
            answer = ask(page, path, hosts)
            assert answer.startswith(b"HTTP/1.0 403 ")
            assert answer.endswith(b"\r\n\r\n")
            assert len(answer) < 100
    assert ask(page, "/flight.rrd", [f"localhost:{page}"]).startswith(b"HTTP/1.0 200 ")
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=60)
    assert process.returncode == 130
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", page)) != 0


def ask(port: int, path: str, hosts: list[str]) -> bytes:
    """Send a raw request with these headers ``Host`` and return the whole answer."""
    with socket.create_connection(("127.0.0.1", port), timeout=10) as raw:
        lines = [f"GET {path} HTTP/1.1", *(f"Host: {host}" for host in hosts), "", ""]
        raw.sendall("\r\n".join(lines).encode())
        return b"".join(iter(lambda: raw.recv(1 << 16), b""))


def test_small_matrices_wake_no_threads(monkeypatch):
    """OpenBLAS with threads takes 300 times as long for the 6 x 6 matrices of the turbulence."""
    code = "import os, runpy, sys; sys.argv = ['bench', '--version']\n"
    code += "try: runpy.run_module('bench', run_name='__main__')\n"
    code += "finally: print(os.environ['OPENBLAS_NUM_THREADS'])"
    for given, meant in ((None, "1"), ("3", "3")):
        monkeypatch.delenv("OPENBLAS_NUM_THREADS", raising=False)
        if given:
            monkeypatch.setenv("OPENBLAS_NUM_THREADS", given)
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
        assert done.stdout.split()[-1] == meant
