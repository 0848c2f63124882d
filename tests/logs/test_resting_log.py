"""Records of an IMU at rest as strangers bring them: other columns, other files, samples that are missing."""

import numpy as np
import pytest

import bench
from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion import pose_fit
from bench.io.logs.resting_log import read_resting_log
from tests.evaluation.test_pose_fit import FACES, RATE, TILTED, list_hits, turn_by_hand, write_table

TRIADS = {"Gyroscope": "deg/s", "Accelerometer": "g"}
HEAD = ",".join(["Time (s)", *(f"{of} {axis} ({unit})" for of, unit in TRIADS.items() for axis in "XYZ")])


def write_foreign(path, read):
    columns = [np.arange(len(read["gyro"])) / RATE, np.rad2deg(read["gyro"]), read["accel"] / 9.80665]
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=HEAD, comments="")


def test_times_in_microseconds_and_values_that_are_no_force_at_rest(tmp_path, still):
    write_table(tmp_path / "own.csv", still)
    head, *rows = (tmp_path / "own.csv").read_text().splitlines()
    in_us = [f"{float(row.partition(',')[0]) * 1e6:.3f},{row.partition(',')[2]}" for row in rows]
    (tmp_path / "us.csv").write_text("\n".join([head.replace("t_s", "t_us"), *in_us]))
    assert read_resting_log(tmp_path / "us.csv").t == pytest.approx(read_resting_log(tmp_path / "own.csv").t)
    for scale, refused in ((0.0, False), (0.5, True), (1.2, True)):
        mean = still["accel"].mean(axis=0)
        write_table(tmp_path / "other.csv", {**still, "accel": still["accel"] + (scale - 1.0) * mean})
        if refused:
            with pytest.raises(ConfigError, match=r"at rest it is 9.8: name the columns by"):
                read_resting_log(tmp_path / "other.csv")
        else:
            assert not read_resting_log(tmp_path / "other.csv").posed
    uneven = np.delete(np.arange(3000), np.arange(0, 3000, 3))
    write_table(tmp_path / "uneven.csv", still, rows=uneven)
    with pytest.raises(ConfigError, match=r"steps of t_s are uneven, 0.01 to 0.02 s; record at one rate"):
        read_resting_log(tmp_path / "uneven.csv")


@pytest.fixture(scope="module")
def still():
    return turn_by_hand(FACES[:1], 3)[0]


def test_columns_of_another_program_are_found_and_give_the_same_figures(tmp_path, monkeypatch, capsys, still):
    monkeypatch.chdir(tmp_path)
    write_table(tmp_path / "own.csv", still)
    write_foreign(tmp_path / "other.csv", still)
    own = bench.measure_allan(log="own.csv")
    assert main(["allan", "--log", "other.csv"]) == 0
    assert "gyro_x_deg_s from Gyroscope X (deg/s)" in capsys.readouterr().out
    for name in ("own.csv", "other.toml"):
        assert main(["allan", "--log", name, "--rates", "deg", "--force"]) == 2
        assert "--rates is for a log with other column names; leave it out" in capsys.readouterr().err
    other = bench.measure_allan(log="other.toml")
    for one, two in zip(own.curves, other.curves, strict=True):
        assert two.measured == pytest.approx(one.measured, rel=1e-6)
    assert other.record.startswith("other.toml, 30 s at 100 Hz")


def test_of_a_record_with_missing_samples_the_longest_piece_counts(tmp_path, still):
    """By hand: rows 1001 to 1003 and 2800 are missing, so 1796 rows without a gap are left."""
    rows = np.delete(np.arange(3000), [1000, 1001, 1002, 2799])
    write_table(tmp_path / "desk.csv", {name: rates[:3000] for name, rates in still.items()}, rows=rows)
    desk = read_resting_log(tmp_path / "desk.csv")
    assert desk.rests == (slice(1000, 2796),)
    assert not desk.posed
    measured = bench.measure_allan(log=tmp_path / "desk.csv")
    assert measured.record == "desk.csv, 18 s at 100 Hz (rows 1001 to 2796)"
    write_table(tmp_path / "torn.csv", still, rows=np.delete(np.arange(3000), np.arange(50, 3000, 100)))
    with pytest.raises(
        ConfigError, match=r"before 30 rows, the first is row 51; the longest piece has 99 rows, 297"
    ):
        read_resting_log(tmp_path / "torn.csv")


def test_a_turn_with_missing_samples_is_left_out():
    """A turn without 0.3 s of its samples seems to be shorter; the intervals hold without it."""
    hits = []
    for seed in range(10):
        read, errors = turn_by_hand(TILTED, seed)
        rests = pose_fit.find_rests(read, 1 / RATE)
        at = (rests[4].stop + rests[5].start) // 2
        torn = {name: np.delete(rates, slice(at, at + 30), axis=0) for name, rates in read.items()}
        moved = [one if one.stop < at else slice(one.start - 30, one.stop - 30) for one in rests]
        gyro, _ = pose_fit.fit_poses(torn, moved, 1 / RATE, None, np.array([at]))
        assert gyro.count == len(TILTED) - 2
        hits.append(list_hits(gyro, errors["gyro"]).mean())
        left_in = pose_fit.fit_poses(torn, moved, 1 / RATE)[0]
        assert left_in.triad == "accel" or left_in.scale_half.max() > 5 * gyro.scale_half.max()
    assert np.mean(hits) > 0.8


def test_poses_with_gaps_are_read_in_pieces(tmp_path):
    read, _ = turn_by_hand(TILTED, 2)
    rests = pose_fit.find_rests(read, 1 / RATE)
    middle = (rests[3].start + rests[3].stop) // 2
    rows = np.delete(np.arange(len(read["gyro"])), [middle, middle + 1])
    write_table(tmp_path / "poses.csv", read, rows=rows)
    desk = read_resting_log(tmp_path / "poses.csv")
    assert desk.posed
    assert desk.gaps.tolist() == [middle]
    assert len(desk.rests) == len(TILTED) + 1
    torn = np.delete(np.arange(len(read["gyro"])), np.arange(40, len(read["gyro"]), 80))
    write_table(tmp_path / "torn.csv", read, rows=torn)
    with pytest.raises(ConfigError, match=r"samples are missing before 1\d\d rows, the first is row 41"):
        read_resting_log(tmp_path / "torn.csv")
    assert all(not ((desk.gaps > one.start) & (desk.gaps < one.stop)).any() for one in desk.rests)
