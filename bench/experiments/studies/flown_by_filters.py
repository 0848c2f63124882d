"""Miss distance and deviation from the path of an aircraft that a filter steers, by filter and IMU.

Each run is a flight of its own (`bench.pipeline.closed_loop`). The miss distance is the distance from the end
of the same flight guided by the truth. An estimate without error flies the same bits, so the miss is due to
navigation alone. If the flight has a flare, the touch-down counts instead of the end. A crash misses by more
than any distance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.mathematics import earth
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.data import Trajectory
from bench.core.records.findings import Findings, FindingTable, make_table
from bench.core.records.findings.series import ESTIMATORS, Plot, draw_line
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError
from bench.core.words.wording import format_number
from bench.evaluation.ensembles.ensemble import Quantile, estimate_quantile, pool_rmse
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.errors.total_system import PARTS, resolve_along
from bench.experiments.studies.study import (
    FLOWN_BY,
    Count,
    StudyWorkers,
    UnitOptions,
    Words,
    ask_each,
    refuse_navigation,
)
from bench.io.config import read_profile
from bench.pipeline import closed_loop
from bench.simulation.flight.guidance.desired_path import measure_steered
from bench.simulation.flight.legs.landing import Flare

STUDY = 9, "closed-loop"
QUESTION = "Where does the aircraft end its flight if a filter guides it, and how far is it from its path?"

_SMALLEST = 1e-3  # misses below this are alike [m]


class Options(UnitOptions):
    """Options of the study."""

    profiles: Words
    """shipped profiles with ``[guidance]``, or .toml files of your own, separated by commas"""
    estimators: Words = ("loose-15", "loose-full")
    """filters that guide the aircraft; each is compared with the first"""
    units: Words | None = None
    """IMUs of the catalog, or .toml files of your own; default: the IMU of the profile"""
    runs: Count = 10
    """flights of each filter with each unit, the same runs for all"""


@dataclass(frozen=True)
class _FlownTask:
    """One flight, as a worker gets it."""

    profile: Profile
    run: int


@dataclass(frozen=True, slots=True)
class FlownByFilter:
    """Result of one flight."""

    miss: float  # horizontal, infinite after a crash [m]
    crashed: bool
    errors: Mapping[str, float]  # tse, fte, nse: mean square across the path [m^2]; empty without a path


def run(options: Options, work: StudyWorkers) -> Findings:
    """Return the miss distance and the total system error by filter and unit."""
    refuse_navigation("closed-loop", options, "--estimators")
    return ask_each("closed-loop", options, work, load_cases, _ask, together=True)


def _ask(options: Options, work: StudyWorkers) -> Findings:
    cases = load_cases(options)
    work.map("flying by the truth", _fly_open, list(cases.values())[:1])
    tasks = [_FlownTask(profile, k) for profile in cases.values() for k in range(options.runs)]
    found = work.map("flying by filters", fly_draw, tasks, first=[0])
    n = options.runs
    flown = {case: found[k * n : (k + 1) * n] for k, case in enumerate(cases)}
    return Findings(
        verdicts=tuple(tell_flown(flown)),
        tables=tuple(tabulate_flown(flown)),
        figures=(plot_misses(flown),),
        runs=n,
    )


def fly_draw(task: _FlownTask) -> FlownByFilter:
    """Fly one run and return its result."""
    profile = task.profile
    closed = closed_loop.fly(profile, task.run)
    truth, answers = closed.truth, closed.answers
    crashed = bool(truth.events.select("crash"))
    miss = np.inf if crashed else measure_miss(profile, truth, _fly_open(profile))
    errors = error_series(truth, answers)
    path = measure_steered(profile.flight, truth, errors.t)
    squares = dict[str, float]()
    if path is not None:
        resolved = resolve_along(path, errors.pos_n)
        on = np.isfinite(path.right) & (errors.t >= profile.evaluation.begin)
        if on.any():
            squares = {part: float(np.mean(resolved[part]["across"][on] ** 2)) for part in PARTS}
    return FlownByFilter(float(miss), crashed, squares)


def measure_miss(profile: Profile, truth: Trajectory, by_truth: Trajectory) -> float:
    """Return the horizontal distance between the ends, or touch-downs, of two flights of a profile [m]."""
    ends = []
    for one in (truth, by_truth):
        t = float(one.t[-1])
        legs = profile.flight.legs if isinstance(profile.flight, FlightSpec) else ()
        for leg, (_, end, _) in zip(legs, one.events.select("leg"), strict=False):
            if isinstance(leg, Flare):
                t = float(end)
        ends.append(one.lla[np.searchsorted(one.t, t - SAME_INSTANT)])
    north, east, _ = earth.difference_n(ends[0], ends[1])
    return float(np.hypot(north, east))


def _fly_open(profile: Profile) -> Trajectory:
    return pipeline.fly(replace(profile, guidance=None))


def load_cases(options: Options) -> dict[tuple[str | None, str], Profile]:
    """Return the profile by unit and filter."""
    profile = read_profile(options.profile, options.settings, options.seed)
    if profile.guidance is None:
        raise ConfigError(f"study closed-loop: {profile.name} has no [guidance]: no filter flies it")
    cases = dict[tuple[str | None, str], Profile]()
    for unit, use in product(options.units or (None,), options.estimators):
        given: dict[str, Any] = {"guidance.options": {}, **options.settings, FLOWN_BY: use}
        given |= {} if unit is None else {"sensors.imu": unit}
        cases[unit, use] = read_profile(options.profile, given, options.seed)
    return cases


def compare_misses(one: FloatArray, first: FloatArray) -> tuple[str, Quantile]:
    """Return the verdict on misses (R,) of the same runs, and the median ratio; a crash is infinite."""
    with np.errstate(invalid="ignore"):
        ratio = np.maximum(one, _SMALLEST) / np.maximum(first, _SMALLEST)
    found = estimate_quantile(np.where(np.isnan(ratio), 1.0, ratio), 0.5)
    if found.high is not None and found.high < 1.0:
        return "better", found
    if found.low is not None and found.low > 1.0:
        return "worse", found
    return "undecided", found


def _collect(flights: list[FlownByFilter]) -> FloatArray:
    return np.array([one.miss for one in flights])


def _finite(value: float | None) -> float | None:
    return value if value is not None and np.isfinite(value) else None


def tabulate_flown(flown: Mapping[tuple[str | None, str], list[FlownByFilter]]) -> Iterator[FindingTable]:
    """Yield the misses and, for flights with a path, the cross-track errors."""
    rows, across = list[list[Any]](), list[list[Any]]()
    first = _collect(next(iter(flown.values())))
    for (unit, use), flights in flown.items():
        miss = _collect(flights)
        middle = estimate_quantile(miss, 0.5)
        head = [unit or "of the profile", use]
        row = [*head, len(flights), sum(one.crashed for one in flights)]
        row += [_finite(one) for one in (middle.value, middle.low, middle.high, float(miss.max()))]
        for part in PARTS:
            squares = np.array([one.errors[part] for one in flights if part in one.errors])
            if len(squares) > 1:
                rms = pool_rmse(squares)
                across.append([*head, part.upper(), rms.value, rms.low, rms.high])
        rows.append([*row, compare_misses(miss, first)[0]])
    rows[0][-1] = "the first"
    names = ("imu", "filter", "runs", "crashed", "miss_m", "miss_low_m", "miss_high_m", "miss_max_m")
    title = "Miss distance: median with its 95 % interval, and the largest; none: a crash"
    yield make_table("closed-loop", title, (*names, "miss_is"), rows)
    if across:
        title = "Errors across the path: total, of the flight, of the navigation; RMS with its 95 % interval"
        yield make_table("across", title, ("imu", "filter", "error", "rms_m", "low_m", "high_m"), across)


def plot_misses(flown: Mapping[tuple[str | None, str], list[FlownByFilter]]) -> Plot:
    """Return the fractions of the flights that miss by less than a distance."""
    lines = []
    for k, (case, flights) in enumerate(flown.items()):
        miss = np.sort(_collect(flights))
        share = 100.0 * np.arange(1, len(miss) + 1) / len(miss)
        kept, name = np.isfinite(miss), _name(case)
        lines.append(draw_line(name, miss[kept], share[kept], name, ESTIMATORS[k % len(ESTIMATORS)]))
    title = "flights that miss by less [%]"
    return Plot(("closed-loop", "miss"), title, tuple(lines), across="m", over="miss distance")


def _name(case: tuple[str | None, str]) -> str:
    return case[1] if case[0] is None else f"{case[1]} with {case[0]}"


def tell_flown(flown: Mapping[tuple[str | None, str], list[FlownByFilter]]) -> Iterator[str]:
    """Yield a sentence for each unit and filter."""
    first = next(iter(flown))
    for case, flights in flown.items():
        miss, crashes = _collect(flights), sum(one.crashed for one in flights)
        middle = estimate_quantile(miss, 0.5)
        told = f"{_name(case)}: "
        if np.isfinite(middle.value):
            told += f"half of {len(flights)} flights miss by less than {format_number(middle.value, 3)} m"
        else:
            told += f"most of {len(flights)} flights crash"
        told += f"; {crashes} crashed" if crashes and np.isfinite(middle.value) else ""
        squares = [one.errors["tse"] for one in flights if one.errors]
        if squares:
            told += (
                f"; total system error {format_number(np.sqrt(np.mean(squares)), 3)} m rms across its path"
            )
        if case != first:
            word, ratio = compare_misses(miss, _collect(flown[first]))
            value = f", {format_number(ratio.value, 3)} times its miss" if np.isfinite(ratio.value) else ""
            told += f"; against {_name(first)} {word}{value}"
        yield told + "."
