"""Runs as logs of PX4: definitions of a log of the user's, byte for byte, and rows read back by pyulog."""

from __future__ import annotations

import contextlib
import re
import struct
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from pyulog import ULog

import bench
from bench.cli.command_line import main
from bench.core.records.instruments import HeadingData, MagData
from bench.core.words.exceptions import WRONG, ConfigError
from bench.io import exports
from bench.io.config.log import load_log
from bench.io.logs import formats as imports
from bench.io.logs import own_estimate
from bench.io.logs.log_records import read_records
from bench.plugins.autopilots.ulog_replay import read_definitions
from bench.simulation.signals.air import pressure_altitude
from tests.exchange.exported import INVALID, make_run
from tests.plugins.autopilots.test_dataflash import FLIGHTS

OWN = {
    "sensor_combined": "uint64_t timestamp;float[3] gyro_rad;float gyro_integral_dt;"
    "int32_t accelerometer_timestamp_relative;float[3] accelerometer_m_s2;float accelerometer_integral_dt;",
    "vehicle_gps_position": "uint64_t timestamp;int32_t lat;int32_t lon;int32_t alt;int32_t alt_ellipsoid;"
    "float s_variance_m_s;float eph;float epv;float vel_n_m_s;float vel_e_m_s;float vel_d_m_s;float heading;"
    "uint8_t fix_type;bool vel_ned_valid;uint8_t satellites_used;uint8_t[5] _padding0;",
    "ekf2_timestamps": "uint64_t timestamp;int16_t gps_timestamp_rel;int16_t airspeed_timestamp_rel;",
    "nested": "uint64_t timestamp;esc_report[8] esc;",
}
"""Messages of firmware before 1.12: degrees in units of 1e-7, durations in seconds."""

MORE = {
    "vehicle_magnetometer": "uint64_t timestamp;float[3] magnetometer_ga;",
    "vehicle_air_data": "uint64_t timestamp;float baro_alt_meter;float baro_temp_celcius;"
    "float baro_pressure_pa;float rho;",
    "vehicle_land_detected": "uint64_t timestamp;bool landed;",
}


def write_own(path, formats=OWN, parameters=(("EKF2_GPS_DELAY", 110.0), ("EKF2_GPS_POS_X", 9.0))):
    """Write a log with definitions alone, and bytes that follow them."""
    parts = [b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 1)]
    bodies = [(b"B", bytes(8) + b"\x01" + bytes(31))]
    bodies += [(b"F", f"{name}:{fields}".encode()) for name, fields in formats.items()]
    bodies += [(b"I", bytes([len(b"char[3] sys_name")]) + b"char[3] sys_namePX4")]
    for name, value in parameters:
        key = f"float {name}".encode()
        bodies.append((b"P", bytes([len(key)]) + key + struct.pack("<f", value)))
    parts += [struct.pack("<Hc", len(body), kind) + body for kind, body in bodies]
    path.write_bytes(b"".join(parts) + struct.pack("<HcBH", 18, b"A", 0, 0) + b"sensor_combined")
    return path


def list_definitions(path, kinds=b"F"):
    raw, at, found = path.read_bytes(), 16, []
    while at + 3 <= len(raw):
        size, kind = struct.unpack_from("<HB", raw, at)
        if kind in kinds:
            found.append(raw[at : at + 3 + size])
        at += 3 + size
    return found


@pytest.fixture
def made(tmp_path):
    _, sensed = make_run(tmp_path / "run")
    return tmp_path / "run", sensed.data


@pytest.mark.parametrize("name", ["sitl.ulg", "sitl-truth.ulg"])
def test_a_run_comes_back_from_the_log_of_another_firmware(made, tmp_path, name):
    run, data = made
    out = bench.export_run(run, "ulog", out=tmp_path / "out", like=FLIGHTS / name)
    path = out / "run.ulg"
    assert list_definitions(path) == list_definitions(FLIGHTS / name)
    assert not ULog(str(path)).file_corruption
    assert main(["new", "log", str(path)]) == 0
    log = load_log(str(path.with_suffix(".toml")))
    found, last = read_records(log), len(data.imu)
    assert_allclose(found.imu.dtheta_b[1:], data.imu.dtheta_b[1:last], rtol=1e-5, atol=1e-9)
    assert_allclose(found.imu.dvel_b[1:], data.imu.dvel_b[1:last], rtol=1e-5, atol=1e-8)
    kept = np.delete(np.arange(len(data.fixes)), INVALID)
    assert_allclose(found.fixes.lla[:, :2], data.fixes.lla[kept, :2], atol=1e-9)
    assert_allclose(found.fixes.lla[:, 2], data.fixes.lla[kept, 2], atol=1e-3)
    assert_allclose(found.fixes.t + found.origin - 10.0, data.fixes.t[kept], atol=2e-6)
    assert_allclose(found.fixes.vel_n, data.fixes.vel_n[kept], atol=1e-5)
    spread = np.sqrt(np.einsum("mii->mi", data.fixes.cov_pos_n[kept]))
    mine = np.sqrt(np.einsum("mii->mi", found.fixes.cov_pos_n))
    assert_allclose(mine[:, 2], spread[:, 2], rtol=1e-5)
    baro = found.instruments["baro"]
    assert_allclose(baro.alt_baro - baro.alt_baro[0], data.baro.alt_baro - data.baro.alt_baro[0], atol=2e-3)


def test_old_firmware_gets_its_own_units_and_stamps(made, tmp_path):
    """Before 1.12: units of 1e-7 deg, seconds; a fix is stamped when it arrives, Replay asks by 0.1 ms."""
    run, data = made
    like = write_own(tmp_path / "own.ulg")
    out = bench.export_run(run, "ulog", out=tmp_path / "out", like=like)
    assert list_definitions(out / "run.ulg") == list_definitions(like)
    rows = {one.name: one.data for one in ULog(str(out / "run.ulg")).data_list}
    gps, imu, asked = (rows[name] for name in ("vehicle_gps_position", "sensor_combined", "ekf2_timestamps"))
    kept = np.delete(np.arange(len(data.fixes)), INVALID)
    fixes = data.fixes.take(kept)
    assert_array_equal(gps["lat"], np.rint(1e7 * np.rad2deg(fixes.lla[:, 0])))
    assert_array_equal(gps["alt"], np.rint(1e3 * fixes.lla[:, 2]))
    assert_allclose(1e-6 * gps["timestamp"] - 10.0, fixes.t_arrival, atol=1e-6)
    assert_allclose(imu["gyro_integral_dt"], data.imu.dt, rtol=1e-6)
    assert np.isnan(gps["heading"]).all()
    assert (asked["airspeed_timestamp_rel"] == 32767).all()
    told = asked["gps_timestamp_rel"] != 32767
    assert told.sum() == np.sum(gps["timestamp"] <= imu["timestamp"][-1])
    for stamp, apart in zip(asked["timestamp"][told], asked["gps_timestamp_rel"][told], strict=True):
        assert (gps["timestamp"] // 100 == stamp // 100 + apart).sum() == 1


def test_parameters_of_antenna_and_delay_are_those_of_the_run(made, tmp_path):
    run, data = made
    like = write_own(
        tmp_path / "own.ulg", parameters=(("EKF2_GPS_DELAY", 1.0), ("EKF2_GPS_POS_X", 9.0), ("MINE", 7.0))
    )
    out = bench.export_run(run, "ulog", out=tmp_path / "out", like=like)
    found = ULog(str(out / "run.ulg")).initial_parameters
    assert found["EKF2_GPS_POS_X"] == pytest.approx(float(data.antenna_b[0]))
    late = 1e3 * np.median(data.fixes.t_arrival - data.fixes.t)
    assert found["EKF2_GPS_DELAY"] == pytest.approx(late, rel=1e-6)
    assert found["MINE"] == 7.0
    assert len(list_definitions(out / "run.ulg", b"I")) == 1


def test_what_a_firmware_does_not_define_is_left_out_and_named(made, tmp_path):
    out = bench.export_run(made[0], "ulog", out=tmp_path / "out", like=write_own(tmp_path / "own.ulg"))
    text = " ".join((out / "README.md").read_text().split())
    assert "not written: sensor_selection, vehicle_air_data" in text
    assert "No autopilot has replayed this file" in text


@pytest.mark.parametrize(
    ("given", "says"),
    [
        (["--to", "ulog"], "name a log of your own firmware, --like OWN.ulg"),
        (["--to", "csv", "--like", "{own}"], "takes no definitions of another file; leave --like out"),
        (["--to", "ulog", "--like", "{text}"], "not a ULog"),
        (["--to", "ulog", "--like", "{none}"], "none.ulg"),
        (["--to", "ulog", "--like", "{poor}"], "it does not define sensor_combined nor vehicle_gps_position"),
    ],
)
def test_a_wrong_log_is_refused_in_a_line(made, tmp_path, capsys, given, says):
    (tmp_path / "text.ulg").write_text("hello")
    write_own(tmp_path / "poor.ulg", formats={"a": "uint64_t timestamp;"})
    places = {name: str(tmp_path / f"{name}.ulg") for name in ("own", "text", "none", "poor")}
    write_own(tmp_path / "own.ulg")
    words = [one.format(**places) for one in given]
    assert main(["export", str(made[0]), *words, "-o", str(tmp_path / "out")]) == WRONG
    said = capsys.readouterr().err
    assert says in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("seed", range(40))
def test_damaged_definitions_end_in_a_line(tmp_path, seed):
    """Bytes are overwritten, or the end is cut off."""
    rng, raw = np.random.default_rng(seed), bytearray(write_own(tmp_path / "own.ulg").read_bytes())
    if seed % 2:
        raw = raw[: rng.integers(16, len(raw))]
    else:
        for at in rng.integers(16, len(raw), 6):
            raw[at] = rng.integers(256)
    (tmp_path / "own.ulg").write_bytes(raw)
    with contextlib.suppress(ConfigError):
        read_definitions(tmp_path / "own.ulg")


@pytest.mark.parametrize(
    ("message", "fields", "says"),
    [
        ("sensor_combined", "float gyro_rad;", "sensor_combined.gyro_rad holds 1 numbers, not 3"),
        ("sensor_combined", "float[x] gyro_rad;", "it does not define sensor_combined"),
        ("vehicle_gps_position", "float[3] eph;", "vehicle_gps_position.eph holds 3 numbers, not 1"),
        ("wide", "".join(f"double[999] b{k};" for k in range(8)), "wide is too long for a message"),
    ],
)
def test_fields_of_another_shape_are_refused_in_a_line(made, tmp_path, message, fields, says):
    own = write_own(tmp_path / "own.ulg", formats={**OWN, message: f"uint64_t timestamp;{fields}"})
    with pytest.raises(ConfigError, match=re.escape(says)):
        bench.export_run(made[0], "ulog", out=tmp_path / "out", like=own)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("told_sd", [np.deg2rad(0.4), np.nan])
def test_a_heading_of_two_antennas_goes_out_and_comes_back(made, tmp_path, told_sd):
    """It turns through south and is lost in the middle."""
    run, _ = made
    found = exports.gather(run)
    t = np.arange(0.02, 20.0, 0.5)
    heading = 0.1 * t + 2.5
    valid = (t < 8.0) | (t > 11.0)
    own = HeadingData(t=t, t_arrival=t, valid=valid, heading=heading, sd=np.full(len(t), told_sd))
    like = write_own(tmp_path / "own.ulg", formats={
        **OWN, "vehicle_gps_position": OWN["vehicle_gps_position"].replace(
            "float heading;", "float heading;float heading_accuracy;"),
    })  # fmt: skip
    told = replace(found, instruments={**found.instruments, "heading": own}, like=like)
    (tmp_path / "out").mkdir()
    exports.write(tmp_path / "out", "ulog", told, "run")
    path = tmp_path / "out" / "run.ulg"
    rows = imports.read("ulog", path, "heading", None)
    back = rows.values["heading"]
    known = np.isfinite(back)
    at = rows.t[known] - 10.0
    assert 10 < known.sum() < len(back)
    assert not ((at > 8.1) & (at < 10.9)).any()
    near = np.argmin(np.abs(at[:, None] - t), axis=1)
    assert_allclose(np.angle(np.exp(1j * (back[known] - heading[near]))), 0.0, atol=1e-6)
    assert (np.abs(back[known]) <= np.pi).all()
    assert (back[known] < 0).any()
    assert ("sd" in rows.values) == np.isfinite(told_sd)
    if np.isfinite(told_sd):
        assert_allclose(rows.values["sd"][known], told_sd, rtol=1e-6)
    fixes = imports.read("ulog", path, "gnss", None)
    assert_allclose(rows.t, fixes.t)
    assert_allclose(rows.values["arrival"], fixes.values["arrival"])
    assert "heading" in own_estimate.look("ulog", path).sensors
    plain = bench.export_run(run, "ulog", out=tmp_path / "plain", like=like)
    assert "heading" not in own_estimate.look("ulog", plain / "run.ulg").sensors
    with pytest.raises(ConfigError, match="no rows of vehicle_gps_position or sensor_gps"):
        imports.read("ulog", plain / "run.ulg", "heading", None)


LATE = 0.1137  # of the fixes [s], no whole number of samples


def test_every_field_is_in_its_unit_and_sign(made, tmp_path):
    """Late fixes of which some have no velocity, and a magnetometer; the vehicle stands for five seconds."""
    run, data = made
    found = exports.gather(run)
    t, fixes = data.imu.t[::10], found.fixes
    speed = np.where(fixes.t < 5.0, 0.1, 10.0)
    vel_n = np.column_stack([speed, -0.5 * speed, 0.2 * speed])
    vel_n[-3:] = np.nan
    cov_vel_n = np.tile(np.diag([0.01, 0.04, 0.09]), (len(fixes), 1, 1))
    fixes = replace(fixes, vel_n=vel_n, cov_vel_n=cov_vel_n, t_arrival=fixes.t + LATE)
    field = np.column_stack([2e-5 + 0.0 * t, -1e-5 + 0.0 * t, 4e-5 + 0.0 * t])
    mag = MagData(t=t, t_arrival=t, valid=np.ones(len(t), bool), field_b=field, sd=np.ones(len(t)))
    own = write_own(tmp_path / "own.ulg", formats={**OWN, **MORE})
    told = replace(found, fixes=fixes, instruments={**found.instruments, "mag": mag}, like=own)
    (tmp_path / "out").mkdir()
    exports.write(tmp_path / "out", "ulog", told, "run")
    log = ULog(str(tmp_path / "out" / "run.ulg"))
    rows = {one.name: one.data for one in log.data_list}
    gps, asked = rows["vehicle_gps_position"], rows["ekf2_timestamps"]
    good = fixes.take(fixes.valid)
    assert_allclose(1e-6 * gps["timestamp"] - 10.0, good.t + LATE, atol=1e-6)
    assert log.initial_parameters["EKF2_GPS_DELAY"] == pytest.approx(1e3 * LATE)
    assert_allclose(gps["s_variance_m_s"], np.sqrt(0.14), rtol=1e-6)
    known = np.isfinite(good.vel_n).all(axis=1)
    assert_array_equal(gps["vel_ned_valid"], known)
    assert_allclose(gps["vel_e_m_s"][known], good.vel_n[known, 1], rtol=1e-6)
    assert_array_equal(rows["vehicle_land_detected"]["landed"], good.t < 5.0)
    for k, gauss in enumerate((0.2, -0.1, 0.4)):
        assert_allclose(rows["vehicle_magnetometer"][f"magnetometer_ga[{k}]"], gauss, rtol=1e-6)
    air = {name: np.asarray(column, float) for name, column in rows["vehicle_air_data"].items()}
    pressure, temperature = air["baro_pressure_pa"], air["baro_temp_celcius"] + 273.15
    assert_allclose(pressure_altitude(pressure), air["baro_alt_meter"], atol=0.02)
    assert_allclose(air["rho"], pressure / (287.053 * temperature), rtol=1e-4)
    told = asked["gps_timestamp_rel"] != 32767
    assert (asked["gps_timestamp_rel"][told] <= 0).all()  # a fix is there before the sample that takes it
    assert (asked["gps_timestamp_rel"][told] > -101).all()
    for stamp, apart in zip(asked["timestamp"][told], asked["gps_timestamp_rel"][told], strict=True):
        assert (gps["timestamp"] // 100 == stamp // 100 + apart).sum() == 1


def test_durations_are_microseconds_where_the_layout_holds_whole_numbers(made, tmp_path):
    """From 1.12 on; the filters of Replay divide by them."""
    run, data = made
    whole = OWN["sensor_combined"].replace("float gyro_integral_dt", "uint32_t gyro_integral_dt")
    whole = whole.replace("float accelerometer_integral_dt", "uint32_t accelerometer_integral_dt")
    own = write_own(tmp_path / "own.ulg", formats={**OWN, "sensor_combined": whole})
    out = bench.export_run(run, "ulog", out=tmp_path / "out", like=own)
    (imu,) = [one.data for one in ULog(str(out / "run.ulg")).data_list if one.name == "sensor_combined"]
    for name in ("gyro_integral_dt", "accelerometer_integral_dt"):
        assert_allclose(1e-6 * imu[name], data.imu.dt, atol=0.5e-6)
    assert_allclose(imu["gyro_rad[1]"], data.imu.dtheta_b[:, 1] / data.imu.dt, rtol=1e-5, atol=1e-7)
