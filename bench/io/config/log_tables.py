"""The tables of the file of a log: keys, limits and defaults, in the units of the file."""

from __future__ import annotations

import datetime
import math
import os
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, WithJsonSchema, create_model
from pydantic_core import PydanticCustomError

from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.specs import EstimatorChoice
from bench.io.config.profile_tables import EstimatorTable, EvaluationTable, RequirementTable
from bench.io.config.tables import NOT_NEGATIVE, ROWS, Table, between
from bench.io.foreign.local_frames import is_origin
from bench.io.log_formats import FORMATS, TABLES, list_names
from bench.simulation.signals.gps_time import leap_seconds

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


_NAMES = "xyz"
_AXES_EXAMPLE = "three axes of the file with signs, each axis once, such as 'y, -x, z'"


def read_axes(text: str) -> tuple[int, int, int]:
    """Return the axes of the file along forward, right, down: 1, 2, 3 for x, y, z, negative if reversed.

    Raises
    ------
    ValueError
        If the text does not name each axis once.
    """
    found = [re.fullmatch(r"([+-]?) *([xyz])", part.strip()) for part in text.lower().split(",")]
    signed = [(-1 if one[1] == "-" else 1) * (_NAMES.index(one[2]) + 1) for one in found if one]
    if len(found) != 3 or sorted(map(abs, signed)) != [1, 2, 3]:
        raise ValueError(_AXES_EXAMPLE)
    return signed[0], signed[1], signed[2]


def is_right_handed(axes: tuple[int, int, int]) -> bool:
    """Return whether axes are a rotation of those in the file, without a reflection."""
    a, b, c = (abs(one) for one in axes)
    even = (a, b, c) in ((1, 2, 3), (2, 3, 1), (3, 1, 2))
    return even == (math.prod(axes) > 0)


def _check_axes(text: str) -> str:
    try:
        read_axes(text)
    except ValueError as error:
        raise PydanticCustomError("message", "must be {words}", {"words": str(error)}) from None
    return text


_Axes = Annotated[str, AfterValidator(_check_axes)]


class AxesTable(Table):
    """Axes by name, for a sensor with three of them."""

    axes: _Axes = "x, y, z"
    """Axes of the file along x, y, z, before ``mounting_deg``: with "y, -x, z", x is y of the file.
    A left-handed choice needs ``left_handed``."""
    left_handed: bool = False
    """Whether the file has left-handed axes: ``axes`` reflects them, for gyros and accelerometers alike."""


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
    clock: Literal["gps", "utc"] = "gps"
    """Time system of its times. "utc": the leap seconds of the ``date`` are added, so that all files have GPS
    time."""


class ImuTable(FileTable, AxesTable):
    """The IMU: roll, pitch, yaw of its axes relative to forward, right, down, then the misalignment."""

    gyro_file: str | None = None
    """Table of the gyros, if ``file`` has the accelerometers alone, or each its own times; joined by time."""
    gyro_columns: _Columns = Field(default_factory=dict)
    """Columns of ``gyro_file``, as ``columns``."""
    gyro_axes: _Axes | None = None
    """Axes of the gyros, where they differ from ``axes``. Any signs."""
    accel_axes: _Axes | None = None
    """Axes of the accelerometers, where they differ from ``axes``. Any signs."""
    sign: Literal["specific-force", "gravity"] = "specific-force"
    """Sign of the accelerometers: at rest, "specific-force" points up and "gravity" down, as on iOS."""
    mounting_deg: _Angles3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of its axes relative to forward, right, down."""
    misalignment_deg: _Angles3 = (0.0, 0.0, 0.0)
    """Additional rotation: roll, pitch, yaw."""
    position_m: _Arm3 = (0.0, 0.0, 0.0)
    """Position from any point on board: forward, right, down."""
    vibration: bool = False
    """Whether filters assume the noise from sample to sample of this record, if it is larger than on the
    datasheet."""


def _check_origin(value: tuple[float, ...]) -> tuple[float, ...]:
    if not is_origin(value):
        raise PydanticCustomError("message", "must be latitude, longitude [deg], height [m], heading [deg]")
    return value


def _check_place(value: tuple[float, ...]) -> tuple[float, ...]:
    if len(value) != 3 or not is_origin(value):
        raise PydanticCustomError("message", "must be latitude, longitude [deg], height [m]")
    return value


class LocalTable(FileTable):
    """A file whose positions may be in a local frame."""

    frame: str | None = None
    """Axes of local positions and of the body, such as "ned-frd". Default: by the format, or "enu-flu"."""
    origin: Annotated[tuple[float, ...], ROWS, AfterValidator(_check_origin)] | None = None
    """Latitude, longitude [deg], height [m] of a local frame, heading [deg] of its north axis."""


class GnssTable(LocalTable):
    """The GNSS receiver: position of its antenna, from the same point as the IMU, and the fixes to use.

    It gives fixes in a file, or ranges in those of a receiver, from which the fixes are solved.
    """

    file: str = ""
    """Path, relative to the log; left out with observations."""
    observations: Annotated[tuple[str, ...], ROWS] = ()
    """RINEX, UBX, SBF or RTCM 3 files of its ranges, a list of paths, in place of a file. Their times are in
    GPS time, seconds since 1980-01-06."""
    navigation: Annotated[tuple[str, ...], ROWS] = ()
    """RINEX navigation files, UBX with RXM-SFRBX, SBF or RTCM 3, with ``observations``."""

    position_m: _Arm3 = (0.0, 0.0, 0.0)
    """Position of the antenna from the same point."""
    velocity_offset_s: _Shift = 0.0
    """Time from a fix to its velocity."""
    velocity_sd_mps: Annotated[float, between(1e-3, 1e3)] | None = None
    """Standard deviation of its velocity along each axis. Default: as reported, else as on the datasheet."""
    quality: Annotated[tuple[int, ...], ROWS] = ()
    """Classes of the fixes that count. Default: all."""
    quality_sd_m: dict[str, Annotated[float, between(1e-4, 1e4)]] = Field(default_factory=dict)
    """A table: class of a fix, and its standard deviation."""


class BaroTable(FileTable):
    """The barometer."""


class MagTable(FileTable, AxesTable):
    """The magnetometer, in the axes of the vehicle, as ``axes`` gives them."""


class RadarTable(FileTable):
    """The range finder that looks down."""

    ground_alt_m: Annotated[float, between(-1000, 10000)] | None = None
    """Ellipsoidal height of the ground below it. Default: by its first reading and the first fix."""


class ReferenceTable(LocalTable):
    """Motion that another unit measured, the reference: of its point, its axes in the vehicle."""

    position_m: _Arm3 = (0.0, 0.0, 0.0)
    """The point whose motion it gives, from the same point as the IMU."""
    mounting_deg: _Angles3 = (0.0, 0.0, 0.0)
    """Roll, pitch, yaw of the sensor axes in the vehicle."""
    quality: Annotated[tuple[int, ...], ROWS] = ()
    """Classes of the rows that count. Default: all."""
    align: Literal["se3", "yaw", "none"] | None = None
    """Alignment of local positions with the fixes. Default: yaw, or none if their place is known."""


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

    kind: Literal["given", "level", "hover", "course"] | None = None
    """Kind of the initial state that the filters get. Default: "course", but "hover" for a multirotor or a
    person."""
    heading: Literal["magnetometer", "autopilot"] | None = None
    """Source of the heading, for "level" and "hover". Default: none; motion finds the heading."""
    duration_s: Annotated[float, between(1, 3600)] | None = None
    """Longest standstill used, for "level" (default 60); length of the track, for "course" (10, less
    where the turn-on bias of a gyro would turn it by 15 deg), or of steady flight, for "hover" (4)."""
    drift_deg: Annotated[float, between(0, 90)] | None = None
    """Standard deviation of the angle from course to heading, for "course". Default: 2, of a boat 10, of a
    fixed-wing aircraft 15."""
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
    vehicle: Literal["multirotor", "fixed-wing", "car", "boat", "person"] | None = None
    """Kind of vehicle, by which a course gives its heading, or does not. Default: unknown."""
    place: Annotated[tuple[float, ...], ROWS, AfterValidator(_check_place)] | None = None
    """Latitude, longitude [deg] and ellipsoidal height [m] of a log without [gnss]."""
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


SIDEWAYS = ("multirotor", "person")
"""Vehicles that move in any direction: their course gives no heading."""
_DRIFT_DEG = {"boat": 10.0, "fixed-wing": 15.0}  # by current and wind, as in 8 m/s across at 30 m/s


def find_kind(table: LogTable) -> str:
    """Return the kind of alignment, or its default for the vehicle."""
    otherwise = "level" if table.gnss is None else "course"
    return table.alignment.kind or ("hover" if table.vehicle in SIDEWAYS and table.gnss else otherwise)


def check_vehicle(vehicle: str | None, choices: Sequence[EstimatorChoice]) -> list[str]:
    """Return a line for each option of a filter that does not hold for a vehicle."""
    right = {"nonholonomic": "car", "coordinated": "fixed-wing"}
    return [
        f"estimator {choice.label}: {option} = true holds for vehicle = {other!r}, not for {vehicle!r}"
        for choice in choices
        for option, other in right.items()
        if choice.options.get(option) and vehicle not in (None, other)
    ]


def list_files(table: Any) -> dict[str, Any]:
    """Return the tables of a log with a file, by kind; None where it has none."""
    kinds = ("imu", "gnss", *INSTRUMENTS, "reference")
    return {kind: getattr(table, kind) for kind in kinds}


def check_frames(table: Any, beside: Path) -> list[str]:
    """Return a line for each wrong table of gyros, left-handed axes, and times in UTC without a date."""
    imu: ImuTable = table.imu
    wrong = ["[imu] gyro_columns needs gyro_file"] if imu.gyro_columns and imu.gyro_file is None else []
    if imu.gyro_file is not None:
        path = beside / imu.gyro_file
        what = f"[imu] gyro_file = {imu.gyro_file!r}"
        if not os.path.isfile(path):  # unlike Path.is_file, false for a name that is too long
            wrong.append(f"{what}: no such file beside the log")
        elif path.suffix.lower() not in (*TABLES, ".txt") or imu.format not in (None, "table"):
            wrong.append(f"{what}: file and gyro_file must be tables, {', '.join(TABLES)} or .txt")
    for kind, row in list_files(table).items():
        if isinstance(row, AxesTable) and is_right_handed(read_axes(row.axes)) == row.left_handed:
            hand = "right-handed" if row.left_handed else "left-handed"
            advice = "reverse or exchange an axis, or set left_handed = "
            advice += (
                "false" if row.left_handed else "true if the axes of the file are left-handed themselves"
            )
            wrong.append(f"[{kind}] axes = {row.axes!r} are {hand}; {advice}")
        if row is not None and row.clock == "utc" and table.date is None:
            wrong.append(f"[{kind}] clock = 'utc' needs a date above all tables: date = 2024-05-31")
    return wrong


def describe_frame(row: FileTable, day: datetime.date | None, beside: Path) -> dict[str, Any]:
    """Return the offset of the times of a table to GPS time [s], its axes, sign of forces, and gyros."""
    leap = leap_seconds(day) if row.clock == "utc" and day is not None else 0
    frame: dict[str, Any] = {"time_offset": float(row.time_offset_s) + leap}
    if isinstance(row, LocalTable):
        frame |= {"frame": row.frame, "origin": row.origin}
    if isinstance(row, AxesTable):
        frame["axes"] = read_axes(row.axes)
    if isinstance(row, ImuTable):
        frame["gyro_axes"] = read_axes(row.gyro_axes or row.axes)
        frame["accel_axes"] = read_axes(row.accel_axes or row.axes)
        frame["gravity"] = row.sign == "gravity"
        frame["gyro_path"] = None if row.gyro_file is None else beside / row.gyro_file
        frame["gyro_columns"] = dict(row.gyro_columns)
    return frame


@dataclass(frozen=True, slots=True)
class StartSpec:
    """Initial state of the filters, and how they find the rest."""

    alignment: str  # "given", "level", "hover" or "course"
    at: float  # earliest start, since the first row of the IMU [s]
    align_for: float  # level: longest standstill to use, course: length of the track to use [s]
    drift_sd: float  # course: sd of the angle between track and heading [rad]
    attitude: tuple[float, float, float]  # given: roll, pitch, heading [rad]
    tilt_sd: float  # given [rad]
    heading_sd: float  # given, or of its source [rad]
    heading_from: str  # level, hover: "magnetometer" or "autopilot"; empty: unknown


def make_start(table: LogTable) -> StartSpec:
    """Return the initial state of a log in SI units."""
    row, kind = table.alignment, find_kind(table)
    attitude = (row.roll_deg or 0.0, row.pitch_deg or 0.0, row.heading_deg or 0.0)
    default = {"course": 10.0, "hover": 4.0}.get(kind, 60.0)  # as in a profile
    drift_deg = _DRIFT_DEG.get(table.vehicle or "", 2.0) if row.drift_deg is None else row.drift_deg
    heading_sd = 10.0 if row.heading else 2.0
    return StartSpec(
        alignment=kind,
        at=float(row.at_s),
        align_for=float(default if row.duration_s is None else row.duration_s),
        drift_sd=math.radians(drift_deg),
        attitude=(math.radians(attitude[0]), math.radians(attitude[1]), math.radians(attitude[2])),
        tilt_sd=math.radians(0.5 if row.tilt_sd_deg is None else row.tilt_sd_deg),
        heading_sd=math.radians(heading_sd if row.heading_sd_deg is None else row.heading_sd_deg),
        heading_from=row.heading or "",
    )
