"""The ionosphere that signals share: its correlation over the shell, and what a filter makes of it.

Statistical bounds are two-sided 99.9 % bands of their statistic at fixed seeds.
"""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.special import ndtr

from bench.core.mathematics import earth
from bench.navigation.error_state_filter.ranges import ionosphere_anchors
from bench.simulation.sensors.measurement_level import ionosphere_field as field
from bench.simulation.signals import least_squares
from bench.simulation.signals.look import Look
from tests.builders import band
from tests.navigation.test_error_state import plain

HERE = np.array([[0.8, 0.2, 500.0]])
DIRECTIONS = np.array(
    [(el, az) for el in (5.0, 20.0, 40.0, 70.0, 89.0) for az in (10.0, 100.0, 220.0, 300.0)]
)


def look():
    el, az = np.deg2rad(DIRECTIONS).T
    los_n = np.column_stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), -np.sin(el)])
    none = np.zeros(len(el))
    return Look(earth.to_ecef(HERE), HERE, los_n, el, none, none)


def draw(decay, count, rng):
    """Fields (count, K) of unit variance at the pierce points."""
    points = field.locate_pierce_points(look(), np.zeros(len(DIRECTIONS), np.int64))
    kernel, out, drawn = field.field_kernel, np.empty(len(points)), []
    for _ in range(count):
        waves = field.draw_waves(rng.standard_normal((field.WAVES, 4)), decay)
        knots = np.repeat(rng.standard_normal((1, 2 * field.WAVES)), 2, axis=0)
        kernel(0, 1, knots, waves, points, np.zeros(len(points), np.int64), out)
        drawn.append(out.copy())
    return np.array(drawn), points


def test_pierce_points_are_on_the_line_of_sight_and_on_the_shell():
    points = field.locate_pierce_points(look(), np.zeros(len(DIRECTIONS), np.int64))
    assert_allclose(np.linalg.norm(points, axis=1), least_squares.SHELL, rtol=1e-12)
    C_en = earth.matrix_en(*HERE[0, :2])
    here = least_squares.EARTH_RADIUS * C_en @ np.array([0.0, 0.0, -1.0])
    toward = (points - here) @ C_en
    toward /= np.linalg.norm(toward, axis=1, keepdims=True)
    assert_allclose(toward, look().los_n, atol=1e-9)


@pytest.mark.parametrize("decay", [1e6, 3e6])
def test_the_field_has_the_correlation_that_the_covariance_assumes(decay):
    """exp(-d / decay) over the chord, for all pairs of 20 directions, over 4000 draws of waves and noise.

    The product of two unit normal numbers of correlation r has the variance 1 + r^2; that of waves which are
    drawn, too, is larger by a tenth at most. Largest of 190 pairs: 4.8 sigma is the 99.97 % band. A field
    without correlation or with half of the decay is outside by far.
    """
    drawn, points = draw(decay, 4000, np.random.default_rng(7))
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    expected = np.exp(-apart / decay)
    found = drawn.T @ drawn / len(drawn)
    off = np.abs(found - expected) / np.sqrt(1.1 * (1.0 + expected**2) / len(drawn))
    assert off.max() < 4.8
    for wrong in (np.exp(-2.0 * apart / decay), np.eye(len(points))):
        assert (np.abs(found - wrong) / np.sqrt((1.0 + wrong**2) / len(drawn))).max() > 9.0


def test_one_draw_is_near_the_correlation():
    """Waves in strata: given the waves, all pairs are within 0.3 of the mean, and 0.12 in the mean square."""
    rng, decay = np.random.default_rng(3), 3e6
    points = field.locate_pierce_points(look(), np.zeros(len(DIRECTIONS), np.int64))
    apart = points[:, None] - points
    expected = np.exp(-np.linalg.norm(apart, axis=2) / decay)
    off = []
    for _ in range(50):
        waves = field.draw_waves(rng.standard_normal((field.WAVES, 4)), decay)
        off.append(np.cos(apart @ waves.T).mean(axis=2) - expected)
    assert np.abs(off).max() < 0.3
    assert np.sqrt(np.mean(np.square(off))) < 0.12


def test_lengths_of_waves_are_those_of_their_chances():
    """The distribution of the length of a Cauchy vector, inverted; one length in each stratum, each way."""
    normal, decay = np.random.default_rng(5).standard_normal((field.WAVES, 4)), 2e6
    waves = field.draw_waves(normal, decay)
    r = np.linalg.norm(waves, axis=1) * decay
    chance = 2.0 / np.pi * (np.arctan(r) - r / (1.0 + r**2))
    assert_allclose(chance * field.WAVES, np.arange(field.WAVES) + ndtr(normal[:, 3]), rtol=0, atol=1e-3)
    assert_allclose(np.cross(waves, normal[:, :3]), 0.0, atol=1e-12)
    assert (np.einsum("wi,wi->w", waves, normal[:, :3]) > 0).all()


def test_between_its_steps_the_field_is_a_line():
    """Of cosines and sines of the phase of each wave; the steps begin an epoch before the first."""
    rng, count = np.random.default_rng(6), 5
    amplitudes, waves = rng.normal(size=(3, 2 * count)), rng.normal(size=(count, 3)) * 1e-6
    points, epoch = rng.normal(size=(7, 3)) * 6e6, np.arange(7)
    found = np.empty(7)
    field.field_kernel(1, 4, amplitudes, waves, points, epoch, found)
    phase = points @ waves.T
    whole = (np.hstack([np.cos(phase), np.sin(phase)]) @ amplitudes.T) / np.sqrt(count)
    expected = [np.interp((k + 1) / 4, np.arange(3), whole[k]) for k in range(7)]
    assert_allclose(found, expected, rtol=0, atol=1e-12)


def columns(anchors, whiten, decay):
    kernel = plain(ionosphere_anchors.ionosphere_kernel)
    seen, rows, left = look(), [], []
    for k in range(len(DIRECTIONS)):
        out = np.empty(len(anchors))
        n, e, _ = seen.los_n[k]
        left.append(kernel(seen.el[k], n, e, np.hypot(n, e), 2.0, anchors, whiten, decay, out))
        rows.append(out)
    return np.array(rows), np.array(left)


def test_the_states_of_the_anchors_give_every_satellite_its_variance_and_near_ones_their_correlation():
    """Gaussian regression written out, k' K^-1 k; what is left makes the variance whole.

    From 20 deg on, where most satellites are, pairs keep their covariance within 0.25 of the variance.
    """
    decay, anchors = 3e6, ionosphere_anchors.ANCHORS
    H, left = columns(anchors, ionosphere_anchors.whiten_anchors(decay), decay)
    seen = look()
    points = least_squares.find_pierce_points(seen.los_n, seen.el)
    k = np.exp(-np.linalg.norm(points[:, None] - anchors, axis=2) / decay)
    K = np.exp(-np.linalg.norm(anchors[:, None] - anchors, axis=2) / decay)
    assert_allclose(H @ H.T, 4.0 * k @ np.linalg.inv(K) @ k.T, rtol=0, atol=1e-12)
    assert_allclose((H**2).sum(axis=1) + left, 4.0, rtol=1e-12)
    assert (left > 0).all()
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    off = H @ H.T + np.diag(left) - 4.0 * np.exp(-apart / decay)
    assert np.abs(off[4:, 4:]).max() < 0.25 * 4.0


def test_the_errors_of_fixes_are_those_that_their_covariance_claims():
    """NEES of least-squares fixes on 600 draws of the field, weights by the receiver's covariance: horizontal
    over 2 and height. With ranges taken as independent both are outside their bands."""
    from scipy.linalg import cho_factor, cho_solve

    rng, decay = np.random.default_rng(11), 3e6
    drawn, _ = draw(decay, 600, rng)
    seen = look()
    slant = 1.0 + 16.0 * (0.53 - seen.el / np.pi) ** 3
    error = drawn * slant + 0.3 * rng.standard_normal(drawn.shape)
    H = np.column_stack([-seen.los_n, np.ones(len(slant))])
    points = least_squares.find_pierce_points(seen.los_n, seen.el)
    cor = np.exp(-np.linalg.norm(points[:, None] - points, axis=2) / decay)
    nees = []
    for together in (cor, np.eye(len(slant))):
        R = cho_factor(together * np.outer(slant, slant) + 0.09 * np.eye(len(slant)))
        P = np.linalg.inv(H.T @ cho_solve(R, H))
        x = (P @ H.T @ cho_solve(R, error.T)).T
        level = np.einsum("mi,ij,mj->m", x[:, :2], np.linalg.inv(P[:2, :2]), x[:, :2])
        nees.append((np.mean(level) / 2.0, np.mean(x[:, 2] ** 2 / P[2, 2])))
    for axes, (right, wrong) in zip((2, 1), zip(*nees, strict=True), strict=True):
        low, high = band(axes * len(drawn))
        assert low < right < high
        assert not low < wrong < high
