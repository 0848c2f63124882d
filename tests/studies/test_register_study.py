"""The table of the register: every row once, each with a test that exists or a reason why it is open."""

from __future__ import annotations

from pathlib import Path

import pytest

import bench
from bench.studies import register_rows
from bench.studies.register_measures import Found
from bench.studies.register_rows import ROWS

ROOT = Path(__file__).parents[2]


def test_every_row_is_there_once():
    assert [row.number for row in ROWS] == list(range(1, 61))


@pytest.mark.parametrize("row", ROWS, ids=lambda row: str(row.number))
def test_every_row_names_a_test_that_exists_or_says_why_it_is_open(row):
    assert bool(row.test) != bool(row.open_because)
    if row.test:
        path, name = row.test.split("::")
        assert f"\ndef {name}(" in (ROOT / path).read_text(encoding="utf-8")


@pytest.mark.parametrize("row", [row for row in ROWS if row.measure], ids=lambda row: str(row.number))
def test_what_takes_seconds_is_computed_and_holds(row):
    found = row.measure()
    assert found.holds, found.ours


def test_a_row_that_does_not_hold_is_said(monkeypatch):
    rows = (
        ROWS[53]._replace(measure=lambda: Found("1745.3 m", holds=False)),
        ROWS[41],
        ROWS[16]._replace(test="", open_because="nobody"),
    )
    monkeypatch.setattr("bench.studies.register_study.ROWS", rows)
    found = bench.study("register")
    assert not found.findings.good
    holds = {name: table.columns["holds"] for name, table in found.tables.items()}
    assert holds == {"sensors": ["open"], "filters": ["test"], "second-source": ["no"]}
    assert any("#54" in text and "1745.3 m" in text for text in found.verdicts)
    assert any(text.startswith("Open: #17") for text in found.verdicts)
    assert register_rows.ROWS is ROWS
