"""Heights of the ground by a file: rows from north to south, bilinear, level at a runway; bad files."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from bench.core.mathematics.earth import displace
from bench.core.records.flight_specs import Runway
from bench.core.words.exceptions import ConfigError
from bench.simulation.signals.terrain import describe_terrain, ground_at, read_grid
from tests.valley import FILE, make_heights, write_grid

SOUTH, WEST, CELL, ROWS, COLUMNS = 46.9, 10.8, 0.01, 31, 41  # [deg]
LATS, LONS = SOUTH + CELL * np.arange(ROWS), WEST + CELL * np.arange(COLUMNS)
LAT, LON = np.meshgrid(LATS, LONS, indexing="ij")
PLACES = np.random.default_rng(36).uniform((LATS[0], LONS[0]), (LATS[-1], LONS[-1]), (500, 2))


def plane(lat, lon):
    return 700.0 + 900.0 * (lat - SOUTH) - 400.0 * (lon - WEST)


def look(spec, lat, lon):
    return ground_at(spec, np.radians(lat), np.radians(lon))


@pytest.fixture
def describe(tmp_path):
    """The spec of heights (R, C), the southernmost row first, at the corner (lat, lon)."""

    def written(heights, south=SOUTH, west=WEST, cell=CELL, **more):
        path = tmp_path / "grid.asc"
        path.write_text(write_grid(np.asarray(heights), south, west, cell))
        return describe_terrain(path, "grid.asc", **{"geoid": 0.0, "runway": None, **more})

    return written


def test_a_plane_comes_back_everywhere(describe):
    """Bilinear interpolation is exact for it: rows, columns, axes and the level of the file are right."""
    spec = describe(plane(LAT, LON), geoid=47.5)
    assert_allclose(look(spec, *PLACES.T), plane(*PLACES.T) + 47.5, atol=1e-6)
    edges = [(LATS[0], LONS[0]), (LATS[-1], LONS[0]), (LATS[-1], LONS[-1])]
    assert_allclose(look(spec, *np.transpose(edges)), [plane(*edge) + 47.5 for edge in edges], atol=1e-6)
    outside = [(LATS[0] - 1e-4, LONS[3]), (LATS[3], LONS[-1] + 1e-4)]
    assert np.isnan(look(spec, *np.transpose(outside))).all()


def test_a_paraboloid_is_off_by_what_its_resolution_says(describe):
    """At most (h_xx + h_yy) step^2 / 8, in the middle of a cell exactly that."""

    def height(lat, lon):
        return 500.0 + 8e4 * (lat - SOUTH - 0.1) ** 2 + 5e4 * (lon - WEST - 0.2) ** 2

    spec = describe(height(LAT, LON))
    most = (2 * 8e4 + 2 * 5e4) * CELL**2 / 8
    off = look(spec, *PLACES.T) - height(*PLACES.T)
    assert off.min() > -1e-6
    assert 0.9 * most < off.max() <= most + 1e-6
    middle = LATS[4] + CELL / 2, LONS[7] + CELL / 2
    assert_allclose(look(spec, *middle) - height(*middle), most, atol=1e-6)


def test_a_tile_runs_from_north_to_south(tmp_path):
    """Big-endian, 3 arc seconds, both edges included; one void spoils the four cells that it belongs to."""
    n = np.arange(1201)
    heights = 2 * n[:, None] + n[None, :] - 500  # from the south-west corner
    heights[400, 700] = -32768
    path = tmp_path / "S03W072.hgt"
    path.write_bytes(heights[::-1].astype(">i2").tobytes())
    spec = describe_terrain(path, path.name, 0.0, None)
    rows, columns = np.array([0.0, 1200.0, 77.25, 399.5, 401.0]), np.array([0.0, 3.0, 900.5, 700.5, 702.0])
    found = look(spec, -3.0 + rows / 1200, -72.0 + columns / 1200)
    expected = 2 * rows + columns - 500
    expected[3] = np.nan
    assert_allclose(found, expected, atol=1e-6)
    assert (
        "1201 x 1201 heights, 3 arc seconds apart (92.1 m north, 92.7 m east)" in read_grid(spec).describe()
    )


def test_corners_are_half_a_cell_from_centers_and_the_date_line_is_none(tmp_path, describe):
    spec = describe([[1, 2], [3, 4]], south=-0.5, west=179.5, cell=1.0)
    assert_allclose(look(spec, 0.0, np.array([180.0, -180.0, -179.75])), [2.5, 2.5, 2.75], atol=1e-9)
    path = tmp_path / "corner.asc"
    text = write_grid(np.array([[1, 2], [3, 4]]), 10.0, 20.0, 0.5).replace("center", "corner").upper()
    path.write_text(text)
    spec = describe_terrain(path, path.name, 0.0, None)
    assert_allclose(look(spec, [10.25, 10.75], [20.25, 20.75]), [1.0, 4.0], atol=1e-9)


@pytest.mark.parametrize("west", [-180.0, 0.0])
def test_a_grid_around_the_earth_has_a_height_at_every_longitude(describe, west):
    lons = west + np.arange(0.0, 361.0, 1.0)
    spec = describe(np.tile(np.abs(np.remainder(lons + 180, 360) - 180), (2, 1)), west=west, cell=1.0)
    lon = np.append(np.random.default_rng(2).uniform(-180, 360, 200), [-180, -1e-13, 0, 180, 360])
    assert_allclose(look(spec, SOUTH, lon), np.abs(np.remainder(lon + 180, 360) - 180), atol=1e-9)


@pytest.mark.parametrize("west", [-179.5, 0.5])
def test_cells_around_the_earth_meet_behind_the_last(describe, west):
    """Of 360 columns the first follows the last: down from 10770 m to 0 m within a cell."""
    heights = np.tile(30.0 * np.arange(360), (2, 1))
    seam = west - 0.5
    lon = seam + np.array([-0.5, -0.25, 0.0, 0.25, 0.5, 0.75, 360.0, 180.0])
    by_hand = [10770.0, 8077.5, 5385.0, 2692.5, 0.0, 7.5, 5385.0, 5385.0]
    assert_allclose(look(describe(heights, west=west, cell=1.0), SOUTH, lon), by_hand, atol=1e-6)
    few_digits = describe(heights, west=west, cell=0.99999)
    assert_allclose(look(few_digits, SOUTH, seam), 5385.0, atol=0.01)
    one_missing = describe(heights[:, :359], west=west, cell=1.0)
    assert np.isnan(look(one_missing, SOUTH, seam - 0.5))


def test_the_ground_is_level_around_a_runway(describe):
    """300 m before the threshold to 3 km beyond, 100 m to either side; 300 m on it is that of the grid."""
    runway = Runway(np.radians(47.05), np.radians(11.0), 620.0, np.radians(70.0))
    spec = describe(plane(LAT, LON), runway=runway)
    along = np.array([-290.0, 0.0, 2990.0, 500.0, 500.0, -450.0, 3150.0, 500.0, 500.0, -610.0, 500.0])
    right = np.array([0.0, 95.0, -95.0, 99.0, -99.0, 0.0, 0.0, 250.0, -250.0, 0.0, 410.0])
    c, s = np.cos(runway.heading), np.sin(runway.heading)
    north, east = along * c - right * s, along * s + right * c
    lla = displace([runway.lat, runway.lon, runway.alt], np.column_stack([north, east, np.zeros_like(north)]))
    grid = ground_at(replace(spec, runway=None), lla[:, 0], lla[:, 1])
    share = np.array([0.0] * 5 + [0.5] * 4 + [1.0] * 2)
    assert_allclose(ground_at(spec, *lla[:, :2].T), 620.0 + share * (grid - 620.0), atol=0.15)
    assert (ground_at(spec, *lla[:5, :2].T) == 620.0).all()


def test_a_file_that_changed_is_not_used(describe, tmp_path):
    spec = describe(plane(LAT, LON))
    describe(plane(LAT, LON) + 1.0)
    with pytest.raises(ConfigError, match=r"grid.asc: it has changed since the profile was read"):
        ground_at(spec, 0.82, 0.19)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("ncols 3", "ncols three"), "grid.asc: ncols = 'three' is not a number"),
        (
            ("ncols 3", "ncols 1e9"),
            "grid.asc: nrows = 2 and ncols = 1e+09 must be whole numbers from 2, 4000000",
        ),
        *(
            (("ncols 3", f"ncols {n}"), "grid.asc: nrows = 2 and ncols = ")
            for n in ("inf", "1e400", "nan", "2.5")
        ),
        (("nrows 2", "nrows -inf"), "grid.asc: nrows = -inf and ncols = 3 must be whole numbers"),
        (("ncols 3", "ncols 0_3"), "grid.asc: ncols = '0_3' is not a number"),
        (("1 2 3", "1 1_0 3"), "grid.asc: a height is not a number: '1_0'"),
        (("ncols 3", "ncols 4"), "grid.asc: 6 heights; nrows x ncols = 8"),
        (("1 2 3", "1 2 3 4"), "grid.asc: more than 6 heights; nrows x ncols = 6"),
        (("cellsize 0.01\n", ""), "grid.asc: an ESRI ASCII grid begins with ncols, nrows, xllcorner or"),
        (("xllcenter", "yllcorner"), "grid.asc: an ESRI ASCII grid begins with ncols"),
        (
            ("xllcenter 10.8", "xllcenter 680000"),
            "map projections are not",
        ),
        (("cellsize 0.01", "cellsize -1"), "expected latitude and longitude"),
        (("cellsize 0.01", "cellsize nan"), "expected latitude and longitude"),
        (("1 2 3", "1 zwei 3"), "grid.asc: a height is not a number"),
        (("1 2 3", "1 inf 3"), "grid.asc: a height of inf m; ground is within 12000 m of the ellipsoid"),
        (("1 2 3", "1 2 -32768"), "grid.asc: a height of -32768 m; ground is within"),
        (("1 2 3\n4 5 6", "-9999 " * 6), "grid.asc: it contains no height"),
        (("1 2 3", "1 2 \xb3"), "grid.asc: not an ASCII file"),
    ],
)
def test_a_grid_that_is_none_is_refused_in_a_line(tmp_path, change, said):
    good = write_grid(np.array([[4, 5, 6], [1, 2, 3]]), SOUTH, WEST, CELL)
    path = tmp_path / "grid.asc"
    path.write_text(good.replace(*change), encoding="latin-1")
    with pytest.raises(ConfigError) as raised:
        describe_terrain(path, path.name, 0.0, None)
    (line,) = raised.value.messages
    assert said in line
    assert "\n" not in line


def test_a_tile_of_another_size_or_name_is_refused(tmp_path):
    for name, size, said in (
        ("N47E011.hgt", 100, "100 bytes; a tile has 2884802"),
        ("alps.hgt", 2884802, "the name of a tile must be its south-west corner: N47E011.hgt"),
        ("gone.hgt", None, "no such file"),
    ):
        if size is not None:
            (tmp_path / name).write_bytes(bytes(size))
        with pytest.raises(ConfigError, match=said):
            describe_terrain(tmp_path / name, name, 0.0, None)
    path = tmp_path / "N01E001.hgt"
    with path.open("wb") as file:
        file.truncate(70_000_000)
    with pytest.raises(ConfigError, match="larger than 60 MB"):
        describe_terrain(path, path.name, 0.0, None)


def test_the_shipped_valley_is_what_its_script_makes():
    assert_array_equal(read_grid(describe_terrain(FILE, FILE.name, 0.0, None)).heights, make_heights())
