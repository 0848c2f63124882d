"""Total error, inclination and vertical part against angles of matrices, and at their ends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.evaluation.metrics.key_figures import list_key_figures
from bench.evaluation.metrics.orientation_errors import split_error
from tests.evaluation.test_metrics import metrics_of, truth, wrong_solution  # noqa: F401


def test_they_are_angles_between_axes_and_of_traces():
    """Total by the trace, inclination by the verticals, and the rest by what is left after the tilt."""
    phi_n = np.random.default_rng(4).normal(size=(500, 3))
    C = rotation.matrix(rotation.from_rotvec(phi_n))
    total, inclination, vertical = split_error(phi_n)
    assert_allclose(total, np.arccos(0.5 * (np.trace(C, axis1=1, axis2=2) - 1.0)), atol=1e-6)
    assert_allclose(inclination, np.arccos(C[:, 2, 2]), atol=1e-6)
    axis = np.cross(C[:, :, 2], [0.0, 0.0, 1.0])
    axis *= (inclination / np.linalg.norm(axis, axis=1))[:, None]
    level = rotation.matrix(rotation.from_rotvec(axis)) @ C
    assert_allclose(level[:, 2, 2], 1.0, atol=1e-9)
    assert_allclose(vertical, np.abs(np.arctan2(level[:, 1, 0], level[:, 0, 0])), atol=1e-6)


@pytest.mark.parametrize("size", [0.0, 1e-9, 1.0, np.pi - 1e-9, np.pi])
def test_a_turn_about_one_axis_is_one_part(size):
    about = np.eye(3) * size
    total, inclination, vertical = split_error(about)
    assert_allclose(total, size, rtol=1e-12, atol=1e-15)
    assert_allclose(inclination, [size, size, 0.0], rtol=1e-12, atol=1e-15)
    assert_allclose(vertical[2], size, rtol=1e-12, atol=1e-15)
    if size < np.pi:
        assert_allclose(vertical[:2], 0.0, atol=1e-12)


def test_the_metrics_hold_them_and_a_constant_heading_error_is_no_drift(truth):  # noqa: F811
    phi_n = np.zeros((201, 3))
    phi_n[:, 0], phi_n[:, 2] = 0.02, 0.1
    found = metrics_of(truth, wrong_solution(truth, phi_n=phi_n))
    total, inclination, vertical = (np.rad2deg(one[0]) for one in split_error(phi_n))
    assert found["total_error_rmse_deg"] == pytest.approx(total)
    assert found["total_error_max_deg"] == pytest.approx(total)
    assert found["inclination_rmse_deg"] == pytest.approx(inclination)
    assert found["vertical_part_rmse_deg"] == pytest.approx(vertical)


def test_the_table_shows_them_where_there_is_no_position():
    attitude = {"tilt_rmse_deg": 0.1, "heading_rmse_deg": 0.3, "total_error_rmse_deg": 0.32}
    assert list_key_figures({"a": attitude})[:2] == ["total_error_rmse_deg", "tilt_rmse_deg"]
    shown = list_key_figures({"a": attitude, "b": {**attitude, "pos_rmse_h_m": 1.0}})
    assert "total_error_rmse_deg" not in shown


def test_heading_drift_counts_from_the_first_epoch_and_wraps(truth):  # noqa: F811
    truth = replace(truth, q_nb=rotation.from_euler(0.0, 0.0, 0.001 * truth.t))
    phi_n = np.zeros((201, 3))
    phi_n[:, 2] = 3.1 + 0.001 * np.arange(201)  # over pi
    found = metrics_of(truth, wrong_solution(truth, phi_n=phi_n))
    expected = np.rad2deg(0.001 * np.sqrt(np.mean(np.arange(201.0) ** 2)))
    assert found["heading_drift_rmse_deg"] == pytest.approx(expected, rel=1e-6)
    phi_n[:, 2] = 3.1
    found = metrics_of(truth, wrong_solution(truth, phi_n=phi_n))
    assert found["heading_drift_rmse_deg"] == pytest.approx(0.0, abs=1e-9)
