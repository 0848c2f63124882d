"""What a flight and a piece of a filter cost in a process of its own, beyond the filter itself: wall time.

The same ten minutes, whole and as pieces of 0.05 s, go by turns to a filter here and to one in its process.
The least of nine slices counts, as for all filters (`tests.perf.ratios`); of pieces their median is taken.
Exit status 1 if one is more than allowed. It is wall time: on a busy machine only ``nice -n -20`` tells it::

    python -m tests.perf.exchange
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np

import bench
from bench import pipeline
from bench.core.records.specs import EstimatorChoice, Guard

FILTERS = Path(__file__).parents[1] / "exchange"
SLICES = 9
ALLOWED_FLIGHT, ALLOWED_PIECE = 60e-3, 0.2e-3  # [s]


def measure_time(work: Callable[[], object]) -> float:
    """Return the wall time of some work [s]."""
    begun = time.perf_counter()
    work()
    return time.perf_counter() - begun


def measure() -> tuple[float, float]:
    """Return what a flight and a piece take longer in a process of its own [s]."""
    profile = bench.read_profile("figure-eight")
    sensed = pipeline.sense(profile, bench.fly(profile))
    pair = [
        pipeline.build_estimator(EstimatorChoice("attacks:Walks", "walks", guard=Guard(in_process=here)))
        for here in (True, False)
    ]
    flights = np.array(
        [
            [measure_time(lambda one=one: one.run(sensed.data, sensed.initial)) for one in pair]
            for _ in range(SLICES + 1)
        ]
    )[1:]  # without the one that starts and loads
    edges = [-np.inf, *np.arange(1.0, 60.0, 0.05)]
    pieces = [bench.slice_sensors(sensed.data, *ends) for ends in pairwise(edges)]
    spent = np.empty((SLICES, len(pieces), 2))
    for part in spent:
        filters = [
            bench.open_filter("attacks:Walks", sensed.initial, guard=Guard(in_process=here))
            for here in (True, False)
        ]
        for piece, row in zip(pieces, part, strict=True):
            row[:] = [measure_time(lambda one=one, piece=piece: one.update(piece)) for one in filters]
    beyond = np.median(np.diff(spent[:, 50:, :], axis=2), axis=(1, 2)).min()
    return float(np.diff(flights).min()), float(beyond)


def main() -> None:
    """Print both figures; exit status 1 if one is not allowed."""
    os.chdir(FILTERS)  # where its process looks for the module
    sys.path.insert(0, str(FILTERS))
    flight, piece = measure()
    print("more in a process of its own:")
    print(f"ten minutes of flight {1e3 * flight:.1f} ms, {1e3 * ALLOWED_FLIGHT:g} ms allowed")
    print(f"a piece {1e3 * piece:.3f} ms, {1e3 * ALLOWED_PIECE:g} ms allowed")
    sys.exit(flight > ALLOWED_FLIGHT or piece > ALLOWED_PIECE)


if __name__ == "__main__":
    main()
