"""Size limit of the truth cache: the least recently read truths go first, never one that is being read."""

from __future__ import annotations

import contextlib
import hashlib
import json
import math
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from bench.core.files import durable
from bench.core.files.places import cache_folder
from bench.core.files.scratch import lock_folder, remove_abandoned
from bench.core.words.exceptions import ConfigError

LIMIT = "BENCH_CACHE_GB"
"""Environment variable: the largest size of the truth cache [GB]."""

_DEFAULT_GB = 2.0
_UNUSED = 30 * 86400.0  # longest time without use [s]


class CacheSize(NamedTuple):
    """Size of the truth cache."""

    folder: Path
    flights: int
    size: int  # [byte]
    limit: int  # [byte]


class _Entry(NamedTuple):
    folder: Path
    used: float  # last use, time of the file system [s]
    size: int  # [byte]


def measure_cache() -> CacheSize:
    """Return the present size of the truth cache and its limit.

    Raises
    ------
    ConfigError
        If the environment variable of the limit is no number.
    """
    root = cache_folder("truth")
    entries = _list_entries(root)
    return CacheSize(root, len(entries), sum(entry.size for entry in entries), read_limit())


def read_limit() -> int:
    """Return the largest size of the truth cache [byte].

    Raises
    ------
    ConfigError
        If the environment variable is no number.
    """
    text = os.environ.get(LIMIT) or str(_DEFAULT_GB)
    with contextlib.suppress(ValueError):
        if 0 <= (value := float(text)) < math.inf:
            return int(1e9 * value)
    raise ConfigError(f"{LIMIT} = {text!r} must be a number of GB, at least 0")


def trim_cache(limit: int, keep: Path | None = None) -> None:
    """Remove truths until they need at most ``limit`` bytes, and those that nobody read for 30 days.

    ``keep`` stays whatever its size, as do truths that a process reads. Scratch of killed processes goes.
    """
    root = cache_folder("truth")
    remove_abandoned(root)
    entries = sorted((e for e in _list_entries(root) if e.folder != keep), key=lambda entry: entry.used)
    size = sum(entry.size for entry in entries) + (_measure_folder(keep) if keep else 0)
    oldest = time.time() - _UNUSED
    for entry in entries:
        if size <= limit and entry.used >= oldest:
            break
        lock = lock_folder(entry.folder)
        if lock is not None:
            shutil.rmtree(entry.folder, ignore_errors=True)
            os.close(lock)
            shutil.rmtree(entry.folder, ignore_errors=True)  # a network file system keeps an open file
            size -= entry.size


@contextlib.contextmanager
def hold_entry(entry: Path) -> Iterator[None]:
    """Keep other processes from removing an entry while it is read."""
    lock = lock_folder(entry, shared=True)
    try:
        yield
    finally:
        if lock is not None:
            os.close(lock)


def write_hashed(path: Path, value: Any) -> None:
    """Write a value as JSON below its SHA-256, atomically."""
    text = json.dumps(value)
    durable.write(path, f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}")


def read_hashed(path: Path) -> dict[str, Any]:
    """Read a JSON object that `write_hashed` wrote.

    Raises
    ------
    OSError, ValueError
        If there is no such file, or it was changed.
    """
    code, _, text = path.read_text(encoding="utf-8").partition("\n")
    if hashlib.sha256(text.encode()).hexdigest() != code:
        raise ValueError(f"{path}: was changed")
    value: dict[str, Any] = json.loads(text)
    return value


def _list_entries(root: Path) -> list[_Entry]:
    """Return the truths in the cache; scratch of running processes has names that begin with a dot."""
    entries = []
    with contextlib.suppress(OSError):  # there is no cache
        for folder in root.glob("[!.]*"):
            with contextlib.suppress(OSError):  # just removed
                entries.append(_Entry(folder, folder.stat().st_mtime, _measure_folder(folder)))
    return entries


def _measure_folder(folder: Path) -> int:
    """Return the size of the files in a folder [byte]."""
    total = 0
    for path in folder.glob("*"):
        with contextlib.suppress(OSError):
            total += path.stat().st_size
    return total
