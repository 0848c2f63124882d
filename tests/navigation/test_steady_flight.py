"""A heading error turns the force of a motion in F, and not the noise of the accelerometers."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.navigation.error_state_filter.error_state import dynamics
from bench.navigation.error_state_filter.rough_heading import steady_kernel
from tests import twin

NAV = np.array([0.8, 0.2, 9000.0, 60.0, -210.0, 3.0, 1.0, 0.0, 0.0, 0.0])
VARIANCE = 1e-4  # [(m/s^2)^2]


def steady() -> np.ndarray:
    """The horizontal force that keeps a velocity."""
    earth, transport = twin.frame_rates(NAV[0], NAV[2], NAV[3:6])
    return np.cross(2.0 * earth + transport, NAV[3:6])[:2]


def heading_column(f_h: np.ndarray) -> np.ndarray:
    F = dynamics(NAV, np.eye(3), [*f_h, -9.8])
    steady_kernel(NAV, np.array([*f_h, -9.8]), VARIANCE, F)
    return F[3:5, 8]


@pytest.mark.parametrize("sigmas", [0.0, 1.0, 2.9])
def test_what_noise_may_be_is_turned_by_no_heading_error(sigmas):
    north, east = steady()
    found = heading_column(steady() + sigmas * np.sqrt(VARIANCE) * np.array([0.6, -0.8]))
    assert_allclose(found, [-east, north], rtol=1e-9)


def test_a_motion_is_turned_but_for_what_noise_may_be_of_it():
    """Ten sigma: 91 % of it; a hundred: all but a ten-thousandth."""
    for sigmas, part in ((10.0, 0.91), (100.0, 0.9991)):
        more = sigmas * np.sqrt(VARIANCE) * np.array([0.6, -0.8])
        north, east = steady() + part * more
        assert_allclose(heading_column(steady() + more), [-east, north], rtol=1e-9)


def test_nothing_else_of_the_dynamics_is_touched():
    f_n = np.array([0.3, -0.2, -9.8])
    F = dynamics(NAV, np.eye(3), f_n)
    other = F.copy()
    steady_kernel(NAV, f_n, VARIANCE, other)
    changed = np.argwhere(other != F).tolist()
    assert changed == [[3, 8], [4, 8], [5, 6], [5, 7]]
    assert_allclose(other[5, 6:8], [-other[3, 8], -other[4, 8]], rtol=1e-12)  # -[f x]
