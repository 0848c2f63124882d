"""How often a convention is named: never without one, and nearly always if it is large enough.

A few runs of each; ``python -m tests.evaluation.convention_power`` makes the tables.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.navigation import built_in, estimator
from bench.simulation import sensors
from tests.evaluation import convention_power, unlisted
from tests.evaluation.convention_power import CLASSES, PLANTS, ask, plant
from tests.weaving import units, weaving

MOST_FALSE = 0.01  # upper bound of the rate of names where there is no mistaken convention


@pytest.mark.parametrize("kind", CLASSES)
def test_nothing_is_named_where_no_convention_is_mistaken(kind):
    """Five runs of each class; who names something in half of them passes once in 32 times."""
    made = (convention_power.make(kind, number) for number in range(0, 40, 8))
    assert [(what, names) for base, solution, what in made if (names := ask(base, solution))] == []


@pytest.mark.long
def test_at_most_one_in_a_hundred_is_named_where_no_convention_is_mistaken():
    wrong = convention_power.list_false(300)
    assert convention_power.bound(sum(map(len, wrong.values())), 900) <= MOST_FALSE, wrong


@pytest.mark.parametrize("name", PLANTS)
def test_a_mistake_of_a_size_is_named(name):
    """Its size is 30 times what an oracle detects in half of the runs, rounded (`UNITS`)."""
    base = unlisted.draw(4)
    solution = plant(name, base, 30.0 * convention_power.UNITS[name], np.random.default_rng(1))
    assert name in ask(base, solution)


@pytest.mark.long
@pytest.mark.parametrize("name", PLANTS)
def test_most_mistakes_above_eight_units_are_named(name):
    rows = convention_power.detect(name, 60)
    large = [name in names for size, names in rows if size >= 8.0]
    assert np.mean(large) >= 0.8
    assert convention_power.find_unit(name) == pytest.approx(convention_power.UNITS[name], rel=0.3)


# --- sound filters of other kinds -------------------------------------------------------------------------


def _narrow(base):
    """Single precision, as a filter in C has it; angles are doubles in its file."""
    s = base.solution
    start = s.lla[0]
    lla = start + (s.lla - start).astype(np.float32)
    narrow = (getattr(s, name).astype(np.float32).astype(float) for name in ("vel_n", "q_nb", "cov"))
    vel_n, q_nb, cov = narrow
    return replace(s, lla=lla, vel_n=vel_n, q_nb=q_nb, cov=cov)


def _slow(base):
    """Answers at 1 Hz, and between them what it draws through them."""
    s, kept = base.solution, slice(None, None, 2)
    columns = {
        name: np.column_stack([np.interp(s.t, s.t[kept], column[kept]) for column in getattr(s, name).T])
        for name in ("lla", "vel_n")
    }
    q_nb = np.column_stack([np.interp(s.t, s.t[kept], column[kept]) for column in s.q_nb.T])
    return replace(s, q_nb=q_nb / np.linalg.norm(q_nb, axis=1, keepdims=True), **columns)


def _attitude_only(base):
    s = base.solution
    cov = s.cov.copy()
    cov[:, :6], cov[:, :, :6] = np.nan, np.nan
    return replace(s, lla=np.full_like(s.lla, np.nan), vel_n=np.full_like(s.vel_n, np.nan), cov=cov)


@pytest.mark.parametrize("change", [_narrow, _slow, _attitude_only])
def test_sound_filters_of_other_kinds_have_no_name(change):
    for number in range(6):
        base = unlisted.draw(number)
        assert ask(base, change(base)) == []


def test_a_sound_filter_of_sigma_points_has_no_name():
    truth = weaving(40.0, 50.0)
    sensed = sensors.sense(truth, units(), 1, 2)
    solution = estimator.answer(built_in.load("ukf", {}), "ukf", sensed.data, sensed.initial)
    base = unlisted.Base(truth, solution, sensed.data.antenna_b, 10.0)
    assert ask(base, solution) == []
