"""A results folder made without a flight: a turn, its sensors drawn, a solution wrong by known errors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from bench.core.records.data import Trajectory
from bench.core.records.run_records import Sensed
from bench.core.records.run_result import RunResult
from bench.core.records.specs import EvaluationWindow
from bench.evaluation.errors.error_series import select_epochs
from bench.evaluation.metrics import run_metrics
from bench.io import config, results
from bench.simulation import sensors
from tests.evaluation.solutions import wrong_solution
from tests.synthetic import turning

LOST = (12.0, 14.0)
INVALID = 4  # the fix at 5 s
ERROR = {"pos_n": [3.0, -2.0, 1.0], "vel_n": [0.1, 0.2, -0.1], "phi_n": [0.01, -0.005, 0.02]}


def make_run(folder: Path, duration: float = 20.0, rate: float = 100.0) -> tuple[Trajectory, Sensed]:
    """Write the folder; no fixes from 12 to 14 s, an invalid one at 5 s; "made" has 202 epochs."""
    overrides = {
        "gnss_outage": [{"start_s": LOST[0], "duration_s": LOST[1] - LOST[0]}],
        "evaluation.from_s": 5.0,
    }
    profile = config.read_profile("figure-eight", overrides)
    truth = turning(duration, rate)
    sensed = sensors.sense(truth, profile.sensors, 4, 0)
    valid = sensed.data.fixes.valid.copy()
    valid[INVALID] = False
    fixes = replace(sensed.data.fixes, valid=valid)
    sensed = replace(sensed, data=replace(sensed.data, fixes=fixes))
    rows = np.round(sensed.data.output_t * rate).astype(int)
    solution = select_epochs(wrong_solution(truth, every=1, **ERROR), rows)
    errors, judged = run_metrics.measure(truth, solution, evaluation=EvaluationWindow(5.0), outages=[LOST])
    result = RunResult(
        profile.document,
        4,
        0,
        {"made": judged},
        {"made": errors},
        {"made": solution},
        {},
        records={"truth": truth, "sensed": sensed},
    )
    with results.make_folder(folder) as partial:
        results.save(partial, result)
    return truth, sensed


def text_rows(path: Path) -> np.ndarray:
    return np.loadtxt(path, ndmin=2)
