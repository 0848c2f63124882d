"""The end of a flight that crashes, found in its record."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from bench.cli.new_files.log_starts import find_impact


def record(wild, speeds, last=100.0):
    """A record of 100 s that turns wildly at some epochs [s], with a speed [m/s] each second."""
    t = np.arange(0.01, last, 0.01)
    dtheta = np.zeros((len(t), 3))
    for at in wild:
        dtheta[round(at / 0.01) - 1, 1] = 0.3  # 30 rad/s
    speeds = np.asarray(speeds, float)
    fixes = SimpleNamespace(
        t=np.arange(float(len(speeds))),
        valid=np.ones(len(speeds), bool),
        vel_n=np.column_stack([speeds, np.zeros((len(speeds), 2))]),
    )
    imu = SimpleNamespace(t=t, dt=np.full(len(t), 0.01), dtheta_b=dtheta, valid=np.ones(len(t), bool))
    return SimpleNamespace(imu=imu, fixes=fixes)


FLIES, LIES, UNKNOWN = [10.0] * 60, [0.1] * 40, [np.nan] * 40


@pytest.mark.parametrize(
    ("wild", "speeds", "last", "found"),
    [
        ([60.0, 61.0], FLIES + LIES, 100.0, 59.0),
        ([20.0, 60.0], FLIES + LIES, 100.0, 59.0),  # the first was a flip, or a glitch
        ([20.0], FLIES + LIES, 100.0, None),  # it lands
        ([60.0], FLIES + [10.0] * 40, 100.0, None),
        ([60.0], FLIES + UNKNOWN, 100.0, None),  # nothing says that it lies
        ([60.0], FLIES, 62.0, 59.0),  # the record ends with it
        ([], FLIES + LIES, 100.0, None),
    ],
)
def test_an_impact_is_a_tumble_after_which_nothing_moves(wild, speeds, last, found):
    assert find_impact(record(wild, speeds, last)) == (None if found is None else pytest.approx(found))
