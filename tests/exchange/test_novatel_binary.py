"""Binary logs of NovAtel: files that novatel-edie made of ASCII logs are read as these are."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.io.log_formats import guess_format
from bench.io.logs import formats
from tests.damage import spoil
from tests.data import gnss_file


def read(path, kind, topic):
    return formats.read("novatel", path, kind, topic)


@pytest.mark.parametrize(
    ("name", "kind", "topic"),
    [
        *(("novatel-rawimus", *one) for one in (("imu", "HG4930"), ("gnss", None), ("gnss", "INSPVAX"))),
        ("novatel-rawimusx", "imu", None),
        *(("novatel-rawimusx", "gnss", topic) for topic in (None, "INSPVAS", "INSPVAX")),
    ],
)
def test_a_binary_log_is_read_as_the_ascii_log_it_was_made_of(name, kind, topic):
    """Standard deviations and undulations are floats of 32 bit in the binary log."""
    binary, text = (read(gnss_file(f"{name}.{ending}"), kind, topic) for ending in ("gps", "asc"))
    assert len(binary.t) == len(text.t) > 0
    assert_allclose(binary.t, text.t, atol=1e-7, rtol=0)
    assert binary.values.keys() == text.values.keys()
    for column, values in text.values.items():
        if column == "lla":
            assert_allclose(binary.values[column][:, :2], values[:, :2], atol=1e-15, rtol=0)
        assert_allclose(binary.values[column], values, atol=2e-6 if column == "lla" else 1e-7, rtol=0)


def frame(number, body, week=2209, milliseconds=400_000_000, short=False, kind=0):
    if short:
        head = struct.pack("<3sBHHi", b"\xaa\x44\x13", len(body), number, week, milliseconds)
    else:
        more = (b"\xaa\x44\x12", 28, number, kind, 32, len(body), 0, 0, 180, week, milliseconds, 0, 0, 0)
        head = struct.pack("<3sBHBBHHBBHiIHH", *more)
    return head + body + struct.pack("<I", zlib.crc32(head + body, 0xFFFFFFFF) ^ 0xFFFFFFFF)


def position(status, height):
    place = (status, 16, 51.0, -114.0, height, -17.0, 61, 1.0, 2.0, 3.0, b"TSTR", 0.0, 0.0)
    return struct.pack("<2I3dfI3f4s2f8B", *place, 14, 12, 12, 12, 0, 6, 0, 3)


def test_a_position_without_a_solution_is_no_fix_and_one_without_a_week_is_left_out(tmp_path):
    path = tmp_path / "a.bin"
    frames = [frame(42, position(0, 1000.0)), frame(42, position(1, 1000.0), milliseconds=400_001_000)]
    path.write_bytes(b"[COM1]" + b"".join(frames) + frame(42, position(0, 1000.0), week=0))
    assert guess_format(path) == "novatel"  # not DataFlash, which has this ending
    found = read(path, "gnss", None)
    assert_allclose(found.t, 2209 * 604_800.0 + np.array([400_000.0, 400_001.0]))
    assert_allclose(found.values["lla"][0, 2], 983.0)
    assert_allclose(found.values["sd_pos"][0], [1.0, 2.0, 3.0])
    assert found.values["satellites"][0] == 12
    assert np.isnan(found.values["lla"][1]).all()


def test_fixes_of_the_second_antenna_are_passed_over(tmp_path):
    path = tmp_path / "a.gps"
    path.write_bytes(frame(42, position(0, 1000.0)) + frame(42, position(0, 900.0), kind=1))
    found = read(path, "gnss", None)
    assert_allclose(found.values["lla"][:, 2], [983.0])
    assert not found.notes


@pytest.mark.parametrize(("number", "topic"), [(507, "INSPVA"), (508, "INSPVAS"), (1465, "INSPVAX")])
def test_a_solution_counts_if_its_status_is_good_free_or_aligned(tmp_path, number, topic):
    """Of the states 0 inactive to 7 alignment complete; velocities along north, east, up."""
    path, frames = tmp_path / "a.gps", b""
    for status in range(8):
        motion = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
        if number == 1465:
            body = struct.pack(
                "<2I3df6d9fIH", status, 56, 51.0, -114.0, 1000.0, -17.0, *motion, *[1.0] * 9, 0, 0
            )
        else:
            body = struct.pack("<I10dI", 2209, 4e5 + status, 51.0, -114.0, 983.0, *motion, status)
        frames += frame(number, body, milliseconds=400_000_000 + 1000 * status, short=number == 508)
    path.write_bytes(frames)
    found = read(path, "gnss", topic)
    assert np.flatnonzero(np.isfinite(found.values["lla"][:, 0])).tolist() == [3, 6, 7]
    assert_allclose(found.values["lla"][3, 2], 983.0)
    assert_allclose(found.values["vel_n"][3], [1.0, 2.0, -3.0])


@pytest.mark.parametrize("numbers", [(42, 99), (1429, 1430)])
def test_velocities_are_those_of_the_log_beside_the_positions(tmp_path, numbers):
    path = tmp_path / "a.gps"
    speed = struct.pack("<2I2f3df", 0, 8, 0.0, 0.0, 2.0, 90.0, 0.5, 0.0)
    path.write_bytes(frame(numbers[0], position(0, 1000.0)) + frame(numbers[1], speed))
    found = read(path, "gnss", None)
    assert_allclose(found.values["vel_n"], [[0.0, 2.0, -0.5]], atol=1e-12)


@pytest.mark.parametrize("number", [268, 325, 1461, 1462])
def test_counts_of_an_imu_are_along_z_minus_y_x(tmp_path, number):
    path, frames = tmp_path / "a.gps", b""
    for k in range(3):
        head = (2209, 4e5 + 0.01 * k, 0) if number < 1000 else (0, 58, 2209, 4e5 + 0.01 * k, 0)
        body = struct.pack("<IdI6i" if number < 1000 else "<2BHdI6i", *head, 30, -20, 10, 6, -5, 4)
        frames += frame(number, body, short=number in (325, 1462))
    path.write_bytes(frames)
    found = read(path, "imu", "HG4930")
    assert_allclose(found.t, 2209 * 604_800.0 + 4e5 + 0.01 * np.arange(3))
    assert_allclose(found.values["dvel"][0] * 2.0**29, [20.0, 10.0, -30.0])
    assert_allclose(found.values["dtheta"][0] * 2.0**33, [5.0, 4.0, -6.0])


def test_damaged_and_short_frames_are_counted(tmp_path):
    path = tmp_path / "a.gps"
    good, bad = frame(42, position(0, 1000.0)), bytearray(frame(42, position(0, 1000.0)))
    bad[60] ^= 1
    path.write_bytes(good + bad + good + frame(42, b"\0" * 10) + good[:-9])
    found = read(path, "gnss", None)
    assert len(found.t) == 2
    assert found.notes == ("a.gps: 3 logs are damaged and left out",)


@pytest.mark.parametrize("name", ["novatel-rawimus", "novatel-rawimusx"])
def test_a_file_that_ends_early_or_has_wrong_bits_gives_rows_or_one_line(name, tmp_path):
    path = tmp_path / "a.gps"
    for piece in spoil(gnss_file(f"{name}.gps").read_bytes(), 5):
        path.write_bytes(piece)
        for kind, topic in (("imu", "HG4930"), ("gnss", None), ("gnss", "INSPVAX")):
            said = "a.gps: read"
            try:
                read(path, kind, topic)
            except ConfigError as error:
                said = str(error)
            assert said.startswith("a.gps: ")
            assert "\n" not in said


def test_unicore_and_ranges_of_novatel_are_named(tmp_path, capsys):
    path = tmp_path / "rover.log"
    path.write_bytes(b"\xaa\x44\xb5" + bytes(200))
    assert main(["fixes", str(path)]) == 2
    assert "rover.log: is a Unicore binary recording; convert it to RINEX" in capsys.readouterr().err
    path.write_bytes(frame(42, position(0, 1000.0)))
    assert main(["fixes", str(path)]) == 2
    assert "rover.log: is a NovAtel binary log; bench new log FILE" in capsys.readouterr().err
