"""The adapters turn conventions right, the league judges them, and its runs repeat to the bit."""

import copy
import importlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.core.mathematics import earth, rotation
from bench.experiments.card.card_suite import Suite, SuiteFlight
from tests.league import entries, league, league_page
from tests.league.entries import ATTITUDE_FILTERS, POSITION_FILTERS, Entry

MEASURED = Path(__file__).with_name("league.json")
ADAPTERS = {one.label: one for one in (*ATTITUDE_FILTERS, *POSITION_FILTERS) if one.use.startswith("tests.")}
HOVER = {
    "leg": [
        {"kind": "static", "duration_s": 10.0},
        {"kind": "take-off", "to_height_m": 10.0, "rate_mps": 2.0},
        {"kind": "hover", "duration_s": 15.0},
        {"kind": "yaw", "by_deg": 180.0, "rate_deg_s": 45.0},
        {"kind": "hover", "duration_s": 10.0},
    ],
    "evaluation.from_s": 20.0,
}
"""A quadrotor that hovers and turns, with its magnetometer."""


def build(label):
    entry = ADAPTERS[label]
    if not entry.version:
        pytest.skip(f"{entry.package} is not installed (extra 'league')")
    module, _, name = entry.use.partition(":")
    return getattr(importlib.import_module(module), name)()


@pytest.fixture(scope="module")
def hover():
    profile = bench.read_profile("hover-and-sprint", HOVER)
    truth = bench.fly(profile)
    return truth, bench.sense(profile, truth)


@pytest.fixture(scope="module")
def weave():
    profile = bench.read_profile(
        "s-turns", {**entries._SHORT, "sensors.imu": "matched-mems", "sensors.gnss": "matched-white"}
    )
    truth = bench.fly(profile)
    return truth, bench.sense(profile, truth)


def attitude_errors(truth, solution):
    """Return the total error, and its tilt and heading [deg], of the last 10 s."""
    late = solution.t > truth.t[-1] - 10.0
    q_nb = truth.q_nb[np.searchsorted(truth.t, solution.t - 1e-9)]
    phi = rotation.to_rotvec(rotation.multiply(solution.q_nb, rotation.conjugate(q_nb)))[late]
    return np.rad2deg(np.sqrt([(phi**2).sum(axis=1).mean(), (phi[:, :2] ** 2).sum(axis=1).mean()]))


@pytest.mark.parametrize("label", [one.label for one in ATTITUDE_FILTERS if one.use.startswith("tests.")])
def test_an_attitude_filter_is_right_in_the_hover(hover, label):
    """Half a turn about the vertical and a hover: a wrong frame, sign or unit leaves 20 deg or more."""
    truth, sensed = hover
    solution = build(label).run(sensed.data, sensed.initial)
    assert np.isnan(solution.lla).all()
    assert np.isnan(solution.cov).all()
    total, tilt = attitude_errors(truth, solution)
    assert tilt < 4.0
    assert total < 10.0
    wrong = replace(solution, q_nb=rotation.conjugate(solution.q_nb))
    assert attitude_errors(truth, wrong)[0] > 20.0


@pytest.mark.filterwarnings("ignore")  # python-ins uses what pandas deprecates
@pytest.mark.parametrize("label", [one.label for one in POSITION_FILTERS if one.use.startswith("tests.")])
def test_a_position_filter_is_as_good_as_ours_on_its_own_errors(weave, label):
    """White fixes 1 s apart and biases alone: errors within twice the errors of `loose-15`.

    The EKF of gtsam has no biases: within eight times.
    """
    truth, sensed = weave
    errors = []
    for one in (build(label), None):
        run = one.run if one else lambda data, initial: bench.run_filter("loose-15", data, initial)
        solution = run(sensed.data, sensed.initial)
        row = np.searchsorted(truth.t, solution.t - 1e-9)
        late = solution.t > 20.0
        pos_n = earth.difference_n(solution.lla, truth.lla[row])[late]
        start = earth.difference_n(solution.lla[:1], truth.lla[:1])
        assert np.abs(start).max() < 50.0
        vel_n = (solution.vel_n - truth.vel_n[row])[late]
        errors.append([np.sqrt((one**2).sum(axis=1).mean()) for one in (pos_n, vel_n)])
        assert np.linalg.eigvalsh(solution.cov[-1]).min() > 0.0
    own, ours = np.array(errors)
    assert (own < (8.0 if label == "GtsamGal3Ekf" else 2.0) * ours).all(), (own, ours)


@pytest.mark.parametrize("label", ["GtsamGal3Ekf", "Vqf"])
def test_an_adapter_takes_nothing_before_it_arrives(weave, label):
    """The record cut at 40 s gives the same bits until then."""
    _, sensed = weave
    data, filter_ = sensed.data, build(label)
    whole = filter_.run(data, sensed.initial)
    early = data.output_t < 40.0
    part = filter_.run(bench.slice_sensors(data, -1.0, 40.0), sensed.initial)
    n = min(int(early.sum()), len(part))
    assert n > 300
    np.testing.assert_array_equal(part.q_nb[:n], whole.q_nb[:n])
    np.testing.assert_array_equal(part.vel_n[:n], whole.vel_n[:n])


@pytest.mark.parametrize("label", ["Madgwick", "Mahony", "Vqf"])
def test_an_adapter_gives_what_the_package_gives_by_itself(weave, label):
    """The batch class of the package on arrays, in its own frame, against the adapter sample by sample."""
    _, sensed = weave
    imu, filter_ = sensed.data.imu, build(label)
    solution = filter_.run(sensed.data, sensed.initial)
    gyro, accel = imu.dtheta_b / imu.dt[:, None], imu.dvel_b / imu.dt[:, None]
    if label == "Vqf":
        theirs = importlib.import_module("vqf").VQF(float(imu.dt[0])).updateBatch(gyro, accel)["quat6D"]
        frame = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])  # east, north, up in n
    else:
        start = rotation.multiply(rotation.conjugate(filter_.frame), sensed.initial.q_nb)
        options = {"gain": 0.041} if label == "Madgwick" else {}
        make = getattr(importlib.import_module("ahrs").filters, label)
        first = np.vstack([gyro[:1], gyro]), np.vstack([accel[:1], accel])  # its row 0 is the start
        theirs = make(*first, q0=start, Dt=float(imu.dt[0]), **options).Q[1:]
        frame = np.diag([1.0, -1.0, -1.0]) if label == "Madgwick" else None
        frame = np.array([[0.0, 1, 0], [1, 0, 0], [0, 0, -1]]) if frame is None else frame
    row = np.searchsorted(imu.t, solution.t[1:] + 1e-9) - 1
    C_nb = frame @ rotation.matrix(theirs[row])
    np.testing.assert_allclose(rotation.matrix(solution.q_nb[1:]), C_nb, atol=1e-4)


@pytest.fixture(scope="module")
def small():
    """A league of two filters on a short flight; the package of the third is nowhere."""
    flight = SuiteFlight("short", "s-turns", entries._SHORT)
    filters = (Entry("loose-full", "", "x"), Entry("loose-15", "", "x"), Entry("x:Missing", "no-such", "x"))
    suites = {"position": (Suite("league-small", (), draws=2, members=(flight,)), filters)}
    with pytest.MonkeyPatch.context() as patch:
        for module in (entries, league):
            patch.setattr(module, "SUITES", suites)
        yield league.make_league(audit=False), patch


def test_a_league_has_a_row_for_each_filter_and_the_reason_of_a_failed_row(small):
    made, _ = small
    full, other, missing = made["rows"]
    assert full["scores"]["short"]["accuracy"]["value"] == 1.0
    assert other["scores"]["short"]["honesty"]["parts"]
    assert other["command"] == "python -m tests.league --only loose-15 --runs 2"
    assert missing["failed"] == "no-such is not installed"
    tables = league_page.write_tables(made)
    assert "| `Missing` | no-such  | x | no-such is not installed |" in tables
    assert "| `Missing` | not audited |" in tables
    assert tables.index("`loose-full`") < tables.index("`loose-15`") < tables.index("`Missing`")


def test_a_table_is_sorted_by_the_first_number_of_a_column_and_what_has_none_is_last(small):
    made, _ = small
    slow = copy.deepcopy(made)
    slow["rows"][0]["speed"] = [900.0, 800.0, 1000.0]
    rows = league_page.write_tables(slow, "CPU").partition("uses the future")[2].splitlines()[2:5]
    assert [row.split("`")[1] for row in rows] == ["loose-15", "loose-full", "Missing"]


def test_robustness_is_the_error_with_faults_over_the_own_error_without():
    suite = Suite(
        "x", (), members=(SuiteFlight("calm", "s-turns"), SuiteFlight("bad", "s-turns", {}, "calm"))
    )
    scores = {"calm": {"accuracy": {"by_run": [1.0, 2.0]}}, "bad": {"accuracy": {"by_run": [3.0, 6.0]}}}
    assert league._compare_faults(suite, scores, "accuracy") == pytest.approx([3.0, 3.0, 3.0])
    scores["bad"]["accuracy"]["by_run"] = [3.0, None]
    assert league._compare_faults(suite, scores, "accuracy") is None
    assert league._compare_faults(suite, {"calm": scores["calm"]}, "accuracy") is None


def test_the_runs_of_a_league_repeat_to_the_bit_and_a_changed_one_is_found(small):
    made, _ = small
    repeated, found = league.verify_league(made)
    assert len(repeated) == 3
    assert found == []
    forged = copy.deepcopy(made)
    for row in forged["rows"][:2]:
        row["answers"] = [["0" * 16 for _ in runs] for runs in row["answers"]]
    assert len(league.verify_league(forged, 1)[1]) == 1


def test_a_seed_draws_other_noise(small):
    made, _ = small
    other = league.make_league(["loose-15"], seed=7, audit=False)
    assert other["suites"] != made["suites"]
    assert other["rows"][0]["command"].endswith("--runs 2 --seed 7")
    assert other["rows"][0]["answers"] != made["rows"][1]["answers"]


def test_the_page_has_a_row_for_each_filter():
    text, measured = (
        league_page.PAGE.read_text(encoding="utf-8"),
        json.loads(MEASURED.read_text(encoding="utf-8")),
    )
    assert league_page.write_tables(measured) in text
    for one in (*ATTITUDE_FILTERS, *POSITION_FILTERS):
        assert f"| `{one.label}`" in text, one.label
    for kind, reference in measured["references"].items():
        assert any(row["filter"] == reference and row["kind"] == kind for row in measured["rows"])
