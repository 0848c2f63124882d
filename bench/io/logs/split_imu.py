"""An IMU with gyros and accelerometers in tables, or at least with times, of their own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from bench.core.mathematics.arrays import FloatArray
from bench.io.config.log import SourceSpec
from bench.io.logs.formats.joined_triads import join_triads
from bench.io.logs.rows import IMU, MOST_ROWS, LogRows
from bench.io.logs.table_files import group, read_table

_TRIADS = {
    "gyro": group("rate", *(f"gyro_{axis}" for axis in "xyz")),
    "accel": group("acceleration", *(f"accel_{axis}" for axis in "xyz")),
}


def read_split(source: SourceSpec) -> LogRows:
    """Read gyros and accelerometers from two tables, at the times of the gyros.

    Raises
    ------
    ConfigError
        If a table cannot be read, or they have no time in common.
    """
    assert source.gyro_path is not None
    gyro_t, gyro = _read_triad(source.gyro_path, "gyro", source.gyro_columns)
    accel_t, accel = _read_triad(source.path, "accel", source.columns)
    shown = source.path.name if source.path == source.gyro_path else source.gyro_path.name
    return join_triads(gyro_t, gyro, accel_t, accel, shown)


def _read_triad(path: Path, triad: str, columns: Mapping[str, str]) -> tuple[FloatArray, FloatArray]:
    """Return times and values of the rows of a triad that have both."""
    kinds = {"time": IMU["time"], "fraction": IMU["fraction"], triad: (_TRIADS[triad],)}
    found = read_table(path, kinds, ("fraction",), MOST_ROWS, columns).columns
    t = found["time"][:, 0]
    return (t + found["fraction"][:, 0] if "fraction" in found else t), found[triad]
