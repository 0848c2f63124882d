"""A file in human units becomes SI exactly, what was typed last wins, and everything that is wrong with it is
said at once: where, what, and what would be right."""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import get_args

import pytest

from bench.core.files.places import PACKAGE
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.io import config
from bench.io.config.datasheets import read_imu
from bench.io.config.log import load_log
from bench.io.config.overrides import split_overrides
from bench.io.config.toml_file import read_toml
from bench.navigation.built_in import BUILT_IN
from bench.simulation.flight.legs.climbs import Climb
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import FigureEight, Turn

SHIPPED = [row.name for row in config.list_profiles()]

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
[[leg]]
kind = "climb"
to_alt_m = 1100.0
rate_mps = 2.0
[[leg]]
kind = "turn"
by_deg = -90.0
bank_deg = 30.0
[[leg]]
kind = "figure-eight"
bank_deg = 18.0
laps = 2
[sensors]
imu = "matched-mems"
gnss = "matched-white"
[[estimator]]
use = "loose-15"
"""


@pytest.fixture(autouse=True)
def beside_the_profile(tmp_path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)


def write(folder: Path, text: str = PROFILE, name: str = "own.toml") -> str:
    (folder / name).write_text(text)
    return str(folder / name)


def errors(name: str, **keywords) -> list[str]:
    """The messages of a profile that is wrong, without the folder of its file."""
    with pytest.raises(ConfigError) as caught:
        config.read_profile(name, **keywords)
    return [message.replace(f"{Path(name).parent}/", "") for message in caught.value.messages]


def test_a_file_of_another_kind_says_what_takes_it(tmp_path):
    log, campaign = '[imu]\nfile = "imu.csv"\n', 'profiles = ["static"]\n'
    takes = "bench navigate takes it, and bench tune with --log"
    assert errors(write(tmp_path, log)) == [f"own.toml: a log, not a profile; {takes}"]
    assert errors(write(tmp_path, campaign)) == [
        "own.toml: a campaign, not a profile; bench campaign takes it"
    ]
    for text, said in (
        (PROFILE, "a profile, not a log; bench run"),
        (campaign, "a campaign, not a log; bench campaign"),
    ):
        with pytest.raises(ConfigError, match=f"own.toml: {said} takes it"):
            load_log(write(tmp_path, text))


# --- from human units to SI ---------------------------------------------------------------------------


def test_a_profile_becomes_si(tmp_path):
    profile = config.read_profile(write(tmp_path))
    flight = profile.flight
    assert (profile.name, flight.rate, flight.speed, flight.alt) == ("own", 200.0, 25.0, 1000.0)
    assert flight.lat == pytest.approx(math.pi / 4, rel=1e-15)
    assert flight.lon == pytest.approx(-math.pi / 2, rel=1e-15)
    assert flight.heading == pytest.approx(math.pi, rel=1e-15)
    straight, climb, turn, eight = flight.legs
    assert (straight, climb) == (Straight(30.0), Climb(1100.0, 2.0))
    assert isinstance(turn, Turn)
    assert turn.by == pytest.approx(-math.pi / 2)
    assert turn.bank == pytest.approx(math.pi / 6)
    assert isinstance(eight, FigureEight)
    assert (eight.bank, eight.laps) == (pytest.approx(math.pi / 10), 2)
    sensors = profile.sensors
    assert sensors.initial_tilt_sd == pytest.approx(math.radians(0.5))
    assert sensors.baro is None
    assert sensors.assumed.imu == sensors.imu
    assert sensors.antenna_b == flight.aircraft.antenna_b


def test_antenna_and_static_port_are_handed_on_relative_to_the_imu(tmp_path):
    """aircraft.toml has all of them relative to the center of gravity."""
    folder = config.read_profile(write(tmp_path)).flight.aircraft.folder
    own = tmp_path / "aircraft" / "kite"
    shutil.copytree(folder, own)
    (own / "aerosonde.xml").rename(own / "kite.xml")
    shipped = (own / "aircraft.toml").read_text()
    profile = write(tmp_path, PROFILE.replace('"aerosonde"', '"kite"'))
    at_cg = config.read_profile(profile)
    assert at_cg.flight.aircraft.imu_b == (0.0, 0.0, 0.0)
    imu = "\n[imu]\nforward_m = 0.5\nright_m = -0.25\ndown_m = 0.125\n"
    (own / "aircraft.toml").write_text(shipped + imu)
    off_cg = config.read_profile(profile)
    assert off_cg.flight.aircraft.imu_b == (0.5, -0.25, 0.125)
    moved = [a - b for a, b in zip(at_cg.sensors.antenna_b, off_cg.sensors.antenna_b, strict=True)]
    assert moved == pytest.approx([0.5, -0.25, 0.125], abs=1e-15)
    ports = at_cg.flight.aircraft.static_port_b, off_cg.flight.aircraft.static_port_b
    assert [a - b for a, b in zip(*ports, strict=True)] == pytest.approx([0.5, -0.25, 0.125], abs=1e-15)
    (own / "aircraft.toml").write_text(shipped + imu.replace("right_m = -0.25", "rigth_m = 200"))
    assert errors(profile) == [
        "kite/aircraft.toml: [imu] right_m is missing",
        "kite/aircraft.toml: [imu]: unknown key 'rigth_m'. Did you mean 'right_m'?\n"
        "  known keys: down_m, forward_m, right_m",
    ]


# By hand: 1 deg = 0.0174532925 rad, 1 h = 3600 s, 1 g = 9.80665 m/s^2. The first row is the gyro of grade 3
# of table 2.4.2: 0.01 deg/sqrt(h) = 0.01 * 0.0174532925 / 60 rad/sqrt(s).
BY_HAND = [
    ("gyro", "noise_deg_sqrt_h", 0.01, "random_walk", 2.9088821e-6),
    ("gyro", "noise_deg_s_sqrt_hz", 0.0035, "random_walk", 6.1086524e-5),
    ("gyro", "bias_instability_deg_h", 0.1, "bias_instability", 4.8481368e-7),
    ("gyro", "turn_on_bias_sd_deg_h", 36.0, "turn_on_bias_sd", 1.7453293e-4),
    ("gyro", "turn_on_bias_sd_deg_s", 0.01, "turn_on_bias_sd", 1.7453293e-4),
    ("gyro", "scale_factor_sd_ppm", 200.0, "scale_factor_sd", 2e-4),
    ("gyro", "scale_factor_sd_percent", 0.5, "scale_factor_sd", 5e-3),
    ("gyro", "misalignment_sd_mrad", 0.75, "misalignment_sd", 7.5e-4),
    ("gyro", "misalignment_sd_deg", 0.1, "misalignment_sd", 1.7453293e-3),
    ("gyro", "quantization_deg", 0.001, "quantization", 1.7453293e-5),
    ("gyro", "quantization_rad", 2e-6, "quantization", 2e-6),
    ("gyro", "bias_correlation_s", 250.0, "bias_correlation", 250.0),
    ("accel", "noise_m_s_sqrt_h", 0.02, "random_walk", 3.3333333e-4),
    ("accel", "noise_ug_sqrt_hz", 60.0, "random_walk", 5.88399e-4),
    ("accel", "bias_instability_ug", 15.0, "bias_instability", 1.4709975e-4),
    ("accel", "bias_instability_mg", 0.05, "bias_instability", 4.903325e-4),
    ("accel", "turn_on_bias_sd_mg", 2.0, "turn_on_bias_sd", 1.96133e-2),
    ("accel", "scale_factor_sd_ppm", 300.0, "scale_factor_sd", 3e-4),
    ("accel", "scale_factor_sd_percent", 0.1, "scale_factor_sd", 1e-3),
    ("accel", "misalignment_sd_mrad", 1.0, "misalignment_sd", 1e-3),
    ("accel", "misalignment_sd_deg", 0.5, "misalignment_sd", 8.7266463e-3),
    ("accel", "quantization_m_s", 1e-5, "quantization", 1e-5),
    ("accel", "bias_correlation_s", 100.0, "bias_correlation", 100.0),
    ("gyro", "bias_instability_deg_s", 0.01, "bias_instability", 1.7453293e-4),
    ("gyro", "rate_random_walk_deg_h_sqrt_h", 1.0, "rate_random_walk", 8.0802280e-8),
    ("gyro", "rate_random_walk_deg_s_sqrt_s", 1e-06, "rate_random_walk", 1.7453293e-8),
    ("gyro", "g_sensitivity_sd_deg_h_g", 1.0, "g_sensitivity_sd", 4.9437237e-7),
    ("gyro", "g_sensitivity_sd_deg_s_g", 0.1, "g_sensitivity_sd", 1.7797405e-4),
    ("gyro", "g2_sensitivity_sd_deg_h_g2", 1.0, "g2_sensitivity_sd", 5.0411952e-8),
    ("gyro", "g2_sensitivity_sd_deg_s_g2", 0.1, "g2_sensitivity_sd", 1.8148303e-5),
    ("gyro", "temperature_sd_deg_h_k", 36.0, "temperature_sd", 1.7453293e-4),
    ("gyro", "temperature_sd_deg_s_k", 0.01, "temperature_sd", 1.7453293e-4),
    ("gyro", "dead_zone_deg_h", 36.0, "dead_zone", 1.7453293e-4),
    ("gyro", "dead_zone_deg_s", 0.01, "dead_zone", 1.7453293e-4),
    ("gyro", "range_deg_s", 450.0, "range", 7.8539816),
    ("accel", "noise_mg_sqrt_hz", 0.14, "random_walk", 1.372931e-3),
    ("accel", "turn_on_bias_sd_ug", 25.0, "turn_on_bias_sd", 2.4516625e-4),
    ("accel", "rate_random_walk_ug_sqrt_h", 60.0, "rate_random_walk", 9.80665e-6),
    ("accel", "quadratic_sd_ug_g2", 50.0, "quadratic_sd", 5.0985811e-6),
    ("accel", "temperature_sd_ug_k", 100.0, "temperature_sd", 9.80665e-4),
    ("accel", "temperature_sd_mg_k", 0.1, "temperature_sd", 9.80665e-4),
    ("accel", "dead_zone_ug", 10.0, "dead_zone", 9.80665e-5),
    ("accel", "dead_zone_mg", 0.01, "dead_zone", 9.80665e-5),
    ("accel", "range_g", 8.0, "range", 78.4532),
    ("gyro", "misalignment_sd_arcsec", 20.0, "misalignment_sd", 9.6962736e-5),
    ("gyro", "misalignment_sd_percent", 2.0, "misalignment_sd", 0.02),
    ("gyro", "nonorthogonality_sd_arcsec", 20.0, "nonorthogonality_sd", 9.6962736e-5),
    ("gyro", "nonorthogonality_sd_deg", 0.1, "nonorthogonality_sd", 1.7453293e-3),
    ("gyro", "nonorthogonality_sd_mrad", 0.75, "nonorthogonality_sd", 7.5e-4),
    ("gyro", "nonorthogonality_sd_percent", 1.0, "nonorthogonality_sd", 0.01),
    ("gyro", "alignment_sd_arcsec", 20.0, "alignment_sd", 9.6962736e-5),
    ("gyro", "alignment_sd_deg", 0.1, "alignment_sd", 1.7453293e-3),
    ("gyro", "alignment_sd_mrad", 0.75, "alignment_sd", 7.5e-4),
    ("gyro", "alignment_sd_percent", 1.0, "alignment_sd", 0.01),
    ("gyro", "scale_asymmetry_sd_ppm", 50.0, "scale_asymmetry_sd", 5e-5),
    ("gyro", "scale_asymmetry_sd_percent", 0.1, "scale_asymmetry_sd", 1e-3),
    ("gyro", "nonlinearity_sd_ppm", 50.0, "nonlinearity_sd", 5e-5),
    ("gyro", "nonlinearity_sd_percent", 0.1, "nonlinearity_sd", 1e-3),
    ("gyro", "bandwidth_hz", 50.0, "bandwidth", 50.0),
    ("gyro", "delay_s", 0.002, "delay", 0.002),
    ("accel", "misalignment_sd_arcsec", 20.0, "misalignment_sd", 9.6962736e-5),
    ("accel", "misalignment_sd_percent", 2.0, "misalignment_sd", 0.02),
    ("accel", "nonorthogonality_sd_arcsec", 20.0, "nonorthogonality_sd", 9.6962736e-5),
    ("accel", "nonorthogonality_sd_deg", 0.1, "nonorthogonality_sd", 1.7453293e-3),
    ("accel", "nonorthogonality_sd_mrad", 0.75, "nonorthogonality_sd", 7.5e-4),
    ("accel", "nonorthogonality_sd_percent", 1.0, "nonorthogonality_sd", 0.01),
    ("accel", "alignment_sd_arcsec", 20.0, "alignment_sd", 9.6962736e-5),
    ("accel", "alignment_sd_deg", 0.1, "alignment_sd", 1.7453293e-3),
    ("accel", "alignment_sd_mrad", 0.75, "alignment_sd", 7.5e-4),
    ("accel", "alignment_sd_percent", 1.0, "alignment_sd", 0.01),
    ("accel", "scale_asymmetry_sd_ppm", 50.0, "scale_asymmetry_sd", 5e-5),
    ("accel", "scale_asymmetry_sd_percent", 0.1, "scale_asymmetry_sd", 1e-3),
    ("accel", "nonlinearity_sd_ppm", 50.0, "nonlinearity_sd", 5e-5),
    ("accel", "nonlinearity_sd_percent", 0.1, "nonlinearity_sd", 1e-3),
    ("accel", "bandwidth_hz", 50.0, "bandwidth", 50.0),
    ("accel", "delay_s", 0.002, "delay", 0.002),
    ("gyro", "resolution_deg_s", 0.01, "resolution", 1.7453293e-04),
    ("gyro", "temperature2_sd_deg_h_k2", 36.0, "temperature2_sd", 1.7453293e-04),
    ("gyro", "temperature2_sd_deg_s_k2", 0.01, "temperature2_sd", 1.7453293e-04),
    ("gyro", "hysteresis_sd_deg_h", 36.0, "hysteresis_sd", 1.7453293e-04),
    ("gyro", "hysteresis_sd_deg_s", 0.01, "hysteresis_sd", 1.7453293e-04),
    ("gyro", "transient_sd_deg_h", 36.0, "transient_sd", 1.7453293e-04),
    ("gyro", "transient_sd_deg_s", 0.01, "transient_sd", 1.7453293e-04),
    ("gyro", "transient_time_s", 60.0, "transient_time", 60.0),
    ("accel", "resolution_ug", 100.0, "resolution", 9.8066500e-04),
    ("accel", "resolution_mg", 0.1, "resolution", 9.8066500e-04),
    ("accel", "temperature2_sd_ug_k2", 100.0, "temperature2_sd", 9.8066500e-04),
    ("accel", "hysteresis_sd_ug", 100.0, "hysteresis_sd", 9.8066500e-04),
    ("accel", "hysteresis_sd_mg", 0.1, "hysteresis_sd", 9.8066500e-04),
    ("accel", "transient_sd_ug", 100.0, "transient_sd", 9.8066500e-04),
    ("accel", "transient_sd_mg", 0.1, "transient_sd", 9.8066500e-04),
    ("accel", "transient_time_s", 60.0, "transient_time", 60.0),
]


@pytest.mark.parametrize(("triad", "key", "value", "field", "si"), BY_HAND)
def test_a_datasheet_figure_becomes_si(tmp_path, triad, key, value, field, si):
    whole_range = "range_deg_s" if triad == "gyro" else "range_g"
    needs = {"bias_instability": "bias_correlation_s = 300.0", "nonlinearity_sd": f"{whole_range} = 8.0"}
    needs["transient_sd"] = "transient_time_s = 60.0"
    needs["transient_time"] = f"transient_sd_{'deg_h' if triad == 'gyro' else 'ug'} = 1.0"
    write(tmp_path, f'source = "by hand"\n[{triad}]\n{key} = {value}\n{needs.get(field, "")}\n', "unit.toml")
    spec = read_imu(tmp_path / "unit.toml", "unit.toml")
    assert getattr(getattr(spec, triad), field) == pytest.approx(si, rel=1e-7)
    other = spec.accel if triad == "gyro" else spec.gyro
    assert getattr(other, field) == 0.0


def test_every_key_of_a_datasheet_is_computed_by_hand():
    figures = triad_figures_of(TriadSpec).items()
    known = {
        (triad, key)
        for triad in ("gyro", "accel")
        for name, told in figures
        for key in told.keys(name, triad)
    }
    assert known == {(triad, key) for triad, key, *_ in BY_HAND}


def test_gnss_decay_is_the_inverse_of_its_length(tmp_path):
    """A-5.2.2: 250 km is 4e-6 1/m, 2000 s is 5e-4 1/s."""
    text = """
    source = "by hand"
    [gnss]
    rate_hz = 1
    pos_h_white_sd_m = 2
    pos_v_white_sd_m = 3
    vel_white_sd_mps = 0.03
    pos_h_markov_sd_m = 6
    pos_decay_distance_km = 250
    pos_decay_time_s = 2000
    """
    write(tmp_path, text, "rx.toml")
    spec = config.read_profile(write(tmp_path), {"sensors.gnss": "rx.toml"}).sensors.gnss
    assert spec.pos_decay_distance == pytest.approx(4e-6)
    assert spec.pos_decay_time == pytest.approx(5e-4)
    assert (spec.name, spec.rate, spec.vel_decay_time) == ("rx", 1.0, 0.0)


@pytest.mark.parametrize(
    ("word", "severity"), [("none", 0), ("light", 3), ("moderate", 4), ("severe", 6), (5, 5)]
)
def test_turbulence_by_name_and_by_number(tmp_path, word, severity):
    profile = config.read_profile(write(tmp_path), {"wind.turbulence": word})
    assert profile.flight.severity == severity


# --- what was typed last wins -------------------------------------------------------------------------


def test_overrides_win_over_the_file_and_the_file_over_the_defaults(tmp_path):
    name = write(tmp_path, "seed = 3\nturbulence_seed = 4\n" + PROFILE)
    plain = config.read_profile(name)
    assert (plain.seed, plain.flight.turbulence_seed, plain.evaluation.begin) == (3, 4, 60.0)
    seeded = config.read_profile(name, seed=9)
    assert (seeded.seed, seeded.flight.turbulence_seed) == (9, 9)
    typed = config.read_profile(name, {"seed": 5, "leg.1.duration_s": 12, "evaluation.from_s": 20.0})
    assert (typed.seed, typed.flight.turbulence_seed) == (5, 4)
    both = config.read_profile(name, {"seed": 5}, seed=9)
    assert (both.seed, both.flight.turbulence_seed) == (5, 5)
    told = config.read_profile(name, {"seed": 5, "turbulence_seed": 6}, seed=9)
    assert (told.seed, told.flight.turbulence_seed) == (5, 6)
    assert typed.flight.legs[0] == Straight(12.0)
    assert typed.evaluation.begin == 20.0
    assert config.read_profile(write(tmp_path), seed=None).flight.turbulence_seed == 0


def test_the_assumed_units_are_those_on_board_unless_the_file_says_otherwise(tmp_path):
    name = write(tmp_path)
    swapped = config.read_profile(name, {"sensors.imu": "stim300"}).sensors
    assert (swapped.imu.name, swapped.assumed.imu.name) == ("stim300", "stim300")
    told = config.read_profile(name, {"sensors.assumed.imu": "stim300"}).sensors
    assert (told.imu.name, told.assumed.imu.name, told.assumed.gnss) == ("matched-mems", "stim300", told.gnss)


def test_estimators_are_chosen_by_label(tmp_path):
    more = '[[estimator]]\nuse = "my.lab:Huber"\noptions = { k = 1.5 }\n'
    name = write(tmp_path, PROFILE + more)
    assert [c.label for c in config.read_profile(name, allow_code=True).estimators] == ["loose-15", "Huber"]
    (kept,) = config.read_profile(name, estimators=["Huber"], allow_code=True).estimators
    assert (kept.use, kept.options) == ("my.lab:Huber", {"k": 1.5})
    assert errors(name, estimators=["loos-15"]) == [
        "own.toml: no filter 'loos-15' in this profile. Did you mean 'loose-15'?\n"
        f"  known filters: {', '.join(sorted([*BUILT_IN, 'Huber']))}, 'module:Class', 'file:SOLUTION', "
        "'command:PROGRAM ...'"
    ]
    others = config.read_profile(name, estimators=["free-inertial", "your.lab:Own"])
    assert [(c.use, c.label) for c in others.estimators] == [
        ("free-inertial", "free-inertial"),
        ("your.lab:Own", "Own"),
    ]
    assert others.document["estimator"][1] == {"use": "your.lab:Own", "label": "Own", "options": {}}


@pytest.mark.parametrize("name", SHIPPED)
def test_the_document_is_the_profile_as_flown(tmp_path, name):
    """Written as JSON, read back and flown again, it gives the same profile."""
    profile = config.read_profile(name, {"sensors.imu": "stim300"}, seed=7)
    document = json.loads(json.dumps(profile.document))
    assert document["seed"] == document["turbulence_seed"] == 7
    assert document["sensors"]["assumed"]["imu"] == "stim300"
    again = config.read_profile(write(tmp_path), document)
    assert (again.flight, again.sensors, again.estimators) == (
        profile.flight,
        profile.sensors,
        profile.estimators,
    )


def test_the_matched_profile_is_the_same_flight_with_other_sensors():
    documents = [
        dict(config.read_profile(name).document) for name in ("figure-eight", "figure-eight-matched")
    ]
    sensors = [document.pop("sensors") for document in documents]
    for document in documents:
        del document["title"], document["estimator"]
    assert documents[0] == documents[1]
    assert not set(sensors[0]["assumed"].values()) & set(sensors[1]["assumed"].values())


# --- what is wrong is said in one line, all at once ---------------------------------------------------


def test_the_messages_of_the_conventions(tmp_path):
    text = """
    aircraft = "aerosonde"
    [start]
    lat_deg = 95
    lon_deg = 0.0
    alt_m = 1000.0
    heading_deg = 0.0
    speed_mps = 25.0
    [[leg]]
    kind = "climb"
    climb_rate_mps = 3.0
    to_alt_m = 2000.0
    rate_mps = 2.0
    [sensors]
    imu = "matched-mems"
    [[estimator]]
    use = "free-inertial"
    """
    assert errors(write(tmp_path, text, "survey.toml")) == [
        "survey.toml: [start] lat_deg = 95 deg is outside -90 to 90 deg",
        "survey.toml: [[leg]] 1 (climb): unknown key 'climb_rate_mps'. Did you mean 'rate_mps'?\n"
        "  known keys: kind, rate_mps, speed_mps, to_alt_m",
    ]


NAN, INF = float("nan"), float("inf")
ONE_THING_WRONG = [
    (
        {"wnd": {}},
        "unknown key 'wnd'. Did you mean 'wind'?\n  known keys: aircraft, alignment, date, duration_s, ",
    ),
    ({"start.alt_ft": 3000.0}, "[start]: unknown key 'alt_ft'. Did you mean 'alt_m'?\n  known keys: alt_m,"),
    ({"sensors.assumed.imx": "a"}, "[sensors.assumed]: unknown key 'imx'. Did you mean 'imu'?"),
    ({"estimator.1.us": "a"}, "[[estimator]] 1: unknown key 'us'. Did you mean 'use'?"),
    ({"leg.2.rate_mps": NAN}, "[[leg]] 2 (climb): rate_mps = nan m/s must be a finite number"),
    ({"start.alt_m": INF}, "[start] alt_m = inf m must be a finite number"),
    ({"start.alt_m": True}, "[start] alt_m = true must be a number"),
    ({"start.alt_m": "1000"}, "[start] alt_m = '1000' must be a number"),
    ({"seed": 1.5}, "seed = 1.5 must be a whole number"),
    ({"seed": -1}, "seed = -1 is outside 0 to 9.0072e+15"),
    ({"title": 3}, "title = 3 must be a text in quotes"),
    ({"rate_hz": 300}, "rate_hz = 300 Hz must be 100, 200, 250, 400, 500 or 1000"),
    ({"start": 3}, "start = 3 must be a table"),
    ({"leg": 3}, "leg = 3 must be a list"),
    ({"leg": []}, "leg = [] must have at least 1 entry"),
    ({"leg.1": 3}, "[[leg]] 1 = 3 must be a table"),
    ({"leg.1": {}}, "[[leg]] 1: kind is missing"),
    ({"leg.1": {"kind": "straight"}}, "[[leg]] 1 (straight): duration_s is missing"),
    (
        {"leg.1.kind": "lop"},
        "[[leg]] 1: kind = 'lop' is unknown\n  known kinds: aileron-roll, approach, climb,",
    ),
    ({"leg.3.by_deg": 0}, "[[leg]] 3 (turn): by_deg = 0 deg must not be 0; positive turns right"),
    ({"leg.3.bank_deg": 60}, "[[leg]] 3 (turn): bank_deg = 60 deg is above the 45 deg of the aerosonde"),
    ({"leg.2.rate_mps": 9}, "[[leg]] 2 (climb): rate_mps = 9 m/s is above the 3.5 m/s of the aerosonde"),
    ({"leg.2.to_alt_m": 900}, "[[leg]] 2 (climb): to_alt_m = 900 m is not above the 1000 m before it"),
    ({"leg.2.kind": "descend"}, "[[leg]] 2 (descend): to_alt_m = 1100 m is not below the 1000 m before it"),
    ({"start.speed_mps": 60}, "[start] speed_mps = 60 m/s is outside 20 to 29 m/s of the aerosonde"),
    ({"terrain.alt_m": 5000.0}, "[terrain] alt_m = 5000 m is not below the start at alt_m = 1000 m"),
    (
        {"wind.turbulence": "bad"},
        "[wind] turbulence = 'bad' must be none, light, moderate, severe or a whole",
    ),
    ({"wind.turbulence": 8}, "[wind] turbulence = 8 must be none, light, moderate, severe or a whole number"),
    ({"initial_error_sd.pos_m": [1, 2]}, "[initial_error_sd] pos_m[2] is missing"),
    (
        {"initial_error_sd.pos_m": [1, -2, 3]},
        "[initial_error_sd] pos_m[1] = -2 m is outside 0.001 to 10000 m",
    ),
    (
        {"estimator.1": {"use": "my.lab:Huber", "options": {"k": INF}}},
        "[[estimator]] 1: options = { ... } must contain only finite numbers,",
    ),
    (
        {"estimator.1.use": "los-15"},
        "[[estimator]] 1: use = 'los-15' is not a built-in filter. Did you mean",
    ),
    ({"estimator.1.label": "a/b"}, "[[estimator]] 1: label = 'a/b' must be a name of letters, digits,"),
    ({"estimator.1.label": "l" * 101}, f"[[estimator]] 1: label = '{'l' * 101}' must be a name of letters,"),
    ({"evaluation.output_hz": 7}, "[evaluation] output_hz = 7 Hz must divide rate_hz = 200 Hz"),
    (
        {"evaluation.from_s": 100, "duration_s": 90},
        "[evaluation] from_s = 100 s is outside the flight, 0 to 90",
    ),
    ({"aircraft": "../etc"}, "aircraft = '../etc' must be a name of letters, digits, '-' and '_'"),
    ({"sensors.imu": "stim30"}, "[sensors] imu = 'stim30' is not in the catalog. Did you mean 'stim300'?\n"),
    ({"sensors.gnss": "x.toml"}, "[sensors] gnss = 'x.toml': no such file beside the profile"),
]


@pytest.mark.parametrize(("overrides", "message"), ONE_THING_WRONG)
def test_one_thing_wrong_is_one_message(tmp_path, overrides, message):
    (found,) = errors(write(tmp_path), overrides=overrides)
    assert found.startswith(f"own.toml: {message}")


def test_outages(tmp_path):
    def rows(*pairs):
        return {"gnss_outage": [{"start_s": start, "duration_s": duration} for start, duration in pairs]}

    name = write(tmp_path)
    taken = config.read_profile(name, {**rows((50, 10), (20, 30)), "duration_s": 70})
    assert taken.sensors.gnss_outages == ((20.0, 50.0), (50.0, 60.0))
    assert errors(name, overrides=rows((20, 30), (40, 30))) == [
        "own.toml: [[gnss_outage]] 2: start_s = 40 s overlaps [[gnss_outage]] 1 (20 to 50 s)"
    ]
    assert errors(name, overrides={**rows((50, 60)), "duration_s": 100}) == [
        "own.toml: [[gnss_outage]] 1: its end at 110 s is outside the flight, 0 to 100 s"
    ]


def test_an_aircraft_beside_a_relative_profile_has_a_whole_path(tmp_path, monkeypatch):
    """It is flown in a process that works in another folder."""
    shutil.copytree(PACKAGE.parent / "aircraft", tmp_path / "aircraft")
    shutil.copy(PACKAGE / "profiles" / "figure-eight.toml", tmp_path / "own.toml")
    monkeypatch.chdir(tmp_path)
    aircraft = config.read_profile("own.toml").flight.aircraft
    assert aircraft.folder == tmp_path / "aircraft" / "aerosonde"
    assert aircraft.systems.is_absolute()


def test_a_path_in_an_override_is_relative_to_the_present_folder(tmp_path, monkeypatch):
    """As any path on a command line; a path in the profile is relative to the profile."""
    profile = write(tmp_path)
    here = tmp_path / "here"
    (here / "sub").mkdir(parents=True)
    sheet = (PACKAGE / "catalog" / "imu" / "stim300.toml").read_text()
    (tmp_path / "my.toml").write_text(sheet.replace("bias_instability_deg_h", "unknown_key"))
    (here / "my.toml").write_text(sheet)
    (here / "sub" / "my.toml").write_text(sheet)
    monkeypatch.chdir(here)
    shipped = config.read_profile(profile, {"sensors.imu": "stim300"}).sensors.imu
    for name in ("my.toml", "sub/my.toml", "../here/my.toml", str(here / "my.toml")):
        for overrides in ({"sensors.imu": name}, {"sensors.assumed": {"imu": name}}):
            read = config.read_profile(profile, overrides)
            unit = read.sensors.imu if "sensors.imu" in overrides else read.sensors.assumed.imu
            assert dataclasses.replace(unit, name=shipped.name) == shipped
    assert errors(profile, overrides={"sensors.imu": "none.toml"}) == [
        f"own.toml: [sensors] imu = '{here.name}/none.toml': no such file"
    ]
    monkeypatch.chdir(tmp_path)
    message = errors("own.toml", overrides={"sensors.imu": "none.toml"})
    assert message == ["own.toml: [sensors] imu = 'none.toml': no such file in the current folder"]


def test_a_table_and_a_solution_on_the_command_line_are_in_the_present_folder(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    (tmp_path / "own.toml").write_text((PACKAGE / "profiles" / "figure-eight.toml").read_text())
    monkeypatch.chdir(tmp_path / "here")
    for key, value, located in (
        ("trajectory", "a.csv", str(tmp_path / "here" / "a.csv")),
        ("script", "a.xml", str(tmp_path / "here" / "a.xml")),
        ("script", "c1721", "c1721"),
        ("jsbsim_root", "../jsbsim", str(tmp_path / "here" / "../jsbsim")),
        ("imu.file", "a.bag", str(tmp_path / "here" / "a.bag")),
        ("sensors", {"imu": "a.toml"}, {"imu": str(tmp_path / "here" / "a.toml")}),
        ("title", "a.csv", "a.csv"),
    ):
        assert split_overrides({key: value}, tmp_path)[0] == {key: located}
        assert split_overrides({key: value}, tmp_path / "here")[0] == {key: value}
    for beside in (tmp_path, tmp_path / "here"):  # a datasheet of the catalog is in neither
        changes = split_overrides({"sensors.gnss.sky.navigation": ["a.nav"]}, beside)[1]
        assert changes.on_board["gnss"] == {"sky.navigation": [str(tmp_path / "here" / "a.nav")]}


def test_an_estimator_on_the_command_line_is_in_the_present_folder(tmp_path, monkeypatch):
    shipped = (PACKAGE / "profiles" / "static.toml").read_text()
    (tmp_path / "own.toml").write_text(f"{shipped}\n[[estimator]]\nuse = 'file:beside.csv'\n")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    own = config.read_profile("../own.toml").estimators
    k = len(own)
    assert own[-1].beside == Path("..")
    for overrides in (
        {f"estimator.{k}.use": "command:./filter {sensors} {solution}"},
        {f"estimator.{k}": {"use": "file:mine.csv"}},
        {"estimator": [{"use": "loose-15"}, {"use": "file:mine.csv"}]},
    ):
        changed = config.read_profile("../own.toml", overrides, allow_code=True).estimators[-1]
        assert changed.beside == Path()
    kept = config.read_profile("../own.toml", {f"estimator.{k}.label": "mine"}).estimators[-1]
    assert kept.beside == Path("..")


def test_an_aircraft_that_is_not_there_is_searched_beside_the_profile_too(tmp_path):
    (message,) = errors(write(tmp_path), overrides={"aircraft": "aerosond"})
    assert message.startswith("own.toml: aircraft = 'aerosond' is not found. Did you mean 'aerosonde'?\n")
    assert message.endswith(f"searched: aircraft, {PACKAGE.parent / 'aircraft'}, {PACKAGE / 'aircraft'}")
    own = tmp_path / "aircraft" / "kite"
    own.mkdir(parents=True)
    shipped = config.read_profile(write(tmp_path)).flight.aircraft.folder / "aircraft.toml"
    (own / "aircraft.toml").write_text(shipped.read_text().replace("min_speed_mps", "min_sped_mps"))
    found = errors(write(tmp_path), overrides={"aircraft": "kite"})
    assert found == [
        "kite/aircraft.toml: [limits] min_speed_mps is missing",
        "kite/aircraft.toml: [limits]: unknown key 'min_sped_mps'. Did you mean 'min_speed_mps'?\n"
        "  known keys: max_bank_deg, max_climb_mps, max_descent_mps, max_speed_mps, min_speed_mps",
    ]
    (own / "aircraft.toml").write_text(shipped.read_text())
    assert errors(write(tmp_path), overrides={"aircraft": "kite"}) == ["kite/kite.xml: no such file"]
    (own / "kite.xml").write_text("<fdm_config/>")
    for good, bad, message in (
        ('"uav"', '"jetliner"', "class = 'jetliner' must be 'uav', 'light', 'transport' or 'fighter'"),
        ("speed_mps = 28.0", "speed_mps = 30.0", "[[trim]] 3: speed_mps = 30 m/s is outside [limits]"),
        ('"runway", "g', '"runwey", "g', "assumed names 'runwey', which is not a table of this file"),
        ('"runway", "g', '"imu", "g', "assumed names 'imu', which is not a table of this file"),
        ("[rough_air]", "[rough_air]\nroll = 1.0", "[rough_air] 'roll' is not a gain of [guidance]"),
        (
            "[rough_flare]",
            "[approach]\npitch-gain = 4.0\n\n[rough_flare]",
            "'pitch-gain' is in [rough_flare] and [approach]; a landing takes one",
        ),
    ):
        (own / "aircraft.toml").write_text(shipped.read_text().replace(good, bad))
        assert errors(write(tmp_path), overrides={"aircraft": "kite"}) == [f"kite/aircraft.toml: {message}"]
    (own / "aircraft.toml").write_text(shipped.read_text())
    assert config.read_profile(write(tmp_path), {"aircraft": "kite"}).flight.aircraft.folder == own


def test_every_class_has_a_shape_and_limits(tmp_path):
    from bench.io.config.profile_tables import Category
    from bench.simulation.flight.sanity import LIMITS
    from bench.views.recording.meshes import MESHES

    own = tmp_path / "aircraft" / "kite"
    own.mkdir(parents=True)
    shipped = config.read_profile(write(tmp_path)).flight.aircraft.folder / "aircraft.toml"
    (own / "kite.xml").write_text("<fdm_config/>")
    shapes = {}
    for category in get_args(Category):
        (own / "aircraft.toml").write_text(shipped.read_text().replace('"uav"', f'"{category}"'))
        shapes[category] = config.read_profile(write(tmp_path), {"aircraft": "kite"}).flight.mesh
    assert shapes.keys() == LIMITS.keys()
    hovering = ("hummingbird", "helion")
    rotors = [config.read_profile("inspection", {"aircraft": name}).flight.mesh for name in hovering]
    assert {*shapes.values(), *rotors} == MESHES.keys()


def test_a_start_without_airspeed_is_the_trim_nearest_in_altitude(tmp_path):
    bare = PROFILE.replace("speed_mps = 25\n", "", 1)
    rows = config.read_profile("figure-eight").flight.aircraft.trims
    for alt, speed in rows:
        profile = config.read_profile(
            write(tmp_path, bare), {"start.alt_m": alt + 10, "leg.2.to_alt_m": 1300}
        )
        assert profile.flight.speed == profile.document["start"]["speed_mps"] == speed
    assert len({speed for _, speed in rows}) > 1


def test_everything_wrong_is_said_at_once(tmp_path):
    overrides = {"start.lat_deg": 95, "aircraft": "x", "sensors.imu": "y", "leg.1.bank_deg": 3, "rate_hz": 1}
    assert len(errors(write(tmp_path), overrides=overrides)) == 5


DATASHEET = [
    ("", "source is missing"),
    (
        'source = "a"\n[gyro]\nnoise_deg_h = 1',
        "[gyro]: unknown key 'noise_deg_h'. Did you mean 'noise_deg_sqrt_h'?",
    ),
    (
        'source = "a"\n[gyro]\nnoise_deg_sqrt_h = -1',
        "[gyro] noise_deg_sqrt_h = -1 deg/sqrt(h) is outside 0 to 1e+06 deg/sqrt(h)",
    ),
    (
        'source = "a"\n[accel]\nbias_instability_ug = 50\nbias_instability_mg = 0.05\nbias_correlation_s = 9',
        "[accel] bias_instability_ug and bias_instability_mg are the same figure; give one of them",
    ),
    (
        'source = "a"\n[gyro]\nbias_instability_deg_h = 1',
        "[gyro] bias_instability needs bias_correlation_s above 0 s: the catalog assumes 300 where no source "
        "states it",
    ),
    (
        'source = "a"\nassumed = ["gyro.bias"]\n[gyro]\nnoise_deg_sqrt_h = 1',
        "assumed: 'gyro.bias' is not a figure of this file",
    ),
    ('source = "a"\n[sources]\n"accel.x" = "b"', "[sources]: 'accel.x' is not a figure of this file"),
    ("source = ", "not valid TOML: Invalid value (at end of document)"),
]


@pytest.mark.parametrize(("text", "message"), DATASHEET)
def test_a_wrong_datasheet(tmp_path, text, message):
    write(tmp_path, text, "unit.toml")
    (found,) = errors(write(tmp_path), overrides={"sensors.imu": "unit.toml"})
    assert found.startswith(f"unit.toml: {message}")


@pytest.mark.parametrize(
    ("name", "message"),
    [
        (
            "figure-eigth",
            "no shipped profile 'figure-eigth' (a file of your own ends in .toml). Did you mean",
        ),
        ("nowhere.toml", "nowhere.toml: no such file"),
    ],
)
def test_a_profile_that_is_not_there(name, message):
    (found,) = errors(name)
    assert found.startswith(message)


def test_a_file_that_is_no_text(tmp_path):
    (tmp_path / "own.toml").write_bytes(b"title = '\xff'")
    assert errors(str(tmp_path / "own.toml")) == ["own.toml: not a text file in UTF-8"]
    (tmp_path / "dir.toml").mkdir()
    assert errors(str(tmp_path / "dir.toml")) == ["dir.toml: Is a directory"]
    os.mkfifo(tmp_path / "pipe.toml")
    assert errors(str(tmp_path / "pipe.toml")) == ["pipe.toml: not a regular file"]


def test_a_hostile_file_is_refused_in_bounded_memory_and_depth(tmp_path):
    (tmp_path / "deep.toml").write_text("a = " + "[" * 100_000)
    (found,) = errors(str(tmp_path / "deep.toml"))
    assert found == "deep.toml: not valid TOML: too many brackets within brackets"
    with (tmp_path / "huge.toml").open("wb") as file:
        file.truncate(3_000_000_000)  # a hole: it needs no room
    assert errors(str(tmp_path / "huge.toml")) == ["huge.toml: larger than 10 MB"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a." * 20_000 + "a = 1", "a dotted key has more than 50 names"),
        (f"[{' . '.join(['b'] * 5000)}]", "a dotted key has more than 50 names"),
        ("a" * 300 + " = 1", "the key a{30}... is longer than 200 characters"),
        ("k=1\n" * 100_001, "more than 100000 keys or tables"),
        (f"a = {'[' * 60}{']' * 60}", "more than 50 tables or arrays within each other"),
        (f"a = {'1' * 5000}", "not valid TOML: Exceeds the limit"),
        ('a.b = [{ c = "x\\u0000" }]', r"a text with the character \\u0000; leave it out"),
    ],
)
def test_what_would_take_long_to_parse_is_refused_at_once(tmp_path, text, message):
    """A dotted key of 40 kB would take half a minute."""
    (tmp_path / "x.toml").write_text(text)
    begun = time.process_time()
    with pytest.raises(ConfigError, match=f"^x.toml: {message}"):
        read_toml(tmp_path / "x.toml", "x.toml")
    assert time.process_time() - begun < 1.0


def test_twenty_errors_are_printed_and_the_rest_is_counted(tmp_path):
    path = tmp_path / "x.toml"
    path.write_text("".join(f"key_{k} = 1\n" for k in range(500)))
    with pytest.raises(ConfigError) as caught:
        config.read_profile(str(path))
    lines = str(caught.value).splitlines()
    assert sum(line.startswith(str(path)) for line in lines) == 20
    assert lines[-1] == f"and {len(caught.value.messages) - 20} more errors"
    assert len(caught.value.messages) >= 500


@pytest.mark.parametrize(
    ("key", "message"),
    [
        ("leg.9.bank_deg", "--set leg.9.bank_deg: '9' must be a number from 1 to 4"),
        ("aircraft.x", "--set aircraft.x: 'x' is not a key of a table"),
    ],
)
def test_an_override_that_leads_nowhere(tmp_path, key, message):
    assert errors(write(tmp_path), overrides={key: 1}) == [message]


def figures_of(**overrides):
    """The IMU on board and the one assumed of figure-eight, and its document."""
    profile = config.read_profile("figure-eight", {k.replace("__", "."): v for k, v in overrides.items()})
    return profile.sensors.imu, profile.sensors.assumed.imu, profile.document


def test_a_figure_of_a_datasheet_is_replaced_on_board_and_for_the_filters():
    plain, _, _ = figures_of()
    on_board, assumed, document = figures_of(sensors__imu__gyro__noise_deg_sqrt_h=0.3)
    assert on_board.gyro.random_walk == pytest.approx(math.radians(0.3) / 60)
    assert assumed == on_board
    assert replace(on_board, name=plain.name, gyro=plain.gyro) == plain
    assert on_board.name == f"{plain.name}, modified"
    assert document["sensors"]["imu"] == document["sensors"]["assumed"]["imu"] == on_board.name
    assert document["sensors.imu.gyro.noise_deg_sqrt_h"] == 0.3
    assert config.read_profile("figure-eight", document).sensors.assumed.imu == assumed
    assert document["sensors"]["gnss"] == "l1-code"


def test_a_figure_may_be_replaced_for_the_filters_alone():
    plain, _, _ = figures_of()
    on_board, assumed, document = figures_of(sensors__assumed__imu__gyro__noise_deg_sqrt_h=0.3)
    assert on_board == plain
    assert assumed.gyro.random_walk == pytest.approx(math.radians(0.3) / 60)
    assert document["sensors"]["imu"] == plain.name
    assert document["sensors"]["assumed"]["imu"] == f"{plain.name}, modified"
    both = {
        "sensors.imu.gyro.noise_deg_sqrt_h": 0.3,
        "sensors.assumed.imu.gyro.noise_deg_sqrt_h": 0.6,
        "sensors.baro.white_sd_m": 2.0,
    }
    sensors = config.read_profile("figure-eight", both).sensors
    assert sensors.assumed.imu.gyro.random_walk == pytest.approx(2 * sensors.imu.gyro.random_walk)
    assert sensors.baro.white_sd == sensors.assumed.baro.white_sd == 2.0


def test_what_filters_assume_is_what_was_typed_last():
    figure, name = {"sensors.imu.gyro.noise_deg_sqrt_h": 5.0}, {"sensors.assumed.imu": "adis16495"}
    plain = config.read_profile("figure-eight", name)
    for overrides in (figure | name, {"sensors.imu.gyro.noise_deg_s_sqrt_hz": 1.0} | figure | name):
        named_last = config.read_profile("figure-eight", overrides)
        for profile in (named_last, config.read_profile("figure-eight", named_last.document)):
            assert profile.sensors.imu.gyro.random_walk == pytest.approx(math.radians(5.0) / 60)
            assert profile.sensors.assumed.imu == plain.sensors.assumed.imu
            assert profile.document["sensors"]["assumed"]["imu"] == "adis16495"
    figure_last = config.read_profile("figure-eight", name | figure)
    assert figure_last.sensors.assumed.imu.name == "adis16495, modified"
    assert figure_last.sensors.assumed.imu.gyro.random_walk == figure_last.sensors.imu.gyro.random_walk
    own = {"sensors.assumed.imu.gyro.noise_deg_sqrt_h": 0.6}
    for overrides, assumed in ((figure | own, 0.6), (own | figure, 5.0), (figure | own | name, 0.6)):
        sensors = config.read_profile("figure-eight", overrides).sensors
        assert sensors.assumed.imu.gyro.random_walk == pytest.approx(math.radians(assumed) / 60)


def test_a_figure_may_differ_by_axis(tmp_path):
    plain, _, _ = figures_of()
    usual = plain.gyro.random_walk
    x, in_hertz = math.radians(0.6) / 60, math.radians(0.02)
    key = "sensors.imu.gyro.noise_deg_sqrt_h"
    on_board, assumed, document = figures_of(**{f"{key}.x": 0.6})
    assert on_board.gyro.by_axis("random_walk") == pytest.approx([x, usual, usual])
    assert on_board.gyro.random_walk == pytest.approx(max(x, usual))
    assert assumed == on_board
    assert on_board.name == f"{plain.name}, modified"
    assert config.read_profile("figure-eight", document).sensors.imu == on_board
    other = {f"{key}.x": 0.6, "sensors.assumed.imu.gyro.noise_deg_s_sqrt_hz.z": 0.02}
    on_board, assumed, _ = figures_of(**other)
    assert on_board.gyro.by_axis("random_walk") == pytest.approx([x, usual, usual])
    assert assumed.gyro.by_axis("random_walk") == pytest.approx([x, usual, in_hertz])
    path = tmp_path / "unit.toml"
    path.write_text('source = "by hand"\n[accel]\nturn_on_bias_sd_mg = [1, 2.0, 3]\n')
    spec = read_imu(path, "unit.toml", {"accel.turn_on_bias_sd_mg.y": 0.5}).accel
    assert spec.by_axis("turn_on_bias_sd") / 9.80665e-3 == pytest.approx([1.0, 0.5, 3.0])
    assert spec.averaged().turn_on_bias_sd == pytest.approx(math.sqrt((1 + 0.25 + 9) / 3) * 9.80665e-3)
    assert read_imu(path, "unit.toml", {"accel.turn_on_bias_sd_mg": 4}).accel.axes == ()
    with pytest.raises(ConfigError, match="must be a number, or one for each of x, y and z"):
        read_imu(path, "unit.toml", {"accel.turn_on_bias_sd_mg.y": -0.5})


@pytest.mark.parametrize(
    ("key", "message"),
    [
        (
            "sensors.imu.gyro.nois_deg_sqrt_h",
            "unknown key 'nois_deg_sqrt_h'. Did you mean 'noise_deg_sqrt_h'?",
        ),
        ("sensors.imu.gyro.noise_deg_sqrt_h.w", "'w' is not a key of a table"),
        ("sensors.imu.gyro.range_deg_s.x", "[gyro] range_deg_s cannot differ by axis"),
        (
            "sensors.radar.white_sd_m",
            "figure-eight.toml: --set sensors.radar.white_sd_m: no radar is on board",
        ),
        ("sensors.assumed.radar.white_sd_m", "no radar is on board"),
    ],
)
def test_a_figure_that_is_none_is_refused(key, message):
    with pytest.raises(ConfigError) as raised:
        config.read_profile("figure-eight", {key: 1.0})
    assert message in "\n".join(raised.value.messages)


def test_shipped_files_parse_and_have_titles():
    shelves = [*config.list_profiles(), *config.list_aircraft(), *config.list_sensors()]
    assert all(row.name and row.title for row in shelves)
    for path in PACKAGE.glob("profiles/*.toml"):
        assert tomllib.loads(path.read_text())
        config.read_profile(path.stem)
