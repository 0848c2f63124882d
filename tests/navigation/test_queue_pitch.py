"""Pitch in a straight queue of stops: what `loose-full` reports is what the data tell (`pitch_posterior`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.special import chdtri, ndtr

from bench.core.mathematics import earth, rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import InitialState, NavSolution, SensorData, Trajectory
from bench.core.records.sensor_specs import SensorsSpec, TriadSpec
from bench.navigation import built_in
from bench.navigation.error_state_filter.error_state import dynamics
from bench.navigation.error_state_filter.imu_states import EVERY_ERROR
from bench.navigation.error_state_filter.state_blocks import state_model, steady_rows
from bench.navigation.start import alignment
from bench.simulation import sensors
from bench.simulation.sensors import imu
from bench.simulation.sensors.draws import SensorDraws
from tests.motions import trials
from tests.motions.flown_paths import draw_queue, rock
from tests.motions.held import after, draw_log
from tests.motions.truths import RATE, clock, make_truth
from tests.navigation import pitch_posterior

HEADING_SD = np.deg2rad(0.5)


class Queue(NamedTuple):
    """A record of a straight queue."""

    truth: Trajectory
    data: SensorData
    initial: InitialState
    rest: float  # until the first move [s]
    stops: list[float]  # half a second before each further move and before the end [s]


def load_spec(unit: str, receiver: str) -> SensorsSpec:
    spec = trials.load_sensors(unit, receiver)
    return replace(
        spec, baro=None, assumed=replace(spec.assumed, baro=None), antenna_b=(0.0, 0.0, 0.0),
        output_rate=2.0, gnss_outages=(), faults=(), alignment="level", initial_heading_sd=HEADING_SD,
    )  # fmt: skip


def drive(spec: SensorsSpec, seed: int, run: int) -> Queue:
    """Stand for 12 to 30 s, then move up 2 to 7 times, north; braking dips the nose, the road slopes."""
    r = np.random.default_rng([seed, run])
    rest = float(np.floor(r.uniform(12.0, 30.0)))
    moves = draw_queue(r, rest)[0][:-1]
    begin, _, ramp, steady = moves[-1]
    t = clock(np.ceil(begin + steady + 2.0 * ramp + 12.0))
    speed = np.zeros(len(t))
    for begin, peak, ramp, steady in moves:
        speed += peak * after(t, begin, ramp) * (1.0 - after(t, begin + ramp + steady, ramp))
    way = np.cumsum(speed) / RATE
    slope = np.deg2rad(draw_log(r, 0.2, 1.0)) * np.sin(way / r.uniform(10.0, 40.0) + r.uniform(0.0, 6.0))
    dip = rock(np.gradient(speed) * RATE, draw_log(r, 0.7, 1.4), r.uniform(0.1, 0.3))
    pitch = np.deg2rad(r.uniform(-2.0, 4.0)) + slope + np.deg2rad(draw_log(r, 0.3, 1.5)) * dip
    truth = make_truth(
        np.column_stack([speed * np.cos(slope), 0.0 * t, -speed * np.sin(slope)]),
        np.column_stack([0.0 * t, pitch, 0.0 * t]),
    )
    drawn = sensors.sense(truth, replace(spec, align_for=rest), seed, run)
    cov = drawn.initial.cov.copy()
    cov[8, 8] = HEADING_SD**2
    q_nb = rotation.from_euler(0.0, 0.0, HEADING_SD * r.standard_normal())
    data = replace(drawn.data, output_t=drawn.data.output_t[drawn.data.output_t >= rest])
    stops = [0.5 * np.floor(2.0 * move[0]) - 0.5 for move in moves[1:]]
    return Queue(truth, data, replace(drawn.initial, cov=cov, q_nb=q_nb), rest, [*stops, float(t[-1]) - 0.5])


def pitch_at(queue: Queue, solution: NavSolution, t: float) -> tuple[float, float, float]:
    """Return the true pitch, the estimate and its sigma at a time [rad]."""
    at, row = round(t * RATE), int(np.searchsorted(solution.t, t - 1e-6))
    true, found = (float(rotation.to_euler(q)[1]) for q in (queue.truth.q_nb[at], solution.q_nb[row]))
    return true, found, float(np.sqrt(solution.cov[row, 7, 7]))


def compare(spec: SensorsSpec, seed: int, run: int, stops: slice, count: int) -> Iterator[FloatArray]:
    """Yield time, sigma of `loose-full` over that of the posterior, and effective sample size at stops."""
    queue = drive(spec, seed, run)
    solution = built_in.load("loose-full", {}).run(queue.data, queue.initial)
    record = pitch_posterior.make_record(queue.data, queue.initial, queue.rest)
    for t in queue.stops[stops]:
        found = pitch_posterior.find_posterior(
            record, record.until(t + 1e-6), count, np.random.default_rng([run, round(t)])
        )
        yield np.array([t, pitch_at(queue, solution, t)[2] / found.sd, found.effective])


def plain_unit() -> SensorsSpec:
    """Sensors with turn-on biases of the accelerometers, Gauss-Markov biases and noise alone."""
    spec = load_spec("matched-mems", "zed-f9p")
    gyro = replace(spec.imu.gyro, turn_on_bias_sd=1e-5, bias_correlation=300.0)
    imu = replace(spec.imu, gyro=gyro)
    return replace(spec, imu=imu, assumed=replace(spec.assumed, imu=imu))


def test_reference_and_filter_agree_where_the_model_is_linear():
    """Within 1 %: that the posterior of a Gaussian model is a Kalman filter's, both have to get right."""
    for run in range(2):
        queue = drive(plain_unit(), 3, run)
        solution = built_in.load("loose-full", {}).run(queue.data, queue.initial)
        record = pitch_posterior.make_record(queue.data, queue.initial, queue.rest)
        for t in queue.stops:
            _, J, g, variance = pitch_posterior.differentiate(record, np.zeros(15), record.until(t + 1e-6))
            variance += g @ np.linalg.solve(J.T @ J + np.eye(15), g)
            assert pitch_at(queue, solution, t)[2] == pytest.approx(np.sqrt(variance), rel=0.01)


def test_pitch_sigma_is_that_of_the_posterior_if_a_bias_is_far_off():
    """An accelerometer bias of 2.2 sigma, which the stops correct by a degree of pitch, within 10 %."""
    ((_, ratio, effective),) = compare(load_spec("bmi088", "l1-code"), 1, 1, slice(-1, None), 1700)
    assert effective > 1000
    assert ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.long
def test_pitch_sigma_is_that_of_the_posterior_at_each_stop():
    spec = load_spec("icm-45686", "zed-f9p")
    found = np.array([row for run in range(6) for row in compare(spec, 11, run, slice(None), 2200)])
    assert found[:, 2].min() > 1000
    assert np.abs(found[:, 1] - 1.0).max() < 0.1, found


@pytest.mark.long
@pytest.mark.parametrize(("unit", "receiver"), [("bmi088", "l1-code"), ("icm-45686", "zed-f9p")])
def test_ranks_of_the_true_pitch_are_uniform(unit, receiver):
    """Simulation-based calibration: 400 records, a stop of each, chi-square over 20 bins at 99.9 %."""
    ranks, spec = [], load_spec(unit, receiver)
    for run in range(400):
        queue = drive(spec, 7, run)
        t = float(np.random.default_rng([7, run, 9]).choice(queue.stops))
        true, found, sd = pitch_at(queue, built_in.load("loose-full", {}).run(queue.data, queue.initial), t)
        ranks.append(ndtr((true - found) / sd))
    counts = np.histogram(ranks, 20, (0.0, 1.0))[0]
    assert np.sum((counts - 20.0) ** 2) / 20.0 < chdtri(19, 0.001), counts


def test_a_leveled_unit_feels_no_horizontal_force():
    """Whatever its accelerometers err by, biases or cross-axis: its tilt compensates all but 5 %."""
    spec = load_spec("bmi088", "l1-code")
    start, _ = alignment.complete(*drive(spec, 5, 0)[1:3])
    model = state_model(start, spec.assumed, [EVERY_ERROR])
    C, f_n = rotation.matrix(start.q_nb), -earth.gravity_n(start.lla[0], start.lla[2])
    nav = np.concatenate([start.lla, start.vel_n, start.q_nb])
    F, L = dynamics(nav, C, f_n)[3:5], steady_rows(model.process.drives, C.T @ f_n, -15.0, len(model.P))
    rows = np.hstack([F, np.zeros((2, len(model.P) - 15))]) + F[:, 9:] @ L
    felt, tilt = rows @ model.P @ rows.T, f_n[2] ** 2 * model.P[6, 6]
    assert np.diag(felt) == pytest.approx(0.0, abs=0.05**2 * tilt)


def test_elements_of_a_matrix_have_in_common_what_turns_and_leans_both_axes():
    """P at the start against 4000 matrices of the simulation, in the 99.9 % band of a covariance."""
    triad = TriadSpec(misalignment_sd=0.003, nonorthogonality_sd=0.01, alignment_sd=0.008)
    spec = load_spec("bmi088", "l1-code")
    specs = replace(spec.assumed, imu=replace(spec.imu, gyro=triad, accel=triad))
    model = state_model(drive(spec, 5, 0).initial, specs, [EVERY_ERROR])
    first = model.layout.slice("accel_matrix_x").start
    drawn = np.array([imu.draw_matrix(triad, SensorDraws(9, run)).ravel() for run in range(4000)])
    P, found = model.P[first : first + 9, first : first + 9], drawn.T @ drawn / len(drawn)
    sd = np.sqrt((np.outer(np.diag(P), np.diag(P)) + P**2) / len(drawn))
    assert np.all(np.abs(found - P) <= 4.0 * sd)  # 36 elements at 99.9 % each in all
