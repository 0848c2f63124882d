"""Files of Android's GnssLogger, written from known values with the header of its documentation."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.log_formats import guess_format
from bench.io.logs import formats
from bench.io.logs.log_records import read_records
from tests.damage import spoil
from tests.workbench.test_exporters import EPOCH, drive

FLU = np.array([1.0, -1.0, -1.0])
HEAD = """#
# Header Description:
#
# Version: v3.0.6.4 Platform: 14 Manufacturer: Google Model: Pixel 7
#
# Raw,utcTimeMillis,TimeNanos,LeapSecond
#
# UncalAccel,utcTimeMillis,elapsedRealtimeNanos,UncalAccelXMps2,UncalAccelYMps2,UncalAccelZMps2,BiasXMps2,BiasYMps2,BiasZMps2
#
# UncalGyro,utcTimeMillis,elapsedRealtimeNanos,UncalGyroXRadPerSec,UncalGyroYRadPerSec,UncalGyroZRadPerSec,DriftXRadPerSec,DriftYRadPerSec,DriftZRadPerSec
#
# Fix,Provider,LatitudeDegrees,LongitudeDegrees,AltitudeMeters,SpeedMps,AccuracyMeters,BearingDegrees,UnixTimeMillis,SpeedAccuracyMps,BearingAccuracyDegrees,elapsedRealtimeNanos,VerticalAccuracyMeters,MockLocation,
#
"""  # noqa: E501
OLD = HEAD.replace("elapsedRealtimeNanos,VerticalAccuracyMeters,MockLocation,", "")
BOOT = 16_118.0
"""Time of t = 0 since the start of the phone [s]."""


def write(path, old=False):
    """Write the drive; ``old``: fixes without times since the start of the phone."""
    imu, gnss = drive()
    lines = []
    for t, gyro, accel in zip(imu["t"], imu["gyro"] * FLU, imu["accel"] * FLU, strict=True):
        clock = f"{1000 * (EPOCH + t):.0f},{1e9 * (BOOT + t):.0f}"
        for name, values in (("UncalAccel", accel), ("UncalGyro", gyro)):
            lines.append((t, f"{name},{clock},{','.join(f'{v:.9g}' for v in values)},0.1,0.2,0.3"))
    for t, lla, vel in zip(gnss["t"], gnss["lla"], gnss["vel_n"], strict=True):
        speed, course = np.hypot(*vel[:2]), np.rad2deg(np.arctan2(vel[1], vel[0])) % 360.0
        place = f"{np.rad2deg(lla[0]):.10f},{np.rad2deg(lla[1]):.10f}"
        rest = "" if old else f",{1e9 * (BOOT + t):.0f},4.0,0"
        tail = f",{1000 * (EPOCH + t):.0f},0.3,2.0{rest}"
        lines.append((t, f"Fix,GPS,{place},{lla[2]:.4f},{speed:.9g},3.0,{course:.9g}{tail}"))
        lines.append((t, f"Fix,NLP,47.0,11.0,0.0,,20.0,{tail}"))
        lines.append((t, "Raw,1699400576748,16118834125931,18"))
    lines.sort(key=lambda line: line[0])
    path.write_text((OLD if old else HEAD) + "\n".join(line for _, line in lines) + "\n")
    return imu, gnss


@pytest.mark.parametrize("old", [False, True])
def test_imu_and_fixes_come_back(tmp_path, old, capsys):
    path = tmp_path / "gnss_log.txt"
    imu, gnss = write(path, old)
    assert guess_format(path) == "gnsslogger"
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    text = path.with_suffix(".toml").read_text()
    assert 'format = "gnsslogger"' in text
    assert "mounting_deg = [180.0, 0.0, 0.0]" in text
    found = read_records(load_log(str(path.with_suffix(".toml"))))
    assert_allclose(found.imu.t, imu["t"] - imu["t"][0], atol=1e-3 if old else 1e-6)
    if not old:
        assert_allclose(found.imu.dtheta_b / found.imu.dt[:, None], imu["gyro"], atol=1e-6)
        assert_allclose(found.imu.dvel_b / found.imu.dt[:, None], imu["accel"], atol=1e-5)
    assert_allclose(found.fixes.t, gnss["t"] - imu["t"][0], atol=2e-3 if old else 1e-6)
    assert_allclose(found.fixes.lla[:, :2], gnss["lla"][:, :2], atol=1e-11)
    assert_allclose(found.fixes.vel_n[:, :2], gnss["vel_n"][:, :2], atol=1e-6)
    sd = np.sqrt(found.fixes.cov_pos_n[0].diagonal())
    assert_allclose(sd[:2], 3.0 / np.sqrt(2.0))
    assert [note for note in found.notes if "fixes are by gps, and used" in note]


def test_sensors_that_were_off_are_a_line(tmp_path):
    path = tmp_path / "a.txt"
    path.write_text(HEAD + "Fix,GPS,47.0,11.0,600.0,0.0,3.0,,1699400582000,0.2,,16124559129000,3.0,0,\n")
    assert len(formats.read("gnsslogger", path, "gnss", None).t) == 1
    with pytest.raises(ConfigError, match="no rows UncalAccel or Accel; turn its sensors on in GnssLogger"):
        formats.read("gnsslogger", path, "imu", None)
    path.write_text(HEAD.replace("LatitudeDegrees", "Breite") + "Fix" + ",1" * 14 + "\n")
    with pytest.raises(ConfigError, match="rows Fix have no column latitude"):
        formats.read("gnsslogger", path, "gnss", None)


def test_damaged_files_are_read_in_part_or_a_line(tmp_path):
    path = tmp_path / "a.txt"
    write(path)
    lines = []
    for raw in spoil(path.read_bytes()[:60_000], 5, bits=1):
        path.write_bytes(raw)
        for kind in ("imu", "gnss"):
            try:
                formats.read("gnsslogger", path, kind, None)
            except ConfigError as error:
                lines.append(str(error))
    assert not [line for line in lines if "\n" in line or not line.startswith("a.txt: ")]
