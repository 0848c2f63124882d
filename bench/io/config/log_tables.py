"""The tables of the file of a log: keys, limits and defaults, in the units of the file."""

from __future__ import annotations

import datetime
from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, WithJsonSchema, create_model
from pydantic_core import PydanticCustomError

from bench.core.records.instruments import INSTRUMENTS
from bench.io.config.profile_tables import EstimatorTable, EvaluationTable, RequirementTable
from bench.io.config.tables import NOT_NEGATIVE, ROWS, Table, between
from bench.io.log_formats import FORMATS, list_names

_Angle = Annotated[float, between(-360, 360)]
_Angles3 = Annotated[tuple[_Angle, _Angle, _Angle], ROWS]
_Arm = Annotated[float, between(-100, 100)]
_Arm3 = Annotated[tuple[_Arm, _Arm, _Arm], ROWS]
_Shift = Annotated[float, between(-10, 10)]
_Clock = Annotated[float, between(-1e10, 1e10)]


def _check_column_names(value: dict[str, str]) -> dict[str, str]:
    twice = [name for name, count in Counter(value.values()).items() if count > 1]
    if twice:
        raise PydanticCustomError("message", f"must not name the column '{twice[0]}' twice")
    return value


_Columns = Annotated[dict[str, str], AfterValidator(_check_column_names)]


def _check_format(name: str) -> str:
    if name not in list_names():
        words = ", ".join(map(repr, list_names()))
        raise PydanticCustomError("message", "must be {words}", {"words": words})
    return name


_FORMAT_SCHEMA = {"anyOf": [{"enum": [*FORMATS]}, {"type": "string"}]}  # an editor completes those of bench
_Format = Annotated[str, AfterValidator(_check_format), WithJsonSchema(_FORMAT_SCHEMA)]


class FileTable(Table):
    """A file, its format, its column names, and the offset of its clock."""

    file: str
    """Path, relative to the log."""
    format: _Format | None = None
    """Format of the file. Default: the format of its ending."""
    topic: str | None = None
    """Name in the file: a message, a topic or a structure."""
    columns: _Columns = Field(default_factory=dict)
    """Columns: the name with quantity and unit, and the name in the file."""
    time_offset_s: _Clock = 0.0
    """Added to its times."""


class ImuTable(FileTable):
    """The IMU: roll, pitch, yaw of its axes relative to forward, right, down, then the misalignment."""

    mounting_deg: _Angles3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its axes relative to forward, right, down."""
    misalignment_deg: _Angles3 = (0.0, 0.0, 0.0)
    """Additional rotation: roll, pitch, yaw."""
    position_m: _Arm3 = (0.0, 0.0, 0.0)
    """Position from any point on board: forward, right, down."""
    vibration: bool = False
    """Whether filters assume the noise from sample to sample of this record, if it is larger than on the
    datasheet."""


class GnssTable(FileTable):
    """The GNSS receiver: position of its antenna, from the same point as the IMU, and the fixes to use.

    It gives fixes in a file, or ranges in those of a receiver, from which the fixes are solved.
    """

    file: str = ""
    """Path, relative to the log; left out with observations."""
    observations: Annotated[tuple[str, ...], ROWS] = ()
    """RINEX or UBX files of its ranges, a list of paths, in place of a file. Their times are in GPS time,
    seconds since 1980-01-06."""
    navigation: Annotated[tuple[str, ...], ROWS] = ()
    """RINEX navigation files, with ``observations``."""

    position_m: _Arm3 = (0.0, 0.0, 0.0)
    """Position of the antenna from the same point."""
    velocity_offset_s: _Shift = 0.0
    """Time from a fix to its velocity."""
    quality: Annotated[tuple[int, ...], ROWS] = ()
    """Classes of the fixes that count. Default: all."""
    quality_sd_m: dict[str, Annotated[float, between(1e-4, 1e4)]] = Field(default_factory=dict)
    """A table: class of a fix, and its standard deviation."""


class BaroTable(FileTable):
    """The barometer."""


class MagTable(FileTable):
    """The magnetometer, in the axes of the vehicle."""


class RadarTable(FileTable):
    """The range finder that looks down."""

    ground_alt_m: Annotated[float, between(-1000, 10000)] | None = None
    """Ellipsoidal height of the ground below it. Default: by its first reading and the first fix."""


class ReferenceTable(FileTable):
    """Motion that another unit measured, the reference: of its point, its axes in the vehicle."""

    position_m: _Arm3 = (0.0, 0.0, 0.0)
    """The point whose motion it gives, from the same point as the IMU."""
    mounting_deg: _Angles3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the sensor axes in the vehicle."""
    quality: Annotated[tuple[int, ...], ROWS] = ()
    """Classes of the rows that count. Default: all."""


class _AssumedTable(Table):
    imu: str
    """Datasheet of the IMU that the filters assume."""
    gnss: str | None = None
    """Datasheet of the GNSS receiver; required with [gnss]."""


_ASSUMED: dict[str, Any] = {
    name: (str | None, Field(None, description=f"Datasheet of the {row.title}; required with [{name}]."))
    for name, row in INSTRUMENTS.items()
}
LogAssumedTable: Any = create_model("LogAssumedTable", __base__=_AssumedTable, **_ASSUMED)
"""The datasheets that the filters assume."""


class LogSensorsTable(Table):
    """Datasheets of the sensors of a log."""

    assumed: LogAssumedTable


class LogAlignmentTable(Table):
    """Initial state that the filters get; they find the rest by alignment.

    ``given``: position and velocity of a fix, and this attitude. ``level``: the position at standstill.
    ``hover``: position, velocity and tilt by fixes and IMU in steady flight. ``course``: nothing.
    """

    kind: Literal["given", "level", "hover", "course"] = "course"
    """Kind of the initial state that the filters get."""
    heading: Literal["magnetometer", "autopilot"] | None = None
    """Source of the heading, for "level" and "hover". Default: none; motion finds the heading."""
    duration_s: Annotated[float, between(1, 3600)] | None = None
    """Longest standstill used, for "level" (default 60); length of the track, for "course" (10), or of
    steady flight, for "hover" (4)."""
    drift_deg: Annotated[float, between(0, 90)] | None = None
    """Standard deviation of the angle from course to heading, for "course". Default: 2."""
    at_s: Annotated[float, between(0, 86400)] = 0.0
    """Earliest start, since the first row of the IMU."""
    roll_deg: _Angle | None = None
    """With "given"."""
    pitch_deg: Annotated[float, between(-90, 90)] | None = None
    """With "given"."""
    heading_deg: _Angle | None = None
    """With "given"."""
    tilt_sd_deg: Annotated[float, between(1e-4, 30)] | None = None
    """Standard deviation of roll and pitch, for "given". Default: 0.5."""
    heading_sd_deg: Annotated[float, between(1e-4, 180)] | None = None
    """Standard deviation of the heading. Default: 2 with "given", 10 with a magnetometer or an autopilot."""


class LogEvaluationTable(EvaluationTable):
    """Withhold every n-th fix from the filters to evaluate them by; 0 withholds none.

    Left out: 5, or 0 where a reference evaluates.
    """

    until_s: Annotated[float, between(0, 1e6)] | None = None
    """End of the part that is used, for example before a crash. Default: the end of the recording."""
    withhold: Annotated[int, NOT_NEGATIVE] | None = None
    """Number N: every Nth fix is withheld from the filters and evaluates them; 0: none. Default: 5, or 0
    with a reference."""


class _LogHead(Table):
    title: str | None = None
    """Title."""
    date: datetime.date | None = None
    """Day of the recording, for the magnetic field; required with a magnetometer."""
    imu: ImuTable
    gnss: GnssTable | None = None


def _list_files() -> Iterator[tuple[str, Any]]:
    own = {"baro": BaroTable, "mag": MagTable, "radar": RadarTable}
    for name, row in INSTRUMENTS.items():
        words, made = f"The {row.title}.", f"{name.capitalize()}Table"
        table: Any = own.get(name) or create_model(made, __base__=FileTable, __doc__=words)
        yield name, (table | None, None)


_LogFiles: Any = create_model("_LogFiles", __base__=_LogHead, **dict(_list_files()))


class LogTable(_LogFiles):  # type: ignore[misc]
    """The file of a log."""

    reference: ReferenceTable | None = None
    sensors: LogSensorsTable
    alignment: LogAlignmentTable = Field(default_factory=LogAlignmentTable)
    estimator: Annotated[tuple[EstimatorTable, ...], ROWS] = (EstimatorTable(use="loose-15"),)
    evaluation: LogEvaluationTable = Field(default_factory=LogEvaluationTable)
    requirement: Annotated[tuple[RequirementTable, ...], ROWS] = ()
