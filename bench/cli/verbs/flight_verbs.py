"""The verbs run, fly and cache."""

from __future__ import annotations

import contextlib
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.cli.compiling import compile_beside
from bench.cli.verbs.console import show_bar
from bench.cli.verbs.printing import print_findings
from bench.core.records.run_records import ShowFlight
from bench.core.records.run_result import RunResult
from bench.core.records.specs import EvaluationWindow
from bench.core.words.stages import FLYING, Progress, Stage
from bench.core.words.wording import one_line
from bench.evaluation.requirements.required_metrics import judge_result
from bench.experiments.baselines.junit import check_required, write_requirements
from bench.io import config, results
from bench.io.config.listing import KINDS

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
    table: bool = False,
    junit: Path | None = None,
    live: Callable[[str], contextlib.AbstractContextManager[ShowFlight | None]] | None = None,
    **profile_options: Any,
) -> tuple[RunResult, Path]:
    """Fly one profile, evaluate its filters, write the results folder, and print a screen of it.

    If ``out`` is None the folder is ``runs/<profile>-<seed>``, with ``-run<draw>`` if the run is not 0.
    ``bound`` and ``causes`` are those of `bench.run`, ``profile_options`` those of
    `bench.io.config.read_profile`. ``table`` prints every main metric, too. ``junit`` is a file for what is
    required. ``live`` gives what shows the flight of a profile while it flies.
    """
    find_own_estimators()
    profile = config.read_profile(name, **profile_options)
    check_required(junit, profile.document.get("requirement"))
    folder = out or RUNS / (f"{profile.name}-{profile.seed}" + (f"-run{draw}" if draw else ""))
    results.check_folder(folder, force=force)
    console.print(describe_run(profile.name, profile.document, profile.seed, draw, profile.evaluation))
    from bench import pipeline  # what takes half a second comes after the first line

    begun = time.perf_counter()
    showing = contextlib.nullcontext() if live is None else live(profile.name)
    with compile_beside(profile), showing as show, show_stages() as watch:
        result = pipeline.run(profile, draw, bound=bound, causes=causes, progress=watch, show=show)
    with write_first(console, result, folder, recording=recording, report=report, force=force):
        if junit is not None:
            write_requirements(junit, result.name, judge_result(result.profile, result.metrics))
        print_result(console, result, table=table)
    print_end(console, folder, begun, table=table)
    return result, folder


@contextlib.contextmanager
def write_first(console: Console, result: RunResult, folder: Path, **options: Any) -> Iterator[None]:
    """Write a result before it is printed; print it also if it cannot be written.

    ``options`` are those of `bench.write_result`.
    """
    from bench.cli.saving import write_result

    notes: list[str] = []
    results.leave_out_pandas()
    try:
        with show_stages() as watch:
            watch(Stage("writing"))
            write_result(result, folder, progress=lambda now: notes.append(str(now)), **options)
    except Exception:
        yield
        raise
    yield
    for note in notes:
        console.print(note, soft_wrap=True)


def describe_run(
    name: str, document: Mapping[str, Any], seed: int, draw: int, evaluation: EvaluationWindow
) -> str:
    """Return the three first lines of a run: the flight, the sensors, and the noise and errors."""
    sensors = [
        f"{_KINDS.get(kind, kind)} {one}" for kind, one in document["sensors"].items() if kind in KINDS
    ]
    outages = [
        f"{one['start_s']:g}-{one['start_s'] + one['duration_s']:g}" for one in document["gnss_outage"]
    ]
    lost = f", GNSS outage {', '.join(outages[:3])}{', ...' if len(outages) > 3 else ''} s" if outages else ""
    first = f"{name}: {one_line(document['title'])}"
    flown = [f"aircraft {document['aircraft']}"] if "aircraft" in document else []
    noise = f"seed {seed}, run {draw}{lost}; {evaluation}"
    lines = (first, f"{'; '.join([*flown, 'sensors: ' + ', '.join(sensors)])}", noise)
    return "\n".join(textwrap.fill(line, 80, subsequent_indent="  ") for line in lines) + "\n"


_KINDS = {"imu": "IMU", "gnss": "GNSS"}


def print_result(console: Console, result: RunResult, *, table: bool) -> None:
    """Print the headlines of a result, or all its main metrics."""
    from bench.cli.verbs import result_table, show

    if table:
        result_table.print_metrics(console, result.metrics, result.solutions)
    else:
        result_table.print_screen(console, result.metrics, result.solutions)
    result_table.print_bound(console, result.metrics)
    if "log" not in result.more:
        for kind in ("sanity", "exceedance"):
            show.print_remarks(console, kind, result.events.select(kind))
        for start, _, text in result.events.select("crash"):
            console.print(f"The flight ended at {start:.1f} s: {text}", style="red")


def print_end(console: Console, folder: Path, begun: float | None = None, *, table: bool = True) -> None:
    """Print the folder of the results, the time they took, and the next commands."""
    console.print()
    for path in sorted(folder.glob(results.PRINTED.format("*"))):
        console.print(f"Output of a filter: {path}", soft_wrap=True)
    took = "" if begun is None else f" ({time.perf_counter() - begun:.1f} s)"
    console.print(f"Results  {folder}{took}", soft_wrap=True)
    page = folder / results.REPORT
    following = {
        f"bench view {folder}": (folder / results.RECORDING).is_file() and "3D recording",
        f"bench show {folder}": not table and "all metrics",
        str(page): page.is_file() and "report, one file to share",
    }
    head, width = "Next", max(map(len, following))
    for command, what in following.items():
        if what:
            console.print(f"{head:<9}{command:<{width}}  {what}", soft_wrap=True)
            head = ""


def find_own_estimators() -> None:
    """Add the present folder to the end of the import path, for the user's own estimators."""
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))


def fly(name: str, *, console: Console, **profile_options: Any) -> None:
    """Fly the truth of one profile into the cache, and print its legs and extremes; no filter is run."""
    from bench import pipeline
    from bench.cli.verbs import show

    profile = config.read_profile(name, allow_code=True, **profile_options)
    with show_stages() as watch:
        length = profile.flight.duration

        def show_time(t: float) -> None:
            watch(Stage(FLYING, t, length))

        summary = pipeline.fly_over(profile, show_time)
    show.print_flight(console, profile, summary)
    console.print(f"Next: bench run {name}")


def look_after_cache(limit: float | None, *, console: Console) -> None:
    """Reduce the cache of flown truth to a given size [GB], if any, and print its size."""
    if limit is not None:
        results.trim_cache(int(1e9 * limit))
    cache = results.measure_cache()
    size = f"{cache.folder}: {cache.flights} flights, {cache.size / 1e9:.3f} GB"
    limits = f"limit: {cache.limit / 1e9:g} GB, set by {results.LIMIT}; the least recently used go first"
    print_findings(console, [size, limits])


@contextlib.contextmanager
def show_stages() -> Iterator[Progress]:
    """Provide a function that shows the current activity on a terminal, and nothing elsewhere."""
    with show_bar("starting", timed=True) as show:
        yield lambda stage: show(str(stage), stage.done, stage.total or None, found=stage.found)
