"""Positions of a table in a local frame, as fixes and as a reference: placed by pymap3d, not by bench."""

from __future__ import annotations

import numpy as np
import pymap3d
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.mathematics import earth
from bench.core.words.exceptions import WRONG, ConfigError
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from tests.exchange import drives
from tests.exchange.test_reference import REFERENCE, motion

ORIGIN = (46.999, 10.998, 550.0)  # [deg, deg, m]
ORIGIN_KEY = "origin = [47, 11, 0, 0]\n"
HEADING = 30.0  # of the north axis of a turned frame [deg]
NAMES = {
    "x_m, y_m, z_m": "enu",
    "east_m, north_m, up_m": "enu",
    "pos_e_m, pos_n_m, pos_u_m": "enu",
    "pn_m, pe_m, pd_m": "ned",
    "pos_n_cm, pos_e_cm, pos_d_cm": "ned",
    "north_mm, east_mm, down_mm": "ned",
    "pos_x_m, pos_y_m, pos_z_m": "nwu",
}
FACTORS = {"m": 1.0, "cm": 100.0, "mm": 1000.0}


def to_local(columns, names, heading=0.0):
    """Return columns with positions, velocities and heading in a frame turned by a heading [deg]."""
    place = [columns.pop(name) for name in ("lat_deg", "lon_deg", "alt_m")]
    east, north, up = pymap3d.geodetic2enu(*place, *ORIGIN)
    c, s = np.cos(np.deg2rad(heading)), np.sin(np.deg2rad(heading))
    letters = {"n": c * north + s * east, "e": c * east - s * north, "u": up}
    letters |= {"d": -letters["u"], "w": -letters["e"]}
    v_n, v_e = columns["vel_n_mps"], columns["vel_e_mps"]
    columns |= {"vel_n_mps": c * v_n + s * v_e, "vel_e_mps": c * v_e - s * v_n}
    if "heading_deg" in columns:
        columns["heading_deg"] = (columns["heading_deg"] - heading) % 360.0
    factor = FACTORS[names.rpartition("_")[2]]
    return columns | {
        name: factor * letters[letter] for name, letter in zip(names.split(", "), NAMES[names], strict=True)
    }


def write_log(folder, names, keys="", heading=0.0, more=""):
    path = drives.write_log(folder, drives.LOG.replace("[sensors", f"{keys}\n[sensors", 1) + more)
    columns = drives.gnss_columns(drives.sensed()["gnss"])
    drives.write_csv(folder / "gnss.csv", to_local(columns, names, heading))
    return path


@pytest.mark.parametrize("heading", [0.0, HEADING])
@pytest.mark.parametrize("names", NAMES)
def test_fixes_are_placed_by_the_origin(tmp_path, names, heading):
    plain = read_records(load_log(str(drives.write_log(tmp_path))))
    keys = f"origin = [{', '.join(map(str, ORIGIN))}, {heading}]\n"
    keys += 'frame = "nwu-flu"' if NAMES[names] == "nwu" else ""
    found = read_records(load_log(str(write_log(tmp_path, names, keys, heading))))
    assert_allclose(earth.difference_n(found.fixes.lla, plain.fixes.lla), 0.0, atol=1e-4)
    # velocities of the table are those at the origin; north turns by 1e-4 rad over the drive
    assert_allclose(found.fixes.vel_n, plain.fixes.vel_n, atol=3e-3)
    (note,) = [one for one in found.notes if "local frame" in one]
    assert note.endswith(f"are in a local frame, taken as {NAMES[names]}")


def test_without_an_origin_the_place_is_assumed_and_that_is_said(tmp_path):
    """Differences of positions are those of the file; a row without a position is no fix."""
    path = write_log(tmp_path, "x_m, y_m, z_m")
    text = (tmp_path / "gnss.csv").read_text().splitlines()
    name = text[0].split(",").index("x_m")
    row = text[8].split(",")
    text[8] = ",".join([*row[:name], "nan", *row[name + 1 :]])
    for k, far in ((9, "2e7"), (10, "-5e4")):  # no place on the Earth, and one that may be
        row = text[k].split(",")
        text[k] = ",".join([*row[:name], far, *row[name + 1 :]])
    (tmp_path / "gnss.csv").write_text("\n".join(text))
    found = read_records(load_log(str(path)))
    assert "taken as enu at an assumed origin, 45, 0 deg, 0 m: set origin" in found.assumed
    assert np.flatnonzero(~found.fixes.valid).tolist() == [7, 8]
    own = np.stack(pymap3d.geodetic2enu(*drive_place(), *ORIGIN), axis=-1)
    lat, lon, alt = found.fixes.lla.T
    placed = np.stack(pymap3d.geodetic2enu(np.rad2deg(lat), np.rad2deg(lon), alt, 45.0, 0.0, 0.0), axis=-1)
    assert_allclose(placed[10:], own[10:], atol=2e-4)
    result = bench.navigate(path)
    (check,) = [one for one in bench.read_log(path).checks if one.name == "gnss_origin"]
    assert (check.text, check.good) == (found.assumed, False)
    assert "assumed origin" in str(result.more)
    assert result.metrics["loose-15"]["converged"]
    assert result.metrics["loose-15"]["verdict"] == "consistent"


def drive_place():
    columns = drives.gnss_columns(drives.sensed()["gnss"])
    return [columns[name] for name in ("lat_deg", "lon_deg", "alt_m")]


@pytest.mark.parametrize("known", [True, False])
def test_a_reference_is_placed_by_its_origin_or_else_aligned(tmp_path, known):
    def navigate(columns, keys):
        drives.write_csv(tmp_path / "other.csv", columns)
        return bench.navigate(
            drives.write_log(tmp_path, drives.LOG + REFERENCE.format(file="other.csv") + keys)
        )

    plain = navigate(motion(), "").metrics["loose-15"]
    keys = f"origin = [{', '.join(map(str, ORIGIN))}, {HEADING}]\n" if known else ""
    result = navigate(to_local(motion(), "pn_m, pe_m, pd_m", HEADING), keys)
    found = result.metrics["loose-15"]
    if known:
        for name in ("pos_rmse_h_m", "pos_rmse_d_m", "heading_rmse_deg", "vel_rmse_h_mps"):
            assert_allclose(found[name], plain[name], rtol=0.05, atol=2e-3, err_msg=name)
        return
    assert "aligned (yaw)" in str(result.more)
    assert found["pos_rmse_h_m"] < plain["pos_rmse_h_m"] + 0.01
    assert found["heading_rmse_deg"] < plain["heading_rmse_deg"] + 0.5


@pytest.mark.parametrize("names", ["x_m, y_m, z_m", "pe, pn, pu", "east_m, north_m, up_m"])
def test_new_log_finds_them_and_asks_for_their_axes(tmp_path, capsys, names):
    columns = to_local(drives.gnss_columns(drives.sensed()["gnss"]), "pos_e_m, pos_n_m, pos_u_m")
    theirs = dict(zip(("pos_e_m", "pos_n_m", "pos_u_m"), names.split(", "), strict=True))
    drives.write_log(tmp_path)
    plain = read_records(load_log(str(tmp_path / "drive.toml"))).fixes
    drives.write_csv(tmp_path / "gnss.csv", {theirs.get(name, name): v for name, v in columns.items()})
    (tmp_path / "imu.csv").rename(tmp_path / "rows.csv")
    assert main(["new", "log", str(tmp_path / "rows.csv")]) == 0, capsys.readouterr().err
    text = (tmp_path / "rows.toml").read_text()
    assert f"{names}: taken as a local frame, east, north, up: right?" in text
    found = read_records(load_log(str(tmp_path / "rows.toml"))).fixes
    here, there = (earth.local_ned(one.lla, one.lla[0]) for one in (found, plain))
    assert_allclose(here, there, atol=2e-2)  # the frame is level at its own origin


def test_x_y_z_without_a_unit_are_no_positions(tmp_path, capsys):
    """They are accelerations in the tables of phones."""
    drives.write_log(tmp_path)
    columns = drives.gnss_columns(drives.sensed()["gnss"])
    names = {"lat_deg": "x", "lon_deg": "y", "alt_m": "z"}
    drives.write_csv(tmp_path / "gnss.csv", {names.get(name, name): v for name, v in columns.items()})
    (tmp_path / "imu.csv").rename(tmp_path / "rows.csv")
    assert main(["new", "log", str(tmp_path / "rows.csv")]) == WRONG
    assert "no columns found for gnss" in capsys.readouterr().err


def test_keys_of_a_local_frame_without_local_positions_are_rejected(tmp_path):
    path = drives.write_log(tmp_path, drives.LOG.replace("[sensors", f"{ORIGIN_KEY}[sensors", 1))
    with pytest.raises(
        ConfigError, match=r"gnss\.csv: origin is only for positions in a local frame, not for lat_deg: leave"
    ):
        read_records(load_log(str(path)))
    path = write_log(tmp_path, "pn_m, pe_m, pd_m", 'frame = "enu-flu"')
    with pytest.raises(
        ConfigError, match=r"gnss\.csv: frame 'enu-flu' contradicts the columns pn_m, pe_m, pd_m"
    ):
        read_records(load_log(str(path)))
    drives.write_log(
        tmp_path, drives.LOG.replace("gnss.csv", "a.nmea").replace("[sensors", f"{ORIGIN_KEY}[sensors", 1)
    )
    (tmp_path / "a.nmea").write_text("")
    with pytest.raises(ConfigError, match=r"a\.nmea: origin: only for positions in a local frame"):
        read_records(load_log(str(path)))
    path = write_log(tmp_path, "x_m, y_m, z_m", 'frame = "abc-flu"')
    with pytest.raises(ConfigError, match="frame 'abc-flu': expected the axes x, y, z"):
        read_records(load_log(str(path)))
