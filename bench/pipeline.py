"""One run: fly, sense, navigate, judge."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from bench import store
from bench.data import ErrorSeries, InitialState, NavSolution, RunResult, Sensed, SensorData, Trajectory
from bench.navigation import estimator
from bench.specs import AssumedSpecs, EstimatorChoice, Profile


@dataclass(frozen=True, slots=True)
class Run:
    """A result with the records it came from."""

    result: RunResult
    truth: Trajectory
    sensed: Sensed


def fly(
    profile: Profile, *, cache: bool = True, progress: Callable[[float], None] | None = None
) -> Trajectory:
    """Return the truth of a profile, from the cache where it has been flown before.

    Raises
    ------
    bench.flight.FlightError
        When the aircraft cannot be loaded, trimmed or flown.
    """

    def in_jsbsim() -> Trajectory:
        from bench import flight

        return flight.fly(profile.flight, progress)

    return store.truth_cached(profile.flight, in_jsbsim) if cache else in_jsbsim()


def sense(profile: Profile, truth: Trajectory, run: int = 0) -> Sensed:
    """Return what the sensors of a profile report on a truth, in the noise draw ``run`` of its seed."""
    from bench import sensors

    return sensors.sense(truth, profile.sensors, profile.seed, run)


def navigate(choice: EstimatorChoice, data: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of one estimator; it gets the sensors and nothing of the truth.

    Raises
    ------
    bench.navigation.estimator.EstimatorError
        When there is no such estimator or it refuses its options.
    """
    return estimator.load(choice.use, choice.options).run(data, initial)


def judge(profile: Profile, truth: Trajectory, solution: NavSolution) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution and its metrics."""
    from bench.evaluation import metrics

    return metrics.judge(
        truth,
        solution,
        evaluation_from=profile.evaluation_from,
        outages=profile.sensors.gnss_outages,
    )


def run(
    profile: Profile,
    run: int = 0,
    *,
    truth: Trajectory | None = None,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Fly, sense, navigate with every estimator of the profile, and judge.

    Parameters
    ----------
    profile : Profile
        What to do; ``bench.config.load_profile`` makes one.
    run : int
        The noise draw of the profile's seed.
    truth : Trajectory or None
        The truth, when it is at hand.
    progress : callable or None
        Called with the seconds flown so far.
    """
    for choice in profile.estimators:  # a wrong name or option fails before the flight
        estimator.load(choice.use, choice.options)
    clock = {"fly": time.process_time()}
    if truth is None:
        truth = fly(profile, progress=progress)
    clock["sense"] = time.process_time()
    sensed = sense(profile, truth, run)
    clock["navigate"] = time.process_time()
    solutions = {c.label: navigate(c, sensed.data, sensed.initial) for c in profile.estimators}
    clock["judge"] = time.process_time()
    judged = {label: judge(profile, truth, solution) for label, solution in solutions.items()}
    clock["end"] = time.process_time()
    steps = list(clock)
    cpu_s = {a: clock[b] - clock[a] for a, b in pairwise(steps)}
    result = RunResult(
        profile=profile.document,
        seed=profile.seed,
        run=run,
        metrics={
            c.label: {**judged[c.label][1], "unmodelled": _unmodelled(profile, c)} for c in profile.estimators
        },
        errors={label: errors for label, (errors, _) in judged.items()},
        solutions=solutions,
        provenance={**store.provenance(), "cpu_s": cpu_s},
    )
    return Run(result, truth, sensed)


def _unmodelled(profile: Profile, choice: EstimatorChoice) -> list[str] | None:
    """Return the errors of the true units that an estimator says it has no state for."""
    named: Mapping[str, Any] = {
        "imu": profile.sensors.imu,
        "gnss": profile.sensors.gnss,
        "baro": profile.sensors.baro,
    }
    asked = getattr(estimator.load(choice.use, choice.options), "unmodelled", None)
    return list(asked(AssumedSpecs(**named))) if asked is not None else None
