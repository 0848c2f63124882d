"""A campaign is every combination of what it varies; each run is that of the command in its row."""

from __future__ import annotations

import json
import shlex
import warnings
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

import bench
from bench.cli.command_line import main
from bench.core.files.places import PACKAGE
from bench.core.words.exceptions import ConfigError
from bench.experiments.campaigns import groups, running
from bench.experiments.campaigns.binned import BinnedRuns
from bench.experiments.campaigns.plan import plan_runs
from bench.experiments.campaigns.pools import SerialExecutor
from tests.campaigns.test_campaign import PROFILE

CAMPAIGN = """
profiles = ["short.toml"]
runs = 1
flights = 2
seed = 3
estimators = ["loose-15"]
[set]
start.alt_m = 1002.5
[[variant]]
"sensors.imu" = "adis16475"
[[variant]]
sensors.imu = "stim300"
sensors.baro = "bmp388"
[sweep]
"sensors.gnss.pos_h_white_sd_m" = [1.5, 3]
"""


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "units.toml").write_text(CAMPAIGN)
    (tmp_path / "files" / "short.toml").write_text(PROFILE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_campaign_is_every_combination(here):
    plan = plan_runs("files/units.toml")
    values = [tuple(one.values.values()) for one in plan.conditions]
    assert values == [
        ("adis16475", 1.5),
        ("adis16475", 3),
        ("stim300", "bmp388", 1.5),
        ("stim300", "bmp388", 3),
    ]
    assert [(cell.condition, cell.profile.seed) for cell in plan.cells] == [
        (k, s) for k in range(4) for s in (3, 4)
    ]
    assert len(plan.runs) == 8
    assert len({cell.truth_key for cell in plan.cells}) == 2  # turbulence of each seed, whatever the sensors
    assert len({plan.run_key(one) for one in plan.runs}) == 8
    assert {len(cell.key) for cell in plan.cells} == {32}
    assert all(cell.profile.document["start"]["alt_m"] == 1002.5 for cell in plan.cells)
    assert plan_runs("files/units.toml", 5, flights=1, seed=9).cells[-1].profile.seed == 9


def test_its_rows_are_repeated_and_its_tables_name_the_values(here, monkeypatch):
    """Of the flights of a wave; kernels of the one filter are compiled by the first run of all."""
    firsts, real = [], running.compute

    def compute(function, items, pool, first=()):
        firsts.extend([list(first)] if function is running.measure else [])
        return real(function, items, pool, first)

    monkeypatch.setattr(running, "WAVE", 3)
    monkeypatch.setattr(running, "compute", compute)
    result = bench.campaign("files/units.toml", executor=SerialExecutor(), out="done")
    assert firsts == [[0], [], []]
    rows = pq.read_table("done/runs.parquet").to_pylist()
    assert all(len(row["answers"]) == 16 for row in rows)
    assert [row["condition"] for row in rows] == [k for k in range(4) for _ in range(2)]
    row = rows[-1]
    varied = [row[name] for name in ("sensors.imu", "sensors.gnss.pos_h_white_sd_m", "seed", "run")]
    assert varied == ["stim300", 3, 4, 0]
    words = shlex.split(row["command"])
    assert main([*words[1:], "--no-rrd", "-o", "alone"]) == 0
    metrics = json.loads(Path("alone/result.json").read_text())["metrics"]["loose-15"]
    why = row.pop("verdict_text").partition(" Worst is")[0]
    assert metrics["verdict_text"].startswith(why)  # that of a run goes on: why
    assert {name: metrics[name] for name in row if name in metrics} == {
        k: v for k, v in row.items() if k in metrics
    }
    epochs = pq.read_table("done/epochs.parquet")
    assert len(set(zip(*(epochs[name].to_pylist() for name in ("condition", "t_s")), strict=True))) == len(
        epochs
    )
    assert epochs["runs"].to_pylist()[0] == 2
    assert epochs.schema.field("sensors.gnss.pos_h_white_sd_m").metadata[b"unit"] == b"m"
    assert [one.runs for one in result.outcomes] == [2] * 4
    assert len({row["vel_rmse_h_mps"] for row in rows}) == 8


@pytest.mark.parametrize("profile", ["static", "short.toml"])
def test_flights_that_would_be_the_same_are_refused(here, profile):
    Path("short.toml").write_text(PROFILE.replace('"light"', '"none"'))
    with pytest.raises(ConfigError, match="has no turbulence, so all its flights are the same"):
        plan_runs(profile, 1, flights=2)


def test_percentiles_of_very_many_runs_come_from_bins(here, monkeypatch):
    exact = bench.campaign(
        "files/short.toml", 5, estimators=["loose-15"], executor=SerialExecutor(), out="five"
    )
    monkeypatch.setattr(groups, "MOST_KEPT", 2 * len(exact.epochs))
    found = list[groups.Group]()
    monkeypatch.setattr(
        running, "gather", lambda *these: (found.append(one) or one for one in groups.gather(*these))
    )
    binned = bench.campaign(
        "files/short.toml",
        5,
        executor=SerialExecutor(),
        out="five",
        estimators=["loose-15"],
        resume=True,
    )
    for name in ("pos_err_n_m_mean", "nees_mean", "heading_err_deg_mean"):
        np.testing.assert_allclose(binned.epochs[name], exact.epochs[name], rtol=1e-5)
    np.testing.assert_allclose(found[0].kept_t, found[0].t[2::3])  # of five runs each third time
    assert binned.epochs["pos_sd_h_m_p50"] != exact.epochs["pos_sd_h_m_p50"]
    np.testing.assert_allclose(binned.epochs["pos_sd_h_m_p50"], exact.epochs["pos_sd_h_m_p50"], rtol=0.013)


def test_binned_percentiles_are_those_of_the_values():
    values = np.random.default_rng(1).normal(size=(3000, 2, 3)) * [1e-2, 1.0, 1e4]
    values[:, 1, 2] = np.nan
    bins = BinnedRuns(5, 3)
    for one in values:
        bins.add(one)
    assert bins.mean().shape == (2, 3)
    np.testing.assert_allclose(bins.mean(), values.mean(axis=0))
    for percent in (5, 50, 95):
        wanted = np.percentile(values, percent, axis=0)
        near = 0.013 * np.abs(wanted) + 0.01 * np.array([1e-2, 1.0, 1e4])  # and 1 % of the spread
        error = np.abs(bins.percentile(percent) - wanted)
        assert (error <= near)[~np.isnan(wanted)].all()
    assert np.isnan(bins.percentile(50)[1, 2])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (('profiles = ["short.toml"]', "profiles = []"), "profiles"),
        (("[1.5, 3]", "2.0"), "must be a list of values"),
        (("runs = 1", "run = 1"), "unknown key 'run'"),
        (('"loose-15"', '"own:Filter"'), "--allow-code permits it"),
        (("start.alt_m", 'sensors.imu = "stim300"\nstart.alt_m'), "sensors.imu is given twice"),
        (('"loose-15"', '"file:x.csv"'), "belongs to one run"),
        (("start.alt_m = 1002.5", 'wind.turbulence = "none"'), "has no turbulence"),
        (("[1.5, 3]", "[1.5, -3]"), "pos_h_white_sd_m"),
    ],
)
def test_a_wrong_campaign_file_is_refused(here, change, message):
    Path("files/units.toml").write_text(CAMPAIGN.replace(*change))
    Path("files/x.csv").write_text("")
    with pytest.raises(ConfigError, match=message):
        plan_runs("files/units.toml")


def test_the_campaign_file_of_the_guide_is_planned(here):
    page = (PACKAGE / "guide" / "campaigns.md").read_text()
    Path("which_unit.toml").write_text(page.split("```toml which_unit.toml\n")[1].split("```")[0])
    plan = plan_runs("which_unit.toml", overrides={"estimator.1.options.gate_probability": 1e-6})
    assert (len(plan.conditions), len(plan.runs)) == (8, 320)


def test_percentiles_over_runs_of_which_some_have_no_value():
    """The same bits as one column at a time: known in all runs, in some, in none."""
    values = np.random.default_rng(5).standard_normal((7, 40, 3))
    values[2:5, 30:, 0], values[:, 35:, 1], values[:, :, 2] = np.nan, np.nan, np.nan
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        wanted = np.nanpercentile(values, groups.PERCENTILES, axis=0)
    np.testing.assert_array_equal(groups.find_percentiles(values), wanted)
