"""A state of a filter is its block; a block from outside needs nothing else.

Register #34: loosely coupled error-state filter with GNSS Markov states.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import cumulative_simpson

from bench.core.mathematics.random_streams import stream
from bench.core.records.data import InitialState
from bench.core.records.sensor_specs import ImuSpec, TriadSpec
from bench.io.config import read_profile
from bench.navigation.error_state_filter import corrections, propagation
from bench.navigation.error_state_filter.aiding_sensors import AIDING
from bench.navigation.error_state_filter.error_state import GYRO
from bench.navigation.error_state_filter.imu_states import EVERY_ERROR
from bench.navigation.error_state_filter.state_blocks import index_of, state_model
from bench.navigation.error_state_filter.state_processes import CUBE, STEADY, WARMTH, Block, States
from bench.navigation.models.loose_tight import Loose
from bench.simulation import sensors
from bench.simulation.sensors import imu
from bench.simulation.sensors.draws import SensorDraws
from tests.builders import first_rows
from tests.navigation.test_error_state import plain
from tests.weaving import units, weaving

SD, DECAY, BY_WAY = 1e-2, 0.02, 1e-3
PUSH = Block(
    "push",
    lambda _: [States("push", "m_s2", 1, SD**2, 0.0, DECAY, BY_WAY, drives=((0, 3, 3),))],
    takes=("accelerometer bias instability as flicker noise",),
)
"""A forward scale error of the accelerometer: it needs no column of H."""


class Pushed(Loose):
    def blocks(self):
        return [*super().blocks(), PUSH]


@pytest.fixture(scope="module")
def drawn():
    return sensors.sense(weaving(60.0), units(), 7, 0)


def test_a_state_from_outside_is_named_spread_and_fades(drawn):
    """Its sd decays by exp(-t / 50 s - s / 1 km), s the way over ground: it looks like the bias."""
    solution = Pushed(gnss=False, baro=False).run(drawn.data, drawn.initial)
    assert solution.extra_names[-1] == "push_m_s2"
    sd = solution.extra_sd[:, -1]
    way = cumulative_simpson(np.hypot(*solution.vel_n[:, :2].T), x=solution.t, initial=0.0)
    assert_allclose(sd, SD * np.exp(-DECAY * (solution.t - drawn.initial.t) - BY_WAY * way), rtol=1e-3)


def test_a_drive_acts_like_the_bias_it_names(drawn):
    """Its factor is the specific force forward, 0.5 m/s^2 in this flight at most: P grows by it."""
    plain, pushed = (cls(gnss=False, baro=False).run(drawn.data, drawn.initial) for cls in (Loose, Pushed))
    growth = pushed.cov[-1] - plain.cov[-1]
    assert (np.diag(growth)[:6] >= 0).all()
    assert growth[0, 0] > 1e-6


def test_what_a_block_takes_is_modeled(drawn):
    specs = drawn.data.specs
    accel = replace(specs.imu.accel, bias_instability=1e-4, bias_correlation=100.0, bias_model="flicker")
    specs = replace(specs, imu=replace(specs.imu, accel=accel))
    assert PUSH.takes[0] in Loose().unmodeled_errors(specs)
    assert PUSH.takes[0] not in Pushed().unmodeled_errors(specs)


def test_kernels_find_the_blocks_of_a_layout_and_no_others(drawn):
    filters = Loose(gnss_markov=True, mems=True), Loose(baro=False)
    models = [state_model(drawn.initial, drawn.data.specs, one.blocks()) for one in filters]
    rich, plain = (model.index for model in models)
    assert (rich.baro_bias, rich.gnss_pos) == (15, 16)
    assert rich.clock_offset == rich.antenna_b == rich.wind_north == -1
    assert set(plain) == {-1}
    assert models[0].index == index_of(models[0].layout)


def test_every_sensor_of_the_table_belongs_to_an_option_of_the_filter():
    for sensor in AIDING:
        assert hasattr(Loose().options, sensor.option)


def test_a_steady_drive_is_taken_off_the_increments_as_the_bias_is():
    """The fast stages of flicker add to an error as they are, whatever the motion."""
    drives = np.array([[15 + i, GYRO + e, STEADY] for i, e in enumerate((0, 1, 2, 3, 4, 5))])
    rng = np.random.default_rng(4)
    state = np.zeros(22)
    state[10:16], state[16:22] = rng.normal(size=6), rng.normal(size=6)
    dth, dv = rng.normal(size=3), rng.normal(size=3)
    wanted = np.concatenate([dth, dv]) - (state[10:16] + state[16:22]) * 0.02
    plain(corrections.correct_kernel)(state, 0.02, drives, np.zeros(3), dth, dv, np.zeros((2, 6)))
    np.testing.assert_allclose(np.concatenate([dth, dv]), wanted, rtol=1e-12)


@pytest.mark.parametrize("triad", [0, 3])
def test_what_an_axis_measures_of_another_is_in_measured_units(triad):
    """(1 + s) w_x + m w_y + b dt is w_x again: the slope divides the misalignment and the bias, too."""
    drives = np.array([[15, GYRO + triad, triad], [16, GYRO + triad, triad + 1]])
    state = np.zeros(18)
    state[10 + triad], state[16:] = 0.3, (0.1, 0.2)
    truth = np.array([2e-3, 5e-3, -1e-3, 0.02, -0.03, -0.2])
    measured = truth.copy()
    measured[triad] += 0.1 * truth[triad] + 0.2 * truth[triad + 1] + 0.3 * 0.02
    plain(corrections.correct_kernel)(
        state, 0.02, drives, np.zeros(3), measured[:3], measured[3:], np.zeros((2, 6))
    )
    np.testing.assert_allclose(measured, truth, rtol=1e-12)


def test_states_decay_by_the_exponential_of_any_interval_and_keep_their_variance():
    tau = np.array([np.inf, 1e4, 3.0, 1.1, 0.9, 0.02, 1e-4])
    n, T = 9 + len(tau), 0.05
    process = SimpleNamespace(
        q=np.zeros(n),
        stationary=np.append(np.zeros(9), np.full(len(tau), 4.0)),
        decay_time=np.append(np.zeros(9), 1.0 / tau),
        decay_distance=np.zeros(n),
    )
    decay, noise = np.zeros(n), np.zeros(n)
    first = plain(propagation.noise_kernel)(T, process, -1, 0.0, np.zeros(2), decay, noise)
    assert first == 10
    np.testing.assert_allclose(decay[9:], np.exp(-T / tau), rtol=1e-15, atol=1e-300)
    np.testing.assert_allclose(noise[9:], 4.0 * -np.expm1(-2.0 * T / tau), rtol=1e-10, atol=1e-15)


@pytest.mark.parametrize("error", [2, 5])
def test_states_that_tell_the_same_in_steady_motion_are_exchangeable_whatever_their_size(error):
    """Far below the range a nonlinearity is a scale factor of -3 times its size, and warmth is a bias.

    Moved from one to the other the increments stay; a product of two such states would be a false rate.
    """
    drives = np.array([[15 + k, GYRO + error, by] for k, by in enumerate((error, CUBE + error, WARMTH))])
    measured = np.array([1e-3, 2e-3, 6e-3, 0.02, -0.03, -0.2])
    found = []
    for moved in (0.0, 0.01):
        state = np.zeros(19)
        state[10 + error] = 0.03 + 20.0 * moved
        state[16:] = -0.02 + 3.0 * moved, 0.016 + moved, 0.004 - moved
        dth, dv = measured[:3].copy(), measured[3:].copy()
        known = np.array([20.0, 1e6, 1e6])
        plain(corrections.correct_kernel)(state, 0.02, drives, known, dth, dv, np.zeros((2, 6)))
        found.append(np.concatenate([dth, dv]))
    assert abs(found[0][error] - measured[error]) > 0.05 * abs(measured[error])
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)


@pytest.mark.parametrize(
    ("triad", "figure", "sd"),
    [
        ("gyro", "scale_asymmetry_sd", 1e-3),
        ("gyro", "nonlinearity_sd", 1e-3),
        ("gyro", "temperature_sd", 1e-4),
        ("gyro", "g2_sensitivity_sd", 1e-5),
        ("accel", "nonlinearity_sd", 1e-3),
        ("accel", "quadratic_sd", 1e-4),
        ("accel", "temperature_sd", 1e-3),
    ],
)
def test_an_error_of_the_datasheet_is_taken_off_as_the_sensor_adds_it(figure_eight_truth, triad, figure, sd):
    """The states at the values that were drawn give back the true increments, in a turn at 7 deg/s."""
    truth = first_rows(figure_eight_truth, 5001)
    spec = ImuSpec("one", TriadSpec(range=2.0), TriadSpec(range=30.0))
    spec = replace(spec, **{triad: replace(getattr(spec, triad), **{figure: sd})})
    record, _ = imu.measure(truth, spec, SensorDraws(5, 0))
    shape = (3, 3) if figure.startswith("g2") else (3,)
    term = figure.removesuffix("_sd").removeprefix("scale_")
    drawn = sd * stream(5, 0, f"imu.{triad}.{term}").standard_normal(shape)
    specs = replace(read_profile("figure-eight").sensors.assumed, imu=spec)
    start = InitialState(0.0, truth.lla[0], truth.vel_n[0], truth.q_nb[0], np.eye(9), "given", 0.0)
    model = state_model(start, specs, [EVERY_ERROR])
    state = np.zeros(model.layout.size + 1)
    state[16:] = drawn.ravel()
    known = np.array([model.process.thermal[0], *model.process.range])
    exact = np.concatenate([truth.dtheta_b, truth.dvel_b], axis=1)
    with_error = np.concatenate([record.dtheta_b, record.dvel_b], axis=1)
    left = []
    for k in range(4900, 5000):
        dth, dv = record.dtheta_b[k].copy(), record.dvel_b[k].copy()
        correct, drives = plain(corrections.correct_kernel), model.process.drives
        correct(state, record.dt[k], drives, known, dth, dv, np.zeros((2, 6)))
        left.append(np.concatenate([dth, dv]) - exact[k])
    added = np.abs(with_error - exact)[4900:].max()
    assert added > 0
    assert np.abs(left).max() < 0.02 * added
