"""Output for people: plots, recordings and reports."""

from __future__ import annotations

from typing import Any

from bench.core.words.notebook import set_drawer


def _draw(*chosen: Any, **look: Any) -> Any:
    from bench.views.report.paper import plot_result

    return plot_result(*chosen, **look)


set_drawer(_draw)
