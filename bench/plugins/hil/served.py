"""A profile for a client to fly."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.core.records.specs import CLIENT, Profile
from bench.io.config.profile import read_profile


def load_served(
    name: str | Path, overrides: Mapping[str, Any] | None = None, *, mavlink: bool, **options: Any
) -> Profile:
    """Read a profile as `read_profile`, for a client to fly.

    For an autopilot that speaks MAVLink a turn is 50 ms unless ``overrides`` says otherwise: its loops do not
    wait for those of ``[guidance]``.
    """
    turn = {"guidance.period_s": 0.05} if mavlink else {}
    changes = {"guidance.navigation": CLIENT, "guidance.options": {}, **turn, **(overrides or {})}
    return read_profile(name, changes, **options)
