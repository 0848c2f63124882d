"""The aiding instruments beside IMU and GNSS: one declaration each, and everything else loops over them.

An instrument is its record, its spec, its place in :class:`Units` and :class:`Reports` and its row in
:data:`INSTRUMENTS`. To add one, write these here, its model in ``bench/sensors/<model>.py`` and, for filters
that use it, its row in `bench.navigation.measurements` and its branch in the measurement kernel. Datasheets,
profiles, faults, files, streams, recordings, needs and alarms follow from the row here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

from bench.arrays import BoolArray, FloatArray
from bench.fields import XYZ, Column, Record, column, columns_of, declared, figure, vector


@declared
class InstrumentData(Record):
    """What every instrument reports beside its value and that value's standard deviation ``sd`` (M,)."""

    t: FloatArray = column("t_s")  # (M,) validity [s]
    t_arrival: FloatArray = column("t_arrival_s")  # (M,) when the row reaches the filter [s]
    valid: BoolArray = column("valid", kind=bool)  # (M,) what the instrument itself flags


@declared
class BaroData(InstrumentData):
    """Barometric altitude as the instrument reports it."""

    alt_baro: FloatArray = column("alt_baro_m")  # (M,) [m]
    sd: FloatArray = column("sd_m")  # (M,) white noise the instrument claims [m]


@declared
class MagData(InstrumentData):
    """The magnetic field as a strapped-down magnetometer reports it."""

    field_b: FloatArray = vector("field", "t", "b", units=("T", "T", "T"))  # (M, 3) [T], b
    sd: FloatArray = column("sd_t", units=("T",))  # (M,) white noise per axis the instrument claims [T]


@declared
class AirspeedData(InstrumentData):
    """True airspeed as the air data computer reports it."""

    airspeed_true: FloatArray = column("airspeed_true_mps")  # (M,) [m/s]
    sd: FloatArray = column("sd_mps")  # (M,) white noise the instrument claims [m/s]


@declared
class StaticPressureSpec:
    """An altimeter by what it feels: static pressure, its port, the weather. What there is not is 0."""

    pressure_white_sd: float = figure("pa", default=0.0)  # of the pressure [Pa]
    pressure_bias_sd: float = figure("pa", default=0.0)  # absolute accuracy of the pressure [Pa]
    temperature_sd: float = figure("pa_k", default=0.0)  # pressure per kelvin of the air from 25 degC [Pa/K]
    # what the air of the day is warmer than standard at every height [K]
    isa_deviation: float = figure("k", -60, 60, default=0.0)
    isa_deviation_sd: float = figure("k", 0, 20, default=0.0)  # of the same, drawn for each run [K]
    qnh_sd: float = figure("hpa", 0, 50, default=0.0)  # of the setting at the start [Pa]
    # of the pressure at sea level since the start [Pa/sqrt(s)]
    qnh_walk: float = figure("hpa_sqrt_h", 0, 50, default=0.0)
    # of the port, over the dynamic pressure, at no incidence [1]
    position_error: float = figure("", -0.5, 0.5, default=0.0)
    position_error_alpha: float = figure("per_deg", -0.1, 0.1, default=0.0)  # per angle of attack [1/rad]
    position_error_beta2: float = figure(
        "per_deg2", -0.01, 0.01, default=0.0
    )  # per squared sideslip [1/rad^2]
    lag: float = figure("s", 0, 60, default=0.0)  # time constant of ports and lines, first order [s]
    quantization: float = figure("pa", default=0.0)  # least bit of the pressure [Pa]


@declared
class BaroSpec:
    """Barometric altitude: white noise and a bias that walks (A-5.3.1, A-5.3.2)."""

    name: str
    rate: float = figure("hz", 0.01, 400)  # [Hz]
    white_sd: float = figure("m", reported=True)  # [m]
    bias_sd: float = figure("m", default=0.0)  # of the bias at the start [m]
    bias_walk: float = figure("m_sqrt_s", default=0.0)  # [m/sqrt(s)]
    quantization: float = figure("m", default=0.0)  # least bit [m]
    latency: float = figure("s", default=0.0)  # [s]
    physical: StaticPressureSpec | None = None  # the errors above are then what filters assume


@declared
class MagSpec:
    """A magnetometer where it is mounted, after its calibration. What it does not have is 0."""

    name: str
    rate: float = figure("hz", 0.01, 400)  # [Hz]
    white_sd: float = figure("nt", reported=True)  # each axis [T]
    # offset left of the unit and of the iron around it, each axis [T]
    hard_iron_sd: float = figure("nt", default=0.0)
    # each element of the symmetric matrix left of the iron around it [1]
    soft_iron_sd: float = figure("percent", 0, 100, default=0.0)
    scale_factor_sd: float = figure("percent", 0, 100, default=0.0)  # each axis [1]
    misalignment_sd: float = figure("deg", 0, 45, default=0.0)  # of each axis towards each other one [rad]
    # largest field of an axis, 0 none; beyond it the sample is clipped and flagged [T]
    range: float = figure("ut", default=0.0)
    quantization: float = figure("nt", default=0.0)  # least bit [T]
    latency: float = figure("s", default=0.0)  # [s]


@declared
class AirspeedSpec:
    """A pitot tube with its differential pressure sensor and the computer that makes true airspeed of it.

    What it does not have is 0; ``bench.signals.air.airspeed_sd`` has the white noise as a speed.
    """

    name: str
    rate: float = figure("hz", 0.01, 400)  # [Hz]
    pressure_white_sd: float = figure("pa", default=0.0)  # of the differential pressure [Pa]
    white_sd: float = figure("mps", default=0.0)  # of the true airspeed [m/s]
    pressure_bias_sd: float = figure("pa", default=0.0)  # zero of the differential pressure [Pa]
    bias_sd: float = figure("mps", default=0.0)  # of the true airspeed [m/s]
    scale_factor_sd: float = figure("percent", 0, 50, default=0.0)  # of the true airspeed [1]
    lag: float = figure("s", 0, 60, default=0.0)  # time constant of tube and lines, first order [s]
    # largest differential pressure, 0 none; beyond it the sample is clipped and flagged [Pa]
    range: float = figure("pa", default=0.0)
    quantization: float = figure("pa", default=0.0)  # least bit of the differential pressure [Pa]
    # true airspeed below which the unit flags its samples [m/s]
    min_speed: float = figure("mps", 0, 100, default=0.0)
    latency: float = figure("s", default=0.0)  # [s]


@declared
class RadarData(InstrumentData):
    """Height above the ground as a radar altimeter reports it."""

    height: FloatArray = column("height_m")  # (M,) [m]
    sd: FloatArray = column("sd_m")  # (M,) white noise the instrument claims [m]


@declared
class RadarSpec:
    """A radar altimeter. What it does not have is 0."""

    name: str
    rate: float = figure("hz", 0.01, 400)  # [Hz]
    white_sd: float = figure("m", reported=True)  # [m]
    range: float = figure("m", 1, 1e5)  # a sample above it is flagged [m]
    min_height: float = figure("m", default=0.0)  # a sample below it is flagged [m]
    max_tilt: float = figure("deg", 1, 90, default=math.pi / 2)  # a sample tilted beyond is flagged [rad]
    bias_sd: float = figure("m", default=0.0)  # constant in a run [m]
    quantization: float = figure("m", default=0.0)  # least bit [m]
    latency: float = figure("s", default=0.0)  # [s]


@declared
class OdometerData(InstrumentData):
    """Speed over ground along the body as a wheel tells it."""

    speed: FloatArray = column("speed_mps")  # (M,) forward positive [m/s]
    sd: FloatArray = column("sd_mps")  # (M,) white noise the instrument claims [m/s]


@declared
class OdometerSpec:
    """A wheel that counts its turns. What it does not have is 0."""

    name: str
    rate: float = figure("hz", 0.01, 400)  # [Hz]
    white_sd: float = figure("mps", reported=True)  # [m/s]
    scale_factor_sd: float = figure("percent", 0, 50, default=0.0)  # of the diameter, constant in a run [1]
    quantization: float = figure("mps", default=0.0)  # least bit [m/s]
    latency: float = figure("s", default=0.0)  # [s]


@dataclass(frozen=True, slots=True, kw_only=True)
class Units:
    """The specs of the instruments, on board or assumed; None: there is no such instrument."""

    baro: BaroSpec | None = None
    mag: MagSpec | None = None
    airspeed: AirspeedSpec | None = None
    radar: RadarSpec | None = None
    odometer: OdometerSpec | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Reports:
    """What the instruments report; None: there is no such instrument."""

    baro: BaroData | None = None
    mag: MagData | None = None
    airspeed: AirspeedData | None = None
    radar: RadarData | None = None
    odometer: OdometerData | None = None

    @property
    def instruments(self) -> dict[str, Any]:
        """The records that there are, by the name of the instrument."""
        found = {name: getattr(self, name) for name in INSTRUMENTS}
        return {name: record for name, record in found.items() if record is not None}


@dataclass(frozen=True, slots=True)
class Trace:
    """How the value of an instrument stands among the plots of the flight."""

    plot: str  # key of the plot it joins, or of a plot of its own
    legend: str  # with several components the axes stand in its place
    unit: str  # of the plot
    scale: float = 1.0  # of the plot's unit over SI
    dots: bool = False


@dataclass(frozen=True, slots=True)
class Instrument:
    """An aiding instrument: how it is called, what it reports, and what else there is to know of it."""

    name: str  # key in [sensors], folder of the catalog, end of file names
    title: str  # in words
    record: type[InstrumentData]
    spec: type
    says: str  # what its table holds, in words
    model: str  # module of `bench.sensors`
    innovation: str  # name of its innovations
    quantity: str  # what they are of, in words
    frame: int  # kind of its frames in a stream
    bias: Column  # its slowly varying error in the table of what was drawn
    trace: Trace
    parts: Mapping[str, type] = field(default_factory=dict)  # further tables of its datasheet -> their specs
    step: str = ""  # unit of the fault "<name>-step"; empty: there is no such fault
    rounds: bool = True  # its ``quantization`` is that of the value
    feels_air: Callable[[Any], bool] = lambda spec: False
    problems: Callable[[Any], list[str]] = lambda spec: []  # what is wrong with a spec, a line each

    @property
    def value(self) -> str:
        """Field of the record that holds what is measured."""
        return next(name for name in columns_of(self.record) if name not in _COMMON)

    def values(self, record: Any) -> FloatArray:
        """Return what a record holds, a row per instant and a column per component (M, k)."""
        found: FloatArray = getattr(record, self.value).reshape(len(record), -1)
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


_COMMON = ("t", "t_arrival", "valid", "sd")


def _baro_problems(spec: BaroSpec) -> list[str]:
    if spec.physical is not None and spec.quantization:
        return ["[baro] quantization_m is not for a barometer with [physical]: give quantization_pa there"]
    return []


def _airspeed_problems(spec: AirspeedSpec) -> list[str]:
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
            says="barometric altitude; sd_m is the white noise the instrument claims",
            model="baro",
            innovation="baro",
            quantity="baro altitude",
            frame=2,
            bias=Column(("baro_bias_m",), ("m",)),
            trace=Trace("altitude", "barometer", "m"),
            parts={"physical": StaticPressureSpec},
            step="m",
            feels_air=lambda spec: spec.physical is not None,
            problems=_baro_problems,
        ),
        Instrument(
            name="mag",
            title="magnetometer",
            record=MagData,
            spec=MagSpec,
            says="the magnetic field as the magnetometer reports it; the date of the flight is in start.json",
            model="magnetometer",
            innovation="magnetometer",
            quantity="magnetic field",
            frame=3,
            bias=Column(tuple(f"mag_bias_{axis}_t" for axis in XYZ), ("T",) * 3, "b", (3,)),
            trace=Trace("magnetic_field", "magnetic field measured", "uT", 1e6),
        ),
        Instrument(
            name="airspeed",
            title="airspeed unit",
            record=AirspeedData,
            spec=AirspeedSpec,
            says="true airspeed as the air data computer reports it",
            model="airspeed",
            innovation="airspeed",
            quantity="airspeed",
            frame=4,
            bias=Column(("airspeed_bias_mps",), ("m/s",)),
            trace=Trace("speed", "airspeed unit", "m/s", dots=True),
            rounds=False,
            feels_air=lambda spec: True,
            problems=_airspeed_problems,
        ),
        Instrument(
            name="radar",
            title="radar altimeter",
            record=RadarData,
            spec=RadarSpec,
            says="height above the runway as the radar altimeter reports it",
            model="radar",
            innovation="radar",
            quantity="radar height",
            frame=5,
            bias=Column(("radar_bias_m",), ("m",)),
            trace=Trace("height", "height above the ground", "m"),
            step="m",
        ),
        Instrument(
            name="odometer",
            title="odometer",
            record=OdometerData,
            spec=OdometerSpec,
            says="forward speed over ground as a wheel tells it; valid while the wheel is on the ground",
            model="odometer",
            innovation="odometer",
            quantity="wheel speed",
            frame=6,
            bias=Column(("odometer_bias_mps",), ("m/s",)),
            trace=Trace("speed", "odometer", "m/s", dots=True),
        ),
    )
}
"""Name -> the instrument."""
