"""Accuracy, integrity, continuity and availability of a navigator on a flight, as aviation defines them.

    TSE = NSE + FTE    across track, both to the right: the error of the navigation and that of the flight

(A-2.1.5; ICAO Doc 9613, DO-236C.) A pilot or an autopilot follows the navigator, so its error moves the
aircraft off the track by as much. The flight here is guided by the truth, and its error off the track is the
flight technical error alone. Levels of `tight` hold while at most one satellite is faulty, those of the other
filters while nothing is (`bench.evaluation.protection`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from bench import pipeline
from bench.arrays import BoolArray, FloatArray
from bench.config import load_profile
from bench.data import NavSolution, Sensed, Trajectory
from bench.errors import ConfigError
from bench.evaluation.ensemble import CONFIDENCE, Estimate, estimate_fraction, estimate_rate, pool_quantile
from bench.evaluation.error_series import error_series
from bench.evaluation.protection import (
    FALSE_ALARM,
    MISSED,
    list_satellites,
    protect_by_separation,
    protect_fault_free,
)
from bench.evaluation.required_performance import (
    OUTSIDE_PER_HOUR,
    WITHIN,
    Watched,
    bound_per_hour,
    count_detected,
    describe_estimate,
    estimate_availability,
    estimate_discontinuity,
    estimate_per_run,
    hours_flown,
)
from bench.flight.off_track import measure_off_track
from bench.navigation import estimator
from bench.navigation.engine.kept_rows import take_observations
from bench.plots import series
from bench.plots.series import Plot
from bench.specs import FlightSpec, Profile
from bench.studies.study import Count, Findings, Positive, StudyOptions, StudyTable, Work
from bench.wording import format_number

_NM = 1852.0  # [m]
_INTERVAL = 1.0  # between the instants of a run [s]
_PLANES = ("horizontal", "vertical")
_Probability = Annotated[float, Field(gt=0, lt=1)]


class Options(StudyOptions):
    """What may be asked."""

    profile: str
    """name of a shipped profile, or the path of a .toml file; a leg ``waypoints`` gives it tracks"""
    estimator: str = "tight"
    """built-in name"""
    gnss: str | None = None
    """receiver of the catalog instead of that of the profile; ``tight`` needs one with a sky, as sky-l1"""
    rnp_nm: Positive = 0.3
    """required navigation performance [nautical miles]"""
    alert_limit_m: Positive | None = None
    """horizontal alert limit [m]; left out: RNP"""
    vertical_limit_m: Positive = 50.0
    """vertical alert limit [m]"""
    time_to_alert_s: Positive = 10.0
    """time in which an alert must come [s]"""
    continuity_s: Positive = 15.0
    """duration of the operation that must not be broken off [s]"""
    false_alarm: _Probability = FALSE_ALARM
    """of an instant without a fault, for the separation of subfilters"""
    missed: _Probability = MISSED
    """of a fault, for the separation of subfilters"""
    draws: Count = 20
    """noise draws"""


@dataclass(frozen=True, slots=True)
class _Run:
    """One draw, as a worker gets it."""

    options: Options
    number: int


@dataclass(frozen=True, slots=True)
class _Watch:
    """What one draw of M instants gives."""

    t: FloatArray  # (M,) [s]
    error: FloatArray  # (M, 2) horizontal, vertical [m]
    level: FloatArray  # (M, 2)
    alarm: BoolArray  # (M,)
    across: FloatArray  # (M,) error across track, to the right [m]; NaN without a track
    off: FloatArray  # (M,) of the flight [m]; NaN without a track


def run(options: Options, work: Work) -> Findings:
    """Return accuracy, integrity, continuity and availability."""
    work.progress("flying", 0, 1)
    profile, _ = _load(options)
    watches = work.map("judging draws", watch_run, [_Run(options, k) for k in range(options.draws)], (0,))
    rnp = options.rnp_nm * _NM
    limits = (options.alert_limit_m or rnp, options.vertical_limit_m)
    alarm = np.array([one.alarm for one in watches])
    planes = [
        Watched(
            _INTERVAL,
            np.array([one.error[:, k] for one in watches]),
            np.array([one.level[:, k] for one in watches]),
            alarm,
            limit,
        )
        for k, limit in enumerate(limits)
    ]
    errors = {"NSE": np.array([one.across for one in watches]), "FTE": np.array([one.off for one in watches])}
    errors["TSE"] = errors["NSE"] + errors["FTE"]
    rows = [*_list_accuracy(errors, rnp), *_list_service(planes, options)]
    names = ("figure", "value", "low", "high", "unit", "required", "held")
    columns = {name: [row[name] for row in rows] for name in names}
    title = f"{options.estimator} on {profile.name}: required navigation performance"
    return Findings(
        verdicts=tuple(_tell(errors, planes, options, rows)),
        tables=(StudyTable("rnp", title, columns), _tabulate_stanford(planes)),
        figures=tuple(_plot(watches, planes)),
        draws=options.draws,
        good=all(row["held"] != "no" for row in rows),
    )


def watch_run(run: _Run) -> _Watch:
    """Return the errors and the protection levels of one draw."""
    options = run.options
    profile, truth = _load(options)
    rows = _choose_rows(truth, profile)
    sensed = pipeline.sense(profile, truth, run.number)
    solution = _navigate(profile, sensed, truth.t[rows])
    if options.estimator == "tight":
        without = [_navigate(profile, one, truth.t[rows]) for one in _leave_out(sensed)]
        protection = protect_by_separation(solution, without, options.false_alarm, options.missed)
    else:
        protection = protect_fault_free(solution)
    apart = error_series(truth, solution).pos_n
    off = course = np.full(len(rows), np.nan)
    if isinstance(profile.flight, FlightSpec):
        off, course = measure_off_track(profile.flight, truth, rows)
    return _Watch(
        truth.t[rows],
        np.column_stack([np.hypot(apart[:, 0], apart[:, 1]), np.abs(apart[:, 2])]),
        protection.level,
        protection.alarm,
        apart[:, 1] * np.cos(course) - apart[:, 0] * np.sin(course),
        off,
    )


@lru_cache(maxsize=1)
def _load(options: Options) -> tuple[Profile, Trajectory]:
    overrides = {} if options.gnss is None else {"sensors.gnss": options.gnss}
    profile = load_profile(options.profile, overrides, None, (options.estimator,))
    _check(options, profile)
    truth = pipeline.fly(profile)
    pipeline.check_times(profile, float(truth.t[-1]))
    return profile, truth


def _check(options: Options, profile: Profile) -> None:
    """Raise ConfigError if the estimator cannot use the receiver."""
    gnss = profile.sensors.gnss
    if options.estimator == "tight" and (gnss is None or gnss.sky is None):
        raise ConfigError(
            f"tight needs measurements of satellites, and {profile.name} has none; --gnss sky-l1 gives them"
        )


def _choose_rows(truth: Trajectory, profile: Profile) -> Any:
    """Return the rows of the truth at whole seconds, from where the profile is evaluated."""
    t = np.arange(np.ceil(max(profile.evaluation_from, truth.t[0])), truth.t[-1] + 1e-9, _INTERVAL)
    return np.unique(np.searchsorted(truth.t, t - 1e-6).clip(max=len(truth.t) - 1))


def _navigate(profile: Profile, sensed: Sensed, t: FloatArray) -> NavSolution:
    choice = profile.estimators[0]
    data = replace(sensed.data, output_t=t)
    return estimator.answer(pipeline.build_estimator(choice), choice.label, data, sensed.initial)


def _leave_out(sensed: Sensed) -> Iterator[Sensed]:
    """Yield the sensor data without each of the satellites that were in view at any time."""
    o = sensed.data.observations
    assert o is not None
    for system, sat in list_satellites(o):
        kept = take_observations(o, (o.system != system) | (o.sat != sat))
        yield replace(sensed, data=replace(sensed.data, observations=kept))


def _list_accuracy(errors: dict[str, FloatArray], rnp: float) -> Iterator[dict[str, Any]]:
    """Yield the rows of what is across track."""
    on = np.isfinite(errors["FTE"]).all(axis=0)
    if not on.any():
        return
    for name, values in errors.items():
        size = np.abs(values[:, on])
        yield _row(f"{name} across track, 95 %", pool_quantile(_known(size), WITHIN), "m")
    within = _known(np.abs(errors["TSE"][:, on])) <= rnp
    found = estimate_fraction(within)
    yield _row("time with TSE within RNP", found, "1", f">= {WITHIN:g}", _compare(found, WITHIN))
    outside = _known(np.abs(errors["TSE"][:, on])) > 2.0 * rnp
    hours = hours_flown(errors["TSE"][:, on], _INTERVAL)
    events = int(outside.any(axis=1).sum())
    bound = bound_per_hour(events, hours)
    found = Estimate(events / hours, 0.0, bound)
    held = "yes" if bound <= OUTSIDE_PER_HOUR else "no" if events else "not shown"
    yield _row("TSE beyond twice RNP, per hour", found, "1/h", f"<= {OUTSIDE_PER_HOUR:g}", held)


def _known(size: FloatArray) -> FloatArray:
    """Return sizes with infinity where there is no solution."""
    return np.where(np.isnan(size), np.inf, size)


def _list_service(planes: list[Watched], options: Options) -> Iterator[dict[str, Any]]:
    """Yield the rows of integrity, continuity and availability (A-2.1.5)."""
    for plane, watched in zip(_PLANES, planes, strict=True):
        found = estimate_availability(watched)
        yield _row(f"availability, {plane}", found, "1", ">= 0.95 to 0.997", _compare(found, 0.95))
    for plane, watched in zip(_PLANES, planes, strict=True):
        lost = estimate_discontinuity(watched, options.continuity_s)
        title = f"risk of an alert in {options.continuity_s:g} s, {plane}"
        held = "not shown" if lost is None or lost.high > 1e-4 else "yes"
        yield _row(title, lost, "1", "<= 1e-5 to 1e-4", "no" if lost and lost.low > 1e-4 else held)
    for plane, watched in zip(_PLANES, planes, strict=True):
        found = estimate_per_run(watched.hazardous)
        yield _row(f"hazardous runs, {plane}", found, "1", "0", _never(found))
    for plane, watched in zip(_PLANES, planes, strict=True):
        beyond, told = count_detected(watched, options.time_to_alert_s)
        if beyond:
            found = estimate_rate(told, beyond)
            title = f"errors beyond the limit told in {options.time_to_alert_s:g} s, {plane}"
            yield _row(title, found, "1", ">= 0.999", _compare(found, 0.999))


def _compare(found: Estimate, least: float) -> str:
    """Return whether a share is at least what is required, by its interval."""
    return "yes" if found.low >= least else "no" if found.high < least else "not shown"


def _never(found: Estimate) -> str:
    return "no" if found.value > 0.0 else "not shown"


def _row(
    figure: str, found: Estimate | None, unit: str, required: str | None = None, held: str | None = None
) -> dict[str, Any]:
    return {"figure": figure, "unit": unit, "required": required, "held": held, **describe_estimate(found)}


def _tabulate_stanford(planes: list[Watched]) -> StudyTable:
    """Return how often each part of the Stanford diagram was visited."""
    names = ("plane", "part", "instants_percent", "runs", "runs_low_percent", "runs_high_percent")
    columns: dict[str, list[Any]] = {name: [] for name in names}
    for plane, watched in zip(_PLANES, planes, strict=True):
        parts = {
            "available, bounded": ~watched.alert & ~watched.misleading,
            "unavailable": watched.alert,
            "misleading: error > level": watched.misleading & ~watched.hazardous,
            "hazardous: error > limit >= level": watched.hazardous,
        }
        for part, where in parts.items():
            runs = estimate_per_run(where)
            row = (
                plane, part, 100.0 * float(where.mean()), int(where.any(axis=1).sum()),
                100.0 * runs.low, 100.0 * runs.high,
            )  # fmt: skip
            for column, value in zip(columns.values(), row, strict=True):
                column.append(value)
    units = {name: "%" for name in names if name.endswith("percent")}
    title = f"Stanford diagram; intervals of {100 * CONFIDENCE:g} % over runs (Clopper and Pearson)"
    return StudyTable("stanford", title, columns, units)


def _tell(
    errors: dict[str, FloatArray], planes: list[Watched], options: Options, rows: list[dict[str, Any]]
) -> list[str]:
    held = {row["figure"]: row for row in rows}
    told = []
    within = held.get("time with TSE within RNP")
    if within is None:
        told.append("The flight has no leg along waypoints: its own error is not known, so no TSE is stated.")
    else:
        total = held["TSE across track, 95 %"]["value"]
        word = {"yes": "is shown", "no": "is missed", "not shown": "is not shown by so few draws"}
        told.append(
            f"RNP {options.rnp_nm:g} ({options.rnp_nm * _NM:.0f} m) {word[within['held']]}: across track the "
            f"total error is below {format_number(total, 3)} m for 95 % of the time on tracks."
        )
        hours = hours_flown(errors["TSE"], _INTERVAL)
        needed = -np.log(1.0 - CONFIDENCE) / OUTSIDE_PER_HOUR
        told.append(
            f"{OUTSIDE_PER_HOUR:g} per hour beyond twice RNP needs about {needed:.0e} independent hours "
            f"without an event; these are {hours:.2g}, so it is not claimed."
        )
    for plane, watched in zip(_PLANES, planes, strict=True):
        level = watched.level[np.isfinite(watched.level)]
        typical = f"median {format_number(np.median(level), 3)} m" if len(level) else "never stated"
        misled = int(watched.misleading.any(axis=1).sum())
        hazard = int(watched.hazardous.any(axis=1).sum())
        limit = format_number(watched.limit)
        told.append(
            f"{plane.capitalize()} protection level: {typical}, alert limit {limit} m; "
            f"the error was larger than the level in {misled} of {options.draws} runs, "
            f"hazardously in {hazard}."
        )
    if options.estimator != "tight":
        told.append(
            "The levels hold while nothing is faulty; only those of tight allow for a faulty satellite."
        )
    return told


def _plot(watches: list[_Watch], planes: list[Watched]) -> Iterator[Plot]:
    """Yield a Stanford diagram and the levels over time, of each plane."""
    for plane, watched in zip(_PLANES, planes, strict=True):
        error, level = watched.error.ravel(), watched.level.ravel()
        shown = np.isfinite(error) & np.isfinite(level) & (error > 0.0)
        if not shown.any():
            continue
        top = 1.5 * max(float(level[shown].max()), float(error[shown].max()), watched.limit)
        low = max(float(error[shown].min()), 1e-3 * top)
        sides = np.array([low, top])
        dots = series.draw_dots(
            "instants", error[shown], level[shown], "an instant", series.ESTIMATORS[0], 1.2
        )
        lines = (
            dots,
            series.draw_line("equal", sides, sides, "level = error", series.REJECTED),
            series.draw_line("limit", sides, np.full(2, watched.limit), "alert limit", series.OUTAGE),
        )
        title = f"{plane} protection level [m]"
        yield Plot(("rnp", f"stanford-{plane}"), title, lines, over="error", across="m", log="xy")
        t = watches[0].t
        with np.errstate(invalid="ignore"):
            worst = np.nanmax(_known(watched.error), axis=0)
        lines = (
            series.draw_line("level", t, watched.level.min(axis=0), "least level", series.ESTIMATORS[0]),
            series.draw_line("error", t, worst, "largest error", series.ESTIMATORS[1]),
            series.draw_line("limit", t, np.full(len(t), watched.limit), "alert limit", series.OUTAGE),
        )
        title = f"{plane} protection level and error, all draws [m]"
        yield Plot(("rnp", f"levels-{plane}"), title, lines, log="y")
