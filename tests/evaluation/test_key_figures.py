"""The metrics of a run are read in words, each its own, with a unit and a heading."""

import pytest

from bench.core.words.wording import format_number
from bench.evaluation.metrics.key_figures import explain_rows, format_bound, list_key_figures
from bench.evaluation.metrics.metric_words import find_words, format_metric, group_metrics, list_wordless
from bench.evaluation.metrics.run_metrics import METRICS


def test_every_metric_has_words_of_its_own():
    """No two rows of a table read alike, none is an identifier, and all stand under a heading."""
    names = {metric.name.format("n" if "phi" in metric.name else "gps") for metric in METRICS}
    assert list_wordless() == []
    told = {find_words(name).words for name in names - {"coverage_3sigma_bias_gps"}}
    assert len(told) == len(names) - 1
    assert not any("_" in words for words in told)
    for metric in METRICS:
        assert len(metric.words) > 10, metric.name
        assert metric.words in str(getattr(metric.function, "func", metric.function).__doc__)
    assert sum(map(len, group_metrics(names).values())) == len(names)


@pytest.mark.parametrize(
    ("name", "value", "read"),
    [
        ("pos_rmse_h_m", 5.99, "horizontal error, rms 5.99 m"),
        ("coverage_3sigma_vel_d", 0.9812, "vertical velocity within 3 sigma 98.1 %"),
        ("coverage_3sigma_phi_d", 1.0, "heading within 3 sigma 100 %"),
        ("phi_rmse_n_deg", 0.054, "tilt about north error, rms 0.054 deg"),
        ("outage_2_drift_h_m", 7.666, "outage 2: error at its end 7.666 m"),
        ("nis_mean_gnss_position", 2.9, "NIS GNSS position, mean 2.9"),
        ("fault_1_detected", 1.0, "fault 1: detected yes"),
        ("rpe_10s_m_all", 1.85, "relative error over 10 s, whole run 1.85 m"),
        ("false_alarm_rate_per_h", None, "false alarms - 1/h"),
    ],
)
def test_a_metric_is_read_with_its_value_and_unit(name, value, read):
    words = find_words(name)
    assert f"{words.words} {format_metric(name, value)} {words.unit}".rstrip() == read


@pytest.mark.parametrize(("name", "word"), [("coverage_3sigma_phi_n", "99.7 %"), ("nees_mean", "normalized")])
def test_only_the_rows_that_are_there_are_explained(name, word):
    assert len(list_key_figures({"x": {name: 0.5}})) == 1
    assert word in " ".join(explain_rows([name]))
    assert word not in " ".join(explain_rows(["vel_rmse_3d_mps"]))


def test_numbers_have_no_power_of_ten_below_ten_million():
    values = (None, 0.012346, 9999.6, 21_164.0, 9_999_600.0, 1.23456e8, 1e-7)
    assert [format_number(x) for x in values] == [
        "-", "0.01235", "10000", "21160", "10000000", "1.235e+08", "1e-07"
    ]  # fmt: skip


def test_bounds_have_two_decimals_below_ten_and_three_digits_from_there_on():
    assert [format_bound(value) for value in (0.5, 1.048, 9.999, 28.96, 161.4)] == [
        "0.50",
        "1.05",
        "10.00",
        "29",
        "161",
    ]
