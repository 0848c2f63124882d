"""Interface of the core to receiver files: `bench.io.fix_readers` describes these functions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.core.records.orbit_sets import KeplerSets
from bench.core.words.exceptions import ConfigError
from bench.io.fix_readers import Orbits
from bench.plugins.receiver import almanac
from bench.plugins.receiver.ranges_beside_imu import read_ranges as read_ranges
from bench.plugins.receiver.rinex import ephemerides
from bench.plugins.receiver.rinex.lines import find_kind


def recognizes(path: Path) -> bool:
    """Return whether a file is RINEX, SP3, UBX, SBF, RTCM 3 or a YUMA almanac."""
    try:
        find_kind(path, path.name)
    except ConfigError:
        with path.open("rb") as file:
            return file.read(100).lstrip().startswith(b"****")
    return True


def read_almanac(path: Path, near: float, shown: str) -> KeplerSets:
    """Return the satellites of a YUMA almanac near a time."""
    return almanac.read_yuma(path, near, shown)


def read_orbits(paths: Mapping[str, Path]) -> Orbits:
    """Return the satellites of RINEX navigation files by the names that messages call them.

    Raises
    ------
    ConfigError
        If a file is wrong, or a part of it cannot be used.
    """
    files = ephemerides.merge_navigation([ephemerides.read_navigation(path, f) for f, path in paths.items()])
    if files.lost:
        raise ConfigError(*files.reasons)
    sets = {system: of[0] for system, of in files.list_sets().items() if of}  # I/NAV
    return Orbits(files.shown, sets, files.klobuchar)
