"""The steps of a run: fly, sense, navigate, evaluate, explain."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any

from bench.core.compilation.compiled import read_compile_time
from bench.core.files import disk_arrays
from bench.core.records.data import InitialState, NavSolution, SensorData, Trajectory
from bench.core.records.flight_specs import TableSpec
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.run_records import ErrorSeries, OffPath, Sensed, SensorTruth, ShowFlight
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.records.specs import CLIENT, IN_FLIGHT, EstimatorChoice, Profile
from bench.core.words.exceptions import ConfigError, EstimatorError, EstimatorFailedError
from bench.core.words.stages import FLYING, Stages
from bench.evaluation.errors.failures import check_starts, describe_error, make_failed_solution
from bench.evaluation.judging import Judged, judge_solution, measure_solution
from bench.io import results
from bench.io.foreign.loading import load_estimators
from bench.navigation import built_in, estimator

# --- fly ---------------------------------------------------------------------------------------------------


def fly(
    profile: Profile,
    *,
    cache: bool = True,
    progress: Callable[[float], None] | None = None,
    run: int = 0,
    show: ShowFlight | None = None,
) -> Trajectory:
    """Return the truth of a profile, from the cache if it was flown before.

    Where an estimate flies, the truth is that of the run ``run``, and it is always flown.

    Raises
    ------
    bench.FlightError
        If the aircraft cannot be loaded, trimmed or flown.
    bench.ConfigError
        If a trajectory table cannot be used.
    """
    if profile.guidance is not None:
        flown: Trajectory = _fly_closed(profile, run, progress, show).truth
        return flown
    shown: list[float] = []  # ends of pieces [s]; a flight that cannot be stored is flown twice
    pieces = partial(_fly_pieces, profile, progress, show, shown)
    truth = results.cached_truth(profile.flight, pieces) if cache else results.join_pieces(pieces())
    if show is not None and not shown:
        show(truth, None)
    return truth


def fly_over(profile: Profile, progress: Callable[[float], None] | None = None) -> dict[str, Any]:
    """Fly a profile, store its truth in the cache, and return a summary of the flight.

    Those of `flight.Summary` and `bench.evaluation.errors.replay`, piece by piece. Errors as for :func:`fly`.
    """
    summarize = partial(_summarize, profile)
    if profile.guidance is not None:
        return summarize([_fly_closed(profile, 0, progress, None).truth])
    sources = ("bench/evaluation/errors/replay.py", "bench/navigation/mechanization.py")
    pieces = partial(_fly_pieces, profile, progress, None, [])
    return results.cached_summary(profile.flight, pieces, summarize, sources)


def _summarize(profile: Profile, pieces: Iterable[Trajectory]) -> dict[str, Any]:
    from bench.evaluation.errors.replay import Replay
    from bench.simulation.flight.summary import Summary

    summary, replay = Summary(profile.sensors.terrain), Replay()
    for piece in pieces:
        summary.add(piece)
        replay.add(piece)
    return summary.result() | replay.result()


def _fly_closed(profile: Profile, *arguments: Any) -> Any:
    from bench.pipeline import closed_loop  # it needs the filters, which a flight by the truth does without

    return closed_loop.fly(profile, *arguments)


def _fly_pieces(
    profile: Profile, progress: Callable[[float], None] | None, show: ShowFlight | None, shown: list[float]
) -> Iterator[Trajectory]:
    if isinstance(profile.flight, TableSpec):
        from bench.io.trajectories import trajectory

        pieces = trajectory.read_trajectory(profile.flight)
    else:
        from bench.simulation import flight

        pieces = flight.fly_pieces(profile.flight, progress)
    for piece in pieces:
        if show is not None and piece.t[-1] > max(shown, default=-1.0):
            shown.append(float(piece.t[-1]))
            show(piece, None)
        yield piece


def fly_run(
    profile: Profile,
    run: int,
    given: tuple[Trajectory | None, NavSolution | None],
    stages: Stages,
    show: ShowFlight | None,
) -> tuple[Trajectory, NavSolution | None]:
    """Return the truth of a run, and the solution that guided it; ``given`` has those already known.

    Raises
    ------
    bench.ConfigError
        If the flight is shorter than an outage, a fault or the alignment window needs.
    """
    truth, steered = given
    tell = partial(_tell_flown, stages, profile.flight.duration)
    if truth is None and profile.guidance is not None:
        closed = _fly_closed(profile, run, tell, show)
        truth, steered = closed.truth, closed.answers
    elif truth is None:
        stages.begin("taking the flight from the cache")
        truth = fly(profile, progress=tell, show=show)
    elif profile.guidance is not None and profile.guidance.navigation.use != CLIENT:
        stages.begin("navigating the flight again")
        from bench.pipeline import closed_loop

        steered = closed_loop.replay(profile, truth, run)
    assert truth is not None
    if profile.guidance is None:  # an estimate may end a flight before an outage or a fault
        check_times(profile, float(truth.t[-1]))
    return truth, steered


def _tell_flown(stages: Stages, duration: float | None, t: float) -> None:
    if not stages.flies:
        stages.begin(FLYING, duration)
    stages.move(t)


def check_times(profile: Profile, end: float) -> None:
    """Raise ConfigError if an outage, a fault or the alignment window ends after the end of the flight."""
    if problems := profile.describe_outside(end):
        raise ConfigError(*problems)


def find_truth_key(profile: Profile, run: int = 0) -> str:
    """Return a hash of all inputs of a truth: the flight and, if an estimate guides it, the estimate."""
    guidance = profile.guidance
    if guidance is None:
        return results.truth_key(profile.flight)
    parts = (results.hash_spec(guidance), results.hash_spec(profile.sensors), str(profile.seed), str(run))
    return results.truth_key(profile.flight, parts)


# --- sense -------------------------------------------------------------------------------------------------


def sense(profile: Profile, truth: Trajectory, run: int = 0) -> Sensed:
    """Return the sensor data of a profile for a truth, with run ``run`` of the profile's seed."""
    from bench.simulation import sensors

    return sensors.sense(truth, profile.sensors, profile.seed, run)


# --- navigate ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Navigated:
    """Solutions of the filters of a run or a log, by label."""

    solutions: dict[str, NavSolution] = field(default_factory=dict)
    unmodeled: dict[str, list[str] | None] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)


def build_estimator(choice: EstimatorChoice) -> estimator.Estimator:
    """Build a filter; errors as for `bench.io.foreign.loading.load_estimators`."""
    return load_estimators([choice])[0]


def build_estimators(profile: Profile) -> dict[str, estimator.Estimator]:
    """Build the filters of a profile by label, and check that the sensors provide the required records.

    Raises
    ------
    bench.EstimatorError, bench.ConfigError
        As for :func:`build_estimator`, and if a record that one needs is missing or it rejects a sensor.
    """
    chosen = profile.estimators
    built = dict(zip([one.label for one in chosen], load_estimators(chosen), strict=True))
    for label, one in built.items():
        estimator.check_needs(one, label, _list_records(profile), specs=profile.sensors.assumed)
    return built


def _list_records(profile: Profile) -> set[str]:
    """Return the names of the `SensorData` records that the sensors of a profile produce."""
    on_board = profile.sensors
    records = {name for name in INSTRUMENTS if getattr(on_board, name) is not None}
    if on_board.gnss is not None:
        records |= {"fixes"} if on_board.gnss.sky is None else {"fixes", "observations"}
    return records


def navigate(choice: EstimatorChoice, data: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of one filter, which gets the sensor data and never the truth.

    Raises
    ------
    bench.EstimatorError
        If there is no such filter, its options are wrong, or it does not return a valid solution.
    bench.core.words.exceptions.EstimatorFailedError
        If its ``run`` raises an exception.
    """
    return estimator.answer(build_estimator(choice), choice.label, data, initial)


def navigate_all(
    built: Mapping[str, estimator.Estimator],
    data: SensorData,
    initial: InitialState,
    specs: AssumedSpecs,
    stages: Stages,
    also: Callable[[str, NavSolution], object] = lambda label, solution: None,
) -> Navigated:
    """Run the filters one after the other; a filter that raises an exception or cannot start has failed.

    ``also`` is called with each solution, and may raise as a filter does.

    Raises
    ------
    bench.EstimatorError
        If none can start.
    """
    answers = Navigated()
    raised: dict[str, EstimatorError | EstimatorFailedError] = {}
    for number, (label, one) in enumerate(built.items(), 1):
        stages.begin(f"filter {number} of {len(built)}: {label}")
        answers.unmodeled[label] = None
        begun = _read_cpu_clock()
        try:
            solution = estimator.answer(one, label, data, initial)
            answers.unmodeled[label] = estimator.list_unmodeled(one, label, specs)
            also(label, solution)
        except (EstimatorError, EstimatorFailedError) as error:
            raised[label] = error
            solution = make_failed_solution(data.output_t, *describe_error(label, error))
        disk_arrays.release()
        answers.solutions[label] = solution
        answers.cpu_s[label] = getattr(one, "cpu_s", _read_cpu_clock() - begun)
    check_starts(raised, len(built))
    return answers


def collect_printed(built: Mapping[str, estimator.Estimator]) -> dict[str, str]:
    """Return the printed output of filters in separate processes by label, without empty outputs."""
    texts = {label: getattr(one, "printed", "") for label, one in built.items()}
    return {label: text for label, text in texts.items() if text}


def read_work_clock() -> float:
    """Return the CPU time of this process without compilations, which happen once [s]."""
    return time.process_time() - read_compile_time()


def _read_cpu_clock() -> float:
    """Return the CPU time of this process without compilations, plus finished child programs [s]."""
    return read_work_clock() + sum(os.times()[2:4])


# --- evaluate ----------------------------------------------------------------------------------------------


def measure(
    profile: Profile,
    truth: Trajectory,
    solution: NavSolution,
    drawn: SensorTruth | None = None,
    data: SensorData | None = None,
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution and its metrics, with metrics of biases if the true biases are given.

    The sensor ``data`` may excuse epochs without an answer.
    """
    return measure_solution(solution, truth, data, profile.evaluation, drawn=drawn, **_list_facts(profile))


def _list_facts(profile: Profile) -> dict[str, Any]:
    on_board = profile.sensors
    return {"outages": on_board.gnss_outages, "faults": on_board.faults, "assumed": on_board.assumed}


def evaluate(
    profile: Profile, truth: Trajectory, sensed: Sensed, answers: Navigated, steered: NavSolution | None
) -> tuple[dict[str, Judged], OffPath | None]:
    """Evaluate all solutions by the truth; add the solution that ``steered``, with its path errors."""
    path = None
    if steered is not None:
        from bench.simulation.flight.guidance.desired_path import measure_steered

        answers.solutions[IN_FLIGHT], answers.unmodeled[IN_FLIGHT] = steered, None
        path = measure_steered(profile.flight, truth, steered.t)
    judged = {}
    for label, solution in answers.solutions.items():
        more = {"unmodeled_errors": answers.unmodeled[label], **_describe_program(solution)}
        judged[label] = judge_solution(
            label,
            solution,
            truth,
            sensed.data,
            profile.evaluation,
            profile.document,
            more,
            drawn=sensed.truth,
            path=path if label == IN_FLIGHT else None,
            **_list_facts(profile),
        )
        disk_arrays.release()
    return judged, path


def find_worked(
    built: Mapping[str, estimator.Estimator], metrics: Mapping[str, dict[str, Any]], data: SensorData
) -> dict[str, estimator.Estimator]:
    """Return the filters that did not fail; add ``same_as`` to the metrics of a filter equal to another."""
    worked = {label: one for label, one in built.items() if not metrics[label].get("failed")}
    for label, other in estimator.find_same(worked, data).items():
        metrics[label]["same_as"] = other
    return worked


def _describe_program(solution: NavSolution) -> dict[str, Any]:
    """Return how an external program ended, and the end of its stderr; empty for other estimators."""
    texts = {kind: [text for _, _, text in solution.events.select(kind)] for kind in ("program", "stderr")}
    return {"program": {kind: " ".join(parts) for kind, parts in texts.items()}} if texts["program"] else {}


# --- explain -----------------------------------------------------------------------------------------------


def explain(
    profile: Profile,
    run: int,
    truth: Trajectory,
    sensed: Sensed,
    solution: NavSolution,
    judged: Judged,
    one: estimator.Estimator,
    causes: bool | None,
    stages: Stages,
) -> Judged:
    """Search for the causes of an inconsistent covariance; return other verdicts unchanged."""
    from bench.evaluation.causes.explaining import DrawnRun, explain_run
    from bench.evaluation.consistency.verdict import BROKEN
    from bench.evaluation.conventions.convention_search import find_mistakes

    if judged.metrics["verdict"] not in BROKEN:
        return judged
    choice = next(row for row in profile.estimators if row.label == judged.label)
    begin, found = profile.evaluation.begin, dict[str, Any]()
    if choice.use not in built_in.BUILT_IN:
        found = find_mistakes([truth], [solution], sensed.data.antenna_b, begin)
    if not found and _is_searched(choice, causes):
        drawn = DrawnRun(truth, profile.sensors, profile.seed, run, begin, list_on_board(profile))
        tell = partial(_tell_search, stages, judged.label)
        found = explain_run(drawn, choice, one, solution, sensed.data, tell)
    return judged.explain(found) if found else judged


def _is_searched(choice: EstimatorChoice, causes: bool | None) -> bool:
    """Return whether the causes of an inconsistent filter are searched, which needs runs of the filter."""
    asked = choice.use in built_in.BUILT_IN if causes is None else causes
    return asked and not choice.use.startswith("file:")


def _tell_search(stages: Stages, label: str, count: int) -> None:
    stages.begin(f"why {label} is wrong: run {count}")


def list_on_board(profile: Profile) -> AssumedSpecs:
    """Return the datasheets of the sensors on board."""
    return AssumedSpecs(**{one.name: getattr(profile.sensors, one.name) for one in fields(AssumedSpecs)})
