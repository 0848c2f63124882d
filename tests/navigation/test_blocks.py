"""A state of a filter is its block; a block from outside needs nothing else.

Register #34: loosely coupled error-state filter with GNSS Markov states.
"""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench import sensors
from bench.navigation import cycle
from bench.navigation.blocks import STEADY, Block, States, index_of, state_model
from bench.navigation.error_state import GYRO
from bench.navigation.fusion import Loose
from bench.navigation.measurements import AIDING
from tests.weaving import units, weaving

SD, DECAY = 1e-2, 0.02
PUSH = Block(
    "push",
    lambda _: [States("push", "m_s2", 1, SD**2, decay_time=DECAY, drives=((0, 3, 3),))],
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
    """Its sd starts as declared and decays by exp(-t / 50 s): no measurement sees it apart from the bias."""
    solution = Pushed(gnss=False, baro=False, covariance_hz=20.0).run(drawn.data, drawn.initial)
    assert solution.extra_names[-1] == "push_m_s2"
    sd = solution.extra_sd[:, -1]
    assert_allclose(sd, SD * np.exp(-DECAY * (solution.t - drawn.initial.t)), rtol=1e-9)


def test_a_drive_acts_like_the_bias_it_names(drawn):
    """Its factor is the specific force forward, 0.5 m/s^2 in this flight at most: P grows by it."""
    plain, pushed = (
        cls(gnss=False, baro=False, covariance_hz=20.0).run(drawn.data, drawn.initial)
        for cls in (Loose, Pushed)
    )
    growth = pushed.cov[-1] - plain.cov[-1]
    assert (np.diag(growth)[:6] >= 0).all()
    assert growth[0, 0] > 1e-6


def test_what_a_block_takes_is_modelled(drawn):
    specs = drawn.data.specs
    accel = replace(specs.imu.accel, bias_instability=1e-4, bias_correlation=100.0, bias_model="flicker")
    specs = replace(specs, imu=replace(specs.imu, accel=accel))
    assert PUSH.takes[0] in Loose().unmodelled(specs)
    assert PUSH.takes[0] not in Pushed().unmodelled(specs)


def test_kernels_find_the_blocks_of_a_layout_and_no_others(drawn):
    filters = Loose(gnss_markov=True, mems=True), Loose(baro=False)
    models = [state_model(drawn.initial, drawn.data.specs, one.blocks()) for one in filters]
    rich, plain = (model.index for model in models)
    assert (rich.baro_bias, rich.gnss_pos, rich.g_sensitivity_x) == (15, 16, 28)
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
    cycle.increments_kernel.py_func(state, 0.02, drives, dth, dv)
    np.testing.assert_allclose(np.concatenate([dth, dv]), wanted, rtol=1e-12)
