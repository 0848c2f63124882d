"""Replace single values of a profile or a log, and of the datasheets that it names."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import ConfigError
from bench.io.config.datasheets import MODIFIED, SENSORS

Figures = Mapping[str, Mapping[str, Any]]
"""Kind of sensor -> ``table.key`` of its datasheet -> value, in the unit of the key."""


def override(document: Mapping[str, Any], key: str, value: object) -> dict[str, Any]:
    """Return a copy of a document with one dotted key replaced; the entries of a list count from 1.

    Raises
    ------
    ConfigError
        If the key leads nowhere.
    """
    copied: dict[str, Any] = copy.deepcopy(dict(document))
    here: Any = copied
    *path, last = key.split(".")
    for part in path:
        here = here.setdefault(part, {}) if isinstance(here, dict) else here[_parse_index(here, part, key)]
    here[last if isinstance(here, dict) else _parse_index(here, last, key)] = value
    return copied


def _parse_index(rows: object, part: str, key: str) -> int:
    if not isinstance(rows, list):
        raise ConfigError(f"--set {key}: {part!r} is not a key of a table")
    if not part.isdecimal() or not 1 <= int(part) <= len(rows):
        raise ConfigError(f"--set {key}: {part!r} must be a number from 1 to {len(rows)}")
    return int(part) - 1


@dataclass(frozen=True, slots=True)
class DatasheetChanges:
    """Values to replace in the datasheets of the sensors on board, and in the datasheets that filters assume.

    Figures are in the order in which they were given; the assumed ones include those on board.
    """

    on_board: dict[str, dict[str, Any]] = field(default_factory=dict)
    assumed: dict[str, dict[str, Any]] = field(default_factory=dict)
    keys: dict[str, Any] = field(default_factory=dict)  # as they were given

    def name_assumed(self, units: object) -> dict[str, Any]:
        """Return the assumed datasheets of a [sensors] table, with changed ones taken from those on board."""
        on_board = units if isinstance(units, Mapping) else {}
        named = on_board.get("assumed")
        changed = {
            kind: on_board[kind]
            for kind, figures in self.assumed.items()
            if kind in on_board and figures != self.on_board.get(kind)
        }
        return changed | (dict(named) if isinstance(named, Mapping) else {})

    def check(self, on_board: Mapping[str, Any], assumed: Mapping[str, Any]) -> list[str]:
        """Return one line for each replaced value of a missing sensor."""
        return [
            f"--set {key}: no {kind} is on board"
            for key in self.keys
            for kind in [key.removeprefix("sensors.").removeprefix("assumed.").partition(".")[0]]
            if (assumed if key.startswith("sensors.assumed.") else on_board).get(kind) is None
        ]

    def mark(self, document: dict[str, Any]) -> None:
        """Mark the changed sensors in the document of a run, and add the overrides to the document."""
        sensors = document["sensors"]
        for names, changed in ((sensors["assumed"], self.assumed), (sensors, self.on_board)):
            names.update({kind: f"{names[kind]}{MODIFIED}" for kind in changed if kind in names})
        document.update(self.keys)


_OF_IMUS = ("gyro", "accel")
"""Tables of the datasheet of an IMU."""

_PATHS = re.compile(r"jsbsim_root|trajectory|((imu|gnss|baro|reference|terrain)\.)?file")
_OF_DATASHEETS = re.compile(r"sensors\.(assumed\.)?gnss\.sky\.(almanac|navigation)")
"""Keys whose value is always a path, in a profile or a log and in a datasheet."""


def _locate(key: str, value: Any, beside: Path) -> Any:
    """Return the value of an override; paths are relative to the current folder, not to the file."""
    if isinstance(value, Mapping):
        return {name: _locate(f"{key}.{name}", inner, beside) for name, inner in value.items()}
    if isinstance(value, list):
        return [_locate(key, one, beside) for one in value]
    if not isinstance(value, str):
        return value
    named = (key == "script" and value.endswith(".xml")) or (
        key.startswith("sensors.") and value.endswith(".toml")
    )
    in_file = (named or _PATHS.fullmatch(key)) and Path.cwd() != beside.resolve()
    return str(Path.cwd() / value) if in_file or _OF_DATASHEETS.fullmatch(key) else value


def sets_estimator(overrides: Mapping[str, Any], number: int) -> bool:
    """Return whether overrides set the ``use`` of an entry of [[estimator]], as trusted user input."""
    return any(key in overrides for key in ("estimator", f"estimator.{number}", f"estimator.{number}.use"))


def split_overrides(overrides: Mapping[str, Any], beside: Path) -> tuple[dict[str, Any], DatasheetChanges]:
    """Divide overrides into overrides of the file and overrides of values in the datasheets that it names.

    A path in an override is relative to the present folder, not to ``beside``, the folder of the file.
    ``sensors.imu.gyro.noise_deg_sqrt_h`` is a parameter of the simulated IMU, and of the assumed datasheet;
    ``sensors.assumed.imu.gyro.noise_deg_sqrt_h`` only of the assumed datasheet. A table with the name of its
    sensor may be left out: ``sensors.baro.white_sd_m``. Later overrides win: after ``sensors.assumed.imu``
    filters assume that datasheet, without the parameters of the simulated IMU set before.
    """
    plain = {key: _locate(key, value, beside) for key, value in overrides.items()}
    changes = DatasheetChanges()
    keys = list(plain)
    for number, key in enumerate(keys):
        parts = key.split(".")
        if parts[0] in _OF_IMUS:
            raise ConfigError(f"--set {key}: a figure of a datasheet; name its sensor: sensors.imu.{key}=...")
        only_assumed = parts[:2] == ["sensors", "assumed"]
        rest = parts[2:] if only_assumed else parts[1:]
        if parts[0] == "sensors" and len(rest) > 1 and rest[0] in SENSORS:
            kind, *path = rest
            figure = ".".join([kind, *path] if len(path) == 1 else path)
            sides = [] if only_assumed else [changes.on_board]
            if only_assumed or f"sensors.assumed.{kind}" not in keys[number:]:
                sides.append(changes.assumed)
            changes.keys[key] = value = plain.pop(key)
            for side in sides:
                side.setdefault(kind, {}).pop(figure, None)
                side[kind][figure] = value
        elif only_assumed and len(rest) == 1 and rest[0] in changes.on_board:
            changes.keys[key] = plain[key]
    return plain, changes


def less_empty(document: dict[str, Any], key: str) -> dict[str, Any]:
    """Remove an empty key from a document, in place, to keep it out of results; return the document."""
    if not document[key]:
        del document[key]
    return document


def describe_choice(choice: EstimatorChoice) -> dict[str, Any]:
    """Return the choice of a filter as a table of a file."""
    table = {"use": choice.use, "label": choice.label, "options": dict(choice.options)}
    return table if choice.guard.timeout is None else table | {"timeout_s": choice.guard.timeout}


def set_seed(
    document: dict[str, Any], overrides: dict[str, Any], seed: int | None
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return a document with a seed, and the other overrides; a seed among the overrides takes precedence."""
    if seed is None:
        return document, overrides
    used = overrides.pop("seed", seed)
    turbulence = {} if "trajectory" in document else {"turbulence_seed": used}
    return document | {"seed": used} | turbulence, overrides
