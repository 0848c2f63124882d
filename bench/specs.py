"""Specs of an experiment in SI and radians: aircraft, flight, sensors, estimators; named random streams."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np

from bench.arrays import FloatArray
from bench.errors import ConfigError
from bench.fields import declared, figure, triad_figure
from bench.instruments import InstrumentSpecs
from bench.moved import moved_from
from bench.orbit_sets import GlonassSets, KeplerSets, parse_systems
from bench.spawned import machine_memory
from bench.units import SAME_INSTANT
from bench.wording import quantity

GAUSS_MARKOV_PEAK = 0.617
"""Peak of the Allan deviation of a first-order Gauss-Markov process over its standard deviation [1]."""
AUTOPILOT = "autopilot"
"""Name of the estimate in the log of an autopilot, as an estimator."""
DEFAULT_DATE = 2026.0
"""Date of a flight without one in its profile: 1 January 2026 [decimal years]."""


def stream(seed: int, run: int, name: str) -> np.random.Generator:
    """Return the random stream of one error term ("imu.gyro.white", "gnss.markov", "initial") in one run.

    Adding, removing or reordering one term leaves the noise of every other bit-identical.

    Examples
    --------
    >>> bool(stream(1, 0, "initial").normal() == stream(1, 0, "initial").normal())
    True
    """
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, key)))


# --- the flight ---------------------------------------------------------------------------------------


SECONDS = (0.1, 86400)  # shortest and longest duration in a profile [s]
ALTITUDES = (-500, 20000)  # lowest and highest ellipsoidal altitude [m]
SPEEDS = (1, 400)  # lowest and highest true airspeed [m/s]
BANKS = (1, 80)  # smallest and largest bank of a turn [deg]
CLIMBS = (0.1, 100)  # smallest and largest vertical speed, up or down [m/s]
MESH_OF_CLASS = {"uav": "uav", "light": "light-single", "transport": "jet", "fighter": "jet"}
"""Class of aircraft -> simple shape in the recording."""


@declared
class RunwaySpec:
    """Figures for take-off and landing of an aircraft; heights are of its centre of gravity."""

    height: float = figure("m", 0.01, 20)
    """Height of the centre of gravity above the ground at rest [m]."""
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

    Antenna and static port are relative to the IMU here, and to the centre of gravity in aircraft.toml.
    """

    name: str
    folder: Path  # holds <name>.xml
    systems: Path  # holds guidance.xml
    gains: Mapping[str, float]  # properties of the guidance system, by their name below ``guidance/``
    rough_gains: Mapping[str, float]  # of those the ones that differ from moderate turbulence on
    flare_gains: Mapping[str, float]  # and those that differ in a flare from light turbulence on
    min_speed: float = figure("mps", *SPEEDS)
    """Slowest true airspeed that a profile may ask for [m/s]."""
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
    imu_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # IMU relative to the centre of gravity [m], b
    static_port_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # relative to the IMU [m], b
    trims: tuple[tuple[float, float], ...] = ()  # altitudes [m] and true airspeeds [m/s] to trim it at
    runway: RunwaySpec | None = None  # None: it starts and ends in the air
    configuration: tuple[str, ...] = ()  # parts that a leg may set: "flaps", "gear"

    @property
    def guided(self) -> bool:
        """Whether its model has the guidance system of the bench and engines without internal state."""
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


@dataclass(frozen=True, slots=True)
class TerrainSpec:
    """A file of heights of the ground; `bench.signals.terrain` reads it."""

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
    """A part of a flight; `bench.flight.legs` holds the kinds, frozen dataclasses with figures in SI."""

    kind: ClassVar[str]  # name in a profile
    needs: ClassVar[str] = "air"  # start: "air", "ground", or after an "approach" or a "flare"
    leaves: ClassVar[str] = "air"  # its end, in the same words
    any_bank: ClassVar[bool] = False  # it may bank beyond the limit of guidance

    def describe(self) -> str:
        """Return the figures of the leg in words; `bench.flight.legs.keys.AtSpeed` adds the airspeed."""
        return ""

    def check(self, start: LegStart) -> list[str]:
        """Return mistakes in the figures, a line each; keys and start are checked elsewhere."""
        return []

    def alt_after(self, start: LegStart) -> float:
        """Return the ellipsoidal altitude at the end of the leg [m]."""
        return start.alt

    def fly(self, cockpit: Any) -> Iterator[None]:
        """Write set-points into a `bench.flight.cockpit.Cockpit`, one step per instant of guidance.

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
class Gust:
    """A discrete gust with a 1 - cosine rise and fall."""

    air_n: tuple[float, float, float]  # velocity added to the air mass at the peak [m/s], n
    start: float = figure("s", 0, 86400)
    """Instant at which it begins [s]."""
    rise: float = figure("s", *SECONDS, default=1.0)
    """How long it rises [s]."""
    hold: float = figure("s", 0, 600, default=0.0)
    """How long it holds its peak [s]."""
    fall: float = figure("s", *SECONDS, default=1.0)
    """How long it falls [s]."""


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
    on_ground: bool = False  # starts at rest on the runway; ``speed`` is then that of the first climb
    runway: Runway | None = None
    flat_alt: float = 0.0  # ellipsoidal height of the ground without a runway [m]
    wind_layers: tuple[WindLayer, ...] = ()  # upwards; they replace wind_from and wind_speed
    gusts: tuple[Gust, ...] = ()  # in order, without overlap
    terrain: TerrainSpec | None = None  # None: flat ground

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
        return MESH_OF_CLASS[self.aircraft.category]


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
    """What a track of positions does not tell: the vehicle, its fixes' noise, the wind it flew in."""

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


# --- the sensors --------------------------------------------------------------------------------------


_ANGLES, _SHARES = ("mrad", "deg", "arcsec", "percent"), ("ppm", "percent")
_NOISE = ("deg_sqrt_h", "deg_s_sqrt_hz"), ("m_s_sqrt_h", "ug_sqrt_hz", "mg_sqrt_hz")
_DRIFT, _ACCELERATION = ("deg_h", "deg_s"), ("ug", "mg")


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """A figure of a triad whose axes differ, in its unit."""

    name: str  # field of `TriadSpec`
    x: float
    y: float
    z: float


@declared
class TriadSpec:
    """Three gyros (unit rad) or three accelerometers (unit m/s). 0 switches an error off.

    A figure is that of all axes, or the largest of those in ``axes``.
    """

    random_walk: float = triad_figure(*_NOISE, key="noise", sought="noise", default=0.0, by_axis=True)
    """White noise of the rate: angular or velocity random walk N [unit/sqrt(s)]."""
    bias_instability: float = triad_figure(
        _DRIFT, _ACCELERATION, sought="bias instability", default=0.0, by_axis=True
    )
    """Bias instability: minimum of the Allan deviation, white noise excluded [unit/s]."""
    bias_correlation: float = triad_figure(("s",), ("s",), default=0.0)
    """Correlation time of the bias instability [s]."""
    bias_model: str = "flicker"
    """Course of the bias instability: "flicker" noise, or a "gauss-markov" process."""
    turn_on_bias_sd: float = triad_figure(
        _DRIFT, _ACCELERATION, sought="turn-on bias", default=0.0, by_axis=True
    )
    """Turn-on bias, constant in a run [unit/s]."""
    scale_factor_sd: float = triad_figure(
        _SHARES, _SHARES, sought="scale factor", error="scale factor", default=0.0, by_axis=True
    )
    """Error of the scale factor [1]."""
    misalignment_sd: float = triad_figure(
        _ANGLES, _ANGLES, sought="misalignment", error="misalignment", default=0.0
    )
    """Misalignment: each off-diagonal element of the matrix [rad]."""
    quantization: float = triad_figure(("rad", "deg"), ("m_s",), error="quantization", default=0.0)
    """Resolution of an increment [unit]."""
    rate_random_walk: float = triad_figure(
        ("deg_h_sqrt_h", "deg_s_sqrt_s"), ("ug_sqrt_h",), error="rate random walk", default=0.0, by_axis=True
    )
    """Rate random walk K: the random walk of the bias [unit/s/sqrt(s)]."""
    scale_asymmetry_sd: float = triad_figure(
        _SHARES, _SHARES, error="scale factor asymmetry", default=0.0, by_axis=True
    )
    """Half the difference between the scale factors of positive and negative motion [1]."""
    nonlinearity_sd: float = triad_figure(_SHARES, _SHARES, error="nonlinearity", default=0.0, by_axis=True)
    """Largest deviation from the best straight line, over the range [1]."""
    quadratic_sd: float = triad_figure((), ("ug_g2",), error="nonlinearity", default=0.0, by_axis=True)
    """Coefficient of the squared specific force [1/(unit/s)]."""
    nonorthogonality_sd: float = triad_figure(
        _ANGLES, _ANGLES, sought="misalignment", error="non-orthogonality", default=0.0
    )
    """Non-orthogonality: deviation of the angle between two sensing axes from 90 deg [rad]."""
    alignment_sd: float = triad_figure(
        _ANGLES, _ANGLES, sought="misalignment", error="alignment", default=0.0
    )
    """Rotation of the triad in its case, each axis [rad]."""
    g_sensitivity_sd: float = triad_figure(
        ("deg_h_g", "deg_s_g"), sought="g-sensitivity", error="g-sensitivity", default=0.0
    )
    """Sensitivity to specific force: each element of the matrix [unit/s/(m/s^2)]."""
    g2_sensitivity_sd: float = triad_figure(
        ("deg_h_g2", "deg_s_g2"), sought="g-sensitivity", error="sensitivity to g squared", default=0.0
    )
    """Sensitivity to squared specific force: each element of the matrix [unit/s/(m/s^2)^2]."""
    temperature_sd: float = triad_figure(
        ("deg_h_k", "deg_s_k"),
        ("ug_k", "mg_k"),
        sought="temperature",
        error="temperature bias",
        default=0.0,
        by_axis=True,
    )
    """Bias per difference from the reference temperature [unit/s/K]."""
    dead_zone: float = triad_figure(_DRIFT, _ACCELERATION, error="dead zone", default=0.0)
    """Dead zone: what is below it reads 0 [unit/s]."""
    dead_zone_kind: str = "subtractive"
    """What is above the dead zone is less by it ("subtractive") or unchanged ("hard")."""
    range: float = triad_figure(("deg_s",), ("g",), sought="range", default=0.0)
    """Range: samples beyond it are clipped and flagged [unit/s]; 0: no limit."""
    bandwidth: float = triad_figure(
        ("hz",), ("hz",), sought="bandwidth", error="bandwidth and delay", default=0.0
    )
    """-3 dB frequency of a second-order Butterworth filter of the motion [Hz]; 0: no filter."""
    delay: float = triad_figure(("s",), ("s",), error="bandwidth and delay", default=0.0)
    """Delay of the motion, in addition to that of the filter [s]."""
    axes: tuple[AxisFigures, ...] = ()  # figures whose axes differ

    @property
    def instability_sd(self) -> float:
        """Standard deviation of the Gauss-Markov process whose Allan deviation peaks at bias_instability."""
        return self.bias_instability / GAUSS_MARKOV_PEAK

    @property
    def instability_by_axis(self) -> FloatArray:
        """``instability_sd`` for x, y and z (3,)."""
        return np.asarray(self.by_axis("bias_instability") / GAUSS_MARKOV_PEAK)

    def by_axis(self, name: str) -> FloatArray:
        """Return a figure for x, y and z (3,)."""
        for one in self.axes or ():
            if one.name == name:
                return np.array([one.x, one.y, one.z])
        return np.full(3, getattr(self, name))

    def averaged(self) -> TriadSpec:
        """Return a triad with the same figures for all axes: root mean squares of those that differ."""
        means: dict[str, Any] = {
            one.name: math.sqrt((one.x**2 + one.y**2 + one.z**2) / 3.0) for one in self.axes or ()
        }
        return replace(self, axes=(), **means)


@declared
class ThermalSpec:
    """Temperature of an IMU: from that of the air to air plus self-heating, with a time constant."""

    reference: float = figure("degc", -60, 150, default=298.15)
    """Temperature at which the temperature errors are zero [K]."""
    self_heating: float = figure("k", default=0.0)
    """Final excess of the unit over the air [K]."""
    time_constant: float = figure("s", default=0.0)
    """Time constant of the warming [s]; 0: immediate."""


@declared
class VibrationSpec:
    """Vibration at the IMU, rms of each axis. 0 switches a source off."""

    engine_gyro: float = figure("deg_s", default=0.0)
    """By the engine, at its reference speed, rms; it grows with the square of the speed [rad/s]."""
    engine_accel: float = figure("mg", default=0.0)
    """The same of the accelerometers [m/s^2]."""
    engine_reference: float = figure("rpm", default=0.0)
    """Reference speed of the engine [rad/s]."""
    engine_order: float = figure(default=1.0)
    """Periods per revolution of the engine [1]."""
    gust_gyro: float = figure("deg_s_per_mps", default=0.0)
    """Of the structural mode that gusts excite, per rms of the gusts [rad/s/(m/s)]."""
    gust_accel: float = figure("mg_per_mps", default=0.0)
    """The same of the accelerometers [m/s^2/(m/s)]."""
    mode_frequency: float = figure("hz", default=0.0)
    """Frequency of that mode [Hz]."""
    mode_damping: float = figure("", 0, 1, default=0.0)
    """Damping of that mode, over critical damping [1]."""


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """An IMU by its datasheet."""

    name: str
    gyro: TriadSpec
    accel: TriadSpec
    thermal: ThermalSpec = field(default_factory=ThermalSpec)
    vibration: VibrationSpec = field(default_factory=VibrationSpec)
    accel_cone: float = 0.0  # half-angle of a skewed accelerometer triad about x [rad]; 0: axes along b
    accel_arms: tuple[tuple[float, float, float], ...] = ()  # positions of the x, y, z accelerometer [m], b

    @property
    def feels_air(self) -> bool:
        """Whether an error depends on temperature, gusts or engine speed of the flight."""
        v = self.vibration
        shaken = max(v.engine_gyro, v.engine_accel, v.gust_gyro, v.gust_accel) > 0
        return shaken or max(self.gyro.temperature_sd, self.accel.temperature_sd) > 0


@declared
class SkySpec:
    """Measurement-level GNSS: constellations, reception, errors of the ranges. 0 switches an error off."""

    day: date  # of the flight
    gps_t0: float  # GPS time of the start of the run, seconds since midnight of that day [s]
    orbits: Mapping[int, KeplerSets | GlonassSets] | None  # by system, since that midnight; others: nominal
    klobuchar: tuple[float, ...]  # (8,) true and broadcast ionosphere, alpha 0-3, beta 0-3
    systems: str  # that the receiver has, as `bench.orbit_sets.parse_systems` takes it; "auto": GPS, GLONASS
    bands: int  # 1, or 2: the ionosphere-free combination
    elevation_mask: float = figure("deg", 3, 60)
    """Lowest elevation above the horizon that is used [rad]."""
    antenna_mask: float = figure("deg", -90, 60)
    """Lowest elevation above the plane of the antenna that is received [rad]."""
    cn0_zenith: float = figure("dbhz", 0, 70)
    """C/N0 along the axis of the antenna, up in the body [dB-Hz]."""
    cn0_horizon: float = figure("dbhz", 0, 70)
    """C/N0 in the plane of the antenna [dB-Hz]."""
    cn0_threshold: float = figure("dbhz", 0, 70)
    """Lowest C/N0 that is tracked [dB-Hz]."""
    second_band_loss: float = figure("db", default=0.0)
    """Loss of C/N0 of the second band against the first [dB]."""
    reacquisition: float = figure("s", default=0.0)
    """Time from the signal back to measurements back [s]."""
    dll_bandwidth: float = figure("hz", default=0.0)
    """Bandwidth of the code loop, which sets the noise of pseudoranges [Hz]."""
    dll_spacing: float = figure("chip", 0.01, 1, default=1.0)
    """Early to late spacing of the code loop [chip]."""
    fll_bandwidth: float = figure("hz", default=0.0)
    """Bandwidth of the frequency loop, which sets the noise of range rates [Hz]."""
    integration: float = figure("s", 1e-3, 1, default=0.02)
    """Integration before detection [s]."""
    gps_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of GPS satellites, along the range [m]."""
    glonass_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of GLONASS satellites, along the range [m]."""
    galileo_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of Galileo satellites, along the range [m]."""
    beidou_space_sd: float = figure("m", default=0.0)
    """Ephemeris and clock of BeiDou satellites, along the range [m]."""
    space_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of these [s]."""
    ionosphere_sd: float = figure("m", default=0.0)
    """Vertical delay that the broadcast model of the ionosphere leaves [m]."""
    ionosphere_share: float = figure("", 0, 1, default=0.0)
    """The same as a share of the delay that the model gives, beside it [1]."""
    ionosphere_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of both [s]."""
    ionosphere_decay: float = figure("km", 100, 1e5, default=3e6)
    """Distance in the ionosphere over which they lose all but 1/e of their correlation [m]."""
    troposphere_sd: float = figure("m", default=0.0)
    """Vertical delay that the model of the troposphere leaves [m]."""
    troposphere_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of that [s]."""
    multipath_zenith_sd: float = figure("m", default=0.0)
    """Multipath at the zenith [m]."""
    multipath_horizon_sd: float = figure("m", default=0.0)
    """Multipath added at the horizon, 1/e of it at 10 deg [m]."""
    multipath_correlation: float = figure("s", 1e-6, 1e9, default=0.0)
    """Correlation time of the multipath [s]."""
    clock_offset_sd: float = figure("m", default=0.0)
    """Offset of the receiver clock at the start [m]."""
    clock_drift_sd: float = figure("mps", default=0.0)
    """Drift of the receiver clock at the start [m/s]."""
    glonass_offset_sd: float = figure("m", default=0.0)
    """GLONASS against GPS time in the receiver [m]."""
    galileo_offset_sd: float = figure("m", default=0.0)
    """Galileo against GPS time in the receiver [m]."""
    beidou_offset_sd: float = figure("m", default=0.0)
    """BeiDou against GPS time in the receiver [m]."""
    clock_h_0: float = figure("s", default=0.0)
    """White frequency noise of the clock, one-sided power-law coefficient [s]."""
    clock_h_m1: float = figure(default=0.0)
    """Flicker of its frequency [1]."""
    clock_h_m2: float = figure("hz", default=0.0)
    """Random walk of its frequency [1/s]."""
    clock_g: float = figure("ppb", -1e6, 1e6, default=0.0)
    """Change of its frequency with the specific force along body down; in a file, per g [s^2/m]."""
    false_alarm: float = figure("", 0, 0.5, default=1e-3)
    """Chance that the fault exclusion of an epoch raises a false alarm [1]."""

    @property
    def constellations(self) -> tuple[int, ...]:
        """Codes of the systems that the receiver has, in ascending order."""
        return tuple(sorted(parse_systems("both" if self.systems == "auto" else self.systems)))

    @property
    def space_sd(self) -> tuple[float, float, float, float]:
        """Error of ephemeris and clock by system [m]."""
        return self.gps_space_sd, self.glonass_space_sd, self.galileo_space_sd, self.beidou_space_sd

    @property
    def offset_sd(self) -> tuple[float, float, float, float]:
        """Time of each system against that of GPS in the receiver [m]."""
        return 0.0, self.glonass_offset_sd, self.galileo_offset_sd, self.beidou_offset_sd

    @property
    def ionosphere_left(self) -> bool:
        """Whether ranges have an error of the ionosphere beyond the broadcast model."""
        return max(self.ionosphere_sd, self.ionosphere_share) > 0


@declared
class GnssSpec:
    """Position-level GNSS errors (A-5.2.1, A-5.2.2); standard deviations are per horizontal axis."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Fixes in a second [Hz]."""
    pos_h_white_sd: float = figure("m", reported=True)
    """White noise of the position, each horizontal axis [m]."""
    pos_v_white_sd: float = figure("m", reported=True)
    """White noise of the height [m]."""
    vel_white_sd: float = figure("mps", reported=True)
    """White noise of the velocity, each axis [m/s]."""
    vel_v_white_sd: float = figure("mps", default=0.0)
    """The same of the vertical velocity, if it differs [m/s]; 0: it does not."""
    pos_h_markov_sd: float = figure("m", default=0.0)
    """Error of the position that wanders, each horizontal axis [m]."""
    pos_v_markov_sd: float = figure("m", default=0.0)
    """Error of the height that wanders [m]."""
    vel_markov_sd: float = figure("mps", default=0.0)
    """Error of the velocity that wanders, each axis [m/s]."""
    pos_decay_distance: float = figure("km", default=0.0, reciprocal=True)
    """Distance over which the error of the position wanders, lambda_s [1/m]."""
    pos_decay_time: float = figure("s", default=0.0, reciprocal=True)
    """Time over which the error of the position wanders, lambda_st [1/s]."""
    vel_decay_time: float = figure("s", default=0.0, reciprocal=True)
    """Time over which the error of the velocity wanders, lambda_V [1/s]."""
    latency: float = figure("s", default=0.0)
    """Time from a fix until a filter gets it [s]."""
    pos_h_jump_sd: float = figure("m", default=0.0)
    """Jump of the position at a fix where the satellites in use change, each horizontal axis [m]."""
    pos_v_jump_sd: float = figure("m", default=0.0)
    """The same of the height [m]."""
    vel_jump_sd: float = figure("mps", default=0.0)
    """The same of the velocity, each axis [m/s]."""
    pos_h_jump_markov_sd: float = figure("m", default=0.0)
    """Jump of the error of the position that wanders, each horizontal axis [m]."""
    pos_v_jump_markov_sd: float = figure("m", default=0.0)
    """The same of the height [m]."""
    vel_jump_markov_sd: float = figure("mps", default=0.0)
    """The same of the velocity, each axis [m/s]."""
    tracking_bandwidth: float = figure("hz", default=0.0)
    """Noise bandwidth of the loops that follow the motion [Hz]; 0: they are never behind."""
    optimism: float = figure("", 0.05, 20, default=1.0)
    """True standard deviation of a fix over the one that it reports [1]."""
    sky: SkySpec | None = None  # measurement level; only filters then assume the errors above

    @property
    def pos_white_sd_n(self) -> tuple[float, float, float]:
        """White noise of the position north, east and down [m]."""
        return self.pos_h_white_sd, self.pos_h_white_sd, self.pos_v_white_sd

    @property
    def vel_white_sd_n(self) -> tuple[float, float, float]:
        """White noise of the velocity north, east and down [m/s]."""
        return self.vel_white_sd, self.vel_white_sd, self.vel_v_white_sd or self.vel_white_sd

    @property
    def jumps(self) -> bool:
        """Whether the error jumps where the satellites in use change."""
        passing = (self.pos_h_jump_sd, self.pos_v_jump_sd, self.vel_jump_sd)
        return any((*passing, self.pos_h_jump_markov_sd, self.pos_v_jump_markov_sd, self.vel_jump_markov_sd))


@dataclass(frozen=True, slots=True)
class Fault:
    """A scripted fault in [start, end); fields that its kind does not use keep their defaults."""

    kind: str  # as in the profile
    sensor: str  # "gnss", "imu", "gyro", "accel" or the name of an instrument
    start: float  # [s]
    end: float  # [s]
    text: str  # description, with the figures of the profile
    satellites: tuple[tuple[int, int], ...] = ()  # (system, number)
    step: tuple[float, ...] = ()  # constant error in SI: in n, in b or a single value
    ramp: tuple[float, ...] = ()  # growth of the error per second
    loss: float = 0.0  # of C/N0 [dB]
    delay: float = 0.0  # [s]
    times: float = 0.0  # noise burst over the white noise of the sensor [1]
    share: float = 1.0  # fraction of the samples affected [1]
    axes: tuple[int, ...] = (0, 1, 2)  # of a triad
    coherent: bool = True  # the velocity error matches the ramp


@dataclass(frozen=True, slots=True)
class AssumedSpecs(InstrumentSpecs):
    """The datasheets that an estimator assumes."""

    imu: ImuSpec
    gnss: GnssSpec | None


@dataclass(frozen=True, slots=True)
class SensorsSpec(InstrumentSpecs):
    """The sensors on board, the datasheets that filters assume, initial errors, outages and faults."""

    imu: ImuSpec
    gnss: GnssSpec | None
    assumed: AssumedSpecs
    antenna_b: tuple[float, float, float]  # [m], b
    gnss_outages: tuple[tuple[float, float], ...]  # [start, end) [s], ordered, disjoint
    initial_pos_sd: tuple[float, float, float]  # n [m]
    initial_vel_sd: tuple[float, float, float]  # n [m/s]
    initial_tilt_sd: float  # north and east component of phi_n [rad]
    initial_heading_sd: float  # down component of phi_n [rad]
    output_rate: float  # of the solutions [Hz]
    date: float = DEFAULT_DATE  # of the flight [decimal years]
    alignment: str = "given"  # initial values given to the estimators: "given", "level" or "course"
    align_for: float = 60.0  # level: longest standstill to use, course: length of the alignment [s]
    drift_sd: float = 0.0  # course: of the angle from course to nose [rad]
    qnh: float = 101325.0  # altimeter setting of a physical barometer [Pa]
    static_port_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the centre of gravity [m], b
    ground_alt: float = 0.0  # ellipsoidal height of the runway, as a chart has it [m]
    rest_height: float = math.inf  # of the IMU above the ground at rest [m]; inf: a ground vehicle
    faults: tuple[Fault, ...] = ()  # as the profile numbers them
    terrain: TerrainSpec | None = None  # below a radar altimeter; None: all ground is at ground_alt


# --- estimators and evaluation ------------------------------------------------------------------


LEAST_TIMEOUT = 600.0
"""Wall time that any flight may take, if no other limit is set [s]."""


@dataclass(frozen=True, slots=True)
class Guard:
    """What a filter that is not built in may take, and whether it gets a process of its own.

    Raises
    ------
    ConfigError
        If a limit is not a number above zero.
    """

    timeout: float | None = None  # wall time of a flight [s]; None: its duration, but at least 600 s
    memory: float | None = None  # of its process [byte]; None: half of that of the machine
    output: float = 2e9  # largest solution [byte]
    in_process: bool = False  # a class runs in the process of bench, for a debugger: nothing is guarded then

    def __post_init__(self) -> None:
        for name in ("timeout", "memory", "output"):
            value = getattr(self, name)
            number = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < math.inf
            if not number and (value is not None or name == "output"):
                raise ConfigError(f"Guard: {name} = {value!r} must be a number above 0")

    def choose_timeout(self, duration: float = 0.0) -> float:
        """Return the wall time that a flight of a duration may take [s]."""
        return max(LEAST_TIMEOUT, duration) if self.timeout is None else self.timeout

    def choose_memory(self) -> float:
        """Return the memory that its process may take [byte]."""
        return 0.5 * machine_memory() if self.memory is None else self.memory


DEFAULT_GUARD = Guard()
"""A process for each filter, and limits that follow from the flight and the machine."""


@dataclass(frozen=True, slots=True)
class EstimatorChoice:
    """An estimator by name, ``module:Class``, ``file:`` or ``command:``, and its options."""

    use: str
    label: str  # unique in the profile; in names of files and columns of reports
    options: Mapping[str, Any] = field(default_factory=dict)
    beside: Path = Path()  # base of relative paths in "file:" and "command:"
    guard: Guard = DEFAULT_GUARD


@dataclass(frozen=True, slots=True)
class EvaluationWindow:
    """What of a run its figures count: the options of ``[evaluation]`` that judge.

    A further one is a field here, with its key in a file, and a key of `config.profile_tables`; the record
    goes with the profile to wherever something is judged.
    """

    begin: float = field(default=0.0, metadata={"key": "from_s"})  # end of the alignment [s]

    @property
    def first(self) -> float:
        """Instants from this one on count [s]: an instant that is the begin counts."""
        return self.begin - SAME_INSTANT

    @classmethod
    def keys(cls) -> dict[str, str]:
        """Return key in a file -> name of the field."""
        return {f.metadata["key"]: f.name for f in fields(cls)}

    @classmethod
    def of_document(cls, document: Mapping[str, Any]) -> EvaluationWindow:
        """Return that of a profile or the file of a log, as flown."""
        return cls(**{name: float(document["evaluation"][key]) for key, name in cls.keys().items()})

    def describe_outside(self, end: float, of: str) -> str | None:
        """Say that no instant until the ``end`` [s] of something counts; None if some do."""
        if self.begin < end:
            return None
        return f"[evaluation] {quantity('from_s', self.begin)} is outside the {of}, 0 to {end:.6g} s"

    def __str__(self) -> str:
        """Return it in words."""
        return f"figures from {self.begin:g} s on"


IN_FLIGHT = "in-flight"
"""Name of the answers that steered, beside the solutions of the estimators."""

CLIENT = "client"
"""Name of the navigation that a client of `bench serve` gives."""


@dataclass(frozen=True, slots=True)
class Guidance:
    """Whose estimate guidance and legs read, and how it comes to them."""

    navigation: EstimatorChoice
    period: float  # between two answers [s], a multiple of 0.05
    latency: float  # from the validity of an answer until guidance goes over to it [s], 0.05 or more
    error: Literal["held", "state"]  # as `bench.flight.belief` says
    look_back: float = 1.0  # longest time from a measurement to its arrival [s]


@dataclass(frozen=True, slots=True)
class Profile:
    """One experiment: flight, sensors, estimators and evaluation."""

    name: str
    title: str
    seed: int
    flight: Flight
    sensors: SensorsSpec
    estimators: tuple[EstimatorChoice, ...]
    evaluation: EvaluationWindow
    document: Mapping[str, Any]  # the profile as flown, defaults filled in, in the units of its file
    guidance: Guidance | None = None  # None: guidance reads the truth

    @property
    def labels(self) -> tuple[str, ...]:
        """Names of the solutions of a run: the estimators, and the answers that steered if some did."""
        steered = () if self.guidance is None else (IN_FLIGHT,)
        return (*(choice.label for choice in self.estimators), *steered)

    @property
    def answer_rate(self) -> float:
        """At this rate all solutions of a run have an answer [Hz]."""
        rate = self.sensors.output_rate
        return rate if self.guidance is None else min(rate, 1.0 / self.guidance.period)

    def describe_outside(self, end: float) -> list[str]:
        """Return in words what ends after a flight [s]: outages, faults, the alignment window."""
        outages = enumerate(self.sensors.gnss_outages, 1)
        ends = [(f"[[gnss_outage]] {k}: its end at", stop) for k, (_, stop) in outages]
        faults = enumerate(self.sensors.faults, 1)
        ends += [(f"[[fault]] {k} ({fault.kind}): its end at", fault.end) for k, fault in faults]
        found = [
            f"{self.name}: {what} {t:g} s is outside the flight, 0 to {end:g} s"
            for what, t in ends
            if t > end
        ]
        outside = self.evaluation.describe_outside(end, "flight")
        return [*found, f"{self.name}: {outside}"] if outside else found

    def __repr__(self) -> str:
        """Return name, seed, flight, sensors and estimators."""
        units = (getattr(self.sensors, f.name) for f in fields(self.sensors))
        names = dict.fromkeys(unit.name for unit in units if hasattr(unit, "name"))
        estimators = ", ".join(one.label for one in self.estimators)
        head = f"{self.name!r}, seed {self.seed}: {self.flight.label}"
        return f"<Profile {head}; sensors {', '.join(names)}; estimators {estimators}>"


if not TYPE_CHECKING:
    __getattr__ = moved_from(__name__)
