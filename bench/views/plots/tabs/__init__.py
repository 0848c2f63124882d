"""The tabs of plots.

A tab is a constant `bench.views.plots.content.Tab` in a module of this folder. Nothing else lists it.
"""

from __future__ import annotations

import pkgutil
from collections.abc import Iterator
from importlib import import_module

from bench.views.plots.content import Tab


def _declared() -> Iterator[Tab]:
    for found in pkgutil.iter_modules(__path__):
        module = import_module(f"{__name__}.{found.name}")
        yield from (value for value in vars(module).values() if isinstance(value, Tab))


TABS: tuple[Tab, ...] = tuple(sorted(_declared(), key=lambda tab: tab.place))
"""Every tab behind the overview, in its order."""
