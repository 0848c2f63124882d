"""The verdict of a run in words, its reason, and what is marked as outside."""

from __future__ import annotations

from io import StringIO

import numpy as np
import pytest
from rich.console import Console

from bench.cli.verbs import result_table
from bench.core.records.data import NavSolution
from bench.core.records.run_result import RunResult
from bench.evaluation.consistency.headline import find_best, judge_look
from bench.evaluation.consistency.verdict import (
    add_verdict,
    compare_drift,
    find_bounds,
    is_outside,
    judge_drift,
)
from bench.navigation.error_state_filter.state_blocks import GNSS_MARKOV

SOUND = {
    "converged": True,
    "reason": None,
    "pos_rmse_h_m": 13.69,
    "pos_sigma_h_m": 0.7,
    "nees_mean": 1031.0,
    "nees_states": 9.0,
    "nees_low": 1.0,
    "nees_high": 29.0,
    "coverage_3sigma_pos_n": 0.5,
    "coverage_3sigma_pos_e": 0.05,
    "coverage_low_pos_e": 0.5,
    "error_over_sigma_pos": 20.0,
    "error_over_sigma_vel": 2.0,
    "unmodeled_errors": ["gyro misalignment", *GNSS_MARKOV.takes],
}


def verdict(**changes):
    return add_verdict("loose-15", {**SOUND, **changes})


def test_an_overconfident_filter_is_told_with_figures_reason_and_remedy():
    found = verdict()
    assert found["verdict"] == "overconfident"
    assert found["verdict_text"] == (
        "loose-15 is overconfident: horizontal error 13.7 m, reported sigma 0.70 m (NEES 1031, ideal 9, one "
        "consistent run 1 to 29; east position inside 3 sigma 5 % of the time). Worst is the position, "
        "in 3D: 20 sigma, root mean square."
    )
    assert found["outside"] == ["nees_mean", "coverage_3sigma_pos_e"]


def test_without_a_truth_loud_innovations_are_overconfident():
    """Withheld fixes lie as near as reported, every NIS is far above its band; beside a truth a remark."""
    sound = {"nees_mean": 9.0, "coverage_3sigma_pos_e": 1.0, "coverage_3sigma_pos_n": 1.0}
    nis = {"nis_mean_gnss_position": 120.0, "nis_low_gnss_position": 2.8, "nis_high_gnss_position": 3.2}
    log = verdict(**sound, **nis, withheld_fixes=50)
    assert log["verdict"] == "overconfident"
    assert log["verdict_text"] == (
        "loose-15 is overconfident by its innovations, NIS of gnss_position 120 (at most 3.2): "
        "distance to withheld fixes 13.7 m, reported sigma 0.70 m."
    )
    quiet = verdict(**sound, **{**nis, "nis_mean_gnss_position": 1.0}, withheld_fixes=50)
    assert quiet["verdict"] == "undecided"
    assert "NIS of gnss_position 1 (at least 2.8): smaller than reported, but" in quiet["verdict_text"]
    fits = {**nis, "nis_mean_gnss_position": 3.0}
    assert verdict(**sound, **fits, withheld_fixes=50)["verdict"] == "consistent"
    assert verdict(**sound, **nis)["verdict"] == "consistent"


def test_an_estimate_that_used_every_fix_is_judged_by_its_innovations_alone():
    values = {"converged": True, "reason": None, "used_every_fix": True}
    nis = {"nis_mean_baro": 1.5, "nis_low_baro": 0.8, "nis_high_baro": 1.2}
    loud = add_verdict("autopilot", {**values, **nis})
    assert loud["verdict"] == "overconfident"
    assert "NIS of baro 1.5 (at most 1.2); it has used every fix" in loud["verdict_text"]
    assert loud["outside"] == ["nis_mean_baro"]
    for mean, says in (
        (1.0, "its innovations match"),
        (0.1, "smaller than reported, NIS of baro 0.1 (at least 0.8)"),
    ):
        quiet = add_verdict("autopilot", {**values, **nis, "nis_mean_baro": mean})
        assert quiet["verdict"] == "not evaluated"
        assert says in quiet["verdict_text"]
    assert "contains no innovations of it" in add_verdict("autopilot", values)["verdict_text"]
    without = add_verdict("ahrs", {**values, "without_fixes": True, **nis, "nis_mean_baro": 1.0})
    assert "the log has no fixes and no reference to evaluate it; its innov" in without["verdict_text"]
    still = {name.replace("baro", "gravity"): value for name, value in nis.items()} | {
        "nis_mean_gravity": 0.01
    }
    told = add_verdict("ahrs", {**values, "without_fixes": True, **still})["verdict_text"]
    assert "NIS of gravity 0.01 (at least 0.8), because their sigma allows for maneuvers" in told


@pytest.mark.parametrize(
    ("changes", "word", "part"),
    [
        (
            {"nees_mean": 9.0, "coverage_3sigma_pos_e": 1.0, "coverage_3sigma_pos_n": 1.0},
            "consistent",
            "one run can",
        ),
        ({"nees_mean": 0.1, "coverage_3sigma_pos_e": 1.0}, "underconfident", "covariance is too large"),
        ({"nees_mean": 9.0}, "overconfident", "NEES 9.0, ideal 9"),  # by its coverage
        (
            {"unmodeled_errors": []},
            "overconfident",
            "Worst is the position, in 3D: 20 sigma, root mean square.",
        ),
        ({"why_text": "Why: the moon."}, "overconfident", "of the time). Why: the moon."),
        (
            {"nees_mean": 0.1, "coverage_3sigma_pos_e": 1.0, "coverage_3sigma_pos_n": 1.0, "why_text": "A."},
            "underconfident",
            "29). A.",
        ),
        (
            {"converged": False, "reason": "lost", "why_text": "A."},
            "diverged",
            "lost. Horizontal error 13.7 m, reported sigma 0.70 m. A.",
        ),
        (
            {"unmodeled_errors": [], "error_over_sigma_pos": 1234.0, "nees_mean": 4e4, "nees_high": 2345.0},
            "overconfident",
            "Worst is the position, in 3D: 1230 sigma, root mean square.",
        ),
        ({"nees_mean": 4e4, "nees_high": 2345.0}, "overconfident", "one consistent run 1 to 2340"),
        ({"nees_mean": None}, "no covariance", "reports no covariance"),
        ({"converged": False, "failed": True, "reason": "failed: boom"}, "failed", "loose-15 failed: boom"),
        (
            {"converged": False, "reason": "gnss_position was rejected from t = 60 to 300 s"},
            "diverged",
            "diverged: gnss_position was rejected from t = 60 to 300 s. Horizontal error 13.7 m",
        ),
    ],
)
def test_each_verdict_has_its_word_and_its_figures(changes, word, part):
    found = verdict(**changes)
    assert found["verdict"] == word
    assert part in found["verdict_text"]


def test_a_drift_is_compared_with_the_law_of_its_datasheet():
    outage = {"outage_1_drift_h_m": 10.0, "outage_1_predicted_h_m": 9.0, "outage_1_predicted_95_h_m": 15.0}
    words = {14.0: "normal", 30.0: "more than normal, 2 times the 95 % radius", 0.5: "less than normal"}
    for grown, word in words.items():
        (text,) = verdict(**outage, outage_1_growth_h_m=grown)["drift_text"]
        assert text.endswith(f"at 95 %: {word}.")
    assert is_outside("outage_1_growth_h_m", {**outage, "outage_1_growth_h_m": 30.0})
    inertial = {
        "inertial_end_h_m": 54e3,
        "inertial_predicted_rms_h_m": 40e3,
        "inertial_predicted_95_h_m": 70e3,
    }
    (text,) = verdict(**inertial)["drift_text"]
    assert text == (
        "loose-15, unaided: 54.0 km off at the end; its datasheet gives 40.0 km rms, 70.0 km at 95 %: normal."
    )


def test_bounds_stand_beside_nees_nis_and_coverage():
    values = {**SOUND, "nis_mean_baro": 1.5, "nis_low_baro": 0.9, "nis_high_baro": 1.1}
    assert find_bounds("nees_mean", values) == (1.0, 29.0)
    assert find_bounds("nis_mean_baro", values) == (0.9, 1.1)
    assert find_bounds("coverage_3sigma_pos_e", values) == (0.5, None)
    assert find_bounds("pos_rmse_h_m", values) is None
    assert is_outside("nis_mean_baro", values)


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        (
            {"pos_max_h_m": 12048.0},
            "loose-15 is consistent with its covariance as far as one run can show, but up to 12.0 km off",
        ),
        ({"pos_max_v_m": 301.0}, "but up to 301 m off in height"),
        ({"vel_max_mps": 20.0}, "but up to 20 m/s off in velocity"),
        ({"tilt_rmse_deg": 31.0}, "but up to 31 deg off in tilt"),
        ({"heading_max_deg": 92.0}, "but up to 92 deg off in heading"),
        ({"pos_max_h_m": 999.0, "heading_max_deg": 59.0}, "is consistent with its covariance"),
    ],
)
def test_honest_and_useless_is_said(changes, part):
    """A covariance that is wide enough is consistent, and of no use beyond the limits of a divergence."""
    sound = {"nees_mean": 9.0, "coverage_3sigma_pos_e": 1.0, "coverage_3sigma_pos_n": 1.0}
    found = verdict(**sound, **changes)
    assert found["verdict"] == "consistent"
    assert part in found["verdict_text"]


@pytest.mark.parametrize("count", [1, 2, 5, 9])
def test_no_column_is_lost_at_80_characters(count):
    """Every filter, value and bound is in the printed tables, which are divided if they are too wide."""
    one, none = np.zeros((1, 3)), np.zeros((1, 0))
    solution = NavSolution(
        np.zeros(1), one, one, np.ones((1, 4)), one, one, np.ones((1, 9, 9)), (), none, none
    )
    values = {**SOUND, "nis_mean_gnss_position": 0.8369, "nis_low_gnss_position": 2.45}
    values["nis_high_gnss_position"] = 3.61
    labels = [f"estimator-{k}" for k in range(count)]
    measured = {
        label: {**add_verdict(label, values), "pos_rmse_h_m": 1000.0 + k} for k, label in enumerate(labels)
    }
    measured[labels[-1]]["same_as"] = "loose-22"
    out = StringIO()
    result_table.print_metrics(Console(file=out, width=80), measured, dict.fromkeys(labels, solution))
    printed = out.getvalue()
    assert max(map(len, printed.splitlines())) <= 80
    assert all(str(1000 + k) in printed for k in range(count))
    assert printed.count("0.8369 !") == count
    assert printed.count("2.45-3.61") + printed.count("2.45 to 3.61") == count
    assert "…" not in printed
    assert f"{labels[-1]}: the same as loose-22 with these sensors" in " ".join(printed.split())


def test_html_shows_the_verdict_and_marks_what_is_outside():
    result = RunResult({"title": "x <y>"}, 1, 0, {"loose-15": verdict()}, {}, {}, {})
    html = result._repr_html_()
    assert "<p>loose-15 is overconfident" in html
    assert '<td style="color:red">1031 !</td>' in html
    assert "x &lt;y&gt;" in html


def test_an_honest_claim_that_is_of_no_use_looks_like_a_warning_and_is_never_the_best():
    near, far = {"pos_max_h_m": 5.0}, {"pos_max_h_m": 1e6}
    looks = {
        (word, name): judge_look(word, values).kind
        for word in ("consistent", "underconfident", "overconfident", "same")
        for name, values in (("", None), ("near", near), ("far", far))
    }
    for name in ("", "near"):
        assert [kind for (_, one), kind in looks.items() if one == name] == ["good", "wide", "bad", "none"]
    assert [kind for (_, one), kind in looks.items() if one == "far"] == ["wide", "wide", "bad", "none"]
    useless, honest, bold = (
        {"verdict": word, **values}
        for word, values in (("consistent", far), ("consistent", near), ("overconfident", near))
    )
    assert find_best({"bold": bold, "useless": useless, "honest": honest, "other": honest}) == "honest"
    assert find_best({"bold": bold, "useless": useless}) == "bold"
    assert find_best({}) == ""


HONEST = {
    "converged": True, "reason": None, "pos_rmse_h_m": 2.0, "pos_sigma_h_m": 2.5,
    "nees_mean": 9.0, "nees_states": 9.0, "nees_low": 5.0, "nees_high": 14.0,
}  # fmt: skip


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({}, "consistent"),
        *(({f"nees_{name}": None}, "no covariance") for name in ("mean", "states", "low", "high")),
        ({"nees_mean": 14.1}, "overconfident"),
        ({"nees_mean": 4.9}, "underconfident"),
        ({"coverage_3sigma_vel_n": 0.5, "coverage_low_vel_n": 0.6}, "overconfident"),
        ({"coverage_3sigma_vel_n": 0.7, "coverage_low_vel_n": 0.6}, "consistent"),
        ({"coverage_3sigma_vel_n_all": 0.5, "coverage_low_vel_n_all": 0.6}, "consistent"),
        ({"coverage_3sigma_bias_gyro_x": 0.5, "coverage_low_bias_gyro_x": 0.6}, "consistent"),
    ],
)
def test_the_word_of_a_claim_by_its_bounds(change, word):
    assert add_verdict("x", {**HONEST, **change})["verdict"] == word


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            {"nis_mean_gnss": 5.0, "nis_mean_baro": 0.2},
            "overconfident by its innovations, NIS of gnss 5 (at most 4)",
        ),
        ({"nis_mean_baro": 0.2}, "undecided, NIS of baro 0.2 (at least 0.5): smaller than reported"),
        (
            {"nees_mean": 4.0},
            "undecided, NEES 4.0; one run of a consistent filter stays within 5 to 14: smaller than reported",
        ),
        ({"nis_mean_gnss_all": 5.0}, "consistent with its covariance"),
    ],
)
def test_without_a_truth_innovations_beyond_their_band_are_named(change, named):
    """Those that are too large, if there are any: those that are too small are not told beside them."""
    band = {"nis_low_gnss": 2.0, "nis_high_gnss": 4.0, "nis_low_baro": 0.5, "nis_high_baro": 2.0}
    values = {**HONEST, **band, "nis_mean_gnss": 3.0, "nis_mean_baro": 1.0, "withheld_fixes": 10, **change}
    text = add_verdict("x", values)["verdict_text"]
    assert named in text
    assert ("baro" in text) == ("baro 0.2" in named)
    used = add_verdict("x", {**values, "used_every_fix": True})
    assert used["verdict"] == ("overconfident" if "nis_mean_gnss" in change else "not evaluated")
    with_truth = add_verdict("x", {name: one for name, one in values.items() if name != "withheld_fixes"})
    assert with_truth["verdict"] == ("underconfident" if "nees_mean" in change else "consistent")


def test_a_drift_is_normal_between_its_quantiles():
    """The radius of 5 % is sqrt(ln 0.95 / ln 0.05) = 0.1309 of that of 95 %."""
    drifts = [compare_drift(one, 100.0) for one in (13.0, 13.2, 100.0)]
    assert drifts == ["less than normal", "normal", "normal"]
    assert compare_drift(250.0, 100.0) == "more than normal, 2.5 times the 95 % radius"


def test_a_drift_is_told_where_everything_of_it_is_known():
    outage = {"outage_2_growth_h_m": 30.0, "outage_2_drift_h_m": 20.0, "outage_2_predicted_h_m": 40.0}
    outage["outage_2_predicted_95_h_m"] = 70.0
    (told,) = judge_drift("x", {**outage, "other_predicted_95_h_m": 1.0})
    assert told == (
        "x, outage 2: the error moved by 30.0 m and ended at 20.0 m; predicted: 40.0 m rms, "
        "70.0 m at 95 %: normal."
    )
    free = {"inertial_end_h_m": 80.0, "inertial_predicted_rms_h_m": 40.0, "inertial_predicted_95_h_m": 70.0}
    (told,) = judge_drift("x", free)
    assert told == (
        "x, unaided: 80.0 m off at the end; its datasheet gives 40.0 m rms, 70.0 m at 95 %: "
        "more than normal, 1.1 times the 95 % radius."
    )
    for known in (outage, free):
        for name in known:
            assert judge_drift("x", {**known, name: None}) == []


@pytest.mark.parametrize(
    ("name", "value", "values", "outside"),
    [
        ("nees_mean", 15.0, HONEST, True),
        ("nees_mean", 4.0, HONEST, True),
        ("nees_mean", 9.0, HONEST, False),
        ("nees_bias_gyro", 3.0, {"nees_low_bias_gyro": 0.5, "nees_high_bias_gyro": 2.0}, True),
        ("nees_bias_gyro", 0.4, {"nees_low_bias_gyro": 0.5, "nees_high_bias_gyro": 2.0}, True),
        ("coverage_3sigma_pos_n", 0.5, {"coverage_low_pos_n": 0.6}, True),
        ("coverage_3sigma_pos_n", 1.0, {"coverage_low_pos_n": 0.6}, False),
        ("outage_1_growth_h_m", 8.0, {"outage_1_predicted_95_h_m": 7.0}, True),
        ("outage_1_growth_h_m", 6.0, {"outage_1_predicted_95_h_m": 7.0}, False),
        ("outage_1_drift_h_m", 8.0, {"outage_1_predicted_95_h_m": 7.0}, False),
        ("inertial_end_h_m", 8.0, {"inertial_predicted_95_h_m": 7.0}, True),
        ("pos_rmse_h_m", 99.0, HONEST, False),
    ],
)
def test_a_metric_lies_outside_of_the_bounds_that_it_has(name, value, values, outside):
    assert is_outside(name, {**values, name: value}) == outside
    assert not is_outside(name, {**values, name: None})


def test_the_worst_block_and_axis_of_a_broken_claim_are_named():
    broken = {**HONEST, "nees_mean": 150.0, "coverage_3sigma_pos_n": 0.97, "coverage_3sigma_pos_e": 0.6}
    broken |= {"error_over_sigma_pos": 3.0, "error_over_sigma_vel": 5.0, "error_over_sigma_phi": None}
    text = add_verdict("x", broken)["verdict_text"]
    assert "NEES 150, ideal 9, one consistent run 5 to 14; east position inside 3 sigma 60 %" in text
    assert "Worst is the velocity, in 3D: 5 sigma" in text
    assert text.startswith("x is overconfident: NEES")
    text = add_verdict("x", {**broken, "pos_rmse_h_m": 3.0, "nees_mean": 99.0})["verdict_text"]
    assert text.startswith("x is overconfident: horizontal error 3.0 m, reported sigma 2.5 m (NEES 99,")
    text = add_verdict("x", {**broken, "coverage_3sigma_pos_e": 0.995})["verdict_text"]
    assert "north position inside 3 sigma 97 %" in text
