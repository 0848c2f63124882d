"""The verbs run, fly and cache."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench import api, config, pipeline, store
from bench.run_result import RunResult
from bench.saving import save
from bench.specs import Profile
from bench.workbench import result_table, show
from bench.workbench.console import PlainConsole

RUNS = Path("runs")
"""Default folder for results."""


def run(
    name: str,
    *,
    console: Console,
    out: Path | None,
    draw: int,
    recording: bool,
    report: bool,
    force: bool,
    bound: bool = False,
    causes: bool | None = None,
    **profile_options: Any,
) -> tuple[RunResult, Path]:
    """Fly one profile, evaluate its estimators, write the results folder, and print the metrics.

    If ``out`` is None the folder is ``runs/<profile>-<seed>``, with ``-run<draw>`` if the draw is not 0.
    ``bound`` and ``causes`` are those of `bench.run`, ``profile_options`` those of
    `bench.config.load_profile`.
    """
    find_own_estimators()
    profile = config.load_profile(name, **profile_options)
    folder = out or RUNS / (f"{profile.name}-{profile.seed}" + (f"-run{draw}" if draw else ""))
    store.check_folder(folder, force=force)
    begun = time.perf_counter()
    with _show_progress(profile) as (progress, progress_causes):
        result = pipeline.run(
            profile,
            draw,
            bound=bound,
            causes=causes,
            progress=progress,
            progress_causes=progress_causes,
        )
    store.leave_out_pandas()
    result_table.print_result(console, profile, result)
    result_table.print_bound(console, result.metrics)
    show.print_sanity(console, result.events.select("sanity"))
    save(result, folder, recording=recording, report=report, force=force)
    print_end(console, folder, begun)
    return result, folder


def print_end(console: Console, folder: Path, begun: float) -> None:
    """Print the folder of the results, how long they took, and the next command."""
    for path in sorted(folder.glob(store.PRINTED.format("*"))):
        console.print(f"What a filter printed is in {path}.", soft_wrap=True)
    console.print(f"Wrote {folder} in {time.perf_counter() - begun:.1f} s.")
    page = folder / store.REPORT
    if page.is_file():
        console.print(f"Report: {page}", soft_wrap=True)
    if (folder / store.RECORDING).is_file():
        console.print(f"Next: bench view {folder}", soft_wrap=True)


def find_own_estimators() -> None:
    """Add the present folder to the end of the import path, for the user's own estimators."""
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))


def fly(name: str, *, console: Console, **profile_options: Any) -> None:
    """Fly the truth of one profile into the cache, and print its legs and extremes; no estimator is run."""
    profile = config.load_profile(name, allow_code=True, **profile_options)
    with _show_progress(profile) as (progress, _):
        summary = api.describe_flight(profile, progress)
    show.print_flight(console, profile, summary)
    console.print(f"Next: bench run {name}")


def look_after_cache(limit: float | None, *, console: Console) -> None:
    """Reduce the cache of flown truth to a size [GB], if one is given, and print its size."""
    if limit is not None:
        store.trim_cache(int(1e9 * limit))
    cache = store.measure_cache()
    console.print(f"{cache.folder}: {cache.flights} flights, {cache.size / 1e9:.3f} GB", soft_wrap=True)
    console.print(f"limit: {cache.limit / 1e9:g} GB, set by {store.LIMIT}; the least recently used go first")


@contextlib.contextmanager
def _show_progress(
    profile: Profile,
) -> Iterator[tuple[Callable[[float], None], Callable[[str, int], None]]]:
    """Provide functions that show the seconds flown so far, and which filter runs again for its causes.

    Nothing is shown before the first call.
    """
    screen = PlainConsole(stderr=True)
    if not screen.is_interactive:
        yield lambda t: None, lambda label, runs: None
        return
    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.fields[flown]}", markup=False),
    )
    duration = profile.flight.duration
    of = f" of {duration:.0f}" if duration else ""
    with contextlib.ExitStack() as stack:
        bar = Progress(*columns, TimeElapsedColumn(), console=screen, transient=True)
        task = bar.add_task(f"flying {profile.name}", total=duration, flown="")

        def start() -> None:
            if not bar.live.is_started:
                stack.enter_context(bar)

        def show_time(t: float) -> None:
            start()
            bar.update(task, completed=t, flown=f"{t:.0f}{of} s")

        def show_runs(label: str, runs: int) -> None:
            start()
            bar.update(task, description=f"why {label} is wrong", total=None, flown=f"run {runs}")

        yield show_time, show_runs
