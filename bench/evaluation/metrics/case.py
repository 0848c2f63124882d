"""The input of every metric: the errors, updates, outages and alarms of one filter in one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.mathematics.arrays import BoolArray, FloatArray
from bench.core.mathematics.units import SAME_INSTANT, split_unit
from bench.core.records.data import Events, NavSolution
from bench.core.records.fields import XYZ
from bench.core.records.run_records import ErrorSeries, OffPath, SensorTruth
from bench.core.records.sensor_specs import AssumedSpecs, Fault
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.consistency.chi_square import SensorNis, count_independent, nis_by_sensor
from bench.evaluation.errors.error_series import as_slice, heading_sd, select_epochs, variances
from bench.evaluation.errors.poses import Poses
from bench.evaluation.metrics.coverage import Coverage

Outages = Sequence[tuple[float, float]]

ALARM = "integrity"
"""Kind of the events by which a filter raises an alarm."""

NO_TIMES = np.empty(0)


@dataclass(frozen=True, slots=True)
class Alarms:
    """Alarms of one sensor, or one integrity event."""

    name: str  # of the innovation, or "integrity"
    sensors: tuple[str, ...]  # the name of the innovation, or the sensors of the event
    t: FloatArray  # (K,) [s]
    asked: FloatArray  # (N,) epochs of all updates of this name; of an event its own [s]
    end: float | None = None  # of an event [s]


@dataclass(frozen=True, slots=True)
class BiasError:
    """Error of one bias state and its standard deviation, in the unit of the state."""

    error: FloatArray  # (M,)
    sd: FloatArray  # (M,)


@dataclass(frozen=True, slots=True)
class Case:
    """The epochs of one run from a time on, with everything a metric may use.

    For covariances they are the epochs with an answer; those of accuracy hold the silent ones, too, with the
    last answer carried on (`bench.evaluation.metrics.coverage.carry_on`).
    """

    t: FloatArray  # (M,) [s]
    pos_n: FloatArray  # (M, 3) errors [m], n
    pos_h: FloatArray  # (M,) length of their horizontal part [m]
    vel_n: FloatArray  # (M, 3) [m/s], n
    phi_n: FloatArray  # (M, 3) [rad], n
    heading: FloatArray  # (M,) [rad]
    heading_sd: FloatArray  # (M,) [rad]
    sd: FloatArray  # (M, 9) of pos_n, vel_n, phi_n
    nees: FloatArray  # (M,)
    nees_samples: float  # independent values of nees
    states: int  # number of states in nees
    nis: Mapping[str, SensorNis]
    events: Mapping[str, int]  # number of the filter's events by kind
    outages: tuple[tuple[int, float, float], ...]  # number from 1, [start, end) [s]: those that start inside
    faults: Mapping[str, Fault]  # number from 1: those that start inside
    scripted: tuple[Fault, ...]  # all faults of the run
    alarms: tuple[Alarms, ...]  # of the whole run
    begin: float  # of what counts [s]
    asked: int  # number of epochs asked for; for covariances, t holds those with a solution
    silent: BoolArray  # (M,) epochs without an answer that nothing excuses
    coverage: Coverage | None  # of the whole run
    solution: NavSolution  # these epochs; all its innovations and events
    biases: Mapping[str, BiasError]  # of the bias states, "gyro_bias_x" ...; empty if the truth is unknown
    poses: Poses | None  # None if a position is not finite
    start: NavSolution  # first epoch of the whole run
    assumed: AssumedSpecs | None  # the datasheets to expect drift from
    path: OffPath | None  # of a flight that this solution flew: the truth against the desired path


def find_outage_rows(case: Case) -> dict[str, tuple[int, int]]:
    """Return the first and last row inside each outage [start, end), by number, if it has any row."""
    rows = {}
    for number, start, end in case.outages:
        first = int(np.searchsorted(case.t, start - SAME_INSTANT))
        last = int(np.searchsorted(case.t, end - SAME_INSTANT)) - 1
        if first <= last:
            rows[str(number)] = first, last
    return rows


def bias_errors(solution: NavSolution, drawn: SensorTruth) -> dict[str, BiasError]:
    """Return the errors of the bias states of a solution and their standard deviations, by name.

    Biases that the filter does not estimate, or that have no standard deviation, are left out.
    """
    if not len(drawn.t):
        return {}
    found = {}
    for k, full in enumerate(solution.extra_names):
        name, _ = split_unit(full)
        stem, _, axis = name.rpartition("_")
        if stem in ("gyro_bias", "accel_bias") and axis in XYZ:
            truth = getattr(drawn, f"{stem}_b")[:, XYZ.index(axis)]
        elif axis == "bias" and stem in drawn.bias and drawn.bias[stem].shape[1] == 1:
            truth = drawn.bias[stem][:, 0]
        else:
            continue
        error = solution.extra[:, k] - np.interp(solution.t, drawn.t, truth)
        found[name] = BiasError(error, solution.extra_sd[:, k])
    return found


def collect_alarms(nis: Mapping[str, SensorNis], events: Events) -> tuple[Alarms, ...]:
    """Return the alarms of a filter: rejected updates by sensor, then events of kind "integrity"."""
    refused = [Alarms(name, (name,), s.t[~s.accepted], np.unique(s.t)) for name, s in nis.items()]
    reported = [
        Alarms(ALARM, tuple(sensor.split()), np.array([t]), np.array([t]), end)
        for t, end, kind, sensor in zip(events.t, events.t_end, events.kind, events.sensor, strict=True)
        if kind == ALARM
    ]
    return (*refused, *reported)


def build_case(
    errors: ErrorSeries,
    solution: NavSolution,
    outages: Outages,
    faults: Sequence[Fault] = (),
    missing: FloatArray = NO_TIMES,
    assumed: AssumedSpecs | None = None,
    drawn: SensorTruth | None = None,
    poses: Poses | None = None,
    silent: BoolArray | None = None,
    coverage: Coverage | None = None,
    path: OffPath | None = None,
) -> Case:
    """Collect the inputs of the metrics from a whole run.

    Parameters
    ----------
    errors, solution : ErrorSeries, NavSolution
        At the same epochs.
    outages : sequence of (start, end)
        Scripted GNSS outages, [start, end) [s], in order.
    faults : sequence of Fault
        Scripted faults, as the profile numbers them.
    missing : (K,) array
        Epochs that were asked for and have no solution [s].
    assumed : AssumedSpecs or None
        The datasheets to expect drift from.
    drawn : SensorTruth or None
        The true biases.
    poses : Poses or None
        Those of the solution.
    silent : (M,) array of bool or None
        Epochs without an answer that nothing excuses; None: none.
    coverage : Coverage or None
        Of the solution.
    path : OffPath or None
        Of the flight, if this solution flew it; it has all epochs of the solution.
    """
    nis = nis_by_sensor(solution.innovations)
    with np.errstate(invalid="ignore"):
        variance = variances(solution)
        sd = disk_arrays.fill(variance.shape, lambda rows: np.sqrt(variance[rows]))
    return Case(
        t=errors.t,
        pos_n=errors.pos_n,
        pos_h=np.hypot(errors.pos_n[:, 0], errors.pos_n[:, 1]),
        vel_n=errors.vel_n,
        phi_n=errors.phi_n,
        heading=errors.heading,
        heading_sd=heading_sd(solution),
        sd=sd,
        nees=errors.nees,
        nees_samples=count_independent(errors.nees - errors.states),
        states=errors.states,
        nis=nis,
        events=_count_events(solution.events, -np.inf),
        outages=tuple(
            (k, start, end)
            for k, (start, end) in enumerate(outages, 1)
            if not ((missing >= start) & (missing < end)).any()
        ),
        faults={str(k): f for k, f in enumerate(faults, 1)},
        scripted=tuple(faults),
        alarms=collect_alarms(nis, solution.events),
        begin=-np.inf,
        asked=len(errors) + len(missing),
        silent=np.zeros(len(errors), np.bool_) if silent is None else silent,
        coverage=coverage,
        solution=solution,
        biases=bias_errors(solution, drawn) if drawn is not None else {},
        poses=None if poses is None else poses.select(slice(None)),
        start=select_epochs(solution, slice(0, 1)),
        assumed=assumed,
        path=None if path is None else select_path(path, np.searchsorted(path.t, errors.t - SAME_INSTANT)),
    )


def select_path(path: OffPath, rows: Any) -> OffPath:
    """Return selected rows of a path."""
    return OffPath(path.t[rows], path.right[rows], path.above[rows], path.course[rows])


def cut_case(whole: Case, evaluation: EvaluationWindow, missing: FloatArray = NO_TIMES) -> Case:
    """Return the evaluated epochs of a whole run, with the outages and faults that begin in them.

    ``missing`` holds the epochs (K,) that were asked for and have no solution [s].
    """
    begin = evaluation.first
    rows = whole.t >= begin
    taken = as_slice(rows)
    nees = whole.nees[taken]
    later = {name: one.t >= begin for name, one in whole.nis.items()}
    return replace(
        whole,
        t=whole.t[taken],
        pos_n=whole.pos_n[taken],
        pos_h=whole.pos_h[taken],
        vel_n=whole.vel_n[taken],
        phi_n=whole.phi_n[taken],
        heading=whole.heading[taken],
        heading_sd=whole.heading_sd[taken],
        sd=whole.sd[taken],
        nees=nees,
        nees_samples=count_independent(nees - whole.states),
        nis={name: whole.nis[name].take(counted) for name, counted in later.items() if counted.any()},
        events=_count_events(whole.solution.events, evaluation.begin),
        outages=tuple(one for one in whole.outages if one[1] >= begin),
        faults={key: fault for key, fault in whole.faults.items() if fault.start >= begin},
        begin=evaluation.begin,
        asked=int(rows.sum() + np.sum(missing >= begin)),
        silent=whole.silent[taken],
        solution=select_epochs(whole.solution, rows),
        biases={name: BiasError(one.error[taken], one.sd[taken]) for name, one in whole.biases.items()},
        poses=None if whole.poses is None else whole.poses.select(taken),
        path=None if whole.path is None else select_path(whole.path, taken),
    )


def _count_events(events: Events, begin: float) -> dict[str, int]:
    """Return the number of events by kind that begin at a time [s] or later."""
    kinds = [kind for kind, t in zip(events.kind, events.t, strict=True) if t >= begin]
    return {kind: kinds.count(kind) for kind in sorted(set(kinds))}
