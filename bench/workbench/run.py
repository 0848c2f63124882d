"""``bench run`` and ``bench fly``: the pipeline, the results folder, the recording, the table."""

from __future__ import annotations

import contextlib
import os
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from bench import pipeline, store
from bench.config import load_profile
from bench.data import RunResult
from bench.errors import ConfigError
from bench.specs import Profile
from bench.workbench import show

RUNS = Path("runs")
"""Where results go when not told."""

RECORDING = "flight.rrd"


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
    check_folder(folder, force=force)
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


def check_folder(folder: Path, *, force: bool, ours: bool | None = None) -> None:
    """Raise ConfigError when results cannot go to a folder; before anything is flown.

    ``ours`` says whether what is there may be replaced; None: when it is a results folder.
    """
    try:
        folder.stat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:  # a name too long, a folder above that may not be searched
        raise ConfigError(f"{folder}: no folder can be made there: {error.strerror}") from None
    if folder.is_dir():
        empty = not any(folder.iterdir())
        if not force and not empty:
            what = "results folder" if ours is None else "folder"
            raise ConfigError(f"{folder}: the {what} exists; --force replaces it, -o names another")
        if ours is False and not empty:
            raise ConfigError(f"{folder}: not replaced, it is no export")
        if ours is None and not empty and not (folder / store.RESULT).is_file():
            raise ConfigError(f"{folder}: not replaced, it is no results folder (no {store.RESULT} in it)")
    elif folder.exists() or folder.is_symlink():
        raise ConfigError(f"{folder}: the results folder cannot be there, it is a file")
    above = next(place for place in folder.absolute().parents if place.exists())
    try:
        tempfile.TemporaryDirectory(dir=above).cleanup()
    except OSError as error:
        raise ConfigError(f"{folder}: no folder can be made in {above}: {error.strerror}") from None


def _write(folder: Path, profile: Profile, flown: pipeline.Run, *, recording: bool, force: bool) -> None:
    result = flown.result
    with new_folder(folder, force=force) as partial:
        store.save(partial, result, flown.truth, flown.sensed)
        if recording:
            from bench.recording import write

            records = (flown.truth, flown.sensed, result.solutions, result.errors, result.metrics)
            write(partial / RECORDING, profile, *records)


@contextlib.contextmanager
def new_folder(folder: Path, *, force: bool) -> Iterator[Path]:
    """Give a folder to write results to; it takes its place when all went well, or nothing does.

    Raises
    ------
    ConfigError
        When another run made the folder meanwhile.
    OSError
        When the disk does not take it.
    """
    replace = force or folder.is_dir()  # an empty one
    try:
        with store.results_folder(folder, replace=replace) as partial:
            yield partial
    except FileExistsError:
        raise ConfigError(f"{folder}: the results folder was made by another run; not replaced") from None
    except OSError as error:
        what = os.strerror(error.errno) if error.errno else str(error)
        raise OSError(error.errno, f"{what}; nothing was written", str(folder)) from error


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
