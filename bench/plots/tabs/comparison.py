"""What estimators have in common, a line for each in one plot."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bench.arrays import FloatArray
from bench.data import ErrorSeries
from bench.plots.content import Content, Tab
from bench.plots.series import Plot, Rows, draw_line

FAR = 20.0
"""A filter whose error is so many times that of the middle one leaves a comparison, and flattens none."""


def _plots(content: Content) -> Mapping[str, Rows]:
    """Return plots of two or more estimators, scaled to those that stay near the middle one."""
    errors, colours = content.errors, content.colours
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
            draw_line(label, errors[label].t, values, label, colours[label])
            for label, values in lines.items()
            if np.isfinite(values).any()
        )
        if len(series) > 1:
            path = ("comparison", title.partition(" ")[0])
            rows.append([Plot(path, title, series, content.evaluation_from, FAR)])
    return {"": rows}


COMPARISON = Tab("Comparison", 10, _plots)
