"""Folders of the package and of its cache; nothing here creates them."""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]
"""The installed package: shipped profiles, catalog and, in a wheel, aircraft."""


def locate_source(name: str) -> Path:
    """Return the path of a file or folder of the package, for example "bench/cli/api.py".

    Raises
    ------
    ImportError
        If it is not there.
    """
    path = PACKAGE.parent / name
    if not path.exists():
        raise ImportError(f"{path}: no such file", name=name)
    return path


def cache_folder(kind: str) -> Path:
    """Return the user's cache folder for "truth" or "kernels".

    It lies in ``BENCH_CACHE`` if that is set, else in ``bench`` below ``XDG_CACHE_HOME`` or ``~/.cache``.
    """
    own = os.environ.get("BENCH_CACHE")
    if own:
        return Path(own) / kind
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "bench" / kind
