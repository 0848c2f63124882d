"""One run: fly, sense, navigate, judge."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields
from functools import partial
from itertools import pairwise
from math import degrees
from typing import Any

from bench.core.compilation.compiled import read_compile_time, watch_compiling
from bench.core.files import disk_arrays
from bench.core.records.data import (
    ErrorSeries,
    InitialState,
    NavSolution,
    OffPath,
    Sensed,
    SensorData,
    SensorTruth,
    ShowFlight,
    Trajectory,
)
from bench.core.records.flight_specs import FlightSpec, TableSpec
from bench.core.records.instruments import INSTRUMENTS
from bench.core.records.run_result import RunResult
from bench.core.records.sensor_specs import AssumedSpecs
from bench.core.records.specs import CLIENT, IN_FLIGHT, EstimatorChoice, Profile
from bench.core.words.exceptions import ConfigError, EstimatorError, EstimatorFailedError
from bench.core.words.stages import FLYING, Stages, Watcher
from bench.evaluation.errors.failures import check_starts, describe_error, make_failed_solution
from bench.io import results
from bench.io.foreign.loading import load_estimators
from bench.navigation import built_in, estimator


def fly(
    profile: Profile,
    *,
    cache: bool = True,
    progress: Callable[[float], None] | None = None,
    run: int = 0,
    show: ShowFlight | None = None,
) -> Trajectory:
    """Return the truth of a profile, from the cache if it was flown before.

    Where an estimate flies, the truth is that of the noise draw ``run``, and it is always flown.

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
    """Fly a profile, store its truth in the cache, and return its figures.

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


def sense(profile: Profile, truth: Trajectory, run: int = 0) -> Sensed:
    """Return the sensor data of a profile for a truth, with noise draw ``run`` of the profile's seed."""
    from bench.simulation import sensors

    return sensors.sense(truth, profile.sensors, profile.seed, run)


def navigate(choice: EstimatorChoice, data: SensorData, initial: InitialState) -> NavSolution:
    """Return the solution of one estimator, which gets the sensor data and never the truth.

    Raises
    ------
    bench.EstimatorError
        If there is no such estimator, its options are wrong, or it does not return a valid solution.
    bench.core.words.exceptions.EstimatorFailedError
        If its ``run`` raises an exception.
    """
    return estimator.answer(build_estimator(choice), choice.label, data, initial)


def build_estimator(choice: EstimatorChoice) -> estimator.Estimator:
    """Build an estimator; errors as for `bench.io.foreign.loading.load_estimators`."""
    return load_estimators([choice])[0]


def judge(
    profile: Profile,
    truth: Trajectory,
    solution: NavSolution,
    drawn: SensorTruth | None = None,
    data: SensorData | None = None,
    *,
    path: OffPath | None = None,
) -> tuple[ErrorSeries, dict[str, Any]]:
    """Return the errors of a solution and its metrics; those of biases if the true ones are given.

    The sensor ``data`` may excuse a silence. A solution that flew the aircraft is held against its ``path``.
    """
    from bench.evaluation.metrics import run_metrics

    return run_metrics.judge(
        truth,
        solution,
        evaluation=profile.evaluation,
        outages=profile.sensors.gnss_outages,
        faults=profile.sensors.faults,
        assumed=profile.sensors.assumed,
        drawn=drawn,
        data=data,
        path=path,
    )


def run(
    profile: Profile,
    run: int = 0,
    *,
    truth: Trajectory | None = None,
    steered: NavSolution | None = None,
    bound: bool = False,
    causes: bool | None = False,
    progress: Watcher | None = None,
    show: ShowFlight | None = None,
) -> RunResult:
    """Fly, sense, navigate with every estimator of the profile, and judge.

    An estimator that raises, or cannot start where others can, has failed: its metrics say why, and the
    others go on.

    Parameters
    ----------
    profile : Profile
        What to fly and evaluate, as ``bench.io.config.load_profile`` returns it.
    run : int
        Number of the noise draw.
    truth : Trajectory or None
        The truth, if it has been flown already.
    steered : NavSolution or None
        The answers that flew it, if a client gave them.
    bound : bool
        Hold the errors against those of the best linear estimator: ``bound`` in the metrics of each.
    causes : bool or None
        Find out why a claim is broken: by the conventions that it may be given in (filters of others), and by
        running the filter again without what may be to blame (`evaluation.causes`). None: again only if it is
        built in; False: neither.
    progress : callable or None
        Called with what is going on (`bench.core.words.stages.Stage`), whenever that changes.
    show : callable or None
        Given the flight piece by piece while it is flown; all of it if it comes from the cache.

    Raises
    ------
    bench.EstimatorError
        If no estimator can start, as well as for :func:`build_estimators`.
    """
    stages = Stages(progress)
    with watch_compiling(stages.compile):
        return _run(profile, run, truth, steered, bound, causes, stages, show)


def _run(
    profile: Profile,
    run: int,
    truth: Trajectory | None,
    steered: NavSolution | None,
    bound: bool,
    causes: bool | None,
    stages: Stages,
    show: ShowFlight | None,
) -> RunResult:
    built = build_estimators(profile)  # fails before the flight
    if bound:
        from bench.evaluation.linear import held

        held.check_flight(profile.sensors, built)
    compiled_before = read_compile_time()
    clock = {"fly": _read_work_clock()}
    own_truth = truth is not None
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
    if profile.guidance is None:  # an estimate may end a flight before an outage or a fault
        check_times(profile, float(truth.t[-1]))
    clock["sense"] = _read_work_clock()
    stages.begin("sensing")
    sensed = sense(profile, truth, run)
    disk_arrays.release()
    clock["navigate"] = _read_work_clock()
    solutions, unmodelled, used = {}, dict[str, list[str] | None](), dict[str, float]()
    raised: dict[str, EstimatorError | EstimatorFailedError] = {}
    specs = AssumedSpecs(**{one.name: getattr(profile.sensors, one.name) for one in fields(AssumedSpecs)})
    for number, (label, one) in enumerate(built.items(), 1):
        stages.begin(f"filter {number} of {len(built)}: {label}")
        unmodelled[label] = None
        begun = _read_cpu_clock()
        try:
            solution = estimator.answer(one, label, sensed.data, sensed.initial)
            unmodelled[label] = estimator.list_unmodelled(one, label, specs)
        except (EstimatorError, EstimatorFailedError) as error:
            raised[label] = error
            solution = make_failed_solution(sensed.data.output_t, *describe_error(label, error))
        disk_arrays.release()
        solutions[label] = solution
        used[label] = getattr(one, "cpu_s", _read_cpu_clock() - begun)
    check_starts(raised, len(built))
    if steered is not None:
        solutions[IN_FLIGHT], unmodelled[IN_FLIGHT] = steered, None
    clock["judge"] = _read_work_clock()
    stages.begin("judging")
    from bench.evaluation.causes.explaining import DrawnRun, explain_run
    from bench.evaluation.consistency.verdict import BROKEN, add_verdict
    from bench.evaluation.conventions.convention_search import find_mistakes
    from bench.evaluation.metrics.coverage import measure_coverage
    from bench.evaluation.requirements.required_metrics import list_requirements
    from bench.simulation.flight.guidance.desired_path import measure_steered

    judged = dict[str, tuple[ErrorSeries, dict[str, Any]]]()
    paths = {} if steered is None else {IN_FLIGHT: measure_steered(profile.flight, truth, steered.t)}
    for label, solution in solutions.items():
        judged[label] = judge(profile, truth, solution, sensed.truth, sensed.data, path=paths.get(label))
        disk_arrays.release()
    metrics = {
        label: {**judged[label][1], "unmodelled": unmodelled[label], **_describe_program(solution)}
        for label, solution in solutions.items()
    }
    requirements = {label: list_requirements(profile.document, label) for label in solutions}
    covered = {label: measure_coverage(solutions[label], sensed.data) for label in solutions}
    verdicts = {
        label: add_verdict(label, values, covered[label], requirements[label])
        for label, values in metrics.items()
    }
    clock["causes"] = _read_work_clock()
    begin = profile.evaluation.begin
    for choice in profile.estimators if causes is not False else ():
        label, values = choice.label, metrics[choice.label]
        if verdicts[label]["verdict"] not in BROKEN:
            continue
        found = dict[str, Any]()
        if choice.use not in built_in.BUILT_IN:
            found = find_mistakes(truth, [solutions[label]], sensed.data.antenna_b, begin)
        if not found and _is_searched(choice, causes):
            found = explain_run(
                DrawnRun(truth, profile.sensors, profile.seed, run, begin, specs),
                choice,
                built[label],
                solutions[label],
                sensed.data,
                partial(_tell_search, stages, label),
            )
        if found:
            values = {**values, **found}
            verdicts[label] = add_verdict(label, values, covered[label], requirements[label])
    clock["compare"] = _read_work_clock()
    metrics = verdicts
    worked = {label: one for label, one in built.items() if not metrics[label].get("failed")}
    for label, other in estimator.find_same(worked, sensed.data).items():
        metrics[label]["same_as"] = other
    if bound and worked:
        errors = {label: judged[label][0] for label in worked}
        smoothing = {label: held.smooths(built[label]) for label in worked}
        ratios = held.hold_run(truth, profile.sensors, sensed, profile.seed, begin, errors, smoothing)
        for label, rows in ratios.items():
            metrics[label]["bound"] = rows
    clock["end"] = _read_work_clock()
    hashes = {
        "truth": None if own_truth else find_truth_key(profile, run),
        "sensors": results.hash_spec(profile.sensors),
    }
    cpu_s = {a: clock[b] - clock[a] for a, b in pairwise(clock)}
    cpu_s["compile"] = read_compile_time() - compiled_before
    return RunResult(
        profile=profile.document,
        seed=profile.seed,
        run=run,
        metrics=metrics,
        errors={label: errors for label, (errors, _) in judged.items()},
        solutions=solutions,
        provenance={
            **results.provenance(),
            "profile": profile.name,
            "inputs": hashes,
            "cpu_s": cpu_s,
            "estimator_cpu_s": used,
        },
        more={"scene": _describe_scene(profile)},
        records={
            "spec": profile,
            "truth": truth,
            "sensed": sensed,
            "printed": collect_printed(built),
            "path": paths.get(IN_FLIGHT),
        },
    )


def find_truth_key(profile: Profile, run: int = 0) -> str:
    """Return a hash of all that a truth follows from: the flight and, where one flies it, the estimate."""
    guidance = profile.guidance
    if guidance is None:
        return results.truth_key(profile.flight)
    parts = (results.hash_spec(guidance), results.hash_spec(profile.sensors), str(profile.seed), str(run))
    return results.truth_key(profile.flight, parts)


def _is_searched(choice: EstimatorChoice, causes: bool | None) -> bool:
    """Tell whether a filter runs again to find out why its claim is broken; one from a file cannot."""
    asked = choice.use in built_in.BUILT_IN if causes is None else causes
    return asked and not choice.use.startswith("file:")


def _describe_scene(profile: Profile) -> dict[str, Any]:
    """Return what pictures need besides the records: the aircraft, what its antenna sees, the runway."""
    gnss, flight = profile.sensors.gnss, profile.flight
    runway = flight.runway if isinstance(flight, FlightSpec) else None
    mask = None if gnss is None or gnss.sky is None else degrees(gnss.sky.antenna_mask)
    place = runway and {
        "lat_deg": degrees(runway.lat),
        "lon_deg": degrees(runway.lon),
        "alt_m": runway.alt,
        "heading_deg": degrees(runway.heading),
    }
    return {"mesh": profile.flight.mesh, "antenna_mask_deg": mask, "runway": place}


def _tell_flown(stages: Stages, duration: float | None, t: float) -> None:
    if not stages.flies:
        stages.begin(FLYING, duration)
    stages.move(t)


def _tell_search(stages: Stages, label: str, count: int) -> None:
    stages.begin(f"why {label} is wrong: run {count}")


def _read_work_clock() -> float:
    """Return the CPU time of this process without that of compiling, which comes once [s]."""
    return time.process_time() - read_compile_time()


def _read_cpu_clock() -> float:
    """Return the work of this process and the CPU time of the programs that it has run to their end [s]."""
    return _read_work_clock() + sum(os.times()[2:4])


def build_estimators(profile: Profile) -> dict[str, estimator.Estimator]:
    """Build the estimators of a profile by label, and check that its sensors give what they need.

    Raises
    ------
    bench.EstimatorError, bench.ConfigError
        As for :func:`build_estimator`, and if a record that one needs is missing or it refuses a sensor.
    """
    chosen = profile.estimators
    built = dict(zip([one.label for one in chosen], load_estimators(chosen), strict=True))
    for label, one in built.items():
        estimator.check_needs(one, label, _list_records(profile), specs=profile.sensors.assumed)
    return built


def collect_printed(built: Mapping[str, estimator.Estimator]) -> dict[str, str]:
    """Return by label what filters in processes of their own have printed; nothing of those that did not."""
    texts = {label: getattr(one, "printed", "") for label, one in built.items()}
    return {label: text for label, text in texts.items() if text}


def check_times(profile: Profile, end: float) -> None:
    """Raise ConfigError if an outage, a fault or the alignment window ends after the end of the flight."""
    if problems := profile.describe_outside(end):
        raise ConfigError(*problems)


def _list_records(profile: Profile) -> set[str]:
    """Return the names of the `SensorData` records that the sensors of a profile produce."""
    on_board = profile.sensors
    records = {name for name in INSTRUMENTS if getattr(on_board, name) is not None}
    if on_board.gnss is not None:
        records |= {"fixes"} if on_board.gnss.sky is None else {"fixes", "observations"}
    return records


def _describe_program(solution: NavSolution) -> dict[str, Any]:
    """Return how an external program ended, and the end of its stderr; empty for other estimators."""
    texts = {kind: [text for _, _, text in solution.events.select(kind)] for kind in ("program", "stderr")}
    return {"program": {kind: " ".join(parts) for kind, parts in texts.items()}} if texts["program"] else {}
