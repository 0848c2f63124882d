"""Find the sensors in a folder of tables, where gyros and accelerometers may have a table each.

File names and columns: Sensor Logger as its UNITS.md (github.com/tszheichoi/awesome-sensor-logger), phyphox
as its exports.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from bench.core.mathematics.units import FACTORS, STANDARD_GRAVITY, split_unit
from bench.core.words.exceptions import ConfigError
from bench.io.logs.exporter_names import make_plain
from bench.io.logs.rows import MOST_ROWS
from bench.io.logs.sensor_search import (
    ACCEL,
    GYRO,
    IMU_STEP,
    NEAR,
    TABLES,
    TEXTS,
    TIME,
    FoundSensor,
    SensorQuantity,
    find_beside,
    find_sensor,
    find_tables,
    match_columns,
)
from bench.io.logs.table_files import list_columns, read_columns

_MOST_FILES = 200
_OTHERS = re.compile(r".*(linear|user|gravity|watch|wrist|headphone).*")
"""Files of phones with other accelerations, or of other devices."""
_FILES = {"accel": re.compile(r"(total|raw)?acc.*"), "gyro": re.compile(r"(raw)?gyr.*")}
_BEST = ("total", "uncalibrated")
"""Words of the names of accelerometer files with gravity, the best first."""
_SENSOR_LOGGER = "secondselapsed"


def find_sensors(path: Path) -> dict[str, FoundSensor]:
    """Return the table of each sensor in a folder, or beside a table.

    Raises
    ------
    ConfigError
        If there is no IMU, or more than one, or no receiver with times of the IMU.
    """
    if not path.is_dir():
        return find_tables(path)
    tables = sorted(
        one for one in path.iterdir() if one.suffix.lower() in (*TABLES, *TEXTS) and one.is_file()
    )
    if not tables:
        raise ConfigError(f"{path}: a folder without a table; name the file with the IMU")
    if len(tables) > _MOST_FILES:
        raise ConfigError(f"{path}: more than {_MOST_FILES} tables; name the one with the IMU")
    whole: list[FoundSensor] = []
    named: dict[Path, list[str]] = {}
    for table in tables:
        try:
            named[table] = list_columns(table)
            if (found := find_sensor(table, "imu", IMU_STEP)) is not None:
                whole.append(found)
        except ConfigError:  # not a table, or accelerations without gravity
            continue
    measured = [one for one in whole if not one.turns] or whole
    if len(measured) > 1:
        listed = ", ".join(one.path.name for one in measured[:10])
        raise ConfigError(f"{path}: several tables have an IMU: {listed}; name one of them")
    imu = measured[0] if measured else _find_split(path, named)
    return find_beside(imu, imu.path, [table for table in named if table != imu.path])


def _find_split(folder: Path, named: dict[Path, list[str]]) -> FoundSensor:
    """Return an IMU from a table of accelerometers and a table of gyros."""
    faults: list[str] = []
    triads = {
        triad: [
            found
            for table, names in named.items()
            if (found := _match_triad(table, names, triad, quantity, faults)) is not None
        ]
        for triad, quantity in (("accel", ACCEL), ("gyro", GYRO))
    }
    if missing := [word for word, of in (("gyros", "gyro"), ("accelerometers", "accel")) if not triads[of]]:
        there = ", ".join(table.name for table in named)[:300] or "none"
        because = f"; {faults[0]}" if faults else ""
        raise ConfigError(f"{folder}: no table with {' or '.join(missing)}; tables: {there}{because}")

    def rank(found: FoundSensor) -> tuple[int, str]:
        stem = make_plain(found.path.stem)
        return next((k for k, word in enumerate(_BEST) if word in stem), len(_BEST)), stem

    accel, gyro = min(triads["accel"], key=rank), min(triads["gyro"], key=lambda one: one.path.name)
    return accel._replace(
        guessed=(*accel.guessed, *gyro.guessed), gyro_path=gyro.path, gyro_columns=gyro.columns
    )


def _match_triad(
    table: Path, names: Sequence[str], triad: str, quantity: SensorQuantity, faults: list[str]
) -> FoundSensor | None:
    """Return the times and axes of a triad in a table; None if it has none, with a reason in ``faults``."""
    plain, stem = {make_plain(name): name for name in names}, make_plain(table.stem)
    by_file = {"x", "y", "z"} <= plain.keys() and _FILES[triad].fullmatch(stem)
    if _OTHERS.fullmatch(stem):
        return None
    if by_file:
        patterns = tuple(rf"(.*_)?{axis}" for axis in "xyz")
        guess = quantity.guess
        if triad == "gyro" and _SENSOR_LOGGER in plain:
            guess = _take_radians
        quantity = quantity._replace(patterns=patterns, guess=guess)
    try:
        found = match_columns(table, names, "", (TIME, quantity), IMU_STEP)
        if found is None or (triad == "accel" and not _has_gravity(found)):
            if found is not None:
                faults.append(f"{table.name}: accelerations without gravity, which no filter can use")
            return None
    except ConfigError as error:
        faults.append(str(error))
        return None
    found = found._replace(guessed=tuple(f"{table.name}: {line}" for line in found.guessed))
    if _SENSOR_LOGGER in plain:
        g = any(ours.endswith("_g") for ours in found.columns)  # iOS; m/s^2 have the sign of Android
        rates = f"{table.name}: {plain['x']}, "  # known to be rad/s
        known = tuple(line for line in found.guessed if triad != "gyro" or not line.startswith(rates))
        return found._replace(program="Sensor Logger", sign="gravity" if g else "", guessed=known)
    return found


def _take_radians(_: object) -> str:
    return "rad_s"


def _has_gravity(found: FoundSensor) -> bool:
    """Return whether the median of specific forces is gravity."""
    columns = {ours: name for ours, name in found.columns.items() if ours.startswith("accel_")}
    values = read_columns(found.path, list(columns.values()), MOST_ROWS)
    units = [FACTORS.get(split_unit(ours)[1], 1.0) for ours in columns]
    force = np.column_stack([values[name] * unit for name, unit in zip(columns.values(), units, strict=True)])
    return bool(abs(float(np.nanmedian(np.linalg.norm(force, axis=1))) / STANDARD_GRAVITY - 1.0) < NEAR)
