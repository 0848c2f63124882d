"""The parts of a journal: rows are read back as they were, damage is a repeated run or a line."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import bench
from bench.core.words.exceptions import ConfigError
from bench.experiments.campaigns import groups, parts, running
from bench.experiments.campaigns.campaign_tables import EPOCHS, RUNS
from bench.experiments.campaigns.journal import NAME, Journal
from bench.experiments.campaigns.plan import EveryRun, Plan, PlannedRun
from bench.experiments.campaigns.pools import SerialExecutor
from bench.experiments.campaigns.worker import CHANNELS, choose_step, encode
from bench.io.results import row_parts
from tests.campaigns import million_rows
from tests.campaigns.test_campaign import PROFILE
from tests.campaigns.test_parts import make_row


@pytest.fixture(autouse=True)
def small(monkeypatch) -> None:
    monkeypatch.setattr(parts, "ROWS", 3)


def list_rows() -> list[dict[str, Any]]:
    """Rows with values of every kind, in an order of their own, and keys with and without numbers."""
    rng = np.random.default_rng(2)
    kinds: list[dict[str, Any]] = [
        {"b/c~": 1, "mixed": 2, "none": None, "words": "ä"},
        {"words": None, "mixed": 2.5, "b/c~": 2},
        {"list": [1.5, 2.0], "mixed": "2", "deep": {"x": True, "y": {}}},
        {"list": [], "huge": 2**70, "empty": "", "small": -0.0},
        {"none": None},
    ]
    rows = [
        make_row(
            f"cell-{k}", metrics=one, instants=encode(rng.normal(size=(k, len(CHANNELS)))),
            repetition={"baro": [1.0, 2.0, float(k)], "gnss": []},
        )
        for k, one in enumerate(kinds)
    ]  # fmt: skip
    return [*rows[:2], {"key": "cell-7", "error": "why"}, *rows[2:], make_row("no number"), make_row("a-01")]


def fill(folder: Path, rows: list[dict[str, Any]]) -> None:
    with Journal(folder / NAME) as journal:
        for row in rows:
            journal.append(row)


def test_rows_are_read_back_from_parts_as_they_were_written(tmp_path):
    rows = list_rows()
    fill(tmp_path, rows)
    assert parts.list_parts(tmp_path) == ["journal-00001.parquet", "journal-00002.parquet"]
    assert len((tmp_path / NAME).read_bytes().splitlines()) == 2
    with Journal(tmp_path / NAME) as journal:
        assert journal.damaged == 0
        for row in rows:
            back = journal[row["key"]]
            assert back == row
            for one, own in zip(
                back.get("estimators", {}).values(), row.get("estimators", {}).values(), strict=True
            ):
                assert json.dumps(one["metrics"]) == json.dumps(own["metrics"])  # with 2 and 2.0, in order
        assert "cell-9" not in journal
        assert "cell-01" not in journal


def test_what_is_missing_is_found_without_the_rows(tmp_path):
    """A run that failed in a part and was repeated since is not missing; one that failed is."""
    fill(tmp_path, [*list_rows(), {"key": "cell-8", "error": "why"}])
    with Journal(tmp_path / NAME) as journal:
        wanted = np.array([0, 1, 4, 7, 8, 9])
        own, other = journal.find_missing([("cell", wanted), ("another", wanted)])
        assert (own.tolist(), other.tolist()) == ([7, 8, 9], wanted.tolist())
        journal.append(make_row("cell-7"))
        journal.append({"key": "cell-9", "error": "why"})
        assert journal.find_missing([("cell", wanted)])[0].tolist() == [8, 9]
        assert "estimators" in journal["cell-7"]
        for k in range(20, 23):
            journal.append(make_row(f"cell-{k}"))
        assert journal.find_missing([("cell", wanted)])[0].tolist() == [8, 9]
        assert "estimators" in journal["cell-7"]


def test_a_driver_that_ended_between_a_part_and_its_lines_goes_on(tmp_path):
    rows = list_rows()[:3]
    (tmp_path / "a").mkdir()
    fill(tmp_path / "a", rows[:2])
    lines = (tmp_path / "a" / NAME).read_bytes()
    fill(tmp_path / "a", rows[2:])
    with Journal(tmp_path / "b") as other:
        other.append(rows[2])
    (tmp_path / "a" / NAME).write_bytes(lines + (tmp_path / "b").read_bytes())
    with Journal(tmp_path / "a" / NAME) as journal:
        assert (tmp_path / "a" / NAME).stat().st_size == 0
        assert [journal[row["key"]] for row in rows] == rows
        journal.append(make_row("new"))
    assert len(parts.list_parts(tmp_path / "a")) == 1


def test_an_old_journal_of_many_lines_is_read_and_becomes_parts(tmp_path, monkeypatch):
    rows = list_rows()
    monkeypatch.setattr(parts, "ROWS", 100)
    fill(tmp_path, rows)
    assert parts.list_parts(tmp_path) == []
    monkeypatch.setattr(parts, "ROWS", 3)
    with Journal(tmp_path / NAME) as journal:
        assert [journal[row["key"]] for row in rows] == rows
        journal.append(make_row("new"))
        assert [journal[row["key"]] for row in rows] == rows
    assert len(parts.list_parts(tmp_path)) == 3
    assert (tmp_path / NAME).stat().st_size == 0


def test_a_damaged_part_is_repeated_or_named(tmp_path):
    """Without its end nothing of it is known; a wrong byte is seen by the checksum of its page."""
    fill(tmp_path, list_rows())
    path = tmp_path / "journal-00001.parquet"
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    with Journal(tmp_path / NAME) as journal:
        assert journal.damaged == 1
        assert [key in journal for key in ("cell-0", "cell-7", "cell-2")] == [False, False, True]
        for k in range(3):
            journal.append(make_row(f"cell-{k}"))
    assert path.read_bytes() == whole[:-20]  # nothing is written over it
    at = whole.index(b"why")
    path.write_bytes(whole[:at] + b"Why" + whole[at + 3 :])
    with (
        Journal(tmp_path / NAME) as journal,
        pytest.raises(ConfigError, match=r"00001.parquet: damaged; remove it"),
    ):
        journal["cell-7"]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no pipes in folders")
def test_a_pipe_in_place_of_a_file_is_refused_and_not_waited_for(tmp_path):
    for name in (NAME, "journal-00001.parquet"):
        path = tmp_path / name
        os.mkfifo(path)
        with pytest.raises(ConfigError, match=rf"{name}: not a regular file"):
            Journal(tmp_path / NAME)
        path.unlink()
        path.symlink_to("/dev/zero")
        with pytest.raises(ConfigError, match=rf"{name}: (not a regular file|is a link)"):
            Journal(tmp_path / NAME)
        path.unlink()


def test_a_part_of_a_stranger_with_a_row_that_no_run_writes_is_named(tmp_path):
    row_parts.write_part(
        tmp_path / "journal-00001.parquet", [make_row("cell-0", metrics={"pos_rmse_h_m": "1"})]
    )
    with Journal(tmp_path / NAME) as journal, pytest.raises(ConfigError, match="damaged; remove it"):
        journal["cell-0"]
    row_parts.write_part(tmp_path / "journal-00001.parquet", [make_row(f"cell-{k}") for k in range(4)])
    with Journal(tmp_path / NAME) as journal:
        assert journal.damaged == 1  # larger than a part


def test_runs_of_other_estimators_in_parts_are_forgotten(tmp_path):
    rows = [{"key": "lost", "error": "why"}, make_row("c-1"), make_row("c-2", label="y"), make_row("c-3")]
    fill(tmp_path, rows)
    with Journal(tmp_path / NAME) as journal:
        assert journal.find_labels() == ("x",)
        journal.keep_runs_of(["x"])
        assert [row["key"] in journal for row in rows] == [True, True, False, True]
        assert journal.damaged == 1


def test_every_run_of_a_plan_is_made_when_it_is_asked_for():
    every = EveryRun(3, 2)
    listed = [PlannedRun(k, run) for k in range(3) for run in range(2)]
    assert list(every) == listed
    assert (len(every), every[-1], list(every[1:3])) == (6, listed[-1], listed[1:3])
    with pytest.raises(IndexError):
        every[6]
    for runs in (every, listed):
        found = Plan("p", (), (), runs).number_runs()
        assert {cell: one.tolist() for cell, one in found.items()} == {k: [0, 1] for k in range(3)}


@pytest.mark.parametrize("duration", [3.0, 20.0, 60.0, 601.0, 7200.0])
def test_the_epochs_of_many_runs_are_among_those_of_few(duration):
    few, many = choose_step(duration, 4.0), choose_step(duration, 4.0, many=True)
    assert many / few == pytest.approx(round(many / few))
    assert int(duration / many) <= 50
    assert many == few or int(duration / many) > 25


# --- a campaign that is killed twice ----------------------------------------------------------------------

KILLED = """
import os, signal, sys, bench
from bench.experiments.campaigns import groups, parts, running
from bench.experiments.campaigns.pools import SerialExecutor

runs, at, parts.ROWS, groups.MOST_EXACT = map(int, sys.argv[1:])
running.MOST_EXACT = groups.MOST_EXACT

def kill(progress):
    if progress.done == at:
        os.kill(os.getpid(), signal.SIGKILL)

bench.campaign("short.toml", runs, estimators=["loose-15"], out="killed", executor=SerialExecutor(),
               resume=True, progress=kill)
"""


def kill_twice(runs: int, size: int, most: int) -> bench.Campaign:
    """Kill a campaign in its first part and later, go on with it, and compare it with one that was not."""
    options: dict[str, Any] = {"estimators": ["loose-15"], "executor": SerialExecutor()}
    for at in (size + size // 2, 6 * runs // 7):
        words = map(str, (runs, at, size, most))
        done = subprocess.run([sys.executable, "-c", KILLED, *words], check=False)
        assert done.returncode == -signal.SIGKILL
        assert len(parts.list_parts(Path("killed"))) == at // size
    seen: list[Any] = []
    bench.campaign("short.toml", runs, out="killed", resume=True, progress=seen.append, **options)
    assert seen[0].done == at
    whole = bench.campaign("short.toml", runs, out="whole", **options)
    for name in (RUNS, EPOCHS):
        assert (Path("whole") / name).read_bytes() == (Path("killed") / name).read_bytes()
    return whole


def test_after_two_kills_with_parts_resume_gives_the_same_tables(tmp_path, monkeypatch):
    """With so many runs that each keeps few epochs."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(parts, "ROWS", 1000)
    monkeypatch.setattr(groups, "MOST_EXACT", 4)
    monkeypatch.setattr(running, "MOST_EXACT", 4)
    Path("short.toml").write_text(PROFILE.replace("duration_s = 20.0", "duration_s = 12.0"))
    assert kill_twice(14, 5, 4).epochs.num_rows == 40
    options: dict[str, Any] = {"estimators": ["loose-15"], "executor": SerialExecutor()}
    bench.campaign("short.toml", 2, out="killed", force=True, **options)
    assert parts.list_parts(Path("killed")) == []


@pytest.mark.long
def test_after_two_kills_many_runs_of_a_minute_have_the_same_tables(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(parts, "ROWS", 1000)
    Path("short.toml").write_text(million_rows.MINUTE)
    assert kill_twice(20_000, parts.ROWS, groups.MOST_EXACT).runs.num_rows == 20_000


@pytest.mark.long
def test_a_million_finished_runs_are_gone_on_with_in_flat_memory():
    """At most 3 kB a run on the disk, and 0.1 kB in memory; the seconds are in its output."""
    million, fewer = million_rows.main(1_000_000)
    assert million["bytes_a_run"] < 3000.0
    assert million["MB"] - fewer["MB"] < 90.0
