"""Axes and signs of a recorded sensor, as its table of the log gives them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.io.config.log import SourceSpec
from bench.io.logs.rows import LogRows

_GYROS, _FORCES = ("gyro", "dtheta"), ("accel", "dvel")
_UNCHANGED = (1, 2, 3)


def turn_axes(rows: LogRows, source: SourceSpec) -> LogRows:
    """Return rows along the axes of the log, with specific forces that point up at rest."""
    of_names = {"field_b": (source.axes, 1.0)} | dict.fromkeys(_GYROS, (source.gyro_axes, 1.0))
    of_names |= dict.fromkeys(_FORCES, (source.accel_axes, -1.0 if source.gravity else 1.0))
    turned = {
        name: _turn(rows.values[name], axes, sign)
        for name, (axes, sign) in of_names.items()
        if name in rows.values and (axes != _UNCHANGED or sign < 0)
    }
    return replace(rows, values={**rows.values, **turned}) if turned else rows


def _turn(values: FloatArray, axes: tuple[int, int, int], sign: float) -> FloatArray:
    columns, signs = [abs(axis) - 1 for axis in axes], sign * np.sign(axes).astype(float)
    return disk_arrays.fill(values.shape, lambda block: values[block][:, columns] * signs)
