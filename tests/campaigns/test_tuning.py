"""Tuning finds the noise that is there, from draws or from withheld fixes, and judges it on other data."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

import bench
from bench.campaigns import tuning
from bench.campaigns.pools import ExecutorPool, SerialExecutor
from bench.campaigns.trials import Judged, Score
from bench.cli import main
from bench.config import load_profile
from bench.errors import ConfigError
from bench.evaluation.ensemble import Estimate
from bench.places import PACKAGE
from tests.builders import band
from tests.campaigns.test_campaign import PROFILE

WRONG = 4.0  # times the noise of the receiver on board


class HerePool(ExecutorPool):
    def __init__(self, workers: int) -> None:
        super().__init__(SerialExecutor(), workers)


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    """A profile whose filter assumes a receiver that is far worse than the one on board."""
    text = (PACKAGE / "catalog" / "gnss" / "matched-white.toml").read_text()
    lines = []
    for line in text.splitlines():
        key, equals, value = line.partition(" = ")
        noise = equals and "white_sd" in key and not key.startswith('"')
        lines.append(f"{key} = {WRONG * float(value.partition('#')[0])}" if noise else line)
    (tmp_path / "poor.toml").write_text("\n".join(lines))
    profile = PROFILE.replace("l1-code", "matched-white").replace(
        "[evaluation]", '[sensors.assumed]\ngnss = "poor.toml"\n[evaluation]'
    )
    (tmp_path / "short.toml").write_text(profile)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(tuning, "ProcessPool", HerePool)
    return tmp_path


def test_the_noise_of_the_receiver_is_found_and_written(here, capsys):
    arguments = [
        "--factor",
        "gnss.gnss.pos_",
        "--factor",
        "gnss.gnss.vel_",
        "--runs",
        "4",
        "--evaluations",
        "30",
    ]
    assert main(["tune", "short.toml", "-e", "loose-15", *arguments]) == 0
    assert "gnss.gnss.pos_: 0.2" in capsys.readouterr().out
    found = load_profile("short.toml", {"sensors.assumed.gnss": "tuned/gnss-tuned.toml"}).sensors
    low, high = (math.sqrt(edge) for edge in band(4 * 15 * 3))  # 4 draws of 15 fixes of 3 components
    assert low < found.assumed.gnss.pos_h_white_sd / found.gnss.pos_h_white_sd < high
    assert low < found.assumed.gnss.vel_white_sd / found.gnss.vel_white_sd < high
    assert not low < WRONG < high


def test_before_and_after_are_on_other_draws(here):
    seen: list[Any] = []
    found = bench.tune(
        "short.toml",
        "loose-15",
        factors=["gnss.gnss."],
        runs=3,
        evaluations=8,
        progress=lambda *now: seen.append(now),
    )
    assert found.evaluations == len(seen) <= 8
    assert found.before.nees_ratio.value < found.after.nees_ratio.value  # it claimed too little
    results = [bench.run("short.toml", run=k, estimators=["loose-15"]) for k in (3, 4, 5)]
    mean = sum(one.metrics["loose-15"]["pos_rmse_h_m"] ** 2 for one in results) / 3
    assert found.before.rmse_h_m.value == pytest.approx(math.sqrt(mean))
    assert any("times the datasheet" in text for text in found.sentences)


def test_a_state_that_is_missing_is_told_by_innovations_that_repeat(here):
    """A receiver whose error wanders: no white noise makes the innovations white, a state for it does."""
    options: Any = {"factors": ["gnss.gnss.pos_"], "runs": 8, "evaluations": 3}
    wandering = {"sensors.gnss": "l1-code", "sensors.assumed.gnss": "l1-code"}
    value, edge = {}, {}
    for label in ("loose-15", "loose-22"):
        found = bench.tune("short.toml", label, overrides=wandering, **options)
        value[label], edge[label] = found.after.repetition["gnss_position"]
        told = [text for text in found.sentences if text.startswith("innovations of gnss_position still")]
        assert bool(told) == (label == "loose-15")
    assert value["loose-15"] > 2 * edge["loose-15"]
    assert abs(value["loose-22"]) < edge["loose-22"]


@pytest.mark.parametrize(("factor", "told"), [(100.0, True), (0.0101, True), (60.0, False), (1.0, False)])
def test_a_factor_at_its_bound_is_told(factor, told):
    one = Estimate(1.0, 0.9, 1.1)
    judged = Judged(one, one, {})
    found = tuning.Tuning("x", "consistency", {"imu.gyro.noise": factor}, judged, judged, 9, {})
    assert ("the bound" in found.sentences[0]) == told


def test_the_cost_is_least_at_the_expectation():
    right = Score(1.0, {"gnss": 1.0}, 2.0, 1.0)
    assert right.cost("consistency") == 0.0
    for wrong in (
        Score(1.5, {"gnss": 1.0}, 1.0, 1.0),
        Score(1.0, {"gnss": 0.7}, 1.0, 1.0),
        Score(1.0, {}, 1.0, 0.9),
    ):
        assert wrong.cost("consistency") > 0.0
    assert Score(9.0, {}, 1.0, 1.0).cost("rmse") < right.cost("rmse")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"factors": ["imu.gyro.nose"]}, "no assumed figure begins with"),
        (
            {"overrides": {"sensors.assumed.imu.gyro.noise_deg_sqrt_h": 1.0}},
            "starts from datasheets in files",
        ),
    ],
)
def test_a_wrong_request_is_refused(here, options, message):
    with pytest.raises(ConfigError, match=message):
        bench.tune("short.toml", "loose-15", **options)
