"""Messages for a file that cannot be read: its package is missing, or it is damaged."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from bench.core.words.exceptions import ConfigError


@contextmanager
def explain_missing(needed: str, path: Path) -> Iterator[None]:
    """Raise ConfigError inside if the package that a format needs is not installed."""
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or not needed or not error.name.startswith(needed):
            raise
        raise ConfigError(f"{path.name}: needs the package {needed}: pip install {needed}") from None


def describe_damage(path: Path, error: BaseException) -> ConfigError:
    """Return the error for a file that the library of its format cannot read."""
    reason = " ".join(str(error).split())[:200]
    return ConfigError(f"{path.name}: cannot be read: {reason or type(error).__name__}")
