"""The accuracy of the shipped profiles is what tests/baselines holds, draw by draw.

``make check`` also flies the longer profiles that have a baseline.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from bench.baselines import checking
from bench.navigation.fusion import Loose

DIRECTORY = Path(__file__).parents[1] / "baselines"
SHORT = ("gnss-faults", "high-dynamics")
pytestmark = pytest.mark.slow


def test_the_accuracy_of_the_short_profiles_holds():
    found = checking.check(SHORT, directory=DIRECTORY)
    assert [row.sentence for row in found if row.word != "same"] == []
    assert {row.draws for row in found if row.metric == "converged"} == {20}


def test_a_lever_arm_left_out_is_found(monkeypatch):
    """A defect of decimetres shows beside an error of metres, draw for draw."""
    run = Loose.run
    monkeypatch.setattr(
        Loose, "run", lambda self, data, initial: run(self, replace(data, antenna_b=np.zeros(3)), initial)
    )
    monkeypatch.setattr(checking, "LOOKS", (20,))
    found = checking.check(["high-dynamics"], directory=DIRECTORY, estimators=["loose-15"])
    worse = {row.metric: row for row in found if row.word == "worse"}
    assert worse["vel_rmse_3d_mps"].paired
