"""The states for what calibration left in a magnetometer: found, reported as they are, and needed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from bench.core.records.instruments import MagSpec
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.simulation import sensors
from tests.builders import ensemble, put
from tests.weaving import DEG, units, weaving

COMPASS = MagSpec(
    "compass", 10.0, white_sd=2e-7, hard_iron_sd=1e-6, soft_iron_sd=0.01, scale_factor_sd=0.01,
    misalignment_sd=0.02,
)  # fmt: skip
NAMES = tuple(
    f"{name}_{axis}_{unit}"
    for name, unit in (("mag_iron_b", "T"), ("mag_scale", "1"), ("mag_soft_iron", "1"), ("mag_turn", "1"))
    for axis in "xyz"
)


@pytest.fixture(scope="module")
def truth():
    return weaving(60.0, rate=50.0)


def on_board(mag=COMPASS, assumed=COMPASS):
    spec = replace(units(), mag=mag, initial_heading_sd=10 * DEG)
    return replace(spec, assumed=replace(spec.assumed, mag=assumed))


@pytest.mark.parametrize("use", ["loose-15", "loose-full"])
def test_nis_is_in_its_band_and_leaves_it_with_more_noise(truth, use):
    """99.9 % band over four runs; noise 1.4 times what the record says leaves it."""
    for noisier, inside in ((1.0, True), (1.4, False)):

        def draw(run, noisier=noisier):
            drawn = sensors.sense(truth, on_board(), 3, run)
            mag = put(drawn.data.mag, slice(None), sd=drawn.data.mag.sd / noisier)
            return replace(drawn, data=replace(drawn.data, mag=mag))

        found = ensemble(load(use, {"magnetometer": True}), truth, draw, 4, 10.0)
        band = found.pooled_nis()["magnetometer"]
        assert (band.low <= band.mean <= band.high) == inside, noisier


def judge(truth, assumed, runs, use="loose-full", options=()):
    """Return sums of squared errors of heading and iron, by their covariance, over some runs."""
    heading, iron = 0.0, 0.0
    for run in range(runs):
        drawn = sensors.sense(truth, on_board(assumed=assumed), 5, run)
        solution = load(use, {"magnetometer": True, **dict(options)}).run(drawn.data, drawn.initial)
        series = error_series(truth, solution)
        heading += series.phi_n[-1, 2] ** 2 / solution.cov[-1, 8, 8]
        if assumed is COMPASS:
            assert set(NAMES) <= set(solution.extra_names)
            at = solution.extra_names.index(NAMES[0])
            off = solution.extra[-1, at : at + 3] - drawn.truth.bias["mag"][-1]
            iron += float(np.sum((off / solution.extra_sd[-1, at : at + 3]) ** 2)) / 3
            assert (solution.extra_sd[-1, at : at + 3] < 0.9 * solution.extra_sd[0, at : at + 3]).all()
    return heading, iron


@pytest.mark.parametrize(
    ("use", "options", "runs"),
    [("loose-full", {}, 12), ("loose-15", {}, 12), ("ukf", {"covariance_hz": 2.0}, 1)],
)
def test_heading_and_iron_are_as_claimed(truth, use, options, runs):
    heading, iron = judge(truth, COMPASS, runs, use, options.items())
    assert heading < stats.chi2.isf(0.001, runs)
    assert iron < stats.chi2.isf(0.001, 3 * runs) / 3


def test_a_datasheet_without_what_calibration_left_makes_the_heading_wrong(truth):
    """The same records; a filter that is told of no iron has no state for it."""
    heading, _ = judge(truth, MagSpec("compass", 10.0, white_sd=2e-7), 12)
    assert heading > 10 * stats.chi2.isf(0.001, 12)
