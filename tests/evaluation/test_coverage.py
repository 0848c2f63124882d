"""A solution that answers a part says so; what the data excuse does not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench import disk_arrays
from bench.cli import main
from bench.data import InitialState, NavSolution, SensorData
from bench.evaluation.coverage import Coverage, measure_coverage
from bench.evaluation.error_series import find_answered_epochs, find_covered_epochs
from bench.evaluation.verdict import add_verdict
from bench.navigation.estimator import load
from tests.builders import take
from tests.campaigns.test_campaign import PROFILE

COLUMNS = ("lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd")


def silence(solution: NavSolution, rows: np.ndarray, names: tuple[str, ...] = COLUMNS) -> NavSolution:
    """Return a solution that says nothing in some rows."""
    changed = {}
    for name in names:
        changed[name] = np.array(getattr(solution, name))
        changed[name][rows] = np.nan
    return replace(solution, **changed)


class Silent:
    """A filter that gives no answer between two instants, nor before its first."""

    def __init__(self, begin: float = 10.0, end: float = 15.0, first: float = 0.0) -> None:
        self._begin, self._end, self._first = begin, end, first

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        found = load("loose-15", {}).run(sensors, initial)
        return silence(found, ((found.t > self._begin) & (found.t < self._end)) | (found.t < self._first))


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """The sensors of 20 s, and an answer to all of them."""
    path = tmp_path_factory.mktemp("coverage") / "short.toml"
    path.write_text(PROFILE)
    profile = bench.load_profile(path)
    sensed = bench.sense(profile, bench.fly(profile))
    return sensed.data, bench.navigate("loose-15", sensed.data, sensed.initial), path


def without_imu(data: SensorData, begin: float, end: float) -> SensorData:
    return replace(data, imu=take(data.imu, (data.imu.t <= begin) | (data.imu.t > end)))


def test_the_share_counts_from_the_first_answer_on(flown):
    data, whole, _ = flown
    t = whole.t
    assert measure_coverage(whole, data).share == 1.0
    half = measure_coverage(silence(whole, t > 10.0), data)
    assert half.share == pytest.approx(np.mean(t <= 10.0))
    assert half.text == "answers 50.2 % of the instants asked for, with the longest silence from 10.1 to 20 s"
    late = measure_coverage(silence(whole, (t < 4.0) | ((t > 10.0) & (t < 12.05))), data)
    assert (late.first, late.longest) == (4.0, (10.1, 12.0))
    assert late.share == pytest.approx(1.0 - 20 / np.sum(t >= 4.0))
    assert " from its first answer on, with" in late.text
    assert measure_coverage(silence(whole, (t > 10.0) & (t < 10.15)), data).enough  # one of 200


def test_silences_of_the_imu_are_excused_and_no_others(flown):
    data, whole, _ = flown
    quiet = silence(whole, (whole.t > 8.0) & (whole.t < 12.0))
    assert not measure_coverage(quiet, data).enough
    assert measure_coverage(quiet, without_imu(data, 8.0, 12.0)).share == 1.0
    assert not measure_coverage(quiet, without_imu(data, 8.0, 10.0)).enough
    flagged = replace(data.imu, valid=(data.imu.t <= 8.0) | (data.imu.t > 12.0))
    assert measure_coverage(quiet, replace(data, imu=flagged)).share == 1.0
    ended = silence(whole, whole.t > 15.0)
    assert measure_coverage(ended, without_imu(data, 15.0, 99.0)).share == 1.0


def test_silences_of_the_fixes_excuse_a_solution_that_is_made_of_them(flown):
    """One with an attitude has an IMU, and goes on without fixes."""
    data, whole, _ = flown
    fixes = take(data.fixes, (data.fixes.t < 8.0) | (data.fixes.t > 12.0))
    lost = replace(data, fixes=fixes)
    quiet = silence(whole, (whole.t > fixes.t[fixes.t < 8.0][-1]) & (whole.t < 12.0))
    of_fixes = silence(quiet, np.ones(len(quiet), bool), ("q_nb",))
    assert measure_coverage(of_fixes, lost).share == 1.0
    assert not measure_coverage(of_fixes, data).enough
    assert not measure_coverage(quiet, lost).enough


def test_epochs_without_an_answer_are_found_in_blocks_too(flown, monkeypatch):
    _, whole, _ = flown
    quiet = silence(whole, (whole.t < 1.0) | ((whole.t > 8.0) & (whole.t < 12.0)))
    cov_alone = silence(quiet, whole.t > 15.0, ("lla", "vel_n", "q_nb"))
    for rows in (1_000, 7):
        monkeypatch.setattr(disk_arrays, "ROWS", rows)
        answered = ((whole.t >= 1.0) & (whole.t <= 8.0)) | (whole.t >= 12.0)
        np.testing.assert_array_equal(find_answered_epochs(quiet), answered)
        np.testing.assert_array_equal(find_answered_epochs(cov_alone), answered)
        np.testing.assert_array_equal(find_covered_epochs(quiet), answered | (whole.t < 1.0))


def test_what_else_is_wrong_is_said_first():
    lost = {"converged": False, "reason": "it diverged", "pos_rmse_h_m": 3.0}
    found = add_verdict("mine", lost, Coverage(0.5, 30.0, (50.0, 90.0)))
    assert found["verdict"] == "diverged"
    assert found["reason"].startswith("it diverged; it answers 50 % of the instants")
    assert found["verdict_text"].endswith(" Its first answer is at t = 30 s.")
    raised = {"converged": False, "reason": "raised", "failed": True}
    failed = add_verdict("mine", raised, Coverage(0.0, None, (0.0, 9.0)))
    assert failed["verdict_text"] == "mine raised"


def test_a_filter_that_answers_a_part_has_its_verdict_and_status_1(flown, tmp_path, monkeypatch, capsys):
    """NaN of a filter, rows that a table lacks; metrics are of what is answered."""
    _, whole, path = flown
    monkeypatch.chdir(tmp_path)
    use = "tests.evaluation.test_coverage:Silent"
    assert main(["run", str(path), "-e", use, "-e", "loose-15", "--no-rrd", "--no-report", "-o", "part"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert (
        "Silent answers 75.6 % of the instants asked for, with the longest silence from 10.1 to 14.9 s."
        in said
    )
    result = bench.load("part")
    found = result.metrics["Silent"]
    assert (found["verdict"], found["converged"]) == ("incomplete", False)
    late = (result.errors["loose-15"].t >= 5.0) & ~((whole.t > 10.0) & (whole.t < 15.0))
    errors = result.errors["loose-15"].pos_n[late, :2]
    assert found["pos_rmse_h_m"] == pytest.approx(np.sqrt(np.mean(np.sum(errors**2, axis=1))))
    assert result.metrics["loose-15"]["converged"]
    assert main(["run", str(path), "-e", "loose-15", "--no-rrd", "--no-report", "-o", "alone"]) == 0
