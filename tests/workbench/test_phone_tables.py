"""Tables as phones and car loggers write them: in one table, or a table for each sensor."""

from __future__ import annotations

import datetime

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.io.config.log import load_log
from bench.io.logs.formats.joined_triads import join_triads
from bench.io.logs.log_records import read_records
from tests.workbench.test_exporters import EPOCH, G, axes, drive, hold, where, write

FLU = np.array([1.0, -1.0, -1.0])
"""Forward, right, down -> forward, left, up, the axes of a phone that lies on its side."""


def speed(gnss, names):
    """Columns of speed and course [m/s], [deg]."""
    vel = gnss["vel_n"]
    course = np.rad2deg(np.arctan2(vel[:, 1], vel[:, 0])) % 360.0
    return {names[0]: np.hypot(vel[:, 0], vel[:, 1]), names[1]: course}


def check(found, imu, gnss, atol=2e-5, rows=slice(None)):
    """Compare records with the drive that was written, from the first gyro row in common on."""
    assert_allclose(found.imu.dtheta_b / found.imu.dt[:, None], imu["gyro"][rows], atol=1e-6)
    assert_allclose(found.imu.dvel_b / found.imu.dt[:, None], imu["accel"][rows], atol=atol)
    assert_allclose(found.fixes.lla[-1, :2], gnss["lla"][-1, :2], atol=2e-9)
    assert_allclose(found.fixes.lla[-1, 2], gnss["lla"][-1, 2], atol=6e-4)
    assert_allclose(found.fixes.vel_n[-1, :2], gnss["vel_n"][-1, :2], atol=6e-4)
    assert np.isnan(found.fixes.vel_n[-1, 2])


def accuracy(gnss, h, v):
    return {h: np.full(len(gnss["t"]), 3.0), v: np.full(len(gnss["t"]), 4.0)}


def test_a_car_logger_is_read_with_km_h_and_rates_by_name(tmp_path, capsys):
    imu, gnss = drive()
    held = hold(gnss, imu["t"])
    day = datetime.date(2014, 3, 26)
    columns = {
        "date": np.full(len(imu["t"]), float(f"{day:%d%m%y}")),
        "time": 123825300.0 + np.floor(imu["t"]) * 1000,
        "millis": 1e3 * (EPOCH + imu["t"]),
        **axes("a{}", imu["accel"]),
        **{f"{n}rate": np.rad2deg(imu["gyro"][:, k]) for k, n in enumerate(("roll", "pitch", "yaw"))},
        **dict.fromkeys(("roll", "pitch", "yaw"), 0.0 * imu["t"]),
        **speed(held, ("speed", "course")),
        **where(held, "latitude", "longitude", "altitude"),
        **dict.fromkeys(("pdop", "hdop", "vdop", "epe", "fix"), 1.0 + 0.0 * imu["t"]),
        "satellites_used": 7.0 + 0.0 * imu["t"],
    }
    columns["speed"] = 3.6 * columns["speed"]
    path = write(tmp_path, [("car.csv", ",", "", columns)])
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    found = read_records(load_log(str(path.with_suffix(".toml"))))
    check(found, imu, gnss, atol=2e-3)  # times since 1970 in milliseconds have 0.2 us
    assert_allclose(found.fixes.t[1:], gnss["t"][1:] - imu["t"][0], atol=1e-2)
    assert found.reported == "dilution of precision"
    assert (found.fixes.satellites == 7).all()


def test_sensor_log_of_ios_has_three_clocks_and_the_sign_of_gravity(tmp_path, capsys):
    """Gyro rows are 4 ms before accelerometer rows; a fix is written 0.3 s after its time, then empty."""
    imu, gnss = drive()
    t, boot = imu["t"], 254_988.0
    seen = np.searchsorted(t, gnss["t"] + 0.3)
    seen = seen[seen < len(t)]

    def put(values):
        """Put values of a fix into the row in which it is written, and nothing into the others."""
        column = np.full(len(t), np.nan)
        column[seen] = values[: len(seen)]
        return column

    columns = {
        "loggingSample": np.arange(len(t)),
        "locationTimestamp_since1970": put(EPOCH + gnss["t"]),
        **{name: put(v) for name, v in where(gnss, *(f"location{n}" for n in PLACE)).items()},
        **{name: put(v) for name, v in speed(gnss, ("locationSpeed", "locationCourse")).items()},
        "locationVerticalAccuracy": put(np.full(len(gnss["t"]), 4.0)),
        "locationHorizontalAccuracy": put(np.full(len(gnss["t"]), 3.0)),
        "accelerometerTimestamp_sinceReboot": boot + t,
        **axes("accelerometerAcceleration{}", -imu["accel"] * FLU / G, "XYZ"),
        "gyroTimestamp_sinceReboot": boot + t - 0.004,
        **axes("gyroRotation{}", imu["gyro"] * FLU, "XYZ"),
    }
    path = write(tmp_path, [("ios.csv", ",", "", columns)])
    text = path.read_text().replace("nan", "")
    path.write_text(text)
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    log = path.with_suffix(".toml").read_text()
    assert 'sign = "gravity"  # as SensorLog has it' in log
    assert "mounting_deg = [180.0, 0.0, 0.0]" in log
    spec = load_log(str(path.with_suffix(".toml")))
    assert spec.imu.time_offset == pytest.approx(EPOCH - boot, abs=0.03)  # by the motion
    found = read_records(spec)
    assert [note for note in found.notes if "rows have no time and are left out" in note]
    gyro = found.imu.dtheta_b / found.imu.dt[:, None]
    assert_allclose(gyro[5:50], imu["gyro"][6:51], atol=1e-6)
    # the interval of a gyro row ends 4 ms before that of an accelerometer row
    mixed = 0.6 * imu["accel"][6:51] + 0.4 * imu["accel"][5:50]
    assert_allclose((found.imu.dvel_b / found.imu.dt[:, None])[5:50], mixed, atol=2e-4)
    sd = np.sqrt(np.einsum("kii->ki", found.fixes.cov_pos_n))
    assert_allclose(sd, np.tile([3 / np.sqrt(2), 3 / np.sqrt(2), 4.0], (len(sd), 1)))


PLACE = ("Latitude", "Longitude", "Altitude")


def sensor_logger(imu, gnss):
    """Sensor Logger on Android: x, y, z in all files, in the order of the app."""
    ns = np.round(1e9 * (EPOCH + imu["t"]))
    clock = {"time": ns, "seconds_elapsed": imu["t"]}
    yield "TotalAcceleration.csv", ",", "", clock | axes("{}", imu["accel"] * FLU)
    yield "Accelerometer.csv", ",", "", clock | axes("{}", imu["accel"] * FLU - [0.0, 0.0, G])
    yield "Gravity.csv", ",", "", clock | axes("{}", np.tile([0.0, 0.0, G], (len(ns), 1)))
    yield "Gyroscope.csv", ",", "", clock | axes("{}", imu["gyro"] * FLU)
    place = {"time": np.round(1e9 * (EPOCH + gnss["t"])), "seconds_elapsed": gnss["t"]}
    place |= {"bearingAccuracy": 0 * gnss["t"], "speedAccuracy": 0.5 + 0 * gnss["t"]}
    place |= accuracy(gnss, "horizontalAccuracy", "verticalAccuracy") | speed(gnss, ("speed", "bearing"))
    yield "Location.csv", ",", "", place | where(gnss, "latitude", "longitude", "altitude")


def sensor_logger_ios(imu, gnss):
    """On iOS: the raw accelerometer in g, with the sign of gravity."""
    files = {name: (name, *rest) for name, *rest in sensor_logger(imu, gnss)}
    _, separator, above, columns = files.pop("TotalAcceleration.csv")
    raw = columns | axes("{}", -imu["accel"] * FLU / G)
    yield from [*files.values(), ("AccelerometerUncalibrated.csv", separator, above, raw)]


def phyphox(imu, gnss):
    clock = {"Time (s)": imu["t"]}
    yield "Accelerometer.csv", ",", "", clock | axes("Acceleration {} (m/s^2)", imu["accel"] * FLU)
    linear = imu["accel"] * FLU - [0.0, 0.0, G]
    yield "Linear Acceleration.csv", ",", "", clock | axes("Linear Acceleration {} (m/s^2)", linear)
    yield "Gyroscope.csv", ",", "", clock | axes("Gyroscope {} (rad/s)", imu["gyro"] * FLU)
    place = {"Time (s)": gnss["t"]} | where(gnss, "Latitude (°)", "Longitude (°)", "Height (m)")
    place |= speed(gnss, ("Velocity (m/s)", "Direction (°)"))
    yield "Location.csv", ",", "", place | accuracy(gnss, "Horizontal Accuracy (m)", "Vertical Accuracy (°)")


def phyphox_short(imu, gnss):
    """Newer names: the axes alone."""
    for name, separator, above, columns in phyphox(imu, gnss):
        short = {
            key.replace("Linear ", "").replace("Acceleration x", "X").replace("Acceleration y", "Y")
            .replace("Acceleration z", "Z").replace("Gyroscope x", "X").replace("Gyroscope y", "Y")
            .replace("Gyroscope z", "Z"): values
            for key, values in columns.items()
        }  # fmt: skip
        yield name, separator, above, short


@pytest.mark.parametrize("style", [sensor_logger, sensor_logger_ios, phyphox, phyphox_short])
def test_a_folder_with_a_table_for_each_sensor_is_joined(tmp_path, style, capsys):
    imu, gnss = drive()
    folder = tmp_path / "walk"
    folder.mkdir()
    write(folder, style(imu, gnss))
    other = {key: v - 864_000.0 for key, v in gnss.items() if key == "t"}  # another day
    *_, columns = list(style(imu, {**gnss, **other}))[-1]
    first = next(iter(columns))
    columns[first] = columns[first] - (8.64e14 if style in (sensor_logger, sensor_logger_ios) else 8.64e5)
    if style is not sensor_logger_ios:
        write(folder, [("Another day.csv", ",", "", columns)])
    assert main(["new", "log", str(folder)]) == 0, capsys.readouterr().err
    said = capsys.readouterr().out
    log = folder / "walk.toml"
    assert f"Wrote {log}" in "".join(said.split("\n"))
    found = read_records(load_log(str(log)))
    check(found, imu, gnss)
    assert_allclose(found.fixes.t, gnss["t"] - imu["t"][0], atol=1e-5)
    assert found.reported == "standard deviation"


def test_navigate_reads_a_folder(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    folder = tmp_path / "walk"
    folder.mkdir()
    write(folder, phyphox(*drive()))
    asked = ["navigate", str(folder), "--outages", "none", "--no-rrd", "-o", str(tmp_path / "out")]
    assert main(asked) in (0, 1), capsys.readouterr().err  # its course is found late
    assert (tmp_path / "out" / "result.json").exists()
    assert (folder / "walk.toml").exists()


def test_gyros_alone_and_two_imus_are_a_line(tmp_path, capsys):
    imu, gnss = drive()
    files = list(phyphox(imu, gnss))
    write(tmp_path, [one for one in files if one[0] not in ("Accelerometer.csv", "Linear Acceleration.csv")])
    assert main(["new", "log", str(tmp_path)]) == 2
    assert "no table with accelerometers; tables: Gyroscope.csv, Location.csv" in capsys.readouterr().err
    whole = {"t_s": imu["t"]} | axes("gyro_{}_rad_s", imu["gyro"]) | axes("accel_{}_m_s2", imu["accel"])
    write(tmp_path, [(name, ",", "", whole) for name in ("a.csv", "b.csv")])
    assert main(["new", "log", str(tmp_path)]) == 2
    assert "several tables have an IMU: a.csv, b.csv; name one of them" in capsys.readouterr().err


def test_forces_of_another_rate_keep_the_velocity_and_gaps_stay_gaps():
    """Forces at 250 Hz between gyros at 100 Hz: their integral is kept; in a gap they are unknown."""
    accel_t, gyro_t = np.arange(1, 2501) / 250.0 + 0.0013, np.arange(1, 1001) / 100.0
    accel = np.column_stack([np.sin(accel_t), np.cos(3 * accel_t), 9.8 + 0 * accel_t])
    rows = join_triads(gyro_t, np.zeros((1000, 3)), accel_t, accel, "phone")
    gained = np.cumsum(rows.values["accel"] * 0.01, axis=0)
    exact = np.column_stack([-np.cos(rows.t), np.sin(3 * rows.t) / 3, 9.8 * rows.t])
    assert_allclose(gained - gained[0], exact - exact[0], atol=4e-3)
    lost = (accel_t > 4.0) & (accel_t < 5.0)
    rows = join_triads(gyro_t, np.zeros((1000, 3)), accel_t[~lost], accel[~lost], "phone")
    unknown = rows.t[np.isnan(rows.values["accel"]).any(axis=1)]
    assert unknown.min() < 4.02
    assert unknown.max() > 4.98
    assert len(unknown) == pytest.approx(100, abs=2)


def test_fixes_frozen_in_motion_are_no_news(tmp_path, capsys):
    """A phone without reception repeats its last fix, speed included."""
    imu, gnss = drive()
    stuck = (gnss["t"] > 50.0) & (gnss["t"] < 55.0)
    last = np.flatnonzero(gnss["t"] <= 50.0)[-1]
    frozen = {name: rows.copy() for name, rows in gnss.items()}
    for name in ("lla", "vel_n"):
        frozen[name][stuck] = frozen[name][last]
    write(tmp_path, phyphox(imu, frozen))
    assert main(["new", "log", str(tmp_path)]) == 0, capsys.readouterr().err
    found = read_records(load_log(str(tmp_path / f"{tmp_path.name}.toml")))
    assert len(found.fixes) == len(gnss["t"]) - stuck.sum()
    assert [note for note in found.notes if "repeat the one before in motion and are left out" in note]


def test_a_table_without_names_is_a_line_that_says_so(tmp_path, capsys):
    """As the replay of PX4-ECL has it: time, name of the sensor, values."""
    rows = [f"{4000 * k},imu,-0.19,0.16,-9.93,0.0006,-0.005,-0.00003" for k in range(1, 50)]
    (tmp_path / "replay.csv").write_text("\n".join(rows))
    assert main(["new", "log", str(tmp_path / "replay.csv")]) == 2
    assert (
        "replay.csv: no line of column names; its first line is 4000, imu, -0.19" in capsys.readouterr().err
    )
