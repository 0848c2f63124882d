"""Read TOML files that may be too large or too deep; one line describes an error."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.core.files.file_checks import check_file
from bench.core.words.exceptions import ConfigError

MOST_BYTES = 10_000_000
"""Largest TOML file that is read [byte]."""
_MOST_KEYS = 100_000  # in a file; one of 4 h of waypoints, a leg a second, has fewer
_LONGEST_KEY = 200  # [character]
_DEEPEST = 50  # tables and arrays within each other, and names in a dotted key
_NAME = r"(?:[\w-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_LONG_CHAIN = re.compile(rf"(?<![\w.-]){_NAME}(?:[ \t]*+\.[ \t]*+{_NAME}){{{_DEEPEST}}}")
"""A dotted key that is too long: the parser would need a time that grows with the square of its length."""


_KINDS = {
    "a profile": (("aircraft", "script", "trajectory"), "bench run takes it"),
    "a log": (("imu",), "bench navigate takes it, and bench tune with --log"),
    "a campaign": (("profiles",), "bench campaign takes it"),
}
"""Kind of a file -> keys of which only such a file has one, and what takes it."""


def check_kind(document: Mapping[str, Any], wanted: str, shown: str) -> None:
    """Raise ConfigError if a document is of another kind than ``wanted``, a key of `_KINDS`."""
    found = [kind for kind, (keys, _) in _KINDS.items() if not document.keys().isdisjoint(keys)]
    if found and wanted not in found:
        raise ConfigError(f"{shown}: {found[0]}, not {wanted}; {_KINDS[found[0]][1]}")


def read_toml(path: Path, shown: str) -> dict[str, Any]:
    """Return the content of a TOML file.

    Raises
    ------
    ConfigError
        If the file cannot be read, is too large or is not TOML. Messages call it ``shown``.
    """
    try:
        check_file(path, shown, MOST_BYTES)
        return _parse_toml(path.read_bytes().decode("utf-8"), shown)
    except FileNotFoundError:
        raise ConfigError(f"{shown}: no such file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{shown}: not a text file in UTF-8") from None
    except OSError as error:
        raise ConfigError(f"{shown}: {error.strerror or error}") from None
    except ValueError as error:  # a TOMLDecodeError, or a number with thousands of digits
        raise ConfigError(f"{shown}: not valid TOML: {error}") from None
    except RecursionError:
        raise ConfigError(f"{shown}: not valid TOML: too many brackets within brackets") from None


def _parse_toml(text: str, shown: str) -> dict[str, Any]:
    """Return the content of a TOML file; raise ConfigError if its keys are too many, too long or too deep.

    So it does for a text with a zero character.
    """
    if _LONG_CHAIN.search(text):
        raise ConfigError(f"{shown}: a dotted key has more than {_DEEPEST} names")
    if text.count("=") > _MOST_KEYS or text.count("[") > _MOST_KEYS:
        raise ConfigError(f"{shown}: more than {_MOST_KEYS} keys or tables")
    document = tomllib.loads(text)
    level: list[Any] = [document]
    for _ in range(_DEEPEST):
        keys = [key for item in level if isinstance(item, dict) for key in item]
        if (longest := max(keys, key=len, default="")) and len(longest) > _LONGEST_KEY:
            raise ConfigError(f"{shown}: the key {longest[:30]}... is longer than {_LONGEST_KEY} characters")
        values = [inner for item in level for inner in (item.values() if isinstance(item, dict) else item)]
        if any("\0" in value for value in values if isinstance(value, str)):  # no file has such a name
            raise ConfigError(f"{shown}: a text with the character \\u0000; leave it out")
        level = [value for value in values if isinstance(value, dict | list)]
        if not level:
            return document
    raise ConfigError(f"{shown}: more than {_DEEPEST} tables or arrays within each other")
