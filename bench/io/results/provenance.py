"""The software and the machine that made a result."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import platform
import subprocess
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import bench
from bench.core.files.places import PACKAGE

PACKAGES = ("numpy", "scipy", "numba", "jsbsim")
"""Packages whose version can change a result."""


def provenance() -> dict[str, object]:
    """Return the versions, the commit of the source tree (None outside one) and the platform."""
    return {
        "versions": list_versions(),
        "commit": find_commit(),
        "platform": platform.platform(),
        "machine": platform.machine(),
    }


def hash_spec(spec: Any) -> str:
    """Return a hash of all values of a spec (a frozen dataclass); the file they came from does not matter."""
    text = json.dumps(dataclasses.asdict(spec), sort_keys=True, default=_to_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:32]


def _to_plain(value: Any) -> Any:
    if isinstance(value, Path):
        return value.name
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)


def list_versions() -> dict[str, str]:
    """Return the versions of bench, Python and every package in `PACKAGES`."""
    return dict(_read_versions())


@cache
def _read_versions() -> dict[str, str]:
    packages = {name: version(name) for name in PACKAGES}
    return {"bench": bench.__version__, "python": platform.python_version(), **packages}


@cache
def find_commit() -> str | None:
    """Return the commit of the source tree, with ``-dirty`` if files differ from it; None outside a tree.

    It is looked up once in a process: what is loaded does not change later.
    """
    tree = PACKAGE.parent
    if not (tree / ".git").exists():
        return None
    command = ["git", "-C", str(tree), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10)
    except (OSError, subprocess.TimeoutExpired):  # no git on this machine
        return None
    return done.stdout.strip() or None
