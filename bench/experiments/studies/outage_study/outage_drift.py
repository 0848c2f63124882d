"""Position drift without GNSS, by IMU, grade and phase of flight, second by second.

Measured: an Aerosonde flies a figure-eight and S-turns. Then GNSS fails while the aircraft flies straight,
turns continuously or climbs. With --profiles your own flights are flown, from their first [[gnss_outage]] on.
The result is the horizontal drift over the runs, with its interval.

Predicted: the closed form of the datasheet along the headings that are flown, by source. The sources are
biases and noise of a calibrated IMU, and the velocity error of the receiver, which no filter can separate
from motion. The error, including the error at the start of the outage, is compared with the reported sigma.
By grade: the covariance of the 22-state filter on the flight of equations 7.1 (`outage_grades`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench import pipeline
from bench.core.mathematics import rotation
from bench.core.mathematics.arrays import FloatArray
from bench.core.mathematics.units import SAME_INSTANT
from bench.core.records.findings import Findings
from bench.core.records.specs import Profile
from bench.core.words.exceptions import ConfigError, EstimatorFailedError
from bench.evaluation.errors.error_series import error_series
from bench.evaluation.errors.failures import make_failed_solution
from bench.evaluation.linear.drift_laws import split_drift
from bench.experiments.campaigns.worker import fly, get_truth
from bench.experiments.studies.outage_study.outage_grades import (
    fill_grades,
    plot_grades,
    predict_grades,
    tell_grades,
)
from bench.experiments.studies.outage_study.outage_growth import Drift, pair_units
from bench.experiments.studies.outage_study.outage_tables import fill_drifts, plot_drifts, tell_drifts
from bench.experiments.studies.study import Count, Durations, FlightOptions, Positive, StudyWorkers, Words
from bench.experiments.studies.unit_study.catalog_units import find_units
from bench.io import results
from bench.io.config import read_profile

STUDY = 2, "outages"
QUESTION = "How far does the position drift without GNSS, by unit and by phase of flight?"

_PRELUDE_S = 131.0  # of the legs before [s]
_LOSS = 150.0  # when GNSS is lost [s]
_LATER = 2.0  # so long GNSS stays lost after the last epoch that counts [s]
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
    """Options of the study."""

    units: Words = ("grade-1", "grade-2", "grade-3", "stim300", "adis16475", "icm-42688-p")
    """IMUs of the catalog, or .toml files of your own"""
    phases: Words = PHASES
    """motion without GNSS: straight, turn, climb"""
    profiles: Words | None = None
    """flights instead of the phases, without GNSS from their first [[gnss_outage]] on"""
    outages_s: Durations = (10.0, 30.0, 60.0, 120.0, 300.0, 600.0)
    """times since the start of the outage; the longest is flown [s]"""
    error_m: Positive = 5.0
    """drift for which the time is computed [m]"""
    estimator: str = "loose-full"
    """built-in filter"""
    gnss: str | None = None
    """receiver, from the catalog or a file; default: l1-code, or the receiver of the profile"""
    runs: Count = 10
    """runs of each IMU in each phase of flight"""


@dataclass(frozen=True)
class DriftRun:
    """One run for a worker."""

    profile: Profile
    truth_key: str
    run: int
    grid: tuple[float, ...]  # since the loss [s]


def run(options: Options, work: StudyWorkers) -> Findings:
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
        DriftRun(profile, results.truth_key(profile.flight), k, grids[phase])
        for (_, phase), profile in profiles.items()
        for k in range(options.runs)
    ]
    found = work.map(f"{options.estimator} without GNSS", measure_growth, tasks, first=[0])
    drifts = {
        case: Drift(
            np.array(grids[case[1]]),
            np.stack(found[k * options.runs : (k + 1) * options.runs]),
            find_law(profile, grids[case[1]]),
        )
        for k, (case, profile) in enumerate(profiles.items())
    }
    grades = predict_grades(elapsed[-1], work)
    pairs = {phase: list(pair_units(drifts, options.units, phase)) for phase in phases}
    limit = options.error_m
    told = tell_drifts(options.units, options.estimator, drifts, pairs, elapsed, limit)
    return Findings(
        verdicts=(*told, *tell_grades(grades, limit)),
        tables=(
            *fill_drifts(drifts, units, elapsed, limit),
            fill_grades(grades, elapsed, limit),
        ),
        figures=(*plot_drifts(options.units, phases, drifts), *plot_grades(grades)),
        runs=options.runs,
    )


def make_profile(options: Options, unit: str, phase: str, longest: float) -> Profile:
    """Return the flight of a phase, or a profile, with a unit; errors as for `read_profile`."""
    given = {**options.settings, "sensors.imu": unit, "evaluation.output_hz": 1.0}
    if options.profiles:
        if options.gnss:
            given["sensors.gnss"] = options.gnss
        profile = read_profile(phase, given, options.seed, [options.estimator])
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
    return read_profile("gnss-denied-leg", own | given, options.seed, [options.estimator])


def make_grid(profile: Profile, elapsed: Sequence[float]) -> tuple[float, ...]:
    """Return every second since the start of the outage and the requested times, up to its end [s]."""
    start, stop = profile.sensors.gnss_outages[0]
    last = min(elapsed[-1], stop - start)
    grid = np.union1d(np.arange(1.0, last), [*elapsed, last])
    return tuple(grid[grid <= last + SAME_INSTANT].tolist())


def measure_growth(task: DriftRun) -> FloatArray:
    """Return (D, 5) of a run: growth north, east, down [m]; horizontal error squared, its variance [m^2].

    NaN if the filter failed.
    """
    profile, truth = task.profile, get_truth(task.truth_key, task.profile)
    pipeline.check_times(profile, float(truth.t[-1]))
    sensed = pipeline.sense(profile, truth, task.run)
    at = list_instants(truth.t, profile.sensors.gnss_outages[0], task.grid)
    try:
        solution = pipeline.navigate(profile.estimators[0], replace(sensed.data, output_t=at), sensed.initial)
    except EstimatorFailedError as error:
        solution = make_failed_solution(at, str(error))
    pos = error_series(truth, solution).pos_n
    squares = np.square(pos[:, :2]).sum(axis=1)
    claimed = solution.cov[:, 0, 0] + solution.cov[:, 1, 1]
    return np.column_stack([pos - pos[0], squares, claimed])[1:]


def list_instants(t: FloatArray, outage: tuple[float, float], grid: Sequence[float]) -> FloatArray:
    """Return the start of the outage and the epochs after it (1 + D,) [s]; the last is before the end.

    A fix at the end itself has ended the drift. ``t`` (N,) are the epochs of the truth.
    """
    at, end = outage[0] + np.array([0.0, *grid]), np.searchsorted(t, outage[1] - SAME_INSTANT)
    return np.where(at < outage[1] - SAME_INSTANT, at, t[max(int(end) - 1, 0)])


def find_law(profile: Profile, grid: Sequence[float]) -> dict[str, FloatArray]:
    """Return the root mean square of the horizontal drift by the closed form (D,), by source [m].

    The receiver leaves its slow velocity error at the loss, everything else is the unit's own.
    """
    truth, loss = get_truth(results.truth_key(profile.flight), profile), profile.sensors.gnss_outages[0][0]
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
