"""Folders for results: an existing one is replaced only on request, and only if bench wrote it."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.errors import ConfigError
from bench.store.results import RESULT, results_folder


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


@contextlib.contextmanager
def make_folder(folder: Path, *, force: bool) -> Iterator[Path]:
    """Provide a new folder to write results to; it appears under its name only if everything succeeds.

    Raises
    ------
    ConfigError
        If another run made the folder meanwhile.
    OSError
        If the folder cannot be written.
    """
    replace = force or folder.is_dir()  # an empty one
    try:
        with results_folder(folder, replace=replace) as partial:
            yield partial
    except FileExistsError:
        raise ConfigError(f"{folder}: the results folder was made by another run; not replaced") from None
    except OSError as error:
        what = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, f"{what}; nothing was written", str(folder)) from error
