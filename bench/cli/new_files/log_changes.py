"""Change the keys of a log as the checks of its recording advise, and leave the rest of the file as it is."""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Mapping, Sequence
from itertools import permutations
from typing import Any

import numpy as np

from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.signed_axes import write_axes
from bench.core.mathematics.units import STANDARD_GRAVITY
from bench.core.words.wording import as_toml
from bench.io.config.log_tables import is_right_handed, read_axes

_NEAR = 0.15  # relative difference within which a gain is that of another unit
_RATES = {"rad_s": math.pi / 180.0, "deg_s": 180.0 / math.pi}  # unit of a file -> gain if read in the other
_FORCES = {"g": 1.0 / STANDARD_GRAVITY, "m_s2": STANDARD_GRAVITY}
_DIGITS = 3


def list_changes(
    document: Mapping[str, Any], advice: Sequence[Mapping[str, Any]]
) -> dict[tuple[str, str], Any]:
    """Return the keys of a log that advice changes, by table and key, and their new values.

    Parameters
    ----------
    document : mapping
        The log as its file says.
    advice : sequence of mappings
        The ``advice`` of each check: an offset is added, axes are matrices on what is recorded, a gain is
        measured by true.
    """
    imu, gnss = document.get("imu", {}), document.get("gnss", {})
    changed: dict[tuple[str, str], Any] = {}
    for key, value in (pair for one in advice for pair in one.items()):
        if key == "imu.time_offset_s":
            changed["imu", "time_offset_s"] = round(imu.get("time_offset_s", 0.0) + value, _DIGITS)
        elif key == "gnss.velocity_offset_s":
            changed["gnss", "velocity_offset_s"] = round(gnss.get("velocity_offset_s", 0.0) + value, _DIGITS)
        elif key == "gnss.velocity_sd_mps":
            changed["gnss", "velocity_sd_mps"] = value
        elif key == "gnss.position_m":
            at = np.add(gnss.get("position_m", [0.0] * 3), value)
            changed["gnss", "position_m"] = [round(float(one), 2) for one in at]
        elif key == "imu.axes":
            changed |= {("imu", name): given for name, given in change_axes(imu, *value).items()}
        elif key in ("imu.gyro_gain", "imu.accel_gain"):
            gyro = key == "imu.gyro_gain"
            columns = _change_unit(
                imu.get("columns", {}), "gyro" if gyro else "accel", _RATES if gyro else _FORCES, value
            )
            if columns:
                changed["imu", "columns"] = columns
    return changed


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


def _change_unit(
    columns: Mapping[str, str], sensor: str, units: Mapping[str, float], gain: float
) -> dict[str, str]:
    """Return the columns of a log with the unit of a sensor that its gain shows; {} if it shows none."""
    names = [f"{sensor}_{axis}" for axis in "xyz"]
    for unit, other in permutations(units):
        ours = {f"{name}_{unit}": f"{name}_{other}" for name in names}
        if abs(gain / units[other] - 1.0) < _NEAR and (not columns or set(ours) <= set(columns)):
            return {ours.get(name, name): there for name, there in columns.items()} or {
                new: old for old, new in ours.items()
            }
    return {}


def write_changes(text: str, changed: Mapping[tuple[str, str], Any]) -> str:
    """Return the text of a log with keys changed: in their lines, or below the head of their table.

    Raises
    ------
    ValueError
        If the text has no such table, or a key whose value is on several lines.
    """
    for (table, key), value in changed.items():
        head = re.search(rf"^\[{table}\][ \t]*(#.*)?$", text, re.MULTILINE)
        if head is None:
            raise ValueError(f"no line [{table}]")
        end = re.search(r"^\[", text[head.end() :], re.MULTILINE)
        stop = head.end() + end.start() if end else len(text)
        line, body = f"{key} = {_as_line(value)}  # by the motion", text[head.end() : stop]
        if old := re.search(rf"^{key}[ \t]*=.*$", body, re.MULTILINE):
            body = body[: old.start()] + line + body[old.end() :]
        else:
            body = f"\n{line}{body}"
        text = text[: head.end()] + body + text[stop:]
    tomllib.loads(text)
    return text


def _as_line(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f'"{key}" = "{one}"' for key, one in value.items()) + " }"
    return f'"{value}"' if isinstance(value, str) else as_toml(value)
