"""Tables of Betaflight and iNav as blackbox_decode prints them, column by column."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.words.exceptions import WRONG
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from tests.workbench.test_exporters import UP, G, drive

START = 55_158_008  # [us]
MAIN = ["loopIteration", "time (us)", "axisP[0]", *(f"gyroADC[{k}]{{turn}}" for k in range(3))]
MAIN += [*(f"accSmooth[{k}]{{force}}" for k in range(3)), "motor[0]", "flightModeFlags (flags)"]
FIXES = "time (us), GPS_numSat, GPS_coord[0], GPS_coord[1], GPS_altitude, GPS_speed (m/s), GPS_ground_course"


def decode(folder, turn=" (deg/s)", force=" (m/s/s)", inav=False):
    """Write LOG00001.01.csv and LOG00001.01.gps.csv; return the first, with what they were made of."""
    imu, gnss = drive()
    lines = [", ".join(MAIN).format(turn=turn, force=force)]
    rates, forces = np.rad2deg(imu["gyro"] * UP), imu["accel"] * UP
    for k, t in enumerate(imu["t"]):
        rate = [f"{v:.2f}" if turn else f"{round(v):3d}" for v in rates[k]]
        accel = [f"{v:.2f}" if force else f"{round(2048 * v / G):3d}" for v in forces[k]]
        lines.append(
            ", ".join([str(k), str(START + round(1e6 * t)), " -1", *rate, *accel, "333", "ANGLE_MODE|ARM"])
        )
    path = folder / "LOG00001.01.csv"
    path.write_text("\n".join(lines) + "\n")
    lines = [FIXES + ", GPS_hdop" * inav]
    speed = np.hypot(*gnss["vel_n"][:, :2].T)
    course = np.rad2deg(np.arctan2(gnss["vel_n"][:, 1], gnss["vel_n"][:, 0])) % 360.0
    for k, t in enumerate(gnss["t"]):
        lat, lon, alt = gnss["lla"][k]
        row = [str(START + round(1e6 * t)), "12", f"{np.rad2deg(lat):.7f}", f"{np.rad2deg(lon):.7f}"]
        row += [str(round(alt if inav else 10.0 * alt)), f"{speed[k]:.2f}", f"{course[k]:.1f}"]
        lines.append(", ".join([*row, *["95"] * inav]))
    (folder / "LOG00001.01.gps.csv").write_text("\n".join(lines) + "\n")
    return path, imu, gnss


@pytest.mark.parametrize("inav", [False, True])
def test_decoded_tables_are_read_in_their_units_and_axes(tmp_path, capsys, inav):
    path, imu, gnss = decode(tmp_path, inav=inav)
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    text = path.with_suffix(".toml").read_text()
    assert (
        "GPS_altitude: taken as dm, as Betaflight 4 writes it; name it alt_cm for earlier versions: right?"
        in text
    ) is not inav
    assert "gyroADC[0], " not in text  # no question
    found = read_records(load_log(str(path.with_suffix(".toml"))))
    assert_allclose(found.imu.t, imu["t"] - imu["t"][0], atol=2e-6)
    assert_allclose(
        np.rad2deg(found.imu.dtheta_b / found.imu.dt[:, None]), np.rad2deg(imu["gyro"]), atol=6e-3
    )
    assert_allclose(found.imu.dvel_b / found.imu.dt[:, None], imu["accel"], atol=6e-3)
    assert_allclose(found.fixes.lla[:, :2], gnss["lla"][:, :2], atol=1e-9)
    assert_allclose(found.fixes.lla[:, 2], gnss["lla"][:, 2], atol=0.51 if inav else 0.051)
    moving = np.hypot(*gnss["vel_n"][:, :2].T) > 1.0
    assert_allclose(found.fixes.vel_n[moving, :2], gnss["vel_n"][moving, :2], atol=0.03)
    assert (found.fixes.satellites == 12).all()


def test_counts_of_the_accelerometer_need_its_scale_so_that_the_log_is_decoded_again(tmp_path, capsys):
    path, *_ = decode(tmp_path, turn="", force="")
    assert main(["new", "log", str(path)]) == WRONG
    err = capsys.readouterr().err
    assert "accSmooth[0], accSmooth[1], accSmooth[2]: not gravity in m/s^2, g or mg" in err
    assert "decode the log again by blackbox_decode --unit-rotation deg/s --unit-acceleration m/s2" in err


@pytest.mark.parametrize("name", ["LOG00001.TXT", "a.bbl", "a.bfl"])
def test_a_blackbox_itself_is_named_with_the_command_that_decodes_it(tmp_path, capsys, name):
    head = b"H Product:Blackbox flight data recorder by Nicholas Sherlock\nH Data version:2\nI\x00\xff\xfe"
    (tmp_path / name).write_bytes(head)
    for command in (["navigate"], ["new", "log"]):
        assert main([*command, str(tmp_path / name)]) == WRONG
        assert "is a Betaflight or iNav blackbox; decode it by blackbox_decode" in capsys.readouterr().err


def test_centimeters_of_a_barometer_are_no_meters(tmp_path):
    """BaroAlt (cm) of the same tables."""
    path, *_ = decode(tmp_path)
    head, *rows = path.read_text().splitlines()
    path.write_text(
        "\n".join([f"{head}, BaroAlt (cm)", *(f"{row}, {12_300 + k}" for k, row in enumerate(rows))])
    )
    assert main(["new", "log", str(path)]) == 0
    found = read_records(load_log(str(path.with_suffix(".toml"))))
    assert_allclose(found.instruments["baro"].alt_baro[:2], [123.0, 123.01])
