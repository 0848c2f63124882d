"""The table of the guide of a level line held in turbulence: ``python -m tests.tools.hold_table``.

Twenty seeds of two minutes each, 250 m above ground. A name flies only that aircraft, a number only so many
seeds: ``python -m tests.tools.hold_table navion 4``.
"""

from __future__ import annotations

import sys

from tests.flight.test_rough_air import KINDS, ask_of, hold_in

SEVERITIES = {3: "light", 4: "moderate", 6: "severe"}
UNITS = ("deg", "m/s", "m", "m")


def main(words: list[str]) -> None:
    """Print a row for each aircraft and severity."""
    names = [word for word in words if not word.isdigit()] or list(KINDS)
    count = next((int(word) for word in words if word.isdigit()), 20)
    for name in names:
        for severity, air in SEVERITIES.items():
            if severity == 6 and name != "aerosonde":
                continue
            held = hold_in(severity, range(1, count + 1), KINDS[name])
            cells = [
                f"{found:.2g} of {asked:.2g} {unit}{' !' if found > asked else ''}"
                for found, asked, unit in zip(held[:4], ask_of(severity, KINDS[name]), UNITS, strict=True)
            ]
            throttle = f"{held.throttle:.3f}, {held.moved:.2f} 1/s"
            print(f"| `{name}` | {air} | {' | '.join(cells)} | {throttle} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
