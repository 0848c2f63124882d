"""How far the position drifts without GNSS, by unit, grade and phase of flight, second by second.

Measured: an aerosonde flies a figure-eight and S-turns, then GNSS is lost while it flies straight, turns on
and on, or climbs, or flights of your own from their first [[gnss_outage]] on; the horizontal growth of the
error over noise draws, with its interval. Beside it the closed form of the datasheet along the headings that
are flown, by source: biases and noise of a calibrated unit, and the velocity error of the receiver, which no
filter tells from motion. The error itself, with what it was at the loss, is held against what the filter
claims. By grade: the covariance of the 22-state filter on the flight of section 7.1 (`outage_grades`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from bench import pipeline, rotation, store
from bench.arrays import FloatArray
from bench.campaigns.worker import fly, get_truth
from bench.config import load_profile
from bench.errors import ConfigError
from bench.evaluation.drift_laws import split_drift
from bench.evaluation.ensemble import Estimate, estimate_quantile, estimate_rate, pool_rmse
from bench.evaluation.paired_draws import Pair, compare_draws_of
from bench.specs import Profile
from bench.studies.catalog_units import find_units
from bench.studies.outage_grades import fill_grades, find_time, plot_grades, predict_grades, tell_grades
from bench.studies.outage_tables import fill_drifts, plot_drifts, tell_drifts
from bench.studies.study import Count, Durations, Findings, FlightOptions, Positive, Words, Work
from bench.units import SAME_INSTANT

_PRELUDE_S = 131.0  # of the legs before [s]
_LOSS = 150.0  # when GNSS is lost [s]
_LATER = 2.0  # so long GNSS stays lost after the last instant that counts [s]
_AFTER = 5.0  # and the flight goes on [s]
_PRELUDE: tuple[dict[str, Any], ...] = (
    {"kind": "straight", "duration_s": 30.0},
    {"kind": "figure-eight", "bank_deg": 30.0, "laps": 1},
    {"kind": "s-turns", "by_deg": 45.0, "bank_deg": 30.0, "count": 2},
)
_ALTITUDE = 1200.0  # of the profile [m]
_CLIMB = 1.5  # [m/s]
_RECEIVER = "l1-code"
PHASES = ("straight", "turn", "climb")
"""What is flown without GNSS."""


class Options(FlightOptions):
    """What may be asked."""

    units: Words = ("grade-1", "grade-2", "grade-3", "stim300", "adis16475", "icm-42688-p")
    """IMUs of the catalog, or .toml files of your own"""
    phases: Words = PHASES
    """what is flown without GNSS: straight, turn, climb"""
    profiles: Words | None = None
    """flights instead of the phases, lost from their first [[gnss_outage]] on"""
    outages_s: Durations = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
    """times since the loss of GNSS; the longest is flown [s]"""
    error_m: Positive = 5.0
    """drift whose time is told [m]"""
    estimator: str = "loose-full"
    """the filter, a built-in one"""
    gnss: str | None = None
    """the receiver, of the catalog or a file; left out: l1-code, or that of the profiles"""
    draws: Count = 10
    """noise draws of each unit and phase"""


@dataclass(frozen=True)
class _Task:
    """One run for a worker."""

    profile: Profile
    truth_key: str
    run: int
    grid: tuple[float, ...]  # since the loss [s]


@dataclass(frozen=True)
class Drift:
    """The growth of the error of one unit in one phase over draws, second by second since the loss."""

    grid: FloatArray  # (D,) since the loss [s]
    grown: FloatArray  # (R, D, 5) north, east, down [m]; horizontal error squared, its claim [m^2]; NaN: lost
    law: Mapping[str, FloatArray]  # (D,) by source, horizontal, closed form, root mean square [m]

    @cached_property
    def good(self) -> FloatArray:
        """The draws (K, D, 5) that are not lost."""
        return self.grown[np.isfinite(self.grown).all(axis=(1, 2))]

    @property
    def lost(self) -> int:
        """Draws that have no finite error at some time."""
        return len(self.grown) - len(self.good)

    @property
    def sizes(self) -> FloatArray:
        """Horizontal growth (K, D) [m]."""
        return np.asarray(np.hypot(self.good[:, :, 0], self.good[:, :, 1]))

    @cached_property
    def rms(self) -> FloatArray:
        """Root mean square of the horizontal growth, and its 95 % interval (D, 3) [m]."""
        return self._pool(np.square(self.sizes))

    @cached_property
    def error(self) -> FloatArray:
        """The same of the horizontal error, with what it was at the loss (D, 3) [m]."""
        return self._pool(self.good[:, :, 3])

    def _pool(self, squares: FloatArray) -> FloatArray:
        if len(squares) < 2:
            return np.full((len(self.grid), 3), np.nan)
        found = [pool_rmse(column) for column in squares.T]
        return np.array([(one.value, one.low, one.high) for one in found])

    @property
    def claimed(self) -> FloatArray:
        """The horizontal error that the filter claims, root mean square over the draws (D,) [m]."""
        return np.asarray(np.sqrt(self.good[:, :, 4].mean(axis=0)))

    @property
    def whole_law(self) -> FloatArray:
        """The closed form of all sources together (D,) [m]."""
        return np.asarray(np.sqrt(sum((np.square(one) for one in self.law.values()), 0.0 * self.grid)))

    def quantile(self, k: int, fraction: float) -> float | None:
        """Return a quantile of the horizontal growth over the draws at an instant [m]."""
        return estimate_quantile(self.sizes[:, k], fraction).value if len(self.good) else None

    def rate_lost(self) -> Estimate:
        """Return which share of draws is lost."""
        return estimate_rate(self.lost, len(self.grown))

    def find_times(self, limit: float) -> tuple[float | None, float | None, float | None]:
        """Return when the drift is beyond a limit [m], and the ends of its 95 % interval [s]; None: never."""
        value, low, high = self.rms.T
        reached = (find_time(self.grid, column, limit) for column in (value, high, low))
        return tuple(reached)  # type: ignore[return-value]


def run(options: Options, work: Work) -> Findings:
    """Return the drift by unit and phase, and the covariances by grade."""
    elapsed = tuple(sorted(set(options.outages_s)))
    units = find_units("outages", options.units)
    phases = options.profiles or options.phases
    if unknown := [
        f"study outages: phases: {name!r} must be one of {', '.join(PHASES)}"
        for name in ([] if options.profiles else phases)
        if name not in PHASES
    ]:
        raise ConfigError(*unknown)
    cases = [(unit, phase) for phase in phases for unit in options.units]
    profiles = {case: make_profile(options, *case, elapsed[-1]) for case in cases}
    flights = {phase: profiles[options.units[0], phase] for phase in phases}
    work.map("flying", fly, list(flights.values()))
    grids = {phase: make_grid(flight, elapsed) for phase, flight in flights.items()}
    tasks = [
        _Task(profile, store.truth_key(profile.flight), k, grids[phase])
        for (_, phase), profile in profiles.items()
        for k in range(options.draws)
    ]
    found = work.map(f"{options.estimator} without GNSS", measure_growth, tasks, first=[0])
    drifts = {
        case: Drift(
            np.array(grids[case[1]]),
            np.stack(found[k * options.draws : (k + 1) * options.draws]),
            find_law(profile, grids[case[1]]),
        )
        for k, (case, profile) in enumerate(profiles.items())
    }
    grades = predict_grades(elapsed[-1], work)
    pairs = {phase: list(pair_units(drifts, options.units, phase)) for phase in phases}
    return Findings(
        verdicts=(*tell_drifts(options, drifts, pairs, elapsed), *tell_grades(grades, options.error_m)),
        tables=(
            *fill_drifts(drifts, units, elapsed, options.error_m),
            fill_grades(grades, elapsed, options.error_m),
        ),
        figures=(*plot_drifts(options.units, phases, drifts), *plot_grades(grades)),
        draws=options.draws,
    )


def make_profile(options: Options, unit: str, phase: str, longest: float) -> Profile:
    """Return the flight of a phase, or a profile, with a unit; errors as for `load_profile`."""
    given = {**options.settings, "sensors.imu": unit, "evaluation.output_hz": 1.0}
    if options.profiles:
        if options.gnss:
            given["sensors.gnss"] = options.gnss
        profile = load_profile(phase, given, options.seed, [options.estimator])
        if not profile.sensors.gnss_outages:
            raise ConfigError(f"study outages: {phase} has no [[gnss_outage]]")
        return profile
    length = _LOSS - _PRELUDE_S + longest + _AFTER
    legs: dict[str, list[dict[str, Any]]] = {
        "straight": [{"kind": "straight", "duration_s": length}],
        "turn": [{"kind": "s-turns", "by_deg": 60.0, "bank_deg": 25.0, "count": 1 + int(length / 27.0)}],
        "climb": [{"kind": "climb", "to_alt_m": _ALTITUDE + _CLIMB * (length + 20.0), "rate_mps": _CLIMB}],
    }
    own = {
        "leg": [*_PRELUDE, *legs[phase]],
        "rate_hz": 100,
        "gnss_outage": [{"start_s": _LOSS, "duration_s": longest + _LATER}],
        "sensors.gnss": options.gnss or _RECEIVER,
    }
    return load_profile("gnss-denied-leg", own | given, options.seed, [options.estimator])


def make_grid(profile: Profile, elapsed: Sequence[float]) -> tuple[float, ...]:
    """Return every second since the loss, and the times asked for, as far as the outage goes [s]."""
    start, stop = profile.sensors.gnss_outages[0]
    last = min(elapsed[-1], stop - start - SAME_INSTANT)
    grid = np.union1d(np.arange(1.0, last + SAME_INSTANT), elapsed)
    return tuple(grid[grid <= last + SAME_INSTANT].tolist())


def measure_growth(task: _Task) -> FloatArray:
    """Return (D, 5) of a run: growth north, east, down [m]; horizontal error squared and its claim [m^2]."""
    truth = get_truth(task.truth_key, task.profile)
    result = pipeline.run(task.profile, task.run, truth=truth)
    (label,) = result.metrics
    errors, solution = result.errors[label], result.solutions[label]
    loss = task.profile.sensors.gnss_outages[0][0]
    rows = np.searchsorted(errors.t, np.array([0.0, *task.grid]) + loss + SAME_INSTANT, "right") - 1
    claimed = np.einsum("kii->ki", solution.cov)[np.searchsorted(solution.t, errors.t[rows] - SAME_INSTANT)]
    pos = errors.pos_n[rows]
    squares = np.square(pos[:, :2]).sum(axis=1)
    return np.column_stack([pos - pos[0], squares, claimed[:, 0] + claimed[:, 1]])[1:]


def find_law(profile: Profile, grid: Sequence[float]) -> dict[str, FloatArray]:
    """Return the root mean square of the horizontal drift by the closed form (D,), by source [m].

    The receiver leaves its slow velocity error at the loss, everything else is the unit's own.
    """
    truth, loss = get_truth(store.truth_key(profile.flight), profile), profile.sensors.gnss_outages[0][0]
    at = np.arange(loss, loss + grid[-1] + 1.0)
    heading = rotation.to_euler(
        truth.q_nb[np.searchsorted(truth.t, at - SAME_INSTANT).clip(max=len(truth.t) - 1)]
    )[2]
    sensors = profile.sensors
    velocity = sensors.gnss.vel_markov_sd if sensors.gnss else 0.0
    parts = [
        split_drift(T, sensors.imu, heading=heading[: max(2, round(T) + 1)], velocity=velocity) for T in grid
    ]
    sources = {"receiver velocity" if key == "velocity" else key: key for key in parts[0]}
    return {
        name: np.sqrt(2.0) * np.array([part[key] for part in parts])
        for name, key in sources.items()
        if any(part[key] for part in parts)
    }


def pair_units(
    drifts: Mapping[tuple[str, str], Drift], units: Sequence[str], phase: str, near: float = 60.0
) -> Iterator[Pair]:
    """Yield each unit over the next better one, by their drift on the same draws near a time [s]."""
    kept = [name for name in units if not drifts[name, phase].lost]
    k = {name: int(np.argmin(np.abs(drifts[name, phase].grid - near))) for name in kept}
    ordered = sorted(kept, key=lambda name: float(drifts[name, phase].rms[k[name], 0]))
    for better, worse in pairwise(ordered):
        first, second = (drifts[name, phase].sizes[:, k[name]] for name in (better, worse))
        yield compare_draws_of((better, worse), first, second)
