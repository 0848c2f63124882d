"""What is said of a file that cannot be read: its package is missing, or it is damaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.core.words.exceptions import ConfigError

_PACKAGES = {"ulog": "pyulog", "rosbag": "rosbags", "mcap": "mcap"}


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
