"""The text of a log for the sensors that were found in tables, texts or bags."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from bench.core.files.file_checks import check_file, read_json
from bench.core.records.instruments import INSTRUMENTS
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line, quote_toml
from bench.io.exports.column_files import START
from bench.io.logs.mat_files.mat_file import list_structures, read_mat
from bench.io.logs.sensor_search import FoundSensor

_CONFIGURATIONS = "*.yaml"  # of KF-GINS
_REP_103 = (".bag", ".db3", ".mcap", "")  # whose axes are forward, left, up; a folder is a bag
_MOST_CONFIGURATION = 1_000_000  # [byte]
DATASHEETS = {
    "imu": "adis16475",
    "gnss": "l1-code",
    **{name: row.usual for name, row in INSTRUMENTS.items() if row.usual},
}
"""Datasheet that is assumed of a sensor until the user names one."""


def read_antenna(fixes: FoundSensor) -> tuple[list[float], str] | None:
    """Return the antenna position [m], b, and its source: a file of bench, NaveGo or KF-GINS."""
    path, says = fixes.path, START
    try:
        if path.suffix.lower() == ".mat":
            structures = list_structures(read_mat(path))
            exported = "start" in structures
            holder, field = ("start", "antenna_b_m") if exported else (fixes.structure, "larm")
            says, place = f"{holder}.{field}", structures[holder][field]
        elif fixes.form:
            says, place = next(_list_levers(path.parent))
        else:
            place = read_json(path.parent / START)["antenna_b_m"]
        x, y, z = (float(value) for value in place)
    except (ConfigError, OSError, KeyError, StopIteration, TypeError, ValueError):
        return None
    return ([x, y, z], says) if np.isfinite([x, y, z]).all() else None


def _list_levers(folder: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield the configuration files of KF-GINS in a folder, each with its antenna position."""
    for path in sorted(one for one in folder.glob(_CONFIGURATIONS) if one.is_file()):
        check_file(path, path.name, _MOST_CONFIGURATION)
        line = re.search(r"^antlever:\s*\[(.*?)\]", path.read_text(encoding="utf-8"), re.MULTILINE)
        if line is not None:
            yield path.name, line[1].split(",")


def write_log(
    title: str,
    found: Mapping[str, FoundSensor],
    antenna: tuple[list[float], str] | None,
    clocks: Mapping[str, str],
) -> str:
    """Return the log above [alignment]; a comment asks for each value that the files do not contain."""
    lines = [f"title = {quote_toml(title)}"]
    if "gnss" not in found:
        lines.append("place = [45.0, 0.0, 0.0]  # where was it? latitude, longitude [deg], height [m]")
    asked = {
        "imu": [
            "# roll, pitch, yaw of its axes against forward, right, down?  mounting_deg = [0.0, 0.0, 0.0]",
            "# from the same point as the antenna?                        position_m = [0.0, 0.0, 0.0]",
        ],
        "gnss": ["# where is its antenna: forward, right, down?  position_m = [0.0, 0.0, 0.0]"],
        "baro": [],
    }
    if antenna is not None:
        place, says = antenna
        asked["gnss"] = [f"position_m = {json.dumps(place)}  # by {one_line(says)}"]
    if found["imu"].path.suffix.lower() in _REP_103:
        text = "# its axes are those of REP 103, forward, left, up?          mounting_deg = [180.0, 0.0, 0.0]"
        asked["imu"][0] = text
    if "axes" in clocks:
        asked["imu"][0] = clocks["axes"]
    for kind, one in found.items():
        lines += ["", f"[{kind}]", f"file = {quote_toml(one.path.name)}"]
        if one.form:
            lines.append(f"format = {quote_toml(one.form)}")
        if one.structure:
            lines.append(f"topic = {quote_toml(one.structure)}")
        lines += [f"# or topic = {quote_toml(other)}?" for other in one.others]
        lines += _list_columns("columns", one.columns)
        if one.gyro_path is not None:
            lines += [f"gyro_file = {quote_toml(one.gyro_path.name)}"]
            lines += _list_columns("gyro_columns", one.gyro_columns)
        lines += [f'sign = "{one.sign}"  # as {one.program} has it'] if one.sign else []
        if one.offset and kind not in clocks:
            lines.append(f"time_offset_s = {one.offset:.3f}  # by the rows with a new fix: right?")
        lines += [f"# {one.told}"] if one.told else []
        lines += [f"# {one_line(line)}: right?" for line in one.guessed] + asked[kind]
        lines += [clocks[kind]] if kind in clocks else []
    lines += ["", "[sensors.assumed]  # which units? bench list sensors"]
    lines += [f"{kind} = {quote_toml(one.sheet or DATASHEETS[kind])}" for kind, one in found.items()]
    return "\n".join(lines) + "\n"


def _list_columns(key: str, columns: Mapping[str, str]) -> list[str]:
    """Return the line of a key that maps columns with other names in the file; no line if none differ."""
    aliases = [f"{ours} = {quote_toml(theirs)}" for ours, theirs in columns.items() if ours != theirs]
    return [f"{key} = {{ {', '.join(aliases)} }}"] if aliases else []
