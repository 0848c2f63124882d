"""Correct solutions given in another convention: each is named, and nothing is said of consistent ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

import bench
from bench import pipeline
from bench.core.mathematics import earth
from bench.evaluation.consistency.verdict import BROKEN, add_verdict
from bench.evaluation.conventions import known_conventions
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.evaluation.conventions.known_conventions import (
    Answers,
    Convention,
    TrueMotion,
    compare,
    list_conventions,
    move,
)
from bench.evaluation.errors.error_series import interpolate_truth
from tests.evaluation import mistaken
from tests.synthetic import turning

STRAIGHT = {**mistaken.MATCHED, "leg": [{"kind": "straight", "duration_s": 150.0}]}


def conventions(found) -> list[str]:
    return [row["convention"] for row in found.get("looks_like", ())]


@pytest.mark.parametrize("mistake", mistaken.MISTAKES)
def test_each_mistake_is_named_alone(mistake):
    found = mistaken.ask(mistake, 0)
    assert conventions(found) == [mistaken.MISTAKES[mistake][1]]
    (row,) = found["looks_like"]
    assert row["nees"] > 10 * row["nees_without"]
    assert found["why_text"].startswith("Looks like ")


def test_the_constants_are_those_that_were_put_there():
    def constants(mistake):
        return np.array(mistaken.ask(mistake, 0)["looks_like"][0]["constants"])

    assert constants("0.1 s late") == pytest.approx([mistaken.LATE], abs=0.005)
    assert constants("lever arm of 1 m") == pytest.approx(mistaken.ARM, abs=0.1)
    assert constants("heights over the geoid") == pytest.approx([mistaken.GEOID], abs=1.0)
    assert constants("turned by 2 deg") == pytest.approx(mistaken.TURN, abs=np.deg2rad(0.1))
    assert "s too late" in mistaken.ask("0.1 s late", 0)["why_text"]
    assert "m too low" in mistaken.ask("heights over the geoid", 0)["why_text"]


@pytest.mark.slow
@pytest.mark.parametrize("run", [1, *(pytest.param(run, marks=pytest.mark.long) for run in (2, 3))])
def test_each_mistake_is_named_in_other_draws(run):
    wrong = {
        mistake: conventions(mistaken.ask(mistake, run))
        for mistake, (_, right) in mistaken.MISTAKES.items()
        if conventions(mistaken.ask(mistake, run)) != [right]
    }
    assert wrong == {}


@pytest.mark.parametrize("draws", [30, pytest.param(200, marks=pytest.mark.long)])
def test_nothing_is_said_of_honest_solutions(draws):
    """Who names a mistake in 15 % of them passes 30 once in 130 times, 200 never."""
    assert sum("looks_like" in mistaken.ask("", 1000 + run) for run in range(draws)) == 0


def test_nothing_is_said_of_a_filter_that_is_wrong_in_another_way():
    """Its covariances are broken by a wandering error, by a spoof, by a drift: no constant undoes them."""
    for name, use in (
        ("figure-eight", "loose-15"),
        ("gnss-faults", "loose-15"),
        ("figure-eight", "gnss-only"),
    ):
        profile = bench.read_profile(name, estimators=[use])
        truth = pipeline.fly(profile)
        sensed = pipeline.sense(profile, truth, 1)
        solution = pipeline.navigate(profile.estimators[0], sensed.data, sensed.initial)
        verdict = add_verdict(use, pipeline.measure(profile, truth, solution, sensed.truth)[1])["verdict"]
        assert verdict in BROKEN
        begin = profile.evaluation.begin
        assert find_mistakes([truth], [solution], sensed.data.antenna_b, begin) == {}


def test_what_a_straight_flight_does_not_tell_is_named_together(monkeypatch):
    profile = bench.read_profile("s-turns", STRAIGHT, estimators=["loose-15"])
    truth = pipeline.fly(profile)
    monkeypatch.setattr(mistaken, "fly", lambda name: (profile, truth))
    monkeypatch.setattr(mistaken, "LATE", 0.3)
    late = mistaken.ask("0.1 s late", 0, "straight")
    assert conventions(late) == [
        "time offset",
        "time offset of the fixes",
        "lever arm",
        "offset",
    ]
    time, _, arm, offset = (row["constants"] for row in late["looks_like"])
    speed = np.linalg.norm(truth.vel_n[-1])
    assert time[0] * speed == pytest.approx(-arm[0], abs=0.1)
    assert np.linalg.norm(offset) == pytest.approx(-arm[0], abs=0.1)
    assert "(this motion cannot distinguish them)" in late["why_text"]
    turned = conventions(mistaken.ask("turned by 2 deg", 0, "straight"))
    assert turned == ["rotation of the body", "rotation of the level"]


def test_two_mistakes_are_named_one_after_the_other():
    solution, sensed = mistaken.give("conjugate", 0)
    profile, truth = mistaken.fly()
    both = mistaken.MISTAKES["velocities ENU"][0](solution, sensed.data)
    found = find_mistakes([truth], [both], sensed.data.antenna_b, profile.evaluation.begin)
    assert sorted(conventions(found)) == [
        "an attitude from level to body, the conjugate quaternion",
        "velocities east, north, up",
    ]
    assert {row["step"] for row in found["looks_like"]} == {1, 2}


@pytest.mark.parametrize(("sigmas", "named"), [(4.5, []), (7.0, ["height"])])
def test_what_a_constant_error_may_be_by_chance_is_no_convention(sigmas, named):
    """An error that lasts the whole run is one value: of 4.5 sigma it is rare, and no proof of a geoid."""
    given, sensed = mistaken.give("", 0)
    profile, truth = mistaken.fly()
    sd = np.array([1.0, 1.0, 6.0 / sigmas, 0.1, 0.1, 0.1, 0.01, 0.01, 0.01])
    lla, vel_n, q_nb = interpolate_truth(truth, given.t)
    lla = earth.displace(lla, np.array([0.0, 0.0, 6.0]))
    cov = np.tile(np.diag(np.square(sd)), (len(given.t), 1, 1))
    solution = replace(given, lla=lla, vel_n=vel_n, q_nb=q_nb, cov=cov)
    found = find_mistakes([truth], [solution], sensed.data.antenna_b, profile.evaluation.begin)
    assert conventions(found) == named


def test_what_cannot_be_compared_is_no_convention():
    """Without a warning: nothing after the alignment, times that the truth has not, numbers of 1e200."""
    given, sensed = mistaken.give("", 0)
    profile, truth = mistaken.fly()
    begin, arm = profile.evaluation.begin, sensed.data.antenna_b
    assert find_mistakes([truth], [given], arm, 1e9) == {}
    assert find_mistakes([truth], [replace(given, t=given.t + 1e6)], arm, begin) == {}
    assert find_mistakes([truth], [replace(given, lla=given.lla * 1e200)], arm, begin) == {}


def test_the_place_of_the_antenna_is_recognized():
    (arm,) = (one for one in list_conventions(mistaken.ARM) if one.name == "lever arm")
    assert "the motion of the antenna" in arm.words(1.1 * mistaken.ARM)
    assert "the motion of a point" in arm.words(mistaken.ARM + 1.0)


# --- each convention by itself ----------------------------------------------------------------------------


def answers(run: int = 0) -> tuple[Answers, object]:
    solution, _ = mistaken.give("", run)
    rows = slice(800, 2800, 20)
    _, truth = mistaken.fly()
    return (
        Answers(
            solution.t[rows],
            solution.lla[rows],
            solution.vel_n[rows],
            solution.q_nb[rows],
            solution.cov[rows],
            np.zeros(100, np.int64),
        ),
        truth,
    )


@pytest.mark.parametrize("name", [one.name for one in list_conventions(np.zeros(3)) if one.constants])
def test_the_derivative_of_a_constant_is_that_of_what_it_undoes(name):
    """By central differences: to undo a constant changes the errors by minus the derivative."""
    own, truth = answers()
    (one,) = (one for one in list_conventions(np.ones(3)) if one.name == name)
    expected = one.derivative(move([truth], own))
    for k in range(one.constants):
        c = np.zeros(one.constants)
        c[k] = 1e-3
        sides = []
        for step in (-c, c):
            undone = one.undo(own, move([truth], own), step)
            sides.append(compare(undone, move([truth], undone)))
        measured = (sides[0] - sides[1]) / 2e-3
        scale = np.abs(expected[:, :, k]).max()
        assert measured == pytest.approx(expected[:, :, k], abs=0.02 * scale + 1e-4)


def test_every_convention_is_tried_once():
    names = [one.name for one in list_conventions(np.zeros(3))]
    assert len(names) == len(set(names)) > 25


# --- each by hand: the mistake made by scipy, and undone --------------------------------------------------

ATTITUDE = Rotation.from_euler("ZYX", [[40.0, 3.0, -20.0], [100.0, -12.0, 8.0]], degrees=True)
LLA = np.array([[0.7, -0.3, 500.0], [-0.9, 2.1, 80.0]])
VEL_N = np.array([[20.0, -7.0, 3.0], [-11.0, 30.0, -2.0]])
ACCEL_N = np.array([[1.0, -2.0, 0.5], [0.3, 0.4, -1.0]])
TURN_N = np.array([[0.1, -0.2, 0.3], [-0.4, 0.05, 0.2]])
TURNED_N = np.array([[0.2, -0.4, 6.0], [0.5, 0.1, -3.0]])


def in_quaternions(attitude: Rotation) -> np.ndarray:
    return attitude.as_quat(scalar_first=True)


def in_euler(factor: float) -> np.ndarray:
    """Attitudes whose angles in rad were multiplied by a factor."""
    return in_quaternions(Rotation.from_euler("ZYX", factor * ATTITUDE.as_euler("ZYX")))


def in_axes(level: bool, body: bool, conjugate: bool) -> np.ndarray:
    given = ATTITUDE * Rotation.from_matrix(mistaken.FLU) if body else ATTITUDE
    given = Rotation.from_matrix(mistaken.ENU) * given if level else given
    return in_quaternions(given.inv() if conjugate else given)


def in_geocentric() -> np.ndarray:
    """Latitudes whose tangents are those of the Earth-fixed position."""
    x, y, z = earth.to_ecef(LLA).T
    return np.column_stack([np.arctan2(z, np.hypot(x, y)), LLA[:, 1:]])


EXCHANGED = {
    "latitude and longitude that are exchanged": {"lla": LLA[:, [1, 0, 2]]},
    "latitude and longitude in degrees read as radians": {"lla": LLA * [180 / np.pi, 180 / np.pi, 1.0]},
    "latitude and longitude in radians read as degrees": {"lla": LLA * [np.pi / 180, np.pi / 180, 1.0]},
    "attitude angles in degrees read as radians": {"q_nb": in_euler(180 / np.pi)},
    "attitude angles in radians read as degrees": {"q_nb": in_euler(np.pi / 180)},
    "geocentric latitudes": {"lla": in_geocentric()},
    "heights that count downwards": {"lla": LLA * [1.0, 1.0, -1.0]},
    "velocities east, north, up": {"vel_n": VEL_N @ mistaken.ENU.T},
    "vertical velocities that count upwards": {"vel_n": VEL_N * [1.0, 1.0, -1.0]},
    "velocities along the body": {"vel_n": ATTITUDE.inv().apply(VEL_N)},
    "an attitude of axes forward, left, up": {"q_nb": in_axes(False, True, False)},
    "an attitude in east, north, up": {"q_nb": in_axes(True, False, False)},
    "an attitude of axes forward, left, up and in east, north, up": {"q_nb": in_axes(True, True, False)},
    "an attitude from level to body, the conjugate quaternion": {"q_nb": in_axes(False, False, True)},
    "an attitude from level to body, the conjugate quaternion and of axes forward, left, up": {
        "q_nb": in_axes(False, True, True)
    },
    "an attitude from level to body, the conjugate quaternion and in east, north, up": {
        "q_nb": in_axes(True, False, True)
    },
    "an attitude from level to body, the conjugate quaternion and of axes forward, left, up and in east, "
    "north, up": {"q_nb": in_axes(True, True, True)},
    "headings that are negated": {
        "q_nb": in_quaternions(Rotation.from_euler("ZYX", ATTITUDE.as_euler("ZYX") * [-1.0, 1.0, 1.0]))
    },
    "quaternions with their scalar last": {"q_nb": ATTITUDE.as_quat()},
}
"""Convention -> the two right answers as they are given in it by mistake."""


def made(**given: np.ndarray) -> tuple[Answers, TrueMotion]:
    """Right answers but for what is given, and the motion; a third time is outside the truth."""
    nothing, inside = np.full((1, 3), np.nan), np.array([True, True, False])
    right = {"lla": LLA, "vel_n": VEL_N, "q_nb": in_quaternions(ATTITUDE)} | given
    columns = (np.vstack([right[name], nothing]) for name in ("lla", "vel_n"))
    q_nb = np.vstack([right["q_nb"], [[1.0, 0.0, 0.0, 0.0]]])
    cov = np.tile(np.diag(np.square(np.arange(1.0, 10.0))), (3, 1, 1))
    motion = TrueMotion(
        inside, LLA, VEL_N, in_quaternions(ATTITUDE), ACCEL_N, TURN_N, TURNED_N, np.ones(2), inside[:2]
    )  # fmt: skip
    return Answers(np.array([5.0, 6.0, 99.0]), *columns, q_nb, cov, np.zeros(3, np.int64)), motion


def find(name: str, antenna=(0.0, 0.0, 0.0)) -> Convention:
    return next(one for one in list_conventions(np.array(antenna)) if one.name == name)


@pytest.mark.parametrize("name", EXCHANGED)
def test_what_is_exchanged_is_undone(name):
    given, motion = made(**EXCHANGED[name])
    assert np.abs(compare(given, motion)).max() > 0.1
    assert_allclose(compare(find(name).undo(given, motion, np.empty(0)), motion), 0.0, atol=1e-8)


def test_all_without_constants_are_undone_above():
    names = [one.name for one in list_conventions(np.zeros(3)) if not (one.constants or one.of_claim)]
    assert sorted(names) == sorted(EXCHANGED)


@pytest.mark.parametrize("factor", [180.0 / np.pi, np.pi / 180.0])
def test_an_error_of_angles_in_a_wrong_unit_is_that_of_the_angles(factor):
    """Roll, pitch and heading each off by a little: in the right unit the answer is off by as much."""
    off = np.array([[2e-4, -1e-4, 3e-4]])
    angles = ATTITUDE.as_euler("ZYX") + off
    given, motion = made(q_nb=in_quaternions(Rotation.from_euler("ZYX", factor * angles)))
    word = "degrees read as radians" if factor > 1.0 else "radians read as degrees"
    undone = find(f"attitude angles in {word}").undo(given, motion, np.empty(0)).q_nb[:2]
    found = Rotation.from_quat(undone, scalar_first=True).as_euler("ZYX")
    assert_allclose(found - ATTITUDE.as_euler("ZYX"), np.tile(off, (2, 1)), atol=2e-6)


def test_constants_are_taken_off():
    """An antenna, a datum, an offset, two turns and a clock, each put there by scipy or by a plain sum."""
    arm, turn = np.array([1.0, -2.0, 0.5]), np.array([0.02, -0.03, 0.05])
    swing = np.cross(ATTITUDE.inv().apply(TURN_N), arm)
    before = earth.displace(LLA, -0.5 * VEL_N)  # half a second ago
    faster = Rotation.from_rotvec(0.01 * TURNED_N) * ATTITUDE
    at = earth.displace(LLA, ATTITUDE.apply(arm))
    for name, constants, mistake in (
        ("lever arm", arm, {"lla": at, "vel_n": VEL_N + ATTITUDE.apply(swing)}),
        ("time offset of the fixes", np.array([0.5]), {"lla": before, "vel_n": VEL_N - 0.5 * ACCEL_N}),
        ("gyro scale", np.array([0.01]), {"q_nb": in_quaternions(faster)}),
        ("height", np.array([30.0]), {"lla": LLA - [0.0, 0.0, 30.0]}),
        ("offset", np.array([4.0, -7.0]), {"lla": earth.displace(LLA, np.array([4.0, -7.0, 0.0]))}),
        ("rotation of the body", turn, {"q_nb": in_quaternions(ATTITUDE * Rotation.from_rotvec(turn))}),
        ("rotation of the level", turn, {"q_nb": in_quaternions(Rotation.from_rotvec(turn) * ATTITUDE)}),
    ):
        given, motion = made(**mistake)
        assert np.abs(compare(given, motion)).max() > 0.01
        assert_allclose(compare(find(name).undo(given, motion, constants), motion), 0.0, atol=1e-4), name
    given, motion = made()
    late = find("time offset").undo(replace(given, late=0.5), motion, np.array([0.25]))
    assert late.late == 0.75


@pytest.mark.parametrize(
    ("name", "given"),
    [
        ("variances given as standard deviations", lambda sd, unit: sd**2),
        ("standard deviations given as variances", lambda sd, unit: sd**0.5),
        ("variances given as standard deviations, of angles in degrees", lambda sd, unit: sd**2 * unit),
        ("standard deviations given as variances, of angles in degrees", lambda sd, unit: (sd / unit) ** 0.5),
        ("standard deviations of the attitude in degrees read as radians", lambda sd, unit: sd * unit),
        ("standard deviations of the attitude in radians read as degrees", lambda sd, unit: sd / unit),
    ],
)  # fmt: skip
def test_a_wrong_claim_is_undone_and_its_correlations_stay(name, given):
    sd, unit = np.arange(1.0, 10.0), np.repeat([1.0, 1.0, 180.0 / np.pi], 3)
    correlation = 0.3 + 0.7 * np.eye(9)
    wrong = given(sd, unit)
    own, motion = made()
    own = replace(own, cov=np.tile(correlation * np.outer(wrong, wrong), (3, 1, 1)))
    undone = find(name).undo(own, motion, np.empty(0))
    assert_allclose(undone.cov, np.tile(correlation * np.outer(sd, sd), (3, 1, 1)))


def test_the_motion_is_that_of_the_instants_that_answers_are_of():
    """A circle at 20 m/s, 0.2 rad/s: the acceleration is 4 m/s^2 to the side, the turn is about down."""
    truth = turning(10.0, 100.0, speed=20.0, turn_rate=0.2)
    own, _ = made()
    own = replace(own, t=np.array([3.0, 0.54, 10.46]), late=0.5)
    motion = move([truth], own)
    assert motion.inside.tolist() == [True, False, False]
    ends = replace(own, t=np.array([0.555, 10.445, 99.0]))
    assert move([truth], ends).inside.tolist() == [True, True, False]
    north, east = np.cos(0.7 + 0.5), np.sin(0.7 + 0.5)
    assert_allclose(motion.vel_n, [[20.0 * north, 20.0 * east, 0.0]], atol=1e-3)
    assert_allclose(motion.accel_n, [[-4.0 * east, 4.0 * north, 0.0]], atol=1e-3)
    assert_allclose(motion.turn_n, [[0.0, 0.0, 0.2]], atol=1e-4)
    assert_allclose(motion.turned_n, [[0.0, 0.0, 0.5]], atol=1e-6)  # 2.5 s of it
    assert (motion.dt.tolist(), motion.first.tolist()) == ([2.5], [True])
    assert_allclose(motion.turn_b, [[0.0, 0.2 * np.sin(0.65), 0.2 * np.cos(0.65)]], atol=1e-4)  # banked


# --- where it is said -------------------------------------------------------------------------------------


class Late:
    """A filter of somebody whose clock is 0.1 s off."""

    def run(self, data, initial):
        late = np.maximum(data.output_t - mistaken.LATE, data.output_t[0])
        late[1:] = np.maximum(late[1:], data.output_t[0] + 1e-3 * np.arange(1, len(late)))
        asked = replace(data, output_t=late)
        solution = bench.navigation.built_in.load("loose-15", {}).run(asked, initial)
        return replace(solution, t=data.output_t)


def test_a_run_says_it_of_a_filter_of_others_and_not_of_a_built_in_one():
    use = "tests.evaluation.test_conventions:Late"
    profile = bench.read_profile("s-turns", mistaken.MATCHED, estimators=[use, "loose-15"], allow_code=True)
    own, built_in = bench.run(profile).metrics.values()
    assert conventions(own) == ["time offset"]
    assert "Looks like answers that are 0.1" in own["verdict_text"]
    assert "looks_like" not in built_in


def test_score_says_it_of_a_solution_in_a_file(tmp_path):
    profile = bench.read_profile("s-turns", mistaken.MATCHED, estimators=["loose-15"])
    bench.write_result(bench.run(profile), tmp_path / "run", recording=False, report=False)
    solution, _ = mistaken.give("velocities ENU", 0)
    lat, lon, alt = solution.lla.T
    sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    names = "t_s,lat_rad,lon_rad,alt_m,vel_n_mps,vel_e_mps,vel_d_mps,q_nb_w,q_nb_x,q_nb_y,q_nb_z"
    names += "".join(
        f",sd_{block}_{axis}_{unit}"
        for block, unit in (("pos", "m"), ("vel", "mps"), ("phi", "rad"))
        for axis in "ned"
    )
    table = np.column_stack([solution.t, lat, lon, alt, solution.vel_n, solution.q_nb, sd])
    np.savetxt(tmp_path / "theirs.csv", table, delimiter=",", header=names, comments="", fmt="%.17g")
    score = bench.score_solution(tmp_path / "theirs.csv", tmp_path / "run")
    assert conventions(score.metrics) == ["velocities east, north, up"]
    assert "Looks like velocities east, north, up" in score.metrics["verdict_text"]


def test_what_is_told_of_a_constant_is_in_its_unit():
    turn, offset = np.deg2rad([1.0, -2.0, 0.5]), np.array([3.0, -4.0])
    told = known_conventions.tell_turn("x, y, z", turn)
    assert told == "an attitude turned by a constant 1.00, -2.00, 0.50 deg about x, y, z"
    assert known_conventions.tell_time("answers", np.array([0.25])) == "answers that are 0.250 s too late"
    assert known_conventions.tell_time("answers", np.array([-0.1])) == "answers that are 0.100 s too early"
    assert known_conventions.tell_time("answers", np.array([18.01])).endswith(
        "late, the leap seconds between GPS time and UTC"
    )
    assert known_conventions.tell_time("answers", np.array([-0.99])).endswith("early, a leap second")
    assert known_conventions.tell_time("answers", np.array([1.03])) == "answers that are 1.030 s too late"
    assert known_conventions.tell_time("stamps", np.array([0.2])) == "stamps that are 0.200 s too late"
    assert known_conventions.tell_scale(np.array([-2e-3])).endswith("scale factor wrong by -0.200 %")
    assert known_conventions.tell_arm(-np.array([1.0, 0.5, -0.25]), np.array([0.98, 0.5, -0.25])) == (
        "a lever arm of -0.98, -0.50, 0.25 m that is applied twice"
    )
    assert known_conventions.tell_height(np.array([-30.0])).endswith("30.0 m too high")
    arm = np.array([1.0, 0.5, -0.25])
    for whose, antenna in (("the antenna", arm + 0.05), ("a point", np.array([0.0, 0.0, -1.0]))):
        told = known_conventions.tell_arm(antenna, arm)
        assert told == f"the motion of {whose} 1.00, 0.50, -0.25 m (forward, right, down) from the IMU"
    assert known_conventions.tell_offset(offset) == "an offset of 3.00 m north, -4.00 m east"
