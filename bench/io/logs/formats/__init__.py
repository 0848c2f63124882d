"""Read files of autopilots and other tools as the rows of a log; each module reads one format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from bench.io.logs.formats.unreadable import explain_missing
from bench.io.logs.rows import LogRows

_ADAPTERS = {
    "ulog": "bench.io.logs.formats.ulog",
    "dataflash": "bench.io.logs.formats.flash_rows",
    "rosbag": "bench.io.logs.formats.bags",
    "mcap": "bench.io.logs.formats.bags",
    "navego": "bench.io.logs.formats.navego_structures",
    "kf-gins": "bench.io.logs.formats.text",
    "rtklib": "bench.io.logs.formats.text",
}


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of one sensor in a file.

    Parameters
    ----------
    form : str
        "ulog", "dataflash", "rosbag", "mcap", "navego", "kf-gins" or "rtklib".
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
    with explain_missing(form, path):
        rows = import_module(_ADAPTERS[form]).read(form, path, kind, topic)
    assert isinstance(rows, LogRows)
    return rows
