"""One run: fly, sense, navigate, evaluate, explain."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from math import degrees
from typing import Any

from bench.core.compilation.compiled import read_compile_time, watch_compiling
from bench.core.files import disk_arrays
from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.flight_specs import FlightSpec
from bench.core.records.run_records import Sensed, ShowFlight
from bench.core.records.run_result import RunResult
from bench.core.records.specs import Profile
from bench.core.words.stages import Progress, Stages
from bench.evaluation.consistency.headline import make_headline
from bench.evaluation.judging import Judged
from bench.io import results
from bench.navigation import estimator
from bench.pipeline.steps import (
    build_estimator,
    build_estimators,
    check_times,
    collect_printed,
    evaluate,
    explain,
    find_truth_key,
    find_worked,
    fly,
    fly_over,
    fly_run,
    list_on_board,
    measure,
    navigate,
    navigate_all,
    read_work_clock,
    sense,
)

__all__ = [
    "build_estimator",
    "build_estimators",
    "check_times",
    "find_truth_key",
    "fly",
    "fly_over",
    "measure",
    "navigate",
    "run",
    "sense",
]


def run(
    profile: Profile,
    run: int = 0,
    *,
    truth: Trajectory | None = None,
    steered: NavSolution | None = None,
    bound: bool = False,
    causes: bool | None = False,
    progress: Progress | None = None,
    show: ShowFlight | None = None,
) -> RunResult:
    """Fly, sense, navigate with every filter of the profile, and evaluate.

    A filter that raises, or cannot start where others can, has failed: its metrics say why, and the
    others go on.

    Parameters
    ----------
    profile : Profile
        What to fly and evaluate, as ``bench.io.config.read_profile`` returns it.
    run : int
        Number of the run.
    truth : Trajectory or None
        The truth, if it has been flown already.
    steered : NavSolution or None
        The answers that flew it, if a client gave them.
    bound : bool
        Hold the errors against those of the best linear estimator: ``bound`` in the metrics of each.
    causes : bool or None
        Find out why a covariance is broken: by the conventions that it may be given in (filters of others),
        and by running the filter again without what may be to blame (`evaluation.causes`). None: again only
        if it is built in; False: neither.
    progress : callable or None
        Called with what is going on (`bench.core.words.stages.Stage`), whenever that changes.
    show : callable or None
        Given the flight piece by piece while it is flown; all of it if it comes from the cache.

    Raises
    ------
    bench.EstimatorError
        If no filter can start, as well as for :func:`build_estimators`.
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
    compiled_before, own_truth, clock = read_compile_time(), truth is not None, {"fly": read_work_clock()}
    truth, steered = fly_run(profile, run, (truth, steered), stages, show)
    clock["sense"] = read_work_clock()
    stages.begin("sensing")
    sensed = sense(profile, truth, run)
    disk_arrays.release()
    clock["navigate"] = read_work_clock()
    answers = navigate_all(built, sensed.data, sensed.initial, list_on_board(profile), stages)
    clock["judge"] = read_work_clock()
    stages.begin("judging")
    judged, path = evaluate(profile, truth, sensed, answers, steered)
    for label, known in judged.items():
        line = make_headline(label, known.metrics)
        stages.find(", ".join(filter(None, (f"{label}: {line.word}", line.error))))
    clock["causes"] = read_work_clock()
    for label, one in built.items() if causes is not False else ():
        answer = answers.solutions[label]
        judged[label] = explain(profile, run, truth, sensed, answer, judged[label], one, causes, stages)
    clock["compare"] = read_work_clock()
    metrics = {label: one.metrics for label, one in judged.items()}
    worked = find_worked(built, metrics, sensed.data)
    if bound and worked:
        for label, rows in _hold(profile, truth, sensed, worked, judged).items():
            metrics[label]["bound"] = rows
    clock["end"] = read_work_clock()
    key = None if own_truth else find_truth_key(profile, run)
    cpu_s = {a: clock[b] - clock[a] for a, b in pairwise(clock)}
    cpu_s["compile"] = read_compile_time() - compiled_before
    return RunResult(
        profile=profile.document,
        seed=profile.seed,
        run=run,
        metrics=metrics,
        errors={label: one.errors for label, one in judged.items()},
        solutions=answers.solutions,
        provenance={
            **results.provenance(),
            "profile": profile.name,
            "inputs": {"truth": key, "sensors": results.hash_spec(profile.sensors)},
            "cpu_s": cpu_s,
            "estimator_cpu_s": answers.cpu_s,
        },
        more={"scene": _describe_scene(profile)},
        records={
            "spec": profile,
            "truth": truth,
            "sensed": sensed,
            "printed": collect_printed(built),
            "path": path,
        },
    )


def _hold(
    profile: Profile,
    truth: Trajectory,
    sensed: Sensed,
    worked: Mapping[str, estimator.Estimator],
    judged: Mapping[str, Judged],
) -> dict[str, Any]:
    """Return the ratios of the errors of each filter to the errors of the best linear filter."""
    from bench.evaluation.linear import held

    errors = {label: judged[label].errors for label in worked}
    smoothing = {label: held.smooths(one) for label, one in worked.items()}
    begin = profile.evaluation.begin
    return held.hold_run(truth, profile.sensors, sensed, profile.seed, begin, errors, smoothing)


def _describe_scene(profile: Profile) -> dict[str, Any]:
    """Return the data of figures besides the records: aircraft, view of the antenna, runway."""
    gnss, flight = profile.sensors.gnss, profile.flight
    runway = flight.runway if isinstance(flight, FlightSpec) and not flight.aircraft.hovers else None
    mask = None if gnss is None or gnss.sky is None else degrees(gnss.sky.antenna_mask)
    place = runway and {
        "lat_deg": degrees(runway.lat),
        "lon_deg": degrees(runway.lon),
        "alt_m": runway.alt,
        "heading_deg": degrees(runway.heading),
        "width_m": runway.width,
    }
    return {"mesh": profile.flight.mesh, "antenna_mask_deg": mask, "runway": place}
