"""Every format of a log gives the recording that the table gives, and says what is wrong with a broken file.

The files are written here: with the library of the format, or from its documentation.
"""

from __future__ import annotations

import json
import resource
import struct
from datetime import datetime, timedelta
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from numpy.testing import assert_allclose
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from bench.cli.command_line import main
from bench.core.words.exceptions import ConfigError
from bench.io.config.log import load_log
from bench.io.logs.formats import bags
from bench.io.logs.log_records import read_records
from tests.exchange import drives

EPOCH = 1_751_000_000.0  # what a clock of ROS shows at t = 0 [s]
FLU = [1.0, -1.0, -1.0]


# --- writers ------------------------------------------------------------------------------------------


def rosbag(path: Path, made, ros2=True, plugin=StoragePlugin.SQLITE3, twist=True) -> Path:
    types = get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC)
    t_of = types.types
    rows: list[tuple[float, str, str, object]] = []

    def header(t):
        whole = int(t)
        nano = round((t - whole) * 1e9)
        time = t_of["builtin_interfaces/msg/Time"](sec=whole, nanosec=nano)
        more = {} if ros2 else {"seq": 0}
        return t_of["std_msgs/msg/Header"](stamp=time, frame_id="x", **more)

    def vector(v):
        return t_of["geometry_msgs/msg/Vector3"](*(float(x) for x in v))

    q, none9 = t_of["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0), np.zeros(9)
    imu, gnss, baro = made["imu"], made["gnss"], made["baro"]
    for k, t in enumerate(imu["t"] + EPOCH):
        message = t_of["sensor_msgs/msg/Imu"](
            header(t), q, none9, vector(imu["gyro"][k] * FLU), none9, vector(imu["accel"][k] * FLU), none9
        )
        rows.append((t, "/imu", "sensor_msgs/msg/Imu", message))
    for k, t in enumerate(gnss["t"] + EPOCH):
        lat, lon = np.rad2deg(gnss["lla"][k, :2])
        status = t_of["sensor_msgs/msg/NavSatStatus"](status=-1 if k == 7 else 0, service=1)
        variance = np.diag(np.square(drives.POS_SD[[1, 0, 2]])).ravel()
        fix = t_of["sensor_msgs/msg/NavSatFix"](header(t), status, lat, lon, gnss["lla"][k, 2], variance, 2)
        rows.append((t, "/gnss/fix", "sensor_msgs/msg/NavSatFix", fix))
        n, e, d = gnss["vel_n"][k]
        cov = np.zeros((6, 6))
        cov[:3, :3] = np.diag(np.square(drives.VEL_SD))
        moving = t_of["geometry_msgs/msg/TwistWithCovariance"](
            t_of["geometry_msgs/msg/Twist"](vector((e, n, -d)), vector((0, 0, 0))), cov.ravel()
        )
        kind = "geometry_msgs/msg/TwistWithCovarianceStamped"
        if twist:
            rows.append((t, "/gnss/vel", kind, t_of[kind](header(t), moving)))
    for k, t in enumerate(baro["t"] + EPOCH):
        ratio = 1.0 - 0.0065 * baro["alt"][k] / 288.15  # ISO 2533
        pressure = 101325.0 * ratio ** (9.80665 / 287.05287 / 0.0065)
        message = t_of["sensor_msgs/msg/FluidPressure"](header(t), float(pressure), 0.0)
        rows.append((t, "/baro", "sensor_msgs/msg/FluidPressure", message))
    writer = Ros2Writer(path, version=8, storage_plugin=plugin) if ros2 else Ros1Writer(path)
    with writer as bag:
        made_for: dict[str, object] = {}
        for t, topic, kind, message in sorted(rows, key=lambda row: row[0]):
            if topic not in made_for:
                made_for[topic] = bag.add_connection(topic, kind, typestore=types)
            raw = types.serialize_cdr(message, kind) if ros2 else types.serialize_ros1(message, kind)
            bag.write(made_for[topic], round(t * 1e9), raw)
    return path


def json_mcap(path: Path, made, compression=CompressionType.ZSTD) -> Path:
    def stamp(t):
        return {"sec": int(t), "nanosec": round((t - int(t)) * 1e9)}

    def xyz(v):
        return dict(zip("xyz", map(float, v), strict=True))

    with path.open("wb") as file:
        writer = McapWriter(file, compression=compression)
        writer.start()
        channels = {}
        for topic, kind in (
            ("/imu", "sensor_msgs/msg/Imu"),
            ("/fix", "sensor_msgs/msg/NavSatFix"),
            ("/vel", "geometry_msgs/msg/TwistStamped"),
            ("/baro", "sensor_msgs/msg/FluidPressure"),
        ):
            schema = writer.register_schema(kind, "jsonschema", b"{}")
            channels[topic] = writer.register_channel(topic, "json", schema)

        def add(topic, t, message):
            ns = round(t * 1e9)
            raw = json.dumps({"header": {"stamp": stamp(t)}, **message}).encode()
            writer.add_message(channels[topic], ns, raw, ns)

        imu, gnss, baro = made["imu"], made["gnss"], made["baro"]
        for k, t in enumerate(imu["t"] + EPOCH):
            add(
                "/imu",
                t,
                {
                    "angular_velocity": xyz(imu["gyro"][k] * FLU),
                    "linear_acceleration": xyz(imu["accel"][k] * FLU),
                },
            )
        for k, t in enumerate(gnss["t"] + EPOCH):
            lat, lon = np.rad2deg(gnss["lla"][k, :2])
            n, e, d = gnss["vel_n"][k]
            fix = {
                "latitude": lat,
                "longitude": lon,
                "altitude": gnss["lla"][k, 2],
                "status": {"status": -1 if k == 7 else 0},
            }
            variance = np.diag(np.square(drives.POS_SD[[1, 0, 2]])).ravel().tolist()
            add("/fix", t, {**fix, "position_covariance": variance, "position_covariance_type": 2})
            add("/vel", t, {"twist": {"linear": xyz((e, n, -d))}})
        for k, t in enumerate(baro["t"] + EPOCH):
            ratio = 1.0 - 0.0065 * baro["alt"][k] / 288.15
            add("/baro", t, {"fluid_pressure": 101325.0 * ratio ** (9.80665 / 287.05287 / 0.0065)})
        writer.finish()
    return path


ULOG_SENSORS = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;uint32_t gyro_integral_dt;"
    "float[3] accelerometer_m_s2;",
    "vehicle_imu": "uint64_t timestamp;uint64_t timestamp_sample;float[3] delta_angle;"
    "float[3] delta_velocity;uint32_t delta_angle_dt;uint32_t delta_velocity_dt;",
    "vehicle_gps_position": "uint64_t timestamp;double latitude_deg;double longitude_deg;"
    "double altitude_ellipsoid_m;float s_variance_m_s;float eph;float epv;float vel_n_m_s;float vel_e_m_s;"
    "float vel_d_m_s;uint8_t fix_type;uint8_t satellites_used;bool vel_ned_valid;",
    "sensor_gps": "uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt_ellipsoid;float s_variance_m_s;"
    "float eph;float epv;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;uint8_t fix_type;",
    "vehicle_air_data": "uint64_t timestamp;float baro_alt_meter;",
}


def ulog(path: Path, made, increments=False, old=False, measured=1.0) -> Path:
    """Bytes by docs.px4.io, ULog file format: header, flag bits, formats, subscriptions, data.

    Unless these are wanted, increments are there once a second, as telemetry, and wrong. ``measured``: part
    of the time between two rows of the IMU.
    """
    imu, gnss, baro = made["imu"], made["gnss"], made["baro"]
    between_us = round(1e6 * measured * float(np.median(np.diff(imu["t"]))))

    def message(kind: str, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), ord(kind)) + body

    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 0), message("B", bytes(40))]
    names = ["vehicle_imu" if increments else "sensor_combined"]
    names += ["sensor_gps" if old else "vehicle_gps_position", "vehicle_air_data"]
    names += [] if increments else ["vehicle_imu"]
    parts += [message("F", f"{name}:{ULOG_SENSORS[name]}".encode()) for name in names]
    parts += [message("A", struct.pack("<BH", 0, k) + name.encode()) for k, name in enumerate(names)]
    rows = []
    for k, t in enumerate(imu["t"]):
        us = round(t * 1e6)
        if increments:
            both = *imu["gyro"][k] * 0.008, *imu["accel"][k] * 0.009  # of intervals of their own
            body = struct.pack("<QQ6f2I", us + 400, us, *both, 8_000, 9_000)
        else:
            body = struct.pack("<Q3fI3f", us, *imu["gyro"][k], between_us, *imu["accel"][k])
            if k % 100 == 0:
                rows.append((us, struct.pack("<HQQ6f2I", 3, us, us, *np.ones(6), 8_000, 9_000)))
        rows.append((us, struct.pack("<H", 0) + body))
    h, v, s = np.sqrt(2) * drives.POS_SD[0], drives.POS_SD[2], np.sqrt(3) * drives.VEL_SD[0]
    for k, t in enumerate(gnss["t"]):
        us, fix = round(t * 1e6), 1 if k == 7 else 6
        lat, lon = np.rad2deg(gnss["lla"][k, :2])
        alt, vel = gnss["lla"][k, 2], gnss["vel_n"][k]
        if old:
            whole = (round(lat * 1e7), round(lon * 1e7), round(alt * 1e3))
            body = struct.pack("<Q3i6fB", us, *whole, s, h, v, *vel, fix)
        else:
            body = struct.pack("<Q3d6f2B?", us, lat, lon, alt, s, h, v, *vel, fix, 17, True)
        rows.append((us, struct.pack("<H", 1) + body))
    for t, alt in zip(baro["t"], baro["alt"], strict=True):
        us = round(t * 1e6)
        rows.append((us, struct.pack("<HQf", 2, us, alt)))
    parts += [message("D", body) for _, body in sorted(rows, key=lambda row: row[0])]
    path.write_bytes(b"".join(parts))
    return path


def navego(path: Path, made) -> Path:
    imu, gnss = made["imu"], made["gnss"]
    n = len(gnss["t"])
    lat, lon, h = gnss["lla"].T
    lat = np.where(np.arange(n) == 7, np.nan, lat)
    structures = {
        "imu": {"t": imu["t"], "wb": imu["gyro"], "fb": imu["accel"], "freq": 100.0},
        "gnss": {
            "t": gnss["t"], "lat": lat, "lon": lon, "h": h, "vel": gnss["vel_n"],
            "stdm": drives.POS_SD, "stdv": drives.VEL_SD, "larm": drives.ARM,
        },
    }  # fmt: skip
    savemat(path, structures, oned_as="column")
    return path


def kf_gins(folder: Path, made, velocity=True) -> None:
    imu, gnss = made["imu"], made["gnss"]
    np.savetxt(
        folder / "imu.txt", np.column_stack([imu["t"], imu["gyro"] * 0.01, imu["accel"] * 0.01]), fmt="%.12g"
    )
    n = len(gnss["t"])
    lla = np.column_stack([np.rad2deg(gnss["lla"][:, :2]), gnss["lla"][:, 2]])
    lla[7, 0] = np.nan
    sd = np.tile(drives.POS_SD, (n, 1))
    more = [gnss["vel_n"], sd, np.tile(drives.VEL_SD, (n, 1))] if velocity else [sd]
    np.savetxt(folder / "gnss.txt", np.column_stack([gnss["t"], lla, *more]), fmt="%.12g")


def rtklib(path: Path, made, week=False) -> Path:
    gnss = made["gnss"]
    lines = [
        "% program   : rnx2rtkp",
        "%  GPST latitude(deg) longitude(deg) height(m) Q ns sdn(m) sde(m) sdu(m) sdne(m) sdeu(m) sdun(m) "
        "age(s) ratio vn(m/s) ve(m/s) vu(m/s) sdvn sdve sdvu sdvne sdveu sdvun",
    ]
    for k, t in enumerate(gnss["t"]):
        lat, lon = np.rad2deg(gnss["lla"][k, :2])
        n, e, d = gnss["vel_n"][k]
        when = datetime(2025, 7, 8, 19, 34) + timedelta(seconds=float(t))
        seconds = (when - datetime(1980, 1, 6)).total_seconds()
        time = f"{seconds // 604800:.0f} {seconds % 604800:.3f}" if week else f"{when:%Y/%m/%d %H:%M:%S.%f}"
        lat = "nan" if k == 7 else f"{lat:.10f}"
        sd, sdv = (" ".join(f"{x:.4f}" for x in (*s, 0, 0, 0)) for s in (drives.POS_SD, drives.VEL_SD))
        place = f"{lat} {lon:.10f} {gnss['lla'][k, 2]:.6f} 1 14 {sd} 0.00 10.0"
        lines.append(f"{time} {place} {n:.9f} {e:.9f} {-d:.9f} {sdv}")
    path.write_text("\n".join(lines) + "\n")
    return path


# --- the same recording -------------------------------------------------------------------------------

SINCE_1980 = (datetime(2025, 7, 8, 19, 34) - datetime(1980, 1, 6)).total_seconds()
BARO = '[baro]\nfile = "{file}"\n{more}\n[sensors.assumed]\nbaro = "baro.toml"'


@pytest.fixture(scope="module")
def made():
    found = drives.sensed()
    found["imu"] = {name: values[:4000] for name, values in found["imu"].items()}
    return found


def log(folder, imu, gnss, baro=None, imu_more="", gnss_more=""):
    for name, sheet in (("imu", drives.IMU_SHEET), ("gnss", drives.GNSS_SHEET), ("baro", drives.BARO_SHEET)):
        (folder / f"{name}.toml").write_text(sheet)
    text = drives.LOG.replace('file = "imu.csv"', f'file = "{imu}"\n{imu_more}')
    text = text.replace('file = "gnss.csv"', f'file = "{gnss}"\n{gnss_more}')
    if baro:
        text = text.replace("[sensors.assumed]", BARO.format(file=baro, more=""))
    (folder / "drive.toml").write_text(text)
    return read_records(load_log(str(folder / "drive.toml")))


def same(found, made, single=False, whole=True):
    """Compare a recording with what it was made of; the seventh fix has none."""
    imu, gnss = made["imu"], made["gnss"]
    angle, speed, place = (2e-8, 2e-6, 2e-9) if single else (1e-10, 1e-8, 1e-11)
    assert_allclose(
        found.imu.t + found.origin, imu["t"] + found.origin - found.imu.t[0] - imu["t"][0], atol=2e-6
    )
    assert_allclose(found.imu.dtheta_b, imu["gyro"] * 0.01, atol=angle, rtol=1e-4)
    assert_allclose(found.imu.dvel_b, imu["accel"] * 0.01, atol=speed, rtol=1e-4)
    assert_allclose(found.fixes.t, gnss["t"] - imu["t"][0], atol=2e-6)
    assert list(np.flatnonzero(~found.fixes.valid)) == [7]
    good = found.fixes.valid
    assert_allclose(found.fixes.lla[good, :2], gnss["lla"][good, :2], atol=place)
    assert_allclose(found.fixes.lla[good, 2], gnss["lla"][good, 2], atol=1e-3)
    if whole:
        assert_allclose(found.fixes.vel_n[good], gnss["vel_n"][good], atol=2e-6)
    assert_allclose(
        np.sqrt(found.fixes.cov_pos_n[good][:, range(3), range(3)]),
        np.tile(drives.POS_SD, (good.sum(), 1)),
        rtol=1e-5,
    )


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("bag.bag", lambda p, m: rosbag(p, m, ros2=False)),
        ("bag2", rosbag),
        ("bag3", lambda p, m: rosbag(p, m, plugin=StoragePlugin.MCAP)),
        ("log.mcap", json_mcap),
    ],
)
def test_bags_of_ros_1_and_2_and_mcap(tmp_path, made, name, write):
    write(tmp_path / name, made)
    found = log(tmp_path, name, name, name, imu_more="mounting_deg = [180.0, 0.0, 0.0]")
    same(found, made)
    assert_allclose(found.instruments["baro"].alt_baro, made["baro"]["alt"], atol=1e-3)
    sd = np.sqrt(found.fixes.cov_vel_n[0, 0, 0])
    assert sd == pytest.approx(drives.VEL_SD[0])


def test_an_mcap_file_of_a_ros_2_bag_is_read_by_itself(tmp_path, made):
    """By mcap and the definitions in the file, and by rosbags: the same."""
    rosbag(tmp_path / "bag", made, plugin=StoragePlugin.MCAP)
    (tmp_path / "bag" / "bag.mcap").rename(tmp_path / "one.mcap")
    same(log(tmp_path, "one.mcap", "one.mcap", imu_more="mounting_deg = [180.0, 0.0, 0.0]"), made)


@pytest.mark.parametrize(("increments", "old"), [(False, False), (True, True)])
def test_ulog_of_px4(tmp_path, made, increments, old):
    ulog(tmp_path / "log.ulg", made, increments, old)
    found = log(tmp_path, "log.ulg", "log.ulg", "log.ulg", gnss_more="quality = [6]")
    same(found, made, single=True)
    off = found.instruments["baro"].alt_baro - made["baro"]["alt"]
    assert_allclose(off, off[0], atol=1e-3)  # set to the height by the fixes
    early = made["gnss"]["t"] < 10.0
    assert abs(np.median((found.instruments["baro"].alt_baro - made["gnss"]["lla"][:, 2])[early])) < 0.1
    if not old:
        assert set(found.fixes.satellites) == {17}


def test_an_imu_that_measured_little_of_the_time_is_refused(tmp_path, made):
    """Rows of 0.4 ms every 10 ms tell nothing of what is between them."""
    ulog(tmp_path / "log.ulg", made, measured=0.04)
    said = refused(tmp_path, "log.ulg")
    assert (
        "log.ulg: sensor_combined has 100 rows a second, which measured 4 % of the time between them" in said
    )


def test_structures_of_navego(tmp_path, made):
    navego(tmp_path / "n.mat", made)
    told = 'format = "navego"'
    same(log(tmp_path, "n.mat", "n.mat", imu_more=told, gnss_more=told), made)


@pytest.mark.parametrize("velocity", [True, False])
def test_text_of_kf_gins(tmp_path, made, velocity):
    kf_gins(tmp_path, made, velocity)
    told = 'format = "kf-gins"'
    found = log(tmp_path, "imu.txt", "gnss.txt", imu_more=told, gnss_more=told)
    same(found, made, whole=velocity)
    assert np.isnan(found.fixes.vel_n).all() != velocity


@pytest.mark.parametrize("week", [True, False])
def test_a_solution_of_rtklib(tmp_path, made, week):
    """Its times are GPS seconds since 1980; the table of the IMU says where its own begin."""
    rtklib(tmp_path / "r.pos", made, week)
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(made["imu"]))
    found = log(
        tmp_path, "imu.csv", "r.pos", imu_more=f"time_offset_s = {SINCE_1980}", gnss_more="quality = [1]"
    )
    same(found, made)
    assert found.origin == pytest.approx(SINCE_1980 + made["imu"]["t"][0])
    assert set(found.fixes.satellites) == {14}


@pytest.mark.parametrize(("system", "late"), [("GPST", 0), ("UTC", 18), ("JST", 18 - 9 * 3600)])
def test_times_of_rtklib_become_gps_times(tmp_path, made, system, late):
    """By their header; a comma or semicolon may separate, and heights above the geoid are told."""
    path = rtklib(tmp_path / "r.pos", made)
    text = path.read_text().replace("%  GPST ", f"%  {system} ").replace(" ", ",;"[late > 0])
    path.write_text("\ufeff% (lat/lon/height=WGS84/geodetic,Q=1:fix)\n" + text, encoding="utf-8")
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(made["imu"]))
    found = log(tmp_path, "imu.csv", "r.pos", imu_more=f"time_offset_s = {SINCE_1980 + late}")
    assert_allclose(found.fixes.t, made["gnss"]["t"] - made["imu"]["t"][0], atol=2e-6)
    assert_allclose(found.fixes.vel_n, made["gnss"]["vel_n"], atol=2e-6)
    told = [note.partition(" its heights")[0] for note in found.notes]
    assert told == [
        "r.pos:",
        *([f"r.pos: {late:+d} s from {system}, which its header names, to GPS time"] * (late != 0)),
    ]


# --- what a file cannot be ----------------------------------------------------------------------------


def refused(folder, imu, gnss="gnss.csv", **more) -> str:
    if gnss == "gnss.csv":
        drives.write_csv(folder / gnss, drives.gnss_columns(drives.sensed()["gnss"]))
    with pytest.raises(ConfigError) as caught:
        log(folder, imu, gnss, **more)
    assert len(caught.value.messages) == 1
    assert len(caught.value.messages[0].splitlines()) == 1
    return caught.value.messages[0]


@pytest.mark.parametrize("name", ["x.ulg", "x.bag", "x.mcap", "x.db3", "x.mat"])
@pytest.mark.parametrize("content", [b"", b"garbage" * 1000, bytes(5000)])
def test_what_is_no_such_file_gets_one_line(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    assert refused(tmp_path, name, imu_more='format = "navego"' if name == "x.mat" else "").startswith(
        f"{name}: "
    )


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
@pytest.mark.parametrize("name", ["x.bag", "x.mcap", "x.ulg", "x.mat"])
def test_a_truncated_file_is_read_as_far_as_it_goes_or_refused_in_one_line(tmp_path, made, name, share):
    """Half a ULog, cut off by a crash, is still a log: its format is made for that."""
    write = {
        "x.bag": lambda p, m: rosbag(p, m, ros2=False),
        "x.mcap": json_mcap,
        "x.ulg": ulog,
        "x.mat": navego,
    }
    path = write[name](tmp_path / name, made)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    more = {"imu_more": 'format = "navego"'} if name == "x.mat" else {}
    if name == "x.ulg":
        drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(made["gnss"]))
        found = log(tmp_path, name, "gnss.csv")
        assert 0.5 * share * 4000 < len(found.imu) <= 4000
        assert_allclose(found.imu.dvel_b, made["imu"]["accel"][: len(found.imu)] * 0.01, atol=1e-6)
        return
    assert refused(tmp_path, name, **more).startswith(f"{name}: ")


def test_bytes_changed_at_random_never_end_in_a_traceback(tmp_path, made):
    """160 files with 1 to 50 bytes changed: a recording, or one line."""
    random = np.random.default_rng(11)
    short = {
        "imu": {k: v[:40] for k, v in made["imu"].items()},
        "gnss": {k: v[:3] for k, v in made["gnss"].items()},
        "baro": {k: v[:3] for k, v in made["baro"].items()},
    }
    drives.write_csv(tmp_path / "gnss.csv", drives.gnss_columns(made["gnss"]))
    kinds = {"x.mcap": json_mcap, "x.ulg": ulog, "x.mat": navego}
    kinds["x.bag"] = lambda p, m: rosbag(p, m, ros2=False)
    for name, write in kinds.items():
        whole = write(tmp_path / name, short).read_bytes()
        for _ in range(40):
            spoiled = bytearray(whole)
            for at in random.integers(0, len(whole), random.integers(1, 50)):
                spoiled[at] = random.integers(0, 256)
            (tmp_path / name).write_bytes(bytes(spoiled))
            more = 'format = "navego"' if name == "x.mat" else ""
            messages: tuple[str, ...] = ("read",)
            try:
                log(tmp_path, name, "gnss.csv", imu_more=more)
            except ConfigError as error:
                messages = error.messages
            assert len(messages) == 1


@pytest.mark.skipif(not hasattr(psutil.Process, "rlimit"), reason="the limit is that of Linux")
def test_a_chunk_that_unpacks_to_more_than_the_limit_is_one_line(tmp_path, monkeypatch):
    """A few kilobytes that hold 100 MB of blanks; with room for them the file itself is what is wrong."""
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = McapWriter(file, compression=CompressionType.ZSTD, chunk_size=1)
        writer.start()
        schema = writer.register_schema("sensor_msgs/msg/Imu", "jsonschema", b"{}")
        channel = writer.register_channel("/imu", "json", schema)
        writer.add_message(channel, 0, b" " * 100_000_000, 0)
        writer.finish()
    assert path.stat().st_size < 100_000
    before = resource.getrlimit(resource.RLIMIT_AS)
    assert "cannot be read: Expecting value" in refused(tmp_path, "x.mcap")
    monkeypatch.setattr(bags, "MOST_UNPACKED", 30_000_000)
    said = "x.mcap: unpacks to more than the 30 MB it may take in memory"
    assert refused(tmp_path, "x.mcap") == said
    assert resource.getrlimit(resource.RLIMIT_AS) == before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "no rows"),
        (b"1 2 3\n", "has 7 columns or more; this has 3"),
        (b"1 0 0 0 0 0 0\n2 0 0 zero 0 0 0\n", "row 2: '2 0 0 zero 0 0 0' is not a row of numbers"),
        (b"1 0 0 0 0 0 0\n2 0 0 0\n", "row 2 has 4 columns, not 7"),
        (b"1 " * 5000, "row 1 is longer than 4096 characters"),
        (b"\xff\xfe\x00", "not a text file"),
    ],
)
def test_text_that_cannot_be_is_refused_with_its_row(tmp_path, content, words):
    (tmp_path / "i.txt").write_bytes(content)
    assert words in refused(tmp_path, "i.txt", imu_more='format = "kf-gins"')


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("2025/07/08 19:34:18 40 -105 1600 1 20\n", "no line that names the columns"),
        (
            "% GPST latitude(deg) longitude(deg) height(m)\nnow 40 -105 1600\n",
            "row 1: 'now 40 -105 1600' is not a time and numbers",
        ),
        (
            "% GPST latitude(deg) longitude(deg)\n2025/07/08 19:34:18 40 -105\n",
            "no columns latitude, longitude, height",
        ),
        (
            "% GPST latitude(d'\") longitude(d'\") height(m)\n2025/07/08 19:34:18 40 -105 5\n",
            "must be in degrees",
        ),
        (
            "% GPST latitude(deg) longitude(deg) height(m)\n2025/07/08 19:34:18 40 -105\n",
            "row 1 has 3 columns, not 4",
        ),
    ],
)
def test_a_solution_that_cannot_be_is_refused_with_its_row(tmp_path, text, words):
    drives.write_csv(tmp_path / "imu.csv", drives.imu_columns(drives.sensed()["imu"]))
    (tmp_path / "r.pos").write_text(text)
    assert words in refused(tmp_path, "imu.csv", "r.pos")


def test_a_topic_that_is_not_there_or_not_alone_is_named(tmp_path, made):
    rosbag(tmp_path / "bag", {**made, "imu": {k: v[:100] for k, v in made["imu"].items()}})
    said = refused(tmp_path, "bag", imu_more='topic = "/gnss/fix"')
    assert (
        "topic '/gnss/fix' holds no sensor_msgs/msg/Imu; there are /baro (sensor_msgs/msg/FluidPressure)"
        in said
    )
    ulog(tmp_path / "log.ulg", made)
    assert "no rows of sensor_accel" in refused(tmp_path, "log.ulg", imu_more='topic = "sensor_accel"')
    assert "NaveGo has no structure for a barometer" in refused_baro(tmp_path)


def refused_baro(folder):
    """Ask a file of NaveGo for a barometer."""
    navego(folder / "n.mat", drives.sensed())
    drives.write_log(folder)
    text = drives.LOG.replace("[sensors.assumed]", BARO.format(file="n.mat", more='format = "navego"'))
    (folder / "drive.toml").write_text(text)
    spec = load_log(str(folder / "drive.toml"))
    with pytest.raises(ConfigError) as caught:
        read_records(spec)
    return str(caught.value)


def test_a_file_beyond_the_stated_size_is_refused_without_reading_it(tmp_path):
    """Two gigabytes that are not there: a sparse file."""
    for name, more in (
        ("x.csv", ""),
        ("x.txt", 'format = "kf-gins"'),
        ("x.ulg", ""),
        ("x.bag", ""),
        ("x.mcap", ""),
    ):
        with (tmp_path / name).open("wb") as file:
            file.truncate(2_100_000_000)
        assert "larger than " in refused(tmp_path, name, imu_more=more)
        (tmp_path / name).unlink()


def test_a_log_of_another_tool_is_navigated(tmp_path, capsys):
    """From ULog to the table of metrics."""
    made = drives.sensed()
    ulog(tmp_path / "log.ulg", made)
    made["gnss"] = made["baro"] = None
    for name, sheet in (("imu", drives.IMU_SHEET), ("gnss", drives.GNSS_SHEET)):
        (tmp_path / f"{name}.toml").write_text(sheet)
    (tmp_path / "drive.toml").write_text(
        drives.LOG.replace("imu.csv", "log.ulg").replace("gnss.csv", "log.ulg")
    )
    assert main(["navigate", str(tmp_path / "drive.toml"), "-o", str(tmp_path / "out"), "--no-rrd"]) == 0
    metrics = json.loads((tmp_path / "out" / "result.json").read_text())["metrics"]["loose-15"]
    assert metrics["pos_rmse_h_m"] < 0.05


def test_covariances_of_messages_are_east_north_up_and_stamps_within_a_millisecond_are_one():
    def stamp(t):
        return SimpleNamespace(stamp=SimpleNamespace(sec=int(t), nanosec=round(t % 1 * 1e9)))

    def xyz(*values):
        return SimpleNamespace(**dict(zip("xyz", values, strict=True)))

    fixes, twists = [], []
    for t, kind, status, late in ((7.25, 2, 0, -0.0008), (8.25, 0, 1, 0.0015), (9.25, 1, -1, 0.0008)):
        fixes.append(bags.read_fix(SimpleNamespace(
            header=stamp(t), latitude=47.0, longitude=-8.0, altitude=500.0,
            position_covariance=[4.0, 0.1, 0.2, 0.3, 9.0, 0.4, 0.5, 0.6, 25.0],
            position_covariance_type=kind, status=SimpleNamespace(status=status),
        )))  # fmt: skip
        covariance = np.diag([0.04, 0.09, 0.16, 7.0, 8.0, 9.0]).ravel()
        moving = SimpleNamespace(linear=xyz(3.0, 2.0, 1.0))
        twists.append(bags.read_twist(SimpleNamespace(
            header=stamp(t + late), twist=SimpleNamespace(twist=moving, covariance=covariance)
        )))  # fmt: skip
    rows = bags.make_fixes(np.array(fixes), np.array(twists[::-1]))
    assert_allclose(rows.t, [7.25, 8.25, 9.25])
    assert_allclose(rows.values["lla"][:2], [[np.deg2rad(47.0), np.deg2rad(-8.0), 500.0]] * 2)
    assert np.isnan(rows.values["lla"][2]).all()
    assert_allclose(rows.values["sd_pos"], [[3.0, 2.0, 5.0], [np.nan] * 3, [3.0, 2.0, 5.0]])
    assert_allclose(rows.values["vel_n"], [[2.0, 3.0, -1.0], [np.nan] * 3, [2.0, 3.0, -1.0]])
    assert_allclose(rows.values["sd_vel"], [[0.3, 0.2, 0.4], [np.nan] * 3, [0.3, 0.2, 0.4]])
