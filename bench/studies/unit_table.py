"""Every IMU of the catalog flown on the same flights by the same filters: what a buyer compares by hand.

The catalog has no prices: the class of a unit stands for it, consumer, industrial, tactical, navigation.
Beside what is measured stand the drift in 60 s that its datasheet alone expects, and how many figures no
source states: these are zero in the model, which flatters the unit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from bench.campaigns.campaign_file import CampaignSpec
from bench.campaigns.outcome import Outcome
from bench.config.datasheets import read_imu
from bench.config.library import find_datasheet
from bench.evaluation.drift_laws import drift_sd
from bench.evaluation.ensemble import Estimate, pool_rmse
from bench.places import PACKAGE
from bench.plots import series
from bench.plots.series import Plot
from bench.studies.catalog_units import CLASSES, Unit, find_units
from bench.studies.study import (
    Count,
    Findings,
    StudyOptions,
    StudyTable,
    Words,
    Work,
    format_estimate,
    make_table,
)

_LAW_S = 60.0  # of the expected drift [s]
_MANY = 8  # figures that no source states


class Options(StudyOptions):
    """What may be asked."""

    units: Words = (
        *("hg9900", "ln-100", "hg1700", "hg4930-ca51", "ln-200", "stim300"),
        *("adis16475", "adis16495", "mti-300", "vn-100"),
        *("bmi088", "icm-20948", "icm-42688-p", "icm-45686", "lsm6dsl", "mpu-6050", "mpu-9250"),
    )
    """IMUs of the catalog"""
    profiles: Words = ("gnss-denied-leg",)
    """flights"""
    estimators: Words = ("loose-15", "loose-full")
    """filters"""
    draws: Count = 6
    """noise draws of each unit on each flight"""


def run(options: Options, work: Work) -> Findings:
    """Return the table of units, and which are beaten by none of a lower class."""
    units = find_units("sensors", options.units)
    spec = CampaignSpec(
        name="sensors",
        profiles=options.profiles,
        runs=options.draws,
        estimators=options.estimators,
        varied=tuple({"sensors.imu": name} for name in options.units),
    )
    found = work.campaign("units on flights", spec)
    laws = {name: find_law(name) for name in options.units}
    rows = list(_gather(found.outcomes, found.runs.to_pylist(), options))
    return Findings(
        verdicts=tuple(_tell(rows, units, options)),
        tables=_fill(rows, units, laws),
        figures=tuple(_plot(rows, units, laws, options)),
        draws=options.draws,
    )


def find_law(name: str) -> float:
    """Return the root mean square of the horizontal drift in 60 s that the datasheet expects [m]."""
    spec = read_imu(*find_datasheet("imu", name, PACKAGE))
    return float(np.sqrt(2.0) * drift_sd(_LAW_S, spec))


class _Row(dict[str, Any]):
    """One unit on one flight by one filter: its names, and an estimate or None by metric."""


def _gather(
    outcomes: Sequence[Outcome], runs: Sequence[Mapping[str, Any]], options: Options
) -> Iterator[_Row]:
    conditions = [(profile, unit) for profile in options.profiles for unit in options.units]
    each = len(outcomes) // len(conditions)
    for k, one in enumerate(outcomes):
        profile, unit = conditions[k // each]
        mine = [
            row
            for row in runs
            if row["profile"] == profile and row["sensors.imu"] == unit and row["estimator"] == one.label
        ]
        yield _Row(
            unit=unit,
            profile=profile,
            estimator=one.label,
            position=one.errors.get("pos_rmse_h_m"),
            heading=one.errors.get("heading_rmse_deg"),
            drift=_pool_drift(mine),
            converged=one.converged_runs,
        )


def _pool_drift(rows: Sequence[Mapping[str, Any]]) -> Estimate | None:
    """Return the horizontal drift at the end of the longest outage, over runs; None without an outage."""
    names = [name for name in (rows[0] if rows else ()) if name.startswith("outage_") and "drift_h_m" in name]
    values = np.array([[row[name] for name in names] for row in rows if row["converged"]], float)
    if not names or len(values) < 2:
        return None
    return pool_rmse(np.square(np.nanmax(values, axis=1)))


def _fill(
    rows: Sequence[_Row], units: Mapping[str, Unit], laws: Mapping[str, float]
) -> tuple[StudyTable, StudyTable]:
    """Return the drift in the outage, and the errors of the whole flight."""
    drifts, errors = [], []
    for row in rows:
        unit, position, heading = row["unit"], row["position"], row["heading"]
        names = (unit, row["profile"], row["estimator"])
        grade = (units[unit].grade, units[unit].absent, row["converged"])
        drifts.append((*names, *_list_ends(row["drift"]), *grade))
        errors.append((*names, *_list_ends(position), heading.value if heading else None, laws[unit]))
    names = ("unit", "profile", "estimator")
    columns = (*names, "drift_m", "low_m", "high_m", "class", "absent", "runs")
    more = (*names, "pos_rmse_h_m", "low_m", "high_m", "heading_deg", f"law_{_LAW_S:g}_s_m")
    return (
        make_table("drift", "Horizontal drift in the outage: RMS with its 95 % interval", columns, drifts),
        make_table("errors", "RMSE over the flight, and the drift that the datasheet expects", more, errors),
    )


def _list_ends(found: Estimate | None) -> tuple[float | None, ...]:
    return (found.value, found.low, found.high) if found else (None, None, None)


def find_front(rows: Sequence[_Row], units: Mapping[str, Unit], figure: str) -> list[str]:
    """Return the units that no unit of the same or a lower class beats, from the lowest class on."""
    ranked = sorted(
        (CLASSES.index(units[row["unit"]].grade), row[figure].value, row["unit"])
        for row in rows
        if row[figure] is not None and units[row["unit"]].grade in CLASSES
    )
    front: list[str] = []
    best = np.inf
    for _, value, name in ranked:
        if value < best:
            front.append(name)
            best = value
    return front


def _choose_figure(rows: Sequence[_Row]) -> tuple[str, str]:
    """Return the figure that is compared, and what it is."""
    if any(row["drift"] is not None for row in rows):
        return "drift", "horizontal drift in the outage [m]"
    return "position", "horizontal RMSE [m]"


def _tell(rows: Sequence[_Row], units: Mapping[str, Unit], options: Options) -> Iterator[str]:
    for profile in options.profiles:
        for label in dict.fromkeys(row["estimator"] for row in rows):
            here = [row for row in rows if row["profile"] == profile and row["estimator"] == label]
            figure, what = _choose_figure(here)
            values = {row["unit"]: row[figure] for row in here}
            told = [
                f"{name} ({units[name].grade}) {format_estimate(values[name])}"
                for name in find_front(here, units, figure)
            ]
            yield f"{profile}, {label}, {what}: beaten by no unit of its class or below: {'; '.join(told)}."
    bare = [name for name in units if units[name].absent >= _MANY]
    if bare:
        yield f"Flattered: {_MANY} or more figures are stated nowhere and zero here, of {', '.join(bare)}."
    lost = sorted({row["unit"] for row in rows if row["converged"] < options.draws})
    if lost:
        yield f"Not every run converged with {', '.join(lost)}."


def _plot(
    rows: Sequence[_Row], units: Mapping[str, Unit], laws: Mapping[str, float], options: Options
) -> Iterator[Plot]:
    """Yield the figure over the class, with its front, and over what the datasheet expects."""
    labels = list(dict.fromkeys(row["estimator"] for row in rows))
    colours = series.estimator_colours(labels)
    for profile in options.profiles:
        by_class, by_law = [], []
        for label in labels:
            here = [row for row in rows if row["profile"] == profile and row["estimator"] == label]
            figure, what = _choose_figure(here)
            here = [row for row in here if row[figure] is not None and units[row["unit"]].grade in CLASSES]
            if not here:
                continue
            y = np.array([row[figure].value for row in here])
            rank = np.array([1.0 + CLASSES.index(units[row["unit"]].grade) for row in here])
            law = np.array([laws[row["unit"]] for row in here])
            front = find_front(here, units, figure)
            at = np.array([[row["unit"] for row in here].index(name) for name in front])
            by_class.append(series.draw_dots(f"{label} units", rank, y, label, colours[label], 4.0))
            by_class.append(series.draw_line(label, rank[at], y[at], f"{label}, front", colours[label]))
            by_law.append(series.draw_dots(label, law, y, label, colours[label], 4.0))
        if by_class:
            over = "class: 1 consumer, 2 industrial, 3 tactical, 4 navigation"
            yield Plot(
                ("sensors", f"{profile}-by-class"),
                f"{profile}: {what}",
                tuple(by_class),
                across="1",
                over=over,
                log="y",
            )
            yield Plot(
                ("sensors", f"{profile}-by-datasheet"),
                f"{profile}: {what}",
                tuple(by_law),
                across="m",
                over=f"drift in {_LAW_S:g} s that the datasheet expects",
                log="xy",
            )
