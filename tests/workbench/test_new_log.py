"""`bench new log`: a first log that navigates, from tables with names and units of other people."""

from __future__ import annotations

import os
import tomllib

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.io import savemat

import bench
from bench.cli.command_line import main
from bench.core.words.exceptions import WRONG
from bench.evaluation.motion.validity import check_recording
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
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
    assert ("gyros in deg, as the motion shows" in said) == (style == "theirs")
    assert ("taken as ms by the values: right?" in text) == (style == "theirs")


@pytest.mark.parametrize("late", [0.0, 0.15])
def test_clocks_that_the_motion_shows_to_be_apart_are_put_right(tmp_path, late, capsys):
    """The IMU's times are too large by 0.15 s: the log takes that off, and its check is content."""
    made = drives.sensed()
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(made["imu"]) | {"t_s": made["imu"]["t"] + late})
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(made["gnss"]))
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 0
    said, log = capsys.readouterr().out, load_log(str(tmp_path / "imu.toml"))
    assert log.imu.time_offset == pytest.approx(-late, abs=0.02)
    assert (log.imu.time_offset == 0.0) == (late == 0.0)
    assert [dict(one.options) for one in log.estimators] == [{}]
    assert ("by the motion: right?" in said) == (late > 0.0)
    records = read_records(log)
    checks = check_recording(records.imu, records.fixes, {}, np.asarray(log.antenna_b))
    assert all(one.good for one in checks if one.name == "imu_shift_s")


def test_a_recording_that_stands_is_leveled(tmp_path, capsys):
    """Forty seconds at rest: no course, so the log says level; the drive gives one."""
    rng, t = np.random.default_rng(2), np.arange(1, 4001) / 100.0
    still = {"t": t, "gyro": 1e-4 * rng.normal(size=(4000, 3))}
    still["accel"] = np.array([0.0, 0.0, -9.80]) + 1e-3 * rng.normal(size=(4000, 3))
    fixes = {"t": t[::100], "lla": np.tile(drives.sensed()["gnss"]["lla"][0], (40, 1))}
    fixes["vel_n"] = 0.02 * rng.normal(size=(40, 3))
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(still))
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(fixes))
    order = ["navigate", str(tmp_path / "imu.csv"), "--no-rrd", "--no-report", "-o", str(tmp_path / "out")]
    assert main(order) == 0
    said = capsys.readouterr().out
    assert (
        'kind = "level"  # it does not move fast enough for a course' in (tmp_path / "imu.toml").read_text()
    )
    assert "Wrote" in said
    assert main([*order, "--force"]) == 0
    assert "imu.toml describes it" in capsys.readouterr().out.replace("\n", "")


def test_a_slow_vehicle_starts_in_flight_and_a_glitch_gives_no_course(tmp_path, capsys):
    """A walk of 2 m/s whose fixes have one second of 50 m/s: neither a course nor a rest, so "hover"."""
    rng, t = np.random.default_rng(59), np.arange(1, 6001) / 100.0
    turn = 0.3 * np.sin(0.4 * t)  # rate about down [rad/s]
    heading = np.cumsum(turn) / 100.0
    gyro = np.column_stack([0 * t, 0 * t, turn]) + 1e-3 * rng.normal(size=(6000, 3))
    accel = np.column_stack([0 * t, 2.0 * turn, -9.80 + 0 * t]) + 2e-2 * rng.normal(size=(6000, 3))
    vel_n = 2.0 * np.column_stack([np.cos(heading), np.sin(heading), 0 * t])
    place = np.cumsum(vel_n, axis=0) / 100.0
    lla = drives.sensed()["gnss"]["lla"][0] + place * [1 / 6.37e6, 1 / 4.3e6, -1.0]
    fixes = {"t": t[::20], "lla": lla[::20], "vel_n": vel_n[::20] + 0.05 * rng.normal(size=(300, 3))}
    fixes["vel_n"][150:155] = [50.0, 0.0, 0.0]
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns({"t": t, "gyro": gyro, "accel": accel}))
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(fixes))
    order = ["navigate", str(tmp_path / "imu.csv"), "--no-rrd", "--no-report", "-o", str(tmp_path / "out")]
    assert main([*order, "--outages", "none"]) in (0, 1)
    log = tomllib.loads((tmp_path / "imu.toml").read_text())
    assert log["alignment"]["kind"] == "hover"
    assert "no solution before" not in capsys.readouterr().out


STRANGE = '\n[reference]\nfile = "x"\n\x1b\x7f \U0001f6e9'


def test_names_of_other_people_stay_within_their_line(tmp_path, capsys):
    """A line break in the name of a column, or of a file, adds nothing to the log."""
    made = drives.sensed()
    imu, fixes = made["imu"], drives.gnss_columns(made["gnss"])
    columns = {"t_s": imu["t"]}
    columns |= {f"gyr{a}({STRANGE}": np.rad2deg(imu["gyro"][:, k]) for k, a in enumerate("xyz")}
    columns |= {f"acc{a}({STRANGE}": imu["accel"][:, k] for k, a in enumerate("xyz")}
    pq.write_table(pa.table(columns), tmp_path / f"a{STRANGE}.parquet")
    pq.write_table(pa.table(fixes), tmp_path / "gnss.parquet")
    assert main(["new", "log", str(tmp_path / f"a{STRANGE}.parquet")]) == 0
    (log,) = tmp_path.glob("*.toml")
    found = tomllib.loads(log.read_text(encoding="utf-8"))
    assert found.keys() == {"title", "imu", "gnss", "sensors", "alignment"}
    assert found["imu"]["file"] == f"a{STRANGE}.parquet"
    assert f"accz({STRANGE}" in found["imu"]["columns"].values()
    assert "\x1b" not in capsys.readouterr().out


def test_the_file_that_names_the_antenna_stays_within_its_comment(tmp_path):
    make_run(tmp_path / "run")
    out = tmp_path / "out"
    bench.export_run(tmp_path / "run", "kf-gins", out=out)
    (out / "kf-gins.yaml").rename(out / f"kf{STRANGE}.yaml".replace("/", ""))
    assert main(["new", "log", str(out / "imu.txt")]) == 0
    assert "reference" not in tomllib.loads((out / "imu.toml").read_text(encoding="utf-8"))
    assert "# by kf [reference] file" in (out / "imu.toml").read_text(encoding="utf-8")


def test_a_name_that_is_no_text_is_refused_in_a_line(tmp_path, capsys):
    make_run(tmp_path / "run")
    out = tmp_path / "out"
    bench.export_run(tmp_path / "run", "kf-gins", out=out)
    try:
        (out / "gnss.txt").rename(out / os.fsdecode(b"caf\xe9.txt"))
    except OSError:
        pytest.skip("this disk has no names that are not UTF-8")
    assert main(["new", "log", str(out / "imu.txt")]) == WRONG
    said = capsys.readouterr().err
    assert said.startswith(f"error: {out / 'imu.txt'}: a log cannot name what is not UTF-8, '?.txt")
    assert said.count("\n") == 1
    assert not list(out.glob("*.toml"))


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
    (out / "a-folder.yaml").mkdir()
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
    assert "imu.txt: no increments of an IMU in the columns of KF-GINS" in capsys.readouterr().err
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


def test_what_cannot_be_found_is_said_and_nothing_is_written(tmp_path, capsys, monkeypatch):
    (tmp_path / "odd.csv").write_text("a,b\n1,2\n")
    assert main(["new", "log", str(tmp_path / "odd.csv")]) == 2
    assert "no columns found for imu" in capsys.readouterr().err
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(drives.sensed()["imu"]))
    drives.write_csv(tmp_path / "track.csv", {"east": np.arange(9.0), "position": np.arange(9.0)})
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 2
    assert "for gnss, there or in a table beside it" in capsys.readouterr().err
    assert main(["new", "log", str(tmp_path)]) == 2
    assert "imu.csv: no columns found for gnss, there or in a table beside it" in capsys.readouterr().err
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path / "empty")
    for folder in (".", ""):
        assert main(["new", "log", folder]) == 2
        assert "a folder without a table; name the file with the IMU" in capsys.readouterr().err
    assert not list(tmp_path.glob("*.toml"))
    (tmp_path / "imu.toml").write_text("mine")
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 2
    assert (tmp_path / "imu.toml").read_text() == "mine"
    assert main(["new", "log"]) == 2


def write_theirs(folder, imu_names, gnss_names, *, rate=1.0, force=1.0, t=1.0, height=1.0, speed=1.0):
    """Write the drive under other names, its values times factors; return the file of the IMU."""
    made = drives.sensed()
    imu, gnss = (list(make(made[kind]).values()) for kind, make in MAKERS.items())
    factors = [t, *[rate] * 3, *[force] * 3]
    theirs = {name: f * column for name, f, column in zip(imu_names, factors, imu, strict=True)}
    drives.write_csv(folder / "imu.csv", theirs)
    factors = [t, 1.0, 1.0, height, *speed * np.ones(3)]
    theirs = {name: f * column for name, f, column in zip(gnss_names, factors, gnss[:7], strict=True)}
    drives.write_csv(folder / "gnss.csv", theirs)
    return folder / "imu.csv"


MAKERS = {"imu": drives.imu_columns, "gnss": drives.gnss_columns}
IMU = ["t_s", *[f"gyro_{a}_rad_s" for a in "xyz"], *[f"accel_{a}_m_s2" for a in "xyz"]]
GNSS = ["t_s", "lat", "lon", "alt", "vn", "ve", "vd"]


def test_a_unit_in_brackets_is_not_guessed(tmp_path, capsys):
    """As where the motion is so gentle that deg/s look like rad/s, and an hour like a minute."""
    gyro, accel = (f"Gyroscope {{}} {unit}" for unit in ("(°/s)", "[dps]")), ("Acc {} [m s^-2]", "Acc {} (g)")
    for k, (turn, force, time) in enumerate(zip(gyro, accel, ("Time (ms)", "Time [µs]"), strict=True)):
        folder = tmp_path / str(k)
        folder.mkdir()
        names = [time, *[turn.format(a) for a in "XYZ"], *[force.format(a) for a in "XYZ"]]
        path = write_theirs(folder, names, [time, *GNSS[1:]], rate=3.0, t=0.1)
        assert main(["new", "log", str(path)]) == 0
        columns = load_log(str(path.with_suffix(".toml"))).imu.columns
        assert list(columns) == [("t_ms", "t_us")[k], *[f"gyro_{a}_deg_s" for a in "xyz"]] + [
            f"accel_{a}_{('m_s2', 'g')[k]}" for a in "xyz"
        ]
    assert "Gyroscope X" not in "".join(
        line for line in capsys.readouterr().out.splitlines() if "taken" in line
    )


@pytest.mark.parametrize("unit", ["(ft)", "[feet]"])
def test_a_unit_that_no_column_has_is_refused(tmp_path, unit, capsys):
    path = write_theirs(tmp_path, IMU, [*GNSS[:3], f"altitude {unit}", *GNSS[4:]], height=3.28084)
    assert main(["new", "log", str(path)]) == 2
    said = capsys.readouterr().err
    assert f"gnss.csv: 'altitude {unit}' is in a unit that no column of a log has; convert it" in said
    assert not path.with_suffix(".toml").exists()


@pytest.mark.parametrize(("t", "unit"), [(1e3, "ms"), (1e6, "us"), (1.0, "s"), (1e9, "ns")])
@pytest.mark.parametrize("rate", [1000.0, 10.0])
def test_the_unit_of_the_time_of_an_imu_is_guessed_from_10_to_1000_hz(tmp_path, t, unit, rate):
    """1000 Hz in ms step by 1 as a slow receiver does in s."""
    made = drives.sensed()
    imu, gnss = drives.imu_columns(made["imu"]), drives.gnss_columns(made["gnss"])
    count = 3000 if rate > 100 else 300
    imu = {name: values[:count] for name, values in imu.items() if name != "t_s"}
    times = np.arange(1, count + 1) / rate
    drives.write_csv(tmp_path / "imu.csv", {"time": t * times} | imu)
    drives.write_csv(
        tmp_path / "gnss.csv", {"time": t * gnss.pop("t_s")[:20]} | {k: v[:20] for k, v in gnss.items()}
    )
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == 0
    log = load_log(str(tmp_path / "imu.toml"))
    assert f"t_{unit}" in log.imu.columns
    assert_allclose(read_records(log).imu.dt, 1.0 / rate, rtol=1e-6)


def test_velocity_up_is_found(tmp_path):
    path = write_theirs(tmp_path, IMU, [*GNSS[:6], "vel_up"])
    assert main(["new", "log", str(path)]) == 0
    found = read_records(load_log(str(path.with_suffix(".toml"))))
    assert_allclose(found.fixes.vel_n, drives.sensed()["gnss"]["vel_n"] * [1.0, 1.0, -1.0], atol=1e-6)


def test_a_solution_is_not_taken_for_fixes(tmp_path, capsys):
    """A truth in a table or a structure, whose name comes first, is no receiver: it has an attitude."""
    _, sensed = make_run(tmp_path / "run")
    bench.export_run(tmp_path / "run", "navego", out=tmp_path / "mat", include=["truth"])
    bench.export_run(tmp_path / "run", "python-ins", out=tmp_path / "out", include=["truth"])
    bench.export_run(tmp_path / "run", "csv", out=tmp_path / "csv")
    (tmp_path / "csv" / "gnss.csv").unlink()
    (tmp_path / "csv" / "truth.parquet").write_bytes((tmp_path / "out" / "truth.parquet").read_bytes())
    (tmp_path / "csv" / "ublox.parquet").write_bytes((tmp_path / "out" / "position.parquet").read_bytes())
    for path in (tmp_path / "mat" / "navego.mat", tmp_path / "csv" / "imu.csv"):
        assert main(["new", "log", str(path)]) == 0
        found = read_records(load_log(str(path.with_suffix(".toml"))))
        assert_allclose(found.fixes.lla, sensed.data.fixes.lla[sensed.data.fixes.valid], atol=1e-9)
    capsys.readouterr()
    assert main(["new", "log", str(tmp_path / "out" / "imu.parquet")]) == 2
    assert "imu.parquet: accel_x, accel_y, accel_z: not gravity in m/s^2, g or mg" in capsys.readouterr().err


def test_fixes_of_kf_gins_are_not_taken_for_increments(tmp_path, capsys):
    """Standard deviations of 6 m each second are 10 m/s^2, but 47 deg of latitude no turn."""
    fixes = np.column_stack([np.arange(20.0), *np.outer([47.0, 11.0, 600.0, 6.0, 6.0, 6.0], np.ones(20))])
    np.savetxt(tmp_path / "gnss.txt", fixes)
    assert main(["new", "log", str(tmp_path / "gnss.txt")]) == 2
    assert "gnss.txt: no increments of an IMU in the columns of KF-GINS" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "above", "end"),
    [("txt", "\ufeff", "\r\n"), ("TXT", "# second, angles\n\n", "\n"), ("txt", "% x\n", "\n\n")],
)
def test_texts_of_kf_gins_have_rows_without_values_and_comments(tmp_path, name, above, end, capsys):
    """A row of NaN in each, an unknown sd of -1, times that repeat; each fault beside it is said."""
    made = drives.sensed()
    imu, gnss = made["imu"], made["gnss"]
    increments = np.column_stack([imu["t"], 0.01 * imu["gyro"], 0.01 * imu["accel"]])[:3000]
    place = np.column_stack([np.rad2deg(gnss["lla"][:, :2]), gnss["lla"][:, 2]])
    fixes = np.column_stack([gnss["t"], place, np.full((len(place), 3), 0.1)])[:150]
    increments[7, 1:], fixes[7, 1:], fixes[8, 4:], increments[9, 0] = np.nan, np.nan, -1.0, increments[8, 0]
    for file, rows in (("imu", increments), ("gnss", fixes)):
        text = "".join(" ".join(f"{x:.12g}" for x in row) + end for row in rows)
        (tmp_path / f"{file}.{name}").write_text(above + text, encoding="utf-8", newline="")
    assert main(["new", "log", str(tmp_path / f"imu.{name}")]) == 0
    found = read_records(load_log(str(tmp_path / "imu.toml")))
    assert_array_equal(np.flatnonzero(~found.imu.valid), [7])
    assert_array_equal(np.flatnonzero(~found.fixes.valid), [7])
    assert_allclose(found.fixes.lla[-1], gnss["lla"][149], atol=1e-9)
    (tmp_path / "imu.toml").unlink()
    (tmp_path / f"gnss.{name}").write_text("1e5 47 11 600 1 1 1\n")
    assert main(["new", "log", str(tmp_path / f"imu.{name}")]) == 2
    assert f"gnss.{name}: its times, 100000 to 100000 s, do not overlap" in capsys.readouterr().err
    (tmp_path / f"gnss.{name}").write_text("1 47 11 600 -0.5 1 1\n")
    assert main(["new", "log", str(tmp_path / f"imu.{name}")]) == 2
    assert f"gnss.{name}: row 1 holds no fix" in capsys.readouterr().err


def test_a_file_of_navego_gives_the_datasheet_it_was_written_with(tmp_path, capsys):
    """Figures go out in the units of NaveGo and come back; NaveGo keeps white noise, drift and its time."""
    _, sensed = make_run(tmp_path / "run")
    bench.export_run(tmp_path / "run", "navego", out=tmp_path / "out")
    path = tmp_path / "out" / "navego.mat"
    assert main(["new", "log", str(path)]) == 0
    assert "navego.imu.toml: the noise of the IMU by navego.mat" in capsys.readouterr().out
    found, meant = load_log(str(path.with_suffix(".toml"))).assumed.imu, sensed.data.specs.imu
    for triad in ("gyro", "accel"):
        one, other = getattr(found, triad), getattr(meant, triad)
        assert one.random_walk > 0.0
        assert one.random_walk == pytest.approx(other.random_walk, rel=1e-6)
        assert one.bias_instability == pytest.approx(other.bias_instability, rel=1e-6)
        assert one.bias_correlation == pytest.approx(other.bias_correlation, rel=1e-6)


def test_a_datasheet_that_is_there_is_kept(tmp_path):
    _, _ = make_run(tmp_path / "run")
    bench.export_run(tmp_path / "run", "navego", out=tmp_path / "out")
    path, sheet = tmp_path / "out" / "navego.mat", tmp_path / "out" / "navego.imu.toml"
    sheet.write_text('source = "mine"\n[gyro]\nnoise_deg_sqrt_h = 0.5\n[accel]\nnoise_m_s_sqrt_h = 0.5\n')
    kept = sheet.read_bytes()
    assert main(["new", "log", str(path)]) == 0
    assert sheet.read_bytes() == kept
    assert load_log(str(path.with_suffix(".toml"))).assumed.imu.gyro.random_walk == np.deg2rad(0.5) / 60.0
