"""The drift of cuts of GNSS has no tail beyond that of its covariance, begun in a turn or not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.evaluation.errors.error_series import error_series
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors
from tests import tails
from tests.builders import band
from tests.weaving import IMU, units, weaving

RUNS, STARTS = 18, (37.5, 52.5)  # banked by 20 deg, and level [s]
BAD = replace(IMU, gyro=replace(IMU.gyro, turn_on_bias_sd=30 * IMU.gyro.turn_on_bias_sd))


def drift(start, bad=0):
    """Return drift [m] and e' P^-1 e of cuts of 60 s; ``bad`` units are worse than assumed."""
    truth = weaving(120.0, rate=50.0)
    found = []
    for run in range(RUNS):
        spec = replace(units(), imu=BAD if run < bad else IMU, gnss_outages=((start, start + tails.CUT),))
        sensed = sensors.sense(truth, spec, 11, run)
        solution = Loose().run(sensed.data, sensed.initial)
        errors = error_series(truth, solution)
        end = int(np.searchsorted(errors.t, start + tails.CUT - 0.05)) - 1
        e, P = errors.pos_n[end, :2], solution.cov[end, :2, :2]
        found.append((np.hypot(*e), e @ np.linalg.solve(P, e)))
    return np.array(found).T


@pytest.mark.parametrize("start", STARTS)
def test_cuts_of_a_matched_filter_have_no_tail(start):
    """95 % at most three times the median, as all cuts alike would have 2.08; the covariance is right."""
    length, ratio = drift(start)
    assert tails.spread(length) <= tails.MOST
    low, high = band(RUNS, 2)
    assert low <= ratio.mean() <= high


def test_a_tail_shows():
    assert tails.spread(drift(STARTS[0], bad=3)[0]) > tails.MOST


@pytest.mark.long
@pytest.mark.parametrize("name", tails.FILTERS)
def test_a_day_of_flights_in_turbulence_has_no_tail(name):
    """12 flights of 10 minutes, 12 draws each, 576 cuts of 60 s: 24 hours of flight."""
    assert tails.spread(tails.cuts(12, 12, name)[:, 0]) <= tails.MOST
