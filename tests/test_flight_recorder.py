"""Recorded truth is one motion: its increments replay it, its columns agree, one plan gives one set of bits.

The replay is the proof of the flight: an error-free navigator with two-sample coning and sculling
corrections, fed with the increments, returns to the recorded position and attitude. `tests/inertial.py` says
what it shares.
"""

import hashlib
import pickle
import subprocess
import sys
from dataclasses import replace
from math import radians

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench import earth, rotation
from bench.data import Trajectory
from bench.flight import FlightError, fly, summarise
from bench.flight.increments import step_increments
from bench.flight.recorder import Recording, record, simulation_step, to_trajectory
from bench.navigation import mechanization
from bench.specs import Straight, Turn
from tests.inertial import inertial, largest_difference, navigate
from tests.plans import FIGURE_EIGHT, plan

MM, UM = 1e-3, 1e-6  # [m], and [rad] for microradians


def two_sample_error(truth: Trajectory) -> tuple[float, float]:
    reference = inertial(truth)
    start = tuple(column[0] for column in reference)
    found = navigate(truth.t[1], truth.dtheta_b, truth.dvel_b, start, two_sample=True)
    return largest_difference(found, reference)


def same_form_error(recording: Recording) -> tuple[float, float]:
    motion = recording.motion
    reference = (motion.pos_i, motion.vel_i, motion.q_ib)
    start = tuple(column[0] for column in reference)
    found = navigate(motion.dt, *step_increments(motion), start, two_sample=False)
    return largest_difference(found, reference)


def test_at_200_hz_ten_minutes_come_back_within_a_millimetre_and_a_microradian(figure_eight_truth):
    assert len(figure_eight_truth) == 120_001
    distance, angle = two_sample_error(figure_eight_truth)
    assert distance < 1 * MM
    assert angle < 1 * UM


def test_the_mechanization_of_the_bench_brings_them_back_too(figure_eight_truth):
    truth = figure_eight_truth
    start = truth.lla[0], truth.vel_n[0], truth.q_nb[0]
    found = mechanization.propagate(*start, np.diff(truth.t), truth.dtheta_b, truth.dvel_b)
    assert np.linalg.norm(earth.difference_n(found[:, :3], truth.lla), axis=1).max() < 1 * MM
    turned = rotation.multiply(rotation.conjugate(truth.q_nb), found[:, 6:])
    assert np.linalg.norm(rotation.to_rotvec(turned), axis=1).max() < 1 * UM


def test_at_100_hz_within_five_and_increments_of_the_wrong_form_do_not_pass():
    """Increments that are constant within a step, summed as if they were integrals, count coning twice."""
    recording = record(replace(FIGURE_EIGHT, rate=100.0))
    truth = to_trajectory(recording)
    distance, angle = two_sample_error(truth)
    assert distance < 5 * MM
    assert angle < 5 * UM
    th, be = (
        column[:-1].reshape(-1, recording.substeps, 3).sum(axis=1)
        for column in step_increments(recording.motion)
    )
    distance, _ = two_sample_error(replace(truth, dtheta_b=th, dvel_b=be))
    assert distance > 50 * MM


def test_in_turbulence_the_increments_replay_in_the_form_they_were_made():
    """Below 0.1 mm in ten minutes; README states what a two-sample navigator makes of it."""
    recording = record(replace(FIGURE_EIGHT, severity=4, rate=200.0))
    distance, angle = same_form_error(recording)
    assert distance < 0.1 * MM
    assert angle < 0.1 * UM


def test_the_path_over_ground_crosses_the_date_line():
    """The distance is that of the same flight elsewhere, not once round the Earth."""
    legs = {"legs": (Straight(20.0),), "rate": 100.0, "duration": 20.0, "heading": radians(90.0)}
    here, there = (fly(replace(FIGURE_EIGHT, lon=radians(lon), **legs)) for lon in (11.0, 179.9999))
    assert there.lla[0, 1] > 3.0
    assert there.lla[-1, 1] < -3.0
    paths = [summarise(truth)["path_over_ground_m"] for truth in (here, there)]
    assert_allclose(paths[0], paths[1], rtol=1e-3)


def test_the_record_starts_at_zero_and_is_evenly_sampled(short_truth):
    assert short_truth.t[0] == 0.0
    assert_array_equal(short_truth.t, np.arange(6001) / 100)
    assert len(short_truth.dtheta_b) == 6000
    assert_array_equal(short_truth.air.t, np.arange(1201) / 20)
    assert_array_equal(short_truth.controls.t, short_truth.air.t)
    assert_allclose(short_truth.lla[0, :2], [radians(47.26), radians(11.34)], rtol=0, atol=1e-10)
    assert_allclose(short_truth.lla[0, 2], 1200.0, rtol=0, atol=1e-4)  # JSBSim's ellipsoid is 5e-5 m flatter


def test_position_is_the_integral_of_velocity(short_truth):
    """Trapezoids of 10 ms are good to 1e-4 m here; blind to what the increments hold."""
    truth = short_truth
    ned = earth.local_ned(truth.lla, truth.lla[0])
    C_nn0 = earth.matrix_en(truth.lla[0, 0], truth.lla[0, 1]).T @ earth.matrix_en(
        truth.lla[:, 0], truth.lla[:, 1]
    )
    vel_0 = np.einsum("kij,kj->ki", C_nn0, truth.vel_n)
    moved = np.cumsum(0.01 * (vel_0[1:] + vel_0[:-1]) / 2, axis=0)
    assert_allclose(moved, ned[1:], atol=1e-4)


def test_air_data_agree_with_the_motion_through_the_air(short_truth):
    """Airspeed, incidence and wind are read from other properties than motion: units and frames must meet."""
    truth, air = short_truth, short_truth.air
    at = slice(None, None, 5)
    through_air = rotation.rotate(rotation.conjugate(truth.q_nb[at]), truth.vel_n[at] - air.wind_n)
    assert_allclose(np.linalg.norm(through_air, axis=1), air.airspeed_true, rtol=1e-6)
    assert_allclose(np.arctan2(through_air[:, 2], through_air[:, 0]), air.alpha, atol=1e-6)
    assert_allclose(np.arcsin(through_air[:, 1] / air.airspeed_true), air.beta, atol=1e-6)
    assert_allclose(air.wind_n, np.broadcast_to([0.003048, 5.0, 0.0], air.wind_n.shape), atol=1e-9)
    density = air.pressure / (287.05 * air.temperature)  # ideal gas
    sea_level = 1.225 / density
    assert_allclose(air.airspeed_calibrated, air.airspeed_true / np.sqrt(sea_level), rtol=2e-3)
    assert_allclose(air.temperature[0], 288.15 - 0.0065 * 1200.0, rtol=1e-4)  # ICAO standard atmosphere
    assert_allclose(air.pressure[0], 101325.0 * (1 - 0.0065 * 1200.0 / 288.15) ** 5.2559, rtol=1e-3)
    assert (air.engine_speed > 100).all()


def test_surfaces_move_with_the_turn(short_truth):
    """Aileron right rolls in; the elevator pulls (negative) more in the turn than before it."""
    controls = short_truth.controls
    rolling = (controls.t > 10.2) & (controls.t < 12.0)
    turning = (controls.t > 14.0) & (controls.t < 18.0)
    before = controls.t < 10.0
    assert controls.aileron[rolling].mean() > 0.05
    assert controls.elevator[turning].mean() < controls.elevator[before].mean() - 0.03
    assert (controls.throttle >= 0).all()
    assert (controls.throttle <= 1).all()


def digest(truth: Trajectory) -> str:
    return hashlib.sha256(pickle.dumps(truth)).hexdigest()


def stormy(seed: int = 5):
    return plan(
        Straight(4.0),
        Turn(radians(30.0), radians(20.0)),
        severity=3,
        turbulence_seed=seed,
        wind_from=1.0,
        wind_speed=4.0,
    )


def test_the_same_plan_gives_the_same_bits_in_another_process_and_another_seed_does_not():
    here = digest(fly(stormy()))
    code = "from tests.test_flight_recorder import *; print(digest(fly(stormy())))"
    there = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert there.stdout.strip() == here
    assert digest(fly(stormy(seed=6))) != here


@pytest.mark.parametrize(
    ("rate", "expected"),
    [(20.0, (20, 400)), (100.0, (4, 400)), (200.0, (2, 400)), (240.0, (2, 480)), (500.0, (1, 500))],
)
def test_jsbsim_steps_at_the_least_multiple_from_400_hz_on(rate, expected):
    substeps, dt = simulation_step(rate)
    assert (substeps, round(1 / dt)) == expected


@pytest.mark.parametrize("rate", [130.0, 0.0, -100.0])
def test_other_rates_are_refused(rate):
    with pytest.raises(FlightError, match="not a multiple of 20 Hz"):
        simulation_step(rate)


def test_progress_counts_the_seconds_flown():
    heard: list[float] = []
    fly(plan(Straight(3.0)), heard.append)
    assert heard == [0.0, 1.0, 2.0]


def test_the_summary_says_what_was_flown(short_truth):
    summary = summarise(short_truth)
    assert summary["duration_s"] == 60.0
    assert_allclose(summary["alt_max_m"], 1220.0, atol=3.0)
    assert_allclose(summary["bank_max_rad"], radians(30.0), atol=radians(2.0))
    assert_allclose(summary["load_factor_max"], 1 / np.cos(radians(30.0)), atol=0.08)
    assert summary["ground_speed_max_mps"] > 29.5  # 25 m/s with 5 m/s from behind
    assert_allclose(
        summary["path_over_ground_m"], np.linalg.norm(short_truth.vel_n[:, :2], axis=1).mean() * 60, rtol=1e-4
    )
    assert [text for _, _, text in summary["legs"]][1] == "2 turn: 120 deg right, bank 30 deg"
