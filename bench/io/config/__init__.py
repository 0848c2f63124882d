"""Read TOML files in human units, check them, and return specs in SI."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from bench.io.config.listing import list_aircraft, list_estimators, list_legs, list_profiles, list_sensors

__all__ = ["list_aircraft", "list_estimators", "list_legs", "list_profiles", "list_sensors", "read_profile"]

if TYPE_CHECKING:
    from bench.io.config.profile import read_profile
else:

    def __getattr__(name: str) -> Any:
        if name == "read_profile":  # who lists what there is needs no checked tables
            from bench.io.config.profile import read_profile

            return read_profile
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
