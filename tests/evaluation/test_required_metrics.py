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
from bench.evaluation.requirements.required_metrics import Looks, judge_run, judge_runs, trace
from bench.evaluation.requirements.share_test import MET, MISSED, UNDECIDED, ShareTest
from bench.experiments.baselines.junit import write_requirements

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


def decide(count, n, share):
    return ShareTest(share).decide([True] * count + [False] * (n - count))[0]


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


def judge_all(kept, row):
    (found,) = judge_runs("mine", [{"pos_rmse_h_m": 1.0 if one else 9.0} for one in kept], [row])
    return found


def test_the_runs_that_are_missing_are_told():
    """All of 8 runs: 0.95^58 is above 5 %, 0.95^59 below."""
    assert 0.95**59 < 0.05 < 0.95**58
    assert ShareTest(0.95).count_least() == 59
    found = judge_all([True] * 8, MOST)
    assert found.word == UNDECIDED
    assert found.sentence == (
        "mine: pos_rmse_h_m is at most 5 m in 8 of 8 runs, 68.8 to 100 % of all, 95 % are required: "
        "undecided; 153 runs would show it in 90 % of cases if 99 % of all runs meet it."
    )
    lost = [{"pos_rmse_h_m": 1.0, "converged": k > 9} for k in range(59)]
    assert judge_runs("mine", lost, [MOST])[0].word == MISSED
    many = judge_all([True] * 192 + [False] * 8, MOST)
    assert "fewer runs meet it than the 99 % expected: more than 153 runs are needed" in many.sentence
    near = judge_all([True] * 8, {**MOST, "expected_share": 0.95001})
    assert near.sentence.endswith("undecided; no number of runs would show it if 95 % of all runs meet it.")


@pytest.mark.parametrize("share", [0.5, 0.9, 0.95])
def test_the_runs_that_are_advised_show_a_good_filter(share):
    """By enumeration: "met" with 90 % at the expected share, with fewer runs less often."""
    test = ShareTest.from_row({"share": share})
    n = test.count_runs()
    counts = np.arange(n + 1)
    met = np.array([test.bound(k, n).low >= share for k in counts.tolist()])
    assert stats.binom.pmf(counts[met], n, test.expected).sum() >= 0.9
    fewer = n * 3 // 4
    met = np.array([test.bound(k, fewer).low >= share for k in range(fewer + 1)])
    assert stats.binom.pmf(np.arange(fewer + 1)[met], fewer, test.expected).sum() < 0.9


@pytest.mark.parametrize(("at", "right"), [(0.95, ""), (0.97, ""), (0.99, MET)])
def test_runs_that_are_added_one_by_one_show_no_more_than_they_say(at, right):
    """2,000 campaigns at the required share, midway, and at the expected share; 99.9 % of the binomial."""
    test = ShareTest(sequential=True)
    most = test.count_runs()
    kept = np.random.default_rng(2).random((2000, most)) < at
    words = Counter(test.decide(one)[0] for one in kept)
    wrong = (MISSED,) if at > test.share else (MET, MISSED)
    assert all(words[word] < stats.binom.ppf(0.999, 2000, test.alpha) for word in wrong)
    if right:
        assert words[right] > stats.binom.ppf(0.001, 2000, 1.0 - test.beta)
    loose = ShareTest(sequential=True, alpha=0.5)
    assert at > test.share or Counter(loose.decide(one)[0] for one in kept)[MET] > words[MET] + 200


def test_a_filter_that_is_bad_is_told_so_soon():
    """By hand: three misses in a row weigh 3 log(0.215 / 0.05), more than log 20."""
    test = ShareTest(sequential=True)
    assert test.decide([False] * 3) == (MISSED, 3)
    assert test.decide([False] * 2) == (UNDECIDED, 2)
    assert judge_all([False] * 9, {**MOST, "plan": "sequential"}).sentence == (
        "mine: pos_rmse_h_m is at most 5 m in 0 of 3 runs, 95 % are required: missed."
    )


def test_a_verdict_has_the_id_and_the_words_of_its_requirement(tmp_path):
    found = judge_all([True] * 59, {**MOST, "id": "NAV-7", "text": "Within 5 m & no more"})
    write_requirements(tmp_path / "found.xml", "suite", [found])
    (case,) = ElementTree.parse(tmp_path / "found.xml").getroot()[0]
    assert case.get("name") == "NAV-7 pos_rmse_h_m"
    assert {one.get("name"): one.get("value") for one in case[0]} == {
        "requirement_id": "NAV-7", "requirement_text": "Within 5 m & no more"
    }  # fmt: skip
    shown = [str(cell) for cell in trace([found]).rows[0]]
    assert shown == ["NAV-7", "Within 5 m & no more", "mine", "met", found.sentence]


def test_looks_double_up_to_the_most():
    assert [Looks(*asked).numbers for asked in ((12, 24), (6, 23), (24, 6))] == [[12, 24], [6, 12, 23], [24]]


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
