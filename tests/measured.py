"""The line below a table of measured figures: when, at which commit, and what its ± is."""

from __future__ import annotations

import os
from collections.abc import Iterable
from datetime import date

from bench.io.results import provenance

SHOWN = 0.95
"""Of every interval that stands as ± in a page: twice the part of a normal error below 1.96 sd, less one."""


def stamp() -> str:
    """Return today and the commit of the tree."""
    commit = str(provenance()["commit"] or "no commit")
    return f"{date.today()} at {commit[:7]}{' with changes' if commit.endswith('-dirty') else ''}"


def write_measured(stamps: Iterable[str]) -> str:
    """Return the line for the days and commits at which the rows of a table were measured."""
    return f"Measured on {'; '.join(sorted(set(stamps)))}."


def name_processor() -> str:
    """Return number and name of the processors of this machine."""
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as file:
            names = [line.partition(":")[2].strip() for line in file if line.startswith("model name")]
    except OSError:
        names = []
    return f"{os.cpu_count()} x {names[0]}" if names else f"{os.cpu_count()} processors"
