"""Estimated biases with 3 sigma, and the simulated biases."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.records.data import NavSolution
from bench.core.records.findings.series import (
    AXES_B,
    DRIFTING,
    TRUTH,
    Plot,
    Rows,
    draw_line,
    draw_three_sigma,
)
from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.palette import Color
from bench.views.plots.content import Content, Tab

_DEG_H = np.rad2deg(1.0) * 3600.0  # rad/s to deg/h
_MG = 1e3 / STANDARD_GRAVITY  # m/s^2 to mg (standard gravity)


def _plots(content: Content) -> Mapping[str, Rows]:
    return {label: _rows(content, label, color) for label, color in content.colors.items()}


def _rows(content: Content, label: str, color: Color) -> Rows:
    """Return a row of plots each for the gyros, the accelerometers and the other instruments."""
    drawn, solution = content.sensed.truth, content.solutions[label]
    unknown = np.full((len(drawn.t), 1), np.nan)
    groups = [
        [
            (f"{triad}_bias_{axis}", f"{title} bias {axis} [{unit}]", scale, estimate[:, k], true[:, k])
            for k, axis in enumerate(AXES_B)
        ]
        for triad, title, unit, scale, estimate, true in (
            ("gyro", "gyro", "deg/h", _DEG_H, solution.gyro_bias_b, drawn.gyro_bias_b),
            ("accel", "accelerometer", "mg", _MG, solution.accel_bias_b, drawn.accel_bias_b),
        )
    ]
    groups.append(
        [
            (
                f"{name}_bias",
                f"{name} bias [{row.unit}]",
                1.0,
                _extra(solution, f"{name}_bias", solution.extra),
                drawn.bias.get(name, unknown)[:, 0],
            )
            for name, row in INSTRUMENTS.items()
        ]
    )
    rows = []
    for group in groups:
        row = []
        for name, title, scale, estimate, true in group:
            if not np.isfinite(estimate).any():
                continue
            sd = scale * _extra(solution, name, solution.extra_sd)
            value = scale * estimate
            series = [
                draw_three_sigma("estimated", solution.t, value, sd, "estimated", color, value, DRIFTING)
            ]
            if len(drawn.t):
                series.append(draw_line("true", drawn.t, scale * true, "true", TRUTH, DRIFTING))
            path = ("estimators", label, "bias", name)
            row.append(Plot(path, f"{label}: {title}", tuple(series), content.begin))
        if row:
            rows.append(row)
    return rows


def _extra(solution: NavSolution, name: str, columns: FloatArray) -> FloatArray:
    """Return the column of the extra state ``name_<unit>``, NaN when there is none."""
    for k, full in enumerate(solution.extra_names):
        if full.startswith(f"{name}_"):
            return columns[:, k]
    return np.full(len(solution), np.nan)


BIASES = Tab("Biases", 50, _plots)
