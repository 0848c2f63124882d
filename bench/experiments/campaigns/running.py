"""Run a campaign: fly the truths, start the workers, write the journal and the tables."""

from __future__ import annotations

import bisect
import contextlib
import itertools
import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from pathlib import Path
from typing import Any

from bench import pipeline
from bench.core.files import durable
from bench.core.files.scratch import make_scratch
from bench.core.files.spawned import Printed
from bench.core.mathematics.arrays import IntArray
from bench.core.records.specs import DEFAULT_GUARD, Guard
from bench.core.words.exceptions import ConfigError, FlightError
from bench.core.words.stages import Progress, ignore
from bench.experiments.campaigns.batches import Lost, Pool, compute
from bench.experiments.campaigns.campaign_tables import (
    EPOCHS,
    RUNS,
    describe_instants,
    write_epochs,
    write_runs,
)
from bench.experiments.campaigns.groups import MOST_EXACT, gather
from bench.experiments.campaigns.journal import NAME, Journal, list_files
from bench.experiments.campaigns.outcome import (
    Campaign,
    CampaignStage,
    Outcome,
    Pair,
    compare,
    pair_runs,
    summarize,
)
from bench.experiments.campaigns.plan import Cell, Plan, PlannedRun, plan_runs
from bench.experiments.campaigns.pools import ExecutorPool, ProcessPool, count_processors
from bench.experiments.campaigns.worker import RunTask, choose_step, fly, measure
from bench.io import results
from bench.io.config.library import name_profile

PRINTED = "printed.txt"
"""File of a campaign with what filters of others have printed."""

_FILES = RUNS, EPOCHS, PRINTED, results.CAMPAIGN_RESULT, results.REPORT, results.RECORDING

WAVE = 50  # flights before their runs: all fit into the cache of truth


def campaign(
    profile: str | Path,
    runs: int | None = None,
    *,
    flights: int | None = None,
    seed: int | None = None,
    estimators: Sequence[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    allow_code: bool = False,
    guard: Guard = DEFAULT_GUARD,
    jobs: int | None = None,
    executor: Executor | None = None,
    scheduler: str | None = None,
    out: str | Path | None = None,
    force: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
) -> Campaign:
    """Run a profile many times and return statistics with confidence intervals.

    Run *k* equals ``bench.run(profile, run=k)``. The result does not depend on the number of processes.

    Parameters
    ----------
    profile : str or Path
        Name of a built-in profile, path of a profile, or path of a campaign file.
    runs : int, optional
        Runs of each flight. Default: 200.
    flights : int, optional
        Flights, each with turbulence of its own. Default: 1.
    seed : int, optional
        Seed of the first flight. Default: the seed of the profile.
    estimators : sequence of str, optional
        Filters, as in `bench.run`. Default: the filters of the profile.
    overrides : mapping, optional
        Profile keys to replace.
    allow_code : bool, optional
        Permit profiles to run code they name. Default: no.
    guard : Guard, optional
        Limits for programs and classes.
    jobs : int, optional
        Number of processes. Default: the number of processors. If a script uses more than one, protect its
        start with ``if __name__ == "__main__"``.
    executor : concurrent.futures.Executor, optional
        Executor whose ``jobs`` workers are used instead.
    scheduler : str, optional
        Address of a Dask scheduler whose workers are used; requires the extra ``cluster``.
    out : str or Path, optional
        Folder for journal and tables. Default: none.
    force : bool, optional
        Replace the campaign in ``out``.
    resume : bool, optional
        Continue the campaign in ``out``.
    progress : callable, optional
        Called with a `CampaignStage` at the start and after each run.

    Returns
    -------
    Campaign
        ``outcomes`` and ``comparisons`` with intervals, ``sentences``, and the Arrow tables ``runs`` and
        ``epochs``; ``frame()`` is a DataFrame.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError, bench.FlightError
        If an argument or file is wrong, a filter cannot be built, or the aircraft cannot be flown.

    Examples
    --------
    >>> import bench
    >>> found = bench.campaign("approach", 2, estimators=["loose-15"], jobs=1)
    >>> found.outcomes[0].runs
    2
    """
    if resume and (out is None or force):
        raise ConfigError("bench.campaign: resume continues the campaign in out, and force replaces it")
    plan = plan_runs(
        name_profile(profile),
        runs,
        flights=flights,
        seed=seed,
        estimators=estimators,
        overrides=overrides,
        allow_code=allow_code,
        guard=guard,
    )
    folder = None if out is None else Path(out)
    return run_campaign(
        plan,
        jobs=jobs,
        executor=executor,
        scheduler=scheduler,
        folder=folder,
        force=force,
        resume=resume,
        progress=progress,
    )


def run_campaign(
    plan: Plan,
    *,
    jobs: int | None = None,
    executor: Executor | None = None,
    scheduler: str | None = None,
    pool: Pool | None = None,
    folder: Path | None = None,
    force: bool = False,
    resume: bool = False,
    progress: Progress | None = None,
) -> Campaign:
    """Run a campaign plan and return its tables and sentences.

    The result does not depend on the number of processes or the order in which runs finish. After Ctrl-C it
    is that of the runs that are finished.

    Parameters
    ----------
    plan : Plan
        As `bench.experiments.campaigns.plan` makes it.
    jobs : int or None
        Number of processes; None takes one for each processor.
    executor : Executor or None
        Use the ``jobs`` workers of this executor instead of processes of its own.
    scheduler : str or None
        Use the workers of the Dask scheduler at this address; it needs the extra "cluster".
    pool : Pool or None
        Workers that run already, and go on afterwards.
    folder : Path or None
        Where journal and tables are written; None leaves nothing behind.
    force : bool
        Replace the campaign in the folder.
    resume : bool
        Continue the campaign in the folder, if there is one: runs of the same profile, filters and
        versions are taken from its journal; those that failed as a whole are tried again.
    progress : callable
        Called at the start and after each run.

    Raises
    ------
    bench.ConfigError, bench.EstimatorError, bench.FlightError
        As for :func:`campaign`.
    OSError
        If the journal cannot be written; ``resume`` continues from there.
    """
    begun = time.perf_counter()
    with contextlib.ExitStack() as stack:
        place = stack.enter_context(
            make_scratch()
            if folder is None
            else results.keep_folder(
                folder,
                (*list_files(folder), *_FILES),
                results.CAMPAIGN,
                force=force,
                resume=resume,
            )
        )
        journal = stack.enter_context(Journal(place / NAME))
        before = journal.find_labels()
        now = {cell.profile.labels for cell in plan.cells}
        if before and before not in now:
            raise ConfigError(
                f"{folder}: holds runs of {', '.join(before)}; name them again to continue, -o names another "
                "folder, --force replaces it"
            )
        if before:
            journal.keep_runs_of(before)
        printed = Printed()
        if (place / PRINTED).is_file():
            printed.add((place / PRINTED).read_bytes())
        try:
            with (
                contextlib.nullcontext(pool)
                if pool
                else choose_pool(plan, jobs or count_processors(), executor, scheduler) as workers
            ):
                _work(plan, journal, workers, printed, progress or ignore)
            interrupted = False
        except KeyboardInterrupt:
            interrupted = True
        if printed.text:
            durable.write(place / PRINTED, printed.text)
        return _finish(plan, journal, place, folder, begun, interrupted=interrupted)


def choose_pool(
    plan: Plan, jobs: int, executor: Executor | None, scheduler: str | None
) -> contextlib.AbstractContextManager[Pool]:
    """Return the workers that the caller asks for."""
    if scheduler is not None:
        from bench.experiments.campaigns.cluster import ClusterPool

        used = {choice.use: choice for cell in plan.cells for choice in cell.profile.estimators}
        return ClusterPool(scheduler, list(used.values()))
    return ProcessPool(jobs) if executor is None else ExecutorPool(executor, jobs)


def _work(plan: Plan, journal: Journal, pool: Pool, printed: Printed, progress: Progress) -> None:
    """Execute the runs that are missing in the journal; store each finished run and printed output."""
    planned = plan.number_runs()
    missing = journal.find_missing((plan.cells[k].key, runs) for k, runs in planned.items())
    todo = {k: runs for k, runs in zip(planned, missing, strict=True) if len(runs)}
    for cell in {plan.cells[k].condition: plan.cells[k] for k in todo}.values():
        pipeline.build_estimators(cell.profile)
    known = len(plan.runs) - sum(map(len, todo.values()))
    counter = RunCounter(plan.name, len(plan.runs), known, progress)
    lengths: dict[str, float] = {}
    sizes = Counter[int]()
    for k, runs in planned.items():
        sizes[plan.cells[k].condition] += len(runs)
    numbers, warm = list(todo), set[tuple[str, ...]]()
    for begin in range(0, len(numbers), WAVE):
        wave = [plan.cells[k] for k in numbers[begin : begin + WAVE]]
        firsts = [next(c for c in plan.cells if c.condition == cell.condition) for cell in wave]
        _fly([*firsts, *wave], lengths, pool)
        tasks, first = Tasks(), list[int]()
        for cell, number, its_first in zip(wave, numbers[begin : begin + WAVE], firsts, strict=True):
            uses = tuple(choice.use for choice in cell.profile.estimators)
            if uses not in warm:  # its kernels are compiled once, not by every worker
                first.append(len(tasks))
                warm.add(uses)
            many = sizes[cell.condition] > MOST_EXACT
            step = choose_step(lengths[its_first.truth_key], cell.profile.answer_rate, many=many)
            tasks.add(cell, todo[number], step, many=many)
        for k, found in compute(measure, tasks, pool, first):
            task = tasks[k]
            row: dict[str, Any] = (
                {"key": task.key, "error": found.reason} if isinstance(found, Lost) else dict(found)
            )
            for label, text in row.pop("printed", {}).items():
                command = tasks.find_cell(k).repeat(task.run)
                printed.add(f"--- {label}: {command}\n{text.rstrip()}\n".encode())
            journal.append(row)
            counter.count(lengths[task.truth_key], failed="error" in row)


class Tasks(Sequence[RunTask]):
    """The tasks of some cells, each made when it is asked for."""

    def __init__(self) -> None:
        self._cells: list[tuple[Cell, IntArray, float, bool]] = []
        self._ends: list[int] = []

    def add(self, cell: Cell, runs: IntArray, step: float, *, many: bool) -> None:
        """Add the runs of a cell."""
        self._ends.append(len(self) + len(runs))
        self._cells.append((cell, runs, step, many))

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def find_cell(self, number: int) -> Cell:
        """Return the cell of a task."""
        return self._cells[bisect.bisect_right(self._ends, number)][0]

    def __getitem__(self, number: Any) -> Any:
        at = bisect.bisect_right(self._ends, number)
        cell, runs, step, many = self._cells[at]
        run = int(runs[number - self._ends[at]])
        return RunTask(f"{cell.key}-{run}", cell.truth_key, cell.profile, run, step, many)


def _fly(cells: Sequence[Cell], lengths: dict[str, float], pool: Pool) -> None:
    """Fly missing truths into the cache, check the times of the profiles, and add the durations [s]."""
    new = {cell.truth_key: cell for cell in cells if cell.truth_key not in lengths}
    profiles = [cell.profile for cell in new.values()]
    for k, length in enumerate(map(fly, profiles)) if pool.remote else compute(fly, profiles, pool):
        if isinstance(length, Lost):
            raise FlightError(f"{list(new.values())[k].profile.name}: {length.reason} while it flew")
        lengths[list(new)[k]] = length
    pool.share(list(new))
    for cell in cells:
        if cell.profile.guidance is None:
            pipeline.check_times(cell.profile, lengths[cell.truth_key])


class RunCounter:
    """Progress report of a campaign."""

    def __init__(self, name: str, runs: int, known: int, progress: Progress) -> None:
        self._name, self._runs, self._known, self._progress = name, runs, known, progress
        self._new, self._failed, self._flown, self._begun = 0, 0, 0.0, time.perf_counter()
        progress(CampaignStage(name, known, runs, "runs"))

    def count(self, length: float, *, failed: bool) -> None:
        """Count a finished run and the length of its flight [s]."""
        self._new += 1
        self._failed += failed
        self._flown += length
        elapsed, done = time.perf_counter() - self._begun, self._known + self._new
        self._progress(
            CampaignStage(
                self._name,
                done,
                self._runs,
                "runs",
                failed=self._failed,
                new=self._new,
                elapsed=elapsed,
                flown=self._flown,
            )
        )


def _finish(
    plan: Plan, journal: Journal, place: Path, folder: Path | None, begun: float, *, interrupted: bool
) -> Campaign:
    """Write the tables and the summary of the finished runs."""
    outcomes: list[Outcome] = []
    pairs: list[Pair] = []
    epochs: list[dict[str, Any]] = []
    for _, groups in itertools.groupby(gather(plan, journal), lambda group: group.number):
        of_condition = list(groups)
        outcomes += map(summarize, of_condition)
        pairs += pair_runs(of_condition)
        epochs += map(describe_instants, of_condition)
    failed: dict[str, str] = {}
    cpu: list[float] = []
    used: dict[str, list[float]] = {}

    def rows() -> Iterator[tuple[PlannedRun, Mapping[str, Any]]]:
        for planned in plan.runs:
            if (key := plan.run_key(planned)) in journal:
                row = journal[key]
                if "error" in row:
                    failed[plan.cells[planned.cell].repeat(planned.run)] = row["error"]
                cpu.append(sum(row.get("cpu_s", {}).values()))
                for label, seconds in row.get("estimator_cpu_s", {}).items():
                    used.setdefault(label, []).append(seconds)
                yield planned, row

    write_runs(place / RUNS, plan, rows())
    write_epochs(place / EPOCHS, plan, epochs)
    profiles = {cell.condition: cell.profile.document for cell in reversed(plan.cells)}
    result = Campaign(
        outcomes=tuple(outcomes),
        comparisons=tuple(compare(pairs)),
        runs=results.read_table(place / RUNS),
        epochs=results.read_table(place / EPOCHS),
        planned=len(plan.runs),
        finished=len(cpu),
        failed=failed,
        conditions=tuple(
            {"profile": one.source, "values": one.values, "as_flown": profiles[number]}
            for number, one in enumerate(plan.conditions)
        ),
        provenance=results.provenance(),
        timing={"wall_s": time.perf_counter() - begun, "run_cpu_s": sum(cpu)},
        estimator_cpu_s=used,
        interrupted=interrupted,
        folder=folder,
        damaged=journal.damaged,
    )
    results.write_json(place / results.CAMPAIGN_RESULT, describe(result))
    return result


def describe(campaign: Campaign) -> dict[str, Any]:
    """Return the values and sentences of a campaign, for JSON."""
    return {
        "planned": campaign.planned,
        "finished": campaign.finished,
        "failed": campaign.failed,
        "sentences": campaign.sentences,
        "outcomes": [asdict(one) for one in campaign.outcomes],
        "comparisons": [asdict(one) for one in campaign.comparisons],
        "conditions": campaign.conditions,
        "estimator_cpu_s": campaign.estimator_cpu_s,
        "timing": campaign.timing,
        "uncertainty": campaign.uncertainty,
        **campaign.provenance,
    }
