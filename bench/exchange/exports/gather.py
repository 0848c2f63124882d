"""Read the part of a results folder that is exported."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bench import store
from bench.errors import ExportError
from bench.exchange.exports.outgoing import ExportData, Track
from bench.store import parquet

TRUTH, SOLUTION = "truth", "solution:"


def gather(folder: Path, wanted: Sequence[str] = ()) -> ExportData:
    """Read the sensors of a results folder, and tracks by name.

    Parameters
    ----------
    folder : Path
        A results folder.
    wanted : sequence of str
        Tracks to export: ``truth``, ``solution:NAME``.

    Raises
    ------
    ConfigError, ExportError
        If the folder is not a results folder, is damaged, or has no such track.
    """
    store.read_summary(folder)
    with report_damage(folder):
        imu, fixes, instruments = store.load_sensors(folder)
        start = store.load_start(folder)
        observations = store.load_observations(folder)
        tracks: dict[str, Track] = {}
        for name in wanted:
            if name == TRUTH:
                tracks[name] = store.load_truth(folder)
            elif name.startswith(SOLUTION):
                label = name.removeprefix(SOLUTION)
                known = store.list_solutions(folder)
                if label not in known:
                    raise ExportError(
                        f"--with {name}: no such solution; there are {', '.join(known) or 'none'}"
                    )
                tracks[f"solution-{label}"] = store.load_solution(folder, label)
            else:
                raise ExportError(f"--with {name}: must be truth or solution:NAME")
        run = ExportData(imu, fixes, observations, instruments, start, tracks)
        (
            store.read_initial_state(start),
            run.calendar,
            run.assumed("gyro"),
            run.assumed("accel"),
        )  # read now, so that damage is reported here
    return run


@contextmanager
def report_damage(folder: Path) -> Iterator[None]:
    """Convert the exceptions of reading a damaged results folder to an ExportError of one line."""
    try:
        yield
    except ExportError:
        raise
    except FileNotFoundError as error:
        missing = re.findall(r"[\w.-]+\.(?:parquet|json)", str(error.filename or error))
        what = missing[-1] if missing else "file"
        if what == store.TRUTH:
            raise ExportError(f"{folder}: has no truth, because it comes from a log") from None
        raise ExportError(f"{folder}: no {what} in it; 'bench run' writes a whole folder") from None
    except parquet.DAMAGED as error:
        reason = " ".join(str(error).split())[:200]
        if isinstance(error, KeyError):
            reason = f"{reason} is missing"
        raise ExportError(f"{folder}: cannot be read: {reason or type(error).__name__}") from None
