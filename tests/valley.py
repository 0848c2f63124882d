"""The ground of bench/profiles/valley.asc: a made-up valley along the runway, with rough sides.

``python -m tests.valley`` writes it again.
"""

from __future__ import annotations

import numpy as np

from bench.core.mathematics.earth import difference_n
from bench.io.config.listing import PROFILES

SOUTH, WEST, CELL, ROWS, COLUMNS = 47.16, 11.12, 0.0025, 81, 193  # [deg]
FILE = PROFILES / "valley.asc"
_THRESHOLD = np.radians([47.26, 11.34, 0.0])
_COURSE = np.radians(85.0)
_FLOOR, _RISE = 600.0, 1400.0  # [m]
_HALF_FLOOR, _SIDE = 900.0, 4500.0  # from the axis [m]


def make_heights() -> np.ndarray:
    """Heights (ROWS, COLUMNS) [m], the southernmost row first: smooth sides with forty waves on them."""
    lat, lon = np.meshgrid(SOUTH + CELL * np.arange(ROWS), WEST + CELL * np.arange(COLUMNS), indexing="ij")
    lla = np.stack([np.radians(lat), np.radians(lon), 0 * lat], axis=-1)
    north, east, _ = np.moveaxis(difference_n(lla, _THRESHOLD), -1, 0)
    along = north * np.cos(_COURSE) + east * np.sin(_COURSE)
    across = east * np.cos(_COURSE) - north * np.sin(_COURSE) + 250 * np.sin(along / 3000.0)
    up = np.clip((np.abs(across) - _HALF_FLOOR) / _SIDE, 0.0, 1.0)
    side = up * up * (3 - 2 * up)
    rng = np.random.default_rng(36)
    rough = np.zeros_like(lat)
    for length, direction, phase in zip(
        np.geomspace(900.0, 6000.0, 40), rng.uniform(0, np.pi, 40), rng.uniform(0, 2 * np.pi, 40), strict=True
    ):
        wave = (north * np.cos(direction) + east * np.sin(direction)) / length
        rough += length * np.cos(2 * np.pi * wave + phase)
    rough *= 120.0 / rough.std()
    return np.round(_FLOOR + _RISE * side + rough * (0.05 + 0.95 * side)).astype(int)


def write_grid(heights: np.ndarray, south: float, west: float, cell: float, void: int = -9999) -> str:
    """An ESRI ASCII grid of heights whose row 0 is the southernmost."""
    rows, columns = heights.shape
    head = f"ncols {columns}\nnrows {rows}\nxllcenter {west}\nyllcenter {south}\n"
    head += f"cellsize {cell}\nNODATA_value {void}\n"
    return head + "".join(" ".join(f"{h:.10g}" for h in row) + "\n" for row in heights[::-1])


if __name__ == "__main__":
    FILE.write_text(write_grid(make_heights(), SOUTH, WEST, CELL))
