"""The legs a flight is made of.

A leg is one frozen dataclass, `bench.core.records.flight_specs.Leg`, in a module of this folder: its fields
are the keys of a profile (`legs.keys`), its docstring says what it does, ``fly`` flies it.
Nothing else lists it.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module

from bench.core.records.flight_specs import Leg


def _declared() -> Iterator[type[Leg]]:
    for found in pkgutil.iter_modules(__path__):
        module = import_module(f"{__name__}.{found.name}")
        for value in vars(module).values():
            own = isinstance(value, type) and value.__module__ == module.__name__
            if own and issubclass(value, Leg) and "kind" in vars(value):
                yield value


LEGS: tuple[type[Leg], ...] = tuple(_declared())
"""Every leg that a profile can ask for; one of another package is added to it."""
