"""What carries a filter over a gap, by hand: a track of fixes, biases that are kept, and who is lost."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics import earth, rotation
from bench.core.records.data import Events, GnssFixes, InitialState, Innovations, no_innovations
from bench.core.records.sensor_specs import AxisFigures, GnssSpec, ImuSpec, TriadSpec
from bench.core.words.exceptions import EstimatorError
from bench.navigation.engine.integrity import nis_limit
from bench.navigation.engine.piecewise import join_events, refuse, take_after
from bench.navigation.engine.record_cuts import (
    first_sample,
    goes_beyond,
    join_pieces,
    longest_wait,
    newest_sample,
    nothing_known,
    slice_sensors,
    take_head,
)
from bench.navigation.engine.velocity_consistency import MovedFixes
from bench.navigation.error_state_filter import rough_heading, state_blocks
from bench.navigation.start import alignment, fixes_only, restart
from bench.navigation.start.fix_track import unknown_arm
from bench.navigation.start.fixes_only import Coast, End, fresh_fixes, lost_at
from bench.navigation.start.learnt_biases import UNLEARNT, LearntBiases, learn_biases
from bench.navigation.start.refused_fixes import RefusedFixes
from bench.simulation import sensors
from tests.builders import put, take
from tests.weaving import units, weaving

ORIGIN = np.array([0.8, 0.2, 500.0])
RECEIVER = GnssSpec(
    "receiver", 1.0, 1.5, 2.5, 0.1, pos_h_markov_sd=3.0, pos_v_markov_sd=4.0, vel_markov_sd=0.2,
    pos_decay_time=1.0 / 600.0, vel_decay_time=1.0 / 100.0,
)  # fmt: skip


def fixes_at(t, place, vel_n, arrival=None):
    """Fixes at places (M, 3) from the origin [m]."""
    t, none = np.asarray(t, float), np.zeros((len(t), 3, 3))
    lla = earth.displace(np.tile(ORIGIN, (len(t), 1)), np.asarray(place, float))
    sound, vel_n = np.ones(len(t), np.bool_), np.broadcast_to(vel_n, (len(t), 3)).copy()
    return GnssFixes(t, t if arrival is None else arrival, sound, lla, vel_n, none, none, 9 * sound)


# --- positions against velocities -----------------------------------------------------------------------


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_position_is_reported_from_where_its_displacement_is_unlikely(axis):
    """Flown straight at 50 m/s, against the middle of the last five fixes, 3 s ago; all errors by hand."""
    g = replace(
        RECEIVER, pos_h_jump_sd=1.1, pos_v_jump_sd=1.3, pos_decay_time=1 / 20.0, pos_decay_distance=1 / 900.0,
        vel_decay_time=1 / 2.0, vel_markov_sd=0.6, pos_h_white_sd=0.9, pos_v_white_sd=1.2,
    )  # fmt: skip
    velocity, t = np.array([30.0, -40.0, 0.0]), np.arange(16.0)
    white = np.array([0.81, 0.9, 1.44, 0.3, 0.4, 0.5])
    ends = 2.0 * (white[axis] + (1.69 if axis == 2 else 1.21) + (10.0 / 24.0) ** 2)
    wanders = 2.0 * (16.0 if axis == 2 else 9.0) * (1.0 - np.exp(-3.0 / 20.0 - 150.0 / 900.0))
    s = (np.arange(3000) + 0.5) / 1000.0
    slow = 0.36 * np.exp(-np.abs(s[:, None] - s[None, :]) / 2.0).sum() / 1e6
    var = ends + wanders + 3.0 * white[3 + axis] + slow
    for part, told in ((0.99, False), (1.01, True)):
        place = np.outer(t, velocity)
        place[-1, axis] += np.sqrt(part * nis_limit(3, 1e-5 / 4) * var)
        test = MovedFixes(g, 1e-5)
        found, events = test.take(fixes_at(t, place, velocity), np.tile(white, (16, 1)), last=True)
        assert found.tolist() == [False] * 15 + [told]
        said = "1 positions disagree with the velocities of the receiver"
        assert events == ([(15.0, 15.0, "integrity", said, "gnss_position")] if told else [])


def test_a_turn_is_summed_by_euler_and_maclaurin_and_leaves_what_changes_within_a_step():
    """A circle with one fix a second: trapezoids alone are off by a meter a second and more."""
    t = np.arange(40.0)
    place = 125.0 * np.column_stack([np.sin(0.2 * t), 1.0 - np.cos(0.2 * t), 0.0 * t])
    velocity = 25.0 * np.column_stack([np.cos(0.2 * t), np.sin(0.2 * t), 0.0 * t])
    one = replace(fixes_at(t, place, [0.0] * 3), vel_n=velocity)
    still = GnssSpec("exact", 1.0, 0.05, 0.05, 0.005)
    found, _ = MovedFixes(still, 1e-5).take(one, np.tile([0.0025] * 3 + [2.5e-5] * 3, (40, 1)), last=True)
    assert not found.any()


def test_what_is_carried_of_a_motion_whose_acceleration_grows():
    """To a cubic the way left over stays the same; beside it the path, and what jerks may hide."""
    t, jerk, dt = 0.5 * np.arange(21.0), np.array([0.6, -0.8, 0.0]), 0.5
    place, velocity = np.outer(t**3 / 6.0, jerk), np.outer(t**2 / 2.0, jerk)
    test, left = MovedFixes(RECEIVER, 1e-5), []
    for k in range(len(t)):
        one = replace(fixes_at(t[k : k + 1], place[k : k + 1], [0.0] * 3), vel_n=velocity[k : k + 1])
        test.take(one, np.full((1, 6), 0.25), last=False)
        left.append(test.state()["before"])
    left = np.array(left)
    assert np.abs(left[2:, 1:4] - left[2, 1:4]).max() < 2e-3  # of 0.2 m that trapezoids leave
    hidden = 10.0 * dt**3 / 24.0 + np.linalg.norm(jerk) * dt**2 * dt / 6.0
    assert_allclose(left[3:, 4:7], 0.25 + hidden**2, rtol=1e-3)
    assert_allclose(left[:, 7:10], np.outer(np.arange(21.0), np.full(3, 0.25 * dt**2)))
    speed = np.linalg.norm(jerk) * t**2 / 2.0
    path = np.append(0.0, np.cumsum(0.5 * dt * (speed[1:] + speed[:-1])))
    assert_allclose(left[:, 10], path, rtol=1e-3, atol=1e-3)


def test_a_receiver_whose_first_fixes_are_all_wild_is_heard_when_it_calms_down():
    """None of the first ten seconds fits the others: the first of them stands for all until the next gap."""
    t, velocity = np.arange(30.0), np.array([3.0, 4.0, 0.0])
    place = np.outer(t, velocity)
    place[:11] += 1e4 * np.random.default_rng(3).normal(size=(11, 3))
    late = np.where(t > 20.0, t + 9.0, t)
    found, _ = MovedFixes(RECEIVER, 1e-5).take(fixes_at(late, place, velocity), np.ones((30, 6)), last=True)
    assert found[2:21].all()
    assert not found[21:].any()


def test_rows_of_reports_are_told_when_they_end_and_only_then():
    t, velocity = np.arange(40.0), np.array([3.0, 4.0, 0.0])
    place = np.outer(t, velocity)
    place[[20, 21, 22, 30], 0] += 500.0
    test, one, variance = MovedFixes(RECEIVER, 1e-5), fixes_at(t, place, velocity), np.ones((40, 6))
    moved, events = np.zeros(0, bool), []
    for begin, end in ((0, 21), (21, 31), (31, 31), (31, 40)):
        found, more = test.take(take(one, slice(begin, end)), variance[begin:end], last=end == 40)
        moved, events = (
            np.append(moved, found),
            [*events, (end, [(row[0], row[1], row[3][:1]) for row in more])],
        )
    assert np.flatnonzero(moved).tolist() == [20, 21, 22, 30]
    assert events == [(21, []), (31, [(20.0, 22.0, "3")]), (31, []), (40, [(30.0, 30.0, "1")])]


# --- biases ---------------------------------------------------------------------------------------------

KNOWN = LearntBiases(
    np.array([1e-3, -2e-3, 3e-3]),
    np.array([0.01, 0.02, -0.05]),
    np.array([1e-4, 2e-4, 5e-4]),
    np.full(3, 4e-3),
)
SHEET = ImuSpec(
    "unit",
    TriadSpec(
        turn_on_bias_sd=4e-4, bias_instability=6.64e-5, range=3.0, temperature_sd=1.0, g_sensitivity_sd=2.0,
        g2_sensitivity_sd=3.0, axes=(AxisFigures("random_walk", 1.0, 2.0, 3.0),),
    ),
    TriadSpec(turn_on_bias_sd=0.05),
)  # fmt: skip


def sensed():
    made = sensors.sense(weaving(3.0, 50.0), units(), 1, 0)
    return replace(made.data, specs=replace(made.data.specs, imu=SHEET))


def test_biases_that_are_known_are_taken_off_and_leave_what_is_not_known_of_them():
    data = sensed()
    less = KNOWN.taken_off(data)
    dt = data.imu.dt[:, None]
    assert_allclose(less.imu.dtheta_b, data.imu.dtheta_b - KNOWN.gyro * dt)
    assert_allclose(less.imu.dvel_b, data.imu.dvel_b - KNOWN.accel * dt)
    gyro, accel = less.specs.imu.gyro, less.specs.imu.accel
    own = SHEET.gyro.instability_sd
    left = np.minimum(np.sqrt(np.maximum(KNOWN.gyro_sd**2 - own**2, (1e-3 * KNOWN.gyro_sd) ** 2)), 4e-4)
    assert_allclose(gyro.by_axis("turn_on_bias_sd"), left)
    assert gyro.turn_on_bias_sd == left.max() == 4e-4
    assert_allclose(gyro.by_axis("random_walk"), [1.0, 2.0, 3.0])
    assert gyro.range == pytest.approx(3.003)
    assert accel.range == 0.0
    assert_allclose(accel.by_axis("turn_on_bias_sd"), 4e-3)
    again = KNOWN.taken_off(less).specs.imu.gyro
    assert [one.name for one in again.axes].count("turn_on_bias_sd") == 1
    sharp = replace(KNOWN, gyro_sd=np.full(3, 0.5 * own)).taken_off(data).specs.imu.gyro
    assert_allclose(sharp.by_axis("turn_on_bias_sd"), 0.5e-3 * own)


def test_an_alignment_takes_errors_of_gyros_that_are_known_as_a_whole_for_no_more_than_that():
    data = sensed()
    whole = KNOWN.for_alignment(data).specs.imu.gyro
    assert (whole.temperature_sd, whole.g_sensitivity_sd, whole.g2_sensitivity_sd) == (0.0, 0.0, 0.0)
    some = replace(KNOWN, gyro_sd=np.array([1e-4, np.inf, 1e-4])).for_alignment(data).specs.imu.gyro
    assert (some.temperature_sd, some.g_sensitivity_sd, some.g2_sensitivity_sd) == (1.0, 2.0, 3.0)
    assert_allclose(UNLEARNT.for_alignment(data).imu.dtheta_b, data.imu.dtheta_b)


def ended(**changes):
    three = np.zeros(3)
    extra, q_nb = np.arange(1.0, 9.0), np.array([1.0, 0.0, 0.0, 0.0])
    velocity, cov = np.array([3.0, 4.0, 0.0]), 1e-4 * np.eye(9)
    return End(5.0, ORIGIN, velocity, q_nb, cov, three, three, extra, 0.1 * extra)._replace(**changes)


def test_what_a_filter_has_learnt_of_its_biases_at_its_end():
    """Its states, or the errors as a whole beyond those it did not see; of a process, nothing."""
    found = learn_biases(ended(), SHEET, KNOWN, None)
    assert_array_equal(found.gyro, [1.0, 2.0, 3.0])
    assert_array_equal(found.accel, [4.0, 5.0, 6.0])
    assert_allclose(found.gyro_sd, [0.1, 0.2, 0.3])
    assert_allclose(found.accel_sd, [0.4, 0.5, 0.6])
    steady = 10.0 * np.arange(1.0, 7.0), np.arange(1.0, 7.0)
    found = learn_biases(ended(), SHEET, KNOWN, steady)
    assert_allclose(found.gyro - KNOWN.gyro, [10.0, 20.0, 30.0])
    assert_allclose(found.accel - KNOWN.accel, [40.0, 50.0, 60.0])
    assert_allclose(found.accel_sd, [4.0, 5.0, 6.0])
    forgets = replace(SHEET, accel=replace(SHEET.accel, turn_on_bias_sd=0.0))
    found = learn_biases(ended(), forgets, KNOWN, (steady[0], np.full(6, np.nan)))
    assert_array_equal(found.gyro, [1.0, 2.0, 3.0])
    assert not found.accel.any()
    assert np.isinf(found.accel_sd).all()
    for bad in ({"gyro_bias_b": np.full(3, np.nan)}, {"extra_sd": np.array([0.1] * 5 + [np.inf, 1.0, 1.0])}):
        assert learn_biases(ended(**bad), SHEET, KNOWN, None) is KNOWN
    beyond = ended(extra_sd=np.array([0.1] * 6 + [np.inf, np.inf]))
    assert learn_biases(beyond, SHEET, KNOWN, None) is not KNOWN


def test_biases_come_back_into_a_solution_that_has_states_for_them():
    plain = nothing_known(np.array([1.0, 2.0]))
    assert KNOWN.given_back(plain) is plain
    extra = np.arange(16.0).reshape(2, 8)
    zero = np.zeros((2, 3))
    full = replace(
        plain, extra_names=tuple("abcdefgh"), extra=extra, extra_sd=extra, gyro_bias_b=zero, accel_bias_b=zero
    )
    back = KNOWN.given_back(full)
    assert_allclose(back.gyro_bias_b, np.tile(KNOWN.gyro, (2, 1)))
    assert_allclose(back.accel_bias_b, np.tile(KNOWN.accel, (2, 1)))
    assert_allclose(back.extra - extra, np.tile([*KNOWN.gyro, *KNOWN.accel, 0.0, 0.0], (2, 1)))


# --- coasting -------------------------------------------------------------------------------------------


def coasting(end=None, gnss=RECEIVER, arm=(0.6, -0.9, 1.2)):
    data = sensed()
    data = replace(data, antenna_b=np.array(arm), specs=replace(data.specs, gnss=gnss))
    return Coast(take_head(data), end or ended(), ("a",) * 8, "datasheet")


def test_an_antenna_of_unknown_attitude_may_be_anywhere_around_the_imu():
    """The mean square along an axis of directions drawn over the sphere, and swinging by a rate."""
    rng = np.random.default_rng(2)
    directions = rng.normal(size=(200_000, 3))
    arm = 1.5 * directions / np.linalg.norm(directions, axis=1)[:, None]
    found = unknown_arm(np.array([0.5, -1.0, 1.0]), 0.3)
    assert_allclose(found[:3], np.mean(arm**2, axis=0), rtol=0.01)
    assert_allclose(found[3:], 0.09 * found[:3])
    assert_allclose(unknown_arm(np.array([0.5, -1.0, 1.0]))[3:], 0.01 * found[:3])


def test_attitude_is_held_and_what_is_not_known_of_it_grows_to_what_is_usual():
    """By the rates over a gap, to 0.5 rad of tilt and any heading; beyond the range by 4 rad/s."""
    coast = coasting()
    for T in (0.5, 2.0, 100.0):
        u = T / 3.0
        turned = 0.45**2 * (2.0 * (u - 1.0 + np.exp(-u)) + u * u - 2.0 * u * (1.0 - np.exp(-u)))
        _, _, cov = coast.at(5.0 + T)
        most = np.array([0.25, 0.25, np.pi**2 / 3.0])
        assert_allclose(cov[6:, 6:], np.diag(np.minimum(1e-4 + turned, most)))
        assert not cov[:6, 6:].any()
        assert not cov[6:, :6].any()
    coast.go_beyond()
    _, _, cov = coast.at(5.2)
    u = 0.2 / 3.0
    turned = 0.45**2 * (2.0 * (u - 1.0 + np.exp(-u)) + u * u - 2.0 * u * (1.0 - np.exp(-u))) + 0.64
    assert_allclose(np.diag(cov)[6:], 1e-4 + turned)
    arm2 = (0.6**2 + 0.9**2 + 1.2**2) / 3.0  # it swings by 1.5 rad/s, and 15 m/s^2 move it
    assert_allclose(np.diag(cov)[3:6], 1e-4 + 2.25 * arm2 + (15.0 * 0.2) ** 2, rtol=0.02)
    assert_allclose(np.diag(coast.at(8.0)[2])[6:], np.pi**2 / 3.0)
    sure = coasting(ended(cov=np.diag([1e-4] * 6 + [1.0, 1e-4, 4.0])))
    assert_allclose(np.diag(sure.at(6000.0)[2])[6:], [1.0, 0.25, 4.0])  # nothing is forgotten


def test_a_coast_begins_where_the_filter_has_ended_at_its_antenna():
    """And has not seen a fix: what all fixes have in common is none of its own yet."""
    end = ended(q_nb=rotation.from_euler(0.1, 0.2, 2.0))
    coast = coasting(end)
    place, velocity, cov = coast.at(5.0)
    arm = rotation.rotate(end.q_nb, np.array([0.6, -0.9, 1.2]))
    assert_allclose(earth.difference_n(place, ORIGIN), arm, atol=1e-6)
    assert_allclose(velocity, [3.0, 4.0, 0.0])
    assert_allclose(np.diag(cov)[:6], 1e-4 + unknown_arm(np.array([0.6, -0.9, 1.2])))
    assert_allclose(coast.offset, [9.0, 9.0, 16.0, 0.04, 0.04, 0.04])
    coast.take(fixes_at([5.5], [arm + np.array([1.5, 2.0, 0.0])], [3.0, 4.0, 0.0]))
    seen = np.diag(coast.at(5.5)[2])
    assert (seen[:3] > [9.0, 9.0, 16.0]).all()
    assert (seen[:3] < [12.0, 12.0, 22.5]).all()
    unseen = coasting(end)
    unseen.take(fixes_at([5.5], [arm], [3.0, 4.0, 0.0], np.array([5.6])))
    assert np.diag(unseen.at(5.59)[2])[0] < 3.0
    assert np.diag(unseen.at(5.6 - 0.5e-6)[2])[0] > 9.0


@pytest.mark.parametrize(
    ("changes", "speed", "lasts"),
    [
        ({}, 5.0, (True, True)),
        ({"pos_decay_time": 0.11}, 5.0, (False, True)),
        ({"vel_decay_time": 0.11}, 5.0, (True, False)),
        ({"pos_decay_distance": 0.011}, 5.0, (True, True)),
        ({"pos_decay_distance": 0.021}, 5.0, (False, True)),
        ({"pos_decay_distance": 9.0}, np.nan, (True, True)),
    ],
)
def test_an_error_of_fixes_that_decays_within_ten_seconds_is_as_good_as_white(changes, speed, lasts):
    gnss = replace(
        RECEIVER, pos_decay_time=0.01, **{k: v for k, v in changes.items() if k != "pos_decay_time"}
    )
    gnss = replace(gnss, **changes)
    found = fixes_only.lasts(gnss, speed * np.array([0.6, 0.0, 0.8]))
    assert found.tolist() == [lasts[0]] * 3 + [lasts[1]] * 3
    coast = coasting(ended(vel_n=speed * np.array([0.6, 0.0, 0.8])), gnss)
    assert_allclose(coast.offset > 0, found)


def test_a_filter_that_is_lost_keeps_its_place_in_time_alone():
    end = lost_at(7.0, ended())
    assert end.t == 7.0
    assert np.isnan(end.lla).all()
    assert np.isnan(end.vel_n).all()
    assert np.isnan(end.cov[:6]).all()
    assert_allclose(end.cov[6:, 6:], np.diag([0.25, 0.25, np.pi**2 / 3.0]))
    coast = coasting(end)
    assert np.isnan(coast.at(7.5)[0]).all()
    coast.take(fixes_at([8.0, 9.0], [[0.0] * 3, [3.0, 4.0, 0.0]], [3.0, 4.0, 0.0]))
    answers = coast.answers(np.array([7.9, 8.0, 9.0]))
    assert np.isnan(answers.lla[0]).all()
    assert_allclose(earth.difference_n(answers.lla[1:], ORIGIN), [[0.0] * 3, [3.0, 4.0, 0.0]], atol=1e-3)
    assert_allclose(
        np.diag(answers.cov[1])[:3] - unknown_arm(np.array([0.6, -0.9, 1.2]))[:3], [11.25, 11.25, 22.25]
    )
    assert answers.innovations.t.tolist() == [9.0] * 6
    assert answers.extra.shape == (3, 8)


def test_fresh_fixes_are_sound_and_newer_than_all_before():
    t = np.array([1.0, 2.0, 3.0, 2.5, np.nan, 9.0, 7.0, 8.0])
    fixes = fixes_at(t, np.zeros((8, 3)), [0.0] * 3, np.where(np.isnan(t), 4.0, t))
    fixes = put(put(fixes, 5, valid=False), 6, lla=[np.nan, 0.0, 0.0])
    fixes = put(fixes, 7, t_arrival=np.nan)
    found, newest = fresh_fixes(fixes, 1.5)
    assert found.t.tolist() == [2.0, 2.5, 3.0]
    assert newest == 3.0
    none, newest = fresh_fixes(take(fixes, slice(0, 0)), 1.5)
    assert (len(none), newest) == (0, 1.5)
    assert fresh_fixes(take(fixes, [5]), 1.5)[1] == 1.5


# --- lost -----------------------------------------------------------------------------------------------


def verdicts(t, refused, code=0):
    """A table of positions, a velocity in use beside each."""
    rows = [
        (one, c, k, 0.0, 1.0, 9.0, c == 1 or not bad)
        for one, bad in zip(t, refused, strict=True)
        for c in (1, 0)
        for k in range(3)
    ]
    return Innovations.from_rows(("gnss_position", "gnss_velocity"), rows)


def watched(refused, moves=1.0, window=10.0, cuts=(), heading_lost_at=None, **changes):
    """When a filter is lost whose positions at 1 Hz are rejected, by fixes that move as they say or not."""
    t = np.arange(1.0, len(refused) + 1.0)
    fixes = replace(fixes_at(t, np.outer(t * moves, [3.0, 4.0, 0.0]), [3.0, 4.0, 0.0]), **changes)
    watch = RefusedFixes(RECEIVER, "datasheet", window)
    for begin, end in zip([0, *cuts], [*cuts, len(t)], strict=True):
        watch.take(take(fixes, slice(begin, end)))
        lost = watch.find(verdicts(t[begin:end], refused[begin:end]), heading_lost_at)
        if lost is not None:
            assert lost[1] == (heading_lost_at is None)  # by rejections
            return lost[0]
    return None


def test_a_filter_is_lost_after_a_window_of_three_quarters_of_refusals():
    """Twice the time of its gate, and no less than 20 s; whatever was before, and however it comes."""
    good, bad = [False] * 30, [True] * 60
    assert watched(good + bad) == 45.0  # 15 of the last 20
    assert watched(bad) == 21.0
    assert watched(good + bad, window=15.0) == 53.0  # 23 of 30
    assert watched(good + bad, window=3.0) == 45.0
    assert watched(good + bad, cuts=[31, 44, 44, 70]) == 45.0
    assert watched(good + [True, False] * 30) is None
    three = good + [True, True, True, False] * 20
    assert watched(three) == 49.0
    assert watched(good + [False] * 30) is None


def test_no_filter_is_lost_by_fixes_that_do_not_move_as_they_say():
    bad = [True] * 60
    assert watched(bad, moves=4.0) is None
    assert watched(bad, vel_n=np.full((60, 3), np.nan)) is None
    t = np.arange(1.0, 61.0)
    place = np.outer(np.minimum(t, 31.0) * 4.0 + np.maximum(t - 31.0, 0.0), [3.0, 4.0, 0.0])
    lla = fixes_at(t, place, [3.0, 4.0, 0.0]).lla
    late = watched(bad, lla=lla)
    assert late == 51.0  # of 46, 51, ...: looked at again each quarter of the window


def test_a_filter_without_a_heading_is_lost_at_the_next_fixes_that_move_as_they_say():
    """Looked at each quarter of the window from that time on, though no position is rejected."""
    good = [False] * 60
    assert watched(good, heading_lost_at=30.2) == 31.0
    assert watched(good, heading_lost_at=30.0) == 30.0
    assert watched(good, heading_lost_at=30.2, cuts=[12, 30, 31, 44]) == 31.0
    assert watched(good, heading_lost_at=3.0) == 13.0  # of 3, 8, 13: ten fixes tell something
    assert watched(good, heading_lost_at=70.0) is None
    assert watched(good, moves=4.0, heading_lost_at=30.2) is None
    t = np.arange(1.0, 61.0)
    place = np.outer(np.minimum(t, 31.0) * 4.0 + np.maximum(t - 31.0, 0.0), [3.0, 4.0, 0.0])
    lla = fixes_at(t, place, [3.0, 4.0, 0.0]).lla
    assert watched(good, lla=lla, heading_lost_at=28.0) == 53.0  # of 28, 33, ...
    assert watched(good, lla=lla, heading_lost_at=28.0, cuts=[29, 40, 53]) == 53.0


@pytest.mark.parametrize("cuts", [(), (35,), (49, 50)])
def test_a_jump_delays_later_tests_alone(cuts):
    """The position jumps at 50 s: the test at 31 s does not wait, the next would for three windows."""
    t = np.arange(1.0, 101.0)
    rows = [
        (
            one,
            c,
            k,
            500.0 * (c == 0 and one == 50.0),
            1.0,
            1e6 if c == 0 and one == 50.0 else 1.0,
            one != 50.0,
        )
        for one in t
        for c in (0, 1)
        for k in range(3)
    ]
    table = Innovations.from_rows(("gnss_position", "gnss_velocity"), rows)
    fixes = fixes_at(t, np.outer(t, [3.0, 4.0, 0.0]), [3.0, 4.0, 0.0])

    def find(heading_lost_at):
        watch = RefusedFixes(RECEIVER, "datasheet", 10.0)
        for begin, end in pairwise([0, *cuts, len(t)]):
            watch.take(take(fixes, slice(begin, end)))
            part = take(table, slice(6 * begin, 6 * end))
            if (lost := watch.find(part, heading_lost_at)) is not None:
                return lost[0]
        return None

    assert find(30.2) == 31.0
    assert find(52.0) is None


def test_too_few_fixes_tell_nothing():
    """Fewer than ten in the window."""
    t = np.arange(1.0, 61.0)
    for every, lost in ((2.0, 21.0), (2.3, None)):
        slow = every * (t - 0.5)
        fixes = fixes_at(slow, np.outer(slow, [3.0, 4.0, 0.0]), [3.0, 4.0, 0.0])
        watch = RefusedFixes(RECEIVER, "datasheet", 10.0)
        watch.take(fixes)
        assert watch.find(verdicts(slow, [True] * 60)) == (lost and (lost, True))
        assert watch.any_refused == (lost is None)


def test_what_a_watch_forgets_and_what_it_has_seen_last():
    watch = RefusedFixes(RECEIVER, "datasheet", 10.0)
    t = np.arange(1.0, 11.0)
    assert watch.find(no_innovations()) is None
    assert not watch.any_refused
    watch.take(fixes_at(t, np.zeros((10, 3)), [0.0] * 3, t + 0.4))
    assert watch.find(verdicts(t, [True] * 10)) is None
    assert watch.any_refused
    assert watch.last(5.4 - 0.5e-6).t.tolist() == [5.0]
    assert watch.last(5.39).t.tolist() == [4.0]
    only_velocities = Innovations.from_rows(("gnss_velocity",), [(12.0, 0, 0, 0.0, 1.0, 1.0, False)])
    assert watch.find(only_velocities) is None
    watch.find(verdicts([40.0], [False]))
    assert not watch.any_refused
    assert not len(watch.last(99.0))
    watch.take(fixes_at(t, np.zeros((10, 3)), [0.0] * 3))
    watch.forget()
    watch.take(fixes_at([3.0], np.zeros((1, 3)), [0.0] * 3))
    watch.take(take(fixes_at([3.0], np.zeros((1, 3)), [0.0] * 3), slice(0, 0)))
    assert watch.last(99.0).t.tolist() == [3.0]


# --- starting again -----------------------------------------------------------------------------------------


def grown(t):
    """A record that has come until a time."""
    return SimpleNamespace(imu=SimpleNamespace(t=np.array([0.0, t, np.nan])))


def searching(monkeypatch, kind, found_at=12.0):
    """A search from 1 s on for an alignment of 10 s, and the newest samples at which it was looked for."""
    asked = []

    def complete(record, initial):
        asked.append(newest_sample(record))
        if asked[-1] < found_at:
            raise EstimatorError("not yet")
        return replace(initial, t=found_at), [(1.0, found_at, "alignment", "found")]

    monkeypatch.setattr(alignment, "complete", complete)
    nothing = np.full((9, 9), np.inf)
    start = InitialState(1.0, *np.full((2, 3), np.nan), np.full(4, np.nan), nothing, kind, 10.0)
    return alignment.StartSearch(start), asked


def test_a_standstill_is_looked_for_once_when_nothing_can_change_it_any_more(monkeypatch):
    search, asked = searching(monkeypatch, "level")
    for t, found in ((13.49, False), (13.5, False), (14.49, False), (14.5, True)):
        assert (search.find(grown(t), 0.5, last=False) is not None) == found
    assert asked == [13.5, 14.49, 14.5]
    search, _ = searching(monkeypatch, "level", 99.0)
    with pytest.raises(EstimatorError, match="not yet"):
        search.find(grown(14.0), 0.5, last=False)
    search, _ = searching(monkeypatch, "level", 3.0)
    assert search.find(grown(4.0), 0.5, last=True)[0].t == 3.0


def test_a_course_is_looked_for_every_two_seconds(monkeypatch):
    search, asked = searching(monkeypatch, "course")
    for t in (1.0, 2.9, 3.0, 4.9, 11.9, 12.1, 13.9, 14.49, 14.5, 16.5):
        found = search.find(grown(t), 0.5, last=False)
        assert (found is not None) == (t == 16.5)
    assert asked == [1.0, 3.0, 11.9, 13.9, 16.5]
    search, _ = searching(monkeypatch, "course", 99.0)
    with pytest.raises(EstimatorError, match="not yet"):
        search.find(grown(14.0), 0.5, last=True)


def test_an_alignment_is_one_of_four():
    start = SimpleNamespace(alignment="north")
    with pytest.raises(
        EstimatorError, match=r"^alignment = 'north' must be 'given', 'level', 'course' or 'motion'$"
    ):
        alignment.complete(None, start)


@pytest.mark.parametrize(
    ("speed", "moved", "kept"), [(0.29, 0.0, True), (0.31, 0.0, False), (0.0, 4.9, True), (0.0, 5.1, False)]
)
def test_behind_a_gap_a_standstill_is_looked_for_first_and_keeps_its_heading(speed, moved, kept):
    """Of an aircraft that stood before and has not moved by five sigma; the course knows the wind."""
    cov = np.diag([1e-4] * 3 + [1e-6] * 3 + [1e-4, 2e-4, 3e-4])
    coast = coasting(ended(vel_n=np.array([0.6 * speed, 0.8 * speed, 0.0]), cov=cov), arm=(0.0, 0.0, 0.0))
    coast.go_beyond()
    coast.take(fixes_at([6.0], [[0.0] * 3], [0.0] * 3))
    spread = np.sqrt(np.trace(coast.at(7.0)[2][:3, :3]))
    coast.end = coast.end._replace(lla=earth.displace(coast.at(7.0)[0], [moved * spread, 0.0, 0.0]))
    _, motion = (search.initial for search in restart.list_starts(7.0, coast, any_heading=True))
    assert (motion.alignment, motion.t, motion.align_for) == ("motion", 7.0, 2.0)
    level, course = (search.initial for search in restart.list_starts(7.0, coast))
    assert (level.alignment, level.t, level.align_for) == ("level", 7.0, 10.0)
    assert_allclose(level.lla, coast.at(7.0)[0])
    assert_allclose(level.cov[:3, :3], coast.at(7.0)[2][:3, :3])
    assert_allclose(level.fix_cov, [9.0, 9.0, 16.0])
    assert np.isfinite(level.q_nb).all() == kept
    assert level.cov[8, 8] == (3e-4 if kept else np.inf)
    assert np.isinf(np.diag(level.cov)[3:8]).all()
    assert (course.alignment, course.t, course.align_for) == ("course", 7.0, 10.0)
    assert np.isnan(course.q_nb).all()
    assert np.isinf(np.diag(course.cov)).all()
    assert course.drift_sd == pytest.approx(np.arctan(state_blocks.WIND_SD / 5.0))


def test_behind_a_gap_a_fast_aircraft_may_have_its_nose_off_its_course_by_the_wind():
    """Its course gives the heading within 15 deg; a slower aircraft aligns in motion instead."""
    coast = coasting(ended(vel_n=np.array([30.0, 40.0, 5.0])))
    for any_heading in (False, True):
        _, course = restart.list_starts(6.0, coast, any_heading=any_heading)
        assert course.initial.drift_sd == pytest.approx(np.arctan(state_blocks.WIND_SD / 50.0))
    lost = coasting(lost_at(5.0, ended()))  # and of a place that is not known
    (motion,) = restart.list_starts(6.0, lost, any_heading=True)
    assert motion.initial.drift_sd == rough_heading.UNKNOWN_HEADING_SD
    (course,) = restart.list_starts(6.0, lost)
    assert course.initial.drift_sd == pytest.approx(np.arctan(state_blocks.WIND_SD / 5.0))


# --- pieces of a record -------------------------------------------------------------------------------------


def test_what_a_piece_of_a_record_holds():
    """IMU samples and answers by their time, measurements by their arrival, to a microsecond."""
    data = sensed()
    t = np.array([0.5, 1.0, 1.0, 1.5, 2.0])
    fixes = fixes_at(
        t, np.zeros((5, 3)), [0.0] * 3, np.array([0.6, 1.0 + 0.5e-6, 1.0 + 1.5e-6, np.nan, 2.25])
    )
    data = replace(data, fixes=fixes, baro=None, output_t=np.array([0.5, 1.0, 1.0 + 0.5e-6, 2.0]))
    first, second = slice_sensors(data, -np.inf, 1.0), slice_sensors(data, 1.0, 2.2)
    assert first.fixes.t.tolist() == [0.5, 1.0, 1.5]  # what has no time is there from the begin on
    assert second.fixes.t.tolist() == [1.0]
    assert (first.imu.t.max(), len(first.imu)) == (1.0, 50)
    assert (second.imu.t.min(), second.imu.t.max()) == (pytest.approx(1.02), pytest.approx(2.2))
    assert first.output_t.tolist() == [0.5, 1.0]
    assert second.output_t.tolist() == [1.0 + 0.5e-6, 2.0]
    both = join_pieces(first, second)
    assert_array_equal(both.imu.t, data.imu.t[:110])
    assert both.fixes.t.tolist() == [0.5, 1.0, 1.5, 1.0]
    assert longest_wait(data) == pytest.approx(0.25 + 2e-6, abs=1e-9)
    assert longest_wait(take_head(data)) == pytest.approx(2e-6)
    assert goes_beyond(data, 2.2)
    assert not goes_beyond(data, 2.25 - 0.5e-6)
    assert goes_beyond(data, 2.25 - 1.5e-6)
    answers = replace(data, fixes=None, output_t=np.array([2.0]))
    assert goes_beyond(answers, 1.9999999)
    assert not goes_beyond(answers, 2.0)
    assert newest_sample(replace(data, imu=put(data.imu, -1, t=np.nan))) == pytest.approx(2.98)
    assert first_sample(replace(data, imu=put(data.imu, 0, t=np.nan))) == pytest.approx(0.04)
    assert (newest_sample(take_head(data)), first_sample(take_head(data))) == (-np.inf, np.inf)


def test_counts_of_the_parts_of_a_record_are_added_and_other_events_stay():
    rows = [
        (3.0, 4.0, "timeline", "imu: 2 rows left out: flagged", "imu"),
        (1.0, 2.0, "timeline", "imu: gap of 1 s", "imu"),
        (1.5, 3.5, "timeline", "imu: 5 rows left out: flagged", "imu"),
        (1.0, 9.0, "timeline", "imu: 1 rows left out: repeated", "imu"),
        (1.0, 9.0, "timeline", "gnss: 4 rows left out: flagged", "gnss"),
        (0.0, 1.0, "refused", "baro: 3 in a row rejected", "baro"),
        (7.0, 8.0, "refused", "baro: 3 in a row rejected", "baro"),
    ]
    assert sorted(join_events(rows)) == sorted(
        [
            *(row for row in rows[1:2] + rows[3:]),
            (1.5, 4.0, "timeline", "imu: 7 rows left out: flagged", "imu"),
        ]
    )


def test_a_solution_less_what_has_been_given():
    """Answers until a time, innovations and ended events until another, to a microsecond."""
    found = replace(
        nothing_known(np.array([1.0, 2.0, 3.0])),
        innovations=verdicts([1.0, 2.0, 2.0 + 1.5e-6], [False] * 3),
        events=Events.from_rows([(0.0, 2.0, "a", "told", ""), (0.0, 2.1, "a", "new", "")]),
    )
    rest = take_after(2.0, 2.0, found)
    assert rest.t.tolist() == [3.0]
    assert rest.innovations.t.tolist() == [2.0 + 1.5e-6] * 6
    assert rest.events.text == ("new",)
    assert take_after(-np.inf, -np.inf, found).t.tolist() == [1.0, 2.0, 3.0]
    assert len(take_after(-np.inf, -np.inf, found).innovations) == 18
    with pytest.raises(EstimatorError) as caught:
        refuse("a row of baro", 1.25, 2.5)
    said = (
        "a row of baro for 1.25 s comes when the filter has gone on to 2.5 s; open it with a longer look_back"
    )
    assert str(caught.value) == said
