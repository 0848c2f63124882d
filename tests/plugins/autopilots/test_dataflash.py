"""Logs of ArduPilot and of PX4 before 2017: records, sensors, damage."""

import contextlib
import datetime
import struct
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.cli.command_line import main
from bench.core.words.exceptions import WRONG, ConfigError
from bench.io.config.log import SourceSpec
from bench.io.logs import formats, own_estimate
from bench.plugins.autopilots.dataflash import DataFlash
from bench.plugins.autopilots.flash_rows import look
from tests.plugins.autopilots.flash import HEAD, unpack, write_flash

FLIGHTS = Path(__file__).parents[2] / "logs" / "flights"
IMU = ("QBffffff", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")
GPS = ("QBBIHBcLLefff", "TimeUS,I,Status,GMS,GWk,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ")
GPA = ("QBCCCCBIHf", "TimeUS,I,VDop,HAcc,VAcc,SAcc,VV,SMS,Delta,Und")
PARM = ("QNf", "TimeUS,Name,Value")


def read(path: Path, kind: str, topic: str | None = None):
    return formats.read("dataflash", path, kind, topic)


def fix(t_us: int, status=3, lat=-35.0, spd=10.0, course=30.0, vz=-1.0, instance=0):
    return ("GPS", (t_us, instance, status, 1000, 2300, 9, 1.5, lat, 149.0, 600.0, spd, course, vz))


@pytest.mark.parametrize("name", ["copter.bin", "quad.px4log"])
def test_every_number_is_that_of_an_independent_reader(name):
    log, found = DataFlash(FLIGHTS / name), {}
    for record, at, values in unpack(FLIGHTS / name):
        found.setdefault(record, []).append((at, values))
    assert set(log.names) == set(found) - {"FMT"}
    for record in log.names:
        starts, rows = zip(*found[record], strict=True)
        assert log.find_starts(record).tolist() == list(starts)
        for label, column in log.read(record).items():
            if column.ndim == 1:
                assert_allclose(column, [row[label] for row in rows], rtol=1e-12)
    assert log.skipped == 0


def test_damage_costs_the_records_it_hits_and_no_others(tmp_path):
    raw = bytearray((FLIGHTS / "copter.bin").read_bytes())
    whole = DataFlash(FLIGHTS / "copter.bin")
    starts = whole.find_starts("IMU")
    del raw[starts[500] + 10 : starts[500] + 30]  # bytes are lost within a record
    raw[starts[900]] = 0  # a head is hit
    path = tmp_path / "damaged.bin"
    path.write_bytes(raw[:-7])
    log = DataFlash(path)
    before, after = whole.read("IMU"), log.read("IMU")
    kept = np.isin(before["TimeMS"], after["TimeMS"])
    assert 2 <= np.count_nonzero(~kept) <= 4
    assert_allclose(after["GyrX"], before["GyrX"][kept])
    assert log.skipped > 0
    assert "are no records" in " ".join(read(path, "imu").notes)


def test_files_that_are_no_logs(tmp_path):
    for content in (b"", b"\xa3", HEAD * 200, bytes(range(256)) * 20):
        path = tmp_path / "x.bin"
        path.write_bytes(content)
        with pytest.raises(ConfigError, match=r"no records of a DataFlash log"):
            DataFlash(path)


@pytest.mark.parametrize("seed", range(8))
def test_random_damage_gives_rows_or_a_line(tmp_path, seed):
    rng = np.random.default_rng(seed)
    raw = np.frombuffer((FLIGHTS / "copter.bin").read_bytes(), np.uint8).copy()
    hit = rng.integers(0, len(raw), 300)
    raw[hit] = rng.integers(0, 256, 300)
    path = tmp_path / "x.bin"
    path.write_bytes(raw.tobytes())
    for kind in ("imu", "gnss", "baro", "mag", "airspeed", "radar"):
        with contextlib.suppress(ConfigError):
            rows = read(path, kind)
            assert len(rows.t) == len(next(iter(rows.values.values())))


def test_a_fix_in_si(tmp_path):
    rows = [
        ("PARM", (1, "GPS1_DELAY_MS", 150.0)),
        fix(1_000_000, status=1),
        fix(1_200_000),
        ("GPA", (1_200_100, 0, 1.2, 0.9, 1.4, 0.3, 1, 1200, 200, -48.5)),
        fix(1_400_000, instance=1, lat=10.0),
    ]
    path = write_flash(tmp_path / "x.bin", {"PARM": PARM, "GPS": GPS, "GPA": GPA}, rows)
    found = read(path, "gnss")
    assert len(found.t) == 2  # those of the first receiver
    assert np.isnan(found.values["lla"][0]).all()  # no fix in three dimensions
    assert_allclose(found.t, [0.85, 1.05])
    assert_allclose(found.values["arrival"], [1.0, 1.2])
    assert_allclose(found.values["lla"][1], [np.deg2rad(-35.0), np.deg2rad(149.0), 648.5], rtol=1e-9)
    assert_allclose(found.values["vel_n"][1], [10 * np.cos(np.pi / 6), 5.0, -1.0], rtol=1e-6)
    assert_allclose(found.values["sd_pos"][1], [0.9 / 2**0.5, 0.9 / 2**0.5, 1.4])
    assert_allclose(found.values["sd_vel"][1], 0.3 / 3**0.5)
    other = read(path, "gnss", "GPS:1")
    assert_allclose(other.values["lla"][0, 0], np.deg2rad(10.0), rtol=1e-7)
    assert look(path).sensors == ("gnss",)


@pytest.mark.parametrize(("known", "height"), [((-48.5, np.nan, -48.5), 648.5), ((np.nan,), 600.0)])
def test_an_undulation_that_is_no_number_does_not_count(tmp_path, known, height):
    rows = [fix(1_000_000 + k) for k in range(3)]
    rows += [("GPA", (1_000_100 + k, 0, 1.2, 0.9, 1.4, 0.3, 1, 1, 1, und)) for k, und in enumerate(known)]
    path = write_flash(tmp_path / "x.bin", {"GPS": GPS, "GPA": GPA}, rows)
    assert_allclose(read(path, "gnss").values["lla"][:, 2], height)


NEW_GPS = (GPS[0] + "fB", GPS[1] + ",Yaw,U")
NEW_GPA = ("QBCCCCfBIHeHH", "TimeUS,I,VDop,HAcc,VAcc,SAcc,YAcc,VV,SMS,Delta,AEl,RTCMFU,RTCMFD")
"""Of later firmware: libraries/AP_GPS/LogStructure.h of ArduPilot."""


def new_accuracy(t_us: int, yaw: float, height: float):
    return ("GPA", (t_us, 0, 1.2, 0.9, 1.4, 0.3, yaw, 1, 1000, 200, height, 0, 0))


def test_a_height_over_the_ellipsoid_is_taken_where_the_log_has_it(tmp_path):
    unknown = -2147483648 * 0.01
    rows = [("GPS", (*fix(1_000_000 + 200_000 * k)[1], 0.0, 1)) for k in range(3)]
    rows += [new_accuracy(1_000_100 + 200_000 * k, 0.0, h) for k, h in enumerate((648.5, unknown, 648.5))]
    path = write_flash(tmp_path / "x.bin", {"GPS": NEW_GPS, "GPA": NEW_GPA}, rows)
    assert_allclose(read(path, "gnss").values["lla"][:, 2], 648.5)
    assert not any("over the sea" in note for note in read(path, "gnss").notes)


@pytest.mark.parametrize(("accuracy", "sd"), [(1.5, [np.deg2rad(1.5)] * 2), (0.0, None)])
def test_headings_of_two_antennas_are_rows_as_old_as_their_fixes(tmp_path, accuracy, sd):
    rows = [("PARM", (1, "GPS1_DELAY_MS", 150.0))]
    for k, yaw in enumerate((0.0, 350.0, 10.0)):  # exactly 0: not known
        rows.append(("GPS", (*fix(1_000_000 + 200_000 * k)[1], yaw, 1)))
        rows.append(new_accuracy(1_000_100 + 200_000 * k, accuracy, 648.5))
    path = write_flash(tmp_path / "x.bin", {"PARM": PARM, "GPS": NEW_GPS, "GPA": NEW_GPA}, rows)
    found = read(path, "heading")
    assert_allclose(found.values["heading"], np.deg2rad([np.nan, 350.0, 10.0]), rtol=1e-6)
    assert_allclose(found.t, [0.85, 1.05, 1.25])
    assert_allclose(found.values["arrival"], [1.0, 1.2, 1.4])
    assert ("sd" in found.values) == (sd is not None)
    if sd is not None:
        assert_allclose(found.values["sd"][1:], sd, rtol=1e-6)
    assert look(path).sensors == ("gnss", "heading")


def test_a_receiver_with_one_antenna_has_no_heading(tmp_path):
    rows = [("GPS", (*fix(1_000_000 + k)[1], 0.0, 1)) for k in range(3)]
    path = write_flash(tmp_path / "x.bin", {"GPS": NEW_GPS}, rows)
    assert look(path).sensors == ("gnss",)
    old = write_flash(tmp_path / "old.bin", {"GPS": GPS}, [fix(1_000_000)])
    with pytest.raises(ConfigError, match="records GPS have no field 'Yaw'"):
        read(old, "heading")


def test_a_receiver_without_vertical_velocity_has_none(tmp_path):
    rows = [fix(1_000_000), ("GPA", (1_000_100, 0, 1.2, 0.9, 1.4, 0.3, 0, 1000, 200, 0.0))]
    path = write_flash(tmp_path / "x.bin", {"GPS": GPS, "GPA": GPA}, rows)
    assert np.isnan(read(path, "gnss").values["vel_n"][0, 2])


def test_instances_of_an_imu(tmp_path):
    rows = [("IMU", (k * 10_000, k % 2, 0.1 + k % 2, 0, 0, 0, 0, -9.8)) for k in range(10)]
    path = write_flash(tmp_path / "x.bin", {"IMU": IMU}, rows)
    assert_allclose(read(path, "imu").values["gyro"][:, 0], 0.1)
    assert_allclose(read(path, "imu", "IMU:1").values["gyro"][:, 0], 1.1)
    with pytest.raises(ConfigError, match="no records IMU:2"):
        read(path, "imu", "IMU:2")


def test_increments_of_the_replay_are_those_of_its_rates(tmp_path):
    rng, rows, sums = np.random.default_rng(1), [], np.zeros(6)
    rates = rng.normal(size=(400, 6))
    for k, rate in enumerate(rates):
        dt = 0.0025 * (1.0 + 0.1 * (k % 3))
        values = rate * dt
        sums += values
        rows.append(("RFRH", (2_500 * (k + 1), 0)))
        rows.append(("RISI", (*values[3:], *values[:3], dt, dt, 15, 0)))
        rows.append(("RISI", (*np.ones(6), dt, dt, 15, 1)))
    kinds = {"RFRH": ("QB", "TimeUS,TF"), "RISI": ("ffffffffBB", "DVX,DVY,DVZ,DAX,DAY,DAZ,DVDT,DADT,Flags,I")}
    found = read(write_flash(tmp_path / "x.bin", kinds, rows), "imu")
    assert_allclose(found.t, 0.0025 * np.arange(1, 401))
    both = np.hstack([found.values["dtheta"], found.values["dvel"]])
    assert_allclose(both.sum(axis=0), sums, rtol=1e-6)
    assert_allclose(both / found.values["interval"][:, None], rates, rtol=1e-5, atol=1e-6)


def test_times_of_px4_are_those_of_the_record_ahead():
    log = DataFlash(FLIGHTS / "quad.px4log")
    imu, gnss = read(FLIGHTS / "quad.px4log", "imu"), read(FLIGHTS / "quad.px4log", "gnss")
    assert_allclose(imu.t, log.read("TIME")["StartTime"] * 1e-6)  # one IMU row each
    assert 80 < 1.0 / np.median(np.diff(imu.t)) < 85
    assert_allclose(np.median(np.diff(gnss.t)), 0.2, atol=0.005)
    assert_allclose(gnss.values["arrival"] - gnss.t, 0.2)  # INAV_DELAY_GPS


def test_airspeed_becomes_true_by_the_density(tmp_path):
    pressure, temperature = 70_000.0, 263.15  # about 3000 m
    rows = [
        ("BARO", (1_000_000, 0, 3000.0, pressure, temperature - 273.15)),
        ("ARSP", (1_000_000, 0, 50.0, 1)),
    ]
    kinds = {"BARO": ("QBfff", "TimeUS,I,Alt,Press,GndTemp"), "ARSP": ("QBfB", "TimeUS,I,Airspeed,H")}
    found = read(write_flash(tmp_path / "x.bin", kinds, rows), "airspeed")
    sea = 101_325.0 / 288.15
    assert_allclose(found.values["airspeed_true"], 50.0 * (sea / (pressure / temperature)) ** 0.5, rtol=1e-6)


def test_a_range_finder_and_a_magnetometer(tmp_path):
    rows = [
        ("RFND", (1_000_000, 0, 12.3, 4)),
        ("RFND", (1_100_000, 0, 99.0, 2)),
        ("MAG", (1_000_000, 0, 200, -50, 400, 1)),
    ]
    kinds = {
        "RFND": ("QBCB", "TimeUS,Instance,Dist,Stat"),
        "MAG": ("QBhhhB", "TimeUS,I,MagX,MagY,MagZ,Health"),
    }
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    radar = read(path, "radar")
    assert_allclose(radar.values["height"], [12.3, 99.0])
    assert radar.values["valid"].tolist() == [1.0, 0.0]
    assert_allclose(read(path, "mag").values["field_b"], [[20e-6, -5e-6, 40e-6]])


def test_what_a_log_lacks_is_said():
    with pytest.raises(ConfigError, match=r"copter\.bin: no records ARSP; it has BARO, CMD"):
        read(FLIGHTS / "copter.bin", "airspeed")
    assert look(FLIGHTS / "copter.bin").sensors == ("imu", "gnss", "baro", "mag")


def fmt(number: int, length: int, name: str, letters: str, labels: str) -> bytes:
    """Return an FMT that may say anything."""
    body = (number, length, name.encode(), letters.encode(), labels.encode())
    return HEAD + bytes([128]) + struct.pack("<BB4s16s64s", *body)


ROW = HEAD + b"\1" + bytes(4)
LIES = {
    "a label that is empty": fmt(1, 7, "IMU", "f", ",") + ROW * 3,
    "no fields": fmt(1, 3, "IMU", "", "") + ROW[:3] * 3,
    "a second layout, longer than the rest of the file": fmt(1, 7, "IMU", "f", "TimeUS")
    + ROW * 3
    + fmt(1, 195, "IMU", "ZZZ", "TimeUS,b,c"),
    "times that are arrays": fmt(1, 67, "IMU", "a", "TimeUS") + (ROW + bytes(60)) * 3,
    "times that are text": fmt(1, 7, "IMU", "n", "TimeUS") + ROW * 3,
    "fixes without a status": fmt(1, 7, "GPS", "I", "TimeUS") + ROW * 3,
    "parameters without a name": fmt(1, 7, "PARM", "f", "Value") + ROW * 3,
    "parameters whose name is a number": fmt(1, 7, "PARM", "hh", "Name,Value") + ROW * 3,
    "lanes without a number": fmt(2, 7, "XKF1", "f", "TimeUS")
    + fmt(1, 7, "XKF4", "f", "PI")
    + HEAD + b"\2" + bytes(4) + HEAD + b"\1" + struct.pack("<f", np.nan),
}  # fmt: skip


@pytest.mark.parametrize("lie", LIES)
def test_a_log_that_lies_about_its_layout_gets_a_line(tmp_path, lie):
    path = tmp_path / "x.bin"
    path.write_bytes(LIES[lie])
    with contextlib.suppress(ConfigError):
        assert not own_estimate.look("dataflash", path).sensors
    with pytest.raises(ConfigError) as imu:
        read(path, "imu")
    with pytest.raises(ConfigError) as own:
        own_estimate.read_estimate(SourceSpec(path, "dataflash"), None)
    assert "\n" not in f"{imu.value}{own.value}"


@pytest.mark.parametrize("week", [np.nan, np.inf])
def test_a_week_that_is_no_number_is_no_day(tmp_path, week):
    name, rows = ("QBBffBcLLefff", GPS[1]), [("GPS", (1, 0, 3, week, week, 9, 1.5, 1, 1, 1, 1, 1, 1))] * 3
    assert look(write_flash(tmp_path / "x.bin", {"GPS": name}, rows)).date is None


def test_an_antenna_at_no_number_is_not_known(tmp_path):
    rows = [
        ("PARM", (1, f"GPS_POS1_{axis}", value)) for axis, value in zip("XYZ", (1, np.nan, 2), strict=True)
    ]
    path = write_flash(tmp_path / "x.bin", {"PARM": PARM}, rows)
    assert look(path).antenna is None
    rows[1] = ("PARM", (1, "GPS_POS1_Y", 0.5))
    assert look(write_flash(tmp_path / "y.bin", {"PARM": PARM}, rows)).antenna == (1.0, 0.5, 2.0)


def test_the_noise_of_the_barometer_is_that_of_the_newest_filter(tmp_path):
    """EKF3 flies where it has its parameters; 0 is none."""
    rows = [("PARM", (1, name, value)) for name, value in (("EKF_ALT_NOISE", 1.0), ("EK3_ALT_M_NSE", 3.0))]
    assert look(write_flash(tmp_path / "x.bin", {"PARM": PARM}, rows)).baro_sd == (3.0, "EK3_ALT_M_NSE")
    rows[1] = ("PARM", (1, "EK3_ALT_M_NSE", 0.0))
    assert look(write_flash(tmp_path / "y.bin", {"PARM": PARM}, rows)).baro_sd == (1.0, "EKF_ALT_NOISE")
    rows[0] = ("PARM", (1, "EKF_ALT_NOISE", np.nan))
    assert look(write_flash(tmp_path / "z.bin", {"PARM": PARM}, rows)).baro_sd is None


def test_an_imu_without_a_whole_row_is_refused_in_a_line(tmp_path, capsys):
    rows = [("IMU", (1_000_000 + 10_000 * k, 0, np.nan, 0, 0, 0, 0, -9.8)) for k in range(500)]
    rows += [fix(1_000_000 + 200_000 * k) for k in range(20)]
    rows += [("IMU", (6_000_000, 0, 0, 0, 0, 0, np.nan, -9.8))]
    path = write_flash(tmp_path / "x.bin", {"IMU": IMU, "GPS": GPS}, rows)
    assert main(["new", "log", str(path)]) == WRONG
    assert capsys.readouterr().err.count("every row of the IMU has a missing value") == 1
    assert not path.with_suffix(".toml").exists()


def test_the_second_layout_of_a_record_is_not_used(tmp_path):
    path = tmp_path / "x.bin"
    path.write_bytes(fmt(1, 7, "A", "f", "x") + ROW * 3 + fmt(1, 7, "A", "hh", "y,z") + ROW + bytes(300))
    assert list(DataFlash(path).read("A")) == ["x"]


@pytest.mark.parametrize("topic", ["IMU:x", "IMU:²", "IMU:-1", "IMU:1e2"])
def test_an_instance_is_a_number(topic):
    with pytest.raises(ConfigError, match="the instance after the colon must be a number"):
        read(FLIGHTS / "copter.bin", "imu", topic)
    with pytest.raises(ConfigError, match="the instance after the colon must be a number"):
        formats.read("ulog", FLIGHTS / "sitl.ulg", "imu", topic.replace("IMU", "sensor_combined"))


def test_an_airspeed_without_a_barometer_says_so(tmp_path):
    kinds = {"ARSP": ("QBfB", "TimeUS,I,Airspeed,H")}
    path = write_flash(tmp_path / "x.bin", kinds, [("ARSP", (1, 0, 5.0, 1))] * 3)
    with pytest.raises(ConfigError, match="no records BARO"):
        read(path, "airspeed")


def test_the_day_is_that_of_the_last_fix_in_three_dimensions(tmp_path):
    """Weeks 2300 to 2302 began on the 4th, 11th and 18th of February 2024."""
    days = ((3, 2300, 1), (4, 2302, 3), (3, 2301, 2), (1, 2310, 5))
    rows = [
        ("GPS", (1_000_000 * k, 0, status, 86_400_000 * day + 70, week, *fix(0)[1][5:]))
        for k, (status, week, day) in enumerate(days)
    ]
    assert look(write_flash(tmp_path / "x.bin", {"GPS": GPS}, rows)).date == datetime.date(2024, 2, 13)
    rows[2], rows[1] = rows[1], rows[2]
    assert look(write_flash(tmp_path / "y.bin", {"GPS": GPS}, rows)).date == datetime.date(2024, 2, 21)


def test_accuracies_are_those_of_the_nearest_record_within_half_a_second(tmp_path):
    rows = [fix(t) for t in (1_000_000, 3_000_000, 7_000_000, 11_700_000)]
    own = ((700_000, 0.9), (3_100_000, 1.7), (4_000_000, 2.3), (6_900_000, 3.1), (11_000_000, 4.7))
    rows += [("GPA", (t, 0, 1.2, h, 1.4, 0.3, 1, 1, 1, 0.0)) for t, h in own]
    found = read(write_flash(tmp_path / "x.bin", {"GPS": GPS, "GPA": GPA}, rows), "gnss")
    assert_allclose(found.values["sd_pos"][:, 0] * 2**0.5, [0.9, 1.7, 3.1, np.nan])
    assert_allclose(found.values["arrival"] - found.t, 0.12)  # of a u-blox, as no parameter says another


def test_undulations_are_those_of_fixes_with_a_height(tmp_path):
    heights = ((1, 500.0), (1, 500.0), (1, 500.0), (3, 648.5), (4, 648.5), (3, 1.5e5), (3, 1.5e5), (3, 1.5e5))
    rows = [("GPS", (*fix(1_000_000 * (k + 1), status)[1], 0.0, 1)) for k, (status, _) in enumerate(heights)]
    rows += [new_accuracy(1_000_000 * (k + 1), 0.0, h) for k, (_, h) in enumerate(heights)]
    path = write_flash(tmp_path / "x.bin", {"GPS": NEW_GPS, "GPA": NEW_GPA}, rows)
    assert_allclose(read(path, "gnss").values["lla"][3:, 2], 648.5)


def test_increments_of_velocity_are_over_the_interval_of_the_angles(tmp_path):
    rows = [("RISI", (2_000, 0.3, -0.2, -0.7, 1e-3, 2e-3, -3e-3, 0.004, 0.005))]
    rows += [
        ("RISI", (7_000, 0.3, -0.2, -0.7, 1e-3, 2e-3, -3e-3, *dt)) for dt in ((0.0, 0.005), (0.004, 0.0))
    ]
    kinds = {"RISI": ("Qffffffff", "TimeUS,DVX,DVY,DVZ,DAX,DAY,DAZ,DVDT,DADT")}
    found = read(write_flash(tmp_path / "x.bin", kinds, rows), "imu").values
    assert_allclose(found["dvel"][0], 1.25 * np.array([0.3, -0.2, -0.7]), rtol=1e-6)
    assert_allclose(found["dtheta"][0], [1e-3, 2e-3, -3e-3], rtol=1e-6)
    assert_allclose(found["interval"][0], 0.005, rtol=1e-6)
    assert found["valid"].tolist() == [1.0, 0.0, 0.0]


def test_a_log_of_px4_is_in_its_own_units(tmp_path):
    kinds = {
        "TIME": ("Q", "StartTime"),
        "GPS": ("QBffLLffffB", "GPSTime,Fix,EPH,EPV,Lat,Lon,Alt,VelN,VelE,VelD,nSat"),
        "IMU": ("fffffffff", "AccX,AccY,AccZ,GyroX,GyroY,GyroZ,MagX,MagY,MagZ"),
        "SENS": ("f", "BaroPres"),
    }
    rows: list[tuple[str, tuple[float, ...]]] = [("SENS", (900.0,))]  # before any time is known
    days = (1_400_000_000_000_000, 1_400_300_000_000_000, 0)
    for k, (utc, status) in enumerate(zip(days, (2, 3, 4), strict=True)):
        rows.append(("TIME", (2_000_000 + 300_000 * k,)))
        rows.append(("GPS", (utc, status, 2.5, 4.0, 47.0 + k, -8.0 - k, 500.0 + k, 3.0, -2.0, 0.7, 7 + k)))
        rows.append(("IMU", (0.3, -0.4, -9.8, 0.01, 0.02, -0.03, 0.2, -0.1, 0.4)))
        rows.append(("SENS", (1013.25,)))
    path = write_flash(tmp_path / "x.px4log", kinds, rows)
    found, baro = read(path, "gnss"), read(path, "baro")
    assert_allclose(found.values["arrival"], [2.0, 2.3, 2.6])
    assert np.isnan(found.values["lla"][0]).all()
    assert_allclose(found.values["lla"][1], [np.deg2rad(48.0), np.deg2rad(-9.0), 501.0])
    assert_allclose(found.values["lla"][2], [np.deg2rad(49.0), np.deg2rad(-10.0), 502.0])
    assert_allclose(found.values["vel_n"][1], [3.0, -2.0, 0.7], rtol=1e-6)
    assert_allclose(found.values["sd_pos"][1], [2.5 / 2**0.5, 2.5 / 2**0.5, 4.0])
    assert found.values["satellites"].tolist() == [7.0, 8.0, 9.0]
    assert_allclose(read(path, "mag").values["field_b"][0], [20e-6, -10e-6, 40e-6], rtol=1e-6)
    assert_allclose(read(path, "imu").values["gyro"][0], [0.01, 0.02, -0.03], rtol=1e-6)
    assert np.isnan(baro.t[0])
    assert_allclose(baro.t[1:], [2.0, 2.3, 2.6])
    assert_allclose(baro.values["alt_baro"][1:], 0.0, atol=0.02)
    assert look(path).date == datetime.date(2014, 5, 13)


def test_times_of_old_logs_are_in_milliseconds(tmp_path):
    kinds = {
        "GPS": ("BIHBcLLefffI", "Status,TimeMS,Week,NSats,HDop,Lat,Lng,Alt,Spd,GCrs,VZ,T"),
        "MAG": ("Ihhh", "TimeMS,MagX,MagY,MagZ"),
        "IMU": ("Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ"),
    }
    rows = [("GPS", (3, 86_400_123, 1800, 9, 1.5, -35.0, 149.0, 600.0, 10.0, 30.0, -1.0, 4_500))]
    rows += [("MAG", (5_250, 0, 0, 0)), ("IMU", (6_125, 0, 0, 0, 0, 0, -9.8))]
    path = write_flash(tmp_path / "x.bin", kinds, rows)
    assert_allclose(read(path, "gnss").values["arrival"], 4.5)
    assert_allclose(read(path, "gnss").values["dilution"], [[1.5]])
    assert_allclose(read(path, "mag").t, 5.25)
    assert_allclose(read(path, "imu").t, 6.125)
    assert look(path).sensors == ("imu", "gnss")  # a magnetometer that says 0 is none, a gyro may stand still
    assert look(path).date == datetime.date(2014, 7, 7)
