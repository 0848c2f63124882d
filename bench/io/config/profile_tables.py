"""The tables of a profile file: keys, limits and defaults, in the units of the file."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from contextlib import suppress
from datetime import date
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import AfterValidator, BeforeValidator, Field, create_model
from pydantic_core import PydanticCustomError

from bench.core.records.flight_specs import (
    ALTITUDES,
    SECONDS,
    SPEEDS,
    Gust,
    Leg,
    Runway,
    ThermalsSpec,
    WindLayer,
)
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.specs import EvaluationWindow
from bench.io.config.fault_tables import FaultTable
from bench.io.config.leg_tables import DeclaredTable, build_leg_type
from bench.io.config.sheet import make_table_type
from bench.io.config.tables import ROWS, Table, between
from bench.simulation.signals.magnetic import FIRST_YEAR, LAST_YEAR

Seconds = Annotated[float, between(*SECONDS)]
Altitude = Annotated[float, between(*ALTITUDES)]
Speed = Annotated[float, between(*SPEEDS)]
SEVERITY = {"none": 0, "light": 3, "moderate": 4, "severe": 6}
"""Severity (index of exceedance of MIL-F-8785C, figure 7) of the named turbulence levels."""


def _check_turbulence(value: object) -> object:
    named = isinstance(value, str) and value in SEVERITY
    numbered = isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= 7
    if not (named or numbered):
        wanted = f"must be {', '.join(SEVERITY)} or a whole number from 0 to 7"
        raise PydanticCustomError("message", wanted)
    return value


def _check_plain(value: dict[str, Any]) -> dict[str, Any]:
    """Reject values that an option cannot have: dates, NaN and infinity."""

    items: list[object] = [value]
    while items:
        item = items.pop()
        if isinstance(item, Mapping | list):
            items += item.values() if isinstance(item, Mapping) else item
        elif not isinstance(item, (bool, int, str)) and not (isinstance(item, float) and math.isfinite(item)):
            raise PydanticCustomError("message", "must contain only finite numbers, texts, true or false")
    return value


def _check_ticks(value: float) -> float:
    if abs(value / 0.05 - round(value / 0.05)) > 1e-9:
        raise PydanticCustomError("message", "must be a multiple of 0.05 s, the interval of the guidance")
    return value


_Sd = Annotated[float, between(1e-3, 1e4)]
_Sd3 = Annotated[tuple[_Sd, _Sd, _Sd], ROWS]
Seed = Annotated[int, between(0, 2**53)]
Category = Literal["uav", "light", "transport", "fighter"]
"""Class of an aircraft."""


def _check_year(value: date) -> date:
    if not FIRST_YEAR <= value.year < LAST_YEAR:
        days = f"{FIRST_YEAR:g}-01-01 to {LAST_YEAR - 1:g}-12-31"
        raise PydanticCustomError("message", f"must be from {days}: the magnetic field is known then")
    return value


def _parse_date(value: object) -> object:
    """Convert an ISO date from the JSON of a flown profile; leave anything else to the validator."""
    if isinstance(value, str):
        with suppress(ValueError):
            return date.fromisoformat(value)
    return value


Date = Annotated[date, BeforeValidator(_parse_date), AfterValidator(_check_year)]


RunwayTable = make_table_type(Runway)


class StartTable(RunwayTable):  # type: ignore[misc, valid-type]
    """Start of the flight: position with ellipsoidal height, heading, true airspeed.

    On the ground the aircraft stands at the threshold of a runway, along its heading, and has no airspeed.
    """

    speed_mps: Speed | None = None
    """True airspeed. Default: the speed of the nearest [[trim]] of the aircraft."""
    on_ground: bool = False
    """Begin at rest: the start is the threshold of a runway."""


class WindTable(Table):
    """Wind, by the direction it blows from, constant or in layers; turbulence by name or index."""

    from_deg: Annotated[float, between(0, 360)] = 0.0
    """Direction that the wind blows from."""
    speed_mps: Annotated[float, between(0, 40)] = 0.0
    """Its speed."""
    layers: Annotated[tuple[make_table_type(WindLayer), ...], ROWS] = ()  # type: ignore[valid-type]
    """Wind by altitude, in place of the two."""
    thermals: make_table_type(ThermalsSpec) | None = None  # type: ignore[valid-type]
    """Thermals of a convective layer, and the sink between them."""
    turbulence: Annotated[Any, AfterValidator(_check_turbulence)] = "none"
    """Severity: "none", "light", "moderate", "severe", or its index in MIL-F-8785C, 0 to 7."""


class TerrainTable(Table):
    """The ground: flat, or by a file of heights. With a runway flat ground is at the height of that."""

    alt_m: Altitude | None = None
    """Height of flat ground above the WGS 84 ellipsoid. Default: 0."""
    file: str | None = None
    """Heights instead: an SRTM tile .hgt or an ESRI grid .asc in degrees, beside the profile or shipped."""
    geoid_m: Annotated[float, between(-120, 100)] = 0.0
    """Height of the zero level of the file above the ellipsoid; for SRTM the geoid height."""


class GustTable(make_table_type(Gust)):  # type: ignore[misc]
    """A 1 - cosine gust: air velocity at its peak, and durations of its rise, peak and fall."""

    north_mps: Annotated[float, between(-40, 40)] = 0.0
    """Velocity of the air at the peak, north."""
    east_mps: Annotated[float, between(-40, 40)] = 0.0
    """The same, east."""
    up_mps: Annotated[float, between(-40, 40)] = 0.0
    """The same, up."""


def _list_aiding(words: str) -> dict[str, Any]:
    titles = {"gnss": "GNSS receiver", **{name: row.title for name, row in INSTRUMENTS.items()}}
    return {
        kind: (str | None, Field(None, description=f"{words} {title}.")) for kind, title in titles.items()
    }


if TYPE_CHECKING:
    SensorsTable = Any
else:
    AssumedTable = create_model(
        "AssumedTable",
        __base__=Table,
        imu=(str | None, Field(None, description="The datasheet that filters assume for the IMU.")),
        **_list_aiding("Datasheet that the filters assume of the"),
    )
    """The datasheets that the filters assume, where they differ from the sensors on board."""
    SensorsTable = create_model(
        "SensorsTable",
        __base__=Table,
        imu=(str, Field(description="Catalog name or datasheet of the IMU.")),
        **_list_aiding("Catalog name or datasheet of the"),
        qnh_hpa=(
            Annotated[float, between(850, 1100)] | None,
            Field(None, description="Setting of a barometer with [physical]; default: standard."),
        ),
        assumed=(AssumedTable, Field(default_factory=AssumedTable)),
    )
    """The sensors on board, each a catalog name or the path of a datasheet."""


def choose_usual_units() -> SensorsTable:
    """Return the sensors of a profile with an external truth that names none."""
    return SensorsTable(imu="adis16475", gnss="l1-code", baro="bmp388")


class OutageTable(Table):
    """A time without GNSS."""

    start_s: Annotated[float, between(0, 86400)]
    """Start of the outage."""
    duration_s: Seconds
    """Duration without fixes."""


class InitialErrorSdTable(Table):
    """Standard deviations of the initial errors; position and velocity are north, east, down."""

    pos_m: _Sd3 = (3.0, 3.0, 5.0)
    """Position: north, east, down."""
    vel_mps: _Sd3 = (0.2, 0.2, 0.2)
    """Velocity: north, east, down."""
    tilt_deg: Annotated[float, between(1e-4, 30)] = 0.5
    """Roll and pitch."""
    heading_deg: Annotated[float, between(1e-4, 180)] = 2.0
    """Heading."""


class AlignmentTable(Table):
    """Initial state that the filters get; they find the rest by alignment.

    ``given``: all of it. ``level``: the position at standstill. ``hover``: nothing; the heading may
    be any. ``course``: nothing.
    """

    kind: Literal["given", "level", "hover", "course"] = "given"
    """Kind of the initial state that the filters get."""
    duration_s: Annotated[float, between(1, 3600)] | None = None
    """Longest standstill used, for "level" (default 60); length of the steady flight, for "hover" (4), or of
    the track, for "course" (10), less where the turn-on bias of a gyro would turn it by 15 deg."""
    drift_deg: Annotated[float, between(0, 90)] | None = None
    """Standard deviation of the angle from course to heading by wind and sideslip, for "course". Default:
    10."""


class EstimatorTable(Table):
    """A filter by its built-in name or ``module:Class``."""

    use: str
    """A built-in name, module:Class, file:SOLUTION or command:PROGRAM."""
    label: str | None = None
    """Its name in the results."""
    options: Annotated[dict[str, Any], AfterValidator(_check_plain)] = Field(default_factory=dict)
    """A table of its options."""
    timeout_s: Annotated[float, between(0.1, 1e6)] | None = None
    """Wall time of a flight, of a filter that is not built in."""


class EvaluationTable(Table):
    """End of the alignment window, and output rate of the solutions."""

    from_s: Annotated[float, between(0, 86400)] = 60.0
    """End of the alignment window: the metrics count from here on."""
    output_hz: Annotated[float, between(0.1, 400)] = 10.0
    """Output rate of the solution."""

    def window(self) -> EvaluationWindow:
        """Return the window of the evaluation."""
        return EvaluationWindow.of_document({"evaluation": self.model_dump()})


class RequirementTable(Table):
    """A metric that a filter has to keep."""

    metric: str
    """Its name: `bench list metrics`. `*` for a number is the worst: `outage_*_drift_h_m`."""
    most: float | None = None
    """Largest value allowed; this or `least`."""
    least: float | None = None
    """Smallest value allowed."""
    share: Annotated[float, between(0.01, 0.999)] = 0.95
    """Share of the runs of a campaign that has to keep it."""
    expected_share: Annotated[float, between(0.01, 0.9999)] | None = None
    """Fraction of the runs of a good filter within the limit, above `share`. Default: a fifth of the misses
    that `share` allows."""
    alpha: Annotated[float, between(1e-6, 0.5)] = 0.05
    """Largest probability of a wrong "met", and of a wrong "missed"."""
    beta: Annotated[float, between(1e-6, 0.5)] = 0.1
    """Probability that a good filter does not get "met" with the number of runs that bench advises."""
    plan: Literal["fixed", "sequential"] = "fixed"
    """"fixed": the number of runs is chosen beforehand; "sequential": runs are added until it is decided."""
    estimator: str | None = None
    """Label of the only filter that has to. Default: all."""
    id: str | None = None
    """Number of the requirement in your own documents, for the report and --junit."""
    text: str | None = None
    """Text of the requirement in your own documents."""


class AntennaTable(Table):
    """GNSS antenna relative to the IMU, for an external truth."""

    forward_m: Annotated[float, between(-100, 100)] = 0.0
    """Ahead of the IMU."""
    right_m: Annotated[float, between(-100, 100)] = 0.0
    """To its right."""
    down_m: Annotated[float, between(-100, 100)] = 0.0
    """Below it."""


class GuidanceTable(Table):
    """The estimate that guidance and legs read instead of the truth."""

    navigation: str
    """The filter that flies: built in or module:Class, and runs in pieces; "client": bench serve."""
    options: Annotated[dict[str, Any], AfterValidator(_check_plain)] = Field(default_factory=dict)
    """A table of its options."""
    period_s: Annotated[float, between(0.05, 10), AfterValidator(_check_ticks)] = 0.2
    """Time between two of its answers, a multiple of 0.05."""
    latency_s: Annotated[float, between(0.05, 5)] = 0.05
    """Time from the validity of an answer until guidance goes over to it, within 0.05 s more."""
    error: Literal["held", "state"] = "held"
    """"held": truth plus the error of the last answer; "state": the last answer itself."""


class ExperimentTable(Table):
    """The keys that all profiles share, whatever their truth is made of."""

    title: str | None = None
    """Title."""
    rate_hz: Literal[100, 200, 250, 400, 500, 1000] = 200
    """Rate of truth and IMU; 250 is for autopilots of `bench serve`."""
    seed: Seed = 0
    """All noise follows from this number."""
    date: Date | None = None
    """Day of the flight, for the magnetic field; of a receiver with [sky] its day, else 2026-01-01."""
    duration_s: Seconds | None = None
    """Length of the flight: the last leg is held until then, or cut."""
    sensors: SensorsTable
    gnss_outage: Annotated[tuple[OutageTable, ...], ROWS] = ()
    fault: Annotated[tuple[Annotated[FaultTable, Field(discriminator="kind")], ...], ROWS] = ()
    initial_error_sd: InitialErrorSdTable = Field(default_factory=InitialErrorSdTable)
    alignment: AlignmentTable = Field(default_factory=AlignmentTable)
    estimator: Annotated[tuple[EstimatorTable, ...], ROWS, Field(min_length=1)]
    evaluation: EvaluationTable = Field(default_factory=EvaluationTable)
    requirement: Annotated[tuple[RequirementTable, ...], ROWS] = ()


class ProfileTable(ExperimentTable):
    """The file of a profile with legs."""

    aircraft: str
    """Name of the aircraft."""
    jsbsim_root: str | None = None
    """JSBSim root of yours that it comes from."""
    turbulence_seed: Seed | None = None
    """Seed of the turbulence. Default: the seed of the noise."""
    start: StartTable
    runway: RunwayTable | None = None  # type: ignore[valid-type]
    wind: WindTable = Field(default_factory=WindTable)
    terrain: TerrainTable | None = None
    gust: Annotated[tuple[GustTable, ...], ROWS] = ()
    guidance: GuidanceTable | None = None
    leg: tuple[DeclaredTable, ...]


@functools.cache
def make_profile_table(legs: tuple[type[Leg], ...]) -> type[ProfileTable]:
    """Return the type of a profile file with legs of these kinds."""
    return create_model("ProfileTable", __base__=ProfileTable, leg=(build_leg_type(legs), ...))


class _ExternalTable(ExperimentTable):
    """A profile with an external truth; it has default sensors."""

    sensors: SensorsTable = Field(default_factory=choose_usual_units)
    estimator: Annotated[tuple[EstimatorTable, ...], ROWS, Field(min_length=1)] = Field(
        default_factory=lambda: (EstimatorTable(use="loose-15"),)
    )
    antenna: AntennaTable = Field(default_factory=AntennaTable)


class ScriptTable(_ExternalTable):
    """The file of a profile that flies a JSBSim script: a name in the jsbsim wheel or a path."""

    script: str
    """Its name in the jsbsim wheel, or a path to an .xml."""
    jsbsim_root: str | None = None
    """JSBSim root with its aircraft. Default: the wheel, or the root in whose scripts the .xml is."""
    turbulence_seed: Seed | None = None
    """Seed of JSBSim's random numbers, if the script sets none. Default: the seed of the noise."""
    category: Category | None = Field(default=None, alias="class")
    """Class of the aircraft: the limits that the sanity report uses. Default: by mass and engines."""


class TrackTable(Table):
    """Assumptions that turn a track of positions into a smooth motion of a vehicle."""

    vehicle: Literal["aircraft", "ground"] = "aircraft"
    """Motion: an aircraft flies coordinated turns; a ground vehicle keeps its wheels level and points along
    its path."""
    noise_m: Annotated[float, between(0.01, 100)] | None = None
    """Standard deviation of a fix, north and east each. Default: estimated."""
    vertical_noise_m: Annotated[float, between(0.01, 100)] | None = None
    """The same of its height."""
    wind_from_deg: Annotated[float, between(0, 360)] = 0.0
    """Direction that the wind blew from."""
    wind_speed_mps: Annotated[float, between(0, 40)] = 0.0
    """Its speed."""
    incidence_deg: Annotated[float, between(-10, 20)] = 3.0
    """Angle of the nose above the path through the air."""
    from_s: Annotated[float, between(0, 1e6)] = 0.0
    """Start of the part of the track that is used."""
    to_s: Annotated[float, between(1, 1e6)] | None = None
    """End of that part. Default: the end of the track."""
    bridge_s: Annotated[float, between(1, 600)] = 30.0
    """Longest interval between fixes that is bridged; at longer ones the track is cut."""


class TrajectoryTable(_ExternalTable):
    """Profile with a trajectory table, or a track, as its truth."""

    trajectory: str
    """A .csv, .parquet, .gpx, .kml, .igc or .nmea file, or a motion definition of gnss-ins-sim, beside the
    profile."""
    track: TrackTable | None = None
