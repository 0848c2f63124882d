"""Read the log of an IMU at rest, to measure its Allan deviation."""

from __future__ import annotations

import csv
import math
from pathlib import Path

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.evaluation.noise_curves import INDEPENDENT
from bench.units import STANDARD_GRAVITY

FEWEST = 2 * INDEPENDENT
"""Fewest rows: the shortest averaging time needs them."""
_COLUMNS = {
    "gyro": {"rad_s": 1.0, "deg_s": math.radians(1.0)},
    "accel": {"m_s2": 1.0, "g": STANDARD_GRAVITY},
}
"""Triad -> unit at the end of its column names -> factor to SI."""


def read_resting_log(path: Path) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Return the times (N,) [s] and the rates (N, 3) of each triad, in SI.

    Parameters
    ----------
    path : Path
        CSV with a header: ``t_s`` and one or both triads, ``gyro_x_rad_s``, ``gyro_y_rad_s``,
        ``gyro_z_rad_s`` (or ``deg_s``), ``accel_x_m_s2`` ... (or ``g``): rates, not increments. Other columns
        are not read.

    Raises
    ------
    ConfigError
        If the file is missing, is not such a table, has irregular times or is too short. The message names
        file and line.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = csv.reader(file)
            header = [name.strip() for name in next(rows, [])]
            wanted = _choose_columns(path, header)
            table = []
            for number, row in enumerate(rows, 2):
                try:
                    table.append([float(row[column]) for column, _ in wanted])
                except (ValueError, IndexError):
                    raise ConfigError(
                        f"{path}: line {number}: needs a number in every column of {', '.join(header)}"
                    ) from None
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file") from None
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file in UTF-8") from None
    values = np.array(table) * [factor for _, factor in wanted] if table else np.empty((0, 1))
    if len(values) < FEWEST:
        raise ConfigError(f"{path}: {len(values)} samples; at least {FEWEST} are needed")
    if not np.isfinite(values).all():
        line = 2 + int(np.argmin(np.isfinite(values).all(axis=1)))
        raise ConfigError(f"{path}: line {line}: a value is not finite")
    t = values[:, 0]
    step = float(np.median(np.diff(t)))
    wrong = np.flatnonzero(np.abs(np.diff(t) - step) > 0.5 * max(step, 0.0))
    if step <= 0 or len(wrong):
        line = 3 + (int(wrong[0]) if len(wrong) else 0)
        raise ConfigError(
            f"{path}: line {line}: t_s must increase by about {step:g} s, as in the rest of the file"
        )
    names = [name for name in _COLUMNS if any(column.startswith(f"{name}_x_") for column in header)]
    return t, {name: values[:, 1 + 3 * k : 4 + 3 * k] for k, name in enumerate(names)}


def _choose_columns(path: Path, header: list[str]) -> list[tuple[int, float]]:
    """Return index and factor to SI of each column to read: time, then three for each triad in the file."""
    if "t_s" not in header:
        raise ConfigError(f"{path}: line 1: no column 't_s'; the header is {', '.join(header)[:80]!r}")
    wanted = [(header.index("t_s"), 1.0)]
    for triad, units in _COLUMNS.items():
        given = [unit for unit in units if f"{triad}_x_{unit}" in header]
        if len(given) > 1:
            raise ConfigError(f"{path}: line 1: {triad} is given in two units; give one of them")
        for unit in given:
            for axis in "xyz":
                column = f"{triad}_{axis}_{unit}"
                if column not in header:
                    raise ConfigError(f"{path}: line 1: no column {column!r}")
                wanted.append((header.index(column), units[unit]))
    if len(wanted) == 1:
        raise ConfigError(f"{path}: line 1: no column 'gyro_x_rad_s' or 'accel_x_m_s2' with its y and z")
    return wanted
