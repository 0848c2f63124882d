"""A receiver that comes back: a drift beyond the gate is accepted at once, a step of the receiver is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.engine.integrity import nis_limit
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors
from tests import twin
from tests.builders import put, take
from tests.navigation.test_twin import assert_same
from tests.weaving import units

FLIGHT = (82.0, 50.0)
BEGIN, END = 40.0, 70.0
NAMES = ["classic-22", "loose-15", "loose-22", "ukf"]


@pytest.fixture(scope="module")
def minutes(truth):
    """The weaving flight with matched sensors, without fixes from 40 s to 70 s."""
    sensed = sensors.sense(truth, replace(units(), output_rate=2.0), 1, 0)
    fixes = sensed.data.fixes
    away = (fixes.t > BEGIN + 0.5) & (fixes.t < END - 0.5)
    return replace(sensed, data=replace(sensed.data, fixes=take(fixes, ~away)))


def drifting(data, push):
    """The record of an accelerometer that errs by ``push`` [m/s^2] to the right while there are no fixes."""
    imu = data.imu
    rows = (imu.t > BEGIN) & (imu.t < END - 0.5)
    dvel = imu.dvel_b.copy()
    dvel[rows, 1] += push * imu.dt[rows]
    return replace(data, imu=replace(imu, dvel_b=dvel))


def after(solution, sensor):
    """Which measurements of a sensor were accepted after the outage, in their order."""
    table = solution.innovations
    rows = (table.code == table.sensor.index(sensor)) & (table.component == 0) & (table.t > END - 0.5)
    return table.accepted[rows]


def error_h(truth, solution):
    """Epochs and horizontal errors [m] of a solution."""
    errors = error_series(truth, solution)
    return errors.t, np.hypot(*errors.pos_n[:, :2].T)


@pytest.mark.parametrize("name", NAMES)
def test_a_drift_beyond_the_gate_is_believed_at_the_first_fix(truth, minutes, name):
    solution = load(name, {}).run(drifting(minutes.data, 0.15), minutes.initial)
    table = solution.innovations
    first = (table.code == 0) & (table.t > END - 0.5)
    assert table.nis[first][0] > nis_limit(3, 1e-5)
    assert after(solution, "gnss_position")[0]
    assert after(solution, "gnss_velocity")[0]
    t, error = error_h(truth, solution)
    assert error[t == END].item() < 0.5 * error[t == END - 0.5].item()


@pytest.mark.parametrize("name", NAMES)
def test_a_receiver_that_comes_back_300_m_off_is_refused(minutes, name):
    """The velocity says that the aircraft has not drifted by that much."""
    fixes = minutes.data.fixes
    back = fixes.t > END - 0.5
    lla = fixes.lla[back] + [300.0 / 6.37e6, 0.0, 0.0]
    solution = load(name, {}).run(replace(minutes.data, fixes=put(fixes, back, lla=lla)), minutes.initial)
    assert_array_equal(after(solution, "gnss_position"), np.arange(13) >= 10)
    assert after(solution, "gnss_velocity").all()


@pytest.mark.parametrize("name", NAMES[:2])
def test_without_velocity_nothing_tells_a_drift_from_a_step(minutes, name):
    data = drifting(minutes.data, 0.3)
    data = replace(data, fixes=put(data.fixes, slice(None), vel_n=np.nan))
    solution = load(name, {}).run(data, minutes.initial)
    assert_array_equal(after(solution, "gnss_position")[:11], np.arange(11) >= 10)


def test_the_smoother_undoes_the_drift(truth, minutes):
    """The covariance grows for the filter alone: what lies between is drawn from both sides."""
    data = drifting(minutes.data, 0.15)
    forward, smoothed = (load(name, {}).run(data, minutes.initial) for name in ("loose-15", "smoother"))
    t, error = error_h(truth, forward)
    blind = (t > BEGIN) & (t < END)
    assert error_h(truth, smoothed)[1][blind].max() < 0.25 * error[blind].max()
    got, limit = (np.einsum("kii->ki", one.cov) for one in (smoothed, forward))
    assert (got <= limit * (1 + 1e-6)).all()


def test_the_twin_believes_it_alike(minutes):
    data = drifting(minutes.data, 0.15)
    solution = Loose(covariance_hz=None).run(data, minutes.initial)
    assert_same(twin.navigate(data, minutes.initial), solution)
