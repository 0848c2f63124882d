"""The IMUs of the catalog as a buyer sees them: class, and how much of them no source states."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from bench.config import list_sensors
from bench.errors import ConfigError
from bench.wording import suggest

CLASSES = ("consumer", "industrial", "tactical", "navigation")
"""Classes of IMUs, from cheap to dear. The catalog has no prices."""

_INCOMPLETE = ("kvh-dsp-1760",)  # gyros without accelerometers


class Unit(NamedTuple):
    """An IMU of the catalog."""

    grade: str  # of `CLASSES`, or "synthetic"
    absent: int  # figures that no source states and that are zero in its model


def list_units() -> Mapping[str, Unit]:
    """Return every complete IMU of the catalog by name."""
    found = {}
    for entry in list_sensors():
        if entry.kind == "imu" and entry.name not in _INCOMPLETE:
            grade = re.split("[,;]", entry.note)[0]
            absent = entry.note.partition("absent: ")[2]
            found[entry.name] = Unit(grade, len(absent.split(", ")) if absent else 0)
    return found


def find_units(study: str, names: Sequence[str]) -> Mapping[str, Unit]:
    """Return the IMUs of these names; ConfigError with a line for each that is not there."""
    known = list_units()
    wrong = [
        f"study {study}: units: {name!r} is no IMU of the catalog{suggest(name, known, 'IMUs')}"
        for name in names
        if name not in known
    ]
    if wrong:
        raise ConfigError(*wrong)
    return {name: known[name] for name in names}
