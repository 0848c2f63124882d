"""The aiding instruments other than GNSS, one declaration each; all other code loops over them.

To add one, write its record, its spec, their fields in :class:`InstrumentSpecs` and
:class:`InstrumentReports`, its row in :data:`INSTRUMENTS`, and ``bench/simulation/sensors/<model>.py``.
Datasheets, profiles, logs, faults, files, streams, recordings, requirements and alarms follow from the row.
`bench guide extending` says what a filter needs to use it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.records.fields import XYZ, Column, Record, column, columns_of, declared, figure, vector


@declared
class InstrumentData(Record):
    """Columns of every instrument, besides its value and the standard deviation ``sd`` (M,) of the value."""

    t: FloatArray = column("t_s")  # (M,) validity [s]
    t_arrival: FloatArray = column("t_arrival_s")  # (M,) when the row reaches the filter [s]
    valid: BoolArray = column("valid", kind=bool)  # (M,) as flagged by the instrument itself


@declared
class BaroData(InstrumentData):
    """Barometric altitude as the instrument reports it."""

    alt_baro: FloatArray = column("alt_baro_m")  # (M,) [m]
    sd: FloatArray = column("sd_m")  # (M,) white noise by the datasheet [m]


@declared
class MagData(InstrumentData):
    """The magnetic field as a strapped-down magnetometer reports it."""

    field_b: FloatArray = vector("field", "t", "b", units=("T", "T", "T"))  # (M, 3) [T], b
    sd: FloatArray = column("sd_t", units=("T",))  # (M,) white noise per axis by the datasheet [T]


@declared
class AirspeedData(InstrumentData):
    """True airspeed as the air data computer reports it."""

    airspeed_true: FloatArray = column("airspeed_true_mps")  # (M,) [m/s]
    sd: FloatArray = column("sd_mps")  # (M,) white noise by the datasheet [m/s]


@declared
class StaticPressureSpec:
    """Errors of a barometer in terms of pressure: sensor, static port, weather. 0 switches an error off."""

    pressure_white_sd: float = figure("pa", default=0.0)
    """White noise of the pressure [Pa]."""
    pressure_bias_sd: float = figure("pa", default=0.0)
    """Absolute accuracy of the pressure [Pa]."""
    temperature_sd: float = figure("pa_k", default=0.0)
    """Error of the pressure per kelvin of the air from 25 degC [Pa/K]."""
    isa_deviation: float = figure("k", -60, 60, default=0.0)
    """Temperature of the air above the standard atmosphere, at every height [K]."""
    isa_deviation_sd: float = figure("k", 0, 20, default=0.0)
    """Standard deviation of this difference, per run [K]."""
    qnh_sd: float = figure("hpa", 0, 50, default=0.0)
    """Error of the altimeter setting at the start [Pa]."""
    qnh_walk: float = figure("hpa_sqrt_h", 0, 50, default=0.0)
    """Random walk of the pressure at sea level [Pa/sqrt(s)]."""
    position_error: float = figure("", -0.5, 0.5, default=0.0)
    """Error of the static port over the dynamic pressure, at zero incidence [1]."""
    position_error_alpha: float = figure("per_deg", -0.1, 0.1, default=0.0)
    """The same per angle of attack [1/rad]."""
    position_error_beta2: float = figure("per_deg2", -0.01, 0.01, default=0.0)
    """The same per squared sideslip [1/rad^2]."""
    lag: float = figure("s", 0, 60, default=0.0)
    """Time constant of ports and lines, first order [s]."""
    quantization: float = figure("pa", default=0.0)
    """Resolution of the pressure [Pa]."""


@declared
class BaroSpec:
    """Barometric altitude with white noise and a random-walk bias (A-5.3.1, A-5.3.2)."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Measurements in a second [Hz]."""
    white_sd: float = figure("m", reported=True)
    """White noise [m]."""
    bias_sd: float = figure("m", default=0.0)
    """Bias at the start [m]."""
    bias_walk: float = figure("m_sqrt_s", default=0.0)
    """Random walk of the bias [m/sqrt(s)]."""
    quantization: float = figure("m", default=0.0, error="barometer quantization")
    """Resolution [m]."""
    latency: float = figure("s", default=0.0)
    """Time from a measurement until a filter gets it [s]."""
    physical: StaticPressureSpec | None = None  # if given, only filters assume the errors above


@declared
class MagSpec:
    """A magnetometer as mounted, after calibration. 0 switches an error off."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Measurements in a second [Hz]."""
    white_sd: float = figure("nt", reported=True)
    """White noise of each axis [T]."""
    hard_iron_sd: float = figure("nt", default=0.0, error="magnetometer calibration")
    """Remaining offset of the sensor and the iron around it, each axis [T]."""
    soft_iron_sd: float = figure("percent", 0, 100, default=0.0, error="magnetometer calibration")
    """Each element of the remaining symmetric matrix of the iron around it [1]."""
    scale_factor_sd: float = figure("percent", 0, 100, default=0.0, error="magnetometer calibration")
    """Error of the scale factor of each axis [1]."""
    misalignment_sd: float = figure("deg", 0, 45, default=0.0, error="magnetometer calibration")
    """Misalignment of each axis towards each other one [rad]."""
    motor_field_sd: float = figure("nt", default=0.0, error="field of motor currents")
    """Field of the motor currents at full throttle, each axis [T]."""
    range: float = figure("ut", default=0.0)
    """Largest field of an axis: samples beyond it are clipped and flagged [T]; 0: no limit."""
    quantization: float = figure("nt", default=0.0)
    """Resolution [T]."""
    latency: float = figure("s", default=0.0)
    """Time from a measurement until a filter gets it [s]."""


@declared
class AirspeedSpec:
    """A pitot tube with a differential pressure sensor and an air data computer. 0 switches an error off."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Measurements in a second [Hz]."""
    pressure_white_sd: float = figure("pa", default=0.0)
    """White noise of the differential pressure [Pa]."""
    white_sd: float = figure("mps", default=0.0)
    """White noise of the true airspeed [m/s]."""
    pressure_bias_sd: float = figure("pa", default=0.0, error="airspeed bias and scale factor")
    """Zero offset of the differential pressure [Pa]."""
    bias_sd: float = figure("mps", default=0.0, error="airspeed bias and scale factor")
    """Bias of the true airspeed [m/s]."""
    scale_factor_sd: float = figure("percent", 0, 50, default=0.0, error="airspeed bias and scale factor")
    """Error of the scale factor of the true airspeed [1]."""
    lag: float = figure("s", 0, 60, default=0.0, error="airspeed lag")
    """Time constant of tube and lines, first order [s]."""
    range: float = figure("pa", default=0.0)
    """Largest differential pressure: samples beyond it are clipped and flagged [Pa]; 0: no limit."""
    quantization: float = figure("pa", default=0.0)
    """Resolution of the differential pressure [Pa]."""
    min_speed: float = figure("mps", 0, 100, default=0.0)
    """Samples below this true airspeed are flagged [m/s]."""
    latency: float = figure("s", default=0.0)
    """Time from a measurement until a filter gets it [s]."""


@declared
class RadarData(InstrumentData):
    """Height above the ground as a radar altimeter reports it."""

    height: FloatArray = column("height_m")  # (M,) [m]
    sd: FloatArray = column("sd_m")  # (M,) white noise by the datasheet [m]


@declared
class RadarSpec:
    """A radar altimeter. 0 switches an error off."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Measurements in a second [Hz]."""
    white_sd: float = figure("m", reported=True)
    """White noise [m]."""
    range: float = figure("m", 1, 1e5)
    """Samples above this height are flagged [m]."""
    min_height: float = figure("m", default=0.0)
    """Samples below this height are flagged [m]."""
    max_tilt: float = figure("deg", 1, 90, default=math.pi / 2)
    """Samples tilted beyond this are flagged [rad]."""
    bias_sd: float = figure("m", default=0.0, error="radar altimeter bias")
    """Bias, constant in a run [m]."""
    quantization: float = figure("m", default=0.0, error="radar altimeter quantization")
    """Resolution [m]."""
    latency: float = figure("s", default=0.0)
    """Time from a measurement until a filter gets it [s]."""


@declared
class OdometerData(InstrumentData):
    """Speed over ground along the body axis as measured by a wheel."""

    speed: FloatArray = column("speed_mps")  # (M,) forward positive [m/s]
    sd: FloatArray = column("sd_mps")  # (M,) white noise by the datasheet [m/s]


@declared
class OdometerSpec:
    """An odometer that counts the turns of a wheel. 0 switches an error off."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Measurements in a second [Hz]."""
    white_sd: float = figure("mps", reported=True)
    """White noise [m/s]."""
    scale_factor_sd: float = figure("percent", 0, 50, default=0.0, error="odometer scale factor")
    """Error of the diameter of the wheel, constant in a run [1]."""
    quantization: float = figure("mps", default=0.0, error="odometer quantization")
    """Resolution [m/s]."""
    latency: float = figure("s", default=0.0)
    """Time from a measurement until a filter gets it [s]."""


@declared
class HeadingData(InstrumentData):
    """Heading from two antennas: the direction from the one behind to the one ahead."""

    heading: FloatArray = column("heading_rad")  # (M,) from north over east [rad]
    sd: FloatArray = column("sd_rad")  # (M,) white noise by the datasheet, or as reported [rad]


@declared
class HeadingSpec:
    """Two antennas ahead of each other and a receiver that takes their heading. 0 switches an error off."""

    name: str
    rate: float = figure("hz", 0.01, 400)
    """Measurements in a second [Hz]."""
    white_sd: float = figure("deg", 0, 90, reported=True)
    """White noise [rad]."""
    wander_sd: float = figure("deg", 0, 90, default=0.0, error="multipath of the antennas' heading")
    """Multipath, Gauss-Markov [rad]."""
    wander_time: float = figure("s", 1, 1e5, default=60.0)
    """Correlation time of the multipath [s]."""
    bias_sd: float = figure("deg", 0, 90, default=0.0, error="offset of the antennas' heading")
    """Offset of the line between the antennas from the forward axis, constant in a run [rad]."""
    max_slope: float = figure("deg", 1, 84, default=math.radians(60.0))
    """Samples with that line steeper than this are flagged [rad]."""
    quantization: float = figure("deg", default=0.0, error="quantization of the antennas' heading")
    """Resolution [rad]."""
    latency: float = figure("s", default=0.0)
    """Time from a measurement until a filter gets it [s]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentSpecs:
    """Specs of the instruments, on board or assumed; None if there is no such instrument."""

    baro: BaroSpec | None = None
    mag: MagSpec | None = None
    airspeed: AirspeedSpec | None = None
    radar: RadarSpec | None = None
    odometer: OdometerSpec | None = None
    heading: HeadingSpec | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class InstrumentReports:
    """Records of the instruments; None if there is no such instrument."""

    baro: BaroData | None = None
    mag: MagData | None = None
    airspeed: AirspeedData | None = None
    radar: RadarData | None = None
    odometer: OdometerData | None = None
    heading: HeadingData | None = None

    @property
    def instruments(self) -> dict[str, Any]:
        """The records present, by name of the instrument."""
        return {name: one for name in INSTRUMENTS if (one := getattr(self, name)) is not None}


@dataclass(frozen=True, slots=True)
class Trace:
    """Curve of an instrument in the plots of a recording."""

    plot: str  # key of an existing plot, or of a new one
    legend: str  # for one component; with several components the axes are named
    unit: str  # of the plot
    scale: float = 1.0  # factor from SI to the unit of the plot
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Instrument:
    """Declaration of an aiding instrument."""

    name: str  # key in [sensors], folder of the catalog, end of file names
    title: str  # in words
    record: type[InstrumentData]
    spec: type
    contents: str  # contents of its table, in words
    model: str  # module of `bench.simulation.sensors`
    innovation: str  # name of its innovations
    quantity: str  # measured quantity, in words
    frame: int  # type number of its frames in a stream
    bias: Column  # its slowly varying error in `bench.core.records.data.SensorTruth`
    trace: Trace
    parts: Mapping[str, type] = field(default_factory=dict)  # further tables of its datasheet -> their specs
    step: str = ""  # unit of the fault "<name>-step"; empty if there is no such fault
    usual: str = ""  # datasheet for a recording whose unit is not known; empty: it is asked for
    spreads: bool = False  # a recording may say its standard deviation
    of_attitude: bool = False  # tells no more than a known attitude does
    rounds: bool = True  # ``quantization`` applies to the value
    feels_air: Callable[[Any], bool] = lambda spec: False  # its errors depend on the air of the flight
    problems: Callable[[Any], list[str]] = lambda spec: []  # find mistakes in a spec, a line each

    @property
    def value(self) -> str:
        """Field of the record with the measured value."""
        return next(name for name in columns_of(self.record) if name not in ("t", "t_arrival", "valid", "sd"))

    def values(self, record: Any) -> FloatArray:
        """Return the measured values (M, k), a column per component."""
        found: FloatArray = getattr(record, self.value).reshape(len(record), self.width)
        return found

    @property
    def width(self) -> int:
        """Number of components of a value."""
        return len(columns_of(self.record)[self.value].names)

    @property
    def unit(self) -> str:
        """Unit of the value."""
        return columns_of(self.record)[self.value].units[0]

    @property
    def with_article(self) -> str:
        """Name with its article, for messages."""
        return f"an {self.name}" if self.name[0] in "aeiou" else f"a {self.name}"


def _check_baro(spec: BaroSpec) -> list[str]:
    if spec.physical is not None and spec.quantization:
        return ["[baro] quantization_m is not for a barometer with [physical]: give quantization_pa there"]
    return []


def _check_airspeed(spec: AirspeedSpec) -> list[str]:
    if spec.pressure_white_sd == 0 and spec.white_sd == 0:
        return ["[airspeed] pressure_white_sd_pa or white_sd_mps must be above 0: the unit reports it"]
    return []


INSTRUMENTS: Mapping[str, Instrument] = {
    row.name: row
    for row in (
        Instrument(
            name="baro",
            title="barometer",
            record=BaroData,
            spec=BaroSpec,
            contents="barometric altitude; sd_m is the white noise that the instrument reports",
            model="baro",
            innovation="baro",
            quantity="baro altitude",
            frame=2,
            bias=Column(("baro_bias_m",), ("m",)),
            trace=Trace("altitude", "barometer", "m"),
            parts={"physical": StaticPressureSpec},
            step="m",
            feels_air=lambda spec: spec.physical is not None,
            problems=_check_baro,
            usual="bmp388",
        ),
        Instrument(
            name="mag",
            title="magnetometer",
            record=MagData,
            spec=MagSpec,
            contents="magnetic field as the magnetometer reports it; the date of the flight is in start.json",
            model="magnetometer",
            innovation="magnetometer",
            quantity="magnetic field",
            frame=3,
            bias=Column(tuple(f"mag_bias_{axis}_t" for axis in XYZ), ("T",) * 3, "b", (3,)),
            trace=Trace("magnetic_field", "magnetic field measured", "uT", 1e6),
            usual="hmc5883l",
            of_attitude=True,
        ),
        Instrument(
            name="airspeed",
            title="airspeed unit",
            record=AirspeedData,
            spec=AirspeedSpec,
            contents="true airspeed as the air data computer reports it",
            model="airspeed",
            innovation="airspeed",
            quantity="airspeed",
            frame=4,
            bias=Column(("airspeed_bias_mps",), ("m/s",)),
            trace=Trace("speed", "airspeed unit", "m/s", dots=True),
            rounds=False,
            feels_air=lambda spec: True,
            problems=_check_airspeed,
            usual="ms4525do",
        ),
        Instrument(
            name="radar",
            title="radar altimeter",
            record=RadarData,
            spec=RadarSpec,
            contents="height above the runway as the radar altimeter reports it",
            model="radar",
            innovation="radar",
            quantity="radar height",
            frame=5,
            bias=Column(("radar_bias_m",), ("m",)),
            trace=Trace("height", "height above the ground", "m"),
            step="m",
            usual="lr-d1",
            spreads=True,
        ),
        Instrument(
            name="odometer",
            title="odometer",
            record=OdometerData,
            spec=OdometerSpec,
            contents="forward speed over ground from a wheel; valid while the wheel is on the ground",
            model="odometer",
            innovation="odometer",
            quantity="wheel speed",
            frame=6,
            bias=Column(("odometer_bias_mps",), ("m/s",)),
            trace=Trace("speed", "odometer", "m/s", dots=True),
        ),
        Instrument(
            name="heading",
            title="dual antenna",
            record=HeadingData,
            spec=HeadingSpec,
            contents="heading from two antennas, from north over east; sd_rad is its white noise",
            model="dual_antenna",
            innovation="heading",
            quantity="heading of the antennas",
            frame=7,
            bias=Column(("heading_bias_rad",), ("rad",)),
            trace=Trace("heading", "dual antenna", "deg", 180.0 / math.pi, dots=True),
            step="deg",
            usual="oem7-align-2m",
            spreads=True,
            of_attitude=True,
        ),
    )
}
"""Name -> the instrument."""
