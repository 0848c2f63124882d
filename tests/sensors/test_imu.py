"""The IMU model: each error term is what its parameter says, and touches nothing else.

Laws: an IMU without errors is the truth; every parameter doubled moves the output as it should; the
Allan deviation of the noise is the datasheet's; the reported bias is the applied one; quantization
loses no motion. Statistical bounds are two-sided 99.9 % bands of the statistic itself.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.simulation.sensors import imu, processes
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals import allan
from tests.builders import Z, band
from tests.sensors.given_numbers import respond
from tests.synthetic import still, turning

OFF = TriadSpec()
FULL = TriadSpec(
    random_walk=4e-5,
    bias_instability=1e-5,
    bias_correlation=100.0,
    turn_on_bias_sd=1e-4,
    scale_factor_sd=5e-4,
    misalignment_sd=1e-3,
)
LINEAR = ["random_walk", "bias_instability", "turn_on_bias_sd", "scale_factor_sd", "misalignment_sd"]


@pytest.fixture(scope="module")
def turn():
    return turning(60.0, 200.0)


@pytest.fixture(scope="module")
def rest():
    return still(600.0, 200.0)


def measure(truth, gyro=OFF, accel=OFF, seed=1, run=0):
    return imu.measure(truth, ImuSpec("test", gyro, accel), SensorDraws(seed, run))


def test_without_errors_the_record_is_the_truth_to_the_last_bit(turn):
    record, bias = measure(turn)
    assert record.dtheta_b.tobytes() == turn.dtheta_b.tobytes()
    assert record.dvel_b.tobytes() == turn.dvel_b.tobytes()
    assert_array_equal(record.t, turn.t[1:])
    assert_array_equal(record.t - record.dt, turn.t[1:] - np.diff(turn.t))
    assert record.valid.all()
    assert not bias.gyro_b.any()
    assert not bias.accel_b.any()


@pytest.mark.parametrize("model", ["flicker", "gauss-markov"])
@pytest.mark.parametrize("figure", LINEAR)
def test_doubling_a_figure_doubles_its_own_error_and_no_other(turn, figure, model):
    """The term alone, from a unit with all terms: full(2x) - full(x) = only(x) = only(2x) / 2."""
    full = replace(FULL, bias_model=model)
    alone = replace(OFF, bias_correlation=100.0, bias_model=model, **{figure: getattr(full, figure)})
    value = 2 * getattr(full, figure)
    deviation = measure(turn, gyro=alone)[0].dtheta_b - turn.dtheta_b
    doubled = measure(turn, gyro=replace(alone, **{figure: value}))[0].dtheta_b - turn.dtheta_b
    assert deviation.std() > 0
    atol = 1e-3 * np.abs(deviation).max()
    assert_allclose(doubled, 2 * deviation, rtol=0, atol=1e-6 * np.abs(doubled).max())

    before = measure(turn, gyro=full, accel=full)[0]
    after = measure(turn, gyro=replace(full, **{figure: value}), accel=full)[0]
    assert_allclose(after.dtheta_b - before.dtheta_b, deviation, rtol=0, atol=atol)
    assert_array_equal(after.dvel_b, before.dvel_b)


def test_doubling_the_correlation_time_halves_the_wandering(rest):
    """Same noise, same spread at the start; the steps of the bias get sqrt(2) smaller."""
    unit = TriadSpec(bias_instability=1e-5, bias_correlation=50.0, bias_model="gauss-markov")
    slow = replace(unit, bias_correlation=100.0)
    fast_bias, slow_bias = measure(rest, gyro=unit)[1].gyro_b, measure(rest, gyro=slow)[1].gyro_b
    assert_array_equal(fast_bias[0], slow_bias[0])
    assert_allclose(
        np.diff(fast_bias, axis=0).std() / np.diff(slow_bias, axis=0).std(), np.sqrt(2), rtol=1e-3
    )


def test_every_term_has_a_stream_and_none_is_drawn_for_nothing(turn, streams_drawn):
    drawn = streams_drawn()
    measure(turn, gyro=replace(OFF, random_walk=1e-5, bias_correlation=100.0))
    assert drawn == ["imu.gyro.white"]
    drawn.clear()
    measure(turn, accel=replace(OFF, turn_on_bias_sd=1e-5, quantization=1e-9))
    assert drawn == ["imu.accel.turn_on"]
    drawn.clear()
    measure(turn, gyro=FULL, accel=FULL)
    assert len(set(drawn)) == len(drawn) == 10


def test_triads_runs_and_seeds_have_their_own_noise(turn):
    noisy = replace(OFF, random_walk=1.0)
    first = measure(turn, noisy, noisy)[0]
    records = [first.dtheta_b - turn.dtheta_b, first.dvel_b - turn.dvel_b]
    records += [measure(turn, noisy, run=1)[0].dtheta_b - turn.dtheta_b]
    records += [measure(turn, noisy, seed=2)[0].dtheta_b - turn.dtheta_b]
    correlation = np.corrcoef([record[:, 0] for record in records])
    assert np.abs(correlation - np.eye(4)).max() < Z / np.sqrt(len(turn) - 1)


def test_scale_factor_and_misalignment_multiply_the_true_increments():
    """Least squares finds I + M back: scale errors on the diagonal, the rest beside it."""
    truth = still(0.1, 200.0)
    dtheta = np.random.default_rng(3).normal(size=truth.dtheta_b.shape)  # every axis is excited
    truth = replace(truth, dtheta_b=dtheta)

    def error_matrix(spec, run=0):
        return np.linalg.lstsq(dtheta, measure(truth, gyro=spec, run=run)[0].dtheta_b)[0].T - np.eye(3)

    diagonal = np.eye(3, dtype=bool)
    assert_allclose(error_matrix(replace(OFF, scale_factor_sd=5e-4))[~diagonal], 0, atol=1e-14)
    assert_allclose(error_matrix(replace(OFF, misalignment_sd=1e-3))[diagonal], 0, atol=1e-14)
    both = replace(OFF, scale_factor_sd=5e-4, misalignment_sd=1e-3)
    drawn = np.array([error_matrix(both, run) for run in range(300)])
    for values, sd in ((drawn[:, diagonal], 5e-4), (drawn[:, ~diagonal], 1e-3)):
        low, high = band(values.size)
        assert low < np.mean(values**2) / sd**2 < high
        assert not low < np.mean((1.2 * values) ** 2) / sd**2 < high  # 20 % too large would be seen


def test_white_noise_has_the_allan_deviation_of_the_datasheet(rest):
    """N / sqrt(tau) at every octave; edf of the overlapping estimate for white noise: NIST SP 1065 (2008).

    60 comparisons, false alarm below 6 %; an N that is 3 % wrong is seen at the shortest tau.
    """
    import allantools

    spec = replace(OFF, random_walk=4e-5)
    record = measure(rest, spec, spec)[0]
    rate = 200.0
    octaves = 2 ** np.arange(10)
    for noise in (record.dtheta_b - rest.dtheta_b, record.dvel_b - rest.dvel_b):
        for axis in range(3):
            taus, adev, _, _ = allantools.oadev(noise[:, axis] * rate, rate, "freq", octaves / rate)
            m, n = np.round(taus * rate), len(noise) + 1
            edf = (1.5 * (n - 1) / m - 2 * (n - 2) / n) * 4 * m**2 / (4 * m**2 + 5)
            ratio = adev**2 / (spec.random_walk**2 / taus)
            low, high = band(edf)
            assert len(taus) == 10
            assert (low < ratio).all()
            assert (ratio < high).all()
            assert ratio[0] * 1.03**2 > high[0]


def test_white_noise_grows_with_the_square_root_of_the_interval():
    """The same N at 50 and 200 Hz: after a second both angles have wandered by N."""
    spec = replace(OFF, random_walk=4e-5)
    for rate in (50.0, 200.0):
        truth = still(600.0, rate)
        angle = (measure(truth, spec)[0].dtheta_b - truth.dtheta_b).reshape(600, -1, 3).sum(axis=1)
        low, high = band(angle.size)
        assert low < np.mean(angle**2) / 4e-5**2 < high


@pytest.mark.parametrize("model", ["flicker", "gauss-markov"])
def test_the_bias_reported_is_the_bias_applied(model):
    """Between its knots the bias is linear, so its trapezoids are what the increments gained."""
    spec = TriadSpec(turn_on_bias_sd=1e-4, bias_instability=1e-3, bias_correlation=30.0, bias_model=model)
    for rate in (200.0, 100.0, 30.0, 10.0):
        truth = still(20.0, rate)
        record, bias = measure(truth, spec, spec)
        assert bias.t[0] == truth.t[0]
        assert bias.t[-1] == truth.t[-1]
        knots = np.searchsorted(truth.t, bias.t)
        for measured, true, b in (
            (record.dtheta_b, truth.dtheta_b, bias.gyro_b),
            (record.dvel_b, truth.dvel_b, bias.accel_b),
        ):
            gained = np.vstack([np.zeros(3), np.cumsum(measured - true, axis=0)])[knots]
            integral = np.cumsum(0.5 * (b[1:] + b[:-1]) * np.diff(bias.t)[:, None], axis=0)
            assert_allclose(gained[1:], integral, rtol=0, atol=1e-12)


def test_a_fast_bias_is_stepped_at_every_sample_and_reported_at_20_hz():
    spec = TriadSpec(bias_instability=1e-3, bias_correlation=0.1, bias_model="gauss-markov")
    truth = still(20.0, 200.0)
    record, bias = measure(truth, spec)
    assert len(bias.t) == 401
    rate = (record.dtheta_b - truth.dtheta_b) * 200.0
    at_knots = 0.5 * (rate[9:-1:10] + rate[10::10])  # mean of the two samples around a knot
    assert np.corrcoef(at_knots[:, 0], bias.gyro_b[1:-1, 0])[0, 1] > 0.95
    curvature = np.diff(rate[:, 0], 2)
    assert np.abs(curvature).min() > 0  # a line between 20 Hz knots would have none


def test_a_bias_of_more_than_a_second_is_a_line_between_20_hz():
    """One of less has a step at every sample; between the knots the second difference is zero."""
    truth = still(5.0, 200.0)
    for correlation, step in ((1.5, 0.05), (0.9, 0.005)):
        spec = TriadSpec(bias_instability=1e-3, bias_correlation=correlation, bias_model="gauss-markov")
        bent = np.abs(np.diff(measure(truth, spec)[0].dtheta_b - truth.dtheta_b, 2, axis=0)) > 1e-12
        assert (bent[2:8].any()) == (step == 0.005)
        assert imu.choose_bias_step(spec, 0.005) == pytest.approx(step)
    assert imu.choose_bias_step(OFF, 0.03) == pytest.approx(0.06)
    assert imu.choose_bias_step(OFF, 0.2) == 0.2


def test_stages_of_a_bias_have_their_covariance_at_any_interval():
    """On each axis alone, exactly, in one piece and in two; what is drawn adds."""
    steps, T, sd = np.array([9.0, 0.3, 2.0, 0.05]), np.array([0.5, 4.0]), np.array([1.0, 3.0])

    def walk(draws, pieces=1):
        return np.concatenate([draws.markov("bias", part, T, sd) for part in np.split(steps, pieces)])

    response = respond("bias", 24, walk)
    lag = np.abs(np.subtract.outer(*[np.cumsum(steps)] * 2))
    expected = sum(s**2 * np.exp(-lag / one) for s, one in zip(sd, T, strict=True))
    assert_allclose(response @ response.T, np.kron(expected, np.eye(3)), atol=1e-12)
    assert (response >= 0).all()
    assert_array_equal(respond("bias", 24, lambda draws: walk(draws, 2)), response)


def test_gauss_markov_bias_is_stationary_with_the_right_memory():
    """400 runs, three axes: variance at both ends of one correlation time, correlation 1/e between them."""
    truth = still(20.0, 20.0)
    spec = TriadSpec(bias_instability=1e-5, bias_correlation=20.0, bias_model="gauss-markov")
    ends = np.array([measure(truth, spec, run=run)[1].gyro_b[[0, -1]] for run in range(400)])
    start, end = ends[:, 0].ravel(), ends[:, 1].ravel()
    low, high = band(start.size)
    for values in (start, end):
        assert low < np.mean(values**2) / (1e-5 / 0.617) ** 2 < high
        assert not low < np.mean(values**2) / 1e-5**2 < high  # the value taken for the sd would be seen

    def memory_is(correlation_time):
        z = np.arctanh(np.corrcoef(start, end)[0, 1]) - np.arctanh(np.exp(-20.0 / correlation_time))
        return abs(z) < Z / np.sqrt(start.size - 3)

    assert memory_is(20.0)
    assert not memory_is(25.0)


def test_analytic_allan_curve_is_that_of_the_autocovariance():
    """The Allan variance of sampled averages, summed from exp(-lag / T) without the closed form."""
    step, m = 0.01, 150
    weights = np.concatenate([-np.ones(m), np.ones(m)]) / m
    lag = step * np.abs(np.subtract.outer(np.arange(2 * m), np.arange(2 * m)))
    variance = 0.5 * weights @ np.exp(-lag / 2.0) @ weights
    assert_allclose(allan.gauss_markov_deviation(m * step, 1.0, 2.0), np.sqrt(variance), rtol=1e-3)


def test_gauss_markov_curve_peaks_at_the_bias_instability():
    spec = TriadSpec(bias_instability=3.0, bias_correlation=7.0, bias_model="gauss-markov")
    correlation, sd = processes.choose_bias_stages(spec)
    tau = np.geomspace(0.7, 70.0, 2001)
    curve = allan.gauss_markov_deviation(tau, sd[0], correlation[0])
    assert_allclose(curve.max(), 3.0, rtol=1e-3)
    assert_allclose(tau[curve.argmax()] / 7.0, 1.89, rtol=1e-2)


def test_flicker_curve_is_flat_at_the_bias_instability():
    """Within 1 % from 0.1 to 10 correlation times."""
    spec = TriadSpec(bias_instability=3.0, bias_correlation=7.0)
    correlation, sd = processes.choose_bias_stages(spec)
    tau = 7.0 * np.geomspace(0.1, 10.0, 2001)
    curve = np.sqrt(
        sum(allan.gauss_markov_deviation(tau, s, c) ** 2 for s, c in zip(sd, correlation, strict=True))
    )
    assert np.abs(curve / 3.0 - 1).max() < 0.01


def test_flicker_records_have_a_flat_allan_deviation():
    """30 records of 100 times the longest tau; the mean Allan variance against 1 within 5 % of deviation.

    The band adds 3.29 standard errors from the spread of the records. One Gauss-Markov stage of the
    same peak fails.
    """
    import allantools

    truth = still(2000.0, 50.0)
    taus = 2.0 * np.array([0.1, 0.3, 1.0, 3.0, 10.0])

    def is_flat(model):
        spec = TriadSpec(bias_instability=1e-3, bias_correlation=2.0, bias_model=model)
        ratios = []
        for run in range(5):
            record = measure(truth, spec, spec, run=run)[0]
            for noise in (record.dtheta_b - truth.dtheta_b, record.dvel_b - truth.dvel_b):
                for axis in range(3):
                    adev = allantools.oadev(noise[:, axis] * 50.0, 50.0, "freq", taus)[1]
                    ratios.append((adev / 1e-3) ** 2)
        mean, error = np.mean(ratios, axis=0), np.std(ratios, axis=0, ddof=1) / np.sqrt(len(ratios))
        assert (error < 0.05).all()
        return bool(((mean > 0.95**2 - Z * error) & (mean < 1.05**2 + Z * error)).all())

    assert is_flat("flicker")
    assert not is_flat("gauss-markov")


def test_quantization_carries_its_remainder(rest):
    """The sum of outputs stays within half a bit of the sum of inputs, with a uniform error."""
    noise = replace(OFF, random_walk=4e-5)
    lsb = 1e-6
    exact = measure(rest, noise)[0].dtheta_b
    rounded = measure(rest, replace(noise, quantization=lsb))[0].dtheta_b
    assert_allclose(rounded / lsb, np.rint(rounded / lsb), rtol=0, atol=1e-9)
    error = np.cumsum(rounded - exact, axis=0)
    assert np.abs(error).max() < 0.5 * lsb * (1 + 1e-6)
    spread = Z * np.sqrt(0.8 / error.size)  # relative sd of the variance estimate of a uniform variable
    assert abs(np.mean(error**2) / (lsb**2 / 12) - 1) < spread
    forgetful = np.cumsum(lsb * np.rint(exact / lsb) - exact, axis=0)
    assert np.abs(forgetful).max() > lsb


def test_doubling_the_least_bit_doubles_the_rounding(turn):
    white = replace(OFF, random_walk=4e-5)
    exact = measure(turn, white, white)[0]
    spread = []
    for lsb in (1e-6, 2e-6):
        record = measure(turn, replace(white, quantization=lsb), white)[0]
        spread.append(np.cumsum(record.dtheta_b - exact.dtheta_b, axis=0).std())
        assert_array_equal(record.dvel_b, exact.dvel_b)
    count = exact.dtheta_b.size
    assert abs(spread[1] / spread[0] / 2 - 1) < Z * np.sqrt(0.8 / count / 4 * 2)


def test_a_missing_correlation_time_or_unknown_model_is_refused(turn):
    with pytest.raises(ValueError, match="bias_instability needs bias_correlation_s above 0 s"):
        measure(turn, replace(OFF, bias_instability=1e-5))
    with pytest.raises(ValueError, match="'flicker' or 'gauss-markov'; got 'pink'"):
        measure(turn, replace(FULL, bias_model="pink"))


def test_compiled_kernels_agree_with_their_own_python(turn):
    rng = np.random.default_rng(7)
    n = 400
    knots = np.append(np.arange(0, n, 10), n)
    arguments = (
        turn.t[: n + 1],
        0,
        turn.dvel_b[:n],
        rng.normal(scale=1e-3, size=(3, 3)),
        knots,
        rng.normal(scale=1e-2, size=(len(knots), 3)),
        rng.normal(size=(n, 3)),
        np.array([1e-3, 2e-3, 0.0]),
        1e-4,
        0.0,
        rng.normal(scale=1e-3, size=(n, 3)),
        20.0,
    )
    compiled, plain = np.empty((n, 3)), np.empty((n, 3))
    flags = np.ones((2, n), bool)
    imu.measure_kernel(*arguments, np.zeros(3), compiled, flags[0])
    imu.measure_kernel.py_func(*arguments, np.zeros(3), plain, flags[1])
    assert_allclose(compiled, plain, rtol=0, atol=1e-13)
    assert_array_equal(flags[0], flags[1])

    dt, correlation, sd = rng.uniform(size=49), np.array([0.5, 3.0]), np.array([1.0, 2.0])
    noise = np.random.default_rng(5).normal(size=(50, 2, 3))
    plain = np.zeros((50, 3))
    decay = np.exp(-np.concatenate([[np.inf], dt])[:, None] / correlation)
    processes.gauss_markov_kernel.py_func(decay, sd, noise, np.zeros((2, 3)), plain)
    simulated = processes.simulate_gauss_markov(dt, correlation, sd, np.random.default_rng(5))
    assert_allclose(simulated, plain, rtol=0, atol=1e-13)
