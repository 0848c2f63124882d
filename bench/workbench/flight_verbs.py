"""What the verbs of flights print: run, fly, check."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench import api, pipeline, store
from bench.config import load_profile
from bench.data import RunResult
from bench.specs import Profile
from bench.workbench import show

RUNS = Path("runs")
"""Where results go when not told."""


def run(
    name: str,
    *,
    console: Console,
    out: Path | None = None,
    estimators: Sequence[str] | None = None,
    overrides: Mapping[str, Any] | None = None,
    seed: int | None = None,
    draw: int = 0,
    recording: bool = True,
    force: bool = False,
    allow_commands: bool = False,
) -> tuple[RunResult, Path]:
    """Fly one profile, evaluate its estimators, and write the results folder.

    Parameters
    ----------
    name : str
        Shipped name or path of the profile.
    console : Console
        Where the table goes; the progress bar goes to stderr.
    out : Path or None
        Results folder; ``runs/<profile>-<seed>`` when None, with the draw where it is not 0.
    estimators, overrides, seed
        As `bench.config.load_profile` takes them.
    draw : int
        The noise draw of the seed.
    recording : bool
        Write ``flight.rrd`` too.
    force : bool
        Replace an existing results folder.
    allow_commands : bool
        The profile itself may name programs that are started.

    Returns
    -------
    result : RunResult
        Metrics of every estimator, diverged ones included.
    folder : Path
        The results folder.

    Raises
    ------
    ConfigError, bench.errors.EstimatorError, bench.errors.FlightError, OSError
        With nothing left behind.
    """
    if str(Path.cwd()) not in sys.path:
        sys.path.append(str(Path.cwd()))  # where the user's own estimators are looked for, after all else
    profile = load_profile(name, overrides, seed, estimators, allow_commands)
    label = f"{profile.name}-{profile.seed}" + (f"-run{draw}" if draw else "")
    folder = out or RUNS / label
    store.check_folder(folder, force=force)
    begun = time.perf_counter()
    with _progress(profile) as progress:
        flown = pipeline.run(profile, draw, progress=progress)
    _write(folder, profile, flown, recording=recording, force=force)
    show.result(console, profile, flown.result)
    show.sanity(console, flown.truth.events.of("sanity"))
    console.print(f"Wrote {folder} in {time.perf_counter() - begun:.1f} s.")
    if recording:
        console.print(f"Next: bench view {folder}")
    return flown.result, folder


def fly(
    name: str, *, console: Console, overrides: Mapping[str, Any] | None = None, seed: int | None = None
) -> None:
    """Fly the truth of one profile, keep it in the cache, and print what was flown."""
    profile = load_profile(name, overrides, seed)
    with _progress(profile) as progress:
        flown = pipeline.fly_over(profile, progress)
    show.flight(console, profile, flown)
    console.print(f"Next: bench run {name}")


def _write(folder: Path, profile: Profile, flown: pipeline.Run, *, recording: bool, force: bool) -> None:
    result = flown.result
    with store.new_folder(folder, force=force) as partial:
        store.save(partial, result, flown.truth, flown.sensed)
        if recording:
            from bench.recording import write

            records = (flown.truth, flown.sensed, result.solutions, result.errors, result.metrics)
            write(partial / store.RECORDING, profile, *records)


def check_limits(directory: Path, names: Sequence[str], *, console: Console, runs: int | None) -> bool:
    """Fly the profiles that have limits, print the verdicts, and return whether every limit holds."""
    with _counted() as progress:
        verdicts = api.check_limits(names, directory=directory, runs=runs, progress=progress)
    show.verdicts(console, verdicts)
    return not any(row.regressed for row in verdicts)


def record_limits(
    directory: Path, names: Sequence[str], *, console: Console, runs: int | None = None
) -> None:
    """Fly profiles and write what they measure as their limits."""
    with _counted() as progress:
        paths = api.record_limits(names, directory=directory, runs=runs, progress=progress)
    for path in paths:
        console.print(f"Wrote {path}.")


@contextlib.contextmanager
def _counted() -> Iterator[Callable[[str, int, int], None]]:
    """Give what shows the run of a profile."""
    with Console(stderr=True).status("") as status:
        yield lambda name, k, n: status.update(f"{name}: run {k + 1} of {n}")


@contextlib.contextmanager
def _progress(profile: Profile) -> Iterator[Callable[[float], None]]:
    """Give what takes the seconds flown so far and shows them; nothing is shown before the first call."""
    screen = Console(stderr=True)
    if not screen.is_interactive:
        yield lambda t: None
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[flown]}"))
    duration = profile.flight.duration
    of = f" of {duration:.0f}" if duration else ""
    with contextlib.ExitStack() as stack:
        bar = Progress(*columns, TimeElapsedColumn(), console=screen, transient=True)
        task = bar.add_task(f"flying {profile.name}", total=duration, flown="")

        def flown_so_far(t: float) -> None:
            if not bar.live.is_started:
                stack.enter_context(bar)
            bar.update(task, completed=t, flown=f"{t:.0f}{of} s")

        yield flown_so_far
