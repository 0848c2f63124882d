"""Advice of the checks of a log as changes of its keys: by hand, by round trip, and from the command line."""

from __future__ import annotations

import tomllib
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from bench.cli.command_line import main
from bench.cli.new_files.log_advice import apply_advice
from bench.cli.new_files.log_changes import change_axes, list_changes, write_changes
from bench.core.mathematics import rotation
from bench.core.words.exceptions import ConfigError
from bench.io.config.log_tables import ImuTable, read_axes
from bench.io.logs.rows import GNSS, LogRows
from bench.io.logs.sensor_axes import turn_axes
from bench.io.logs.table_files import read_table
from bench.pipeline import log_pipeline
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
    changed = list_changes(tomllib.loads(TEXT), advice, Path())
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
    imu = {"file": "none.csv", "columns": named}
    found = list_changes({"imu": imu}, [{f"imu.{sensor}_gain": gain}], Path())["imu", "columns"]
    assert found == {f"{sensor}_{axis}_{unit}": f"col{axis}" for axis in "xyz"} | {"t_s": "time"}
    assert list_changes({"imu": imu}, [{f"imu.{sensor}_gain": 1.1}], Path()) == {}
    for other in ({"file": "a.txt", "format": "kf-gins"}, {"file": "a.bag", "topic": "/imu"}):
        assert list_changes({"imu": other}, [{f"imu.{sensor}_gain": gain}], Path()) == {}


def test_each_gain_names_the_columns_of_its_own_table():
    """Two gains change one table; gyros with a file of their own have columns of their own."""
    named = {f"gyro_{axis}_rad_s": f"g{axis}" for axis in "xyz"} | {
        f"accel_{axis}_m_s2": axis for axis in "xyz"
    }
    advice = [{"imu.gyro_gain": 57.3}, {"imu.accel_gain": 1.0 / 9.81}]
    found = list_changes({"imu": {"file": "none.csv", "columns": named}}, advice, Path())
    both = {f"gyro_{axis}_deg_s": f"g{axis}" for axis in "xyz"} | {f"accel_{axis}_g": axis for axis in "xyz"}
    assert found == {("imu", "columns"): both}
    gyros = {one: there for one, there in named.items() if one.startswith("gyro")}
    imu = {"file": "none.csv", "gyro_file": "other.csv", "gyro_columns": gyros}
    found = list_changes({"imu": imu}, advice, Path())
    assert found == {("imu", "gyro_columns"): {f"gyro_{axis}_deg_s": f"g{axis}" for axis in "xyz"}}


@pytest.mark.parametrize(
    ("header", "matrix", "expected"),
    [
        ("vel_n_mps,vel_e_mps,vel_d_mps", np.diag([1.0, 1.0, -1.0]), ("vel_n_mps", "vel_e_mps", "vel_u_mps")),
        ("vel_n_mps,vel_e_mps,vel_u_mps", np.diag([1.0, 1.0, -1.0]), ("vel_n_mps", "vel_e_mps", "vel_d_mps")),
        ("vel_n_mps,vel_e_mps,vel_d_mps", np.eye(3) / 3.6, ("vel_n_km_h", "vel_e_km_h", "vel_d_km_h")),
        ("vel_n_m_s,vel_e_m_s,vel_d_m_s", np.eye(3)[[1, 0, 2]], ("vel_e_m_s", "vel_n_m_s", "vel_d_m_s")),
        ("vel_n_mps,vel_e_mps,vel_d_mps", np.diag([-1.0, 1.0, 1.0]), None),
        ("vel_n_mps,vel_e_mps,vel_d_mps", np.eye(3) / 1.944, None),
        ("speed_mps,course_deg", np.diag([1.0, 1.0, -1.0]), None),
    ],
)
def test_velocities_of_other_axes_or_units_get_other_names(tmp_path, header, matrix, expected):
    """The record with the new names is the matrix times the record with the old ones."""
    (tmp_path / "gnss.csv").write_text(f"t_s,lat_deg,lon_deg,alt_m,{header}\n1,47,11,500,3,5,7\n")
    changed = list_changes({"gnss": {"file": "gnss.csv"}}, [{"gnss.velocity": matrix}], tmp_path)
    if expected is None:
        assert changed == {}
        return
    columns = changed["gnss", "columns"]
    names = zip(expected, header.split(","), strict=True)
    assert columns == {ours: theirs for ours, theirs in names if ours != theirs}

    def vel_n(columns):
        table = read_table(tmp_path / "gnss.csv", GNSS, tuple(GNSS)[2:], 10, columns)
        return LogRows.from_table(table, "gnss.csv").values["vel_n"][0]

    np.testing.assert_allclose(vel_n(columns), matrix @ vel_n({}))


ODD = {
    "comment": (
        "[imu]\ntime_offset_s = 0.5  # a # b\n",
        "time_offset_s = 0.1  # a # b; by the motion\n",
    ),
    "crlf": ("[imu]\r\nfile = 'ü.csv'\r\n", "[imu]\r\ntime_offset_s = 0.1  # by the motion\r\nfile"),
    "crlf and comment": ("[imu] # it\r\ntime_offset_s=5 # old\r\n", "= 0.1  # old; by the motion\r\n"),
    "spaces": ("  [ imu ]\n  time_offset_s = 0.5\n", "  time_offset_s = 0.1  # by the motion\n"),
    "no last line end": ("[imu]", "[imu]\ntime_offset_s = 0.1  # by the motion"),
    "hash in a string": ('[imu]\nsign = "gravity" # "#"\n[gnss]', "[imu]\ntime_offset_s = 0.1"),
    "inline": ('imu = { file = "a.csv" }\n', None),
    "dotted": ('imu.file = "a.csv"\n', None),
    "a name": ('file = "a.mat"\nimu = "imu1"\n', None),
    "quoted key": ('[imu]\n"time_offset_s" = 0.5\n', None),
    "in a text": ('title = """\n[imu]\n"""\n[imu]\n', None),
    "an array": ("[imu]\nx = [\n[1],\n]\ntime_offset_s = 1\n", None),
}


@pytest.mark.parametrize("name", ODD)
def test_a_key_changes_and_nothing_else(name):
    """A text in which the key has no line of its own is not changed."""
    text, expected = ODD[name]
    if expected is None:
        with pytest.raises(ValueError, match=r"no line \[imu\]|not in a line of its own"):
            write_changes(text, {("imu", "time_offset_s"): 0.1})
        return
    after = write_changes(text, {("imu", "time_offset_s"): 0.1})
    assert expected in after
    document = tomllib.loads(text)
    assert tomllib.loads(after) == document | {"imu": document["imu"] | {"time_offset_s": 0.1}}
    assert write_changes(after, {("imu", "time_offset_s"): 0.1}) == after


def test_names_of_columns_are_quoted():
    columns = {"gyro_x_rad_s": 'a "wild" \\ name', "gyro_y_rad_s": "x" * 90}
    after = write_changes('[imu]\nfile = "a.csv"\n', {("imu", "columns"): columns})
    assert tomllib.loads(after)["imu"]["columns"] == columns


@pytest.fixture
def faked(tmp_path, monkeypatch):
    """A log whose check fails with some offsets of its clock; a function sets what reading it does."""

    def use(text, judge):
        def read_log(name, **_):
            bad, advice = judge(tomllib.loads(Path(name).read_bytes().decode()))
            checks = [SimpleNamespace(name=one, good=False, advice=advice) for one in bad]
            return SimpleNamespace(checks=checks)

        monkeypatch.setattr(log_pipeline, "read_log", read_log)
        (tmp_path / "a.toml").write_bytes(text.encode())
        return tmp_path / "a.toml"

    return use


def by_offset(document):
    return ([], {}) if "time_offset_s" in document["imu"] else (["imu_shift_s"], {"imu.time_offset_s": 0.1})


def test_files_beside_the_log_are_left_alone(faked, tmp_path):
    path = faked("[imu]\r\n", by_offset)
    path.chmod(0o640)
    (tmp_path / "a.applied.toml").write_text("mine")
    (tmp_path / "link.toml").symlink_to("a.toml")
    apply_advice(str(tmp_path / "link.toml"), Console())
    assert path.read_bytes() == b"[imu]\r\ntime_offset_s = 0.1  # by the motion\r\n"
    assert path.stat().st_mode & 0o777 == 0o640
    assert (tmp_path / "link.toml").is_symlink()
    assert sorted(one.name for one in tmp_path.iterdir()) == ["a.applied.toml", "a.toml", "link.toml"]
    assert (tmp_path / "a.applied.toml").read_text() == "mine"


def test_advice_that_leads_to_an_error_or_mends_nothing_changes_nothing(faked, capsys):
    def fail(document):
        if "time_offset_s" in document["imu"]:
            raise ConfigError("imu.csv: no such [bold]column")
        return by_offset(document)

    path = faked("[imu]\n", fail)
    apply_advice(str(path), Console())
    assert path.read_text() == "[imu]\n"
    assert "is not changed: with the advice imu.csv: no such [bold]column" in capsys.readouterr().out
    path = faked("[imu]\n", lambda document: (["imu_shift_s"], {"imu.time_offset_s": 0.1}))
    apply_advice(str(path), Console())
    assert path.read_text() == "[imu]\n"
    assert "with the advice these checks fail: imu_shift_s" in capsys.readouterr().out


def test_what_cannot_be_written_is_told_with_its_value(faked):
    path = faked("imu = {}\n", by_offset)
    with pytest.raises(ConfigError, match=r"no line \[imu\]: set by hand \[imu\] time_offset_s = 0.1, or"):
        apply_advice(str(path), Console())
    assert path.read_text() == "imu = {}\n"


def test_a_log_that_is_read_only_or_being_edited_is_not_changed(faked):
    path = faked("[imu]\n", by_offset)
    path.chmod(0o444)
    with pytest.raises(ConfigError, match="read-only"):
        apply_advice(str(path), Console())
    path.chmod(0o644)

    def edit(document):
        if "time_offset_s" in document["imu"]:
            path.write_text("[imu] # edited\n")
        return by_offset(document)

    faked("[imu]\n", edit)
    with pytest.raises(ConfigError, match="changed in the meantime"):
        apply_advice(str(path), Console())
    assert path.read_text() == "[imu] # edited\n"
    assert [one.name for one in path.parent.iterdir()] == ["a.toml"]


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
    assert '[imu] sign = "gravity"' in said
    assert not (tmp_path / "log.applied.toml").exists()
    before = (tmp_path / "log.toml").read_text()
    assert main([*options, "-o", "second"]) == 0
    assert (tmp_path / "log.toml").read_text() == before
