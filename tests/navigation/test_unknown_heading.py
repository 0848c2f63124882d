"""A start with an unknown heading: consistent at rest, and once motion has shown the heading."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench import pipeline
from bench.core.mathematics import rotation
from bench.core.records.data import InitialState
from bench.core.records.instruments import MagSpec
from bench.evaluation.errors.error_series import error_series
from bench.io.config import read_profile
from bench.navigation.built_in import load
from bench.navigation.mechanization import propagate
from bench.navigation.models.loose_tight import Loose
from bench.navigation.start import headings
from bench.simulation import sensors
from tests.builders import band, first_rows, steered, student
from tests.navigation.test_tight import MATCHED
from tests.weaving import DEG, GNSS, units, weaving

REST, AWAY = 60.0, 60.0
DRAWS = 20
"""Headings around the circle, one run of the sensors each."""


def take_off(heading, rest=REST, away=AWAY):
    """Stand, roll for 15 s to 30 m/s, climb, weave."""
    return steered(
        rest + away, 25.0, (47 * DEG, 0.3, 250.0), heading,
        push=lambda t: 2.0 * ((t > rest) & (t < rest + 15)),
        turn=lambda t: 3 * DEG * np.sin(2 * np.pi * (t - rest - 20) / 40) * (t > rest + 20),
        climb=lambda t: 3.0 * (1 - np.exp(-(t - rest - 20) / 5)) * (t > rest + 20),
    )  # fmt: skip


def squares(estimator, spec, draws=DRAWS, options=None, **motion):
    """Epochs (M,), and the NEES (runs, M, 3) of tilt, heading and all nine states."""
    found = []
    for draw in range(draws):
        truth = take_off(2 * np.pi * draw / draws + 0.1, **motion)
        sensed = sensors.sense(truth, spec, 7, draw)
        solution = load(estimator, options or {}).run(sensed.data, sensed.initial)
        errors = error_series(truth, solution)
        tilt, cov = errors.phi_n[:, :2], solution.cov[:, 6:8, 6:8]
        found.append(
            np.column_stack(
                [
                    np.einsum("ki,kij,kj->k", tilt, np.linalg.inv(cov), tilt),
                    errors.phi_n[:, 2] ** 2 / solution.cov[:, 8, 8],
                    errors.nees,
                ]
            )
        )
    return solution.t, np.array(found)


def spec_of(start, gnss=GNSS):
    spec = replace(units(gnss=gnss), output_rate=1.0)
    if start == "level":
        return replace(spec, alignment="level", align_for=30.0)
    return replace(spec, initial_heading_sd=180 * DEG)


def assert_honest(t, found, at_rest=(35.0, 45.0, 55.0, 59.0), later=(65.0, 70.0, 80.0, 100.0, 119.0)):
    for instant in (*at_rest, *later):
        k = int(np.argmin(np.abs(t - instant)))
        for column, states in ((0, 2), (1, 1), (2, 9)):
            low, high = band(len(found), states)
            mean = np.mean(found[:, k, column])
            assert mean < high, (instant, states, mean)
            if instant not in at_rest or column == 0:  # an angle on a circle is no normal variable
                assert mean > low, (instant, states, mean)


@pytest.mark.parametrize(
    ("estimator", "start", "options"),
    [
        ("loose-15", "level", {}),
        ("loose-22", "given", {"standstill": True}),
        ("tight", "level", {}),
        pytest.param("loose-mems", "level", {}, marks=pytest.mark.long),
        pytest.param("loose-15", "given", {}, marks=pytest.mark.long),
    ],
)
def test_tilt_is_honest_at_rest_and_the_heading_is_after_the_first_motion(estimator, start, options):
    """20 runs, 99.9 % bands. One linear filter: tilt NEES of 16 while it stands, 900 once it moves."""
    gnss = MATCHED if estimator == "tight" else GNSS
    t, found = squares(estimator, spec_of(start, gnss), options=options)
    assert_honest(t, found)


def test_one_filter_with_a_wide_heading_is_not_honest(monkeypatch):
    """What the hypotheses are for: with them off the same runs are far out of the band."""
    monkeypatch.setattr(headings, "heading_is_unknown", lambda initial: False)
    t, found = squares("loose-15", spec_of("level"), draws=6)
    late = t > REST + 20
    assert found[:, late, 2].mean() > 9 * band(9 * 6)[1]


def test_at_rest_an_arm_tells_no_heading_and_a_compass_does(monkeypatch):
    """An antenna 6 m off the IMU: it may be anywhere on its circle."""
    monkeypatch.setattr(headings, "heading_is_unknown", lambda initial: False)
    compass = MagSpec("compass", 10.0, white_sd=2e-7)
    spec = replace(spec_of("given"), antenna_b=(5.0, -4.0, 1.0), mag=compass)
    spec = replace(spec, assumed=replace(spec.assumed, mag=compass))
    truth = steered(20.0, 25.0, (47 * DEG, 0.3, 250.0), 1.0)
    sensed = sensors.sense(truth, spec, 7, 0)
    cov = sensed.initial.cov.copy()
    cov[8, 8] = 0.4  # 36 deg, and 17 deg off
    initial = replace(sensed.initial, q_nb=rotation.from_euler(0.0, 0.0, 1.3), cov=cov)
    blind, seeing = (Loose(magnetometer=one).run(sensed.data, initial) for one in (False, True))
    assert_allclose(blind.cov[1:, 8, 8], np.pi**2 / 3.0)
    assert_allclose(blind.cov[1:, :8, 8], 0.0, atol=1e-6)
    yaw = error_series(truth, blind).phi_n[:, 2]
    assert np.abs(yaw - yaw[0]).max() < 0.01
    sd = np.sqrt(seeing.cov[-1, 8, 8])
    assert abs(error_series(truth, seeing).phi_n[-1, 2]) < 4.0 * sd < 0.1


@pytest.fixture(scope="module")
def straight_on():
    """The first 150 s of s-turns, matched sensors, a heading known to 30 deg: first it flies straight on."""
    changes = {"sensors.imu": "matched-mems", "sensors.gnss": "matched-white"}
    changes |= {"initial_error_sd.heading_deg": 30.0, "evaluation.output_hz": 1.0}
    profile = read_profile("s-turns", changes)
    return profile, first_rows(pipeline.fly(profile), 30_001)


def mean_nees(profile, truth, draws):
    """Mean NEES of each run from 30 s on."""
    found = []
    for draw in draws:
        sensed = pipeline.sense(profile, truth, draw)
        errors = error_series(truth, load("loose-15", {}).run(sensed.data, sensed.initial))
        found.append(errors.nees[errors.t > 30.0].mean())
    return np.array(found)


def test_a_start_in_flight_with_a_rough_heading_is_honest(straight_on):
    """The mean of 12 runs within its 99.9 % band."""
    found = mean_nees(*straight_on, range(12))
    assert abs(found.mean() - 9.0) < student(12) * found.std(ddof=1) / 12**0.5


def test_one_filter_from_a_rough_heading_is_not_honest(straight_on, monkeypatch):
    monkeypatch.setattr(headings, "LINEAR", np.inf)
    assert mean_nees(*straight_on, (2, 5, 8)).max() > 10 * 9


def test_an_outlier_while_the_heading_is_found_decides_nothing():
    """The fix one second into the take-off is 300 m off: rejected, and the heading is found all the same."""
    truth = take_off(2.2)
    sensed = sensors.sense(truth, spec_of("level"), 7, 0)
    fixes = sensed.data.fixes
    lla = fixes.lla.copy()
    lla[int(np.argmin(np.abs(fixes.t - REST - 1.0)))] += [300.0 / 6.4e6, 0.0, 0.0]
    solution = load("loose-15", {}).run(replace(sensed.data, fixes=replace(fixes, lla=lla)), sensed.initial)
    errors = error_series(truth, solution)
    assert abs(errors.phi_n[-1, 2]) < 4 * np.sqrt(solution.cov[-1, 8, 8])


def test_without_motion_the_heading_stays_unknown():
    """Free of aiding as well: the solution says so from start to end, and names the hypotheses."""
    truth = take_off(1.0, rest=90.0, away=0.0)
    sensed = sensors.sense(truth, spec_of("level"), 7, 0)
    for name in ("loose-15", "free-inertial"):
        solution = load(name, {}).run(sensed.data, sensed.initial)
        answered = np.isfinite(solution.lla[:, 0])
        assert (np.sqrt(solution.cov[answered, 8, 8]) > 40 * DEG).all()
        texts = [text for _, _, text in solution.events.select("alignment")]
        assert texts[-1].startswith("heading unknown: 16 hypotheses; no motion")


def test_a_turned_start_is_the_same_aircraft_on_another_heading():
    """Tilt errors belong to the instrument: their covariance with its biases is the same in b."""
    truth = take_off(0.4, away=0.0)
    sensed = sensors.sense(truth, spec_of("level"), 7, 0)
    from bench.navigation.start import alignment

    initial, _ = alignment.complete(sensed.data, sensed.initial)
    other = headings.turn_heading(initial, 1.3)
    roll, pitch, heading = rotation.to_euler(initial.q_nb)
    assert_allclose(rotation.to_euler(other.q_nb), (roll, pitch, np.mod(heading + 1.3, 2 * np.pi)), atol=1e-9)
    in_b = [rotation.matrix(start.q_nb)[:2].T @ start.bias_cov[6:8, 3:] for start in (initial, other)]
    assert np.abs(in_b[0]).max() > 0
    assert_allclose(in_b[1], in_b[0], rtol=1e-9, atol=1e-12 * np.abs(in_b[0]).max())


def test_the_jacobian_carries_an_error_over_a_large_rotation():
    rng = np.random.default_rng(3)
    d = rng.normal(size=(50, 3))
    d *= (rng.uniform(0.01, 3.1, 50) / np.linalg.norm(d, axis=1))[:, None]
    e = 1e-6 * rng.normal(size=(50, 3))
    both = rotation.multiply(rotation.from_rotvec(d), rotation.from_rotvec(e))
    J = headings.inverse_jacobian(d)
    assert_allclose(rotation.to_rotvec(both) - d, np.einsum("kij,kj->ki", J, e), rtol=1e-3, atol=1e-9)


@pytest.mark.parametrize("turn_deg", [5.0, -40.0, 80.0])
def test_another_heading_feels_the_same_force_over_ground(turn_deg):
    """In a turn the tilt follows from the heading: whatever that is, the force felt is that of the path.

    An aircraft in a bank of 25 deg; alignment on the move has matched its acceleration over ground.
    """
    f_n = np.array([2.7, -3.7, -9.8])
    q_nb = rotation.from_euler(0.44, 0.05, 2.1)
    f_b = rotation.rotate(rotation.conjugate(q_nb), f_n)
    m = np.array([f_n[0], f_n[1]]) / f_n[2]  # of tilt x f + heading e_D x f = 0, horizontally
    cov = np.diag(np.square([1.5, 1.5, 2.5, 0.05, 0.05, 0.05, 1e-3, 1e-3, 0.0]))
    by_heading = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, *m, 1.0])
    cov += np.deg2rad(18.0) ** 2 * np.outer(by_heading, by_heading)
    start = InitialState(0.0, np.array([0.8, 0.2, 500.0]), np.array([20.0, 15.0, 0.0]), q_nb, cov, "given")
    turned = headings.turn_heading(start, np.deg2rad(turn_deg))
    felt = rotation.rotate(turned.q_nb, f_b)
    # the tilt is a rotation vector of up to half a radian; its square is left out
    np.testing.assert_allclose(felt[:2], f_n[:2], atol=0.12 * np.hypot(*f_n[:2]))
    turn = rotation.multiply(turned.q_nb, rotation.conjugate(q_nb))
    assert abs(np.rad2deg(2 * np.arctan2(turn[3], turn[0])) - turn_deg) < 3.0
    small = np.diag(turned.cov)[6:8] - (headings.SD * m) ** 2
    np.testing.assert_allclose(small, 1e-6, rtol=1e-3)  # what the heading does not explain
    np.testing.assert_allclose(turned.cov[6:8, 8], headings.SD**2 * m, rtol=1e-9)


@pytest.mark.filterwarnings("error::RuntimeWarning")
@pytest.mark.parametrize("unit", ["bmi088", "mpu-9250"])
def test_a_hand_launch_beyond_the_range_of_its_accelerometer_says_why_and_goes_on(unit):
    """Of 16 headings some are lost in a push of 30 g; none of them takes the run with it."""
    imu = read_profile("figure-eight", {"sensors.imu": unit}).sensors.imu
    spec = replace(units(imu=imu), initial_heading_sd=np.pi, output_rate=1.0)
    duration, rate = 60.0, 100.0
    base = weaving(duration, rate=rate)
    middle = 0.5 * (base.t[1:] + base.t[:-1])
    f_b, w_b = np.tile([0.0, 0.0, -9.81], (len(middle), 1)), np.zeros((len(middle), 3))
    f_b[(middle > 10) & (middle < 10.085), 0] = 30 * 9.81
    w_b[middle > 12, 0] = 0.3 * np.cos(0.3 * middle[middle > 12])
    dvel_b, dtheta_b = f_b / rate, w_b / rate
    q_nb = rotation.from_euler(0.0, 0.0, 0.6)
    start = [47 * DEG, 0.2, 800.0]
    nav = propagate(start, np.zeros(3), q_nb, np.full(len(middle), 1 / rate), dtheta_b, dvel_b)
    truth = replace(
        base, lla=nav[:, :3], vel_n=nav[:, 3:6], q_nb=rotation.continuous(nav[:, 6:]),
        dtheta_b=dtheta_b, dvel_b=dvel_b,
    )  # fmt: skip
    for draw in range(3):
        sensed = sensors.sense(truth, spec, 3, draw)
        solution = load("loose-full", {}).run(sensed.data, sensed.initial)
        assert np.isfinite(solution.lla).all()
        assert any("beyond its range" in text for text in solution.events.text)
