"""IMUs for a buyer, from the catalog or a file: class, and values that no source states.

A figure that a datasheet leaves out is zero in its model, which flatters the unit. What is typical of a class
is the median of the figures that the catalog has for units of this class, those that are assumed included.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from bench.core.mathematics.units import from_si, to_si
from bench.core.records.fields import triad_figures_of
from bench.core.records.sensor_specs import TriadSpec
from bench.core.words.exceptions import ConfigError
from bench.io.config.datasheets import read_imu
from bench.io.config.library import find_datasheet
from bench.io.config.listing import CATALOG, list_missing_figures
from bench.io.config.sheet import ProductTable
from bench.io.config.toml_file import read_toml

CLASSES = ("consumer", "industrial", "tactical", "navigation")
"""Classes of IMUs, from cheap to dear."""

_INCOMPLETE = ("kvh-dsp-1760",)  # gyros without accelerometers
LIMITS = ("range", "bandwidth", "quantization")
"""Figures whose absence makes a model no better by a class: they are not filled in, and limit nothing."""


class Typical(NamedTuple):
    """Typical value of a class for a parameter that a datasheet leaves out."""

    gap: str  # in words, as in ``CatalogImu.absent``
    key: str  # ``gyro.bias_instability_deg_h``
    value: float  # in the unit of the key
    units: tuple[str, ...]  # of the catalog that have it
    assumed: bool  # no source states it for any of them


class CatalogImu(NamedTuple):
    """An IMU of the catalog, or of a file."""

    name: str  # in the catalog, or the path of its file
    grade: str  # of `CLASSES`; "synthetic" or "" stand outside of them
    absent: tuple[str, ...]  # figures, in words, that no source states and that are zero in its model
    typical: tuple[Typical, ...]  # of them, those that units of its class have
    product: ProductTable = ProductTable()

    @property
    def filled(self) -> dict[str, Any]:
        """Overrides of a profile that fly the IMU with typical values for its gaps."""
        return {f"sensors.imu.{one.key}": one.value for one in self.typical}

    @property
    def short(self) -> str:
        """Name of the IMU in a figure."""
        return Path(self.name).stem


def list_units() -> Mapping[str, CatalogImu]:
    """Return every complete IMU of the catalog by name."""
    names = sorted(path.stem for path in (CATALOG / "imu").glob("*.toml"))
    return {name: _find_unit(name) for name in names if name not in _INCOMPLETE}


def find_units(study: str, names: Sequence[str]) -> Mapping[str, CatalogImu]:
    """Return the IMUs of these names, or of these files; ConfigError with a line for each that is wrong."""
    found, wrong = dict[str, CatalogImu](), list[str]()
    for name in names:
        try:
            found[name] = _find_unit(name)
            if name in _INCOMPLETE:
                wrong.append(f"study {study}: units: {name} has no accelerometers")
        except ConfigError as error:
            wrong += [f"study {study}: units: {line}" for line in error.messages]
    if wrong:
        raise ConfigError(*wrong)
    return found


def _find_unit(name: str) -> CatalogImu:
    if name.endswith(".toml") and not os.path.isfile(name):  # unlike Path.is_file, false if it is too long
        where = "" if Path(name).is_absolute() else " in the working folder"
        raise ConfigError(f"{name!r}: no such file{where}")
    path, shown = find_datasheet("imu", name, Path())
    read_imu(path, shown)
    document = read_toml(path, shown)
    grade = str(document.get("class", ""))
    absent = tuple(list_missing_figures("imu", document))
    product = ProductTable.model_validate(document.get("product", {}))  # checked above
    return CatalogImu(name, grade, absent, tuple(_fill_gaps(grade, absent)), product)


def _fill_gaps(grade: str, absent: Sequence[str]) -> Iterator[Typical]:
    for gap in absent:
        triad, _, sought = gap.partition(" ")
        if sought not in LIMITS:
            yield from find_typical(grade, triad, sought)


@lru_cache
def find_typical(grade: str, triad: str, sought: str) -> tuple[Typical, ...]:
    """Return the typical value of a class for a datasheet parameter; nothing if no IMU of the class has one.

    Of several figures with this name the one that most units have counts. A bias instability comes with its
    correlation time.
    """
    fields = [name for name, one in triad_figures_of(TriadSpec).items() if one.sought == sought]
    found = max((_gather(grade, triad, name) for name in fields), key=len)
    if not found:
        return ()
    rows = [found, _gather(grade, triad, "bias_correlation")] if sought == "bias instability" else [found]
    return tuple(_take_median(f"{triad} {sought}", row) for row in rows if row)


def _gather(grade: str, triad: str, name: str) -> list[tuple[str, str, float, bool]]:
    """Return unit, key, value in SI of a figure in a class, and whether it is assumed."""
    keys = triad_figures_of(TriadSpec)[name].keys(name, triad)
    found = []
    for path in sorted((CATALOG / "imu").glob("*.toml")):
        sheet = read_toml(path, path.name)
        if sheet.get("class") != grade or grade not in CLASSES:
            continue
        for key in keys:
            value = sheet.get(triad, {}).get(key)
            if value is not None:
                size = float(np.sqrt(np.mean(np.square(value))))
                assumed = f"{triad}.{key}" in sheet.get("assumed", ())
                found.append((path.stem, key, to_si(key, size), assumed))
    return found


def _take_median(gap: str, rows: Sequence[tuple[str, str, float, bool]]) -> Typical:
    triad, key = gap.partition(" ")[0], rows[0][1]
    value = from_si(key, float(np.median([row[2] for row in rows])))
    return Typical(
        gap,
        f"{triad}.{key}",
        float(f"{value:.4g}"),
        tuple(row[0] for row in rows),
        all(row[3] for row in rows),
    )
