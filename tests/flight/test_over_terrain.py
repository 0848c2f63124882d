"""Flights over a grid of heights: the radar altimeter, turbulence, the leg that follows the ground."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.interpolate import RegularGridInterpolator

from bench.core.records.instruments import RadarSpec
from bench.core.words.exceptions import ConfigError, FlightError
from bench.io.config import read_profile
from bench.simulation.flight.legs.level import Straight
from bench.simulation.flight.legs.tracks import Point, TerrainFollowing, clear_heights
from bench.simulation.sensors import radar
from bench.simulation.sensors.draws import SensorDraws
from bench.simulation.signals.terrain import describe_terrain, ground_at
from tests.flight.plans import plan, record_whole, truth_of
from tests.valley import write_grid

SOUTH, WEST, CELL = 47.2, 11.2, 0.005  # [deg]
LATS, LONS = SOUTH + CELL * np.arange(25), WEST + CELL * np.arange(61)


@pytest.fixture
def describe(tmp_path):
    def written(heights):
        path = tmp_path / "grid.asc"
        path.write_text(write_grid(heights, SOUTH, WEST, CELL))
        return describe_terrain(path, "grid.asc", 0.0, None)

    return written


def hills(height=950.0, size=60.0):
    lat, lon = np.meshgrid(LATS, LONS, indexing="ij")
    return np.round(height + size * np.sin(radians(360) * (lon - WEST) / 0.04) * np.cos(150 * (lat - SOUTH)))


def test_the_radar_altimeter_tells_the_height_above_the_grid(describe):
    """Against the interpolator of SciPy, along a flight; where the grid has no height it sees nothing."""
    heights = hills()
    heights[12, 32] = np.nan  # below the end of the flight
    spec = describe(np.where(np.isnan(heights), -9999, heights))
    truth = truth_of(record_whole(plan(Straight(60.0))), 100.0)
    record, _ = radar.measure(truth, RadarSpec("exact", 10.0, 0.0, 2000.0), 0.0, SensorDraws(1, 0), spec)
    rows = np.searchsorted(truth.t, record.t - 1e-9)
    lat, lon, alt = truth.lla[rows].T
    ground = RegularGridInterpolator((LATS, LONS), heights)(np.degrees(np.column_stack([lat, lon])))
    assert 0 < np.isnan(ground).sum() < len(ground) / 2
    assert_array_equal(record.valid, ~np.isnan(ground))
    assert_allclose(record.height[record.valid], (alt - ground)[record.valid], atol=1e-6)
    assert np.ptp(record.height[record.valid]) > 30.0


def test_turbulence_is_that_of_the_height_above_the_grid(describe):
    """Over a grid that is level it is the same, bit for bit, as over flat ground; over hills it is not."""
    rough = plan(Straight(15.0), severity=3, flat_alt=950.0)
    flat = truth_of(record_whole(rough), 100.0)
    level = replace(rough, terrain=describe(np.full((25, 61), 950)), flat_alt=0.0)
    assert_array_equal(flat.lla, truth_of(record_whole(level), 100.0).lla)
    other = truth_of(record_whole(replace(rough, terrain=describe(hills()))), 100.0)
    assert np.abs(flat.lla - other.lla)[:, 2].max() > 0.01


def test_a_flight_that_leaves_the_grid_or_meets_the_ground_says_so(describe):
    spec = describe(np.full((25, 61), 950))
    west = plan(Straight(60.0), terrain=spec, lon=radians(11.205), heading=radians(270.0))
    with pytest.raises(FlightError, match=r"at \d+\.\d s: grid.asc has no height at 47.26\d*, 11.20000 deg"):
        record_whole(west)
    heights = np.full((25, 61), 950)
    heights[:, 31:] = 1300
    with pytest.raises(FlightError, match="flew into the ground"):
        record_whole(plan(Straight(60.0), terrain=describe(heights)))


def test_heights_that_clear_the_ground_are_never_below_it_nor_too_steep():
    """Any ground: 0 m below, at most the slope; where the ground is flatter than that they are 0 m above."""
    rng = np.random.default_rng(3)
    for slope in (0.05, 0.12):
        least = 600 + 30 * np.cumsum(rng.standard_normal(400)) * (np.arange(400) > 60)
        heights = clear_heights(least, 20.0, slope, 9)
        assert (heights >= least - 1e-9).all()
        assert np.abs(np.diff(heights)).max() <= slope * 20.0 + 1e-9
        assert_allclose(heights[:10], np.maximum(heights[:10], 600.0), atol=1e-9)
    assert_allclose(clear_heights(np.full(50, 700.0), 20.0, 0.1, 9), 700.0, atol=1e-9)
    ridge = np.where(np.arange(200) == 100, 800.0, 700.0)
    flown = clear_heights(ridge, 20.0, 0.1, 9)
    assert_allclose(flown[60:70], 800.0 - 0.1 * 20.0 * (np.arange(40, 30, -1) - 4), atol=1e-9)
    assert flown[0] == flown[-1] == 700.0


def test_the_leg_keeps_its_height_above_the_ground(describe):
    """Never more than 6 m below, and over the hills it follows them."""
    spec = describe(hills(size=25.0))
    leg = TerrainFollowing((Point(north=0.0, east=4000.0),), radians(30.0), 150.0)
    truth = truth_of(record_whole(plan(leg, terrain=spec, alt=1130.0, heading=radians(90.0))), 100.0)
    lat, lon, alt = truth.lla.T
    above = alt - ground_at(spec, lat, lon)
    assert above.min() > 144.0
    assert np.percentile(above, 50) < 185.0
    assert np.ptp(alt[len(alt) // 4 :]) > 15.0
    low = plan(leg, terrain=spec, alt=1080.0)
    with pytest.raises(FlightError, match=r"the ground ahead asks for 1\d\d\d m at the start: at 1080 m"):
        record_whole(low)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"terrain.file": "x.tif"}, "x.tif' must end in .hgt or .asc"),
        ({"terrain.file": "x.asc"}, "x.asc': no such file"),
        ({"terrain.alt_m": 3.0}, "[terrain] has file and alt_m; leave one of them out"),
        ({"start.lat_deg": 10.0}, "[terrain] file = 'valley.asc' has no height at the start"),
        ({"start.alt_m": 500.0}, "the ground at 584 m is not below the start at alt_m = 500 m"),
        ({"leg.2.points": [{"north_m": 0.0, "east_m": 1.0, "alt_m": 9.0}]}, "points[0]: unknown key 'alt_m'"),
        (
            {"estimator.1.options": {"radar": True}},
            "'loose-15': options: radar = true takes a height for one",
        ),
        (
            {"guidance.navigation": "loose-15", "guidance.options": {"radar": True}},
            "[guidance]: options: radar = true takes a height for one",
        ),
    ],
)
def test_what_does_not_fit_a_terrain_is_refused(changes, said):
    with pytest.raises(ConfigError) as raised:
        read_profile("terrain-following", changes)
    assert any(said in line for line in raised.value.messages), raised.value.messages


def test_the_file_counts_and_not_where_it_is(tmp_path):
    """A copy of the profile and its grid elsewhere has the same truth, another grid another."""
    from bench.io import results

    shipped = read_profile("terrain-following").flight
    moved = replace(shipped.terrain, path=tmp_path / "valley.asc")
    assert results.truth_key(shipped) == results.truth_key(replace(shipped, terrain=moved))
    other = replace(shipped.terrain, digest="0" * 64)
    assert results.truth_key(shipped) != results.truth_key(replace(shipped, terrain=other))
