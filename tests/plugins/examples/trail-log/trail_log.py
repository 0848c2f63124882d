"""A format of recordings: a first line ``TRAIL``, then a row of an IMU or a receiver on each.

``I t gyro gyro gyro accel accel accel`` in s, rad/s, m/s^2, forward, right, down;
``G t lat lon alt north east down`` in s, rad, rad, m, m/s.
"""

from pathlib import Path

import numpy as np

from bench import ConfigError
from bench.io.logs.log_contents import Contents
from bench.io.logs.rows import LogRows

_HEAD = "TRAIL"
_LETTERS = {"imu": "I", "gnss": "G"}


def recognizes(path: Path) -> bool:
    """Return whether a file is of this format, whatever its ending."""
    with path.open("rb") as file:
        return file.read(len(_HEAD)) == _HEAD.encode()


def look(path: Path) -> Contents:
    """Return what a file holds: this alone lets ``bench navigate`` and ``bench new log`` take it as it is."""
    return Contents(tuple(kind for kind in _LETTERS if len(_read(path, kind))))


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Return the rows of one sensor in SI."""
    rows = _read(path, kind)
    if not len(rows):
        raise ConfigError(f"{path.name}: has no rows of the {kind}")
    first, second = ("gyro", "accel") if kind == "imu" else ("lla", "vel_n")
    return LogRows(rows[:, 0], {first: rows[:, 1:4], second: rows[:, 4:7]})


def _read(path: Path, kind: str) -> np.ndarray:
    lines = path.read_text(encoding="utf-8").splitlines()[1:]
    try:
        rows = [list(map(float, line.split()[1:])) for line in lines if line[:1] == _LETTERS.get(kind)]
        return np.array(rows).reshape(-1, 7)
    except ValueError as error:
        raise ConfigError(f"{path.name}: {error}") from None
