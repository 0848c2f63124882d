"""Find the texts of KF-GINS, which have no column names, by their values."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs import formats
from bench.io.logs.sensor_search import TEXT, FoundSensor
from bench.io.logs.table_files import list_columns

_UNKNOWN = -1.0  # that receivers write for a standard deviation they do not know
_FORCES = (5.0, 20.0)  # that the median specific force is between [m/s^2]
_FASTEST = 10.0  # median angular rate of no vehicle [rad/s]


def has_names(path: Path) -> bool:
    """Tell whether a text is a table with names above its columns; raise ConfigError if it is not a text."""
    return any(re.search(r"[a-z]{2}", name.lower()) for name in list_columns(path))


def find_texts(path: Path) -> dict[str, FoundSensor]:
    """Return the files of increments and fixes of KF-GINS, which have no column names, by their values.

    Raises
    ------
    ConfigError
        If the file has no increments, or no file beside it the fixes; it says why.
    """
    imu = formats.read("kf-gins", path, "imu", None)
    steps = np.diff(imu.t, prepend=np.nan)
    forward = steps > 0
    rate, force = (
        float(np.nanmedian(np.linalg.norm(imu.values[name][forward], axis=1) / steps[forward]))
        if forward.any()
        else np.nan
        for name in ("dtheta", "dvel")
    )
    if not (_FORCES[0] < force < _FORCES[1] and rate < _FASTEST):
        raise ConfigError(
            f"{path.name}: no increments of an IMU in the columns of KF-GINS: second of week, angles [rad] "
            "and velocities [m/s] forward, right, down. Other tables need a line of column names: "
            "bench guide log-format"
        )
    faults = []
    for place in sorted(one for one in path.parent.iterdir() if one.suffix.lower() == TEXT and one != path):
        if not (fault := _find_fault(place, imu.t)):
            files = {"imu": path, "gnss": place}
            return {kind: FoundSensor(file, {}, (), form="kf-gins") for kind, file in files.items()}
        faults.append(fault)
    raise ConfigError(
        f"{path.name}: no fixes beside it, as KF-GINS has them: a {TEXT} with second of week, latitude, "
        f"longitude [deg], height, three standard deviations [m]; {'; '.join(faults[:3]) or 'there is none'}"
    )


def _find_fault(path: Path, imu_t: FloatArray) -> str:
    """Return why a text does not contain the fixes for an IMU; empty if it does."""
    try:
        fixes = formats.read("kf-gins", path, "gnss", None)
    except ConfigError as error:
        return str(error)
    first, last = fixes.t.min(), fixes.t.max()
    if not (first <= imu_t.max() and imu_t.min() <= last):
        return f"{path.name}: its times, {first:.9g} to {last:.9g} s, do not overlap with the IMU"
    lat, lon, _ = np.abs(fixes.values["lla"]).T
    sd = fixes.values["sd_pos"]
    below = ((sd < 0) & (sd != _UNKNOWN)).any(axis=1)  # as an increment may be
    wrong = (lat > 0.5 * np.pi) | (lon > 2 * np.pi) | below
    if wrong.any():
        return f"{path.name}: row {int(np.argmax(wrong)) + 1} holds no fix"
    return ""
