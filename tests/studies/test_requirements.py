"""The requirement curves against the table of the register (section 4, figures 2.4.1 and 2.4.2)."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

import bench
from bench import earth
from bench.studies import requirements

PRINTED = {  # outage s: accelerometer ug, gyro deg/h, for 5 m
    10: (10197, 631),
    30: (1133, 23.37),
    60: (283.4, 2.922),
    100: (102.1, 0.6315),
    120: (70.94, 0.3656),
    180: (31.60, 0.1085),
    300: (11.46, 0.02353),
    600: (2.97, 3.003e-3),
    900: (1.40, 9.21e-4),
    1800: (0.49, 1.39e-4),
    2532: (0.39, 6.39e-5),
    3600: (0.63, 3.69e-5),
}


@pytest.fixture(scope="module")
def found():
    return bench.study("requirements")


@pytest.fixture(scope="module")
def columns(found):
    return {name: np.array(values) for name, values in found.tables["requirements"].columns.items()}


def test_16_the_closed_form_is_the_table_of_the_register(columns):
    """As many digits as are printed."""
    assert columns["outage_s"].tolist() == list(PRINTED)
    for k, name in enumerate(("accel_ug", "gyro_deg_h")):
        for found, row in zip(columns[name].tolist(), PRINTED.values(), strict=True):
            digits = len(f"{row[k]:e}".split("e")[0].replace(".", "").rstrip("0"))
            assert float(f"{found:.{max(digits, 2) - 1}e}") == pytest.approx(row[k], rel=1e-12)


def test_16_the_strapdown_with_one_bias_agrees_within_2_percent(columns):
    """To an hour: a strapdown that forgot the rate of the Earth is off by 18 % then."""
    near = columns["outage_s"] >= 60
    for name in ("accel_{}ug", "gyro_{}deg_h"):
        assert_allclose(columns[name.format("simulated_")][near], columns[name.format("")][near], rtol=0.02)


def test_a_gyro_is_allowed_less_where_gravity_is_larger():
    """Over a minute the position errs by g times drift times t^3 / 6."""
    at = {lat: bench.study("requirements", outages_s=[60], lat_deg=lat) for lat in (0.0, 60.0)}
    equator, north = (one.tables["requirements"].columns["gyro_simulated_deg_h"][0] for one in at.values())
    gravity = [float(earth.gravity_n(np.deg2rad(lat), 0.0)[2]) for lat in at]
    assert equator / north == pytest.approx(gravity[1] / gravity[0], rel=1e-4)


def test_the_answer_is_for_one_five_and_ten_minutes(found):
    for seconds, accel, gyro in ((60, 283.4, 2.922), (300, 11.46, 0.02353), (600, 2.967, 0.003003)):
        assert f"{seconds} s without GNSS leave {accel} ug or {gyro} deg/h" in found.verdicts[0]


def test_closed_form_and_strapdown_lie_on_each_other_in_two_colours(found, columns):
    assert len(found.figures) == 2
    for figure, limit in zip(found.figures.values(), ("accel_ug", "gyro_deg_h"), strict=True):
        line, dots = figure.series
        assert line.colours != dots.colours
        there = np.interp(np.log(columns["outage_s"]), np.log(line.t), line.values[:, 0])
        assert_allclose(there, columns[limit], rtol=0.01)
        near = (dots.t >= 60) & (dots.t <= 600)
        assert_allclose(dots.values[near, 0], columns[limit][near], rtol=0.02)


def test_the_answer_has_no_power_of_ten():
    first, second = requirements._tell(2e4, np.array([10.0]), np.array([[10197.0, 631.0]]), np.empty(0))
    assert "10 s without GNSS leave 10200 ug or 631 deg/h" in first
    assert "2532 s: 1600 ug" in second
