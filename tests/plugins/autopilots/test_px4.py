"""ULogs of PX4: cuts of real logs and of simulations, read as pyulog alone has them."""

from __future__ import annotations

import contextlib
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from pyulog import ULog

from bench.cli.command_line import main
from bench.core.mathematics.earth import difference_n
from bench.core.words.exceptions import WRONG, ConfigError
from bench.io import results
from bench.io.config.log import SourceSpec, load_log
from bench.io.logs import formats, own_estimate
from bench.io.logs.log_records import read_records
from bench.plugins.autopilots import ulog, ulog_motion
from bench.plugins.autopilots.ulog import find_undulation, measure_cover
from tests.plugins.autopilots.test_dataflash import FLIGHTS


def raw(name: str, message: str) -> dict[str, np.ndarray]:
    """Columns of a message, by pyulog."""
    (found,) = [
        one.data for one in ULog(str(FLIGHTS / name)).data_list if one.name == message and one.multi_id == 0
    ]
    return found


@pytest.mark.parametrize("name", ["sitl.ulg", "sitl-truth.ulg"])
def test_the_imu_is_the_stream_that_covers_the_time(name):
    """vehicle_imu is there, too, twice a second, and no IMU at all."""
    rows, own = formats.read("ulog", FLIGHTS / name, "imu", None), raw(name, "sensor_combined")
    assert len(rows.t) == len(own["timestamp"]) > 50 * len(raw(name, "vehicle_imu")["timestamp"])
    for axis in range(3):
        assert_allclose(rows.values["gyro"][:, axis], own[f"gyro_rad[{axis}]"], rtol=1e-6)
    with pytest.raises(ConfigError, match="vehicle_imu has 2 rows a second"):
        formats.read("ulog", FLIGHTS / name, "imu", "vehicle_imu:0")


def test_fixes_are_as_old_as_the_parameter_says():
    rows, own = (
        formats.read("ulog", FLIGHTS / "sitl.ulg", "gnss", None),
        raw("sitl.ulg", "vehicle_gps_position"),
    )
    assert_allclose(rows.values["arrival"], 1e-6 * own["timestamp"])
    assert_allclose(rows.values["arrival"] - rows.t, 0.11, atol=1e-6)
    assert any("by EKF2_GPS_DELAY" in note for note in rows.notes)
    assert_allclose(rows.values["sd_pos"][:, 0] * 2**0.5, own["eph"], rtol=1e-6)


def test_a_magnetometer_is_in_tesla():
    rows = formats.read("ulog", FLIGHTS / "sitl.ulg", "mag", None)
    assert 30e-6 < np.linalg.norm(rows.values["field_b"], axis=1).mean() < 65e-6  # of the Earth


def test_an_imu_that_does_not_cover_the_time_is_refused_in_a_line(tmp_path, capsys):
    shutil.copy(FLIGHTS / "decimated.ulg", tmp_path)
    assert main(["navigate", str(tmp_path / "decimated.ulg")]) == WRONG
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert "8.6 rows a second, which measured 3.8 % of the time" in said
    assert not (tmp_path / "decimated.toml").exists()


def test_the_estimate_of_ekf2_with_its_claims():
    own = own_estimate.read_estimate(SourceSpec(FLIGHTS / "sitl.ulg", "ulog"), None)
    local, states = raw("sitl.ulg", "vehicle_local_position"), raw("sitl.ulg", "estimator_states")
    t, variance = own.variances
    known = np.isfinite(own.motion.lla).all(axis=1)
    assert_allclose(own.motion.t, 1e-6 * local["timestamp_sample"], rtol=1e-12)
    assert_allclose(variance[:, 0] + variance[:, 1], np.square(local["eph"]), rtol=1e-5)
    home = np.array([np.deg2rad(local["ref_lat"][-1]), np.deg2rad(local["ref_lon"][-1]), 0.0])
    ned = difference_n(own.motion.lla[known], np.broadcast_to(home, (known.sum(), 3)))
    assert_allclose(ned[-5:, :2], np.column_stack([local["x"], local["y"]])[known][-5:], atol=1e-3)
    # PX4 of 2024 has three angles first: the covariance of the heading is the third number
    late = t > 1e-6 * states["timestamp_sample"][-1]
    assert_allclose(variance[late, 8], states["covariances[2]"][-1], rtol=1e-6)
    assert set(own.innovations.sensor) >= {"gnss_position", "gnss_velocity", "baro"}
    one = raw("sitl.ulg", "estimator_innovations")["gps_hvel[0]"]
    mine = own.innovations.z[
        (own.innovations.code == own.innovations.sensor.index("gnss_velocity"))
        & (own.innovations.component == 0)
    ]
    assert np.isin(np.float32(mine), one).all()


def test_the_truth_of_a_simulator_judges(tmp_path, capsys):
    shutil.copy(FLIGHTS / "sitl-truth.ulg", tmp_path)
    path = tmp_path / "sitl-truth.ulg"
    assert main(["navigate", str(path), "-o", str(tmp_path / "out"), "--no-rrd"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "evaluated by the reference, sitl-truth.ulg" in said
    (metrics,) = results.read_result(tmp_path / "out").metrics.values()
    assert metrics["heading_rmse_deg"] < 1.0  # which no fix shows
    log = load_log(str(tmp_path / "sitl-truth.toml"))
    records = read_records(log)
    truth = own_estimate.read_truth(log.imu)
    at = np.interp(records.fixes.t[-1] + records.origin, truth.t, truth.lla[:, 0])
    assert_allclose(records.fixes.lla[-1, 0], at, atol=1e-8)


@pytest.mark.parametrize("field", ["ref_alt", "z_valid", "x", "xy_reset_counter", "latitude_deg"])
def test_a_log_whose_messages_lack_a_field_is_read_or_gets_a_line(tmp_path, field):
    path, name = tmp_path / "x.ulg", field.encode()
    whole = (FLIGHTS / "sitl-truth.ulg").read_bytes()
    path.write_bytes(whole.replace(b" " + name + b";", b" " + name[:-1] + b"Z;"))
    source = SourceSpec(path, "ulog")
    for look in (
        lambda: own_estimate.look("ulog", path),
        lambda: own_estimate.read_truth(source),
        lambda: own_estimate.read_estimate(source, None),
    ):
        with contextlib.suppress(ConfigError):
            look()


def test_a_parameter_that_is_no_number_is_none(tmp_path):
    path = tmp_path / "x.ulg"
    whole = (FLIGHTS / "sitl.ulg").read_bytes()
    path.write_bytes(whole.replace(b"float EKF2_GPS_DELAY", b"char8 EKF2_GPS_DELAY"))
    assert path.read_bytes() != whole
    notes = formats.read("ulog", path, "gnss", None).notes
    assert not any("EKF2_GPS_DELAY" in note for note in notes)


def test_rows_of_one_instant_have_a_cover():
    data = {"gyro_integral_dt": np.full(5, 4000.0)}
    assert measure_cover(np.array([0.0, 0.0, 0.0, 0.0, 1.0]), data) == 1.0
    assert measure_cover(0.004 * np.arange(5), data) == pytest.approx(1.0)
    assert measure_cover(0.4 * np.arange(5), data) == pytest.approx(0.01)


def make_log(*messages, **parameters):
    """Return what pyulog reads: messages as (name, instance, times [s], columns)."""
    found = [
        SimpleNamespace(
            name=name,
            multi_id=instance,
            data={"timestamp": 1e6 * np.array(t), **{key: np.array(one) for key, one in columns.items()}},
        )
        for name, instance, t, columns in messages
    ]
    return SimpleNamespace(data_list=found, initial_parameters=parameters, message_formats={})


T = [1.0, 2.0, 3.0]


def make_local(ref_alt=400.0, **columns):
    return {
        "x": [20.0, 21.0, 22.0], "y": [-30.0, -31.0, -32.0], "z": [-7.0, -17.0, -27.0],
        "vx": [1.0] * 3, "vy": [2.0] * 3, "vz": [-0.5] * 3,
        "ref_lat": [47.0] * 3, "ref_lon": [8.0] * 3, "ref_alt": [ref_alt] * 3, **columns,
    }  # fmt: skip


@pytest.mark.parametrize(
    ("ref_alt", "place", "height"),
    [(400.0, None, 448.0), (0.0, (418.0, 427.0, 436.5), 458.0), (0.0, None, 48.0)],
)
def test_a_truth_counts_from_its_reference_or_the_height_beside_it(ref_alt, place, height):
    """The geoid is 48 m over the ellipsoid."""
    messages = [("vehicle_local_position_groundtruth", 0, T, make_local(ref_alt))]
    messages += [] if place is None else [("vehicle_global_position_groundtruth", 0, T, {"alt": place})]
    found = ulog_motion.read_truth(make_log(*messages), 48.0, 777.0)
    home = np.array([np.deg2rad(47.0), np.deg2rad(8.0), height])
    ned = difference_n(found.lla, np.broadcast_to(home, (3, 3)))
    assert_allclose(ned, [[20.0, -30.0, -7.0], [21.0, -31.0, -17.0], [22.0, -32.0, -27.0]], atol=1e-3)
    assert_allclose(found.vel_n[0], [1.0, 2.0, -0.5])
    flat = make_local(0.0, z=[0.0] * 3)
    found = ulog_motion.read_truth(make_log((ulog_motion.TRUTH, 0, T, flat)), 48.0, 777.0)
    assert_allclose(found.lla[:, 2], 777.0)


def test_claims_of_the_elements_of_a_quaternion_and_innovations_of_old_firmware():
    """Level to the north phi = 2 (q1, q2, q3), to the south 2 (q2, q1, q0) but for signs."""
    own = [9e-5, 1e-4, 2e-4, 3e-4, 0.1, 0.2, 0.3, 1.5, 2.5]
    z, S = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6], [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    old = {f"vel_pos_innov[{k}]": [z[k]] * 3 for k in range(6)}
    old |= {f"vel_pos_innov_var[{k}]": [S[k]] * 3 for k in range(6)}
    old |= {f"mag_innov[{k}]": [z[k] + 1.0] * 3 for k in range(3)}
    old |= {f"mag_innov_var[{k}]": [S[k] + 10.0] * 3 for k in range(3)}
    valid = {"xy_valid": [1, 1, 0], "z_valid": [1, 0, 1]}
    claims = {"eph": [2.0] * 3, "epv": [3.0] * 3, "evh": [0.6] * 3, "evv": [0.5] * 3}
    attitude = {"q[0]": [1.0, 0.0, 0.0], "q[3]": [0.0, 1.0, 1.0], "q[1]": [0.0] * 3, "q[2]": [0.0] * 3}
    bias = {f"{of}_bias[{k}]": [n + k] * 3 for of, n in (("gyro", 1.0), ("accel", 4.0)) for k in range(3)}
    log = make_log(
        ("vehicle_local_position", 0, T, make_local(**valid, **claims, z_reset_counter=[0, 0, 1])),
        ("vehicle_attitude", 0, T, {**attitude, "quat_reset_counter": [0, 1, 1]}),
        ("estimator_selector_status", 0, T, {"primary_instance": [1, 1, 0]}),
        ("estimator_status", 1, T, {f"covariances[{k}]": [v] * 3 for k, v in enumerate(own)}),
        ("estimator_sensor_bias", 1, T, bias),
        ("ekf2_innovations", 1, T, old),
    )
    found = ulog_motion.read_estimate(log, None, 48.0)
    assert np.isfinite(found.motion.lla).all(axis=1).tolist() == [True, False, False]
    assert_allclose(found.variances[1][:, :6], [[2.0, 2.0, 9.0, 0.18, 0.18, 0.25]] * 3)
    assert_allclose(found.variances[1][:2, 6:], [[4e-4, 8e-4, 12e-4], [8e-4, 4e-4, 3.6e-4]])
    assert_allclose(found.biases[1], [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]] * 3)
    table = found.innovations
    rows = {name: table.code == k for k, name in enumerate(table.sensor)}
    for name, z_of, S_of in (
        ("gnss_velocity", z[:3], S[:3]),
        ("gnss_position", z[3:], S[3:]),
        ("magnetometer", [1.1, 1.2, 1.3], [11.0, 12.0, 13.0]),
    ):
        assert_allclose(table.z[rows[name]], z_of)
        assert_allclose(table.S[rows[name]], S_of)
    assert [(row[0], row[2], row[3]) for row in found.events] == [
        (2.0, "reset", "attitude"),
        (3.0, "lane", "instance 0 after 1"),
        (3.0, "reset", "height"),
    ]


def test_the_undulation_is_that_of_fixes_with_both_heights():
    sea = [100_000, 400_000, 410_000, 420_000, 430_000, 440_000]
    ellipsoid = [999_000, 448_000, 458_500, 467_000, 0, 0]
    fix_type = [1, 3, 4, 5, 3, 3]
    gps = {"alt": sea, "alt_ellipsoid": ellipsoid, "fix_type": fix_type}
    assert find_undulation(make_log(("sensor_gps", 0, np.arange(6.0), gps))) == pytest.approx(48.0)
    meters = {"altitude_msl_m": [400.0, 410.0], "altitude_ellipsoid_m": [447.0, 458.0], "fix_type": [3, 3]}
    log = make_log(("vehicle_gps_position", 0, [1.0, 2.0], meters))
    assert find_undulation(log) == pytest.approx(47.5)


def test_a_range_is_good_downward_within_its_limits():
    data = {
        "current_distance": [3.0, 0.1, 9.0, 4.0, 5.0], "min_distance": [0.2] * 5, "max_distance": [8.0] * 5,
        "orientation": [25, 25, 25, 24, 25], "signal_quality": [90, 90, 90, 90, 0],
    }  # fmt: skip
    found = ulog.read_radar({name: np.array(column) for name, column in data.items()})
    assert found["valid"].tolist() == [1.0, 0.0, 0.0, 0.0, 0.0]
    assert found["height"].tolist() == data["current_distance"]


def test_samples_of_an_accelerometer_are_moved_to_those_of_the_gyro():
    gyro = {"x": [0.1, 0.2, 0.3], "y": [0.4, 0.5, 0.6], "z": [0.7, 0.8, 0.9]}
    accel = {"x": [1.0, 2.0, 4.0], "y": [5.0, 7.0, 8.0], "z": [-9.0, -9.5, -9.8]}
    log = make_log(("sensor_gyro", 0, T, gyro), ("sensor_accel", 0, [9.0] * 3, accel))
    log.data_list[1].data["timestamp_sample"] = 1e6 * np.array([0.5, 1.5, 2.5])
    found = ulog.read_imu(log, "sensor_gyro", 0, log.data_list[0].data)
    assert_allclose(found["gyro"], np.column_stack([gyro["x"], gyro["y"], gyro["z"]]))
    assert_allclose(found["accel"], [[1.5, 6.0, -9.25], [3.0, 7.5, -9.65], [4.0, 8.0, -9.8]])
    log.data_list[0].data["gyro_clipping"] = np.array([0, 2, 0])
    assert ulog.read_imu(log, "sensor_gyro", 0, log.data_list[0].data)["valid"].tolist() == [1.0, 0.0, 1.0]
