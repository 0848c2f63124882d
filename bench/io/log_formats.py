"""Formats of recorded files: built-in formats, and formats from ``bench.logs`` entry points.

A module of that group reads the format of its entry's name: ``read(form, path, kind, topic) -> LogRows`` as
`bench.io.logs.formats.read` says. It may have

- ``ENDINGS``, those of its files, ``(".xyz",)``, and ``recognizes(path) -> bool`` for files of other endings;
- ``TOPICS = True`` if a log may say by ``topic`` what a file calls a sensor;
- ``look(path) -> Contents`` if a file knows of itself what it holds, and then ``read_truth(path) ->
  OwnMotion`` and ``read_estimate(path, instance) -> OwnEstimate`` (`bench.io.logs.log_contents`).

One of a plug-in of bench says in ``FORMAT`` what its row here is, so that it is known without an import.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from bench.core.files.installed import Installed, find_installed, find_own, import_installed, read_constant
from bench.core.words.exceptions import ConfigError
from bench.io.logs.file_kinds import GNSSLOGGER, NMEA, NOVATEL, NOVATEL_BINARY, is_kind


class LogFormat(NamedTuple):
    """A format of recorded files."""

    module: str = ""  # that reads it; none: `bench.io.logs.table_files`
    endings: tuple[str, ...] = ()  # of files that are this format if a log does not name another
    topics: bool = False  # names what it holds
    fixes: bool = False  # contains fixes alone, as a file beside that of an IMU
    knows: bool = False  # of itself what it holds, as the log of an autopilot does
    package: str = ""  # that it needs
    recognizes: Callable[[Path], bool] | None = None  # files of other endings
    brought_by: str = ""  # another package


def _is_trajectory(path: Path) -> bool:
    return bool(import_module(POSES).recognizes(path))


def _is_novatel(path: Path) -> bool:
    return is_kind(NOVATEL, path) or is_kind(NOVATEL_BINARY, path)


POSES = "bench.io.logs.formats.pose_files"
"""Module of trajectories, which is imported when a file is looked at."""
NAV = ".nav"
"""Ending of a solution of KF-GINS."""
MATLAB = ".mat"
TABLES = (".csv", ".tsv", ".parquet", MATLAB)

FORMATS: Mapping[str, LogFormat] = {
    "table": LogFormat(endings=TABLES),
    **{name: LogFormat(place, **read_constant(place, "FORMAT")) for name, place in find_own("logs").items()},
    "rosbag": LogFormat("bench.io.logs.formats.bags", (".bag", ".db3"), topics=True, package="rosbags"),
    "mcap": LogFormat("bench.io.logs.formats.bags", (".mcap",), topics=True, package="mcap"),
    "navego": LogFormat("bench.io.logs.formats.navego_structures", topics=True),
    "kf-gins": LogFormat("bench.io.logs.formats.text"),
    "novatel": LogFormat("bench.io.logs.formats.novatel", topics=True, recognizes=_is_novatel),
    "gnsslogger": LogFormat("bench.io.logs.formats.gnsslogger", recognizes=partial(is_kind, GNSSLOGGER)),
    "nmea": LogFormat(
        "bench.io.logs.formats.nmea_sentences", (".nmea",), fixes=True, recognizes=partial(is_kind, NMEA)
    ),
    "poses": LogFormat(POSES, (".tum", ".sbet"), recognizes=_is_trajectory),
    "rtklib": LogFormat("bench.io.logs.formats.text", (".pos",), fixes=True),
}
"""Name of a format of bench -> the format; a table is a CSV, Parquet or MATLAB file."""


def list_names() -> list[str]:
    """Return the names of all formats, formats of other packages last, without importing a package."""
    return [*FORMATS, *find_installed("logs", FORMATS)]


def find_format(name: str) -> LogFormat:
    """Return a format of `list_names`.

    Raises
    ------
    ConfigError
        If it is another package's and cannot be imported, or has no function ``read``.
    """
    return FORMATS[name] if name in FORMATS else _ask(find_installed("logs", FORMATS)[name])


def _ask(one: Installed) -> LogFormat:
    module = import_installed("log format", one, "read")
    endings = getattr(module, "ENDINGS", ())
    if not (isinstance(endings, tuple) and all(isinstance(ending, str) for ending in endings)):
        raise ConfigError(
            f"log format {one.name!r} of {one.package}: ENDINGS must be a tuple of texts; got {endings!r:.60}"
        )
    return LogFormat(
        one.place,
        tuple(ending.lower() for ending in endings),
        bool(getattr(module, "TOPICS", False)),
        knows=callable(getattr(module, "look", None)),
        recognizes=getattr(module, "recognizes", None),
        brought_by=one.package,
    )


def guess_solution(path: Path) -> str | None:
    """Return the format of a solution that only a reference may be; None if it is another file."""
    if _is_trajectory(path):
        return "poses"
    return "kf-gins" if path.suffix.lower() == NAV else None


def guess_format(path: Path) -> str | None:
    """Return the format of a file by its ending or its content; None if neither identifies it.

    Formats of other packages are imported and tried only if no format of bench has this ending.
    """
    ending = path.suffix.lower()
    if ending == ".bin" and _is_novatel(path):  # the ending of DataFlash, too
        return "novatel"
    if own := next((name for name, one in FORMATS.items() if ending in one.endings), None):
        return own
    known = (name for name, one in FORMATS.items() if one.recognizes and one.recognizes(path))
    if own := next(known, None):
        return own
    added = {name: _ask(one) for name, one in find_installed("logs", FORMATS).items()}
    named = (name for name, one in added.items() if ending in one.endings)
    asked = {name: one.recognizes for name, one in added.items() if one.recognizes and path.is_file()}
    return next(named, None) or next((name for name, knows in asked.items() if knows(path)), None)
