"""The rows of the table of a run are told apart by their names or by the line below it."""

import pytest

from bench.evaluation.key_figures import explain_rows, list_key_figures
from bench.evaluation.metrics import METRICS

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
            said = explain_rows([name]).removeprefix(explain_rows([])[:-1])
            assert len(said) > 20, name


@pytest.mark.parametrize(("name", "word"), [("coverage_3sigma_phi_n", "attitude"), ("cep95_m", "radius")])
def test_only_the_rows_that_are_there_are_explained(name, word):
    assert word in explain_rows([name])
    assert word not in explain_rows(["nees_mean"])
