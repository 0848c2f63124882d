"""Sixty files as their owners bring them: the answer names what the file is, or gives what was asked for.

The files of `tests/data/strangers` are real; those whose name has no ending are written by `brought`.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.io.logs import formats
from tests.exchange import brought
from tests.exchange.exported import make_run

DATA = Path(__file__).parents[1] / "data" / "strangers"
TO_GPX = "it has fixes but no IMU; convert it to GPX to fly its track"
ALONE = "No columns of a GNSS receiver: only attitude is estimated."
NO_FIXES = "no <trkpt> with a <time>: a route without times is not a motion"
OWN_LOG = "name them in a log of your own: bench guide log-format"
NO_START = "it needs fixes with velocities for a second, 10 s at rest, or 10 s above 5 m/s"

ANSWERS: list[tuple[str, str, int, tuple[str, ...]]] = [
    ("um981.nmea", "navigate", 2, ("no IMU in NMEA sentences; name the file in [gnss]",)),
    ("unicore_h.log", "navigate", 2, ("no GGA sentence with a time",)),
    ("maritime.nmea", "navigate", 2, ("no GGA sentence with a time",)),
    (
        "no_checksum.nmea",
        "navigate",
        2,
        ("no GGA sentence with a time; 4 sentences have a wrong or no checksum; let",),
    ),
    ("pixel6.nmea", "navigate", 2, ("no IMU in NMEA sentences; name the file in [gnss]",)),
    ("trimble_r2.nmea", "fly", 0, ("stands once", "Next: bench run")),
    ("pynmea2_data.log", "navigate", 2, ("no RMC sentence with a date", "let the receiver write both")),
    ("motion_def_90deg.csv", "navigate", 2, ("is a motion definition of gnss-ins-sim", "fly it: trajectory")),
    (
        "pixel10_gnsslogger.txt",
        "fixes",
        2,
        ("no navigation file; give the RINEX navigation file of the day, too",),
    ),
    ("gsdc_ground_truth.csv", "navigate", 2, ("no columns found for imu; it has MessageType", OWN_LOG)),
    ("gxtrack.kml", "fly", 2, ("7 fixes with time, position and height; at least 10 are needed",)),
    ("run.tcx", "navigate", 2, (f"is a Garmin TCX file; {TO_GPX}",)),
    (
        "dji.srt",
        "navigate",
        2,
        ("is a file of subtitles (SRT); if they contain fixes, convert these to GPX",),
    ),
    ("rover_rtk.pos", "navigate", 2, ("a solution of RTKLIB has no IMU; name it in [gnss]",)),
    ("boulder_xyzf.min", "navigate", 2, ("no line of column names; its first line is Format", "IAGA-2002")),
    ("geostationary.oem", "fly", 2, ("must end in .csv or .parquet or .gpx",)),
    ("track_with_speed.gpx", "navigate", 2, ("is a GPX or KML track; it has no IMU; fly it: trajectory",)),
    ("cerknicko_without_times.gpx", "fly", 2, (NO_FIXES,)),
    ("route.gpx", "fly", 2, (NO_FIXES,)),
    ("gpx_with_garmin_extension.gpx", "fly", 2, (NO_FIXES,)),
    ("xsens_mtw.txt", "navigate", 2, ("xsens_mtw.txt: no row has a time; record or export it too",)),
    ("apdm_opal.csv", "navigate", 2, ("no line of column names; its first line is Format=7", "Write one")),
    ("px4_quad_head.px4log", "navigate", 2, ("no filter can start between 0.00 and 1.15 s", NO_START)),
    ("px4_cut_by_power_loss.ulg", "navigate", 2, ("no filter can start between 0.00 and 0.99 s", NO_START)),
    ("ubx_nav_x20p.ubx", "navigate", 2, ("is a u-blox UBX recording; put it beside a table of an IMU",)),
    ("ubx_configuration.ubx", "fixes", 2, ("no whole ephemeris", "and no raw measurements (UBX-RXM-RAWX)")),
    (
        "almanac_yuma.txt",
        "fixes",
        2,
        ("is a YUMA almanac; it has no ranges", 'almanac = "FILE" in [sky] of a GNSS datasheet'),
    ),
    ("pyins_gnss.csv", "navigate", 2, ("no columns found for imu, only fixes: time, lat, lon, alt, VN",)),
    ("flightradar_ek97.csv", "fly", 2, ("no columns for time: t_s or time_s; there are Timestamp, UTC",)),
    ("px4_vehicle_gps_position_0.csv", "navigate", 2, ("for imu, only fixes: timestamp, lat, lon, alt_ell",)),
    (
        "ardupilot_GPS.txt",
        "navigate",
        2,
        ("no increments of an IMU", "Other tables need a line of column names: bench guide"),
    ),
    (
        "boat_positions.csv",
        "fly",
        2,
        ("no columns for time: t_s or time_s; there are ID, ais_pos_timestamp",),
    ),
    ("vio_estimate.txt", "score", 2, ("do not overlap with the run, 0 to 20 s; --t0 1413393212.256 puts",)),
    ("empty", "navigate", 2, ("log.csv: is empty",)),
    ("header_only", "navigate", 2, ("imu.csv: no rows",)),
    ("photo", "navigate", 2, ("is a picture; export the data as CSV",)),
    ("video", "navigate", 2, ("is a video; export its telemetry as CSV",)),
    ("septentrio", "fixes", 2, ("has no ephemeris (SBF GPSNav, GLONav", "bench fixes OBS NAV")),
    ("fit", "navigate", 2, (f"is a Garmin FIT file; {TO_GPX}",)),
    ("telemetry", "navigate", 2, ("RAW_IMU has 5 rows a second, too few to navigate", "use the log on the")),
    ("blackbox", "navigate", 2, ("is a Betaflight or iNav blackbox; decode it by blackbox_decode",)),
    ("matlab73", "navigate", 2, ("no columns found for gnss", "imu.gyro.1")),
    ("sbet", "score", 2, ("do not overlap with the run, 0 to 20 s; --t0 122400 puts its first row",)),
    ("kitti_oxts", "navigate", 2, ("oxts: no IMU is read from a trajectory; use it in [reference]",)),
    ("kitti_row", "navigate", 2, ("no IMU is read from a trajectory; use it in [reference] of a log",)),
    ("euroc", "navigate", 0, (ALONE, "ahrs")),
    ("airdata", "navigate", 2, ("no columns found for imu; it has time(millisecond)", OWN_LOG)),
    ("dji_flight_record", "fly", 2, ("no columns for time: t_s or time_s; there are CUSTOM.date [local]",)),
    ("torque", "navigate", 2, ("no columns found for imu; it has GPS Time, Device Time", "is not a number")),
    ("vbox", "navigate", 2, (f"is a Racelogic VBO file; {TO_GPX}",)),
    (
        "sensor_logger",
        "navigate",
        0,
        ("by Sensor Logger", "mounting_deg = [180.0, 0.0, 90.0]", "15 of 15 checks"),
    ),
    ("xsens_dot", "navigate", 2, ("rows of an IMU a second, too few to navigate",)),
    (
        "vectornav",
        "navigate",
        2,
        ("is a recording of VectorNav messages; they have no times; write a table",),
    ),
    ("dataflash_text", "navigate", 2, ("is an ArduPilot log converted to text; use the .bin it was made",)),
    ("rostopic", "navigate", 2, ("is a text of rostopic echo; use the bag it was made from",)),
    ("sbg", "navigate", 0, (ALONE, "ahrs")),
    ("gyroflow", "navigate", 2, ("is a Gyroflow log; it has gyros but no fixes; write a table of it",)),
    ("ros2_storage", "navigate", 2, ("drive_0.db3: no rows",)),
    ("workbook", "navigate", 2, ("is an Office document; save its table as CSV",)),
    ("timeline", "navigate", 2, ("is a JSON file; write a table of it: bench guide log-format",)),
]
"""File, command, exit status, and words of the answer."""

PROFILE = 'trajectory = "{}"\nrate_hz = 100\ntrack = {{ vehicle = "ground", noise_m = 1.0 }}\n'


def bring(name: str, folder: Path) -> Path:
    if "." not in name:
        make: Callable[[Path], Path] = getattr(brought, name)
        return make(folder)
    return Path(shutil.copyfile(DATA / name, folder / name))


@pytest.fixture(scope="module")
def circle(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs") / "circle"
    make_run(folder)
    return folder


@pytest.mark.parametrize(("name", "command", "status", "words"), ANSWERS, ids=[one[0] for one in ANSWERS])
def test_an_owner_is_answered(
    name: str,
    command: str,
    status: int,
    words: tuple[str, ...],
    circle: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    recwarn: pytest.WarningsRecorder,
) -> None:
    file = bring(name, tmp_path)
    if command == "fly":
        (tmp_path / "profile.toml").write_text(PROFILE.format(file.name))
    arguments = {
        "fixes": [str(file)],
        "fly": [str(tmp_path / "profile.toml")],
        "navigate": [str(file), "--outages", "none", "--no-report", "--no-rrd", "-o", str(tmp_path / "out")],
        "score": [str(file), str(circle), "--align", "yaw"],
    }[command]
    assert main([command, *arguments]) == status
    said = capsys.readouterr()
    answer = " ".join((said.out + said.err).split())
    for word in words:
        assert word in answer
    assert not recwarn.list
    if status:
        assert not said.out
        assert len(said.err.splitlines()) == 1


def test_there_are_sixty_files_and_each_real_one_is_used():
    assert len({one[0] for one in ANSWERS}) == 60
    real = {
        path.name
        for path in DATA.iterdir()
        if path.name != "README.md" and path.name[:6] not in ("LICENS", "NOTICE")
    }
    others = {"xio_at_rest.parquet"}  # tests/evaluation/test_noise_fit.py
    assert real == {name for name, *_ in ANSWERS if "." in name} | others
    assert sum(path.stat().st_size for path in DATA.iterdir()) < 700_000


def test_the_named_ways_out_work(circle, tmp_path, capsys):
    """A solution of RTKLIB and sentences of a receiver are fixes; the time for --t0 is exact enough."""
    fixes = formats.read("rtklib", bring("rover_rtk.pos", tmp_path), "gnss", None)
    assert len(fixes.t) == 8
    fixes = formats.read("nmea", bring("um981.nmea", tmp_path), "gnss", None)
    np.testing.assert_allclose(np.rad2deg(fixes.values["lla"][0, :2]), [53.4505998, -2.2402445], atol=1e-6)
    main(["score", str(bring("vio_estimate.txt", tmp_path)), str(circle), "--t0", "1413393212.256"])
    assert "do not overlap" not in capsys.readouterr().err


def test_a_second_antenna_of_unicore_is_not_the_first(tmp_path):
    """GNGGAH is of the second antenna; it replaced the position of the same epoch."""
    first = (DATA / "um981.nmea").read_text().splitlines()
    body = "GNGGAH,130058.00,4004.73874301,N,11614.19077585,E,1,28,0.6,64.2831,M,8.4925,M,,"
    check = 0
    for byte in body.encode():
        check ^= byte
    log = tmp_path / "two.nmea"
    log.write_text("\n".join([*first[:3], f"${body}*{check:02X}", *first[3:]]) + "\n")
    lla = formats.read("nmea", log, "gnss", None).values["lla"]
    assert len(lla) == 2
    np.testing.assert_allclose(np.rad2deg(lla[0, 0]), 53.4505998, atol=1e-6)
    log.write_text(f"${body}*{check:02X}\n")
    with pytest.raises(ConfigError, match=r"two\.nmea: no GGA sentence with a time"):
        formats.read("nmea", log, "gnss", None)
