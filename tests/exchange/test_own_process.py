"""A filter class of others takes nothing with it: no results, streams, folders, or other filters."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import bench
from bench import pipeline
from bench.core.records.data import InitialState, SensorData
from bench.core.records.fields import Record
from bench.core.records.specs import EstimatorChoice, Guard
from bench.core.words.exceptions import (
    ConfigError,
    EstimatorError,
    EstimatorFailedError,
    EstimatorStoppedError,
)
from bench.experiments.campaigns.plan import plan_runs
from bench.io.config import read_profile
from bench.io.foreign import filter_process, filter_server
from bench.io.foreign.record_messages import RecordMessage, read_message
from bench.simulation import sensors
from tests.builders import assert_same_solution, is_running
from tests.cli.test_cli import PROFILE
from tests.synthetic import turning

HERE = Path(__file__).parent
HARMLESS = ("Stays", "Prints", "LeavesThread", "MovesAway", "Searches", "Patches", "ExitsWhenCompared")
STOPPED = {
    "Hangs": r"stopped after 4 s \(--timeout\)",
    "Exits": "its process ended with exit status 0",
    "ExitsLeavingChild": "its process ended with exit status 3",
    "Crashes": "its process ended by signal SIGSEGV",
    "Hogs": r"stopped: 0\.\d+ GB of memory, more than 0\.5 GB \(--memory\)",
    "AnswersTooMuch": r"stopped: its solution is larger than 20 MB \(--output\)",
}
"""Filter -> why it has no solution."""


def wait_for(holds: Any, seconds: float = 60.0) -> bool:
    """Wait until something holds, however busy the machine; return whether it does."""
    end = time.monotonic() + seconds
    while not (found := holds()) and time.monotonic() < end:
        time.sleep(0.02)
    return bool(found)


@pytest.fixture(scope="module")
def place(tmp_path_factory) -> Iterator[Path]:
    """A folder to stand in, with the filters, a short profile, and the results of one run of all of them."""
    folder = tmp_path_factory.mktemp("attacked")
    shutil.copy(HERE / "attacks.py", folder)
    (folder / "short.toml").write_text(PROFILE)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("BENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        patch.chdir(folder)
        patch.syspath_prepend(str(folder))
        yield folder


def run_bench(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "bench", *arguments]
    environment = os.environ | {"PYTHONPATH": str(Path(bench.__file__).parents[1])}
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)


@pytest.fixture(scope="module")
def ran(place) -> subprocess.CompletedProcess[str]:
    uses = [word for name in (*HARMLESS, *STOPPED) for word in ("-e", f"attacks:{name}")]
    limits = ["--timeout", "4", "--memory", "0.5", "--output", "20"]
    rest = ["-e", "gnss-only", *limits, "--json", "--no-rrd", "--no-report", "-o", "all"]
    return run_bench("run", "short.toml", *uses, *rest)


@pytest.mark.parametrize(("answers", "asked"), [([[]] * 9, 3), ([[], [(3, 1)]], 2)])
def test_who_waits_stays_awake_for_a_millisecond(monkeypatch, answers, asked):
    """Asks at 7.0 s and each 0.4 ms from then on, until something is there or the millisecond is over."""
    clock, seen = iter(7.0 + 0.0004 * np.arange(9)), []
    monkeypatch.setattr(filter_server, "time", SimpleNamespace(perf_counter=clock.__next__))
    poll = SimpleNamespace(poll=lambda _: seen.append(answers[len(seen)]) or seen[-1])
    assert filter_server.watch(poll) == answers[-1]
    assert len(seen) == asked


@pytest.mark.parametrize("in_process", [False, True])
def test_sensors_are_refused_before_the_flight(place, monkeypatch, in_process):
    """By a class in its own process or here; what is documented as optional is asked for in both."""
    monkeypatch.setattr(pipeline.steps, "fly", None)  # it fails before anything flies
    guard = Guard(in_process=in_process)
    for least, error, why in (
        (1.0, EstimatorError, r"^filter 'RefusesMems': no matched-mems for me$"),
        (
            -1.0,
            EstimatorFailedError,
            r"^filter 'RefusesMems': check_sensors\(\) raised ArithmeticError: no root$",
        ),
    ):
        profile = read_profile("short.toml", estimators=["attacks:RefusesMems"], guard=guard)
        choice = replace(profile.estimators[0], options={"least": least})
        with pytest.raises(error, match=why):
            pipeline.run(replace(profile, estimators=(choice,)))


def test_every_optional_method_of_the_guide_is_offered():
    text = (Path(bench.__file__).parent / "guide" / "filter-protocol.md").read_text()
    assert set(re.findall(r"^\| `(\w+)\([^`]*\)`, optional", text, re.MULTILINE)) == set(filter_server.OFFERS)


# --- what filters do to a run -------------------------------------------------------------------------


def test_each_attack_is_a_row_beside_the_others(place, ran):
    metrics = json.loads(ran.stdout)  # what a filter prints is not in it
    assert ran.returncode == 1
    for name in HARMLESS:
        assert metrics[name]["output_coverage"] == 1.0, (name, metrics[name]["reason"])
    for name, why in STOPPED.items():
        assert re.fullmatch(f"failed: {why}", metrics[name]["reason"]), metrics[name]["reason"]
        assert "traceback" not in metrics[name]
    assert metrics["gnss-only"]["converged"]
    loaded = bench.read_result(place / "all")  # and not where a filter has moved to
    assert set(loaded.solutions) == {*HARMLESS, *STOPPED, "gnss-only"}


def test_what_they_leave_behind_has_ended(place, ran):
    assert wait_for(lambda: not is_running(int((place / "hangs.pid").read_text())))
    assert wait_for(lambda: not is_running(int((place / "child.pid").read_text())))
    assert not list(place.glob(".bench-*"))


def test_another_filter_gets_what_it_gets_alone(place, ran):
    alone = bench.run("short.toml", estimators=["gnss-only"])
    after = bench.read_result(place / "all")
    assert_same_solution(after.solutions["gnss-only"], alone.solutions["gnss-only"])
    assert after.metrics["gnss-only"]["pos_rmse_h_m"] == alone.metrics["gnss-only"]["pos_rmse_h_m"]


def test_what_they_print_is_in_a_file_of_the_results(place, ran):
    assert len(ran.stderr) < 50_000
    printed = (place / "all/printed-Prints.txt").read_text()
    assert printed.startswith("the first line\nxxx")
    assert printed.endswith("x\n�\nthe last line\n")
    assert re.search(r"x\n\[199\d{6} bytes left out\]\nx", printed)
    assert len(printed) < 1_100_000
    assert "printed-Prints.txt" in ran.stderr
    for name, line in (("Hangs", "time.sleep"), ("Crashes", "string_at")):  # where it was
        assert "in act" in (place / f"all/printed-{name}.txt").read_text(), line
    assert not (place / "all/printed-Stays.txt").exists()
    assert bench.read_result(place / "all").records["printed"]["Prints"] == printed


def test_what_raises_keeps_its_traceback(place):
    uses = ["-e", "attacks:Raises", "-e", "attacks:Interrupts", "-e", "attacks:Writes", "-e", "gnss-only"]
    ran = run_bench("run", "short.toml", *uses, "--json", "--no-rrd", "--no-report", "-o", "raised")
    assert ran.returncode == 70
    metrics = json.loads(ran.stdout)
    assert metrics["Raises"]["reason"] == "failed: run() raised ArithmeticError: what was not to be"
    assert 'raise ArithmeticError("what was not to be")' in metrics["Raises"]["traceback"]
    assert 'raise ArithmeticError("what was not to be")' in ran.stderr
    assert metrics["Interrupts"]["reason"] == "failed: run() raised KeyboardInterrupt"
    assert "cannot set WRITEABLE flag" in metrics["Writes"]["reason"]
    assert metrics["gnss-only"]["converged"]


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("SaysTooMuch", r"run\(\) raised ValueError: no  no .*"),
        ("TakesRowsAway", r".*: NavSolution: columns differ in length: .*'cov': 3, "),
        ("PutsObjects", r".*: NavSolution.vel_n must be an array of float; got an array of object"),
    ],
)
def test_what_cannot_be_sent_is_a_failure_at_once(sensed, name, why):
    """Not a wait for what never comes, nor the memory of objects taken for numbers."""
    one = pipeline.build_estimator(EstimatorChoice(f"attacks:{name}", name, guard=Guard(timeout=60.0)))
    begun = time.process_time()
    with pytest.raises(EstimatorFailedError, match=why) as caught:
        one.run(sensed.data, sensed.initial)
    assert len(str(caught.value)) < 1000
    assert len(str(caught.value.__cause__)) < 300_000
    assert time.process_time() - begun < 5.0


def test_in_process_is_for_a_debugger_and_says_that_nothing_is_guarded(place):
    arguments = ["run", "short.toml", "-e", "attacks:Stays", "--in-process", "--no-rrd", "-o", "here"]
    ran = run_bench(*arguments)
    assert ran.stderr.splitlines()[0] == "Classes of yours run in this process: nothing is guarded."
    (extra,) = {tuple(row) for row in bench.read_result(place / "here").solutions["Stays"].extra}
    assert not is_running(int(extra[0]))
    choice = EstimatorChoice("attacks:Stays", "Stays", guard=Guard(in_process=True))
    assert type(pipeline.build_estimator(choice)).__name__ == "Stays"


@pytest.mark.parametrize(
    ("name", "number"),
    [("Hangs", signal.SIGINT), ("HangsInC", signal.SIGTERM), ("HangsInC", signal.SIGKILL)],
)
def test_it_ends_with_bench_however_that_ends(place, name, number):
    (place / "hangs.pid").unlink(missing_ok=True)
    command = [sys.executable, "-m", "bench", "run", "short.toml", "-e", f"attacks:{name}", "-o", "ended"]
    environment = os.environ | {"PYTHONPATH": str(Path(bench.__file__).parents[1])}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as child:
        file = place / "hangs.pid"
        assert wait_for(lambda: file.exists() and file.read_text())
        child.send_signal(number)
        _, said = child.communicate(timeout=60)
    assert wait_for(lambda: not is_running(int(file.read_text())))
    if number != signal.SIGKILL:
        assert (child.returncode, said.strip()) == (130, "error: interrupted")
    assert not (place / "ended").exists()


# --- its process --------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sensed(place) -> Any:
    """Three minutes of sensors: more than goes by a socket."""
    profile = read_profile("figure-eight")
    return sensors.sense(turning(180.0, 100.0), profile.sensors, 4, 0)


def navigate(sensed, name: str, options: Any = None, guard: Guard | None = None) -> Any:
    return bench.run_filter(f"attacks:{name}", sensed.data, sensed.initial, options, guard or Guard())


def test_a_process_is_kept_and_every_run_gets_a_new_instance(sensed):
    found = [navigate(sensed, "Stays").extra[0] for _ in range(3)]
    pid, _, before, _ = found[0]
    assert [row[:3].tolist() for row in found] == [[pid, 1, before + k] for k in range(3)]
    other = navigate(sensed, "Stays", {"shift": 2.0}).extra[0]  # with other options it is another filter
    assert other[0] != pid
    assert other[3] == 2.0


def test_it_is_started_again_after_a_limit_and_after_a_change(place, sensed):
    with pytest.raises(EstimatorStoppedError, match=r"^filter 'attacks:Exits': its process ended with"):
        navigate(sensed, "Exits")
    one = pipeline.build_estimator(EstimatorChoice("attacks:Crashes", "x"))
    for _ in range(2):
        with pytest.raises(EstimatorStoppedError, match=r"^filter 'x': its process ended by signal"):
            one.run(sensed.data, sensed.initial)
    (place / "changing.py").write_text("from attacks import Stays\nclass Mine(Stays):\n    pass\n")
    choice = EstimatorChoice("changing:Mine", "Mine")
    first = pipeline.navigate(choice, sensed.data, sensed.initial)
    (place / "changing.py").write_text(
        "from attacks import Stays\nclass Mine(Stays):\n    def act(self, sensors): self.shift = 7.0\n"
    )
    second = pipeline.navigate(choice, sensed.data, sensed.initial)
    assert (first.extra[0, 3], second.extra[0, 3]) == (0.0, 7.0)


def test_a_record_is_a_map_that_only_can_be_read(sensed):
    assert RecordMessage(sensed.data).size > 500_000
    with pytest.raises(EstimatorStoppedError, match="its process ended by signal SIGSEGV"):
        navigate(sensed, "WritesToMap")


def test_processes_that_nobody_waits_for_end(sensed, monkeypatch):
    monkeypatch.setattr(filter_process, "MOST_KEPT", 2)
    pids = [int(navigate(sensed, "Stays", {"shift": float(k)}).extra[0, 0]) for k in range(3)]
    assert [is_running(pid) for pid in pids] == [False, True, True]


def test_options_that_cannot_be_sent_are_told(sensed):
    with pytest.raises(EstimatorError, match=r"its options cannot be sent .*Guard\(in_process=True\)"):
        navigate(sensed, "Stays", {"shift": lambda: 0.0})


@pytest.mark.parametrize("wrong", [{"timeout": 0.0}, {"memory": -1.0}, {"output": None}, {"timeout": np.nan}])
def test_a_limit_is_a_number_above_zero(wrong):
    with pytest.raises(ConfigError, match=rf"Guard: {next(iter(wrong))} = .* must be a number above 0"):
        Guard(**wrong)


def test_the_time_limit_is_at_least_that_of_the_flight():
    assert Guard().choose_timeout(90.0) == 600.0
    assert Guard().choose_timeout(36_000.0) == 36_000.0
    assert Guard(timeout=5.0).choose_timeout(36_000.0) == 5.0


def test_a_profile_may_set_the_time_limit_and_the_command_line_wins(place):
    table = "[[estimator]]\nuse = 'attacks:Stays'\ntimeout_s = 40.0\n"
    (place / "limited.toml").write_text(PROFILE + table)

    def read(guard: Guard = Guard(), **options: Any) -> Any:  # noqa: B008
        return read_profile("limited.toml", allow_code=True, guard=guard, **options)

    built_in, own = read().estimators
    assert built_in.guard == Guard()
    assert own.guard == Guard(timeout=40.0)
    assert read().document["estimator"][1]["timeout_s"] == 40.0
    assert read(Guard(timeout=3.0, memory=1e9)).estimators[1].guard == Guard(timeout=3.0, memory=1e9)
    with pytest.raises(ConfigError, match="timeout_s has no effect: it is for a class of yours or a program"):
        read(overrides={"estimator.1.timeout_s": 5.0})


def test_an_object_is_no_name():
    with pytest.raises(ConfigError, match=r"filter <object .*> is no name; give 'module:Class'"):
        bench.run("figure-eight", estimators=[object()])  # type: ignore[list-item]


def test_many_runs_say_nothing_on_the_streams_and_lose_no_other_filter(place, capfd):
    uses = ["attacks:Prints", "attacks:Exits", "gnss-only"]
    found = bench.campaign("short.toml", 2, estimators=uses, jobs=1, out="many")
    assert capfd.readouterr() == ("", "")
    assert found.failed == {}
    rates = {one.label: one.converged.value for one in found.outcomes}
    assert (rates["Exits"], rates["gnss-only"]) == (0.0, 1.0)
    printed = (place / "many/printed.txt").read_text()
    assert printed.startswith("--- Prints: bench run short.toml -e attacks:Prints")
    assert printed.count("the first line\n") == printed.count("the last line\n") == 2
    assert len(printed) < 30_000  # of 400 MB
    bench.campaign("short.toml", 3, estimators=uses, jobs=1, out="many", resume=True)
    assert (place / "many/printed.txt").read_text().startswith(printed)
    limited = plan_runs("short.toml", 1, estimators=["attacks:Stays"], guard=Guard(9.0))
    assert limited.cells[0].repeat(0).endswith("--timeout 9 --seed 5 --run 0")


# --- in pieces ----------------------------------------------------------------------------------------


def feed_all(sensed, guard: Guard, tmp_path: Path) -> list[Any]:
    """What a filter answers in pieces, between them, after a stop, and at its end."""
    data = sensed.data
    filter_ = bench.open_filter("attacks:Walks", sensed.initial, guard=guard)
    found = [filter_.update(bench.slice_sensors(data, -np.inf, 1.0)), filter_.current()]
    early = filter_.copy()
    found += [filter_.update(bench.slice_sensors(data, 1.0, 1.01)), filter_.current(), filter_.current()]
    found.append(early.update(bench.slice_sensors(data, 1.0, 90.0)))  # which knows nothing of that
    filter_ = bench.read_filter(bench.write_filter(filter_, tmp_path / "stopped.npz"), allow_code=True)
    found.append(filter_.update(bench.slice_sensors(data, 1.01, np.inf)))
    return [*found, filter_.finish()]


def test_in_pieces_it_says_what_it_says_here(sensed, tmp_path):
    here = feed_all(sensed, Guard(in_process=True), tmp_path)
    apart = feed_all(sensed, Guard(), tmp_path)
    for one, other in zip(here, apart, strict=True):
        assert_same_solution(one, other)
    assert here[-2].extra[-1, 0] == len(sensed.data.imu)


def test_what_raises_in_a_piece_leaves_the_filter_as_it_was(sensed):
    filter_ = bench.open_filter("attacks:Walks", sensed.initial, look_back=101.0)
    with pytest.raises(EstimatorFailedError, match=r"update\(\) raised ArithmeticError: too far"):
        filter_.update(bench.slice_sensors(sensed.data, -np.inf, 1.0))
    filter_.look_back = 1.0
    assert filter_.update(bench.slice_sensors(sensed.data, -np.inf, 1.0)).extra[-1, 0] == 100.0


# --- what goes between --------------------------------------------------------------------------------


def test_records_arrive_as_they_were(sensed):
    """Those of every instrument, with rows and without, in columns of any width."""
    spec = read_profile(
        "figure-eight",
        {f"sensors.{kind}": name for kind, name in (("gnss", "sky-l1"), ("mag", "rm3100"))},
    ).sensors
    drawn = sensors.sense(turning(5.0, 100.0), spec, 4, 0)
    assert drawn.data.observations is not None
    unknown = replace(drawn.initial, alignment="level", q_nb=np.full(4, np.nan))
    empty = bench.slice_sensors(drawn.data, -2.0, -1.0)
    words = ["ü", None, True, 1.5, np.inf, 2**70, {"a": (1, 2)}]
    sent = {"records": [drawn.data, empty, unknown], "words": words}
    message = RecordMessage(sent)
    body = np.frombuffer(b"".join(message.parts), np.uint8)
    found = read_message(message.text, body, drawn.data.specs)
    assert found["words"] == ["ü", None, True, 1.5, np.inf, 2**70, {"a": [1, 2]}]
    for one, other in zip(sent["records"], found["records"], strict=True):
        assert_same_record(one, other)
    with pytest.raises(ValueError, match="bytes"):
        read_message(message.text, body[: body.size // 16 * 8], drawn.data.specs)


def assert_same_record(one: Any, other: Any) -> None:
    assert type(one) is type(other)
    if not isinstance(one, Record | SensorData | InitialState):
        assert one == other
        return
    for field in fields(one):
        a, b = getattr(one, field.name), getattr(other, field.name)
        if isinstance(a, np.ndarray):
            assert (a.dtype, a.flags.c_contiguous) == (b.dtype, b.flags.c_contiguous)
            assert not b.flags.writeable
            assert_array_equal(a, b)
        elif field.name != "specs":
            assert_same_record(a, b)
