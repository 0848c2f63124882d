"""Conversion of a plot to a recording: lines and dots, thinned, and hatches for shaded intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import rerun as rr

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings.series import Plot, Series, Shade, select_rows, take_logarithms

TIMELINE = "flight_time"

HATCH = 1.0 / 600.0
"""Distance of the strokes that mark an outage, as a fraction of the flight."""


def entity(*parts: str) -> str:
    """Return an entity path, with reserved characters of rerun escaped in each part."""
    return "/" + "/".join(rr.escape_entity_path_part(part) for part in parts)


def send(stream: Any, plot: Plot, shades: Sequence[Shade]) -> None:
    """Send the series of a plot, and shades over its whole height."""
    for series in plot.series:
        path, names = entity(*plot.path, series.key), list(series.names)
        colors = [list(color) for color in series.colors]
        style = (
            rr.SeriesPoints(colors=colors, names=names, marker_sizes=series.widths)
            if series.marks
            else rr.SeriesLines(colors=colors, names=names, widths=_choose_widths(series))
        )
        stream.log(path, style, static=True)
        keep = select_rows(series)
        send_scalars(stream, path, series.t[keep], series.values[keep])
    for shade in shades:
        _send_shade(stream, entity(*plot.path, "behind", shade.key), shade, plot)


def _choose_widths(series: Series) -> list[float]:
    return [0.5 * one if series.dashed else one for one in series.widths]  # the viewer has no dashes


def linearize(plot: Plot) -> Plot:
    """Return a plot of logarithms, because the viewer has no logarithmic axes."""
    if not plot.log:
        return plot
    title = f"log10 of {plot.title}" if "y" in plot.log else plot.title
    return replace(take_logarithms(plot), title=title, log="")


def send_scalars(stream: Any, entity: str, t: FloatArray, values: FloatArray) -> None:
    """Send values (N, k); a row of only NaN becomes an empty row, at which lines break."""
    there = ~np.isnan(values).all(axis=1)
    if len(t):
        stream.send_columns(
            entity,
            [rr.TimeColumn(TIMELINE, duration=t)],
            rr.Scalars.columns(scalars=values[there].ravel()).partition(values.shape[1] * there),
        )


def _send_shade(stream: Any, entity: str, shade: Shade, plot: Plot) -> None:
    """Send a hatch over the height of a plot: it has no shaded region, and a wide line ends in round caps."""
    low, high = plot.limits()
    spacing = HATCH * max(float(series.t[-1]) for series in plot.series if len(series.t))
    t, y = [], []
    for start, end in shade.intervals:
        strokes = max(2, round((end - start) / spacing))
        t.append(np.append(np.linspace(start, end, strokes + 1), end + 1e-6))
        y.append(np.append(np.where(np.arange(strokes + 1) % 2, low, high), np.nan))
    stream.log(
        entity,
        rr.SeriesLines(
            colors=[[*shade.color, 50]],
            names=shade.name,
            widths=1.0,
            aggregation_policy=rr.components.AggregationPolicy.Off,
        ),
        static=True,
    )
    send_scalars(stream, entity, np.concatenate(t), np.concatenate(y)[:, None])
