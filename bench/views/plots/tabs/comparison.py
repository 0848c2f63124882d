"""Quantities that filters have in common, a line for each filter in one plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.findings.series import Plot, Rows, draw_line
from bench.core.records.run_records import ErrorSeries
from bench.views.plots.content import FAR, Content, Tab

LEAST = 1e-3
"""Smaller errors are drawn as this on a logarithmic scale."""


def _plots(content: Content) -> Mapping[str, Rows]:
    """Return plots of two or more filters, scaled to the filters with errors near the median."""
    errors, looks = content.errors, content.looks
    sizes: dict[str, Callable[[ErrorSeries], FloatArray]] = {
        "horizontal position error [m]": lambda e: np.hypot(e.pos_n[:, 0], e.pos_n[:, 1]),
        "vertical position error [m]": lambda e: e.pos_n[:, 2],
        "velocity error, 3D [m/s]": lambda e: np.linalg.norm(e.vel_n, axis=1),
        "heading error [deg]": lambda e: np.rad2deg(e.heading),
    }
    rows = []
    for title, size in sizes.items():
        lines = {label: size(error) for label, error in errors.items()}
        series = tuple(
            draw_line(label, errors[label].t, values, label, looks[label].color, dashed=looks[label].dashed)
            for label, values in lines.items()
            if np.isfinite(values).any()
        )
        if len(series) > 1:
            path = ("comparison", title.partition(" ")[0])
            plot = Plot(path, title, series, content.begin, FAR)
            rows.append([plot, _take_sizes(plot)])
    return {"": rows}


def _take_sizes(plot: Plot) -> Plot:
    """Return a plot of the sizes on a logarithmic axis, so that a diverging line leaves others readable."""
    lines = [replace(one, values=np.maximum(np.abs(one.values), LEAST)) for one in plot.series]
    path = ("comparison-log", plot.path[1])
    return replace(plot, path=path, title=f"size of {plot.title}", series=tuple(lines), far=np.inf, log="y")


COMPARISON = Tab("Comparison", 10, _plots)
