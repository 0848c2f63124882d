"""Read the TOML file of a log; check its tables against each other and against the files they name."""

from __future__ import annotations

import datetime
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.sensor_specs import DEFAULT_DATE, AssumedSpecs
from bench.core.records.specs import DEFAULT_GUARD, EstimatorChoice, EvaluationWindow, Guard
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import as_toml
from bench.io.config import checks
from bench.io.config.datasheets import SENSORS
from bench.io.config.library import find_datasheet
from bench.io.config.log_tables import (
    SIDEWAYS,
    FileTable,
    GnssTable,
    LogTable,
    StartSpec,
    check_frames,
    check_vehicle,
    describe_frame,
    make_start,
)
from bench.io.config.overrides import (
    DatasheetChanges,
    describe_choice,
    less_empty,
    override,
    split_overrides,
)
from bench.io.config.profile import choose_estimators, make_choices
from bench.io.config.tables import check_table, collect_errors
from bench.io.config.toml_file import check_kind, read_toml
from bench.io.log_formats import (
    FORMATS,
    MATLAB,
    TABLES,
    find_format,
    guess_format,
    guess_solution,
    list_names,
)

RANGES = "ranges"
"""Format of a source that is the observation and navigation files of a receiver."""
WITHHOLD = 5
"""One fix in so many evaluates a log without a reference."""


@dataclass(frozen=True, slots=True)
class SourceSpec:
    """A file to read rows from."""

    path: Path
    format: str = "table"
    topic: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)  # name with unit -> name in the file
    time_offset: float = 0.0  # added to its times [s]
    axes: tuple[int, int, int] = (1, 2, 3)  # of the file along x, y, z; negative: reversed
    gyro_axes: tuple[int, int, int] = (1, 2, 3)  # those of the gyros of an IMU
    accel_axes: tuple[int, int, int] = (1, 2, 3)  # those of its accelerometers
    frame: str | None = None  # axes of local positions, such as "enu-flu"
    origin: tuple[float, ...] | None = None  # of them: latitude, longitude [deg], height [m], heading [deg]
    gravity: bool = False  # its accelerometers have the sign of gravity
    gyro_path: Path | None = None  # of the gyros, if they have times of their own
    gyro_columns: Mapping[str, str] = field(default_factory=dict)
    observations: tuple[Path, ...] = ()  # of a receiver whose fixes are solved; ``path`` is the first
    navigation: tuple[Path, ...] = ()


@dataclass(frozen=True, slots=True)
class ReferenceSpec:
    """Source, lever arm and mounting of the reference of a log."""

    source: SourceSpec
    point_b: tuple[float, float, float]  # relative to the IMU [m], b
    mounting: tuple[float, float, float]  # roll, pitch, yaw of its axes in b [rad]
    quality: tuple[int, ...]  # of the rows to use; empty: all
    align: str | None = None  # of local positions with the fixes: "se3", "yaw" or "none"
    place: tuple[float, float, float] | None = None  # [rad, rad, m] of rows without a position


@dataclass(frozen=True, slots=True)
class LogSpec:
    """A recording and how to use it, in SI."""

    name: str
    title: str
    imu: SourceSpec
    gnss: SourceSpec | None
    instruments: Mapping[str, SourceSpec]  # name of an instrument -> where its rows are
    ground_alt: float | None  # ellipsoidal height of the ground below a radar [m]; None: not told
    date: float  # decimal year
    sideways: bool  # it flies or walks sideways too: its course does not show its forward axis
    vibration: bool  # assume the noise of the record where it is more than that of the datasheet
    mounting: tuple[float, float, float]  # roll, pitch, yaw of the IMU axes in b [rad]
    misalignment: tuple[float, float, float]  # remaining rotation after the mounting, in b [rad]
    antenna_b: tuple[float, float, float]  # relative to the IMU [m], b
    velocity_offset: float  # time of the velocity minus time of the fix [s]
    clock_given: bool  # the log contains a time_offset_s of IMU or receiver
    velocity_sd: float | None  # of the velocity along each axis [m/s]; None: as the file or datasheet says
    quality: tuple[int, ...]  # of the fixes to use; empty: all
    quality_sd: Mapping[int, float]  # by class of quality: of each axis of a fix [m]; empty: not told
    assumed: AssumedSpecs
    start: StartSpec
    place: tuple[float, float, float] | None  # [deg, deg, m], of a log without gnss
    estimators: tuple[EstimatorChoice, ...]
    evaluation: EvaluationWindow
    until: float  # end of what counts [s]
    output_rate: float  # [Hz]
    withhold: int
    reference: ReferenceSpec | None  # None: withheld fixes judge
    document: Mapping[str, Any]  # the file with every default filled in

    @property
    def records(self) -> set[str]:
        """Names of the records that filters get."""
        ranges = self.gnss is not None and bool(self.gnss.observations)
        return {*self.instruments, *["fixes"] * (self.gnss is not None), *["observations"] * ranges}


def is_log(path: Path) -> bool:
    """Return whether a .toml file is a log: it names a recording."""
    return not {"file", "imu"}.isdisjoint(_read_keys(path))


def is_datasheet(path: Path) -> bool:
    """Return whether a .toml file is a datasheet, as `bench new log` may write one beside a log."""
    keys = _read_keys(path)
    return "source" in keys and keys.isdisjoint({"file", "imu", "aircraft", "profiles"})


def _read_keys(path: Path) -> set[str]:
    """Return the keys of a .toml file; none if it cannot be read."""
    try:
        return set(read_toml(path, str(path)))
    except ConfigError:
        return set()


def load_log(
    name: str,
    estimators: Sequence[str] | None = None,
    allow_code: bool = False,
    overrides: Mapping[str, Any] | None = None,
    guard: Guard = DEFAULT_GUARD,
) -> LogSpec:
    """Read and check a log file; the files it names are searched beside it.

    Parameters
    ----------
    name : str
        Path of the ``.toml`` file.
    filters, allow_code, overrides, guard
        As `bench.io.config.read_profile` takes them; the figures of a log are those of ``sensors.assumed``.

    Raises
    ------
    ConfigError
        One message for each problem in the file and the files it names.
    """
    path = Path(name)
    document = read_toml(path, name)
    check_kind(document, "a log", name)
    overrides, changes = split_overrides(overrides or {}, path.parent)
    at_top = {key: value for key, value in overrides.items() if "." not in key}
    document = _spread_file({**document, **at_top}, name)
    for key, value in overrides.items():
        if key not in at_top:
            document = override(document, key, value)
    if "gnss" not in document:
        document = {"estimator": [{"use": "ahrs"}], **document}
    wrong = [f"{name}: {line}" for line in checks.check_options(document)]
    try:
        table = check_table(LogTable, document, name)
    except ConfigError as error:
        raise ConfigError(*error.messages, *wrong) from None
    beside, place = path.parent, f"{name}: "
    withhold = table.evaluation.withhold
    if withhold is None:
        withhold = 0 if table.reference or table.gnss is None else WITHHOLD
        evaluation = table.evaluation.model_copy(update={"withhold": withhold})
        table = table.model_copy(update={"evaluation": evaluation})
    elif table.reference and withhold:
        wrong.append(f"{place}[evaluation] withhold is for a log without [reference]")
    elif table.gnss is None and withhold:
        wrong.append(f"{place}[evaluation] withhold has no effect without [gnss]")
    tables = {"imu": table.imu, "gnss": table.gnss, **{kind: getattr(table, kind) for kind in INSTRUMENTS}}
    sources = {
        kind: _find_source(row, kind, beside, place, wrong, table.date) for kind, row in tables.items()
    }
    reference = _find_source(table.reference, "reference", beside, place, wrong, table.date)
    assumed = _read_assumed(table, tables, changes, beside, place, wrong)
    wrong += [f"{place}{line}" for line in changes.check({}, dict(table.sensors.assumed))]
    choices = make_choices(table.estimator, overrides, beside)
    across = (
        checks.check_estimators(choices, of_log=True)
        + checks.check_requested(choices, estimators or (), of_log=True)
        + checks.check_requirements(table.requirement, choices)
        + checks.check_log_start(table)
        + check_frames(table, beside)
        + check_vehicle(table.vehicle, choices)
    )
    wrong += [f"{place}{line}" for line in across]
    if wrong:
        raise ConfigError(*wrong)
    choices = choose_estimators(name, choices, estimators, allow_code, guard)
    imu = sources["imu"]
    assert imu is not None
    return _make_spec(path.stem, path.name, table, imu, sources, reference, assumed, choices, changes)


def _read_assumed(
    table: LogTable,
    tables: Mapping[str, FileTable | None],
    changes: DatasheetChanges,
    beside: Path,
    place: str,
    wrong: list[str],
) -> dict[str, Any]:
    """Return the datasheets that the filters assume, by sensor; ``wrong`` gets a line for each problem."""
    assumed: dict[str, Any] = {}
    for kind in tables:
        datasheet = getattr(table.sensors.assumed, kind)
        if datasheet is None and tables[kind] is not None:
            wrong.append(
                f"{place}[sensors.assumed] {kind} is missing: name the datasheet that the filters assume"
            )
        with collect_errors(wrong, f"{place}[sensors.assumed] "):
            sheet = None if datasheet is None else find_datasheet(kind, datasheet, beside)
            with collect_errors(wrong):
                figures = changes.assumed.get(kind)
                assumed[kind] = None if sheet is None else SENSORS[kind](*sheet, figures)
    return assumed


def _make_spec(
    name: str,
    file: str,
    table: LogTable,
    imu: SourceSpec,
    sources: Mapping[str, SourceSpec | None],
    reference: SourceSpec | None,
    assumed: Mapping[str, Any],
    choices: tuple[EstimatorChoice, ...],
    changes: DatasheetChanges,
) -> LogSpec:
    """Return a log in SI units from checked tables."""
    gnss_at = table.gnss.position_m if table.gnss else table.imu.position_m

    def from_imu(at: tuple[float, float, float]) -> tuple[float, float, float]:
        x, y, z = (a - b for a, b in zip(at, table.imu.position_m, strict=True))
        return x, y, z

    withhold = table.evaluation.withhold
    assert withhold is not None
    velocity_sd = table.gnss.velocity_sd_mps if table.gnss else None
    if velocity_sd is not None:
        white = {"vel_white_sd": velocity_sd, "vel_v_white_sd": velocity_sd, "vel_markov_sd": 0.0}
        assumed = {**assumed, "gnss": replace(assumed["gnss"], **white)}
    return LogSpec(
        name=name,
        title=table.title or name,
        imu=imu,
        gnss=sources["gnss"],
        instruments={kind: source for kind in INSTRUMENTS if (source := sources[kind]) is not None},
        ground_alt=table.radar.ground_alt_m if table.radar else None,
        date=DEFAULT_DATE if table.date is None else _to_year(table.date),
        sideways=table.vehicle in SIDEWAYS,
        vibration=table.imu.vibration,
        mounting=_to_radians(table.imu.mounting_deg),
        misalignment=_to_radians(table.imu.misalignment_deg),
        antenna_b=from_imu(gnss_at),
        velocity_offset=float(table.gnss.velocity_offset_s) if table.gnss else 0.0,
        clock_given=any(one and "time_offset_s" in one.model_fields_set for one in (table.imu, table.gnss)),
        velocity_sd=velocity_sd,
        quality=table.gnss.quality if table.gnss else (),
        quality_sd=_read_classes(table.gnss.quality_sd_m if table.gnss else {}, file),
        assumed=AssumedSpecs(**assumed),
        start=make_start(table),
        place=table.place,
        estimators=choices,
        evaluation=table.evaluation.window(),
        until=math.inf if table.evaluation.until_s is None else float(table.evaluation.until_s),
        output_rate=float(table.evaluation.output_hz),
        withhold=withhold,
        reference=ReferenceSpec(
            reference,
            from_imu(table.reference.position_m),
            _to_radians(table.reference.mounting_deg),
            table.reference.quality,
            table.reference.align,
            table.place and (*_to_radians(table.place)[:2], table.place[2]),
        )
        if table.reference and reference
        else None,
        document=_make_document(table, name, choices, changes),
    )


def _spread_file(document: Mapping[str, Any], shown: str) -> dict[str, Any]:
    """Return a document with a table for each sensor, if one file at its top contains several.

    ``file = "all.mat"`` and ``imu = "imu1"`` are ``[imu] file = "all.mat"`` and ``topic = "imu1"``; a table
    without a file gets the file at the top.

    Raises
    ------
    ConfigError
        If a sensor has a name and the document no file, or a file and no sensor in it.
    """
    top = {key: document[key] for key in ("file", "format") if key in document}
    spread: dict[str, Any] = {}
    for kind in ("imu", "gnss", *INSTRUMENTS, "reference"):
        value = document.get(kind)
        if isinstance(value, str):
            if "file" not in top:
                text = f'is a name in a file; say file = "..." above it, or write a table [{kind}]'
                raise ConfigError(f"{shown}: {kind} = {as_toml(value)} {text}")
            spread[kind] = {**top, "topic": value}
        elif isinstance(value, dict) and "file" in top and {"file", "observations"}.isdisjoint(value):
            spread[kind] = {**top, **value}
    if top and not spread:
        text = "is for the sensors in that file, and none is there; name one: imu = ..."
        raise ConfigError(f"{shown}: {next(iter(top))} at the top {text}")
    return {**{key: value for key, value in document.items() if key not in top}, **spread}


def _find_source(
    row: FileTable | None,
    kind: str,
    beside: Path,
    place: str,
    wrong: list[str],
    day: datetime.date | None,
) -> SourceSpec | None:
    if row is None:
        return None
    if isinstance(row, GnssTable) and not (row.file and not row.observations and not row.navigation):
        return _find_ranges(row, beside, place, wrong)
    path = beside / row.file
    folder = os.path.isdir(path)  # unlike Path.is_dir, false for a name that is too long
    ending = path.suffix.lower()
    own = guess_solution(path) if kind == "reference" else None
    form = row.format or own or ("rosbag" if folder else guess_format(path))
    what = f"{place}[{kind}] file = {row.file!r}"
    if not os.path.exists(path):
        wrong.append(f"{what}: no such file beside the log")
    elif form is None:
        wrong.append(f"{what}: its ending does not show the format; set format to {', '.join(list_names())}")
    elif folder and form not in ("rosbag", own):
        wrong.append(f"{what} is a folder; only a ROS 2 bag or KITTI oxts may be one")
    elif form == "table" and ending not in (*TABLES, ".txt"):
        wrong.append(f"{what}: a table ends in {', '.join(TABLES)}, .txt")
    elif form != "table" and row.columns:
        wrong.append(f"{place}[{kind}] columns are for a table; format {form!r} has its own")
    elif row.topic is not None and not (find_format(form).topics or (form == "table" and ending == MATLAB)):
        listed = f"{', '.join(name for name, one in FORMATS.items() if one.topics)} and tables in {MATLAB}"
        wrong.append(f"{place}[{kind}] topic is for {listed}; format {form!r} has none")
    else:
        return SourceSpec(path, form, row.topic, dict(row.columns), **describe_frame(row, day, beside))
    return None


def _find_ranges(row: GnssTable, beside: Path, place: str, wrong: list[str]) -> SourceSpec | None:
    """Return the files of a receiver's ranges; ``wrong`` gets a line for each problem."""
    if row.file or not (row.observations and row.navigation):
        wrong.append(f"{place}[gnss] give either file, or both observations and navigation")
        return None
    keys = ["format", "topic", "columns", "velocity_offset_s", "velocity_sd_mps", "quality", "quality_sd_m"]
    found = [
        f"{key} is for fixes in a file, not for observations"
        for key in (*keys, "clock", "frame", "origin")
        if key in row.model_fields_set
    ]
    observations, navigation = (
        tuple(beside / name for name in files) for files in (row.observations, row.navigation)
    )
    found += [
        f"{path.name!r}: no such file beside the log"
        for path in (*observations, *navigation)
        if not path.is_file()
    ]
    wrong += [f"{place}[gnss] {line}" for line in found]
    if found:
        return None
    offset = float(row.time_offset_s)
    return SourceSpec(
        observations[0], RANGES, time_offset=offset, observations=observations, navigation=navigation
    )


def _to_year(day: datetime.date) -> float:
    """Return a day as a decimal year."""
    return day.year + (day.timetuple().tm_yday - 1) / 365.25


def _read_classes(table: Mapping[str, float], shown: str) -> dict[int, float]:
    """Return the sd of each class of quality; TOML has the classes as text."""
    if wrong := [name for name in table if not name.isdecimal()]:
        text = f"[gnss] quality_sd_m: {wrong[0]!r} must be a class of quality, a whole number"
        raise ConfigError(f"{shown}: {text}, such as 1 = 0.02")
    return {int(name): float(sd) for name, sd in table.items()}


def _to_radians(angles: tuple[float, float, float]) -> tuple[float, float, float]:
    return (math.radians(angles[0]), math.radians(angles[1]), math.radians(angles[2]))


def _make_document(
    table: LogTable, name: str, choices: Sequence[EstimatorChoice], changes: DatasheetChanges
) -> dict[str, Any]:
    document: dict[str, Any] = {"title": name, **table.model_dump(mode="json", exclude_none=True)}
    document["estimator"] = [describe_choice(choice) for choice in choices]
    changes.mark(document)
    return less_empty(document, "requirement")
