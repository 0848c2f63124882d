"""Rows of the table of aircraft in the guide: ``python -m tests.tools.aircraft_table [NAME...]``.

Each aircraft of the jsbsim wheel, or each that is named, is designed, flown and accepted or not as
``bench new aircraft`` does it, and writes nothing. All of them take two hours.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

from bench.cli.new_files.new_aircraft import find_design, find_shipped
from bench.core.words.exceptions import FlightError
from bench.io.config.external_truth import find_jsbsim_root, list_root_aircraft


def make_row(name: str) -> str:
    """The row of the guide, or the reason."""
    raw, _, _ = find_shipped(name)
    try:
        design, accepted, flown = find_design(raw)
    except FlightError as error:
        return f"not accepted: {error}"
    height = "" if flown.glides else f"{accepted.height:.1f} m"
    return (
        f"| `{name}` | {design.speed:.0f} m/s, {design.alt:.0f} m | {math.degrees(accepted.bank):.1f} deg | "
        f"{height} | {100 * accepted.speed:.1f} % | {accepted.describe_load()} |"
    )


def main(*names: str) -> None:
    for name in names or list_root_aircraft(find_jsbsim_root(None, Path())):
        print(make_row(name), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
