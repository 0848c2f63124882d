"""External truth: JSBSim scripts, trajectory tables, and aircraft of another JSBSim root."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path

from bench.core.records.flight_specs import ROTORCRAFT, Flight, ScriptSpec, TableSpec, TrackSpec
from bench.core.words.exceptions import ConfigError, FlightError
from bench.core.words.wording import quantity, suggest, tell_where
from bench.io.config.profile_tables import ExperimentTable, ScriptTable, TrackTable, TrajectoryTable
from bench.simulation.flight.model_files import LONGEST_SCRIPT, class_of, script_facts, system_files

_TABLES = (".csv", ".parquet")
_TRACKS = (".gpx", ".kml", ".igc", ".nmea")


def find_jsbsim_root(name: str | None, beside: Path) -> Path:
    """Return a JSBSim root: a folder relative to the profile or, without a name, the jsbsim wheel.

    Raises
    ------
    ConfigError
        If the folder is not a JSBSim root, or the jsbsim package is not installed.
    """
    if name is None:
        package = find_spec("jsbsim")
        if package is None or package.origin is None:
            raise ConfigError("the package jsbsim is not installed")
        return Path(package.origin).parent
    root = (beside / name).resolve()
    missing = [name for name in ("aircraft", "engine", "systems") if not (root / name).is_dir()]
    if missing:
        raise ConfigError(f"jsbsim_root = {name!r} has no folder {' and no folder '.join(missing)}")
    return root


def list_root_aircraft(root: Path) -> list[str]:
    """Return the names of the aircraft of a JSBSim root."""
    return sorted(path.parent.name for path in root.glob("aircraft/*/*.xml") if path.stem == path.parent.name)


def has_guidance(model: Path) -> bool:
    """Return whether a model includes the guidance system of bench; False if it cannot be read."""
    try:
        return not {"guidance", *ROTORCRAFT}.isdisjoint(system_files(model))
    except FlightError:
        return False


def place_antenna(table: ExperimentTable) -> tuple[float, float, float]:
    """Return the GNSS antenna relative to the IMU, for external truth [m], b."""
    assert isinstance(table, ScriptTable | TrajectoryTable)
    place = table.antenna
    return (place.forward_m, place.right_m, place.down_m)


def _read_script(table: ExperimentTable, beside: Path) -> ScriptSpec:
    assert isinstance(table, ScriptTable)
    name = table.script
    if table.duration_s is not None and table.duration_s > LONGEST_SCRIPT:
        what = quantity("duration_s", table.duration_s)
        raise ConfigError(f"{what} is above the {LONGEST_SCRIPT:g} s of a script")
    if name.endswith(".xml"):
        path = (beside / name).resolve()
        if not os.path.isfile(path):
            raise ConfigError(f"script = {name!r}: no such file{tell_where(name)}")
    else:
        root = find_jsbsim_root(table.jsbsim_root, beside)
        known = sorted(path.stem for path in root.glob("scripts/*.xml"))
        if name not in known:
            hint = suggest(name, known, "scripts")
            raise ConfigError(f"script = {name!r} is not in {root / 'scripts'}{hint}")
        path = root / "scripts" / f"{name}.xml"
    try:
        aircraft = script_facts(path).aircraft
    except FlightError as error:
        raise ConfigError(str(error)) from None
    roots = [find_jsbsim_root(table.jsbsim_root, beside)]
    if table.jsbsim_root is None and name.endswith(".xml"):
        roots.insert(0, path.parent.parent)  # a script lies in <root>/scripts
    needed = Path("aircraft") / aircraft / f"{aircraft}.xml"
    holding = [place for place in roots if (place / needed).is_file()]
    if not holding:
        searched = ", ".join(str(place) for place in roots)
        raise ConfigError(f"script = {name!r} flies {aircraft!r}, which is not found\n  searched: {searched}")
    if not (holding[0] / "engine").is_dir():
        rest = "a JSBSim root has aircraft, engine and systems"
        raise ConfigError(f"{holding[0]} has no folder engine; {rest}")
    try:
        category = table.category or class_of(aircraft, holding[0])
    except FlightError as error:
        raise ConfigError(str(error)) from None
    return ScriptSpec(
        name=path.stem,
        path=path,
        root=holding[0],
        aircraft=aircraft,
        rate=float(table.rate_hz),
        duration=table.duration_s,
        turbulence_seed=table.seed if table.turbulence_seed is None else table.turbulence_seed,
        category=category,
    )


def _read_trajectory(table: ExperimentTable, beside: Path) -> TableSpec:
    assert isinstance(table, TrajectoryTable)
    path = beside / table.trajectory
    allowed = (*_TABLES, *_TRACKS)
    if path.suffix.lower() not in allowed:
        raise ConfigError(f"trajectory = {table.trajectory!r} must end in {' or '.join(allowed)}")
    if not os.path.isfile(path):
        raise ConfigError(f"trajectory = {table.trajectory!r}: no such file{tell_where(table.trajectory)}")
    return TableSpec(
        name=path.stem,
        path=path.resolve(),
        rate=float(table.rate_hz),
        duration=table.duration_s,
        track=_make_track(table.track) if table.track else None,
    )


def _make_track(table: TrackTable) -> TrackSpec:
    return TrackSpec(
        vehicle=table.vehicle,
        noise=table.noise_m,
        vertical_noise=table.vertical_noise_m,
        wind_from=math.radians(table.wind_from_deg),
        wind_speed=table.wind_speed_mps,
        incidence=math.radians(table.incidence_deg),
        begin=table.from_s,
        end=math.inf if table.to_s is None else table.to_s,
        bridge=table.bridge_s,
    )


EXTERNAL: Mapping[str, tuple[type[ExperimentTable], Callable[[ExperimentTable, Path], Flight]]] = {
    "script": (ScriptTable, _read_script),
    "trajectory": (TrajectoryTable, _read_trajectory),
}
"""Key that marks an external truth in a profile -> the type of the file, and the function that reads it."""
