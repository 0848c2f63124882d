"""Errors of an alignment: across track, along a course, of a quaternion, and by two vectors."""

from __future__ import annotations

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

import bench
from bench.core.records.findings import series
from bench.core.words.exceptions import ConfigError
from bench.plugins.papers import alignment_errors

RADIUS = 6_371_000.0


@pytest.fixture(scope="module")
def found():
    return bench.study("alignment", jobs=1, runs=400, duration_s=1200.0)


def columns(found, name):
    return {key: np.array(values) for key, values in found.tables[name].columns.items()}


def test_54_a_short_leg_is_a_triangle_and_the_allowed_error_leads_back(found):
    """On a short leg length times the error; 1738.2 m on 1000 km; to the allowed error belongs its limit."""
    table = columns(found, "route")
    by_length = dict(zip(table["length_km"], table["cross_track_m"], strict=True))
    assert by_length[50.0] == pytest.approx(50e3 * np.deg2rad(0.1), rel=2e-4)
    assert by_length[1000.0] == pytest.approx(1738.2, abs=0.05)
    for km, allowed in zip(table["length_km"], table["allowed_deg"], strict=True):
        off = RADIUS * np.arcsin(np.sin(1e3 * km / RADIUS) * np.sin(np.deg2rad(allowed)))
        assert off == pytest.approx(1000.0)
    assert alignment_errors.find_allowed(500.0, 1000.0) is None


def test_19_the_descriptions_are_one_and_only_gyro_errors_change_that_in_inertial_axes(found):
    table = columns(found, "course")
    inertial = np.column_stack([table[f"delta_u_{k}_arcsec"] for k in "123"])
    delta = np.column_stack([table[f"delta_{k}_arcsec"] for k in "123"])
    assert_allclose(np.linalg.norm(delta, axis=1), np.linalg.norm(inertial, axis=1), rtol=1e-9)
    grown = np.linalg.norm(inertial[-1] - inertial[0])
    assert grown == pytest.approx(np.sqrt(3.0) * 0.01 * 1200.0, rel=0.01)  # deg/h for s are arcsec
    alpha = [table[f"alpha_{k}_arcsec"][0] for k in "123"]
    assert_allclose(alpha, [0.0, 0.0, 360.0])
    assert float(found.verdicts[1].rpartition("within ")[2].removesuffix(" rad.")) < 1e-15


def test_53_the_integral_is_the_difference_of_two_integrations(found):
    table = columns(found, "quaternion")
    assert table["apart_arcsec"].max() < 1e-4 * table["exact_arcsec"].max()
    assert table["exact_arcsec"][-1] > 5.0
    assert (np.diff(table["exact_arcsec"]) > 0).all()


def test_53_the_turn_is_that_of_a_constant_error_along_a_turning_body(found):
    """By hand: along the axis of the turn the error grows with time, across it as a chord of the turn."""
    table, turn = columns(found, "quaternion"), np.array([0.05, -0.02, 0.1])
    rate, error = np.linalg.norm(turn), np.full(3, np.deg2rad(0.01) / 3600.0)
    along = error @ turn / rate
    across = np.linalg.norm(error - along * turn / rate)
    t = table["t_s"]
    assert t[-1] == pytest.approx(600.0)
    size = np.hypot(along * t, across * 2.0 * np.sin(0.5 * rate * t) / rate)
    assert_allclose(table["exact_arcsec"], np.rad2deg(size) * 3600.0, atol=1e-3)


def test_the_words_and_pictures_are_those_of_the_tables(found):
    def digits(text):
        return [float(one) for one in re.findall(r"\d+(?:\.\d+)?(?:e-\d+)?", text)]

    course, quaternion, vectors = (columns(found, name) for name in ("course", "quaternion", "vectors"))
    sizes = {
        name: np.linalg.norm([course[f"{name}_{k}_arcsec"] for k in "123"], axis=0)
        for name in ("alpha", "delta_u")
    }
    leg, along, turned, told, _ = found.verdicts
    assert leg.startswith("0.1 deg of heading lead across track: 50 km 87.27 m, 100 km 174.5 m,")
    expected = [1200.0, 0.01, *sizes["alpha"][[0, -1]], sizes["delta_u"][-1]]
    assert_allclose(digits(along)[:5], expected, rtol=1e-3)
    end = [quaternion[name][-1] for name in ("integral_arcsec", "t_s", "exact_arcsec")]
    assert_allclose(digits(turned)[:3], end, rtol=1e-3)
    rows = np.column_stack([vectors[name][1:] for name in ("angle_deg", "largest_mrad", "drawn_mrad")])
    assert_allclose(digits(told), rows.astype(float).ravel(), rtol=6e-3)
    plots = {plot.path[1]: plot for plot in found.findings.figures}
    for name, key in (("alpha", "alpha"), ("delta", "delta"), ("delta_u", "delta-u")):
        for k, line in enumerate(plots[key].series, 1):
            drawn = np.interp(course["t_s"], line.t, np.ravel(line.values))
            assert_allclose(drawn, course[f"{name}_{k}_arcsec"], atol=1e-9)
    (route,) = plots["route"].series
    assert route.colors == series.ESTIMATORS[:1]
    assert np.interp(1000.0, route.t, np.ravel(route.values)) == pytest.approx(1738.2, rel=1e-3)
    assert (route.t[0], route.t[-1]) == pytest.approx((1.0, 5000.0))


def test_59_two_vectors_tell_the_attitude_as_their_angle_allows(found):
    """Beside each other the turn about the better one is told by the part of the other across it."""
    table = columns(found, "vectors")
    assert np.isnan(table["largest_mrad"].astype(float)[0])
    angles, largest = table["angle_deg"][1:], table["largest_mrad"][1:].astype(float)
    about_position = 1e3 * 0.0707 / (200.0 * np.sin(np.deg2rad(angles)))  # velocity across the position
    assert_allclose(largest, about_position, rtol=0.01)
    drawn = table["drawn_mrad"][1:].astype(float)
    assert_allclose(drawn, largest, rtol=3.3 / np.sqrt(2.0 * 400))
    assert (table["low_mrad"][1:] < drawn).all()
    assert "At 0 deg they are parallel" in found.verdicts[-1]


def test_the_seed_changes_the_draws_and_nothing_else():
    one, other = (
        bench.study("alignment", jobs=1, runs=20, duration_s=60.0, angles_deg="90", seed=seed)
        for seed in (1, 2)
    )
    first, second = (columns(each, "vectors") for each in (one, other))
    assert first["drawn_mrad"][0] != second["drawn_mrad"][0]
    assert first["largest_mrad"][0] == second["largest_mrad"][0]
    assert one.command.endswith("--seed 1")


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"lengths_km": "0,10"}, "lengths_km must be above 0"),
        ({"lat_deg": 79.0, "course_deg": 0.0, "speed_mps": 900.0}, "within 5 deg of a pole"),
    ],
)
def test_what_cannot_be_asked_is_one_line(given, message):
    with pytest.raises(ConfigError, match=message):
        bench.study("alignment", **given)


def test_the_interval_of_drawn_attitudes_holds_their_covariance():
    """Of 150 studies of 40 runs about 95 % hold it, 99.9 % band; one a tenth as wide would not."""
    held = 0
    for seed in range(150):
        _, by_cov, drawn, low, high, _ = alignment_errors.match_at(
            alignment_errors.Options(runs=40, seed=seed), 57.6
        )
        held += low <= by_cov <= high
        assert low * high == pytest.approx(drawn**2), "the interval is one of its logarithm"
    least, most = stats.binom.ppf([0.0005, 0.9995], 150, 0.95)
    assert least <= held <= most
