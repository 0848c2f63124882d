"""The attitude filter: closed forms at rest, covariances against many runs, turns and magnets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench.core.mathematics import earth, rotation
from bench.core.records.instruments import MagSpec
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.models import ahrs
from bench.simulation import sensors
from tests.builders import at_rest, band, put, steered
from tests.weaving import DEG, IMU, units

LLA = np.array([47 * DEG, 11 * DEG, 500.0])
POLE = np.array([89.99 * DEG, 0.0, 0.0])
"""Here the rate of the Earth is no compass."""
WHITE = ImuSpec("white", TriadSpec(random_walk=0.3 * DEG / 60), TriadSpec(random_walk=0.06 / 60))
SCALED = replace(
    IMU,
    gyro=replace(IMU.gyro, scale_factor_sd=5e-3, misalignment_sd=3e-3),
    accel=replace(IMU.accel, random_walk=0.02),
)
"""Of phone grade: finer accelerometers measure angles by which the first errors are not linear."""
COMPASS = MagSpec("compass", 10.0, white_sd=2e-7, hard_iron_sd=5e-7, soft_iron_sd=5e-3, scale_factor_sd=5e-3)


def on_board(imu=IMU, mag=None):
    spec = replace(units(imu, None, None), mag=mag)
    return replace(spec, assumed=replace(spec.assumed, mag=mag))


def tumbling(duration, rate=50.0):
    """A truth that turns about all axes in one place."""
    base = at_rest(duration, rate, LLA)
    t = base.t
    angles = 40 * DEG * np.sin(0.3 * t), 30 * DEG * np.sin(0.2 * t), 2.0 * np.sin(0.1 * t)
    q = rotation.continuous(rotation.from_euler(*angles))
    turn = rotation.to_rotvec(rotation.multiply(rotation.conjugate(q[:-1]), q[1:]))
    back = rotation.conjugate(rotation.multiply(q[:-1], rotation.from_rotvec(0.5 * turn)))
    w_n = earth.EARTH_RATE * np.array([np.cos(LLA[0]), 0.0, -np.sin(LLA[0])])
    one = np.ones((len(turn), 1)) / rate
    dtheta = turn + rotation.rotate(back, one * w_n)
    dvel = rotation.rotate(back, -one * earth.gravity_n(LLA[0], LLA[2]))
    return replace(base, q_nb=q, dtheta_b=dtheta, dvel_b=dvel)


def solve(truth, spec, run=0, change=lambda data: data, **options):
    sensed = sensors.sense(truth, spec, 7, run)
    solution = load("ahrs", options).run(change(sensed.data), sensed.initial)
    return error_series(truth, solution), solution


# --- a heading that nobody knows ------------------------------------------------------------------------


@pytest.mark.parametrize("make", [tumbling, lambda duration: at_rest(duration, 50.0, LLA, 0.05, 0.1, 0.3)])
def test_an_unknown_heading_moves_with_the_gyros_alone(make):
    """A linear error of 1.8 rad tells nothing; with it, gravity and Earth rate pull by 30 deg and more."""
    truth, gyro = make(180.0), IMU.gyro
    drift = np.hypot(gyro.turn_on_bias_sd * 180.0, gyro.random_walk * np.sqrt(180.0))
    for run in range(2):
        sensed = sensors.sense(truth, on_board(), 7, run)
        cov = sensed.initial.cov.copy()
        cov[8], cov[:, 8] = 0.0, 0.0
        cov[8, 8] = np.pi**2 / 3.0
        moved = []
        for off in (0.0, 1.7, 3.0):
            q_nb = rotation.multiply(rotation.from_euler(0.0, 0.0, off), sensed.initial.q_nb)
            solution = load("ahrs", {}).run(sensed.data, replace(sensed.initial, q_nb=q_nb, cov=cov))
            error = error_series(truth, solution).phi_n
            moved.append(np.angle(np.exp(1j * (error[-1, 2] - error[0, 2]))))
            assert np.sqrt(solution.cov[-1, 8, 8]) == pytest.approx(np.pi / np.sqrt(3.0), rel=0.02)
            assert np.hypot(*error[-50:, :2].T).max() < 1.0 * DEG
        assert np.abs(moved).max() < 4.0 * drift
        assert np.ptp(moved) < 0.1 * DEG


def test_a_specific_force_that_is_too_short_does_not_hide_gravity():
    """0.7 % of scale are 0.07 m/s^2 along the vertical, no 1.2 m/s^2 across it: the tilt is found at rest."""
    truth = at_rest(120.0, 50.0, LLA, 0.05, 0.1, 0.3)

    def shorten(data):
        return replace(data, imu=replace(data.imu, dvel_b=0.993 * data.imu.dvel_b))

    errors, _ = solve(truth, on_board(WHITE), change=shorten)
    late = errors.t > 60.0
    assert np.hypot(*errors.phi_n[late, :2].T).max() < 0.3 * DEG


# --- at rest: closed forms ------------------------------------------------------------------------------


def test_the_tilt_at_rest_has_the_variance_of_the_riccati_equation():
    """White noise alone: p^2 + q T p = q T r with r = (N / g)^2 / T, after an update."""
    _, solution = solve(
        at_rest(200.0, 50.0, POLE), on_board(WHITE), acceleration_sd=0.0, gravity_period_s=0.5
    )
    T, g = 0.5, earth.gravity_n(POLE[0], POLE[2])[2]
    q, r = WHITE.gyro.random_walk**2 * T, (WHITE.accel.random_walk / g) ** 2 / T
    p = 0.5 * (np.sqrt(q * q + 4 * q * r) - q)
    last = solution.cov[-1, 6:, 6:]
    assert solution.t[-1] % T == pytest.approx(0.0, abs=1e-9)
    assert_allclose(np.diag(last)[:2], p, rtol=1e-3)
    start, q_t = (2.0 * DEG) ** 2, WHITE.gyro.random_walk**2 * 200.0
    assert_allclose(last[2, 2], start + q_t, rtol=1e-3)  # nothing tells the heading
    assert np.isnan(solution.lla).all()
    assert np.isnan(solution.vel_n).all()
    assert np.isnan(solution.cov[:, :6]).all()


def test_a_bias_of_the_accelerometers_stays_in_the_tilt():
    """Level and at rest, the variance of the tilt is that of the horizontal bias over g, at best."""
    _, solution = solve(at_rest(100.0, 50.0, POLE), on_board(SCALED), acceleration_sd=0.0)
    bias = IMU.accel.turn_on_bias_sd**2 + IMU.accel.instability_sd**2
    prior = (0.5 * DEG) ** 2
    best = 1.0 / (1.0 / prior + 9.81**2 / bias)
    found = np.diag(solution.cov[-1])[6:8]
    assert (best < found).all()
    assert (found < 1.1 * best).all()  # the rest is noise


# --- many runs --------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def runs():
    truth = tumbling(60.0)
    return [solve(truth, on_board(SCALED, COMPASS), run, acceleration_sd=0.0) for run in range(16)]


def test_nees_of_three_states_is_in_its_band(runs):
    """At four times, each over 16 independent runs; 99.9 % band. A covariance of a third is outside."""
    low, high = band(len(runs), 3)
    for t in (5.0, 20.0, 40.0, 60.0):
        nees = np.array([np.interp(t, errors.t, errors.nees) for errors, _ in runs])
        assert low < nees.mean() < high, (t, nees.mean())
        assert 3.0 * nees.mean() > high
    assert all(errors.states == 3 for errors, _ in runs)


def test_nis_of_gravity_and_field_is_in_its_band(runs):
    for name in ("gravity", "magnetometer"):
        found = []
        for _, solution in runs:
            table = solution.innovations
            own = (table.code == table.sensor.index(name)) & (table.component == 0)
            assert table.accepted[own].mean() > 0.99
            found.append(table.nis[own])
        low, high = band(sum(map(len, found)), 3)
        assert low < np.concatenate(found).mean() < high, name


def test_the_biases_of_the_gyros_are_found(runs):
    """The sigma of each falls below a half, and the errors have it: 99.9 % band over runs and axes."""
    ratios = []
    for run, (_, solution) in enumerate(runs):
        drawn = sensors.sense(tumbling(60.0), on_board(SCALED, COMPASS), 7, run).truth if run < 8 else None
        assert (solution.extra_sd[-1, :3] < 0.5 * solution.extra_sd[0, :3]).all()
        if drawn is not None:
            ratios.append((solution.gyro_bias_b[-1] - drawn.gyro_bias_b[-1]) / solution.extra_sd[-1, :3])
    low, high = band(np.size(ratios))
    assert low < np.mean(np.square(ratios)) < high


# --- accelerations and magnets ------------------------------------------------------------------------------


def coordinated():
    """Level wings of a car: 10 s straight, a minute of a steady turn with 5 m/s^2, 30 s straight."""
    turning = lambda t: np.where((t > 10.0) & (t < 70.0), 0.25, 0.0)  # noqa: E731
    return steered(100.0, 50.0, LLA, 0.3, 20.0, turn=turning)


def test_a_sustained_turn_widens_sigma_and_hardly_moves_the_tilt(monkeypatch):
    """The apparent vertical is off by 27 deg for a minute. Without the length of f the tilt follows it."""
    truth = coordinated()
    errors, solution = solve(truth, on_board())
    tilt = np.hypot(*errors.phi_n[:, :2].T) / DEG
    sd = np.sqrt(solution.cov[:, 6, 6]) / DEG
    assert tilt.max() < 1.0
    before, after = np.searchsorted(errors.t, [10.0, 70.0])
    assert sd[after] > sd[before]
    assert sd[-1] < sd[after]  # and straight on it narrows again
    monkeypatch.setattr(ahrs, "_SHOWN", np.inf)
    errors, _ = solve(truth, on_board())
    assert np.hypot(*errors.phi_n[:, :2].T).max() > 2.0 * DEG


def test_at_rest_no_acceleration_is_seen():
    """Null case: R of gravity is that of the noise alone, so S has no outliers."""
    _, solution = solve(at_rest(100.0, 50.0, LLA), on_board(), acceleration_sd=0.0)
    table = solution.innovations
    late = (table.t > 5.0) & (table.component == 0)
    assert table.S[late].max() < 1.5 * table.S[late].min()


@pytest.mark.parametrize("field_t", [20e-6, 60e-6])
def test_a_magnet_is_rejected(field_t):
    """A field for eight seconds: all samples in it are rejected, none outside, and the heading holds."""
    during = (20.0, 28.0)

    def disturb(data):
        mag = data.mag
        rows = (mag.t > during[0]) & (mag.t < during[1])
        return replace(data, mag=put(mag, rows, field_b=mag.field_b[rows] + [0.0, field_t, 0.0]))

    truth = tumbling(60.0)
    errors, solution = solve(truth, on_board(SCALED, COMPASS), change=disturb)
    table = solution.innovations
    own = (table.code == table.sensor.index("magnetometer")) & (table.component == 0)
    inside = (table.t > during[0]) & (table.t < during[1])
    assert not table.accepted[own & inside].any()
    assert table.accepted[own & ~inside].all()
    clean, _ = solve(truth, on_board(SCALED, COMPASS))
    assert np.abs(errors.heading - clean.heading).max() < 0.5 * DEG
    loose, _ = solve(truth, on_board(SCALED, COMPASS), change=disturb, readmit_after_s=0.0)
    assert np.abs(loose.heading - clean.heading).max() > 2 * np.abs(errors.heading - clean.heading).max()


def test_an_unknown_heading_is_found_by_the_magnetometer():
    """120 deg off with a sigma of 90: within five of its own sigmas after the first samples."""
    truth = tumbling(20.0)
    sensed = sensors.sense(truth, on_board(IMU, COMPASS), 7, 0)
    q = rotation.multiply(rotation.from_rotvec([0.0, 0.0, 120 * DEG]), sensed.initial.q_nb)
    cov = sensed.initial.cov.copy()
    cov[8, 8] = (90 * DEG) ** 2
    solution = load("ahrs", {}).run(sensed.data, replace(sensed.initial, q_nb=q, cov=cov))
    errors = error_series(truth, solution)
    late = errors.t > 1.0
    assert (np.abs(errors.heading[late]) < 5.0 * np.sqrt(solution.cov[late, 8, 8])).all()
    assert np.abs(errors.heading[late]).max() < 5.0 * DEG


# --- contract -----------------------------------------------------------------------------------------------


def test_it_keeps_the_contract_with_a_magnetometer():
    sensed = sensors.sense(tumbling(10.0), on_board(SCALED, COMPASS), 7, 0)
    bench.check_estimator(load("ahrs", {}), sensed.data, sensed.initial)


def test_what_it_leaves_out_is_named():
    shaky = replace(SCALED, gyro=replace(SCALED.gyro, g_sensitivity_sd=1e-5))
    told = load("ahrs", {}).unmodeled_errors(on_board(shaky, COMPASS).assumed)
    assert told[0].startswith("sustained acceleration")
    assert any("g-sensitivity" in one for one in told)
    assert not any("calibration" in one or "scale factor" in one for one in told)


def test_the_rate_of_the_earth_does_not_turn_the_attitude():
    """An hour at rest with gyros that measure it alone: 15 deg of rotation, and none is left."""
    w_n = earth.EARTH_RATE * np.array([np.cos(0.8), 0.0, -np.sin(0.8)])
    begun = rotation.matrix(rotation.from_euler(0.3, -0.2, 1.1))
    C_nb, dt = begun.copy(), 1.0
    memory = np.zeros((3, 12)), np.zeros((3, 16)), np.zeros(3), np.zeros((9, 3))
    for _ in range(3600):
        ahrs.turn_kernel(C_nb, np.zeros(15), w_n, dt, begun.T @ w_n * dt, np.zeros(3), *memory)
    assert_allclose(C_nb, begun, atol=1e-10)
