"""Folders that bench writes: they bear its mark, and only such a folder is replaced, on request."""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator
from pathlib import Path

import bench
from bench.errors import ConfigError
from bench.scratch import make_scratch, set_aside

MARK = ".bench.json"
"""File that marks a folder as written by bench: version, kind, and the names of all files written."""

RESULTS, EXPORT = "results folder", "export"
"""Kinds of folders."""

_LONGEST = "x" * 150  # no file in a folder has a longer name [characters]


def check_folder(folder: Path, *, force: bool, kind: str = RESULTS) -> None:
    """Raise ConfigError if a folder of this kind cannot be written; call it before anything is flown.

    With ``force``, a folder of the same kind may be replaced if every file in it was written by bench.
    """
    here = Path.cwd()
    try:
        with contextlib.suppress(FileNotFoundError, NotADirectoryError):
            (folder / _LONGEST).stat()
        whole = folder.resolve()
    except (OSError, RuntimeError) as error:  # a name too long, a folder that may not be searched, a loop
        reason = getattr(error, "strerror", None) or "a symbolic link leads to itself"
        raise ConfigError(f"{folder}: no folder can be made there: {reason}") from None
    if folder.is_symlink():
        raise ConfigError(f"{folder}: a symbolic link; name the folder itself")
    if whole == here or whole in here.parents:
        raise ConfigError(f"{folder}: the present folder is not replaced, nor one that contains it")
    if folder.is_dir():
        if os.path.ismount(folder):
            raise ConfigError(f"{folder}: a mount point cannot be replaced; name a folder in it")
        if any(folder.iterdir()):
            _check_own(folder, kind)
            if not force:
                raise ConfigError(f"{folder}: the {kind} exists; --force replaces it, -o names another")
    elif folder.exists():
        raise ConfigError(f"{folder}: a file is there; a {kind} needs a name that is free")
    above = next(place for place in folder.absolute().parents if place.exists())
    try:
        with make_scratch(above):
            pass
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


def _check_own(folder: Path, kind: str) -> None:
    """Raise ConfigError unless a folder is of this kind and bench wrote every file in it."""
    refused = f"{folder}: not replaced"
    try:
        mark = json.loads((folder / MARK).read_text(encoding="utf-8"))
        written, found = {*mark["files"], MARK}, mark["kind"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        raise ConfigError(f"{refused}, bench did not write it (no {MARK} of bench in it)") from None
    if found != kind:
        raise ConfigError(f"{refused}, it is no {kind}")
    foreign = [name for name in _list_names(folder) if name not in written]
    if foreign:
        raise ConfigError(f"{refused}, bench did not write {foreign[0]} in it; move it away or use -o")


def _list_names(folder: Path) -> list[str]:
    """Return everything in a folder and its folders, relative to it."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


@contextlib.contextmanager
def make_folder(folder: Path, *, force: bool = False, kind: str = RESULTS) -> Iterator[Path]:
    """Provide a temporary folder beside the wanted one; marked, it gets the name if everything succeeds.

    After an exception, Ctrl-C included, it is removed, and what was under the name is still there; after
    ``kill -9`` the next run does the same.

    Raises
    ------
    ConfigError
        If the folder was made or changed meanwhile and must not be replaced.
    OSError
        If the folder cannot be written.
    """
    missing = [place for place in folder.absolute().parents if not place.exists()]
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        with make_scratch(folder.parent) as scratch:
            partial = scratch / "new"
            partial.mkdir()
            yield partial
            mark = {"bench": bench.__version__, "kind": kind, "files": _list_names(partial)}
            (partial / MARK).write_text(json.dumps(mark, indent=1) + "\n", encoding="utf-8")
            if folder.exists():
                if any(folder.iterdir()):
                    _check_own(folder, kind)
                    if not force:
                        raise ConfigError(f"{folder}: the {kind} was made by another run; not replaced")
                set_aside(scratch, folder)
            partial.rename(folder)
    except BaseException as error:
        for place in missing:
            with contextlib.suppress(OSError):  # it was not made, or holds something else
                place.rmdir()
        if isinstance(error, OSError):
            what = os.strerror(error.errno) if error.errno else str(error)
            raise OSError(error.errno, f"{what}; nothing was written", str(folder)) from error
        raise
