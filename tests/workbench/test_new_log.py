"""`bench new log`: a first log that navigates, from tables with names and units of other people."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

import bench
from bench.cli import main
from bench.config.log import load_log
from bench.exchange.log_records import read_records
from tests.exchange import drives
from tests.exchange.exported import make_run
from tests.exchange.test_log_tables import write_structures


def write(folder, style):
    """Write the drive of the tests in a style; return the file of the IMU."""
    made = drives.sensed()
    imu, gnss = made["imu"], made["gnss"]
    if style == "ours":
        drives.write_csv(folder / "imu.csv", drives.imu_columns(imu))
        drives.write_csv(folder / "gnss.csv", drives.gnss_columns(gnss))
        return folder / "imu.csv"
    columns = {"Timestamp": 1e3 * imu["t"]}
    columns |= {f"Gyr{a}": np.rad2deg(imu["gyro"][:, k]) for k, a in enumerate("XYZ")}
    columns |= {f"Acc{a} [g]": imu["accel"][:, k] / 9.80665 for k, a in enumerate("XYZ")}
    held = np.maximum(np.searchsorted(gnss["t"], imu["t"] + 1e-9, "right") - 1, 0)
    columns |= {name: np.rad2deg(gnss["lla"][held, k]) for k, name in enumerate(("latitude", "longitude"))}
    columns |= {"height": gnss["lla"][held, 2]}
    columns |= {f"Vel {w}": gnss["vel_n"][held, k] for k, w in enumerate(("North", "East", "Down"))}
    drives.write_csv(folder / "all.csv", columns)
    return folder / "all.csv"


@pytest.mark.parametrize("style", ["ours", "theirs"])
def test_the_log_reads_what_was_recorded(tmp_path, style, capsys):
    """Names and units are found, guessed units are said and asked, and the numbers are those of the drive."""
    path = write(tmp_path, style)
    assert main(["new", "log", str(path)]) == 0
    said, log = capsys.readouterr().out, path.with_suffix(".toml")
    found, made = read_records(load_log(str(log))), drives.sensed()
    assert_allclose(found.imu.dvel_b / found.imu.dt[:, None], made["imu"]["accel"], atol=1e-6)
    assert_allclose(found.imu.dtheta_b / found.imu.dt[:, None], made["imu"]["gyro"], atol=1e-6)
    assert_allclose(found.fixes.lla[-1], made["gnss"]["lla"][-1], atol=1e-3)
    assert_allclose(found.fixes.vel_n[-1], made["gnss"]["vel_n"][-1], atol=1e-6)
    text = log.read_text()
    assert "mounting_deg" in text
    assert ("taken as deg_s by the values" in said) == (style == "theirs")
    assert ("taken as ms by the values: right?" in text) == (style == "theirs")


def test_an_export_of_the_bench_is_found(tmp_path):
    """Its IMU has increments, their length and a flag; its fixes are in radians."""
    _, sensed = make_run(tmp_path / "run")
    bench.export_run(tmp_path / "run", "csv", out=tmp_path / "out")
    assert main(["new", "log", str(tmp_path / "out" / "imu.csv")]) == 0
    log = load_log(str(tmp_path / "out" / "imu.toml"))
    found, data = read_records(log), sensed.data
    assert_array_equal(found.imu.dtheta_b, data.imu.dtheta_b)
    assert_array_equal(found.imu.dvel_b, data.imu.dvel_b)
    assert_array_equal(found.imu.dt, data.imu.dt)
    assert_allclose(found.fixes.lla, data.fixes.lla, atol=1e-12)
    assert_array_equal(log.antenna_b, data.antenna_b)
    assert log.assumed.baro is not None
    (tmp_path / "out" / "imu.toml").unlink()
    (tmp_path / "out" / "start.json").write_text('{"antenna_b_m": [1.0, NaN, 2.0]}')
    assert main(["new", "log", str(tmp_path / "out" / "imu.csv")]) == 0
    assert "# where is its antenna" in (tmp_path / "out" / "imu.toml").read_text()


@pytest.mark.parametrize(
    ("kind", "name", "says"), [("mat", "run", "start.antenna_b_m"), ("navego", "navego", "gnss.larm")]
)
def test_a_matlab_file_says_where_the_antenna_is(tmp_path, kind, name, says):
    _, sensed = make_run(tmp_path / "run")
    bench.export_run(tmp_path / "run", kind, out=tmp_path / "out")
    path = tmp_path / "out" / f"{name}.mat"
    assert main(["new", "log", str(path)]) == 0
    assert f"  # by {says}" in path.with_suffix(".toml").read_text()
    log = load_log(str(path.with_suffix(".toml")))
    assert_array_equal(log.antenna_b, sensed.data.antenna_b)
    assert_allclose(read_records(log).fixes.lla[0], sensed.data.fixes.lla[0], atol=1e-12)


def test_texts_of_kf_gins_are_found_by_their_values(tmp_path, capsys):
    """Beside the increments of another IMU and a solution; the antenna is that of the configuration."""
    _, sensed = make_run(tmp_path / "run")
    out = tmp_path / "out"
    bench.export_run(tmp_path / "run", "kf-gins", out=out, include=["truth"])
    (out / "another.txt").write_bytes((out / "imu.txt").read_bytes())
    assert main(["new", "log", str(out / "imu.txt")]) == 0
    text = (out / "imu.toml").read_text()
    assert "  # by kf-gins.yaml" in text
    log = load_log(str(out / "imu.toml"))
    found, data = read_records(log), sensed.data
    assert_allclose(log.antenna_b, data.antenna_b, rtol=1e-11)
    assert_array_equal(found.imu.dvel_b, data.imu.dvel_b)
    assert_allclose(found.fixes.lla, data.fixes.lla[data.fixes.valid], atol=1e-12)
    (out / "imu.toml").unlink()
    (out / "kf-gins.yaml").write_text("antlever: [ here ]")
    assert main(["new", "log", str(out / "imu.txt")]) == 0
    assert "# where is its antenna" in (out / "imu.toml").read_text()
    capsys.readouterr()
    (out / "gnss.txt").rename(out / "gnss.dat")
    (out / "imu.toml").unlink()
    assert main(["new", "log", str(out / "imu.txt")]) == 2
    assert "imu.txt: no fixes beside it, as KF-GINS has them: a .txt with" in capsys.readouterr().err
    np.savetxt(out / "imu.txt", np.loadtxt(out / "imu.txt") * [1, 0.01, 0.01, 0.01, 0.01, 0.01, 0.01])
    assert main(["new", "log", str(out / "imu.txt")]) == 2
    assert "imu.txt: no increments of an IMU as KF-GINS has them" in capsys.readouterr().err
    assert not list(out.glob("*.toml"))


def test_structures_of_a_matlab_file_are_found(tmp_path, capsys):
    """NaveGo's by their fields, the first of two; a table's in the structure with its columns."""
    made = write_structures(tmp_path, "imu1", "imu2")
    imu, gnss = made["imu"], made["gnss"]
    unit = {"time": imu["t"], "gyro": imu["gyro"], "acc": imu["accel"]}
    lat, lon, height = gnss["lla"].T
    fixes = {"time": gnss["t"], "lat_rad": lat, "lon_rad": lon, "height": height}
    (tmp_path / "other").mkdir()
    savemat(tmp_path / "other" / "rec.mat", {"rec": {"unit": unit, "gps": fixes}})
    for path in (tmp_path / "all.mat", tmp_path / "other" / "rec.mat"):
        assert main(["new", "log", str(path)]) == 0
        found = read_records(load_log(str(path.with_suffix(".toml"))))
        assert_allclose(found.imu.dvel_b / found.imu.dt[:, None], made["imu"]["accel"], atol=1e-6)
        assert_allclose(found.fixes.lla, gnss["lla"], atol=1e-9)
    assert '# or topic = "flight.imu2"?' in (tmp_path / "all.toml").read_text()
    assert "rec.mat, structure rec.unit: " in capsys.readouterr().out


def test_what_cannot_be_found_is_said_and_nothing_is_written(tmp_path, capsys):
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    assert main(["new", "log", str(tmp_path / "odd.csv")]) == 2
    assert "no columns that look like those of imu" in capsys.readouterr().err
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(drives.sensed()["imu"]))
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 2
    assert "those of gnss, there or in a table beside it" in capsys.readouterr().err
    for folder in (str(tmp_path), ".", ""):
        assert main(["new", "log", folder]) == 2
        assert "a folder; name the file in it with the IMU" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.toml"))
    (tmp_path / "imu.toml").write_text("mine")
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 2
    assert (tmp_path / "imu.toml").read_text() == "mine"
    assert main(["new", "log"]) == 2
