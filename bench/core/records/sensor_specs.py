"""Specs of the sensors in SI and radians: figures of datasheets, faults, and what filters assume."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from bench.core.mathematics.arrays import FloatArray
from bench.core.records.fields import declared, figure, triad_figure
from bench.core.records.flight_specs import TerrainSpec
from bench.core.records.instruments import InstrumentSpecs
from bench.core.records.sky_spec import SkySpec

GAUSS_MARKOV_PEAK = 0.617
"""Peak of the Allan deviation of a first-order Gauss-Markov process over its standard deviation [1]."""
DEFAULT_DATE = 2026.0
"""Date of a flight without one in its profile: 1 January 2026 [decimal years]."""


_ANGLES, _SHARES = ("mrad", "deg", "arcsec", "percent"), ("ppm", "percent")
_NOISE = ("deg_sqrt_h", "deg_s_sqrt_hz"), ("m_s_sqrt_h", "ug_sqrt_hz", "mg_sqrt_hz")
_DRIFT, _ACCELERATION = ("deg_h", "deg_s"), ("ug", "mg")


@dataclass(frozen=True, slots=True)
class AxisFigures:
    """Values of a triad by axis, if the axes differ, in the unit of the file."""

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
    """White noise: angular or velocity random walk N [unit/sqrt(s)]."""
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
    resolution: float = triad_figure(("deg_s",), ("ug", "mg"), error="rounding of the rates", default=0.0)
    """Resolution: each sample is rounded, and the remainder is lost [unit/s]."""
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
    temperature2_sd: float = triad_figure(
        ("deg_h_k2", "deg_s_k2"), ("ug_k2",), error="temperature bias of second order", default=0.0,
        by_axis=True,
    )  # fmt: skip
    """Bias per squared difference from the reference temperature [unit/s/K^2]."""
    hysteresis_sd: float = triad_figure(
        _DRIFT, _ACCELERATION, error="temperature hysteresis", default=0.0, by_axis=True
    )
    """Bias after long warming; after long cooling it has the opposite sign [unit/s]."""
    transient_sd: float = triad_figure(
        _DRIFT, _ACCELERATION, error="turn-on transient", default=0.0, by_axis=True
    )
    """Additional bias when the unit is switched on, which decays [unit/s]."""
    transient_time: float = triad_figure(("s",), ("s",), default=0.0)
    """Time constant of this decay [s]."""
    dead_zone: float = triad_figure(_DRIFT, _ACCELERATION, error="dead zone", default=0.0)
    """Dead zone: what is below it reads 0 [unit/s]."""
    dead_zone_kind: str = "subtractive"
    """Output above the dead zone: reduced by it ("subtractive") or unchanged ("hard")."""
    range: float = triad_figure(("deg_s",), ("g",), sought="range", default=0.0)
    """Range: samples beyond it are clipped and flagged [unit/s]; 0: no limit."""
    bandwidth: float = triad_figure(
        ("hz",), ("hz",), sought="bandwidth", error="bandwidth and delay", default=0.0
    )
    """-3 dB frequency of a second-order Butterworth filter of the motion [Hz]; 0: no filter."""
    delay: float = triad_figure(("s",), ("s",), error="bandwidth and delay", default=0.0)
    """Delay of the motion, in addition to the delay of the filter [s]."""
    noise_shape: str = "white"
    """White noise: not filtered ("white"), or through the filter of the bandwidth, as mean of each sample
    ("averaged") or value at its end ("sampled")."""
    axes: tuple[AxisFigures, ...] = ()  # figures whose axes differ

    @property
    def has_slow_terms(self) -> bool:
        """Return whether the bias has parts that are linear between epochs 0.05 s apart."""
        slow = (self.rate_random_walk, self.temperature_sd, self.temperature2_sd, self.hysteresis_sd)
        return max(*slow, self.transient_sd) > 0

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
    """Temperature of an IMU: rises from air temperature by the self-heating, with a time constant."""

    reference: float = figure("degc", -60, 150, default=298.15)
    """Temperature at which the temperature errors are zero [K]."""
    self_heating: float = figure("k", default=0.0)
    """Final temperature of the sensor above the air [K]."""
    time_constant: float = figure("s", default=0.0)
    """Time constant of the warming [s]; 0: immediate."""
    hysteresis: float = figure("k", 0.01, 200, default=10.0)
    """Change of temperature after which 63 % of the hysteresis has reversed [K]."""


@declared
class SampleClockSpec:
    """Clock of an IMU: its time tags are later than the samples. 0 switches an error off."""

    drift: float = figure("ppm", 0, 1000, default=0.0)
    """Drift of the time tags: their delay against the samples grows at this rate [1]."""
    jitter: float = figure("us", 0, 1e5, default=0.0)
    """Largest random delay of a time tag, uniform from 0 [s]."""


@declared
class VibrationSpec:
    """Vibration at the IMU, rms of each axis. 0 switches a source off."""

    engine_gyro: float = figure("deg_s", default=0.0)
    """Vibration of the gyros by the engine at its reference speed, rms; grows as its square [rad/s]."""
    engine_accel: float = figure("mg", default=0.0)
    """Vibration of the accelerometers by the engine at its reference speed, rms; grows as its square
    [m/s^2]."""
    engine_reference: float = figure("rpm", default=0.0)
    """Reference speed of the engine [rad/s]."""
    engine_order: float = figure(default=1.0)
    """Periods per revolution of the engine [1]."""
    gust_gyro: float = figure("deg_s_per_mps", default=0.0)
    """Vibration of the gyros by a structural mode that gusts excite, per rms of the gusts [rad/s/(m/s)]."""
    gust_accel: float = figure("mg_per_mps", default=0.0)
    """Vibration of the accelerometers by this mode, per rms of the gusts [m/s^2/(m/s)]."""
    mode_frequency: float = figure("hz", default=0.0)
    """Frequency of the structural mode [Hz]."""
    mode_damping: float = figure("", 0, 1, default=0.0)
    """Damping of the structural mode, over critical damping [1]."""
    rotor_accel_1: float = figure("mg", default=0.0)
    """Unbalance of each rotor of a multirotor, rms along x and y at the reference speed [m/s^2]."""
    rotor_accel_2: float = figure("mg", default=0.0)
    """Blades passing, twice per revolution of each rotor, rms along z at the reference speed [m/s^2]."""
    rotor_accel_4: float = figure("mg", default=0.0)
    """Blades passing, four times per revolution of each rotor, rms along z at the reference speed [m/s^2]."""
    rotor_reference: float = figure("rpm", default=0.0)
    """Reference speed of the rotors; the vibration grows with the square of the speed [rad/s]."""
    rotor_forward: float = figure("m", 0, 100, default=0.0)
    """Distance of the rotors ahead of and behind the center of gravity [m]; 0: from the aircraft."""
    rotor_right: float = figure("m", 0, 100, default=0.0)
    """Distance of the rotors to the right and left of the center of gravity [m]; 0: from the aircraft."""
    rotor_up: float = figure("m", -100, 100, default=0.0)
    """Height of the rotors above the center of gravity [m]."""
    gyration_x: float = figure("m", 0, 100, default=0.0)
    """Radius of gyration about x, the square root of inertia over mass [m]; 0: from the aircraft."""
    gyration_y: float = figure("m", 0, 100, default=0.0)
    """Radius of gyration about y [m]; 0: from the aircraft."""
    gyration_z: float = figure("m", 0, 100, default=0.0)
    """Radius of gyration about z [m]; 0: from the aircraft."""
    imu_forward: float = figure("m", -100, 100, default=0.0)
    """Position of the IMU ahead of the center of gravity, for the vibration by rotors [m]."""
    imu_right: float = figure("m", -100, 100, default=0.0)
    """Position of the IMU to the right of the center of gravity, for this vibration [m]."""
    imu_down: float = figure("m", -100, 100, default=0.0)
    """Position of the IMU below the center of gravity, for this vibration [m]."""
    inner_rate: float = figure("hz", 0, 64000, default=0.0)
    """Rate at which the IMU samples vibration and sums it up [Hz]; 0: the output rate."""

    @property
    def by_engine(self) -> bool:
        """Return whether the engine or gusts shake the IMU."""
        return max(self.engine_gyro, self.engine_accel, self.gust_gyro, self.gust_accel) > 0

    @property
    def by_rotors(self) -> bool:
        """Return whether rotors shake the IMU."""
        return max(self.rotor_accel_1, self.rotor_accel_2, self.rotor_accel_4) > 0


@dataclass(frozen=True, slots=True)
class ImuSpec:
    """An IMU by its datasheet."""

    name: str
    gyro: TriadSpec
    accel: TriadSpec
    thermal: ThermalSpec = field(default_factory=ThermalSpec)
    vibration: VibrationSpec = field(default_factory=VibrationSpec)
    clock: SampleClockSpec = field(default_factory=SampleClockSpec)
    accel_cone: float = 0.0  # half-angle of a skewed accelerometer triad about x [rad]; 0: axes along b
    accel_arms: tuple[tuple[float, float, float], ...] = ()  # positions of the x, y, z accelerometer [m], b

    @property
    def warms(self) -> bool:
        """Return whether an error depends on the temperature."""
        names = ("temperature_sd", "temperature2_sd", "hysteresis_sd")
        return any(getattr(triad, name) > 0 for triad in (self.gyro, self.accel) for name in names)

    @property
    def feels_air(self) -> bool:
        """Return whether an error depends on gusts or engine speed of the flight."""
        return self.vibration.by_engine


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
    latency_jitter: float = figure("s", 0, 10, default=0.0)
    """Largest addition to the latency, uniform from 0 for each fix; no fix overtakes the one before [s]."""
    time_tag_error: float = figure("s", -10, 10, default=0.0)
    """Time tag of a fix minus its true time; a fix with a late tag arrives at its tag [s]."""
    pos_h_smooth_sd: float = figure("m", default=0.0)
    """Error of carrier-smoothed code, Gauss-Markov, each horizontal axis [m]."""
    pos_v_smooth_sd: float = figure("m", default=0.0)
    """Error of carrier-smoothed code in the height [m]."""
    smooth_time: float = figure("s", default=0.0)
    """Correlation time of this error [s]."""
    pos_h_jump_sd: float = figure("m", default=0.0)
    """Jump of the position when the satellites in use change, each horizontal axis [m]."""
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
        """Return whether the error jumps where the satellites in use change."""
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
    """The datasheets that a filter assumes."""

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
    alignment: str = "given"  # initial values given to the filters: "given", "level", "hover" or "course"
    align_for: float = 60.0  # level: longest standstill to use, else: length of the alignment [s]
    drift_sd: float = 0.0  # course: of the angle from course to nose [rad]
    qnh: float = 101325.0  # altimeter setting of a physical barometer [Pa]
    static_port_b: tuple[float, float, float] = (0.0, 0.0, 0.0)  # from the center of gravity [m], b
    ground_alt: float = 0.0  # ellipsoidal height of the runway, as a chart has it [m]
    rest_height: float = math.inf  # of the IMU above the ground at rest [m]; inf: a ground vehicle
    faults: tuple[Fault, ...] = ()  # as the profile numbers them
    terrain: TerrainSpec | None = None  # below a radar altimeter; None: all ground is at ground_alt
