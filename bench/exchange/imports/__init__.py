"""Read files of autopilots and other tools as the rows of a log; each module reads one format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from bench.exchange.imports.unreadable import explain_missing
from bench.exchange.rows import LogRows

_ADAPTERS = {
    "ulog": "bench.exchange.imports.ulog",
    "dataflash": "bench.exchange.imports.flash_rows",
    "rosbag": "bench.exchange.imports.bags",
    "mcap": "bench.exchange.imports.bags",
    "navego": "bench.exchange.imports.navego_structures",
    "kf-gins": "bench.exchange.imports.text",
    "rtklib": "bench.exchange.imports.text",
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
