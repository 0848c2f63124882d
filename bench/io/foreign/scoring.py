"""Evaluate a solution from a file on a run, as if it were the solution of a filter of bench."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from bench.core.records.data import NavSolution, Trajectory
from bench.core.records.run_records import ErrorSeries
from bench.core.records.run_result import RunResult
from bench.core.words.exceptions import ConfigError
from bench.evaluation.consistency.verdict import BROKEN
from bench.evaluation.conventions.convention_search import find_mistakes
from bench.evaluation.errors.resampling import resample
from bench.evaluation.judging import Known, judge_solution
from bench.io import results
from bench.io.config import fault_tables
from bench.io.config.checks import LABEL
from bench.io.foreign.solutions import check_unit, read_solution
from bench.simulation.sensors.timing import select_output_times


@dataclass(frozen=True, slots=True)
class Score:
    """A solution, its errors and metrics, and the run it is evaluated on."""

    label: str
    solution: NavSolution  # at the output times of the run; NaN where the file has no solution
    errors: ErrorSeries
    metrics: Mapping[str, Any]
    run: RunResult
    coverage: float  # fraction of the output times with a solution [1]
    rows: int  # number of rows in the file


def score(path: Path, folder: Path, label: str | None, t_0: float, longest: float | None) -> Score:
    """Evaluate a solution on a run; parameters and errors as `bench.cli.exchanging.score_solution`."""
    label = label or re.sub(r"[^A-Za-z0-9_.-]+", "-", path.stem)
    if not LABEL.fullmatch(label):
        raise ConfigError(
            f"--label {label!r} must be a name of letters, digits, '-', '_' and '.', 100 at most"
        )
    for option, seconds in (("--t0", t_0), ("--max-gap", longest)):
        if seconds is not None and not math.isfinite(seconds):
            raise ConfigError(f"{option} {seconds:g} must be a number of seconds")
    if path.is_dir() and folder.is_file():
        raise ConfigError(f"{folder} is a file and {path} a folder; the solution comes first, then the run")
    with results.report_damage(folder):
        run = results.read_result(folder)
        if label in run.metrics:
            raise ConfigError(f"{folder} has a solution {label!r} already; choose another name with --label")
        if run.truth is None and "log" in run.more:
            return _score_log(path, run, label, t_0, longest)
        truth, sensed = results.load_truth(folder), run.sensed
        profile = run.profile
        rows = [
            (row["start_s"], row["start_s"] + row["duration_s"]) for row in profile.get("gnss_outage", [])
        ]
        outages = tuple(sorted(rows))
        faults = fault_tables.read_faults(profile.get("fault", []))
        t = select_output_times(truth.t, profile["evaluation"]["output_hz"], outages)
    foreign = read_solution(path, t_0=t_0)
    check_unit(foreign, float(truth.t[0]), truth.lla[0])
    solution = resample(foreign, t, longest)
    facts = {
        "outages": outages,
        "faults": faults,
        "assumed": sensed.data.specs if sensed else None,
        "drawn": sensed.truth if sensed else None,
    }
    return _make_score(label, solution, truth, run, len(foreign), **facts)


def _score_log(path: Path, run: RunResult, label: str, t_0: float, longest: float | None) -> Score:
    """Evaluate a solution on a log, by its reference or its withheld fixes."""
    data, by = run.sensors, run.records.get("reference")
    assert data is not None
    foreign = read_solution(path, t_0=t_0)
    if not len(data.output_t):
        raise ConfigError("no filter of this log has epochs to compare with: navigate it again")
    fixes = data.fixes
    if fixes is not None and len(fixes):
        check_unit(foreign, float(fixes.t[0]), fixes.lla[0])
    solution = resample(foreign, data.output_t, longest)
    return _make_score(label, solution, run.records["withheld"] if by is None else by, run, len(foreign))


def _make_score(
    label: str, solution: NavSolution, known: Known, run: RunResult, rows: int, **facts: Any
) -> Score:
    """Return the verdict of a solution, and with a truth also the convention that may be mistaken."""
    blocks = (solution.lla, solution.vel_n, solution.q_nb)
    empty = np.all([np.isnan(block).all(axis=1) for block in blocks], axis=0)
    coverage = float(np.mean(np.isfinite(solution.t) & ~empty))
    judged = judge_solution(label, solution, known, run.sensors, run.evaluation, run.profile, **facts)
    if isinstance(known, Trajectory) and judged.metrics["verdict"] in BROKEN:
        antenna_b = np.zeros(3) if run.sensors is None else run.sensors.antenna_b
        judged = judged.explain(find_mistakes(known, [solution], antenna_b, run.evaluation.begin))
    return Score(label, solution, judged.errors, judged.metrics, run, coverage, rows)
