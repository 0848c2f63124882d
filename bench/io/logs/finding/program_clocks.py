"""Clocks in the tables of programs: of gyros with times of their own, and of an IMU beside fixes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from bench.io.logs.exporter_names import Exporter, make_plain
from bench.io.logs.rows import MOST_ROWS
from bench.io.logs.table_files import read_columns


def find_clocks(
    path: Path, columns: Mapping[str, str], names: Sequence[str], program: Exporter
) -> dict[str, Any]:
    """Return the fields of an IMU that follow from its program: sign, gyros, offset of its clock."""
    found: dict[str, Any] = {"sign": program.sign}
    clock = _find_name(names, program.gyro_clock)
    if clock:
        gyros = {ours: name for ours, name in columns.items() if ours.startswith("gyro_")}
        rest = {ours: name for ours, name in columns.items() if ours not in gyros}
        found |= {"columns": rest, "gyro_path": path, "gyro_columns": {"t_s": clock, **gyros}}
    own, other = (_find_name(names, pattern) for pattern in program.epochs)
    if own and other:
        t = read_columns(path, [own, other], MOST_ROWS)
        new = np.flatnonzero(np.diff(t[other], prepend=np.nan) != 0)  # a fix is written soon after its time
        late = t[other][new] - t[own][new]
        late = late[np.isfinite(late)]
        found["offset"] = float(np.max(late)) if len(late) else 0.0
    return found


def _find_name(names: Sequence[str], pattern: str) -> str:
    return next((name for name in names if pattern and re.fullmatch(pattern, make_plain(name))), "")
