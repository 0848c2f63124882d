"""Mistakes and their pairs in recordings of random motions are named; sound recordings have no line.

A small draw for each; ``python -m tests.evaluation.diagnosis`` makes the whole table.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.evaluation.motion.fix_reach import find_reachable
from tests.evaluation import diagnosis, random_motions
from tests.evaluation.diagnosis import MISTAKES
from tests.evaluation.random_motions import MOTIONS

SEED = 20261129
_DRAWN = np.random.default_rng(SEED)
PAIRS = _DRAWN.permutation(sorted(MISTAKES)).reshape(6, 2).tolist()
VEHICLES = _DRAWN.choice(sorted(MOTIONS), 18)


@pytest.mark.parametrize("vehicle", MOTIONS)
def test_sound_recordings_have_no_line(vehicle):
    for k in range(4):
        checks = random_motions.draw(vehicle, SEED + k).check()
        assert [one.text for one in checks.values() if not one.good] == []


def _hover(r, t):
    """Less than a meter a second, turning slowly: the lift hides any turn between the triads."""
    waves = random_motions._waves
    vel = 0.4 * np.column_stack(
        [waves(r, t, 4, 40.0, 6.0), waves(r, t, 4, 40.0, 6.0), waves(r, t, 3, 40.0, 8.0)]
    )
    vel[:, 2] *= 0.3
    force = np.gradient(vel, t, axis=0) - [0.0, 0.0, 9.81]
    yaw = r.uniform(0, 6) + 0.03 * t + 0.05 * waves(r, t, 3, 30.0, 4.0)
    c, s = np.cos(yaw), np.sin(yaw)
    ahead, right = c * force[:, 0] + s * force[:, 1], c * force[:, 1] - s * force[:, 0]
    pitch, roll = np.arctan2(-ahead, -force[:, 2]), np.arctan2(right, np.hypot(ahead, force[:, 2]))
    return vel, np.column_stack([roll, pitch, yaw])


@pytest.mark.parametrize("seed", [14, 97976])
def test_a_sound_hover_has_no_line(monkeypatch, seed):
    """The first fit ends at a turn between the triads that is hardly more likely, or at a worse one."""
    monkeypatch.setitem(random_motions.MOTIONS, "hover", _hover)
    checks = random_motions.draw("hover", seed).check()
    assert [one.text for one in checks.values() if not one.good] == []


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_named(name):
    """Each in two motions of a vehicle that is drawn with it."""
    vehicle = VEHICLES[list(MISTAKES).index(name)]
    said = [diagnosis.judge(vehicle, SEED + 50 + k, (name,)) for k in range(2)]
    assert all(one in (("named", []), ("not shown", [])) for one in said), said


@pytest.mark.parametrize("names", PAIRS)
def test_two_mistakes_are_named(names):
    vehicle = VEHICLES[12 + PAIRS.index(names)]
    said = diagnosis.judge(vehicle, SEED + 60, names)
    assert said in (("named", []), ("not shown", [])), (vehicle, said)


@pytest.mark.parametrize(
    ("seed", "names"),
    [(3108000, ("clock", "far clock")), (4721000, ("far clock",)), (5581000, ("far clock",))],
)
def test_half_a_step_of_a_walk_is_not_named_for_a_reversed_velocity(seed, names):
    """A gait that is half a period late fits a vertical velocity that is reversed, but worse."""
    assert diagnosis.judge("walk", seed, names) == ("named", [])


def test_a_missed_mistake_would_be_seen():
    """The judge of these tests calls a recording with a mistake sound only if the advice mends it."""
    sound = random_motions.draw("car", SEED)
    spoiled = MISTAKES["handedness"](sound, np.random.default_rng(1))
    assert diagnosis._differ(sound, spoiled, True, "", 0.0)
    assert not diagnosis._differ(sound, diagnosis.follow(spoiled, spoiled.check()), True, "", 0.0)


@pytest.mark.parametrize("vehicle", MOTIONS)
def test_a_glitch_is_no_fix_and_sound_fixes_are(vehicle):
    """Two fixes in a row 30 m/s and 40 m off, at each place of a segment of 20 s."""
    one = next(
        one
        for k in range(80, 99)
        if np.diff((one := random_motions.draw(vehicle, SEED + k)).fixes.t)[0] > 0.5
    )
    assert find_reachable(one.imu, one.fixes).all()
    for begin in range(30, 52):
        vel, lla = one.fixes.vel_n.copy(), one.fixes.lla.copy()
        vel[begin : begin + 2] += [24.0, -18.0, 0.0]
        lla[begin : begin + 2, 0] += 40.0 / 6.37e6
        found = find_reachable(one.imu, replace(one.fixes, vel_n=vel, lla=lla))
        assert not found[begin : begin + 2].any(), begin
        assert found.sum() >= len(found) - 4, begin


def test_repeated_blocks_of_fixes_are_not_compared_out_of_order():
    one = random_motions.draw("car", SEED)
    again = np.concatenate([np.arange(60), np.arange(30, 60), np.arange(60, len(one.fixes.t))])
    assert find_reachable(one.imu, one.fixes.take(again)).all()


def test_a_wrong_lever_arm_of_a_multirotor_is_named():
    """It need not fly forward for that; its axes are as given."""
    for k in range(3):
        one = random_motions.draw("multirotor", SEED + k)
        checks = replace(one, antenna_b=one.antenna_b + np.array([3.0, 0.0, 0.0])).check()
        assert not checks["arm_off_m"].good or "?" in checks["arm_off_m"].text.partition(",")[0]
