"""Tables, sentences and pictures of the drift without GNSS."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.findings import FindingTable, make_table, series
from bench.core.records.findings.series import Plot, Series
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import Estimate
from bench.evaluation.ensembles.paired_draws import PairedRatio
from bench.experiments.studies.outage_study.outage_grades import find_time
from bench.experiments.studies.outage_study.outage_growth import Drift
from bench.experiments.studies.study import format_estimate
from bench.experiments.studies.unit_study.catalog_units import CatalogImu

Drifts = Mapping[tuple[str, str], Drift]
"""Unit and phase -> its drift."""


def _rows(drift: Drift, elapsed: Sequence[float]) -> Iterator[tuple[float, int]]:
    """Yield the requested times within the flown outage, with their rows."""
    for T in elapsed:
        k = int(np.argmin(np.abs(drift.grid - T)))
        if abs(drift.grid[k] - T) < SAME_INSTANT:
            yield T, k


_TITLE = "Horizontal drift since the start of the outage: RMS with its 95 % interval, median, 95 % of runs"


def fill_drifts(
    drifts: Drifts, units: Mapping[str, CatalogImu], elapsed: Sequence[float], limit: float
) -> tuple[FindingTable, ...]:
    """Return the tables of the horizontal drift, its sources, the time to a limit [m], the drift by axis."""
    rows, claims, by_axis, sources, times = [], [], [], [], []
    for (unit, phase), drift in drifts.items():
        measured = len(drift.good) > 1
        head = (unit, phase)
        for T, k in _rows(drift, elapsed):
            rms, error = ((tuple(one[k]) if measured else (None,) * 3) for one in (drift.rms, drift.error))
            quantiles = (drift.quantile(k, 0.5), drift.quantile(k, 0.95))
            rows.append((*head, T, *rms, *quantiles, drift.whole_law[k]))
            claims.append((*head, T, *error, drift.claimed[k] if len(drift.good) else None))
            axes = np.sqrt(np.square(drift.good[:, k, :3]).mean(axis=0)) if len(drift.good) else (None,) * 3
            most = drift.sizes[:, k].max() if len(drift.good) else None
            by_axis.append((unit, units[unit].grade, phase, T, *axes, most, drift.lost))
            whole = drift.whole_law[k] ** 2
            sources += [
                (*head, T, name, part[k], 100.0 * part[k] ** 2 / whole) for name, part in drift.law.items()
            ]
        reached: tuple[Any, ...] = drift.find_times(limit) if measured else (None,) * 3
        known = (drift.whole_law, drift.claimed) if len(drift.good) else ()
        expected = [find_time(drift.grid, values, limit) for values in known] or [None, None]
        times.append((*head, *reached, *expected))
    drift_names = (
        "unit",
        "phase",
        "outage_s",
        "drift_m",
        "low_m",
        "high_m",
        "median_m",
        "p95_m",
        "predicted_m",
    )
    return (
        make_table("drift", _TITLE, drift_names, rows),
        make_table(
            "times",
            f"Time until the drift is {limit:g} m RMS, 95 % interval; predicted, reported",
            ("unit", "phase", "after_s", "low_s", "high_s", "predicted_s", "reported_s"),
            times,
        ),
        make_table(
            "sources",
            "Predicted drift by source: a calibrated IMU, and the velocity error that the receiver leaves",
            ("unit", "phase", "outage_s", "source", "rms_m", "percent"),
            sources,
        ),
        make_table(
            "reported",
            "Horizontal error: RMS with its 95 % interval, and reported sigma",
            ("unit", "phase", "outage_s", "error_m", "low_m", "high_m", "reported_m"),
            claims,
        ),
        make_table(
            "axes",
            "RMS by axis, and the largest horizontal drift",
            ("unit", "class", "phase", "outage_s", "north_m", "east_m", "down_m", "largest_m", "lost"),
            by_axis,
        ),
    )


def tell_drifts(
    units: Sequence[str],
    label: str,
    drifts: Drifts,
    pairs: Mapping[str, Sequence[PairedRatio]],
    elapsed: Sequence[float],
    limit: float,
) -> Iterator[str]:
    """Yield sentences on drift, time to the limit, its sources, pairs, reported sigmas and diverged runs."""
    for phase, told in pairs.items():
        parts, times = [], []
        grid = drifts[units[0], phase].grid
        flown = [T for T, _ in _rows(drifts[units[0], phase], elapsed)]
        near = min(flown or [float(grid[-1])], key=lambda T: abs(T - 60.0))
        if longer := [f"{T:g}" for T in elapsed if T not in flown]:
            yield f"{phase}: the outage lasts {grid[-1]:g} s; no result after {', '.join(longer)} s."
        made: dict[str, list[str]] = {}
        for unit in units:
            drift = drifts[unit, phase]
            k = int(np.argmin(np.abs(drift.grid - near)))
            known = len(drift.good) > 1
            text = format_estimate(Estimate(*drift.rms[k])) if known else "no two runs"
            parts.append(f"{unit} {text}, {format_number(drift.whole_law[k], 3)}")
            times.append(f"{unit} {_say_time(drift, limit)}")
            source = max(drift.law, key=lambda name: float(drift.law[name][k]), default="nothing")
            made.setdefault(source, []).append(unit)
        what = f"Drift after {near:g} s without GNSS, {phase}, RMS and by the closed form [m]"
        yield f"{what}: {'; '.join(parts)}."
        yield f"The drift is {limit:g} m RMS, {phase}, after: {'; '.join(times)}."
        sources = "; ".join(f"{source} ({', '.join(of)})" for source, of in made.items())
        yield f"By the closed form most of it comes from: {sources}."
        if told:
            yield f"On the same runs, {phase}: {'; '.join(pair.sentence for pair in told)}."
    yield from _tell_claims(label, drifts, elapsed)
    lost = [
        f"{unit} {phase} {drift.lost} of {len(drift.grown)}"
        for (unit, phase), drift in drifts.items()
        if drift.lost
    ]
    if lost:
        yield f"Runs that diverged, left out of all values: {', '.join(lost)}."


def _say_time(drift: Drift, limit: float) -> str:
    if len(drift.good) < 2:
        return "no two runs"
    value, low, high = ("later" if one is None else f"{one:.0f}" for one in drift.find_times(limit))
    return f"{value} s ({low} to {high})" if value != "later" else f"not in {drift.grid[-1]:g} s"


def _tell_claims(label: str, drifts: Drifts, elapsed: Sequence[float]) -> Iterator[str]:
    outside, total = Counter[str](), 0
    for (unit, _), drift in drifts.items():
        if len(drift.good) > 1:
            for _, k in _rows(drift, elapsed):
                total += 1
                outside[unit] += not drift.error[k, 1] <= drift.claimed[k] <= drift.error[k, 2]
    missed = ", ".join(f"{unit} {count}" for unit, count in outside.items() if count)
    yield (
        f"What {label} reports lies in the 95 % interval of the measured error in "
        f"{total - outside.total()} of {total} cases" + (f"; not in, by unit: {missed}." if missed else ".")
    )


def plot_drifts(units: Sequence[str], phases: Sequence[str], drifts: Drifts) -> Iterator[Plot]:
    """Yield the error of all units with its band and reported sigma, and the drift over its closed form."""
    colors = series.estimator_colors(units)
    for phase in phases:
        lines: list[Series] = []
        ratios: list[Series] = []
        key = phase.rpartition("/")[2].removesuffix(".toml")
        for unit in units:
            drift, color = drifts[unit, phase], colors[unit]
            if len(drift.good) < 2:
                continue
            name = unit.rpartition("/")[2]
            lines.append(
                Series(name, drift.grid, drift.error, (name,) * 3, (color,) * 3, (1.5, 1.0, 1.0), band=(1, 2))
            )
            rows = np.unique(np.searchsorted(drift.grid, np.geomspace(1.0, drift.grid[-1], 25)))
            lines.append(
                series.draw_dots(
                    f"{name} reported", drift.grid[rows], drift.claimed[rows], f"{name} reported", color, 3.0
                )
            )
            ratios.append(series.draw_line(name, drift.grid, drift.rms[:, 0] / drift.whole_law, name, color))
        if lines:
            title = f"{phase}: horizontal error, RMS with 95 % band, and as reported [m]"
            yield Plot(("outages", key), title, tuple(lines), over="outage", log="xy")
            title = f"{phase}: drift over its closed form"
            yield Plot(("outages", f"{key}-over-law"), title, tuple(ratios), over="outage", log="xy")
