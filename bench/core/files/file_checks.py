"""Checks of a foreign file before it is opened."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from bench.core.words.exceptions import ConfigError

_MOST_JSON = 200_000_000  # of a JSON file [byte]


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
        If it is not a regular file, or is larger than ``most``.
    OSError
        If it does not exist, or its folder cannot be read.
    """
    found = path.stat()
    if not (stat.S_ISREG(found.st_mode) or stat.S_ISDIR(found.st_mode)):
        raise ConfigError(f"{shown}: not a regular file")
    if found.st_size > most:
        raise ConfigError(f"{shown}: larger than {most // 1_000_000} MB")


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file that contains one object.

    Raises
    ------
    ConfigError
        If there is no such file, it cannot be read, or it holds something else.
    """
    try:
        check_file(path, str(path), _MOST_JSON)
        document = json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise ConfigError(f"{path}: not valid JSON: {error}") from None
    if not isinstance(document, dict):
        raise ConfigError(f"{path}: must contain one JSON object")
    return document
