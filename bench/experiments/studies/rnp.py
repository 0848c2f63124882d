"""Accuracy, integrity, continuity and availability of a navigator on a flight, as aviation defines them.

    TSE = FTE - NSE    across track, all to the right: `bench.evaluation.errors.total_system`

(A-2.1.5; ICAO Doc 9613, DO-236C.) A pilot or an autopilot follows the navigator, so the navigation error
moves the aircraft off the track by the same distance. A flight guided by the truth has the flight technical
error alone, off the track and off the arcs of its turns. If the profile has [guidance], ``estimator`` steers,
TSE is measured, and NSE is the error of the solution that steered.

A flight is one trial, with its own noise and turbulence, and the exposure is counted in hours. A line is met
or missed if its 95 % bound shows it, else it is undecided and needs more hours. Nothing is extrapolated.
The protection levels of `tight` are valid with at most one faulty satellite, the levels of other filters
without faults (`bench.evaluation.metrics.protection`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bench import pipeline
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import HOUR, SAME_INSTANT
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.findings import Findings, FindingTable
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import Sensed
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number, suggest
from bench.evaluation.ensembles.ensemble import Estimate, estimate_fraction, estimate_rate, pool_quantile
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.metrics.protection import (
    FALSE_ALARM,
    list_satellites,
    protect_by_separation,
    protect_fault_free,
)
from bench.evaluation.metrics.protection import MISSED as MISSED_DETECTION
from bench.evaluation.requirements.required_performance import (
    OUTSIDE_PER_HOUR,
    WITHIN,
    JudgedFigure,
    Watched,
    count_detected,
    count_windows,
    hours_flown,
    judge_rate,
    judge_share,
)
from bench.evaluation.requirements.share_test import MET, MISSED, UNDECIDED, ShareTest
from bench.experiments.studies.rare_errors import LEAST, find_largest, find_rare_errors
from bench.experiments.studies.stanford import PLANES, known_size, plot_stanford, tabulate_stanford
from bench.experiments.studies.study import (
    FLOWN_BY,
    Count,
    Positive,
    StudyWorkers,
    UnitOptions,
    Words,
    ask_each,
    refuse_navigation,
)
from bench.experiments.studies.watched_flights import WatchedFlight, align_flights, tell_crashes
from bench.io.config import read_profile
from bench.navigation import estimator
from bench.navigation.engine.kept_rows import take_rows
from bench.pipeline import closed_loop
from bench.simulation.flight.guidance.desired_path import measure_off_path

STUDY = 10, "rnp"
QUESTION = "Does navigation meet the accuracy, integrity, continuity and availability of a procedure?"

_NM = 1852.0  # [m]
_INTERVAL = 1.0  # between the epochs of a run [s]
_RISK, _TOLD = 1e-4, 0.999  # required: risk of an alert; share of errors told
LINES = ("accuracy", "containment", "availability", "continuity", "integrity")
"""What a procedure requires."""

_Probability = Annotated[float, Field(gt=0, lt=1)]


class Options(UnitOptions):
    """Options of the study."""

    profiles: Words
    """shipped profiles, or .toml files of your own; legs ``waypoints`` and ``approach`` have tracks"""
    estimator: str = "tight"
    """built-in filter; it also guides the aircraft if the profile has [guidance]"""
    gnss: str | None = None
    """receiver, if not of the profile; ``tight`` requires a receiver with [sky], such as sky-l1"""
    rnp_nm: Positive = 0.3
    """required navigation performance [nautical miles]"""
    alert_limit_m: Positive | None = None
    """horizontal alert limit [m]; left out: RNP"""
    vertical_limit_m: Positive = 50.0
    """vertical alert limit [m]"""
    time_to_alert_s: Positive = 10.0
    """time within which an alert must come [s]"""
    continuity_s: Positive = 15.0
    """duration of the operation that must not be interrupted [s]"""
    availability: _Probability = 0.95
    """fraction of the time that must have no alert; procedures require 0.95 to 0.997"""
    false_alarm: _Probability = FALSE_ALARM
    """probability of a false alarm, for the separation of subfilters"""
    missed: _Probability = MISSED_DETECTION
    """probability of a missed fault, for the separation of subfilters"""
    lines: Words = LINES
    """what is evaluated: accuracy, containment, availability, continuity, integrity"""
    runs: Count = 60
    """flights, each with its own noise and turbulence"""
    hours: Positive | None = None
    """smallest number of flight hours, instead of --runs [h]"""
    rare_runs: Annotated[int, Field(ge=LEAST, le=10_000)] | None = None
    """runs above each threshold of a subset simulation of errors beyond the alert limits, such as 200"""


@dataclass(frozen=True, slots=True)
class RnpRun:
    """One run, as a worker gets it."""

    options: Options
    number: int


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return accuracy, integrity, continuity and availability."""
    if wrong := [
        f"study rnp: lines: {name!r} is unknown{suggest(name, LINES, 'lines')}"
        for name in options.lines
        if name not in LINES
    ]:
        raise ConfigError(*wrong)
    refuse_navigation("rnp", options, "--estimator")
    return ask_each("rnp", options, work, make_profile, _ask)


def _ask(options: Options, work: StudyWorkers) -> Findings:
    work.progress("flying", 0, 1)
    if options.rare_runs and make_profile(options).guidance is not None:
        raise ConfigError("study rnp: --rare-runs: a filter guides this flight; leave --rare-runs out")
    profile, truth, _ = load_flight(options, 0)
    instants = len(choose_rows(truth, profile))
    each = hours_flown((1, instants), _INTERVAL)
    flights = options.runs if options.hours is None else max(2, math.ceil(options.hours / each))
    watches = work.map("evaluating flights", watch_run, [RnpRun(options, k) for k in range(flights)], (0,))
    planes = _gather(watches, options)
    errors = {"NSE": _stack(watches, "across"), "FTE": _stack(watches, "off")}
    errors["TSE"] = errors["FTE"] - errors["NSE"]
    rows = list(_list_rows(errors, planes, options))
    hours = hours_flown(errors["TSE"].shape, _INTERVAL)
    told = list(_tell(errors, planes, options, rows, hours))
    if options.rare_runs:

        def measure(runs: Sequence[int]) -> FloatArray:
            found = work.map("rare errors", measure_largest, [RnpRun(options, one) for one in runs])
            return np.array(found)

        for one in find_rare_errors(measure, [plane.limit for plane in planes], options.rare_runs, each):
            rows.append({"line": "integrity"} | _row(one.title, one.judged, "1/h", one.required))
            told.append(one.sentence)
    names = ("line", "figure", "value", "low", "high", "unit", "required", "word", "more_h")
    columns = {name: [row[name] for row in rows] for name in names}
    title = f"{options.estimator} on {profile.name}, {flights} flights, {hours:.3g} h: bounds of 95 % each"
    words = [row["word"] for row in rows]
    return Findings(
        verdicts=(*tell_crashes(watches), *told),
        tables=(FindingTable("rnp", title, columns, {"more_h": "h"}), tabulate_stanford(planes)),
        figures=tuple(plot_stanford(watches[0].t, planes)),
        runs=flights,
        good=MISSED not in words,
        undecided=UNDECIDED in words,
    )


def _gather(watches: Sequence[WatchedFlight], options: Options) -> list[Watched]:
    """Return the horizontal and the vertical errors and levels, of flights cut to one length."""
    limits = (options.alert_limit_m or options.rnp_nm * _NM, options.vertical_limit_m)
    alarm = np.array([one.alarm for one in align_flights(watches)])
    return [
        Watched(
            _INTERVAL,
            np.array([one.error[:, k] for one in align_flights(watches)]),
            np.array([one.level[:, k] for one in align_flights(watches)]),
            alarm,
            limit,
        )
        for k, limit in enumerate(limits)
    ]


def measure_largest(run: RnpRun) -> FloatArray:
    """Return the largest horizontal and vertical error (2,) [m] of a run on the first flight."""
    profile, truth, _ = load_flight(run.options, 0)
    sensed = pipeline.sense(profile, truth, run.number)
    solution = navigate(profile, sensed, truth.t[choose_rows(truth, profile)])
    return find_largest(error_series(truth, solution).pos_n)


def _stack(watches: Sequence[WatchedFlight], name: str) -> FloatArray:
    return np.array([getattr(one, name) for one in align_flights(watches)])


def watch_run(run: RnpRun) -> WatchedFlight:
    """Return the errors and the protection levels of one run."""
    options = run.options
    profile, truth, steered = load_flight(options, run.number)
    rows = choose_rows(truth, profile)
    if steered is not None:  # at the first answer from each whole second on
        after = np.searchsorted(steered.t, truth.t[rows] - SAME_INSTANT)
        rows = np.searchsorted(truth.t, steered.t[after[after < len(steered.t)]] - SAME_INSTANT)
    sensed = pipeline.sense(profile, truth, run.number)
    solution = navigate(profile, sensed, truth.t[rows])
    if options.estimator == "tight":
        without = [navigate(profile, one, truth.t[rows]) for one in leave_out(sensed)]
        protection = protect_by_separation(solution, without, options.false_alarm, options.missed)
    else:
        protection = protect_fault_free(solution)
    apart = error_series(truth, solution).pos_n
    off = course = np.full(len(rows), np.nan)
    if isinstance(profile.flight, FlightSpec):
        path = measure_off_path(profile.flight, truth, rows)
        off, course = path.right, path.course
    navigated = apart if steered is None else find_steering_errors(truth, steered, truth.t[rows])
    across = navigated[:, 1] * np.cos(course) - navigated[:, 0] * np.sin(course)
    return WatchedFlight(
        truth.t[rows],
        np.column_stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])]),
        protection.level,
        protection.alarm,
        across,
        off if steered is None else off + across,
        bool(truth.events.select("crash")),
    )


def find_steering_errors(truth: Trajectory, steered: NavSolution, t: FloatArray) -> FloatArray:
    """Return the position errors (M, 3) [m], n, of the guiding solution at some epochs (M,) [s]."""
    errors = error_series(truth, steered)
    found: FloatArray = errors.pos_n[np.searchsorted(errors.t, t - SAME_INSTANT).clip(max=len(errors.t) - 1)]
    return found


@lru_cache(maxsize=2)
def load_flight(options: Options, number: int) -> tuple[Profile, Trajectory, NavSolution | None]:
    """Return profile and truth of a flight, and the solution that guided it if the filter flew.

    With turbulence each flight has its own, and so it has where the filter flies; else one is that of all.
    """
    profile = make_profile(options)
    if profile.guidance is not None:
        flown = closed_loop.fly(profile, number)
        return profile, flown.truth, flown.answers
    if number and isinstance(profile.flight, FlightSpec):
        if profile.flight.severity == 0:
            return profile, load_flight(options, 0)[1], None
        profile = make_profile(options, profile.seed + number)
    truth = pipeline.fly(profile)
    pipeline.check_times(profile, float(truth.t[-1]))
    return profile, truth, None


def make_profile(options: Options, seed: int | None = None) -> Profile:
    """Return the profile, guided by the filter if requested; ConfigError if it lacks satellites."""
    given = options.settings | ({} if options.gnss is None else {"sensors.gnss": options.gnss})
    seed, asked = options.seed if seed is None else seed, (options.estimator,)
    profile = read_profile(options.profile, given, seed, asked)
    gnss = profile.sensors.gnss
    if options.estimator == "tight" and (gnss is None or gnss.sky is None):
        raise ConfigError(
            f"tight needs measurements of satellites, and {profile.name} has none; --gnss sky-l1 gives them"
        )
    if profile.guidance is None:
        return profile
    given = {"guidance.options": {}, **given, FLOWN_BY: options.estimator}
    return read_profile(options.profile, given, seed, asked)


def choose_rows(truth: Trajectory, profile: Profile) -> Any:
    """Return the rows of the truth at whole seconds, from the start of the evaluation."""
    t = np.arange(np.ceil(max(profile.evaluation.begin, truth.t[0])), truth.t[-1] + SAME_INSTANT, _INTERVAL)
    return np.unique(np.searchsorted(truth.t, t - SAME_INSTANT))


def navigate(profile: Profile, sensed: Sensed, t: FloatArray) -> NavSolution:
    """Return the solution of the filter at some times (M,) [s]."""
    choice = profile.estimators[0]
    data = replace(sensed.data, output_t=t)
    return estimator.answer(pipeline.build_estimator(choice), choice.label, data, sensed.initial)


def leave_out(sensed: Sensed) -> Iterator[Sensed]:
    """Yield the sensor data without each of the satellites that were in view at any time."""
    o = sensed.data.observations
    assert o is not None
    for system, sat in list_satellites(o):
        kept = take_rows(o, (o.system != system) | (o.sat != sat))
        yield replace(sensed, data=replace(sensed.data, observations=kept))


def _list_rows(
    errors: dict[str, FloatArray], planes: list[Watched], options: Options
) -> Iterator[dict[str, Any]]:
    """Yield the rows of the requested lines (A-2.1.5)."""
    makers = {
        "accuracy": lambda: _list_accuracy(errors, options.rnp_nm * _NM),
        "containment": lambda: _list_containment(errors, options.rnp_nm * _NM),
        "availability": lambda: _list_availability(planes, options),
        "continuity": lambda: list_continuity(planes, options),
        "integrity": lambda: _list_integrity(planes, options),
    }
    for line in LINES:
        if line in options.lines:
            yield from ({"line": line} | row for row in makers[line]())


def _list_accuracy(errors: dict[str, FloatArray], rnp: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of the cross-track errors."""
    on = ~np.isnan(errors["FTE"]).any(axis=0)
    if not on.any():
        return
    for name, values in errors.items():
        yield _row(
            f"{name} across track, 95 %", pool_quantile(known_size(np.abs(values[:, on])), WITHIN), "m"
        )
    inside = known_size(np.abs(errors["TSE"][:, on])) <= rnp
    judged = judge_share(inside, WITHIN, hours_flown(errors["TSE"].shape, _INTERVAL))
    yield _row("time with TSE within RNP", judged, "1", f">= {WITHIN:g}")


def _list_containment(errors: dict[str, FloatArray], rnp: float) -> Iterator[dict[str, Any]]:
    """Yield the rate of flights that went beyond twice RNP."""
    on = ~np.isnan(errors["FTE"]).any(axis=0)
    if not on.any():
        return
    outside = known_size(np.abs(errors["TSE"][:, on])) > 2.0 * rnp
    hours = hours_flown(outside.shape, _INTERVAL)
    judged = judge_rate(int(outside.any(axis=1).sum()), hours, OUTSIDE_PER_HOUR)
    yield _row("TSE beyond twice RNP, per hour", judged, "1/h", f"<= {OUTSIDE_PER_HOUR:g}")


def _list_availability(planes: list[Watched], options: Options) -> Iterator[dict[str, Any]]:
    for plane, watched in zip(PLANES, planes, strict=True):
        hours = hours_flown(watched.error.shape, _INTERVAL)
        judged = judge_share(~watched.alert, options.availability, hours)
        yield _row(f"availability, {plane}", judged, "1", f">= {options.availability:g}")


def list_continuity(planes: list[Watched], options: Options) -> Iterator[dict[str, Any]]:
    """Yield the risk of an alert in an operation that begins without one; a flight is one event at most."""
    for plane, watched in zip(PLANES, planes, strict=True):
        windows = count_windows(watched, options.continuity_s)
        title = f"risk of an alert in {options.continuity_s:g} s, {plane}"
        if windows is None or not windows[0].any():
            yield _row(title, None, "1", f"<= {_RISK:g}")
            continue
        begun, lost = windows
        operations = float(begun.sum())
        judged = judge_rate(int(lost.any(axis=1).sum()), operations, _RISK)
        more = None if judged.more_h is None else judged.more_h * options.continuity_s / HOUR
        found = judged.found
        if lost.any():  # alerts of one flight come together
            spread = estimate_fraction(lost).high * lost.size / operations
            found = Estimate(float(lost.sum()) / operations, found.low, max(found.high, min(spread, 1.0)))
        word = judged.word if judged.word != MET or found.high <= _RISK else UNDECIDED
        yield _row(title, JudgedFigure(found, word, more), "1", f"<= {_RISK:g}")


def _list_integrity(planes: list[Watched], options: Options) -> Iterator[dict[str, Any]]:
    """Yield the rate of hazardously misleading flights, and the rate of alerts if the limit is exceeded."""
    for plane, watched in zip(PLANES, planes, strict=True):
        hours = hours_flown(watched.error.shape, _INTERVAL)
        judged = judge_rate(int(watched.hazardous.any(axis=1).sum()), hours, OUTSIDE_PER_HOUR)
        yield _row(f"hazardously misleading, per hour, {plane}", judged, "1/h", f"<= {OUTSIDE_PER_HOUR:g}")
    for plane, watched in zip(PLANES, planes, strict=True):
        beyond, told = count_detected(watched, options.time_to_alert_s)
        if beyond:
            word, _ = ShareTest(_TOLD).decide([k < told for k in range(beyond)])
            title = (
                f"flights whose errors beyond the limit are told in {options.time_to_alert_s:g} s, {plane}"
            )
            yield _row(title, JudgedFigure(estimate_rate(told, beyond, 0.9), word), "1", f">= {_TOLD:g}")


def _row(
    figure: str, found: JudgedFigure | Estimate | None, unit: str, required: str | None = None
) -> dict[str, Any]:
    judged = found if isinstance(found, JudgedFigure) else None
    estimate = judged.found if judged is not None else found if isinstance(found, Estimate) else None
    return {
        "figure": figure,
        "value": None if estimate is None else estimate.value,
        "low": None if estimate is None else estimate.low,
        "high": None if estimate is None else estimate.high,
        "unit": unit,
        "required": required,
        "word": judged.word if judged is not None else UNDECIDED if required else None,
        "more_h": None if judged is None else judged.more_h,
    }


def _tell(
    errors: dict[str, FloatArray],
    planes: list[Watched],
    options: Options,
    rows: list[dict[str, Any]],
    hours: float,
) -> Iterator[str]:
    by_figure = {row["figure"]: row for row in rows}
    within, flights = by_figure.get("time with TSE within RNP"), len(errors["TSE"])
    if within is None and {"accuracy", "containment"} & {*options.lines}:
        yield "No leg is along waypoints or to a runway, which a total system error would need."
    elif within is not None:
        total = by_figure["TSE across track, 95 %"]["value"]
        finite = (errors[name][np.isfinite(errors[name])] for name in ("FTE", "NSE"))  # no crashed flight
        flown, navigated = (float(np.mean(np.square(values))) for values in finite)
        share = flown / max(flown + navigated, 1e-12)
        yield (
            f"RNP {options.rnp_nm:g} ({options.rnp_nm * _NM:.0f} m): {within['word']}; across track, turns "
            f"included, the total error is below {format_number(total, 3)} m for 95 % of the time, "
            f"{100.0 * share:.0f} % of its mean square by the flight, the rest by the navigation."
        )
    judged = [row for row in rows if row["required"]]
    for word in (MISSED, UNDECIDED, MET):
        parts = [f"{row['figure']}{_tell_more(row)}" for row in judged if row["word"] == word]
        if parts:
            yield f"{word.capitalize()} by {flights} flights, {hours:.3g} h: {'; '.join(parts)}."
    for plane, watched in zip(PLANES, planes, strict=True):
        level = watched.level[np.isfinite(watched.level)]
        typical = f"median {format_number(np.median(level), 3)} m" if len(level) else "never stated"
        misled = int(watched.misleading.any(axis=1).sum())
        hazard = int(watched.hazardous.any(axis=1).sum())
        limit = format_number(watched.limit)
        yield (
            f"{plane.capitalize()} protection level: {typical}, alert limit {limit} m; "
            f"the error was larger than the level in {misled} of {flights} flights, hazardously in {hazard}."
        )
    if options.estimator != "tight":
        yield "The levels hold while nothing is faulty; only tight allows for a faulty satellite."


def _tell_more(row: dict[str, Any]) -> str:
    return "" if row["more_h"] is None else f" ({format_number(row['more_h'], 2)} h more would decide)"
