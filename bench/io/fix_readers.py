"""Files of GNSS receivers: observations, ephemerides and almanacs, with readers from ``bench.fixes``.

A module of that group has ``recognizes(path) -> bool`` and

- ``read_almanac(path, near, shown) -> KeplerSets``: the satellites of an almanac near a time;
- ``read_orbits(paths) -> Orbits``: the satellites of navigation files;
- ``read_ranges(observations, navigation, time_offset, gnss) -> RecordedRanges``: what the ranges in files
  tell beside a recorded IMU, with noise, masks, systems and carriers of a datasheet.

Times are in seconds since 1980-01-06.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from pathlib import Path
from typing import NamedTuple, TypeVar

from bench.core.files.installed import find_installed, find_own, import_installed
from bench.core.mathematics.arrays import FloatArray
from bench.core.records.data import GnssObservations
from bench.core.records.orbit_sets import GlonassSets, KeplerSets
from bench.core.records.run_records import SkyView
from bench.core.words.exceptions import ConfigError
from bench.io.logs.rows import LogRows

_Answer = TypeVar("_Answer")


class Orbits(NamedTuple):
    """The satellites of navigation files."""

    shown: str  # names of the files
    sets: Mapping[int, KeplerSets | GlonassSets]  # by system
    klobuchar: FloatArray | None  # (8,) ionosphere


class RecordedRanges(NamedTuple):
    """Ranges of a receiver and what follows from them, on the clock of a log [s]."""

    fixes: LogRows
    observations: GnssObservations | None  # if the datasheet that is assumed has a [sky]
    sky: SkyView
    lack: str  # why there are no observations, in words; empty: there are some


def ask_reader(path: Path, what: str, kind: type[_Answer], *given: object) -> _Answer:
    """Return the result of a function of the reader for a file, from another package if bench has no reader.

    Raises
    ------
    ConfigError
        If the file is wrong, or the reader of another package is none: a line that names the package.
    """
    (own,) = (import_module(place) for place in find_own("fixes").values())
    others = find_installed("fixes", find_own("fixes")).values() if path.is_file() else ()
    if others and not own.recognizes(path):
        for one in others:
            module = import_installed("reader of fixes", one, "recognizes")
            if module.recognizes(path):
                found = getattr(import_installed("reader of fixes", one, what), what)(*given)
                if not isinstance(found, kind):
                    wrong = f"{what} gives no {kind.__name__}, but {type(found).__name__}"
                    raise ConfigError(f"{path.name}: reader of fixes {one.name!r} of {one.package}: {wrong}")
                return found
    answer: _Answer = getattr(own, what)(*given)
    return answer
