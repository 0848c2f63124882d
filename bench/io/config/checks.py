"""Checks across the tables of a profile; each returns one line for each problem."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

from bench.core.files.installed import find_installed
from bench.core.records.flight_specs import AircraftSpec, Flight, TableSpec
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.specs import AUTOPILOT, CLIENT, EstimatorChoice
from bench.core.words.exceptions import FlightError
from bench.core.words.wording import quantity, suggest
from bench.evaluation.requirements.required_metrics import is_metric
from bench.io.config.log_tables import SIDEWAYS, LogTable, find_kind
from bench.io.config.profile_tables import ExperimentTable, RequirementTable
from bench.navigation.built_in import BUILT_IN
from bench.navigation.error_state_filter.rough_heading import UNKNOWN_HEADING_SD
from bench.simulation.flight.model_files import rotor_figures
from bench.simulation.signals.magnetic import FIRST_YEAR, LAST_YEAR

_TICKS = 20  # set-points of guidance a second
LABEL = re.compile(r"[A-Za-z0-9_.-]{1,100}")
"""Label of a filter, a part of the names of its files."""
_PLACE = ("imu_forward", "imu_right", "imu_down")
_DRIFT_DEG = 10.0  # 1 sigma: a crosswind of a sixth of the airspeed, unknown to the filter


def check_rates(table: ExperimentTable, sensors: Mapping[str, Any]) -> list[str]:
    """Check that fixes and outputs fall on epochs of the truth."""
    asked_rates = {
        f"[sensors] {kind} = {spec.name!r}: rate_hz": spec.rate
        for kind, spec in sensors.items()
        if kind != "imu" and spec is not None
    }
    asked_rates["[evaluation] output_hz"] = table.evaluation.output_hz
    guidance = getattr(table, "guidance", None)
    served = guidance is not None and guidance.navigation == CLIENT
    wrong = []
    if table.rate_hz % _TICKS and not served:
        what = f"rate_hz = {table.rate_hz} Hz is for an autopilot of bench serve"
        wrong.append(f"{what}; other flights need a multiple of {_TICKS} Hz")
    return wrong + [
        f"{key} = {rate:g} Hz must divide rate_hz = {table.rate_hz} Hz"
        for key, rate in asked_rates.items()
        if abs(table.rate_hz / rate - round(table.rate_hz / rate)) > 1e-9
    ]


def check_outages(table: ExperimentTable) -> list[str]:
    """Check that outages do not overlap and, like the alignment window, lie inside the flight."""
    wrong = []
    rows = sorted(
        (row.start_s, row.start_s + row.duration_s, number) for number, row in enumerate(table.gnss_outage, 1)
    )
    for (start, end, number), (later, _, other) in itertools.pairwise(rows):
        if later < end:
            what = f"[[gnss_outage]] {other}: {quantity('start_s', later)}"
            wrong.append(f"{what} overlaps [[gnss_outage]] {number} ({start:g} to {end:g} s)")
    length = math.inf if table.duration_s is None else table.duration_s
    for _, end, number in rows:
        if end > length:
            what = f"[[gnss_outage]] {number}: its end at {end:g} s"
            wrong.append(f"{what} is outside the flight, 0 to {length:g} s")
    if rows and table.sensors.gnss is None:
        wrong.append("[[gnss_outage]] 1: there is no gnss in [sensors] to lose")
    if outside := table.evaluation.window().describe_outside(length, "flight"):
        wrong.append(outside)
    return wrong


def check_requirements(rows: Sequence[RequirementTable], choices: Sequence[EstimatorChoice]) -> list[str]:
    """Check that each requirement names a metric, one limit and an existing filter."""
    wrong, labels = [], [choice.label for choice in choices]
    for k, row in enumerate(rows, 1):
        place = f"[[requirement]] {k}"
        if not is_metric(row.metric):
            wrong.append(f"{place}: no metric {row.metric!r}: bench list metrics")
        if (row.most is None) == (row.least is None):
            wrong.append(f"{place}: give most or least, one of them")
        if row.expected_share is not None and row.expected_share <= row.share:
            least = quantity("share", row.share)
            wrong.append(f"{place}: {quantity('expected_share', row.expected_share)} must be above {least}")
        if row.estimator is not None and row.estimator not in labels:
            wrong.append(f"{place}: no filter {row.estimator!r}; there are {', '.join(labels)}")
    return wrong


def check_alignment(table: ExperimentTable) -> list[str]:
    """Check that an alignment has what it needs, and ends before the evaluation begins."""
    asked = table.alignment
    wrong, kind = [], f"kind = '{asked.kind}'"
    if asked.kind == "given" and asked.duration_s is not None:
        wrong.append(f"[alignment] duration_s is for 'level', 'hover' or 'course'; {kind} takes no time")
    if asked.kind != "course" and asked.drift_deg is not None:
        wrong.append(f"[alignment] drift_deg is for kind = 'course', not for {kind}")
    if asked.kind in ("hover", "course") and table.sensors.gnss is None:
        wrong.append(f"[alignment] {kind} needs a gnss in [sensors]")
    duration = choose_alignment_time(table)
    if asked.kind != "given" and duration > (begin := table.evaluation.window().begin):
        wrong.append(
            f"[alignment] {quantity('duration_s', duration)} must not go beyond [evaluation] "
            f"{quantity('from_s', begin)}"
        )
    return wrong


def choose_alignment_time(table: ExperimentTable) -> float:
    """Return the duration of an alignment [s]; default 60 s at rest, 4 s in a hover, 10 s on the move."""
    if table.alignment.duration_s is not None:
        return table.alignment.duration_s
    return {"hover": 4.0, "course": 10.0}.get(table.alignment.kind, 60.0)


def choose_drift(table: ExperimentTable) -> float:
    """Return the standard deviation of the angle from course to heading [rad]; of a hover it is any."""
    if table.alignment.kind == "hover":
        return UNKNOWN_HEADING_SD
    return math.radians(_DRIFT_DEG if table.alignment.drift_deg is None else table.alignment.drift_deg)


def check_sensors(table: ExperimentTable, sensors: Mapping[str, Any], has_air: bool) -> list[str]:
    """Check that each setting of a sensor has an effect, and that the truth has the data a sensor needs.

    ``sensors`` maps each kind to its spec, or to None if there is none on board.
    """
    wrong = [
        f"[sensors.assumed] {kind} = {name!r} has no effect: there is no {kind} in [sensors]"
        for kind, name in table.sensors.assumed
        if name is not None and getattr(table.sensors, kind) is None
    ]
    physical = sensors["baro"] is not None and sensors["baro"].physical is not None
    if table.sensors.qnh_hpa is not None and not physical:
        what = quantity("qnh_hpa", table.sensors.qnh_hpa)
        wrong.append(f"[sensors] {what} has no effect: it is the setting of a baro with [physical]")
    sky = None if sensors["gnss"] is None else sensors["gnss"].sky
    if sky is not None and table.date not in (None, sky.day):
        wrong.append(
            f"date = {table.date} differs from the date of gnss = {table.sensors.gnss!r}, {sky.day}; "
            "leave it out"
        )
    elif sky is not None and table.sensors.mag is not None and not FIRST_YEAR <= sky.day.year < LAST_YEAR:
        wrong.append(
            f"[sensors] mag = {table.sensors.mag!r}: the magnetic field is known from {FIRST_YEAR:g} to "
            f"{LAST_YEAR - 1:g}; gnss = {table.sensors.gnss!r} starts {sky.day}"
        )
    if not has_air:
        imu = sensors["imu"]
        feels = {"imu": imu is not None and imu.feels_air} | {
            kind: sensors[kind] is not None and row.feels_air(sensors[kind])
            for kind, row in INSTRUMENTS.items()
        }
        wrong += [
            f"[sensors] {kind} = {getattr(table.sensors, kind)!r} needs air data, which a trajectory table "
            "does not have"
            for kind, needs_air in feels.items()
            if needs_air
        ]
    return wrong


_EXTERNAL = "'module:Class', 'file:SOLUTION', 'command:PROGRAM ...'"  # other forms of a filter name


def is_autopilot(use: str) -> bool:
    """Return whether a name selects the estimate of an autopilot: ``autopilot``, ``autopilot:INSTANCE``."""
    return use.partition(":")[0] == AUTOPILOT


def check_estimators(choices: Sequence[EstimatorChoice], *, of_log: bool = False) -> list[str]:
    """Check that built-in filters exist, and that labels are unique and can be part of a file name.

    ``of_log``: of a recording, in which an autopilot may have its own.
    """
    wrong = []
    labels: list[str] = []
    for number, choice in enumerate(choices, 1):
        place = f"[[estimator]] {number}: "
        if choice.use in ("file:", "command:"):
            wrong.append(f"{place}use = {choice.use!r} names no {choice.use[:-1]}")
        if is_autopilot(choice.use):
            if not of_log:
                wrong.append(f"{place}use = {choice.use!r} is for the log of an autopilot: bench navigate")
        elif not is_known(choice.use):
            hint = suggest(choice.use, list_names(), "filters")
            wrong.append(f"{place}use = {choice.use!r} is not a built-in filter{hint}, {_EXTERNAL}")
        what = f"{place}label = {choice.label!r}"
        if not LABEL.fullmatch(choice.label):
            wrong.append(f"{what} must be a name of letters, digits, '-', '_' and '.', 100 at most")
        if choice.guard.timeout is not None and not is_guarded(choice.use):
            wrong.append(f"{place}timeout_s has no effect: it is for a class of yours or a program")
        if choice.label in labels:
            wrong.append(f"{what} is taken by an entry above; give each its own label")
        labels.append(choice.label)
    return wrong


def check_options(document: Mapping[str, Any]) -> list[str]:
    """Check the options of built-in filters; entries that are not tables are checked elsewhere."""
    wrong = []
    rows = document.get("estimator")
    for number, row in enumerate(rows if isinstance(rows, list) else (), 1):
        use, values = (row.get("use"), row.get("options")) if isinstance(row, Mapping) else (None, None)
        if isinstance(use, str) and use in BUILT_IN and isinstance(values, Mapping):
            place = f"[[estimator]] {number} ({row.get('label', use)}): options: "
            wrong += [f"{place}{line}" for line in BUILT_IN[use].wrong(values)]
        elif isinstance(use, str) and use.startswith("command:") and "timeout_s" in (values or {}):
            wrong.append(f"[[estimator]] {number}: options: timeout_s stands beside use, not in options")
    return wrong


def is_code(use: str) -> bool:
    """Return whether a text names a program or a Python class, which a file may run only with permission."""
    return ":" in use and not use.startswith("file:") and use not in BUILT_IN and not is_autopilot(use)


def is_guarded(use: str) -> bool:
    """Return whether a filter runs in a separate process: a program, or a class that is not built in."""
    return is_code(use) or (use not in BUILT_IN and use in find_installed("estimators", BUILT_IN))


def is_known(use: str) -> bool:
    """Return whether a filter is built in, installed, or named with a colon."""
    return ":" in use or use in BUILT_IN or use in find_installed("estimators", BUILT_IN)


def list_names() -> list[str]:
    """Return the names of the filters that are built in or installed."""
    return [*BUILT_IN, *find_installed("estimators", BUILT_IN)]


def check_code(own: Sequence[EstimatorChoice], run: Sequence[EstimatorChoice]) -> list[str]:
    """Reject code that a file would run, so that a foreign file cannot run code undetected.

    ``own`` are the filters of the file, ``run`` those to run: with -e the user names code himself. What
    an installed package adds was installed by the user.
    """
    return [
        f"[[estimator]] {number}: {choice.use[:60]!r} is code that would run on this machine; "
        "--allow-code lets a file do so; code that you name with -e runs without it"
        for number, choice in enumerate(own, 1)
        if is_code(choice.use) and any(choice is one for one in run)
    ]


def check_requested(
    choices: Sequence[EstimatorChoice], names: Sequence[str], *, of_log: bool = False
) -> list[str]:
    """Check that each requested filter is in the profile, built in, or has the form ``module:Class``."""
    if objects := [one for one in names if not isinstance(one, str)]:
        return [f"filter {objects[0]!r} is no name; give 'module:Class', or call its own run()"]
    labels = {choice.label for choice in choices}
    own = [name for name in names if is_autopilot(name) and name not in labels]
    if own and not of_log:
        return [f"filter {own[0]!r} is for the log of an autopilot: bench navigate"]
    unknown = [name for name in names if name not in {*labels, *own} and not is_known(name)]
    known = labels.union(list_names()) if unknown else labels
    return [
        f"no filter {name!r} in this profile{suggest(name, known, 'filters')}, {_EXTERNAL}"
        for name in unknown
    ]


def check_across(
    table: ExperimentTable,
    on_board: Mapping[str, Any],
    choices: Sequence[EstimatorChoice],
    estimators: Sequence[str],
    *,
    has_air: bool,
) -> list[str]:
    """Return a line for each problem between the tables of a profile."""
    return [
        *check_rates(table, on_board),
        *check_outages(table),
        *check_alignment(table),
        *check_sensors(table, on_board, has_air=has_air),
        *check_requirements(table.requirement, choices),
        *check_estimators(choices),
        *check_requested(choices, estimators),
    ]


def complete_rotors(
    on_board: Mapping[str, Any], aircraft: AircraftSpec | None, flight: Flight | None, wrong: list[str]
) -> dict[str, Any]:
    """Return the sensors with the positions and radii of gyration of the aircraft, where the IMU has none.

    Parameters
    ----------
    on_board : mapping
        Kind of sensor -> its spec, or None.
    aircraft : AircraftSpec or None
        What flies; None for a script or a table.
    flight : FlightSpec, ScriptSpec, TableSpec or None
        The flight; None if it is wrong.
    wrong : list of str
        A line is added if the flight has no rotor speeds, or a figure is missing.
    """
    imu = on_board["imu"]
    if imu is None or flight is None or not (imu.vibration.rotor_reference and imu.vibration.by_rotors):
        return dict(on_board)
    from bench.io.trajectories.trajectory import has_rotor_speeds
    from bench.simulation.sensors.rotor_vibration import list_missing

    named = f"[sensors] imu = {imu.name!r}"
    shaken, table = imu.vibration, isinstance(flight, TableSpec)
    four = aircraft is not None and aircraft.has_four_rotors
    if not (has_rotor_speeds(flight.path) if isinstance(flight, TableSpec) else four):
        what = "the table has no columns rotor_speed" if table else "this is no multirotor"
        wrong.append(f"{named}: [vibration] rotor_accel needs the speeds of four rotors; {what}")
        return dict(on_board)
    if aircraft is not None:
        try:
            known = rotor_figures(aircraft.folder / f"{aircraft.name}.xml")
        except FlightError as error:
            wrong.append(str(error))
            return dict(on_board)
        if not any(getattr(shaken, name) for name in _PLACE):
            known |= dict(zip(_PLACE, aircraft.imu_b, strict=True))
        given = {name: value for name, value in known.items() if not getattr(shaken, name)}
        shaken = replace(shaken, **given)
    if shaken.inner_rate % flight.rate:
        rates = f"inner_rate_hz = {shaken.inner_rate:g} Hz must be a multiple of rate_hz = {flight.rate:g} Hz"
        wrong.append(f"{named}: [vibration] {rates}")
    if missing := list_missing(shaken):
        wrong.append(f"{named}: [vibration] vibration by rotors needs {', '.join(missing)} above 0")
    return {**on_board, "imu": replace(imu, vibration=shaken)}


_GIVEN_KEYS = ("roll_deg", "pitch_deg", "heading_deg", "tilt_sd_deg", "heading_sd_deg")


def check_log_start(table: LogTable) -> list[str]:
    """Return a line for what the alignment lacks, and for what would have no effect."""
    asked, found = table.alignment, find_kind(table)
    kind = f"kind = {found!r}"
    present = [key for key in _GIVEN_KEYS if getattr(asked, key) is not None]
    wrong = []
    if found == "given":
        wrong += [
            f"[alignment] {key} is missing; {kind} needs it" for key in _GIVEN_KEYS[:3] if key not in present
        ]
        wrong += [f"[alignment] duration_s has no effect with {kind}"] if asked.duration_s is not None else []
    else:
        given = [key for key in present if not (key == "heading_sd_deg" and asked.heading)]
        wrong += [f"[alignment] {key} is for kind = 'given', not for {kind}" for key in given]
    if asked.heading and found not in ("level", "hover"):
        wrong.append(f"[alignment] heading is for kind = 'level' or 'hover', not for {kind}")
    if asked.heading == "magnetometer" and table.mag is None:
        wrong.append("[alignment] heading = 'magnetometer' needs a table [mag]")
    if found != "course" and asked.drift_deg is not None:
        wrong.append(f"[alignment] drift_deg is for kind = 'course', not for {kind}")
    if table.vehicle in SIDEWAYS and found == "course":
        wrong.append(f"[alignment] {kind}: the course of a {table.vehicle} gives no heading; use 'hover'")
    if table.mag is not None:
        year = None if table.date is None else table.date.year
        if year is None or not FIRST_YEAR <= year < LAST_YEAR:
            known = f"of {FIRST_YEAR:g} to {LAST_YEAR - 1:g}, by which the magnetic field is known"
            wrong.append(f"[mag] needs a date above all tables, {known}: date = 2024-05-31")
    if (table.gnss is None) != (table.place is not None):
        wrong.append(
            "place has no effect with [gnss]"
            if table.place
            else "[gnss] is missing: for filters without "
            "fixes, such as 'ahrs', give place = [latitude, longitude, height]"
        )
    elif table.gnss is None and (found not in ("given", "level") or asked.heading):
        wrong.append(f"[alignment] without [gnss]: kind 'level' or 'given' without heading, not {found!r}")
    return wrong
