"""Atomic and durable writing of all permanent files: each is completely on the disk, or absent.

A file is written beside, synced and renamed; a folder is made beside, synced with all in it, and renamed.
What does not outlive its process (`scratch`, `disk_arrays`, messages to a child) and compiled code, which has
sums of its own, is written elsewhere.
"""

from __future__ import annotations

import contextlib
import glob
import io
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

if sys.platform != "win32":
    import fcntl

_PART = ".part"


def before(action: str, path: Path) -> None:
    """Do nothing; called before each write, sync and rename of a path. Tests let them fail here."""


class _File(io.FileIO):
    """A new file, each write of which can be made to fail."""

    def __init__(self, path: Path) -> None:
        super().__init__(path, "w")
        self._path = path

    def write(self, data: Any, /) -> int:
        before("write", self._path)
        return super().write(data)


@contextlib.contextmanager
def open_binary(path: Path) -> Iterator[IO[bytes]]:
    """Provide a binary file that gets its name atomically if everything succeeds.

    After an exception nothing is left of it, and what was under the name is still there.

    Raises
    ------
    OSError
        If the file cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}{_PART}")
    _remove_abandoned(path)
    try:
        with io.BufferedWriter(_File(part)) as file:
            _lock(file.fileno())
            yield file
            file.flush()
            _sync(file.fileno(), path)
        rename(part, path)
    finally:
        part.unlink(missing_ok=True)


@contextlib.contextmanager
def open_text(path: Path, encoding: str = "utf-8", newline: str | None = None) -> Iterator[IO[str]]:
    """Provide a text file as :func:`open_binary` does a binary one."""
    with open_binary(path) as file:
        text = io.TextIOWrapper(file, encoding=encoding, newline=newline)
        try:
            yield text
            text.flush()
        finally:
            with contextlib.suppress(OSError, ValueError):  # what failed has been told
                text.detach()


def write(path: Path, data: str | bytes) -> None:
    """Write a file, text in UTF-8, atomically; errors as for :func:`open_binary`."""
    with open_binary(path) as file:
        file.write(data.encode() if isinstance(data, str) else data)


def append(descriptor: int, data: bytes, at: int, path: Path, *, sync: bool = True) -> None:
    """Write data at a place of an open file of some path; with ``sync``, wait until it is on the disk."""
    done = 0
    while done < len(data):
        before("write", path)
        done += _write_at(descriptor, data[done:], at + done)
    if sync:
        _sync(descriptor, path)


def _write_at(descriptor: int, data: bytes, at: int) -> int:
    if sys.platform == "win32":
        os.lseek(descriptor, at, os.SEEK_SET)
        return os.write(descriptor, data)
    return os.pwrite(descriptor, data, at)


def read_at(descriptor: int, length: int, at: int) -> bytes:
    """Return the bytes from a place of an open file; fewer if the file ends before."""
    if sys.platform == "win32":
        os.lseek(descriptor, at, os.SEEK_SET)
        return os.read(descriptor, length)
    return os.pread(descriptor, length, at)


def rename(old: Path, new: Path) -> None:
    """Rename a file or a folder; the new name is on the disk afterwards."""
    before("rename", new)
    old.replace(new)
    _sync_folder(new.parent)


def sync_tree(root: Path) -> None:
    """Wait until a folder and all its content are on the disk."""
    for folder, _, names in os.walk(root):
        for name in names:
            with (Path(folder) / name).open("rb") as file:
                _sync(file.fileno(), Path(folder) / name)
        _sync_folder(Path(folder))


def is_part(name: str) -> bool:
    """Return whether a file of this name was being written when its process was killed."""
    return name.startswith(".") and name.endswith(_PART)


def _lock(descriptor: int) -> bool:
    """Lock an open file until its process ends or closes it; return False if that is not possible."""
    if sys.platform == "win32":
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _remove_abandoned(path: Path) -> None:
    """Remove the temporary files that killed processes have left of a file."""
    for part in path.parent.glob(f".{glob.escape(path.name)}.*{_PART}"):
        with contextlib.suppress(OSError), part.open("rb") as file:
            if _lock(file.fileno()):
                part.unlink()


def _sync(descriptor: int, path: Path) -> None:
    before("sync", path)
    os.fsync(descriptor)


def _sync_folder(folder: Path) -> None:
    """Wait until the names in a folder are on the disk; Windows does so by itself."""
    if sys.platform == "win32":
        return
    before("sync", folder)
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
