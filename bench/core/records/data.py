"""The records of the bench: frozen, read-only columns, one row per time.

Frames: n is the local level at the current position (north, east, down), b the body and IMU axes (forward,
right, down), e Earth-fixed, i inertial. Units are SI and radians. The truth must be finite with increasing
times. Sensor records and solutions are checked for shape and type only, because NaN, repeated times and time
going back are data there.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, fields
from functools import cache

import numpy as np

from bench.core.mathematics.arrays import BoolArray, FloatArray, IntArray
from bench.core.records.fields import NED, Rebuilt, Record, column, declared, freeze_field, matrix, vector
from bench.core.records.instruments import InstrumentReports
from bench.core.records.rotor_speeds import Rotors, no_rotors
from bench.core.records.sensor_specs import DEFAULT_DATE, AssumedSpecs

LLA = ("lat_rad", "lon_rad", "alt_m")
Q_NB = ("q_nb_w", "q_nb_x", "q_nb_y", "q_nb_z")
TIME_OFFSET = "time_offset_s"
"""Further state of a filter that estimates the clock of the fixes: the time to add to them [s]."""
STATES = tuple(
    (f"{block}_{axis}", unit)
    for block, unit in (("pos", "m"), ("vel", "m/s"), ("phi", "rad"))
    for axis in NED
)
"""Names and units of the nine errors in the covariance of a solution."""


def _check_increasing(name: str, t: FloatArray) -> None:
    if not (t[1:] > t[:-1]).all():
        k = int(np.argmax(np.diff(t) <= 0))
        raise ValueError(f"{name} must increase; row {k + 1} has {t[k + 1]:g} s after {t[k]:g} s")


EventRow = tuple[float, float, str, str] | tuple[float, float, str, str, str]
"""t, t_end, kind, text and, if there are any, the sensors concerned, as in `Events`."""


@declared
class Events(Record):
    """Events with start and end: legs, outages, faults, rejected sensor rows. For a time t_end = t."""

    t: FloatArray = column("t_s")  # (N,) start [s]
    t_end: FloatArray = column("t_end_s")  # (N,) end [s]
    kind: tuple[str, ...] = column("kind", kind=str)  # "leg", "gnss_outage", "wind", "timeline", ...
    text: tuple[str, ...] = column("text", kind=str)
    # names of the records or innovations concerned, "gnss", "gnss_position" ..., with spaces between; or ""
    sensor: tuple[str, ...] = column("sensor", kind=str)

    def select(self, kind: str) -> list[tuple[float, float, str]]:
        """Return (t, t_end, text) of all events of one kind."""
        return [
            (float(a), float(b), text)
            for a, b, k, text in zip(self.t, self.t_end, self.kind, self.text, strict=True)
            if k == kind
        ]

    @classmethod
    def from_rows(cls, rows: Iterable[EventRow]) -> Events:
        """Make events from rows in any order; they are sorted by time."""
        ordered = sorted(((*row, "")[:5] for row in rows), key=lambda row: row[:2])
        if not ordered:
            return no_events()
        t, t_end, *texts = zip(*ordered, strict=True)
        return cls(np.array(t, float), np.array(t_end, float), *texts)

    def rows(self) -> list[EventRow]:
        """Return the rows."""
        t, t_end = self.t.tolist(), self.t_end.tolist()
        return list(zip(t, t_end, self.kind, self.text, self.sensor, strict=True))


@cache
def no_events() -> Events:
    """Return events without rows."""
    return Events(np.empty(0), np.empty(0), (), (), ())


@declared
class AirData(Record):
    """The air around the aircraft, at 20 Hz on its own times."""

    t: FloatArray = column("t_s")  # (A,) [s]
    pressure: FloatArray = column("pressure_pa")  # (A,) static [Pa]
    temperature: FloatArray = column("temperature_k")  # (A,) static [K]
    airspeed_true: FloatArray = column("airspeed_true_mps")  # (A,) [m/s]
    airspeed_calibrated: FloatArray = column("airspeed_calibrated_mps")  # (A,) [m/s]
    alpha: FloatArray = column("alpha_rad")  # (A,) angle of attack [rad]
    beta: FloatArray = column("beta_rad")  # (A,) sideslip [rad]
    wind_n: FloatArray = vector("wind", "mps", "n")  # (A, 3) of the air mass, with turbulence [m/s], n
    engine_speed: FloatArray = column("engine_speed_rad_s")  # (A,) [rad/s]

    def __post_init__(self) -> None:
        self._freeze(finite=True)
        _check_increasing("AirData.t", self.t)


@declared
class Controls(Record):
    """Controls as flown, at 20 Hz; surfaces -1 to 1, signs of JSBSim (right roll, nose down, nose left)."""

    t: FloatArray = column("t_s")  # (A,) [s]
    aileron: FloatArray = column("aileron")  # (A,)
    elevator: FloatArray = column("elevator")  # (A,)
    rudder: FloatArray = column("rudder")  # (A,)
    throttle: FloatArray = column("throttle")  # (A,) 0 to 1

    def __post_init__(self) -> None:
        self._freeze(finite=True)
        _check_increasing("Controls.t", self.t)


def no_air() -> AirData:
    """Return air data without rows, for a truth without air."""
    n = np.empty(0)
    return AirData(n, n, n, n, n, n, n, np.empty((0, 3)), n)


def no_controls() -> Controls:
    """Return controls without rows, for a truth without controls."""
    n = np.empty(0)
    return Controls(n, n, n, n, n)


@declared
class Trajectory(Record):
    """True motion of the IMU, and the exact increments that an error-free IMU would report.

    Attributes
    ----------
    t : ndarray, (N,)
        Time since the start of the run [s], increasing.
    lla : ndarray, (N, 3)
        Geodetic latitude and longitude [rad], ellipsoidal height [m]; WGS 84.
    vel_n : ndarray, (N, 3)
        Velocity relative to the Earth [m/s], n.
    q_nb : ndarray, (N, 4)
        Attitude quaternion, b to n, scalar first, without sign changes.
    dtheta_b : ndarray, (N-1, 3)
        Integral of w_ib_b over (t[k], t[k+1]] [rad], b.
    dvel_b : ndarray, (N-1, 3)
        Integral of f_b over (t[k], t[k+1]] [m/s], b.
    air : AirData
        Pressure, temperature, airspeed and wind.
    controls : Controls
        Control surfaces and throttle.
    events : Events
        Legs, wind changes and others.
    rotors : Rotors
        Speeds of the rotors of a multirotor at each time; otherwise without rows.

    Examples
    --------
    >>> import bench
    >>> truth = bench.fly("approach")
    >>> truth.dtheta_b.shape[0] == len(truth.t) - 1
    True
    """

    t: FloatArray = column("t_s")
    lla: FloatArray = column(*LLA, frame="WGS 84, geodetic", shape=(3,))
    vel_n: FloatArray = vector("vel", "mps", "n")
    q_nb: FloatArray = column(*Q_NB, frame="b to n, scalar first", shape=(4,))
    dtheta_b: FloatArray = vector("dtheta", "rad", "b")
    dvel_b: FloatArray = vector("dvel", "mps", "b")
    air: AirData
    controls: Controls
    events: Events
    rotors: Rotors = field(default_factory=no_rotors)

    def __post_init__(self) -> None:
        between = (len(self.t) - 1, 3)
        self._freeze(finite=True, besides={"dtheta_b": between, "dvel_b": between})
        _check_increasing("Trajectory.t", self.t)
        if len(self.rotors) not in (0, len(self.t)):
            raise ValueError(f"Trajectory.rotors: {len(self.rotors)} rows for {len(self.t)} times")


@declared
class ImuData(Record):
    """Measured increments; row k covers the interval (t[k] - dt[k], t[k]]."""

    t: FloatArray = column("t_s")  # (N,) end of the interval [s]
    dt: FloatArray = column("dt_s")  # (N,) length of the interval [s]
    valid: BoolArray = column("valid", kind=bool)  # (N,) as flagged by the IMU itself
    dtheta_b: FloatArray = vector("dtheta", "rad", "b")  # (N, 3) [rad], b
    dvel_b: FloatArray = vector("dvel", "mps", "b")  # (N, 3) [m/s], b


@declared
class GnssFixes(Record):
    """Position and velocity of the GNSS antenna as the receiver reports them."""

    t: FloatArray = column("t_s")  # (M,) validity [s]
    t_arrival: FloatArray = column("t_arrival_s")  # (M,) when the fix reaches the filter [s]
    valid: BoolArray = column("valid", kind=bool)  # (M,)
    lla: FloatArray = column(*LLA, frame="WGS 84, geodetic", shape=(3,))  # (M, 3) [rad, rad, m]
    vel_n: FloatArray = vector("vel", "mps", "n")  # (M, 3) [m/s], n; NaN if not reported
    cov_pos_n: FloatArray = matrix(STATES[0:3], "n")  # (M, 3, 3) reported [m^2], n
    cov_vel_n: FloatArray = matrix(STATES[3:6], "n")  # (M, 3, 3) reported [m^2/s^2], n
    satellites: IntArray = column("satellites", kind=int)  # (M,) number used

    def take(self, rows: BoolArray | IntArray) -> GnssFixes:
        """Return the fixes of the selected rows."""
        return GnssFixes(**{one.name: getattr(self, one.name)[rows] for one in fields(self)})


@declared
class GnssObservations(Record):
    """Measurements of a receiver with the computed satellite states, a row per satellite and epoch."""

    t: FloatArray = column("t_s")  # (K,) validity of the epoch [s]
    t_arrival: FloatArray = column("t_arrival_s")  # (K,) [s]
    sat: IntArray = column("sat", kind=int)  # (K,) number within its system
    system: IntArray = column("system", kind=int)  # (K,) code of `bench.core.records.orbit_sets`
    frequency: FloatArray = column(shape=(None,))  # (K, bands) carrier [Hz]
    pseudorange: FloatArray = column(shape=(None,))  # (K, bands) [m]; NaN where a band is missing
    range_rate: FloatArray = column(shape=(None,))  # (K, bands) [m/s]
    cn0: FloatArray = column(shape=(None,))  # (K, bands) [dB-Hz]
    # (K, 3) at transmission, by the broadcast ephemeris [m], e at transmission
    sat_pos_e: FloatArray = vector("sat_pos", "m", "e at transmission")
    sat_vel_e: FloatArray = vector("sat_vel", "mps", "e at transmission")  # (K, 3) [m/s], e at transmission
    sat_clock: FloatArray = column("sat_clock_m")  # (K,) with relativity; add it to a pseudorange [m]
    sat_clock_rate: FloatArray = column("sat_clock_rate_mps")  # (K,) add it to a range rate [m/s]
    # (K,) of the range in use, of one carrier or of two combined; subtract it [m]
    group_delay: FloatArray = column("group_delay_m")
    sd_pseudorange: FloatArray = column("sd_pseudorange_m")  # (K,) assumed, of the corrected pseudorange [m]
    sd_range_rate: FloatArray = column("sd_range_rate_mps")  # (K,) assumed [m/s]
    epoch_start: IntArray  # (M + 1,) first row of each epoch, then K
    klobuchar: FloatArray  # (8,) broadcast alpha 0-3, beta 0-3
    gps_t0: float  # GPS time of t = 0, seconds since a GPS midnight [s]

    def __post_init__(self) -> None:
        self._freeze(width=np.shape(self.pseudorange)[-1])
        freeze_field(self, "epoch_start", int, (None,))
        freeze_field(self, "klobuchar", float, (8,))

    @property
    def epoch(self) -> IntArray:
        """Epoch (K,) of each row."""
        count: IntArray = np.repeat(np.arange(len(self.epoch_start) - 1), np.diff(self.epoch_start))
        return count


@dataclass(frozen=True, slots=True, repr=False)
class SensorData(InstrumentReports, Rebuilt):
    """Input of a filter: measurements, and the datasheets it should assume.

    Attributes
    ----------
    imu : ImuData
        Increments dtheta_b [rad] and dvel_b [m/s], b, at their times.
    fixes : GnssFixes or None
        Position and velocity fixes of the antenna.
    antenna_b : ndarray, (3,)
        GNSS antenna relative to the IMU [m], b.
    specs : AssumedSpecs
        Assumed datasheets, in SI.
    output_t : ndarray, (M,)
        Output times of the solution [s], increasing.
    observations : GnssObservations or None
        Pseudoranges and range rates.
    ground_alt : float
        Ellipsoidal height of the runway on the chart [m].
    date : float
        Date of the flight [decimal years], for the magnetic field.
    baro, mag, ... : InstrumentReports
        One record for each other instrument; None if it is not on board.

    Examples
    --------
    >>> import bench
    >>> sensed = bench.sense("approach", bench.fly("approach"))
    >>> sensed.data.imu.dvel_b.shape == (len(sensed.data.imu.t), 3)
    True
    """

    imu: ImuData
    fixes: GnssFixes | None
    antenna_b: FloatArray
    specs: AssumedSpecs
    output_t: FloatArray
    observations: GnssObservations | None = None
    ground_alt: float = 0.0
    date: float = DEFAULT_DATE
    __repr__ = Rebuilt.__repr__

    def __post_init__(self) -> None:
        freeze_field(self, "antenna_b", float, (3,), finite=True)
        freeze_field(self, "output_t", float, (None,), finite=True)
        _check_increasing("SensorData.output_t", self.output_t)

    def duration_from(self, start: float) -> float:
        """Return the time from a start to the last epoch of the solution [s]."""
        return float(self.output_t[-1]) - start if len(self.output_t) else 0.0


@dataclass(frozen=True, slots=True, repr=False)
class InitialState(Rebuilt):
    """Initial state of a filter with its covariance.

    Values that are not given are NaN with infinite variance; `bench.navigation.start.alignment.complete`
    finds them.

    Attributes
    ----------
    t : float
        Time [s].
    lla : ndarray, (3,)
        Position of the IMU [rad, rad, m].
    vel_n : ndarray, (3,)
        Velocity [m/s], n.
    q_nb : ndarray, (4,)
        Attitude quaternion, b to n.
    cov : ndarray, (9, 9)
        Covariance of the errors (pos_n [m], vel_n [m/s], phi_n [rad]).
    alignment : {"given", "level", "course", "motion"}
        What is given: everything; the position at standstill; nothing. "motion" is "course" of any heading.
    align_for : float
        "level": longest standstill used; "course", "motion": longest segment used [s].
    drift_sd : float
        "course": sigma of the angle between course and nose, from wind and sideslip; "motion": of the
        heading [rad].
    bias_cov : ndarray, (9, 6)
        Covariance of these errors with gyro [rad/s] and accelerometer [m/s^2] bias errors, b.
    fix_cov : ndarray, (3,)
        Covariance of the position error with the lasting error of the fixes [m^2], n.

    Examples
    --------
    >>> import bench
    >>> bench.sense("approach", bench.fly("approach")).initial.alignment
    'given'
    """

    t: float
    lla: FloatArray
    vel_n: FloatArray
    q_nb: FloatArray
    cov: FloatArray
    alignment: str
    align_for: float = 60.0
    drift_sd: float = 0.0
    bias_cov: FloatArray = field(default_factory=lambda: np.zeros((9, 6)))
    fix_cov: FloatArray = field(default_factory=lambda: np.zeros(3))

    def __post_init__(self) -> None:
        state = {"lla": (3,), "vel_n": (3,), "q_nb": (4,), "cov": (9, 9)}
        shapes: dict[str, tuple[int, ...]] = {**state, "bias_cov": (9, 6), "fix_cov": (3,)}
        for name, shape in shapes.items():
            freeze_field(self, name, float, shape, finite=self.alignment == "given")


@declared
class Innovations(Record):
    """Measurement minus prediction, a row per scalar component."""

    t: FloatArray = column("t_s")  # (K,) [s]
    sensor: tuple[str, ...]  # names; ``code`` is the index
    code: IntArray = column("sensor", kind=int)  # (K,) index into sensor: "gnss_position", "baro" ...
    component: IntArray = column("component", frame="n", kind=int)  # (K,) 0, 1, 2 along n
    z: FloatArray = column("z", units=("of the sensor",), frame="n")  # (K,) [unit of the sensor]
    S: FloatArray = column("S", units=("of the sensor, squared",), frame="n")  # (K,) predicted variance of z
    nis: FloatArray = column("nis")  # (K,) of the whole measurement vector, repeated on its rows
    accepted: BoolArray = column("accepted", kind=bool)  # (K,)

    @classmethod
    def from_rows(
        cls, sensor: tuple[str, ...], rows: list[tuple[float, int, int, float, float, float, bool]]
    ) -> Innovations:
        """Make a table from rows (t, code, component, z, S, nis, accepted)."""
        t, code, component, z, S, nis, accepted = np.array(rows, float).reshape(-1, 7).T
        codes, components = code.astype(np.int64), component.astype(np.int64)
        return cls(t, sensor, codes, components, z, S, nis, accepted.astype(np.bool_))


@cache
def no_innovations() -> Innovations:
    """Return an empty table, for a filter without updates."""
    return Innovations.from_rows((), [])


@declared
class NavSolution(Record):
    """Output of a filter at ``SensorData.output_t``, after all updates at that time.

    A block that is not estimated is NaN in its values and in its rows of the covariance.

    Attributes
    ----------
    t : ndarray, (M,)
        Time [s].
    lla : ndarray, (M, 3)
        Position of the IMU: latitude, longitude [rad], ellipsoidal height [m].
    vel_n : ndarray, (M, 3)
        Velocity relative to the Earth [m/s], n.
    q_nb : ndarray, (M, 4)
        Attitude quaternion, b to n, scalar first.
    gyro_bias_b, accel_bias_b : ndarray, (M, 3)
        Biases [rad/s], [m/s^2], b.
    cov : ndarray, (M, 9, 9)
        Covariance of the errors (pos_n [m], vel_n [m/s], phi_n [rad]).
    extra_names : tuple of str
        Names of further states; the unit ends the name.
    extra, extra_sd : ndarray, (M, n)
        Their values and standard deviations.
    offset_cov : ndarray, (M, 9), or None
        Covariance of the error of ``time_offset_s``, the time to add to the fixes, with the errors of
        ``cov``; NaN if it is not known, None without this state.
    innovations : Innovations
        Measurement minus prediction, with NIS and acceptance.
    events : Events
        Rejections, re-admissions and others.

    Examples
    --------
    >>> import bench
    >>> result = bench.run("approach", estimators=["loose-15"], causes=False)
    >>> result.solutions["loose-15"].extra_names[0]
    'gyro_bias_x_rad_s'
    """

    t: FloatArray = column("t_s")
    lla: FloatArray = column(*LLA, frame="WGS 84, geodetic", shape=(3,))
    vel_n: FloatArray = vector("vel", "mps", "n")
    q_nb: FloatArray = column(*Q_NB, frame="b to n, scalar first", shape=(4,))
    gyro_bias_b: FloatArray = vector("gyro_bias", "rad_s", "b")
    accel_bias_b: FloatArray = vector("accel_bias", "m_s2", "b")
    cov: FloatArray = matrix(STATES, "n")
    extra_names: tuple[str, ...]
    extra: FloatArray = column(shape=(None,))
    extra_sd: FloatArray = column(shape=(None,))
    innovations: Innovations = field(default_factory=no_innovations)
    events: Events = field(default_factory=no_events)
    offset_cov: FloatArray | None = None

    def __post_init__(self) -> None:
        self._freeze(width=len(self.extra_names))
        if TIME_OFFSET in self.extra_names and self.offset_cov is None:
            object.__setattr__(self, "offset_cov", np.full((len(self), 9), np.nan))
        elif TIME_OFFSET not in self.extra_names and self.offset_cov is not None:
            raise ValueError(f"NavSolution.offset_cov needs {TIME_OFFSET!r} among extra_names")
        if self.offset_cov is not None:
            freeze_field(self, "offset_cov", float, (len(self), 9))
