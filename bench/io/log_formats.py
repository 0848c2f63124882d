"""The formats of recorded files: what bench reads, and what ``bench.logs`` adds.

A module of that group reads the format of its entry's name: ``read(form, path, kind, topic) -> LogRows`` as
`bench.io.logs.formats.read` says. It may have

- ``ENDINGS``, those of its files, ``(".xyz",)``, and ``recognises(path) -> bool`` for files of other endings;
- ``TOPICS = True`` if a log may say by ``topic`` what a file calls a sensor;
- ``look(path) -> Contents`` if a file knows of itself what it holds, and then ``read_truth(path) ->
  OwnMotion`` and ``read_estimate(path, instance) -> OwnEstimate`` (`bench.io.logs.log_contents`).

One of a plug-in of bench says in ``FORMAT`` what its row here is, so that it is known without an import.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

from bench.core.files.installed import find_installed, find_own, read_constant
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line


class LogFormat(NamedTuple):
    """A format of recorded files."""

    module: str = ""  # that reads it; none: `bench.io.logs.table_files`
    endings: tuple[str, ...] = ()  # of files that are this format if a log does not name another
    topics: bool = False  # names what it holds
    knows: bool = False  # of itself what it holds, as the log of an autopilot does
    package: str = ""  # that it needs
    recognises: Callable[[Path], bool] = lambda path: False


MATLAB = ".mat"
TABLES = (".csv", ".tsv", ".parquet", MATLAB)

FORMATS: Mapping[str, LogFormat] = {
    "table": LogFormat(endings=TABLES),
    **{name: LogFormat(place, **read_constant(place, "FORMAT")) for name, place in find_own("logs").items()},
    "rosbag": LogFormat("bench.io.logs.formats.bags", (".bag", ".db3"), topics=True, package="rosbags"),
    "mcap": LogFormat("bench.io.logs.formats.bags", (".mcap",), topics=True, package="mcap"),
    "navego": LogFormat("bench.io.logs.formats.navego_structures", topics=True),
    "kf-gins": LogFormat("bench.io.logs.formats.text"),
    "rtklib": LogFormat("bench.io.logs.formats.text", (".pos",)),
}
"""Name of a format of bench -> the format; a table is a CSV, Parquet or MATLAB file."""


@cache
def list_formats() -> dict[str, LogFormat]:
    """Return all formats by name, those of other packages last; their modules are imported.

    Raises
    ------
    ConfigError
        If one of these cannot be imported, or has no function ``read``.
    """
    added = find_installed("logs", FORMATS).items()
    return {**FORMATS, **{name: _ask(name, one.place, one.package) for name, one in added}}


def _ask(name: str, place: str, package: str) -> LogFormat:
    try:
        module = import_module(place)
    except ImportError as error:
        raise ConfigError(f"log format {name!r} of {package}: {one_line(str(error))}") from error
    if not callable(getattr(module, "read", None)):
        raise ConfigError(f"log format {name!r} of {package}: {place} has no function read")
    endings = getattr(module, "ENDINGS", ())
    if not (isinstance(endings, tuple) and all(isinstance(one, str) for one in endings)):
        raise ConfigError(
            f"log format {name!r} of {package}: ENDINGS must be a tuple of texts; got {endings!r:.60}"
        )
    return LogFormat(
        place,
        tuple(one.lower() for one in endings),
        bool(getattr(module, "TOPICS", False)),
        callable(getattr(module, "look", None)),
        recognises=getattr(module, "recognises", LogFormat().recognises),
    )


def guess_format(path: Path) -> str | None:
    """Return the format of a file by its ending or its content; None if nothing tells it."""
    formats = list_formats()
    named = (name for name, one in formats.items() if path.suffix.lower() in one.endings)
    known = (name for name, one in formats.items() if path.is_file() and one.recognises(path))
    return next(named, None) or next(known, None)
