"""Each source of the linear model by hand: its errors at given rates, its covariance, its epochs."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi2

from bench.core.records.instruments import BaroSpec, StaticPressureSpec
from bench.core.records.sensor_specs import Fault, GnssSpec, ImuSpec, TriadSpec, VibrationSpec
from bench.core.words.exceptions import ConfigError
from bench.evaluation.linear import error_budget, gains, held, quantities, terms
from bench.evaluation.linear.best_linear import find_epochs
from bench.evaluation.linear.path import FACTORS, make_path
from bench.evaluation.linear.terms import IMU, Constant, ErrorProcess
from bench.navigation.error_state_filter.measurement_rows import BARO, POSITION, VELOCITY
from bench.navigation.error_state_filter.state_processes import ABSOLUTE, CUBE, SQUARE, STEADY, WARMTH
from bench.simulation.sensors.imu_terms import compute_temperature
from tests.synthetic import turning
from tests.weaving import units

RATES = np.array([0.3, -0.2, 0.5, 2.0, -3.0, 9.0])  # of gyros [rad/s], accelerometers [m/s^2]
ACROSS = ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))


def make_factors() -> np.ndarray:
    """The factors of a sample with these rates, 20 K above the reference, in a range of 10."""
    factors = np.zeros(FACTORS)
    factors[:6], factors[STEADY], factors[WARMTH] = RATES, 1.0, 20.0
    factors[ABSOLUTE : ABSOLUTE + 6], factors[SQUARE : SQUARE + 6] = np.abs(RATES), RATES**2
    factors[CUBE:] = RATES * (4.0 * (RATES / 10.0) ** 2 - 3.0)
    return factors


def covariance(constants: list[Constant]) -> np.ndarray:
    """Covariance (6, 6) of the errors that constants make of the factors above."""
    factors, P = make_factors(), np.zeros((6, 6))
    for one in constants:
        error = np.zeros(6)
        for axis, factor, size in one.factors:
            error[axis] += size * factors[factor]
        P += np.outer(error, error)
    return P


@pytest.mark.parametrize("first", [0, 3])
def test_constants_of_a_triad_are_those_of_its_error_equation(first):
    """e = b + M w + ...: every figure alone, with independent coefficients of each axis."""
    w, g = RATES[first : first + 3], RATES[3:]
    sd = 1e-3
    full = 4.0 * (w / 10.0) ** 2 - 3.0
    for figure, expected in {
        "turn_on_bias_sd": np.eye(3),
        "scale_factor_sd": np.diag(w**2),
        "scale_asymmetry_sd": np.diag(w**2),
        "nonlinearity_sd": np.diag((w * full) ** 2),
        "quadratic_sd": np.diag(w**4),
        "temperature_sd": 400.0 * np.eye(3),
        "g_sensitivity_sd": np.eye(3) * (g @ g),
        "g2_sensitivity_sd": np.eye(3) * np.sum(g**4),
        "misalignment_sd": np.diag(w @ w - w**2),
        "nonorthogonality_sd": 0.25 * (np.diag(w @ w - w**2) + np.outer(w, w) - np.diag(w**2)),
        "alignment_sd": (w @ w) * np.eye(3) - np.outer(w, w),
    }.items():
        triad = TriadSpec(**{figure: sd, "range": 10.0})
        found = list(terms.list_triad_constants("gyro", triad, first))
        own = slice(first, first + 3)
        P = covariance(found)
        assert_allclose(P[own, own], sd**2 * expected, atol=1e-15, err_msg=figure)
        assert np.count_nonzero(P) == np.count_nonzero(P[own, own])
        assert len({one.source for one in found}) == 1
    assert not list(terms.list_triad_constants("gyro", TriadSpec(), first))


def test_a_common_coefficient_turns_both_axes():
    """Non-orthogonality takes two axes the same way, an alignment one forth and the other back."""
    both = [one.factors for one in terms.list_triad_constants("gyro", TriadSpec(nonorthogonality_sd=0.2), 0)]
    assert both == [((i, j, 0.1), (j, i, 0.1)) for i, j in ((1, 2), (2, 0), (0, 1))]
    turn = [one.factors for one in terms.list_triad_constants("gyro", TriadSpec(alignment_sd=0.2), 3)]
    assert turn == [((3 + i, 3 + j, 0.2), (3 + j, 3 + i, -0.2)) for i, j in ((1, 2), (2, 0), (0, 1))]


def test_processes_of_a_triad_have_the_figures_of_its_sheet():
    triad = TriadSpec(
        random_walk=0.1, rate_random_walk=0.02, bias_instability=0.5, bias_correlation=200.0,
        bias_model="gauss-markov",
    )  # fmt: skip
    white, bias, walk = terms.list_triad_processes("gyro", triad, 3)
    assert_allclose(white.white, 0.01)
    assert_allclose(walk.density, 4e-4)
    correlation, sd = terms.choose_bias_stages(triad)
    assert_allclose(bias.variance, sd[0] ** 2)
    assert bias.decay_time == 1.0 / correlation[0]
    assert {one.first for one in (white, bias, walk)} == {3}
    assert (white.states, bias.states, walk.states) == (False, True, True)
    assert len(list(terms.list_triad_processes("gyro", replace(triad, bias_instability=0.0), 0))) == 2


def test_jumps_of_fixes_come_at_their_mean_rate_or_where_satellites_change(monkeypatch):
    """A hundred a day; of shot noise with decay a the variance is rate sd^2 / 2 a."""
    gnss = GnssSpec(
        "jumping", 2.0, 1.5, 2.5, 0.05, pos_h_markov_sd=3.0, pos_decay_distance=2e-5, pos_decay_time=1e-3,
        vel_decay_time=0.01, vel_markov_sd=0.3, pos_h_jump_sd=2.0, pos_v_jump_markov_sd=4.0,
        vel_jump_markov_sd=0.1,
    )  # fmt: skip
    truth, spec, rate = turning(10.0, 100.0, speed=50.0), units(gnss=gnss), 100.0 / 86400.0
    place, wander, jumps, speed, drift, others = terms.list_gnss_processes(truth, spec, False)
    assert (place.acts, speed.acts) == (POSITION, VELOCITY)
    assert_allclose(place.white, [2.25, 2.25, 6.25])
    assert_allclose(speed.white, 0.0025)
    assert_allclose(wander.variance, [9.0, 9.0, 0.0])
    assert (wander.decay_time, wander.decay_distance) == (1e-3, 2e-5)
    assert (drift.decay_time, drift.decay_distance) == (0.01, 0.0)
    assert_allclose(jumps.variance, [0.0, 0.0, 16.0 * rate / (2.0 * (1e-3 + 2e-5 * 50.0))], rtol=1e-4)
    assert_allclose(jumps.white, [4.0 * rate / 2.0, 4.0 * rate / 2.0, 0.0])
    assert_allclose(others.variance, 0.01 * rate / 0.02)
    assert jumps.at is None
    monkeypatch.setattr(
        terms, "find_constellation_changes", lambda t, lla: np.isin(np.arange(len(t)), [2, 5])
    )
    *_, known = list(terms.list_gnss_processes(truth, spec, True))[:3]
    assert_allclose(known.at, [1.5, 3.0])  # epochs are at 0.5, 1.0, ... s
    assert_allclose(known.kick, [0.0, 0.0, 16.0])
    assert_allclose(known.white, [4.0, 4.0, 0.0])
    steady = replace(gnss, pos_h_jump_sd=0.0, pos_v_jump_markov_sd=0.0, vel_jump_markov_sd=0.0)
    assert len(list(terms.list_gnss_processes(truth, units(gnss=steady), False))) == 4
    forever = replace(gnss, pos_decay_time=0.0, pos_decay_distance=0.0)
    lasting = list(terms.list_gnss_processes(truth, units(gnss=forever), False))[2]
    assert lasting.variance[2] == pytest.approx(16.0 * rate * 86400.0 / 2.0)  # forgotten within a day


def test_what_is_drawn_counts_by_its_mean_square(monkeypatch):
    """Eight runs of a barometer, of vibration: the sum of their squares is the mean of eight."""
    truth = turning(4.0, 100.0)
    spec = replace(units(), baro=BaroSpec("drawn", 5.0, 0.5, physical=StaticPressureSpec()))
    drawn = iter(np.arange(1.0, 9.0))

    def measure(truth, baro, qnh, port, draws):
        return SimpleNamespace(alt_baro=truth.lla[20::20, 2] + next(drawn)), None

    monkeypatch.setattr(terms.static_pressure, "measure", measure)
    baro = list(terms.sampled_baro(truth, spec, 1))
    assert len(baro) == 8
    assert_allclose(sum(one.height**2 for one in baro), np.mean(np.arange(1.0, 9.0) ** 2), rtol=1e-6)
    shaken = iter(np.arange(1.0, 9.0))

    def shake(truth, vibration, draws):
        size = next(shaken)
        return truth.dtheta_b + 1e-2 * size, truth.dvel_b + 3e-2 * size

    monkeypatch.setattr(terms.vibration, "shake", shake)
    imu = ImuSpec("shaken", TriadSpec(), TriadSpec(), vibration=VibrationSpec(engine_gyro=1.0))
    found = list(terms.sampled_imu(truth, imu, 1))
    assert {one.source for one in found} == {"vibration"}
    rate = np.array([1.0, 1.0, 1.0, 3.0, 3.0, 3.0])  # 0.01 rad and 0.03 m/s of 0.01 s
    assert_allclose(
        sum(one.signal**2 for one in found), np.tile(25.5 * rate**2, (len(truth.dtheta_b), 1)), rtol=1e-9
    )


def test_roundings_and_lags_are_those_of_one_triad_and_the_same_in_every_draw():
    truth = turning(2.0, 100.0)
    rounded = TriadSpec(quantization=1e-4)
    (gyro,) = terms.sampled_imu(truth, ImuSpec("x", rounded, TriadSpec()), 1)
    assert (gyro.source, gyro.stochastic) == ("gyro quantization", False)
    assert_allclose(gyro.signal[:, 3:], 0.0, atol=1e-9)
    assert 0.1 * 1e-2 < np.abs(gyro.signal[:, :3]).max() <= 1.001 * 1e-2  # a step of 1e-4 rad in 0.01 s
    late = TriadSpec(delay=0.02)
    (accel,) = terms.sampled_imu(truth, ImuSpec("x", TriadSpec(), late), 1)
    assert accel.source == "accelerometer lag and dead zone"
    assert_allclose(accel.signal[:, :3], 0.0, atol=1e-9)


def test_a_barometer_has_a_bias_a_walk_and_the_noise_of_its_steps():
    spec = units(
        ImuSpec("x", TriadSpec(), TriadSpec()), None, BaroSpec("x", 5.0, 0.5, 3.0, 0.2, quantization=0.6)
    )
    found = terms.model_errors(turning(2.0, 100.0), spec, 1, known_jumps=False)
    bias, walk, noise = found.processes
    for own, value in ((bias.variance, 9.0), (walk.density, 0.04), (noise.white, 0.25 + 0.36 / 12.0)):
        assert_allclose(own, [value, 0.0, 0.0])
    assert {one.acts for one in found.processes} == {BARO}
    starts = np.array([one.start for one in found.constants])
    assert_allclose(starts, np.diag([3.0, 3.0, 5.0, 0.2, 0.2, 0.2, *np.deg2rad([0.5, 0.5, 2.0])]))
    assert [one.name for one in found.sources][:4] == list(terms.INITIAL)


def test_what_has_no_linear_model_is_named():
    spec = units()
    terms.check_sensors(spec)
    fault = Fault("bias", "gnss", 1.0, 2.0, "made")
    for other, word in (
        (replace(spec, imu=replace(spec.imu, accel_cone=0.1)), "accel_cone_deg"),
        (replace(spec, gnss=replace(spec.gnss, latency=0.1)), "without latency, not weaving-gnss"),
        (replace(spec, baro=replace(spec.baro, latency=0.1)), "without latency, not weaving-baro"),
        (replace(spec, gnss=replace(spec.gnss, tracking_bandwidth=1.0)), "tracking_bandwidth_hz"),
        (replace(spec, faults=(fault,)), "scripted faults"),
    ):
        with pytest.raises(ConfigError, match=word):
            terms.check_sensors(other)


# --- the path ---------------------------------------------------------------------------------------------


def test_the_steps_of_a_path_are_means_of_its_samples():
    truth = turning(1.0, 100.0, speed=20.0, turn_rate=0.4)
    imu = ImuSpec("x", TriadSpec(range=2.0), TriadSpec())
    path = make_path(truth, imu, np.array([0.25, 0.333]))
    assert_allclose(path.t, [0.0, 0.1, 0.2, 0.25, 0.3, 0.33, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
    assert_allclose(path.span, np.diff(path.t))
    assert_allclose(path.speed, 20.0, rtol=1e-9)
    rates = np.hstack([truth.dtheta_b, truth.dvel_b]) / 0.01
    own = slice(20, 25)  # of the samples in the step from 0.2 to 0.25 s
    for first, expected in (
        (0, rates), (STEADY, np.ones((100, 1))), (ABSOLUTE, np.abs(rates)), (SQUARE, rates**2),
        (CUBE, np.hstack([rates[:, :3] * (rates[:, :3] ** 2 - 3.0), -3.0 * rates[:, 3:]])),
    ):  # fmt: skip
        found = path.factors[2, first : first + expected.shape[1]]
        assert_allclose(found, expected[own].mean(axis=0), rtol=1e-9, atol=1e-12)
    assert_allclose(path.factors[:, WARMTH], 0.0)
    assert_allclose(path.rate_b[4], rates[29, :3])
    C = 0.5 * (path.C_nb[2] + path.C_nb[3])
    assert_allclose(path.C_mean[2], C, atol=1e-3)
    assert_allclose(path.G[2, :3, 3:6], 0.05 * np.eye(3), atol=1e-3)  # position by velocity
    assert_allclose(path.G[2, 3:6, 12:15], -0.05 * C, atol=2e-3)  # velocity by accelerometer biases


def test_the_temperature_of_a_path_is_that_over_the_reference():
    truth = turning(1.0, 100.0)
    thermal = replace(ImuSpec("x", TriadSpec(), TriadSpec()).thermal, reference=280.0, self_heating=5.0)
    path = make_path(truth, ImuSpec("x", TriadSpec(temperature_sd=1e-5), TriadSpec(), thermal), np.empty(0))
    degrees = compute_temperature(truth, path.rows, thermal) - 280.0
    assert_allclose(path.factors[:, WARMTH], 0.5 * (degrees[1:] + degrees[:-1]))
    assert np.abs(path.factors[:, WARMTH]).min() > 0.1


def test_a_filter_knows_the_temperature_by_its_own_model():
    """Immediate warming: reference + slope times height from the second step on; the first is that given."""
    path = SimpleNamespace(
        factors=np.ones((3, FACTORS)), span=np.ones(3), lla=np.array([[0.0, 0.0, 100.0]] * 4)
    )
    drives = np.array([[9, 0, WARMTH]])
    model = SimpleNamespace(process=SimpleNamespace(drives=drives, thermal=np.array([7.0, 20.0, -0.01, 0.0])))
    found = error_budget.motion_factors(path, model)
    assert_allclose(found[:, WARMTH], [7.0, 19.0, 19.0])
    assert_allclose(np.delete(found, WARMTH, axis=1), 1.0)
    model.process.drives = np.array([[9, 0, STEADY]])
    assert error_budget.motion_factors(path, model) is path.factors


def test_signals_are_means_over_the_steps():
    path = SimpleNamespace(factors=np.tile(make_factors(), (2, 1)), rows=np.array([0, 2, 5]))
    samples = np.arange(30.0).reshape(5, 6)
    made = (Constant("a", factors=((1, 3, 0.5), (4, STEADY, 2.0))), Constant("b", signal=samples))
    found = error_budget.signals(path, made)
    assert_allclose(found[:, :, 0], [[0.0, 0.5 * 2.0, 0.0, 0.0, 2.0, 0.0]] * 2)
    assert_allclose(found[:, :, 1], [samples[:2].mean(axis=0), samples[2:].mean(axis=0)])


def test_processes_fade_with_time_and_way_and_walk():
    path = SimpleNamespace(span=np.array([2.0, 0.5]), speed=np.array([30.0, 10.0]))
    wander = ErrorProcess(
        "a", POSITION, variance=np.array([4.0, 1.0, 9.0]), decay_time=0.1, decay_distance=0.01
    )
    walk = ErrorProcess("b", IMU, density=np.array([0.3, 0.0, 0.1]))
    decay, added = error_budget.ProcessSteps([wander, walk]).steps(path)
    fade = np.exp([-(0.1 + 0.3) * 2.0, -(0.1 + 0.1) * 0.5])
    assert_allclose(decay, np.column_stack([fade, np.ones(2)]))
    assert_allclose(added[:, 0], (1.0 - fade[:, None] ** 2) * wander.variance)
    assert_allclose(added[:, 1], np.array([[2.0], [0.5]]) * walk.density)


def test_white_noise_of_jumps_is_there_at_their_instants_only():
    always = ErrorProcess("a", POSITION, white=np.array([1.0, 2.0, 3.0]))
    jump = ErrorProcess("b", POSITION, white=np.array([4.0, 5.0, 6.0]), at=np.array([10.0, 20.0]))
    other = ErrorProcess("c", VELOCITY, white=np.array([7.0, 8.0, 9.0]))
    steps = error_budget.ProcessSteps([always, jump, other])
    for t, white in ((10.0, [2.0, 5.0, 0.0]), (15.0, [2.0, 0.0, 0.0]), (20.0 + 1e-7, [2.0, 5.0, 0.0])):
        acts, found = steps.rows(POSITION, 1, t)
        assert acts.tolist() == [1.0, 1.0, 0.0]
        assert found.tolist() == white


# --- figures ----------------------------------------------------------------------------------------------


def test_epochs_are_those_of_valid_records_in_the_order_of_time():
    def record(t, valid):
        return SimpleNamespace(t=np.array(t), valid=np.array(valid, bool))

    path = SimpleNamespace(t=np.arange(0.0, 3.1, 0.5))
    data = SimpleNamespace(fixes=record([1.0, 2.0, 3.0], [1, 0, 1]), baro=record([0.5, 1.0], [1, 1]))
    found = find_epochs(path, data)
    assert found.step.tolist() == [1, 2, 2, 2, 6, 6]
    assert found.code.tolist() == [BARO, POSITION, VELOCITY, BARO, POSITION, VELOCITY]
    assert len(find_epochs(path, SimpleNamespace(fixes=None, baro=None)).step) == 0


def test_a_flight_has_gnss_but_in_its_outages():
    t, spec = np.arange(10.0), SimpleNamespace(gnss_outages=((3.0, 5.0),))
    found = held.list_phases(t, 2.0, spec)
    assert np.flatnonzero(found["with GNSS"]).tolist() == [2, 5, 6, 7, 8, 9]
    assert np.flatnonzero(found["without GNSS"]).tolist() == [3, 4]
    assert list(held.list_phases(t, 6.0, spec)) == ["with GNSS"]


def test_draws_over_a_bound_have_the_interval_of_their_spread():
    """Three runs of one epoch with the squares 2, 8 and 26 m^2: few runs hold the spread for larger."""
    horizontal, height, *_, heading = quantities.QUANTITIES
    errors = np.zeros((3, 1, 9))
    errors[:, 0, 2], errors[:, 0, 8] = np.sqrt([2.0, 8.0, 26.0]), np.deg2rad([1.0, 2.0, 3.0])
    least = np.full((1, 9), 2.0)
    found = quantities.compare_draws(errors, least, height)
    assert (found.rmse, found.bound, found.ratio) == pytest.approx(
        (np.sqrt(12.0), np.sqrt(2.0), np.sqrt(6.0))
    )
    widest = (100.0 + 16.0 + 196.0) / chi2.ppf(0.05, 2)
    freedom = 3.0 * max(1.0, 2.0 * 144.0 / widest)
    low, high = (np.sqrt(6.0 * freedom / chi2.ppf(p, freedom)) for p in (0.9995, 0.0005))
    assert (found.low, found.high) == pytest.approx((low, high))
    turned = quantities.compare_draws(errors, np.full((1, 9), np.deg2rad(0.5) ** 2), heading)
    assert (turned.rmse, turned.bound) == pytest.approx((np.sqrt(14.0 / 3.0), 0.5))
    assert quantities.compare_draws(errors * np.nan, least, horizontal) is None
    assert quantities.compare_run(errors[:, 0] * np.nan, least, horizontal) is None
    for unknown in (quantities.compare_draws(errors, least * np.nan, height),
                    quantities.compare_run(errors[:, 0], least * np.nan, height)):  # fmt: skip
        assert unknown is None
    assert quantities.count_freedom(np.full(3, 2.0)) > 1e6, "runs that are alike"


@pytest.mark.parametrize("alternate", [True, False])
def test_the_interval_of_one_run_counts_what_its_correlation_leaves(alternate):
    """Ten errors of +-1 or of 1: rho^2 at lag k is (1 - k / 10)^2, whatever its sign."""
    size = np.where(np.arange(10) % 2, -1.0 if alternate else 1.0, 1.0)
    found = quantities.compare_run(np.tile(size[:, None], (1, 9)), np.ones((10, 9)), quantities.QUANTITIES[1])
    freedom = max(1.0, 10.0 / (1.0 + 2.0 * np.sum((1.0 - np.arange(1, 10) / 10.0) ** 2)))
    low, high = (np.sqrt(freedom / chi2.ppf(p, freedom)) for p in (0.9995, 0.0005))
    assert (found.ratio, found.low, found.high) == pytest.approx((1.0, low, high))


# --- the walk of the errors of a filter -------------------------------------------------------------------


def walk(*processes: ErrorProcess, constants: tuple[Constant, ...] = ()) -> error_budget.SourceWalk:
    """The errors of a filter of 15 states on a path of ten steps of 0.1 s."""
    path = make_path(turning(1.0, 100.0), ImuSpec("x", TriadSpec(), TriadSpec()), np.empty(0))
    none = np.zeros(15)
    process = SimpleNamespace(drives=np.empty((0, 3), np.int64), decay_time=none, decay_distance=none)
    model = SimpleNamespace(layout=SimpleNamespace(size=15), process=process)
    return error_budget.SourceWalk(path, terms.TruthModel((), constants, processes), model)


def test_a_jump_comes_at_its_instant_and_fades():
    jump = ErrorProcess("jump", POSITION, kick=np.array([4.0, 0.0, 1.0]), at=np.array([0.5]), decay_time=0.2)
    one, found = walk(jump), []
    for k in range(10):
        one.move(k)
        found.append(one.Pss[0, 0])
    assert_allclose(found[:4], 0.0)
    assert_allclose(found[4:], 4.0 * np.exp(-0.4 * 0.1 * np.arange(6)))
    assert_allclose(one.Pss[0, 1:], [0.0, 0.25 * found[-1]])


def test_a_known_height_error_goes_in_by_the_gain_of_the_barometer():
    down = np.eye(15)[2]
    one = walk(
        constants=(Constant("port", height=np.array([5.0, 7.0])), Constant("start", start=2.0 * down[:9]))
    )
    gain = np.arange(15.0)
    one.correct(-down, gain, BARO, 0, 1, 0)
    assert_allclose(one.X[:, 0], 7.0 * gain)
    assert_allclose(one.X[:, 1], 2.0 * down + 2.0 * gain)
    one.correct(0.0 * down, gain, POSITION, 0, 0, 0)
    assert_allclose(one.X[:, 0], 7.0 * gain)


def test_a_correction_is_that_of_the_matrix_equations():
    """A wandering fix and white noise: P of (x, s) by (I - K h') P (I - K h')' + K r K', row by row."""
    wander = ErrorProcess("wander", POSITION, variance=np.array([4.0, 9.0, 1.0]), decay_time=0.1)
    noise = ErrorProcess("noise", POSITION, white=np.array([0.5, 0.25, 2.0]))
    one = walk(wander, noise)
    drawn, h = 0.3 * np.random.default_rng(3).standard_normal((4, 15)), np.eye(15)[:3]
    P, R = np.zeros((18, 18)), np.zeros((15, 15))
    P[15:, 15:] = np.diag(wander.variance)
    for gain, axis in zip(drawn, (0, 1, 0, 2), strict=True):
        one.correct(h[axis], gain, POSITION, axis, 0, 0)
        row = np.concatenate([h[axis], -np.eye(3)[axis]])  # h x - s
        A = np.eye(18) - np.outer(np.concatenate([gain, np.zeros(3)]), row)
        P = A @ P @ A.T
        A = np.eye(15) - np.outer(gain, h[axis])
        R = A @ R @ A.T + noise.white[axis] * np.outer(gain, gain)
    assert_allclose(one.Pxx[:, 0], P[:15, :15], atol=1e-12)
    assert_allclose(one.Pxs[:, 0], P[:15, 15:], atol=1e-12)
    assert_allclose(one.Pss[0], wander.variance)
    assert_allclose(one.Pxx[:, 1], R, atol=1e-12)


def test_a_measurement_comes_from_the_row_that_arrived_then():
    record = SimpleNamespace(t=np.arange(3.0), t_arrival=np.array([1.0, 2.0, 3.0]))
    data = SimpleNamespace(baro=record, fixes=None)
    assert gains.find_record_rows(np.array([1.0, 2.0, 3.5]), BARO, data).tolist() == [0, 1, 2]
    assert gains.find_record_rows(np.array([1.0, 2.0]), POSITION, data).tolist() == [0, 0]


def test_figures_are_roots_of_sums_in_their_units():
    variance = np.square([3.0, 4.0, 2.0, 0.6, 0.8, 9.0, *np.deg2rad([0.3, 0.4, 5.0])])
    found = {one.name: float(one.sd(variance)) for one in quantities.QUANTITIES}
    assert found == pytest.approx(
        {"horizontal_m": 5.0, "height_m": 2.0, "velocity_mps": 1.0, "tilt_deg": 0.5, "heading_deg": 5.0}
    )
