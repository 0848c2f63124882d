"""Change the keys of a log as the checks of its recording advise, and leave the rest of the file as it is."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.rotation import write_axes
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_value
from bench.io.config.log_tables import is_right_handed, read_axes
from bench.io.log_formats import TABLES
from bench.io.logs.table_files import list_columns

_NEAR = 0.15  # relative difference within which a gain is that of another unit
_RATES = {"rad_s": math.pi / 180.0, "deg_s": 180.0 / math.pi}  # unit of a file -> gain if read in the other
_FORCES = {"g": 1.0 / STANDARD_GRAVITY, "m_s2": STANDARD_GRAVITY}
_DIGITS = 3
_SAID = "by the motion"
_BY = f"  # {_SAID}"


def list_changes(
    document: Mapping[str, Any], advice: Sequence[Mapping[str, Any]], beside: Path
) -> dict[tuple[str, str], Any]:
    """Return the keys of a log that advice changes, by table and key, and their new values.

    Parameters
    ----------
    document : mapping
        The log as its file says.
    advice : sequence of mappings
        The ``advice`` of each check: an offset is added; axes are matrices that turn the recorded vectors;
        a gain is measured by true; a velocity is a matrix that turns the recorded one to n [m/s].
    beside : Path
        Folder of the log.
    """
    top = {key: document[key] for key in ("file", "format") if key in document}
    own = {name: document.get(name) for name in ("imu", "gnss")}
    imu, gnss = (top | one if isinstance(one, dict) else top for one in own.values())
    changed: dict[tuple[str, str], Any] = {}
    for key, value in (pair for one in advice for pair in one.items()):
        if key in ("imu.time_offset_s", "gnss.velocity_offset_s"):
            table, _, name = key.partition(".")
            before = (imu if table == "imu" else gnss).get(name, 0.0)
            changed[table, name] = round(float(before + value), _DIGITS)
        elif key == "gnss.velocity_sd_mps":
            changed["gnss", "velocity_sd_mps"] = value
        elif key == "gnss.position_m":
            at = np.add(gnss.get("position_m", [0.0] * 3), value)
            changed["gnss", "position_m"] = [round(float(one), 2) for one in at]
        elif key == "imu.axes":
            changed |= {("imu", name): given for name, given in change_axes(imu, *value).items()}
        elif key == "gnss.velocity":
            changed |= _rename(gnss, "gnss", "columns", beside, partial(_name_velocity, matrix=value))
        elif key in ("imu.gyro_gain", "imu.accel_gain"):
            gyro = key == "imu.gyro_gain"
            columns = "gyro_columns" if gyro and "gyro_file" in imu else "columns"
            new = _name_unit("gyro", _RATES, value) if gyro else _name_unit("accel", _FORCES, value)
            changed |= _rename(imu, "imu", columns, beside, lambda _, new=new: new)
    return changed


def _rename(
    row: dict[str, Any], table: str, key: str, beside: Path, choose: Callable[..., dict[str, str]]
) -> dict[tuple[str, str], Any]:
    """Return the change of columns that get new names, {} if none; ``row`` gets them, too.

    ``choose`` returns old names and new ones for the names in use, from the log or the header of the file.
    """
    file = str(row.get("gyro_file" if key == "gyro_columns" else "file", ""))
    if row.get("format", "table" if Path(file).suffix.lower() in TABLES else "") != "table":
        return {}
    given: dict[str, str] = dict(row.get(key, {}))
    known = given
    with suppress(ConfigError, OSError):
        known = {one: one for one in list_columns(beside / file) if one not in given.values()} | given
    new = choose(known)
    if not new or not set(new) <= set(known) or set(new.values()) & (set(known) - set(new)):
        return {}
    kept = {new.get(one, one): there for one, there in given.items()}
    row[key] = kept | {one: known[old] for old, one in new.items() if known[old] != one}
    return {(table, key): row[key]}


def change_axes(imu: Mapping[str, Any], gyro: FloatArray, accel: FloatArray) -> dict[str, Any]:
    """Return the keys of [imu] after which its records are turned by ``gyro`` and ``accel`` (3, 3), too.

    A rotation changes the mounting, unless the log gives axes; all else are axes and signs of the file.
    """
    mount = rotation.matrix(rotation.from_euler(*np.deg2rad(imu.get("mounting_deg", [0.0] * 3))))
    slant = rotation.matrix(rotation.from_euler(*np.deg2rad(imu.get("misalignment_deg", [0.0] * 3))))
    inside = [slant.T @ one @ slant for one in (gyro, accel)]
    if np.array_equal(gyro, accel) and np.linalg.det(gyro) > 0 and "axes" not in imu:
        turned = rotation.to_euler(rotation.from_matrix(inside[0] @ mount))
        return {"mounting_deg": [round(float(np.rad2deg(one)), 2) + 0.0 for one in turned]}
    inside = [mount.T @ one @ mount for one in inside]
    axes = imu.get("axes", "x, y, z")
    old = [_as_matrix(imu.get(name, axes)) for name in ("gyro_axes", "accel_axes")]
    if any(np.abs(one - one.round()).max() > 1e-6 for one in inside):
        return {}  # a mounting that is no right angle: these axes have no names
    new = [one.round() @ before for one, before in zip(inside, old, strict=True)]
    keys: dict[str, Any] = {}
    if np.array_equal(new[0], -new[1]):
        keys["sign"] = "specific-force" if imu.get("sign") == "gravity" else "gravity"
        new[1] = new[0]
    own = "gyro_axes" in imu or "accel_axes" in imu  # they win over axes
    if np.array_equal(new[0], new[1]) and not own:
        if not np.array_equal(new[0], old[0]):
            keys["axes"] = write_axes(new[0])
            if not is_right_handed(read_axes(keys["axes"])) or imu.get("left_handed"):
                keys["left_handed"] = not is_right_handed(read_axes(keys["axes"]))
        return keys
    for name, one, before in zip(("gyro_axes", "accel_axes"), new, old, strict=True):
        if not np.array_equal(one, before):
            keys[name] = write_axes(one)
    return keys


def _as_matrix(text: str) -> FloatArray:
    signed = read_axes(text)
    return np.eye(3)[[abs(one) - 1 for one in signed]] * np.sign(signed)[:, None]


def _name_unit(sensor: str, units: Mapping[str, float], gain: float) -> dict[str, str]:
    """Return the names of columns in the unit of a sensor that its gain shows; {} if it shows none."""
    for unit, other in permutations(units):
        if abs(gain / units[other] - 1.0) < _NEAR:
            return {f"{sensor}_{axis}_{unit}": f"{sensor}_{axis}_{other}" for axis in "xyz"}
    return {}


def _name_velocity(known: Mapping[str, str], matrix: FloatArray) -> dict[str, str]:
    """Return the names of columns after which velocities are in n; {} if no names fit the ``matrix``."""
    ends = [(down, unit) for down in "du" for unit in ("mps", "m_s") if f"vel_{down}_{unit}" in known]
    down, unit = ends[0] if ends else ("d", "mps")
    new = {1.0: unit, 3.6: "km_h"}.get(round(1.0 / float(np.abs(matrix).max()), 6))
    signed = np.sign(matrix) * [1.0, 1.0, 1.0 if down == "d" else -1.0]
    if new is None or signed[:2].min() < 0.0:
        return {}
    axes, taken = ("n", "e", "u" if signed[2].min() < 0.0 else "d"), np.abs(signed).argmax(axis=1)
    old = [f"vel_{('n', 'e', down)[int(k)]}_{unit}" for k in taken]
    return {one: f"vel_{axis}_{new}" for one, axis in zip(old, axes, strict=True)}


def write_changes(text: str, changed: Mapping[tuple[str, str], Any]) -> str:
    """Return the text of a log with keys changed: in their lines, or below the head of their table.

    Raises
    ------
    ValueError
        If the text has no such table, or a key has no line of its own.
    """
    wanted: dict[str, Any] = tomllib.loads(text)
    after = text
    for (table, key), value in changed.items():
        head = re.search(rf"^[ \t]*\[[ \t]*{table}[ \t]*\][ \t]*(#.*?)?(\r?)$", after, re.MULTILINE)
        if head is None:
            raise ValueError(f"no line [{table}]")
        end = re.search(r"^[ \t]*\[", after[head.end() :], re.MULTILINE)
        stop = head.end() + end.start() if end else len(after)
        line, body = f"{key} = {format_value(value)}", after[head.end() : stop]
        if old := re.search(rf"^([ \t]*){key}[ \t]*=(.*?)(\r?)$", body, re.MULTILINE):
            body = f"{body[: old.start()]}{old[1]}{line}{_find_comment(old[2])}{old[3]}{body[old.end() :]}"
        else:
            body = "\n" + line + _BY + head[2] + body
        after = after[: head.end()] + body + after[stop:]
        wanted[table] = {**wanted[table], key: value}
    with suppress(tomllib.TOMLDecodeError):
        if tomllib.loads(after) == wanted:
            return after
    raise ValueError(f"{', '.join(f'[{table}] {key}' for table, key in changed)} not in a line of its own")


def _find_comment(rest: str) -> str:
    """Return the comment behind the new value of a line whose end, after the equals sign, is given."""
    for at in (one.start() for one in re.finditer("#", rest)):
        with suppress(tomllib.TOMLDecodeError):
            tomllib.loads(f"value = {rest[:at]}")
            return f"  {rest[at:]}" if rest.endswith(_SAID) else f"  {rest[at:].rstrip()}; {_SAID}"
    return _BY
