"""The NEES table of the guide: words follow from the interval, faults do not count, every cell is there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.core.records.specs import EvaluationWindow
from bench.experiments.campaigns.groups import Group
from bench.experiments.campaigns.plan import Condition, plan_runs
from bench.experiments.campaigns.worker import CHANNELS
from bench.io.config.listing import list_profiles
from bench.navigation import built_in
from tests.tools import nees_table

RNG = np.random.default_rng(5)


def row(mean: float, draws: int = 50):
    averages = mean + RNG.standard_normal(draws)
    return nees_table.summarize("survey", "loose-15", 9, 0, averages)


@pytest.mark.parametrize(
    ("mean", "word"),
    [(9.0, "consistent"), (400.0, "overconfident"), (5.0, "underconfident"), (11.2, "undecided")],
)
def test_the_word_follows_from_the_interval(mean, word):
    assert row(mean).word == word
    assert row(mean, 1).word == "undecided"


@pytest.mark.parametrize(
    ("mean", "half", "cell"),
    [(9.04, 0.52, "9.0 ± 0.5 ="), (274.4, 75.2, "274 ± 75 !"), (2580638.0, 1748037.0, "3e6 ± 2e6 !")],
)
def test_a_cell_is_short(mean, half, cell):
    assert nees_table.write_cell(nees_table.Row("survey", "loose-15", 9, 50, 0, mean, half)) == cell


def test_the_interval_holds_the_mean_as_often_as_it_says():
    """2000 intervals of 95 %: 0.933 to 0.965 of them, 99.9 %."""
    inside = [abs(one.mean - 9.0) < one.half for one in (row(9.0, 8) for _ in range(2000))]
    assert 0.933 < np.mean(inside) < 0.965


def test_the_mark_follows_from_a_wider_interval_than_is_shown():
    """11.25 is the most that is consistent; of 50 draws the interval of 99 % is 1.334 times that of 95 %."""
    words = [nees_table.Row("p", "f", 9, 50, 0, 11.25 - reach, 1.0).word for reach in (1.32, 1.35)]
    assert words == ["undecided", "consistent"]


def test_faults_and_runs_that_were_lost_do_not_count():
    profile = replace(bench.read_profile("gnss-faults"), evaluation=EvaluationWindow(60.0))
    t = np.arange(1.0, 261.0)
    kept = np.full((4, len(t), len(CHANNELS)), 9.0)
    kept[:, (t >= 80.0), :] = 1e6  # from the first fault on
    metrics = tuple({"converged": k < 3} for k in range(4))
    flown, start = Condition("gnss-faults", {}), EvaluationWindow(60.0)
    group = Group(0, flown, "loose-15", (1,), start, metrics, 9, (), t, t, t, t, kept)
    found = nees_table.judge(group, profile)
    assert (found.mean, found.draws, found.lost) == (9.0, 3, 1)
    whole = nees_table.judge(group, replace(profile, sensors=replace(profile.sensors, faults=())))
    assert whole.mean > 1e5


def test_the_campaign_files_hold_every_estimator_on_every_profile():
    """But those of satellites or white fixes where there are none, flights of an estimate, those left out."""
    flown: list[tuple[str, str]] = []
    fast = {
        one.label
        for one in plan_runs(str(nees_table.CAMPAIGN_FILES / "nees.toml"), 1).cells[0].profile.estimators
    }
    for path in nees_table.CAMPAIGN_FILES.glob("nees*.toml"):
        plan = plan_runs(str(path), 1)
        for cell in plan.cells:
            profile = plan.conditions[cell.condition].source
            flown += [(profile, one.label) for one in cell.profile.estimators]
    assert len(flown) == len(set(flown))
    names, equal = {entry.name for entry in list_profiles()}, {"classic-22", "error-ekf"}
    names -= nees_table.LEFT_OUT
    names -= {name for name in names if bench.read_profile(name).guidance is not None}  # flown by an estimate
    used = set(built_in.BUILT_IN) - equal - {"ahrs"}  # which has no position
    assert used == {name for labels in nees_table.TABLES for name in labels}
    receivers = {name: bench.read_profile(name).sensors.gnss for name in names}
    sky = {name for name, receiver in receivers.items() if receiver is not None and receiver.sky is not None}
    white = {"figure-eight-matched", "gnss-faults"}
    places = {"tight": sky, "graph-smoother": white}
    needed = {(name, label) for name in names for label in used if name in places.get(label, names)}
    slow = {(name, label) for name in nees_table.PARTLY for label in used - fast}
    assert set(flown) == needed - slow
