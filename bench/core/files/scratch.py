"""Temporary folders that are removed even if their process is killed: then by the next run.

A process holds a lock (flock) in each of its folders, which the kernel releases when the process ends. So a
folder without a lock has lost its process, whatever process has its number now. The name of a folder holds a
code of the machine, because a lock may not be visible from another one; folders of other machines stay.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import secrets
import shutil
import stat
import sys
import tempfile
import uuid
from collections.abc import Iterator
from pathlib import Path

from bench.core.files import durable

if sys.platform != "win32":
    import fcntl

PREFIX = ".bench-scratch-"
"""What the names of temporary folders begin with."""

LOCK = "lock"
"""File in a folder that holds its lock."""

_UNLOCKED = ".bench-unlocked-"  # a folder has this name until its lock is held
_ASIDE, _NAME = "old", "name"  # a folder that `set_aside` moved, and a file with its name


@contextlib.contextmanager
def make_scratch(place: Path | None = None) -> Iterator[Path]:
    """Provide a temporary folder in ``place``, by default in the temporary folder of the system.

    It is removed at the end. Folders that killed processes left in the same place are removed first.
    """
    place = Path(tempfile.gettempdir()) if place is None else place
    remove_abandoned(place)
    code = secrets.token_hex(8)
    unlocked, folder = place / f"{_UNLOCKED}{code}", place / f"{PREFIX}{identify_machine()}-{code}"
    lock: int | None = None
    try:
        unlocked.mkdir(0o700)
        lock = lock_folder(unlocked)
        unlocked.rename(folder)
        yield folder
    finally:
        try:
            _end(unlocked, folder, lock)
        except KeyboardInterrupt:  # once more, because it came while this was under way
            _end(unlocked, folder, lock)
            raise


def set_aside(scratch: Path, folder: Path) -> None:
    """Move a folder into the temporary folder next to it.

    When the temporary folder is removed, it is moved back if nothing has its name by then.
    """
    durable.write(scratch / _NAME, folder.name)
    durable.rename(folder, scratch / _ASIDE)


def remove_abandoned(place: Path) -> None:
    """Remove the temporary folders in a folder that killed processes of this machine left there."""
    with contextlib.suppress(OSError):  # not there, or not readable
        for folder in place.glob(f"{PREFIX}{identify_machine()}-*"):
            lock = lock_folder(folder) if _is_own(folder) else None
            if lock is not None:
                _end(folder, folder, lock)


def _is_own(folder: Path) -> bool:
    """Return whether a path is a folder of this user and no link; others may write to a shared place."""
    try:
        found = folder.lstat()
    except OSError:
        return False
    return stat.S_ISDIR(found.st_mode) and (sys.platform == "win32" or found.st_uid == os.geteuid())


def lock_folder(folder: Path, *, shared: bool = False) -> int | None:
    """Lock a folder and return an open file descriptor; None if another process has locked it.

    The lock is on a file in the folder and ends when the descriptor is closed. None as well if the file
    system has no locks.
    """
    if sys.platform == "win32":
        return None
    descriptor = None
    try:
        ways = os.O_RDONLY if shared else os.O_RDWR | os.O_CREAT
        descriptor = os.open(folder / LOCK, ways | os.O_NOFOLLOW, 0o666)
        fcntl.flock(descriptor, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
    except OSError:
        if descriptor is not None:
            os.close(descriptor)
        return None
    return descriptor


def _end(unlocked: Path, folder: Path, lock: int | None) -> None:
    """Move back what was set aside, remove the folder, and release its lock."""
    if _move_back(folder):
        for path in (unlocked, folder):
            shutil.rmtree(path, ignore_errors=True)
    if lock is not None:
        with contextlib.suppress(OSError):  # closed already
            os.close(lock)
        if not (folder / _ASIDE).exists():
            shutil.rmtree(folder, ignore_errors=True)  # a network file system keeps an open file


def _move_back(folder: Path) -> bool:
    """Move a folder that was set aside back to its name if the name is free; False if the name is unknown."""
    aside = folder / _ASIDE
    if not aside.exists():
        return True
    home = _find_home(folder)
    if home is None:  # it stays, so that nothing is lost
        return False
    if home.exists():
        shutil.rmtree(aside, ignore_errors=True)
    else:
        durable.rename(aside, home)
    return True


def _find_home(folder: Path) -> Path | None:
    """Return the original path of a folder that was set aside; None if its name is missing or not plain."""
    try:
        name = (folder / _NAME).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    plain = name not in ("", ".", "..") and not {"/", "\\", "\0"} & set(name)
    return folder.parent / name if plain else None


def identify_machine() -> str:
    """Return a code of this machine: of its name and network address."""
    return hashlib.sha256(f"{platform.node()} {uuid.getnode():x}".encode()).hexdigest()[:8]
