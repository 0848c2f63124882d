"""Files of GNSS receivers: observations, ephemerides and almanacs, read by what ``bench.fixes`` adds.

A module of that group has ``recognises(path) -> bool`` and

- ``read_almanac(path, near, shown) -> KeplerSets``: the satellites of an almanac near a time;
- ``read_orbits(paths) -> Orbits``: the satellites of navigation files;
- ``read_ranges(source, gnss) -> RecordedRanges``: what ranges tell beside a recorded IMU, as
  `bench.io.logs.log_ranges` says.

Times are in seconds since 1980-01-06.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from bench.core.files.installed import find_installed, find_own
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.orbit_sets import GlonassSets, KeplerSets


class Orbits(NamedTuple):
    """The satellites of navigation files."""

    shown: str  # names of the files
    sets: Mapping[int, KeplerSets | GlonassSets]  # by system
    klobuchar: FloatArray | None  # (8,) ionosphere


def find_reader(path: Path) -> Any:
    """Return the module that reads a file: another package's only where that of bench does not know it."""
    (own,) = (import_module(place) for place in find_own("fixes").values())
    others = find_installed("fixes", find_own("fixes")) if path.is_file() else {}
    if others and not own.recognises(path):
        for other in others.values():
            module = import_module(other.place)
            if module.recognises(path):
                return module
    return own
