"""Whoever looks ahead anywhere is found, or does not repeat its answers; honest filters are never accused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bench import pipeline
from bench.core.records.specs import Guard
from bench.experiments.campaigns.worker import hash_answers
from bench.experiments.card import card_making
from bench.experiments.card.card_causality import choose_instants, judge_causality
from bench.experiments.card.card_lines import UNPROVEN, Line
from bench.experiments.card.card_suite import Suite, SuiteFlight
from tests.campaigns.looks_ahead import ODD, FailsAtAJump
from tests.campaigns.test_campaign import PROFILE

EVENTS = """
[[gnss_outage]]
start_s = 13.0
duration_s = 4.0
[[fault]]
kind = "spoofing"
start_s = 8.0
duration_s = 3.0
step_m = [400.0, 0.0, 20.0]
"""
LOOKS = (
    "AheadInOutages",
    "AheadAfterOutages",
    "AheadAtTheStart",
    "AheadInFaults",
    "AheadInCovariance",
    "AheadInBiases",
    "AheadInEvents",
    "LeaksALittle",
    "KnowsWhenFixesReturn",
    "KnowsItsWay",
    "KnowsTheNextTurn",
    "AheadByOneStep",
    "StreamsHonestly",
    "SeesTheAudit",
    "SmoothsItsFirstRuns",
    "NoticesARepeat",
)
MOODY = ("UsesTheClock", "ThrowsADie", "ClaimsByADie")


@pytest.fixture(autouse=True)
def place(tmp_path, monkeypatch) -> Path:
    (tmp_path / "short.toml").write_text(PROFILE + EVENTS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def audit(use: str, runs: int = 1, number: int = 7, options: dict | None = None) -> Line:
    """The line of a filter after runs of a flight of 20 s with an outage and a fault, all in this process."""
    suite = Suite("card-quick", (), draws=runs, members=(SuiteFlight("short", "short.toml"),))
    guard = Guard(in_process=True)
    plan, (own, *_) = card_making.plan_card(suite, use, "loose-22", guard, None, options)
    (choice,) = (one for one in suite.profile_of(plan, 0, 0).estimators if one.label == own)
    rows = []
    for run in range(runs):
        profile = suite.profile_of(plan, 0, run)
        sensed = pipeline.sense(profile, pipeline.fly(profile))
        found = pipeline.navigate(choice, sensed.data, sensed.initial)
        rows.append({"converged": True, "answers": hash_answers(found)})
    return judge_causality(plan, suite, own, [rows], 1.0, number)


def own(name: str) -> str:
    return f"tests.campaigns.looks_ahead:{name}"


@pytest.mark.parametrize("name", LOOKS)
def test_who_looks_ahead_in_one_place_is_found(name):
    line = audit(own(name))
    assert line.word == UNPROVEN or line.value > 0.0, line.sentence
    assert ("by the times of later data alone" in line.sentence) == (name == "KnowsWhenFixesReturn")


@pytest.mark.parametrize("name", MOODY)
def test_who_answers_otherwise_each_time_is_not_repeatable(name):
    line = audit(own(name))
    assert (line.value, line.word) == (None, UNPROVEN)
    assert "it is not repeatable" in line.sentence


def test_who_looks_ahead_in_half_of_the_runs_is_found_in_half_of_the_audits():
    """The chance that the card states is that of the draw: 0.5 for one audit of one run in two."""
    found = [audit(own("AheadInOneRunOfEight"), 4, number, {"share": 2}).value > 0.0 for number in range(10)]
    assert 1 <= sum(found) <= 9  # 99.8 % of Binomial(10, 0.5)


@pytest.mark.parametrize("use", [*map(own, ODD), "loose-15", "loose-full", "ukf", "gnss-only"])
def test_honest_filters_are_not_accused(use):
    for number in range(1 if use == "ukf" else 3):
        line = audit(use, number=number)
        assert (line.value, line.word) == (0.0, ""), line.sentence
    how = "other data after" if ":" in use else "fed in pieces in 1 run"
    assert how in line.sentence
    assert ("not confined" in line.sentence) == (":" in use)


def test_a_filter_that_fails_after_a_jump_gets_other_noise_alone():
    line = audit(own("FailsAtAJump"))
    assert FailsAtAJump.failed > 0
    assert (line.value, line.word) == (0.0, ""), line.sentence


def test_the_times_lie_in_the_parts_of_a_flight():
    suite = Suite("card-quick", (), draws=1, members=(SuiteFlight("short", "short.toml"),))
    plan, _ = card_making.plan_card(suite, "loose-15", "loose-22", Guard())
    profile = suite.profile_of(plan, 0, 0)
    data = pipeline.sense(profile, pipeline.fly(profile), 0).data
    drawn = np.array(
        [choose_instants(data, [(8.0, 11.0), (13.0, 17.0)], np.random.default_rng(k)) for k in range(50)]
    )
    assert drawn.shape == (50, 8)
    assert (drawn[:, 0] < 4.0).all()
    for low, high in ((6.0, 8.0), (8.9, 11.0), (11.0, 16.0), (11.0, 13.0), (14.2, 17.0), (17.0, 20.0)):
        assert ((drawn[:, 2:] >= low - 0.02) & (drawn[:, 2:] < high)).any(axis=1).all()
    outside = choose_instants(data, [(0.0, 30.0), (25.0, 30.0)], np.random.default_rng(1))
    assert len(outside) == 3
