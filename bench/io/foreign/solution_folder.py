"""Solutions of many runs in a folder: ``use = "file:FOLDER"``, a subfolder for each run.

A subfolder is named by the sensor data and the start, so that no solution is taken for another run.
`write_sensors` makes it, with the data as ``bench export --to csv`` writes them; ``solution.csv`` is the
answer.
"""

from __future__ import annotations

import gzip
import hashlib
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.core.files import durable
from bench.core.records.data import ImuData, InitialState, NavSolution, SensorData
from bench.core.words.exceptions import ConfigError, EstimatorError
from bench.io.exports.column_files import write as write_tables
from bench.io.exports.outgoing import ExportData
from bench.io.foreign.solutions import FileEstimator
from bench.io.results import make_start_document

SOLUTION = "solution.csv"
"""The answer, in the folder of its sensor data."""

SENSORS = "sensors"
"""Folder with the tables, beside the answer; those of many rows are compressed (gzip)."""

_FINE = 0.05  # resolution of increments over the noise of a sample: 2e-4 of its variance at most
_MANY = 1 << 16  # a table above is compressed [byte]

_DIGITS = 6  # of the figures in a name: another processor may differ in the last of sixteen


def write_sensor_tables(folder: Path, sensors: SensorData, initial: InitialState) -> None:
    """Write sensor data and start as CSV into an existing, empty folder, without the truth.

    Raises
    ------
    OSError
        If a file cannot be written.
    """
    out = ExportData(
        imu=sensors.imu,
        fixes=sensors.fixes,
        observations=sensors.observations,
        instruments=sensors.instruments,
        start=make_start_document(sensors, initial),
        output_t=sensors.output_t,
    )
    write_tables(folder, out, "csv")


def write_sensors(root: Path, sensors: SensorData, initial: InitialState) -> Path:
    """Write sensor data into the folder of their name below ``root``, and return it.

    Raises
    ------
    ConfigError
        If the folder is there already.
    OSError
        If a file cannot be written.
    """
    folder = root / name_draw(sensors, initial)
    try:
        (folder / SENSORS).mkdir(parents=True)
    except FileExistsError:
        raise ConfigError(f"{folder}: exists; name a new folder") from None
    thin = replace(sensors, imu=round_increments(sensors.imu))
    write_sensor_tables(folder / SENSORS, thin, initial)
    for path in sorted((folder / SENSORS).iterdir()):
        if path.stat().st_size > _MANY:
            packed = gzip.compress(path.read_bytes(), mtime=0)
            durable.write(path.with_name(f"{path.name}.gz"), packed)
            path.unlink()
    return folder


def round_increments(imu: ImuData) -> ImuData:
    """Return the data of an IMU with increments rounded to the digits that its noise justifies.

    The noise of a sample is told by the second differences of neighbors; a unit without noise keeps all.
    """
    columns = {}
    for name in ("dtheta_b", "dvel_b"):
        values = getattr(imu, name)
        bends = np.diff(values[imu.valid], 2, axis=0)
        noise = float(np.median(np.abs(bends))) / (0.6745 * 6.0**0.5) if len(bends) else 0.0
        digits = -math.floor(math.log10(_FINE * noise)) if noise > 1e-12 else None
        columns[name] = values if digits is None else np.round(values, digits)
    return replace(imu, **columns)


def name_draw(sensors: SensorData, initial: InitialState) -> str:
    """Return the name of a set of sensor data and its initial state: a digest of values of both."""
    imu, fixes = sensors.imu, sensors.fixes
    good = imu.valid
    figures = [len(imu.t), *np.std(imu.dtheta_b[good], axis=0), *np.std(imu.dvel_b[good], axis=0)]
    if fixes is not None:
        figures += [len(fixes), *np.nanstd(fixes.lla, axis=0)]
    text = " ".join(f"{float(x):.{_DIGITS}e}" for x in figures)
    latency = 0.0 if fixes is None else np.mean(fixes.t_arrival - fixes.t)
    for x in (latency, *initial.vel_n, *initial.q_nb):  # they may be zero but for round-off
        text += f" {round(float(x), _DIGITS) + 0.0:.{_DIGITS}f}"
    return hashlib.sha256(text.encode()).hexdigest()[:16]


class FolderEstimator:
    """Filter that returns the solution for its sensor data from a folder of many solutions.

    Parameters
    ----------
    folder : Path
        It holds ``<name>/solution.csv`` for each set of sensor data; `name_draw` gives the name.
    t_0_s, max_gap_s
        As for `bench.io.foreign.solutions.FileEstimator`.
    """

    def __init__(self, folder: Path, *, t_0_s: float = 0.0, max_gap_s: float | None = None) -> None:
        self._folder, self._options = folder, {"t_0_s": t_0_s, "max_gap_s": max_gap_s}

    def run(self, sensors: SensorData, initial: InitialState) -> NavSolution:
        """Return the solution at ``sensors.output_t``; NaN at times that it does not cover."""
        path = self._folder / name_draw(sensors, initial) / SOLUTION
        if not path.is_file():
            raise EstimatorError(f"{path}: no such file. Expected the solution of these sensor data")
        return FileEstimator(path, **self._options).run(sensors, initial)  # type: ignore[arg-type]
