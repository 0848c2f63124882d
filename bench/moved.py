"""Names that programs outside of bench may still import: one line says what replaced each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import ModuleType
from typing import NoReturn

MODULES: Mapping[str, str] = {
    "bench.door": "is now bench.api",
    "bench.legs": "is now bench.flight.legs",
    "bench.unit_names": "is now bench.units",
}
"""Module that is gone -> what became of it."""

NAMES: Mapping[str, str] = {
    "bench.config.ConfigError": "bench.ConfigError",
    "bench.flight.FlightError": "bench.FlightError",
    "bench.data.RunResult": "bench.run_result.RunResult",
    **{f"bench.data.{name}": f"bench.instruments.{name}" for name in ("BaroData", "MagData", "AirspeedData")},
    **{
        f"bench.specs.{name}": f"bench.instruments.{name}"
        for name in ("BaroSpec", "StaticPressureSpec", "MagSpec", "AirspeedSpec")
    },
    "bench.specs.stream": "bench.random_streams.stream",
}
"""Name that is gone from a module -> the name that replaced it."""

OPTIONS: Mapping[str, str] = {"--allow-commands": "--allow-code"}
"""Option that is gone from the command line -> the option that replaced it."""


class MovedModules:
    """The last finder of ``sys.meta_path``: it finds nothing, and names the replacement of a module."""

    @staticmethod
    def find_spec(name: str, path: object = None, target: object = None) -> None:
        """Raise ModuleNotFoundError for a module that has been replaced."""
        if name in MODULES:
            raise ModuleNotFoundError(f"{name} {MODULES[name]}", name=name)


def moved_from(module: str, *parts: ModuleType) -> Callable[[str], NoReturn]:
    """Return a module ``__getattr__`` that names the replacement of what has left the module.

    ``parts`` are modules that hold what it held.
    """

    def look_up(name: str) -> NoReturn:
        replacement = NAMES.get(f"{module}.{name}")
        for part in parts:
            if not name.startswith("_") and name in vars(part):
                replacement = f"{part.__name__}.{name}"
        if replacement is not None:
            raise ImportError(f"{module}.{name} is now {replacement}")
        raise AttributeError(f"module {module!r} has no attribute {name!r}")

    return look_up
