"""Where results may go: what is there already is replaced only when asked, and only if it is ours."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.errors import ConfigError
from bench.store.results import RESULT, results_folder


def check_folder(folder: Path, *, force: bool, ours: bool | None = None) -> None:
    """Raise ConfigError when results cannot go to a folder; before anything is flown.

    ``ours`` says whether what is there may be replaced; None: when it is a results folder.
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
            what = "results folder" if ours is None else "folder"
            raise ConfigError(f"{folder}: the {what} exists; --force replaces it, -o names another")
        if ours is False and not empty:
            raise ConfigError(f"{folder}: not replaced, it is no export")
        if ours is None and not empty and not (folder / RESULT).is_file():
            raise ConfigError(f"{folder}: not replaced, it is no results folder (no {RESULT} in it)")
    elif folder.exists() or folder.is_symlink():
        raise ConfigError(f"{folder}: the results folder cannot be there, it is a file")
    above = next(place for place in folder.absolute().parents if place.exists())
    try:
        tempfile.TemporaryDirectory(dir=above).cleanup()
    except OSError as error:
        raise ConfigError(f"{folder}: no folder can be made in {above}: {error.strerror}") from None


@contextlib.contextmanager
def make_folder(folder: Path, *, force: bool) -> Iterator[Path]:
    """Give a folder to write results to; it takes its place when all went well, or nothing does.

    Raises
    ------
    ConfigError
        When another run made the folder meanwhile.
    OSError
        When the disk does not take it.
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
