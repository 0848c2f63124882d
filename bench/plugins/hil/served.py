"""A profile for a client to fly."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.core.records.specs import CLIENT, Profile
from bench.io.config.profile import read_profile


def load_served(name: str | Path, overrides: Mapping[str, Any] | None = None, **options: Any) -> Profile:
    """Read a profile as `read_profile`, for a client to fly."""
    changes = {"guidance.navigation": CLIENT, "guidance.options": {}, **(overrides or {})}
    return read_profile(name, changes, **options)
