"""Tables wider than the terminal are divided, with the names of the rows in each part, and nothing is cut."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from bench.cli.verbs import record_verbs
from bench.cli.verbs.campaign_verb import print_campaign
from bench.cli.verbs.check_verb import tabulate_verdicts
from bench.cli.verbs.printing import print_table
from bench.cli.verbs.result_table import print_bound
from bench.core.files.places import PACKAGE
from bench.core.records.findings import FindingTable
from bench.core.words.notebook import ShownFigure
from bench.evaluation.ensembles.ensemble import Estimate
from bench.evaluation.metrics.outages import tabulate_drifts
from bench.evaluation.motion.noise_curves import AllanCurve
from bench.experiments.baselines.verdict_rows import Verdict
from bench.experiments.campaigns.outcome import Campaign, Outcome

METRICS = ("pos_rmse_h_m", "heading_rmse_deg", "cep95_m")
ALL = Estimate(1.0, 0.7, 1.0)


def print_outcomes(outcomes) -> str:
    file = io.StringIO()
    campaign = Campaign(
        tuple(outcomes), (), None, None, 3, 3, {}, (), {}, {"wall_s": 1.0}, False, Path("made")
    )
    print_campaign(Console(file=file, width=80), campaign, table=True)
    return file.getvalue()


def print_at(width, show) -> str:
    """What is printed on a terminal of some width, of which no line is longer, and nothing is cut."""
    file = io.StringIO()
    show(Console(file=file, width=width))
    assert max(map(len, file.getvalue().splitlines())) <= width
    assert "…" not in file.getvalue()
    return file.getvalue()


def test_the_bound_of_many_estimators_is_divided_and_each_part_names_its_rows():
    names = [f"an-estimator-{k}" for k in range(7)]
    quantities = ("horizontal position", "heading")
    rows = [
        {"quantity": name, "phase": "without GNSS", "ratio": 1234.0, "low": 1016.0, "high": 1457.0}
        for name in quantities
    ]
    for width in (60, 80, 200):
        words = print_at(
            width, lambda console: print_bound(console, {name: {"bound": rows} for name in names})
        )
        parts = words.count("─\n")
        assert all(words.count(name) == 1 for name in names)
        assert words.count("1016 to 1457") == len(names) * len(rows)
        assert words.count("GNSS") == parts * len(rows)
        assert (parts > 1) == (width < 200)


def test_drifts_in_outages_are_not_cut():
    ends = {f"{name}_{end}m": 1016.4 for name in ("median_h", "p95_h") for end in ("low_", "", "high_")}
    row = {"duration_s": 5.0, "estimator": "an-estimator", "places": 10, **ends}
    row |= {"reported_median_h_m": 1016.4, "predicted_median_h_m": 1016.4}
    words = print_at(
        60, lambda console: print_table(console, tabulate_drifts([row, row | {"estimator": "another"}]))
    )
    assert words.count("an-estimator") == words.count("another") == words.count("─\n") > 1
    assert words.count("1020 to 1020") == 4


@pytest.mark.parametrize("width", [60, 80])
def test_an_allan_table_is_not_cut_and_marks_what_is_outside(width):
    tau, expected = np.array([0.005, 4096.0]), np.array([1e-3, 2e-3])
    bands = {"low": 0.9 * expected, "high": 1.1 * expected, "expected": expected, "terms": {"N": expected}}
    curve = AllanCurve("gyro", tau, expected * [1.0, 1.234], np.array([119999.0, 48.0]), **bands)
    words = print_at(width, lambda console: print_table(console, record_verbs.tabulate_allan(curve))).split()
    assert words.count("4096") == 1
    assert " ".join(words).count("0.900 to 1.100") == 2
    assert words[words.index("!") - 1] == "1.234"
    assert words.count("!") == 1
    assert "119999" in words


def test_a_head_is_broken_after_spaces_and_underscores():
    columns = {"unit": ["long " * 9] * 2, "ANEES / n of_it_m": [ShownFigure("1.00 (0.9 to 1)")] * 2}
    lines = print_at(40, lambda console: print_table(console, FindingTable("", "", columns))).splitlines()
    assert [line.split("  ")[-1].strip() for line in lines[1:3]] == ["ANEES / n of_", "it_m"]


def test_a_title_may_be_wider_than_its_table():
    title = "Words above a table of one narrow column"
    said = print_at(30, lambda console: print_table(console, FindingTable("", title, {"unit": ["m"]})))
    assert " ".join(said.split()).startswith(title)


def test_changes_of_a_comparison_are_not_cut():
    """Two runs: the interval ends nowhere."""
    numbers = 6.8, 4.8, -0.29, -1.0, 9.5e140
    row = Verdict(
        "flight", "mine", "coverage_3sigma_pos_n", "m", "undecided", *numbers, True, 2, paired=False, note=""
    )
    assert row.format_change() == "-29.0% (-100.0% to +9.5e+142%)"
    assert replace(row, low=-0.3, high=12.5).format_change() == "-29.0% (-30.0% to +1250.0%)"
    table = tabulate_verdicts([row], "flight", ("the-first", "the-other"))
    words = print_at(60, lambda console: print_table(console, table))
    assert "undecided" in words


def test_intervals_stand_below_their_figures_only_where_there_is_no_room():
    columns = {
        "": ["Heading", "error"],
        "mine": [ShownFigure(""), ShownFigure("12.3", "1 to 20", outside=True)],
    }
    table = FindingTable("", "", columns | {"theirs": [ShownFigure(""), ShownFigure("4", "3 to 5")]})
    wide = print_at(60, lambda console: print_table(console, table)).splitlines()
    assert " ".join(wide[-2].split()) == "error 12.3 ! (1 to 20) 4 (3 to 5)"
    narrow = print_at(30, lambda console: print_table(console, table)).splitlines()
    assert [" ".join(line.split()) for line in narrow[-3:-1]] == ["error 12.3 ! 4", "1 to 20 3 to 5"]


def test_what_is_found_is_printed_by_one_module():
    users = [path.name for path in PACKAGE.rglob("*.py") if "rich.table" in path.read_text(encoding="utf-8")]
    assert users == ["printing.py"], "make a FindingTable, and let print_findings print it"


def test_the_conditions_of_a_campaign_with_lost_runs_are_told_with_the_reason():
    some = Estimate(0.5, 0.2, 0.8)
    outcomes = [Outcome(f"seed = {k}", "x", 4, some if k else ALL, {}, None, "late" * k) for k in range(9)]
    said = print_outcomes(outcomes)
    assert "seed = 1: x: 2 of 4 runs diverged or failed, 20 to 80 % of all; the first: late" in said
    assert "seed = 0:" not in said
    assert "3 more conditions have such runs" in said


@pytest.mark.parametrize("several", [False, True], ids=["ten filters", "conditions"])
def test_the_table_of_a_campaign_is_divided_and_nothing_is_cut(several):
    values = iter(range(1000))
    outcomes = [
        Outcome(
            f"sensors.imu = unit-{row}-with-a-long-name" if several else "",
            f"an-estimator-{row}",
            3,
            ALL,
            {name: Estimate(1000.0 + next(values), 516.0, 4660.0) for name in METRICS},
            None,
        )
        for row in range(10)
    ]
    said = print_outcomes(outcomes)
    table = said.partition("Over all runs")[0]
    assert max(map(len, table.splitlines())) <= 80
    assert "…" not in said
    words, shown = table.split(), METRICS[:2] if several else METRICS
    found = [word for word in words if word.startswith("10") and len(word) == 4]
    assert sorted(found) == sorted(f"{one.errors[name].value:.0f}" for one in outcomes for name in shown)
    parts = sum("─" in line for line in table.splitlines())
    assert parts > 1
    for row in range(10):
        assert words.count(f"an-estimator-{row}") == 1
        assert words.count(f"unit-{row}-with-a-long-name") == (parts if several else 0)
    if not several:
        assert table.count("heading error") == parts
