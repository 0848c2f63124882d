"""The replay finds what an error-free strapdown would make of a truth: nothing where the truth is one motion,
the error that mechanics gives where it is not, and it starts anew every ten minutes."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bench.core.records.data import Trajectory, no_events
from bench.evaluation.errors.replay import STRETCH, Replay
from bench.navigation import mechanization
from tests.synthetic import still

RATE = 20.0  # [Hz]


def replayed(*pieces: Trajectory) -> Replay:
    replay = Replay()
    for piece in pieces:
        replay.add(piece)
    return replay


def cut(truth: Trajectory, *rows: int) -> list[Trajectory]:
    bounds = [0, *rows, len(truth) - 1]
    return [
        replace(
            truth,
            **{name: getattr(truth, name)[a : b + 1] for name in ("t", "lla", "vel_n", "q_nb")},
            **{name: getattr(truth, name)[a:b] for name in ("dtheta_b", "dvel_b")},
            events=no_events(),
        )
        for a, b in pairwise(bounds)
    ]


@pytest.fixture(scope="module")
def rest() -> Trajectory:
    """25 minutes."""
    return still(1500.0, RATE, (0.0, 0.0, 0.0))


def biased(truth: Trajectory, start: float, end: float, bias: float = 1e-6) -> Trajectory:
    """An accelerometer bias forward, here north, from start to end [m/s^2]."""
    dvel_b = truth.dvel_b.copy()
    dvel_b[(truth.t[:-1] >= start - 1e-6) & (truth.t[:-1] < end - 1e-6), 0] += bias / RATE
    return replace(truth, dvel_b=dvel_b)


def test_a_sound_truth_comes_back(rest):
    """At 20 Hz; a resting body has nothing to correct but the turn of the Earth."""
    result = replayed(rest).result()
    assert set(result) == {"replay_position_m", "replay_attitude_rad"}
    assert result["replay_position_m"] < 1e-4
    assert result["replay_attitude_rad"] < 1e-10


def test_a_bias_drifts_as_schuler_says_and_no_longer_than_ten_minutes(rest):
    """b (1 - cos(w t)) / w^2 with w^2 = g / R: 0.172 m after 600 s; 0.79 m after 1500 s."""
    w = np.sqrt(9.81 / 6.37e6)
    drift = 1e-6 * (1 - np.cos(w * STRETCH)) / w**2
    for start, end in ((0, 1500), (0, 600), (600, 1200)):
        assert replayed(biased(rest, start, end)).position == pytest.approx(drift, rel=0.01)
    assert replayed(biased(rest, 1200, 1500)).position < 0.3 * drift


def test_an_attitude_that_is_not_the_gyros_is_seen(rest):
    dtheta_b = rest.dtheta_b.copy()
    dtheta_b[100, 2] += 1e-6
    assert replayed(replace(rest, dtheta_b=dtheta_b)).attitude == pytest.approx(1e-6, rel=1e-3)


@pytest.mark.parametrize("rows", [(1,), (7, 8, 5000), (11999, 12000, 12001), (12000, 24000)])
def test_pieces_give_what_the_whole_gives(rest, rows):
    truth = biased(rest, 0, 1500)
    assert replayed(*cut(truth, *rows)).result() == replayed(truth).result()


def test_the_strapdown_takes_a_record_in_pieces(short_truth):
    """The interval before goes along: coning and sculling corrections do not begin anew."""
    truth, before = short_truth, np.zeros(7)
    start, dt = (truth.lla[0], truth.vel_n[0], truth.q_nb[0]), np.diff(truth.t)
    whole = mechanization.propagate(*start, dt, truth.dtheta_b, truth.dvel_b)
    for part in (slice(0, 1500), slice(1500, 1501), slice(1501, None)):
        found = mechanization.propagate(*start, dt[part], truth.dtheta_b[part], truth.dvel_b[part], before)
        assert_array_equal(found[1:], whole[1:][part])
        start = found[-1, :3], found[-1, 3:6], found[-1, 6:]


def test_the_figure_of_the_figure_eight_is_below_a_millimeter(figure_eight_truth):
    replay = replayed(figure_eight_truth)
    assert 1e-5 < replay.position < 1e-3
    assert 1e-11 < replay.attitude < 1e-6
