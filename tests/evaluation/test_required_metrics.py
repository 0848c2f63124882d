"""Requirements: hand cases, the bound on a share, and what a filter cannot do to look as if it kept them."""

from __future__ import annotations

import re
from collections import Counter
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy import stats

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.verdict import add_verdict
from bench.evaluation.requirements.required_metrics import (
    MET,
    MISSED,
    UNDECIDED,
    Looks,
    count_deciding_runs,
    decide,
    judge_run,
    judge_runs,
)

MOST = {"metric": "pos_rmse_h_m", "most": 5.0, "share": 0.95}
LEAST = {"metric": "nees_inside_95", "least": 0.9, "share": 0.95}
OUTAGES = {"metric": "outage_*_drift_h_m", "most": 20.0, "share": 0.95}


def word(values, row):
    (found,) = judge_run("mine", values, [row])
    assert found.sentence.endswith(f": {found.word}.")
    return found.word


@pytest.mark.parametrize(
    ("values", "row", "expected"),
    [
        ({"pos_rmse_h_m": 5.0}, MOST, MET),
        ({"pos_rmse_h_m": 5.001}, MOST, MISSED),
        ({"nees_inside_95": 0.9}, LEAST, MET),
        ({"nees_inside_95": 0.89}, LEAST, MISSED),
        ({"outage_1_drift_h_m": 3.0, "outage_2_drift_h_m": 19.0}, OUTAGES, MET),
        ({"outage_1_drift_h_m": 3.0, "outage_12_drift_h_m": 21.0}, OUTAGES, MISSED),
        # what looks good and is not
        ({"pos_rmse_h_m": 1.0, "converged": False}, MOST, MISSED),
        ({"pos_rmse_h_m": None}, MOST, MISSED),
        ({"pos_rmse_h_m": float("nan")}, MOST, MISSED),
        ({}, MOST, MISSED),
        ({"outage_1_drift_h_m": 3.0, "outage_2_drift_h_m": None}, OUTAGES, MISSED),
        ({"outage_1_drift_h_m_all": 30.0, "outage_1_drift_h_m": 3.0}, OUTAGES, MET),
    ],
)
def test_one_run(values, row, expected):
    assert word(values, row) == expected


@pytest.mark.parametrize("share", [0.5, 0.9, 0.95])
@pytest.mark.parametrize("n", [10, 59, 200])
def test_a_wrong_word_is_rare(share, n):
    """At the share itself neither word is right: each comes in at most 5 % of campaigns, by enumeration."""
    chance = {MET: 0.0, MISSED: 0.0, UNDECIDED: 0.0}
    for count in range(n + 1):
        chance[decide(count, n, share)] += stats.binom.pmf(count, n, share)
    assert chance[MET] <= 0.05
    assert chance[MISSED] <= 0.05
    assert decide(0, n, share) == MISSED


def test_the_runs_that_are_missing_decide():
    """All of 8 runs: 0.95^58 is above 5 %, 0.95^59 below."""
    assert 0.95**59 < 0.05 < 0.95**58
    assert count_deciding_runs(8, 8, 0.95) == 59
    assert count_deciding_runs(95, 100, 0.95) is None
    row = {"metric": "pos_rmse_h_m", "most": 5.0, "share": 0.95}
    (found,) = judge_runs("mine", [{"pos_rmse_h_m": 1.0}] * 8, [row])
    assert found.word == UNDECIDED
    assert found.sentence == (
        "mine: pos_rmse_h_m is at most 5 m in 8 of 8 runs, 68.8 to 100 % of all, 95 % are required: "
        "undecided; 59 runs would decide it."
    )
    lost = [{"pos_rmse_h_m": 1.0, "converged": k > 9} for k in range(59)]
    assert judge_runs("mine", lost, [row])[0].word == MISSED


@pytest.mark.parametrize(("count", "n"), [(6, 6), (24, 24), (23, 24), (11, 12), (20, 24)])
def test_the_runs_that_are_advised_are_enough(count, n):
    """Begun with 6 and doubled to 24: as many as advised, of which as many keep it, decide."""
    needed = count_deciding_runs(count, n, 0.95, Looks(6, 24))
    assert needed == 59 if count == n else needed > 24
    assert decide(round(count / n * needed), needed, 0.95, Looks(6, needed)) != UNDECIDED


def test_only_a_look_that_can_decide_has_a_part_of_the_error():
    assert [Looks(*asked).numbers for asked in ((12, 24), (6, 23), (24, 6))] == [[12, 24], [6, 12, 23], [24]]
    assert decide(59, 59, 0.95, Looks(6, 59)) == decide(80, 80, 0.95, Looks(6, 80)) == MET
    assert decide(59, 59, 0.95, Looks(59, 118)) == UNDECIDED
    assert decide(0, 6, 0.95, Looks(6, 59)) == MISSED


def test_a_verdict_says_it_and_one_without_requirements_says_nothing():
    values = {"converged": True, "reason": None, "pos_rmse_h_m": 6.0}
    judged = add_verdict("mine", values, requirements=[MOST, {**MOST, "most": 7.0}])
    assert judged["required"] == MISSED
    assert judged["required_text"] == [
        "mine: pos_rmse_h_m is 6 m, at most 5 m is required: missed.",
        "mine: pos_rmse_h_m is 6 m, at most 7 m is required: met.",
    ]
    assert not {"required", "required_text"} & add_verdict("mine", values).keys()


PROFILE = """
title = "Straight, with an outage"
aircraft = "aerosonde"
rate_hz = 100
start = {{ lat_deg = 47.0, lon_deg = 11.0, alt_m = 1200.0, heading_deg = 85.0 }}
leg = [{{ kind = "straight", duration_s = 30.0 }}]
sensors = {{ imu = "adis16475", gnss = "l1-code", baro = "bmp388" }}
evaluation = {{ from_s = 10.0 }}
gnss_outage = [{{ start_s = 20.0, duration_s = 5.0 }}]
estimator = [{{ use = "loose-15" }}, {{ use = "loose-full" }}]
{}
"""
KEPT = '[[requirement]]\nmetric = "outage_*_drift_h_m"\nmost = 500.0\nshare = 0.5\n'
BROKEN = '[[requirement]]\nmetric = "pos_rmse_h_m"\nmost = 0.001\nestimator = "loose-15"\n'


def test_run_and_campaign_end_with_1_where_a_requirement_is_missed(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "short.toml"
    for text, status, failures in ((KEPT, 0, 0), (KEPT + BROKEN, 1, 1)):
        path.write_text(PROFILE.format(text))
        for verb in (["run", "--table", "--no-rrd"], ["campaign", "--runs", "6", "--jobs", "1"]):
            order = [*verb, "short.toml", "--no-report", "--force", "--junit", "found.xml"]
            assert main(order) == status, verb
            said = re.sub(r"\s+", " ", capsys.readouterr().out)
            assert "loose-full: outage_*_drift_h_m is" in said
            assert ("is required: missed." in said or "are required: missed." in said) == bool(status)
            suite = ElementTree.parse("found.xml").getroot()[0]
            assert suite.get("failures") == str(failures)
            assert suite.get("tests") == str(2 + failures)


def test_junit_without_a_requirement_is_refused(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "short.toml").write_text(PROFILE.format(""))
    order = ["run", "short.toml", "--no-rrd", "--no-report", "--force", "--junit", "found.xml"]
    assert main(order) == 2
    assert "the file has no [[requirement]]" in capsys.readouterr().err


def test_a_wrong_requirement_is_named(tmp_path):
    from bench.io.config import read_profile

    rows = (
        '[[requirement]]\nmetric = "pos_rms"\nmost = 1.0\n'
        '[[requirement]]\nmetric = "pos_rmse_h_m"\n'
        '[[requirement]]\nmetric = "pos_rmse_h_m"\nmost = 1.0\nestimator = "other"\n'
    )
    path = tmp_path / "short.toml"
    path.write_text(PROFILE.format(rows))
    with pytest.raises(ConfigError) as error:
        read_profile(str(path))
    assert tuple(text.removeprefix(f"{tmp_path}/") for text in error.value.messages) == (
        "short.toml: [[requirement]] 1: no metric 'pos_rms': bench list metrics",
        "short.toml: [[requirement]] 2: give most or least, one of them",
        "short.toml: [[requirement]] 3: no filter 'other'; there are loose-15, loose-full",
    )


def test_runs_that_are_added_until_it_is_decided_show_no_more_than_they_say():
    """Just 95 % keep it: looked at four times, either word falls in 5 % of the campaigns at most."""
    looks, words = [30, 60, 120, 240, 480], Counter[str]()
    assert Looks(30, 480).numbers == looks
    decided = {(n, k): decide(k, n, 0.95, Looks(30, 480)) for n in looks for k in range(n + 1)}
    kept = np.random.default_rng(2).random((4000, looks[-1])) < 0.95
    for counts in np.cumsum(kept, axis=1):
        found = [decided[n, int(counts[n - 1])] for n in looks]
        words[next((word for word in found if word != UNDECIDED), UNDECIDED)] += 1
    assert words[MET] < stats.binom.ppf(0.999, 4000, 0.05)
    assert words[MISSED] < stats.binom.ppf(0.999, 4000, 0.05)
