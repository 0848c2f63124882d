"""The input of every metric: the errors, updates, outages and alarms of one estimator in one run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from bench.arrays import FloatArray
from bench.data import ErrorSeries, Events, NavSolution
from bench.evaluation.consistency import SensorNis, nis_by_sensor
from bench.evaluation.error_series import heading_sd
from bench.specs import Fault
from bench.units import SAME_INSTANT

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
    states: int  # number of states in nees
    nis: Mapping[str, SensorNis]
    events: Mapping[str, int]  # number of the estimator's events by kind
    outages: tuple[tuple[int, float, float], ...]  # number from 1, [start, end) [s]: those that start inside
    faults: Mapping[str, Fault]  # number from 1: those that start inside
    scripted: tuple[Fault, ...]  # all faults of the run
    alarms: tuple[Alarms, ...]  # of the whole run
    from_s: float  # [s]
    asked: int  # number of epochs asked for; t holds those with a solution


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
    """
    rows = errors.t >= from_s - SAME_INSTANT
    kinds = [kind for kind, t in zip(solution.events.kind, solution.events.t, strict=True) if t >= from_s]
    with np.errstate(invalid="ignore"):
        sd = np.sqrt(np.einsum("kii->ki", solution.cov))
    return Case(
        t=errors.t[rows],
        pos_n=errors.pos_n[rows],
        vel_n=errors.vel_n[rows],
        phi_n=errors.phi_n[rows],
        heading=errors.heading[rows],
        heading_sd=heading_sd(solution)[rows],
        sd=sd[rows],
        nees=errors.nees[rows],
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
    )
