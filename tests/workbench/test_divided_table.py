"""Tables wider than the terminal are divided, with the names of the rows in each part, and nothing is cut."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from rich.console import Console

from bench.campaigns.outcome import Outcome
from bench.campaigns.running import Campaign
from bench.evaluation.ensemble import Estimate
from bench.workbench.campaign_verb import print_campaign

METRICS = ("pos_rmse_h_m", "heading_rmse_deg", "cep95_m")
ALL = Estimate(1.0, 0.7, 1.0)


def print_outcomes(outcomes) -> str:
    file = io.StringIO()
    campaign = Campaign(
        tuple(outcomes), (), None, None, 3, 3, {}, (), {}, {"wall_s": 1.0}, False, Path("made")
    )
    print_campaign(Console(file=file, width=80), campaign)
    return file.getvalue()


@pytest.mark.parametrize("several", [False, True], ids=["ten estimators", "conditions"])
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
        assert words.count(f"an-estimator-{row}") == (parts if several else 1)
    if not several:
        assert [words.count(name) for name in METRICS] == [parts] * 3
