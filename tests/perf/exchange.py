"""What a piece of a filter costs in a process of its own, beyond the filter itself: wall time.

The same pieces, 20 a second of flight, go by turns to a filter here and to one in its process. The least of
nine slices counts, as for all filters (`tests.perf.ratios`): a machine that slows down moves it by half::

    python -m tests.perf.exchange
"""

from __future__ import annotations

import os
import sys
import time
from itertools import pairwise
from pathlib import Path

import numpy as np

import bench
from bench import pipeline
from bench.specs import Guard

FILTERS = Path(__file__).parents[1] / "exchange"
SLICES = 9


def measure() -> tuple[float, float]:
    """Return the median wall time of a piece here, and what it takes longer in a process of its own [s]."""
    profile = bench.load_profile("figure-eight")
    sensed = pipeline.sense(profile, bench.fly(profile))
    edges = [-np.inf, *np.arange(1.0, 60.0, 0.05)]
    pieces = [bench.take_piece(sensed.data, *ends) for ends in pairwise(edges)]
    spent = np.empty((SLICES, len(pieces), 2))
    for part in spent:
        filters = [
            bench.open_filter("attacks:Walks", sensed.initial, guard=Guard(in_process=here))
            for here in (True, False)
        ]
        for piece, row in zip(pieces, part, strict=True):
            for k, one in enumerate(filters):
                begun = time.perf_counter()
                one.feed(piece)
                row[k] = time.perf_counter() - begun
    here, there = np.moveaxis(spent[:, 50:], 2, 0)
    return float(np.median(here, axis=1).min()), float(np.median(there - here, axis=1).min())


def main() -> None:
    """Print both figures."""
    os.chdir(FILTERS)  # where its process looks for the module
    sys.path.insert(0, str(FILTERS))
    own, beyond = measure()
    print(f"a piece takes {1e3 * own:.2f} ms here, and {1e3 * beyond:.2f} ms more in a process of its own")


if __name__ == "__main__":
    main()
