"""Read TOML files in human units, check them, and return specs in SI."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bench.config.library import list_aircraft, list_estimators, list_legs, list_profiles, list_sensors
from bench.config.profile import load_profile
from bench.moved import moved_from

__all__ = ["list_aircraft", "list_estimators", "list_legs", "list_profiles", "list_sensors", "load_profile"]

if not TYPE_CHECKING:
    __getattr__ = moved_from(__name__)
