"""Find profiles, aircraft and datasheets by name, and list them."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import MISSING
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, Self

from pydantic import Field

from bench.config import external_truth
from bench.config.datasheets import SENSORS, list_missing_figures
from bench.config.profile_tables import Altitude, Category, Speed
from bench.config.sheet import convert_figures, make_table_type
from bench.config.tables import ROWS, Table, between, check_table, read_toml
from bench.errors import ConfigError
from bench.flight import legs
from bench.flight.legs.keys import keys_of
from bench.navigation.estimator import BUILT_IN
from bench.places import PACKAGE
from bench.specs import AircraftSpec, ForeignSpec, RunwaySpec
from bench.wording import quantity, suggest, tell_where

_PROFILES = PACKAGE / "profiles"
_CATALOG = PACKAGE / "catalog"
JSBSIM = "jsbsim:"
"""Prefix of the names of aircraft of the jsbsim wheel."""
_NAME = re.compile(r"[A-Za-z0-9_-]{1,100}")


class _Position(Table):
    """A position on board relative to the centre of gravity."""

    forward_m: Annotated[float, between(-100, 100)]
    right_m: Annotated[float, between(-100, 100)]
    down_m: Annotated[float, between(-100, 100)]

    @classmethod
    def at_cg(cls) -> Self:
        return cls(forward_m=0.0, right_m=0.0, down_m=0.0)


class _Trim(Table):
    """Altitude and airspeed of a steady level flight."""

    alt_m: Altitude
    speed_mps: Speed


class _AircraftTable(Table):
    title: str
    category: Category = Field(alias="class")
    source: str = ""
    assumed: Annotated[tuple[str, ...], ROWS] = ()
    limits: make_table_type(AircraftSpec)  # type: ignore[valid-type]
    trim: Annotated[tuple[_Trim, ...], ROWS] = ()
    imu: _Position = Field(default_factory=_Position.at_cg)
    antenna: _Position
    static_port: _Position = Field(default_factory=_Position.at_cg)
    runway: make_table_type(RunwaySpec) | None = None  # type: ignore[valid-type]
    configuration: Annotated[tuple[Literal["flaps", "gear"], ...], ROWS] = ()
    guidance: dict[str, float] = Field(default_factory=dict)


def find_profile(name: str) -> tuple[Path, str]:
    """Return the file of a profile, found by path or shipped name, and its name in messages.

    Raises
    ------
    ConfigError
        If there is no such profile.
    """
    if name.endswith(".toml"):
        return Path(name), name
    known = [path.stem for path in _PROFILES.glob("*.toml")]
    if name not in known:
        raise ConfigError(
            f"no shipped profile {name!r} (a file of your own ends in .toml)"
            f"{suggest(name, known, 'profiles')}"
        )
    return _PROFILES / f"{name}.toml", f"{name}.toml"


class _ForeignTable(_AircraftTable):
    properties: dict[str, float] = Field(default_factory=dict)


def find_aircraft(name: str, beside: Path) -> Path:
    """Find the folder of an aircraft: beside the profile, in the repository or in the installed package.

    Raises
    ------
    ConfigError
        If the aircraft is not found; the message lists the folders searched.
    """
    if not _NAME.fullmatch(name):
        raise ConfigError(f"aircraft = {name!r} must be a name of letters, digits, '-' and '_', 100 at most")
    places = _list_aircraft_folders(beside)
    folder = next((place / name for place in places if (place / name).is_dir()), None)
    if folder is None:
        searched = ", ".join(str(place) for place in places)
        known = [row.name for row in list_aircraft(beside)]
        raise ConfigError(
            f"aircraft = {name!r} is not found{suggest(name, known, 'aircraft')}\n  searched: {searched}"
        )
    return folder


def read_aircraft(folder: Path, beside: Path) -> AircraftSpec:
    """Read the aircraft of a folder; its ``systems`` are searched beside it and where aircraft are.

    Raises
    ------
    ConfigError
        One message for each problem in the files.
    """
    name = folder.name
    shown = f"{name}/aircraft.toml"
    model = folder / f"{name}.xml"
    if folder.parent in _list_aircraft_folders():
        table = check_table(_AircraftTable, read_toml(folder / "aircraft.toml", shown), shown)
        foreign = None
    else:
        guided = external_truth.has_guidance(model)
        kind = _AircraftTable if guided else _ForeignTable
        table = check_table(kind, read_toml(folder / "aircraft.toml", shown), shown)
        foreign = _make_foreign(table, external_truth.find_jsbsim_root(None, beside))
    if not model.is_file():
        raise ConfigError(f"{name}/{name}.xml: no such file")
    return _make_aircraft(table, shown, folder, beside, foreign)


def read_jsbsim_aircraft(name: str, root: str | None, beside: Path) -> AircraftSpec:
    """Read the aircraft ``jsbsim:NAME`` of the jsbsim wheel or of another JSBSim root.

    Its limits, antenna and guidance gains are in ``aircraft/jsbsim/NAME.toml`` (own or shipped).

    Raises
    ------
    ConfigError
        One message for each thing that is missing or wrong.
    """
    name = name.removeprefix(JSBSIM)
    folder = external_truth.find_jsbsim_root(root, beside)
    known = external_truth.list_root_aircraft(folder)
    if name not in known:
        raise ConfigError(
            f"aircraft = {JSBSIM + name!r} is not in {folder / 'aircraft'}{suggest(name, known, 'aircraft')}"
        )
    places = [place / "jsbsim" for place in _list_aircraft_folders(beside)]
    file = next((place / f"{name}.toml" for place in places if (place / f"{name}.toml").is_file()), None)
    if file is None:
        shipped = sorted({path.stem for place in places for path in place.glob("*.toml")})
        raise ConfigError(
            f"aircraft = {JSBSIM + name!r} has no gains: write aircraft/jsbsim/{name}.toml beside the "
            f"profile, with limits, antenna and guidance as in those of {', '.join(shipped)}"
        )
    shown = f"jsbsim/{name}.toml"
    table = check_table(_ForeignTable, read_toml(file, shown), shown)
    return _make_aircraft(table, shown, folder / "aircraft" / name, beside, _make_foreign(table, folder))


def _make_foreign(table: _AircraftTable, root: Path) -> ForeignSpec:
    if isinstance(table, _ForeignTable):
        return ForeignSpec(root, table.properties)
    return ForeignSpec(root, {}, guided=True)


def _make_aircraft(
    table: _AircraftTable, shown: str, folder: Path, beside: Path, foreign: ForeignSpec | None
) -> AircraftSpec:
    limits, imu = table.limits, table.imu
    if limits.min_speed_mps >= limits.max_speed_mps:
        raise ConfigError(f"{shown}: [limits] min_speed_mps must be below max_speed_mps")
    for number, row in enumerate(table.trim, 1):
        if not limits.min_speed_mps <= row.speed_mps <= limits.max_speed_mps:
            raise ConfigError(
                f"{shown}: [[trim]] {number}: {quantity('speed_mps', row.speed_mps)} is outside [limits]"
            )
    missing = [name for name in table.assumed if name not in table.model_fields_set]
    if missing:
        raise ConfigError(f"{shown}: assumed names {missing[0]!r}, which is not a table of this file")
    systems = [place / "systems" for place in (folder.parent, *_list_aircraft_folders(beside))]
    with_guidance = next((place for place in systems if (place / "guidance.xml").is_file()), None)
    if with_guidance is None:
        raise ConfigError(f"guidance.xml: no such file in {', '.join(str(place) for place in systems)}")
    return AircraftSpec(
        name=folder.name,
        folder=folder.absolute(),  # it is read in a process that works elsewhere
        systems=with_guidance.absolute(),
        gains=table.guidance,
        **convert_figures(AircraftSpec, limits),
        antenna_b=_from_imu(table.antenna, imu),
        category=table.category,
        foreign=foreign,
        imu_b=_from_imu(imu, _Position.at_cg()),
        static_port_b=_from_imu(table.static_port, imu),
        trims=tuple((float(row.alt_m), float(row.speed_mps)) for row in table.trim),
        runway=RunwaySpec(**convert_figures(RunwaySpec, table.runway)) if table.runway else None,
        configuration=table.configuration,
    )


def _from_imu(place: _Position, imu: _Position) -> tuple[float, float, float]:
    """Return a position on board relative to the IMU [m], b."""
    return (place.forward_m - imu.forward_m, place.right_m - imu.right_m, place.down_m - imu.down_m)


def find_datasheet(kind: str, name: str, beside: Path) -> tuple[Path, str]:
    """Return the file of a datasheet, and its name in messages.

    Parameters
    ----------
    kind : str
        "imu", "gnss" or the name of an instrument.
    name : str
        Name in the catalog, or a path ending in ``.toml``, relative to the profile.
    beside : Path
        Folder of the profile that asks for it.

    Raises
    ------
    ConfigError
        If there is no such file.
    """
    if name.endswith(".toml"):
        if not os.path.isfile(beside / name):  # unlike Path.is_file, false for a name that is too long
            raise ConfigError(f"{kind} = {name!r}: no such file{tell_where(name)}")
        return beside / name, name
    known = [path.stem for path in (_CATALOG / kind).glob("*.toml")]
    if name not in known:
        raise ConfigError(f"{kind} = {name!r} is not in the catalog{suggest(name, known, kind)}")
    return _CATALOG / kind / f"{name}.toml", f"{name}.toml"


def _list_aircraft_folders(beside: Path | None = None) -> list[Path]:
    beside_profile = [beside / "aircraft"] if beside else []
    tree = [PACKAGE.parent / "aircraft"] if (PACKAGE.parent / "pyproject.toml").is_file() else []
    return [*beside_profile, *tree, PACKAGE / "aircraft"]


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
    """A profile, aircraft, leg, sensor or estimator that is selected by name."""

    name: str
    title: str
    kind: str  # "profile", "aircraft", "leg", "estimator", "export", or a kind of sensor: "imu" ...
    note: str = ""  # limits, source of the figures, assumed figures, fixed options
    keys: tuple[KeyEntry, ...] = ()  # of a leg

    def as_dict(self) -> dict[str, Any]:
        """Return the fields by name, for JSON."""
        return {**self._asdict(), "keys": [key._asdict() for key in self.keys]}


def list_profiles() -> list[CatalogEntry]:
    """Return every shipped profile."""
    return [
        CatalogEntry(path.stem, str(read_toml(path, path.name).get("title", "")), "profile")
        for path in sorted(_PROFILES.glob("*.toml"))
    ]


def list_aircraft(beside: Path | None = None) -> list[CatalogEntry]:
    """Return every aircraft that a profile can name, sorted by name."""
    sheets = {}
    for place in reversed(_list_aircraft_folders(beside)):
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
    parts.append("takes off and lands" if "runway" in sheet else "in the air only")
    parts += ["IMU off the centre of gravity"] if "imu" in sheet else []
    parts += [f"source: {sheet['source']}"] if "source" in sheet else []
    parts += [f"assumed: {', '.join(sheet['assumed'])}"] if "assumed" in sheet else []
    return "; ".join(parts)


def list_sensors() -> list[CatalogEntry]:
    """Return every sensor of the catalog."""
    return [
        CatalogEntry(path.stem, str(sheet.get("title", "")), kind, _describe_datasheet(kind, sheet))
        for kind in SENSORS
        for path in sorted((_CATALOG / kind).glob("*.toml"))
        for sheet in [read_toml(path, path.name)]
    ]


def find_unit(kind: str, name: str) -> CatalogEntry | None:
    """Return a sensor of the catalog; None if it is not in there."""
    path = _CATALOG / kind / f"{name}.toml"
    if not _NAME.fullmatch(name) or not path.is_file():
        return None
    sheet = read_toml(path, path.name)
    return CatalogEntry(name, str(sheet.get("title", "")), kind, _describe_datasheet(kind, sheet))


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
    """Return every built-in estimator, with the options that its name implies."""
    return [
        CatalogEntry(
            name, row.title, "estimator", ", ".join(quantity(key, value) for key, value in row.fixed.items())
        )
        for name, row in BUILT_IN.items()
    ]


def _describe_datasheet(kind: str, sheet: Mapping[str, Any]) -> str:
    """Return one line with the grade of a datasheet, its confidence, and its assumed and missing figures."""
    known = ", ".join(str(sheet[key]) for key in ("class", "confidence") if key in sheet)
    assumed = [str(name) for name in sheet.get("assumed", [])]
    lists = {"assumed": assumed, "absent": list_missing_figures(kind, sheet)}
    return "; ".join([known, *(f"{what}: {', '.join(names)}" for what, names in lists.items() if names)])
