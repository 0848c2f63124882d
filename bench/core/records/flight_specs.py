"""Specs of a flight in SI and radians: aircraft, runway, terrain, wind, legs, scripts and tables."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from bench.core.records.fields import declared, figure

SECONDS = (0.1, 86400)  # shortest and longest duration in a profile [s]
ALTITUDES = (-500, 20000)  # lowest and highest ellipsoidal altitude [m]
SPEEDS = (1, 400)  # lowest and highest true airspeed [m/s]
HEIGHTS = (0.01, 20)  # of a center of gravity above the ground at rest [m]
BANKS = (1, 80)  # smallest and largest bank of a turn [deg]
CLIMBS = (0.1, 100)  # smallest and largest vertical speed, up or down [m/s]
FIXED_WING, MULTIROTOR, GLIDER, HELICOPTER = "fixed-wing", "multirotor", "glider", "helicopter"
"""Kinds of aircraft of the bench."""
WINGS = (FIXED_WING, GLIDER)
"""Kinds that fly by airspeed."""
ROTORCRAFT = (MULTIROTOR, HELICOPTER)
"""Kinds that hover."""
MESH_OF_CLASS = {"uav": "uav", "light": "light-single", "transport": "jet", "fighter": "jet"}
"""Class of aircraft -> simple shape in the recording."""


@declared
class RunwaySpec:
    """Figures for take-off and landing of an aircraft; heights are of its center of gravity."""

    height: float = figure("m", *HEIGHTS)
    """Height of the center of gravity above the ground at rest [m]."""
    rotate_speed: float = figure("mps", 1, 200, stem="rotate")
    """Airspeed at which the nose is raised [m/s]."""
    take_off_pitch: float = figure("deg", 0.5, 25)
    """Pitch of the take-off [rad]."""
    approach_speed: float = figure("mps", 1, 200, stem="approach")
    """Airspeed on the glide path [m/s]."""
    flare_height: float = figure("m", 3.5, 100, stem="flare")
    """Height above the ground where the flare begins; in proportion more on a path above 3.5 deg [m]."""
    touch_down_sink: float = figure("mps", 0.05, 3, stem="touch_down")
    """Sink rate that the flare aims at [m/s]."""


@declared
class EnvelopeSpec:
    """Limits beyond which a flight has an exceedance; 0: not stated."""

    stall: float = figure("deg", 0, 90, default=0.0)
    """Angle of attack of the stall; 0: not stated [rad]."""
    max_cas: float = figure("mps", 0, SPEEDS[1], default=0.0)
    """Largest calibrated airspeed, VNE or VMO; 0: not stated [m/s]."""
    max_eas: float = figure("mps", 0, SPEEDS[1], default=0.0)
    """Largest equivalent airspeed, where VMO is one; 0: not stated [m/s]."""
    max_mach: float = figure("", 0, 5, default=0.0)
    """Largest Mach number, MMO; 0: not stated."""


@dataclass(frozen=True, slots=True)
class ForeignSpec:
    """Additional figures of an aircraft from the jsbsim wheel or from the user."""

    root: Path  # JSBSim root: holds engine/ and systems/
    properties: Mapping[str, float]  # JSBSim properties, set before the start: mixture, gear ...
    stubs: tuple[str, ...] = ()  # properties that its model reads and no part of it has: declared, 0
    guided: bool = False  # its model already contains the guidance system of the bench


@declared
class AircraftSpec:
    """An aircraft: its JSBSim model and the figures that guidance and sensors need.

    Antenna and static port are relative to the IMU here, and to the center of gravity in aircraft.toml.
    """

    name: str
    folder: Path  # holds <name>.xml
    systems: Path  # holds guidance.xml
    gains: Mapping[str, float]  # properties of the guidance system, by their name below ``guidance/``
    rough_gains: Mapping[str, float]  # of those the ones that differ in rough air
    rough_from: int  # severity at which rough air begins
    flare_gains: Mapping[str, float]  # and those that differ in a flare from light turbulence on
    approach_gains: Mapping[str, float]  # and those that differ on an approach and in its flare
    min_speed: float = figure("mps", 0, SPEEDS[1])
    """Slowest true airspeed that a profile may ask for [m/s]; of a multirotor 0, of others 1 or more."""
    max_speed: float = figure("mps", *SPEEDS)
    """Fastest true airspeed that a profile may ask for [m/s]."""
    max_bank: float = figure("deg", *BANKS)
    """Largest bank of a leg [rad]."""
    max_climb: float = figure("mps", *CLIMBS)
    """Largest climb rate of a leg [m/s]."""
    max_descent: float = figure("mps", *CLIMBS)
    """Largest descent rate of a leg, positive [m/s]."""
    antenna_b: tuple[float, float, float]  # GNSS antenna relative to the IMU [m], b
    category: str  # a key of MESH_OF_CLASS: shape in the recording, limits of the sanity report
    foreign: ForeignSpec | None = None  # how to fly it if it was not made for the bench
    imu_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # IMU relative to the center of gravity [m], b
    static_port_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # relative to the IMU [m], b
    trims: tuple[tuple[float, float], ...] = ()  # altitudes [m] and true airspeeds [m/s] to trim it at
    runway: RunwaySpec | None = None  # None: it starts and ends in the air
    configuration: tuple[str, ...] = ()  # parts that a leg may set: "flaps", "gear"
    kind: str = FIXED_WING  # or one of the others: its guidance system, trim and legs
    stand_height: float | None = None  # of what hovers on its legs, of a glider on its wheel [m]
    envelope: EnvelopeSpec = EnvelopeSpec()

    @property
    def hovers(self) -> bool:
        """Return whether it flies without airspeed."""
        return self.kind in ROTORCRAFT

    @property
    def has_four_rotors(self) -> bool:
        """Return whether four rotors carry it."""
        return self.kind == MULTIROTOR

    @property
    def glides(self) -> bool:
        """Return whether it has no engine: it holds its airspeed by pitch and sinks."""
        return self.kind == GLIDER

    @property
    def rest_height(self) -> float | None:
        """Return the height of the center of gravity above the ground at rest [m]; None: it never rests."""
        return self.runway.height if self.runway else self.stand_height

    @property
    def guided(self) -> bool:
        """Return whether the model has the guidance system of bench and engines without internal state."""
        return self.foreign is None or self.foreign.guided


@declared
class Runway:
    """Threshold and heading of a runway; without [terrain] all ground is at its height."""

    lat: float = figure("deg", -90, 90)
    """Latitude [rad]."""
    lon: float = figure("deg", -180, 180)
    """Longitude [rad]."""
    alt: float = figure("m", *ALTITUDES)
    """Height above the WGS 84 ellipsoid [m]."""
    heading: float = figure("deg", 0, 360)
    """Heading from true north [rad]."""
    width: float = figure("m", 1, 200, default=40.0)
    """Width of a runway; a leg on the ground that leaves it fails [m]."""
    length: float = figure("m", 0, 20000, default=0.0)
    """Length of a runway; 0: not stated, without an end [m]."""
    roughness: float = figure("cm3", 0, 50, default=0.0)
    """Roughness: elevation PSD at 1 rad/m, typically 0.13; 0: smooth [m^3/rad]."""


@dataclass(frozen=True, slots=True)
class TerrainSpec:
    """A file of heights of the ground; `bench.simulation.signals.terrain` reads it."""

    path: Path
    digest: str  # SHA-256 of the file
    geoid: float  # of what its heights count from, above the ellipsoid [m]
    runway: Runway | None  # around it the ground is level


@dataclass(frozen=True, slots=True)
class LegStart:
    """Conditions at the start of a leg that are known from the profile."""

    aircraft: AircraftSpec
    alt: float  # ellipsoidal [m]
    runway: Runway | None
    after: str  # ``leaves`` of the leg before it


@dataclass(frozen=True)
class Leg:
    """A part of a flight; `flight.legs` holds the kinds, frozen dataclasses with figures in SI."""

    kind: ClassVar[str]  # name in a profile
    flown_by: ClassVar[tuple[str, ...]] = (FIXED_WING,)  # kinds of aircraft
    needs: ClassVar[str] = "air"  # start: "air", "ground", or after an "approach" or a "flare"
    leaves: ClassVar[str] = "air"  # its end, in the same words
    any_bank: ClassVar[bool] = False  # it may bank beyond the limit of guidance

    def describe(self) -> str:
        """Return the figures of the leg in words; `keys.AtSpeed` adds the airspeed."""
        return ""

    def check(self, start: LegStart) -> list[str]:
        """Return mistakes in the figures, a line each; keys and start are checked elsewhere."""
        return []

    def alt_after(self, start: LegStart) -> float:
        """Return the ellipsoidal altitude at the end of the leg [m]."""
        return start.alt

    def fly(self, cockpit: Any) -> Iterator[None]:
        """Write set-points into a `cockpit.Cockpit`, one step per time of guidance.

        The generator may return a remark about the leg as flown.

        Raises
        ------
        FlightError
            If the leg cannot be flown.
        """
        raise NotImplementedError


@declared
class WindLayer:
    """Wind at one altitude; components are linear between altitudes and constant beyond them."""

    alt: float = figure("m", *ALTITUDES)
    """Ellipsoidal altitude [m]."""
    wind_from: float = figure("deg", 0, 360, stem="from")
    """Direction that the wind blows from [rad]."""
    speed: float = figure("mps", 0, 100)
    """Its speed [m/s]."""


@declared
class ThermalsSpec:
    """Convective layer over flat ground, for the thermals in it."""

    w_star: float = figure("mps", 0.1, 10)
    """Velocity scale w* of the convective layer [m/s]; 2.56 on an average day in the desert of Nevada."""
    depth: float = figure("m", 100, 5000)
    """Depth of the layer above the ground [m]; 1401 on that day."""


@declared
class Gust:
    """A discrete gust with a 1 - cosine rise and fall."""

    air_n: tuple[float, float, float]  # velocity added to the air mass at the peak [m/s], n
    start: float = figure("s", 0, 86400)
    """Instant at which it begins [s]."""
    rise: float = figure("s", *SECONDS, default=1.0)
    """Duration of the increase [s]."""
    hold: float = figure("s", 0, 600, default=0.0)
    """Duration of the peak [s]."""
    fall: float = figure("s", *SECONDS, default=1.0)
    """Duration of the decrease [s]."""


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """A flight by legs: all that the truth depends on."""

    aircraft: AircraftSpec
    rate: float  # truth and IMU output rate [Hz]
    lat: float  # [rad]
    lon: float  # [rad]
    alt: float  # ellipsoidal [m]
    heading: float  # [rad]
    speed: float  # true airspeed [m/s]
    wind_from: float  # direction the wind blows from [rad]
    wind_speed: float  # [m/s]
    severity: int  # Dryden turbulence: index of exceedance of MIL-F-8785C, 0 none
    turbulence_seed: int
    legs: tuple[Leg, ...]
    duration: float | None  # the last leg is held until then [s]; None: until it ends
    on_ground: bool = False  # starts at rest on the runway; ``speed`` is then the speed of the first climb
    runway: Runway | None = None
    flat_alt: float = 0.0  # ellipsoidal height of the ground without a runway [m]
    wind_layers: tuple[WindLayer, ...] = ()  # upwards; they replace wind_from and wind_speed
    gusts: tuple[Gust, ...] = ()  # in order, without overlap
    terrain: TerrainSpec | None = None  # None: flat ground
    thermals: ThermalsSpec | None = None  # None: the air neither rises nor sinks

    @property
    def ground_alt(self) -> float:
        """Ellipsoidal height of flat ground [m]."""
        return self.flat_alt if self.runway is None else self.runway.alt

    @property
    def label(self) -> str:
        """Description of the flight."""
        return f"aircraft {self.aircraft.name}"

    @property
    def mesh(self) -> str:
        """Class of the simple shape in the recording."""
        return self.aircraft.kind if self.aircraft.hovers else MESH_OF_CLASS[self.aircraft.category]


@dataclass(frozen=True, slots=True)
class ScriptSpec:
    """A flight by a JSBSim script, unchanged."""

    name: str
    path: Path
    root: Path  # JSBSim root: holds aircraft/, engine/ and systems/
    aircraft: str  # name of the aircraft
    rate: float  # truth and IMU output rate [Hz]
    duration: float | None  # the script is stopped then [s]; None: it runs to its end
    turbulence_seed: int  # seed of JSBSim's random numbers if the script sets none
    category: str  # a key of MESH_OF_CLASS: shape in the recording, limits of the sanity report

    @property
    def label(self) -> str:
        """Description of the flight."""
        return f"script {self.name}, aircraft {self.aircraft}"

    @property
    def mesh(self) -> str:
        """Class of the simple shape in the recording."""
        return MESH_OF_CLASS[self.category]


@dataclass(frozen=True, slots=True)
class TrackSpec:
    """Assumptions about a track of positions: the vehicle, the noise of the fixes, the wind."""

    vehicle: str = "aircraft"  # or "ground"
    noise: float | None = None  # sd of a fix, north and east each [m]; None: estimated
    vertical_noise: float | None = None  # the same of its height [m]
    wind_from: float = 0.0  # direction that the wind blows from [rad]
    wind_speed: float = 0.0  # [m/s]
    incidence: float = math.radians(3.0)  # of an aircraft's nose above its path through the air [rad]
    begin: float = 0.0  # the piece that is used [s]
    end: float = math.inf
    bridge: float = 30.0  # longest interval between fixes that is bridged [s]

    @property
    def wind_n(self) -> tuple[float, float, float]:
        """Velocity of the air [m/s], n."""
        return -self.wind_speed * math.cos(self.wind_from), -self.wind_speed * math.sin(self.wind_from), 0.0


@dataclass(frozen=True, slots=True)
class TableSpec:
    """A trajectory from a table made by other software."""

    name: str
    path: Path
    rate: float  # truth and IMU output rate [Hz]
    duration: float | None  # the truth ends then [s]; None: at the end of the table
    mesh: str = "uav"  # class of the simple shape in the recording
    track: TrackSpec | None = None  # None: [track] is not in the profile

    @property
    def label(self) -> str:
        """Description of the flight."""
        return f"trajectory {self.path.name}"


Flight = FlightSpec | ScriptSpec | TableSpec
