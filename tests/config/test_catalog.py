"""The catalog: every figure is in its datasheet's unit and has a source or is marked as assumed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import ThermalSpec
from bench.core.words.exceptions import ConfigError
from bench.experiments.studies.unit_study.catalog_units import find_typical
from bench.io.config.datasheets import SENSORS, read_gnss, read_imu
from bench.io.config.figure_table import ASSUMED, MARKS, mark_figure, tabulate_figures
from bench.simulation.sensors import imu
from bench.simulation.sensors.draws import SensorDraws
from tests.synthetic import still

CATALOG = Path(bench.__file__).parent / "catalog"
FILES = sorted(CATALOG.glob("*/*.toml"))
TABLES = {
    "imu": ("gyro", "accel", "thermal", "vibration", "clock", "layout", "product"),
    "gnss": ("gnss", "sky"),
    **{name: (name, *row.parts) for name, row in INSTRUMENTS.items()},
}
CHOICES = (
    "bias_model", "dead_zone_kind", "noise_shape",
    "price_date", "start", "almanac", "navigation", "klobuchar", "systems", "bands", "false_alarm",
)  # fmt: skip
CLASSES = ("consumer", "industrial", "tactical", "navigation", "synthetic")
DEG = np.pi / 180


def document(path):
    return tomllib.loads(path.read_text(encoding="utf-8"))


def entry(kind, name, read):
    return read(CATALOG / kind / f"{name}.toml", f"{name}.toml")


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_figure_has_a_source_or_is_marked_assumed(path):
    """What is a choice of the model or of the experiment, as the date, is not a figure."""
    entry = document(path)
    figures = {
        f"{table}.{key}"
        for table in TABLES[path.parent.name]
        for key in entry.get(table, {})
        if key not in CHOICES
    }
    sourced, assumed = set(entry.get("sources", {})), set(entry.get("assumed", []))
    assert sourced | assumed == figures
    assert not sourced & assumed
    assert all(text.strip() for text in [entry["title"], entry["source"], *entry.get("sources", {}).values()])
    assert entry["class"] in CLASSES
    if entry["class"] == "synthetic":
        assert not sourced


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_what_was_read_names_its_page_and_its_document(path):
    """A file whose datasheet was read names the document; each figure of an IMU names its page."""
    sheet = document(path)
    names = [f"{table}.{key}" for table in TABLES[path.parent.name] for key in sheet.get(table, {})]
    marks = {name: mark_figure(sheet, name) for name in names if name.partition(".")[2] not in CHOICES}
    assert set(marks.values()) <= {"", *MARKS}
    assert all((mark == ASSUMED) == (name in sheet.get("assumed", [])) for name, mark in marks.items())
    if sheet.get("confidence") == "datasheet":
        assert re.search(r"\d", sheet["source"])
    if sheet.get("confidence") == "datasheet" and path.parent.name == "imu":
        read = [name for name, mark in marks.items() if not mark]
        assert all(re.match(r"p\. \d", sheet["sources"][name]) for name in read)
        assert len(read) >= 10
    if sheet.get("confidence") == "quoted":
        assert "" not in marks.values()


def test_eleven_imus_were_read_and_36_are_there():
    units = [document(path) for path in FILES if path.parent.name == "imu"]
    assert len(units) >= 36
    assert sum(unit.get("confidence") == "datasheet" for unit in units) >= 11


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("price_usd = 20.0", "[product] price_usd needs price_date"),
        ("mass_kg = 0.0", "mass_kg = 0 kg is outside 1e-06 to 1000 kg"),
        ("weight_g = 3.0", "unknown key 'weight_g'"),
    ],
)
def test_a_wrong_product_says_what_would_be_right(tmp_path, text, message):
    (tmp_path / "bad.toml").write_text(f'source = "by hand"\n[product]\n{text}\n')
    with pytest.raises(ConfigError) as caught:
        read_imu(tmp_path / "bad.toml", "bad.toml")
    assert message in str(caught.value)


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_entry_becomes_a_spec_by_its_name(path):
    assert SENSORS[path.parent.name](path, path.name).name == path.stem


def test_twelve_real_imus_and_more_over_four_classes_each_with_its_confidence():
    units = {path.stem: document(path) for path in FILES if path.parent.name == "imu"}
    real = {name: unit for name, unit in units.items() if unit.get("confidence") not in (None, "table")}
    assert len(real) >= 12
    assert {unit["class"] for unit in real.values()} == {"consumer", "industrial", "tactical", "navigation"}
    assert all("confidence" in unit or unit["class"] == "synthetic" for unit in units.values())
    for name in ("mpu-6050", "mpu-9250", "icm-20948", "bmi088", "lsm6dsl"):  # their datasheets print none
        assert not any("bias_instability" in key for table in ("gyro", "accel") for key in real[name][table])


@pytest.mark.parametrize(
    ("number", "gyro", "accel"),
    [
        (1, [2.4241e-8, 2.5e-5, 9.6963e-5, 3.7078e-9, 1.4544e-7], [9.80665e-5, 1e-5, 4.8481e-5, 1.5e-4]),
        (2, [4.8481e-8, 5e-5, 2.9089e-4, 7.4156e-9, 2.9089e-7], [4.90333e-4, 5e-5, 4.8481e-5, 1.6667e-4]),
        (3, [4.8481e-7, 2e-4, 5.8178e-4, 7.4156e-8, 2.9089e-6], [9.80665e-4, 1e-4, 9.6963e-5, 3.3333e-4]),
    ],
)
def test_the_grades_of_the_source_are_read_as_the_register_reads_them(number, gyro, accel):
    """A-T2.4.1, A-T2.4.2 and #15 in SI, by hand: drift, scale factor, angle, g-drift, random walk."""
    unit = entry("imu", f"grade-{number}", read_imu)
    g, a = unit.gyro, unit.accel
    found = [g.turn_on_bias_sd, g.scale_factor_sd, g.nonorthogonality_sd, g.g_sensitivity_sd, g.random_walk]
    assert_allclose(found, gyro, rtol=1e-4)
    found = [a.turn_on_bias_sd, a.scale_factor_sd, a.nonorthogonality_sd, a.random_walk]
    assert_allclose(found, accel, rtol=1e-4)
    for triad in (g, a):
        assert triad.bias_instability == triad.dead_zone == triad.misalignment_sd == triad.quantization == 0


def test_the_other_tables_of_an_imu_become_si(tmp_path):
    (tmp_path / "odd.toml").write_text(
        """
        source = "by hand"
        [gyro]
        dead_zone_deg_h = 36.0
        dead_zone_kind = "hard"
        [thermal]
        reference_degc = 20.0
        self_heating_k = 12.0
        time_constant_s = 300.0
        [vibration]
        engine_gyro_deg_s = 1.0
        engine_accel_mg = 100.0
        engine_reference_rpm = 6000.0
        engine_order = 2.0
        gust_gyro_deg_s_per_mps = 0.1
        gust_accel_mg_per_mps = 10.0
        mode_frequency_hz = 25.0
        mode_damping = 0.03
        [layout]
        accel_cone_deg = 40.0
        accel_x_m = [0.01, 0.0, 0.0]
        accel_y_m = [0.0, 0.02, 0.0]
        """
    )
    unit = read_imu(tmp_path / "odd.toml", "odd.toml")
    assert (unit.gyro.dead_zone_kind, unit.accel.dead_zone_kind) == ("hard", "subtractive")
    assert unit.thermal == ThermalSpec(293.15, 12.0, 300.0)
    shaking = unit.vibration
    assert_allclose([shaking.engine_gyro, shaking.engine_accel], [DEG, 0.980665])
    assert_allclose([shaking.engine_reference, shaking.engine_order], [628.3185, 2.0], rtol=1e-6)
    assert_allclose([shaking.gust_gyro, shaking.gust_accel], [0.1 * DEG, 0.0980665])
    assert (shaking.mode_frequency, shaking.mode_damping) == (25.0, 0.03)
    assert_allclose(unit.accel_cone, 40 * DEG)
    assert unit.accel_arms == ((0.01, 0.0, 0.0), (0.0, 0.02, 0.0), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[gyro]\nnonlinearity_sd_ppm = 50.0", "[gyro] nonlinearity_sd needs range_deg_s above 0"),
        ("[accel]\nnonlinearity_sd_ppm = 50.0", "[accel] nonlinearity_sd needs range_g above 0"),
        (
            "[accel]\ndead_zone_ug = 1.0\ndead_zone_mg = 1.0",
            "dead_zone_ug and dead_zone_mg are the same figure",
        ),
        ('[gyro]\ndead_zone_kind = "soft"', "must be 'subtractive' or 'hard'"),
        ("[accel]\ng_sensitivity_sd_deg_h_g = 1.0", "unknown key 'g_sensitivity_sd_deg_h_g'"),
        ("[vibration]\nengine_accel_mg = 1.0", "[vibration] engine shaking needs engine_reference_rpm"),
        ("[vibration]\ngust_accel_mg_per_mps = 1.0", "[vibration] shaking by gusts needs mode_frequency_hz"),
        ("[layout]\naccel_cone_deg = 95.0", "accel_cone_deg = 95 deg is outside 0 to 89 deg"),
        ("[layout]\naccel_x_m = [1.0, 2.0]", "accel_x_m"),
        ('confidence = "hearsay"', "confidence = 'hearsay'"),
    ],
)
def test_a_wrong_imu_sheet_says_what_would_be_right(tmp_path, text, message):
    (tmp_path / "bad.toml").write_text(f'source = "by hand"\n{text}\n')
    with pytest.raises(ConfigError) as caught:
        read_imu(tmp_path / "bad.toml", "bad.toml")
    assert message in str(caught.value)
    assert all(line.startswith("bad.toml: ") for line in caught.value.messages)


def test_the_list_of_sensors_shows_what_is_assumed(capsys):
    assert main(["list", "sensors"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "stim300" in out
    assert (
        "tactical, quoted; assumed: gyro.bias_correlation_s, accel.bias_correlation_s; absent: "
        "gyro temperature, "
        "gyro bandwidth, accel temperature, accel bandwidth"
    ) in out
    assert "walking bias: synthetic; assumed: baro.rate_hz, baro.white_sd_m, baro.bias_sd_m, " in out
    assert "baro.bias_walk_m_sqrt_s; absent: quantization, latency" in out
    assert "figure-eight" not in out
    assert main(["list", "profiles"]) == 0
    assert "figure-eight" in capsys.readouterr().out
    assert main(["list", "cats"]) == 2


def test_units_of_the_datasheets_become_si():
    """By hand: 0.15 deg/sqrt(h) = 0.15 deg / 60 sqrt(s); 3.6 ug = 3.6e-6 * 9.80665 m/s^2; 0.5/3 % ..."""
    adis = entry("imu", "adis16475", read_imu)
    assert_allclose(adis.gyro.random_walk, 4.3633e-5, rtol=1e-4)
    assert_allclose(adis.gyro.bias_instability, 9.6963e-6, rtol=1e-4)
    assert_allclose(adis.gyro.turn_on_bias_sd, 1.7453e-4, rtol=1e-4)
    assert_allclose(adis.gyro.misalignment_sd, 5.7596e-4, rtol=1e-4)
    assert_allclose(adis.accel.bias_instability, 3.5304e-5, rtol=1e-4)
    assert_allclose(adis.accel.random_walk, 4.8333e-4, rtol=1e-4)
    assert_allclose(adis.accel.turn_on_bias_sd, 1.96133e-2, rtol=1e-4)
    assert adis.accel.scale_factor_sd == 0.0  # its front page does not say
    icm = entry("imu", "icm-42688-p", read_imu)
    assert_allclose(icm.gyro.random_walk, 0.0028 * DEG, rtol=1e-9)
    assert_allclose(icm.gyro.turn_on_bias_sd, 0.167 * DEG, rtol=1e-9)
    assert_allclose(icm.gyro.scale_factor_sd, 0.00167, rtol=1e-9)
    assert_allclose(icm.accel.random_walk, 6.8647e-4, rtol=1e-4)
    assert_allclose(icm.accel.misalignment_sd, 3.3e-3, rtol=1e-9)
    honeywell = entry("imu", "hg4930-ca51", read_imu)
    assert honeywell.gyro.quantization == 2.0**-33
    assert honeywell.accel.quantization == 0.3048 * 2.0**-27
    assert_allclose(honeywell.gyro.scale_factor_sd, 6e-4, rtol=1e-9)
    code = entry("gnss", "l1-code", read_gnss)
    assert_allclose([code.pos_decay_distance, code.pos_decay_time], [4e-6, 5e-4], rtol=1e-9)
    assert_allclose(code.vel_decay_time, np.sqrt(0.0017 * 0.05), rtol=0.01)


def test_three_sigma_units_keep_their_bounds():
    """+-x read as three standard deviations: the entry times three is the datasheet's x within rounding."""
    icm = document(CATALOG / "imu" / "icm-42688-p.toml")
    for table, key, bound in [
        ("gyro", "turn_on_bias_sd_deg_s", 0.5),
        ("gyro", "scale_factor_sd_percent", 0.5),
        ("gyro", "misalignment_sd_mrad", 12.5),
        ("accel", "turn_on_bias_sd_mg", 20.0),
        ("accel", "misalignment_sd_mrad", 10.0),
    ]:
        assert_allclose(3 * icm[table][key], bound, rtol=0.011)


def test_the_matched_units_have_only_errors_a_15_state_filter_models():
    unit = entry("imu", "matched-mems", read_imu)
    for triad in (unit.gyro, unit.accel):
        assert triad.bias_model == "gauss-markov"
        assert min(triad.random_walk, triad.bias_instability, triad.turn_on_bias_sd) > 0
        assert triad.scale_factor_sd == triad.misalignment_sd == triad.quantization == 0
    receiver = entry("gnss", "matched-white", read_gnss)
    assert receiver.pos_h_markov_sd == receiver.pos_v_markov_sd == receiver.vel_markov_sd == 0
    assert receiver.latency == 0
    barometer = entry("baro", "matched-walk", SENSORS["baro"])
    assert min(barometer.white_sd, barometer.bias_sd, barometer.bias_walk) > 0
    assert barometer.quantization == barometer.latency == 0


@pytest.mark.parametrize("path", sorted((CATALOG / "imu").glob("*.toml")), ids=lambda path: path.stem)
def test_every_imu_measures(path):
    record, bias = imu.measure(still(1.0, 100.0), read_imu(path, path.name), SensorDraws(1, 0))
    assert np.isfinite(record.dtheta_b).all()
    assert np.isfinite(record.dvel_b).all()
    assert bias.gyro_b.any()


def test_the_long_list_has_every_figure_in_one_unit(capsys):
    """0.0028 deg/s/sqrt(Hz) is 0.168 deg/sqrt(h); what is assumed is marked, what is absent is no zero."""
    columns = tabulate_figures("imu")
    row = {name: cells[columns["imu"].index("icm-42688-p")] for name, cells in columns.items()}
    assert row["gyro noise_deg_sqrt_h"] == "0.168"
    assert row["gyro turn_on_bias_sd_deg_h"] == "601"
    assert row["gyro bias_instability_deg_h"] == "5*"
    assert row["gyro g_sensitivity_sd_deg_h_g"] == "-"
    assert columns["class"].index("navigation") < columns["class"].index("tactical")
    assert len({len(cells) for cells in columns.values()}) == 1
    assert columns["imu"].index("hg9900") < columns["imu"].index("mpu-6050")
    assert main(["list", "sensors", "--long"]) == 0
    shown = capsys.readouterr().out
    assert "zed-f9p" in shown
    assert "* typical of the class" in " ".join(shown.split())
    assert main(["list", "profiles", "--long"]) == 2
    capsys.readouterr()
    assert main(["list", "baro", "--long"]) == 0
    only = capsys.readouterr().out
    assert "bmp581" in only
    assert "zed-f9p" not in only
    assert main(["list", "nosuch"]) == 2
    assert "not a kind; there are profiles" in capsys.readouterr().err


def test_no_triad_is_free_of_noise():
    """Where a datasheet has none, what is typical of the class is assumed: the median of the others."""
    for path in sorted((CATALOG / "imu").glob("*.toml")):
        sheet, spec = document(path), read_imu(path, path.name)
        assert min(spec.gyro.random_walk, spec.accel.random_walk) > 0.0, path.stem
        for one in find_typical(sheet["class"], "accel", "noise"):
            if one.key in sheet.get("assumed", ()) and path.stem != "adis16475":  # has that of a sibling
                assert sheet["accel"][one.key.partition(".")[2]] == one.value, path.stem
