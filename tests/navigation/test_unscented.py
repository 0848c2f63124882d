"""ukf: the loose filter's model by sigma points: the same where it is linear, better where it is not."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth, rotation
from bench.core.words.exceptions import EstimatorError
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.error_state_filter.state_blocks import BARO_BIAS, state_model
from bench.navigation.models import ukf
from bench.navigation.models.loose_tight import Loose
from bench.navigation.models.ukf import Unscented
from bench.navigation.start import headings
from bench.simulation import sensors
from tests.builders import ensemble, student
from tests.navigation.test_layouts import standard_errors_from
from tests.weaving import DEG, GNSS, units, weaving

FLIGHT, UNITS = (30.0, 100.0), units()


@pytest.fixture(scope="module")
def minute():
    return weaving(60.0, rate=50.0)


def test_on_a_short_flight_it_says_what_loose_15_says(sensed):
    """Errors small enough to be linear, a good start: to 2 % of sigma, and sigma to 1 %."""
    small = replace(units(), initial_tilt_sd=0.05 * DEG, initial_heading_sd=0.2 * DEG)
    sensed = sensors.sense(weaving(30.0, rate=100.0), small, 1, 0)
    mine, theirs = (e.run(sensed.data, sensed.initial) for e in (Unscented(), Loose(covariance_hz=10.0)))
    sd = np.sqrt(np.einsum("kii->ki", theirs.cov))
    turn = rotation.to_rotvec(rotation.multiply(mine.q_nb, rotation.conjugate(theirs.q_nb)))
    apart = np.hstack([earth.difference_n(mine.lla, theirs.lla), mine.vel_n - theirs.vel_n, turn])
    assert np.abs(apart / sd).max() < 0.02
    assert_allclose(np.sqrt(np.einsum("kii->ki", mine.cov)), sd, rtol=0.01)
    assert np.abs((mine.extra - theirs.extra) / theirs.extra_sd).max() < 0.02
    assert mine.extra_names == theirs.extra_names
    other = Unscented().run(
        replace(sensed.data, antenna_b=sensed.data.antenna_b + np.array([0.1, 0, 0])), sensed.initial
    )
    assert np.abs(earth.difference_n(other.lla, theirs.lla) / sd[:, :3]).max() > 0.05


def test_the_covariance_step_is_that_of_the_linear_filter_for_small_errors(sensed):
    """One second of prediction from P, without fixes: sigma points and Jacobian agree to 1e-3."""
    tiny = replace(units(), initial_tilt_sd=1e-4, initial_heading_sd=1e-4, gnss=None, baro=None)
    sensed = sensors.sense(weaving(1.0, rate=100.0), tiny, 1, 0)
    mine, theirs = (e.run(sensed.data, sensed.initial) for e in (Unscented(), Loose(covariance_hz=10.0)))
    scale = np.sqrt(np.einsum("kii->ki", theirs.cov))
    scale = scale[:, :, None] * scale[:, None, :]
    assert_allclose(mine.cov / scale, theirs.cov / scale, atol=1e-3)


@pytest.mark.slow
def test_six_seeds_over_a_minute_are_consistent(minute):
    """Mean NEES and mean NIS in their 99.9 % bands.

    A receiver assumed to have half the noise it has leaves the bands.
    """

    def draw(run):
        return sensors.sense(minute, units(), 11, run)

    found = ensemble(Unscented(), minute, draw, 6, 30.0)
    nees, nis = found.averages(), found.pooled_nis()
    assert abs(standard_errors_from(nees, 9)) < student(6)
    assert abs(nees.mean() - 9) < 4.0
    assert all(band.inside for band in nis.values()), nis
    half = replace(GNSS, pos_h_white_sd=0.75, pos_v_white_sd=1.25, vel_white_sd=0.025)
    believed = replace(units().assumed, gnss=half)
    nis = ensemble(Unscented(), minute, draw, 2, 30.0, believed).pooled_nis()
    assert not nis["gnss_position"].inside
    assert not nis["gnss_velocity"].inside


def test_a_heading_that_is_hardly_known_is_found(monkeypatch):
    """60 deg of heading sd, 8 runs of a minute: the headings after 30 s in units of what is reported.

    One filter, without the hypotheses that it starts with from such a heading. Of 8 consistent runs two are
    beyond 3.29 sigma once in 36,000 times.
    """
    monkeypatch.setattr(headings, "LINEAR", np.inf)
    truth, spec = weaving(60.0, rate=50.0), replace(units(), initial_heading_sd=60.0 * DEG)
    beyond = 0
    for run in range(8):
        sensed = sensors.sense(truth, spec, 2, run)
        solution = Unscented().run(sensed.data, sensed.initial)
        errors = error_series(truth, solution)
        late = errors.t > 30.0
        beyond += np.mean(errors.heading[late] ** 2 / solution.cov[-late.sum() :, 8, 8]) > 3.29**2
    assert beyond < 2


@pytest.mark.parametrize(("spread", "least"), [(0.2, True), (0.5, True), (0.9, False)])
def test_no_covariance_of_the_points_turns_indefinite(sensed, spread, least):
    """No weight is negative: where the beta of a Gaussian, 2, would leave the center below 0, it has 0."""
    model = state_model(sensed.initial, sensed.data.specs, [BARO_BIAS])
    flight = ukf.SigmaPointFlight(Unscented(spread=spread).options, model, sensed.initial, np.zeros((4, 3)))
    points = flight.points()
    assert (points.cov[1:] > 0.0).all()
    assert points.cov[0] == pytest.approx(0.0 if least else 2.0 + 2.0 - 0.9**-2 - 0.9**2, abs=1e-9)
    assert_allclose((points.x.T * points.cov) @ points.x, flight.P, rtol=1e-9, atol=1e-15)


def test_a_gauss_markov_state_forgets_between_measurements(sensed):
    """x' = -x / tau over ten seconds: the estimate decays, its variance goes to that of the process.

    Exact, because nothing acts on the bias of the barometer and sigma points carry a linear state exactly.
    The biases of the IMU, which are random walks here, stay.
    """
    tau, sd, T = 4.0, 3.0, 10.0
    model = state_model(sensed.initial, sensed.data.specs, [BARO_BIAS])
    at, n = model.index.baro_bias, model.layout.size
    decay_time, stationary = np.zeros((2, n))
    decay_time[at], stationary[at] = 1 / tau, sd**2
    process = model.process._replace(decay_time=decay_time, stationary=stationary)
    model = replace(model, process=process)
    flight = ukf.SigmaPointFlight(Unscented().options, model, sensed.initial, np.zeros((4, 3)))
    flight.P[at, :] = flight.P[:, at] = 0.0
    flight.P[at, at] = 25.0
    flight.estimate[10:] = np.arange(1.0, len(flight.estimate) - 9) * 1e-4
    flight.estimate[at + 1] = 7.0
    before = flight.estimate[10:].copy()
    n = 1000
    quiet = np.zeros((n, 3)), np.tile([0.0, 0.0, -9.81 * T / n], (n, 1))
    flight.predict(np.full(n, T / n), *quiet, np.zeros(2))
    gone = np.exp(-T / tau)
    assert flight.estimate[at + 1] == pytest.approx(7.0 * gone, rel=1e-9)
    assert flight.P[at, at] == pytest.approx(25.0 * gone**2 + sd**2 * (1 - gone**2), rel=1e-9)
    assert_allclose(np.delete(flight.estimate[10:], at - 9), np.delete(before, at - 9), rtol=1e-9)


@pytest.mark.parametrize(("sigmas", "part"), [(2.9, 0.0), (10.0, 0.91)])
def test_an_attitude_error_turns_no_noise(sensed, sigmas, part):
    """Level; a force beyond that of a steady flight by some sigma of the noise: the part that is motion."""
    model = state_model(sensed.initial, sensed.data.specs, [])
    flight = ukf.SigmaPointFlight(Unscented().options, model, sensed.initial, np.zeros((4, 3)))
    n, T, psi = 20, 0.05, 1e-3
    lat, _, alt = sensed.initial.lla
    flight.estimate[3:10] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
    flight.P[:] = 0.0
    flight.P[6:9, 6:9] = psi**2 * np.eye(3)
    more = sigmas * np.sqrt(model.process.q[3] / T) * np.array([0.6, -0.8, 0.0])
    rate = earth.EARTH_RATE * np.array([np.cos(lat), 0.0, -np.sin(lat)])
    steps = np.tile(rate * T / n, (n, 1)), np.tile((more - earth.gravity_n(lat, alt)) * T / n, (n, 1))
    flight.predict(np.full(n, T / n), *steps, np.zeros(2))
    turned = flight.P[3:6, 6:9] / (psi**2 * T)
    wanted, atol = part * np.array([-more[1], more[0]]), 0.01 * np.abs(more).max()
    assert_allclose(turned[:2, 2], wanted, atol=atol)
    assert_allclose(turned[2, :2], -wanted, atol=atol)


def test_the_kernel_is_its_own_python(sensed):
    imu = sensed.data.imu
    initial = sensed.initial
    nav = np.concatenate([initial.lla, initial.vel_n, initial.q_nb])
    start = np.hstack([np.tile(nav, (3, 1)), 1e-3 * np.arange(18.0).reshape(3, 6)])
    results = []
    for kernel in (ukf.carry_kernel, ukf.carry_kernel.py_func):
        points, before, work = start.copy(), np.zeros((3, 7)), np.empty((5, 3))
        kernel(points, before, imu.dt[:20], imu.dtheta_b[:20], imu.dvel_b[:20], work, np.empty((3, 3)))
        results.append(np.hstack([points, before]))
    assert_allclose(results[0], results[1], rtol=1e-12, atol=1e-13)
    assert not np.array_equal(results[0][0], results[0][1])


def test_states_without_variance_do_not_move(sensed):
    """A barometer without bias: nothing to draw; the filter runs and the state stays zero."""
    specs = sensed.data.specs
    data = replace(sensed.data, specs=replace(specs, baro=replace(specs.baro, bias_sd=0.0, bias_walk=0.0)))
    solution = Unscented().run(data, sensed.initial)
    assert not solution.extra[:, -1].any()
    assert not solution.extra_sd[:, -1].any()
    assert np.isfinite(solution.cov).all()


def test_a_filter_of_nan_is_a_result(sensed):
    specs = sensed.data.specs
    broken = replace(specs, imu=replace(specs.imu, gyro=replace(specs.imu.gyro, random_walk=np.nan)))
    solution = Unscented().run(replace(sensed.data, specs=broken), sensed.initial)
    assert np.isnan(solution.lla[-1]).all()


def test_the_root_is_one_of_a_singular_matrix_and_no_other():
    a = np.array([[4.0, 2e-3], [2e-3, 1e-6]])
    assert_allclose(ukf.root(a).T @ ukf.root(a), a, rtol=1e-12)
    with pytest.raises(np.linalg.LinAlgError, match="eigenvalue"):
        ukf.root(a * [[1.0, 1.1], [1.1, 1.0]])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"gnss": 1}, "gnss = 1 must be true or false"),
        ({"covariance_hz": 0.0}, "covariance_hz = 0 Hz must be positive"),
        ({"covariance_hz": None}, "covariance_hz = None must be a number"),
        ({"gate_probability": 1.0}, "gate_probability = 1 must be between 0 and 1"),
        ({"readmit_after_s": "1"}, "readmit_after_s = '1' must be a number"),
        ({"spread": 1.5}, "spread = 1.5 must be above 0 and not above 1"),
        ({"gnss_markov": True}, "unknown option 'gnss_markov'\n  known options: airspeed, baro"),
    ],
)
def test_a_wrong_option_says_why(options, message):
    with pytest.raises(EstimatorError) as caught:
        load("ukf", options)
    assert message in str(caught.value)


def test_every_option_moves_the_answer(sensed):
    wild = sensed.data.fixes.lla.copy()
    wild[10:14, 0] += 300.0 / 6.4e6
    data = replace(sensed.data, fixes=replace(sensed.data.fixes, lla=wild))
    plain = Unscented().run(data, sensed.initial)
    assert (np.linalg.eigvalsh(Unscented(spread=0.3).run(data, sensed.initial).cov) > 0.0).all()
    for options in (
        {"gnss": False}, {"baro": False}, {"covariance_hz": 20.0}, {"gate_probability": 0.3},
        {"readmit_after_s": 2.0}, {"spread": 0.3},
    ):  # fmt: skip
        assert not np.array_equal(Unscented(**options).run(data, sensed.initial).lla, plain.lla), options


def test_a_gap_of_the_imu_is_bridged_as_by_the_compiled_filter(sensed):
    """A second is missing: the last rates known carry both alike, and P grows alike, answers or not.

    Tilts of 4 deg make the difference between sigma points and a linear step: second order, 0.07^2.
    """
    imu = sensed.data.imu
    there = (imu.t < 10.0 + 1e-6) | (imu.t > 11.0 - 1e-6)
    columns = {f.name: getattr(imu, f.name)[there] for f in fields(imu)}
    linear = Loose(covariance_hz=10.0)
    for wanted in (np.array([9.9, 10.95]), np.round(np.arange(9.9, 10.96, 0.05), 2)):
        data = replace(sensed.data, imu=replace(imu, **columns), output_t=wanted)
        mine, theirs = (e.run(data, sensed.initial) for e in (Unscented(), linear))
        sd, other_sd = (np.sqrt(np.einsum("kii->ki", s.cov)) for s in (mine, theirs))
        assert (sd[-1, 3:6] > 10 * sd[0, 3:6]).all()
        assert_allclose(sd, other_sd, rtol=0.01)
        apart = np.hstack([earth.difference_n(mine.lla, theirs.lla), mine.vel_n - theirs.vel_n])
        assert (np.abs(apart[-1]) < 0.01 * sd[-1, :6]).all()
