"""``bench export``: a run in the format another tool reads."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from bench import store
from bench.errors import ConfigError, ExportError
from bench.exchange.exports import README, gather, write
from bench.workbench.run import check_folder

_TITLE = "Export of"
"""How the README of an export begins; a folder without it is not replaced."""


def export(
    folder: Path,
    kind: str,
    *,
    console: Console,
    out: Path | None = None,
    wanted: Sequence[str] = (),
    force: bool = False,
) -> Path:
    """Write a run in the format of another tool and return the folder.

    Parameters
    ----------
    folder : Path
        A results folder.
    kind : str
        One of `bench.exchange.exports.FORMATS`.
    console : Console
        Where the names of the files go.
    out : Path or None
        Where to; beside the results folder, with the format in its name, when None.
    wanted : sequence of str
        What goes out beside the sensors: ``truth``, ``solution:NAME``.
    force : bool
        Replace an export that is there.

    Raises
    ------
    ConfigError
        When it cannot be done; nothing is left behind.
    """
    # "." and ".." have no name of their own
    beside = folder.resolve() if folder.name in ("", "..") else folder
    out = out or beside.with_name(f"{folder.resolve().name}-{kind}")
    readme = out / README
    ours = readme.is_file() and readme.read_bytes()[:80].startswith(f"# {_TITLE} ".encode())
    check_folder(out, force=force, ours=ours)
    try:
        outgoing = gather(folder, tuple(dict.fromkeys(wanted)))
        with store.results_folder(out, replace=force or out.is_dir()) as partial:
            write(partial, kind, outgoing, f"{_TITLE} {folder.resolve().name} to {kind}")
            names = sorted(path.name for path in partial.iterdir())
    except ExportError as error:
        raise ConfigError(str(error)) from None
    except FileExistsError:
        raise ConfigError(f"{out}: the folder was made by somebody else; not replaced") from None
    console.print(f"{out}: {', '.join(names)}", soft_wrap=True)
    return out
