"""Innovations of each sensor with the 3 sigma that the filter expects, their NIS, and the NEES."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.core.mathematics.arrays import BoolArray
from bench.core.records.data import Innovations
from bench.core.records.findings.series import (
    AXES_N,
    BAND,
    MOST_ROWS,
    REJECTED,
    Plot,
    Rows,
    Series,
    break_at_gaps,
    draw_dots,
    draw_line,
    shorten,
)
from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.palette import Color
from bench.evaluation.consistency.chi_square import chi2_quantile, nis_by_sensor
from bench.views.plots.content import Content, Tab

_MEASURED = {
    "gnss_position": ("GNSS position", "m"),
    "gnss_velocity": ("GNSS velocity", "m/s"),
    "pseudorange": ("pseudorange", "m"),
    "range_rate": ("range rate", "m/s"),
    **{row.innovation: (row.quantity, row.unit) for row in INSTRUMENTS.values()},
}
"""Title and unit by sensor."""
_WIDE = 3  # plots in a row


def _plots(content: Content) -> Mapping[str, Rows]:
    return {label: _rows(content, label, color) for label, color in content.colors.items()}


def _rows(content: Content, label: str, color: Color) -> Rows:
    """Return a row per sensor of several components; then scalar sensors, each NIS, and the NEES."""
    rows: list[list[Plot]] = []
    others: list[Plot] = []
    error, table = content.errors[label], content.solutions[label].innovations
    for sensor, nis in nis_by_sensor(table).items():
        title, unit = _MEASURED.get(sensor, (sensor, "SI"))
        here = table.code == table.sensor.index(sensor)
        components = np.unique(table.component[here])
        row = []
        for component in components:
            axis, name = "value", title
            if len(components) > 1:
                axis = AXES_N[component]
                name += f", {axis}"
            series = _innovation_series(table, here & (table.component == component), color)
            path = ("estimators", label, "innovation", sensor, axis)
            row.append(Plot(path, f"{label}: {name} [{unit}]", series, content.begin))
        squares = draw_dots("value", nis.t, nis.nis, "NIS", color)
        place = ("estimators", label, "nis", sensor)
        dof = int(nis.dof.max())
        consistency = _chi_square(content, place, f"{label}: NIS of {title}", squares, dof)
        if len(row) > 1:
            rows.append(row)
            others.append(consistency)
        else:
            others += [*row, consistency]
    if np.isfinite(error.nees).any():
        t, squared = break_at_gaps(error.t, error.nees[:, None])
        nees = draw_line("value", t, squared[:, 0], "NEES", color, MOST_ROWS)
        others.append(
            _chi_square(content, ("estimators", label, "nees"), f"{label}: NEES", nees, error.states)
        )
    return rows + [others[k : k + _WIDE] for k in range(0, len(others), _WIDE)]


def _innovation_series(table: Innovations, rows: BoolArray, color: Color) -> tuple[Series, ...]:
    t, z, three, used = table.t[rows], table.z[rows], 3.0 * np.sqrt(table.S[rows]), table.accepted[rows]
    ends, gates = break_at_gaps(t, np.column_stack([three, -three]))  # none while the sensor is silent
    bounds = Series("bounds", ends, gates, ("±3√S",) * 2, (BAND,) * 2, (1.0, 1.0), band=(0, 1))
    series = [shorten(bounds), draw_dots("used", t[used], z[used], "used", color)]
    if not used.all():
        series.append(draw_dots("rejected", t[~used], z[~used], "rejected", REJECTED, size=3.0))
    return tuple(series)


def _chi_square(content: Content, path: tuple[str, ...], title: str, squares: Series, dof: int) -> Plot:
    """Return a plot of normalized squares with the central 95 % of chi-square."""
    edges = [chi2_quantile(0.025, dof), chi2_quantile(0.975, dof)]
    t, values = squares.t[[0, -1]], np.array([edges, edges])
    band = Series("band", t, values, ("95 % band",) * 2, (BAND,) * 2, (1.0, 1.0), band=(0, 1))
    return Plot(path, f"{title} ({dof} expected)", (band, squares), content.begin)


INNOVATIONS = Tab("Innovations", 60, _plots)
