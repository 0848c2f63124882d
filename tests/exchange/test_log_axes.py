"""Axes, signs and clocks of a log: with the right keys, turned files give the records of the sound ones."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from tests.exchange import drives

LENGTH = 20.0
"""Time of the drive that is written [s]."""
MAG = '[mag]\nfile = "mag.csv"\n'
DAY = "date = 2016-12-31\n"


@functools.cache
def make_drive():
    """Return the start of the drive, the IMU and the fixes."""
    made = drives.sensed()
    return tuple(
        {name: rows[made[kind]["t"] <= LENGTH] for name, rows in made[kind].items()}
        for kind in ("imu", "gnss")
    )


def write(folder, imu_keys="", gnss_keys="", mag_keys="", matrix=None, sign=1.0, late=0.0, day=DAY):
    """Write the drive with its axes turned by a matrix, forces by a sign and fixes later by seconds."""
    turn = np.eye(3) if matrix is None else np.asarray(matrix, float)
    text = drives.LOG.replace('file = "imu.csv"', 'file = "imu.csv"\n' + imu_keys)
    text = text.replace('file = "gnss.csv"', 'file = "gnss.csv"\n' + gnss_keys)
    text = text.replace("[sensors.assumed]", MAG + mag_keys + '[sensors.assumed]\nmag = "rm3100"')
    path = folder / "drive.toml"
    path.write_text(day + text)
    for name, sheet in (("imu", drives.IMU_SHEET), ("gnss", drives.GNSS_SHEET)):
        (folder / f"{name}.toml").write_text(sheet)
    imu, gnss = make_drive()
    turned = {"t": imu["t"], "gyro": imu["gyro"] @ turn.T, "accel": sign * imu["accel"] @ turn.T}
    drives.write_csv(folder / "imu.csv", drives.imu_columns(turned))
    drives.write_csv(folder / "gnss.csv", drives.gnss_columns({**gnss, "t": gnss["t"] - late}))
    field = np.tile([20.0, 3.0, 43.0], (20, 1)) @ turn.T
    columns = {"t_s": np.arange(20.0), **{f"field_{a}_ut": field[:, k] for k, a in enumerate("xyz")}}
    drives.write_csv(folder / "mag.csv", columns)
    return path


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return read_records(load_log(str(write(tmp_path_factory.mktemp("sound")))))


TURNED = {  # keys -> matrix from the axes of the sound file to those of the turned file
    'axes = "y, -x, z"\n': [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
    'axes = "-y, x, z"\n': [[0, 1, 0], [-1, 0, 0], [0, 0, 1]],
    'axes = "z, x, y"\n': [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    'axes = "x, -y, -z"\n': np.diag([1, -1, -1]),
    'axes = "x, -y, z"\nleft_handed = true\n': np.diag([1, -1, 1]),
    'axes = "y, x, z"\nleft_handed = true\n': [[0, 1, 0], [1, 0, 0], [0, 0, 1]],
}


@pytest.mark.parametrize("keys", TURNED)
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_turned_files_with_their_keys_give_the_records_of_the_sound_ones(tmp_path, sound, keys, sign):
    signs = 'sign = "gravity"\n' if sign < 0 else 'sign = "specific-force"\n'
    found = read_records(load_log(str(write(tmp_path, keys + signs, "", keys, TURNED[keys], sign))))
    assert_array_equal(found.imu.dtheta_b, sound.imu.dtheta_b)
    assert_array_equal(found.imu.dvel_b, sound.imu.dvel_b)
    assert_array_equal(found.instruments["mag"].field_b, sound.instruments["mag"].field_b)


def test_axes_come_before_the_mounting(tmp_path, sound):
    """The mounting turns what ``axes`` gives: forward, left, up by both of them."""
    keys = 'axes = "y, -x, z"\nmounting_deg = [180.0, 0.0, 0.0]\n'
    matrix = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ np.diag([1, -1, -1])
    found = read_records(load_log(str(write(tmp_path, keys, matrix=matrix))))
    assert_allclose(found.imu.dvel_b, sound.imu.dvel_b, rtol=0, atol=1e-14)


@pytest.mark.parametrize(("day", "leap"), [("2016-12-31", 17.0), ("2017-01-01", 18.0), ("2012-06-30", 15.0)])
def test_fixes_in_utc_get_the_leap_seconds_of_their_day(tmp_path, sound, day, leap):
    path = write(tmp_path, gnss_keys='clock = "utc"\n', late=leap, day=f"date = {day}\n")
    found = read_records(load_log(str(path)))
    assert_allclose(found.fixes.t, sound.fixes.t, rtol=0, atol=1e-9)
    assert_array_equal(found.fixes.lla, sound.fixes.lla)


def test_an_imu_in_utc_meets_fixes_in_gps_time(tmp_path, sound):
    made = read_records(load_log(str(write(tmp_path, imu_keys='clock = "utc"\n', late=-17.0))))
    assert_allclose(made.fixes.t, sound.fixes.t, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"imu_keys": 'axes = "x, -y, z"\n'}, "[imu] axes = 'x, -y, z' are left-handed; reverse or exchange"),
        ({"imu_keys": "left_handed = true\n"}, "[imu] axes = 'x, y, z' are right-handed; reverse or"),
        ({"mag_keys": 'axes = "y, x, z"\n'}, "[mag] axes = 'y, x, z' are left-handed"),
        ({"imu_keys": 'axes = "x, x, z"\n'}, "must be three axes of the file with signs"),
        ({"imu_keys": 'axes = "x, y"\n'}, "must be three axes of the file with signs"),
        ({"imu_keys": 'sign = "up"\n'}, "sign"),
        ({"gnss_keys": 'axes = "x, y, z"\n'}, "axes"),
    ],
)
def test_wrong_axes_are_a_line_that_names_them(tmp_path, keys, says):
    with pytest.raises(ConfigError) as caught:
        load_log(str(write(tmp_path, **keys)))
    assert says in str(caught.value)


def test_utc_needs_a_date(tmp_path):
    path = write(tmp_path, gnss_keys='clock = "utc"\n', day="")
    with pytest.raises(ConfigError) as caught:
        load_log(str(path))
    assert "[gnss] clock = 'utc' needs a date above all tables" in str(caught.value)
