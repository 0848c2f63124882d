"""The legs a flight is made of, in SI and radians.

Legs in the air hold the airspeed before them, or change to their own ``speed`` while they are flown.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Straight:
    """Hold course heading, altitude and airspeed."""

    duration: float  # [s]
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Cruise:
    """Hold course heading, altitude and airspeed over a distance."""

    distance: float  # over ground [m]
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class SpeedChange:
    """Change the airspeed on the present heading, and hold it."""

    speed: float  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Climb:
    """Climb on the present heading to an altitude."""

    to_alt: float  # ellipsoidal [m]
    rate: float  # [m/s], positive
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Descend:
    """Descend on the present heading to an altitude."""

    to_alt: float  # ellipsoidal [m]
    rate: float  # [m/s], positive
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Turn:
    """Turn by an angle or to a heading, at a bank or at a rate, altitude held."""

    by: float | None  # heading change, positive to the right [rad]; None: to heading
    bank: float | None  # [rad], positive; None: what rate needs at the airspeed
    heading: float | None = None  # [rad]
    side: int = 0  # to heading: 1 right, -1 left, 0 the shorter way
    rate: float | None = None  # of the heading [rad/s], positive; 3 deg/s is standard
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class FigureEight:
    """Full circles, right then left, again and again."""

    bank: float  # [rad], positive
    laps: int  # number of eights; one is a full right and a full left circle
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class STurns:
    """Turn off the course by an angle to the right, then to the left, again and again, and back to it."""

    by: float  # largest angle off the course [rad], positive
    bank: float  # [rad], positive
    count: int  # of right and left together
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Waypoint:
    """A point to fly by."""

    lat: float  # [rad]
    lon: float  # [rad]
    alt: float | None  # ellipsoidal [m]; None: the altitude before it


@dataclass(frozen=True, slots=True)
class Waypoints:
    """Follow the tracks from point to point over ground; turns begin early enough to meet the next track."""

    points: tuple[Waypoint, ...]
    bank: float  # of the turns at the highest ground speed [rad], positive
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Survey:
    """Parallel strips over ground from the present position, flown to and fro."""

    course: float | None  # of the first strip over ground [rad]; None: the present one
    length: float  # of a strip [m]
    spacing: float  # of the strips [m]
    strips: int
    side: int  # 1: the next strip is on the right, -1 left
    bank: float  # of the turns at the highest ground speed [rad], positive
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Holding:
    """A racetrack over ground, whatever the wind, from a fix at the present position."""

    course: float | None  # inbound, over ground [rad]; None: the present one
    leg_time: float  # of the straights at the airspeed [s]
    laps: int
    side: int  # of the turns: 1 right, -1 left
    bank: float  # of the turns at the highest ground speed [rad], positive
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Static:
    """Stand on the ground with brakes set."""

    duration: float  # [s]


@dataclass(frozen=True, slots=True)
class TakeOff:
    """Roll, rotate and climb straight ahead to a height above the runway."""

    to_height: float  # above the ground [m]
    rate: float  # of the climb [m/s]
    speed: float  # true airspeed of the climb [m/s]


@dataclass(frozen=True, slots=True)
class Approach:
    """Meet the extended centreline and the glide path of the runway, down to the flare."""

    glide: float  # angle of the path [rad], positive
    aim: float  # where the path meets the ground, beyond the threshold [m]


@dataclass(frozen=True, slots=True)
class Flare:
    """Break off the glide and touch down."""


@dataclass(frozen=True, slots=True)
class LandingRoll:
    """Lower the nose, brake to a standstill on the centreline, and stand."""

    hold: float  # how long it stands at the end [s]


@dataclass(frozen=True, slots=True)
class Doublet:
    """Deflect a surface to one side, then to the other, guidance off for it."""

    surface: str  # "aileron", "elevator" or "rudder"
    amplitude: float  # share of its travel, positive rolls right, pitches down, yaws left
    width: float  # of each half [s]
    count: int  # of doublets
    pause: float  # guidance flies between and after them [s]


@dataclass(frozen=True, slots=True)
class AileronRoll:
    """Raise the nose, roll all the way around by aileron alone, recover."""

    aileron: float  # share of its travel, positive to the right
    count: int  # of rolls, one after the other
    pitch: float  # before the roll [rad]
    pause: float  # guidance flies between and after them [s]
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class WindUpTurn:
    """Turn ever tighter by elevator to a load factor, hold it, roll out."""

    bank: float  # [rad], positive to the right
    load: float  # load factor to reach [1]
    rise: float  # how long the load factor takes to get there [s]
    hold: float  # [s]
    speed: float | None = None  # true airspeed [m/s]


@dataclass(frozen=True, slots=True)
class Configuration:
    """Move flaps or gear; heading, altitude and airspeed are held."""

    flaps: float | None  # 0 up to 1 full; None: as they are
    gear: bool | None  # True down, False up; None: as it is
    duration: float  # of the movement [s]


Leg = (
    Straight
    | Cruise
    | SpeedChange
    | Climb
    | Descend
    | Turn
    | FigureEight
    | STurns
    | Waypoints
    | Survey
    | Holding
    | Static
    | TakeOff
    | Approach
    | Flare
    | LandingRoll
    | Doublet
    | AileronRoll
    | WindUpTurn
    | Configuration
)
