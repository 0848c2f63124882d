"""A card says what the runs of the suite say, and only cards of equal suites compare."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

import bench
from bench.campaigns import card, running
from bench.campaigns.pools import ExecutorPool, SerialExecutor
from bench.campaigns.study import Study
from bench.cli import main
from tests.campaigns.test_campaign import PROFILE

FAULT = """
[[gnss_outage]]
start_s = 14.0
duration_s = 4.0
[[fault]]
kind = "spoofing"
start_s = 8.0
duration_s = 3.0
step_m = [400.0, 0.0, 0.0]
"""


@pytest.fixture
def here(tmp_path, monkeypatch) -> Path:
    (tmp_path / "short.toml").write_text(PROFILE + FAULT)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(card, "_QUICK", Study("card-quick", ("short.toml",), runs=3))
    monkeypatch.setattr(running, "_open_pool", lambda *_: ExecutorPool(SerialExecutor(), 1))
    return tmp_path


def test_a_card_says_what_the_runs_say(here, capsys):
    assert main(["card", "-e", "loose-15", "--against", "loose-22", "--quick", "-o", "a.json"]) == 0
    assert "times that of loose-22" in capsys.readouterr().out
    found = json.loads(Path("a.json").read_text())
    lines = {(line["topic"], line["sentence"].split()[1]): line for line in found["lines"]}
    results = [bench.run("short.toml", run=k) for k in range(3)]
    own, other = ([one.metrics[label] for one in results] for label in ("loose-15", "loose-22"))

    def ratio(name: str) -> float:
        return math.sqrt(sum(a[name] ** 2 for a in own) / sum(b[name] ** 2 for b in other))

    assert lines["accuracy", "horizontal"]["value"] == pytest.approx(ratio("pos_rmse_h_m"))
    assert lines["heading", "heading"]["value"] == pytest.approx(ratio("heading_rmse_deg"))
    assert lines["outages", "growth"]["value"] == pytest.approx(ratio("outage_1_growth_h_m"))
    assert lines["faults", "largest"]["value"] == pytest.approx(ratio("fault_1_max_h_m"))
    nees = [one["nees_mean"] / 9 for one in own]
    assert lines["honesty", "NEES"]["value"] == pytest.approx(sum(nees) / 3)
    assert lines["faults", "noticed"]["value"] == sum(one["fault_1_detected"] for one in own) / 3
    assert lines["convergence", "converged"]["value"] == 1.0
    assert all(line["low"] <= line["value"] <= line["high"] for line in found["lines"])


def test_equal_inputs_give_equal_cards_and_another_suite_another_hash(here):
    first = bench.make_card("loose-15", against="loose-22", quick=True)
    assert bench.make_card("loose-15", against="loose-22", quick=True) == first
    alone = bench.make_card("loose-22", against="loose-22", quick=True)
    assert alone.suite_hash == first.suite_hash
    assert not any("times that of" in text for text in alone.sentences)
    Path("short.toml").write_text(PROFILE + FAULT.replace("400.0", "401.0"))
    assert bench.make_card("loose-22", against="loose-22", quick=True).suite_hash != first.suite_hash
