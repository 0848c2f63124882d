"""Ground heights from a file, bilinear: an SRTM tile (.hgt) or an ESRI ASCII grid (.asc) in degrees.

An SRTM tile is named after its south-west corner (``N47E011.hgt``): n x n samples of a degree square,
edges included, big-endian, from north to south. An ESRI ASCII grid has six lines of header, then rows from
north to south; the samples are the centers of its cells.
"""

from __future__ import annotations

import hashlib
import math
import re
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.earth import difference_n, radii
from bench.core.records.flight_specs import Runway, TerrainSpec
from bench.core.words.exceptions import ConfigError

ENDINGS = (".hgt", ".asc")
"""Endings of the files that can be read."""

_MOST_BYTES = 60_000_000
_MOST_HEIGHTS = 4_000_000  # of an ASCII grid
_TILES = {2 * n * n: n for n in (1201, 3601)}  # bytes of an SRTM tile -> its samples along an edge
_TILE_NAME = re.compile(r"([NS])(\d\d)([EW])(\d\d\d)", re.IGNORECASE)
_TILE_VOID = -32768
_HEADER = re.compile(r"\s*([A-Za-z_]+)[ \t]+(\S+)[ \t]*(?:\r?\n|$)")
_HEADER_LINES = 6
_HIGHEST = 12_000.0  # no ground is further from the ellipsoid [m]
_AROUND = 0.01  # of a cell that columns around the Earth may miss or overlap, by the digits of the file
_BEFORE, _BEYOND, _BESIDE = 300.0, 3000.0, 100.0  # of a runway's threshold and centerline: level ground [m]
_ROUNDING = 1e-6  # of a place on the edge of a grid, in steps
_EDGE = 300.0  # in which level ground goes over to that of the grid [m]


@dataclass(frozen=True, eq=False, slots=True)
class TerrainGrid:
    """Heights at crossings of meridians and parallels; row 0 is the southernmost, column 0 westernmost.

    Columns that lie all around the Earth have the first again behind the last.
    """

    south: float  # [rad]
    west: float  # [rad]
    step: float  # between rows and between columns [rad]
    heights: FloatArray  # (R, C) [m]; NaN where there is none

    def heights_at(self, lat: ArrayLike, lon: ArrayLike) -> FloatArray:
        """Return the heights [m] at places (...) [rad]; NaN outside the grid and next to missing heights."""
        row = (np.asarray(lat, float) - self.south) / self.step
        beyond = np.asarray(lon, float) - self.west
        turns = np.floor((beyond + _ROUNDING * self.step) / math.tau)
        column = (beyond - math.tau * turns) / self.step
        rows, columns = self.heights.shape
        around = abs(columns * self.step - math.tau) < _ROUNDING * self.step
        ends = np.array([rows - 1, columns - (not around)])
        inside = (row > -_ROUNDING) & (row < ends[0] + _ROUNDING)
        inside &= (column > -_ROUNDING) & (column < ends[1] + _ROUNDING)
        row, column = (
            np.clip(np.where(inside, v, 0.0), 0, end) for v, end in zip((row, column), ends, strict=True)
        )
        i, j = (np.minimum(v.astype(np.int64), end - 1) for v, end in zip((row, column), ends, strict=True))
        y, x = row - i, column - j
        h, east = self.heights, (j + 1) % columns
        south = (1 - x) * h[i, j] + x * h[i, east]
        north = (1 - x) * h[i + 1, j] + x * h[i + 1, east]
        return np.where(inside, (1 - y) * south + y * north, np.nan)

    def describe(self) -> str:
        """Return size and resolution of the grid in words."""
        rows, columns = self.heights.shape
        lat = self.south + 0.5 * (rows - 1) * self.step
        north, east = radii(lat)
        size = f"{self.step * float(north):.3g} m north, {self.step * float(east) * math.cos(lat):.3g} m east"
        return f"{rows} x {columns} heights, {math.degrees(self.step) * 3600:.4g} arc seconds apart ({size})"


def describe_terrain(path: Path, shown: str, geoid: float, runway: Runway | None) -> TerrainSpec:
    """Read a file and return its spec.

    Parameters
    ----------
    path : Path
        An .hgt or .asc file.
    shown : str
        What messages call it.
    geoid : float
        Height of what the file counts from, above the ellipsoid [m].
    runway : Runway or None
        Around it the ground is level.

    Raises
    ------
    ConfigError
        If it cannot be read, is too large or is no such file: one line.
    """
    _, digest = _read(path, shown)
    return TerrainSpec(path.absolute(), digest, float(geoid), runway)


def ground_at(spec: TerrainSpec, lat: ArrayLike, lon: ArrayLike) -> FloatArray:
    """Return the ellipsoidal heights of the ground at places (...) [rad], (...) [m].

    NaN where the file has none. From 300 m before the threshold of the runway to 3 km beyond, 100 m to either
    side, all is at its height; within 300 m more it goes over to the grid.
    """
    ground = read_grid(spec).heights_at(lat, lon) + spec.geoid
    runway = spec.runway
    if runway is None:
        return ground
    here = np.stack(np.broadcast_arrays(np.asarray(lat, float), np.asarray(lon, float), runway.alt), axis=-1)
    at = difference_n(here, [runway.lat, runway.lon, runway.alt])
    c, s = math.cos(runway.heading), math.sin(runway.heading)
    along, across = at[..., 0] * c + at[..., 1] * s, at[..., 1] * c - at[..., 0] * s
    ahead = np.maximum(0.0, np.maximum(-_BEFORE - along, along - _BEYOND))
    share = np.clip(np.hypot(ahead, np.maximum(0.0, np.abs(across) - _BESIDE)) / _EDGE, 0.0, 1.0)
    level: FloatArray = np.where(share > 0, runway.alt + share * (ground - runway.alt), runway.alt)
    return level


def read_grid(spec: TerrainSpec) -> TerrainGrid:
    """Return the grid of a spec; raise a `ConfigError` if its file has changed since it was described."""
    return _read_again(spec.path, spec.digest)


@lru_cache(maxsize=2)
def _read_again(path: Path, digest: str) -> TerrainGrid:
    grid, found = _read(path, path.name)
    if found != digest:
        raise ConfigError(f"{path.name}: it has changed since the profile was read")
    return grid


def _read(path: Path, shown: str) -> tuple[TerrainGrid, str]:
    try:
        check_file(path, shown, _MOST_BYTES)
        raw = path.read_bytes()
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    if path.suffix.lower() == ".hgt":
        grid = _parse_tile(raw, path.stem, shown)
    elif path.suffix.lower() == ".asc":
        grid = _parse_ascii(raw, shown)
    else:
        raise ConfigError(f"{shown}: must end in {' or '.join(ENDINGS)}")
    return grid, hashlib.sha256(raw).hexdigest()


def _parse_tile(raw: bytes, stem: str, shown: str) -> TerrainGrid:
    named, n = _TILE_NAME.fullmatch(stem), _TILES.get(len(raw))
    if named is None:
        raise ConfigError(f"{shown}: the name of a tile must be its south-west corner: N47E011.hgt")
    if n is None:
        sizes = " or ".join(f"{size} ({side} x {side})" for size, side in _TILES.items())
        raise ConfigError(f"{shown}: {len(raw)} bytes; a tile has {sizes}")
    lat, lon = int(named[2]), int(named[4])
    south, west = -lat if named[1] in "Ss" else lat, -lon if named[3] in "Ww" else lon
    heights = np.frombuffer(raw, ">i2").reshape(n, n)[::-1]
    return _make_grid(south, west, 1 / (n - 1), np.where(heights == _TILE_VOID, np.nan, heights), shown)


def _parse_ascii(raw: bytes, shown: str) -> TerrainGrid:
    try:
        text = raw.decode("ascii")
    except UnicodeDecodeError:
        raise ConfigError(f"{shown}: not an ASCII file") from None
    header, place = dict[str, float](), 0
    while len(header) < _HEADER_LINES and (line := _HEADER.match(text, place)):
        try:
            header[line[1].lower()] = _parse_number(line[2])
        except ValueError:
            raise ConfigError(f"{shown}: {line[1]} = {line[2][:20]!r} is not a number") from None
        place = line.end()
    corner = [name for name in ("xllcorner", "xllcenter", "yllcorner", "yllcenter") if name in header]
    missing = [name for name in ("ncols", "nrows", "cellsize") if name not in header]
    if missing or [name[:4] for name in corner] != ["xllc", "yllc"]:
        named = "ncols, nrows, xllcorner or xllcenter, yllcorner or yllcenter, cellsize"
        raise ConfigError(f"{shown}: an ESRI ASCII grid begins with {named} and NODATA_value, a line each")
    rows, columns, cell = header["nrows"], header["ncols"], header["cellsize"]
    whole = rows.is_integer() and columns.is_integer()
    if not (whole and min(rows, columns) >= 2 and rows * columns <= _MOST_HEIGHTS):
        most = f"whole numbers from 2, {_MOST_HEIGHTS} heights at most"
        raise ConfigError(f"{shown}: nrows = {rows:g} and ncols = {columns:g} must be {most}")
    x, y = (header[name] + (0.5 * cell if name.endswith("corner") else 0.0) for name in corner)
    count = int(rows * columns)
    words = text[place:].split(maxsplit=count)  # a word more holds all that is too much
    if len(words) != count:
        found = f"more than {count}" if len(words) > count else str(len(words))
        raise ConfigError(f"{shown}: {found} heights; nrows x ncols = {count}")
    try:
        values = np.fromiter(map(_parse_number, words), float, count)
    except ValueError as error:
        raise ConfigError(f"{shown}: a height is not a number: {str(error)[:80]}") from None
    values[values == header.get("nodata_value", -9999.0)] = np.nan
    return _make_grid(y, x, cell, values.reshape(int(rows), int(columns))[::-1], shown)


def _parse_number(word: str) -> float:
    if "_" in word:  # which Python reads over
        raise ValueError(f"{word!r}")
    return float(word)


def _make_grid(south: float, west: float, step: float, heights: FloatArray, shown: str) -> TerrainGrid:
    rows, columns = heights.shape
    north, east = south + (rows - 1) * step, west + (columns - 1) * step
    if not (
        0 < step <= 1 and south >= -90 and north <= 90 and west >= -180 and east <= 540 and east - west <= 360
    ):
        where = f"{south:g} to {north:g} north, {west:g} to {east:g} east, a cell {step:g}"
        raise ConfigError(
            f"{shown}: {where}: expected latitude and longitude [deg]; map projections are not supported"
        )
    if abs(columns * step - 360) < _AROUND * step:
        step = 360 / columns
    if np.isnan(heights).all():
        raise ConfigError(f"{shown}: it contains no height")
    if not np.nanmax(np.abs(heights)) <= _HIGHEST:
        wrong = float(heights.flat[int(np.nanargmax(np.abs(heights)))])
        raise ConfigError(
            f"{shown}: a height of {wrong:g} m; ground is within {_HIGHEST:g} m of the ellipsoid"
        )
    return TerrainGrid(
        math.radians(south), math.radians(west), math.radians(step), np.ascontiguousarray(heights, float)
    )
