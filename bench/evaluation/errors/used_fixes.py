"""Evaluate the estimate of an autopilot without a reference, by real outages and by the logged innovations.

It has used every fix, so a fix says nothing of its error, but for the first one after a while without any:
when that was measured, the autopilot had not used it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from bench.core.records.data import GnssFixes, NavSolution, SensorData
from bench.core.records.run_records import ErrorSeries
from bench.evaluation.consistency.chi_square import mean_nis, nis_by_sensor
from bench.evaluation.errors.failures import describe_failure
from bench.evaluation.errors.fixes import antenna_errors
from bench.evaluation.metrics.outages import OutageDrift

_GAP, _SHORTEST = 5.0, 2.0
"""An outage is longer than so many usual intervals between fixes, and [s]."""


def find_outages(fixes: GnssFixes) -> list[tuple[float, float]]:
    """Return the times [s] of the last fix before each real outage and of the fix that ends it."""
    t = fixes.t[fixes.valid]
    steps = np.diff(t)
    if not len(steps):
        return []
    most = max(_GAP * float(np.median(steps)), _SHORTEST)
    return [(float(t[k]), float(t[k + 1])) for k in np.flatnonzero(steps > most)]


def measure_outages(
    solution: NavSolution, fixes: GnssFixes, data: SensorData, outages: Sequence[tuple[float, float]]
) -> list[OutageDrift]:
    """Return the drift of a solution at the fix that ends each outage, if the solution has this epoch."""
    drifts = []
    for begin, end in outages:
        last = fixes.take(fixes.t == end)
        errors, moved = antenna_errors(solution, last, data)
        if not len(errors) or not np.isfinite(errors.pos_n[-1]).all():
            continue
        drifts.append(OutageDrift.measure(begin, end, errors.pos_n[-1], moved.cov[-1], last.cov_pos_n[-1]))
    return drifts


def measure_innovations(
    solution: NavSolution, begin: float, without_fixes: bool = False
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the metrics of the innovations, with an empty error series; ``without_fixes``: it had none."""
    values: dict[str, Any] = {"converged": True, "reason": None, **describe_failure(solution)}
    values["used_every_fix"] = True
    if without_fixes:
        values["without_fixes"] = True
    for ending, first in (("", begin), ("_all", -np.inf)):
        for name, one in nis_by_sensor(solution.innovations, first).items():
            mean = mean_nis(one.nis, one.dof)
            figures = {"mean": mean.mean, "low": mean.low, "high": mean.high}
            values.update({f"nis_{part}_{name}{ending}": value for part, value in figures.items()})
    none = np.empty((0, 3))
    return ErrorSeries(np.empty(0), none, none, none, np.empty(0), np.empty(0), 0), values
