"""Errors of position, velocity and attitude with the 3 sigma that the filter claims."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from bench.arrays import FloatArray
from bench.data import ErrorSeries
from bench.recording.content import Content, Tab
from bench.recording.drawing import AXES_N, Plot, Rows, draw_three_sigma, entity


def _position(error: ErrorSeries, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    return error.pos_n, sd[:, :3]


def _velocity(error: ErrorSeries, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    return error.vel_n, sd[:, 3:6]


def _attitude(error: ErrorSeries, sd: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.rad2deg(error.phi_n), np.rad2deg(sd[:, 6:])


def _plots_of(
    what: str, unit: str, block: Callable[[ErrorSeries, FloatArray], tuple[FloatArray, FloatArray]]
) -> Callable[[Content], Mapping[str, Rows]]:
    """Return what draws a block of the error (M, 3) and of its standard deviation (M, 9), in ``unit``."""

    def plots(content: Content) -> Mapping[str, Rows]:
        found: dict[str, Rows] = {}
        for label, colour in content.colours.items():
            solution, error = content.solutions[label], content.errors[label]
            with np.errstate(invalid="ignore"):  # a diverged covariance is a result: its sigma is NaN
                sd = np.sqrt(np.einsum("kii->ki", solution.cov))[np.searchsorted(solution.t, error.t)]
            values, sigma = block(error, sd)
            rows = []
            for k, axis in enumerate(AXES_N):
                if np.isfinite(values[:, k]).any():
                    title = f"{what} error about {axis}" if what == "attitude" else f"{axis} {what} error"
                    series = draw_three_sigma("error", error.t, values[:, k], sigma[:, k], "error", colour)
                    path = entity("estimators", label, what, axis)
                    title = f"{label}: {title} [{unit}]"
                    rows.append([Plot(path, title, (series,), content.evaluation_from)])
            found[label] = rows
        return found

    return plots


POSITION = Tab("Position", 20, _plots_of("position", "m", _position))
VELOCITY = Tab("Velocity", 30, _plots_of("velocity", "m/s", _velocity))
ATTITUDE = Tab("Attitude", 40, _plots_of("attitude", "deg", _attitude))
