"""Satellites as a table: a line ``sat,t_oe,...`` with names of Keplerian elements in SI, then one each."""

from pathlib import Path

import numpy as np

from bench import ConfigError
from bench.core.records.orbit_sets import KEPLER, KeplerSets


def recognizes(path: Path) -> bool:
    """Return whether a file is such a table."""
    with path.open("rb") as file:
        return file.read(9) == b"sat,t_oe,"


def read_almanac(path: Path, near: float, shown: str) -> KeplerSets:
    """Return the satellites; elements that the table does not have are 0."""
    with path.open(encoding="utf-8") as file:
        names = file.readline().strip().split(",")
        if unknown := set(names[1:]) - set(KEPLER):
            raise ConfigError(f"{shown}: has no element {min(unknown)!r}")
        table = np.loadtxt(file, delimiter=",", ndmin=2)
    elements = np.zeros((len(table), len(KEPLER)))
    elements[:, [KEPLER.index(name) for name in names[1:]]] = table[:, 1:]
    return KeplerSets(table[:, 0].astype(int), np.ones(len(table), bool), elements)
