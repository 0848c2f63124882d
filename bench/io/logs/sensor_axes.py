"""Axes and signs of a recorded sensor, as its table of the log gives them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import FloatArray
from bench.io.config.log import SourceSpec
from bench.io.logs.rows import LogRows

_VECTORS = ("gyro", "accel", "dtheta", "dvel", "field_b")
_FORCES = ("accel", "dvel")
_UNCHANGED = (1, 2, 3)


def turn_axes(rows: LogRows, source: SourceSpec) -> LogRows:
    """Return rows along the axes of the log, with specific forces that point up at rest."""
    if source.axes == _UNCHANGED and not source.gravity:
        return rows
    columns = [abs(axis) - 1 for axis in source.axes]
    signs = np.sign(source.axes).astype(float)

    def turn(values: FloatArray, factors: FloatArray) -> FloatArray:
        return disk_arrays.fill(values.shape, lambda block: values[block][:, columns] * factors)

    turned = {
        name: turn(rows.values[name], -signs if source.gravity and name in _FORCES else signs)
        for name in _VECTORS
        if name in rows.values
    }
    return replace(rows, values={**rows.values, **turned})
