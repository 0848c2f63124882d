"""The options of the smoother as a factor graph."""

from __future__ import annotations

from bench.navigation.options import Count, GateOptions


class GraphOptions(GateOptions):
    """Options of the smoother as a factor graph."""

    passes: Count = 10
    """Passes after which the fit ends even if it still moves; the first is a filter, with its gate."""
    flat: bool = False
    """Take the Earth as flat and at rest, as gtsam has it: no Earth rate, no change of gravity."""
