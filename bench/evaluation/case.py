"""The input of every metric: the errors, updates, outages and alarms of one estimator in one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.arrays import FloatArray
from bench.data import ErrorSeries, Events, NavSolution, SensorTruth
from bench.evaluation.consistency import SensorNis, count_independent, nis_by_sensor
from bench.evaluation.error_series import as_slice, heading_sd, select_epochs, variances
from bench.evaluation.poses import Poses
from bench.fields import XYZ
from bench.specs import AssumedSpecs, Fault
from bench.units import SAME_INSTANT, split_unit

Outages = Sequence[tuple[float, float]]

ALARM = "integrity"
"""Kind of the events by which an estimator raises an alarm."""

NO_TIMES = np.empty(0)


@dataclass(frozen=True, slots=True)
class Alarms:
    """Alarms of one sensor, or one integrity event."""

    name: str  # of the innovation, or "integrity"
    sensors: tuple[str, ...]  # the name of the innovation, or the sensors of the event
    t: FloatArray  # (K,) [s]


@dataclass(frozen=True, slots=True)
class BiasError:
    """Error of one bias state and its standard deviation, in the unit of the state."""

    error: FloatArray  # (M,)
    sd: FloatArray  # (M,)


@dataclass(frozen=True, slots=True)
class Case:
    """The epochs of one run from an instant on, with everything a metric may use."""

    t: FloatArray  # (M,) [s]
    pos_n: FloatArray  # (M, 3) errors [m], n
    vel_n: FloatArray  # (M, 3) [m/s], n
    phi_n: FloatArray  # (M, 3) [rad], n
    heading: FloatArray  # (M,) [rad]
    heading_sd: FloatArray  # (M,) [rad]
    sd: FloatArray  # (M, 9) of pos_n, vel_n, phi_n
    nees: FloatArray  # (M,)
    nees_samples: float  # independent values of nees
    states: int  # number of states in nees
    nis: Mapping[str, SensorNis]
    events: Mapping[str, int]  # number of the estimator's events by kind
    outages: tuple[tuple[int, float, float], ...]  # number from 1, [start, end) [s]: those that start inside
    faults: Mapping[str, Fault]  # number from 1: those that start inside
    scripted: tuple[Fault, ...]  # all faults of the run
    alarms: tuple[Alarms, ...]  # of the whole run
    from_s: float  # [s]
    asked: int  # number of epochs asked for; t holds those with a solution
    solution: NavSolution  # these epochs; all its innovations and events
    biases: Mapping[str, BiasError]  # of the bias states, "gyro_bias_x" ...; empty if the truth is unknown
    poses: Poses | None  # None if a position is not finite
    start: NavSolution  # first epoch of the whole run
    assumed: AssumedSpecs | None  # the datasheets to expect drift from


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

    Biases that the estimator does not estimate, or that have no standard deviation, are left out.
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
    """Return the alarms of an estimator: rejected updates by sensor, then events of kind "integrity"."""
    refused = [Alarms(name, (name,), s.t[~s.accepted]) for name, s in nis.items()]
    reported = [
        Alarms(ALARM, tuple(sensor.split()), np.array([start]))
        for start, kind, sensor in zip(events.t, events.kind, events.sensor, strict=True)
        if kind == ALARM
    ]
    return (*refused, *reported)


def build_case(
    errors: ErrorSeries,
    solution: NavSolution,
    from_s: float,
    outages: Outages,
    faults: Sequence[Fault] = (),
    missing: FloatArray = NO_TIMES,
    assumed: AssumedSpecs | None = None,
    drawn: SensorTruth | None = None,
    poses: Poses | None = None,
) -> Case:
    """Collect what the metrics need of a run from an instant on.

    Parameters
    ----------
    errors, solution : ErrorSeries, NavSolution
        At the same instants.
    from_s : float
        First instant that counts [s].
    outages : sequence of (start, end)
        Scripted GNSS outages, [start, end) [s], in order.
    faults : sequence of Fault
        Scripted faults, as the profile numbers them.
    missing : (K,) array
        Instants that were asked for and have no solution [s].
    assumed : AssumedSpecs or None
        The datasheets to expect drift from.
    drawn : SensorTruth or None
        The true biases.
    poses : Poses or None
        Those of the solution.
    """
    rows = errors.t >= from_s - SAME_INSTANT
    taken = as_slice(rows)
    kinds = [kind for kind, t in zip(solution.events.kind, solution.events.t, strict=True) if t >= from_s]
    inside = select_epochs(solution, rows)
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(variances(inside))
    return Case(
        t=errors.t[taken],
        pos_n=errors.pos_n[taken],
        vel_n=errors.vel_n[taken],
        phi_n=errors.phi_n[taken],
        heading=errors.heading[taken],
        heading_sd=heading_sd(inside),
        sd=sd,
        nees=errors.nees[taken],
        nees_samples=count_independent(errors.nees[taken] - errors.states),
        states=errors.states,
        nis=nis_by_sensor(solution.innovations, from_s - SAME_INSTANT),
        events={kind: kinds.count(kind) for kind in sorted(set(kinds))},
        outages=tuple(
            (k, start, end)
            for k, (start, end) in enumerate(outages, 1)
            if start >= from_s - SAME_INSTANT and not ((missing >= start) & (missing < end)).any()
        ),
        faults={str(k): f for k, f in enumerate(faults, 1) if f.start >= from_s - SAME_INSTANT},
        scripted=tuple(faults),
        alarms=collect_alarms(nis_by_sensor(solution.innovations), solution.events) if faults else (),
        from_s=from_s,
        asked=int(rows.sum() + np.sum(missing >= from_s - SAME_INSTANT)),
        solution=inside,
        biases=bias_errors(inside, drawn) if drawn is not None else {},
        poses=None if poses is None else poses.select(rows),
        start=select_epochs(solution, slice(0, 1)),
        assumed=assumed,
    )
