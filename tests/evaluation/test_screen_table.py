"""The tables of a run and of a log by hand: each cell from its metric, and a dash if it is absent."""

from __future__ import annotations

from typing import Any

import pytest

from bench.core.words.notebook import format_cell
from bench.evaluation.consistency.headline import make_headline
from bench.evaluation.consistency.screen_table import tabulate_log, tabulate_run

SOUND = {
    "verdict": "consistent", "converged": True, "nees_mean": 7.74, "nees_states": 9.0,
    "pos_rmse_h_m": 6.04, "pos_sigma_h_m": 6.1, "pos_rmse_d_m": 0.257,
    "vel_rmse_3d_mps": 0.0851, "tilt_rmse_deg": 0.1, "heading_rmse_deg": 1.25,
}  # fmt: skip


def show(tabulate, measured: dict[str, dict[str, Any]], **look: bool) -> dict[str, list[str]]:
    lines = [make_headline(label, values) for label, values in measured.items()]
    table = tabulate(measured, lines, **look)
    columns = table.columns.items()
    return {head.replace("\n", " "): [format_cell(one) for one in cells] for head, cells in columns}


def test_each_cell_is_its_metric():
    found = show(tabulate_run, {"a": SOUND})
    assert found == {
        "filter": ["a"], "horizontal RMS": ["6.0 m"], "reported 1 sigma": ["6.1 m"],
        "vertical RMS": ["0.26 m"], "NEES ideal 9": ["7.7"], "verdict": ["✓ consistent"],
    }  # fmt: skip
    wide = show(tabulate_run, {"a": SOUND}, wide=True)
    assert [wide[head] for head in ("velocity RMS", "tilt RMS", "heading RMS")] == [
        ["0.085 m/s"],
        ["0.1 deg"],
        ["1.2 deg"],
    ]


@pytest.mark.parametrize(("mean", "shown"), [(9.0, "9.0"), (0.049, "0.049"), (99.4, "99"), (1031.4, "1031")])
def test_a_nees_has_two_digits_or_is_whole(mean, shown):
    assert show(tabulate_run, {"a": {**SOUND, "nees_mean": mean}})["NEES ideal 9"] == [shown]


def test_filters_of_different_states_have_their_ideal_beside():
    found = show(tabulate_run, {"a": SOUND, "b": {**SOUND, "nees_states": 6.0}, "c": {"verdict": "failed"}})
    assert found["NEES (ideal)"] == ["7.7 (9)", "7.7 (6)", "-"]
    assert found["horizontal RMS"] == ["6.0 m", "6.0 m", "-"]
    assert found["verdict"][2] == "✗ failed"


def test_the_largest_drift_and_the_worst_fault_are_shown_and_none_of_a_filter_without_aiding():
    grown = {"outage_1_growth_h_m": 3.0, "outage_2_growth_h_m": 14.0, "outage_3_growth_h_m": None}
    free = {"inertial_end_h_m": 9e3, "inertial_predicted_95_h_m": 1e4}
    fault = {"fault_1_max_h_m": 2.0, "fault_1_detected": 0.0, "fault_1_delay_s": None}
    worse = {"fault_2_max_h_m": 5.0, "fault_2_detected": 1.0, "fault_2_delay_s": 1.25}
    measured = {
        "a": {**SOUND, **grown, **fault}, "b": {**SOUND, **grown, **free, **fault, **worse}, "c": SOUND,
    }  # fmt: skip
    found = show(tabulate_run, measured)
    assert found["outage drift"] == ["14.0 m", "-", "-"]
    assert found["fault detected"] == ["no", "1.2 s", "-"]


def test_a_log_has_the_nis_of_each_sensor_and_the_range_that_fits():
    nis = {"nis_mean_gnss_position": 0.169, "nis_low_gnss_position": 2.4, "nis_high_gnss_position": 3.7}
    baro = {"nis_mean_baro": 98.9, "nis_low_baro": 0.77, "nis_high_baro": 1.26, "nis_mean_baro_all": 1.0}
    log = {**SOUND, "withheld_fixes": 50, **nis, **baro}
    found = show(tabulate_log, {"a": log})
    assert found["filter"] == ["a", "range"]
    assert found["NIS position"] == ["0.169", "2.4-3.7"]
    assert found["NIS baro"] == ["98.9", "0.77-1.3"]
    assert found["horizontal RMS"] == ["6.0 m", ""]
    assert "NIS baro_all" not in found
    both = show(tabulate_log, {"a": log, "b": {**log, "nis_high_baro": 2.0}, "c": {"verdict": "failed"}})
    assert both["filter"][-1] == "range (1st)"
    assert both["NIS baro"] == ["98.9", "98.9", "-", "0.77-1.3"]
    assert show(tabulate_log, {"a": SOUND})["filter"] == ["a", "range"]
