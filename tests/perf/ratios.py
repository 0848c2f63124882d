"""Speed as ratios measured side by side in one run: ``make perf``.

Each work goes by turns with its unit (`tests.perf.units`, `tests.perf.dense`): work that is limited by the
same part of the machine. The least cost of each counts, so that a slow or busy machine moves both sides.
Whole commands are measured by the CPU time of their own process, with pandas installed and as if it were not:
other packages import it where it is. Exit status 1 where a figure is beyond its limit.

    python -m tests.perf.ratios [PART ...]

Without parts it also writes the table of the guide.
"""

from __future__ import annotations

import math
import platform
import sys
from collections.abc import Callable
from pathlib import Path

from rich.console import Console
from rich.table import Table

import bench
from bench import pipeline
from bench.io import config
from tests.measured import name_processor, stamp, write_measured
from tests.perf import closed, commands, filters, flights, hil
from tests.perf.units import Figure

PAGE = Path(bench.__file__).parent / "guide" / "accuracy.md"
HEAD, END = "<!-- make perf writes -->", "<!-- to here -->"


def write_page(figures: list[Figure]) -> None:
    """Write the table of the guide, with the day, the commit and the machine."""
    lines = ["| | measured | allowed |", "|---|---|---|"]
    for f in figures:
        side = "at least " if f.higher_is_better else ""
        limit = "" if math.isinf(f.limit) else f"{side}{f.limit:g}{'' if f.unit == 'x' else f' {f.unit}'}"
        lines.append(f"| {f.what} | {f.value:.3g}{'' if f.unit == 'x' else f' {f.unit}'} | {limit} |")
    machine = f"{name_processor()}, Python {platform.python_version()}"
    text = "\n".join([*lines, "", f"{write_measured([stamp()])[:-1]}, {machine}."])
    before, _, rest = PAGE.read_text(encoding="utf-8").partition(HEAD)
    PAGE.write_text(f"{before}{HEAD}\n{text}\n{END}{rest.partition(END)[2]}", encoding="utf-8")


def main(wanted: list[str]) -> int:
    """Measure the parts that are wanted, all if none is named; return the exit status."""
    profile = config.read_profile("figure-eight")
    matched = config.read_profile("figure-eight-matched")
    truth = pipeline.fly(profile)
    sensed = pipeline.sense(profile, truth)
    parts: dict[str, Callable[[], list[Figure]]] = {
        "filters": lambda: filters.navigating(profile, matched),
        "covariance": lambda: filters.slower_covariance(matched, truth),
        "python-ins": lambda: filters.against_python_ins(truth, sensed),
        "sensors": lambda: flights.sensing(profile, truth),
        "flights": lambda: flights.flying(profile),
        "closed": closed.measure,
        "hil": hil.measure,
        "report": lambda: commands.reporting(profile),
        "starts": lambda: commands.starting(truth),
        "commands": commands.warm,
        "first": commands.first,
    }
    if unknown := set(wanted) - set(parts):
        sys.exit(f"no part {', '.join(sorted(unknown))}; there are {', '.join(parts)}")
    table = Table(title="Speed, as ratios inside one run")
    for heading in ("", "measured", "spread", "limit", ""):
        table.add_column(heading, justify="left" if not heading else "right")
    figures = list[Figure]()
    for name, part in parts.items():
        found = part() if not wanted or name in wanted else []
        for one in found:
            print(f"{one.what}: {one.value:.3g} {one.unit}", flush=True)
        figures += found
    for f in figures:
        sign = ">=" if f.higher_is_better else "<="
        spread = f"{100 * (f.spread - 1):.0f} %" if f.spread > 1 else ""
        table.add_row(f.what, f"{f.value:.3g} {f.unit}", spread, f"{sign} {f.limit:g}", f.word)
    console = Console(width=118)
    console.print(table)
    if not wanted:
        write_page(figures)
    beyond = sum(f.over > 0 for f in figures)
    console.print(f"{beyond} of {len(figures)} figures are beyond their limit.")
    return 1 if beyond else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
