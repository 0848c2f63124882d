"""The rows of the table of a run are told apart by their names or by the line below it."""

import pytest

from bench.evaluation.key_figures import explain_rows, list_key_figures
from bench.evaluation.metrics import METRICS
from bench.wording import format_number

PLAIN = (
    "pos_rmse", "vel_rmse", "tilt_rmse", "heading_rmse",  # named as in every textbook
    "outage_", "fault_", "false_alarms_",  # count what a profile scripts; outages have a line
    "output_coverage",
)  # fmt: skip


def test_every_row_is_plain_or_explained():
    names = [metric.name.format("1") for metric in METRICS]
    rows = list_key_figures({"x": dict.fromkeys(names, 0.5)})
    assert len(rows) > 20
    for name in rows:
        if not name.startswith(PLAIN):
            said = explain_rows([name])[1:]
            assert said, name
            assert len(said[0]) > 20


@pytest.mark.parametrize(("name", "word"), [("coverage_3sigma_phi_n", "attitude"), ("cep95_m", "radius")])
def test_only_the_rows_that_are_there_are_explained(name, word):
    assert word in " ".join(explain_rows([name]))
    assert word not in " ".join(explain_rows(["nees_mean"]))


def test_numbers_have_no_power_of_ten_below_ten_million():
    values = (None, 0.012346, 9999.6, 21_164.0, 9_999_600.0, 1.23456e8, 1e-7)
    assert [format_number(x) for x in values] == [
        "-", "0.01235", "10000", "21160", "10000000", "1.235e+08", "1e-07"
    ]  # fmt: skip
