"""The catalog: every figure is in its datasheet's unit and has a source or is marked as assumed."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from synthetic import still

import bench
from bench.config.datasheets import read_baro, read_gnss, read_imu
from bench.sensors import imu

CATALOG = Path(bench.__file__).parent / "catalog"
FILES = sorted(CATALOG.glob("*/*.toml"))
TABLES = {"imu": ("gyro", "accel"), "gnss": ("gnss",), "baro": ("baro",)}
CLASSES = ("consumer", "industrial", "tactical", "navigation", "synthetic")
DEG = np.pi / 180


def document(path):
    return tomllib.loads(path.read_text(encoding="utf-8"))


def entry(kind, name, read):
    return read(CATALOG / kind / f"{name}.toml", f"{name}.toml")


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_figure_has_a_source_or_is_marked_assumed(path):
    """bias_model is a choice of model, not a figure."""
    entry = document(path)
    figures = {
        f"{table}.{key}" for table in TABLES[path.parent.name] for key in entry[table] if key != "bias_model"
    }
    sourced, assumed = set(entry.get("sources", {})), set(entry.get("assumed", []))
    assert sourced | assumed == figures
    assert not sourced & assumed
    assert all(text.strip() for text in [entry["title"], entry["source"], *entry.get("sources", {}).values()])
    assert entry["class"] in CLASSES
    if entry["class"] == "synthetic":
        assert not sourced


@pytest.mark.parametrize("path", FILES, ids=lambda path: f"{path.parent.name}/{path.stem}")
def test_every_entry_becomes_a_spec_by_its_name(path):
    read = {"imu": read_imu, "gnss": read_gnss, "baro": read_baro}[path.parent.name]
    assert read(path, path.name).name == path.stem


def test_three_real_imus_of_three_classes():
    classes = {document(path)["class"] for path in FILES if path.parent.name == "imu"}
    assert {"consumer", "industrial", "tactical"} <= classes


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
    barometer = entry("baro", "matched-walk", read_baro)
    assert min(barometer.white_sd, barometer.bias_sd, barometer.bias_walk) > 0
    assert barometer.quantization == barometer.latency == 0


@pytest.mark.parametrize("path", sorted((CATALOG / "imu").glob("*.toml")), ids=lambda path: path.stem)
def test_every_imu_measures(path):
    record, bias = imu.measure(still(1.0, 100.0), read_imu(path, path.name), 1, 0)
    assert np.isfinite(record.dtheta_b).all()
    assert np.isfinite(record.dvel_b).all()
    assert bias.gyro_b.any()
