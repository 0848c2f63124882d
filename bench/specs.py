"""What a profile asks for, in SI and radians: aircraft, flight, sensors, estimators; named random streams."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from bench.fields import declared, figure, triad_figure
from bench.instruments import Units
from bench.moved import moved_from

if TYPE_CHECKING:
    from bench.signals.orbits import GlonassSets, KeplerSets

GAUSS_MARKOV_PEAK = 0.617
"""Peak of the Allan deviation of a first-order Gauss-Markov process over its standard deviation [1]."""
DEFAULT_DATE = 2026.0
"""Date of a flight that does not say it: 1 January 2026 [decimal years]."""


def stream(seed: int, run: int, name: str) -> np.random.Generator:
    """Random stream of one error term ("imu.gyro.white", "gnss.markov", "initial") in one run.

    Adding, removing or reordering one term leaves the noise of every other bit-identical.

    Examples
    --------
    >>> bool(stream(1, 0, "initial").normal() == stream(1, 0, "initial").normal())
    True
    """
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run, key)))


# --- the flight ---------------------------------------------------------------------------------------


MESH_OF_CLASS = {"uav": "uav", "light": "light-single", "transport": "jet", "fighter": "jet"}
"""Simple shape in the recording of each class of aircraft."""


@dataclass(frozen=True, slots=True)
class RunwaySpec:
    """How an aircraft is taken off and landed."""

    height: float  # of the centre of gravity above the ground at rest [m]
    rotate_speed: float  # true airspeed at which the nose is raised [m/s]
    take_off_pitch: float  # [rad]
    approach_speed: float  # true airspeed on the glide path [m/s]
    flare_height: float  # of the centre of gravity above the ground where the glide is broken off [m]
    touch_down_sink: float  # the flare aims at [m/s]


@dataclass(frozen=True, slots=True)
class ForeignSpec:
    """What an aircraft of the jsbsim wheel or of the user needs besides."""

    root: Path  # JSBSim root: holds engine/ and systems/
    properties: Mapping[str, float]  # of the model, set before the start: mixture, gear ...
    guided: bool = False  # its model has the guidance system of the bench already


@dataclass(frozen=True, slots=True)
class AircraftSpec:
    """An aircraft of the bench: its JSBSim model and what guidance and sensors need to know of it.

    aircraft.toml gives positions relative to the centre of gravity; here antenna and static port are
    relative to the IMU.
    """

    name: str
    folder: Path  # holds <name>.xml
    systems: Path  # holds guidance.xml
    gains: Mapping[str, float]  # properties of the guidance system, by their name below ``guidance/``
    min_speed: float  # slowest and fastest true airspeed guidance is tuned for [m/s]
    max_speed: float
    max_bank: float  # [rad]
    max_climb: float  # largest climb rate a leg may ask for [m/s]
    max_descent: float  # largest descent rate a leg may ask for, positive [m/s]
    antenna_b: tuple[float, float, float]  # GNSS antenna relative to the IMU [m], b
    category: str  # a key of MESH_OF_CLASS: shape in the recording, limits of the sanity report
    foreign: ForeignSpec | None = None  # how it is flown when it was not made for the bench
    imu_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # IMU relative to the centre of gravity [m], b
    static_port_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # relative to the IMU [m], b
    trims: tuple[tuple[float, float], ...] = ()  # altitude [m] and true airspeed [m/s] it is trimmed at
    runway: RunwaySpec | None = None  # None: it starts and ends in the air
    configuration: tuple[str, ...] = ()  # what a leg may set of it: "flaps", "gear"

    @property
    def guided(self) -> bool:
        """Whether its model is one for the bench: with the guidance system, and engines without a state."""
        return self.foreign is None or self.foreign.guided


@dataclass(frozen=True, slots=True)
class Runway:
    """The beginning of a runway, and the way along it; the ground all around is as high as it is."""

    lat: float  # [rad]
    lon: float  # [rad]
    alt: float  # ellipsoidal [m]
    heading: float  # [rad]


@dataclass(frozen=True, slots=True)
class LegStart:
    """What a leg begins from, as far as the profile says it."""

    aircraft: AircraftSpec
    alt: float  # ellipsoidal [m]
    runway: Runway | None
    after: str  # what the leg before it leaves


@dataclass(frozen=True)
class Leg:
    """A part of a flight; `bench.flight.legs` has each kind, a frozen dataclass with its figures in SI."""

    kind: ClassVar[str]  # its name in a profile
    needs: ClassVar[str] = "air"  # where it begins: "air", "ground", or after an "approach" or a "flare"
    leaves: ClassVar[str] = "air"  # the same of its end
    any_bank: ClassVar[bool] = False  # it may bank beyond what guidance is expected to come back from

    def describe(self) -> str:
        """Return its figures in words; the airspeed of `bench.flight.legs.keys.AtSpeed` is added."""
        return ""

    def check(self, start: LegStart) -> list[str]:
        """Return what is wrong with it, a line each, besides its keys and where it begins."""
        return []

    def alt_after(self, start: LegStart) -> float:
        """Return the ellipsoidal altitude at its end [m]."""
        return start.alt

    def fly(self, cockpit: Any) -> Iterator[None]:
        """Write set-points into a `bench.flight.cockpit.Cockpit`, one step per instant of guidance.

        A generator may return in words how it went.

        Raises
        ------
        FlightError
            When it cannot be flown.
        """
        raise NotImplementedError


@dataclass(frozen=True, slots=True)
class WindLayer:
    """The wind at one altitude; between altitudes its components go straight, beyond them they stay."""

    alt: float  # ellipsoidal [m]
    wind_from: float  # direction the wind blows from [rad]
    speed: float  # [m/s]


@dataclass(frozen=True, slots=True)
class Gust:
    """A discrete gust that rises and falls as 1 - cosine."""

    start: float  # [s]
    rise: float  # [s]
    hold: float  # [s]
    fall: float  # [s]
    air_n: tuple[float, float, float]  # velocity it adds to the air mass at its peak [m/s], n


@dataclass(frozen=True, slots=True)
class FlightSpec:
    """Everything truth depends on."""

    aircraft: AircraftSpec
    rate: float  # truth and IMU output rate [Hz]
    lat: float  # [rad]
    lon: float  # [rad]
    alt: float  # ellipsoidal [m]
    heading: float  # [rad]
    speed: float  # true airspeed [m/s]
    wind_from: float  # direction the wind blows from [rad]
    wind_speed: float  # [m/s]
    severity: int  # Milspec turbulence: probability-of-exceedance index, 0 none
    turbulence_seed: int
    legs: tuple[Leg, ...]
    duration: float | None  # the last leg is held to this instant [s]; None: to its own end
    on_ground: bool = False  # starts at rest on the runway; speed is then that of the first climb
    runway: Runway | None = None  # None: the ground is the ellipsoid
    wind_layers: tuple[WindLayer, ...] = ()  # upwards; they take the place of wind_from and wind_speed
    gusts: tuple[Gust, ...] = ()  # in order, none before the end of the other
    turbulence_model: str = "milspec"  # or "tustin", another discretization of the same spectra

    @property
    def label(self) -> str:
        """What is flown, in words."""
        return f"aircraft {self.aircraft.name}"

    @property
    def mesh(self) -> str:
        """Class of the simple shape in the recording."""
        return MESH_OF_CLASS[self.aircraft.category]


@dataclass(frozen=True, slots=True)
class ScriptSpec:
    """A JSBSim script, flown as it is."""

    name: str
    path: Path
    root: Path  # JSBSim root: holds aircraft/, engine/ and systems/
    aircraft: str  # name of the aircraft it flies
    rate: float  # truth and IMU output rate [Hz]
    duration: float | None  # the script is stopped there [s]; None: flown to its end
    turbulence_seed: int  # of JSBSim's random numbers, unless the script sets its own
    category: str  # a key of MESH_OF_CLASS: shape in the recording, limits of the sanity report

    @property
    def label(self) -> str:
        """What is flown, in words."""
        return f"script {self.name}, aircraft {self.aircraft}"

    @property
    def mesh(self) -> str:
        """Class of the simple shape in the recording."""
        return MESH_OF_CLASS[self.category]


@dataclass(frozen=True, slots=True)
class TableSpec:
    """A trajectory somebody else made, as a table."""

    name: str
    path: Path
    rate: float  # truth and IMU output rate [Hz]
    duration: float | None  # truth ends there [s]; None: with the table
    mesh: str = "uav"  # class of the simple shape in the recording

    @property
    def label(self) -> str:
        """What is flown, in words."""
        return f"trajectory {self.path.name}"


Flight = FlightSpec | ScriptSpec | TableSpec


# --- the sensors --------------------------------------------------------------------------------------


_ANGLES, _SHARES = ("mrad", "deg", "arcsec", "percent"), ("ppm", "percent")
_DRIFT, _ACCELERATION = ("deg_h", "deg_s"), ("ug", "mg")


@declared
class TriadSpec:
    """Three gyros (unit rad) or three accelerometers (unit m/s). What a unit does not have is 0."""

    # white noise of the rate: angular or velocity random walk N [unit/sqrt(s)]
    random_walk: float = triad_figure(
        ("deg_sqrt_h", "deg_s_sqrt_hz"),
        ("m_s_sqrt_h", "ug_sqrt_hz", "mg_sqrt_hz"),
        key="noise",
        sought="noise",
        default=0.0,
    )
    # minimum of the Allan deviation, white noise excluded [unit/s]
    bias_instability: float = triad_figure(_DRIFT, _ACCELERATION, sought="bias instability", default=0.0)
    bias_correlation: float = triad_figure(("s",), ("s",), default=0.0)  # [s]
    bias_model: str = "flicker"  # or "gauss-markov"
    # [unit/s]
    turn_on_bias_sd: float = triad_figure(_DRIFT, _ACCELERATION, sought="turn-on bias", default=0.0)
    # [1]
    scale_factor_sd: float = triad_figure(
        _SHARES, _SHARES, sought="scale factor", error="scale factor", default=0.0
    )
    # each off-diagonal element [rad]
    misalignment_sd: float = triad_figure(
        _ANGLES, _ANGLES, sought="misalignment", error="misalignment", default=0.0
    )
    # least bit of an increment [unit]
    quantization: float = triad_figure(("rad", "deg"), ("m_s",), error="quantization", default=0.0)
    # walk of the rate, K [unit/s/sqrt(s)]
    rate_random_walk: float = triad_figure(
        ("deg_h_sqrt_h", "deg_s_sqrt_s"), ("ug_sqrt_h",), error="rate random walk", default=0.0
    )
    # half of what the scale factors of both signs differ by [1]
    scale_asymmetry_sd: float = triad_figure(_SHARES, _SHARES, error="scale factor asymmetry", default=0.0)
    # largest departure from the best straight line, over the range [1]
    nonlinearity_sd: float = triad_figure(_SHARES, _SHARES, error="nonlinearity", default=0.0)
    # of the squared rate [1/(unit/s)]
    quadratic_sd: float = triad_figure((), ("ug_g2",), error="nonlinearity", default=0.0)
    # of the angle between two sensing axes from 90 deg [rad]
    nonorthogonality_sd: float = triad_figure(
        _ANGLES, _ANGLES, sought="misalignment", error="non-orthogonality", default=0.0
    )
    # turn of the triad in its case, each axis [rad]
    alignment_sd: float = triad_figure(
        _ANGLES, _ANGLES, sought="misalignment", error="alignment", default=0.0
    )
    # gyros: each element, per specific force [unit/s/(m/s^2)]
    g_sensitivity_sd: float = triad_figure(
        ("deg_h_g", "deg_s_g"), sought="g-sensitivity", error="g-sensitivity", default=0.0
    )
    # gyros: each element, per squared specific force [unit/s/(m/s^2)^2]
    g2_sensitivity_sd: float = triad_figure(
        ("deg_h_g2", "deg_s_g2"), sought="g-sensitivity", error="sensitivity to g squared", default=0.0
    )
    # bias per kelvin from the reference temperature [unit/s/K]
    temperature_sd: float = triad_figure(
        ("deg_h_k", "deg_s_k"), ("ug_k", "mg_k"), sought="temperature", error="temperature bias", default=0.0
    )
    # a rate below it reads 0 [unit/s]
    dead_zone: float = triad_figure(_DRIFT, _ACCELERATION, error="dead zone", default=0.0)
    dead_zone_kind: str = "subtractive"  # or "hard": a rate above it is whole
    # largest rate, 0 none; beyond it the sample is clipped and flagged [unit/s]
    range: float = triad_figure(("deg_s",), ("g",), sought="range", default=0.0)
    # -3 dB of a second-order Butterworth filter of the motion, 0 none [Hz]
    bandwidth: float = triad_figure(
        ("hz",), ("hz",), sought="bandwidth", error="bandwidth and delay", default=0.0
    )
    # of the motion, beyond that of the filter [s]
    delay: float = triad_figure(("s",), ("s",), error="bandwidth and delay", default=0.0)

    @property
    def instability_sd(self) -> float:
        """Standard deviation of the Gauss-Markov process whose Allan deviation peaks at bias_instability."""
        return self.bias_instability / GAUSS_MARKOV_PEAK


@declared
class ThermalSpec:
    """The temperature of an IMU: it follows that of the air and its own heat, from that of the air on."""

    reference: float = figure("degc", -60, 150, default=298.15)  # temperature without temperature error [K]
    self_heating: float = figure("k", default=0.0)  # final excess over the air [K]
    time_constant: float = figure("s", default=0.0)  # 0: at once [s]


@declared
class VibrationSpec:
    """Shaking at the IMU's place in the aircraft; rms of each axis. What there is not is 0."""

    # at the reference engine speed; grows with its square [rad/s]
    engine_gyro: float = figure("deg_s", default=0.0)
    engine_accel: float = figure("mg", default=0.0)  # [m/s^2]
    engine_reference: float = figure("rpm", default=0.0)  # [rad/s]
    engine_order: float = figure(default=1.0)  # periods per turn of the engine [1]
    # per m/s of gust rms, of the structural mode [rad/s/(m/s)]
    gust_gyro: float = figure("deg_s_per_mps", default=0.0)
    gust_accel: float = figure("mg_per_mps", default=0.0)  # [m/s^2/(m/s)]
    mode_frequency: float = figure("hz", default=0.0)  # of the structural mode that gusts excite, damped [Hz]
    mode_damping: float = figure("", 0, 1, default=0.0)  # ratio to critical damping [1]


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """An IMU as its datasheet describes it."""

    name: str
    gyro: TriadSpec
    accel: TriadSpec
    thermal: ThermalSpec = field(default_factory=ThermalSpec)
    vibration: VibrationSpec = field(default_factory=VibrationSpec)
    accel_cone: float = 0.0  # half-angle of a skewed accelerometer triad about x [rad]; 0: along b
    accel_arms: tuple[tuple[float, float, float], ...] = ()  # of the x, y, z accelerometer [m], b

    @property
    def feels_air(self) -> bool:
        """Whether an error follows the temperature, the gusts or the engine of the flight."""
        v = self.vibration
        shaken = max(v.engine_gyro, v.engine_accel, v.gust_gyro, v.gust_accel) > 0
        return shaken or max(self.gyro.temperature_sd, self.accel.temperature_sd) > 0


@dataclass(frozen=True, slots=True)
class SkySpec:
    """Measurement-level GNSS: which satellites fly, how they are received, what errors the ranges have.

    Standard deviations and decays of processes that are off are 0.
    """

    day: date  # of the flight
    gps_t0: float  # GPS time of the start of the run, seconds since midnight of that day [s]
    gps: KeplerSets | None  # times since that midnight; None: the nominal constellation
    glonass: KeplerSets | GlonassSets | None  # the same
    klobuchar: tuple[float, ...]  # (8,) true and broadcast ionosphere, alpha 0-3, beta 0-3
    systems: str  # that the receiver uses: "gps", "glonass", "both", "auto"
    bands: int  # 1, or 2: the ionosphere-free combination
    elevation_mask: float  # lowest elevation used [rad]
    antenna_mask: float  # lowest elevation above the plane of the antenna that is received [rad]
    cn0_zenith: float  # along the axis of the antenna, up in the body [dB-Hz]
    cn0_horizon: float  # in the plane of the antenna [dB-Hz]
    cn0_threshold: float  # of tracking [dB-Hz]
    second_band_loss: float  # [dB]
    reacquisition: float  # seen again to measured again [s]
    dll_bandwidth: float  # [Hz]
    dll_spacing: float  # early to late [chip]
    fll_bandwidth: float  # [Hz]
    integration: float  # before detection [s]
    gps_space_sd: float  # ephemeris and satellite clock, along the range [m]
    glonass_space_sd: float  # [m]
    space_correlation: float  # [s]
    ionosphere_sd: float  # vertical, against the broadcast model [m]
    ionosphere_correlation: float  # [s]
    troposphere_sd: float  # vertical, against the model [m]
    troposphere_correlation: float  # [s]
    multipath_zenith_sd: float  # [m]
    multipath_horizon_sd: float  # added at the horizon, falls by 1/e over 10 deg [m]
    multipath_correlation: float  # [s]
    clock_offset_sd: float  # of the receiver at the start [m]
    clock_drift_sd: float  # [m/s]
    glonass_offset_sd: float  # GLONASS against GPS time in the receiver [m]
    clock_h_0: float  # white frequency noise, one-sided power-law coefficient [s]
    clock_h_m1: float  # flicker of frequency [1]
    clock_h_m2: float  # random walk of frequency [1/s]
    clock_g: float  # fractional frequency per specific force along the down axis of the body [s^2/m]
    false_alarm: float  # of the residual test of one epoch [1]


@declared
class GnssSpec:
    """Position-level GNSS errors (A-5.2.1, A-5.2.2); standard deviations are per horizontal axis."""

    name: str
    rate: float = figure("hz", 0.01, 400)  # [Hz]
    pos_h_white_sd: float = figure("m", reported=True)  # [m]
    pos_v_white_sd: float = figure("m", reported=True)  # [m]
    vel_white_sd: float = figure("mps", reported=True)  # each axis [m/s]
    pos_h_markov_sd: float = figure("m", default=0.0)  # [m]
    pos_v_markov_sd: float = figure("m", default=0.0)  # [m]
    vel_markov_sd: float = figure("mps", default=0.0)  # each axis [m/s]
    # decorrelation by distance flown, lambda_s [1/m]
    pos_decay_distance: float = figure("km", default=0.0, reciprocal=True)
    # decorrelation by time, lambda_st [1/s]
    pos_decay_time: float = figure("s", default=0.0, reciprocal=True)
    vel_decay_time: float = figure("s", default=0.0, reciprocal=True)  # lambda_V [1/s]
    latency: float = figure("s", default=0.0)  # from validity to arrival [s]
    # where the satellites in use change, at that epoch only [m]
    pos_h_jump_sd: float = figure("m", default=0.0)
    pos_v_jump_sd: float = figure("m", default=0.0)  # [m]
    vel_jump_sd: float = figure("mps", default=0.0)  # each axis [m/s]
    # the same, and it decays as the Markov error does [m]
    pos_h_jump_markov_sd: float = figure("m", default=0.0)
    pos_v_jump_markov_sd: float = figure("m", default=0.0)  # [m]
    vel_jump_markov_sd: float = figure("mps", default=0.0)  # each axis [m/s]
    optimism: float = figure("", 0.05, 20, default=1.0)  # true over reported standard deviation of a fix [1]
    sky: SkySpec | None = None  # measurement level; the errors above are then what filters assume

    @property
    def jumps(self) -> bool:
        """Whether its error jumps where the satellites in use change."""
        passing = (self.pos_h_jump_sd, self.pos_v_jump_sd, self.vel_jump_sd)
        return any((*passing, self.pos_h_jump_markov_sd, self.pos_v_jump_markov_sd, self.vel_jump_markov_sd))


@dataclass(frozen=True, slots=True)
class Fault:
    """What is scripted to go wrong in [start, end); what its kind has no use for keeps its default."""

    kind: str  # as in the profile
    sensor: str  # "gnss", "imu", "gyro", "accel" or the name of an instrument
    start: float  # [s]
    end: float  # [s]
    text: str  # in words, as in the profile
    satellites: tuple[tuple[int, int], ...] = ()  # system and number
    step: tuple[float, ...] = ()  # from the start on, in SI: n, b or a single value
    ramp: tuple[float, ...] = ()  # growth of the step, per s
    loss: float = 0.0  # of C/N0 [dB]
    delay: float = 0.0  # [s]
    times: float = 0.0  # noise over the white noise of the unit [1]
    share: float = 1.0  # of the samples that are struck [1]
    axes: tuple[int, ...] = (0, 1, 2)  # of a triad
    coherent: bool = True  # the velocity follows the ramp


@dataclass(frozen=True, slots=True)
class AssumedSpecs(Units):
    """The datasheets an estimator is told to believe."""

    imu: ImuSpec
    gnss: GnssSpec | None


@dataclass(frozen=True, slots=True)
class SensorsSpec(Units):
    """The units on board, what the filters assume of them, and what is scripted to happen."""

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
    alignment: str = "given"  # what the estimators are told of the start: "given", "level" or "course"
    align_for: float = 60.0  # level: longest standstill to use, course: length of the stretch [s]
    drift_sd: float = 0.0  # course: of the angle from course to nose [rad]
    qnh: float = 101325.0  # altimeter setting of a physical barometer [Pa]
    static_port_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the centre of gravity [m], b
    ground_alt: float = 0.0  # ellipsoidal height of the runway, as a chart has it [m]
    rest_height: float = math.inf  # of the IMU above the ground at rest [m]; inf: it never leaves the ground
    faults: tuple[Fault, ...] = ()  # as the profile numbers them


# --- the estimators and the judgement ------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class EstimatorChoice:
    """An estimator by its name, ``module:Class``, ``file:`` or ``command:``, and the keywords it takes."""

    use: str
    label: str  # unique in the profile; names files and report columns
    options: Mapping[str, Any] = field(default_factory=dict)
    beside: Path = Path()  # where the relative paths of "file:" and "command:" begin


@dataclass(frozen=True, slots=True)
class Profile:
    """One experiment: a flight, its sensors, the estimators and the judgement."""

    name: str
    title: str
    seed: int
    flight: Flight
    sensors: SensorsSpec
    estimators: tuple[EstimatorChoice, ...]
    evaluation_from: float  # end of the alignment window [s]
    document: Mapping[str, Any]  # the profile as flown, defaults filled in, in the units of its file


if not TYPE_CHECKING:
    __getattr__ = moved_from(__name__)
