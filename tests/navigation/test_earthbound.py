"""A state that has left the Earth ends its filter, with the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.navigation.built_in import load
from bench.navigation.engine.earthbound import FASTEST, HIGHEST, Earthbound
from bench.simulation import sensors
from tests.navigation.test_pieces import joined, pieces
from tests.weaving import units, weaving

USED = ["loose-15", "free-inertial", "smoother", "ukf", "classic-22", "gnss-only", "invariant-ekf",
        "graph-smoother"]  # fmt: skip


@pytest.fixture(scope="module")
def drawn():
    """A few seconds, whose start has its velocity in a wrong unit."""
    drawn = sensors.sense(weaving(6.0, 50.0), units(), 3, 0)
    return drawn, replace(drawn.initial, vel_n=1e6 * drawn.initial.vel_n)


@pytest.mark.parametrize("use", USED)
def test_every_filter_stops_with_its_reason(drawn, use):
    sensed, start = drawn
    solution = load(use, {}).run(sensed.data, start)
    assert not np.isfinite(solution.lla).any()
    assert not np.isfinite(solution.cov).any()
    ((_, _, text),) = solution.events.select("ended")
    assert text.endswith("2.06e+07 m/s; the filter has stopped")
    assert not len(load(use, {}).run(sensed.data, sensed.initial).events.select("ended"))


@pytest.mark.parametrize("use", ["loose-15", "ukf", "gnss-only"])
def test_it_stays_stopped_in_all_pieces(drawn, use):
    sensed, start = drawn
    filter_ = bench.open_filter(use, start, {}, look_back=0.5)
    found = [filter_.update(piece) for piece in pieces(sensed.data, [1.0, 2.5, 4.0])] + [filter_.finish()]
    assert not np.isfinite(joined(found).lla).any()
    assert sum(len(one.events.select("ended")) for one in found) == 1


@pytest.mark.parametrize(
    ("lat", "height", "speed", "left"),
    [
        (1.57, HIGHEST, -FASTEST, False),
        (0.1, -1.001 * HIGHEST, 0.0, True),
        (0.1, 0.0, 1.001 * FASTEST, True),
        (-1.58, 0.0, 0.0, True),
        (np.nan, 0.0, 0.0, True),
        (0.1, 0.0, np.inf, True),
    ],
)
def test_the_limits(lat, height, speed, left):
    state = np.zeros((3, 7))
    state[1, :6] = lat, 0.1, height, 0.0, speed, 0.0
    bound, other = Earthbound(), np.ones((3, 9, 9))
    events = bound.end_answers(np.array([1.0, 2.0, 3.0]), state, other)
    assert [row[:3] for row in events] == ([(2.0, 2.0, "ended")] if left else [])
    assert np.isfinite(other).all(axis=(1, 2)).tolist() == [True, not left, not left]
    assert bound.end_answers(np.array([4.0]), state[:1], other[:1]) == []
    assert np.isfinite(other[0]).all() != left


@pytest.mark.parametrize("variance", [np.nan, np.inf, 0.0, -1e-12])
def test_a_variance_that_is_none_ends_the_filter(variance):
    cov = np.tile(np.eye(9), (3, 1, 1))
    cov[1, 4, 4] = variance
    state = np.zeros((3, 7))
    ((t, _, _, text, _),) = Earthbound().end_answers(np.array([1.0, 2.0, 3.0]), state, cov)
    assert t == 2.0
    assert text == "a variance is not finite or not above 0; the filter has stopped"
    assert np.isfinite(state).all(axis=1).tolist() == [True, False, False]


@pytest.mark.parametrize("every", [False, True])
def test_a_row_without_a_state_is_no_answer_unless_every_row_is(every):
    state, cov = np.zeros((3, 7)), np.tile(np.eye(9), (3, 1, 1))
    state[2], cov[2] = np.nan, np.nan
    events = Earthbound().end_answers(np.array([1.0, 2.0, 3.0]), state, cov, every=every)
    assert [row[3] for row in events] == ["the state is not finite; the filter has stopped"] * every
