"""Errors of position, velocity and attitude with the 3 sigma that the filter reports."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

import numpy as np

from bench.core.records.findings.series import AXES_N, Plot, Rows, draw_three_sigma
from bench.evaluation.errors.error_series import BLOCKS, variances
from bench.views.plots.content import Content, Tab


def _plots(what: str, block: str, unit: str, scale: float, content: Content) -> Mapping[str, Rows]:
    """Return the plots of a block of errors, by axis; ``scale`` converts them from SI."""
    found: dict[str, Rows] = {}
    for label, color in content.colors.items():
        solution, error = content.solutions[label], content.errors[label]
        with np.errstate(invalid="ignore"):  # a diverged covariance is a result: its sigma is NaN
            at = np.searchsorted(solution.t, error.t)
            sigma = scale * np.sqrt(variances(solution)[:, BLOCKS[block]][at])
        values = scale * getattr(error, f"{block}_n")
        rows = []
        for k, axis in enumerate(AXES_N):
            if np.isfinite(values[:, k]).any():
                title = f"{what} error about {axis}" if block == "phi" else f"{axis} {what} error"
                series = draw_three_sigma("error", error.t, values[:, k], sigma[:, k], "error", color)
                path = ("estimators", label, what, axis)
                rows.append([Plot(path, f"{label}: {title} [{unit}]", (series,), content.begin)])
        found[label] = rows
    return found


POSITION = Tab("Position", 20, partial(_plots, "position", "pos", "m", 1.0))
VELOCITY = Tab("Velocity", 30, partial(_plots, "velocity", "vel", "m/s", 1.0))
ATTITUDE = Tab("Attitude", 40, partial(_plots, "attitude", "phi", "deg", float(np.rad2deg(1.0))))
