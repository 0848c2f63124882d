"""The Stanford diagram: protection levels compared with errors, as a table and as figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings import FindingTable, series
from bench.core.records.findings.series import Plot
from bench.evaluation.ensembles.ensemble import CONFIDENCE
from bench.evaluation.requirements.required_performance import Watched, estimate_per_run

PLANES = ("horizontal", "vertical")
"""What is watched, in order."""


def known_size(size: FloatArray) -> FloatArray:
    """Return sizes with infinity where there is no solution."""
    return np.where(np.isnan(size), np.inf, size)


def tabulate_stanford(planes: list[Watched]) -> FindingTable:
    """Return the number of epochs in each region of the Stanford diagram."""
    names = ("plane", "part", "instants_percent", "runs", "runs_low_percent", "runs_high_percent")
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for plane, watched in zip(PLANES, planes, strict=True):
        parts = {
            "available, bounded": ~watched.alert & ~watched.misleading,
            "unavailable": watched.alert,
            "misleading: error > level": watched.misleading & ~watched.hazardous,
            "hazardous: error > limit >= level": watched.hazardous,
        }
        for part, where in parts.items():
            runs = estimate_per_run(where)
            row = (
                plane, part, 100.0 * float(where.mean()), int(where.any(axis=1).sum()),
                100.0 * runs.low, 100.0 * runs.high,
            )  # fmt: skip
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
    units = {name: "%" for name in names if name.endswith("percent")}
    title = f"Stanford diagram; intervals of {100 * CONFIDENCE:g} % over runs (Clopper and Pearson)"
    return FindingTable("stanford", title, columns, units)


def plot_stanford(t: FloatArray, planes: list[Watched]) -> Iterator[Plot]:
    """Yield a Stanford diagram and the levels over time, of each plane."""
    for plane, watched in zip(PLANES, planes, strict=True):
        error, level = watched.error.ravel(), watched.level.ravel()
        shown = np.isfinite(error) & np.isfinite(level) & (error > 0.0)
        if not shown.any():
            continue
        top = 1.5 * max(float(level[shown].max()), float(error[shown].max()), watched.limit)
        low = max(float(error[shown].min()), 1e-3 * top)
        sides = np.array([low, top])
        dots = series.draw_dots("instants", error[shown], level[shown], "a time", series.ESTIMATORS[0], 1.2)
        lines = (
            dots,
            series.draw_line("equal", sides, sides, "level = error", series.REJECTED),
            series.draw_line("limit", sides, np.full(2, watched.limit), "alert limit", series.OUTAGE),
        )
        title = f"{plane} protection level [m]"
        yield Plot(("rnp", f"stanford-{plane}"), title, lines, over="error", across="m", log="xy")
        t = t[: watched.error.shape[1]]
        with np.errstate(invalid="ignore"):
            worst = np.nanmax(known_size(watched.error), axis=0)
        lines = (
            series.draw_line("level", t, watched.level.min(axis=0), "least level", series.ESTIMATORS[0]),
            series.draw_line("error", t, worst, "largest error", series.ESTIMATORS[1]),
            series.draw_line("limit", t, np.full(len(t), watched.limit), "alert limit", series.OUTAGE),
        )
        title = f"{plane} protection level and error, all runs [m]"
        yield Plot(("rnp", f"levels-{plane}"), title, lines, log="y")
