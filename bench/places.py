"""Folders of the package and of its cache; nothing here creates them."""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
"""The installed package: shipped profiles, catalog and, in a wheel, aircraft."""


def cache_folder(kind: str) -> Path:
    """Return the user's cache folder for "truth" or "kernels".

    It lies in ``BENCH_CACHE`` if that is set, else in ``bench`` below ``XDG_CACHE_HOME`` or ``~/.cache``.
    """
    own = os.environ.get("BENCH_CACHE")
    if own:
        return Path(own) / kind
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "bench" / kind
