"""The table of the guide of landings in rough air and wind across: ``python -m tests.tools.landing_table``.

A name flies only that aircraft: ``python -m tests.tools.landing_table jet747``.
"""

from __future__ import annotations

import sys

import numpy as np

from bench.core.words.exceptions import FlightError
from tests.flight.test_legs_ground import LANDING, land_in, measure_landing

SEEDS = range(21, 33)


def main(names: list[str]) -> None:
    """Print a row for each aircraft and severity."""
    for name, kind in LANDING.items():
        for severity, words in ((3, "light"), (4, "moderate")):
            landed = []
            for seed in SEEDS if not names or name in names else ():
                try:
                    landed.append(measure_landing(land_in(severity, 4.0, seed, kind)))
                except FlightError as error:
                    print(f"{name}, {words}, seed {seed}: {error}", flush=True)
            if landed:
                sink, along, off, rolled = np.array(landed).T
                sinks = f"{np.median(sink):.1f}, {sink.max():.1f} m/s"
                where = f"{along.min():.0f} to {along.max():.0f} m"
                shown = f"| `{name}` | {words} | {len(landed)} of {len(SEEDS)} | {sinks} | {where}"
                print(f"{shown} | {off.max():.1f} m | {rolled.max():.1f} m |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
