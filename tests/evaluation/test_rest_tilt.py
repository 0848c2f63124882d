"""Tilt at rests, against tilts that were put in, and silence where nothing comes to rest."""

import numpy as np
import pytest

import bench
from bench.core.mathematics import rotation
from bench.core.records.data import ImuData, NavSolution
from bench.evaluation.motion.rest_tilt import find_rests_after_motion, measure_rest_tilt
from tests.evaluation.test_pose_fit import RATE, TILTED, turn_by_hand, write_table

UP_N = np.array([0.0, 0.0, -1.0])


def turn(seed, poses=TILTED, **options):
    """Return the readings of an IMU without biases that is turned from pose to pose."""
    read, errors = turn_by_hand(poses, seed, **options)
    return {name: rates - errors[name][2] for name, rates in read.items()}


def record(read):
    n = len(read["gyro"])
    times = np.arange(1, n + 1) / RATE, np.full(n, 1 / RATE), np.ones(n, bool)
    return ImuData(*times, read["gyro"] / RATE, read["accel"] / RATE)


def answer(t, q_nb):
    unknown = np.full((len(t), 3), np.nan)
    none = np.empty((len(t), 0))
    cov = np.zeros((len(t), 9, 9))
    return NavSolution(t, unknown, unknown, q_nb, unknown, unknown, cov, (), none, none)


def test_a_tilt_that_was_put_in_is_found_at_each_rest_whatever_the_heading():
    imu = record(turn(3))
    t, up_b = find_rests_after_motion(imu)
    q_nb = rotation.from_euler(*np.deg2rad(TILTED[1:]).T)
    assert rotation.rotate(rotation.conjugate(q_nb), UP_N) == pytest.approx(up_b, abs=0.01)
    rng = np.random.default_rng(5)
    for tilt in (2.0, 20.0):
        way = rng.uniform(-np.pi, np.pi, len(t))
        about = np.deg2rad(tilt) * np.column_stack([np.cos(way), np.sin(way), np.zeros(len(t))])
        turned = rotation.from_euler(np.zeros(len(t)), np.zeros(len(t)), rng.uniform(-3, 3, len(t)))
        off = rotation.multiply(rotation.from_rotvec(about), rotation.multiply(turned, q_nb))
        found = measure_rest_tilt(answer(t + 0.05, off), imu, 0.0)
        assert found["rests"] == len(TILTED) - 1
        assert found["tilt_rmse_deg"] == pytest.approx(tilt, abs=0.3)
    half = measure_rest_tilt(answer(t + 0.05, off), imu, t[5])
    assert half["rests"] == len(t) - 5
    assert measure_rest_tilt(answer(t + 2.0, off), imu, 0.0) == {}  # the rest has corrected it by then


def test_nothing_is_measured_where_nothing_comes_to_rest():
    """At rest all the time; engine vibration; free fall; turns at a bank of 5 deg: no mean is vertical."""
    still = turn(1, TILTED[:1])
    shaken = turn(2)
    shaken["accel"] += np.random.default_rng(0).normal(size=shaken["accel"].shape)
    bank, rate = np.deg2rad(5.0), 0.034
    banked = {name: rates[:12000].copy() for name, rates in turn(1, TILTED[:1] * 30).items()}
    for begin in range(2000, 12000, 1500):
        rows = slice(begin, begin + 1000)
        banked["gyro"][rows] += [0.0, rate * np.sin(bank), rate * np.cos(bank)]
        banked["accel"][rows, 2] -= 9.80665 * (1.0 / np.cos(bank) - 1.0)
        banked["gyro"][begin : begin + 100] += 0.5
    assert [len(find_rests_after_motion(record(one))[0]) for one in (still, shaken)] == [0, 0]
    falling = {name: rates[:6000].copy() for name, rates in turn(1, TILTED[:1] * 12).items()}
    falling["accel"][4000:5000] *= 1e-3
    starts = find_rests_after_motion(record(falling))[0]
    assert not np.any((starts > 39.0) & (starts < 50.0))
    starts = find_rests_after_motion(record(banked))[0]
    assert len(starts) > 0
    assert not np.any((starts * RATE - 2000) % 1500 < 950)


def test_a_log_without_a_receiver_is_evaluated_at_its_rests(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    read = turn(4)
    write_table(tmp_path / "imu.csv", read)
    (tmp_path / "log.toml").write_text(
        'title = "By hand"\nplace = [47.0, 11.0, 500.0]\n[imu]\nfile = "imu.csv"\n[evaluation]\nfrom_s = 35\n'
        '[sensors.assumed]\nimu = "mpu-6050"\n[alignment]\nkind = "level"\nduration_s = 30.0\n'
    )
    result = bench.navigate("log.toml")
    metrics = result.metrics["ahrs"]
    t, _ = find_rests_after_motion(record(read))
    q_nb = rotation.from_euler(*np.deg2rad(TILTED[1:]).T)
    solution = result.solutions["ahrs"]
    known = t > 35.0
    k = np.searchsorted(solution.t, t[known])
    error = rotation.multiply(solution.q_nb[k], rotation.conjugate(q_nb[known]))
    up = rotation.rotate(error, UP_N)
    own = np.rad2deg(np.arctan2(np.hypot(up[:, 0], up[:, 1]), -up[:, 2]))
    assert metrics["rests"] == known.sum()
    assert metrics["tilt_rmse_deg"] == pytest.approx(np.sqrt(np.mean(own**2)), abs=0.3)
    said = f"at {known.sum()} apparent rests, tilt is compared with the accelerometers"
    assert said in metrics["verdict_text"]
