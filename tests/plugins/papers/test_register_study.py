"""The table of the register: every row once, each with a test that exists or a reason why it is open."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import bench
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.ensembles.ensemble import Estimate
from bench.evaluation.requirements.required_performance import JudgedFigure, count_windows
from bench.experiments.studies import rnp
from bench.experiments.studies.watched_flights import WatchedFlight
from bench.plugins.papers import register_flights, register_rows
from bench.plugins.papers.register_measures import Bounded, RowFinding, below
from bench.plugins.papers.register_rows import ROWS

ROOT = Path(__file__).parents[3]


def test_every_row_is_there_once():
    assert [row.number for row in ROWS] == list(range(1, 61))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row.number))
def test_every_row_names_a_test_that_exists_or_says_why_it_is_open(row):
    assert bool(row.test) != bool(row.open_because)
    if row.test:
        path, name = row.test.split("::")
        assert f"\ndef {name}(" in (ROOT / path).read_text(encoding="utf-8")


INF = math.inf
LIMITS = {
    1: [(0, 0.01), (0, 1e-6)],  # m, m/s
    3: [(0, 0.01)],
    4: [(0, 0.4), (0.5, 0.7)],
    5: [(0, 0.02)],  # arcsec, to #7
    6: [(0, 0.02), (0.05, INF), (0, None)],
    7: [(0, 0.2)],
    8: [(0.98, 1.02), (1.97e-4, 2.01e-4)],
    9: [(0.96 * one, 1.04 * one) for one in (9.60, 2.72, 2.55, 0.196, 0.65, 0.013)],
    10: [(0.29, 0.31), (44.5, 45.5), (0, 0.33), (15, 21)],
    11: [(0, 1e-14)],
    12: [(3.95, 4.05), (2, 3.5)],
    16: [(11.455, 11.465), (0.023525, 0.023535)],
    19: [(0, 1e-15)],
    20: [(0, 0.01)],
    29: [(156.2, 156.4), (0, 1e-3)],
    30: [(None, None)] * 2 + [(None, INF)] * 2,
    31: [(None, None)] * 2 + [(None, INF)] * 2,
    33: [(0, 1e-9)] * 12,
    34: [(6.9, 7.1), (20.5, 23.5)],
    35: [(7, 7)] * 3 + [(0, 0)],
    41: [(0.9997, 0.9999), (0.0013, 0.0027)],
    43: [(172.1, 172.3)],
    46: [(0, 0.3), (0, None)],
    47: [(0.85 * one, 1.15 * one) for one in (9.2, 10.6, 27.5, 227.0)],
    49: [(0.98 * one, 1.02 * one) for one in (0.0075, 0.31)],
    52: [(0, 1e-9)],
    53: [(0, 1e-11)],
    54: [(1738.15, 1738.25)],
    55: [(23.7835, 23.7845)],
    59: [
        (3.6, 3.8),
        *((0.9 * one, 1.1 * one) for one in (1.3e-4, 3.8e-4, 3.7e-5)),
        *[(0, 4)] * 3,
        *[(None, None)] * 3,
    ],
    60: [(0, 1)],
}
"""Row -> between what its numbers must lie by the register; None: what is found tells."""


@pytest.mark.parametrize("row", [row for row in ROWS if row.measure], ids=lambda row: str(row.number))
def test_what_takes_seconds_is_computed_and_holds(row, monkeypatch):
    monkeypatch.setattr(register_flights, "FLIGHTS", 2)
    found = row.measure()
    assert found.holds, found.ours
    for one, limits in zip(found.checks, LIMITS[row.number], strict=True):
        for end, wanted in zip(one[1:], limits, strict=True):
            assert wanted is None or end == pytest.approx(wanted, rel=1e-6, abs=0.0)
    assert not RowFinding("", (*found.checks, Bounded(math.nan, 0.0, 1.0))).holds


def watch_by_hand(run, alerts=0):
    """Return a flight of ten minutes that is known to 3 m, with an alert in some of its last seconds."""
    n = 600
    level = np.full((n, 2), 10.0)
    level[n - alerts :] = 9999.0
    nothing = np.zeros(n)
    return WatchedFlight(np.arange(n), np.full((n, 2), 3.0), level, nothing > 0, nothing, nothing)


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("hours_flown", lambda shape, interval: math.prod(shape) * interval / 60.0),
        ("judge_share", lambda inside, least, hours: JudgedFigure(Estimate(0.9, 0.2, 1.0), "undecided")),
        ("judge_share", lambda inside, least, hours: JudgedFigure(Estimate(1.0, 0.05**0.5, 1.0), "met")),
        (
            "judge_rate",
            lambda events, hours, most: JudgedFigure(Estimate(0.0, 0.0, 3.7 / hours), "undecided"),
        ),
        ("count_windows", lambda watched, window: count_windows(watched, 2.0 * window)),
    ],
)
def test_row_33_holds_a_count_of_the_seconds_against_the_study(monkeypatch, name, wrong):
    made = SimpleNamespace(name="made", evaluation=EvaluationWindow())
    monkeypatch.setattr(rnp, "make_profile", lambda options: made)
    monkeypatch.setattr(rnp, "load_flight", lambda *args: (made, SimpleNamespace(t=np.arange(600.0)), None))
    monkeypatch.setattr(rnp, "watch_run", watch_by_hand)
    monkeypatch.setattr(register_flights, "FLIGHTS", 2)
    found = register_flights.require_performance()
    assert found.holds, found.ours
    assert found.ours.startswith("2 flights, 0.33 h: availability 1 (0.22 to 1, undecided)")
    monkeypatch.setattr(rnp, name, wrong)
    assert not register_flights.require_performance().holds


def test_seconds_are_counted():
    """Of 80 operations one begins in the alert of 20 s at the end, and one is broken off by it."""
    late = watch_by_hand(0, alerts=20)
    late.error[100:103, 0], late.error[590:, 0] = 600.0, 600.0
    found = register_flights.count_seconds([late, watch_by_hand(1)])
    assert [row[0] for row in found.values()] == pytest.approx([1180 / 1200, 1 / 79, 3.0])


def test_a_row_that_does_not_hold_is_said(monkeypatch):
    rows = (
        ROWS[53]._replace(measure=lambda: RowFinding("1745.3 m", (below(1745.3, 1738.25),))),
        ROWS[41],
        ROWS[16]._replace(test="", open_because="nobody"),
    )
    monkeypatch.setattr("bench.plugins.papers.register_study.ROWS", rows)
    found = bench.study("register", jobs=1)
    assert not found.findings.good
    holds = {name: table.columns["holds"] for name, table in found.tables.items()}
    assert holds == {"sensors": ["open"], "filters": ["test"], "second-source": ["no"]}
    assert any("#54" in text and "1745.3 m" in text for text in found.verdicts)
    assert any(text.startswith("Open: #17") for text in found.verdicts)
    assert register_rows.ROWS is ROWS
