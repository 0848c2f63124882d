"""A campaign is the runs of `bench run`, whoever computes them and in whatever order."""

from __future__ import annotations

import errno
import html
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from rich.console import Console
from scipy import stats

import bench
from bench.cli.command_line import main
from bench.cli.verbs import record_verbs
from bench.core.words.exceptions import INTERRUPTED, MACHINE, ConfigError
from bench.core.words.wording import format_number
from bench.evaluation.consistency.chi_square import NIS_PROBABILITY, mean_band
from bench.evaluation.ensembles.ensemble import Estimate, compare_rmse
from bench.evaluation.errors.error_series import heading_sd, select_epochs
from bench.evaluation.metrics.metric_words import name_metric
from bench.experiments.campaigns import running
from bench.experiments.campaigns.campaign_tables import EPOCHS, RUNS
from bench.experiments.campaigns.journal import NAME, Journal
from bench.experiments.campaigns.merging import merge_campaigns
from bench.experiments.campaigns.outcome import CampaignStage, Outcome, Pair, compare, pool_nis
from bench.experiments.campaigns.pools import ExecutorPool, SerialExecutor
from bench.experiments.campaigns.worker import CHANNELS, MOST_INSTANTS, choose_step
from bench.views import recording
from bench.views.recording import drawing
from bench.views.report import campaign_page
from bench.views.report.index import find_folders, write_index

PROFILE = """
title = "Short"
aircraft = "aerosonde"
rate_hz = 100
seed = 5
turbulence_seed = 9
duration_s = 20.0
[start]
lat_deg = 47.0
lon_deg = 11.0
alt_m = 1000.0
heading_deg = 10.0
speed_mps = 25.0
[wind]
turbulence = "light"
[[leg]]
kind = "turn"
by_deg = 90.0
bank_deg = 25.0
[sensors]
imu = "matched-mems"
gnss = "l1-code"
[evaluation]
from_s = 5.0
[[estimator]]
use = "loose-15"
[[estimator]]
use = "loose-22"
"""

OPTIONS: dict[str, Any] = {"overrides": {"start.alt_m": 1001.5, "sensors.imu": "adis16475"}, "seed": 8}


@pytest.fixture(scope="module")
def done(tmp_path_factory) -> Path:
    """A campaign of two processes, in a folder beside its profile."""
    place = tmp_path_factory.mktemp("campaign")
    (place / "short.toml").write_text(PROFILE)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(place)
        arguments = ["--runs", "4", "--jobs", "2", "--seed", "8", "-o", "two"]
        arguments += ["--set", "start.alt_m=1001.5", "--set", "sensors.imu=adis16475"]
        assert main(["campaign", "short.toml", *arguments]) == 0
    return place


def campaign(folder: str, runs: int = 4, **options: Any) -> Any:
    return bench.campaign(
        "short.toml", runs, out=folder, **{**OPTIONS, "executor": SerialExecutor(), **options}
    )


def same(a: Path, b: Path) -> bool:
    return all((a / name).read_bytes() == (b / name).read_bytes() for name in (RUNS, EPOCHS))


@pytest.fixture
def here(done, monkeypatch) -> Path:
    monkeypatch.chdir(done)
    return done


def test_the_tables_do_not_depend_on_workers_and_order(here):
    """Two processes, and batches that are worked off backwards."""

    class Turned(SerialExecutor):
        def submit(self, function: Any, /, work: Any, tasks: Any) -> Future[Any]:
            future: Future[Any] = Future()
            future.set_result(function(work, tasks[::-1])[::-1])
            return future

    result = campaign("one", executor=Turned(), jobs=7)
    assert same(here / "two", here / "one")
    assert result.runs.num_rows == 8


def test_each_run_is_repeated_by_the_command_in_its_row(here):
    for row in pq.read_table(here / "two" / RUNS).to_pylist()[2::4]:
        words = shlex.split(row["command"])
        assert words[0] == "bench"
        assert main([*words[1:], "--no-rrd", "--force", "-o", "alone"]) == 0
        found = json.loads((here / "alone" / "result.json").read_text())
        assert (found["seed"], found["run"]) == (row["seed"], row["run"])
        metrics = found["metrics"][row["estimator"]]
        for name, value in row.items():
            if name == "verdict_text":  # that of a run goes on: why
                assert metrics[name].startswith(value.partition(" Worst is")[0])
            elif name in metrics:
                assert metrics[name] == value, name
        assert sum(name in row for name in metrics) > 100
        errors = bench.read_result("alone").errors[row["estimator"]]
        late = errors.t >= 5.0
        assert np.sqrt(np.mean(errors.pos_n[late, 2] ** 2)) == pytest.approx(row["pos_rmse_d_m"])


def test_runs_differ_and_columns_have_units(here):
    table = pq.read_table(here / "two" / RUNS)
    assert table["run"].to_pylist() == [0, 0, 1, 1, 2, 2, 3, 3]
    assert len(set(table["pos_rmse_h_m"].to_pylist())) == 8
    assert table.schema.field("pos_rmse_h_m").metadata[b"unit"] == b"m"
    assert table.schema.field("heading_rmse_deg").metadata[b"unit"] == b"deg"


def list_channels(result: Any, at: int) -> list[float]:
    """What is kept of loose-22 at a time, in the order of `CHANNELS`."""
    one, solution = result.errors["loose-22"], result.solutions["loose-22"]
    k = int(np.argmin(np.abs(solution.t - one.t[at])))
    variance, claimed = (
        np.diag(solution.cov[k]),
        np.rad2deg(heading_sd(select_epochs(solution, np.array([k])))),
    )
    tilt, heading = np.rad2deg(np.hypot(*one.phi_n[at, :2])), np.rad2deg(one.heading[at])
    sds = [np.sqrt(variance[:2].sum()), np.sqrt(variance[2]), claimed[0]]
    return [*one.pos_n[at], *one.vel_n[at], tilt, heading, *sds, one.nees[at]]


def test_epochs_hold_the_statistics_of_the_runs(here):
    table = pq.read_table(here / "two" / EPOCHS)
    rows = [row for row in table.to_pylist() if row["estimator"] == "loose-22"]
    results = [bench.run(bench.read_profile("short.toml", **OPTIONS), run=k) for k in range(4)]
    errors = [one.errors["loose-22"] for one in results]
    for row in (rows[0], rows[-1]):
        at = int(np.argmin(np.abs(errors[0].t - row["t_s"])))
        down = [one.pos_n[at, 2] for one in errors]
        assert row["pos_err_d_m_mean"] == pytest.approx(np.mean(down), rel=1e-5)
        assert row["pos_err_d_m_p95"] == pytest.approx(np.percentile(down, 95), rel=1e-5)
        assert row["nees_mean"] == pytest.approx(np.mean([one.nees[at] for one in errors]), rel=1e-5)
        assert (row["nees_low"], row["nees_high"]) == pytest.approx(mean_band(9, 4, 0.95), rel=1e-6)
        heading = [np.rad2deg(one.heading[at]) for one in errors]
        assert row["heading_err_deg_p50"] == pytest.approx(np.median(heading), rel=1e-5)
        found = np.array([list_channels(one, at) for one in results])
        assert [row[f"{name}_mean"] for name in CHANNELS] == pytest.approx(found.mean(axis=0), rel=1e-5)
    assert rows[-1]["t_s"] == errors[0].t[-1]
    assert table.schema.field("pos_err_d_m_p95").type == "float"
    assert table.schema.field("pos_err_d_m_p95").metadata[b"unit"] == b"m"


@pytest.mark.parametrize(
    ("duration", "rate"),
    [(20.0, 10.0), (60.0, 10.0), (60.1, 10.0), (600.0, 10.0), (600.005, 10.0), (7200.0, 4.0)],
)
def test_at_most_600_instants_are_kept(duration, rate):
    step = choose_step(duration, rate)
    assert MOST_INSTANTS / 2 <= int(duration / step) <= MOST_INSTANTS or step == 1 / rate
    assert step * rate == pytest.approx(round(step * rate))


def test_an_interruption_keeps_what_is_done(here):
    def interrupt(progress: Any) -> None:
        if progress.new == 2:
            raise KeyboardInterrupt

    result = campaign("some", progress=interrupt)
    assert (result.interrupted, result.finished, result.planned) == (True, 2, 4)
    assert pq.read_table("some/runs.parquet").num_rows == 4
    assert not campaign("some", resume=True).interrupted
    assert same(here / "two", here / "some")


def test_an_interrupted_verb_says_how_to_continue(here, monkeypatch, capsys):
    real = Journal.append

    def interrupt(self: Journal, row: Any) -> None:
        real(self, row)
        raise KeyboardInterrupt

    monkeypatch.setattr(Journal, "append", interrupt)
    monkeypatch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
    assert main(["campaign", "short.toml", "--runs", "3", "--jobs", "1", "-o", "cut"]) == INTERRUPTED
    assert "--resume" in capsys.readouterr().out
    assert pq.read_table("cut/runs.parquet").num_rows == 2


def test_the_summary_has_figures_and_sentences(here):
    found = json.loads((here / "two" / "campaign.json").read_text())
    assert found["finished"] == 4
    assert found["uncertainty"]["runs"] == "4 of 4 planned"
    assert found["uncertainty"]["versions"] == found["versions"]
    assert [one["label"] for one in found["outcomes"]] == ["loose-15", "loose-22"]
    rows = pq.read_table(here / "two" / RUNS).to_pylist()
    pooled = np.sqrt(np.mean([row["pos_rmse_h_m"] ** 2 for row in rows if row["estimator"] == "loose-22"]))
    assert found["outcomes"][1]["errors"]["pos_rmse_h_m"]["value"] == pytest.approx(pooled)
    assert any("loose-15 and loose-22" in text or "is better than" in text for text in found["sentences"])


def test_the_report_shows_what_the_tables_hold(here, capsys):
    assert main(["report", "two"]) == 0
    text = (here / "two" / "report.html").read_text()
    read = bench.read_campaign("two")
    assert read.outcomes == bench.campaign("short.toml", 4, **OPTIONS, out="two", resume=True).outcomes
    words = html.unescape(text)
    assert all(one.sentence in words for one in read.comparisons)
    worst = max(
        (row for row in read.runs.to_pylist() if row["estimator"] == "loose-22"),
        key=lambda row: row["pos_rmse_h_m"],
    )
    assert f"<td>worst</td><td>{format_number(worst['pos_rmse_h_m'])}</td>" in text
    assert f"<code>{worst['command']}</code>" in words
    plots = re.findall(r'aria-label="([^"]+)"', text)
    nees = next(words for words in plots if words.startswith("NEES, mean of the runs: loose-15"))
    rows = [row for row in read.epochs.to_pylist() if row["estimator"] == "loose-15" and row["t_s"] >= 5.0]
    means = [row["nees_mean"] for row in rows]
    assert f"loose-15 {min(means):.3g} to {max(means):.3g}" in nees
    share = next(words for words in plots if words.startswith("runs with at most this horizontal error, rms"))
    assert "loose-22 0 to 100" in share
    index = bench.write_report(here, here / "index.html").read_text()
    assert '<a href="two/report.html">two</a>' in index
    assert '<td class="text">4 runs</td>' in index
    (written,) = re.findall(r"<span>written (.{16})</span>", text)
    assert f'<td class="text">{written}</td>' in index
    (here / "damaged").mkdir()
    for name in (RUNS, EPOCHS):
        (here / "damaged" / name).write_bytes((here / "two" / name).read_bytes())
    for content in ("[]", "{}", '{"outcomes": [1]}', "{"):
        (here / "damaged" / "campaign.json").write_text(content)
        with pytest.raises(ConfigError, match=r"campaign\.json"):
            bench.read_campaign("damaged")


@pytest.mark.parametrize(
    "change",
    [
        *({name: bad} for name, bad in {"sensors": "x", "assumed": [], "title": 3, "seed": "x"}.items()),
        {"sensors": {"imu": {}}},
        None,
    ],
)
def test_a_folder_of_a_stranger_is_a_line_and_the_others_stand(here, tmp_path, change):
    """None: a campaign without a condition."""
    shutil.copytree(here / "two", tmp_path / "bad")
    shutil.copytree(here / "two", tmp_path / "good")
    path = tmp_path / "bad" / "campaign.json"
    found = json.loads(path.read_text())
    if change is None:
        found["conditions"] = []
    else:
        found["conditions"][0]["as_flown"] |= change
    path.write_text(json.dumps(found))
    index = tmp_path / "index.html"
    (line,) = write_index(index, find_folders(tmp_path))
    assert "campaign.json" in line
    assert ">good</a>" in index.read_text()
    assert ">bad</a>" not in index.read_text()
    with pytest.raises(ConfigError, match=r"campaign\.json"):
        bench.write_report(path.parent, force=True)


def test_a_swept_number_is_the_axis_of_a_plot(here):
    read = bench.read_campaign("two")
    (only,) = read.conditions
    conditions = [{**only, "values": {"sensors.imu.gyro.noise_deg_sqrt_h": x}} for x in (2.0, 0.5)]
    outcomes = [
        replace(one, condition=f"short.toml, sensors.imu.gyro.noise_deg_sqrt_h = {x}", errors=errors)
        for x, size in ((2.0, 10.0), (0.5, 3.0))
        for one in read.outcomes[1:]
        for errors in [{"tilt_rmse_deg": Estimate(size, size - 1.0, size + 1.0)}]
    ]
    swept = replace(read, conditions=tuple(conditions), outcomes=tuple(outcomes))
    (plot,) = campaign_page.plot_sweep(swept, {"loose-22": (0, 0, 0)})
    assert plot.title == "tilt error (roll and pitch), rms [deg] by sensors.imu.gyro.noise_deg_sqrt_h"
    assert plot.series[0].t.tolist() == [0.5, 2.0]
    assert plot.series[0].values.tolist() == [[3.0, 2.0, 4.0], [10.0, 9.0, 11.0]]
    assert list(campaign_page.plot_sweep(read, {"loose-22": (0, 0, 0)})) == []


def test_two_campaigns_are_drawn_over_each_other(here, capsys):
    campaign("better", overrides={**OPTIONS["overrides"], "sensors.imu": "stim300"})
    assert main(["compare", "two", "better", "-o", "both"]) == 0
    words = html.unescape((here / "both" / "report.html").read_text())
    (found,) = bench.compare_results(["two", "better"])
    assert "sensors.imu: adis16475 and stim300" in found.differences
    assert all(text in words for text in (*found.sentences, *found.differences))
    row = next(row for row in found.verdicts if row.metric == "tilt_rmse_deg")
    cells = (row.estimator, name_metric(row.metric), format_number(row.old), format_number(row.new), row.word)
    assert all(f">{cell}</t" in words for cell in (*cells, row.format_change()))
    plots = re.findall(r'aria-label="([^"]+)"', words)
    tilt = next(text for text in plots if text.startswith("tilt error [deg]: loose-15, two"))
    for name in ("two", "better"):
        rows = bench.read_campaign(name).epochs.to_pylist()
        mine = [row for row in rows if row["estimator"] == "loose-15" and row["t_s"] >= 5.0]
        values = [row["tilt_deg_p50"] for row in mine]
        assert f"loose-15, {name} {min(values):.3g} to {max(values):.3g}" in tilt
    assert len(found.verdicts) > 10
    (here / "run").mkdir()
    (here / "run" / "result.json").write_text("{}")
    capsys.readouterr()
    assert main(["compare", "two", "run", "-o", "none"]) == 2
    assert not (here / "none").exists()


def test_campaigns_are_merged_by_their_conditions(here):
    read = bench.read_campaign("two")
    (only,) = read.conditions

    def sweep(*values: float) -> Any:
        conditions = tuple({**only, "values": {"seed_value": x}} for x in values)
        names = [f"short.toml, seed_value = {x}" for x in values]
        outcomes = tuple(replace(one, condition=name) for name in names for one in read.outcomes)
        tables = {
            name: table.from_pydict(
                {
                    **{key: column * len(values) for key, column in rows.items()},
                    "condition": [k for k in range(len(values)) for _ in rows["condition"]],
                }
            )
            for name, table in (("runs", read.runs), ("epochs", read.epochs))
            for rows in [table.to_pydict()]
        }
        return replace(read, conditions=conditions, outcomes=outcomes, **tables)

    merged = merge_campaigns({"a": sweep(1.0, 2.0), "b": sweep(3.0, 2.0)})
    assert [one["values"] for one in merged.conditions] == [{"seed_value": 2.0}]
    assert [one.label for one in merged.outcomes] == [
        f"{label}, {name}" for label in ("loose-15", "loose-22") for name in "ab"
    ]
    assert {one.condition for one in merged.outcomes} == {"short.toml, seed_value = 2.0"}
    assert set(merged.epochs.to_pydict()["condition"]) == {0}
    assert merged.runs.num_rows == 2 * read.runs.num_rows
    assert [(one.first, one.second) for one in merged.comparisons] == [
        (f"loose-15, {name}", f"loose-22, {name}") for name in "ab"
    ]
    assert (merged.planned, merged.finished, merged.interrupted) == (8, 8, False)
    assert merged.provenance["b: versions"] == read.provenance["versions"]
    wide = sweep(1.0, 2.0)
    wide = replace(
        wide, runs=wide.runs.append_column("more", [list(range(16))]), failed={"x": "why"}, interrupted=True
    )
    joined = merge_campaigns({"a": sweep(2.0), "b": wide})
    assert joined.runs["more"].to_pylist() == [None] * 8 + list(range(8, 16))
    assert joined.runs["run"].to_pylist() == read.runs["run"].to_pylist() * 2
    assert (joined.failed, joined.interrupted) == ({"x": "why"}, True)
    alone = merge_campaigns({"a": sweep(2.0), "b": sweep(3.0)})  # of one condition each: whatever it is
    assert {one.condition for one in alone.outcomes} == {"short.toml, seed_value = 2.0"}
    assert alone.runs.num_rows == 16
    with pytest.raises(ConfigError, match="no condition is in all"):
        merge_campaigns({"a": sweep(1.0, 2.0), "b": sweep(3.0, 4.0)})


def test_runs_are_recorded_side_by_side(here, capsys):
    """The recorded errors are those of the runs that the table names."""
    assert main(["record", "two", "--runs", "worst, 0", "-o", "some.rrd"]) == 0
    said = capsys.readouterr().out
    rows = [row for row in pq.read_table("two/runs.parquet").to_pylist() if row["estimator"] == "loose-15"]
    worst = max(rows, key=lambda row: row["pos_rmse_h_m"])["run"]
    assert f"Wrote some.rrd: worst, run {worst}; run 0." in said
    for name, run in ((f"worst, run {worst}", worst), ("run 0", 0)):
        path = drawing.entity("estimators", f"loose-15, {name}", "position", "north", "error")
        t, north = recording.column(Path("some.rrd"), path, "Scalars:scalars")
        rms = float(np.sqrt(np.mean(north[t >= 5.0 - 1e-6, 0] ** 2)))
        assert rms == pytest.approx(next(row["pos_rmse_n_m"] for row in rows if row["run"] == run))
    assert main(["record", "two", "--runs", "7"]) == 2
    assert "has no run '7'; best, median, worst, or a number up to 3" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="runs code on this machine; --allow-code permits it"):
        record_verbs.record_runs(
            Path("two"), Path("some.rrd"), {"run 0": {"estimators": ["lab:Mine"]}},
            force=True, allow_code=False, console=Console(),
        )  # fmt: skip


def test_a_folder_is_not_replaced_unasked(here):
    with pytest.raises(ConfigError, match="exists"):
        campaign("two")
    (here / "own").mkdir()
    (here / "own" / "diary.txt").write_text("mine")
    for options in ({"force": True}, {"resume": True}):
        with pytest.raises(ConfigError, match="did not write"):
            campaign("own", **options)


def test_a_journal_survives_half_a_line_and_names_damage(tmp_path):
    path = tmp_path / NAME
    with Journal(path) as journal:
        for k in range(3):
            journal.append({"key": str(k), "error": f"lost {k}"})
    text = path.read_bytes()
    path.write_bytes(text[:-5])
    with Journal(path) as journal:
        assert "2" not in journal
        assert journal["1"]["error"] == "lost 1"
        journal.append({"key": "2", "error": "lost 2"})
    assert path.read_bytes() == text
    path.write_bytes(text.replace(b"lost 1", b"lost 7"))
    with Journal(path) as journal:
        assert journal.damaged == 1
        assert "1" not in journal
        assert "2" in journal
    with Journal(tmp_path / "other") as journal:
        journal.append({"key": "4", "error": "a reason"})
        journal.append({"key": "5", "x": 1.0})  # summed, but no row
    with Journal(tmp_path / "other") as journal:
        assert journal.damaged == 1
        assert "4" in journal
        assert "5" not in journal


# --- what ends in the middle ------------------------------------------------------------------------------

KILLED = """
import os, signal, bench
from bench.experiments.campaigns.pools import SerialExecutor
from tests.campaigns.test_campaign import OPTIONS

def kill(progress):
    if progress.new == 2:
        os.kill(os.getpid(), signal.SIGKILL)

bench.campaign("short.toml", 4, out="killed", executor=SerialExecutor(), progress=kill, **OPTIONS)
"""


def test_after_kill_9_resume_gives_the_same_tables(here):
    done = subprocess.run([sys.executable, "-c", KILLED], check=False)
    assert done.returncode == -signal.SIGKILL
    assert not (here / "killed" / RUNS).exists()
    lines = (here / "killed" / NAME).read_bytes()
    (here / "killed" / NAME).write_bytes(lines + lines[:1000])  # and it was writing the third
    seen: list[Any] = []
    campaign("killed", resume=True, progress=seen.append)
    assert [one.done for one in seen] == [2, 3, 4]
    assert same(here / "two", here / "killed")


def test_a_damaged_line_is_repeated_and_said(here, capsys):
    shutil.copytree(here / "two", here / "bitten")
    lines = (here / "bitten" / NAME).read_bytes()
    (here / "bitten" / NAME).write_bytes(lines.replace(b"metrics", b"metricz", 1))
    again = ["campaign", "short.toml", "--runs", "4", "--seed=8", "--resume", "--jobs", "1"]
    again += [f"--set={key}={value}" for key, value in OPTIONS["overrides"].items()]
    for folder, said in (("bitten", True), ("two", False)):
        assert main([*again, "-o", folder]) == 0
        assert ("Journal, damaged lines and parts: 1." in capsys.readouterr().out) == said
    assert same(here / "two", here / "bitten")


def test_a_full_disk_keeps_what_is_finished(here, monkeypatch, capsys):
    real, ends = os.pwrite, list[int]()

    def write(descriptor: int, data: bytes, at: int) -> int:
        ends.extend(at + k + 1 for k, byte in enumerate(bytes(data)) if byte == ord("\n"))
        free = ends[1] + 100 if len(ends) > 1 else at + len(data)  # of two runs, and hardly of a third
        if at >= free:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(descriptor, data[: free - at], at)

    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", write)
        patch.setattr(running, "choose_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
        arguments = [f"--set={key}={value}" for key, value in OPTIONS["overrides"].items()]
        assert (
            main(["campaign", "short.toml", "--runs", "4", "--seed=8", "-o", "full", *arguments]) == MACHINE
        )
    assert "No space left on device; what is finished is kept" in capsys.readouterr().err
    seen: list[Any] = []
    campaign("full", resume=True, progress=seen.append)
    assert seen[0].done == 2
    assert same(here / "two", here / "full")


def test_other_estimators_do_not_replace_a_campaign_unasked(here):
    before = (here / "two" / RUNS).read_bytes()
    with pytest.raises(
        ConfigError, match="two: holds runs of loose-15, loose-22; name them again to continue"
    ):
        campaign("two", resume=True, estimators=["loose-22"])
    assert (here / "two" / RUNS).read_bytes() == before


def test_only_runs_of_the_same_profile_estimator_and_versions_are_taken(here, monkeypatch):
    def count(**options: Any) -> int:
        seen: list[Any] = []
        campaign("taken", 2, resume=True, progress=seen.append, **options)
        return seen[0].done

    monkeypatch.syspath_prepend(here)
    (here / "own_filter.py").write_text("from bench.navigation.models.loose_tight import Loose as Own\n")
    own = {"estimators": ["own_filter:Own"]}
    assert [count(**own), count(**own)] == [0, 2]
    (here / "own_filter.py").write_text(
        "from bench.navigation.models.loose_tight import Loose as Own  # another\n"
    )
    assert count(**own) == 0
    assert count(**own, overrides=OPTIONS["overrides"] | {"sensors.imu.gyro.noise_deg_sqrt_h": 0.2}) == 0
    monkeypatch.setattr("bench.experiments.campaigns.plan.describe_software", lambda: {"bench": "another"})
    assert count(**own) == 0


def test_a_run_that_ends_its_worker_is_a_row_with_its_reason(here, monkeypatch):
    """As a pool of one process would tell it; `test_batches` ends real ones."""

    class Mortal(ExecutorPool):
        lost = (BrokenProcessPool,)

        def submit(self, function: Any, *arguments: Any) -> Future[Any]:
            if any(getattr(task, "run", 0) == 2 for task in arguments[1]):
                future: Future[Any] = Future()
                future.set_exception(BrokenProcessPool())
                return future
            return super().submit(function, *arguments)

        def recover(self) -> tuple[str, bool]:
            return "its worker process was ended by SIGSEGV", True

    with monkeypatch.context() as patch:
        patch.setattr(running, "choose_pool", lambda *_: Mortal(SerialExecutor(), 1))
        result = campaign("mortal")
    rows = pq.read_table("mortal/runs.parquet").to_pylist()
    assert [row["failed"] for row in rows] == [False] * 4 + [True] * 2 + [False] * 2
    assert rows[4]["reason"] == "its worker process was ended by SIGSEGV"
    assert result.failed == {rows[4]["command"]: rows[4]["reason"]}
    assert result.finished == 4
    campaign("mortal", resume=True)  # it is tried again
    assert same(here / "two", here / "mortal")


@pytest.mark.parametrize("jobs", [3, None])
def test_a_campaign_has_the_processes_that_are_asked_for(here, monkeypatch, jobs):
    def stop(plan: Any, count: int, executor: Any, scheduler: Any) -> Any:
        raise ConfigError(f"{count} processes")

    monkeypatch.setattr(running, "choose_pool", stop)
    with pytest.raises(ConfigError, match=f"^{jobs or running.count_processors()} processes"):
        bench.campaign("short.toml", 1, jobs=jobs)


def test_what_filters_print_is_kept_with_the_command_of_the_run(here, monkeypatch):
    real = running.measure
    monkeypatch.setattr(
        running, "measure", lambda task: {**real(task), "printed": {"loose-22": f"of {task.run}\n\n"}}
    )
    first = campaign("printed", 1)
    campaign("printed", 2, resume=True)
    commands = bench.read_campaign("printed").runs["command"].to_pylist()[::2]
    told = [f"--- loose-22: {command}\nof {k}\n" for k, command in enumerate(commands)]
    assert (here / "printed" / running.PRINTED).read_text() == "".join(told)
    assert not (here / "two" / running.PRINTED).exists()
    assert 0.0 < first.timing["run_cpu_s"] < 100.0
    assert 0.0 < first.timing["wall_s"] < 1000.0
    assert sum(map(sum, first.estimator_cpu_s.values())) < first.timing["run_cpu_s"]


def test_progress_tells_how_fast_it_is_and_how_long_it_lasts():
    now = CampaignStage("short", 6, 10, "runs", failed=0, new=4, elapsed=8.0, flown=200.0)
    assert str(now) == "6 of 10 runs, 0.50 runs/s, 8 s left, 25 x real time"
    before = replace(now, done=2, new=0, elapsed=0.0, flown=0.0)
    assert str(before) == "2 of 10 runs"


@pytest.mark.parametrize(
    ("rate", "told"),
    [
        (Estimate(0.9, 0.8, 0.95), "x: 4 of 40 runs diverged or failed, 5 to 20 % of all; the first: why"),
        (Estimate(1.0, 0.91, 1.0), "x: all 40 runs converged; 0 to 9 % diverge, with 95 % confidence"),
    ],
)
def test_an_outcome_tells_what_did_not_converge_and_whether_the_claims_hold(rate, told):
    claim: Any = SimpleNamespace(sentence="overconfident by 2", reasons=("one", "two"))
    outcome = Outcome("short", "x", 40, rate, {}, None, "why")
    assert outcome.sentences == (told,)
    more = ("x is overconfident by 2", "x: one", "x: two")
    assert replace(outcome, consistency=claim).sentences == (told, *more)


def test_several_comparisons_share_one_chance_of_a_false_better():
    """The clearest of three has a third of the 5 % (Holm); one alone has all of it."""
    rng = np.random.default_rng(8)
    base = rng.uniform(1.0, 2.0, (3, 12))
    other = base * rng.uniform(0.8, 1.2, (3, 12))
    other[0] *= 3.0
    pairs = [Pair(("a", "b"), *rows) for rows in zip(base, other, strict=True)]
    for asked, confidence in ((pairs[:1], 0.95), (pairs, 1.0 - 0.05 / 3)):
        assert compare(asked)[0] == compare_rmse(("a", "b"), base[0], other[0], "m", confidence)


def test_the_nis_of_the_runs_that_converged_is_weighted_by_their_updates():
    """A run without the sensor and one that is lost do not count; the band is that of chi-square."""
    rows = [(1.2, 10, 30), (0.6, 30, 90), (9.0, 50, 150), None]
    group: Any = SimpleNamespace(
        converged=np.array([True, True, False, True]),
        nis_dof=[{"baro": row[2]} if row else {} for row in rows],
        metrics=[{"nis_mean_baro": row[0], "updates_baro": row[1]} if row else {} for row in rows],
    )
    ((sensor, found),) = pool_nis(group).items()
    assert sensor == "baro"
    assert (found.mean, found.updates) == (pytest.approx(0.75), 40)
    tail = 0.5 * (1.0 - NIS_PROBABILITY)
    assert [found.low, found.high] == pytest.approx(stats.chi2.ppf([tail, 1.0 - tail], 120) / 40)


def test_a_campaign_shows_its_figures_in_a_notebook_as_a_plot_and_as_a_frame(here):
    loaded = bench.read_campaign("two")
    shown = loaded._repr_html_()
    assert all(f"<p>{sentence}" in shown for sentence in loaded.sentences if "<" not in sentence)
    assert "<th>pos_rmse_h_m</th>" in shown
    frame = loaded.frame()
    assert len(frame) == loaded.runs.num_rows
    assert frame["pos_rmse_h_m"].tolist() == loaded.runs["pos_rmse_h_m"].to_pylist()
    figure = loaded.plot("pos_err_e_m")
    assert len(figure.axes) == len(loaded.conditions)
    with pytest.raises(ConfigError, match="'pos_err' has no plots"):
        loaded.plot("pos_err")
