"""Folders that bench writes: they have a mark file, and only marked folders are replaced, on request."""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import bench
from bench.core.files import durable
from bench.core.files.scratch import LOCK, lock_folder, make_scratch, set_aside
from bench.core.words.exceptions import ConfigError

MARK = ".bench.json"
"""File that marks a folder as written by bench: version, kind, and the names of all files written."""

RESULTS, EXPORT, CAMPAIGN = "results folder", "export", "campaign"
STUDY, FIGURES = "study", "folder of figures"
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
                more = ", --resume continues it" if kind == CAMPAIGN else ""
                raise ConfigError(f"{folder}: the {kind} exists; --force replaces it, -o names another{more}")
    elif folder.exists():
        raise ConfigError(f"{folder}: a file is there; a {kind} needs a name that is free")
    above = next(place for place in folder.absolute().parents if place.exists())
    try:
        with make_scratch(above):
            pass
    except OSError as error:
        raise ConfigError(f"{folder}: no folder can be made in {above}: {error.strerror}") from None


def check_file(path: Path, *, force: bool) -> None:
    """Raise ConfigError if a file cannot be written under a path; call it before the work.

    With ``force``, a file that is there may be replaced.
    """
    if path.is_dir():
        raise ConfigError(f"{path}: is a folder; name a file in it")
    if not path.parent.is_dir():
        raise ConfigError(f"{path}: there is no folder {path.parent}")
    if path.exists() and not force:
        raise ConfigError(f"{path}: exists; --force replaces it")
    if not os.access(path if path.exists() else path.parent, os.W_OK):
        raise ConfigError(f"{path}: cannot be written: permission denied")


def _check_own(folder: Path, kind: str, what: str = "replaced") -> None:
    """Raise ConfigError unless a folder is of this kind and bench wrote every file in it."""
    refused = f"{folder}: not {what}"
    try:
        mark = json.loads((folder / MARK).read_text(encoding="utf-8"))
        written, found = {*mark["files"], MARK}, mark["kind"]
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        raise ConfigError(f"{refused}, bench did not write it (no {MARK} of bench in it)") from None
    if found != kind:
        raise ConfigError(f"{refused}, it is no {kind}")
    names = [name for name in _list_names(folder) if not durable.is_part(Path(name).name)]
    foreign = [name for name in names if name not in written]
    if foreign:
        raise ConfigError(f"{refused}, bench did not write {foreign[0]} in it; move it away or use -o")


def _write_mark(folder: Path, kind: str, files: Sequence[str]) -> None:
    mark = {"bench": bench.__version__, "kind": kind, "files": files}
    durable.write(folder / MARK, json.dumps(mark, indent=1) + "\n")


def _list_names(folder: Path) -> list[str]:
    """Return everything in a folder and its folders, relative to it."""
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*"))


def add_to_mark(folder: Path, name: str) -> None:
    """Add a file to the mark of a folder as written by bench; do nothing if the folder has no mark."""
    try:
        mark = json.loads((folder / MARK).read_text(encoding="utf-8"))
        mark["files"] = sorted({*mark["files"], name})
    except (OSError, ValueError, TypeError, KeyError, RecursionError):
        return
    durable.write(folder / MARK, json.dumps(mark, indent=1) + "\n")


@contextlib.contextmanager
def make_folder(folder: Path, *, force: bool = False, kind: str = RESULTS) -> Iterator[Path]:
    """Provide a temporary folder that is marked and renamed to the requested name if everything succeeds.

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
            _write_mark(partial, kind, _list_names(partial))
            durable.sync_tree(partial)
            if folder.exists():
                if any(folder.iterdir()):
                    _check_own(folder, kind)
                    if not force:
                        raise ConfigError(f"{folder}: the {kind} was made by another run; not replaced")
                set_aside(scratch, folder)
            durable.rename(partial, folder)
    except BaseException as error:
        for place in missing:
            with contextlib.suppress(OSError):  # it was not made, or holds something else
                place.rmdir()
        if isinstance(error, OSError):
            what = os.strerror(error.errno) if error.errno else str(error)
            raise OSError(error.errno, f"{what}; nothing was written", str(folder)) from error
        raise


@contextlib.contextmanager
def keep_folder(
    folder: Path, files: Sequence[str], kind: str, *, force: bool = False, resume: bool = False
) -> Iterator[Path]:
    """Provide a folder for files that are written one after another and stay if the work is interrupted.

    Parameters
    ----------
    folder : Path
        It is marked, and locked until the end.
    files : sequence of str
        The files that may be written in it.
    kind : str
        Kind of the folder.
    force : bool
        Remove these files of before.
    resume : bool
        Use these files of before, if there are any.

    Raises
    ------
    ConfigError
        If the folder cannot be used, or another process works in it.
    OSError
        If the folder cannot be written.
    """
    resume = resume and folder.is_dir() and any(folder.iterdir())
    if resume:
        _check_own(folder, kind, "continued")
    else:
        check_folder(folder, force=force, kind=kind)
    folder.mkdir(parents=True, exist_ok=True)
    lock = lock_folder(folder)
    if lock is None and sys.platform != "win32":
        raise ConfigError(f"{folder}: another process works in this {kind}, or its disk has no file locks")
    try:
        for name in () if resume else files:
            (folder / name).unlink(missing_ok=True)
        for part in (path for path in folder.iterdir() if durable.is_part(path.name)):
            part.unlink(missing_ok=True)
        _write_mark(folder, kind, [*files, LOCK])
        yield folder
    finally:
        if lock is not None:
            os.close(lock)
