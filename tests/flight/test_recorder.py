"""Recorded truth is one motion: its increments replay it, its columns agree, one plan gives one set of bits.

The replay is the proof of the flight: an error-free navigator with two-sample coning and sculling
corrections, fed with the increments, returns to the recorded position and attitude. `inertial.py` says
what it shares.
"""

import dataclasses
import hashlib
import os
import pickle
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from math import radians
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench import pipeline
from bench.core.mathematics import earth, rotation
from bench.core.records.data import Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.specs import Profile
from bench.core.words.exceptions import FlightError
from bench.io.config import read_profile
from bench.io.results.truth_cache import truth_pieces
from bench.navigation import mechanization
from bench.simulation.flight import Summary, fly, fly_pieces, summarize
from bench.simulation.flight.increments import Motion, at_point, step_increments
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.turns import Turn
from bench.simulation.flight.recorder import simulation_step
from bench.simulation.flight.truth import Stretch
from tests.flight.inertial import inertial, largest_difference, navigate
from tests.flight.plans import FIGURE_EIGHT, plan, short_plan, truth_of

MM, UM = 1e-3, 1e-6  # [m], and [rad] for microradians


def with_imu(spec: FlightSpec, *imu_b: float) -> FlightSpec:
    return replace(spec, aircraft=replace(spec.aircraft, imu_b=imu_b))


def two_sample_error(truth: Trajectory) -> tuple[float, float]:
    reference = inertial(truth)
    start = tuple(column[0] for column in reference)
    found = navigate(truth.t[1], truth.dtheta_b, truth.dvel_b, start, two_sample=True)
    return largest_difference(found, reference)


def same_form_error(motion: Motion) -> tuple[float, float]:
    reference = (motion.pos_i, motion.vel_i, motion.q_ib)
    start = tuple(column[0] for column in reference)
    found = navigate(motion.dt, *step_increments(motion), start, two_sample=False)
    return largest_difference(found, reference)


def test_at_200_hz_ten_minutes_come_back_within_a_millimeter_and_a_microradian(figure_eight_truth):
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


def test_at_100_hz_within_five_and_increments_of_the_wrong_form_do_not_pass(eights):
    """Increments that are constant within a step, summed as if they were integrals, count coning twice."""
    truth = truth_of(eights, 100.0)  # of the same steps of 1/400 s
    distance, angle = two_sample_error(truth)
    assert distance < 5 * MM
    assert angle < 5 * UM
    th, be = (
        column[:-1].reshape(-1, 4, 3).sum(axis=1)  # 400 Hz
        for column in step_increments(eights.motion)
    )
    distance, _ = two_sample_error(replace(truth, dtheta_b=th, dvel_b=be))
    assert distance > 50 * MM


def test_gusts_come_back_at_the_steps_of_jsbsim_where_two_of_them_are_too_far_apart():
    """The flight is the same; two samples of two steps each do not show how it moved between."""
    legs = Straight(20.0), Turn(radians(360.0), radians(30.0))
    fine, coarse = (fly(plan(*legs, rate=rate, severity=4)) for rate in (400.0, 200.0))
    assert_array_equal(fine.lla[::2], coarse.lla)
    distance, _ = two_sample_error(fine)
    assert distance < 0.1 * MM
    assert two_sample_error(coarse)[0] > 10 * distance


def test_the_path_over_ground_crosses_the_date_line():
    """The distance is that of the same flight elsewhere, not once round the Earth."""
    legs = {"legs": (Straight(20.0),), "rate": 100.0, "duration": 20.0, "heading": radians(90.0)}
    here, there = (fly(replace(FIGURE_EIGHT, lon=radians(lon), **legs)) for lon in (11.0, 179.9999))
    assert there.lla[0, 1] > 3.0
    assert there.lla[-1, 1] < -3.0
    paths = [summarize(truth)["path_over_ground_m"] for truth in (here, there)]
    assert_allclose(paths[0], paths[1], rtol=1e-3)


# --- the IMU off the center of gravity ----------------------------------------------------------------


@pytest.fixture(scope="module")
def eights(recorded) -> Stretch:
    """Ten minutes of figure-eights at 200 Hz, of the center of gravity."""
    return recorded(FIGURE_EIGHT)


@pytest.mark.parametrize("arm_b", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-5.0, 8.0, 3.0)])
def test_ten_minutes_of_an_imu_off_the_center_of_gravity_come_back_too(eights, arm_b):
    """1 m along each axis and 10 m across; the velocity of the arm is the slope of its position."""
    imu = replace(eights, motion=at_point(eights.motion, arm_b))
    distance, angle = same_form_error(imu.motion)
    assert distance < 0.1 * MM
    assert angle < 0.1 * UM
    distance, angle = two_sample_error(truth_of(imu, 200.0))
    assert distance < 1 * MM
    assert angle < 1 * UM
    slope = arm_slope_error(eights.motion, imu.motion)
    assert slope < 5e-6 * np.linalg.norm(arm_b)  # [m/s]; rounding of positions alone is 2e-6


def test_a_velocity_that_is_half_a_step_late_does_not_come_back(eights):
    """What the rate over the last step would make of an arm of 10 m."""
    motion = at_point(eights.motion, (-5.0, 8.0, 3.0))
    arm_i = rotation.rotate(motion.q_ib, [-5.0, 8.0, 3.0])
    late = motion.vel_i.copy()
    late[1:] = eights.motion.vel_i[1:-2] + np.diff(arm_i, axis=0) / motion.dt
    imu = replace(eights, motion=replace(motion, vel_i=late))
    assert arm_slope_error(eights.motion, imu.motion) > 1e-4
    assert two_sample_error(truth_of(imu, 200.0))[0] > 1 * MM


def arm_slope_error(at_cg: Motion, at_imu: Motion) -> float:
    """Largest difference [m/s] of the velocity relative to the c.g. from the slope of the relative position.

    The slope is the central difference of sixth order; the recorded velocity is one of fourth order.
    """
    u = at_imu.pos_i - at_cg.pos_i[:-2]
    slope = (45 * (u[4:-2] - u[2:-4]) - 9 * (u[5:-1] - u[1:-5]) + (u[6:] - u[:-6])) / (60 * at_imu.dt)
    velocity = (at_imu.vel_i - at_cg.vel_i[:-2])[3:-3]
    return float(np.abs(slope - velocity).max())


def test_the_imu_moves_as_a_point_of_a_rigid_body(short_truth):
    """Position by C l, velocity by w x l, specific force by w' x l + w x (w x l), with rates from the
    increments of the center of gravity. Central differences of 10 ms are good to the tolerances here:
    set-points change the angular acceleration 20 times a second."""
    arm_b = np.array([3.0, -0.5, 1.0])
    imu = fly(with_imu(short_plan(), *arm_b))
    cg, dt = short_truth, 0.01
    apart = rotation.rotate(rotation.conjugate(cg.q_nb), earth.difference_n(imu.lla, cg.lla))
    assert_allclose(apart, np.broadcast_to(arm_b, apart.shape), atol=2e-6)  # first order in 3 m / 6400 km
    w_ib = cg.dtheta_b / dt
    w_ie = rotation.rotate(rotation.conjugate(cg.q_nb), earth.EARTH_RATE * level_pole(cg.lla[:, 0]))
    w_eb = (w_ib[:-1] + w_ib[1:]) / 2 - w_ie[1:-1]
    velocity = rotation.rotate(rotation.conjugate(cg.q_nb), imu.vel_n - cg.vel_n)[1:-1]
    assert_allclose(velocity, np.cross(w_eb, arm_b), atol=3e-4)
    assert np.abs(velocity).max() > 0.3
    turning = (w_ib[2:] - w_ib[:-2]) / (2 * dt)
    force = (imu.dvel_b - cg.dvel_b)[1:-1] / dt
    w = w_ib[1:-1]
    assert_allclose(force, np.cross(turning, arm_b) + np.cross(w, np.cross(w, arm_b)), atol=1e-2)
    assert np.abs(np.cross(w, np.cross(w, arm_b))).max() > 0.2  # each term is seen
    assert np.abs(np.cross(turning, arm_b)).max() > 0.2
    # gravity and the level turn with the place by less than 1e-6 rad
    turned = rotation.to_rotvec(rotation.multiply(rotation.conjugate(cg.q_nb), imu.q_nb))
    assert_allclose(turned, 0, atol=1e-6)
    assert_allclose(imu.dtheta_b, cg.dtheta_b, atol=1e-14)


def level_pole(lat) -> np.ndarray:
    """The axis of the Earth, n."""
    return np.stack([np.cos(lat), 0 * lat, -np.sin(lat)], axis=-1)


def test_an_imu_at_the_center_of_gravity_has_its_motion_bit_for_bit(eights):
    at = at_point(eights.motion, (0.0, 0.0, 0.0))
    for field in dataclasses.fields(Motion)[1:]:
        assert_array_equal(getattr(at, field.name), getattr(eights.motion, field.name)[:-2], strict=True)


# --- in pieces ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("spec", "seconds"),
    [
        (plan(Straight(3.0), rate=100.0), 1.0),
        (plan(Straight(3.0), rate=100.0), 0.05),
        (plan(Straight(2.0), Turn(radians(90.0), radians(30.0)), rate=500.0, severity=4), 1.3),
    ],
)
@pytest.mark.parametrize("imu_b", [(0.0, 0.0, 0.0), (2.0, -1.0, 0.5)])
def test_pieces_put_together_are_the_whole_bit_for_bit(spec, seconds, imu_b):
    spec = with_imu(spec, *imu_b)
    whole = fly(spec)
    pieces = list(fly_pieces(spec, seconds=seconds))
    assert len(pieces) >= round((whole.t[-1] - 0.1) / seconds) > 1
    same_bits(pieces, whole)


def test_a_flight_with_heading_and_sign_going_round_is_the_same_in_pieces(eights, figure_eight_truth):
    """Six full circles: the sign of the attitude has to go on across every piece the pipeline joined."""
    same_bits([figure_eight_truth], truth_of(eights, 200.0))


def same_bits(pieces: list[Trajectory], whole: Trajectory) -> None:
    for name in ("t", "lla", "vel_n", "q_nb", "dtheta_b", "dvel_b"):
        repeats = 0 if name.startswith("d") else 1
        columns = [getattr(piece, name)[repeats * (k > 0) :] for k, piece in enumerate(pieces)]
        assert_array_equal(np.concatenate(columns), getattr(whole, name), err_msg=name, strict=True)
        if repeats:
            for before, after in pairwise(pieces):
                assert_array_equal(getattr(before, name)[-1], getattr(after, name)[0], strict=True)
    for part in ("air", "controls"):
        for field in dataclasses.fields(getattr(whole, part)):
            columns = [getattr(getattr(piece, part), field.name) for piece in pieces]
            assert_array_equal(
                np.concatenate(columns), getattr(getattr(whole, part), field.name), strict=True
            )
    assert [len(piece.events) for piece in pieces[:-1]] == [0] * (len(pieces) - 1)
    assert pieces[-1].events.text == whole.events.text


MEMORY = """
import resource, sys, jsbsim, scipy.optimize, rich.console
from bench import pipeline
from bench.evaluation.errors.replay import Replay
from bench.navigation import mechanization
from bench.cli.verbs import flight_verbs
from tests.flight.test_recorder import cruise_for
mechanization.propagate([0.8, 0, 0], [1, 0, 0], [1, 0, 0, 0], [1], [[0, 0, 0]], [[0, 0, 0]])  # its kernel
def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
start = peak()
for _ in range(2):
    summary = pipeline.fly_over(cruise_for(float(sys.argv[1])))
    print(summary["samples"], peak() - start)
"""


def cruise_for(seconds: float) -> Profile:
    """Return ``long-cruise``, which takes two hours, or its last turn and a straight to that duration."""
    profile = read_profile("long-cruise")
    if seconds == profile.flight.duration:
        return profile
    turn, straight = profile.flight.legs[-2:]
    legs = (turn, replace(straight, duration=0.5 * seconds))
    return replace(profile, flight=replace(profile.flight, legs=legs, duration=seconds))


@pytest.fixture(
    params=[600.0, pytest.param(7200.0, marks=pytest.mark.long)], ids=["ten minutes", "two hours"]
)
def cruise(request, session_folder, made_once) -> tuple[float, Path, str]:
    """A cruise flown in a process of its own, once in a session: how long, its cache, and what it printed."""
    cache = session_folder / f"cruise-{request.param:.0f}"

    def run() -> str:
        env = {
            **os.environ,
            "BENCH_CACHE": str(cache),
        }
        command = [sys.executable, "-c", MEMORY, str(request.param)]
        done = subprocess.run(command, capture_output=True, text=True, env=env)
        assert done.returncode == 0, done.stderr
        return done.stdout

    return request.param, cache, made_once(cache.name, run)


@pytest.mark.slow
def test_a_long_cruise_at_200_hz_needs_less_than_64_mb(cruise):
    """Flown, kept in the cache and summed up; then from the cache. Peak memory above that after imports.

    Flown as one piece, ten minutes need 100 MB.
    """
    seconds, cache, printed = cruise
    for line in printed.splitlines():
        samples, megabytes = line.split()
        assert int(samples) >= seconds * 200
        assert float(megabytes) < 64
    (entry,) = (cache / "truth").iterdir()
    assert sum(path.stat().st_size for path in entry.iterdir()) > 27e3 * seconds


@pytest.mark.slow
def test_a_long_cruise_is_held_and_replays(cruise, monkeypatch):
    seconds, cache, _ = cruise
    monkeypatch.setenv("BENCH_CACHE", str(cache))
    truth = pipeline.fly(cruise_for(seconds))
    assert truth.t[-1] == seconds
    assert_allclose(truth.lla[:, 2], 9000.0, atol=2.0)
    assert_allclose(truth.air.airspeed_true, 230.0, atol=0.5)
    assert truth.air.pressure.min() > 300e2
    distance, angle = two_sample_error(truth)
    assert distance < seconds / 600.0 * MM
    assert angle < seconds / 600.0 * UM


# --- the record itself --------------------------------------------------------------------------------


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
    code = "from tests.flight.test_recorder import *; print(digest(fly(stormy())))"
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


@pytest.mark.parametrize(
    ("legs", "figures"),
    [(2, None), pytest.param(4, ([0.051, 0.025], [0.0131, 0.0066]), marks=pytest.mark.long)],
)
def test_finer_steps_change_the_flight_less_and_less(legs, figures):
    """JSBSim is of first order in its step: each halving halves the difference. aircraft/aerosonde/README.md
    has the figures of four legs [m, deg]. The increments fit the motion whatever the step."""
    apart, turned = [], []
    spec = replace(FIGURE_EIGHT, legs=FIGURE_EIGHT.legs[:legs], duration=None)
    flights = [fly(replace(spec, rate=rate)) for rate in (400.0, 800.0, 1600.0)]
    for coarse, fine in pairwise(flights):
        apart.append(np.linalg.norm(earth.difference_n(coarse.lla, fine.lla[::2]), axis=1).max())
        q = rotation.multiply(rotation.conjugate(coarse.q_nb), fine.q_nb[::2])
        turned.append(np.linalg.norm(rotation.to_rotvec(q), axis=1).max())
    if figures:
        assert_allclose(apart, figures[0], rtol=0.1)
        assert_allclose(np.rad2deg(turned), figures[1], rtol=0.1)
    assert 0.4 < apart[1] / apart[0] < 0.6
    assert 0.4 < turned[1] / turned[0] < 0.6


def test_the_summary_of_pieces_is_that_of_the_whole(figure_eight_truth):
    summary = Summary()
    pieces = list(truth_pieces(FIGURE_EIGHT, lambda: fly_pieces(FIGURE_EIGHT)))
    assert [len(piece) for piece in pieces] == 20 * [6001]
    for piece in pieces:
        summary.add(piece)
    whole = summarize(figure_eight_truth)
    assert summary.result() == whole | {"path_over_ground_m": pytest.approx(whole["path_over_ground_m"])}


def test_the_path_goes_on_across_the_date_line(short_truth):
    lla = short_truth.lla.copy()
    lla[:, 1] = np.mod(lla[:, 1] - lla[1000, 1], 2 * np.pi) - np.pi
    assert np.abs(np.diff(lla[:, 1])).max() > 6
    there = summarize(replace(short_truth, lla=lla))["path_over_ground_m"]
    assert_allclose(there, summarize(short_truth)["path_over_ground_m"], rtol=1e-9)


def test_the_summary_says_what_was_flown(short_truth):
    summary = summarize(short_truth)
    assert summary["duration_s"] == 60.0
    assert_allclose(summary["alt_max_m"], 1220.0, atol=3.0)
    assert_allclose(summary["bank_max_rad"], radians(30.0), atol=radians(2.0))
    assert_allclose(summary["load_factor_max"], 1 / np.cos(radians(30.0)), atol=0.08)
    assert summary["ground_speed_max_mps"] > 29.5  # 25 m/s with 5 m/s from behind
    assert_allclose(
        summary["path_over_ground_m"], np.linalg.norm(short_truth.vel_n[:, :2], axis=1).mean() * 60, rtol=1e-4
    )
    assert [text for _, _, text in summary["legs"]][1] == "2 turn: 120 deg right, bank 30 deg"
