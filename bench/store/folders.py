"""Folders for results: an existing one is replaced only on request, and only if bench wrote it."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.errors import ConfigError
from bench.store.results import RESULT


def check_folder(folder: Path, *, force: bool, replaceable: bool | None = None) -> None:
    """Raise ConfigError if results cannot be written to a folder; call it before anything is flown.

    ``replaceable`` says whether the present content may be replaced; None: if it is a results folder.
    """
    try:
        folder.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:  # a name too long, a folder above that may not be searched
        raise ConfigError(f"{folder}: no folder can be made there: {error.strerror}") from None
    if folder.is_dir():
        empty = not any(folder.iterdir())
        if not force and not empty:
            what = "results folder" if replaceable is None else "folder"
            raise ConfigError(f"{folder}: the {what} exists; --force replaces it, -o names another")
        if replaceable is False and not empty:
            raise ConfigError(f"{folder}: not replaced, it is not an export")
        if replaceable is None and not empty and not (folder / RESULT).is_file():
            raise ConfigError(f"{folder}: not replaced, it is not a results folder (no {RESULT} in it)")
    elif folder.exists() or folder.is_symlink():
        raise ConfigError(f"{folder}: a file is there; a results folder needs a name that is free")
    above = next(place for place in folder.absolute().parents if place.exists())
    try:
        tempfile.TemporaryDirectory(dir=above).cleanup()
    except OSError as error:
        raise ConfigError(f"{folder}: no folder can be made in {above}: {error.strerror}") from None


def check_file(path: Path) -> None:
    """Raise ConfigError if a file cannot be written under a path; call it before the work."""
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder; name a file in it")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError(f"{path}: cannot be written: permission denied")


@contextlib.contextmanager
def make_folder(folder: Path, *, force: bool = False) -> Iterator[Path]:
    """Provide a temporary folder beside the wanted one; it gets the name if everything succeeds.

    After an exception, Ctrl-C included, it is removed, and what was under the name is still there.

    Raises
    ------
    ConfigError
        If another run made the folder meanwhile; with ``force`` it is replaced.
    OSError
        If the folder cannot be written.
    """
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            prefix=f".{folder.name}-", dir=folder.parent, ignore_cleanup_errors=True
        ) as scratch:
            partial, old = Path(scratch) / "new", Path(scratch) / "old"
            partial.mkdir()
            yield partial
            if folder.exists():
                if not force and any(folder.iterdir()):
                    raise ConfigError(f"{folder}: the results folder was made by another run; not replaced")
                folder.rename(old)
            try:
                partial.rename(folder)
            except BaseException:
                if old.exists():
                    old.rename(folder)
                raise
    except OSError as error:
        what = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, f"{what}; nothing was written", str(folder)) from error
