"""Read a profile and return it in SI; overrides replace values of the file, the file replaces defaults."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any, cast

from bench.core.records.flight_specs import (
    FIXED_WING,
    AircraftSpec,
    Flight,
    FlightSpec,
    Gust,
    TerrainSpec,
    ThermalsSpec,
    WindLayer,
)
from bench.core.records.sensor_specs import AssumedSpecs, SensorsSpec
from bench.core.records.specs import CLIENT, DEFAULT_GUARD, EstimatorChoice, Guard, Guidance, Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import suggest
from bench.io.config import checks, external_truth, fault_tables, leg_checks
from bench.io.config.datasheets import MODIFIED, SENSORS
from bench.io.config.library import (
    find_aircraft,
    find_datasheet,
    find_profile,
    read_aircraft,
    read_jsbsim_aircraft,
)
from bench.io.config.listing import JSBSIM
from bench.io.config.overrides import (
    DatasheetChanges,
    Figures,
    describe_choice,
    less_empty,
    override,
    set_seed,
    sets_estimator,
    split_overrides,
)
from bench.io.config.profile_tables import (
    SEVERITY,
    EstimatorTable,
    ExperimentTable,
    ProfileTable,
    TrajectoryTable,
    choose_usual_units,
    make_profile_table,
)
from bench.io.config.sheet import convert_figures
from bench.io.config.tables import check_table, collect_errors
from bench.io.config.toml_file import check_kind, read_toml
from bench.simulation.flight import legs
from bench.simulation.signals.air import SEA_LEVEL_PRESSURE
from bench.simulation.signals.magnetic import decimal_year

_OUTSIDE = ("file:", "command:")
DEFAULT_DAY = date(2026, 1, 1)
"""Date of a flight whose profile gives none."""


def read_profile(
    name: str | Path,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    estimators: Sequence[str] | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
) -> Profile:
    """Read and check a profile.

    Parameters
    ----------
    name : str or Path
        Name of a built-in profile, or path of a ``.toml`` file.
    overrides : mapping, optional
        Profile keys to replace: ``{"sensors.imu": "stim300", "leg.1.laps": 2}``. Entries of a list count
        from 1, and paths are relative to the current folder. ``sensors.imu.gyro.noise_deg_sqrt_h`` replaces
        a value of the datasheet on board and for the filters, ``sensors.assumed.imu.gyro...`` only for the
        filters.
    seed : int, optional
        Replaces ``seed`` and ``turbulence_seed``.
    estimators : sequence of str, optional
        Filters to evaluate: labels of the profile, built-in names, ``module:Class``, ``file:solution.csv`` or
        ``command:./program {sensors} {solution}``. Default: all of the profile.
    allow_code : bool, optional
        Permit the file to name code that is run. Code in ``estimators`` is always permitted. Default: no.
    guard : Guard, optional
        Limits for that code.

    Returns
    -------
    Profile
        The experiment, in SI and radians.

    Raises
    ------
    bench.ConfigError
        If the profile, the overrides or a file is wrong; one message for each problem.

    Examples
    --------
    >>> import bench
    >>> bench.read_profile("figure-eight", {"sensors.imu": "stim300"}).sensors.imu.name
    'stim300'
    """
    path, shown = find_profile(name)
    if isinstance(estimators, str):
        raise ConfigError(f"estimators = {estimators!r} is a text; give a list: [{estimators!r}]")
    document = read_toml(path, shown)
    check_kind(document, "a profile", shown)
    document, overrides = set_seed(document, dict(overrides or {}), seed)
    overrides, changes = split_overrides(overrides, path.parent)
    for key, value in overrides.items():
        document = override(document, key, value)
    beside, wrong = path.parent, [f"{shown}: {line}" for line in checks.check_options(document)]
    truth_keys = [key for key in ("aircraft", "script", "trajectory") if key in document]
    if len(truth_keys) > 1:
        raise ConfigError(f"{shown}: {' and '.join(truth_keys)}: a profile has only one of them")
    external = external_truth.EXTERNAL.get(truth_keys[0]) if truth_keys else None
    aircraft = _find_aircraft(document, beside, f"{shown}: ", wrong) if external is None else None
    units = document.get("sensors")
    if units is None and external is not None:
        units = choose_usual_units().model_dump()
    on_board, assumed = _read_sensors(units, beside, shown, wrong, changes)
    try:
        table: ExperimentTable = check_table(
            external[0] if external else make_profile_table(legs.LEGS), document, shown
        )
    except ConfigError as error:
        raise ConfigError(*error.messages, *wrong) from None
    choices = make_choices(table.estimator, overrides, beside)
    flight: Flight | None = None
    terrain: TerrainSpec | None = None
    across = []
    if isinstance(table, ProfileTable) and aircraft is not None:
        table = leg_checks.fill_in_speed(table, aircraft)
        across = leg_checks.check_legs(table, aircraft) + leg_checks.check_air(table)
        with collect_errors(wrong, f"{shown}: [terrain] "):
            terrain = leg_checks.find_terrain(table, beside)
        across += leg_checks.check_radar_use(table, terrain, choices)
        if not across:
            flight = _make_flight(table, aircraft, terrain)
    elif external is not None:
        with collect_errors(wrong, f"{shown}: "):
            flight = external[1](table, beside)
    end, has_air = math.inf if table.duration_s is None else table.duration_s, "trajectory" not in document
    on_board = checks.complete_rotors(on_board, aircraft, flight, across)
    across += fault_tables.check_faults(table.fault, on_board, end)
    across += checks.check_across(table, on_board, choices, estimators or (), has_air=has_air)
    wrong += [f"{shown}: {line}" for line in across]
    if wrong or flight is None:
        raise ConfigError(*wrong)
    choices = choose_estimators(shown, choices, estimators, allow_code, guard)
    return Profile(
        name=path.stem,
        title=table.title or path.stem,
        seed=table.seed,
        flight=flight,
        sensors=_make_sensors(table, aircraft, on_board, assumed, terrain),
        estimators=choices,
        evaluation=table.evaluation.window(),
        document=_make_document(table, path.stem, choices, _choose_day(table, on_board), changes),
        guidance=_make_guidance(table, shown, flight, guard, allow_code=allow_code),
    )


def _read_sensors(
    units: Any, beside: Path, shown: str, wrong: list[str], changes: DatasheetChanges
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the datasheets on board and the datasheets that filters assume, by sensor."""
    on_board = _find_sensors(units, beside, f"{shown}: [sensors] ", wrong, changes.on_board)
    assumed_names = changes.name_assumed(units)
    assumed = _find_sensors(assumed_names, beside, f"{shown}: [sensors.assumed] ", wrong, changes.assumed)
    named = units if isinstance(units, Mapping) else {}
    wrong += [f"{shown}: {line}" for line in changes.check(named, {**named, **assumed_names})]
    return on_board, {kind: assumed[kind] or on_board[kind] for kind in SENSORS}


def _make_guidance(
    table: ExperimentTable, shown: str, flight: Flight, guard: Guard, *, allow_code: bool
) -> Guidance | None:
    """Return the filter that guides the flight; None if the truth does.

    Raises
    ------
    ConfigError
        If that is code and not allowed, there is no such filter, or the aircraft has no guidance of ours.
    """
    own = getattr(table, "guidance", None)
    if own is None:
        return None
    choice = make_choice(own.navigation, own.navigation, own.options)
    place = f"{shown}: [guidance]"
    craft = flight.aircraft if isinstance(flight, FlightSpec) else None
    if craft is None or not craft.guided or craft.foreign is not None:
        raise ConfigError(f"{place} is for aircraft of the bench; others have no guidance that it reaches")
    if craft.kind != FIXED_WING:
        raise ConfigError(
            f"{place}: fixed-wing aircraft fly by an estimate or commands; {craft.name} does not"
        )
    if choice.use == CLIENT:
        return Guidance(choice, own.period_s, own.latency_s, own.error)
    if not checks.is_known(choice.use) or choice.use.startswith(_OUTSIDE):
        hint = suggest(choice.use, checks.list_names(), "filters")
        what = f"{place} navigation = {choice.use!r}"
        raise ConfigError(f"{what}: must be a filter that runs in pieces{hint}")
    if checks.is_code(choice.use) and not allow_code:
        raise ConfigError(
            f"{place} navigation = {choice.use!r} is code that would run on this machine; "
            "--allow-code lets a file do so"
        )
    choice = _set_guard(choice, guard) if checks.is_guarded(choice.use) else choice
    return Guidance(choice, own.period_s, own.latency_s, own.error)


def _find_aircraft(
    document: Mapping[str, Any], beside: Path, place: str, wrong: list[str]
) -> AircraftSpec | None:
    """Read the aircraft of a profile, or add the problems to ``wrong``; None if it names none."""
    name, root = document.get("aircraft"), document.get("jsbsim_root")
    if isinstance(name, str):
        with collect_errors(wrong, place):
            if name.startswith(JSBSIM):
                return read_jsbsim_aircraft(name, root if isinstance(root, str) else None, beside)
            if root is not None:
                raise ConfigError(f"jsbsim_root is for aircraft = '{JSBSIM}NAME'; aircraft = {name!r} is not")
            folder = find_aircraft(name, beside)
            with collect_errors(wrong):
                return read_aircraft(folder, beside)
    return None


def _find_sensors(
    names: object, beside: Path, place: str, wrong: list[str], changes: Figures
) -> dict[str, Any]:
    """Read the datasheets that a table names, with some figures replaced; None for the others.

    Problems are added to ``wrong``, each behind ``place``.
    """
    specs: dict[str, Any] = dict.fromkeys(SENSORS)
    for kind in SENSORS:
        name = names.get(kind) if isinstance(names, Mapping) else None
        if isinstance(name, str):
            with collect_errors(wrong, place):
                path, shown = find_datasheet(kind, name.removesuffix(MODIFIED), beside)
                with collect_errors(wrong):
                    specs[kind] = SENSORS[kind](path, shown, changes.get(kind))
    return specs


def choose_estimators(
    shown: str,
    own: Sequence[EstimatorChoice],
    estimators: Sequence[str] | None,
    allow_code: bool,
    guard: Guard,
) -> tuple[EstimatorChoice, ...]:
    """Return the filters to run: the filters of a file, or those requested instead.

    Raises
    ------
    ConfigError
        If two share a label, the request is empty, or the file would run code without permission.
    """
    choices = tuple(own)
    if estimators is not None:
        by_label = {choice.label: choice for choice in choices}
        choices = _number_labels([by_label.get(name) or make_choice(name) for name in estimators])
        twice = [label for label, count in Counter(c.label for c in choices).items() if count > 1]
        if twice:
            raise ConfigError(f"{shown}: two of the requested filters have the label {twice[0]!r}")
        if not choices:
            hint = "leave the list out to run the filters of the profile"
            raise ConfigError(f"{shown}: no filter is requested; {hint}")
    if not allow_code and (wrong := checks.check_code(own, choices)):
        raise ConfigError(*(f"{shown}: {line}" for line in wrong))
    return tuple(_set_guard(choice, guard) if checks.is_guarded(choice.use) else choice for choice in choices)


def _set_guard(choice: EstimatorChoice, guard: Guard) -> EstimatorChoice:
    """Return a choice with a guard; without a time limit in the guard, the limit of the file counts."""
    timeout = choice.guard.timeout if guard.timeout is None else guard.timeout
    return replace(choice, guard=replace(guard, timeout=timeout))


def make_choice(
    use: str, label: str | None = None, options: Mapping[str, Any] | None = None, beside: Path | None = None
) -> EstimatorChoice:
    """Return the choice of a filter; the default label follows from its ``use``."""
    beside = beside if beside and use.startswith(_OUTSIDE) else Path()
    return EstimatorChoice(use, label or _make_label(use), dict(options or {}), beside)


def make_choices(
    rows: Sequence[EstimatorTable], overrides: Mapping[str, Any], beside: Path
) -> tuple[EstimatorChoice, ...]:
    """Return the choices of a file; a path is relative to the file or, from an override, to this folder."""
    return tuple(
        replace(
            make_choice(row.use, row.label, row.options, Path() if sets_estimator(overrides, k) else beside),
            guard=Guard(timeout=row.timeout_s),
        )
        for k, row in enumerate(rows, 1)
    )


def _make_label(use: str) -> str:
    """Return the default label of a filter: the name of its class, file or program."""
    kind, _, rest = use.rpartition(":")
    if checks.is_autopilot(use):
        return use.replace(":", "-")
    if use.startswith(_OUTSIDE):
        kind, _, rest = use.partition(":")
        words = rest.split() if kind == "command" else [rest]
        return re.sub(r"[^A-Za-z0-9_.-]+", "-", Path(words[0] if words else kind).stem) or kind
    return rest


def _number_labels(choices: Sequence[EstimatorChoice]) -> tuple[EstimatorChoice, ...]:
    """Return the choices; a repeated label of a file or program gets a number appended."""
    counts: Counter[str] = Counter()
    numbered = []
    for choice in choices:
        counts[choice.label] += 1
        count = counts[choice.label]
        if count > 1 and choice.use.startswith(_OUTSIDE):
            choice = replace(choice, label=f"{choice.label}-{count}")
        numbered.append(choice)
    return tuple(numbered)


def _make_flight(table: ProfileTable, aircraft: AircraftSpec, terrain: TerrainSpec | None) -> FlightSpec:
    wind, start = table.wind, table.start
    return FlightSpec(
        aircraft=aircraft,
        rate=float(table.rate_hz),
        **leg_checks.find_start(table),
        speed=leg_checks.choose_first_speed(table, aircraft),
        wind_from=math.radians(wind.from_deg),
        wind_speed=float(wind.speed_mps),
        severity=SEVERITY.get(wind.turbulence, wind.turbulence),
        turbulence_seed=table.seed if table.turbulence_seed is None else table.turbulence_seed,
        legs=leg_checks.build_legs(table),
        duration=table.duration_s,
        on_ground=start.on_ground,
        runway=leg_checks.make_runway(table),
        flat_alt=leg_checks.choose_ground(table),
        wind_layers=tuple(
            WindLayer(**convert_figures(WindLayer, row))
            for row in sorted(wind.layers, key=lambda row: row.alt_m)
        ),
        gusts=tuple(
            Gust(air_n=(row.north_mps, row.east_mps, -row.up_mps), **convert_figures(Gust, row))
            for row in sorted(table.gust, key=lambda row: row.start_s)
        ),
        terrain=terrain,
        thermals=ThermalsSpec(**convert_figures(ThermalsSpec, wind.thermals)) if wind.thermals else None,
    )


def _make_sensors(
    table: ExperimentTable,
    aircraft: AircraftSpec | None,
    on_board: Mapping[str, Any],
    assumed: Mapping[str, Any],
    terrain: TerrainSpec | None,
) -> SensorsSpec:
    initial = table.initial_error_sd
    return SensorsSpec(
        **on_board,
        assumed=AssumedSpecs(**assumed),
        date=decimal_year(_choose_day(table, on_board)),
        qnh=SEA_LEVEL_PRESSURE if table.sensors.qnh_hpa is None else 100.0 * table.sensors.qnh_hpa,
        static_port_b=_place_static_port(aircraft),
        **_find_ground(table, aircraft),
        terrain=terrain,
        antenna_b=external_truth.place_antenna(table) if aircraft is None else aircraft.antenna_b,
        gnss_outages=tuple(sorted((row.start_s, row.start_s + row.duration_s) for row in table.gnss_outage)),
        initial_pos_sd=initial.pos_m,
        initial_vel_sd=initial.vel_mps,
        initial_tilt_sd=math.radians(initial.tilt_deg),
        initial_heading_sd=math.radians(initial.heading_deg),
        output_rate=float(table.evaluation.output_hz),
        alignment=table.alignment.kind,
        align_for=checks.choose_alignment_time(table),
        drift_sd=checks.choose_drift(table),
        faults=tuple(fault_tables.make_fault(row) for row in table.fault),
    )


def _find_ground(table: ExperimentTable, aircraft: AircraftSpec | None) -> dict[str, Any]:
    """Return the height of the ground, and the height of the IMU above it at rest [m].

    The vehicle of a trajectory table stays on the ground. An aircraft without runway figures, whose landing
    gear is not known, never rests on it, and neither does one over hills without a runway.
    """
    if not isinstance(table, ProfileTable) or aircraft is None:
        return {} if isinstance(table, TrajectoryTable) else {"rest_height": -math.inf}
    hills = table.terrain is not None and table.terrain.file and leg_checks.make_runway(table) is None
    height = None if hills else aircraft.rest_height
    rest = -math.inf if height is None else height - aircraft.imu_b[2]
    return {"ground_alt": leg_checks.choose_ground(table), "rest_height": rest}


def _choose_day(table: ExperimentTable, on_board: Mapping[str, Any]) -> date:
    """Return the day of the flight: from the profile, else from the receiver's [sky], else the default."""
    gnss = on_board["gnss"]
    if table.date is None and gnss is not None and gnss.sky is not None:
        return cast(date, gnss.sky.day)
    return table.date or DEFAULT_DAY


def _place_static_port(aircraft: AircraftSpec | None) -> tuple[float, float, float]:
    """Return the static port relative to the center of gravity [m], b."""
    if aircraft is None:
        return (0.0, 0.0, 0.0)
    imu_b, port_b = aircraft.imu_b, aircraft.static_port_b
    return (imu_b[0] + port_b[0], imu_b[1] + port_b[1], imu_b[2] + port_b[2])


def _make_document(
    table: ExperimentTable,
    name: str,
    choices: Sequence[EstimatorChoice],
    day: date,
    changes: DatasheetChanges,
) -> dict[str, Any]:
    """Return the profile as flown: the file with overrides and all defaults filled in."""
    document: dict[str, Any] = {
        "title": name,
        **table.model_dump(mode="json", exclude_none=True, by_alias=True),
        "date": day.isoformat(),
    }
    if "turbulence_seed" in type(table).model_fields:
        document.setdefault("turbulence_seed", table.seed)
    sensors = document["sensors"]
    on_board = {kind: sensors[kind] for kind in SENSORS if kind in sensors}
    sensors["assumed"] = on_board | sensors["assumed"]
    changes.mark(document)
    document["estimator"] = [describe_choice(choice) for choice in choices]
    return less_empty(document, "requirement")
