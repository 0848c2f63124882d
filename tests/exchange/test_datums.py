"""Output in other datums (equations #29)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bench.core.mathematics import earth

KYIV = np.array([np.deg2rad(50.0), np.deg2rad(30.0), 0.0])

# PROJ 9.5.1: cart +ellps=krass, helmert 23.57 -140.95 -79.8 0 -0.35 -0.79 -0.22 coordinate_frame, inv cart
PROJ = [((50.0, 30.0, 0.0), (49.999823515095, 29.998294978040, 14.8444)),
        ((60.0, 84.0, 200.0), (60.000723291621, 83.999368974757, 170.6583))]  # fmt: skip


@pytest.mark.parametrize("datum", earth.DATUMS)
def test_round_trip(datum):
    draw = np.random.default_rng(1)
    lla = np.column_stack(
        [draw.uniform(-1.5, 1.5, 100), draw.uniform(-3.1, 3.1, 100), draw.uniform(-100, 1e4, 100)]
    )
    there = earth.from_datum(earth.to_datum(lla, datum), datum)
    assert np.abs(earth.to_ecef(there) - earth.to_ecef(lla)).max() < 1e-3


@pytest.mark.parametrize(("given", "expected"), PROJ)
def test_sk42_equals_proj(given, expected):
    """Within 1 cm of the pipeline PROJ uses for 'Pulkovo 1942 to WGS 84 (20)'."""
    got = earth.from_datum([*np.deg2rad(given[:2]), given[2]], "SK-42")
    want = np.array([*np.deg2rad(expected[:2]), expected[2]])
    assert np.linalg.norm(earth.to_ecef(got) - earth.to_ecef(want)) < 0.01


def test_the_sign_of_the_rotation():
    """The whole shift at 50 N 30 E is 156.3 m; with the rotations reversed the point is 29.8 m elsewhere."""
    pos = earth.to_ecef(KYIV, earth.KRASOVSKY_1940)
    A, b = earth.compute_helmert(earth.DATUMS["SK-42"])
    right = A @ pos + b
    assert abs(np.linalg.norm(right - pos) - 156.3) < 0.1
    assert abs(np.linalg.norm(A.T @ pos + b - right) - 29.8) < 0.1
    y, z = np.deg2rad(
        [0.35 / 3600, 0.79 / 3600]
    )  # position vector convention: rotates the vector, +0.35, +0.79
    vector = np.array([[1.0, -z, y], [z, 1.0, 0.0], [-y, 0.0, 1.0]])
    assert_allclose(A, (1 - 0.22e-6) * vector, rtol=0, atol=1e-15)


def test_pz90_is_another_ellipsoid_of_the_same_axes():
    lla = earth.to_datum(KYIV, "PZ-90.11")
    assert 0.9 < lla[2] < 1.1  # the semi-major axis is 1 m shorter
    assert np.abs(lla[:2] - KYIV[:2]).max() * 6.4e6 < 0.1
