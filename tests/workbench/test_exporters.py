"""Tables as other programs write them: read right without a question, or asked for, and never read wrong."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.words.exceptions import WRONG
from bench.io.config.log import load_log
from bench.io.logs.log_records import read_records
from tests.exchange import drives

G = 9.80665
LENGTH = 60.0  # of the drive that is written [s]
UP = np.array([1.0, -1.0, -1.0])  # forward, right, down -> forward, left, up
EPOCH = 1_700_000_000  # [s]


def drive():
    """The drive of the tests, shorter: t, gyro, accel, and the fixes held at the rate of the IMU."""
    made = drives.sensed()
    imu = {name: rows[made["imu"]["t"] <= LENGTH] for name, rows in made["imu"].items()}
    gnss = {name: rows[made["gnss"]["t"] <= LENGTH] for name, rows in made["gnss"].items()}
    return imu, gnss


def hold(gnss, t):
    """Return the fixes as a table at the rate of the IMU repeats them."""
    row = np.maximum(np.searchsorted(gnss["t"], t + 1e-9, "right") - 1, 0)
    return {name: rows[row] for name, rows in gnss.items()}


def axes(pattern, values, places="xyz"):
    """Columns of three axes."""
    return {pattern.format(a): values[:, k] for k, a in enumerate(places)}


def where(gnss, lat, lon, alt):
    """Columns of a position in degrees."""
    deg = np.rad2deg(gnss["lla"][:, :2])
    return {lat: deg[:, 0], lon: deg[:, 1], alt: gnss["lla"][:, 2]}


def vectornav_gps(gnss):
    columns = {"TimeStartup": np.round(1e9 * gnss["t"]) + 5e9}
    columns |= where(gnss, "gnss1PosLat", "gnss1PosLon", "gnss1PosAlt")
    return "gps.csv", ",", "", columns | axes("gnss1VelNed{}", gnss["vel_n"], "XYZ")


def vectornav(imu, gnss):
    yield (
        "imu.csv",
        ",",
        "",
        (
            {"TimeStartup": np.round(1e9 * imu["t"]) + 5e9}
            | axes("UncompAccel{}", imu["accel"], "XYZ")
            | axes("UncompGyro{}", imu["gyro"], "XYZ")
            | {"Temperature": 30.0 + 0 * imu["t"], "Pressure": 101.0 + 0 * imu["t"]}
        ),
    )
    yield vectornav_gps(gnss)


def vectornav_increments(imu, gnss):
    dt = np.diff(imu["t"], prepend=0.0)[:, None]
    yield (
        "imu.csv",
        ",",
        "",
        (
            {"timeStartup": np.round(1e9 * imu["t"]), "deltaTime": dt[:, 0]}
            | axes("deltaTheta{}", np.rad2deg(imu["gyro"] * dt), "XYZ")
            | axes("deltaVel{}", imu["accel"] * dt, "XYZ")
            | where(hold(gnss, imu["t"]), "gnss1PosLat", "gnss1PosLon", "gnss1PosAlt")
            | axes("gnss1Vel{}", hold(gnss, imu["t"])["vel_n"], "XYZ")
        ),
    )


def xsens(imu, gnss):
    held = hold(gnss, imu["t"])
    above = "// Start Time: Unknown\n// Update Rate: 100.0Hz\n// Firmware Version: 4.0.2\n"
    yield (
        "MT.txt",
        "\t",
        above,
        (
            {"PacketCounter": np.arange(len(imu["t"])), "SampleTimeFine": np.round(1e4 * imu["t"]) + 7e5}
            | axes("Acc_{}", imu["accel"] * UP, "XYZ")
            | axes("Gyr_{}", imu["gyro"] * UP, "XYZ")
            | axes("Mag_{}", 0.3 + 0 * imu["gyro"], "XYZ")
            | where(held, "Latitude", "Longitude", "Altitude")
            | axes("Vel_{}", held["vel_n"][:, [1, 0, 2]] * [1.0, 1.0, -1.0], "XYZ")
        ),
    )


def sbg(imu, gnss):
    yield (
        "imu.txt",
        "\t",
        "",
        (
            {"timestamp": np.round(1e6 * imu["t"]), "status": 0 * imu["t"]}
            | axes("accel{}", imu["accel"], "XYZ")
            | axes("gyro{}", np.rad2deg(imu["gyro"]), "XYZ")
            | {"temperature": 30.0 + 0 * imu["t"]}
        ),
        "(us) (na) (m.s^-2) (m.s^-2) (m.s^-2) (deg.s^-1) (deg.s^-1) (deg.s^-1) (degC)",
    )
    yield (
        "gps1Pos.txt",
        "\t",
        "",
        (
            {
                "timestamp": np.round(1e6 * gnss["t"]),
                "status": 0 * gnss["t"],
                "gpsTow": np.round(1e3 * gnss["t"]),
            }
            | where(gnss, "latitude", "longitude", "altitude")
            | {f"{name}Std": 0.5 + 0 * gnss["t"] for name in ("latitude", "longitude", "altitude")}
        ),
        "(us) (na) (ms) (deg) (deg) (m) (m) (m) (m)",
    )


def advanced_navigation(imu, gnss):
    def stamp(t):
        return {"Unix Time": EPOCH + np.floor(t), "Microseconds": np.round(1e6 * (t % 1.0))}

    yield (
        "RawSensors.csv",
        ",",
        "",
        (
            stamp(imu["t"])
            | axes("Accelerometer {}", imu["accel"], "XYZ")
            | axes("Gyroscope {}", imu["gyro"], "XYZ")
            | axes("Magnetometer {}", 300.0 + 0 * imu["gyro"], "XYZ")
        ),
    )
    yield (
        "RawGNSS.csv",
        ",",
        "",
        (
            stamp(gnss["t"])
            | where(gnss, "Latitude", "Longitude", "Height")
            | {f"Velocity {w}": gnss["vel_n"][:, k] for k, w in enumerate(("North", "East", "Down"))}
        ),
    )


def u_blox(imu, gnss):
    yield (
        "imu.csv",
        ",",
        "",
        (
            {"iTOW_ms": 1e3 * imu["t"]}
            | axes("gyro_{}_dps", np.rad2deg(imu["gyro"]))
            | axes("acc_{}_g", imu["accel"] / G)
        ),
    )
    deg = np.round(np.rad2deg(gnss["lla"][:, :2]) * 1e7)
    yield (
        "nav-pvt.csv",
        ",",
        "",
        (
            {"iTOW": np.round(1e3 * gnss["t"]), "year": 2026 + 0 * gnss["t"], "fixType": 3 + 0 * gnss["t"]}
            | {"numSV": 20 + 0 * gnss["t"], "lon": deg[:, 1], "lat": deg[:, 0]}
            | {"height": np.round(1e3 * gnss["lla"][:, 2]), "hMSL": np.round(1e3 * gnss["lla"][:, 2]) - 48000}
            | {"hAcc": 20 + 0 * gnss["t"], "vAcc": 40 + 0 * gnss["t"]}
            | {f"vel{a}": np.round(1e3 * gnss["vel_n"][:, k]) for k, a in enumerate("NED")}
        ),
    )


def ros_echo(imu, gnss):
    def stamp(t):
        stamps = np.round(1e9 * (EPOCH + t))
        return {"%time": stamps + 1e6, "field.header.seq": np.arange(len(t)), "field.header.stamp": stamps}

    yield (
        "imu.csv",
        ",",
        "",
        (
            stamp(imu["t"])
            | {"field.header.frame_id": None}
            | axes("field.orientation.{}", 0 * np.ones((len(imu["t"]), 4)), "xyzw")
            | {"field.orientation_covariance0": -1.0 + 0 * imu["t"]}
            | axes("field.angular_velocity.{}", imu["gyro"] * UP)
            | {"field.angular_velocity_covariance0": 0.1 + 0 * imu["t"]}
            | axes("field.linear_acceleration.{}", imu["accel"] * UP)
            | {"field.linear_acceleration_covariance0": 0.1 + 0 * imu["t"]}
        ),
    )
    yield (
        "fix.csv",
        ",",
        "",
        (
            stamp(gnss["t"])
            | {"field.header.frame_id": None, "field.status.status": 0 * gnss["t"]}
            | where(gnss, "field.latitude", "field.longitude", "field.altitude")
            | {f"field.position_covariance{k}": 0.1 + 0 * gnss["t"] for k in range(9)}
        ),
    )


def plotjuggler(imu, gnss):
    held = hold(gnss, imu["t"])
    yield (
        "all.csv",
        ",",
        "",
        (
            {"__time": EPOCH + imu["t"]}
            | axes("/imu/data/angular_velocity/{}", imu["gyro"] * UP)
            | axes("/imu/data/linear_acceleration/{}", imu["accel"] * UP)
            | where(held, "/fix/latitude", "/fix/longitude", "/fix/altitude")
        ),
    )


def euroc(imu, gnss):
    names = [f"w_RS_S_{a} [rad s^-1]" for a in "xyz"], [f"a_RS_S_{a} [m s^-2]" for a in "xyz"]
    yield (
        "data.csv",
        ",",
        "",
        (
            {"#timestamp [ns]": np.round(1e9 * (EPOCH + imu["t"]))}
            | {name: imu["gyro"][:, k] * UP[k] for k, name in enumerate(names[0])}
            | {name: imu["accel"][:, k] * UP[k] for k, name in enumerate(names[1])}
        ),
    )
    yield (
        "gnss.csv",
        ",",
        "",
        (
            {"#timestamp [ns]": np.round(1e9 * (EPOCH + gnss["t"]))}
            | where(gnss, "latitude [deg]", "longitude [deg]", "altitude [m]")
        ),
    )


def androsensor(imu, gnss):
    held = hold(gnss, imu["t"])
    yield (
        "Sensor_record.csv",
        ";",
        "",
        (
            {f"ACCELEROMETER {a} (m/s²)": UP[k] * imu["accel"][:, k] for k, a in enumerate("XYZ")}
            | {f"LINEAR ACCELERATION {a} (m/s²)": 0.1 + 0 * imu["t"] for a in "XYZ"}
            | {f"GRAVITY {a} (m/s²)": 3.0 + 0 * imu["t"] for a in "XYZ"}
            | {f"GYROSCOPE {a} (rad/s)": UP[k] * imu["gyro"][:, k] for k, a in enumerate("XYZ")}
            | where(held, "LOCATION Latitude : ", "LOCATION Longitude : ", "LOCATION Altitude ( m)")
            | {"Time since start in ms ": np.round(1e3 * imu["t"])}
        ),
    )


def physics_toolbox(imu, gnss):
    held = hold(gnss, imu["t"])
    yield (
        "phone.csv",
        ",",
        "",
        (
            {"time": imu["t"]}
            | axes("gF{}", imu["accel"] * UP / G)
            | axes("a{}", 0.1 + 0 * imu["accel"])
            | axes("w{}", imu["gyro"] * UP)
            | where(held, "Latitude", "Longitude", "Altitude")
            | {"Speed (m/s)": np.hypot(*held["vel_n"][:, :2].T)}
        ),
    )


def gnss_ins_sim(imu, gnss):
    yield (
        "imu.csv",
        ",",
        "",
        (
            {"time (sec)": imu["t"]}
            | axes("gyro_{} (deg/s)", np.rad2deg(imu["gyro"]))
            | axes("accel_{} (m/s^2)", imu["accel"])
        ),
    )
    yield (
        "gps-0.csv",
        ",",
        "",
        (
            {"gps_time (sec)": gnss["t"]}
            | where(gnss, "gps_lat (deg)", "gps_lon (deg)", "gps_alt (m)")
            | {f"gps_v{a} (m/s)": gnss["vel_n"][:, k] for k, a in enumerate("NED")}
        ),
    )


def bare(imu, gnss):
    held = hold(gnss, imu["t"])
    yield (
        "log.csv",
        ",",
        "",
        (
            {"timestamp": np.round(1e6 * imu["t"])}
            | axes("a{}", imu["accel"])
            | axes("g{}", np.rad2deg(imu["gyro"]))
            | where(held, "lat", "lon", "alt")
        ),
    )


def ulog2csv(imu, gnss):
    yield (
        "sensor_combined_0.csv",
        ",",
        "",
        (
            {"timestamp": np.round(1e6 * imu["t"])}
            | {f"gyro_rad[{k}]": imu["gyro"][:, k] for k in range(3)}
            | {"gyro_integral_dt": 1e4 + 0 * imu["t"]}
            | {f"accelerometer_m_s2[{k}]": imu["accel"][:, k] for k in range(3)}
        ),
    )
    deg = np.round(np.rad2deg(gnss["lla"][:, :2]) * 1e7)
    yield (
        "vehicle_gps_position_0.csv",
        ",",
        "",
        (
            {"timestamp": np.round(1e6 * gnss["t"]), "time_utc_usec": np.round(1e6 * (EPOCH + gnss["t"]))}
            | {"lat": deg[:, 0], "lon": deg[:, 1], "alt": np.round(1e3 * gnss["lla"][:, 2]) - 48000}
            | {"alt_ellipsoid": np.round(1e3 * gnss["lla"][:, 2])}
            | {f"vel_{a}_m_s": gnss["vel_n"][:, k] for k, a in enumerate("ned")}
        ),
    )


def microstrain(imu, gnss):
    held = hold(gnss, imu["t"])
    yield (
        "gx5.csv",
        ",",
        "",
        (
            {"Time": EPOCH + imu["t"]}
            | axes("inertial-6251.scaledAccel{}", imu["accel"] / G, "XYZ")
            | axes("inertial-6251.scaledGyro{}", imu["gyro"], "XYZ")
            | axes("inertial-6251.deltaVel{}", imu["accel"] / G / 100.0, "XYZ")
            | where(
                held,
                "inertial-6251.latitude",
                "inertial-6251.longitude",
                "inertial-6251.heightAboveEllipsoid",
            )
        ),
    )


def microstrain_messages(imu, gnss):
    """SensorConnect with a session above the table, a row for each message; fixes have rows of their own."""
    session = "FILE_INFO\nListSeparator=comma\n\nSESSION_INFO\nStartTime,02/10/2017 16:13:52\n\nDATA_START\n"
    held = hold(gnss, imu["t"])
    new = np.diff(held["t"], prepend=-1.0) != 0
    place = where(
        {"lla": np.where(new[:, None], held["lla"], np.nan)}, "Lat [x8103]", "Long [x8103]", "Height [x8103]"
    )
    yield (
        "sensorconnect.csv",
        ",",
        session,
        (
            {"GPS TFlags": 7 + 0 * imu["t"], "GPS Week": 1935 + 0 * imu["t"], "GPS TOW": 403_575.0 + imu["t"]}
            | axes("{} Accel [x8004]", imu["accel"] / G, "XYZ")
            | axes("{} Gyro [x8005]", imu["gyro"], "XYZ")
            | place
        ),
    )


def vectornav_instinct(imu, gnss):
    """INSTINCT's export of a VectorNav: the names behind the group of the message."""
    yield (
        "imu.csv",
        ",",
        "",
        (
            {"Time [s]": imu["t"], "Time::TimeStartup [ns]": np.round(1e9 * imu["t"]) + 5e9}
            | axes("IMU::UncompAccel::{} [m/s^2]", imu["accel"], "XYZ")
            | axes("IMU::UncompGyro::{} [rad/s]", imu["gyro"], "XYZ")
        ),
    )
    yield vectornav_gps(gnss)


STYLES = (
    *(vectornav, vectornav_increments, xsens, sbg, advanced_navigation, u_blox, ros_echo, plotjuggler),
    *(euroc, androsensor, physics_toolbox, gnss_ins_sim, bare, ulog2csv, microstrain),
    *(microstrain_messages, vectornav_instinct),
)
WITH_VELOCITY = {
    vectornav,
    vectornav_instinct,
    vectornav_increments,
    advanced_navigation,
    u_blox,
    gnss_ins_sim,
    ulog2csv,
}


def write(folder, tables):
    """Write the tables of a style; return the first, which has the IMU."""
    first = None
    for name, separator, above, columns, *units in tables:
        count = max(len(rows) for rows in columns.values() if rows is not None)
        text = [["base_link"] * count if r is None else [f"{v:.16g}" for v in r] for r in columns.values()]
        lines = [separator.join(columns)]
        lines += [separator.join(line.split()) for line in units]
        lines += [separator.join(row) for row in zip(*text, strict=True)]
        (folder / name).write_text(above + "\n".join(lines) + "\n", encoding="utf-8")
        first = first or folder / name
    return first


@pytest.mark.parametrize("style", STYLES, ids=lambda style: style.__name__)
def test_a_style_is_read_right_without_a_question(tmp_path, style, capsys):
    imu, gnss = drive()
    path = write(tmp_path, style(imu, gnss))
    assert main(["new", "log", str(path)]) == 0, capsys.readouterr().err
    found = read_records(load_log(str(path.with_suffix(".toml"))))
    assert_allclose(found.imu.t, imu["t"] - imu["t"][0], atol=2e-5)
    assert_allclose(found.imu.dtheta_b / found.imu.dt[:, None], imu["gyro"], atol=1e-6)
    assert_allclose(found.imu.dvel_b / found.imu.dt[:, None], imu["accel"], atol=2e-5)
    assert_allclose(found.fixes.lla[-1], gnss["lla"][-1], atol=6e-4)
    assert_allclose(found.fixes.lla[-1, :2], gnss["lla"][-1, :2], atol=2e-9)
    if style in WITH_VELOCITY:
        assert_allclose(found.fixes.vel_n[-1], gnss["vel_n"][-1], atol=6e-4)
    text = path.with_suffix(".toml").read_text()
    assert not [line for line in text.splitlines() if "right?" in line and "gyro" in line]


def test_gyros_that_nothing_explains_are_asked_for(tmp_path, capsys):
    """At rest no motion tells degrees from radians; the option does."""
    rng, t = np.random.default_rng(2), np.arange(1, 4001) / 100.0
    rate = 1e-3 * rng.normal(size=(4000, 3))
    columns = {"t_s": t} | axes("gyr{}", np.rad2deg(rate))
    columns |= axes("acc{}", np.array([0.0, 0.0, -9.80]) + 1e-3 * rng.normal(size=(4000, 3)))
    drives.write_csv(tmp_path / "imu.csv", columns)
    fixes = {"t": t[::100], "lla": np.tile(drives.sensed()["gnss"]["lla"][0], (40, 1))}
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(fixes | {"vel_n": np.zeros((40, 3))}))
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == WRONG
    assert "gyrx, gyry, gyrz: rad or deg? Neither names nor" in capsys.readouterr().err
    assert not (tmp_path / "imu.toml").exists()
    assert main(["new", "log", str(tmp_path / "imu.csv"), "--rates", "deg"]) == 0
    found = read_records(load_log(str(tmp_path / "imu.toml")))
    assert_allclose(found.imu.dtheta_b / found.imu.dt[:, None], rate, atol=1e-6)


def test_accelerations_without_gravity_are_no_specific_forces(tmp_path, capsys):
    """As phones give them; the size alone would pass for g."""
    imu, gnss = drive()
    columns = {"t_s": imu["t"]} | axes("gyro_{}_rad_s", imu["gyro"])
    drives.write_csv(tmp_path / "imu.csv", columns | axes("acc{}", imu["accel"] + [0.0, 0.0, 9.81]))
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(gnss))
    assert main(["new", "log", str(tmp_path / "imu.csv")]) == WRONG
    assert "accx, accy, accz: not gravity in m/s^2, g or mg" in capsys.readouterr().err
