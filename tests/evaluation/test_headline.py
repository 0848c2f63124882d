"""What a run says of a filter in a few lines, each by hand; nothing where there is nothing to say."""

from __future__ import annotations

import pytest

from bench.evaluation.consistency.headline import Headline, make_headline


def head(**values) -> Headline:
    return make_headline("mine", {"verdict": "consistent", "converged": True} | values)


def test_an_error_stands_behind_the_reason_and_before_the_path():
    across = {"tse_across_max_m": 91.0, "fte_across_max_m": 1.5, "nse_across_max_m": 90.0}
    path = "path error up to 91.0 m: 1.5 m by its own estimate, navigation error 90.0 m"
    lost = {"verdict": "diverged", "verdict_reason": "1 km off"}
    found = {"pos_rmse_h_m": 3.0}
    assert head(**found, **across).error == f"horizontal error 3.0 m; {path}"
    assert head(**lost).reason == "1 km off"
    assert head(**across).error == path
    assert head(tse_across_max_m=91.0, fte_across_max_m=1.5).error == ""


def test_the_fault_that_moved_it_most_is_told():
    first = {"fault_1_max_h_m": 5.0, "fault_1_alarm_share": 0.5, "fault_1_delay_s": 2.25}
    second = {"fault_2_max_h_m": 71.0, "fault_2_alarm_share": 0.0, "fault_2_delay_s": None}
    noticed = "detected after 2.2 s, rejected for 50 % of its time, error up to 5.0 m"
    assert head(**first).fault == f"fault 1: {noticed}"
    both = head(**first, **second, fault_3_max_h_m=None).fault
    assert both == "fault 2, the worst of 2: not detected, error up to 71.0 m"
    assert head(fault_1_max_h_m=5.0).fault == head(**second | {"fault_2_max_h_m": None}).fault == ""


def test_figures_are_those_that_are_there():
    nees = {"nees_mean": 9.123, "nees_low": 3.14, "nees_high": 20.22}
    found = head(pos_rmse_d_m=2.345, vel_rmse_3d_mps=0.1234, heading_rmse_deg=0.5678, **nees)
    begin = "height 2.3 m; velocity 0.12 m/s; heading 0.57 deg; NEES 9.1; one run of a consistent filter"
    assert found.figures == f"{begin} stays within 3.1 to 20"
    for name in nees:
        assert head(**nees | {name: None}).figures == ""


def test_the_worst_outage_is_told_unless_all_of_it_was_without_aiding():
    grown = {"outage_1_growth_h_m": 5.0, "outage_2_growth_h_m": 50.0, "outage_3_growth_h_m": None}
    worst = "worst of 2 GNSS outages: drift 50.0 m"
    assert head(**grown).drift == worst
    assert head(**grown, outage_2_predicted_95_h_m=80.0).drift == f"{worst}, 95 % limit 80.0 m"
    assert head(outage_1_growth_h_m=5.0).drift == "GNSS outage: drift 5.0 m"
    assert head(outage_1_growth_h_m=5.0, inertial_end_h_m=500.0).drift == "GNSS outage: drift 5.0 m"
    assert head(outage_1_growth_h_m=5.0, inertial_predicted_95_h_m=9.0).drift == "GNSS outage: drift 5.0 m"
    alone = head(outage_1_growth_h_m=5.0, inertial_end_h_m=500.0, inertial_predicted_95_h_m=900.0).drift
    assert alone == "500 m off at the end without aiding (95 % limit 900 m)"


def test_axes_that_are_outside_too_long_are_told_the_worst_first():
    axes = {"pos_d": 0.5, "pos_n": 0.89, "pos_e": 0.91, "vel_n": 0.7}
    inside = {f"coverage_3sigma_{axis}": share for axis, share in axes.items()}
    told = "errors beyond 3 sigma: height 50 %, north velocity 30 %, north 11 % of the time"
    assert head(**inside).outside == told
    fourth = {"coverage_3sigma_phi_d": 0.992, "coverage_low_phi_d": 0.995}  # rare, and rarer than allowed
    assert head(**inside, **fourth).outside == f"{told}, 1 more"
    assert head(**fourth).outside == "errors beyond 3 sigma: heading 0.8 % of the time"
    assert head(coverage_3sigma_pos_e=0.91).outside == head().outside == ""


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({"causes": [{"cause": one} for one in "aba"], "advice_text": "Do it."}, "cause: a, b. Do it."),
        ({"causes": [{"cause": "a"}], "why_text": "Why: that."}, "cause: a."),
        ({"why_text": "Why: that."}, "cause: that."),
        ({}, ""),
    ],
)
def test_why_is_the_causes_or_a_sentence(values, why):
    assert head(**values).why == why


def test_lines_below_the_first_are_those_with_words_or_a_note_alone():
    found = head(pos_rmse_d_m=2.0, why_text="Why: that.", coverage_3sigma_pos_d=0.5)
    assert found.more == ("height 2.0 m", "errors beyond 3 sigma: height 50 % of the time", "cause: that.")
    assert head(pos_rmse_d_m=2.0, same_as="other").more == ("the same as other with these sensors",)
