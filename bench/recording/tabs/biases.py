"""Biases as estimated, with 3 sigma, and as they were drawn."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bench.arrays import FloatArray
from bench.data import NavSolution
from bench.instruments import INSTRUMENTS
from bench.recording.content import Content, Tab
from bench.recording.drawing import AXES_B, TRUTH, Colour, Plot, Rows, Series, draw_line, entity, paler, thin
from bench.units import STANDARD_GRAVITY

_DEG_H = np.rad2deg(1.0) * 3600.0  # rad/s to deg/h
_MG = 1e3 / STANDARD_GRAVITY  # m/s^2 to mg (standard gravity)


def _plots(content: Content) -> Mapping[str, Rows]:
    return {label: _rows(content, label, colour) for label, colour in content.colours.items()}


def _rows(content: Content, label: str, colour: Colour) -> Rows:
    drawn, solution = content.sensed.truth, content.solutions[label]
    gyro = [
        (
            f"gyro_bias_{a}",
            f"gyro bias {a} [deg/h]",
            _DEG_H,
            solution.gyro_bias_b[:, k],
            drawn.gyro_bias_b[:, k],
        )
        for k, a in enumerate(AXES_B)
    ]
    accel = [
        (
            f"accel_bias_{a}",
            f"accelerometer bias {a} [mg]",
            _MG,
            solution.accel_bias_b[:, k],
            drawn.accel_bias_b[:, k],
        )
        for k, a in enumerate(AXES_B)
    ]
    unknown = np.full((len(drawn.t), 1), np.nan)
    others = [
        (
            f"{name}_bias",
            f"{name} bias [{row.unit}]",
            1.0,
            _extra(solution, f"{name}_bias", solution.extra),
            drawn.bias.get(name, unknown)[:, 0],
        )
        for name, row in INSTRUMENTS.items()
    ]
    rows = []
    for group in (gyro, accel, others):
        row = []
        for name, title, unit, estimate, true in group:
            if not np.isfinite(estimate).any():
                continue
            sd = 3.0 * _extra(solution, name, solution.extra_sd)
            keep = thin(solution.t)
            pale = paler(colour)
            values = unit * np.column_stack([estimate, estimate + sd, estimate - sd])[keep]
            estimated = Series(
                "estimated",
                solution.t[keep],
                values,
                ("estimated", "±3σ", "±3σ"),
                (colour, pale, pale),
                (1.5, 1.0, 1.0),
            )
            drawn_line = [draw_line("true", drawn.t, unit * true, "true", TRUTH)] if len(drawn.t) else []
            series = (estimated, *drawn_line)
            path = entity("estimators", label, "bias", name)
            row.append(Plot(path, f"{label}: {title}", series, content.evaluation_from))
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
