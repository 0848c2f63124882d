"""The table of the guide of what a pilot sees of each shipped flight: ``python -m tests.tools.pilot_table``.

Names fly only those profiles: ``python -m tests.tools.pilot_table circuit survey``. All take ten minutes.
"""

from __future__ import annotations

import sys

from bench.core.records.flight_specs import FlightSpec
from bench.io.config import read_profile
from bench.io.config.listing import PROFILES
from tests.flight.pilot import asked_bank, look_at
from tests.flight.plans import fly_here

_HEADS = (
    ("bank asked for, deg", "bank, deg", "load factor"),
    ("airspeed, m/s", "sideslip, deg", "at a stop, %", "height, m"),
)


def main(names: list[str]) -> None:
    """Print a row for each flight in each of two tables; a flight of several profiles has one."""
    flown: list[FlightSpec] = []
    tables: tuple[list[str], list[str]] = ([], [])
    for name in names or sorted(path.stem for path in PROFILES.glob("*.toml")):
        spec = read_profile(name).flight
        if isinstance(spec, FlightSpec) and spec not in flown:
            flown.append(spec)
            cells = [f"{asked_bank(spec):.0f}", *look_at(spec, fly_here(spec)).cells()]
            for rows, part in zip(tables, (cells[:3], cells[3:]), strict=True):
                rows.append(f"| `{name}` | {' | '.join(part)} |")
    for heads, rows in zip(_HEADS, tables, strict=True):
        print(f"| profile | {' | '.join(heads)} |\n{'|---' * (len(heads) + 1)}|", *rows, "", sep="\n")


if __name__ == "__main__":
    main(sys.argv[1:])
