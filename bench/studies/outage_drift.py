"""How far the position drifts without GNSS, by unit, grade and phase of flight, 10 to 600 s after its loss.

Measured: an aerosonde flies a figure-eight and S-turns, then GNSS is lost while it flies straight, turns on
and on, or climbs; the horizontal growth of the error over noise draws, with its interval. Beside it the
closed form of the datasheet with a perfect start, along the headings that are flown. The error itself, with
what it was at the loss, is held against what the filter claims.
By grade: the covariance of the 22-state filter on the flight of section 7.1, and what the bias of the grade
alone would do if nothing had calibrated it (A-2.4.4, A-2.4.7, figures 2.4.1 and 2.4.2).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np

from bench import pipeline, rotation, store
from bench.arrays import FloatArray
from bench.campaigns.worker import fly, get_truth
from bench.config import load_profile
from bench.data import Trajectory
from bench.errors import ConfigError
from bench.evaluation.drift_laws import accel_bias_drift, drift_sd, gyro_bias_drift
from bench.evaluation.ensemble import Estimate, pool_rmse
from bench.plots import series
from bench.plots.series import Plot, Series
from bench.specs import Profile
from bench.studies.catalog_units import Unit, find_units
from bench.studies.linear_flight import GRADES, LOST, LinearFlight, Phase
from bench.studies.study import (
    Count,
    Durations,
    Findings,
    StudyOptions,
    StudyTable,
    Words,
    Work,
    format_estimate,
    make_table,
)
from bench.units import SAME_INSTANT
from bench.wording import format_number

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
PHASES = ("straight", "turn", "climb")
"""What is flown without GNSS."""


class Options(StudyOptions):
    """What may be asked."""

    units: Words = ("grade-1", "grade-2", "grade-3", "stim300", "adis16475", "icm-42688-p")
    """IMUs of the catalog"""
    phases: Words = PHASES
    """what is flown without GNSS: straight, turn, climb"""
    outages_s: Durations = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
    """times since the loss of GNSS; the longest is flown [s]"""
    estimator: str = "loose-full"
    """the filter, a built-in one"""
    gnss: str = "l1-code"
    """the receiver, of the catalog"""
    draws: Count = 10
    """noise draws of each unit and phase"""


@dataclass(frozen=True)
class _Task:
    """One run for a worker."""

    profile: Profile
    truth_key: str
    run: int
    elapsed: tuple[float, ...]  # [s]


@dataclass(frozen=True)
class Drift:
    """The growth of the error of one unit in one phase over draws, at each time since the loss."""

    rms: tuple[Estimate | None, ...]  # horizontal [m]
    error: tuple[Estimate | None, ...]  # the error itself, with what it was at the loss, horizontal [m]
    claimed: FloatArray  # of the error, horizontal, root mean square over the draws [m]
    law: FloatArray  # horizontal, closed form [m]
    axes: FloatArray  # (D, 3) root mean square north, east, down [m]
    most: FloatArray  # largest horizontal [m]
    runs: int  # that have a finite error at the end


def run(options: Options, work: Work) -> Findings:
    """Return the drift by unit and phase, and the covariances by grade."""
    elapsed = tuple(sorted(set(options.outages_s)))
    units = find_units("outages", options.units)
    if unknown := [
        f"study outages: phases: {name!r} must be one of {', '.join(PHASES)}"
        for name in options.phases
        if name not in PHASES
    ]:
        raise ConfigError(*unknown)
    cases = [(unit, phase) for phase in options.phases for unit in options.units]
    profiles = {case: make_profile(*case, elapsed[-1], options.gnss, options.estimator) for case in cases}
    flights = {phase: profiles[options.units[0], phase] for phase in options.phases}
    work.map("flying", fly, list(flights.values()))
    tasks = [
        _Task(profile, store.truth_key(profile.flight), k, elapsed)
        for profile in profiles.values()
        for k in range(options.draws)
    ]
    found = work.map(f"{options.estimator} without GNSS", measure_growth, tasks, first=[0])
    drifts = {
        case: summarize(found[k * options.draws : (k + 1) * options.draws], profile, elapsed)
        for k, (case, profile) in enumerate(profiles.items())
    }
    grades = list(_predict_grades(elapsed, work))
    return Findings(
        verdicts=(*_tell(options, drifts, elapsed), *_tell_grades(grades, elapsed)),
        tables=(*_fill_drifts(drifts, units, elapsed), _fill_grades(grades, elapsed)),
        figures=(*_plot_drifts(options, drifts, elapsed), *_plot_grades(grades, elapsed)),
        draws=options.draws,
    )


def make_profile(unit: str, phase: str, longest: float, gnss: str, estimator: str) -> Profile:
    """Return the flight of a phase with a unit, GNSS lost for so long [s]; errors as for `load_profile`."""
    length = _LOSS - _PRELUDE_S + longest + _AFTER
    legs: dict[str, list[dict[str, Any]]] = {
        "straight": [{"kind": "straight", "duration_s": length}],
        "turn": [{"kind": "s-turns", "by_deg": 60.0, "bank_deg": 25.0, "count": 1 + int(length / 27.0)}],
        "climb": [{"kind": "climb", "to_alt_m": _ALTITUDE + _CLIMB * (length + 20.0), "rate_mps": _CLIMB}],
    }
    values = {
        "leg": [*_PRELUDE, *legs[phase]],
        "rate_hz": 100,
        "gnss_outage": [{"start_s": _LOSS, "duration_s": longest + _LATER}],
        "sensors.imu": unit,
        "sensors.gnss": gnss,
        "evaluation.output_hz": 1.0,
    }
    return load_profile("gnss-denied-leg", values, estimators=[estimator])


def measure_growth(task: _Task) -> FloatArray:
    """Return (D, 5) of a run: growth north, east, down [m]; horizontal error squared and its claim [m^2]."""
    truth = get_truth(task.truth_key, task.profile)
    result = pipeline.run(task.profile, task.run, truth=truth)
    (label,) = result.metrics
    errors, solution = result.errors[label], result.solutions[label]
    rows = np.searchsorted(errors.t, np.array([0.0, *task.elapsed]) + _LOSS + SAME_INSTANT, "right") - 1
    claimed = np.einsum("kii->ki", solution.cov)[np.searchsorted(solution.t, errors.t[rows] - SAME_INSTANT)]
    horizontal = claimed[:, 0] + claimed[:, 1]
    pos = errors.pos_n[rows]
    return np.column_stack([pos - pos[0], np.square(pos[:, :2]).sum(axis=1), horizontal])[1:]


def summarize(runs: Sequence[FloatArray], profile: Profile, elapsed: Sequence[float]) -> Drift:
    """Return the statistics of the draws of one unit and phase."""
    grown = np.stack(runs)  # (R, D, 5)
    good = grown[np.isfinite(grown).all(axis=(1, 2))]
    squares = np.square(good[:, :, :2]).sum(axis=2)
    truth = get_truth(store.truth_key(profile.flight), profile)

    def pool(values: FloatArray) -> tuple[Estimate | None, ...]:
        return tuple(pool_rmse(values[:, k]) if len(good) > 1 else None for k in range(len(elapsed)))

    return Drift(
        rms=pool(squares),
        error=pool(good[:, :, 3]),
        claimed=np.sqrt(good[:, :, 4].mean(axis=0)),
        law=np.array([_find_law(profile, truth, T) for T in elapsed]),
        axes=np.sqrt(np.square(good[:, :, :3]).mean(axis=0)),
        most=np.sqrt(squares.max(axis=0)),
        runs=len(good),
    )


def _find_law(profile: Profile, truth: Trajectory, T: float) -> float:
    """Return the root mean square of the horizontal drift by the closed form [m]."""
    at = np.linspace(_LOSS, _LOSS + T, max(2, round(T) + 1))
    rows = np.searchsorted(truth.t, at - SAME_INSTANT)
    heading = rotation.to_euler(truth.q_nb[rows])[2]
    sensors = profile.sensors
    velocity = sensors.gnss.vel_markov_sd if sensors.gnss else 0.0
    return float(np.sqrt(2.0) * drift_sd(T, sensors.imu, heading=heading, velocity=velocity))


@dataclass(frozen=True)
class _Grown:
    """A grade on the linear flight of section 7.1."""

    name: str
    phase: Phase
    east: FloatArray  # growth of the east standard deviation [m]
    by_accel: FloatArray  # what its bias alone would do [m]
    by_gyro: FloatArray


def _predict_grades(elapsed: Sequence[float], work: Work) -> Iterator[_Grown]:
    rows = np.rint(elapsed).astype(int)
    found = work.map("covariances by grade", _grow, [(name, int(rows[-1])) for name in GRADES])
    for phase in get_args(Phase):
        for name, sd in zip(GRADES, found, strict=True):
            sigmas = GRADES[name].sigmas
            by_accel, by_gyro = (
                np.array([size * law(T) for T in elapsed])
                for size, law in ((sigmas.da, accel_bias_drift), (sigmas.eps, gyro_bias_drift))
            )
            east = np.sqrt(np.maximum(sd[phase][rows] ** 2 - sd[phase][0] ** 2, 0.0))
            yield _Grown(name, phase, east, by_accel, by_gyro)


def _grow(asked: tuple[str, int]) -> dict[str, FloatArray]:
    """Return the east standard deviation from the loss of GNSS on, second by second, of each phase [m]."""
    name, seconds = asked
    grade, flight = GRADES[name], LinearFlight()
    for P in flight.carry(grade, flight.start(grade), 0, LOST):
        lost = P
    return {
        phase: flight.take_sd([lost, *LinearFlight(phase).carry(grade, lost, LOST, LOST + seconds)])[:, 0]
        for phase in get_args(Phase)
    }


# --- tables, words and figures ----------------------------------------------------------------------------


def _fill_drifts(
    drifts: dict[tuple[str, str], Drift], units: Mapping[str, Unit], elapsed: Sequence[float]
) -> tuple[StudyTable, ...]:
    """Return the horizontal drift beside the closed form, the error beside the claim, the drift by axis."""
    rows, claims, by_axis = [], [], []
    for (unit, phase), drift in drifts.items():
        for k, T in enumerate(elapsed):
            rms, error = (
                (one.value, one.low, one.high) if one else (None, None, None)
                for one in (drift.rms[k], drift.error[k])
            )
            rows.append((unit, phase, T, *rms, drift.law[k]))
            claims.append((unit, phase, T, *error, drift.claimed[k]))
            by_axis.append((unit, units[unit].grade, phase, T, *drift.axes[k], drift.most[k], drift.runs))
    names = ("unit", "phase", "outage_s", "drift_m", "low_m", "high_m", "law_m")
    claim = ("unit", "phase", "outage_s", "error_m", "low_m", "high_m", "claimed_m")
    more = ("unit", "class", "phase", "outage_s", "north_m", "east_m", "down_m", "largest_m", "runs")
    title = "Horizontal drift since the loss of GNSS: RMS with its 95 % interval, closed form"
    return (
        make_table("drift", title, names, rows),
        make_table("claims", "Horizontal error: RMS with its 95 % interval, as claimed", claim, claims),
        make_table("axes", "RMS by axis, and the largest horizontal drift", more, by_axis),
    )


def _fill_grades(grades: Sequence[_Grown], elapsed: Sequence[float]) -> StudyTable:
    rows = [
        (one.name, one.phase, T, one.east[k], one.by_accel[k], one.by_gyro[k])
        for one in grades
        for k, T in enumerate(elapsed)
    ]
    names = ("grade", "phase", "outage_s", "growth_east_m", "accel_bias_m", "gyro_bias_m")
    title = "By grade: covariance of the 22-state filter, 1 sigma, and each bias alone, not calibrated"
    return make_table("grades", title, names, rows)


def _tell(options: Options, drifts: dict[tuple[str, str], Drift], elapsed: Sequence[float]) -> Iterator[str]:
    k = min(range(len(elapsed)), key=lambda n: abs(elapsed[n] - 60.0))
    for phase in options.phases:
        parts = []
        for unit in options.units:
            drift = drifts[unit, phase]
            rms = drift.rms[k]
            text = format_estimate(rms) if rms else "no two runs"
            parts.append(f"{unit} {text}, law {format_number(drift.law[k], 3)}")
        yield f"Drift after {elapsed[k]:g} s without GNSS, {phase} [m]: {'; '.join(parts)}."
    outside = Counter(
        unit
        for (unit, _), drift in drifts.items()
        for error, claimed in zip(drift.error, drift.claimed, strict=True)
        if error is not None and not error.low <= claimed <= error.high
    )
    total = len(drifts) * len(elapsed)
    missed = ", ".join(f"{unit} {count}" for unit, count in outside.items())
    yield (
        f"What {options.estimator} claims lies in the 95 % interval of the measured error in "
        f"{total - outside.total()} of {total} cases" + (f"; not in, by unit: {missed}." if missed else ".")
    )


def _tell_grades(grades: Sequence[_Grown], elapsed: Sequence[float]) -> Iterator[str]:
    parts = []
    for one in grades:
        if one.phase == "s-turns":
            T = np.interp(5.0, one.east, elapsed, left=np.nan, right=np.nan)
            parts.append(f"{one.name} {T:.0f} s" if np.isfinite(T) else f"{one.name} not within the outages")
    yield f"By covariance the drift is 5 m east (1 sigma), S-turns flown on, after: {', '.join(parts)}."


def _plot_drifts(
    options: Options, drifts: dict[tuple[str, str], Drift], elapsed: Sequence[float]
) -> Iterator[Plot]:
    t = np.array(elapsed)
    colours = series.estimator_colours(options.units)
    for phase in options.phases:
        lines: list[Series] = []
        for unit in options.units:
            drift, colour = drifts[unit, phase], colours[unit]
            values = np.array([(e.value, e.low, e.high) if e else (np.nan,) * 3 for e in drift.error])
            lines.append(Series(unit, t, values, (unit,) * 3, (colour,) * 3, (1.5, 1.0, 1.0), band=(1, 2)))
            lines.append(series.draw_dots(f"{unit} claimed", t, drift.claimed, "claimed", colour, 3.0))
        title = f"{phase}: horizontal error, RMS with 95 % band [m]"
        yield Plot(("outages", phase), title, tuple(lines), over="outage", log="xy")
    for phase in options.phases:
        lines = []
        for unit in options.units:
            drift = drifts[unit, phase]
            ratio = np.array([e.value if e else np.nan for e in drift.rms]) / drift.law
            lines.append(series.draw_line(unit, t, ratio, unit, colours[unit]))
        title = f"{phase}: drift over its closed form"
        yield Plot(("outages", f"{phase}-over-law"), title, tuple(lines), over="outage", log="xy")


def _plot_grades(grades: Sequence[_Grown], elapsed: Sequence[float]) -> Iterator[Plot]:
    t = np.array(elapsed)
    colours = series.estimator_colours(GRADES)
    for phase in get_args(Phase):
        here = [one for one in grades if one.phase == phase]
        lines = tuple(series.draw_line(one.name, t, one.east, one.name, colours[one.name]) for one in here)
        title = f"by grade, {phase}: growth of the east sigma [m]"
        yield Plot(("outages", f"grades-{phase}"), title, lines, over="outage", log="xy")
    for kind in ("accel", "gyro"):
        lines = tuple(
            series.draw_line(one.name, t, getattr(one, f"by_{kind}"), one.name, colours[one.name])
            for one in grades
            if one.phase == "straight"
        )
        word = "accelerometer" if kind == "accel" else "gyro"
        title = f"{word} bias of the grade alone, not calibrated [m]"
        yield Plot(("outages", f"{word}-bias-alone"), title, lines, over="outage", log="xy")
