"""IMU noise in the parameters of other programs: round trips, and noise drawn by their own discretization.

The formulas of the other programs stand here a second time, as their source has them: a simulated record of
the converted parameters has the Allan deviation of the datasheet, a filter with them the covariance.
"""

from __future__ import annotations

import re
from dataclasses import replace

import allantools
import numpy as np
import pytest
import yaml
from numpy.testing import assert_allclose

import bench
from bench.cli.command_line import main
from bench.core.records.sensor_specs import GAUSS_MARKOV_PEAK, AxisFigures, ImuSpec, ThermalSpec, TriadSpec
from bench.core.words.exceptions import WRONG, ConfigError
from bench.io.config.datasheets import read_imu
from bench.io.parameters import (
    PROGRAMS,
    TUNINGS,
    bound_tuning,
    format_sheet,
    read_parameters,
    write_parameters,
)

RATE = 50.0
SPEC = ImuSpec(
    "mine",
    TriadSpec(
        random_walk=2e-4,
        rate_random_walk=3e-5,
        bias_instability=1e-4,
        bias_correlation=60.0,
        bias_model="gauss-markov",
        scale_factor_sd=1e-4,
    ),
    TriadSpec(
        random_walk=3e-3,
        rate_random_walk=2e-4,
        bias_instability=1e-3,
        bias_correlation=60.0,
        bias_model="gauss-markov",
        scale_factor_sd=3e-4,
    ),
)
OPENED = {"kalibr", "openvins", "vins", "gtsam", "matlab", "ros", "kf-gins", "navego", "gnss-ins-sim"}


def numbers_of(name: str, spec: ImuSpec = SPEC) -> dict[str, np.ndarray]:
    """The parameters of a file by name, read without the code of bench."""
    text = write_parameters(spec, name, RATE).text
    if PROGRAMS[name].comment == "#" and "np." not in text:
        rows = yaml.safe_load(text.replace("%YAML:1.0", ""))
        while len(rows) == 1:
            rows = next(iter(rows.values()))
        return {key: np.array(value, float) for key, value in rows.items() if key != "rostopic"}
    if name == "gnss-ins-sim":
        found: dict[str, object] = {}
        exec(text, found)
        return found["imu_err"]  # type: ignore[return-value]
    rows = dict(re.findall(r"^([\w.]+) = \[(.*?)\];", text, re.MULTILINE))
    return {key: np.array(value.split(","), float) for key, value in rows.items()}


# --- noise of programs that simulate --------------------------------------------------------------------


def measure(rates: np.ndarray, tau: float) -> float:
    return float(allantools.oadev(rates, RATE, "freq", [tau])[1][0])


def draw_markov(decay: float, step: float, samples: int, rng: np.random.Generator) -> np.ndarray:
    out, state = np.zeros(samples), 0.0
    for k, noise in enumerate(step * rng.standard_normal(samples)):
        state = decay * state + noise
        out[k] = state
    return out


def steps_of(name: str, triad: str) -> tuple[float, float, tuple[float, float]]:
    """White sd of a sample, step of the walk, and decay and step of the Gauss-Markov bias, by the program."""
    p, dt = numbers_of(name), 1 / RATE
    gyro = triad == "gyro"
    if name == "kalibr":  # the wiki IMU-Noise-Model
        long = "gyroscope" if gyro else "accelerometer"
        return (
            float(p[f"{long}_noise_density"]) / np.sqrt(dt),
            float(p[f"{long}_random_walk"]) * np.sqrt(dt),
            (0, 0),
        )
    if name == "matlab":  # IMUSensorSimulator, double-sided: the bandwidth is half the sample rate
        long = "imu.Gyroscope" if gyro else "imu.Accelerometer"
        white = p[f"{long}.NoiseDensity"][0] * np.sqrt(RATE / 2)
        return white, p[f"{long}.RandomWalk"][0] / np.sqrt(RATE / 2), (0, 0)
    if name == "navego":  # imu_si_errors.m, noise_rrw.m, noise_b_dyn.m
        unit = np.pi / 180 if gyro else 1.0
        walk = p["imu.arw" if gyro else "imu.vrw"][0] / 60 * unit
        rate_walk = p["imu.arrw" if gyro else "imu.vrrw"][0] / 60 * unit
        sd = p["imu.gb_dyn"][0] * unit if gyro else p["imu.ab_dyn"][0] * 0.001 * 9.80665
        decay = np.exp(-dt / p["imu.gb_corr" if gyro else "imu.ab_corr"][0])
        return walk / np.sqrt(dt), rate_walk * dt, (decay, sd * np.sqrt(1 - decay**2))
    unit = np.pi / 180 if gyro else 1.0  # gnss-ins-sim: imu_model.py, pathgen.py
    walk = p["gyro_arw" if gyro else "accel_vrw"][0] * unit / 60
    drift = p["gyro_b_stability"][0] * unit / 3600 if gyro else p["accel_b_stability"][0]
    decay = dt / p["gyro_b_corr" if gyro else "accel_b_corr"][0]
    return walk / np.sqrt(dt), 0.0, (1 - decay, drift * np.sqrt(1 - np.exp(-2 * decay)))


@pytest.mark.parametrize("triad", ["gyro", "accel"])
@pytest.mark.parametrize("name", ["kalibr", "matlab", "navego", "gnss-ins-sim"])
def test_drawn_noise_has_the_allan_lines_of_the_datasheet(name, triad):
    """N at 1 s, K at 60 s of the walk alone, and the peak of the bias instability at 1.89 correlation times.

    One hour at 50 Hz of white noise: 1 s has 2000 degrees of freedom, a 99.9 % band of 5 %. The walk and the
    bias are drawn alone, 6 h at the rate: 60 s has 400, its peak at 113 s 200, bands of 12 and 17 %.
    """
    figures, rng = getattr(SPEC, triad), np.random.default_rng(12)
    white, step, (decay, kick) = steps_of(name, triad)
    assert measure(white * rng.standard_normal(180_000), 1.0) == pytest.approx(figures.random_walk, rel=0.05)
    n = 1_080_000
    if step:
        walk = np.cumsum(step * rng.standard_normal(n))
        assert measure(walk, 60.0) / np.sqrt(20.0) == pytest.approx(figures.rate_random_walk, rel=0.12)
    else:
        assert "rate_random_walk" not in {one.figure for one in PROGRAMS[name].parameters}
    if kick:
        bias = draw_markov(decay, kick, n, rng)
        assert measure(bias, 1.89 * 60.0) == pytest.approx(figures.bias_instability, rel=0.17)
    else:
        assert "instability_sd" not in {one.figure for one in PROGRAMS[name].parameters}


# --- covariance of filters ----------------------------------------------------------------------------


@pytest.mark.parametrize("triad", ["gyro", "accel"])
@pytest.mark.parametrize("name", ["openvins", "vins", "kf-gins", "ros"])
def test_filters_have_the_covariance_of_the_datasheet(name, triad):
    """The variance of the integral after 1 s is N^2, and the variance of the bias K^2, or the steady sd^2."""
    p, dt, gyro, figures = numbers_of(name), 1 / RATE, triad == "gyro", getattr(SPEC, triad)
    angle = bias = 0.0
    for _ in range(round(RATE)):
        if name == "openvins":  # Propagator.cpp: G = dt, Qc = sigma^2 / dt
            long = "gyroscope" if gyro else "accelerometer"
            angle += dt * p[f"{long}_noise_density"] ** 2 / dt * dt
            bias += dt * p[f"{long}_random_walk"] ** 2 / dt * dt
        elif name == "vins":  # integration_base.h: V = 0.5 dt for two samples, dt for the bias
            angle += 2 * (0.5 * dt) ** 2 * p["gyr_n" if gyro else "acc_n"] ** 2
            bias += dt**2 * p["gyr_w" if gyro else "acc_w"] ** 2
        elif name == "ros":
            key = "angular_velocity_covariance" if gyro else "linear_acceleration_covariance"
            angle += dt**2 * p[key].reshape(3, 3)[1, 1]
        else:  # gi_engine.cpp: Qc dt
            angle += (p["arw"][0] * np.pi / 180 / 60 if gyro else p["vrw"][0] / 60) ** 2 * dt
    assert angle == pytest.approx(figures.random_walk**2, rel=1e-6)
    if name in ("openvins", "vins"):
        assert bias == pytest.approx(figures.rate_random_walk**2, rel=1e-6)
    if name == "kf-gins":
        sd = p["gbstd"][0] * np.pi / 180 / 3600 if gyro else p["abstd"][0] * 1e-5
        assert sd == pytest.approx(figures.bias_instability / GAUSS_MARKOV_PEAK, rel=1e-6)
        assert float(p["corrtime"]) * 3600 == pytest.approx(60.0)


def test_gtsam_itself_has_the_covariance_of_the_datasheet():
    """The covariance of its preintegrated measurements after 1 s: rotation, position, velocity, biases."""
    gtsam = pytest.importorskip("gtsam")
    found: dict[str, object] = {}
    exec(write_parameters(SPEC, "gtsam").text, found)
    params = found["params"]
    params.setIntegrationCovariance(np.zeros((3, 3)))
    pim = gtsam.PreintegratedCombinedMeasurements(params, gtsam.imuBias.ConstantBias())
    for _ in range(100):
        pim.integrateMeasurement(np.zeros(3), np.zeros(3), 0.01)
    sd = np.sqrt(np.diag(pim.preintMeasCov()))
    walk_in_angle = SPEC.gyro.rate_random_walk / np.sqrt(3.0)
    assert_allclose(sd[0:3], np.hypot(SPEC.gyro.random_walk, walk_in_angle), rtol=0.01)
    assert_allclose(
        sd[6:9], np.hypot(SPEC.accel.random_walk, SPEC.accel.rate_random_walk / 3**0.5), rtol=0.01
    )
    assert_allclose(sd[9:12], SPEC.accel.rate_random_walk, rtol=1e-6)
    assert_allclose(sd[12:15], SPEC.gyro.rate_random_walk, rtol=1e-6)


# --- there and back -----------------------------------------------------------------------------------


def test_every_program_was_opened():
    assert PROGRAMS.keys() == OPENED
    assert all(one.source for one in (*PROGRAMS.values(), *TUNINGS.values()))


@pytest.mark.parametrize("name", sorted(OPENED))
def test_figures_come_back(name, tmp_path):
    """Also by axis where the program has axes; what it does not have is 0, and was listed as lost."""
    axes = (AxisFigures("random_walk", 1e-4, 2e-4, 1.5e-4),)
    spec = replace(SPEC, gyro=replace(SPEC.gyro, axes=axes), thermal=ThermalSpec(self_heating=5.0))
    converted = write_parameters(spec, name, RATE)
    path = tmp_path / "theirs"
    path.write_text(converted.text)
    back = read_parameters(path, name, RATE)
    lost = " ".join(converted.lost)
    for triad in ("gyro", "accel"):
        figures = {one.figure for one in PROGRAMS[name].parameters if one.triad == triad}
        was, found = getattr(spec, triad), getattr(back, triad)
        for field in ("random_walk", "rate_random_walk", "scale_factor_sd"):
            if field in figures:
                if PROGRAMS[name].layout == "one":
                    assert getattr(found, field) == pytest.approx(getattr(was.averaged(), field), rel=1e-6)
                else:
                    assert_allclose(found.by_axis(field), was.by_axis(field), rtol=1e-6)
            else:
                assert getattr(found, field) == 0.0
        if "instability_sd" in figures:
            assert found.bias_instability == pytest.approx(was.bias_instability, rel=1e-6)
            assert (found.bias_correlation, found.bias_model) == (pytest.approx(60.0), "gauss-markov")
        else:
            assert found.bias_instability == 0.0
            assert f"{triad} bias instability" in lost
            assert "not part of the random walk" in lost
        assert ("scale_factor_sd" in figures) != (f"{triad} scale factor" in lost)
    assert "thermal" in lost
    assert ("axes differ" in lost) == (PROGRAMS[name].layout == "one")
    sheet = tmp_path / "mine.toml"
    sheet.write_text(format_sheet(back, "mine", "theirs"))
    again = read_imu(sheet, "mine.toml")
    assert_allclose(again.gyro.by_axis("random_walk"), back.gyro.by_axis("random_walk"), rtol=1e-6)


def test_a_bias_instability_becomes_a_walk_only_if_asked():
    """At short times a Gauss-Markov process of sd s is a walk of s sqrt(2 / T)."""
    plain = read_number(write_parameters(SPEC, "kalibr", RATE).text, "gyroscope_random_walk")
    asked = write_parameters(SPEC, "kalibr", RATE, bias_as_walk=True)
    assert plain == pytest.approx(3e-5)
    walk = 1e-4 / GAUSS_MARKOV_PEAK * np.sqrt(2.0 / 60.0)
    assert read_number(asked.text, "gyroscope_random_walk") == pytest.approx(np.hypot(3e-5, walk))
    assert "bias instability" not in " ".join(asked.lost)


def read_number(text: str, key: str) -> float:
    return float(re.search(rf"{key}: (\S+)", text)[1])


# --- filters without a conversion, wrong files ----------------------------------------------------------


def test_bounds_are_the_noise_at_the_step_of_the_filter():
    columns = bound_tuning(SPEC, "px4")
    assert columns["parameter"][0] == "EKF2_GYR_NOISE"
    assert columns["default"][:2] == ["0.015", "0.35"]
    assert columns["noise of the IMU"] == ["0.002", "0.03", "0.0003", "0.002"]  # times 10: a step of 10 ms
    assert set(bound_tuning(SPEC, "robot_localization")["noise of the IMU"]) == {"-"}


def test_the_verb_prints_what_is_lost_and_what_has_no_conversion(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["convert", "kvh-dsp-1760", "--to", "kalibr", "--rate", "200", "-o", "imu.yaml"]) == 0
    out = capsys.readouterr().out
    assert "update_rate: 200" in out
    assert "lost: accel bias instability 50 ug: no parameter; it is not part of the random walk" in out
    assert "lost: accel rate random walk: the datasheet has none, 0 is written, which keeps" in out
    assert "IMU-Noise-Model" in out
    assert main(["convert", "imu.yaml", "--from", "kalibr", "-o", "mine.toml"]) == 0
    assert "rate_random_walk_deg_h_sqrt_h = 0.30024" in capsys.readouterr().out
    assert read_imu(tmp_path / "mine.toml", "mine.toml").gyro.rate_random_walk > 0
    for name in TUNINGS:
        assert main(["convert", "stim300", "--to", name]) == 0
        assert "no conversion exists" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["stim300", "--to", "kalibrr"], "program 'kalibrr' is unknown. Did you mean 'kalibr'?"),
        (["stim300", "--to", "vins"], "depends on the rate of the samples; give --rate HZ"),
        (["no.yaml", "--from", "vins"], "depend on the rate of the samples; give --rate HZ"),
        (["no.yaml", "--from", "kalibr"], "no.yaml: no such file"),
        (
            ["none.yaml", "--from", "kalibr"],
            "none.yaml: has no parameter of kalibr; expected gyroscope_noise",
        ),
        (["three.yaml", "--from", "kalibr"], "gyroscope_noise_density has 3 numbers; expected 1"),
        (["minus.yaml", "--from", "kalibr"], "gyroscope_noise_density must be finite numbers of 0 or more"),
        (["bytes.yaml", "--from", "kalibr"], "bytes.yaml: cannot be read"),
        (["stim300", "--to", "px4", "--rate", "100"], "no conversion exists, rate has no effect"),
        (["stim300", "--to", "vins", "--rate", "-1"], "rate = -1 Hz must be above 0"),
    ],
)
def test_what_is_wrong_is_said(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "none.yaml").write_text("# gyroscope_noise_density: 1\nother: 2\n")
    (tmp_path / "three.yaml").write_text("gyroscope_noise_density: [1, 2, 3]\n")
    (tmp_path / "minus.yaml").write_text("gyroscope_noise_density: -1e-3\n")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    assert main(["convert", *arguments]) == WRONG
    assert message in " ".join(capsys.readouterr().err.split())


def test_python_converts_as_the_verb_does():
    with pytest.raises(ConfigError, match="one of to and source"):
        bench.convert_unit("stim300")
    assert bench.convert_unit("stim300", to="kf-gins").program == "kf-gins"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("accelerometer_noise_density: TBD, see sheet 7", "= 'TBD, see sheet 7' is not a number"),
        ("accelerometer_noise_density: !!python/name:os.path 2", "is not a number or a list"),
        ("accelerometer_noise_density: - 3", "is not a number"),
        ("accelerometer_noise_density: $ACC_2", "is not a number"),
        (
            "accelerometer_noise_density: 1e-3\naccelerometer_noise_density: 2e-3",
            "is in it 2 times, expected once; keep one IMU",
        ),
        ("accelerometer_noise_density: [1e-3, 2e-3]", "has 2 numbers; expected 1"),
    ],
)
def test_text_that_is_no_number_is_not_read(tmp_path, text, message):
    path = tmp_path / "imu.yaml"
    path.write_text(f"gyroscope_noise_density: 1.0e-4\n{text}\n")
    with pytest.raises(ConfigError, match=re.escape(message)):
        read_parameters(path, "kalibr")


def test_no_way_is_no_unknown_program_and_a_walk_needs_a_place(tmp_path):
    (tmp_path / "x").write_text("EKF2_GYR_NOISE 0.015")
    with pytest.raises(ConfigError, match="no conversion from px4 exists"):
        read_parameters(tmp_path / "x", "px4")
    with pytest.raises(ConfigError, match="kf-gins: it has no rate random walk; leave out --bias-as-walk"):
        write_parameters(SPEC, "kf-gins", bias_as_walk=True)


def test_what_a_file_does_not_have_is_listed(tmp_path):
    (tmp_path / "imu.yaml").write_text("gyroscope_noise_density: 1.0e-4\ngyroscope_random_walk: 0\n")
    lost = bench.convert_unit(tmp_path / "imu.yaml", source="kalibr", rate=200.0).lost
    assert set(lost) == {
        "gyroscope_random_walk is missing, or 0",
        "accelerometer_noise_density is missing, or 0",
        "accelerometer_random_walk is missing, or 0",
    }
