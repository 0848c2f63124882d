"""``bench score``: a solution from anywhere, judged on a run beside the estimators of the bench."""

from __future__ import annotations

import math
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from bench import store
from bench.config import fault_tables
from bench.errors import ConfigError, ExportError
from bench.evaluation import metrics as judging
from bench.exchange.exports import reading
from bench.exchange.solutions import check_unit, read_solution, resampled
from bench.sensors.timing import output_times
from bench.workbench import show
from bench.workbench.run import RECORDING, check_folder, new_folder

_LABEL = re.compile(r"[A-Za-z0-9_.-]+")


def score(
    path: Path,
    folder: Path,
    *,
    console: Console,
    label: str | None = None,
    t_0: float = 0.0,
    longest: float | None = None,
    out: Path | None = None,
    force: bool = False,
) -> dict[str, Any]:
    """Judge a solution on a run, print it beside the run's own estimators, and return its metrics.

    Parameters
    ----------
    path : Path
        The solution, as `bench.exchange.solutions` reads it.
    folder : Path
        A results folder.
    console : Console
        Where the table goes.
    label : str or None
        What the solution is called; the name of its file when None.
    t_0 : float
        What the file calls the start of the run [s].
    longest : float or None
        The longest interval between rows that is interpolated [s], as `bench.exchange.solutions.resampled`.
    out : Path or None
        Where to write the results folder with the solution added, without the recording.
    force : bool
        Replace an existing results folder.

    Raises
    ------
    ConfigError
        When the solution, the folder or a number is wrong: one line; nothing is written.
    """
    label = label or re.sub(r"[^A-Za-z0-9_.-]+", "-", path.stem)
    if not _LABEL.fullmatch(label):
        raise ConfigError(f"--label {label!r} must be a name of letters, digits, '-', '_' and '.'")
    if not (folder / store.RESULT).is_file():
        raise ConfigError(f"{folder}: no results folder, there is no {store.RESULT} in it")
    for option, seconds in (("--t0", t_0), ("--max-gap", longest)):
        if seconds is not None and not math.isfinite(seconds):
            raise ConfigError(f"{option} {seconds:g} must be a number of seconds")
    if out is not None:
        check_folder(out, force=force)
    try:
        with reading(folder):
            result, truth = store.load(folder), store.load_truth(folder)
            profile = result.profile
            rows = [
                (row["start_s"], row["start_s"] + row["duration_s"]) for row in profile.get("gnss_outage", [])
            ]
            outages, evaluation = tuple(sorted(rows)), profile["evaluation"]
            faults = fault_tables.flown(profile.get("fault", []))
            asked = output_times(truth.t, evaluation["output_hz"], outages)
    except ExportError as error:
        raise ConfigError(str(error)) from None
    if label in result.metrics:
        raise ConfigError(f"{label!r} is in {folder} already; --label names the solution")
    given = read_solution(path, t_0=t_0)
    check_unit(given, float(truth.t[0]), truth.lla[0])
    solution = resampled(given, asked, longest)
    errors, measured = judging.judge(
        truth, solution, evaluation_from=evaluation["from_s"], outages=outages, faults=faults
    )
    console.print(
        f"{profile['title']}: seed {result.seed}, run {result.run}, from {evaluation['from_s']:g} s on"
    )
    show.metrics(console, {**result.metrics, label: measured}, {**result.solutions, label: solution})
    share = float(np.mean(np.isfinite(solution.t) & ~_silent(solution)))
    console.print(f"{label} covers {100 * share:.4g} % of the {len(asked)} instants, {len(given)} rows")
    for kind in ("table", "interpolated"):
        for _, _, text in solution.events.of(kind):
            console.print(f"{label}: {text}")
    if out is not None:
        with new_folder(out, force=force) as partial:
            shutil.copytree(folder, partial, dirs_exist_ok=True, ignore=shutil.ignore_patterns(RECORDING))
            store.add_solution(partial, label, solution, errors, measured)
        console.print(f"Wrote {out}")
    return measured


def _silent(solution: Any) -> Any:
    return np.all([np.isnan(x).all(axis=1) for x in (solution.lla, solution.vel_n, solution.q_nb)], axis=0)
