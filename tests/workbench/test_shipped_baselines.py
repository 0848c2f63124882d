"""The accuracy of the shipped profiles is what tests/baselines holds, run by run.

``make check`` also flies the longer profiles that have a baseline.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import stdtrit

from bench.core.mathematics.units import unit_of
from bench.evaluation.ensembles import ensemble
from bench.experiments.baselines import checking
from bench.experiments.baselines.baseline_file import read_baseline
from bench.navigation.models.loose_tight import Loose

DIRECTORY = Path(__file__).parents[1] / "baselines"
SHORT = ("gnss-faults", "high-dynamics")
ROOT = Path(__file__).parents[2]
FIGURES = {
    "horizontal position RMSE": "pos_rmse_h_m",
    "vertical position RMSE": "pos_rmse_d_m",
    "velocity RMSE, 3D": "vel_rmse_3d_mps",
    "tilt RMSE": "tilt_rmse_deg",
    "heading RMSE": "heading_rmse_deg",
    "horizontal growth in the outage": "outage_1_growth_h_m",
    "mean NEES (9 is right)": "nees_mean",
}
"""Row of the table of the guide -> the metric that it shows."""


HEAD = "`loose-full` | `loose-15` | `loose-15`, every error modeled |\n"
COLUMNS = (
    ("figure-eight", "loose-full"),
    ("figure-eight", "loose-15"),
    ("figure-eight-matched", "loose-15"),
)


def write_figure(name: str, use: str, metric: str) -> str:
    """A metric over the runs of a baseline, with its 95 % interval, as the tables have it."""
    row = read_baseline(DIRECTORY / f"{name}.json").estimators[use]
    values = np.array(row.metrics[metric])
    if metric == "nees_mean":
        half = stdtrit(len(values) - 1, 0.975) * values.std(ddof=1) / np.sqrt(len(values))
        numbers = [values.mean(), values.mean() - half, values.mean() + half]
    else:
        found = ensemble.pool_rmse(values**2)
        numbers = [found.value, found.low, found.high]
    unit = unit_of(metric)
    texts = [f"{x:#.3g}".rstrip(".") for x in numbers]
    return f"{texts[0]} ({texts[1]} to {texts[2]}){f' {unit}' if unit else ''}"


def test_the_figure_of_readme_is_that_of_the_baseline():
    shown = write_figure("figure-eight-matched", "loose-15", "nees_mean").replace("(", "(95 % interval ")
    assert f"| {shown}; 9 is ideal |" in (ROOT / "README.md").read_text()


def test_the_figures_of_the_table_are_those_of_the_baselines():
    text = (ROOT / "bench/guide/accuracy.md").read_text()
    table = text[text.index(HEAD) + len(HEAD) :].split("\n\n")[0].splitlines()[1:]
    assert len(table) >= 4
    for line in table:
        title, *cells = (cell.strip() for cell in line.strip("|").split("|"))
        found = [write_figure(name, use, FIGURES[title]) for name, use in COLUMNS]
        assert cells == found, title


@pytest.mark.slow
def test_the_accuracy_of_the_short_profiles_holds():
    found = checking.check(SHORT, directory=DIRECTORY)
    assert [row.sentence for row in found if row.word != "same"] == []
    assert {row.draws for row in found if row.metric == "converged"} == {20}


@pytest.mark.slow
def test_a_lever_arm_left_out_is_found(monkeypatch):
    """A defect of decimeters shows beside an error of meters, draw for draw."""
    run = Loose.run
    monkeypatch.setattr(
        Loose, "run", lambda self, data, initial: run(self, replace(data, antenna_b=np.zeros(3)), initial)
    )
    monkeypatch.setattr(checking, "LOOKS", (20,))
    found = checking.check(["high-dynamics"], directory=DIRECTORY, estimators=["loose-15"])
    worse = {row.metric: row for row in found if row.word == "worse"}
    assert worse["vel_rmse_3d_mps"].paired
