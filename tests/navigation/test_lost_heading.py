"""A heading lost in a hover, second-order terms of a heading error, and leveling by the velocity gained."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from bench.core.mathematics import earth, rotation
from bench.core.records.sensor_specs import TriadSpec
from bench.evaluation.errors.error_series import error_series
from bench.navigation.built_in import load
from bench.navigation.error_state_filter import rough_heading
from bench.navigation.error_state_filter.rough_heading import (
    UNKNOWN_HEADING_SD,
    second_order_tilt_kernel,
    second_order_velocity_kernel,
)
from bench.navigation.error_state_filter.standstill import count_steady
from bench.navigation.start import alignment, turn_on
from bench.navigation.start.course import find_calm
from bench.navigation.start.headings import turn_heading
from bench.simulation import sensors
from tests.builders import band
from tests.hovering import hovering
from tests.motions import trials
from tests.motions.held import after, lean
from tests.motions.truths import RATE, Motion, clock, make_truth
from tests.weaving import units

DEG = np.pi / 180
GYRO = TriadSpec(random_walk=0.01 * DEG, bias_instability=0.0, bias_correlation=300.0, turn_on_bias_sd=DEG)


# --- rest ---------------------------------------------------------------------------------------------


def rates(random, count, turning_from=None, rate=0.0):
    """Mean rates of one-second windows of a unit with a bias; it turns from one window on."""
    found = 0.5 * DEG + GYRO.random_walk * random.standard_normal((count, 3))
    if turning_from is not None:
        found[turning_from:, 2] += rate
    return found


@pytest.mark.parametrize("usual", [None, np.full(3, 0.5 * DEG)])
def test_what_stands_is_seen_to_stand(usual):
    """1000 rests of 20 s: 5 sigma of 60,000 sums give a false alarm in 3 % of such tests."""
    random = np.random.default_rng(1)
    assert all(count_steady(rates(random, 20), usual, GYRO) == 20 for _ in range(1000))


@pytest.mark.parametrize("rate_deg_s", [0.1, 0.5, 5.0])
@pytest.mark.parametrize("usual", [None, np.full(3, 0.5 * DEG)])
def test_a_turn_is_seen_within_a_degree_and_a_window(usual, rate_deg_s):
    random = np.random.default_rng(2)
    for _ in range(50):
        count = count_steady(rates(random, 40, 12, rate_deg_s * DEG), usual, GYRO)
        assert 12 <= count < 40
        assert rate_deg_s * (count - 12) <= 1.0 + rate_deg_s


def test_no_window_is_steady_of_none():
    assert count_steady(np.empty((0, 3)), None, GYRO) == 0
    assert count_steady(np.empty((0, 3)), np.zeros(3), GYRO) == 0
    assert count_steady(np.zeros((1, 3)), None, GYRO) == 1


def test_gyros_that_stood_keep_their_bias_when_the_vehicle_drives_off():
    """At rest for 12 s of the first 20: the bias measured there is kept, and true within its sigma."""
    t = clock(25.0)
    speed = 3.0 * after(t, 12.0, 3.0)
    truth = make_truth(np.column_stack([speed, 0 * t, 0 * t]), np.zeros((len(t), 3)))
    spec = trials.choose_start(trials.load_sensors("mpu-6050", "l1-code"), Motion(speed, speed), "given")
    drawn = sensors.sense(truth, spec, 4, 0)
    found = turn_on.find_turn_on(drawn.data, drawn.initial)
    assert found is not None
    assert 5.0 < found.until < 13.0
    rows = (drawn.data.imu.t > 2.0) & (drawn.data.imu.t < 11.0)
    mean = drawn.data.imu.dtheta_b[rows].sum(axis=0) / drawn.data.imu.dt[rows].sum()
    np.testing.assert_allclose(found.bias_b, mean, atol=5.0 * found.sd)
    assert found.sd < 0.03 * DEG


@pytest.mark.parametrize("unit", ["bmi088", "icm-20948"])
def test_at_rest_a_consumer_unit_keeps_its_heading(unit):
    """Twelve rests of a minute: none is taken for a turn, which would let the heading go."""
    n = 60 * round(RATE)
    truth = make_truth(np.zeros((n + 1, 3)), np.tile([0.02, 0.03, 1.0], (n + 1, 1)))
    motion = Motion(np.zeros((2, 3)), np.zeros((2, 3)))
    spec = trials.choose_start(trials.load_sensors(unit, "l1-code"), motion, "given")
    for run in range(12):
        drawn = sensors.sense(truth, spec, 3, run)
        solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        assert solution.cov[-1, 8, 8] < 1.02 * drawn.initial.cov[8, 8]


# --- second order -------------------------------------------------------------------------------------


def test_a_gained_velocity_is_short_by_the_second_order_of_the_heading():
    """Monte Carlo: the along-track error of a velocity gained with a normal heading error."""
    sd, speed, course = 8.0 * DEG, 30.0, 0.7
    P = np.zeros((9, 9))
    P[8, 8] = sd**2
    along = np.array([np.cos(course), np.sin(course), 0.0])
    for _ in range(50):
        second_order_velocity_kernel(30.0 * along, 1.0 / 50.0, P)
        gained = speed * (_ + 1) / 50.0
        P[3, 8] = P[8, 3] = -gained * along[1] * P[8, 8]  # as F does
        P[4, 8] = P[8, 4] = gained * along[0] * P[8, 8]
    u = along[:2]
    error = speed * (np.cos(sd * np.random.default_rng(3).standard_normal(400_000)) - 1.0)
    assert u @ P[3:5, 3:5] @ u == pytest.approx(np.mean(error**2), rel=0.04)
    across = np.array([-u[1], u[0]])
    assert across @ P[3:5, 3:5] @ across == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("sd_deg", [1.0, 40.0])
def test_a_heading_that_is_known_or_lost_has_no_second_order(sd_deg):
    P = np.zeros((9, 9))
    P[8, 8] = (sd_deg * DEG) ** 2
    second_order_velocity_kernel(np.array([5.0, 0.0, 0.0]), 1.0, P)
    assert not P[3:5, 3:5].any()
    if sd_deg > 30.0:
        P[6, 6] = 1.0
        second_order_tilt_kernel(0.1, P)
        assert P[7, 7] == 0.0


def test_what_brakes_gains_no_second_order():
    P = np.zeros((9, 9))
    P[8, 8] = (8.0 * DEG) ** 2
    P[4, 8] = P[8, 4] = 30.0 * P[8, 8]
    second_order_velocity_kernel(np.array([-5.0, 0.0, 0.0]), 1.0, P)
    assert not P[3:5, 3:5].any()


def test_a_drift_of_the_heading_turns_the_tilts():
    """Monte Carlo: the covariance of tilts changed by a small normal rotation."""
    random = np.random.default_rng(5)
    P = np.zeros((9, 9))
    P[6:8, 6:8] = [[4e-4, 1.5e-4], [1.5e-4, 1e-4]]
    P[8, 8] = (10.0 * DEG) ** 2
    tilts = random.multivariate_normal([0.0, 0.0], P[6:8, 6:8], 400_000)
    turn = 5.0 * DEG * random.standard_normal(400_000)
    moved = np.column_stack([-turn * tilts[:, 1], turn * tilts[:, 0]])
    before = P[6:8, 6:8].copy()
    second_order_tilt_kernel((5.0 * DEG) ** 2, P)
    np.testing.assert_allclose(P[6:8, 6:8] - before, np.cov(moved.T), rtol=0.03, atol=2e-8)
    second_order_tilt_kernel(-1.0, P)
    np.testing.assert_allclose(P[6, 7], P[7, 6])


# --- starts in motion ---------------------------------------------------------------------------------


def banked(seconds=12.0):
    """A multirotor that accelerates east with 2 m/s^2, its nose to the south-west."""
    t = clock(seconds)
    vel_n = np.column_stack([0.3 * np.sin(t), 2.0 * t, 0.0 * t])
    return make_truth(vel_n, lean(vel_n, np.full(len(t), -2.2)))


def start_in_motion(run, truth=None, receiver="zed-f9p", antenna_b=None, with_velocity=True):
    truth = truth or banked()
    spec = trials.load_sensors("adis16495", receiver)
    spec = replace(units(spec.imu, spec.gnss, spec.baro), output_rate=1.0)
    drawn = sensors.sense(truth, replace(spec, antenna_b=antenna_b or spec.antenna_b), 8, run)
    if not with_velocity:
        fixes = replace(drawn.data.fixes, vel_n=np.full_like(drawn.data.fixes.vel_n, np.nan))
        drawn = replace(drawn, data=replace(drawn.data, fixes=fixes))
    asked = replace(
        drawn.initial,
        alignment="motion",
        align_for=2.0,
        drift_sd=UNKNOWN_HEADING_SD,
        cov=np.diag(np.full(9, np.inf)),
    )
    found, ((_, _, kind, text),) = alignment.complete(drawn.data, asked)
    assert kind == "alignment"
    assert text.endswith("heading is unknown")
    return truth, found


def tilt_error(truth, found, heading):
    """Tilt (2,) of a start turned to a heading, and its covariance."""
    turned = turn_heading(found, float(heading - rotation.to_heading(found.q_nb)))
    q = truth.q_nb[round(found.t * RATE)]
    return rotation.to_rotvec(rotation.multiply(turned.q_nb, rotation.conjugate(q)))[:2], turned.cov[6:8, 6:8]


def test_a_start_in_motion_is_level_at_the_heading_that_is_true():
    squares = []
    for run in range(40):
        truth, found = start_in_motion(run)
        true = float(rotation.to_heading(truth.q_nb[round(found.t * RATE)]))
        error, cov = tilt_error(truth, found, true)
        squares.append(error @ np.linalg.solve(cov, error))
        wrong, _ = tilt_error(truth, found, true + np.pi)
        assert np.linalg.norm(wrong) > 20.0 * DEG  # the push leans it 12 deg to one side, not to the other
        assert np.linalg.norm(error) < 2.0 * DEG
    assert np.mean(squares) < 2.0 * band(2 * len(squares))[1]


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("heading", [0.0, 1.5, 3.0])
def test_a_start_in_motion_does_not_know_where_its_antenna_is_about_it(heading, with_velocity):
    """A unit that rocks by 3 deg, fixes of a centimeter: a run is a draw of 4 degrees of freedom."""
    t = clock(14.0)
    vel_n = np.column_stack([0.1 * t, 0.2 * t, 0.0 * t])
    euler = np.column_stack([3 * DEG * np.sin(2 * t), 3 * DEG * np.cos(3 * t), np.full(len(t), heading)])
    truth = make_truth(vel_n, euler)
    for run in range(3):
        _, found = start_in_motion(run, truth, "rtk-fixed", (1.0, 0.5, -1.0), with_velocity)
        k = round(found.t * RATE)
        error = np.append(earth.difference_n(found.lla, truth.lla[k])[:2], (found.vel_n - truth.vel_n[k])[:2])
        chosen = [0, 1, 3, 4]
        nees = error @ np.linalg.solve(found.cov[np.ix_(chosen, chosen)], error)
        assert nees < 4.0 * band(4)[1]


def test_a_start_in_motion_begins_with_what_is_calm_and_takes_ten_seconds_without_velocities():
    """9 m/s^2 for 4 s: from 2.67 s on, less than 6 m/s^2 in the mean of two seconds."""
    t = clock(14.0)
    vel_n = np.column_stack([9.0 * np.minimum(t, 4.0), 0.0 * t, 0.0 * t])
    _, found = start_in_motion(0, make_truth(vel_n, lean(vel_n, 0.0 * t)))
    assert 4.6 < found.t < 5.2
    _, found = start_in_motion(0, banked(14.0), with_velocity=False)
    assert 10.0 < found.t < 11.0


@pytest.mark.parametrize("fall", [False, True])
def test_a_start_in_motion_waits_for_a_calm_segment(fall):
    t = np.arange(0.0, 12.0, 0.2)
    vel_n = np.zeros((len(t), 3))
    vel_n[:, 2 if fall else 0] = 9.8 * np.minimum(t, 5.0)
    first = find_calm(t, vel_n, 2.0, np.empty(0))
    assert 3.6 <= t[first] <= 4.2  # 6 m/s^2 of the 9.8 over two seconds
    assert find_calm(t, vel_n, 2.0, np.array([t[first] + 1.0])) > first  # no gap lies in it
    vel_n[:, 0] += 7.0 * t
    assert find_calm(t, vel_n, 2.0, np.empty(0)) == len(t)


def test_a_heading_lost_in_a_hover_is_found_again_in_motion():
    """A consumer gyro loses it within seconds; with a gyro that keeps it, there is no reset."""
    truth = hovering(90.0, RATE, still_s=36.0, turn_deg_s=1.0)
    for unit in ("mpu-6050", "adis16495"):
        spec = trials.choose_start(
            trials.load_sensors(unit, "l1-code"), Motion(truth.vel_n, truth.vel_n), "given"
        )
        drawn = sensors.sense(truth, spec, 9, 2)
        solution = load("loose-full", {}).run(drawn.data, drawn.initial)
        errors = error_series(truth, solution)
        resets = [row for row in solution.events.rows() if row[2] == "reset"]
        if unit == "adis16495":
            assert not resets
            continue
        assert any("GNSS shows motion while the heading is unknown" in row[3] for row in resets)
        hover = (errors.t > 20.0) & (errors.t < 35.0)
        assert (np.sqrt(solution.cov[hover, 8, 8]) > rough_heading.WIDE).all()
        late = errors.t > 75.0
        sd = np.sqrt(solution.cov[late, 8, 8])
        assert (sd < 15.0 * DEG).all()
        assert (np.abs(errors.heading[late]) < 4.0 * sd).all()
        assert errors.nees[late].mean() < 9.0 * band(9)[1]
