"""Locks on kernels: of two processes with one cache, one compiles a kernel and the other waits for it.

A lock covers one byte of a file in the cache folder. The system releases it when its process ends in
any way. Without such locks, as on Windows and in a cache that is read-only, each process compiles alone.
"""

from __future__ import annotations

import os
import sys
import time
import zlib
from functools import cache
from pathlib import Path

if sys.platform != "win32":
    import fcntl

PATIENCE = 120.0
"""Longest time to wait for another process, which may have been suspended [s]."""
_LOOK = 0.02  # between two attempts [s]


@cache
def _open(folder: Path) -> int:
    """Return the descriptor of the file of locks, open until the process ends: a close releases them."""
    folder.mkdir(parents=True, exist_ok=True)
    return os.open(folder / "locks", os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0), 0o666)


def _set(folder: Path, name: str, *, taken: bool) -> bool:
    """Take or release the lock of a name; return False if another process has it."""
    if sys.platform == "win32":
        return True
    try:
        descriptor = _open(folder)
    except OSError:  # a cache that can only be read
        return True
    try:
        operation = fcntl.LOCK_EX | fcntl.LOCK_NB if taken else fcntl.LOCK_UN
        fcntl.lockf(descriptor, operation, 1, zlib.crc32(name.encode()))
    except (BlockingIOError, PermissionError):
        return False
    except OSError:  # no such locks here
        return True
    return True


def lock(folder: Path, name: str) -> None:
    """Lock a kernel by its name; while another process has it, wait, but no longer than `PATIENCE`."""
    end = time.monotonic() + PATIENCE
    while not _set(folder, name, taken=True) and time.monotonic() < end:
        time.sleep(_LOOK)


def unlock(folder: Path, name: str) -> None:
    """Release a lock of this process."""
    _set(folder, name, taken=False)


def is_locked(folder: Path, name: str) -> bool:
    """Return whether another process has the lock."""
    free = _set(folder, name, taken=True)
    if free:
        unlock(folder, name)
    return not free
