"""What must hold between the legs of a profile, its aircraft and its air: a line per thing that is wrong."""

from __future__ import annotations

import itertools
import math
from typing import Any

from bench.config.leg_tables import (
    AileronRollTable,
    ApproachTable,
    ClimbTable,
    ConfigurationTable,
    DescendTable,
    DoubletTable,
    FlareTable,
    LandingRollTable,
    LegTable,
    StaticTable,
    TakeOffTable,
    TurnTable,
    WaypointsTable,
    WindUpTurnTable,
)
from bench.config.profile_tables import ProfileTable
from bench.config.tables import quantity
from bench.specs import AircraftSpec


def legs(table: ProfileTable, aircraft: AircraftSpec) -> list[str]:
    """Check what the aircraft can do, that climbs go up and descents down, and where the ground is."""
    wrong = _start(table, aircraft)
    alt, low = float(table.start.alt_m), table.start.on_ground
    ground = table.runway.alt_m if table.runway else table.start.alt_m
    before: LegTable | None = None
    for number, leg in enumerate(table.leg, 1):
        place = f"[[leg]] {number} ({leg.kind}): "
        wrong += [place + what for what in _limits(leg, aircraft)]
        wrong += [place + what for what in _order(leg, before, low=low)]
        match leg:
            case ClimbTable() | DescendTable():
                up = isinstance(leg, ClimbTable)
                if leg.to_alt_m == alt or (leg.to_alt_m > alt) != up:
                    what = quantity("to_alt_m", leg.to_alt_m)
                    wrong.append(f"{place}{what} is not {'above' if up else 'below'} the {alt:g} m before it")
                alt = leg.to_alt_m
            case WaypointsTable():
                alt = next((p.alt_m for p in reversed(leg.points) if p.alt_m is not None), alt)
            case TakeOffTable():
                alt = ground + leg.to_height_m
            case ApproachTable():
                alt = ground
                if table.runway is None and not table.start.on_ground:
                    wrong.append(f"{place}there is no [runway] to approach")
        low = isinstance(leg, StaticTable | LandingRollTable | FlareTable)
        before = leg
    return wrong


def _start(table: ProfileTable, aircraft: AircraftSpec) -> list[str]:
    start = table.start
    if start.on_ground:
        wrong = []
        if start.speed_mps is not None:
            wrong.append(
                f"[start] {quantity('speed_mps', start.speed_mps)}: on_ground = true has no airspeed"
            )
        if table.runway is not None:
            wrong.append("[runway] is not needed: on_ground = true makes it of [start]")
        if aircraft.runway is None:
            wrong.append(
                f"[start] on_ground = true: the {aircraft.name} has no [runway] in its aircraft.toml"
            )
        return wrong
    if start.speed_mps is None:
        return [f"[start] speed_mps is missing, and the {aircraft.name} has no [[trim]]"]
    if not aircraft.min_speed <= start.speed_mps <= aircraft.max_speed:
        return [f"[start] {_speed(start.speed_mps, aircraft)}"]
    return []


def _speed(value: float, aircraft: AircraftSpec) -> str:
    limits = f"{aircraft.min_speed:g} to {aircraft.max_speed:g} m/s of the {aircraft.name}"
    return f"{quantity('speed_mps', value)} is outside {limits}"


def _limits(leg: LegTable, aircraft: AircraftSpec) -> list[str]:
    """Check the figures of a leg against the aircraft."""
    wrong = []
    value: Any = getattr(leg, "speed_mps", None)
    if value is not None and not aircraft.min_speed <= value <= aircraft.max_speed:
        wrong.append(_speed(value, aircraft))
    value = getattr(leg, "rate_mps", None)
    if value is not None:
        limit = aircraft.max_descent if isinstance(leg, DescendTable) else aircraft.max_climb
        if value > limit:
            wrong.append(f"{quantity('rate_mps', value)} is above the {limit:g} m/s of the {aircraft.name}")
    value = getattr(leg, "bank_deg", None)
    max_bank_deg = math.degrees(aircraft.max_bank)
    if value is not None and not isinstance(leg, WindUpTurnTable) and value > max_bank_deg * (1 + 1e-9):
        wrong.append(
            f"{quantity('bank_deg', value)} is above the {max_bank_deg:g} deg of the {aircraft.name}"
        )
    match leg:
        case TurnTable(by_deg=0):
            wrong.append("by_deg = 0 deg must not be 0; positive turns right")
        case WindUpTurnTable() if abs(leg.bank_deg) < 20:
            wrong.append(f"{quantity('bank_deg', leg.bank_deg)} must be 20 deg or more to either side")
        case DoubletTable(amplitude=0) | AileronRollTable(aileron=0):
            wrong.append("a deflection of 0 does nothing")
        case AileronRollTable() if abs(leg.aileron) < 0.2:
            wrong.append(f"{quantity('aileron', leg.aileron)} is too little to roll around; 0.2 to 1")
        case ConfigurationTable():
            moved = [name for name in ("flaps", "gear") if getattr(leg, name) is not None]
            wrong += [
                f"the {aircraft.name} has no {name} to move"
                for name in moved
                if name not in aircraft.configuration
            ]
        case TakeOffTable() | ApproachTable() if aircraft.runway is None:
            wrong.append(f"the {aircraft.name} has no [runway] in its aircraft.toml")
    return wrong


def _order(leg: LegTable, before: LegTable | None, *, low: bool) -> list[str]:
    """Check that what needs the ground is on it, and what needs the air is in it."""
    match leg:
        case StaticTable() if not low or isinstance(before, FlareTable):
            return ["stands on the ground: [start] on_ground = true, or a landing-roll before it"]
        case TakeOffTable() if not low or isinstance(before, FlareTable):
            return ["starts on the ground: [start] on_ground = true, or a landing-roll before it"]
        case FlareTable() if not isinstance(before, ApproachTable):
            return ["must follow an approach"]
        case LandingRollTable() if not isinstance(before, FlareTable):
            return ["must follow a flare"]
    if isinstance(before, ApproachTable) and not isinstance(leg, FlareTable):
        return ["must be a flare, after an approach"]
    if low and not isinstance(leg, StaticTable | TakeOffTable | LandingRollTable):
        return ["is flown in the air; a take-off must come before it"]
    return []


def with_speed(table: ProfileTable, aircraft: AircraftSpec) -> ProfileTable:
    """Return the profile with the airspeed of its start: what it says, or the trim nearest in altitude."""
    start = table.start
    if start.on_ground or start.speed_mps is not None or not aircraft.trims:
        return table
    _, speed = min(aircraft.trims, key=lambda trim: abs(trim[0] - start.alt_m))
    return table.model_copy(update={"start": start.model_copy(update={"speed_mps": speed})})


def first_speed(table: ProfileTable, aircraft: AircraftSpec) -> float:
    """Return the airspeed the flight begins with; on the ground that of the first climb [m/s]."""
    if table.start.speed_mps is not None:
        return float(table.start.speed_mps)
    climbs = (leg.speed_mps for leg in table.leg if isinstance(leg, TakeOffTable))
    return float(next(climbs, 0.5 * (aircraft.min_speed + aircraft.max_speed)))


def air(table: ProfileTable) -> list[str]:
    """Check the layers of the wind, and that gusts come one after the other."""
    wrong = []
    wind = table.wind
    if wind.layers and wind.speed_mps:
        wrong.append(f"[wind] {quantity('speed_mps', wind.speed_mps)}: layers take its place; leave one out")
    alts = [row.alt_m for row in wind.layers]
    for number, alt in enumerate(alts):
        if alt in alts[:number]:
            wrong.append(f"[wind] layers[{number}] {quantity('alt_m', alt)} is there twice")
    for number, gust in enumerate(table.gust, 1):
        if not (gust.north_mps or gust.east_mps or gust.up_mps):
            wrong.append(f"[[gust]] {number}: needs a north_mps, east_mps or up_mps that is not 0")
    ordered = sorted(table.gust, key=lambda row: row.start_s)
    for earlier, later in itertools.pairwise(ordered):
        end = earlier.start_s + earlier.rise_s + earlier.hold_s + earlier.fall_s
        if later.start_s < end:
            what = quantity("start_s", later.start_s)
            wrong.append(
                f"[[gust]] {table.gust.index(later) + 1}: {what} is before the end of another at {end:g} s"
            )
    return wrong
