"""Magnetometer, airspeed, physical barometer: units by hand, one day, one line for each mistake."""

from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import pytest

from bench.cli.command_line import main
from bench.core.files.places import PACKAGE
from bench.core.records.instruments import AirspeedSpec, MagSpec, StaticPressureSpec
from bench.core.words.exceptions import ConfigError
from bench.io import config
from bench.io.config.datasheets import SENSORS
from bench.navigation.built_in import load

PROFILE = """
aircraft = "aerosonde"
[start]
lat_deg = 45.0
lon_deg = -90.0
alt_m = 1000
heading_deg = 180.0
speed_mps = 25
[[leg]]
kind = "straight"
duration_s = 30
[sensors]
imu = "matched-mems"
mag = "rm3100"
airspeed = "tfpitot01"
baro = "bmp388-physical"
[evaluation]
from_s = 10.0
[[estimator]]
use = "free-inertial"
"""


def write(folder: Path, text: str, name: str) -> Path:
    (folder / name).write_text(text)
    return folder / name


def wrong(path: Path, **keywords) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        config.read_profile(str(path), **keywords)
    return [message.replace(f"{path.parent}/", "") for message in caught.value.messages]


# --- figures become SI ------------------------------------------------------------------------------------

# By hand: 1 nT = 1e-9 T, 1 % = 0.01, 1 deg = 0.0174532925 rad, 1 hPa = 100 Pa, 1 h = 3600 s.
MAG = {
    "rate_hz": (20.0, "rate", 20.0),
    "white_sd_nt": (15.0, "white_sd", 1.5e-8),
    "hard_iron_sd_nt": (500.0, "hard_iron_sd", 5e-7),
    "motor_field_sd_nt": (900.0, "motor_field_sd", 9e-7),
    "soft_iron_sd_percent": (0.5, "soft_iron_sd", 5e-3),
    "scale_factor_sd_percent": (0.2, "scale_factor_sd", 2e-3),
    "misalignment_sd_deg": (0.1, "misalignment_sd", 1.74532925e-3),
    "range_ut": (88.0, "range", 8.8e-5),
    "quantization_nt": (13.3, "quantization", 1.33e-8),
    "latency_s": (0.02, "latency", 0.02),
}
AIRSPEED = {
    "rate_hz": (20.0, "rate", 20.0),
    "pressure_white_sd_pa": (2.0, "pressure_white_sd", 2.0),
    "white_sd_mps": (0.1, "white_sd", 0.1),
    "pressure_bias_sd_pa": (5.0, "pressure_bias_sd", 5.0),
    "bias_sd_mps": (0.2, "bias_sd", 0.2),
    "scale_factor_sd_percent": (1.5, "scale_factor_sd", 0.015),
    "lag_s": (0.3, "lag", 0.3),
    "range_pa": (1500.0, "range", 1500.0),
    "quantization_pa": (0.05, "quantization", 0.05),
    "min_speed_mps": (5.0, "min_speed", 5.0),
    "latency_s": (0.02, "latency", 0.02),
}
PHYSICAL = {
    "pressure_white_sd_pa": (1.2, "pressure_white_sd", 1.2),
    "pressure_bias_sd_pa": (50.0, "pressure_bias_sd", 50.0),
    "temperature_sd_pa_k": (0.75, "temperature_sd", 0.75),
    "isa_deviation_k": (-15.0, "isa_deviation", -15.0),
    "isa_deviation_sd_k": (5.0, "isa_deviation_sd", 5.0),
    "qnh_sd_hpa": (0.5, "qnh_sd", 50.0),
    "qnh_walk_hpa_sqrt_h": (0.6, "qnh_walk", 1.0),
    "position_error": (-0.02, "position_error", -0.02),
    "position_error_alpha_per_deg": (0.002, "position_error_alpha", 0.11459156),
    "position_error_beta2_per_deg2": (1e-4, "position_error_beta2", 0.32828063),
    "lag_s": (0.2, "lag", 0.2),
    "quantization_pa": (0.016, "quantization", 0.016),
}
BARO = "[baro]\nrate_hz = 10.0\nwhite_sd_m = 0.1\n"


@pytest.mark.parametrize(
    ("read", "table", "given", "record", "part"),
    [
        (SENSORS["mag"], "[mag]", MAG, MagSpec, lambda spec: spec),
        (SENSORS["airspeed"], "[airspeed]", AIRSPEED, AirspeedSpec, lambda spec: spec),
        (SENSORS["baro"], BARO + "[physical]", PHYSICAL, StaticPressureSpec, lambda spec: spec.physical),
    ],
    ids=["mag", "airspeed", "physical"],
)
def test_every_figure_of_a_datasheet_becomes_si(tmp_path, read, table, given, record, part):
    lines = "\n".join(f"{key} = {value}" for key, (value, _, _) in given.items())
    path = write(tmp_path, f'source = "by hand"\n{table}\n{lines}\n', "unit.toml")
    spec = part(read(path, "unit.toml"))
    for _, field, si in given.values():
        assert getattr(spec, field) == pytest.approx(si, rel=1e-7)
    known = {field.name for field in dataclasses.fields(record)} - {"name"}
    assert known == {field for _, field, _ in given.values()}


@pytest.mark.parametrize(
    ("kind", "text", "message"),
    [
        ("mag", "[mag]\nrate_hz = 20.0\nwhite_sd_nt = 0.0", "[mag] white_sd_nt = 0 nT must be above 0"),
        ("mag", "[mag]\nwhite_sd_nt = 9.0", "[mag] rate_hz is missing"),
        ("mag", "[mag]\nrate_hz = 20.0\nwhite_sd_ut = 9.0", "[mag]: unknown key 'white_sd_ut'. Did you mean"),
        ("mag", "[mag]\nrate_hz = 20.0\nwhite_sd_nt = -1.0", "white_sd_nt = -1 nT is outside 0 to 1e+06 nT"),
        ("airspeed", "[airspeed]\nrate_hz = 20.0", "pressure_white_sd_pa or white_sd_mps must be above 0"),
        ("airspeed", "[airspeed]\nrate_hz = 20.0\nlag_s = 99.0", "lag_s = 99 s is outside 0 to 60 s"),
        ("baro", BARO + "quantization_m = 0.1\n[physical]", "[baro] quantization_m is not for a barometer"),
        ("baro", BARO + "[physical]\nqnh_sd_hpa = 70.0", "qnh_sd_hpa = 70 hPa is outside 0 to 50 hPa"),
        ("baro", BARO + "[physical]\nposition_error = 2.0", "position_error = 2 is outside -0.5 to 0.5"),
    ],
)
def test_a_datasheet_that_is_wrong_says_so_in_one_line(tmp_path, monkeypatch, capsys, kind, text, message):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, f'source = "by hand"\n{text}\n', "unit.toml")
    path = write(tmp_path, PROFILE, "own.toml")
    lines = wrong(path, overrides={f"sensors.{kind}": "unit.toml"})
    assert any(message in line and "unit.toml" in line for line in lines)
    out = tmp_path / "out"
    assert main(["run", str(path), "--set", f"sensors.{kind}=unit.toml", "-o", str(out)]) == 2
    assert message.partition(". Did")[0] in capsys.readouterr().err
    assert not out.exists()


# --- in a profile -----------------------------------------------------------------------------------------


def test_a_profile_names_them_and_what_filters_assume_of_them(tmp_path):
    path = write(tmp_path, PROFILE, "own.toml")
    sensors = config.read_profile(str(path)).sensors
    assert (sensors.mag.name, sensors.airspeed.name) == ("rm3100", "tfpitot01")
    assert (sensors.assumed.mag, sensors.assumed.airspeed) == (sensors.mag, sensors.airspeed)
    told = config.read_profile(
        str(path), {"sensors.assumed.mag": "lis3mdl", "sensors.assumed.airspeed": "ms4525do"}
    ).sensors
    assert (told.assumed.mag.name, told.assumed.airspeed.name) == ("lis3mdl", "ms4525do")
    assert (told.mag, told.airspeed) == (sensors.mag, sensors.airspeed)


def test_one_day_for_the_sky_and_the_magnetic_field(tmp_path):
    """That of the profile, else that of the receiver's sky, else 1 January 2026."""
    path = str(write(tmp_path, PROFILE, "own.toml"))
    usual = config.read_profile(path)
    assert (usual.sensors.date, usual.document["date"]) == (2026.0, "2026-01-01")
    typed = config.read_profile(path, {"date": "2024-07-02"})
    assert (typed.sensors.date, typed.document["date"]) == (2024.5, "2024-07-02")
    sky = config.read_profile(path, {"sensors.gnss": "sky-l1"})
    assert sky.document["date"] == "2022-02-17"
    assert sky.sensors.date == pytest.approx(2022 + 47 / 365)
    assert config.read_profile(path, {"sensors.gnss": "sky-l1", "date": "2022-02-17"}).sensors == sky.sensors


def test_the_setting_and_the_port_of_the_barometer_reach_it(tmp_path):
    path = str(write(tmp_path, PROFILE, "own.toml"))
    assert config.read_profile(path).sensors.qnh == 101325.0
    assert config.read_profile(path, {"sensors.qnh_hpa": 1003.0}).sensors.qnh == pytest.approx(100300.0)
    sensors = config.read_profile("circuit-navion", {"sensors.baro": "bmp388-physical"}).sensors
    assert sensors.static_port_b == pytest.approx(
        (-2.2, 0.0, -0.2)
    )  # of its file: from the center of gravity


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        ({"sensors.mag": "rm310"}, "[sensors] mag = 'rm310' is not in the catalog. Did you mean 'rm3100'?"),
        ({"sensors.airspeed": 3}, "[sensors] airspeed = 3 must be a text in quotes"),
        ({"sensors.assumed.gnss": "l1-code"}, "[sensors.assumed] gnss = 'l1-code' has no effect"),
        ({"sensors.baro": "bmp388", "sensors.qnh_hpa": 1003.0}, "[sensors] qnh_hpa = 1003 hPa has no effect"),
        ({"sensors.qnh_hpa": 300.0}, "[sensors] qnh_hpa = 300 hPa is outside 850 to 1100 hPa"),
        ({"date": "1999-01-01"}, "date = '1999-01-01' must be from 2010-01-01 to 2029-12-31"),
        ({"date": "someday"}, "date = 'someday' must be a date, as 2026-01-31"),
        (
            {"date": "2026-01-01", "sensors.gnss": "sky-l1"},
            "date = 2026-01-01 differs from the date of gnss = 'sky",
        ),
        ({"sensors.mag": "odd.toml"}, "[sensors] mag = 'odd': rate_hz = 30 Hz must divide rate_hz = 200 Hz"),
    ],
)
def test_one_thing_wrong_is_one_line(tmp_path, monkeypatch, overrides, message):
    monkeypatch.chdir(tmp_path)
    write(tmp_path, 'source = "by hand"\n[mag]\nrate_hz = 30.0\nwhite_sd_nt = 9.0\n', "odd.toml")
    (found,) = wrong(write(tmp_path, PROFILE, "own.toml"), overrides=overrides)
    assert found.startswith(f"own.toml: {message}")


@pytest.mark.parametrize("kind", ["gnss", "baro", "mag", "airspeed"])
def test_believing_a_unit_that_is_not_on_board_is_said(tmp_path, kind):
    name = {"gnss": "l1-code", "baro": "bmp388", "mag": "lis3mdl", "airspeed": "ms4525do"}[kind]
    bare = "\n".join(line for line in PROFILE.splitlines() if not line.startswith(f"{kind} = "))
    path = write(tmp_path, bare, "own.toml")
    assert wrong(path, overrides={f"sensors.assumed.{kind}": name}) == [
        f"own.toml: [sensors.assumed] {kind} = {name!r} has no effect: there is no {kind} in [sensors]"
    ]


CONSUMER = ("bmi088", "icm-20948", "icm-42688-p", "icm-45686", "lsm6dsl", "mpu-6050", "mpu-9250")
SHAKEN = "sensors.imu.vibration."


@pytest.mark.parametrize(
    ("kind", "name", "figure"),
    [
        ("baro", "bmp388-physical", {}),
        ("airspeed", "nasa-t2", {}),
        ("imu", "mpu-6050", {f"{SHAKEN}engine_accel_mg": 1.0, f"{SHAKEN}engine_reference_rpm": 5e3}),
    ],
)
def test_what_feels_the_air_is_refused_on_a_table_that_says_nothing_of_it(tmp_path, kind, name, figure):
    rows = "\n".join(f"{k / 10},45.0,-90.0,1000.0,0.0,0.0,90.0" for k in range(200))
    write(tmp_path, f"t_s,lat_deg,lon_deg,alt_m,roll_deg,pitch_deg,heading_deg\n{rows}\n", "made.csv")
    path = write(tmp_path, 'trajectory = "made.csv"\n[evaluation]\nfrom_s = 5.0\n', "own.toml")
    assert config.read_profile(str(path)).sensors.baro.name == "bmp388"
    for imu in CONSUMER:
        assert config.read_profile(str(path), {"sensors.imu": imu}).sensors.imu.name == imu
    sensors = {"sensors.imu": "matched-mems", f"sensors.{kind}": name, **figure}
    assert wrong(path, overrides=sensors) == [
        f"own.toml: [sensors] {kind} = {name!r} needs air data, which a trajectory table does not have"
    ]


def test_the_catalog_lists_them_with_what_is_assumed(capsys):
    assert main(["list", "sensors"]) == 0
    listed = capsys.readouterr().out
    for name in ("rm3100", "lis3mdl", "hmc5883l", "tfpitot01", "ms4525do", "nasa-t2", "bmp388-physical"):
        assert name in listed
    assert "mag.hard_iron_sd_nt" in listed


def test_what_filters_assume_of_the_physical_barometer_follows_from_its_parts():
    """White noise at 0.083 m/Pa; bias: sensor and setting, and the day's deviation at 1000 m."""
    path = PACKAGE / "catalog" / "baro" / "bmp388-physical.toml"
    spec = SENSORS["baro"](path, path.name)
    unit = spec.physical
    meter = 288.15 * 287.05287 / (9.80665 * 101325.0)
    assert spec.white_sd == pytest.approx(unit.pressure_white_sd * meter, rel=0.02)
    day = 1000.0 * unit.isa_deviation_sd / 288.15
    assert spec.bias_sd == pytest.approx(
        math.hypot(unit.pressure_bias_sd * meter, unit.qnh_sd * meter, day), rel=0.03
    )
    climbing = 100.0 * unit.isa_deviation_sd / 288.15 / math.sqrt(60.0)
    drift = unit.qnh_walk * meter
    assert spec.bias_walk == pytest.approx(math.hypot(climbing, drift), rel=0.15)


def test_a_filter_says_that_it_has_no_state_for_what_a_physical_barometer_feels(tmp_path):
    path = str(write(tmp_path, PROFILE, "own.toml"))
    loose = load("loose-15", {})
    said = "barometer errors with height, airspeed and incidence"
    for unit in ("bmp388", "bmp388-physical"):
        specs = config.read_profile(path, {"sensors.baro": unit}).sensors.assumed
        assert (said in loose.unmodeled_errors(specs)) == (unit == "bmp388-physical")
