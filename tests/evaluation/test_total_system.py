"""TSE = FTE - NSE along the path of a flight, each computed in a way of its own."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench import pipeline
from bench.core.mathematics import earth
from bench.core.records.data import NavSolution
from bench.core.records.run_records import OffPath
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors import total_system
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.errors.total_system import locate_path, resolve
from bench.evaluation.metrics import run_metrics
from bench.evaluation.metrics.case import build_case
from bench.io import config
from bench.simulation.flight.guidance.desired_path import measure_off_path


@pytest.fixture(scope="module")
def approach():
    """A flight down to a runway, and beliefs that are wrong by up to tens of meters."""
    profile = config.read_profile("approach")
    truth = pipeline.fly(profile)
    rows = np.arange(200, len(truth.t), 40)
    error_n = np.random.default_rng(4).normal(scale=[20.0, 20.0, 10.0], size=(len(rows), 3))
    return profile.flight, truth, rows, error_n


def believe(truth, rows, error_n):
    return NavSolution(
        truth.t[rows], earth.displace(truth.lla[rows], error_n), truth.vel_n[rows], truth.q_nb[rows],
        *(np.zeros((len(rows), 3)) for _ in range(2)), np.tile(np.eye(9), (len(rows), 1, 1)), (),
        *(np.zeros((len(rows), 0)) for _ in range(2)),
    )  # fmt: skip


def test_the_belief_is_off_the_path_by_the_sum_of_both(approach):
    """FTE by resolving the estimated positions themselves against the runway: equal within 1 mm."""
    spec, truth, rows, error_n = approach
    path = measure_off_path(spec, truth, rows)
    solution = believe(truth, rows, error_n)
    errors = resolve(build_case(error_series(truth, solution), solution, (), path=path))
    lla = truth.lla.copy()
    lla[rows] = solution.lla
    believed = measure_off_path(spec, replace(truth, lla=lla), rows)
    on = np.isfinite(path.right)
    assert on.sum() > 500
    assert_allclose(errors["fte"]["across"][on], believed.right[on], rtol=0, atol=1e-3)
    for axis in ("across", "up"):
        left = errors["tse"][axis] - errors["fte"][axis] + errors["nse"][axis]
        assert np.nanmax(np.abs(left)) < 1e-9
    assert np.isfinite(path.above).sum() > 300
    assert np.isnan(path.right[truth.t[rows] < 30.0]).all()  # a straight leg has no path


def test_the_path_that_is_drawn_is_on_the_path(approach):
    """By the geometry of the runway: 0 to its right and 0 above it, wherever the truth was."""
    spec, truth, rows, _ = approach
    moved = replace(truth, lla=earth.displace(truth.lla, np.array([[30.0, 20.0, -7.0]])))
    path = measure_off_path(spec, moved, rows)
    lla = moved.lla.copy()
    lla[rows] = np.where(np.isfinite(path.right)[:, None], locate_path(path, lla[rows]), lla[rows])
    there = measure_off_path(spec, replace(truth, lla=lla), rows)
    assert_allclose(there.right[np.isfinite(path.right)], 0.0, atol=1e-3)
    both = np.isfinite(path.above) & np.isfinite(there.above)
    assert both.sum() > 300
    assert_allclose(there.above[both], 0.0, atol=0.02)
    assert np.isnan(locate_path(path, truth.lla[rows])[np.isnan(path.right)]).any(axis=1).all()


def test_where_the_truth_is_off_its_path_is_seen(approach):
    """The autopilot stays within meters of the path; a truth that is moved north and up is off by that."""
    spec, truth, rows, _ = approach
    path = measure_off_path(spec, truth, rows)
    late = truth.t[rows] > 150.0
    assert np.nanmax(np.abs(path.right[late])) < 5.0
    assert np.nanmax(np.abs(path.above[late])) < 8.0
    moved = earth.displace(truth.lla, np.array([[50.0, 0.0, -7.0]]))
    north = measure_off_path(spec, replace(truth, lla=moved), rows)
    heading = spec.runway.heading
    assert_allclose((north.right - path.right)[late], -50.0 * np.sin(heading), atol=0.01)
    both = late & np.isfinite(north.above) & np.isfinite(path.above)
    slope = np.tan(spec.legs[2].glide)
    assert_allclose((north.above - path.above)[both], 7.0 + slope * 50.0 * np.cos(heading), atol=0.02)


def test_the_metrics_are_rms_and_largest_of_what_has_a_path(approach):
    spec, truth, rows, error_n = approach
    path = measure_off_path(spec, truth, rows)
    solution = believe(truth, rows, error_n)
    window = EvaluationWindow(60.0)
    _, values = run_metrics.measure(truth, solution, evaluation=window, outages=(), path=path)
    assert 15.0 < values["nse_across_rms_m"] < 25.0
    assert values["tse_across_rms_m"] < 0.5 * values["fte_across_rms_m"]
    _, without = run_metrics.measure(truth, solution, evaluation=window, outages=())
    assert "tse_across_rms_m" not in without


def test_the_three_errors_by_hand():
    """A course of 30 deg: 2 m north and 3 m east are 3 cos 30 - 2 sin 30 m right; 1 m down is 1 m below."""
    path = OffPath(
        np.arange(3.0), np.array([1.0, np.nan, -2.0]), np.array([4.0, 5.0, np.nan]), np.full(3, np.pi / 6)
    )
    pos_n = np.tile([2.0, 3.0, 1.0], (3, 1))
    right = 3.0 * np.cos(np.pi / 6) - 1.0
    found = {p: total_system.measure(p, SimpleNamespace(path=path, pos_n=pos_n)) for p in total_system.PARTS}
    for part, across, up in (("tse", [1.0, -2.0], [4.0, 5.0]), ("nse", [right] * 2, [-1.0] * 2)):
        assert found[part] == pytest.approx(of(across, "across") | of(up, "up"))
    assert found["fte"] == pytest.approx(of([1.0 + right, right - 2.0], "across") | of([3.0, 4.0], "up"))
    assert total_system.measure("tse", SimpleNamespace(path=None, pos_n=pos_n)) == {}


def of(values, axis):
    return {f"{axis}_rms": np.sqrt(np.mean(np.square(values))), f"{axis}_max": np.abs(values).max()}
