"""Read files of autopilots and other tools as the rows of a log; each module reads one format."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path

from bench.errors import ConfigError
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
_PACKAGES = {"ulog": "pyulog", "rosbag": "rosbags", "mcap": "mcap"}


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


@contextmanager
def explain_missing(form: str, path: Path) -> Iterator[None]:
    """Raise ConfigError inside if the package of a format is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or not error.name.startswith(_PACKAGES.get(form, "-")):
            raise
        raise ConfigError(
            f"{path.name}: needs the package {_PACKAGES[form]}: pip install 'ins-gnss-bench[logs]'"
        ) from None


def describe_damage(path: Path, error: BaseException) -> ConfigError:
    """Return the error for a file that the library of its format cannot read."""
    reason = " ".join(str(error).split())[:200]
    return ConfigError(f"{path.name}: cannot be read: {reason or type(error).__name__}")
