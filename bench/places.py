"""Where files of the bench live on a machine; nothing here creates anything."""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
"""The installed package: shipped profiles, catalog and, in a wheel, aircraft."""


def cache_folder(kind: str) -> Path:
    """Return the user's cache folder for one kind of thing ("truth", "kernels").

    ``BENCH_CACHE`` names another root; else it is ``bench`` below ``XDG_CACHE_HOME`` or ``~/.cache``.
    """
    own = os.environ.get("BENCH_CACHE")
    if own:
        return Path(own) / kind
    root = os.environ.get("XDG_CACHE_HOME")
    return (Path(root) if root else Path.home() / ".cache") / "bench" / kind
