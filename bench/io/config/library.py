"""Find profiles, aircraft and datasheets by name."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field

from bench.core.files.installed import find_folders
from bench.core.records.flight_specs import (
    FIXED_WING,
    GLIDER,
    HEIGHTS,
    SPEEDS,
    WINGS,
    AircraftSpec,
    EnvelopeSpec,
    ForeignSpec,
    RunwaySpec,
)
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import one_line, quantity, suggest, tell_where
from bench.io.config import external_truth
from bench.io.config.listing import (
    CATALOG,
    JSBSIM,
    NAME,
    PROFILES,
    find_sheets,
    list_aircraft,
    list_aircraft_folders,
)
from bench.io.config.profile_tables import SEVERITY, Altitude, Category, Speed
from bench.io.config.sheet import convert_figures, make_table_type
from bench.io.config.tables import ROWS, Table, between, check_table
from bench.io.config.toml_file import read_toml


class _Position(Table):
    """A position on board relative to the center of gravity."""

    forward_m: Annotated[float, between(-100, 100)]
    """Ahead of the center of gravity."""
    right_m: Annotated[float, between(-100, 100)]
    """To its right."""
    down_m: Annotated[float, between(-100, 100)]
    """Below it."""

    @classmethod
    def at_cg(cls) -> Self:
        return cls(forward_m=0.0, right_m=0.0, down_m=0.0)


class _TrimPoint(Table):
    """Altitude and airspeed of a steady level flight."""

    alt_m: Altitude
    """Ellipsoidal altitude of a steady level flight."""
    speed_mps: Speed
    """Its true airspeed; a [start] without airspeed takes the nearest in altitude."""


class _Stand(Table):
    """How what has no [runway] rests: a multirotor or helicopter on its legs, a glider on its wheel."""

    height_m: Annotated[float, between(*HEIGHTS)]
    """Height of the center of gravity above the ground at rest."""


class AircraftTable(Table):
    """The file of an aircraft."""

    title: str
    """Title."""
    category: Category = Field(alias="class")
    """Class: shape in the recording, limits of the sanity report."""
    kind: Literal["fixed-wing", "multirotor", "glider", "helicopter"] = "fixed-wing"
    """Its guidance system, trim and legs."""
    source: str = ""
    """Source of the values."""
    assumed: Annotated[tuple[str, ...], ROWS] = ()
    """Tables that no source states."""
    limits: make_table_type(AircraftSpec)  # type: ignore[valid-type]
    trim: Annotated[tuple[_TrimPoint, ...], ROWS] = ()
    imu: _Position = Field(default_factory=_Position.at_cg)
    antenna: _Position
    static_port: _Position = Field(default_factory=_Position.at_cg)
    runway: make_table_type(RunwaySpec) | None = None  # type: ignore[valid-type]
    stand: _Stand | None = None
    envelope: make_table_type(EnvelopeSpec) | None = None  # type: ignore[valid-type]
    configuration: Annotated[tuple[Literal["flaps", "gear"], ...], ROWS] = ()
    """Parts that a leg may move."""
    guidance: dict[str, float] = Field(default_factory=dict)
    """A table: gains of the autopilot, by their names in guidance.xml."""
    rough_air: dict[str, float] = Field(default_factory=dict)
    """A table: gains of [guidance] that are other ones from the turbulence of rough_air_from on."""
    rough_air_from: Literal["light", "moderate"] = "moderate"
    """The least turbulence with the gains of [rough_air]."""
    rough_flare: dict[str, float] = Field(default_factory=dict)
    """The same in a flare, from light turbulence on."""
    approach: dict[str, float] = Field(default_factory=dict)
    """The same on an approach and in its flare, in any air."""


def find_profile(name: str | Path) -> tuple[Path, str]:
    """Return the file of a profile, found by path or shipped name, and its name in messages.

    Raises
    ------
    ConfigError
        If there is no such profile, or the name is not a text or a path.
    """
    name = name_profile(name)
    if name.endswith(".toml"):
        return Path(name), name
    known = [path.stem for path in PROFILES.glob("*.toml")]
    if name not in known:
        raise ConfigError(
            f"no shipped profile {name!r} (a file of your own ends in .toml)"
            f"{suggest(name, known, 'profiles')}"
        )
    return PROFILES / f"{name}.toml", f"{name}.toml"


def name_profile(profile: object) -> str:
    """Return the name or path of a profile as a text; `ConfigError` if it is anything else."""
    if isinstance(profile, str | Path):
        return str(profile)
    if isinstance(profile, Profile):
        raise ConfigError(
            f"profile {profile.name!r} is read already; give its name or its path here, with seed, "
            "filters and overrides as arguments"
        )
    raise ConfigError(f"profile = {one_line(repr(profile))[:60]} must be a name or the path of a .toml file")


class ForeignTable(AircraftTable):
    """The file of an aircraft that was not made for bench."""

    properties: dict[str, float] = Field(default_factory=dict)
    """A table: JSBSim properties set before the start; in aircraft/jsbsim, and for a model of yours without
    the autopilot."""
    stubs: tuple[str, ...] = ()
    """JSBSim properties that the model reads and does not have, of a cockpit that is not there; each is 0."""


def find_aircraft(name: str, beside: Path) -> Path:
    """Find the folder of an aircraft: beside the profile, in the repository or in the installed package.

    Raises
    ------
    ConfigError
        If the aircraft is not found; the message lists the folders searched.
    """
    if not NAME.fullmatch(name):
        raise ConfigError(f"aircraft = {name!r} must be a name of letters, digits, '-' and '_', 100 at most")
    places = list_aircraft_folders(beside)
    folder = next((place / name for place in places if (place / name).is_dir()), None)
    if folder is None:
        places += find_folders("aircraft").values()
        folder = next((place / name for place in places if (place / name).is_dir()), None)
    if folder is None:
        searched = ", ".join(str(place) for place in places)
        known = [row.name for row in list_aircraft(beside)]
        raise ConfigError(
            f"aircraft = {name!r} is not found{suggest(name, known, 'aircraft')}\n  searched: {searched}"
        )
    return folder


def read_aircraft(folder: Path, beside: Path) -> AircraftSpec:
    """Read the aircraft of a folder; its ``systems`` are searched beside it and in the aircraft folders.

    Raises
    ------
    ConfigError
        One message for each problem in the files.
    """
    name = folder.name
    shown = f"{name}/aircraft.toml"
    model = folder / f"{name}.xml"
    if folder.parent in list_aircraft_folders():
        table = check_table(AircraftTable, read_toml(folder / "aircraft.toml", shown), shown)
        foreign = None
    else:
        guided = external_truth.has_guidance(model)
        kind = AircraftTable if guided else ForeignTable
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
    places = [place / "jsbsim" for place in list_aircraft_folders(beside)]
    file = next((place / f"{name}.toml" for place in places if (place / f"{name}.toml").is_file()), None)
    if file is None:
        shipped = sorted({path.stem for place in places for path in place.glob("*.toml")})
        raise ConfigError(
            f"aircraft = {JSBSIM + name!r} has no gains: write aircraft/jsbsim/{name}.toml beside the "
            f"profile, with limits, antenna and guidance as in the files of {', '.join(shipped)}"
        )
    shown = f"jsbsim/{name}.toml"
    table = check_table(ForeignTable, read_toml(file, shown), shown)
    return _make_aircraft(table, shown, folder / "aircraft" / name, beside, _make_foreign(table, folder))


def _make_foreign(table: AircraftTable, root: Path) -> ForeignSpec:
    if isinstance(table, ForeignTable):
        return ForeignSpec(root, table.properties, table.stubs)
    return ForeignSpec(root, {}, guided=True)


def _make_aircraft(
    table: AircraftTable, shown: str, folder: Path, beside: Path, foreign: ForeignSpec | None
) -> AircraftSpec:
    limits, imu = table.limits, table.imu
    if limits.min_speed_mps >= limits.max_speed_mps:
        raise ConfigError(f"{shown}: [limits] min_speed_mps must be below max_speed_mps")
    kind, wings = table.kind, table.kind in WINGS
    if wings and limits.min_speed_mps < SPEEDS[0]:
        what = quantity("min_speed_mps", limits.min_speed_mps)
        raise ConfigError(f"{shown}: [limits] {what} is below {SPEEDS[0]} m/s; 0 is for what hovers")
    gains = ("rough_air", "rough_flare", "approach")
    not_used: tuple[str, ...] = () if wings else ("trim", "runway", "configuration", "envelope", *gains)
    if kind == GLIDER:
        not_used = ("runway", "configuration", "rough_flare", "approach")
    for name in (*not_used, *(["stand"] if kind == FIXED_WING else [])):
        if name in table.model_fields_set:
            raise ConfigError(f"{shown}: [{name}] is not used with kind = {table.kind!r}")
    if not wings and limits.min_speed_mps:
        what = quantity("min_speed_mps", limits.min_speed_mps)
        raise ConfigError(f"{shown}: [limits] {what} must be 0 with kind = {table.kind!r}: it hovers")
    if not wings and isinstance(table, ForeignTable):
        raise ConfigError(f"{shown}: kind = {kind!r}: the model must name <system file={kind!r}/>")
    for number, row in enumerate(table.trim, 1):
        if not limits.min_speed_mps <= row.speed_mps <= limits.max_speed_mps:
            raise ConfigError(
                f"{shown}: [[trim]] {number}: {quantity('speed_mps', row.speed_mps)} is outside [limits]"
            )
    missing = [name for name in table.assumed if name not in table.model_fields_set]
    if missing:
        raise ConfigError(f"{shown}: assumed names {missing[0]!r}, which is not a table of this file")
    for key in gains:
        unknown = [name for name in getattr(table, key) if name not in table.guidance]
        if unknown:
            raise ConfigError(f"{shown}: [{key}] {unknown[0]!r} is not a gain of [guidance]")
    if both := sorted(table.rough_flare.keys() & table.approach):
        raise ConfigError(f"{shown}: {both[0]!r} is in [rough_flare] and [approach]; a landing takes one")
    systems = [place / "systems" for place in (folder.parent, *list_aircraft_folders(beside))]
    law = "guidance.xml" if wings else f"{table.kind}.xml"
    with_guidance = next((place for place in systems if (place / law).is_file()), None)
    if with_guidance is None:
        raise ConfigError(f"{law}: no such file in {', '.join(str(place) for place in systems)}")
    return AircraftSpec(
        name=folder.name,
        folder=folder.absolute(),  # it is read in a process that works elsewhere
        systems=with_guidance.absolute(),
        gains=table.guidance,
        rough_gains=table.rough_air,
        rough_from=SEVERITY[table.rough_air_from],
        flare_gains=table.rough_flare,
        approach_gains=table.approach,
        **convert_figures(AircraftSpec, limits),
        antenna_b=_from_imu(table.antenna, imu),
        category=table.category,
        foreign=foreign,
        imu_b=_from_imu(imu, _Position.at_cg()),
        static_port_b=_from_imu(table.static_port, imu),
        trims=tuple((float(row.alt_m), float(row.speed_mps)) for row in table.trim),
        runway=RunwaySpec(**convert_figures(RunwaySpec, table.runway)) if table.runway else None,
        configuration=table.configuration,
        kind=table.kind,
        stand_height=table.stand.height_m if table.stand else None,
        envelope=EnvelopeSpec(**convert_figures(EnvelopeSpec, table.envelope) if table.envelope else {}),
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
            where = tell_where(name)
            if where and beside == Path():
                where = " in the current folder"
            raise ConfigError(f"{kind} = {name!r}: no such file{where}")
        return beside / name, name
    shipped = CATALOG / kind / f"{name}.toml"
    if NAME.fullmatch(name) and shipped.is_file():
        return shipped, shipped.name
    known = find_sheets(kind)
    if name not in known:
        raise ConfigError(f"{kind} = {name!r} is not in the catalog{suggest(name, known, kind)}")
    return known[name][0], f"{name}.toml"
