"""A log of a user: what was recorded, how it was mounted, what filters are told -> ``LogSpec`` in SI."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field
from pydantic_core import PydanticCustomError

from bench.config import checks
from bench.config.datasheets import SENSORS
from bench.config.library import sensor_file
from bench.config.profile_tables import EstimatorTable, EvaluationTable, Metres3
from bench.config.tables import NOT_NEGATIVE, ROWS, ConfigError, Table, between, checked, noting, read
from bench.specs import AssumedSpecs, EstimatorChoice

ENDINGS = (".csv", ".parquet", ".mat")
"""Endings of the files a log may name."""

_Angle = Annotated[float, between(-360, 360)]
_Angles3 = Annotated[tuple[_Angle, _Angle, _Angle], ROWS]
_Arm = Annotated[float, between(-100, 100)]
_Arm3 = Annotated[tuple[_Arm, _Arm, _Arm], ROWS]
_Shift = Annotated[float, between(-10, 10)]


def _names(value: dict[str, str]) -> dict[str, str]:
    twice = [name for name, count in Counter(value.values()).items() if count > 1]
    if twice:
        raise PydanticCustomError("message", f"must not name the column '{twice[0]}' twice")
    return value


_Columns = Annotated[dict[str, str], AfterValidator(_names)]


class _FileTable(Table):
    """A file, what it calls its columns, and how its clock is off."""

    file: str
    columns: _Columns = Field(default_factory=dict)
    time_offset_s: _Shift = 0.0


class ImuTable(_FileTable):
    """The IMU: from its axes to forward, right, down by roll, pitch, yaw, then by the misalignment."""

    mounting_deg: _Angles3 = (0.0, 0.0, 0.0)
    misalignment_deg: _Angles3 = (0.0, 0.0, 0.0)
    position_m: _Arm3 = (0.0, 0.0, 0.0)


class GnssTable(_FileTable):
    """The GNSS receiver: where its antenna is, from the same point as the IMU, and which fixes count."""

    position_m: _Arm3 = (0.0, 0.0, 0.0)
    velocity_offset_s: _Shift = 0.0
    quality: Annotated[tuple[int, ...], ROWS] = ()


class BaroTable(_FileTable):
    """The barometer."""


class AssumedTable(Table):
    """The datasheets the filters believe."""

    imu: str
    gnss: str | None = None
    baro: str | None = None


class SensorsTable(Table):
    """What is told of the sensors."""

    assumed: AssumedTable


class InitialTable(Table):
    """How a filter starts: attitude given, or found by levelling and the course over ground."""

    alignment: Literal["given", "level", "course"] = "course"
    at_s: Annotated[float, between(0, 86400)] | None = None
    roll_deg: _Angle | None = None
    pitch_deg: Annotated[float, between(-90, 90)] | None = None
    heading_deg: _Angle | None = None
    pos_sd_m: Metres3 | None = None
    vel_sd_mps: Metres3 | None = None
    tilt_sd_deg: Annotated[float, between(1e-4, 30)] = 2.0
    heading_sd_deg: Annotated[float, between(1e-4, 180)] = 5.0
    min_speed_mps: Annotated[float, between(0.1, 100)] = 3.0


class LogEvaluationTable(EvaluationTable):
    """Every so manyth fix is kept from the filters and judges them; 0 keeps none."""

    withhold: Annotated[int, NOT_NEGATIVE] = 5


class LogTable(Table):
    """The file of a log."""

    title: str | None = None
    imu: ImuTable
    gnss: GnssTable | None = None
    baro: BaroTable | None = None
    sensors: SensorsTable
    initial: InitialTable = InitialTable()
    estimator: Annotated[tuple[EstimatorTable, ...], ROWS] = (EstimatorTable(use="loose-15"),)
    evaluation: LogEvaluationTable = LogEvaluationTable()


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """A file to read rows from."""

    path: Path
    columns: Mapping[str, str] = field(default_factory=dict)  # name with unit -> what the file calls it
    time_offset: float = 0.0  # added to its times [s]


@dataclass(frozen=True, slots=True)
class InitialSpec:
    """How a filter starts."""

    alignment: str  # "given", "level" or "course"
    at: float | None  # since the first row of the IMU; None: as soon as can be [s]
    roll: float | None  # [rad]
    pitch: float | None  # [rad]
    heading: float | None  # [rad]
    pos_sd: tuple[float, float, float] | None  # n; None: of the first fix [m]
    vel_sd: tuple[float, float, float] | None  # [m/s]
    tilt_sd: float  # [rad]
    heading_sd: float  # [rad]
    min_speed: float  # over ground, that a course needs [m/s]


@dataclass(frozen=True, slots=True)
class LogSpec:
    """A recording and how it is to be used."""

    name: str
    title: str
    imu: SourceSpec
    gnss: SourceSpec | None
    baro: SourceSpec | None
    mounting: tuple[float, float, float]  # roll, pitch, yaw of the axes of the IMU in b [rad]
    misalignment: tuple[float, float, float]  # of what the mounting gives, in b [rad]
    antenna_b: tuple[float, float, float]  # relative to the IMU [m], b
    velocity_offset: float  # from the time of a fix to that of its velocity [s]
    quality: tuple[int, ...]  # of the fixes to use; none: all
    assumed: AssumedSpecs
    initial: InitialSpec
    estimators: tuple[EstimatorChoice, ...]
    evaluation_from: float  # [s]
    output_rate: float  # [Hz]
    withhold: int
    document: Mapping[str, Any]  # the file with every default filled in


def load_log(name: str, estimators: Sequence[str] | None = None) -> LogSpec:
    """Return a log file in SI, checked; what it names is looked for beside it.

    Parameters
    ----------
    name : str
        Path of the ``.toml`` file.
    estimators : sequence of str or None
        Estimators to use instead of the file's: its labels, built-in names or ``module:Class``.

    Raises
    ------
    ConfigError
        All that is wrong with the file and the files it names, one message each.
    """
    path = Path(name)
    document = read(path, name)
    table = checked(LogTable, document, name)
    wrong: list[str] = []
    beside, place = path.parent, f"{name}: "
    given = {"imu": table.imu, "gnss": table.gnss, "baro": table.baro}
    sources = {kind: _source(row, kind, beside, place, wrong) for kind, row in given.items()}
    assumed: dict[str, Any] = {}
    for kind in SENSORS:
        asked = getattr(table.sensors.assumed, kind)
        if asked is None and given[kind] is not None:
            wrong.append(
                f"{place}[sensors.assumed] {kind} is missing: which datasheet do the filters believe?"
            )
        with noting(wrong, f"{place}[sensors.assumed] "):
            sheet = None if asked is None else sensor_file(kind, asked, beside)
            with noting(wrong):
                assumed[kind] = None if sheet is None else SENSORS[kind](*sheet)
    choices = tuple(
        EstimatorChoice(r.use, r.label or r.use.rpartition(":")[2], dict(r.options)) for r in table.estimator
    )
    wrong += [
        f"{place}{line}" for line in checks.estimators(choices) + checks.asked(choices, estimators or ())
    ]
    wrong += [f"{place}{line}" for line in _starts(table)]
    if wrong:
        raise ConfigError(*wrong)
    if estimators:
        by_label = {choice.label: choice for choice in choices}
        choices = tuple(
            by_label.get(use) or EstimatorChoice(use, use.rpartition(":")[2])
            for use in dict.fromkeys(estimators)
        )
    imu = sources["imu"]
    assert imu is not None
    gnss_at = table.gnss.position_m if table.gnss else table.imu.position_m
    return LogSpec(
        name=path.stem,
        title=table.title or path.stem,
        imu=imu,
        gnss=sources["gnss"],
        baro=sources["baro"],
        mounting=_radians(table.imu.mounting_deg),
        misalignment=_radians(table.imu.misalignment_deg),
        antenna_b=tuple(a - b for a, b in zip(gnss_at, table.imu.position_m, strict=True)),  # type: ignore[arg-type]
        velocity_offset=float(table.gnss.velocity_offset_s) if table.gnss else 0.0,
        quality=table.gnss.quality if table.gnss else (),
        assumed=AssumedSpecs(imu=assumed["imu"], gnss=assumed["gnss"], baro=assumed["baro"]),
        initial=_initial(table.initial),
        estimators=choices,
        evaluation_from=float(table.evaluation.from_s),
        output_rate=float(table.evaluation.output_hz),
        withhold=table.evaluation.withhold,
        document=_document(table, path.stem, choices),
    )


def _choice(use: str, label: str | None = None, options: Mapping[str, Any] | None = None) -> EstimatorChoice:
    return EstimatorChoice(use, label or use.rpartition(":")[2], dict(options or {}))


def _source(
    row: _FileTable | None, kind: str, beside: Path, place: str, wrong: list[str]
) -> SourceSpec | None:
    if row is None:
        return None
    path = beside / row.file
    if path.suffix.lower() not in ENDINGS:
        wrong.append(f"{place}[{kind}] file = {row.file!r} must end in {', '.join(ENDINGS)}")
    elif not path.is_file():
        wrong.append(f"{place}[{kind}] file = {row.file!r}: no such file beside the log")
    else:
        return SourceSpec(path, dict(row.columns), float(row.time_offset_s))
    return None


def _starts(table: LogTable) -> list[str]:
    """Check that the start is neither told too little nor what it would not read."""
    start = table.initial
    needed = {"given": ("roll_deg", "pitch_deg", "heading_deg"), "level": ("heading_deg",), "course": ()}
    told = [key for key in ("roll_deg", "pitch_deg", "heading_deg") if getattr(start, key) is not None]
    wanted = needed[start.alignment]
    wrong = [
        f"[initial] {key} is missing; alignment = {start.alignment!r} needs it"
        for key in wanted
        if key not in told
    ]
    wrong += [
        f"[initial] {key} is not read with alignment = {start.alignment!r}; leave it out"
        for key in told
        if key not in wanted
    ]
    if table.gnss is None:
        wrong.append("[gnss] is missing: a start needs a position, and a judgement the fixes")
    return wrong


def _initial(row: InitialTable) -> InitialSpec:
    def angle(value: float | None) -> float | None:
        return None if value is None else math.radians(value)

    return InitialSpec(
        alignment=row.alignment,
        at=row.at_s,
        roll=angle(row.roll_deg),
        pitch=angle(row.pitch_deg),
        heading=angle(row.heading_deg),
        pos_sd=row.pos_sd_m,
        vel_sd=row.vel_sd_mps,
        tilt_sd=math.radians(row.tilt_sd_deg),
        heading_sd=math.radians(row.heading_sd_deg),
        min_speed=row.min_speed_mps,
    )


def _radians(angles: tuple[float, float, float]) -> tuple[float, float, float]:
    return (math.radians(angles[0]), math.radians(angles[1]), math.radians(angles[2]))


def _document(table: LogTable, name: str, choices: Sequence[EstimatorChoice]) -> dict[str, Any]:
    document: dict[str, Any] = {"title": name, **table.model_dump(mode="json", exclude_none=True)}
    document["estimator"] = [
        {"use": choice.use, "label": choice.label, "options": dict(choice.options)} for choice in choices
    ]
    return document
