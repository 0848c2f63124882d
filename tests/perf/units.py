"""What a figure of `tests.perf` is measured in: fixed work that is limited by the same part of the machine.

Work and unit go by turns, and the least of each counts: what else the machine does only adds to it, and meets
both. The sources of the units are fixed and share nothing with ``bench``.
"""

from __future__ import annotations

import math
import os
import resource
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

Costs = Callable[[], float]
"""Does some work and returns its CPU time [s]."""


@dataclass(frozen=True)
class Figure:
    """A line of the table."""

    what: str
    value: float
    limit: float
    unit: str = "x"
    higher_is_better: bool = False
    spread: float = 1.0

    @property
    def over(self) -> float:
        """How far it is beyond its limit, as a part of it; 0 or less where it is kept."""
        if math.isinf(self.limit):
            return 0.0
        return (self.limit - self.value if self.higher_is_better else self.value - self.limit) / self.limit

    @property
    def word(self) -> str:
        return "kept" if self.over <= 0 else f"[red]{100 * self.over:.2g} % beyond it"


@dataclass(frozen=True)
class Ratio:
    """The least cost of a work over the least cost of its unit, and how far both scatter."""

    value: float
    spread: float  # median cost over least cost, the larger of work and unit

    def hold(self, what: str, limit: float, factor: float = 1.0) -> Figure:
        """Return the line of the table: the ratio times a factor, and its limit."""
        return Figure(what, factor * self.value, limit, spread=self.spread)


def compare(work: Costs, unit: Costs, rounds: int = 7) -> Ratio:
    """Return the cost of a work in a unit, after one round that compiles and warms."""
    work(), unit()
    costs = np.array([[work(), unit()] for _ in range(rounds)])
    least = costs.min(axis=0)
    return Ratio(float(least[0] / least[1]), float((np.median(costs, axis=0) / least).max()))


def cpu(work: Callable[[], object]) -> Costs:
    """Return the work as costs: the CPU time of this process, threads included."""

    def spend() -> float:
        begun = time.process_time()
        work()
        return time.process_time() - begun

    return spend


def child(*command: str, cwd: str | os.PathLike[str] | None = None, **environment: str) -> Costs:
    """Return the CPU time of a Python process, its children included, as costs."""

    def spend() -> float:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run(
            [sys.executable, *command], cwd=cwd, env=dict(os.environ) | environment, capture_output=True
        )
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        if done.returncode != 0:
            sys.exit(f"{' '.join(command)}: exit {done.returncode}\n{done.stderr.decode()}")
        return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime

    return spend


START = child("-m", "tests.perf.interpreted")
"""The start of Python and numpy, and some interpreted work."""

COMPILE = child(
    "-c", "from numpy import ones\nfrom tests.perf.dense import _multiply\n_multiply(*[ones((3, 3))] * 3, 1)"
)
"""The start of Python and numba, and the compilation of a product of matrices."""
