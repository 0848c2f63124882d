"""The tables of the legs of a profile, in the units of the file, and the legs they stand for."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from bench.config.tables import ROWS, Table, between
from bench.earth import matrix_en, to_ecef, to_geodetic
from bench.legs import (
    AileronRoll,
    Approach,
    Climb,
    Configuration,
    Cruise,
    Descend,
    Doublet,
    FigureEight,
    Flare,
    Holding,
    LandingRoll,
    Leg,
    SpeedChange,
    Static,
    Straight,
    STurns,
    Survey,
    TakeOff,
    Turn,
    Waypoint,
    Waypoints,
    WindUpTurn,
)

Seconds = Annotated[float, between(0.1, 86400)]
Bank = Annotated[float, between(1, 80)]
Altitude = Annotated[float, between(-500, 20000)]
Heading = Annotated[float, between(0, 360)]
Speed = Annotated[float, between(1, 400)]
Rate = Annotated[float, between(0.1, 100)]
Share = Annotated[float, between(-1, 1)]
Count = Annotated[int, between(1, 1000)]

_SIDES = {"right": 1, "left": -1}


def _one_of(table: Table, *names: str) -> None:
    given = [name for name in names if getattr(table, name) is not None]
    if len(given) != 1:
        wanted = f"has {' and '.join(given) or 'none of them'}: needs one of {', '.join(names)}"
        raise PydanticCustomError("whole", wanted)


class StraightTable(Table):
    """Hold heading, altitude and airspeed."""

    kind: Literal["straight"]
    duration_s: Seconds
    speed_mps: Speed | None = None


class CruiseTable(Table):
    """Hold heading, altitude and airspeed over a distance on the ground."""

    kind: Literal["cruise"]
    distance_m: Annotated[float, between(10, 1e7)]
    speed_mps: Speed | None = None


class SpeedTable(Table):
    """Change the airspeed and wait for it."""

    kind: Literal["speed"]
    speed_mps: Speed


class ClimbTable(Table):
    """Climb to an altitude."""

    kind: Literal["climb"]
    to_alt_m: Altitude
    rate_mps: Rate
    speed_mps: Speed | None = None


class DescendTable(Table):
    """Descend to an altitude."""

    kind: Literal["descend"]
    to_alt_m: Altitude
    rate_mps: Rate
    speed_mps: Speed | None = None


class TurnTable(Table):
    """Turn by an angle, positive to the right, or to a heading; at a bank or a rate."""

    kind: Literal["turn"]
    by_deg: Annotated[float, between(-3600, 3600)] | None = None
    to_heading_deg: Heading | None = None
    side: Literal["right", "left", "shorter"] = "shorter"
    bank_deg: Bank | None = None
    rate_deg_s: Annotated[float, between(0.1, 90)] | None = None
    speed_mps: Speed | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        _one_of(self, "by_deg", "to_heading_deg")
        _one_of(self, "bank_deg", "rate_deg_s")
        if self.by_deg is not None and self.side != "shorter":
            raise PydanticCustomError("whole", "has by_deg and side: the sign of by_deg is the side")
        return self


class FigureEightTable(Table):
    """Full circles, right then left."""

    kind: Literal["figure-eight"]
    bank_deg: Bank
    laps: Count
    speed_mps: Speed | None = None


class STurnsTable(Table):
    """Swing about the course, right first, and end on it."""

    kind: Literal["s-turns"]
    by_deg: Annotated[float, between(1, 180)]
    bank_deg: Bank
    count: Count
    speed_mps: Speed | None = None


class PointTable(Table):
    """A waypoint by latitude and longitude, or by metres from the start of the profile."""

    lat_deg: Annotated[float, between(-90, 90)] | None = None
    lon_deg: Annotated[float, between(-180, 180)] | None = None
    north_m: Annotated[float, between(-100e3, 100e3)] | None = None
    east_m: Annotated[float, between(-100e3, 100e3)] | None = None
    alt_m: Altitude | None = None

    @model_validator(mode="after")
    def _whole(self) -> Self:
        absolute, local = (self.lat_deg, self.lon_deg), (self.north_m, self.east_m)
        complete = [pair for pair in (absolute, local) if None not in pair]
        begun = [pair for pair in (absolute, local) if pair != (None, None)]
        if len(complete) != 1 or len(begun) != 1:
            raise PydanticCustomError("whole", "needs either lat_deg and lon_deg or north_m and east_m")
        return self


class WaypointsTable(Table):
    """Follow the tracks from point to point and fly by each but the last."""

    kind: Literal["waypoints"]
    points: Annotated[tuple[PointTable, ...], ROWS, Field(min_length=1)]
    bank_deg: Bank
    speed_mps: Speed | None = None


class SurveyTable(Table):
    """Parallel strips from the present position."""

    kind: Literal["survey"]
    course_deg: Heading | None = None
    length_m: Annotated[float, between(10, 1e6)]
    spacing_m: Annotated[float, between(1, 1e5)]
    strips: Count
    side: Literal["right", "left"] = "right"
    bank_deg: Bank
    speed_mps: Speed | None = None


class HoldingTable(Table):
    """Racetracks over ground with the fix at the present position."""

    kind: Literal["holding"]
    course_deg: Heading | None = None
    leg_s: Seconds = 60.0
    laps: Count
    side: Literal["right", "left"] = "right"
    bank_deg: Bank
    speed_mps: Speed | None = None


class StaticTable(Table):
    """Stand on the ground with brakes set."""

    kind: Literal["static"]
    duration_s: Seconds


class TakeOffTable(Table):
    """Take off and climb straight ahead to a height above the runway."""

    kind: Literal["take-off"]
    to_height_m: Annotated[float, between(20, 5000)]
    rate_mps: Rate
    speed_mps: Speed


class ApproachTable(Table):
    """Meet the glide path of the runway and fly it down to the flare."""

    kind: Literal["approach"]
    glide_deg: Annotated[float, between(1, 10)] = 3.0
    aim_m: Annotated[float, between(0, 1000)] = 60.0


class FlareTable(Table):
    """Touch down."""

    kind: Literal["flare"]


class LandingRollTable(Table):
    """Brake to a standstill and stand."""

    kind: Literal["landing-roll"]
    hold_s: Annotated[float, between(0.1, 86400)] = 10.0


class DoubletTable(Table):
    """Deflect a surface to and fro: share of its travel, positive rolls right, pitches down, yaws left."""

    kind: Literal["doublet"]
    surface: Literal["aileron", "elevator", "rudder"]
    amplitude: Share
    width_s: Annotated[float, between(0.2, 10)]
    count: Count = 1
    pause_s: Seconds = 8.0


class AileronRollTable(Table):
    """Roll all the way around by aileron: share of its travel, positive to the right."""

    kind: Literal["aileron-roll"]
    aileron: Share
    count: Count = 1
    pitch_deg: Annotated[float, between(0, 30)] = 15.0
    pause_s: Seconds = 8.0
    speed_mps: Speed | None = None


class WindUpTurnTable(Table):
    """Pull to a load factor in a steep turn, positive bank to the right."""

    kind: Literal["wind-up-turn"]
    bank_deg: Annotated[float, between(-85, 85)]
    load_factor: Annotated[float, between(1.2, 9)]
    rise_s: Annotated[float, between(1, 60)] = 5.0
    hold_s: Annotated[float, between(0.1, 60)] = 2.0
    speed_mps: Speed | None = None


class ConfigurationTable(Table):
    """Move flaps, 0 up to 1 full, or gear."""

    kind: Literal["configuration"]
    flaps: Annotated[float, between(0, 1)] | None = None
    gear: Literal["up", "down"] | None = None
    duration_s: Seconds = 5.0

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if self.flaps is None and self.gear is None:
            raise PydanticCustomError("whole", "needs flaps or gear")
        return self


LegTable = Annotated[
    StraightTable
    | CruiseTable
    | SpeedTable
    | ClimbTable
    | DescendTable
    | TurnTable
    | FigureEightTable
    | STurnsTable
    | WaypointsTable
    | SurveyTable
    | HoldingTable
    | StaticTable
    | TakeOffTable
    | ApproachTable
    | FlareTable
    | LandingRollTable
    | DoubletTable
    | AileronRollTable
    | WindUpTurnTable
    | ConfigurationTable,
    Field(discriminator="kind"),
]


def _rad(angle: float | None) -> float | None:
    return None if angle is None else math.radians(angle)


def to_leg(row: LegTable, start_lla: tuple[float, float, float]) -> Leg:
    """Return the leg of a table, in SI; local waypoints are from the start (rad, rad, m)."""
    match row:
        case StraightTable():
            return Straight(float(row.duration_s), row.speed_mps)
        case CruiseTable():
            return Cruise(float(row.distance_m), row.speed_mps)
        case SpeedTable():
            return SpeedChange(float(row.speed_mps))
        case ClimbTable():
            return Climb(float(row.to_alt_m), float(row.rate_mps), row.speed_mps)
        case DescendTable():
            return Descend(float(row.to_alt_m), float(row.rate_mps), row.speed_mps)
        case TurnTable():
            return Turn(
                by=_rad(row.by_deg),
                bank=_rad(row.bank_deg),
                heading=_rad(row.to_heading_deg),
                side=_SIDES.get(row.side, 0),
                rate=_rad(row.rate_deg_s),
                speed=row.speed_mps,
            )
        case FigureEightTable():
            return FigureEight(math.radians(row.bank_deg), row.laps, row.speed_mps)
        case STurnsTable():
            return STurns(math.radians(row.by_deg), math.radians(row.bank_deg), row.count, row.speed_mps)
        case WaypointsTable():
            points = tuple(_waypoint(point, start_lla) for point in row.points)
            return Waypoints(points, math.radians(row.bank_deg), row.speed_mps)
        case SurveyTable():
            return Survey(
                course=_rad(row.course_deg),
                length=float(row.length_m),
                spacing=float(row.spacing_m),
                strips=row.strips,
                side=_SIDES[row.side],
                bank=math.radians(row.bank_deg),
                speed=row.speed_mps,
            )
        case HoldingTable():
            return Holding(
                course=_rad(row.course_deg),
                leg_time=float(row.leg_s),
                laps=row.laps,
                side=_SIDES[row.side],
                bank=math.radians(row.bank_deg),
                speed=row.speed_mps,
            )
        case StaticTable():
            return Static(float(row.duration_s))
        case TakeOffTable():
            return TakeOff(float(row.to_height_m), float(row.rate_mps), float(row.speed_mps))
        case ApproachTable():
            return Approach(math.radians(row.glide_deg), float(row.aim_m))
        case FlareTable():
            return Flare()
        case LandingRollTable():
            return LandingRoll(float(row.hold_s))
        case DoubletTable():
            return Doublet(row.surface, row.amplitude, float(row.width_s), row.count, float(row.pause_s))
        case AileronRollTable():
            pitch, pause = math.radians(row.pitch_deg), float(row.pause_s)
            return AileronRoll(row.aileron, row.count, pitch, pause, row.speed_mps)
        case WindUpTurnTable():
            rise, hold = float(row.rise_s), float(row.hold_s)
            return WindUpTurn(math.radians(row.bank_deg), row.load_factor, rise, hold, row.speed_mps)
        case ConfigurationTable():
            gear = None if row.gear is None else row.gear == "down"
            return Configuration(row.flaps, gear, float(row.duration_s))


def _waypoint(row: PointTable, start_lla: tuple[float, float, float]) -> Waypoint:
    alt = None if row.alt_m is None else float(row.alt_m)
    if row.lat_deg is not None and row.lon_deg is not None:
        return Waypoint(math.radians(row.lat_deg), math.radians(row.lon_deg), alt)
    beside = matrix_en(start_lla[0], start_lla[1]) @ np.array([row.north_m, row.east_m, 0.0])
    lat, lon, _ = (float(v) for v in to_geodetic(to_ecef(start_lla) + beside))
    return Waypoint(lat, lon, alt)
