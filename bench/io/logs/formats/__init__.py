"""Read files of autopilots and other tools as the rows of a log; each module reads one format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from bench.core.words.exceptions import ConfigError
from bench.io.log_formats import find_format
from bench.io.logs.formats.unreadable import explain_missing
from bench.io.logs.rows import LogRows


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of one sensor in a file.

    Parameters
    ----------
    form : str
        One of `bench.io.log_formats.list_names`, but no table.
    path : Path
        The file, or the folder of a ROS 2 bag.
    kind : str
        "imu", "gnss" or an instrument.
    topic : str or None
        Topic in the file; None if the file has only one.

    Raises
    ------
    ConfigError
        If the file is broken, is not of this format, or has no such rows: one line.
    """
    found = find_format(form)
    with explain_missing(found.package, path):
        rows = import_module(found.module).read(form, path, kind, topic)
    if not isinstance(rows, LogRows):
        what = f"log format {form!r} of {found.brought_by}"
        raise ConfigError(f"{path.name}: {what}: read gives no LogRows, but {type(rows).__name__}")
    return rows
