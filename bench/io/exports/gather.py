"""Read the part of a results folder that is exported."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from bench.core.words.exceptions import ExportError
from bench.io import results
from bench.io.exports.outgoing import ExportData, Track

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
    results.read_summary(folder)
    with results.report_damage(folder):
        imu, fixes, instruments = results.load_sensors(folder)
        start = results.load_start(folder)
        observations = results.load_observations(folder)
        output_t = results.load_output_times(folder)
        tracks: dict[str, Track] = {}
        for name in wanted:
            if name == TRUTH:
                tracks[name] = results.load_truth(folder)
            elif name.startswith(SOLUTION):
                label = name.removeprefix(SOLUTION)
                known = results.list_solutions(folder)
                if label not in known:
                    raise ExportError(
                        f"--with {name}: no such solution; there are {', '.join(known) or 'none'}"
                    )
                tracks[f"solution-{label}"] = results.load_solution(folder, label)
            else:
                raise ExportError(f"--with {name}: must be truth or solution:NAME")
        run = ExportData(imu, fixes, observations, instruments, start, output_t, tracks)
        (
            results.read_initial_state(start),
            run.calendar,
            run.assumed("gyro"),
            run.assumed("accel"),
        )  # read now, so that damage is reported here
    return run
