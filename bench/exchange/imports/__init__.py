"""Read files of autopilots and other tools as the rows of a log; each module reads one format."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path

from bench.errors import ConfigError
from bench.exchange.rows import LogRows

_ADAPTERS = {
    "ulog": "bench.exchange.imports.ulog",
    "rosbag": "bench.exchange.imports.bags",
    "mcap": "bench.exchange.imports.bags",
    "navego": "bench.exchange.imports.navego_structures",
    "kf-gins": "bench.exchange.imports.text",
    "rtklib": "bench.exchange.imports.text",
}
_PACKAGES = {"ulog": "pyulog", "rosbag": "rosbags", "mcap": "mcap"}


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of one sensor in a file.

    Parameters
    ----------
    form : str
        "ulog", "rosbag", "mcap", "navego", "kf-gins" or "rtklib".
    path : Path
        The file, or the folder of a ROS 2 bag.
    kind : str
        "imu", "gnss" or "baro".
    topic : str or None
        Topic in the file; None if the file has only one.

    Raises
    ------
    ConfigError
        If the file is broken, is not of this format, or has no such rows: one line.
    """
    adapter = import_module(_ADAPTERS[form])
    try:
        rows = adapter.read(form, path, kind, topic)
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith(_PACKAGES.get(form, "-")):
            raise
        raise ConfigError(
            f"{path.name}: needs the package {_PACKAGES[form]}: pip install 'ins-gnss-bench[logs]'"
        ) from None
    assert isinstance(rows, LogRows)
    return rows


def describe_damage(path: Path, error: BaseException) -> ConfigError:
    """Return the error for a file that the library of its format cannot read."""
    reason = " ".join(str(error).split())[:200]
    return ConfigError(f"{path.name}: cannot be read: {reason or type(error).__name__}")
