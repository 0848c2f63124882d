"""Advice of the checks of a log as changes of its keys: by hand, by round trip, and from the command line."""

from __future__ import annotations

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from bench.cli.command_line import main
from bench.cli.new_files.log_changes import change_axes, list_changes, write_changes
from bench.core.mathematics import rotation
from bench.io.config.log_tables import ImuTable, read_axes
from bench.io.logs.rows import LogRows
from bench.io.logs.sensor_axes import turn_axes
from tests.exchange import drives

RNG = np.random.default_rng(20261129)
SIGNED = [np.eye(3)[RNG.permutation(3)] * RNG.choice([1.0, -1.0], 3)[:, None] for _ in range(40)]


def read(imu, raw):
    """Return the rates and forces (N, 3) of a file in the axes that [imu] gives, before a misalignment."""
    table = ImuTable(file="imu.csv", **imu)
    names = ("axes", "gyro_axes", "accel_axes")
    axes = {name: read_axes(getattr(table, name) or table.axes) for name in names}
    values = dict(zip(("gyro", "accel"), raw, strict=True))
    source = SimpleNamespace(**axes, gravity=table.sign == "gravity")
    rows = turn_axes(LogRows(np.arange(len(raw[0])) * 1.0, values), source)
    mount = rotation.matrix(rotation.from_euler(*np.deg2rad(imu.get("mounting_deg", [0.0] * 3))))
    return [rows.values[name] @ mount.T for name in ("gyro", "accel")]


STARTS = [
    {},
    {"mounting_deg": [180.0, 0.0, 90.0]},
    {"sign": "gravity", "axes": "y, x, -z"},
    {"gyro_axes": "-y, x, z"},
    {"axes": "y, -x, z", "accel_axes": "z, x, y"},
    {"axes": "y, x, z", "left_handed": True, "gyro_axes": "z, x, y", "accel_axes": "z, -x, y"},
]


@pytest.mark.parametrize("start", STARTS)
@pytest.mark.parametrize("k", range(0, 40, 2))
def test_keys_do_what_the_matrices_of_the_advice_do(start, k):
    """For drawn axes of both triads alike, of one, of both apart, and for reversed signs."""
    gyro, other = SIGNED[k], SIGNED[k + 1]
    raw = RNG.standard_normal((5, 3)), RNG.standard_normal((5, 3))
    before = read(start, raw)
    for one, two in ((gyro, gyro), (gyro, np.eye(3)), (np.eye(3), gyro), (gyro, -gyro), (gyro, other)):
        keys = start | change_axes(start, one, two)
        np.testing.assert_allclose(read(keys, raw), [before[0] @ one.T, before[1] @ two.T], atol=1e-12)


def test_axes_behind_a_mounting_that_is_no_right_angle_have_no_names():
    assert change_axes({"mounting_deg": [0.0, 0.0, 30.0]}, np.diag([1.0, -1.0, 1.0]), np.eye(3)) == {}
    turned = change_axes({"mounting_deg": [0.0, 0.0, 30.0]}, *2 * [np.diag([-1.0, -1.0, 1.0])])
    assert turned == {"mounting_deg": [0.0, 0.0, 210.0]}


TEXT = """title = "A log"  # kept

[imu]
file = "imu.csv"
time_offset_s = 0.5  # a guess

[gnss]
file = "gnss.csv"
"""


def test_changes_are_added_to_what_the_log_says():
    advice = [
        {"imu.time_offset_s": -0.1234},
        {"gnss.position_m": [0.5, 0.0, 0.001]},
        {"gnss.velocity_offset_s": 0.2},
        {"gnss.velocity_sd_mps": 0.4},
    ]
    changed = list_changes(tomllib.loads(TEXT), advice)
    text = write_changes(TEXT, changed)
    after = tomllib.loads(text)
    assert after["imu"] == {"file": "imu.csv", "time_offset_s": 0.377}
    moved = {"position_m": [0.5, 0.0, 0.0], "velocity_offset_s": 0.2, "velocity_sd_mps": 0.4}
    assert after["gnss"] == {"file": "gnss.csv", **moved}
    assert 'title = "A log"  # kept' in text
    with pytest.raises(ValueError, match=r"no line \[gnss\]"):
        write_changes("[imu]\n", {("gnss", "position_m"): [0.0, 0.0, 0.0]})


@pytest.mark.parametrize(
    ("sensor", "gain", "unit"),
    [("gyro", 57.0, "deg_s"), ("gyro", 0.0175, "rad_s"), ("accel", 0.1, "g"), ("accel", 9.9, "m_s2")],
)
def test_a_gain_of_another_unit_renames_the_columns(sensor, gain, unit):
    other = {"deg_s": "rad_s", "rad_s": "deg_s", "g": "m_s2", "m_s2": "g"}[unit]
    named = {f"{sensor}_{axis}_{other}": f"col{axis}" for axis in "xyz"} | {"t_s": "time"}
    found = list_changes({"imu": {"columns": named}}, [{f"imu.{sensor}_gain": gain}])["imu", "columns"]
    assert found == {f"{sensor}_{axis}_{unit}": f"col{axis}" for axis in "xyz"} | {"t_s": "time"}
    assert list_changes({"imu": {"columns": named}}, [{f"imu.{sensor}_gain": 1.1}]) == {}


def spoil(columns):
    """Return the columns of an IMU with reversed forces, 0.4 s late, y reversed in both triads."""
    out = {}
    for name, values in columns.items():
        factor = (-1.0 if name.startswith("accel") else 1.0) * (-1.0 if "_y_" in name else 1.0)
        out[name] = values + 0.4 if name.startswith("t") else factor * values
    return out


def test_apply_mends_a_log_with_three_mistakes(tmp_path, capsys, monkeypatch):
    """A second run has nothing left to apply."""
    monkeypatch.chdir(tmp_path)
    made = drives.sensed()
    drives.write_csv(tmp_path / "imu.csv", spoil(drives.imu_columns(made["imu"])))
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(made["gnss"]))
    (tmp_path / "log.toml").write_text(
        '[imu]\nfile = "imu.csv"\n[gnss]\nfile = "gnss.csv"\nposition_m = [-0.6, 0.3, -1.0]\n'
        '[sensors.assumed]\nimu = "adis16475"\ngnss = "l1-code"\n'
    )
    options = ["navigate", "log.toml", "--apply", "--no-rrd", "--no-report", "--outages", "none"]
    assert main([*options, "-o", "first"]) == 0
    said = capsys.readouterr().out
    log = tomllib.loads((tmp_path / "log.toml").read_text())
    assert log["imu"]["sign"] == "gravity"
    assert log["imu"]["axes"] == "x, -y, z"
    assert log["imu"]["left_handed"] is True
    assert log["imu"]["time_offset_s"] == pytest.approx(-0.4, abs=0.02)
    assert "[imu] sign = gravity" in said
    assert not (tmp_path / "log.applied.toml").exists()
    before = (tmp_path / "log.toml").read_text()
    assert main([*options, "-o", "second"]) == 0
    assert (tmp_path / "log.toml").read_text() == before
