"""A solution that answers a part says so; what the data excuse does not count."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import bench
from bench.cli.command_line import main
from bench.core.files import disk_arrays
from bench.core.mathematics import earth
from bench.core.records.data import InitialState, NavSolution, SensorData
from bench.evaluation.consistency.verdict import add_verdict
from bench.evaluation.errors.error_series import find_answered_epochs, find_covered_epochs
from bench.evaluation.metrics import coverage
from bench.evaluation.metrics.coverage import Coverage, carry_on, find_silent_epochs, measure_coverage
from bench.navigation.built_in import load
from tests.builders import take
from tests.campaigns.test_campaign import PROFILE
from tests.evaluation.solutions import weaving_truth, wrong_solution

COLUMNS = ("lla", "vel_n", "q_nb", "gyro_bias_b", "accel_bias_b", "cov", "extra", "extra_sd")


def silence(solution: NavSolution, rows: np.ndarray, names: tuple[str, ...] = COLUMNS) -> NavSolution:
    """Return a solution that says nothing in some rows."""
    changed = {}
    for name in names:
        changed[name] = np.array(getattr(solution, name))
        changed[name][rows] = np.nan
    return replace(solution, **changed)


class Silent:
    """A filter that gives no answer between two epochs, nor before its first."""

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
    profile = bench.read_profile(path)
    sensed = bench.sense(profile, bench.fly(profile))
    return sensed.data, bench.run_filter("loose-15", sensed.data, sensed.initial), path


def without_imu(data: SensorData, begin: float, end: float) -> SensorData:
    return replace(data, imu=take(data.imu, (data.imu.t <= begin) | (data.imu.t > end)))


def test_the_share_counts_from_the_first_answer_on(flown):
    data, whole, _ = flown
    t = whole.t
    assert measure_coverage(whole, data).share == 1.0
    half = measure_coverage(silence(whole, t > 10.0), data)
    assert half.share == pytest.approx(np.mean(t <= 10.0))
    assert half.text == "answers 50.2 % of the epochs asked for, with the longest silence from 10.1 to 20 s"
    late = measure_coverage(silence(whole, (t < 4.0) | ((t > 10.0) & (t < 12.05))), data)
    assert (late.first, late.longest) == (4.0, (10.1, 12.0))
    assert late.share == pytest.approx(1.0 - 20 / np.sum(t >= 4.0))
    assert " from its first answer on, with" in late.text
    assert measure_coverage(silence(whole, (t > 10.0) & (t < 10.15)), data).enough  # one of 200


@pytest.mark.parametrize("interval", [0.5, 1.0, 2.0])
def test_a_filter_may_answer_at_its_own_rate(flown, interval):
    """Judged at its own epochs: the errors are those of the same filter there, and nothing is carried on."""
    data, whole, path = flown
    profile = bench.read_profile(path)
    truth = bench.fly(profile)
    own = np.abs(whole.t / interval - np.round(whole.t / interval)) < 1e-6
    slow = silence(whole, ~own)
    found = measure_coverage(slow, data)
    assert (found.share, found.interval) == (1.0, pytest.approx(interval))
    assert found.text == f"answers 100 % of the epochs asked for, at its own rate of {1 / interval:.3g} Hz"
    assert not find_silent_epochs(slow).any()
    _, judged = bench.evaluation.judging.measure_solution(slow, truth, data, profile.evaluation, outages=())
    rows = own & (whole.t >= profile.evaluation.begin)
    error = earth.difference_n(slow.lla[rows], truth.lla[np.searchsorted(truth.t, whole.t[rows] - 1e-6)])
    wanted = np.sqrt(np.mean(np.square(error[:, :2]).sum(axis=1)))
    assert judged["pos_rmse_h_m"] == pytest.approx(wanted, rel=1e-6)
    assert judged["converged"]


def test_who_is_silent_where_it_errs_has_no_own_rate(flown):
    """A silence of some of its intervals counts as long as it lasts; one every 5 s is none of a filter."""
    data, whole, _ = flown
    own = np.abs(whole.t - np.round(whole.t)) < 1e-6
    gap = measure_coverage(silence(whole, ~own | ((whole.t > 8.5) & (whole.t < 12.5))), data)
    assert gap.share == pytest.approx(17 / (17 + 4.9), rel=0.01)
    assert gap.longest == (8.1, 12.9)
    fives = np.abs(whole.t / 5.0 - np.round(whole.t / 5.0)) < 1e-6
    assert measure_coverage(silence(whole, ~fives), data).interval is None
    bursts = silence(whole, np.floor(whole.t) % 2 == 1)
    assert measure_coverage(bursts, data).share < 0.6


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
    found = add_verdict("mine", lost, Coverage({"pos": 0.5}, 30.0, 30.0, (50.0, 90.0)))
    assert found["verdict"] == "diverged"
    assert found["reason"].startswith("it diverged; it answers 50 % of the epochs")
    assert found["verdict_text"].endswith(" Its first answer is at t = 30 s.")
    raised = {"converged": False, "reason": "raised", "failed": True}
    failed = add_verdict("mine", raised, Coverage({}, 0.0, None, (0.0, 9.0)))
    assert failed["verdict_text"] == "mine raised"


def test_a_filter_that_answers_a_part_has_its_verdict_and_status_1(flown, tmp_path, monkeypatch, capsys):
    """NaN of a filter; a silence is charged the last answer, carried on by its own velocity."""
    _, whole, path = flown
    monkeypatch.chdir(tmp_path)
    use = "tests.evaluation.test_coverage:Silent"
    assert main(["run", str(path), "-e", use, "-e", "loose-15", "--no-rrd", "--no-report", "-o", "part"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "answers 75.6 % of the epochs asked for, with the longest silence from 10.1 to 14.9 s" in said
    result = bench.read_result("part")
    found = result.metrics["Silent"]
    assert (found["verdict"], found["converged"]) == ("incomplete", False)
    silent = (whole.t > 10.0) & (whole.t < 15.0)
    k = int(np.flatnonzero(silent)[0]) - 1
    errors = result.errors["loose-15"].pos_n[:, :2].copy()
    moved = earth.displace(whole.lla[k], whole.vel_n[k] * (whole.t[silent] - whole.t[k])[:, None])
    truth = bench.fly(path)
    there = np.array([truth.lla[np.argmin(np.abs(truth.t - t))] for t in whole.t[silent]])
    errors[silent] = earth.difference_n(moved, there)[:, :2]
    late = errors[whole.t >= 5.0]
    assert found["pos_rmse_h_m"] == pytest.approx(np.sqrt(np.mean(np.sum(late**2, axis=1))), rel=1e-6)
    assert found["pos_max_h_m"] == pytest.approx(np.hypot(*late.T).max(), rel=1e-6)
    assert found["cep95_m"] is None
    assert found["cep50_m"] is not None  # less than half is silent
    assert found["nees_mean"] == pytest.approx(
        np.mean(result.errors["loose-15"].nees[(whole.t >= 5.0) & ~silent])
    )
    assert found["availability_pos"] == pytest.approx(1 - np.mean(silent))
    assert (found["first_answer_s"], result.metrics["loose-15"]["availability_phi"]) == (0.0, 1.0)
    assert result.metrics["loose-15"]["converged"]
    assert main(["run", str(path), "-e", "loose-15", "--no-rrd", "--no-report", "-o", "alone"]) == 0


def test_an_answer_carried_on_in_a_turn_leaves_it_along_the_tangent():
    """Closed form: after an angle a on a circle of radius R it is R (a - sin a, 1 - cos a) off."""
    radius, speed = 300.0, 30.0
    solution = wrong_solution(weaving_truth(10.0))  # ten a second
    a = speed / radius * solution.t
    place = radius * np.column_stack([np.sin(a), 1.0 - np.cos(a), np.zeros(len(a))])
    lla = earth.displace(np.broadcast_to([0.8, 0.2, 500.0], place.shape), place)
    vel_n = speed * np.column_stack([np.cos(a), np.sin(a), np.zeros(len(a))])
    since = np.arange(len(a)) % 10 / 10.0
    turned = speed / radius * since
    expected = radius * np.hypot(turned - np.sin(turned), 1.0 - np.cos(turned))

    def find_errors(velocity: np.ndarray) -> np.ndarray:
        quiet = silence(replace(solution, lla=lla, vel_n=velocity), since > 0.0)
        found = carry_on(quiet, since > 0.0)
        assert np.isnan(found.cov[since > 0.0]).all()
        return np.hypot(*earth.difference_n(found.lla, lla)[:, :2].T)

    np.testing.assert_allclose(find_errors(vel_n), expected, atol=2e-3)
    bare = find_errors(np.full_like(vel_n, np.nan))[10:]  # by the chord of the second before
    assert bare.max() == pytest.approx(speed**2 / radius * 0.9 * (1.0 + 0.9) / 2.0, rel=0.01)
    held = np.hypot(*earth.difference_n(lla[np.arange(len(a)) // 10 * 10], lla)[:, :2].T)
    assert held.max() > 15 * expected.max()


def test_silences_are_infinite_in_the_95_percent_error_but_those_that_the_data_excuse(flown):
    """Six of 151 epochs without an answer are among the twentieth that it may leave out, nine are not."""
    data, whole, path = flown
    profile, truth = bench.read_profile(path), bench.fly(path)
    late = np.flatnonzero(whole.t >= 5.0)
    for count, known in ((6, True), (9, False)):
        quiet = silence(whole, np.isin(np.arange(len(whole)), late[40 : 40 + count]))
        judged = bench.evaluate(profile, truth, quiet)[1]
        assert (judged["cep95_m"] is not None, judged["pos_95_v_m"] is not None) == (known, known)
    begin, end = whole.t[late[40]] - 0.1, whole.t[late[48]]
    excusing = replace(bench.sense(profile, truth), data=without_imu(data, begin, end))
    excused = bench.evaluate(profile, truth, quiet, excusing)[1]
    assert excused["cep95_m"] is not None
    assert excused["availability_pos"] == 1.0


def test_each_block_that_a_filter_declares_counts(flown):
    data, whole, _ = flown
    part = measure_coverage(silence(whole, whole.t > 10.0, ("vel_n",)), data)
    assert part.shares["pos"] == part.shares["phi"] == 1.0
    assert part.share == part.shares["vel"] == pytest.approx(np.mean(whole.t <= 10.0))
    assert part.text.startswith("answers position at 100 %, velocity at 50.2 %, attitude at 100 % of the")
    bare = measure_coverage(silence(whole, whole.t >= 0.0, ("q_nb",)), data)
    assert list(bare.shares) == ["pos", "vel"]


@pytest.mark.parametrize(("wait", "late"), [(0.9, False), (1.1, True)])
def test_a_first_answer_after_a_second_is_late(wait, late):
    solution = wrong_solution(weaving_truth(10.0))  # ten a second
    found = measure_coverage(silence(solution, solution.t < solution.t[0] + wait - 0.01), None)
    assert found.waited == pytest.approx(wait)
    assert found.first == (pytest.approx(solution.t[0] + wait) if late else None)
    assert found.shares == {"pos": 1.0, "vel": 1.0, "phi": 1.0}


def test_a_sensor_is_silent_for_more_than_one_and_a_half_of_its_intervals():
    """Reports at 0, 1, 2, 3.4, 4, 5.6, 6 s, the last but one late by 1.6 s; without a report always."""
    reports, t = (
        np.array([0.0, 1.0, 2.0, 3.4, 4.4, 6.0, 7.0]),
        np.array([-1.0, 0.5, 2.7, 4.4, 5.0, 6.0, 6.5, 8.0]),
    )
    expected = [True, False, False, False, True, True, False, True]
    assert coverage.is_silent(t, reports).tolist() == expected
    assert coverage.is_silent(t, reports[:1]).all()


@pytest.mark.parametrize(("share", "text", "enough"), [(0.9899, "98.9 %", False), (0.9909, "99 %", True)])
def test_shares_are_rounded_down_and_the_least_counts(share, text, enough):
    found = Coverage({"pos": 1.0, "vel": share}, 0.0, 30.0, (2.5, 4.0))
    assert found.text == (
        f"answers position at 100 %, velocity at {text} of the epochs asked for from its first answer on, "
        "with the longest silence from 2.5 to 4 s"
    )
    assert (found.share, found.enough) == (share, enough)
    assert Coverage({"pos": 1.0}, 0.0, None, (0.0, 0.0)).text == "answers 100 % of the epochs asked for"


def test_the_longest_run_is_that_of_the_longest_time():
    t = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 9.0, 10.0])
    assert coverage.find_longest(t, np.array([0, 1, 2, 4, 5])) == (4.0, 9.0)
    assert coverage.find_longest(t, np.array([], int)) == (0.0, 0.0)
