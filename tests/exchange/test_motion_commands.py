"""Motion definitions of gnss-ins-sim: against closed forms, and a plain integration of its rules."""

from __future__ import annotations

import numpy as np
import pymap3d
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.core.mathematics.earth import matrix_en, to_geodetic
from bench.core.records.flight_specs import TableSpec, TrackSpec
from bench.core.words.exceptions import ConfigError
from bench.io.results import join_pieces
from bench.io.trajectories.motion_commands import fly_commands
from bench.io.trajectories.trajectory import read_trajectory
from tests.fuzz import judge

HEAD = "ini lat (deg),ini lon (deg),ini alt (m),ini vx_body (m/s),ini vy_body (m/s),ini vz_body (m/s),"
HEAD += "ini yaw (deg),ini pitch (deg),ini roll (deg)"
NAMES = "command type,yaw (deg),pitch (deg),roll (deg),vx_body (m/s),vy_body (m/s),vz_body (m/s),"
NAMES += "command duration (s),GPS visibility"


def write(folder, start, *commands):
    path = folder / "motion_def.csv"
    path.write_text("\n".join([HEAD, start, NAMES, *commands]) + "\n")
    return path


def angles_of(motion):
    """Yaw, pitch, roll [rad] and velocity in b of each row."""
    lat, lon, _ = to_geodetic(motion.pos_e).T
    q_ne = rotation.conjugate(rotation.from_matrix(matrix_en(lat, lon)))
    q_nb = rotation.multiply(q_ne, motion.q_eb)
    roll, pitch, yaw = rotation.to_euler(q_nb)
    vel_b = rotation.rotate(rotation.conjugate(motion.q_eb), motion.vel_e)
    return np.column_stack([np.unwrap(yaw), pitch, roll]), vel_b


def test_a_rate_is_filtered_and_the_path_is_its_integral(tmp_path):
    """The turn to the left of 90 deg of its demo; the filter keeps 0.9 from step to step."""
    path = write(
        tmp_path, "32,120,0,10,0,0,90,0,0", "1,0,0,0,0,0,0,1,0", "1,-15,0,0,0,0,0,6,0", "1,0,0,0,0,0,0,3,0"
    )
    motion = fly_commands(path)
    assert_allclose(motion.t[[0, -1]], [0.0, 10.0])
    n, m = np.arange(1, 601), np.arange(1, 301)
    turned = -15.0 * 0.01 * (n - 9.0 * (1.0 - 0.9**n))  # the sum of 1 - 0.9^k
    after = turned[-1] - 15.0 * (1.0 - 0.9**600) * 0.01 * 9.0 * (1.0 - 0.9**m)
    yaw = np.concatenate([np.full(101, 90.0), 90.0 + turned, 90.0 + after])
    assert_allclose(np.rad2deg(angles_of(motion)[0][:, 0]), yaw, atol=1e-7)
    assert_allclose(yaw[-1], 0.0, atol=1e-6)
    rate = 10.0 * np.column_stack([np.sin(np.deg2rad(yaw)), np.cos(np.deg2rad(yaw))])
    level = np.cumsum(0.5 * (rate[1:] + rate[:-1]), axis=0)[-1] * 0.01
    east, north, up = pymap3d.ecef2enu(*motion.pos_e[-1], 32.0, 120.0, 0.0)
    assert_allclose([east, north], level, atol=2e-3)  # north turns by 5e-6 rad, the height is 0.0002 m
    assert_allclose(up, 0.0, atol=1e-3)


def follow(att, vel, turn, change, wanted_att, wanted_vel, seconds):
    """The rules for one angle and one velocity, step by step: what they become, and how long it takes."""
    soft, k = vel, 0
    while k < round(100 * seconds):
        soft += 0.1 * (wanted_vel - soft)
        change = min(max((soft - vel) / 0.01, -1.0), 1.0)
        turn += 0.01 * min(max(5.0 * (wanted_att - att) - 10.0 * turn, -0.5), 0.5)
        turn = min(max(turn, -2.0), 2.0)
        done = np.hypot(wanted_att - att, 0.0) < 1e-4 and abs(wanted_vel - vel) < 1e-4
        vel, att, k = vel + 0.01 * change, att + 0.01 * turn, k + 1
        if done:
            return att, vel, 0.0, 0.0, k
    return att, vel, turn, change, k


@pytest.mark.parametrize(
    ("kind", "att", "vel"), [(2, 40.0, 12.0), (3, 50.0, 22.0), (4, 40.0, 22.0), (5, 50.0, 12.0)]
)
@pytest.mark.parametrize("seconds", [60, 3])
def test_attitude_and_velocity_become_what_is_commanded(tmp_path, kind, att, vel, seconds):
    """Absolute or as changes; until both are reached, or the time is over."""
    start = "-40,-70,500,10,0,0,10,0,0"
    path = write(tmp_path, start, f"{kind},40,0,0,12,,,{seconds},1", "2,0,0,0,0,,,2,0")
    motion = fly_commands(path)
    own, vel_b = angles_of(motion)
    *state, k = follow(np.deg2rad(10.0), 10.0, 0.0, 0.0, np.deg2rad(att), vel, seconds)
    *_, more = follow(*state, 0.0, 0.0, 2.0)
    assert len(motion.t) == k + more + 1
    assert (k < 6000) if seconds == 60 else (k == 300)
    assert_allclose(own[k, 0], state[0], atol=1e-9)
    assert_allclose(vel_b[k], [state[1], 0.0, 0.0], atol=1e-8)
    last = follow(*state, 0.0, 0.0, 2.0)
    assert_allclose([own[-1, 0], vel_b[-1, 0]], last[:2], atol=1e-8)
    assert "GPS visibility is not used" in str(motion.notes)


def test_the_truth_of_commands_keeps_them(tmp_path):
    """Climb, turn and bank in space; velocities are the change of the positions."""
    path = write(tmp_path, "32,120,0,10,0,0,90,0,0", "2,0,10,0,15,0,0,20,0", "5,90,-10,20,10,1,-2,60,0")
    truth = join_pieces(read_trajectory(TableSpec("path", path, 100.0, None)))
    own, vel_b = angles_of(fly_commands(path))
    n = min(len(truth), len(own))
    roll, pitch, yaw = rotation.to_euler(truth.q_nb[:n])
    assert_allclose(np.column_stack([np.unwrap(yaw), pitch, roll]), own[:n], atol=2e-4)
    assert_allclose(
        rotation.rotate(rotation.conjugate(truth.q_nb[:n]), truth.vel_n[:n]), vel_b[:n], atol=0.02
    )
    assert not [text for _, _, text in truth.events.select("sanity")]
    with pytest.raises(ConfigError, match=r"\[track\] is not used, because the commands contain an attitude"):
        list(read_trajectory(TableSpec("path", path, 100.0, None, track=TrackSpec())))


@pytest.mark.parametrize(
    ("commands", "words"),
    [
        (("6,0,0,0,0,0,0,1,0",), "line 4: expected a command type from 1 to 5 and a duration"),
        (("1,0,0,0,0,0,0,-1,0",), "line 4: expected a command type from 1 to 5 and a duration"),
        (("1,0,0,0,0",), "line 4: 5 values; expected 8"),
        (("1,0,0,x,0,0,0,1,0",), "line 4: not a row of numbers"),
        (("1,0,0,nan,0,0,0,1,0",), "line 4: value 4 is nan; expected at most 100000"),
        (("1,0,0,0,0,0,0,7000,0", "1,0,0,0,0,0,0,300,0"), "last 7300 s, more than 7200 s"),
        ((), "3 lines; expected names, the initial state, names, and commands"),
    ],
)
def test_a_wrong_definition_is_one_line(tmp_path, commands, words):
    with pytest.raises(ConfigError, match=rf"motion_def\.csv: .*{words}"):
        fly_commands(write(tmp_path, "32,120,0,10,0,0,90,0,0", *commands))


def test_damaged_definitions_are_flown_or_rejected(tmp_path):
    whole = write(tmp_path, "32,120,0,10,0,0,90,0,0", "1,-15,0,0,0,0,0,2,0", "3,9,0,0,2,0,0,2,0").read_bytes()
    random, path = np.random.default_rng(5), tmp_path / "a.csv"
    for k in range(70):
        damaged = bytearray(whole[: random.integers(len(whole))] if k < 20 else whole)
        if k >= 20:
            damaged[random.integers(len(damaged))] = random.integers(256)
        path.write_bytes(damaged)
        outcome, raised = judge(lambda one: list(read_trajectory(TableSpec("a", one, 100.0, None))), path)
        assert outcome != "failed", raised
