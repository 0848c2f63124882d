"""NaveGo: the structures ``imu`` and ``gnss`` of a MATLAB file, or others that the log names.

Fields and units of ins-gnss/ins_gnss.m of github.com/rodralez/NaveGo: imu.t [s], wb [rad/s], fb [m/s^2],
forward, right, down; gnss.t, lat, lon [rad], h [m], vel [m/s] north, east, down, stdm [m], stdv [m/s].
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.mat_files.mat_file import find_structure, get_vector, list_structures, read_mat
from bench.io.logs.rows import MOST_ROWS, LogRows

_FIELDS = {"imu": {"t", "wb", "fb"}, "gnss": {"t", "lat", "lon", "h"}}
"""Fields without which a structure is not that of a sensor."""


def list_sensors(path: Path, kind: str) -> list[str]:
    """Return the structures of a MATLAB file with an "imu" or "gnss" of NaveGo, shortest name first.

    A structure with an attitude, such as ``ref``, is the last choice.
    """
    needed = _FIELDS.get(kind)
    if needed is None:
        return []
    structures = list_structures(read_mat(path))
    found = [name for name, fields in structures.items() if needed <= fields.keys()]
    return sorted(found, key=lambda name: ("roll" in structures[name], len(name), name))


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of a structure of a NaveGo file."""
    if kind == "baro":
        raise ConfigError(f"{path.name}: NaveGo has no structure for a barometer")
    structure = find_structure(read_mat(path), topic or kind, path.name)

    def column(name: str) -> FloatArray:
        if name not in structure:
            there = ", ".join(structure)[:200]
            raise ConfigError(f"{path.name}: {kind}.{name} is missing; there are {there or 'none'}")
        return get_vector(structure[name], f"{kind}.{name}", path.name)

    t = column("t")
    if len(t) > MOST_ROWS:
        raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows")

    def rows(name: str) -> FloatArray:
        array = structure.get(name)
        if not isinstance(array, np.ndarray) or np.atleast_2d(array).shape != (len(t), 3):
            what = f"of shape {np.shape(array)}" if isinstance(array, np.ndarray) else "missing"
            raise ConfigError(f"{path.name}: {kind}.{name} must be {len(t)} rows of 3; it is {what}")
        return np.atleast_2d(array)

    if kind == "imu":
        return LogRows(t, {"gyro": rows("wb"), "accel": rows("fb")})
    place = [column(name) for name in ("lat", "lon", "h")]
    if any(len(one) != len(t) for one in place):
        raise ConfigError(f"{path.name}: gnss.lat, lon, h must be as long as gnss.t, {len(t)} rows")
    values = {"lla": np.column_stack(place)}
    if "vel" in structure:
        values["vel_n"] = rows("vel")
    for new, old in (("sd_pos", "stdm"), ("sd_vel", "stdv")):
        if old in structure:
            claimed = column(old)
            if claimed.shape != (3,):
                raise ConfigError(f"{path.name}: gnss.{old} must be three numbers; it is {len(claimed)}")
            values[new] = np.tile(claimed, (len(t), 1))
    return LogRows(t, values)
