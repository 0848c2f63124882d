"""Judge a solution from a file on a run, like that of an estimator of the bench."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench import store
from bench.config import fault_tables
from bench.data import ErrorSeries, NavSolution
from bench.errors import ConfigError
from bench.evaluation import metrics
from bench.evaluation.verdict import add_verdict
from bench.exchange.solutions import check_unit, read_solution, resample
from bench.run_result import RunResult
from bench.sensors.timing import select_output_times

_LABEL = re.compile(r"[A-Za-z0-9_.-]+")


@dataclass(frozen=True, slots=True)
class Score:
    """A solution, its errors and metrics, and the run it is judged on."""

    label: str
    solution: NavSolution  # at the output times of the run; NaN where the file has no solution
    errors: ErrorSeries
    metrics: Mapping[str, Any]
    run: RunResult
    coverage: float  # fraction of the output times with a solution [1]
    rows: int  # number of rows in the file


def score(path: Path, folder: Path, label: str | None, t_0: float, longest: float | None) -> Score:
    """Judge a solution on a run; parameters and errors as `bench.api.score_solution`."""
    label = label or re.sub(r"[^A-Za-z0-9_.-]+", "-", path.stem)
    if not _LABEL.fullmatch(label):
        raise ConfigError(f"--label {label!r} must be a name of letters, digits, '-', '_' and '.'")
    for option, seconds in (("--t0", t_0), ("--max-gap", longest)):
        if seconds is not None and not math.isfinite(seconds):
            raise ConfigError(f"{option} {seconds:g} must be a number of seconds")
    with store.report_damage(folder):
        run, truth = store.load(folder), store.load_truth(folder)
        sensed = run.sensed
        profile = run.profile
        rows = [
            (row["start_s"], row["start_s"] + row["duration_s"]) for row in profile.get("gnss_outage", [])
        ]
        outages, evaluation = tuple(sorted(rows)), profile["evaluation"]
        faults = fault_tables.read_faults(profile.get("fault", []))
        t = select_output_times(truth.t, evaluation["output_hz"], outages)
    if label in run.metrics:
        raise ConfigError(f"{folder} has a solution {label!r} already; choose another name with --label")
    foreign = read_solution(path, t_0=t_0)
    check_unit(foreign, float(truth.t[0]), truth.lla[0])
    solution = resample(foreign, t, longest)
    errors, measured = metrics.judge(
        truth,
        solution,
        evaluation_from=evaluation["from_s"],
        outages=outages,
        faults=faults,
        assumed=sensed.data.specs if sensed else None,
        drawn=sensed.truth if sensed else None,
    )
    measured = add_verdict(label, measured)
    blocks = (solution.lla, solution.vel_n, solution.q_nb)
    empty = np.all([np.isnan(block).all(axis=1) for block in blocks], axis=0)
    coverage = float(np.mean(np.isfinite(solution.t) & ~empty))
    return Score(label, solution, errors, measured, run, coverage, len(foreign))
