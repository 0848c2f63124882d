"""What a file of others must be before it is opened."""

from __future__ import annotations

import stat
from pathlib import Path

from bench.errors import ConfigError


def check_file(path: Path, shown: str, most: int) -> None:
    """Check that a file can be read to its end; a pipe or a device may have none.

    Parameters
    ----------
    path : Path
        A folder is left to the reader.
    shown : str
        What messages call it.
    most : int
        Largest size [byte].

    Raises
    ------
    ConfigError
        If it is no regular file, or larger.
    OSError
        If it cannot be looked at.
    """
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise ConfigError(f"{shown}: not a regular file")
    if found.st_size > most:
        raise ConfigError(f"{shown}: larger than {most // 1_000_000} MB")
