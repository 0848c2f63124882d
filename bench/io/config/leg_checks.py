"""Checks of the legs, start and wind of a profile against its aircraft; one line for each problem."""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from bench.core.records.flight_specs import AircraftSpec, Leg, LegStart, Runway, TerrainSpec
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import quantity, tell_where
from bench.io.config.listing import PROFILES
from bench.io.config.profile_tables import ProfileTable
from bench.io.config.sheet import convert_figures
from bench.simulation.flight.legs.keys import check_leg
from bench.simulation.flight.legs.runway import TakeOff
from bench.simulation.signals.terrain import ENDINGS, describe_terrain, ground_at


def check_legs(table: ProfileTable, aircraft: AircraftSpec) -> list[str]:
    """Check the start, and each leg against the aircraft and the legs before it."""
    problems = _check_start(table, aircraft) + _check_terrain(table)
    after = "ground" if table.start.on_ground else "air"
    start = LegStart(aircraft, table.start.alt_m, make_runway(table), after)
    for number, leg in enumerate(build_legs(table), 1):
        problems += [f"[[leg]] {number} ({leg.kind}): {problem}" for problem in check_leg(leg, start)]
        start = replace(start, alt=leg.alt_after(start), after=leg.leaves)
    return problems


def build_legs(table: ProfileTable) -> tuple[Leg, ...]:
    """Return the legs of a profile in SI."""
    return tuple(row.build() for row in table.leg)


def make_runway(table: ProfileTable) -> Runway | None:
    """Return the runway of a profile: its [runway], or the place of a start on the ground."""
    row = table.runway or (table.start if table.start.on_ground else None)
    if row is None:
        return None
    return Runway(**convert_figures(Runway, row))


def find_start(table: ProfileTable) -> dict[str, float]:
    """Return the place and heading of the start, by the fields of `FlightSpec`."""
    figures = convert_figures(Runway, table.start)
    return {name: figures[name] for name in ("lat", "lon", "alt", "heading")}


def choose_ground(table: ProfileTable) -> float:
    """Return the ellipsoidal height of the ground [m]: of the runway, of [terrain], else the ellipsoid."""
    if runway := make_runway(table):
        return runway.alt
    return table.terrain.alt_m or 0.0 if table.terrain else 0.0


def find_terrain(table: ProfileTable, beside: Path) -> TerrainSpec | None:
    """Return the file of heights of a profile; None: its ground is flat.

    Raises
    ------
    ConfigError
        If the file cannot be used, or the flight does not start above what it holds.
    """
    if table.terrain is None or table.terrain.file is None:
        return None
    name, start = table.terrain.file, table.start
    if not name.lower().endswith(ENDINGS):
        raise ConfigError(f"file = {name!r} must end in {' or '.join(ENDINGS)}")
    path = next((place / name for place in (beside, PROFILES) if os.path.isfile(place / name)), None)
    if path is None:
        raise ConfigError(f"file = {name!r}: no such file{tell_where(name)}")
    spec = describe_terrain(path, name, table.terrain.geoid_m, make_runway(table))
    ground = float(ground_at(spec, math.radians(start.lat_deg), math.radians(start.lon_deg)))
    if math.isnan(ground):
        raise ConfigError(f"file = {name!r} has no height at the start")
    if not start.on_ground and start.alt_m <= ground:
        what = quantity("alt_m", start.alt_m)
        raise ConfigError(f"file = {name!r}: the ground at {ground:.0f} m is not below the start at {what}")
    return spec


def _check_terrain(table: ProfileTable) -> list[str]:
    terrain = table.terrain
    if terrain is None:
        return []
    if terrain.file is not None:
        return [] if terrain.alt_m is None else ["[terrain] has file and alt_m; leave one of them out"]
    if terrain.geoid_m:
        return [f"[terrain] {quantity('geoid_m', terrain.geoid_m)} has no effect without file"]
    if make_runway(table) is not None:
        return ["[terrain] alt_m is not used with a runway: flat ground is at the height of the runway"]
    if table.start.alt_m <= (alt := terrain.alt_m or 0.0):
        return [
            f"[terrain] {quantity('alt_m', alt)} is not below the start at "
            f"{quantity('alt_m', table.start.alt_m)}"
        ]
    return []


def check_radar_use(
    table: ProfileTable, terrain: TerrainSpec | None, choices: Sequence[EstimatorChoice]
) -> list[str]:
    """Check that no filter, also for guidance, treats heights above hills as heights above the runway."""
    if terrain is None:
        return []
    use = "takes a height for one above the runway: not with [terrain] file"
    users = [f"[[estimator]] {choice.label!r}" for choice in choices if choice.options.get("radar")]
    if table.guidance and table.guidance.options.get("radar"):
        users.append("[guidance]")
    return [f"{place}: options: radar = true {use}" for place in users]


def _list_runway_keys(table: ProfileTable) -> list[str]:
    """Return the keys of a runway that [start] gives, as written."""
    start = table.start
    given = ("width_m", "length_m", "roughness_cm3")
    return [
        quantity(key, getattr(start, key))
        for key in given
        if getattr(start, key) != type(start).model_fields[key].default
    ]


def _check_stand(table: ProfileTable) -> list[str]:
    """Check a start on the ground beside a runway, whose keys are in [runway]; the ground is level."""
    if table.runway is None:
        return []
    wrong = [f"[start] {what} is not used: the runway is in [runway]" for what in _list_runway_keys(table)]
    if table.start.alt_m != table.runway.alt_m:
        wrong.append(
            f"[start] {quantity('alt_m', table.start.alt_m)} is not the height of the runway, "
            f"{quantity('alt_m', table.runway.alt_m)}: the ground between them is level"
        )
    return wrong


def _check_start(table: ProfileTable, aircraft: AircraftSpec) -> list[str]:
    start, runway = table.start, make_runway(table)
    if aircraft.hovers and runway is not None and runway.roughness:
        place = "start" if table.runway is None else "runway"
        return [f"[{place}] roughness_cm3 is not used by a multirotor, which does not roll; leave it out"]
    if aircraft.hovers and table.alignment.kind == "course":
        return [f"[alignment] kind = 'course': the course of a {aircraft.kind} gives no heading; use 'hover'"]
    if start.on_ground:
        wrong = []
        if start.speed_mps is not None:
            wrong.append(
                f"[start] {quantity('speed_mps', start.speed_mps)} is not used with on_ground = true"
            )
        wrong += _check_stand(table)
        if aircraft.rest_height is None:
            table_of = "stand" if aircraft.hovers or aircraft.glides else "runway"
            wrong.append(
                f"[start] on_ground = true: the {aircraft.name} has no [{table_of}] in its aircraft.toml"
            )
        return wrong
    if unused := _list_runway_keys(table):
        return [f"[start] {what} is not used: it is of a runway, with on_ground = true" for what in unused]
    if aircraft.hovers:
        if start.speed_mps is None:
            return []
        what = quantity("speed_mps", start.speed_mps)
        return [f"[start] {what} is not used: the {aircraft.name} is a {aircraft.kind} and starts in a hover"]
    if start.speed_mps is None:
        return [f"[start] speed_mps is missing, and the {aircraft.name} has no [[trim]]"]
    if not aircraft.min_speed <= start.speed_mps <= aircraft.max_speed:
        limits = f"{aircraft.min_speed:g} to {aircraft.max_speed:g} m/s of the {aircraft.name}"
        return [f"[start] {quantity('speed_mps', start.speed_mps)} is outside {limits}"]
    return []


def fill_in_speed(table: ProfileTable, aircraft: AircraftSpec) -> ProfileTable:
    """Return the profile with a start airspeed: its own, or the airspeed of the trim nearest in altitude."""
    start = table.start
    if start.on_ground or start.speed_mps is not None or not aircraft.trims:
        return table
    _, speed = min(aircraft.trims, key=lambda trim: abs(trim[0] - start.alt_m))
    return table.model_copy(update={"start": start.model_copy(update={"speed_mps": speed})})


def choose_first_speed(table: ProfileTable, aircraft: AircraftSpec) -> float:
    """Return the airspeed at the start or, on the ground, of the climb after take-off [m/s]."""
    if table.start.speed_mps is not None:
        return float(table.start.speed_mps)
    if aircraft.hovers:
        return 0.0
    if aircraft.glides and aircraft.trims:
        return min(aircraft.trims, key=lambda trim: abs(trim[0] - table.start.alt_m))[1]
    climbs = (leg.speed for leg in build_legs(table) if isinstance(leg, TakeOff))
    return float(next(climbs, None) or 0.5 * (aircraft.min_speed + aircraft.max_speed))


def check_air(table: ProfileTable) -> list[str]:
    """Check the layers of the wind, and that gusts do not overlap."""
    wrong = []
    wind = table.wind
    if wind.layers and wind.speed_mps:
        wrong.append(
            f"[wind] {quantity('speed_mps', wind.speed_mps)}: not used with layers; leave one of them out"
        )
    if wind.thermals and table.terrain and table.terrain.file:
        wrong.append("[wind.thermals] stand on flat ground; leave [terrain] file out")
    if not wind.thermals:
        circles = (number for number, leg in enumerate(table.leg, 1) if leg.made.kind == "thermal")
        wrong += [f"[[leg]] {number} (thermal): needs [wind.thermals]" for number in circles]
    alts = [row.alt_m for row in wind.layers]
    for number, alt in enumerate(alts):
        if alt in alts[:number]:
            wrong.append(f"[wind] layers[{number}] {quantity('alt_m', alt)} is given twice")
    for number, gust in enumerate(table.gust, 1):
        if not (gust.north_mps or gust.east_mps or gust.up_mps):
            wrong.append(f"[[gust]] {number}: needs a north_mps, east_mps or up_mps other than 0")
    ordered = sorted(table.gust, key=lambda row: row.start_s)
    for earlier, later in itertools.pairwise(ordered):
        end = earlier.start_s + earlier.rise_s + earlier.hold_s + earlier.fall_s
        if later.start_s < end:
            what = quantity("start_s", later.start_s)
            wrong.append(
                f"[[gust]] {table.gust.index(later) + 1}: {what} is before the end of another at {end:g} s"
            )
    return wrong
