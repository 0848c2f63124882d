"""Explain an inconsistent run of one filter: run it again with the same noise without each candidate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from bench.core.files import disk_arrays
from bench.core.records.data import NavSolution, SensorData, Trajectory
from bench.core.records.sensor_specs import AssumedSpecs, SensorsSpec
from bench.core.records.specs import EstimatorChoice
from bench.core.words.exceptions import EstimatorError, EstimatorFailedError
from bench.evaluation.causes.candidates import list_candidates
from bench.evaluation.causes.search import advise, describe_causes, find_causes
from bench.evaluation.consistency.block_nees import BlockNees, judge_blocks
from bench.evaluation.conventions.convention_search import keep_finite
from bench.evaluation.errors.error_series import TITLES, error_series
from bench.navigation import estimator
from bench.navigation.error_state_filter.aiding_sensors import AIDING, unmodeled
from bench.simulation import sensors

LOST = dict.fromkeys(TITLES, BlockNees(3, np.inf, 0.0, np.inf, 0.0))
"""The covariances of a filter that ended without a solution."""


@dataclass(frozen=True, slots=True)
class DrawnRun:
    """One run of the sensors on a flight, with the settings of its evaluation."""

    truth: Trajectory
    spec: SensorsSpec
    seed: int
    run: int
    begin: float  # end of the alignment window [s]
    on_board: AssumedSpecs  # datasheets of the sensors on board


def explain_run(
    drawn: DrawnRun,
    choice: EstimatorChoice,
    one: estimator.Estimator,
    solution: NavSolution,
    data: SensorData,
    progress: Callable[[int], None] = lambda runs: None,
) -> dict[str, Any]:
    """Return the causes of an inconsistent run as metrics; empty if the NEES of no block is above its band.

    Parameters
    ----------
    drawn : DrawnRun
        The run.
    choice, one : EstimatorChoice, Estimator
        The filter; it runs a dozen times.
    solution : NavSolution
        Its solution in the run.
    data : SensorData
        What it got there.
    progress : callable
        Called with the number of runs so far.

    Returns
    -------
    values : dict
        ``causes``, a row each: the words, the block of states whose covariance is broken, its mean NEES with
        and without it (``nees``, ``nees_without``), and the ``step``: the causes of one step were found
        together, with the causes of earlier steps removed; ``causes_runs``, how often the filter ran;
        ``advice_text``, which filter does better; ``why_text``.
    """
    count = 0

    def judge_here(solution: NavSolution) -> dict[str, BlockNees]:
        found = judge_blocks(error_series(drawn.truth, solution), solution, drawn.begin)
        disk_arrays.release()
        return found

    def measure(spec: SensorsSpec) -> dict[str, BlockNees]:
        nonlocal count
        count += 1
        progress(count)
        sensed = sensors.sense(drawn.truth, spec, drawn.seed, drawn.run)
        try:
            return judge_here(estimator.answer(one, choice.label, sensed.data, sensed.initial))
        except (EstimatorError, EstimatorFailedError):
            return LOST

    named = estimator.list_unmodeled(one, choice.label, drawn.on_board)
    if named is None:  # it does not say: whatever a filter may leave out
        present = [sensor for sensor in AIDING if getattr(data, sensor.record) is not None]
        named = list(unmodeled(drawn.on_board, present, ()))
    candidates = list_candidates(drawn.spec, named)
    causes = find_causes(drawn.spec, candidates, judge_here(solution), measure)
    if causes is None:
        return {}
    sky = data.observations is not None
    rows = [
        {
            "cause": candidate.words,
            "block": TITLES[step.block],
            "nees": keep_finite(step.before.mean),
            "nees_without": keep_finite(step.after.mean),
            "step": number,
        }
        for number, step in enumerate(causes.steps, 1)
        for candidate in step.named
    ]
    advice = advise(choice, drawn.on_board, causes.named, sky)
    return {
        "causes": rows,
        "causes_runs": causes.runs,
        "advice_text": advice,
        "why_text": f"Why: {describe_causes(causes, advice)}",
    }
