"""APE, RPE, drift in percent and time offset against errors whose answer is known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors.poses import align
from bench.evaluation.metrics.run_metrics import measure
from tests.evaluation.solutions import weaving_truth, wrong_solution

SPEED, LENGTH = 50.0, 100.0


@pytest.fixture(scope="module")
def truth() -> Trajectory:
    """East at 50 m/s along the equator, which is a circle, level; 100 s."""
    base = weaving_truth(LENGTH, 10.0)
    lla = np.zeros((len(base), 3))
    lla[:, 1] = SPEED * base.t / earth.radii(0.0)[1]
    heading = np.full(len(base), 0.5 * np.pi)
    return replace(
        base,
        lla=lla,
        vel_n=np.tile([0.0, SPEED, 0.0], (len(base), 1)),
        q_nb=rotation.from_euler(0.0 * heading, 0.0 * heading, heading),
    )


def judged(truth, **errors):
    return measure(
        truth, wrong_solution(truth, every=1, **errors), evaluation=EvaluationWindow(0.0), outages=()
    )[1]


def test_a_constant_error_has_no_relative_error_and_vanishes_with_alignment(truth):
    found = judged(truth, pos_n=[3.0, 4.0, 12.0])
    assert found["pos_rmse_3d_m"] == pytest.approx(13.0, rel=1e-6)
    assert found["ape_aligned_rmse_m"] == pytest.approx(0.0, abs=5e-3)  # the axes of n turn along the path
    assert found["rpe_10s_m"] == pytest.approx(0.0, abs=2e-3)  # the axes of n turn by 8e-5 rad in 10 s
    assert found["drift_segments_percent"] == pytest.approx(0.0, abs=1e-3)
    assert found["drift_end_percent"] == pytest.approx(100 * 5.0 / (SPEED * LENGTH), rel=1e-3)


def test_a_path_that_is_turned_as_a_whole_aligns_and_has_the_relative_error_of_the_turn(truth):
    """Turned by 1 deg about the start: position and attitude together, so that no displacement is wrong."""
    angle = np.deg2rad(1.0)
    along = SPEED * truth.t
    pos_n = np.column_stack([-along * np.sin(angle), along * (np.cos(angle) - 1.0), 0 * along])
    found = judged(truth, pos_n=pos_n, phi_n=[0.0, 0.0, angle])
    assert found["pos_rmse_3d_m"] == pytest.approx(angle * SPEED * LENGTH / np.sqrt(3.0), rel=2e-3)
    assert found["ape_aligned_rmse_m"] < 0.01
    assert found["rpe_1km_m"] < 0.02
    assert found["rpe_1km_deg"] == pytest.approx(0.0, abs=1e-3)
    without = judged(truth, pos_n=pos_n)  # the attitude is right: the displacement points wrong
    assert without["rpe_1km_m"] == pytest.approx(2.0 * 1000.0 * np.sin(0.5 * angle), rel=5e-3)


def test_a_scale_error_of_2_percent_is_a_drift_of_2_percent(truth):
    along = SPEED * truth.t
    found = judged(truth, pos_n=np.column_stack([0 * along, 0.02 * along, 0 * along]))
    assert found["drift_segments_percent"] == pytest.approx(2.0, rel=2e-3)
    assert found["drift_end_percent"] == pytest.approx(2.0, rel=1e-3)
    assert found["rpe_10s_m"] == pytest.approx(0.02 * 10.0 * SPEED, rel=2e-3)
    assert found["rpe_100m_m"] == pytest.approx(2.0, rel=0.01)
    assert found["time_offset_ms"] is None  # the velocity does not change: no offset to be found


def test_an_attitude_that_turns_has_the_angle_of_its_rate(truth):
    phi_n = np.column_stack([0 * truth.t, 0 * truth.t, np.deg2rad(0.1) * truth.t])
    found = judged(truth, phi_n=phi_n)
    assert found["rpe_10s_deg"] == pytest.approx(1.0, rel=1e-6)
    assert found["rpe_60s_deg"] == pytest.approx(6.0, rel=1e-6)


def test_the_time_offset_of_a_late_solution_is_found():
    truth = weaving_truth(60.0, 100.0)
    late = 0.04
    rows = np.arange(100, len(truth), 10)
    solution = wrong_solution(truth)
    columns = ("t", "lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd")
    solution = replace(solution, **{name: getattr(solution, name)[10:] for name in columns})
    shifted = rows - round(late * 100)
    solution = replace(solution, lla=truth.lla[shifted], vel_n=truth.vel_n[shifted])
    found = measure(truth, solution, evaluation=EvaluationWindow(0.0), outages=())[1]
    assert found["time_offset_ms"] == pytest.approx(-1e3 * late, rel=0.01)


def test_alignment_finds_any_rotation_and_shift_but_no_scale():
    """Umeyama's solution against the rotation that made the points, reflections left out."""
    rng = np.random.default_rng(3)
    points = rng.normal(size=(40, 3)) * [100.0, 50.0, 1.0]
    C = rotation.matrix(rotation.from_rotvec(np.array([0.3, -1.2, 0.5])))
    moved = points @ C.T + [5.0, -7.0, 2.0]
    np.testing.assert_allclose(align(points, moved), moved, atol=1e-10)
    doubled = align(points, 2.0 * moved)
    assert np.ptp(doubled, axis=0) == pytest.approx(np.ptp(moved, axis=0), rel=1e-9)
    mirrored = points * [1.0, 1.0, -1.0]
    assert np.abs(align(points, mirrored) - mirrored).max() > 0.5
