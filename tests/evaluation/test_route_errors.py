"""Across a great circle by vectors: how far the end of a leg is from the plane that was meant."""

from __future__ import annotations

import math

import numpy as np
import pytest

from bench.evaluation.errors.route_errors import RADIUS, allowed_heading_error, cross_track_error


@pytest.mark.parametrize(("length", "error"), [(1e5, 0.1), (5e6, 0.01), (9e6, -0.3)])
def test_a_heading_error_makes_what_is_allowed_for_it(length, error):
    assert pytest.approx(6.371e6) == RADIUS
    s = length / RADIUS
    end = np.array([math.cos(s), math.sin(s) * math.sin(error), math.sin(s) * math.cos(error)])
    across = RADIUS * math.asin(end[1])  # the meant leg lies in the plane y = 0
    assert cross_track_error(length, error) == pytest.approx(across)
    assert allowed_heading_error(length, across) == pytest.approx(error)


@pytest.mark.parametrize(
    ("length", "across", "said"),
    [
        (0.0, 1.0, "a leg of 0 m"),
        (0.501 * math.pi * RADIUS, 1.0, "must be shorter than 1.00075e"),
        (1000.0, 1001.0, "1001 m across track on 1000 m"),
        (1000.0, -1001.0, "across track"),
    ],
)
def test_what_no_heading_makes_is_refused(length, across, said):
    with pytest.raises(ValueError, match=said):
        allowed_heading_error(length, across)
    assert allowed_heading_error(1000.0, 999.9) < 0.5 * math.pi
