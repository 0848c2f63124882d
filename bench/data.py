"""The records that flow through the bench: frozen, read-only columns, one row per instant.

Frames: n is the local level at the current position (north, east, down), b the
body and IMU axes (forward, right, down), e Earth-fixed, i inertial. Units are SI
and radians. The truth side is strict at birth (finite, increasing times); sensor
records and solutions are checked for shape and type only, because NaN, repeated
times and time going back are data there; the instants asked for increase.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from bench.arrays import BoolArray, FloatArray, IntArray, Shape, as_float, as_kind
from bench.specs import DEFAULT_DATE, AssumedSpecs


def _freeze(record: object, *, finite: bool = False, **shapes: Shape) -> None:
    """Replace each named field by a checked, read-only float64 view; equal first lengths."""
    for name, shape in shapes.items():
        _store(record, name, as_float(_label(record, name), getattr(record, name), shape, finite=finite))
    _equal_lengths(record, shapes)


def _freeze_kind(record: object, dtype: type, **shapes: Shape) -> None:
    for name, shape in shapes.items():
        _store(record, name, as_kind(_label(record, name), getattr(record, name), dtype, shape))


def _store(record: object, name: str, column: np.ndarray[Any, Any]) -> None:
    view = column.view()
    view.flags.writeable = False
    object.__setattr__(record, name, view)


def _label(record: object, name: str) -> str:
    return f"{type(record).__name__}.{name}"


def _equal_lengths(record: object, names: Mapping[str, object]) -> None:
    lengths = {name: len(getattr(record, name)) for name in names}
    if len(set(lengths.values())) > 1:
        raise ValueError(f"{type(record).__name__}: columns differ in length: {lengths}")


def _increasing(name: str, t: FloatArray) -> None:
    if not (np.diff(t) > 0).all():
        k = int(np.argmax(np.diff(t) <= 0))
        raise ValueError(f"{name} must increase; row {k + 1} has {t[k + 1]:g} s after {t[k]:g} s")


def _rebuild(record: Any) -> tuple[type, tuple[Any, ...]]:
    """Pickle a record by its columns, so that a copy is checked and read-only too."""
    return type(record), tuple(getattr(record, f.name) for f in fields(record))


@dataclass(frozen=True, slots=True)
class Events:
    """What happened when: legs, outages, faults, sensor rows left out. An instant has t_end = t."""

    t: FloatArray  # (N,) start [s]
    t_end: FloatArray  # (N,) end [s]
    kind: tuple[str, ...]  # "leg", "gnss_outage", "wind", "timeline", ...
    text: tuple[str, ...]

    def __post_init__(self) -> None:
        _freeze(self, t=(None,), t_end=(None,))
        _equal_lengths(self, dict.fromkeys(("t", "t_end", "kind", "text")))

    def __len__(self) -> int:
        return len(self.t)

    def of(self, kind: str) -> list[tuple[float, float, str]]:
        """Return (t, t_end, text) of every event of one kind."""
        return [
            (float(a), float(b), text)
            for a, b, k, text in zip(self.t, self.t_end, self.kind, self.text, strict=True)
            if k == kind
        ]

    @classmethod
    def from_rows(cls, rows: list[tuple[float, float, str, str]]) -> Events:
        """Build from (t, t_end, kind, text) rows, sorted by t."""
        rows = sorted(rows, key=lambda row: (row[0], row[1]))
        return cls(
            np.array([row[0] for row in rows]),
            np.array([row[1] for row in rows]),
            tuple(row[2] for row in rows),
            tuple(row[3] for row in rows),
        )

    __reduce__ = _rebuild


def no_events() -> Events:
    """Return an empty list of events."""
    return Events(np.empty(0), np.empty(0), (), ())


@dataclass(frozen=True, slots=True)
class AirData:
    """The air around the aircraft, at 20 Hz on its own times."""

    t: FloatArray  # (A,) [s]
    pressure: FloatArray  # (A,) static [Pa]
    temperature: FloatArray  # (A,) static [K]
    airspeed_true: FloatArray  # (A,) [m/s]
    airspeed_calibrated: FloatArray  # (A,) [m/s]
    alpha: FloatArray  # (A,) angle of attack [rad]
    beta: FloatArray  # (A,) sideslip [rad]
    wind_n: FloatArray  # (A, 3) velocity of the air mass incl. turbulence [m/s], n
    engine_speed: FloatArray  # (A,) [rad/s]

    def __post_init__(self) -> None:
        n = dict.fromkeys([f.name for f in fields(self)], (None,))
        _freeze(self, finite=True, **{**n, "wind_n": (None, 3)})
        _increasing("AirData.t", self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class Controls:
    """Controls as flown, at 20 Hz; surfaces -1 to 1, JSBSim senses (right roll, nose down, nose left)."""

    t: FloatArray  # (A,) [s]
    aileron: FloatArray  # (A,)
    elevator: FloatArray  # (A,)
    rudder: FloatArray  # (A,)
    throttle: FloatArray  # (A,) 0 to 1

    def __post_init__(self) -> None:
        _freeze(self, finite=True, **dict.fromkeys([f.name for f in fields(self)], (None,)))
        _increasing("Controls.t", self.t)

    __reduce__ = _rebuild


def no_air() -> AirData:
    """Return air data without rows: nothing is known of the air."""
    n = np.empty(0)
    return AirData(n, n, n, n, n, n, n, np.empty((0, 3)), n)


def no_controls() -> Controls:
    """Return controls without rows: nothing is known of them."""
    n = np.empty(0)
    return Controls(n, n, n, n, n)


@dataclass(frozen=True, slots=True)
class Trajectory:
    """The truth: motion of the IMU, with the exact increments an error-free IMU would give."""

    t: FloatArray  # (N,) since the start of the run [s]
    lla: FloatArray  # (N, 3) geodetic latitude, longitude [rad], ellipsoidal height [m]
    vel_n: FloatArray  # (N, 3) Earth-relative velocity [m/s], n
    q_nb: FloatArray  # (N, 4) b to n, scalar first, sign-continuous
    dtheta_b: FloatArray  # (N-1, 3) integral of w_ib_b over (t[k], t[k+1]] [rad], b
    dvel_b: FloatArray  # (N-1, 3) integral of f_b over (t[k], t[k+1]] [m/s], b
    air: AirData
    controls: Controls
    events: Events

    def __post_init__(self) -> None:
        _freeze(self, finite=True, t=(None,), lla=(None, 3), vel_n=(None, 3), q_nb=(None, 4))
        n = len(self.t) - 1
        _freeze(self, finite=True, dtheta_b=(n, 3), dvel_b=(n, 3))
        _increasing("Trajectory.t", self.t)

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class ImuData:
    """Measured increments; row k covers the interval (t[k] - dt[k], t[k]]."""

    t: FloatArray  # (N,) end of the interval [s]
    dt: FloatArray  # (N,) length of the interval [s]
    valid: BoolArray  # (N,) what the unit itself flags
    dtheta_b: FloatArray  # (N, 3) [rad], b
    dvel_b: FloatArray  # (N, 3) [m/s], b

    def __post_init__(self) -> None:
        _freeze_kind(self, np.bool_, valid=(None,))
        _freeze(self, t=(None,), dt=(None,), dtheta_b=(None, 3), dvel_b=(None, 3))
        _equal_lengths(self, dict.fromkeys(("t", "valid")))

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class GnssFixes:
    """Position and velocity of the GNSS antenna as the receiver reports them."""

    t: FloatArray  # (M,) validity [s]
    t_arrival: FloatArray  # (M,) when the fix reaches the filter [s]
    valid: BoolArray  # (M,)
    lla: FloatArray  # (M, 3) [rad, rad, m]
    vel_n: FloatArray  # (M, 3) [m/s], n; NaN where it reports none
    cov_pos_n: FloatArray  # (M, 3, 3) reported [m^2], n
    cov_vel_n: FloatArray  # (M, 3, 3) reported [m^2/s^2], n
    satellites: IntArray  # (M,) number used

    def __post_init__(self) -> None:
        _freeze_kind(self, np.bool_, valid=(None,))
        _freeze_kind(self, np.int64, satellites=(None,))
        _freeze(self, t=(None,), t_arrival=(None,), lla=(None, 3), vel_n=(None, 3))
        _freeze(self, cov_pos_n=(None, 3, 3), cov_vel_n=(None, 3, 3))
        _equal_lengths(self, dict.fromkeys(("t", "valid", "cov_pos_n", "satellites")))

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


GPS, GLONASS = 0, 1
"""Codes of ``GnssObservations.system``."""


@dataclass(frozen=True, slots=True)
class GnssObservations:
    """What a receiver measures and computes of each satellite, a row per satellite and epoch."""

    t: FloatArray  # (K,) validity of the epoch [s]
    t_arrival: FloatArray  # (K,) [s]
    sat: IntArray  # (K,) number within its system
    system: IntArray  # (K,) GPS or GLONASS
    frequency: FloatArray  # (K, bands) carrier [Hz]
    pseudorange: FloatArray  # (K, bands) [m]; NaN where a band is missing
    range_rate: FloatArray  # (K, bands) [m/s]
    cn0: FloatArray  # (K, bands) [dB-Hz]
    sat_pos_e: FloatArray  # (K, 3) at transmission, by the broadcast ephemeris [m], e at transmission
    sat_vel_e: FloatArray  # (K, 3) [m/s], e at transmission
    sat_clock: FloatArray  # (K,) with relativity; to be added to a pseudorange [m]
    sat_clock_rate: FloatArray  # (K,) to be added to a range rate [m/s]
    group_delay: FloatArray  # (K,) of the first band, to be taken off its pseudorange [m]
    sd_pseudorange: FloatArray  # (K,) claimed, of the corrected pseudorange [m]
    sd_range_rate: FloatArray  # (K,) claimed [m/s]
    epoch_start: IntArray  # (M + 1,) first row of each epoch, then K
    klobuchar: FloatArray  # (8,) broadcast alpha 0-3, beta 0-3
    gps_t0: float  # GPS time of t = 0, seconds since a GPS midnight [s]

    def __post_init__(self) -> None:
        _freeze_kind(self, np.int64, sat=(None,), system=(None,), epoch_start=(None,))
        bands = np.shape(self.pseudorange)[-1]
        rows = ("t", "t_arrival", "sat_clock", "sat_clock_rate", "group_delay")
        wide = ("frequency", "pseudorange", "range_rate", "cn0")
        shapes: dict[str, Any] = {**dict.fromkeys(rows, (None,)), **dict.fromkeys(wide, (None, bands))}
        _freeze(self, **shapes, sat_pos_e=(None, 3), sat_vel_e=(None, 3))
        _freeze(self, sd_pseudorange=(None,), sd_range_rate=(None,))
        _freeze(self, klobuchar=(8,))
        _equal_lengths(self, dict.fromkeys(("t", "sat", "system", "sd_pseudorange")))

    def __len__(self) -> int:
        return len(self.t)

    @property
    def epoch(self) -> IntArray:
        """Epoch (K,) of each row."""
        count: IntArray = np.repeat(np.arange(len(self.epoch_start) - 1), np.diff(self.epoch_start))
        return count

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class BaroData:
    """Barometric altitude as the instrument reports it."""

    t: FloatArray  # (M,) validity [s]
    t_arrival: FloatArray  # (M,) [s]
    valid: BoolArray  # (M,)
    alt_baro: FloatArray  # (M,) [m]
    sd: FloatArray  # (M,) white noise the instrument claims [m]

    def __post_init__(self) -> None:
        _freeze_kind(self, np.bool_, valid=(None,))
        _freeze(self, t=(None,), t_arrival=(None,), alt_baro=(None,), sd=(None,))
        _equal_lengths(self, dict.fromkeys(("t", "valid")))

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class MagData:
    """The magnetic field as a strapped-down magnetometer reports it."""

    t: FloatArray  # (M,) validity [s]
    t_arrival: FloatArray  # (M,) [s]
    valid: BoolArray  # (M,)
    field_b: FloatArray  # (M, 3) [T], b
    sd: FloatArray  # (M,) white noise per axis the instrument claims [T]

    def __post_init__(self) -> None:
        _freeze_kind(self, np.bool_, valid=(None,))
        _freeze(self, t=(None,), t_arrival=(None,), field_b=(None, 3), sd=(None,))
        _equal_lengths(self, dict.fromkeys(("t", "valid")))

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class AirspeedData:
    """True airspeed as the air data computer reports it."""

    t: FloatArray  # (M,) validity [s]
    t_arrival: FloatArray  # (M,) [s]
    valid: BoolArray  # (M,)
    airspeed_true: FloatArray  # (M,) [m/s]
    sd: FloatArray  # (M,) white noise the instrument claims [m/s]

    def __post_init__(self) -> None:
        _freeze_kind(self, np.bool_, valid=(None,))
        _freeze(self, t=(None,), t_arrival=(None,), airspeed_true=(None,), sd=(None,))
        _equal_lengths(self, dict.fromkeys(("t", "valid")))

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class SensorData:
    """Everything an estimator may know: measurements, and the specs it is told to assume."""

    imu: ImuData
    fixes: GnssFixes | None
    baro: BaroData | None
    antenna_b: FloatArray  # (3,) GNSS antenna relative to the IMU [m], b
    specs: AssumedSpecs
    output_t: FloatArray  # (M,) instants at which the solution is wanted, each after the one before [s]
    observations: GnssObservations | None = None
    mag: MagData | None = None
    airspeed: AirspeedData | None = None
    date: float = DEFAULT_DATE  # of the flight [decimal years]; the magnetic field depends on it

    def __post_init__(self) -> None:
        _freeze(self, finite=True, antenna_b=(3,))
        _freeze(self, finite=True, output_t=(None,))
        _increasing("SensorData.output_t", self.output_t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class InitialState:
    """Where the estimator is told to start, and how well that is known.

    What it is not told is NaN with infinite variance; `bench.navigation.alignment.complete` finds it.
    """

    t: float  # [s]
    lla: FloatArray  # (3,) [rad, rad, m]
    vel_n: FloatArray  # (3,) [m/s], n
    q_nb: FloatArray  # (4,)
    cov: FloatArray  # (9, 9) of (pos_n m, vel_n m/s, phi_n rad) errors
    alignment: str  # what is told: "given" all, "level" the position of a standstill, "course" nothing
    align_for: float = 60.0  # level: longest standstill to use, course: length of the stretch [s]
    drift_sd: float = 0.0  # course: of the angle from course to nose, wind and sideslip [rad]
    bias_cov: FloatArray = field(default_factory=lambda: np.zeros((9, 6)))
    """(9, 6) of those errors with the errors of gyro [rad/s] and accelerometer [m/s^2] bias, b."""

    def __post_init__(self) -> None:
        shapes = {"lla": (3,), "vel_n": (3,), "q_nb": (4,), "cov": (9, 9), "bias_cov": (9, 6)}
        for name, shape in shapes.items():
            told = self.alignment == "given"
            _store(self, name, as_float(_label(self, name), getattr(self, name), shape, finite=told))

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class SensorTruth:
    """What the sensor models drew, on their own times: for the recording and the report, never a filter."""

    t: FloatArray  # (B,) [s]
    gyro_bias_b: FloatArray  # (B, 3) [rad/s], b
    accel_bias_b: FloatArray  # (B, 3) [m/s^2], b
    baro_bias: FloatArray  # (B,) [m]
    mag_bias_b: FloatArray | None = None  # (B, 3) hard iron [T], b; None becomes NaN
    airspeed_bias: FloatArray | None = None  # (B,) [m/s]; None becomes NaN

    def __post_init__(self) -> None:
        if self.mag_bias_b is None:
            object.__setattr__(self, "mag_bias_b", np.full((len(self.t), 3), np.nan))
        if self.airspeed_bias is None:
            object.__setattr__(self, "airspeed_bias", np.full(len(self.t), np.nan))
        _freeze(self, t=(None,), gyro_bias_b=(None, 3), accel_bias_b=(None, 3), baro_bias=(None,))
        _freeze(self, t=(None,), mag_bias_b=(None, 3), airspeed_bias=(None,))

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class SkyView:
    """Every satellite above the elevation mask of a measurement-level receiver, a row per epoch.

    Received or not. For the recording and the report, never a filter.
    """

    t: FloatArray  # (K,) [s]
    system: IntArray  # (K,) GPS or GLONASS
    sat: IntArray  # (K,) number within its system
    azimuth: FloatArray  # (K,) [rad]
    elevation: FloatArray  # (K,) [rad]
    cn0: FloatArray  # (K,) on the first carrier [dB-Hz]; NaN: not received
    used: BoolArray  # (K,) in the fix of the epoch

    def __post_init__(self) -> None:
        _freeze_kind(self, np.int64, system=(None,), sat=(None,))
        _freeze_kind(self, np.bool_, used=(None,))
        _freeze(self, t=(None,), azimuth=(None,), elevation=(None,), cn0=(None,))
        _equal_lengths(self, dict.fromkeys(("t", "system", "sat", "used")))

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class Innovations:
    """Measurement minus prediction, a row per scalar component."""

    t: FloatArray  # (K,) [s]
    sensor: tuple[str, ...]  # names, asked by ``code``
    code: IntArray  # (K,) index into sensor: "gnss_position", "gnss_velocity", "baro"
    component: IntArray  # (K,) 0, 1, 2 along n
    z: FloatArray  # (K,) [unit of the sensor]
    S: FloatArray  # (K,) predicted variance of z
    nis: FloatArray  # (K,) of the whole sub-vector, repeated on its rows
    accepted: BoolArray  # (K,)

    def __post_init__(self) -> None:
        _freeze_kind(self, np.int64, code=(None,), component=(None,))
        _freeze_kind(self, np.bool_, accepted=(None,))
        _freeze(self, t=(None,), z=(None,), S=(None,), nis=(None,))
        _equal_lengths(self, dict.fromkeys(("t", "code", "component", "accepted")))

    @classmethod
    def from_rows(
        cls, sensor: tuple[str, ...], rows: list[tuple[float, int, int, float, float, float, bool]]
    ) -> Innovations:
        """Return a table from rows (t, code, component, z, S, nis, accepted)."""
        table = np.array(rows, float).reshape(-1, 7)
        return cls(
            t=table[:, 0],
            sensor=sensor,
            code=table[:, 1].astype(np.int64),
            component=table[:, 2].astype(np.int64),
            z=table[:, 3],
            S=table[:, 4],
            nis=table[:, 5],
            accepted=table[:, 6].astype(np.bool_),
        )

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


def no_innovations() -> Innovations:
    """Return an empty table, for an estimator without updates."""
    return Innovations.from_rows((), [])


@dataclass(frozen=True, slots=True)
class NavSolution:
    """An estimator's answer at ``SensorData.output_t``, after any update at that instant.

    A block that is not estimated has NaN in its values and covariance rows.
    """

    t: FloatArray  # (M,) [s]
    lla: FloatArray  # (M, 3) of the IMU [rad, rad, m]
    vel_n: FloatArray  # (M, 3) [m/s], n
    q_nb: FloatArray  # (M, 4)
    gyro_bias_b: FloatArray  # (M, 3) [rad/s], b
    accel_bias_b: FloatArray  # (M, 3) [m/s^2], b
    cov: FloatArray  # (M, 9, 9) of (pos_n m, vel_n m/s, phi_n rad) errors
    extra_names: tuple[str, ...]  # names of the columns of extra_*, unit in the name
    extra: FloatArray  # (M, n) values of the states beyond position, velocity, attitude
    extra_sd: FloatArray  # (M, n) their standard deviations
    innovations: Innovations = field(default_factory=no_innovations)
    events: Events = field(default_factory=no_events)

    def __post_init__(self) -> None:
        n = len(self.extra_names)
        _freeze(
            self,
            t=(None,),
            lla=(None, 3),
            vel_n=(None, 3),
            q_nb=(None, 4),
            gyro_bias_b=(None, 3),
            accel_bias_b=(None, 3),
            cov=(None, 9, 9),
            extra=(None, n),
            extra_sd=(None, n),
        )

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class ErrorSeries:
    """Estimate minus truth at the solution's times."""

    t: FloatArray  # (M,) [s]
    pos_n: FloatArray  # (M, 3) [m], n
    vel_n: FloatArray  # (M, 3) [m/s], n
    phi_n: FloatArray  # (M, 3) [rad], n: C_nb_est = exp([phi_n x]) C_nb_true
    heading: FloatArray  # (M,) heading error, wrapped to +-pi [rad]
    nees: FloatArray  # (M,) of the estimated blocks; NaN where the covariance is not positive definite
    states: int  # number of states that nees counts

    def __post_init__(self) -> None:
        _freeze(
            self, t=(None,), pos_n=(None, 3), vel_n=(None, 3), phi_n=(None, 3), heading=(None,), nees=(None,)
        )

    def __len__(self) -> int:
        return len(self.t)

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class Sensed:
    """One draw of the sensors: what the estimators get, and what they must not see."""

    data: SensorData
    initial: InitialState
    truth: SensorTruth
    events: Events  # outages and faults of this run
    sky: SkyView | None = None  # of a measurement-level receiver

    __reduce__ = _rebuild


@dataclass(frozen=True, slots=True)
class RunResult:
    """One run of one profile: metrics per estimator, with everything needed to repeat it."""

    profile: Mapping[str, Any]  # the profile as flown, in the units of its file
    seed: int
    run: int
    metrics: Mapping[str, Mapping[str, Any]]  # estimator -> metric -> number, null or list
    errors: Mapping[str, ErrorSeries]
    solutions: Mapping[str, NavSolution]
    provenance: Mapping[str, Any]  # versions, commit, CPU time

    __reduce__ = _rebuild
