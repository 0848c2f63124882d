"""A heading that is hardly known: what standing and a covariance make of it, case by case."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import rotation
from bench.navigation.error_state_filter import rough_heading
from bench.navigation.error_state_filter.antenna_rows import antenna_kernel, steady_arm_kernel
from tests.navigation.test_error_state import plain

ROUGH, WIDE = 0.05, np.pi / 6.0
"""Sd from which on motion that may be none does not tell a heading, and above which it may be any [rad]."""


def standing(vel_n=(2.0, -2.0), variance=(0.4, 0.5), heading_sd=0.1):
    """State, P (15, 15) without a zero, F and the noise of a step."""
    root = np.random.default_rng(3).normal(size=(15, 15))
    P = 0.01 * root @ root.T
    P[3, 3], P[4, 4], P[8, 8] = *variance, heading_sd**2
    state = np.array([0.8, 0.2, 500.0, *vel_n, 9.0, 1.0, 0.0, 0.0, 0.0, *np.zeros(6)])
    return state, P, np.arange(135.0).reshape(9, 15) + 1.0, np.full(15, 0.25)


CASES = [
    # horizontal velocity, its variances, whether it may be none: 3 sigma, of a velocity known to 1 m/s
    ((2.0, -2.0), (0.4, 0.5), True),
    ((-2.1, 2.0), (0.4, 0.5), False),
    ((2.0, 2.1), (0.5, 0.4), False),
    ((0.0, 0.0), (0.6, 0.41), False),
    ((0.0, 0.0), (0.58, 0.41), True),
]


@pytest.mark.parametrize(("vel_n", "variance", "stands"), CASES)
def test_a_velocity_within_three_sigma_may_be_none_if_it_is_known_at_all(vel_n, variance, stands):
    state, P, F, noise = standing(vel_n, variance)
    assert not plain(rough_heading.stand_kernel)(state, 0.5, P, F, noise)
    assert (F[3, 8] == F[4, 8] == 0.0) == stands
    seen = rough_heading.may_stand(np.array([[*vel_n, 9.0]]), P[None, :9, :9])
    assert seen.tolist() == [stands]


@pytest.mark.parametrize(
    ("heading_sd", "columns", "lost"),
    [
        (0.99 * ROUGH, [], False),
        (1.01 * ROUGH, [3, 4], False),
        (0.99 * WIDE, [3, 4], False),
        (1.01 * WIDE, [3, 4, 6, 7], True),
    ],
)
def test_a_rough_heading_turns_no_force_and_a_wide_one_begins_anew(heading_sd, columns, lost):
    """The tilts then turn at a rate as unknown as the bias about the vertical: twice its sd times their
    variance and the time."""
    state, P, F, noise = standing(heading_sd=heading_sd)
    before, wanted, P_before, T = F.copy(), noise.copy(), P.copy(), 0.5
    assert plain(rough_heading.stand_kernel)(state, T, P, F, noise) == lost
    before[columns, 8] = 0.0
    assert_allclose(F, before)
    if lost:
        wanted[6:8] += 2.0 * np.sqrt(P_before[11, 11]) * T * np.diag(P_before)[6:8]
        P_before[8], P_before[:, 8] = 0.0, 0.0
        P_before[8, 8] = np.pi**2 / 3.0  # even from -pi to pi
    assert_allclose(noise, wanted)
    assert_allclose(P, P_before)


@pytest.mark.parametrize(("vel_n", "heading_sd", "blind"), [
    ((2.0, -2.0), 1.01 * WIDE, True), ((2.0, -2.0), 0.99 * WIDE, False), ((9.0, 0.0), 1.01 * WIDE, False),
])  # fmt: skip
def test_a_lever_arm_tells_no_heading_that_may_be_any(vel_n, heading_sd, blind):
    state, P, _, _ = standing(vel_n, heading_sd=heading_sd)
    H = np.arange(45.0).reshape(3, 15) + 1.0
    wanted = H.copy()
    wanted[:, 8] *= not blind
    plain(rough_heading.blind_kernel)(state, P, H)
    assert_allclose(H, wanted)


def test_the_arm_of_a_velocity_keeps_the_heading_of_a_turn_about_the_vertical_alone():
    """By the velocity of a swinging arm, from rotation vectors, at a pitched and rolled attitude."""
    C = rotation.matrix(rotation.from_euler(0.3, -0.2, 1.1))
    arm_b, w_b, nav = np.array([0.4, -0.3, -0.8]), np.array([0.5, -0.4, 0.7]), np.zeros(10)
    nav[0] = 0.8
    H, z = np.zeros((6, 15)), np.zeros(6)
    plain(antenna_kernel)(nav, C, arm_b, w_b, nav[:3], nav[3:6], H, z)
    before = H.copy()
    plain(steady_arm_kernel)(C, w_b, H)
    turn_n = np.array([0.0, 0.0, (C @ w_b)[2]])
    wanted = np.cross(np.cross(turn_n, C @ arm_b), [0.0, 0.0, 1.0])  # -[v x] e_D
    assert_allclose(H[3:5, 8], -wanted[:2], atol=1e-12)
    before[3:5, 8] = H[3:5, 8]
    assert_allclose(H, before)
    assert np.abs(np.cross(C @ np.cross(w_b, arm_b), [0.0, 0.0, 1.0])[:2] + H[3:5, 8]).max() > 0.1


def test_an_antenna_on_an_arm_is_anywhere_on_its_circle_where_the_heading_is_any():
    P = np.tile(np.diag(np.arange(1.0, 10.0)), (3, 1, 1))
    P[:, 8, 8] = np.pi**2 / 3.0 * np.array([1.005, 1.015, 0.985])
    wanted = P.copy()
    wanted[0, 0, 0] += 25.0
    wanted[0, 1, 1] += 25.0
    rough_heading.add_arm(P, np.array([3.0, -4.0, 7.0]))
    assert_allclose(P, wanted)
