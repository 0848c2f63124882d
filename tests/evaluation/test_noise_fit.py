"""The fit of random errors to a record at rest: its curves by sums, its intervals by counts, real records."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.fft import dct
from scipy.signal import butter, lfilter
from scipy.stats import binom

from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.evaluation.motion.noise_curves import AllanResult, make_resting_truth
from bench.evaluation.motion.noise_fit import fit_triad, make_transient, remove_effects
from bench.evaluation.motion.noise_spectrum import PARAMETERS, make_shapes, make_spectrum
from bench.io.config.datasheets import read_imu
from bench.io.config.library import find_datasheet
from bench.io.logs.resting_log import read_resting_log
from bench.io.parameters import format_measured_sheet, summarize_fit
from bench.simulation.sensors import imu
from bench.simulation.sensors.draws import SensorDraws

TESTS = Path(__file__).parents[1]
RATE = 20.0
UNITS = (
    "adis16475", "adis16495", "hg4930-ca51", "icm-42688-p", "kvh-dsp-1760", "ln-200", "stim300", "vn-100",
)  # fmt: skip
"""Of the catalog. Not hg1700: the bias of its accelerometers moves so much between the epochs of the
simulated biases, 50 ms apart, that the lines between them show in its white noise."""


def draw(spec: ImuSpec, hours: float, seed: int, rate: float = RATE) -> dict[str, np.ndarray]:
    record, _ = imu.measure(make_resting_truth(rate, 3600.0 * hours), spec, SensorDraws(seed, 0))
    return {"gyro": record.dtheta_b * rate, "accel": record.dvel_b * rate}


def white(samples: int, seed: int, rate: float = RATE) -> np.ndarray:
    """White noise of N = 1."""
    return np.sqrt(rate) * np.random.default_rng(seed).standard_normal((samples, 3))


# --- curves -------------------------------------------------------------------------------------------


def transform_covariance(angle_covariance, samples):
    """Variances of the cosine transform of increments, whose sums have a covariance; step 1 s."""
    t = np.arange(samples + 1.0)
    sums = angle_covariance(t[:, None], t[None, :])
    increments = sums[1:, 1:] - sums[1:, :-1] - sums[:-1, 1:] + sums[:-1, :-1]
    whole = dct(dct(increments, axis=0, norm="ortho"), axis=1, norm="ortho")
    return whole[1:, 1:]


@pytest.mark.parametrize("correlation", [6.0, 40.0, 400.0])
def test_the_shapes_are_the_variances_of_the_transform(correlation):
    """From the covariance of each process's integral, by a double sum over 256 samples of 1 s."""
    n, k = 256, np.arange(1.0, 256.0)
    shapes = make_shapes(k, n, 1.0, correlation, "gauss-markov")
    c, sd = correlation, 1.0 / 0.617

    def markov(s, t):
        """Covariance of the integral of a stationary Gauss-Markov process."""

        def one(h):
            return 2.0 * c * h - 2.0 * c**2 * (1.0 - np.exp(-h / c))

        return sd**2 * 0.5 * (one(s) + one(t) - one(np.abs(s - t)))

    def walk(s, t):
        low, high = np.minimum(s, t), np.maximum(s, t)
        return low**2 * (3.0 * high - low) / 6.0

    def rounding(s, t):
        return np.where(s == t, 1.0 / 12.0, 0.0)

    for column, process, bound in (
        (0, rounding, 0.01),
        (1, np.minimum, 1e-9),
        (2, walk, 0.01),
        (3, markov, 0.03),
    ):
        whole = transform_covariance(process, n)
        assert_allclose(shapes[:, column], np.diag(whole), rtol=bound)
        scale = np.sqrt(np.outer(np.diag(whole), np.diag(whole)))
        correlated = np.abs(whole / scale - np.eye(n - 1))
        if column:  # the rounding of the first and the last angle is in all coefficients
            assert correlated.max() < 0.35  # neighbors of the lowest coefficients
            assert np.sqrt(np.mean(correlated**2)) < 0.03


def test_bins_keep_the_power_of_all_coefficients():
    rates = white(5000, 1)
    spectrum = make_spectrum(rates, 0.05)
    assert_allclose(
        spectrum.count @ spectrum.power, np.sum((rates - rates.mean(axis=0)) ** 2, axis=0), rtol=1e-12
    )
    assert spectrum.count.sum() == 4999
    assert_allclose(spectrum.index[:3], [1.0, 2.0, 3.0])


# --- intervals ----------------------------------------------------------------------------------------


def count_held(hours: float, draws: Iterable[tuple[int, int]]) -> dict[str, list[bool]]:
    """Whether the intervals hold, by parameter, for numbers of units and draws; gyros in even draws."""
    held: dict[str, list[bool]] = {name: [] for name in PARAMETERS}
    for number, seed in draws:
        spec = read_imu(*find_datasheet("imu", UNITS[number], Path()))
        triad = ("gyro", "accel")[seed % 2]
        fit = fit_triad(triad, draw(spec, hours, 1000 * number + seed)[triad], 1 / RATE)
        for name, one in fit.estimates.items():
            held[name].append(bool(one.low <= getattr(getattr(spec, triad), name) <= one.high))
    return held


def test_intervals_hold_the_figures():
    """8 records of 20 min, within the 99.9 % band of the binomial distribution."""
    held = count_held(1 / 3, [(k, k) for k in range(8)])
    least = int(binom.ppf(0.001, 8, 0.95))
    assert all(sum(ones) >= least for ones in held.values()), {k: sum(v) for k, v in held.items()}


def write_sheet(name, fits):
    return format_measured_sheet(name, AllanResult(name, (), None, simulated=False, fits=tuple(fits)))


@pytest.mark.long
@pytest.mark.parametrize("hours", [0.5, 2.0, 12.0])
def test_intervals_hold_the_figures_in_186_of_200(hours):
    held = count_held(hours, product(range(8), range(25)))
    assert all(sum(ones) >= 186 for ones in held.values()), {k: sum(v) for k, v in held.items()}


def test_white_noise_alone_identifies_nothing_else():
    fit = fit_triad("gyro", 1e-4 * white(20_000, 4), 1 / RATE)
    assert [name for name, one in fit.estimates.items() if one.identified] == ["random_walk"]
    assert_allclose(fit.estimates["random_walk"].value, 1e-4, rtol=0.02)
    assert (fit.transient, fit.temperature, dict(fit.axes), fit.slow) == (None, None, {}, False)
    assert fit.highest == fit.nyquist == RATE / 2
    assert fit.make_triad() == TriadSpec(random_walk=fit.estimates["random_walk"].value)
    text = write_sheet("mine", [fit])
    for words in ("bias instability below", "rate random walk below", "quantization below"):
        assert words in text
    assert "bias_instability_deg_h" not in text


def test_a_strong_walk_is_identified_and_quantization_too():
    """N = 1e-4 rad/sqrt(s), K = 2e-5 rad/s/sqrt(s), a resolution of 2e-5 rad."""
    rng = np.random.default_rng(7)
    n = 36_000
    walk = np.cumsum(2e-5 / np.sqrt(RATE) * rng.standard_normal((n, 3)), axis=0)
    angle = np.cumsum(1e-4 * white(n, 8) + walk, axis=0) / RATE
    rates = np.diff(2e-5 * np.round(angle / 2e-5), axis=0, prepend=0.0) * RATE
    fit = fit_triad("gyro", rates, 1 / RATE)
    for name, true in (("random_walk", 1e-4), ("rate_random_walk", 2e-5), ("quantization", 2e-5)):
        one = fit.estimates[name]
        assert one.identified
        assert one.low <= true <= one.high
        assert one.high / one.low < 3.5


# --- what is removed ----------------------------------------------------------------------------------


def test_a_transient_and_the_temperature_are_removed_before_the_walk_is_measured():
    """A decay of 0.02 rad/s with 27 s, and 1e-3 rad/s/K over a ramp of 5 K with ripples, in 15 min."""
    n, interval = 18_000, 1 / RATE
    t = interval * np.arange(n)
    temperature = 295.0 + 5.0 * t / t[-1] + 0.3 * np.sin(t / 50.0)
    effect = 0.02 * make_transient(n, interval, 0.03 * n * interval) + 1e-3 * (temperature - 295.0)
    noise = 1e-3 * white(n, 11)
    rates = noise + effect[:, None] * [1.0, -1.0, 0.5]
    fit = fit_triad("gyro", rates, interval, temperature)
    assert fit.transient is not None
    assert fit.transient[0] == pytest.approx(0.03 * n * interval)
    assert_allclose(fit.transient[1], [0.02, -0.02, 0.01], atol=5e-4)
    assert_allclose(fit.temperature, [1e-3, -1e-3, 5e-4], atol=1e-4)
    assert not fit.estimates["rate_random_walk"].identified
    cleaned = remove_effects(fit, rates, interval, temperature)
    assert np.std(cleaned.reshape(-1, 1200, 3).mean(axis=1), axis=0).max() < 4.0 * 1e-3 / np.sqrt(60.0)
    assert "a turn-on transient of 27 s" in summarize_fit(fit)
    dirty = fit_triad("gyro", noise + (1e-3 * (temperature - 295.0))[:, None], interval)
    assert dirty.estimates["rate_random_walk"].value > 0 or dirty.estimates["bias_instability"].value > 0
    plain = fit_triad("gyro", noise, interval, temperature)
    assert plain.transient is None
    assert plain.temperature is None
    sheet = fit.make_triad()
    assert (sheet.transient_time, sheet.transient_sd) == pytest.approx((27.0, 0.01 * np.sqrt(3.0)), rel=0.02)
    assert sheet.temperature_sd == pytest.approx(1e-3 * np.sqrt(0.75), rel=0.1)


def test_noise_beyond_the_bandwidth_is_left_out():
    """A second-order Butterworth filter at a tenth of the sample rate: N is the density far below it."""
    b, a = butter(2, 10.0, fs=100.0)
    rates = lfilter(b, a, white(60_000, 5, 100.0), axis=0)
    fit = fit_triad("accel", rates, 0.01)
    assert 1.0 < fit.highest < 7.0
    assert_allclose(fit.estimates["random_walk"].value, 1.0, rtol=0.03)
    assert "above, the noise does not fit the model" in summarize_fit(fit)


def test_axes_that_differ_have_figures_of_their_own():
    rates = 1e-3 * white(20_000, 6) * [1.0, 1.0, 1.3]
    fit = fit_triad("accel", rates, 1 / RATE)
    found = [one.value for one in fit.axes["random_walk"]]
    assert_allclose(found, [1e-3, 1e-3, 1.3e-3], rtol=0.02)
    text = write_sheet("mine", [fit])
    assert text.count("noise_m_s_sqrt_h = [") == 1
    assert not fit_triad("accel", rates * [1.3, 1.3, 1.0], 1 / RATE).axes


def test_the_sheet_is_read_back_as_it_was_fitted(tmp_path):
    spec = read_imu(*find_datasheet("imu", "icm-42688-p", Path()))
    fits = [fit_triad(name, rates, 1 / RATE) for name, rates in draw(spec, 1.0, 3).items()]
    path = tmp_path / "unit.toml"
    path.write_text(write_sheet("unit", fits))
    back = read_imu(path, path.name)
    for fit in fits:
        triad = getattr(back, fit.triad)
        for name, one in fit.estimates.items():
            assert getattr(triad, name) == pytest.approx(one.value if one.identified else 0.0, rel=1e-3)
        assert triad.bias_correlation == pytest.approx(fit.correlation, rel=1e-3)
        assert triad.bias_model == fit.model
    scaled = replace(back.gyro, random_walk=0.0)
    assert scaled != back.gyro


# --- real records -------------------------------------------------------------------------------------


def test_a_real_unit_on_a_desk_has_the_noise_of_its_neighboring_samples():
    """15 s of an x-IMU3: N and the noise from sample to sample agree, B and K are below a bound."""
    import allantools

    desk = read_resting_log(TESTS / "data/strangers/xio_at_rest.parquet")
    t, triads, temperature = desk.t, desk.triads, desk.temperature
    interval = (t[-1] - t[0]) / (len(t) - 1)
    assert temperature is None
    for name, rates in triads.items():
        fit = fit_triad(name, rates, interval)
        one = fit.estimates["random_walk"]
        adev = [allantools.oadev(rates[:, k], 1 / interval, "freq", [8 * interval])[1][0] for k in range(3)]
        measured = np.sqrt(np.mean(np.square(adev))) * np.sqrt(8 * interval)
        assert one.identified
        assert one.value == pytest.approx(measured, rel=0.1)
        assert not fit.estimates["rate_random_walk"].identified
