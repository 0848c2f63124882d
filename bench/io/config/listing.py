"""Catalog entries to select by name: profiles, aircraft, legs, sensors, filters."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from pathlib import Path
from typing import Any, NamedTuple

from bench.core.files.installed import find_folders, find_installed
from bench.core.files.places import PACKAGE
from bench.core.mathematics.units import split_unit
from bench.core.records.fields import figures_of, triad_figures_of
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import GnssSpec, TriadSpec
from bench.core.words.wording import quantity
from bench.io.config.toml_file import read_toml
from bench.navigation.built_in import BUILT_IN
from bench.simulation.flight import legs
from bench.simulation.flight.legs.keys import keys_of

PROFILES = PACKAGE / "profiles"
CATALOG = PACKAGE / "catalog"
JSBSIM = "jsbsim:"
"""Prefix of the names of aircraft of the jsbsim wheel."""
NAME = re.compile(r"[A-Za-z0-9_-]{1,100}")
KINDS = ("imu", "gnss", *INSTRUMENTS)
"""Kinds of sensors, also the names of their catalog folders."""


class KeyEntry(NamedTuple):
    """A key of a leg."""

    name: str  # with the array it is in: points.lat_deg
    words: str
    unit: str
    low: float | None  # in ``unit``, as are high and default
    high: float | None
    choices: tuple[str, ...]  # allowed texts
    default: float | str | None  # None: optional without a default, or required
    required: bool


class CatalogEntry(NamedTuple):
    """A profile, aircraft, leg, sensor or filter that is selected by name."""

    name: str
    title: str
    kind: str  # "profile", "aircraft", "leg", "filter", "export", kind of sensor, group of entry points
    note: str = ""  # limits, source of the figures, assumed figures, fixed options
    keys: tuple[KeyEntry, ...] = ()  # of a leg

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, for JSON."""
        return {**self._asdict(), "keys": [key._asdict() for key in self.keys]}


def list_aircraft_folders(beside: Path | None = None) -> list[Path]:
    """Return the folders in which aircraft are searched, the folder beside a profile first."""
    beside_profile = [beside / "aircraft"] if beside else []
    tree = [PACKAGE.parent / "aircraft"] if (PACKAGE.parent / "pyproject.toml").is_file() else []
    return [*beside_profile, *tree, PACKAGE / "aircraft"]


def list_profiles() -> list[CatalogEntry]:
    """Return the built-in profiles.

    Returns
    -------
    list of CatalogEntry
        ``name``, ``title``.

    Examples
    --------
    >>> import bench
    >>> "figure-eight" in [entry.name for entry in bench.list_profiles()]
    True
    """
    return [
        CatalogEntry(path.stem, str(read_toml(path, path.name).get("title", "")), "profile")
        for path in sorted(PROFILES.glob("*.toml"))
    ]


def list_aircraft(beside: Path | None = None) -> list[CatalogEntry]:
    """Return the aircraft that a profile can name, sorted by name.

    Parameters
    ----------
    beside : Path, optional
        Folder of a profile whose ``aircraft`` folder is searched, too.

    Returns
    -------
    list of CatalogEntry
        ``name``, ``title``, and ``note`` with limits and source.

    Examples
    --------
    >>> import bench
    >>> "navion" in [entry.name for entry in bench.list_aircraft()]
    True
    """
    sheets = {}
    for place in (*find_folders("aircraft").values(), *reversed(list_aircraft_folders(beside))):
        for path in place.glob("*/aircraft.toml"):
            sheets[path.parent.name] = read_toml(path, f"{path.parent.name}/aircraft.toml")
        for path in place.glob("jsbsim/*.toml"):
            sheets[f"{JSBSIM}{path.stem}"] = read_toml(path, f"jsbsim/{path.name}")
    return [
        CatalogEntry(name, str(sheet.get("title", "")), "aircraft", _describe_aircraft(sheet))
        for name, sheet in sorted(sheets.items())
    ]


def _describe_aircraft(sheet: Mapping[str, Any]) -> str:
    """Return one line with the limits of an aircraft, its source, and its assumed tables."""
    limits = sheet.get("limits", {})
    parts = [f"class {sheet.get('class')}"]
    parts.append(f"{limits.get('min_speed_mps', 0):g} to {limits.get('max_speed_mps', 0):g} m/s")
    parts += [f"trimmed at {row['speed_mps']:g} m/s, {row['alt_m']:g} m" for row in sheet.get("trim", [])]
    grounded = "runway" in sheet or "stand" in sheet
    parts += [str(sheet["kind"])] if "kind" in sheet else []
    ground = "starts on a winch" if sheet.get("kind") == "glider" else "takes off and lands"
    parts.append(ground if grounded else "in the air only")
    parts += ["IMU off the center of gravity"] if "imu" in sheet else []
    parts += [f"source: {sheet['source']}"] if "source" in sheet else []
    parts += [f"assumed: {', '.join(sheet['assumed'])}"] if "assumed" in sheet else []
    return "; ".join(parts)


def list_sensors() -> list[CatalogEntry]:
    """Return the sensors of the catalog and of installed packages.

    Returns
    -------
    list of CatalogEntry
        ``name``, ``title``, ``kind`` ("imu", "gnss", "baro" ...), and ``note`` with the grade and the assumed
        and missing parameters.

    Examples
    --------
    >>> import bench
    >>> "stim300" in [entry.name for entry in bench.list_sensors() if entry.kind == "imu"]
    True
    """
    return [_make_unit(kind, path, package) for kind in KINDS for path, package in find_sheets(kind).values()]


def find_sheets(kind: str) -> dict[str, tuple[Path, str]]:
    """Return file and package of each datasheet of a kind by name; the package of bench itself is empty."""
    found = {path.stem: (path, "") for path in sorted((CATALOG / kind).glob("*.toml"))}
    for package, folder in find_folders("catalog").items():
        for path in sorted((folder / kind).glob("*.toml")):
            found.setdefault(path.stem, (path, package))
    return found


def _make_unit(kind: str, path: Path, package: str) -> CatalogEntry:
    sheet = read_toml(path, path.name)
    note = _describe_datasheet(kind, sheet) + (f"; from {package}" if package else "")
    return CatalogEntry(path.stem, str(sheet.get("title", "")), kind, note)


def find_unit(kind: str, name: str) -> CatalogEntry | None:
    """Return a sensor of the catalog; None if the catalog does not contain it."""
    found = find_sheets(kind).get(name)
    return None if found is None else _make_unit(kind, *found)


def list_legs() -> list[CatalogEntry]:
    """Return every kind of leg, sorted by name."""
    return [
        CatalogEntry(leg.kind, str(leg.__doc__).partition("\n")[0], "leg", keys=tuple(_list_keys(leg)))
        for leg in sorted(legs.LEGS, key=lambda leg: leg.kind)
    ]


def _list_keys(made: type[Any], place: str = "") -> Iterator[KeyEntry]:
    for entry in keys_of(made):
        key, required = entry.key, entry.default is MISSING
        low, high = (None if math.isinf(end) else float(end) for end in (key.low, key.high))
        default = None if required else entry.default
        yield KeyEntry(place + key.name, key.words, key.unit, low, high, entry.choices, default, required)
        if entry.row:
            yield from _list_keys(entry.row, f"{key.name}.")


def list_estimators() -> list[CatalogEntry]:
    """Return the built-in filters and the filters of installed packages.

    Returns
    -------
    list of CatalogEntry
        ``name``, ``title``, and ``note`` with the options that the name implies.

    Examples
    --------
    >>> import bench
    >>> "loose-15" in [entry.name for entry in bench.list_estimators()]
    True
    """
    return [
        CatalogEntry(
            name, row.title, "estimator", ", ".join(quantity(key, value) for key, value in row.fixed.items())
        )
        for name, row in BUILT_IN.items()
    ] + [
        CatalogEntry(name, f"{one.place} of {one.package}", "estimator")
        for name, one in find_installed("estimators", BUILT_IN).items()
    ]


def _describe_datasheet(kind: str, sheet: Mapping[str, Any]) -> str:
    """Return one line with the grade of a datasheet, its confidence, and its assumed and missing figures."""
    known = ", ".join(str(sheet[key]) for key in ("class", "confidence") if key in sheet)
    assumed = [str(name) for name in sheet.get("assumed", [])]
    lists = {"assumed": assumed, "absent": list_missing_figures(kind, sheet)}
    return "; ".join([known, *(f"{what}: {', '.join(names)}" for what, names in lists.items() if names)])


def list_missing_figures(kind: str, document: Mapping[str, Any]) -> list[str]:
    """Return the names, in words, of the errors that a datasheet does not specify and the model lacks.

    Parameters
    ----------
    kind : str
        One of :data:`KINDS`.
    document : mapping
        Content of a checked datasheet file.
    """
    if kind == "imu":
        present: dict[str, bool] = {}
        for name in ("gyro", "accel"):
            for field, figure in triad_figures_of(TriadSpec).items():
                keys = figure.keys(field, name)
                if figure.sought and keys:
                    error = f"{name} {figure.sought}"
                    here = any(key in document.get(name, {}) for key in keys)
                    present[error] = present.get(error, False) or here
        return [error for error, here in present.items() if not here]
    given = {split_unit(key)[0] for table in document.values() if isinstance(table, dict) for key in table}
    spec = GnssSpec if kind == "gnss" else INSTRUMENTS[kind].spec
    return [name.removesuffix("_sd").replace("_", " ") for name in figures_of(spec) if name not in given]
