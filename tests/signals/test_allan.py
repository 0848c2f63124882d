"""Allan deviation: our code against allantools, the curves against sums, every unit against its own figures.

For every unit of the catalog the overlapping Allan deviation of its model, three axes pooled, equals the
analytic curve of all its terms at octave averaging times. Each value is held to its own two-sided 99.9 %
band, from the effective degrees of freedom of the very process: about 40 strongly correlated values a unit,
false alarm below 4 % a unit at fixed seeds. Seen in a unit that has all terms: 2 % of the white noise, 5 %
of the quantization, 10 % of the bias instability, 70 % of the walk (its longest times have 40 degrees of
freedom).
"""

from __future__ import annotations

import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import gammaincinv

import bench
from bench.cli.command_line import main
from bench.core.records.sensor_specs import AxisFigures, ImuSpec, TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.evaluation.motion.noise_curves import format_noise_figures, measure_model
from bench.io import config
from bench.io.config.datasheets import read_imu
from bench.io.logs.resting_log import read_resting_log
from bench.simulation.sensors import processes
from bench.simulation.signals import allan

UNITS = sorted((Path(bench.__file__).parent / "catalog/imu").glob("*.toml"))
OFF = TriadSpec()


# --- the measuring code and the curves ----------------------------------------------------------------


@pytest.mark.parametrize("samples", [1000, 4097])
def test_our_overlapping_deviation_is_that_of_allantools(samples):
    import allantools

    rate = 50.0
    values = np.random.default_rng(4).normal(size=(samples, 3)).cumsum(axis=0) + 5.0
    spans = allan.make_octaves(samples, 4)
    ours = allan.measure_deviation(values / rate, 1 / rate, spans)
    for axis in range(3):
        theirs = allantools.oadev(values[:, axis], rate, "freq", spans / rate)[1]
        assert_allclose(ours[:, axis], theirs, rtol=1e-9)
    assert_allclose(allan.measure_deviation(values[:, 0] / rate, 1 / rate, spans), ours[:, 0], rtol=1e-12)


def test_too_long_an_average_is_refused():
    with pytest.raises(ValueError, match="1 to 5 for 10 samples; got 6"):
        allan.measure_deviation(np.zeros(10), 1.0, [6])


def test_the_curves_are_those_of_the_standard():
    """IEEE Std 952-1997, annex C: N / sqrt(tau), K sqrt(tau / 3), sqrt(3) Q / tau with Q = lsb / sqrt(12)."""
    tau = np.geomspace(0.01, 1000.0, 30)
    assert_allclose(allan.expected_deviation(allan.white(3.0), tau), 3.0 / np.sqrt(tau), rtol=1e-9)
    assert_allclose(allan.expected_deviation(allan.rate_walk(3.0), tau), 3.0 * np.sqrt(tau / 3), rtol=1e-9)
    assert_allclose(
        allan.expected_deviation(allan.quantization(3.0), tau), 3.0 / np.sqrt(4.0) / tau, rtol=1e-9
    )
    near = tau > 1.0  # where the closed form still has its digits
    curve = allan.expected_deviation(allan.markov(2.0, 20.0), tau[near])
    assert_allclose(curve, allan.gauss_markov_deviation(tau[near], 2.0, 20.0), rtol=1e-6)
    short = allan.expected_deviation(allan.markov(2.0, 1e5), tau[~near])  # a walk of K = sd sqrt(2 / T)
    assert_allclose(short, 2.0 * np.sqrt(2e-5) * np.sqrt(tau[~near] / 3), rtol=1e-4)
    both = allan.expected_deviation(allan.add_processes(allan.white(3.0), allan.rate_walk(2.0)), tau)
    assert_allclose(both**2, 9.0 / tau + 4.0 * tau / 3, rtol=1e-9)


@pytest.mark.parametrize("tau", [0.1, 0.3, 1.0, 1.7, 5.0])
def test_lines_between_instants_have_the_allan_deviation_of_their_curve(tau):
    """A walk with unit steps a second apart, lines in between, 100 samples a step; summed over all phases.

    The average over a span starting at any phase is a weighted sum of the steps: no noise is drawn.
    """
    fine, n = 100, 40
    m = round(tau * fine)
    walks = np.tril(np.ones((n, n)))  # row: knot, column: which steps it holds
    lines = np.array([np.interp(np.arange(n * fine - fine) / fine, np.arange(n), w) for w in walks.T]).T
    angle = np.vstack([np.zeros(n), np.cumsum(0.5 * (lines[1:] + lines[:-1]), axis=0)]) / fine
    start = np.arange(10 * fine, 11 * fine)
    second = angle[start + 2 * m] - 2 * angle[start + m] + angle[start]
    variance = np.mean(np.sum(second**2, axis=1)) / (2 * tau**2)
    assert_allclose(allan.expected_deviation(allan.rate_walk(1.0, 1.0), tau), np.sqrt(variance), rtol=2e-3)
    slow = allan.expected_deviation(allan.markov(50.0, 5000.0, 1.0), tau)  # K = 1 over these times
    assert_allclose(slow, np.sqrt(variance), rtol=5e-3)
    if tau <= 1.0:
        assert abs(allan.expected_deviation(allan.rate_walk(1.0), tau) / np.sqrt(variance) - 1) > 0.1


def test_degrees_of_freedom_of_white_noise_are_those_of_sp_1065():
    """NIST SP 1065 (2008), table 5, an approximation good to a few percent."""
    for samples in (1024, 8192):
        for m in (1, 4, 32, samples // 16):
            n = samples + 1
            closed = (1.5 * (n - 1) / m - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
            assert_allclose(allan.degrees_of_freedom(allan.white(2.0), samples, 0.1, m), closed, rtol=0.02)


@pytest.mark.parametrize(
    "process",
    [allan.white(1.0), allan.markov(1.0, 20.0), allan.rate_walk(1.0), allan.quantization(1.0)],
    ids=["white", "markov", "walk", "quantization"],
)
def test_degrees_of_freedom_are_those_of_the_whole_double_sum(process):
    """2 E^2 / Var of the mean square, its variance summed over every pair of second differences."""
    samples, m = 300, 16
    M = samples + 1 - 2 * m
    lag = np.subtract.outer(np.arange(M), np.arange(M)).astype(float)
    R = sum(
        a * b * process(np.abs(lag + (i - j) * m))
        for i, a in enumerate((1, -2, 1))
        for j, b in enumerate((1, -2, 1))
    )
    edf = 2 * (M * R[0, 0]) ** 2 / (2 * np.sum(R**2))
    assert_allclose(allan.degrees_of_freedom(process, samples, 1.0, m), edf, rtol=0.01)


def test_the_spread_of_the_estimate_is_that_of_its_degrees_of_freedom():
    """400 records of a Gauss-Markov rate: the relative variance of its Allan variance is 2 / edf."""
    rng = np.random.default_rng(8)
    n, m, count = 2000, 64, 400
    values = []
    for _ in range(count // 3 + 1):
        rate = processes.simulate_gauss_markov(np.ones(n), np.array([30.0]), np.ones(1), rng)
        angle = 0.5 * (rate[1:] + rate[:-1])
        values += list(allan.measure_deviation(angle, 1.0, [m])[0] ** 2)
    edf = allan.degrees_of_freedom(allan.markov(1.0, 30.0), n, 1.0, m)
    ratio = np.var(values, ddof=1) / np.mean(values) ** 2 * edf / 2
    spread = 3.29 * np.sqrt((2 + 12 / edf) / len(values))  # the kurtosis of chi-square is 3 + 12 / edf
    assert abs(ratio - 1) < spread
    assert abs(ratio * 1.6 - 1) > spread


# --- every unit of the catalog ------------------------------------------------------------------------


def seed_of(name):
    return zlib.crc32(name.encode()) % 1000  # independent noise for every unit


@pytest.mark.parametrize("path", UNITS, ids=lambda path: path.stem)
def test_every_unit_has_the_allan_deviation_of_its_figures(path):
    spec = read_imu(path, path.name)
    curves = measure_model(spec, seed_of(path.stem))
    assert curves
    for curve in curves:
        total = np.sqrt(sum(term**2 for term in curve.terms.values()))
        assert_allclose(curve.expected, total, rtol=1e-12)
        assert curve.tau[0] == 1 / 200
        assert curve.tau[-1] == 4096
        assert_allclose(curve.tau[1:] / curve.tau[:-1], 2.0, rtol=0.25)
        assert curve.edf.min() > 30
        assert curve.outside <= 1, curve.measured / curve.expected  # of 1680 values, 1.7 are beyond 99.9 %


def test_the_picture_of_the_catalog_has_a_line_for_each_imu_of_a_class(here, monkeypatch, capsys):
    from matplotlib.axes import Axes

    drawn = []
    monkeypatch.setattr(Axes, "annotate", lambda axes, text, *_, **__: drawn.append(text.strip()))
    assert main(["list", "sensors", "--picture", "imus.png"]) == 0
    assert (here / "imus.png").stat().st_size > 50_000
    assert set(drawn) == {path.stem for path in UNITS if "synthetic" not in path.read_text()}
    assert main(["list", "sensors", "--picture", "imus.png"]) == 2
    assert "imus.png: exists; --force replaces it" in capsys.readouterr().err
    for wrong in (["aircraft", "--picture", "other.png"], ["sensors", "--force"]):
        assert main(["list", *wrong]) == 2


FULL = ImuSpec(
    "full",
    TriadSpec(
        random_walk=2e-5,
        bias_instability=2e-6,
        bias_correlation=100.0,
        rate_random_walk=1e-7,
        quantization=2.8e-6,
    ),
    TriadSpec(
        random_walk=1e-3,
        bias_instability=1e-4,
        bias_correlation=300.0,
        bias_model="gauss-markov",
        rate_random_walk=3e-6,
        quantization=1.4e-4,
    ),
)


def test_all_four_terms_at_once():
    """Quantization is as large as the white noise at 5 ms; then that rules, the instability, the walk."""
    for curve in measure_model(FULL, 3):
        assert curve.outside == 0, curve.measured / curve.expected
        bits, white, instability, walk = curve.terms.values()
        assert bits[0] > 0.95 * white[0]
        assert set(np.argmax([white, instability, walk], axis=0)) == {0, 1, 2}


def test_axes_that_differ_are_held_against_the_mean_of_their_variances():
    white = AxisFigures("random_walk", 2e-5, 1e-5, 6e-5)
    walk = AxisFigures("rate_random_walk", 1e-7, 4e-7, 1e-7)
    gyro = replace(FULL.gyro, random_walk=6e-5, rate_random_walk=4e-7, axes=(white, walk))
    for curve in measure_model(replace(FULL, gyro=gyro), 3):
        assert curve.outside == 0, curve.measured / curve.expected


@pytest.mark.parametrize(
    ("figure", "factor"),
    [("random_walk", 1.02), ("quantization", 1.05), ("bias_instability", 1.1), ("rate_random_walk", 1.7)],
)
def test_a_wrong_figure_is_seen(figure, factor):
    """The same records held against a datasheet that is off in one figure."""
    for name in ("gyro", "accel"):
        triad = getattr(FULL, name)
        claimed = replace(FULL, **{name: replace(triad, **{figure: factor * getattr(triad, figure)})})
        measured = next(curve for curve in measure_model(FULL, 3) if curve.triad == name)
        terms = processes.make_noise_terms(getattr(claimed, name))
        expected = allan.expected_deviation(allan.add_processes(*terms.values()), measured.tau)
        low, high = (
            expected * np.sqrt(2 * gammaincinv(measured.edf / 2, tail) / measured.edf)
            for tail in (0.0005, 0.9995)
        )
        assert ((measured.measured < low) | (measured.measured > high)).any(), name


def test_a_skewed_warm_shaken_unit_is_measured_at_rest_along_its_axes():
    from bench.core.records.sensor_specs import SampleClockSpec, ThermalSpec, VibrationSpec

    odd = replace(
        FULL,
        gyro=replace(FULL.gyro, temperature_sd=1e-5, resolution=1e-3, transient_sd=1e-3, transient_time=9.0),
        accel=replace(FULL.accel, noise_shape="sampled", bandwidth=30.0, hysteresis_sd=1e-3),
        clock=SampleClockSpec(jitter=1e-3),
        thermal=ThermalSpec(290.0, 30.0, 1000.0),
        vibration=VibrationSpec(engine_accel=1.0, engine_reference=100.0),
        accel_cone=0.6,
        accel_arms=((0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1)),
    )
    for plain, with_rest in zip(measure_model(FULL, 3), measure_model(odd, 3), strict=True):
        assert_allclose(plain.measured, with_rest.measured, rtol=1e-6)


# --- the verb -----------------------------------------------------------------------------------------


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def desk_log(
    path, rate=50.0, seconds=2000.0, N=1e-3, K=2e-4, head="t_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s"
):
    """A log of a gyro with white noise N [rad/sqrt(s)] and rate random walk K [rad/s/sqrt(s)], in deg/s."""
    rng = np.random.default_rng(6)
    n = round(rate * seconds)
    walk = np.cumsum(K / np.sqrt(rate) * rng.normal(size=(n, 3)), axis=0)
    values = np.rad2deg(N * np.sqrt(rate) * rng.normal(size=(n, 3)) + walk + 0.01)
    np.savetxt(
        path,
        np.column_stack([np.arange(n) / rate, values]),
        delimiter=",",
        header=head,
        comments="",
        fmt="%.9g",
    )


def test_allan_of_a_unit_prints_the_table_and_draws_the_picture(here, capsys):
    assert main(["allan", "stim300", "-o", "a.png"]) == 0
    out = capsys.readouterr().out
    assert "gyro, Allan deviation in deg/h" in out
    assert "accel, Allan deviation in ug" in out
    assert "0 of 42 values lie outside their 99.9 % band." in out
    assert (here / "a.png").read_bytes()[:4] == b"\x89PNG"
    assert (here / "a.png").stat().st_size > 20_000


def test_allan_of_a_log_writes_a_datasheet_that_a_profile_accepts(here, capsys):
    """N within 1 %, K within 10 %: 20 s, where the walk begins to rule, have 300 degrees of freedom."""
    desk_log(here / "desk.csv")
    desk = read_resting_log(here / "desk.csv")
    t, triads, temperature = desk.t, desk.triads, desk.temperature
    assert (list(triads), temperature) == (["gyro"], None)
    assert len(t) == 100_000
    assert main(["allan", "--log", "desk.csv"]) == 0
    out = capsys.readouterr().out
    assert "white noise 3.4" in out  # 1e-3 rad/sqrt(s) is 3.44 deg/sqrt(h)
    assert "bias instability below" in out
    assert "99.9 % band" in out
    assert (here / "allan-desk.png").is_file()
    found = read_imu(here / "unit-desk.toml", "unit-desk.toml").gyro
    assert_allclose(found.random_walk, 1e-3, rtol=0.01)
    assert_allclose(found.rate_random_walk, 2e-4, rtol=0.1)
    profile = config.read_profile("figure-eight", overrides={"sensors.imu": "unit-desk.toml"})
    assert profile.sensors.imu.gyro == found
    assert main(["allan", "--log", "desk.csv", "-o", "c.png"]) == 2
    assert capsys.readouterr().err == "error: unit-desk.toml: exists; --force replaces it\n"


def test_a_log_is_compared_with_a_datasheet(here, capsys):
    desk_log(here / "desk.csv", seconds=100.0)
    assert main(["allan", "icm-42688-p", "--log", "desk.csv", "-o", "b.svg", "--sheet", "mine.toml"]) == 0
    assert "datasheet: mine.toml" in capsys.readouterr().out
    assert "<svg" in (here / "b.svg").read_text()[:1000]
    assert not (here / "unit-desk.toml").exists()
    assert read_imu(here / "mine.toml", "mine.toml").gyro.random_walk == pytest.approx(1e-3, rel=0.1)


def test_noise_of_another_unit_is_doubted(here, capsys):
    """1 deg/s named rad/s is 57 times as much; the noise itself is that of a consumer IMU."""
    desk_log(here / "desk.csv", N=8e-5, K=1e-6, seconds=100.0)
    doubt = "gyro: more than 5 times the white noise of any IMU of the catalog (!)"
    assert main(["allan", "--log", "desk.csv"]) == 0
    out = capsys.readouterr().out
    assert doubt not in out
    assert "not in the datasheet: turn-on bias, scale factor, misalignment" in out
    text = (here / "desk.csv").read_text()
    (here / "deg.csv").write_text(text.replace("deg_s", "rad_s"))
    assert main(["allan", "--log", "deg.csv"]) == 0
    assert doubt in " ".join(capsys.readouterr().out.split())


def test_a_short_log_has_curves_and_no_datasheet(here, capsys):
    desk_log(here / "desk.csv", seconds=10.0)
    assert main(["allan", "--log", "desk.csv"]) == 0
    assert ": a fit needs 1024 samples at rest in one pose; record for longer" in capsys.readouterr().out
    assert list(here.glob("*.toml")) == []
    assert main(["allan", "--log", "desk.csv", "--sheet", "mine.toml", "--force"]) == 2
    assert "mine.toml: a datasheet needs 1024 samples or more at rest in one pose" in capsys.readouterr().err
    assert main(["allan", "stim300", "--sheet", "mine.toml"]) == 2
    assert "mine.toml: a datasheet is fitted to a log" in capsys.readouterr().err
    assert main(["allan", "--log", "desk.csv", "--sheet", "mine.txt", "--force"]) == 2
    assert "mine.txt: must end in .toml" in capsys.readouterr().err


def test_a_temperature_is_read(here):
    desk_log(here / "desk.csv", seconds=100.0)
    rows = np.loadtxt(here / "desk.csv", delimiter=",", skiprows=1)
    warm = 25.0 + 0.01 * rows[:, 0]
    rows[:, 1:] += 5.0 * (warm - 25.0)[:, None]
    head = "t_s,gyro_x_deg_s,gyro_y_deg_s,gyro_z_deg_s,temperature_degc"
    np.savetxt(here / "warm.csv", np.column_stack([rows, warm]), delimiter=",", header=head, comments="")
    (fit,) = bench.measure_allan(log=here / "warm.csv").fits
    assert_allclose(np.rad2deg(fit.temperature), 5.0, atol=0.5)


def test_a_log_in_other_units_gives_the_same(here):
    desk_log(here / "deg.csv", seconds=100.0)
    rows = np.loadtxt(here / "deg.csv", delimiter=",", skiprows=1)
    rows[:, 1:] = np.deg2rad(rows[:, 1:])
    head = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s"
    np.savetxt(here / "rad.csv", rows, delimiter=",", header=head, comments="", fmt="%.12g")
    in_deg, in_rad = (bench.measure_allan(log=here / name).curves[0] for name in ("deg.csv", "rad.csv"))
    assert_allclose(in_deg.measured, in_rad.measured, rtol=1e-6)
    g = "t_s,accel_x_g,accel_y_g,accel_z_g"
    si = "t_s,accel_x_m_s2,accel_y_m_s2,accel_z_m_s2"
    for name, header, factor in (("g.csv", g, 1.0), ("si.csv", si, 9.80665)):
        table = np.column_stack([rows[:, 0], factor * rows[:, 1:]])
        np.savetxt(here / name, table, delimiter=",", header=header, comments="", fmt="%.12g")
    in_g, in_si = (bench.measure_allan(log=here / name).curves[0] for name in ("g.csv", "si.csv"))
    assert_allclose(in_g.measured, in_si.measured, rtol=1e-9)
    assert in_g.triad == "accel"


HEAD = "t_s,gyro_x_rad_s,gyro_y_rad_s,gyro_z_rad_s\n"
GOOD, SLOW = ("".join(f"{k * step:.1f},0.1,0.2,0.3\n" for k in range(40)) for step in (0.1, 10.0))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no columns for time: t_s; there are none"),
        ("a,b\n1,2\n", "no columns for time: t_s; there are a, b"),
        ("t_s,wx\n1,2\n", "no column 'gyro_x_rad_s' or 'accel_x_m_s2'"),
        ("t_s,gyro_x_rad_s,gyro_y_rad_s,wz\n1,2,3,4\n", "gyro_x, gyro_y without gyro_z; other columns: wz"),
        ("0.1,2\n1,2\n", "there are 0.1, 2; name the columns in line 1"),
        (HEAD.replace("\n", ",gyro_x_deg_s\n"), "are the same quantity"),
        (HEAD + GOOD + "4.0,0.1,oops,0.3\n", "row 41: gyro_y_rad_s = 'oops' is not a number"),
        (HEAD + GOOD + "4.0,0.1\n", "row 41: 2 columns, the header has 4"),
        (HEAD + GOOD + "4.0,0.1,nan,0.3\n", "row 41: a value of gyro is not finite; cut the record there"),
        (
            HEAD + GOOD + "3.9,0.1,0.2,0.3\n",
            "row 41: t_s does not increase, it steps by 0 s; cut the record there",
        ),
        (
            HEAD + SLOW,
            "steps of t_s are 10 s; expected",
        ),
        (HEAD + "0,1,2,3\n", "1 samples; at least 32 are needed"),
        (HEAD + GOOD, "gyro_x does not change from row 1 to 40; cut the record there"),
    ],
)
def test_a_wrong_log_is_one_line_with_its_place(here, text, message):
    (here / "bad.csv").write_text(text)
    with pytest.raises(ConfigError, match=r"bad\.csv") as caught:
        bench.measure_allan(log=here / "bad.csv")
    assert message in str(caught.value)
    assert len(caught.value.messages) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["allan"], "give a UNIT of the catalog or --log FILE"),
        (["allan", "stim30"], "Did you mean 'stim300'?"),
        (["allan", "desk.csv"], "desk.csv is a log: bench allan --log desk.csv"),
        (["allan", "--log", "nowhere.csv"], "nowhere.csv: no such file"),
        (["allan", "stim300", "-o", "picture.txt"], "must end in .png, .svg or .pdf"),
        (["allan", "silent.toml"], "silent: has no random error to measure"),
    ],
)
def test_a_wrong_command_is_status_2(here, capsys, arguments, message):
    (here / "silent.toml").write_text('source = "by hand"\n[gyro]\nturn_on_bias_sd_deg_h = 1.0\n')
    assert main(arguments) == 2
    assert message in capsys.readouterr().err


def test_noise_is_told_in_the_units_of_datasheets():
    """By hand: 1 deg/h is 1 deg in 3600 s, 1 ug is 1e-6 of 9.80665 m/s^2."""
    gyro, accel = np.deg2rad(1.0) / 3600.0, 9.80665e-6
    for name, one, unit in (("gyro", gyro, "deg/h"), ("accel", accel, "ug")):
        told = format_noise_figures(name, TriadSpec(bias_instability=5.0 * one, bias_correlation=100.0))
        assert told["bias instability"] == f"5 {unit}"


@pytest.mark.parametrize(
    ("moved", "message"),
    [
        ("gyro_y_rad_s", "gyro_y moves: its means over 1 s have a standard deviation of 0.2"),
        ("accel_x_m_s2", "accel_x moves"),
        (None, r"the mean specific force is 1 m/s\^2, at rest it is 9.8: if the values are in g"),
    ],
)
def test_a_record_that_moves_or_is_in_g_is_no_rest(tmp_path, moved, message):
    t = np.arange(0.0, 200.0, 0.1)
    names = [f"{of}_{axis}_{unit}" for of, unit in (("gyro", "rad_s"), ("accel", "m_s2")) for axis in "xyz"]
    noise = np.random.default_rng(4).normal(size=(len(t), 6)) * 1e-3
    noise[:, 5] -= 1.0 if moved is None else 9.8
    if moved:
        noise[:, names.index(moved)] += (0.3 if moved.startswith("gyro") else 2.0) * np.sin(0.1 * t)
    path = tmp_path / "desk.csv"
    np.savetxt(
        path, np.column_stack([t, noise]), delimiter=",", header=",".join(["t_s", *names]), comments=""
    )
    with pytest.raises(ConfigError, match=message):
        read_resting_log(path)


def test_an_axis_that_dies_in_a_record_is_named_and_coarse_values_are_not(tmp_path):
    """By hand: an axis of 2000 rows stands from row 1201 on; three values at random are no dead axis."""
    t = np.arange(0.0, 200.0, 0.1)
    rates = np.round(np.random.default_rng(4).normal(size=(len(t), 3))) * 1e-3
    for name, last in (("coarse", len(t)), ("dies", 1200)):
        rates[last:, 1] = 0.0
        path = tmp_path / f"{name}.csv"
        np.savetxt(path, np.column_stack([t, rates]), delimiter=",", header=HEAD.strip(), comments="")
    read_resting_log(tmp_path / "coarse.csv")
    with pytest.raises(ConfigError, match=r"dies.csv: gyro_y does not change from row (1[12]\d\d) to 2000"):
        read_resting_log(tmp_path / "dies.csv")


@pytest.mark.parametrize("sd", [0.1, 0.3, 0.45, 0.6, 2.0])
def test_noise_that_rounding_hides_is_not_measured(tmp_path, sd):
    """Where noise is half a step or more, the fit of rounded values is that of noise and step / sqrt(12)."""
    t = np.arange(0.0, 400.0, 0.1)
    whole = np.random.default_rng(4).normal(size=(len(t), 3)) * sd + 0.47
    rates = 1e-3 * np.round(whole)
    np.savetxt(
        tmp_path / "a.csv", np.column_stack([t, rates]), delimiter=",", header=HEAD.strip(), comments=""
    )
    if sd < 0.5:
        with pytest.raises(
            ConfigError, match=r"gyro_x (has steps of 0.001, and scatters by|does not change)"
        ):
            read_resting_log(tmp_path / "a.csv")
        return
    (fit,) = bench.measure_allan(log=tmp_path / "a.csv").fits
    noise = np.sqrt(sd**2 + 1 / 12) * 1e-3 * np.sqrt(0.1)
    assert fit.estimates["random_walk"].value == pytest.approx(noise, rel=0.05)
