"""Text files of Android's GnssLogger: IMU and fixes; LOGGING_FORMAT.md of google/gps-measurement-tools.

imu: ``UncalAccel`` and ``UncalGyro``, or ``Accel`` and ``Gyro``, in the axes of the phone: right and up
along the screen, out of it. gnss: ``Fix`` of the provider GPS, or of the fused one if there is no other, with
a horizontal velocity; heights above the ellipsoid. Times count from the start of the phone, or, if the fixes
have none, are in UTC since 1970. Comments above the rows name the columns.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from bench.core.files.file_checks import check_file
from bench.core.mathematics.arrays import FloatArray
from bench.core.words.exceptions import ConfigError
from bench.io.logs.formats.joined_triads import join_triads
from bench.io.logs.formats.text import read_lines
from bench.io.logs.rows import MOST_ROWS, LogRows, spread_accuracy, to_horizontal
from bench.io.logs.table_files import MOST_BYTES

_TIMES = ("elapsedrealtimenanos", "unixtimemillis", "utctimemillis", "(utc)timeinms")
"""Columns of times, the best first; the first counts nanoseconds, the others milliseconds."""
_TRIADS = {"accel": ("UncalAccel", "Accel"), "gyro": ("UncalGyro", "Gyro")}
_UNITS = {"accel": "mps2", "gyro": "radpersec"}
_FIX = (
    *("latitude", "longitude", "altitude", "speed", "bearing"),
    *("accuracy", "verticalaccuracy", "speedaccuracy"),
)
_ENDINGS = ("", "degrees", "meters", "mps")
_PROVIDERS = ("gps", "flp", "fused", "nlp", "network")


def read(form: str, path: Path, kind: str, topic: str | None) -> LogRows:
    """Read the rows of the IMU or the fixes."""
    if kind not in ("imu", "gnss"):
        raise ConfigError(f"{path.name}: no {kind} is read from a GnssLogger file")
    check_file(path, path.name, MOST_BYTES)
    triads = [name for names in _TRIADS.values() for name in names] if kind == "imu" else []
    names, rows, providers = _read_rows(path, ("Fix", *triads))
    clocks = [one for one in _TIMES if one in names.get("Fix", _TIMES)]
    clock = clocks[0] if clocks and clocks[0] == _TIMES[0] else ""
    if kind == "gnss":
        return _make_fixes(path, names, rows, providers, clock)
    found = {}
    for triad, kinds in _TRIADS.items():
        name = next((one for one in kinds if len(rows.get(one, ()))), None)
        if name is None:
            raise ConfigError(f"{path.name}: no rows {' or '.join(kinds)}; turn its sensors on in GnssLogger")
        values = [_take(path, names, rows, name, (f"{name}{axis}{_UNITS[triad]}".lower(),)) for axis in "xyz"]
        found[triad] = _read_times(path, names, rows, name, clock), np.column_stack(values)
    return join_triads(*found["gyro"], *found["accel"], path.name)


def _read_rows(
    path: Path, wanted: Sequence[str]
) -> tuple[dict[str, list[str]], dict[str, FloatArray], list[str]]:
    """Return the names of columns in lower case, the numbers of the rows by kind, and providers of the fixes.

    A row that is not whole is left out; a cell that is no number is NaN.
    """
    names: dict[str, list[str]] = {}
    flat = {kind: array("d") for kind in wanted}
    providers: list[str] = []
    for line in read_lines(path):
        kind, _, rest = line.lstrip("# ").partition(",")
        if kind not in flat:
            continue
        cells = [cell.strip() for cell in rest.split(",")]
        if line.startswith("#"):
            names[kind] = [cell.lower() for cell in cells if cell]
        elif kind in names and len(cells) >= len(names[kind]):
            numbers = [_read_number(cell) for cell in cells[: len(names[kind])]]
            flat[kind].extend(numbers)
            if kind == "Fix":
                providers.append(cells[0].lower())
            if len(flat[kind]) > MOST_ROWS * len(numbers):
                raise ConfigError(f"{path.name}: more than {MOST_ROWS} rows {kind}")
    return names, {k: np.array(v).reshape(-1, len(names[k])) for k, v in flat.items() if len(v)}, providers


def _read_number(cell: str) -> float:
    try:
        return float(cell) if cell else np.nan
    except ValueError:
        return np.nan


def _take(
    path: Path,
    names: Mapping[str, Sequence[str]],
    rows: Mapping[str, FloatArray],
    kind: str,
    wanted: Sequence[str],
    *,
    needed: bool = True,
) -> FloatArray:
    """Return the first of some columns of a kind of rows (N,); NaN if there is none and it is not needed."""
    name = next((one for one in wanted if one in names[kind]), None)
    if name is None and needed:
        there = ", ".join(names[kind])[:300]
        raise ConfigError(f"{path.name}: rows {kind} have no column {' or '.join(wanted)}; they have {there}")
    return np.full(len(rows[kind]), np.nan) if name is None else rows[kind][:, names[kind].index(name)]


def _read_times(
    path: Path, names: Mapping[str, Sequence[str]], rows: Mapping[str, FloatArray], kind: str, clock: str
) -> FloatArray:
    return _take(path, names, rows, kind, (clock,) if clock else _TIMES[1:]) * (1e-9 if clock else 1e-3)


def _make_fixes(
    path: Path,
    names: Mapping[str, Sequence[str]],
    rows: Mapping[str, FloatArray],
    providers: Sequence[str],
    clock: str,
) -> LogRows:
    """Return the fixes of the best provider."""
    if "Fix" not in rows:
        raise ConfigError(f"{path.name}: no rows Fix; turn the location on in GnssLogger")
    best = next((one for one in _PROVIDERS if one in providers), providers[0])
    mine = np.array([one == best for one in providers])
    found = {
        stem: _take(path, names, rows, "Fix", [f"{stem}{end}" for end in _ENDINGS], needed=k < 3)[mine]
        for k, stem in enumerate(_FIX)
    }
    values = {
        "lla": np.column_stack(
            [np.deg2rad(found["latitude"]), np.deg2rad(found["longitude"]), found["altitude"]]
        ),
        "vel_n": to_horizontal(found["speed"], np.deg2rad(found["bearing"])),
        "sd_pos": spread_accuracy(np.column_stack([found["accuracy"], found["verticalaccuracy"]])),
        "sd_vel": np.column_stack([found["speedaccuracy"]] * 2 + [np.full(mine.sum(), np.nan)]),
    }
    notes = () if mine.all() else (f"{path.name}: {mine.sum()} of {len(mine)} fixes are by {best}, and used",)
    return LogRows(_read_times(path, names, rows, "Fix", clock)[mine], values, notes)
